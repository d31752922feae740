"""Commands that measure errors and differences: compare, convergence."""

import os
from pathlib import Path
from typing import Annotated, Any

import typer
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.results import ResultsFolder
from signorini_fenicsx.cli import options as option
from signorini_fenicsx.cli.common import any_case, results_place

MAX_LEVEL = 30


def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="Results folder of a run.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Results folder of another run on the same domain.")],
    output: option.OutputFolder = None,
    quiet: option.Quiet = False,
    as_json: option.Json = False,
) -> None:
    """Compare two runs on one domain, on any meshes: contact sets, and norms of the differences.

    Example:
      signorini compare results/example5 results/example5-adapt --output results/difference
    """
    from signorini_fenicsx.cli.comparison_report import ComparisonReport
    from signorini_fenicsx.comparing.comparison import compare as compare_solutions
    from signorini_fenicsx.output.checkpoint import load_solution
    from signorini_fenicsx.output.writing import write_summary

    comm, report = MPI.COMM_WORLD, ComparisonReport(quiet=quiet, as_json=as_json)
    if output is not None and os.path.realpath(output) in map(os.path.realpath, (first, second)):
        raise InputError(f"--output {output}: is one of the runs, which the comparison would replace; choose another")
    one = load_solution(first, comm)  # a name keeps it alive in an exception; freeing it then would deadlock MPI
    other = load_solution(second, comm)
    comparison = compare_solutions(one, other)
    report.comparison(comparison, first, second)
    summary = {"runs": [str(first), str(second)]} | comparison.summary()
    report.json(summary)
    if output is not None:
        with ResultsFolder(comm, output) as folder:
            on_root(comm, lambda: write_summary(folder.path, summary))
            folder.publish()
            report.results(folder.target)


@option.of_case
def convergence(
    case: option.CaseName,
    vary: Annotated[str, typer.Option("--vary", help="h; eps (same mesh); eps=h or eps=h^2 (both vary).")] = "h",
    levels: Annotated[str, typer.Option("--levels", help="FIRST:LAST of h = 2^-level, or of eps = 10^-level.")] = "2:6",
    reference: Annotated[int, typer.Option("--reference", help="Level of the reference; unused by --vary eps.")] = 8,
    output: option.OutputFolder = None,
    quiet: option.Quiet = False,
    as_json: option.Json = False,
    **new: Any,
) -> None:
    """Measure errors against a fine solution, or errors of the penalty; write results/<case>-convergence/.

    Examples:
      signorini convergence example1 --levels 2:6 --reference 8 --algorithm alg2
      signorini convergence example4 --algorithm alg3 --vary eps --levels 0:8 --h 2^-8
    """
    from signorini_fenicsx.cli.comparison_report import ConvergenceReport
    from signorini_fenicsx.comparing.convergence import Vary, convergence_study, fitted_slopes
    from signorini_fenicsx.output.writing import publish_convergence

    comm, report = MPI.COMM_WORLD, ConvergenceReport(quiet=quiet, as_json=as_json)
    problem = any_case(comm, case, **new)
    if vary not in (ways := [way.value for way in Vary]):
        raise InputError(f"--vary {vary}: must be one of {', '.join(ways)}")
    way, steps = Vary(vary), _levels(levels)
    if way is not Vary.EPS and not steps[-1] < reference <= MAX_LEVEL:
        raise InputError(f"--reference {reference}: must be finer than the last level, {steps[-1]}, up to {MAX_LEVEL}")
    with ResultsFolder(comm, results_place(output, f"{problem.name}-convergence")) as folder:
        report.heading(problem, comm)
        rows = convergence_study(problem, way, steps, reference, comm, on_row=report.errors)
        publish_convergence(problem, way, reference, rows, folder, comm)
        report.slopes(fitted_slopes(rows, way), way, problem.method)
        report.published(folder.target)


def _levels(text: str) -> range:
    first, separator, last = text.partition(":")
    allowed = [str(level) for level in range(MAX_LEVEL + 1)]
    if not (separator and first in allowed and last in allowed and int(first) <= int(last)):
        raise InputError(f"--levels {text}: must be FIRST:LAST with FIRST ≤ LAST ≤ {MAX_LEVEL}, such as 2:6")
    return range(int(first), int(last) + 1)
