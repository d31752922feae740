"""Quantities: their values are those of the solution in the tables, and intervals have the exact ones, if known."""

import json
import random
from pathlib import Path

import numpy as np
from exact_quantities import Known, bar, membrane

from fuzzing.broken import OUTPUT, Broken, Valid
from fuzzing.laws import LAWS
from signorini_fenicsx import Contact, Dirichlet, Signorini
from signorini_fenicsx.quantities import Kind

IN_TABLES = {
    "flux": {"kind": "flux", "parts": ["left"]},
    "p": {"kind": "integral", "parts": ["left"]},
    "resultant": {"kind": "force", "parts": ["right"], "direction": [1, 0]},
}
"""Quantities that are in the tables, by the names that these have there."""


def quantities(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A membrane or a bar whose quantities are known, or any law on a side, steady or in time."""
    asked, values = {}, {}
    if rng.random() < 0.5:
        known = rng.choice([membrane, bar])(np.random.default_rng(rng.randrange(2**32)))
        lines, shown = _of_known(known)
        for kind, value in rng.sample(known.kinds, 2):
            name = f"number {len(asked)}"
            asked[name], values[name] = _keys(kind), value
    else:
        law, in_time = rng.choice(LAWS), rng.random() < 0.5
        lines, shown = ["[boundary]", 'neumann = ["top", "bottom"]', "[[law]]", 'parts = ["left"]'], ["flux", "p"]
        lines += [f"{key} = {value}" for key, value in law.items()]
        lines += ["[problem]", f'f = "{rng.uniform(-20, 20)} if y < {rng.random()} else {rng.uniform(-20, 20)}"']
        lines += [f"u_D = {rng.uniform(-1, 1)}", *(["[time]", "end = 1", "steps = 2"] if in_time else [])]
    for name, keys in (asked | {name: IN_TABLES[name] for name in shown}).items():
        lines += ["[[quantity]]", f'name = "{name}"', *(f"{key} = {json.dumps(value)}" for key, value in keys.items())]
    lines += ["[geometry]", 'shape = "square"', f'mesh = "{rng.choice(["structured", "unstructured"])}"']
    lines += ["[solve]", f"h = {rng.uniform(0.3, 0.7)}"]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = ["solve", "case.toml", "--output", OUTPUT]
    return Broken(words, "; ".join(lines)[:400], solved=True, values=values, shown=shown)


def _of_known(known: Known) -> tuple[list[str], list[str]]:
    """The lines of a problem on the unit square that depends on x alone, and which quantities tables have of it."""
    left, right, _ = known.problem.conditions
    sides, f = {"neumann": ["top", "bottom"]}, json.dumps(known.problem.f)
    if isinstance(right, Contact):
        lines = ['physics = "elasticity"', "[boundary]", 'neumann = ["top", "bottom"]', 'contact = ["right"]']
        lines += ['fixed = {left = "xy"}', "[problem]", "young = 2", "poisson = 0"]
        return [*lines, f"u_D = {left.value}", f"gap = {right.gap}", f"f = {f}"], ["resultant"]
    data = {"kappa": known.problem.kappa, "f": known.problem.f, "u_D": repr(right.value)}
    if isinstance(left, Signorini):
        sides["signorini"], data["psi"] = ["left"], repr(left.psi)
    elif isinstance(left, Dirichlet):
        data["u_D"] = f"{right.value!r} if x > 1/2 else {left.value!r}"
    else:
        sides["neumann"].append("left")
        data["g_N"] = f"{left.value!r} if x < 1e-9 else 0"
    lines = ["[boundary]", *(f"{name} = {json.dumps(parts)}" for name, parts in sides.items())]
    lines += ["[problem]", *(f"{name} = {json.dumps(text)}" for name, text in data.items())]
    return lines, ["flux", "p"] if isinstance(left, Signorini) else []


def _keys(kind: Kind) -> dict[str, object]:
    """A quantity as a case file has it."""
    return {"kind": type(kind).__name__.lower()} | {key: value for key, value in vars(kind).items() if value}
