"""Compare all algorithms on all examples and three mesh sizes: work, accuracy, mass balance, contact set.

Usage: python scripts/compare_methods.py [--examples 1,2,3,4,5,6] [--levels 3:5] [--reference 7] [--output FOLDER]

For h ≤ 2^-level it prints, and writes into FOLDER/methods.csv, one row per algorithm, then means over the examples; the
columns are explained in `method_rows.MethodRow`. The reference is Algorithm 1 with
h ≤ 2^-reference, and ε is 1e-8 in all examples. FOLDER/methods.png shows four of the columns over h, as geometric means
over the examples.
"""

import argparse
import itertools
from dataclasses import fields
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from method_rows import MethodRow, compare_methods
from mpi4py import MPI
from rich.console import Console
from rich.table import Table

from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.text import write_table
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.methods.registry import METHODS

COMM = MPI.COMM_WORLD
COLUMNS = [field.name for field in fields(MethodRow)]
PANELS = {
    "iterations": "iterations",
    "seconds": "seconds",
    "flux": "‖σ_ref − σ_h‖ / ‖σ_ref‖",
    "mass": "‖∇·σ_h + f_h‖ / ‖f_h‖",
}
FAMILIES = {
    "C0": ("alg1", "alg2", "vi", "qp"),
    "C1": ("alg3", "alg4", "snes1", "snes2"),
    "C2": ("mixed-uzawa1", "mixed-uzawa2", "mixed-uzawa-h12", "mixed-uzawa-wang"),
    "C3": ("uzawa", "psor", "primal-pdas", "primal-penalty"),
    "C4": ("slimane",),
}
STYLES = ("o-", "s--", "^:", "v-.")


def complain(method: str, failure: NumericalFailure) -> None:
    """Print which method failed and why."""
    if COMM.rank == 0:
        print(f"{method} failed: {failure}")


def show(rows: list[MethodRow]) -> None:
    """Print the rows of one example."""
    if COMM.rank == 0:
        table = Table(*COLUMNS[1:], title=rows[0].case)
        for row in rows:
            values = (getattr(row, name) for name in COLUMNS[1:])
            table.add_row(*(f"{value:.2e}" if isinstance(value, float) else str(value) for value in values))
        Console(width=130).print(table)


def summarise(rows: dict[int, list[MethodRow]]) -> None:
    """Print the values of the figure, and for each method its largest distance from Algorithm 1."""
    if COMM.rank == 0:
        title = "geometric means over the examples, h ≤ " + " / ".join(f"2^-{level}" for level in rows)
        table = Table("method", *PANELS, "distance", title=title)
        for method in METHODS:
            means = [" / ".join(f"{mean(some, method, column):.2g}" for some in rows.values()) for column in PANELS]
            distance = max(row.distance for some in rows.values() for row in some if row.method == method)
            table.add_row(method, *means, f"{distance:.1e}")
        Console(width=130).print(table)


def mean(rows: list[MethodRow], method: str, column: str) -> float:
    """Geometric mean of a column over the rows of one method."""
    values = [getattr(row, column) for row in rows if row.method == method]
    return float(np.exp(np.mean(np.log(np.maximum(values, 1e-17)))))


def draw(path: Path, rows: dict[int, list[MethodRow]]) -> None:
    """Geometric means over the examples, over h; rows by level."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    h = [2.0**-level for level in rows]
    for axes, (column, label) in zip(figure.subplots(2, 2).flat, PANELS.items(), strict=True):
        for colour, methods in FAMILIES.items():
            for method, style in zip(methods, STYLES, strict=False):
                means = [mean(of_level, method, column) for of_level in rows.values()]
                axes.loglog(h, means, style, color=colour, label=method, markersize=4)
        axes.set_xscale("log", base=2)
        axes.set(xlabel="h", ylabel=label)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside right center")
    figure.savefig(path, dpi=150)


def main() -> None:
    """Run everything, then write the table and the figure."""
    parser = argparse.ArgumentParser(description="Compare all algorithms on all examples.")
    parser.add_argument("--examples", default="1,2,3,4,5,6")
    parser.add_argument("--levels", default="3:5")
    parser.add_argument("--reference", type=int, default=7)
    parser.add_argument("--output", type=Path, default=Path("results/compare_methods"))
    options = parser.parse_args()
    first, last = (int(level) for level in options.levels.split(":"))

    for method in METHODS:  # compiles the forms, so that no time contains this
        solve_case(load_case("example1").with_values({"solve.algorithm": method, "solve.h": 0.25}))
    rows: dict[int, list[MethodRow]] = {level: [] for level in range(first, last + 1)}
    for example in options.examples.split(","):
        case = load_case(f"example{example}")
        fine = solve_case(case.with_values({"solve.algorithm": "alg1", "solve.h": 2.0**-options.reference}))
        comparisons = {level: compare_methods(case, 2.0**-level, fine, on_failure=complain) for level in rows}
        for level, of_level in comparisons.items():
            rows[level] += of_level
        show([row for of_level in comparisons.values() for row in of_level])

    summarise(rows)

    def write() -> None:
        options.output.mkdir(parents=True, exist_ok=True)
        write_table(options.output / "methods.csv", MethodRow, itertools.chain(*rows.values()))
        draw(options.output / "methods.png", rows)

    on_root(COMM, write)


if __name__ == "__main__":
    main()
