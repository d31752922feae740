"""Writes a solution: summary and tables as text, fields for ParaView."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import owned_values
from signorini_fenicsx.base.parallel import Stopwatch, collector_off, on_root
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.base.text import json_text, write_rows, write_table
from signorini_fenicsx.base.versions import versions
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.seepage import seepage
from signorini_fenicsx.certificate.adaptive import AdaptRow
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.certificate.of_field import FieldBound
from signorini_fenicsx.comparing.convergence import ErrorRow, Vary, fitted_slopes
from signorini_fenicsx.contact.history import Step
from signorini_fenicsx.output.checkpoint_writing import write_checkpoint
from signorini_fenicsx.output.field_files import write_fields
from signorini_fenicsx.output.gather import gather
from signorini_fenicsx.output.tables import write_by_rank, write_columns
from signorini_fenicsx.quantities import Quantity
from signorini_fenicsx.solving.fields import IN_CELLS, Field
from signorini_fenicsx.solving.solved import Solved

if TYPE_CHECKING:  # SciPy takes a second to load
    from signorini_fenicsx.rigorous.proof import Proof


@collector_off()
def write_solution(
    solution: Solved,
    folder: Path | str,
    *,
    certificate: Certificate | None = None,
    proof: Proof | None = None,
    quantities: Mapping[str, Quantity] | None = None,
    of_field: FieldBound | None = None,
    plot: bool = False,
    html: bool = False,
    fields: bool = True,
) -> None:
    """Write all files of a solution into a folder, one after the other (collective).

    `Solution.write` writes them completely or not at all, and leaves nothing of an earlier result.

    Args:
        solution: The solution.
        folder: The folder; it is made if it does not exist, and files with the same names are overwritten.
        certificate: Its error bound, or None.
        proof: The result of the attempt to prove the bound, or None.
        quantities: Intervals of quantities by their names, or None.
        of_field: How wrong a function of the user is, or None.
        plot: Also draw PNGs, of a large mesh by a sample of its cells, see `Sample`.
        html: Also write `solution.html`, pictures that the mouse can turn; likewise. Elastic solutions have none.
        fields: Also write the fields for ParaView.

    Raises:
        InputError: If the folder cannot be made.
        OSError: On all ranks, if the disk is full.
        WriteFailure: If a library cannot write, at least on this rank.
    """
    check_kind("solution", solution, Solved)
    check_kind("folder", folder, str, Path)
    folder, comm, watch = Path(folder), solution.spaces.mesh.comm, Stopwatch()
    on_root(comm, lambda: _make(folder))
    with watch.phase("output"):
        write_checkpoint(folder, solution)  # first: it is complete even if the disk is too full for the others
        write_sites(folder, solution)
        water, others = seepage(solution), solution.other_tables()
        line = None if water is None else water.phreatic_line
        if line is not None:
            others |= {"phreatic_line": dict(zip(("x", "y"), line.T, strict=True))}
        for name, columns in others.items():
            on_root(comm, partial(write_columns, folder / f"{name}.csv", [columns]))
        if plot or html:
            with doing("drawing"):
                draw(folder, solution, certificate, line, plot=plot, html=html)
        if plot and of_field is not None:
            _draw_field(folder / "field.png", of_field)
        on_root(comm, lambda: write_table(folder / "history.csv", Step, solution.outcome.history))
        if fields:
            of_files, bounds = dict(solution.fields()), [each for each in (certificate, of_field) if each is not None]
            indicators = [Field(each.indicator.name, owned_values(each.indicator)) for each in bounds]
            of_files[IN_CELLS] = [*of_files[IN_CELLS], *indicators]
            write_fields(folder, solution.spaces, [(None, of_files)], 1)
        summary = solution.summary()
        if water is not None:
            summary["seepage"] = water.summary()
        if certificate is not None:
            summary["certificate"] = certificate.summary()
            summary["timings"] |= {"certificate": certificate.seconds}
        if proof is not None:
            summary["certificate"] |= proof.summary()
        summary = with_quantities(summary, quantities or {})
        if of_field is not None:
            summary["field"] = of_field.summary()
    summary["timings"] |= watch.longest(comm)
    on_root(comm, lambda: write_summary(folder, summary))


def with_quantities(summary: dict[str, Any], quantities: Mapping[str, Quantity]) -> dict[str, Any]:
    """A summary with the intervals for quantities, by their names, in its section for quantities."""
    if not quantities:
        return summary
    summaries = {name: each.summary() for name, each in quantities.items()}
    return summary | {"quantities": summary.get("quantities", {}) | summaries}


def _make(folder: Path) -> None:
    """Make a folder, if there is none (rank 0).

    Raises:
        InputError: If there cannot be one.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"folder {folder}: cannot be made: {error.strerror}") from None


