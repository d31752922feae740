"""The files of a solution: summary and tables as text, fields for ParaView."""

import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

from mpi4py import MPI

from signorini_fenicsx.base.errors import check_kind
from signorini_fenicsx.base.owned import owned_values
from signorini_fenicsx.base.parallel import Stopwatch, collector_off, on_root
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.base.results import ResultsFolder
from signorini_fenicsx.base.text import json_text, write_rows, write_table
from signorini_fenicsx.base.versions import versions
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.units import summary_of, units_of
from signorini_fenicsx.certificate.adaptive import AdaptRow
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.certificate.certify import FieldBound
from signorini_fenicsx.certificate.proof import Proof
from signorini_fenicsx.comparing.convergence import ErrorRow, Vary, fitted_slopes
from signorini_fenicsx.contact.history import Step
from signorini_fenicsx.output.checkpoint import write_checkpoint
from signorini_fenicsx.output.field_files import write_fields
from signorini_fenicsx.output.latex import write_latex
from signorini_fenicsx.output.outlines import write_readings
from signorini_fenicsx.output.tables import write_sites
from signorini_fenicsx.quantities import Quantity
from signorini_fenicsx.solving.fields import IN_CELLS, Field
from signorini_fenicsx.solving.solved import Solved

type Write = Callable[[Path], None]
"""Writes files into a folder."""
NONE: Mapping[str, Write] = MappingProxyType({})


@dataclass(frozen=True, kw_only=True)
class Found:
    """What is known of a solution beside itself.

    Attributes:
        certificate: Its error bound, or None.
        proof: The result of the attempt to prove the bound, or None.
        quantities: Intervals of quantities by their names, or None.
        of_field: How wrong a function of the user is, or None.
    """

    certificate: Certificate | None = None
    proof: Proof | None = None
    quantities: Mapping[str, Quantity] | None = None
    of_field: FieldBound | None = None

    def added_to(self, summary: dict[str, Any]) -> dict[str, Any]:
        """The summary of the solution with what is known (collective)."""
        certificate = self.certificate
        if certificate is not None:
            about = certificate.summary() | ({} if self.proof is None else self.proof.summary())
            timings = summary["timings"] | {"certificate": certificate.seconds}
            summary = summary | {"certificate": about, "timings": timings}
        summary = with_quantities(summary, self.quantities or {})
        return summary if self.of_field is None else summary | {"field": self.of_field.summary()}


