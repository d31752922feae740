"""Corrections by a solver that may be far off: what is left does not grow.

A correction is what the solver makes of what is left. Made orthogonal to those before, by what they change, and scaled,
it leaves as little as it can: GCR (Eisenstat, Elman, Schultz: SIAM J. Numer. Anal. 20, 1983). A solver that is wrong in
few directions only, as one is by a flat cell, needs about as many corrections as there are of these.
"""

from collections.abc import Callable

from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array

MOST = 60
"""Corrections at most."""
PATIENCE = 30
"""In so many corrections what is left has to fall by a half."""
MEMORY, FEW = 2**28, 4
"""Bytes of a rank for earlier corrections, and how many are kept whatever they need."""
WHOLE = 1e-3
"""A first correction whose best share is as near to 1 is taken as it is: what it leaves is known then."""
GOOD = 0.1
"""Where a correction leaves at most this share, none are kept: the solver is good."""

type Fields = list[Array]


def corrected(
    comm: MPI.Comm,
    fields: Fields,
    left_by: Callable[[Fields], Array],
    correction: Callable[[Array], Fields],
    enough: Callable[[Array], bool],
) -> Fields:
    """Fields with corrections, until little is left, or until this falls no more (collective).

    Args:
        comm: Communicator.
        fields: The fields on this rank.
        left_by: What fields leave, an affine function of them; it is asked last for those that are returned.
        correction: What the solver makes of what is left: corrections of the fields.
        enough: Whether so little is left.
    """

    def dot(a: Array, b: Array) -> float:
        return float(comm.allreduce(float(a @ b)))

    kept, left = list[Fields](), left_by(fields)
    sizes = [dot(left, left)]
    while not enough(left) and len(sizes) <= MOST:
        if len(sizes) > PATIENCE and sizes[-1] > sizes[-1 - PATIENCE] / 4:
            break
        change = correction(left)
        corrected_once = _sum(fields, change)
        change = [left_by(corrected_once) - left, *change]
        for earlier in kept:
            change = _sum(change, earlier, -dot(change[0], earlier[0]) / dot(earlier[0], earlier[0]))
        size = dot(change[0], change[0])
        share = -dot(left, change[0]) / size if size > 0 else 0.0
        whole = not kept and abs(share - 1) < WHOLE
        fields = corrected_once if whole else _sum(fields, change[1:], share)
        left = left + change[0] if whole else left_by(fields)
        sizes.append(dot(left, left))
        if sizes[-1] <= GOOD**2 * sizes[-2]:
            kept = []
        elif size > 0:
            most = MEMORY // comm.allreduce(sum(each.nbytes for each in change), MPI.MAX)
            kept = [*kept[-max(FEW, most) + 1 :], change]
    return fields


def stepped(
    comm: MPI.Comm,
    fields: Fields,
    left_by: Callable[[Fields], Array],
    correction: Callable[[Array], Fields],
    enough: Callable[[Array], bool],
) -> Fields:
    """Fields with corrections as they are, while what is left falls, see `corrected` (collective).

    These are steps of the proximal point method where the solver has springs that what is left has not.
    """
    left, before = left_by(fields), float("inf")
    for _ in range(MOST):
        if enough(left) or not (size := comm.allreduce(float(left @ left))) < before:
            break
        fields, before = _sum(fields, correction(left)), size
        left = left_by(fields)
    return fields


def _sum(fields: Fields, changes: Fields, share: float = 1.0) -> Fields:
    return [field + share * each for field, each in zip(fields, changes, strict=True)]
