"""Rigid motions that nothing prevents: then an elastic contact problem has no solution, or many."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.physics.elasticity.data import ElasticData, blocks_of_cells
from signorini_fenicsx.physics.elasticity.friction import STICKS
from signorini_fenicsx.physics.elasticity.johnson_mercier import Cells
from signorini_fenicsx.physics.elasticity.problem import NORMAL
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces

type Moved = Callable[[Array], Array]

FREE = 1e-8
"""A motion of size 1 that moves what is given by less is free."""
SLACK = 1e-9
"""A motion is not into the foundation below this share of its size; loads do no work below this share of their most."""
SMALL = 1e-6
"""What the size of a motion costs, so that of several a short one is told."""
MOST_CUTS = 200
"""For each direction; far more than were ever seen."""


def check_rigid_motions(spaces: ElasticSpaces, data: ElasticData) -> Array:
    """Make sure that each rigid motion is prevented, by what is given of u or by contact under the loads (collective).

    For a motion r that what is given of u lets free, and that does not go into the foundation, r_n ≤ 0 on Γ_C, the work
    of the loads must be negative, with friction less than ∫ g|r_t|: then contact holds the body against it. Coulomb's g
    is not known, and counts as ∞ before the first solve; if it is too small, see `slides`.

    Returns:
        The motions that contact has to prevent, a basis: means of r_n at the sites, and of r_t at those with friction,
        shape (sites, motions).

    Raises:
        InputError: If a motion is not prevented; it is told.
    """
    means, motion = _motions_of_contact(spaces, data)
    if motion is not None:
        raise InputError(f"the body can move rigidly, {motion[0]}: {HELD_BY}")
    return means


def slides(spaces: ElasticSpaces, data: ElasticData) -> str:
    """The motion that the bounds of the friction do not prevent, and by how much, in words; or empty (collective)."""
    _, motion = _motions_of_contact(spaces, data)
    if motion is None:
        return ""
    words, loads, holds = motion
    return (
        f"the body slides away, {words}: on this motion the loads do the work {loads:.4g}, and friction under the last "
        f"pressure takes at most {holds:.4g}; with less load, or more friction, it rests"
    )


def _motions_of_contact(spaces: ElasticSpaces, data: ElasticData) -> tuple[Array, tuple[str, float, float] | None]:
    """What `check_rigid_motions` returns, and a motion that is not prevented: in words, the work, and what is rubbed.

    Collective. Both are those of a unit translation, or of the rotation by a unit angle.
    """
    low, high = spaces.domain.box()[:, : spaces.dim]
    middle, size = (low + high) / 2, float((high - low).max())

    def moved(x: Array) -> Array:
        """The basis of all rigid motions in points of shape (…, d): shape (…, d, motions)."""
        return _motions((x - middle) / size)

    free = _not_given(spaces, moved)
    if free.shape[1] == 0:
        return np.zeros((len(spaces.sites) + len(spaces.slip_sites), 0)), None
    work, most = _work(spaces, data, moved)
    work = work @ free / most
    into = np.einsum("nai,nair->nar", _at(spaces.contact.normals, spaces.dim), moved(spaces.contact.vertices)) @ free
    rough = spaces.rough
    along = np.einsum("nai,nair->nar", _at(spaces.tangents, spaces.dim), moved(rough.vertices)) @ free
    slips, shears = along.reshape(-1, free.shape[1]), np.empty(0)
    if data.friction is not None:
        shears = np.repeat(rough.measure, 2) / 2 * data.friction.bound.ravel() / most
    limits = Limits(spaces.mesh.comm, work, into.reshape(-1, free.shape[1]), slips, shears)
    motion, told = limits.unprevented(), None
    if motion is not None:
        words, unit = _in_words(free @ motion, middle, size)
        rubbed = float(shears @ np.abs(slips @ motion)) if len(shears) else 0.0
        told = words, float(work @ motion) * most / unit, spaces.mesh.comm.allreduce(rubbed) * most / unit
    found = np.concatenate([into, along])
    means = (found + found.sum(axis=1, keepdims=True)) / (spaces.dim + 1)  # weighted by the hats
    return means.reshape(-1, free.shape[1]), told


HELD_BY = "neither the parts where u is given nor contact under these loads prevent that"


def _motions(x: Array) -> Array:
    """Translations, then rotations about the origin."""
    dim = x.shape[-1]
    found = [np.broadcast_to(axis, x.shape) for axis in np.eye(dim)]
    if dim == 2:
        found.append(np.stack([-x[..., 1], x[..., 0]], axis=-1))
    else:
        found += [np.cross(axis, x) for axis in np.eye(3)]
    return np.stack(found, axis=-1)


def _at(normals: Array, dim: int) -> Array:
    return np.repeat(normals[:, None], dim, axis=1)


def _not_given(spaces: ElasticSpaces, moved: Moved) -> Array:
    """A basis of the motions that are 0 where u is given (collective)."""
    dim = spaces.dim
    number = dim * (dim + 1) // 2
    gram, total = np.zeros((number, number)), 0.0
    for facets, k, letter in spaces.fixed:
        motions = moved(facets.vertices)
        along = np.einsum("nai,nair->nar", _at(facets.normals, dim), motions) if letter == NORMAL else motions[:, :, k]
        gram += np.einsum("nar,nas,n->rs", along, along, facets.measure)
        total += float(facets.measure.sum())
    gram, total = spaces.mesh.comm.allreduce(gram), spaces.mesh.comm.allreduce(total)
    sizes, vectors = np.linalg.eigh(gram)
    return vectors[:, sizes <= FREE**2 * max(total, 1e-300)]


def _work(spaces: ElasticSpaces, data: ElasticData, moved: Moved) -> tuple[Array, float]:
    """What f and g_N do on the motions, and what they could do, 1 if they are 0 (collective)."""
    pairs = [(spaces.neumann.vertices, data.tractions)]
    for cells in blocks_of_cells(spaces):
        vertices = spaces.vertices[cells]
        pairs.append((vertices, data.moments_of_f(spaces, cells, Cells(vertices).measure)))
    work = sum(np.einsum("nvi,nvir->r", moments, moved(vertices)) for vertices, moments in pairs)
    most = sum(float(np.abs(moments).sum()) for _, moments in pairs)
    work, most = spaces.mesh.comm.allreduce(work), spaces.mesh.comm.allreduce(most)
    return work, most if most > 0 else 1.0


@dataclass(frozen=True)
class Limits:
    """What a motion r ≠ 0 has to meet that nothing prevents: into·r ≤ 0 and Σ shears |slips·r| ≤ work·r.

    Both sides are found by cutting planes: a linear programme with few rows gives a motion, and each rank adds the row
    that this motion violates most. So only rows of as many numbers as there are motions go from rank to rank.

    Attributes:
        comm: Communicator.
        work: What the loads do on the motions.
        into: Rows of this rank, r_n on Γ_C.
        slips: Rows of this rank, r_t where there is friction.
        shears: The shear for each of them; where nothing slips it is infinite.
    """

    comm: MPI.Comm
    work: Array
    into: Array
    slips: Array
    shears: Array

    def unprevented(self) -> Array | None:
        """A motion with an entry 1 or −1, or None (collective)."""
        sticks = self.shears > STICKS / 1e100
        stuck = self.slips[sticks]
        sizes, vectors = np.linalg.eigh(self.comm.allreduce(stuck.T @ stuck))
        still = vectors[:, sizes > FREE**2].T
        cuts = np.empty((0, len(self.work)))
        for objective in np.concatenate([np.eye(len(self.work)), -np.eye(len(self.work))]):
            for _ in range(MOST_CUTS):
                motion = self.comm.bcast(_farthest(objective, cuts, still) if self.comm.rank == 0 else None)
                if motion is None or objective @ motion < 0.5:
                    break
                more = self._violated(motion, ~sticks)
                if len(more) == 0:
                    return np.asarray(motion)
                cuts = np.concatenate([cuts, more])
        return None

    def _violated(self, motion: Array, slides: Mask) -> Array:
        """Rows c for c·r ≤ 0 that this motion does not meet: at most one of each rank, and one (collective)."""
        off = self.into @ motion
        worst = self.into[np.argmax(off)][None] if off.max(initial=0.0) > SLACK else self.into[:0]
        slips, shears = self.slips[slides], self.shears[slides]
        rubbing = (shears * np.sign(slips @ motion)) @ slips if len(slips) else np.zeros(len(motion))
        along = self.comm.allreduce(rubbing) - self.work
        rows = np.concatenate(self.comm.allgather(worst))
        return np.concatenate([rows, along[None]]) if along @ motion > SLACK else rows


def _farthest(objective: Array, cuts: Array, still: Array) -> Array | None:
    """The motion with the largest objective, entries up to 1, or None if there is none; of several a short one."""
    from scipy.optimize import linprog  # takes a second to load

    both = np.append(-objective, objective) + SMALL  # entries above 0 and below 0 are variables of their own
    equal = {"A_eq": np.hstack([still, -still]), "b_eq": np.zeros(len(still))} if len(still) else {}
    rows = np.hstack([cuts, -cuts])
    exact = {"primal_feasibility_tolerance": SLACK / 10}  # otherwise a cut may be violated again
    found = linprog(both, A_ub=rows, b_ub=np.zeros(len(cuts)), bounds=(0, 1), options=exact, **equal)
    return np.subtract(*np.split(found.x, 2)) if found.success else None


def _in_words(motion: Array, middle: Array, size: float) -> tuple[str, float]:
    """A motion as a translation or a rotation, and its length or its angle."""
    dim = len(middle)
    shift, turn = motion[:dim], motion[dim:] / size
    along = ", ".join(f"{x:.3g}" for x in shift / max(np.abs(shift).max(), 1e-300))
    if np.abs(turn).max() * size < 1e-6 * np.abs(shift).max():
        return f"along ({along})", float(np.linalg.norm(shift))
    if dim == 2:
        center = middle + np.array([-shift[1], shift[0]]) / turn[0]
    else:
        center = middle + np.cross(turn, shift) / (turn @ turn)
    place = ", ".join(f"{x:.3g}" for x in center)
    if dim == 2:
        return f"about the point ({place})", float(np.abs(turn[0]))
    axis = ", ".join(f"{x:.3g}" for x in turn / np.abs(turn).max())
    return f"about an axis along ({axis}) through ({place})", float(np.linalg.norm(turn))
