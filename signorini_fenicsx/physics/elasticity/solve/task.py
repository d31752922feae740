"""What a method gets of an elastic problem: its starts, and Coulomb's friction as an outer method around the loop."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Chains, Penalty, SiteConditions
from signorini_fenicsx.contact.history import FoundSets, Outcome
from signorini_fenicsx.contact.kept_backend import KeptBackend
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.methods.task import Loop, Task
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.solve.backend import ElasticBackend
from signorini_fenicsx.physics.elasticity.solve.coulomb import CHANGE, balanced, by_path
from signorini_fenicsx.physics.elasticity.solve.residuals import ElasticKKT, elastic_kkt
from signorini_fenicsx.physics.elasticity.solve.slipping import slipped

PREDICT_FROM = 15_000
"""Number of unknowns from which a prediction saves more than it costs."""
REACH = 0.1
"""Gaps larger than the least one by this share of the body are open at the start where contact has to hold it,"""
ENOUGH = 0.01
"""if the other ones hold each rigid motion by this share at least of what all of them do, in squares of its means."""


@dataclass(frozen=True, kw_only=True)
class ElasticTask(Task):
    """A discrete elastic problem and the parameters of its method.

    Attributes:
        kept: Has the backend.
        changes: Of the steps of Coulomb's friction in the last run, see `ElasticSolution.bound_changes`.
    """

    spaces: ElasticSpaces
    data: ElasticData
    kept: KeptBackend
    changes: list[float] = field(default_factory=list)

    def is_large(self, backend: ElasticBackend) -> bool:
        """Whether there are so many unknowns that a prediction saves more than it costs."""
        return self.tuning.predicts(backend.dofs, PREDICT_FROM)

    def coarsening(self, backend: ElasticBackend) -> float | None:
        """See `Task.coarsening`."""
        return self.tuning.coarsening if self.is_large(backend) else None

    def own_start(self, backend: ElasticBackend) -> SiteConditions | None:
        """Contact where it has to hold the body, and nothing slips; friction by its first bounds (collective)."""
        backend.turn(self.data.friction)
        chains = backend.chains
        return None if self._near is None else chains.conditions(_sticking(chains, self._near))

    def begin(self, backend: ElasticBackend, start: Segments) -> Indices:
        """Segments and bounds of the shear of a start, or what has to hold the body (collective)."""
        spaces, law, rough = self.spaces, backend.chains, self.spaces.rough_rows
        start = start.on(spaces)
        segment = np.minimum(start.segment, law.count)
        holds = spaces.site_kinds["normal"].of(law.slope[np.arange(len(segment)), segment] > 0)
        if self._near is not None and not backend.comm.allreduce(bool(holds.any()), MPI.LOR):
            return _sticking(law, self._near)
        friction = backend.friction.with_bounds(start.carried["bound"][rough])
        if friction and "slip" in start.carried:
            friction = friction.along(spaces.in_frames(start.carried["slip"][rough]).reshape(-1, 3, 2))
        backend.turn(friction)
        return segment

    def found(self, backend: ElasticBackend, segment: Indices) -> Segments:
        """The segments, the bounds of the shear, and with given ones in space what slips.

        Coulomb's bounds are found sooner from no slip than from that under bounds that are not quite right.
        """
        friction, spaces = backend.friction, self.spaces
        carried = {"bound": friction.bound}
        if friction.in_space and not friction.by_pressure:
            carried["slip"] = spaces.along(friction.slipping.direction * friction.slipping.size[:, :, None])
        spread = spaces.site_kinds["slip"].spread
        return Segments(spaces, segment, {name: spread(rows) for name, rows in carried.items()})

    def settled[F: FoundSets](self, backend: ElasticBackend, settle: Callable[[], F]) -> F:
        """Settle the sets, with Coulomb's friction once for each bound of the shear (collective)."""
        return balanced(backend, settle, [], roughly=True)

    def solved(self, backend: ElasticBackend, loop: Loop) -> Outcome:
        """Run the loop, with Coulomb's friction in the plane once for each bound of the shear (collective)."""
        self.changes.clear()
        if backend.friction.in_space:
            return slipped(backend, lambda follow: loop(None, follow), self.changes, self.max_iterations)
        outcome = balanced(backend, loop, self.changes)
        found = not self.changes or self.changes[-1] <= CHANGE
        return outcome if found or not outcome.converged else by_path(backend, loop, self.changes)

    def floating(self) -> None:
        """None: weak springs hold a body that no site holds."""

    def kkt(self, iterate: Iterate, _penalty: Penalty | None) -> ElasticKKT:
        """The residuals of the last iterate, with the bounds of the shear that were found (collective)."""
        stresses = self.spaces.split.values(iterate.sigma)
        return elastic_kkt(self.spaces, self.kept.present.data_found(), stresses, iterate.p)

    @cached_property
    def _near(self) -> Mask | None:
        """The facet vertices whose contact holds the body at the start: those with small gaps (collective at first).

        A gap that is large beside the body does not close, and contact with it would tear the body apart. The reach is
        doubled until what is in it holds the body nearly as well as all of Γ_C does. None if it is held without.
        """
        spaces, comm, motions = self.spaces, self.spaces.mesh.comm, self.data.motions
        if motions is None or motions.shape[1] == 0:
            return None
        normal, slip = spaces.site_kinds
        into, along = normal.of(motions), slip.of(motions)
        slips = comm.allreduce(along.T @ along)

        def held(near: Mask) -> Array:
            return np.asarray(comm.allreduce(into[near].T @ into[near]) + slips)

        gap = self.data.lift[normal.unknown]
        everything, least = held(np.ones(len(gap), dtype=bool)), comm.allreduce(gap.min(initial=np.inf), MPI.MIN)
        reach = REACH * float(np.ptp(spaces.domain.box(), axis=0).max())
        while True:
            near = gap <= least + reach
            if np.linalg.eigvals(np.linalg.solve(everything, held(near))).real.min() >= ENOUGH:
                return near
            reach *= 2


def _sticking(chains: Chains, touching: Mask) -> Indices:
    """The segments with these facet vertices in contact; nothing slips."""
    steep = np.append(touching, np.ones(len(chains.p) - len(touching), dtype=bool))
    return np.where(steep, chains.steepest(), chains.beside_reference(steep=False))
