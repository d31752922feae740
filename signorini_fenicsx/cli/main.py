"""The command `signorini`. PETSc options go after `--`: `signorini solve example1 -- -ksp_monitor`."""

import errno
import gc
import io
import itertools
import math
import os
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import petsc4py
import typer
from mpi4py import MPI
from rich.console import Console

from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import FORWARDING, abort_all_on_exception, end_all, on_root, refuse_lone_copies
from signorini_fenicsx.base.shipped import case_names, study_names
from signorini_fenicsx.base.signals import Interruption, listen_again, listening, outlive_readers

if TYPE_CHECKING:
    from signorini_fenicsx.cases.case import Case
    from signorini_fenicsx.methods.history import Step

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
MAX_LEVEL = 30
MIN_THETA = 1e-3
MAX_WORDS = 800, 200
"""Characters of a message that are shown, at its begin and at its end."""

app = typer.Typer(
    help="Fully mixed methods for the Signorini problem. PETSc options go after --.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _names_of_algorithms() -> list[str]:
    from signorini_fenicsx.methods.registry import METHODS

    return list(METHODS)


CaseName = Annotated[
    str,
    typer.Argument(
        help="Name of a shipped case (example1 … example6) or path of a .toml file.", autocompletion=case_names
    ),
]
AlgorithmName = Annotated[
    str | None,
    typer.Option(
        "--algorithm", help="One of those that `signorini methods` lists.", autocompletion=_names_of_algorithms
    ),
]
MeshSize = Annotated[str | None, typer.Option("--h", help="Largest cell diameter: 0.0625, 1/16 or 2^-4.")]
Rho = Annotated[str | None, typer.Option("--rho", help="ρ > 0 of the set rule or the Uzawa iteration.")]
Epsilon = Annotated[str | None, typer.Option("--eps", help="ε of the penalty and stabilised methods.")]
BackendName = Annotated[str | None, typer.Option("--backend", help="hybrid or mixed; of alg1 to alg4 only.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Any other key of the case, e.g. geometry.mesh=structured."),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, the summary, and nothing else.")]
Html = Annotated[bool, typer.Option("--html", help="Also write solution.html, pictures that the mouse turns.")]
OutputFolder = Annotated[Path | None, typer.Option("--output", help="Folder for the results.", show_default=False)]


def _overrides(settings: list[str] | None, **options: str | None) -> dict[str, object]:
    values: dict[str, object] = {}
    for setting in settings or []:
        key, separator, value = setting.partition("=")
        if not separator or not key:
            raise InputError(f"--set {setting}: must be KEY=VALUE, such as geometry.mesh=structured")
        values[key] = _toml_value(value)
    return values | {f"solve.{name}": value for name, value in options.items() if value is not None}


def _toml_value(text: str) -> object:
    """A value as TOML writes it, such as ["top", "left"], or else the text itself."""
    try:
        tree = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return tree["value"] if len(tree) == 1 else text


@app.command()
def solve(
    case: CaseName,
    algorithm: AlgorithmName = None,
    h: MeshSize = None,
    rho: Rho = None,
    eps: Epsilon = None,
    backend: BackendName = None,
    predict: Annotated[bool, typer.Option(help="Start large problems from a coarser mesh's sets.")] = True,
    settings: Settings = None,
    start_from: Annotated[
        Path | None, typer.Option("--start-from", help="Results folder whose contact set is the first one.")
    ] = None,
    rigorous: Annotated[
        bool, typer.Option("--rigorous", help="Also prove the error bound, rounding included.")
    ] = False,
    output: OutputFolder = None,
    plot: Annotated[bool, typer.Option("--plot", help="Also draw pictures (PNG).")] = False,
    html: Html = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    r"""Solve a case and write its results, by default into results/<case>/.

    \b
    Examples:
      signorini solve example1 --plot
      signorini solve dam --algorithm alg2 --output results/seepage
      signorini solve my-case.toml --h 1/64 --set 'boundary.signorini=["bottom"]' --rigorous
      mpirun -n 2 signorini solve example2 --h 2^-7 -- -ksp_view
    """
    from signorini_fenicsx.base.results import ResultsFolder
    from signorini_fenicsx.base.signals import end_if_told
    from signorini_fenicsx.cases.case import load_case
    from signorini_fenicsx.cases.domains import rough_cells
    from signorini_fenicsx.cases.solving import shared_domain, solve_case
    from signorini_fenicsx.certificate.certify import certify
    from signorini_fenicsx.cli import report
    from signorini_fenicsx.output.checkpoint import load_solution
    from signorini_fenicsx.output.writing import write_solution
    from signorini_fenicsx.rigorous.proof import check_size, proof_of

    comm = MPI.COMM_WORLD
    report.console.quiet = quiet or as_json
    values = _overrides(settings, algorithm=algorithm, h=h, rho=rho, eps=eps, backend=backend)
    cold = {} if predict else {"solve.predict": False}

    def on_step(row: "Step") -> None:
        report.step(row)
        end_if_told(comm)

    problem = on_root(comm, lambda: load_case(case).with_values(values | cold))
    if rigorous:
        on_root(comm, lambda: check_size(rough_cells(problem)))
    with ResultsFolder(comm, output or Path("results", problem.name)) as folder:
        report.heading(problem, comm)
        report.iteration_heading(problem)
        try:
            start = None if start_from is None else load_solution(start_from, comm)
            domain = None if start is None else shared_domain(start, problem)
            solution = solve_case(problem, comm, domain=domain, start=start, on_step=on_step)
        except NumericalFailure as failure:
            if failure.solution is not None:
                write_solution(failure.solution, folder.path, plot=plot, html=html)
                failure.args = (f"{failure}; the last state is in {folder.keep_failed()}",)
            raise
        certificate = certify(solution)
        proof = proof_of(solution, certificate.v) if rigorous else None
        write_solution(solution, folder.path, certificate=certificate, proof=proof, plot=plot, html=html)
        folder.publish()
        report.solution(solution, folder.target, certificate, proof)
        if as_json:
            report.summary(folder.target)
        if proof is not None and proof.proven is None:
            raise NumericalFailure(f"the bound is not proved: {proof.reason}; the results are in {folder.target}")


@app.command()
def adapt(
    case: CaseName,
    target: Annotated[
        str | None, typer.Option("--target", help="Relative certified error to reach, such as 1e-2.")
    ] = None,
    max_cells: Annotated[int | None, typer.Option("--max-cells", help="Largest mesh, 10^6 cells by default.")] = None,
    theta: Annotated[str, typer.Option("--theta", help="Part of the squared error to refine; 1 is uniform.")] = "0.5",
    uniform: Annotated[bool, typer.Option("--uniform", help="Refine uniformly as well, for comparison.")] = False,
    algorithm: AlgorithmName = None,
    h: Annotated[str | None, typer.Option("--h", help="h of the first mesh; an eighth of a shape's diameter.")] = None,
    rho: Rho = None,
    eps: Epsilon = None,
    backend: BackendName = None,
    settings: Settings = None,
    output: OutputFolder = None,
    plot: Annotated[bool, typer.Option("--plot", help="Also draw pictures of the last solution (PNG).")] = False,
    html: Html = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    r"""Refine where the certified error is large until it is small; into results/<case>-adapt/.

    \b
    Examples:
      signorini adapt example5 --target 1e-2
      signorini adapt lprism --max-cells 50000 --uniform
    """
    from signorini_fenicsx.base.results import ResultsFolder
    from signorini_fenicsx.base.signals import end_if_told
    from signorini_fenicsx.cases.case import load_case
    from signorini_fenicsx.cases.solving import adapt_case
    from signorini_fenicsx.certificate.adaptive import DEFAULT_MAX_CELLS, FIRST_MESH, AdaptRow
    from signorini_fenicsx.cli import report
    from signorini_fenicsx.meshes.shapes import SHAPES
    from signorini_fenicsx.output.writing import write_adapt, write_solution

    comm = MPI.COMM_WORLD
    report.console.quiet = quiet or as_json
    if target is None and max_cells is None:
        raise InputError("adapt: give --target, the relative error to reach, or --max-cells, or both")
    wanted = None if target is None else _positive("--target", target)
    part = _positive("--theta", theta)
    if not MIN_THETA <= part <= 1:
        raise InputError(f"--theta {theta}: must be between {MIN_THETA:g}, which refines hardly anything, and 1")
    if max_cells is not None and max_cells < 1:
        raise InputError(f"--max-cells {max_cells}: must be at least 1")
    most = max_cells or DEFAULT_MAX_CELLS

    def first_mesh() -> "Case":
        problem = load_case(case)
        values = _overrides(settings, algorithm=algorithm, h=h, rho=rho, eps=eps, backend=backend)
        shape = problem.with_values(values).geometry.shape
        first = {} if shape is None else {"solve.h": SHAPES[shape].diameter / FIRST_MESH}
        return problem.with_values(first | values)

    problem = on_root(comm, first_mesh)
    rows: list[AdaptRow] = []

    def on_row(row: AdaptRow) -> None:
        rows.append(row)
        report.adapt_row(row)

    with ResultsFolder(comm, output or Path("results", f"{problem.name}-adapt")) as folder:
        report.heading(problem, comm)
        report.adapt_heading(wanted, most)
        try:
            refined = partial(
                adapt_case,
                *(problem, comm),
                target=wanted,
                max_cells=most,
                on_row=on_row,
                on_step=lambda row: end_if_told(comm),
            )
            solution, certificate = refined(theta=part)
            if uniform:
                refined(theta=1.0)
        except NumericalFailure as failure:
            if failure.solution is not None:
                write_solution(failure.solution, folder.path, plot=plot, html=html)
                failure.args = (f"{failure}; the last state is in {folder.keep_failed()}",)
            raise
        write_solution(solution, folder.path, certificate=certificate, plot=plot, html=html)
        write_adapt(solution, rows, folder.path)
        if wanted is not None and not certificate.relative <= wanted:
            kept = folder.keep_failed()
            raise NumericalFailure(
                f"relative error ≤ {certificate.relative:.3g}, not {wanted:g}, with the largest mesh of at most {most} "
                f"cells; the last state is in {kept}"
            )
        folder.publish()
        report.adapted(rows, solution.spaces.mesh.topology.dim, certificate, folder.target)
        if as_json:
            report.summary(folder.target)


def _positive(option: str, text: str) -> float:
    from signorini_fenicsx.expressions import parse_number

    try:
        value = parse_number(text)
    except InputError as error:
        raise InputError(f"{option}: {error}") from None
    if not 0 < value < math.inf:
        raise InputError(f"{option} {text}: must be greater than 0")
    return value


@app.command()
def export(
    results: Annotated[Path, typer.Argument(help="Results folder of an earlier run, or of a run of a study.")],
    output: OutputFolder = None,
    plot: Annotated[bool, typer.Option("--plot", help="Also draw pictures (PNG).")] = False,
    html: Html = False,
) -> None:
    r"""Write fields, tables and pictures of an earlier solution again, without solving, by default in place.

    \b
    Example:
      mpirun -n 2 signorini export results/example2 --plot
    """
    from signorini_fenicsx.base.results import ResultsFolder
    from signorini_fenicsx.cases.solving import case_of
    from signorini_fenicsx.certificate.certify import certify
    from signorini_fenicsx.cli import report
    from signorini_fenicsx.output.checkpoint import load_solution
    from signorini_fenicsx.output.writing import write_solution

    comm = MPI.COMM_WORLD
    solution = load_solution(results, comm)
    with ResultsFolder(comm, output or results) as folder:
        report.heading(case_of(solution), comm)
        certificate = certify(solution) if solution.converged else None
        write_solution(solution, folder.path, certificate=certificate, plot=plot, html=html)
        folder.publish(add=folder.target == Path(os.path.realpath(results)))
        report.results(folder.target)


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="Results folder of a run.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Results folder of another run on the same domain.")],
    output: OutputFolder = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    r"""Compare two runs on one domain, whatever their meshes: contact sets, and norms of the differences.

    \b
    Example:
      signorini compare results/example5 results/example5-adapt --output results/difference
    """
    from signorini_fenicsx.base.results import ResultsFolder
    from signorini_fenicsx.cli import report
    from signorini_fenicsx.comparing.comparison import compare as compare_solutions
    from signorini_fenicsx.output.checkpoint import load_solution
    from signorini_fenicsx.output.writing import write_summary

    comm = MPI.COMM_WORLD
    report.console.quiet = quiet or as_json
    if output is not None and os.path.realpath(output) in map(os.path.realpath, (first, second)):
        raise InputError(f"--output {output}: is one of the runs, which the comparison would replace; take another")
    one = load_solution(first, comm)  # named, so that an exception keeps it: MPI deadlocks on freeing it meanwhile
    other = load_solution(second, comm)
    comparison = compare_solutions(one, other)
    report.comparison(comparison, first, second)
    summary = {"runs": [str(first), str(second)]} | comparison.summary()
    if as_json:
        report.json_object(summary)
    if output is not None:
        with ResultsFolder(comm, output) as folder:
            on_root(comm, lambda: write_summary(folder.path, summary))
            folder.publish()
            report.results(folder.target)


@app.command()
def convergence(
    case: CaseName,
    vary: Annotated[str, typer.Option("--vary", help="h, eps (same mesh), or with ε tied to h: eps=h, eps=h^2.")] = "h",
    levels: Annotated[str, typer.Option("--levels", help="FIRST:LAST of h = 2^-level, or of eps = 10^-level.")] = "2:6",
    reference: Annotated[int, typer.Option("--reference", help="Level of the reference; unused by --vary eps.")] = 8,
    algorithm: AlgorithmName = None,
    h: MeshSize = None,
    rho: Rho = None,
    eps: Epsilon = None,
    backend: BackendName = None,
    settings: Settings = None,
    output: OutputFolder = None,
) -> None:
    r"""Measure errors against a fine solution, or those of the penalty; into results/<case>-convergence/.

    \b
    Examples:
      signorini convergence example1 --levels 2:6 --reference 8 --algorithm alg2
      signorini convergence example4 --algorithm alg3 --vary eps --levels 0:8 --h 2^-8
    """
    from signorini_fenicsx.base.results import ResultsFolder
    from signorini_fenicsx.cases.case import load_case
    from signorini_fenicsx.cli import report
    from signorini_fenicsx.comparing.convergence import Vary, convergence_study, fitted_slopes
    from signorini_fenicsx.methods.registry import METHODS
    from signorini_fenicsx.output.writing import write_convergence

    comm = MPI.COMM_WORLD
    values = _overrides(settings, algorithm=algorithm, h=h, rho=rho, eps=eps, backend=backend)
    problem = on_root(comm, lambda: load_case(case).with_values(values))
    if vary not in (known := [way.value for way in Vary]):
        raise InputError(f"--vary {vary}: must be one of {', '.join(known)}")
    way, steps = Vary(vary), _levels(levels)
    if way is not Vary.EPS and not steps[-1] < reference <= MAX_LEVEL:
        raise InputError(f"--reference {reference}: must be finer than the last level, {steps[-1]}, up to {MAX_LEVEL}")
    with ResultsFolder(comm, output or Path("results", f"{problem.name}-convergence")) as folder:
        report.heading(problem, comm)
        report.convergence_heading()
        rows = convergence_study(
            problem, way, steps, reference, comm, on_start=report.about_to_solve, on_row=report.convergence_row
        )
        write_convergence(problem, way, reference, rows, folder.path, comm)
        folder.publish()
        report.convergence_slopes(fitted_slopes(rows, way), way, METHODS[problem.solve.algorithm])
        report.results(folder.target)


@app.command()
def study(
    study: Annotated[
        str, typer.Argument(help="Name of a shipped study or path of a .toml file.", autocompletion=study_names)
    ],
    output: OutputFolder = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the runs and their sizes; run nothing.")] = False,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Try failed runs again.")] = False,
) -> None:
    r"""Do the runs of a study that have not been done, into results/<study>-study/; start again after any interruption.

    \b
    Examples:
      signorini study my-study.toml --dry-run
      mpirun -n 4 signorini study my-study.toml
    """
    from signorini_fenicsx.cli import study_report
    from signorini_fenicsx.studies.folder import StudyFolder
    from signorini_fenicsx.studies.runner import check_all_succeeded, run_study
    from signorini_fenicsx.studies.study import load_study

    comm = MPI.COMM_WORLD
    declared, runs = on_root(comm, lambda: load_study(study))
    folder = StudyFolder(comm, output or Path("results", f"{declared.name}-study"))
    study_report.heading(declared, runs, comm)
    if dry_run:
        study_report.plan(runs, folder)
        return
    with folder:
        if retry_failed:
            on_root(comm, lambda: folder.forget_failures(runs))
        with study_report.Progress(runs, folder, comm) as progress:
            run_study(runs, declared.ranks_per_run, folder, comm, on_run=progress.say)
        study_report.ended(folder)
        check_all_succeeded(runs, folder, comm)


