"""Components of the domain in which u is known but for a constant, if no site holds it.

Each site joins the component behind it to the ground or, inside the domain, to another component. A component is held
if steep segments of its sites join it to the ground, perhaps by way of others. Otherwise the linear problem has no
solution, or many; then one site goes to its next segment that is steep, the one whose corner the constant meets first.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.contact.backend import SitePairs
from signorini_fenicsx.contact.chains import Chains

GROUND = 0
"""Number of all components in which u is known."""


@dataclass(frozen=True)
class Floating:
    """The component, or the ground, on each side of each site of this rank.

    Attributes:
        number: How many components float.
        named: The component behind each site, from 1, or the ground.
        across: That on its other side, the ground on the boundary.
        measure: |e| of each site.
    """

    number: int
    named: Indices
    across: Indices
    measure: Array

    def held(self, law: Chains, segment: Indices, iterate: SitePairs, comm: MPI.Comm) -> Indices:
        """The segments, changed where they leave a component without hold (collective).

        u is moved up or down there until one site is at a corner. The total flux says whether up or down.
        """
        rows, segment = np.arange(len(segment)), segment.copy()
        for _ in range(self.number):
            steep = law.slope[rows, segment] > 0
            loose = self._loose(steep, comm)
            if not loose.any():
                break
            side = loose[self.named].astype(np.int64) - loose[self.across]
            flux = np.where(steep, 0.0, law.value[rows, segment] - iterate.flux)
            up = comm.allreduce(float((side * self.measure) @ flux)) > 0
            following = np.clip(segment + (side if up else -side), 0, law.count)
            corner = np.minimum(np.minimum(segment, following), law.corners - 1)
            reachable = (following != segment) & (law.slope[rows, following] > 0)
            distance = np.full(len(segment), np.inf)
            distance[reachable] = np.abs(law.p[rows, corner] - iterate.p)[reachable]
            nearest = comm.allreduce(distance.min(initial=np.inf), MPI.MIN)
            if not np.isfinite(nearest):
                break
            segment = np.where(distance <= nearest, following, segment)
        return segment

    def _loose(self, steep: np.ndarray, comm: MPI.Comm) -> np.ndarray:
        """Mask of some components that are joined to one another but not to the ground, the first one (collective)."""
        pairs = np.unique(np.column_stack([self.named, self.across])[steep], axis=0)
        group = np.arange(self.number + 1)
        for one, other in np.concatenate(comm.allgather(pairs)):
            group[group == max(group[one], group[other])] = min(group[one], group[other])
        loose: np.ndarray = (group == group[group != group[GROUND]].min(initial=len(group))) & (group != GROUND)
        return loose
