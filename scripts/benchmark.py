"""Compares the speed of this program with alternatives: one table, one picture.

Each competitor runs in a separate process and reads the same mesh file. Its time counts only if its KKT residual and
its flux error are right. Runs are interleaved; medians and extremes are given. Seconds are those of the solver, from
the mesh to the fields, without making the mesh and without the final KKT check.

    uv run --group bench python scripts/benchmark.py            # long: the saddle points take most of it
    uv run --group bench python scripts/benchmark.py --quick
    uv run --group bench python scripts/benchmark.py --small    # up to 60 000 facets, at equal flux error
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import matplotlib
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from signorini_fenicsx.base.text import write_table
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.meshes.grids import Share
from signorini_fenicsx.meshes.shapes import SHAPES

WORKERS = Path(__file__).with_name("benchmark")
OURS, ALONE, FRESH, REUSE, SNESVI, KNOWN = (
    "ours",
    "ours, this mesh alone",
    "saddle point, fresh",
    "saddle point, symbolic reuse",
    "SNESVI + GAMG",
    "contact set known",
)
SKFEM, NGSOLVE = "scikit-fem + PyAMG, P1", "NGSolve, P1"
P1 = (SKFEM, NGSOLVE)
METHODS = (OURS, ALONE, FRESH, REUSE, SNESVI, *P1, KNOWN)
ON_TWO_RANKS = (OURS, KNOWN)
FACTORED_UP_TO = {"transition": 1.5e6, "transition3d": 2.2e5}
"""Largest number of cells for which a factorisation of the saddle point fits into the memory of a common machine."""
RUN_ONCE_FROM = 30.0
"""Runs that take longer than this many seconds are not repeated."""
TARGETS = {  # least cells: a / ours, b / ours, ours / f
    "transition": {130_000: (25, 6, 1.5), 1_000_000: (40, 10, 1.5)},
    "transition3d": {80_000: (20, 9, 2.0), 500_000: (60, 20, 2.0)},
}
FULL = {"transition": ("2^-6", "2^-7", "2^-8", "2^-9"), "transition3d": ("0.14", "0.072", "0.055", "0.039")}
QUICK = {"transition": ("2^-4", "2^-5", "2^-6"), "transition3d": ("0.28", "0.14", "0.1")}
SMALL = {
    "transition": ("2^-4", "2^-4.5", "2^-5", "2^-5.5", "2^-6", "2^-6.5"),
    "transition3d": ("0.28", "0.2", "0.14", "0.11"),
}
"""Sizes below 60 000 facets."""
FINER = {"transition": (), "transition3d": ("0.08", "0.06")}
"""Sizes at which P1 reaches the flux errors that we have on those of `SMALL`."""
AGAIN = 4
"""Small solves are repeated this often in one process; the fastest counts."""

console = Console(highlight=False, width=None if sys.stdout.isatty() else 180)


@dataclass(frozen=True)
class Row:
    """One competitor on one mesh: medians over the repetitions."""

    case: str
    method: str
    ranks: int
    cells: int
    unknowns: int
    solver: str
    steps: int
    linear_iterations: int
    seconds: float
    fastest: float
    slowest: float
    assembly: float
    setup: float
    solve: float
    rest: float
    kkt: float
    flux_error: float
    mebibytes: float
    repeats: int


def main(
    quick: Annotated[bool, typer.Option(help="Small meshes only.")] = False,
    small: Annotated[bool, typer.Option(help="Compare with P1 at equal flux error below 60 000 facets.")] = False,
    repeats: Annotated[int, typer.Option(min=1, help="Runs of each competitor.")] = 3,
    case: Annotated[str | None, typer.Option(help="transition or transition3d; both if not given.")] = None,
    output: Annotated[Path, typer.Option(help="Folder of the table and the picture.")] = Path("results/benchmark"),
) -> None:
    """Run all competitors on all meshes and print their times."""
    rows: list[Row] = []
    sizes = QUICK if quick else FULL
    output.mkdir(parents=True, exist_ok=True)
    if small:
        console.print(at_equal_error(case, repeats))
        return
    for name in (case,) if case else sizes:
        for h in sizes[name]:
            rows += compare(name, h, repeats)
            write_table(output / "benchmark.csv", Row, rows)
    draw(rows, output / "benchmark.png")
    console.print(targets(rows))
    console.print(f"results    {output}")


def compare(case: str, h: str, repeats: int) -> list[Row]:
    """All competitors on one mesh, interleaved."""
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "mesh.npz"
        cells = write_mesh(case, h, mesh)
        runs = [(method, 1) for method in METHODS if method not in (FRESH, REUSE) or cells <= FACTORED_UP_TO[case]]
        runs += [(method, 2) for method in ON_TWO_RANKS]
        measured: dict[tuple[str, int], list[dict]] = {run: [] for run in runs}
        for _ in range(repeats):
            for run, results in measured.items():
                if not results or results[0]["seconds"] < RUN_ONCE_FROM:
                    with console.status(f"{case}, h = {h}, {cells} cells: {run[0]}, {run[1]} ranks"):
                        results.append(launch(case, h, mesh, *run))
    rows = [summarise(case, method, ranks, results) for (method, ranks), results in measured.items()]
    check(rows)
    console.print(table(rows))
    return rows


def at_equal_error(case: str | None, repeats: int) -> Table:
    """Our seconds on small meshes, and those of P1 for the same flux error, between its sizes by a power law."""
    result = Table(title="Seconds on one core at equal flux error; ~ extrapolated", title_justify="left")
    for name in ("case", "facets", "‖σ−σ_h‖", "ours", *(f"{other}{end}" for other in P1 for end in ("", " / ours"))):
        result.add_column(name, justify="left" if name == "case" else "right")
    for name in (case,) if case else SMALL:
        runs: dict[str, list[dict]] = {method: [] for method in (OURS, *P1)}
        for h in SMALL[name] + FINER[name]:
            for method in runs if h in SMALL[name] else P1:
                runs[method].append(best_of(name, h, method, repeats))
        for ours in runs[OURS]:
            shown = [f"{ours['unknowns']}", f"{ours['flux_error']:.3g}", f"{ours['seconds']:.3f}"]
            for method in P1:
                time, guessed = at_error(runs[method], ours["flux_error"])
                shown += [f"{'~' * guessed}{time:.3f}", f"{time / ours['seconds']:.2f}"]
            result.add_row(name, *shown)
    return result


def best_of(case: str, h: str, method: str, repeats: int) -> dict:
    """The fastest of some runs of one competitor, each of which solves several times."""
    with tempfile.TemporaryDirectory() as folder, console.status(f"{case}, h = {h}: {method}"):
        mesh = Path(folder) / "mesh.npz"
        write_mesh(case, h, mesh)
        runs = [launch(case, h, mesh, method, 1, AGAIN) for _ in range(repeats)]
    return min(runs, key=lambda run: run["seconds"])


def at_error(runs: list[dict], error: float) -> tuple[float, bool]:
    """Seconds of a competitor at a flux error, and whether they are extrapolated."""
    errors, times = (np.log([run[key] for run in runs]) for key in ("flux_error", "seconds"))
    wanted = np.log(error)
    i = int(np.clip(np.searchsorted(-errors, -wanted) - 1, 0, len(runs) - 2))
    slope = (times[i + 1] - times[i]) / (errors[i + 1] - errors[i])
    inside = bool(errors[-1] <= wanted <= errors[0])
    return float(np.exp(times[i] + slope * (wanted - errors[i]))), not inside


def write_mesh(case: str, h: str, path: Path) -> int:
    """Write the points and cells of the case's structured mesh; returns the number of cells."""
    settings = load_case(case).with_values({"geometry.mesh": "structured", "solve.h": h})
    grid = SHAPES[settings.geometry.shape].grid
    assert grid is not None
    points, cells = grid(settings.solve.h, "right", Share())
    np.savez(path, points=points, cells=cells)
    return len(cells)


