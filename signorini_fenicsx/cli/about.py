"""Commands that give information without solving: cases, info, check, methods, version."""

from typing import Annotated, Any

import typer
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.shipped import case_names
from signorini_fenicsx.cli import options as option
from signorini_fenicsx.cli.common import any_case
from signorini_fenicsx.cli.report import Report


@option.of_case
def info(case: option.CaseName, as_json: option.Json = False, **new: Any) -> None:
    """Show sizes and boundary parts of a case, and estimate memory and time of a run; solve nothing.

    Examples:
      signorini info dam
      mpirun -n 4 signorini info cube --h 2^-6
    """
    from signorini_fenicsx.cases.inspection import expected
    from signorini_fenicsx.cli.case_report import CaseReport

    comm, report = MPI.COMM_WORLD, CaseReport(as_json=as_json)
    problem = any_case(comm, case, **new)
    estimate = on_root(comm, lambda: expected(problem, comm.size))
    report.heading(problem, comm)
    report.expected(problem, estimate)
    report.json({"case": problem.name, "title": problem.title, "ranks": comm.size} | vars(estimate))


@option.of_case
def check(case: option.CaseName, quiet: option.Quiet = False, **new: Any) -> None:
    """Check a case without solving it: read it, make or read its mesh, find its parts, evaluate its data.

    Examples:
      signorini check my-case.toml
      signorini check dam --set 'boundary.signorini=["face", "top"]'
    """
    from signorini_fenicsx.cases import inspection
    from signorini_fenicsx.cases.complaints import naming
    from signorini_fenicsx.cli.case_report import CaseReport

    comm, report = MPI.COMM_WORLD, CaseReport(quiet=quiet)
    problem = any_case(comm, case, **new)
    report.heading(problem, comm)
    with naming(problem.name):
        report.checked(problem, inspection.check(problem, comm))


def cases(
    name: Annotated[
        str | None, typer.Argument(help="A shipped case; without it all are listed.", autocompletion=case_names)
    ] = None,
    show: Annotated[bool, typer.Option("--show", help="Print the case file, as a start for your own.")] = False,
) -> None:
    """List the shipped cases: name, shape or mesh file, title. With --show, print one.

    Examples:
      signorini cases
      signorini cases dam --show > my-dam.toml
    """
    from signorini_fenicsx.cases.case import load_case
    from signorini_fenicsx.cases.first_case import shipped_text

    report = Report()
    if show:
        if name is None:
            raise InputError("cases --show: give the name of a case, such as `signorini cases dam --show`")
        report.line(on_root(MPI.COMM_WORLD, lambda: shipped_text(name)).removesuffix("\n"))
        return
    shipped = [load_case(each) for each in ([name] if name else case_names())]
    names, domains = max(len(case.name) for case in shipped), max(len(case.geometry.name) for case in shipped)
    for case in shipped:
        report.line(f"{case.name:<{names}}  {case.geometry.name:<{domains}}  {case.title}")


def methods() -> None:
    """List all algorithms: name, problem that it solves, source."""
    from signorini_fenicsx.methods.registry import METHODS

    report = Report()
    names, titles = max(map(len, METHODS)), max(len(algorithm.title) for algorithm in METHODS.values())
    for name, algorithm in METHODS.items():
        report.line(f"{name:<{names}}  {algorithm.title:<{titles}}  {algorithm.reference}")


def version(as_json: option.Json = False) -> None:
    """Show the versions of this program and of all software that can change a result."""
    from signorini_fenicsx.base.versions import versions

    report, of_software = Report(as_json=as_json), versions()
    report.entries(of_software, width=max(map(len, of_software)) + 1)
    report.json(of_software)
