"""Gain of adaptive refinement: unknowns and seconds that it needs for the certified error of each uniform mesh.

Usage: python scripts/adaptive_gain.py [MAX_CELLS [CASE …]]

For each case (default: example2 example5) uniform refinement runs up to MAX_CELLS (default 200000). For each uniform
mesh the table gives its certified relative error, then unknowns and seconds of

- uniform: this mesh, the seconds of all meshes up to it, and those of this mesh alone,
- adaptive: the first adaptive mesh with at most this error, and the seconds of all meshes up to it,

and the ratios: of the unknowns, of the seconds, and of the seconds of the uniform mesh alone to those of all adaptive
meshes. Each mesh starts from the contact set of the mesh before. A first run on small meshes compiles the forms and
does not count.
"""

import sys
from itertools import pairwise

from mpi4py import MPI
from rich.console import Console
from rich.table import Table

from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import adapt_case
from signorini_fenicsx.certificate.adaptive import FIRST_MESH, AdaptRow
from signorini_fenicsx.meshes.shapes import shape_of


def main() -> None:
    """Print one table over all cases."""
    max_cells = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
    columns = ("case", "error", "uniform", "seconds", "alone", "adaptive", "seconds", "ratios")
    table = Table(*columns)
    for name in sys.argv[2:] or ("example2", "example5"):
        case = load_case(name)
        case = case.with_values({"solve.h": shape_of(case.geometry.shape).diameter / FIRST_MESH})
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
