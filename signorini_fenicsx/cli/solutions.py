"""Commands that compute solutions or write them again: solve, adapt, export."""

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, LaterFailure, NumericalFailure
from signorini_fenicsx.base.exchange import complete
from signorini_fenicsx.base.extras import check_installed
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.results import ResultsFolder
from signorini_fenicsx.base.signals import end_if_told
from signorini_fenicsx.cli import options as option
from signorini_fenicsx.cli.common import any_case, failure_kept, keep_beside, refuse_idle, results_place

if TYPE_CHECKING:
    from typing import TypeGuard

    from signorini_fenicsx.cases.case import CaseFile
    from signorini_fenicsx.certificate.certificate import Certificate
    from signorini_fenicsx.certificate.proof import Proof
    from signorini_fenicsx.physics.diffusion.case import Case
    from signorini_fenicsx.quantities import Quantity
    from signorini_fenicsx.solving.solved import Solved

MIN_THETA = 1e-3


@option.of_case
def solve(
    case: option.CaseName,
    predict: option.Predict = True,
    start_from: option.StartFrom = None,
    rigorous: option.Rigorous = False,
    for_signorini: option.ForSignorini = False,
    restart: option.Restart = False,
    certify_steps: option.CertifySteps = False,
    output: option.OutputFolder = None,
    plot: option.Plot = False,
    html: option.Html = False,
    quiet: option.Quiet = False,
    verbose: option.Verbose = False,
    as_json: option.Json = False,
    **new: Any,
) -> None:
    """Solve a case and write its results, by default into results/<case>/.

    Examples:
      signorini solve example1 --plot
      signorini solve dam --algorithm alg2 --output results/seepage
      signorini solve my-case.toml --h 1/64 --set 'boundary.signorini=["bottom"]' --rigorous
      mpirun -n 2 signorini solve example2 --h 2^-7 -- -ksp_view
      signorini solve membrane --certify-steps --plot
    """
    from signorini_fenicsx.cases.solving import quantities_of, shared_domain, solve_case
    from signorini_fenicsx.certificate.certify import certify
    from signorini_fenicsx.cli.solution_report import SolutionReport
    from signorini_fenicsx.output.checkpoint import load_solution
    from signorini_fenicsx.output.writing import Found, SolutionFiles

    said = {"quiet": quiet, "verbose": verbose, "as_json": as_json}
    comm, report = MPI.COMM_WORLD, SolutionReport(**said)
    problem = any_case(comm, case, **new, predict=None if predict else False)
    only_steady = {"--rigorous": rigorous, "--html": html, "--for-signorini": for_signorini}
    _refuse_lacking(problem, only_steady)
    if _is_in_time(problem, only_steady, {"--restart": restart, "--certify-steps": certify_steps}):
        from signorini_fenicsx.cli.evolving import EvolutionReport, solve_in_time

        kept = {"restart": restart, "certify_steps": certify_steps}
        solve_in_time(problem, comm, EvolutionReport(**said), output, start_from, **kept, plot=plot)
        return
    if rigorous:
        on_root(comm, lambda: _check_provable(problem))
    with ResultsFolder(comm, results_place(output, problem.name)) as folder:
        report.begin(problem, comm)
        with failure_kept(folder, plot=plot, html=html):
            start = None if start_from is None else load_solution(start_from, comm)
            solution = solve_case(
                problem, comm, domain=shared_domain(start, problem), start=start, on_step=report.followed(comm)
            )
        files = SolutionFiles(solution).publish(folder)
        certificate = folder.attempt("error bound", lambda: certify(solution, for_signorini=for_signorini or rigorous))
        proof = folder.attempt("proof", lambda: _proof(solution, certificate)) if rigorous else None
        quantities = folder.attempt("quantities", lambda: quantities_of(solution))
        found = Found(certificate=certificate, proof=proof, quantities=quantities)
        files.publish_others(folder, found, plot=plot, html=html)
        report.solution(solution, found)
        report.published(folder.target)
        if proof is not None and proof.proven is None:
            raise NumericalFailure(f"the bound is not proved: {proof.reason}")


def _proof(solution: Any, certificate: "Certificate | None") -> "Proof | None":
    """The proof of a bound, whose library takes a second to load; None without a bound (collective)."""
    from signorini_fenicsx.certificate.proof import proof_of

    return None if certificate is None else proof_of(solution, certificate.v)


def _is_in_time(
    problem: "CaseFile", only_steady: Mapping[str, object], only_in_time: Mapping[str, object]
) -> "TypeGuard[Case]":
    """Whether a case has [time].

    Raises:
        InputError: If an option is given that it does not have.
    """
    in_time = getattr(problem, "time", None) is not None
    for name, value in (only_steady if in_time else only_in_time).items():
        if value:
            raise InputError(
                f"{name}: {problem.name} has {'a' if in_time else 'no'} section [time], so this does not apply"
            )
    return in_time


