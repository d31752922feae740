"""First problems of engineers and hydrologists: shipped cases on coarse meshes with other numbers.

Stiffnesses, loads, laws, soils and friction are multiplied by random powers of ten, some conditions are taken away, and
some bodies are in other units. Such a problem has a solution, or a sentence says why there is none (exit status 2). No
run may fail (exit status 1).
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
from typing import Any

import numpy as np

from makers import Found
from signorini_fenicsx import InputError, NumericalFailure
from signorini_fenicsx.base.shipped import case_names
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.meshes.shapes import shape_of

NO_SOLUTION = (
    "can move rigidly",
    "slides away",
    "no solution",
    "cannot carry",
    "passes the foundation where parts meet",
)
"""What is said of problems without a solution."""
CELLS_ACROSS = {2: 12, 3: 4}
"""The diameter of a shape divided by h."""
SCALED = ("young", "f", "g_N", "pressure", "kappa", "mu", "g", "q_S", "rain", "beta", "r", "k", "K", "viscosity")
"""Data that are multiplied by a number; with them a problem stays one."""


def times(value: Any, factor: float) -> Any:
    """A datum times a number; of data by part, and of vectors, each."""
    if isinstance(value, dict):
        return {key: times(each, factor) for key, each in value.items()}
    if isinstance(value, list):
        return [times(each, factor) for each in value]
    return f"{factor:.6g}*({value})"


def changed(rng: np.random.Generator, name: str) -> dict[str, Any]:
    """New values for a case, by key."""
    case = load_case(name)
    tree, new = case.model_dump(exclude_unset=True), {}
    if case.geometry.shape is not None:
        shape = shape_of(case.geometry.shape)
        new["solve.h"] = shape.diameter / CELLS_ACROSS[shape.dim]
    tables = [("problem", tree.get("problem", {}))]
    for kind in ("law", "pair"):
        tables += [(f"{kind}.{number}", table) for number, table in enumerate(tree.get(kind, []))]
    tables += [(f"soil.{region}", table) for region, table in tree.get("soil", {}).items()]
    for place, table in tables:
        for key in SCALED:
            if key in table and rng.random() < 0.5:
                new[f"{place}.{key}"] = times(table[key], 10 ** rng.uniform(-2, 2))
    fixed = tree.get("boundary", {}).get("fixed", {})
    if fixed and rng.random() < 0.3:
        moved = tree["problem"].get("u_D", {})
        new["boundary.fixed"] = {part: ways for part, ways in fixed.items() if part in moved or rng.random() < 0.5}
        new["boundary.neumann"] = [*tree["boundary"].get("neumann", []), *(fixed.keys() - new["boundary.fixed"].keys())]
    return new


def first_problem(seed: int) -> list[Found]:
    """Change a case and solve it (collective)."""
    rng = np.random.default_rng(seed)
    name = str(rng.choice([name for name in case_names() if load_case(name).time is None]))
    new = changed(rng, name)
    try:
        solve_case(load_case(name).with_values(new))
        ending = "solved"
    except InputError as error:
        ending = "no solution" if any(words in str(error) for words in NO_SOLUTION) else f"refused: {error}"
    except NumericalFailure as error:
        ending = f"failed: {error}"
    good = ending in ("solved", "no solution")
    return [Found(f"{name}, {new}: {ending}", [ending.partition(":")[0]], wrong=not good, shown=False)]