def launch(case: str, h: str, mesh: Path, method: str, ranks: int, again: int = 1) -> dict:
    """Run one competitor once; of several solves in this run the fastest counts.

    Raises:
        RuntimeError: If it fails.
    """
    if method == SKFEM:
        command = [sys.executable, WORKERS / "skfem_worker.py", mesh, again]
    elif method == NGSOLVE:
        command = [sys.executable, WORKERS / "ngsolve_worker.py", mesh, again]
    else:
        command = [sys.executable, WORKERS / "fenicsx_worker.py", method, case, h, mesh, again]
    if ranks > 1:
        command = ["mpirun", "-n", str(ranks), *command]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NGS_NUM_THREADS": "1"}
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, env=environment, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{method}, {ranks} ranks, h = {h}: {done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def summarise(case: str, method: str, ranks: int, results: list[dict]) -> Row:
    """Medians over the repetitions of one competitor."""

    def median(key: str) -> float:
        return statistics.median(result[key] for result in results)

    seconds, last = [result["seconds"] for result in results], results[-1]
    return Row(
        case=case,
        method=method,
        ranks=ranks,
        **{key: last[key] for key in ("cells", "unknowns", "solver", "steps", "linear_iterations")},
        seconds=median("seconds"),
        fastest=min(seconds),
        slowest=max(seconds),
        assembly=median("assembly"),
        setup=median("setup"),
        solve=median("solve"),
        rest=median("recovery and rest"),
        kkt=max(result["kkt"] for result in results),
        flux_error=last["flux_error"],
        mebibytes=max(result["peak_memory"] for result in results) / 2**20,
        repeats=len(results),
    )


def check(rows: list[Row]) -> None:
    """Make sure that all competitors have solved the problem: the same cells, small residuals, the right flux.

    Raises:
        RuntimeError: If one has not.
    """
    ours = rows[0]
    for row in rows:
        same_discretisation = row.method not in P1
        tolerance = 1e-6 if same_discretisation else 1.0  # P1 has 12 times fewer unknowns in 3D
        wrong = abs(row.flux_error / ours.flux_error - 1) > tolerance
        if row.cells != ours.cells or row.kkt > 1e-8 or wrong:
            raise RuntimeError(f"{row.method} has not solved the problem: {row}, ours: {ours}")


def table(rows: list[Row]) -> Table:
    """One line per competitor."""
    ours = rows[0].seconds
    result = Table(title=f"{rows[0].case}, {rows[0].cells} cells", title_justify="left")
    columns = (
        "method",
        "ranks",
        "unknowns",
        "steps",
        "its",
        "seconds",
        "min–max",
        "/ ours",
        "assembly",
        "set-up",
        "solve",
    )
    for name in (*columns, "rest", "KKT", "‖σ−σ_h‖", "MiB"):
        result.add_column(name, justify="left" if name == "method" else "right")
    for row in rows:
        phases = (f"{value:.2f}" for value in (row.assembly, row.setup, row.solve, row.rest))
        result.add_row(
            row.method,
            *map(str, (row.ranks, row.unknowns, row.steps, row.linear_iterations)),
            f"{row.seconds:.2f}",
            f"{row.fastest:.2f}–{row.slowest:.2f}",
            f"{row.seconds / ours:.2f}",
            *phases,
            f"{row.kkt:.0e}",
            f"{row.flux_error:.3g}",
            f"{row.mebibytes:.0f}",
        )
    return result


def targets(rows: list[Row]) -> Table:
    """The main ratios, on the smallest mesh of each class of sizes."""
    result = Table(title="Ratios of solver time; ~ extrapolated by a power law", title_justify="left")
    for name in (
        "mesh",
        "a / ours",
        "at least",
        "b / ours",
        "at least",
        "ours / f",
        "at most",
        "1 rank / 2",
        "facets/s",
    ):
        result.add_column(name, justify="left" if name == "mesh" else "right")
    for case, classes in TARGETS.items():
        for least, (a, b, f) in classes.items():
            sizes = [row.cells for row in rows if row.case == case and row.cells >= least]
            if not sizes:
                continue
            cells = min(sizes)
            ours = seconds(rows, case, OURS, cells)[0]
            slower = [seconds(rows, case, method, cells) for method in (FRESH, REUSE)]
            with_known_set = seconds(rows, case, KNOWN, cells)[0]
            two = seconds(rows, case, OURS, cells, ranks=2)[0]
            facets = next(row.unknowns for row in rows if (row.case, row.method, row.cells) == (case, OURS, cells))
            shown = [f"{'~' * guessed}{time / ours:.1f}" for time, guessed in slower]
            result.add_row(
                f"{case}, {cells} cells",
                *(shown[0], f"{a}", shown[1], f"{b}", f"{ours / with_known_set:.2f}", f"{f}"),
                f"{ours / two:.2f}",
                f"{facets / ours / 1000:.0f}k",
            )
    return result


def seconds(rows: list[Row], case: str, method: str, cells: int, *, ranks: int = 1) -> tuple[float, bool]:
    """Seconds of a method on a mesh, and whether they are extrapolated from its two largest meshes."""
    by_cells = {row.cells: row.seconds for row in rows if (row.case, row.method, row.ranks) == (case, method, ranks)}
    if cells in by_cells:
        return by_cells[cells], False
    (n1, t1), (n2, t2) = sorted(by_cells.items())[-2:]
    return t2 * (cells / n2) ** (np.log(t2 / t1) / np.log(n2 / n1)), True


def draw(rows: list[Row], path: Path) -> None:
    """Time over cells and time over error, one row of panels per case."""
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    cases = list(dict.fromkeys(row.case for row in rows))
    figure, axes = plt.subplots(len(cases), 2, figsize=(12, 5 * len(cases)), squeeze=False, layout="constrained")
    for (over_cells, over_error), case in zip(axes, cases, strict=True):
        for number, method in enumerate(METHODS):
            chosen = [row for row in rows if (row.case, row.method, row.ranks) == (case, method, 1)]
            style = {"marker": "o", "color": f"C{number}", "linestyle": "--" if method == KNOWN else "-"}
            times = [row.seconds for row in chosen]
            over_cells.loglog([row.cells for row in chosen], times, label=method, **style)
            over_error.loglog([row.flux_error for row in chosen], times, **style)
        over_cells.set(title=case, xlabel="cells", ylabel="seconds")
        over_error.set(title=case, xlabel="‖σ − σ_h‖", ylabel="seconds")
        over_error.invert_xaxis()
        for axis in (over_cells.xaxis, over_error.xaxis):  # less than two decades
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(NullFormatter())
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.savefig(path, dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(main)
    app()