@app.command()
def methods() -> None:
    """List all algorithms: name, what it solves, where it comes from."""
    from signorini_fenicsx.cli import report

    report.methods()


@app.command()
def info(
    case: CaseName,
    algorithm: AlgorithmName = None,
    h: MeshSize = None,
    backend: BackendName = None,
    settings: Settings = None,
    as_json: Json = False,
) -> None:
    r"""Show the sizes and boundary parts of a case, and about how much memory and time a run takes; solve nothing.

    \b
    Examples:
      signorini info dam
      mpirun -n 4 signorini info cube --h 2^-6
    """
    from signorini_fenicsx.cases.case import load_case
    from signorini_fenicsx.cases.inspection import expected
    from signorini_fenicsx.cli import report

    comm = MPI.COMM_WORLD
    values = _overrides(settings, algorithm=algorithm, h=h, backend=backend)
    problem = on_root(comm, lambda: load_case(case).with_values(values))
    estimate = on_root(comm, lambda: expected(problem, comm.size))
    report.console.quiet = as_json
    report.heading(problem, comm)
    report.expected(problem, estimate)
    if as_json:
        report.json_object({"case": problem.name, "title": problem.title, "ranks": comm.size} | vars(estimate))


@app.command()
def check(
    case: CaseName,
    algorithm: AlgorithmName = None,
    h: MeshSize = None,
    rho: Rho = None,
    eps: Epsilon = None,
    backend: BackendName = None,
    settings: Settings = None,
    quiet: Quiet = False,
) -> None:
    r"""Do all that a run does before it solves: read the case, make or read its mesh, find its parts, take its data.

    \b
    Examples:
      signorini check my-case.toml
      signorini check dam --set 'boundary.signorini=["face", "top"]'
    """
    from signorini_fenicsx.cases import inspection
    from signorini_fenicsx.cases.case import load_case
    from signorini_fenicsx.cli import report

    comm = MPI.COMM_WORLD
    report.console.quiet = quiet
    values = _overrides(settings, algorithm=algorithm, h=h, rho=rho, eps=eps, backend=backend)
    problem = on_root(comm, lambda: load_case(case).with_values(values))
    report.heading(problem, comm)
    report.checked(inspection.check(problem, comm))