def write_sites(folder: Path, solution: Solved) -> None:
    """Write the table of sites as text; of a large Γ_S a folder with the rows of each rank as Parquet (collective).

    Raises:
        OSError: On all ranks, if the disk is full.
    """
    spaces, table = solution.spaces, solution.table()
    comm = spaces.mesh.comm
    if spaces.Lambda.dofmap.index_map.size_global > solution.options.tuning.one_table_up_to:
        write_by_rank(comm, folder / table.name, lambda: solution.columns(table.in_order()))
        return
    whole = table.gathered(comm)
    on_root(comm, lambda: write_columns(folder / f"{table.name}.csv", [solution.columns(whole)]))


def draw(
    folder: Path, solution: Solved, certificate: Certificate | None, line: Array | None, *, plot: bool, html: bool
) -> None:
    """Draw a solution, perhaps with a phreatic line, on rank 0 (collective)."""
    gathered = gather(solution, None if certificate is None else certificate.indicator)

    def write() -> None:
        if gathered is not None:
            from signorini_fenicsx.output import pictures  # takes a second to import

            scene = pictures.scene_of(solution, gathered, certificate, line)
            if plot:
                pictures.draw_all(folder, scene)
            if html:
                pictures.write_page(folder / "solution.html", scene)

    on_root(solution.spaces.mesh.comm, write)


def _draw_field(path: Path, of_field: FieldBound) -> None:
    """Draw how wrong a function is in each cell, on rank 0 (collective)."""
    from signorini_fenicsx.output import pictures  # takes a second to import

    solution = of_field.solution
    gathered = gather(solution, of_field.indicator)

    def write() -> None:
        if gathered is not None:
            pictures.draw_field(path, pictures.scene_of(solution, gathered))

    on_root(solution.spaces.mesh.comm, write)


def write_convergence(
    case: CaseFile, vary: Vary, reference: int, rows: list[ErrorRow], folder: Path, comm: MPI.Comm
) -> None:
    """Write `convergence.csv`, `convergence.png` and `summary.json` of a study (collective)."""

    def write() -> None:
        from signorini_fenicsx.output import pictures

        write_rows(folder / "convergence.csv", rows[0].columns(), [row.columns() for row in rows])
        against = {
            Vary.H: f"{case.solve.algorithm}, h = 2^-{reference}",
            Vary.EPS: "alg1 on the same mesh",
        }.get(vary, f"alg1, h = 2^-{reference}")
        title = f"{case.name}, {case.solve.algorithm}, against {against}"
        pictures.draw_errors(folder / "convergence.png", rows, vary, title)
        summary = {
            "case": case.name,
            "algorithm": case.solve.algorithm,
            "vary": vary.value,
            "reference": against,
            "rows": [row.columns() for row in rows],
            "slopes": fitted_slopes(rows, vary),
            "ranks": comm.size,
        }
        write_summary(folder, summary)

    on_root(comm, write)


def write_adapt(solution: Solved, rows: list[AdaptRow], folder: Path) -> None:
    """Write `adapt.csv`, `adapt.png` and `mesh.png` of an adaptive run that ended with this solution (collective)."""
    from signorini_fenicsx.output import pictures  # takes a second to import

    scene = pictures.gathered_scene(solution)

    def write() -> None:
        write_table(folder / "adapt.csv", type(rows[0]), rows)
        pictures.draw_bounds(folder / "adapt.png", rows, solution.best_rate, solution.name)
        if scene is not None:
            pictures.draw_mesh(folder / "mesh.png", scene)

    on_root(solution.spaces.mesh.comm, write)


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """Write `summary.json`, with versions and the command (rank 0)."""
    summary = summary | {"versions": versions(), "command": shlex.join(sys.argv)}
    (folder / "summary.json").write_text(json_text(summary) + "\n", encoding="utf-8")