class SolutionFiles:
    """What writes the files of a solution into folders. Its methods are collective.

    Each of them raises an OSError on all ranks if the disk is full, and a `WriteFailure` if a library cannot write, at
    least on this rank.
    """

    def __init__(self, solution: Solved):
        """Keep what is to be written; nothing on disk changes."""
        self._solution, self._comm, self.found = solution, solution.spaces.mesh.comm, Found()
        self._watch = Stopwatch()

    def publish(
        self, results: ResultsFolder, *, add: bool = False, failed: bool = False, others: Mapping[str, Write] = NONE
    ) -> Self:
        """Publish the solution: its checkpoint, and with it tables and summary, see `ResultsFolder`.

        Args:
            results: The folder.
            add: Keep earlier results with other names.
            failed: Keep it as that of a failed run.
            others: Further tables, what they are and what writes them into a folder.

        Returns:
            This object.
        """
        self.checkpoint(results.path)
        for what, write in {"tables": self.tables, "summary": self.summary, **others}.items():
            results.attempt(what, partial(write, results.path))
        results.keep_failed() if failed else results.publish(add=add)
        return self

    def publish_others(
        self, results: ResultsFolder, found: Found, *, plot: bool = False, html: bool = False, fields: bool = True
    ) -> None:
        """Add what is known beside the solution, and pictures and fields, for which no solution may be lost.

        Args:
            results: The folder, in which the solution is published.
            found: What is known.
            plot: Also draw PNGs, of a large mesh by a sample of its cells, see `Sample`.
            html: Also write `solution.html`, pictures that the mouse can turn; likewise.
            fields: Also write the fields for ParaView.
        """
        self.found = found
        wanted = {"pictures": self.pictures, "solution.html": self.page, "fields": self.fields}
        chosen = [what for what, given in zip(wanted, (plot, html, fields), strict=True) if given]
        for what in ["summary", *chosen, "summary"]:
            results.attempt(what, partial(wanted.get(what, self.summary), results.path))

    def checkpoint(self, folder: Path) -> None:
        """Write the solution itself."""
        with self._watch.phase("output"):
            write_checkpoint(folder, self._solution)

    def tables(self, folder: Path) -> None:
        """Write the tables of sites, of iterations, and others that the physics has."""
        with self._watch.phase("output"):
            solution, table = self._solution, self._solution.table()
            number, whole = solution.spaces.Lambda.dofmap.index_map.size_global, table.gathered(self._comm)
            many = number > solution.options.tuning.one_table_up_to
            on_root(
                self._comm,
                lambda: write_sites(folder / table.name, iter([solution.columns(whole)]), many=many),
            )
            for name, columns in (self._solution.other_tables() | self._solution.readings).items():
                on_root(self._comm, partial(write_readings, folder, name, [(None, columns)], self._units))
            history = self._solution.outcome.history
            on_root(self._comm, lambda: write_table(folder / "history.csv", Step, history))

    def summary(self, folder: Path) -> None:
        """Write `summary.json`."""
        with self._watch.phase("output"):
            summary = self.found.added_to(self._about)
        timings = summary["timings"] | self._watch.longest(self._comm)
        on_root(self._comm, lambda: write_summary(folder, summary | {"timings": timings}))

    def pictures(self, folder: Path) -> None:
        """Draw PNGs."""
        self._draw(lambda drawing, scene: drawing.draw_all(folder, scene))
        if self.found.of_field is not None:
            self._draw(lambda drawing, scene: drawing.draw_field(folder / "field.png", scene), self.found.of_field)

    def page(self, folder: Path) -> None:
        """Write `solution.html`."""
        self._draw(lambda drawing, scene: drawing.write_page(folder / "solution.html", scene))

    def fields(self, folder: Path) -> None:
        """Write the fields for ParaView."""
        with self._watch.phase("output"):
            of_files = dict(self._solution.fields())
            bounds = [each for each in (self.found.certificate, self.found.of_field) if each is not None]
            indicators = [Field(each.indicator.name, owned_values(each.indicator)) for each in bounds]
            of_files[IN_CELLS] = [*of_files[IN_CELLS], *indicators]
            write_fields(folder, self._solution.spaces, [(None, of_files)], 1)

    def refinement(self, rows: Sequence[AdaptRow], folder: Path) -> None:
        """Draw `adapt.png` and `mesh.png` of an adaptive run with rows that ended with the solution."""
        from signorini_fenicsx.output.curves import draw_bounds  # takes a second to import

        def drawn(drawing: Any, scene: Any) -> None:
            draw_bounds(folder / "adapt.png", rows, self._solution.best_rate, self._solution.name)
            drawing.draw_mesh(folder / "mesh.png", scene)

        if rows:
            self._draw(drawn)

    def _draw(self, drawn: Callable[[Any, Any], None], of_field: FieldBound | None = None) -> None:
        """Draw the scene of the solution, or of how wrong a function is, on rank 0."""
        from signorini_fenicsx.pictures import drawing  # takes a second to import
        from signorini_fenicsx.pictures.scene import gathered_scene

        with self._watch.phase("output"), doing("drawing"):
            scene = self._scene if of_field is None else gathered_scene(of_field.solution, indicator=of_field.indicator)
            on_root(self._comm, lambda: None if scene is None else drawn(drawing, scene))

    @cached_property
    def _scene(self) -> Any:
        """The scene of the solution on rank 0; None elsewhere."""
        from signorini_fenicsx.pictures.scene import gathered_scene

        return gathered_scene(self._solution, self.found.certificate)

    @cached_property
    def _about(self) -> dict[str, Any]:
        """The summary of the solution itself."""
        return summary_of(self._solution)

    @cached_property
    def _units(self) -> dict[str, str]:
        """The units of what is read off."""
        return units_of(self._solution)


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
    """Write the files of a solution into a results folder, see `ResultsFolder` (collective).

    Args:
        solution: The solution.
        folder: The folder; it is made if it does not exist, and an earlier result in it is replaced.
        certificate: Its error bound, or None.
        proof: The result of the attempt to prove the bound, or None.
        quantities: Intervals of quantities by their names, or None.
        of_field: How wrong a function of the user is, or None.
        plot: Also draw PNGs, of a large mesh by a sample of its cells, see `Sample`.
        html: Also write `solution.html`, pictures that the mouse can turn; likewise.
        fields: Also write the fields for ParaView.

    Raises:
        InputError: If this cannot be a results folder.
        OSError: On all ranks, if the disk is full.
        LaterFailure: If the solution is written, but not all files that come after it.
    """
    check_kind("solution", solution, Solved)
    check_kind("folder", folder, str, Path)
    found = Found(certificate=certificate, proof=proof, quantities=quantities, of_field=of_field)
    with ResultsFolder(solution.spaces.mesh.comm, folder) as place:
        SolutionFiles(solution).publish(place).publish_others(place, found, plot=plot, html=html, fields=fields)