def _refuse_lacking(about: "CaseFile | Solved", options: Mapping[str, object]) -> None:
    """Refuse options that a method does not have, or a small installation.

    Raises:
        InputError: If one is given.
    """
    for name in [name for name, value in options.items() if value]:
        if name == "--for-signorini" and not about.method.penalty:
            raise InputError(f"{name}: there is no such option for {about.approach}")
        check_installed(name)


def _check_provable(case: "CaseFile") -> None:
    """Refuse a case whose bound cannot be proved (rank 0).

    Raises:
        InputError: If its mesh is too large, or if there is no theorem for the problem.
    """
    from signorini_fenicsx.cases.domains import rough_cells
    from signorini_fenicsx.certificate.proof import check_size

    check_size(rough_cells(case), case.PHYSICS)
    if case.unproved:
        raise InputError(f"--rigorous: {case.unproved}")


@option.of_case
def adapt(
    case: option.CaseName,
    target: Annotated[
        str | None, typer.Option("--target", help="Relative certified error to reach, such as 1e-2.")
    ] = None,
    max_cells: Annotated[int | None, typer.Option("--max-cells", help="Most cells of a mesh; default 10^6.")] = None,
    quantity: Annotated[
        str | None, typer.Option("--quantity", help="Refine for this quantity of the case, with --width.")
    ] = None,
    width: Annotated[str | None, typer.Option("--width", help="Length of its interval to reach.")] = None,
    theta: Annotated[str, typer.Option("--theta", help="Share of the squared error to refine; 1 is uniform.")] = "0.5",
    uniform: Annotated[bool, typer.Option("--uniform", help="Refine uniformly as well, for comparison.")] = False,
    h: Annotated[str | None, typer.Option("--h", help="h of the first mesh; default 1/8 of the diameter.")] = None,
    output: option.OutputFolder = None,
    plot: option.Plot = False,
    html: option.Html = False,
    quiet: option.Quiet = False,
    as_json: option.Json = False,
    **new: Any,
) -> None:
    """Refine where the certified error is large until it is small; write results/<case>-adapt/.

    Examples:
      signorini adapt example5 --target 1e-2
      signorini adapt lprism --max-cells 50000 --uniform
      signorini adapt my-case.toml --quantity discharge --width 0.01
    """
    from signorini_fenicsx.cases.solving import adapt_case, check_named
    from signorini_fenicsx.cli.adapt_report import AdaptReport
    from signorini_fenicsx.output.writing import Found, SolutionFiles, write_adapt

    comm, report = MPI.COMM_WORLD, AdaptReport(quiet=quiet, as_json=as_json)
    error, share, length, cells = _checked(target, max_cells, theta, quantity, width)
    problem = on_root(comm, lambda: _on_first_mesh(case, new | {"h": h}))
    _refuse_lacking(problem, {"--html": html})
    check_named(problem, quantity)
    end: Any = {"target": error, "max_cells": cells, "width": length, "on_step": lambda _: end_if_told(comm)}
    refined = partial(adapt_case, problem, comm, **end, by=quantity, on_row=report.mesh, on_note=report.line)
    with ResultsFolder(comm, results_place(output, f"{problem.name}-adapt")) as folder:
        report.heading(problem, comm)
        report.columns(error, cells, {} if quantity is None else {quantity: length}, problem)
        with failure_kept(folder, plot=plot, html=html):
            solution, certificate, later = _so_far(partial(refined, theta=share))
        quantities = {} if certificate is None or not report.rows else report.rows[-1].quantities
        measured = {name: each for name, each in quantities.items() if name == quantity}
        missed = "" if later else _missed(certificate, error, measured, length)
        table = partial(write_adapt, report.rows, comm)
        files = SolutionFiles(solution).publish(folder, failed=bool(missed), others={"adapt.csv": table})
        if uniform and later is None:
            folder.attempt("uniform refinement", lambda: refined(theta=1.0))
            folder.attempt("adapt.csv", partial(table, folder.path))
        files.publish_others(folder, Found(certificate=certificate, quantities=quantities), plot=plot, html=html)
        folder.attempt("pictures of the refinement", partial(files.refinement, report.rows, folder.path))
        if missed:
            raise NumericalFailure(f"{missed}, with the largest mesh of at most {cells} cells; {folder.last_state()}")
        if later is not None:
            keep_beside(folder, later)
        report.adapted(solution.best_rate, certificate, quantities)
        report.published(folder.target)


