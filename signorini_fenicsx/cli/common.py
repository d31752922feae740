"""What commands have in common: the case with its new values, the place of results, the state of a failed run."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.results import ResultsFolder
from signorini_fenicsx.cli.options import overrides

if TYPE_CHECKING:
    from signorini_fenicsx.cases.case import Case
    from signorini_fenicsx.cases.elastic_case import ElasticCase


def chosen_case(comm: MPI.Comm, name: str, settings: list[str] | None, **options: object) -> "Case":
    """The case that a command for scalar problems is about (collective), see `any_case`."""
    from signorini_fenicsx.cases.case import load_case

    values = overrides(settings, **options)
    return on_root(comm, lambda: load_case(name).with_values(values))


def any_case(comm: MPI.Comm, name: str, settings: list[str] | None, **options: object) -> "Case | ElasticCase":
    """The case that a command is about, of any physics (collective).

    Args:
        comm: Communicator; rank 0 reads the case.
        name: Its name or path.
        settings: New values, see `overrides`.
        options: Likewise.

    Raises:
        InputError: If there is no such case, or it is not valid with these values.
    """
    from signorini_fenicsx.cases.elastic_case import load_any_case

    values = overrides(settings, **options)
    return on_root(comm, lambda: load_any_case(name).with_values(values))


def results_place(output: Path | None, name: str) -> Path:
    """Where results go: into the wanted folder, or below results/."""
    return output or Path("results", name)


@contextlib.contextmanager
def failure_kept(folder: ResultsFolder, write: Callable[[Any], None]) -> Iterator[None]:
    """Write the state of a run that fails, and say where it is (collective).

    Args:
        folder: Where.
        write: Writes the solution that a failure holds (collective).

    Raises:
        NumericalFailure: The one that the run has ended with.
    """
    try:
        yield
    except NumericalFailure as failure:
        if failure.solution is not None:
            write(failure.solution)
            failure.args = (f"{failure}; the last state is in {folder.keep_failed()}",)
        raise
