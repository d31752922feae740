"""What limits rigid motions, and motions that meet no limit, found by cutting planes."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.physics.elasticity.discrete.friction import STICKS

FREE = 1e-6
"""A motion of size 1 that moves what is given by less is free."""
SLACK = 1e-9
"""A motion is not into the foundation below this share of its size; loads do no work below this share of their most."""
SURELY = 1e-4
"""Loads move a body, as a share of what they do at most, if they do more."""
SMALL = 1e-6
"""What the size of a motion costs, so that of several a short one is told."""
MOST_CUTS = 200
"""For each direction; far more than were ever seen."""


@dataclass(frozen=True)
class Limits:
    """What a motion r ≠ 0 has to meet that nothing prevents: into·r ≤ 0 and Σ shears |slips·r| ≤ work·r.

    Both sides are found by cutting planes: a linear programme with few rows gives a motion, and each rank adds the row
    that this motion violates most. So only rows of as many numbers as there are motions go from rank to rank.

    Attributes:
        comm: Communicator.
        work: What the loads do on the motions.
        into: Rows of this rank, r_n on Γ_C.
        slips: Rows of this rank, r_t where there is friction, shape (rows, d − 1, motions).
        shears: The shear for each of them; where nothing slips it is infinite.
        cones: r_n and μr_t at the vertices under Coulomb's law, shape (rows, d, motions).
    """

    comm: MPI.Comm
    work: Array
    into: Array
    slips: Array
    shears: Array
    cones: Array

    def sliding(self) -> Array | None:
        """A motion that no pressures under Coulomb's law prevent, with friction, or None (collective).

        Their forces do no work on a motion with r_n + μ|r_t| ≤ 0 at all vertices. If the loads do, and more than other
        friction takes, nothing balances them.
        """
        way, cuts = self.work / (np.linalg.norm(self.work) or 1.0), np.empty((0, len(self.work)))
        if not self.comm.allreduce(len(self.cones) > 0, MPI.LOR):
            return None
        for _ in range(MOST_CUTS):
            motion = on_root(self.comm, partial(_farthest, way, cuts, np.empty((0, len(way)))))
            if motion is None or way @ motion < SURELY:
                return None
            onto, along = self.cones[:, 0] @ motion, self.cones[:, 1:] @ motion
            size = np.linalg.norm(along, axis=1)
            worst = np.argsort(onto + size)[-1:]
            worst = worst[(onto + size)[worst] > SLACK]
            turned = (along / np.where(size > 0, size, 1.0)[:, None])[worst]
            rows = self.cones[worst, 0] + np.einsum("nk,nkr->nr", turned, self.cones[worst, 1:])
            cuts_of_cones = np.concatenate(self.comm.allgather(rows))
            others = self._violated(motion)
            if len(cuts_of_cones) + len(others) == 0:
                return np.asarray(motion)
            cuts = np.concatenate([cuts, cuts_of_cones, others])
        return None

    def unprevented(self) -> Array | None:
        """A motion with an entry 1 or −1, or None (collective)."""
        still = self._still()
        cuts = np.empty((0, len(self.work)))
        way = self.work / (np.linalg.norm(self.work) or 1.0)  # where the loads push is told first
        for objective in np.concatenate([way[None], np.eye(len(way)), -np.eye(len(way))]):
            for _ in range(MOST_CUTS):
                motion = on_root(self.comm, partial(_farthest, objective, cuts, still))
                if motion is None or objective @ motion < 0.5:
                    break
                further = self._violated(motion)
                if len(further) == 0:
                    return np.asarray(motion)
                cuts = np.concatenate([cuts, further])
        return None

    def plainer(self, motion: Array, others: Array) -> Array:
        """The first of some other motions that nothing prevents either, or this one (collective).

        They are tried by what the loads do on them. If the loads push this motion, they push the other one.
        """
        still, pushed = self._still(), self.work @ motion > SLACK
        for other in others[np.argsort(-np.round(others @ self.work / SLACK), kind="stable")]:
            if pushed and self.work @ other <= SLACK:
                break
            if np.abs(still @ other).max(initial=0.0) <= FREE and len(self._violated(other)) == 0:
                return np.asarray(other)
        return motion

    def _still(self) -> Array:
        """Motions whose shares must be 0 as they would slip where friction has no limit, orthonormal (collective)."""
        stuck = self.slips[self._sticks].reshape(-1, len(self.work))
        sizes, vectors = np.linalg.eigh(self.comm.allreduce(stuck.T @ stuck))
        return np.asarray(vectors[:, sizes > FREE**2].T)

    @property
    def _sticks(self) -> Mask:
        return self.shears > STICKS / 1e100

    def rubbed(self, motion: Array) -> float:
        """Σ shears |slips·r| where it may slip (collective)."""
        lengths = np.linalg.norm(self.slips @ motion, axis=1)
        return self.comm.allreduce(float(np.where(self._sticks, 0.0, self.shears) @ lengths))

    def _violated(self, motion: Array) -> Array:
        """Rows c for c·r ≤ 0 that this motion does not meet: at most one of each rank, and one (collective)."""
        off = self.into @ motion
        worst = self.into[np.argmax(off)][None] if off.max(initial=0.0) > SLACK else self.into[:0]
        slips, shears = self.slips[~self._sticks], self.shears[~self._sticks]
        moved = slips @ motion
        size = np.linalg.norm(moved, axis=1)[:, None]
        pulls = shears[:, None] * np.divide(moved, size, out=np.zeros_like(moved), where=size > 0)
        rubbing = np.einsum("nk,nkr->r", pulls, slips)
        along = self.comm.allreduce(rubbing) - self.work
        rows = np.concatenate(self.comm.allgather(worst))
        return np.concatenate([rows, along[None]]) if along @ motion > SLACK else rows


def _farthest(objective: Array, cuts: Array, still: Array) -> Array | None:
    """The motion with the largest objective, entries up to 1, or None if there is none; of several a short one."""
    if len(objective) == 1:
        return objective if len(still) == 0 and (cuts @ objective <= 0).all() else None
    from scipy.optimize import linprog  # takes a second to load

    both = np.append(-objective, objective) + SMALL  # entries above 0 and below 0 are variables of their own
    equal = {"A_eq": np.hstack([still, -still]), "b_eq": np.zeros(len(still))} if len(still) else {}
    rows = np.hstack([cuts, -cuts])
    exact = {"primal_feasibility_tolerance": SLACK / 10}  # otherwise a cut may be violated again
    optimum = linprog(both, A_ub=rows, b_ub=np.zeros(len(cuts)), bounds=(0, 1), options=exact, **equal)
    return np.subtract(*np.split(optimum.x, 2)) if optimum.success else None
