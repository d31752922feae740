"""The command that tells how wrong a function of another program is: certify."""

from pathlib import Path
from typing import Annotated

import typer
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.results import ResultsFolder
from signorini_fenicsx.cli.common import any_case, failure_kept, results_place
from signorini_fenicsx.cli.options import CaseName, Json, MeshSize, OutputFolder, Plot, Quiet, Settings, Verbose

MOST_LEVELS = 5


def certify(
    case: CaseName,
    field: Annotated[Path, typer.Option("--field", help="Mesh file with values at its points, such as a .vtu.")],
    name: Annotated[str | None, typer.Option("--name", help="Name of the values, if there are others.")] = None,
    refine: Annotated[int, typer.Option("--refine", help="Refine the mesh so often for the flux: sharper bounds.")] = 0,
    h: MeshSize = None,
    settings: Settings = None,
    output: OutputFolder = None,
    plot: Plot = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    as_json: Json = False,
) -> None:
    """Bound how wrong a solution of another program is; write results/<case>-certify/.

    Examples:
      signorini certify example1 --field mine.vtu --plot
      signorini certify my-case.toml --field mine.vtu --name u --refine 1
    """
    from signorini_fenicsx.cases.fields import field_of_case
    from signorini_fenicsx.cases.solving import solve_case
    from signorini_fenicsx.certificate.certify import bound_field
    from signorini_fenicsx.cli.solution_report import SolutionReport
    from signorini_fenicsx.output.writing import Found, SolutionFiles

    comm, report = MPI.COMM_WORLD, SolutionReport(quiet=quiet, verbose=verbose, as_json=as_json)
    if not 0 <= refine <= MOST_LEVELS:
        raise InputError(f"--refine {refine}: must be between 0 and {MOST_LEVELS}")
    problem = any_case(comm, case, settings=settings, h=h)
    domain, v = field_of_case(problem, str(field), name, refine, comm)
    with ResultsFolder(comm, results_place(output, f"{problem.name}-certify")) as folder:
        report.begin(problem, comm)
        with failure_kept(folder, plot=plot):
            solution = solve_case(problem, comm, domain=domain, on_step=report.followed(comm))
        files = SolutionFiles(solution).publish(folder)
        bounds = folder.attempt("error bound", lambda: bound_field(solution, v))
        found = Found() if bounds is None else Found(certificate=bounds.certificate, of_field=bounds)
        files.publish_others(folder, found, plot=plot)
        report.solution(solution, found)
        report.published(folder.target)
