"""Tables of errors as LaTeX, with the commands of booktabs."""

from collections.abc import Sequence
from pathlib import Path

from signorini_fenicsx.comparing.convergence import ErrorRow

NAMES = {
    "sigma_V": r"\|\sigma-\sigma_h\|_V",
    "sigma_L2": r"\|\sigma-\sigma_h\|",
    "u_Q": r"\|u-u_h\|",
    "u_L2": r"\|u-u_h\|",
    "u_potential_L2": r"\|u-\tilde u_h\|",
    "p_Lambda": r"\|p-p_h\|",
    "p_half": r"\|p-p_h\|_{1/2}",
    "p_L2": r"\|p-p_h\|",
    "flux_scaled": r"\sqrt\varepsilon\|(\sigma-\sigma_h)\cdot n\|",
}
"""The errors as formulas; others stand with their names."""


def write_latex(path: Path, rows: Sequence[ErrorRow]) -> None:
    """Write errors and their orders, a row for each mesh or ε (rank 0)."""
    names = [name for name in rows[0].errors if any(row.errors[name] is not None for row in rows)]
    with_eps = any(row.eps is not None for row in rows)
    heads = ["$h$", *([r"$\varepsilon$"] if with_eps else []), "cells", "iterations"]
    for name in names:
        heads += [f"${NAMES[name]}$" if name in NAMES else name.replace("_", r"\_"), "order"]
    lines = [rf"\begin{{tabular}}{{{'r' * len(heads)}}}", r"\toprule", " & ".join(heads) + r" \\", r"\midrule"]
    for row in rows:
        entries = [_number(row.h), *([_number(row.eps)] if with_eps else []), str(row.cells), str(row.iterations)]
        for name in names:
            order = row.orders[name]
            entries += [_number(row.errors[name]), "" if order is None else f"{order:.2f}"]
        lines.append(" & ".join(entries) + r" \\")
    path.write_text("\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""]), encoding="utf-8")


def _number(value: float | None) -> str:
    """A number with three digits; nothing for None."""
    if value is None:
        return ""
    digits, _, exponent = f"{value:.2e}".partition("e")
    return f"${digits}$" if int(exponent) == 0 else rf"${digits}\cdot 10^{{{int(exponent)}}}$"