def with_quantities(summary: dict[str, Any], quantities: Mapping[str, Quantity]) -> dict[str, Any]:
    """A summary with the intervals for quantities, by their names, in its section for quantities."""
    if not quantities:
        return summary
    summaries = {name: each.summary() for name, each in quantities.items()}
    return summary | {"quantities": summary.get("quantities", {}) | summaries}


def publish_convergence(
    case: CaseFile, vary: Vary, reference: int, rows: list[ErrorRow], results: ResultsFolder, comm: MPI.Comm
) -> None:
    """Publish `convergence.csv`, `convergence.tex` and `summary.json` of a study, then its picture (collective)."""
    against = {
        Vary.H: f"{case.solve.algorithm}, h = 2^-{reference}",
        Vary.EPS: "alg1 on the same mesh",
    }.get(vary, f"alg1, h = 2^-{reference}")

    def write() -> None:
        write_rows(results.path / "convergence.csv", rows[0].columns(), [row.columns() for row in rows])
        write_latex(results.path / "convergence.tex", rows)
        summary = {
            "case": case.name,
            "algorithm": case.solve.algorithm,
            "vary": vary.value,
            "reference": against,
            "rows": [row.columns() for row in rows],
            "slopes": fitted_slopes(rows, vary),
            "ranks": comm.size,
        }
        write_summary(results.path, summary)

    def draw() -> None:
        from signorini_fenicsx.output.curves import draw_errors  # takes a second to import

        title = f"{case.name}, {case.solve.algorithm}, against {against}"
        draw_errors(results.path / "convergence.png", rows, vary, title)

    on_root(comm, write)
    results.publish()
    results.attempt("picture", lambda: on_root(comm, draw))


def write_adapt(rows: list[AdaptRow], comm: MPI.Comm, folder: Path) -> None:
    """Write `adapt.csv` of an adaptive run, if there is a row (collective)."""
    if rows:
        tables = [row.columns() for row in rows]
        on_root(comm, lambda: write_rows(folder / "adapt.csv", tables[0], tables))


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """Write `summary.json`, with versions and the command (rank 0)."""
    summary = summary | {"versions": versions(), "command": shlex.join(sys.argv)}
    (folder / "summary.json").write_text(json_text(summary) + "\n", encoding="utf-8")