def _so_far(refined: "Callable[[], tuple[Solved, Certificate]]") -> tuple[Any, Any, LaterFailure | None]:
    """The last solution of an adaptive run, its bound or None, and what failed after it or None (collective)."""
    try:
        return *refined(), None
    except LaterFailure as failure:
        return failure.solution, failure.certificate, failure


def _missed(
    certificate: "Certificate", target: float | None, quantities: "Mapping[str, Quantity]", width: float | None
) -> str:
    """How far a run was from its targets when it ended, in words; empty if it has reached one, or has none."""
    reached = [] if target is None else [("relative error", certificate.relative, target)]
    reached += [(f"length of {name}", each.width, width or 0.0) for name, each in quantities.items()]
    if any(value <= limit for _, value, limit in reached):
        return ""
    return ", ".join(f"{what} ≤ {value:.3g}, not {limit:g}" for what, value, limit in reached)


def _checked(
    target: str | None, max_cells: int | None, theta: str, quantity: str | None, width: str | None
) -> tuple[float | None, float, float | None, int]:
    """The relative error to reach, the share of the error to refine, the length of an interval to reach, most cells.

    Raises:
        InputError: If one of the options of `adapt` is not valid, or none of them defines the end.
    """
    from signorini_fenicsx.certificate.adaptive import DEFAULT_MAX_CELLS

    if (quantity is None) is not (width is None):
        raise InputError("adapt: --quantity and --width, the length of its interval to reach, belong together")
    if target is None and max_cells is None and width is None:
        raise InputError("adapt: give --target, the relative error to reach, --max-cells, or --quantity with --width")
    error = None if target is None else option.positive("--target", target)
    share = option.positive("--theta", theta)
    if not MIN_THETA <= share <= 1:
        raise InputError(f"--theta {theta}: must be between {MIN_THETA:g}, which refines hardly anything, and 1")
    if max_cells is not None and max_cells < 1:
        raise InputError(f"--max-cells {max_cells}: must be at least 1")
    length = None if width is None else option.positive("--width", width)
    return error, share, length, max_cells or DEFAULT_MAX_CELLS


def _on_first_mesh(name: str, new: Mapping[str, Any]) -> "CaseFile":
    """A case with its new values; on a named shape without a value of h, with h of the first mesh (rank 0).

    Raises:
        InputError: If it is not valid, or its method does not have one of these options.
    """
    from signorini_fenicsx.cases.case import load_case
    from signorini_fenicsx.certificate.adaptive import FIRST_MESH
    from signorini_fenicsx.meshes.shapes import shape_of

    case, values = load_case(name), option.overrides(**new)
    shape = case.with_values(values).geometry.shape
    first = {} if shape is None else {"solve.h": shape_of(shape).diameter / FIRST_MESH}
    problem = case.with_values(first | values)
    refuse_idle(problem, **new)
    return problem


def export(
    results: Annotated[Path, typer.Argument(help="Results folder of an earlier run, or of a run of a study.")],
    for_signorini: option.ForSignorini = False,
    output: option.OutputFolder = None,
    plot: option.Plot = False,
    html: option.Html = False,
    quiet: option.Quiet = False,
    as_json: option.Json = False,
) -> None:
    """Write fields, tables and pictures of an earlier solution again without solving, by default into its folder.

    Of a run in time it is the last step, and needs another folder.

    Examples:
      mpirun -n 2 signorini export results/example2 --plot
      signorini export results/membrane --output results/membrane-end --plot
    """
    from signorini_fenicsx.certificate.certify import certify
    from signorini_fenicsx.cli.case_report import CaseReport
    from signorini_fenicsx.output.checkpoint import load_solution
    from signorini_fenicsx.output.writing import Found, SolutionFiles

    comm, report = MPI.COMM_WORLD, CaseReport(quiet=quiet, as_json=as_json)
    own = os.path.realpath(output or results) == os.path.realpath(results)
    if own:
        on_root(comm, lambda: complete(results))
    solution = load_solution(results, comm)
    _refuse_lacking(solution, {"--html": html, "--for-signorini": for_signorini})
    is_step = solution.step is not None
    if is_step and own and (results / "steps.csv").is_file():
        raise InputError(f"{results}: is a run in time, whose last step would replace it; give --output")
    with ResultsFolder(comm, output or results) as folder:
        report.heading(solution, comm)
        files, certificate = SolutionFiles(solution).publish(folder, add=own), None
        if solution.converged and not is_step:  # the bound of a step needs the steps before
            certificate = folder.attempt("error bound", lambda: certify(solution, for_signorini=for_signorini))
        files.publish_others(folder, Found(certificate=certificate), plot=plot, html=html)
        report.published(folder.target)
