"""Bounds that are proved, rounding included: what a proof gives, and rank 0 proves while the other ranks wait."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from dolfinx import fem

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import Stopwatch, on_root
from signorini_fenicsx.solving.physics import PHYSICS
from signorini_fenicsx.solving.solved import Solved


@dataclass(frozen=True)
class Proven:
    """Upper bounds, with the names of `Certificate`.

    Attributes:
        bound: Bound of ‖σ − σ_h‖ and of |∇(v − u)|, in elasticity |v − u|.
        sigma_bound: Bound of ‖σ − σ_h‖.
        gap: Bound of the gap.
        oscillation: Bound of the effect of f, g_N and q_S minus their means.
        remainder: Bound of ‖y − σ_h‖.
    """

    bound: float
    sigma_bound: float
    gap: float
    oscillation: float
    remainder: float


@dataclass(frozen=True)
class Proofs:
    """The proofs of a physics.

    Attributes:
        most: Largest number of cells, of which enclosures take 4 to 5 GB in space, 1 GB in the plane.
        prepared: Gives the proof for a solution and the v of its certificate, to be run on rank 0 (collective). Raises
            InputError if there is no theorem for the problem.
    """

    most: int
    prepared: Callable[[Any, fem.Function], Callable[[], Proven | None]]


@dataclass(frozen=True)
class Proof:
    """The result of a proof.

    Attributes:
        proven: The bounds; None if there is no proof.
        reason: Why there is no proof; empty if there is one.
        seconds: Wall time.
    """

    proven: Proven | None
    reason: str
    seconds: float

    def summary(self) -> dict[str, Any]:
        """The numbers, ready for JSON, which writes floats with all digits."""
        if self.proven is None:
            return {"proved": None, "not_proved": self.reason}
        return {"proved": asdict(self.proven) | {"seconds": self.seconds}}


def check_size(cells: float, physics: str) -> None:
    """Refuse a mesh that is too large for one process, or a physics without proofs.

    Raises:
        InputError: If there are too many cells, or no proofs.
    """
    if (proofs := PHYSICS[physics].proofs) is None:
        raise InputError(f"--rigorous: there is no proof for {physics}")
    if cells > proofs.most:
        raise InputError(
            f"--rigorous: one process has room for {proofs.most} cells, not {cells:.3g}; choose a larger h"
        )


def proof_of(solution: Solved, v: fem.Function) -> Proof:
    """Prove a bound for a solution of any algorithm (collective).

    Args:
        solution: The solution.
        v: The continuous function of its certificate, `Certificate.v`.
    """
    watch = Stopwatch()
    comm = solution.spaces.mesh.comm
    proven, reason = None, ""
    with watch.phase("proof"):
        try:
            cells = solution.spaces.Q.dofmap.index_map.size_global
            check_size(cells, solution.physics)
            proven = on_root(comm, PHYSICS[solution.physics].proofs.prepared(solution, v))
        except InputError as error:
            reason = str(error)
    return Proof(proven, reason, watch.longest(comm)["proof"])
