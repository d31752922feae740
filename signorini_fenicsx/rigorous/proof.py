"""The rigorous bound of a solution: rank 0 proves it, the other ranks wait."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from dolfinx import fem

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import Stopwatch, on_root
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.rigorous.data import Given
from signorini_fenicsx.rigorous.discrete import gathered
from signorini_fenicsx.rigorous.elasticity import discrete as elastic
from signorini_fenicsx.rigorous.elasticity.scope import outside
from signorini_fenicsx.rigorous.elasticity.theorem import prove as prove_elastic
from signorini_fenicsx.rigorous.elementary import FromArb
from signorini_fenicsx.rigorous.proven import Proven
from signorini_fenicsx.rigorous.theorem import prove
from signorini_fenicsx.solving.solved import Solved


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
    if physics not in PROOFS:
        raise InputError(f"--rigorous: there is no proof for {physics}")
    most = PROOFS[physics].most
    if cells > most:
        raise InputError(f"--rigorous: one process has room for {most} cells, not {cells:.3g}; choose a larger h")


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
            proven = on_root(comm, PROOFS[solution.physics].prepared(solution, v))
        except InputError as error:
            reason = str(error)
    return Proof(proven, reason, watch.longest(comm)["proof"])


def _prepared_scalar(solution: Solution, v: fem.Function) -> Callable[[], Proven | None]:
    """The proof of a scalar problem, to be run on rank 0 (collective).

    Raises:
        InputError: If there is no theorem for the problem.
    """
    if solution.data.laws.listed:
        raise InputError("the proof is for the law of Signorini alone")
    if solution.data.c_h is not None:
        raise InputError("the proof is for c = 0 alone")
    if solution.data.inside is not None:
        raise InputError("the proof is for problems without an obstacle and other laws in Ω")
    given = Given.of(solution.data.trees, FromArb())
    discrete = gathered(solution, v)
    return lambda: None if discrete is None else prove(discrete, given)


def _prepared_elastic(solution: ElasticSolution, v: fem.Function) -> Callable[[], Proven | None]:
    """The proof of an elastic problem, to be run on rank 0 (collective).

    Raises:
        InputError: If there is no theorem for the problem.
    """
    reason = outside(solution.problem)
    if reason or solution.step is not None:
        raise InputError(reason or "the proof is not for steps in time")
    discrete = elastic.gathered(solution, v, FromArb())
    return lambda: None if discrete is None else prove_elastic(*discrete)


@dataclass(frozen=True)
class OfPhysics:
    """The proofs of a physics.

    Attributes:
        most: Largest number of cells.
        prepared: Gives the proof for a solution, to be run on rank 0 (collective).
    """

    most: int
    prepared: Callable[[Any, fem.Function], Callable[[], Proven | None]]


PROOFS = {"diffusion": OfPhysics(500_000, _prepared_scalar), "elasticity": OfPhysics(50_000, _prepared_elastic)}
"""The physics that have proofs. Enclosures of so many cells take 4 and 5 GB in space, 1 GB in the plane."""
