"""What adaptive refinement gains, and how intervals of quantities shrink with h."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Annotated

import typer

from measuring import COMM, say, show
from signorini_fenicsx import Diffusion, Neumann, Signorini, adapt_case, load_case, solve
from signorini_fenicsx.certificate.adaptive import ALONE, FIRST_MESH, AdaptRow
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.quantities import Energy, Flux, Integral, Kind, Mean, Quantity
from signorini_fenicsx.solving.solved import Solved

QUANTITIES: dict[str, Kind] = {
    "mean": Mean(),
    "far corner": Integral(weight="1 if x > 0.5 and y < 0.25 else 0"),
    "on bottom": Mean(parts="bottom"),
}
"""Quantities of example 5."""


def measured(solution: Solved, kind: Kind, *, of_energy: bool) -> Quantity:
    """A quantity; for the bound of the energy error without the shares of cells (collective)."""
    interval = solution.quantity(kind)
    return replace(interval, shares=None) if of_energy else interval


def coarse(name: str) -> Case:
    """A case with RT0 on the mesh from which adaptive runs start."""
    case = load_case(name)
    return case.with_values({"solve.h": shape_of(case.geometry.shape).diameter / FIRST_MESH, "solve.element": "RT0"})


def reached(rows: list[AdaptRow], size: Callable[[AdaptRow], float], most: float, number: str) -> list[object]:
    """Cells or unknowns of the first mesh on which something is at most so large, and the seconds of all up to it."""
    row = next((row for row in rows if size(row) <= most), None)
    return ["–", "–"] if row is None else [getattr(row, number), row.seconds]


def width(row: AdaptRow) -> float:
    """The length of the interval of the quantity."""
    return row.quantities[ALONE].width


def quantities(max_cells: Annotated[int, typer.Argument()] = 20_000) -> None:
    """Refinement for the interval of a quantity beside that for the energy error, and uniform one, in example 5.

    The table has cells of the first mesh whose interval is that short, and the seconds of all meshes up to it, each
    with its interval. Each length is what the last mesh for the energy bound reaches, times 1, 2 and 4.
    """
    ways = {"interval": (False, 0.5), "energy": (True, 0.5), "uniform": (True, 1.0)}
    table = []
    for name, kind in QUANTITIES.items():
        rows: dict[str, list[AdaptRow]] = {way: [] for way in ways}
        for way, (of_energy, theta) in ways.items():
            measure = partial(measured, kind=kind, of_energy=of_energy)
            adapt_case(coarse("example5"), max_cells=max_cells, theta=theta, measure=measure, on_row=rows[way].append)
        for factor in (4, 2, 1):
            most = factor * width(rows["energy"][-1])
            found = [cell for some in rows.values() for cell in reached(some, width, most, "cells")]
            table.append([name, most, *found])
    show(["quantity", "length", *(f"{way}: {what}" for way in ways for what in ("cells", "s"))], table)


def adaptive(
    max_cells: Annotated[int, typer.Argument()] = 200_000,
    cases: Annotated[list[str], typer.Argument()] = ["example2", "example5"],  # noqa: B006
) -> None:
    """Unknowns and seconds that adaptive refinement with RT0 needs for the certified error of uniform meshes.

    For each case uniform refinement runs up to MAX_CELLS. For each uniform mesh the table gives its certified relative
    error, its unknowns, the seconds of all meshes up to it, and those of this mesh alone; then unknowns of the first
    adaptive mesh with at most this error, and the seconds of all up to it. Each mesh starts from the contact set of the
    mesh before. A first run on small meshes compiles the forms and does not count.
    """
    table = []
    for name in cases:
        case, uniform, refined = coarse(name), list[AdaptRow](), list[AdaptRow]()
        adapt_case(case, max_cells=10_000)
        _, finest = adapt_case(case, max_cells=max_cells, theta=1.0, on_row=uniform.append)
        adapt_case(case, target=finest.relative, on_row=refined.append)
        for before, row in pairwise(uniform):
            of_row = [row.unknowns, row.seconds, row.seconds - before.seconds]
            most = row.relative
            others = reached(refined, lambda row: row.relative, most, "unknowns")
            table.append([name, most, *of_row, *others])
    show(["case", "error", "uniform", "seconds", "alone", "adaptive", "seconds"], table)


def orders() -> None:
    """How half the length of some intervals shrinks with h (collective)."""
    problem = Diffusion(f="-10 if x < 0.5 else 10", conditions=[Signorini("bottom"), Neumann("right")])
    kinds = [Integral(weight="1 if x < 0.5 else 0"), Mean(), Flux(["left", "bottom", "top"]), Energy()]
    for n in (16, 32, 64, 128):
        solution = solve(build_domain(COMM, "square", 1.001 * 2**0.5 / n, mesh="structured"), problem)
        intervals = [solution.quantity(kind) for kind in kinds]
        say(f"{n:4d} " + "  ".join(f"{each.middle:.6f} ± {each.width / 2:.2e}" for each in intervals))