@app.command()
def version(as_json: Json = False) -> None:
    """Show the versions of this program and of all that can change a result."""
    from signorini_fenicsx.cli import report
    from signorini_fenicsx.output.writing import versions

    if as_json:
        report.json_object(versions())
    else:
        report.versions(versions())


def _levels(text: str) -> range:
    first, separator, last = text.partition(":")
    known = [str(level) for level in range(MAX_LEVEL + 1)]
    if not (separator and first in known and last in known and int(first) <= int(last)):
        raise InputError(f"--levels {text}: must be FIRST:LAST with FIRST ≤ LAST ≤ {MAX_LEVEL}, such as 2:6")
    return range(int(first), int(last) + 1)


def _run(command: Callable[[], object]) -> int:
    """Run the command on all ranks and turn the failures that can be expected into exit statuses."""
    try:
        command()
    except InputError as error:
        _complain("error", str(error))
        return EXIT_BAD_INPUT
    except NumericalFailure as failure:
        _complain("failed", str(failure))
        return EXIT_FAILED
    except OSError as error:  # a full disk, a folder that vanished; a path that no system takes
        is_input = error.errno == errno.ENAMETOOLONG
        _complain("error" if is_input else "failed", f"{error.filename or 'file system'}: {error.strerror or error}")
        return EXIT_BAD_INPUT if is_input else EXIT_FAILED
    except RuntimeError as error:
        from signorini_fenicsx.backends.petsc import refuse_options

        try:
            refuse_options(error)
        except InputError as refusal:
            _complain("error", str(refusal))
            return EXIT_BAD_INPUT
        raise
    except Interruption as interruption:
        _complain("failed", str(interruption))
        _end_others(MPI.COMM_WORLD, interruption)
        return EXIT_FAILED
    except SystemExit as request:  # typer: usage errors and --help
        return request.code if isinstance(request.code, int) else EXIT_BAD_INPUT
    return 0


