"""Gain of adaptive refinement with RT0: unknowns and seconds that it needs for the certified error of uniform meshes.

Usage: python scripts/adaptive_gain.py [MAX_CELLS [CASE …]]
       python scripts/adaptive_gain.py --quantities [MAX_CELLS]

For each case (default: example2 example5) uniform refinement runs up to MAX_CELLS (default 200000). For each uniform
mesh the table gives its certified relative error, then unknowns and seconds of

- uniform: this mesh, the seconds of all meshes up to it, and those of this mesh alone,
- adaptive: the first adaptive mesh with at most this error, and the seconds of all meshes up to it,

and the ratios: of the unknowns, of the seconds, and of the seconds of the uniform mesh alone to those of all adaptive
meshes. Each mesh starts from the contact set of the mesh before. A first run on small meshes compiles the forms and
does not count.

With --quantities the table compares refinement for the interval of a quantity with refinement for the bound of the
energy error, and with uniform refinement, in example 5: cells of the first mesh whose interval is that short, and the
seconds of all meshes up to it, each with its interval. Each length is what the last mesh for the energy bound reaches,
times 1, 2 and 4.
"""

import sys
from dataclasses import replace
from functools import partial
from itertools import pairwise

from mpi4py import MPI
from rich.console import Console
from rich.table import Table

from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import adapt_case
from signorini_fenicsx.certificate.adaptive import ALONE, FIRST_MESH, AdaptRow
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.quantities import Integral, Kind, Mean, Quantity
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


def of_quantities(max_cells: int) -> None:
    """Print the table of quantities."""
    case = load_case("example5")
    case = case.with_values({"solve.h": shape_of(case.geometry.shape).diameter / FIRST_MESH, "solve.element": "RT0"})
    ways = {"interval": (False, 0.5), "energy": (True, 0.5), "uniform": (True, 1.0)}
    table = Table("quantity", "length", *(f"{way}: {what}" for way in ways for what in ("cells", "s")))
    for name, kind in QUANTITIES.items():
        rows: dict[str, list[AdaptRow]] = {}
        for way, (of_energy, theta) in ways.items():
            rows[way] = []
            measure = partial(measured, kind=kind, of_energy=of_energy)
            adapt_case(case, max_cells=max_cells, theta=theta, measure=measure, on_row=rows[way].append)
        last = rows["energy"][-1].quantities[ALONE].width
        for factor in (4, 2, 1):
            cells = []
            for of_way in rows.values():
                reached = next((row for row in of_way if row.quantities[ALONE].width <= factor * last), None)
                cells += ["–", "–"] if reached is None else [str(reached.cells), f"{reached.seconds:.1f}"]
            table.add_row(name, f"{factor * last:.2e}", *cells)
    if MPI.COMM_WORLD.rank == 0:
        Console(width=110).print(table)


def main() -> None:
    """Print one table over all cases, or that of quantities."""
    if sys.argv[1:2] == ["--quantities"]:
        of_quantities(int(sys.argv[2]) if len(sys.argv) > 2 else 20_000)
        return
    max_cells = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
    columns = ("case", "error", "uniform", "seconds", "alone", "adaptive", "seconds", "ratios")
    table = Table(*columns)
    for name in sys.argv[2:] or ("example2", "example5"):
        case = load_case(name)
        case = case.with_values(
            {"solve.h": shape_of(case.geometry.shape).diameter / FIRST_MESH, "solve.element": "RT0"}
        )
        uniform: list[AdaptRow] = []
        adaptive: list[AdaptRow] = []
        adapt_case(case, max_cells=10_000)
        _, finest = adapt_case(case, max_cells=max_cells, theta=1.0, on_row=uniform.append)
        adapt_case(case, target=finest.relative, on_row=adaptive.append)
        for before, row in pairwise(uniform):
            reached = next(other for other in adaptive if other.relative <= row.relative)
            alone = row.seconds - before.seconds
            ratios = (row.unknowns / reached.unknowns, row.seconds / reached.seconds, alone / reached.seconds)
            table.add_row(
                name,
                f"{row.relative:.2e}",
                str(row.unknowns),
                f"{row.seconds:.1f}",
                f"{alone:.1f}",
                str(reached.unknowns),
                f"{reached.seconds:.1f}",
                "  ".join(f"{ratio:.1f}" for ratio in ratios),
            )
    if MPI.COMM_WORLD.rank == 0:
        Console(width=100).print(table)


if __name__ == "__main__":
    main()
