"""Work of one rank: what goes wrong there is told on all."""

import pytest
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import on_root, on_root_only


class Refused(Exception):
    """An error whose class cannot be made again from its words."""

    def __init__(self, place: str, reason: str):
        super().__init__(f"{place}: {reason}")
        self.kept = lambda: None


@pytest.mark.parallel(2)
@pytest.mark.parametrize(
    ("error", "elsewhere"),
    [
        (InputError("h = 0"), InputError),
        (ZeroDivisionError("a zero"), ZeroDivisionError),
        (Refused("here", "no"), RuntimeError),
    ],
)
def test_whatever_goes_wrong_on_rank_0_is_told_on_all_ranks(error: Exception, elsewhere: type[Exception]):
    """No rank waits for ever for one that has failed, whether the error can be sent or not; then all go on together."""
    comm = MPI.COMM_WORLD

    def fails() -> None:
        raise error

    for run in (on_root, on_root_only):
        with pytest.raises(type(error) if comm.rank == 0 else elsewhere, match=str(error)):
            run(comm, fails)
    assert on_root(comm, lambda: comm.rank) == 0
    assert on_root_only(comm, lambda: 1) == (1 if comm.rank == 0 else None)
