"""Tables of errors and of studies as LaTeX, with the commands of booktabs."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from signorini_fenicsx.comparing.convergence import ErrorRow

FORMULAS = {
    "sigma_V": r"\|\sigma-\sigma_h\|_V",
    "u_Q": r"\|u-u_h\|",
    "p_Lambda": r"\|p-p_h\|",
    "p_half": r"\|p-p_h\|_{1/2}",
    "flux_scaled": r"\sqrt{\varepsilon}\|(\sigma-\sigma_h)\cdot n\|",
    "energy": r"|\sigma-\sigma_h|",
    "u_L2": r"\|u-u_h\|",
    "pressure_L2": r"\|(\sigma-\sigma_h)_{nn}\|",
    "gap_L2": r"\|(u-u_h)_n\|",
}


def formula(error: str) -> str:
    """The formula of an error; empty for one that stands with its name."""
    return f"${FORMULAS[error]}$" if error in FORMULAS else ""


def write_latex(path: Path, rows: Sequence[ErrorRow]) -> None:
    """Write errors and their orders, a row for each mesh or ε (rank 0)."""
    names = [name for name in rows[0].errors if any(row.errors[name] for row in rows)]  # p has none without Γ_S
    with_eps = any(row.eps is not None for row in rows)
    heads = ["$h$", *([r"$\varepsilon$"] if with_eps else []), "cells", "iterations"]
    for name in names:
        heads += [formula(name) or _text(name), "order"]
    lines = []
    for row in rows:
        entries = [_number(row.h), *([_number(row.eps)] if with_eps else []), str(row.cells), str(row.iterations)]
        for name in names:
            order = row.orders[name]
            entries += [_number(row.errors[name]), "" if order is None else f"{order:.2f}"]
        lines.append(entries)
    _write(path, heads, lines)


def write_columns(path: Path, columns: Mapping[str, str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write some columns of a table, under their heads (rank 0)."""
    entries = [[_entry(row.get(key)) for key in columns] for row in rows]
    _write(path, [_text(head) for head in columns.values()], entries)


def _write(path: Path, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    lines = [" & ".join(row) + r" \\" for row in (heads, *rows)]
    table = [rf"\begin{{tabular}}{{{'r' * len(heads)}}}", r"\toprule", lines[0], r"\midrule", *lines[1:]]
    path.write_text("\n".join([*table, r"\bottomrule", r"\end{tabular}", ""]), encoding="utf-8")


def _text(value: object) -> str:
    """Text, in which LaTeX takes no character for a command."""
    special = {"\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}"} | {mark: "\\" + mark for mark in "_&%$#{}"}
    return "".join(special.get(mark, mark) for mark in str(value))


def _entry(value: object) -> str:
    """A cell of a table; a short number, such as one that is given, is as it is."""
    if value is None:
        return ""
    if isinstance(value, float) and value == float(short := f"{value:.3g}") and "e" not in short:
        return f"${short}$"
    return _number(value) if isinstance(value, float) and math.isfinite(value) else _text(value)


def _number(value: float | None) -> str:
    """A number with three digits; nothing for None."""
    if value is None:
        return ""
    digits, _, exponent = f"{value:.2e}".partition("e")
    return f"${digits}$" if int(exponent) == 0 else rf"${digits}\cdot 10^{{{int(exponent)}}}$"