def _end_others(comm: MPI.Comm, interruption: Interruption) -> None:
    """End the ranks that no signal has reached, maybe; if it has reached rank 0, that has said so."""
    if comm.size > 1 and comm.rank > 0:
        time.sleep(2 * FORWARDING)
        end_all(comm, f"failed: rank {comm.rank} was {interruption}\n")
    if comm.size > 1:
        end_all(comm, "")


def _complain(kind: str, message: str) -> None:
    console = Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)
    console.print(f"{kind}:", style="bold red", end=" ")
    words, (first, last) = " ".join(message.split()), MAX_WORDS
    console.print(words if len(words) <= first + last else f"{words[:first]} … {words[-last:]}", markup=False)


def main() -> None:
    """Entry point: PETSc gets what follows `--`, the command what precedes it; only rank 0 speaks."""
    arguments, petsc_options = sys.argv[1:], []
    if "--" in arguments:
        split = arguments.index("--")
        arguments, petsc_options = arguments[:split], arguments[split + 1 :]
    comm = MPI.COMM_WORLD
    abort_all_on_exception(comm)
    gc.disable()  # see `parallel.collect_garbage`
    if comm.rank != 0:
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - for the life of the process
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without Unicode is no reason to fail
    command = typer.main.get_command(app)  # calling app itself would replace sys.excepthook

    def run() -> None:
        refuse_lone_copies(comm)
        _start_petsc(petsc_options, comm)
        listen_again()
        outlive_readers()
        command(args=arguments, prog_name="signorini")

    with listening(), np.errstate(all="ignore"):  # what is not finite is told in a sentence
        status = _run(run)
    sys.exit(status)


def _start_petsc(options: list[str], comm: MPI.Comm) -> None:
    """Give PETSc the options; what it prints of an error is kept for the sentence.

    Some errors are met by rank 0 alone, which then ends all.

    Raises:
        InputError: If it cannot start with them.
    """
    failure: InputError | None = None
    with tempfile.TemporaryFile("w+", errors="replace") as words:
        stderr = os.dup(2)
        os.dup2(words.fileno(), 2)
        try:
            petsc4py.init([sys.argv[0], *options])
        except RuntimeError as error:
            words.seek(0)
            said = [line.partition("ERROR: ")[2].strip() for line in words if "ERROR: " in line and "---" not in line]
            reason = ", ".join(itertools.takewhile(lambda line: not line.startswith("See "), said))
            failure = InputError(f"PETSc cannot start with its options: {reason or error}")
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
    if failure is not None and comm.size > 1:
        _complain("error", str(failure))
        end_all(comm, "", EXIT_BAD_INPUT)
    if failure is not None:
        raise failure
