"""Functions shared by commands: the case with its new values, the place of results, the state of a failed run."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, LaterFailure, NumericalFailure
from signorini_fenicsx.base.exchange import failed_place
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.results import ResultsFolder
from signorini_fenicsx.cli.options import overrides

if TYPE_CHECKING:
    from signorini_fenicsx.cases.case import CaseFile


def any_case(comm: MPI.Comm, name: str, **new: Any) -> "CaseFile":
    """The case of a command, of any physics, with its new values (collective).

    Args:
        comm: Communicator; rank 0 reads the case.
        name: Name or path of the case.
        new: New values by options, see `overrides`.

    Raises:
        InputError: If there is no such case, or it is not valid with these values.
    """
    from signorini_fenicsx.cases.case import load_case

    values = overrides(**new)
    case = on_root(comm, lambda: load_case(name).with_values(values))
    refuse_idle(case, **new)
    return case


def refuse_idle(case: "CaseFile", **options: object) -> None:
    """Refuse options that the method of a case does not have.

    Raises:
        InputError: If one is given.
    """
    from signorini_fenicsx.methods.registry import Method, methods_that

    has: dict[str, Callable[[Method], object]] = {
        "rho": lambda method: method.has_rho,
        "eps": lambda method: method.has_eps,
        "backend": lambda method: method.rule is not None,
        "element": lambda method: method.takes_order_two,
    }
    for key, needed in has.items():
        if options.get(key) is not None and not needed(case.method):
            raise InputError(f"--{key}: {case.solve.algorithm} has no such option; {methods_that(needed)} have it")


def results_place(output: Path | None, name: str) -> Path:
    """The folder for results: `output`, or by default one below results/."""
    return output or Path("results", name)


@contextlib.contextmanager
def failure_kept(folder: ResultsFolder, **wanted: bool) -> Iterator[None]:
    """Write the last state of a run that fails in this context, and add its place to the message (collective).

    Args:
        folder: Where. A state that solves the problem is published there, any other is that of a failed run.
        wanted: Which pictures, see `SolutionFiles.publish_others`.

    Raises:
        NumericalFailure: The failure of the run.
    """
    from signorini_fenicsx.output.writing import Found, SolutionFiles

    try:
        yield
    except NumericalFailure as failure:
        state = failure.solution
        if state is not None:
            files = SolutionFiles(state).publish(folder, failed=not state.converged)
            files.publish_others(folder, Found(), **wanted)
            if not state.converged:
                failure.args = (f"{failure}; {folder.last_state()}",)
        raise


def keep_beside(folder: ResultsFolder, later: LaterFailure) -> NoReturn:
    """End a run whose solution is published by what failed after it, whose last state is kept beside it (collective).

    Raises:
        LaterFailure: What failed, with the place of the state if there is one.
    """
    from signorini_fenicsx.output.writing import Found, SolutionFiles

    place = failed_place(folder.target)

    def write() -> None:
        with ResultsFolder(folder.comm, place) as beside:
            SolutionFiles(later.state).publish(beside).publish_others(beside, Found())

    if later.state is not None:
        folder.attempt("last state", write)
        if "last state" not in folder.failures:
            later.args = (f"{later}; its last state is in {place}",)
    raise later
