"""The results of a run in time as files: tables of all steps, the fields as one series, pictures."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.base.results import ResultsFolder
from signorini_fenicsx.base.text import write_rows
from signorini_fenicsx.cases.units import summary_of, units_of
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.discrete.site_table import SiteTable
from signorini_fenicsx.output.checkpoint import write_checkpoint
from signorini_fenicsx.output.field_files import write_fields
from signorini_fenicsx.output.outlines import write_readings
from signorini_fenicsx.output.steps import OPPOSITE, Row, StepFolder
from signorini_fenicsx.output.tables import write_sites
from signorini_fenicsx.output.writing import with_quantities, write_summary
from signorini_fenicsx.pictures.gather import sample_of
from signorini_fenicsx.quantities import Quantity
from signorini_fenicsx.solving.evolving import Instant
from signorini_fenicsx.solving.physics import PHYSICS
from signorini_fenicsx.solving.solved import Columns, Solved

BOUNDS = ("bound", "sigma_bound", "gap", "oscillation", "relative")
UNBOUNDED = {**dict.fromkeys(BOUNDS, math.inf), "guaranteed": False, "relies_on": "", "bound_is": ""}
"""What a row has in the place of a bound that could not be found."""


def row_of(
    instant: Instant, certificate: Certificate | None, quantities: Mapping[str, Quantity], seconds: float
) -> dict[str, Any]:
    """The numbers of a step, with intervals by the names of quantities (collective)."""
    solution = instant.solution
    facets, measure = solution.contact
    history = solution.outcome.history
    bounds = {} if certificate is None else {name: certificate.numbers()[name] for name in BOUNDS}
    trust = {}
    if certificate is not None:
        guaranteed, to = certificate.summary()["guaranteed"], f"to {certificate.of}" if certificate.of else ""
        trust = {"guaranteed": guaranteed, "relies_on": _relies_on(certificate), "bound_is": to}
    return {
        "step": instant.step,
        "t": instant.t,
        "contact_facets": facets,
        "contact_measure": measure,
        **solution.of_step(),
        **instant.numbers,
        "iterations": len(history),
        "linear_iterations": sum(step.linear_iterations for step in history),
        "kkt": max(vars(solution.kkt).values()),
        **(solution.errors() or {}),
        **bounds,
        **trust,
        **{key: value for name, quantity in quantities.items() for key, value in quantity.columns(name).items()},
        "seconds": seconds,
    }


def _relies_on(certificate: Certificate) -> str:
    """The data that a bound knows in the points of quadratures only, or does not resolve."""
    unresolved = (name for name, _ in certificate.unresolved)
    return ", ".join(dict.fromkeys([*certificate.by_quadrature, *unresolved]))


def write_evolution(
    results: ResultsFolder, steps: StepFolder, last: Instant, quantities: Mapping[str, Quantity], *, plot: bool
) -> None:
    """Publish the results of a run in time, then add the fields of all steps, and pictures (collective).

    Args:
        results: The folder.
        steps: All steps.
        last: The last of them.
        quantities: The intervals for its quantities, by their names.
        plot: Also draw pictures.

    Raises:
        InputError: If the steps cannot be read.
        OSError: On all ranks, if the disk is full.
    """
    solution, rows = last.solution, steps.rows()
    comm, kind, opposite = solution.spaces.mesh.comm, type(solution.table()), solution.opposite
    many = len(rows) * solution.spaces.Lambda.dofmap.index_map.size_global > solution.options.tuning.one_table_up_to
    times = [row["t"] for row in rows]

    def tables() -> None:
        write_rows(results.path / "steps.csv", dict.fromkeys(key for row in rows for key in row), rows)
        sites = (_at(row, solution.columns(steps.table(row["step"], kind))) for row in rows)
        write_sites(results.path / kind.name, sites, many=many)
        if opposite is not None:
            of = type(opposite.table)
            sites = (_at(row, opposite.columns(steps.table(row["step"], of, OPPOSITE))) for row in rows)
            write_sites(results.path / of.name, sites, many=many)
        units = units_of(solution)
        for name in solution.readings:
            write_readings(results.path, name, [(row["t"], steps.readings(row, name)) for row in rows], units)

    def write() -> None:
        fields = solution.fields()
        series = ((t, steps.fields(solution.spaces, step, fields)) for step, t in enumerate(times, start=1))
        write_fields(results.path, solution.spaces, series, len(times))

    def draw() -> None:
        with doing("drawing"):
            _draw(results.path, steps, rows, times, solution, kind)

    def summarise() -> None:
        summary = with_quantities(summary_of(solution), quantities)
        on_root(comm, lambda: write_summary(results.path, summary | _along(rows)))

    write_checkpoint(results.path, solution)
    results.attempt("tables", lambda: on_root(comm, tables))
    results.attempt("summary", summarise)
    results.publish()
    results.attempt("fields", write)
    if plot:
        results.attempt("pictures", draw)


def _along(rows: Sequence[Row]) -> dict[str, Any]:
    """What a summary has for all steps together."""
    errors = [name for name in rows[0] if name.endswith("_L2")]
    bounds = [name for name in ("bound", "sigma_bound") if name in rows[0]]
    largest = {name: max(row[name] for row in rows) for name in ("kkt", *errors, *bounds)}
    iterations = sum(row["iterations"] for row in rows)
    guaranteed: dict[str, Any] = {"guaranteed": all(row["guaranteed"] for row in rows)} if bounds else {}
    if bounds:
        names = (name for row in rows for name in row.get("relies_on", "").split(", ") if name)
        guaranteed["relies_on"] = ", ".join(dict.fromkeys(names))
        guaranteed["bound_is"] = rows[-1].get("bound_is", "")
    end = {"steps": len(rows), "end": rows[-1]["t"], "seconds": sum(row["seconds"] for row in rows)}
    return {"iterations": iterations, "time": end | {"largest": largest | guaranteed}}


def _at(row: Row, table: Columns) -> Columns:
    """A table of sites after the step with this row, with step and time in front."""
    length = len(next(iter(table.values())))
    return {**{key: np.full(length, row[key]) for key in ("step", "t")}, **table}


def _draw(
    folder: Path,
    steps: StepFolder,
    rows: Sequence[Row],
    times: Sequence[float],
    solution: Solved,
    kind: type[SiteTable],
) -> None:
    """Draw the pictures over time, with what the physics wants of the fields that the steps kept (collective)."""
    from signorini_fenicsx.pictures import drawing  # takes a second to import
    from signorini_fenicsx.pictures.panels import DrawnSteps
    from signorini_fenicsx.pictures.scene import gathered_scene

    spaces, comm = solution.spaces, solution.spaces.mesh.comm
    sample = sample_of(spaces)
    scene = gathered_scene(solution, sample=sample)
    wanted = PHYSICS[solution.physics].pictures.kept(solution, len(times))
    kept = {key: {step: sample.in_cells(steps.kept(spaces, step, key)) for step in of} for key, of in wanted.items()}

    def write() -> None:
        if scene is not None:
            tables = [steps.table(step, kind) for step in range(1, len(times) + 1)]
            of = [type(each.table) for each in scene.surfaces[1:]]
            others = [steps.table(step, each, OPPOSITE) for each in of for step in range(1, len(times) + 1)]
            readings = {name: [steps.readings(row, name) for row in rows] for name in solution.readings}
            drawing.draw_steps(folder, scene, DrawnSteps(times, tables, rows, kept, readings, others))

    on_root(comm, write)
