"""Rigid motions that nothing prevents: then an elastic contact problem has no solution, or many."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import gather_rows, on_root
from signorini_fenicsx.discrete.elastic_data import ElasticData, blocks_of_cells
from signorini_fenicsx.discrete.elastic_friction import STICKS
from signorini_fenicsx.discrete.elastic_problem import NORMAL
from signorini_fenicsx.discrete.elastic_spaces import ElasticSpaces
from signorini_fenicsx.discrete.johnson_mercier import Cells

type Moved = Callable[[Array], Array]

FREE = 1e-8
"""A motion of size 1 that moves what is given by less is free."""
SLACK = 1e-10
"""A load does no work on a motion if it does less than this share of what it could."""


def check_rigid_motions(spaces: ElasticSpaces, data: ElasticData) -> Array:
    """Make sure that each rigid motion is prevented, by what is given of u or by contact under the loads (collective).

    For a motion r that what is given of u lets free, and that does not go into the foundation, r_n ≤ 0 on Γ_C, the work
    of the loads must be negative, with friction less than ∫ g|r_t|: then contact holds the body against it. Coulomb's g
    is not known, and counts as ∞ here; if it is too small, no residual is small in the end.

    Returns:
        The motions that contact has to prevent, a basis: means of r_n at the sites, and of r_t at those with friction,
        shape (sites, motions).

    Raises:
        InputError: If a motion is not prevented; it is told.
    """
    low, high = spaces.domain.box()[:, : spaces.dim]
    middle, size = (low + high) / 2, float((high - low).max())

    def moved(x: Array) -> Array:
        """The basis of all rigid motions in points of shape (…, d): shape (…, d, motions)."""
        return _motions((x - middle) / size)

    free = _not_given(spaces, moved)
    if free.shape[1] == 0:
        return np.zeros((len(spaces.sites) + len(spaces.slip_sites), 0))
    work, most = _work(spaces, data, moved)
    work = work @ free / most
    into = np.einsum("nai,nair->nar", _at(spaces.contact.normals, spaces.dim), moved(spaces.contact.vertices)) @ free
    rough = spaces.rough
    along = np.einsum("nai,nair->nar", _at(spaces.tangents, spaces.dim), moved(rough.vertices)) @ free
    slips, shears = along.reshape(-1, free.shape[1]), np.empty(0)
    if data.friction is not None:
        shears = np.repeat(rough.measure, 2) / 2 * data.friction.bound.ravel() / most
    rows = gather_rows(spaces.mesh.comm, into.reshape(-1, free.shape[1]))
    rubbed = gather_rows(spaces.mesh.comm, np.column_stack([shears, slips]))

    def complain() -> None:
        assert rows is not None
        assert rubbed is not None
        found = _unprevented(np.unique(np.round(rows, 9), axis=0), work, rubbed[:, 1:], rubbed[:, 0])
        if found is not None:
            raise InputError(f"the body can move rigidly, {_in_words(free @ found, middle, size)}: {HELD_BY}")

    on_root(spaces.mesh.comm, complain)
    found = np.concatenate([into, along])
    means = (found + found.sum(axis=1, keepdims=True)) / (spaces.dim + 1)  # weighted by the hats
    return means.reshape(-1, free.shape[1])


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


def _unprevented(into: Array, work: Array, slips: Array, shears: Array) -> Array | None:
    """A motion r ≠ 0 with into·r ≤ 0 and work·r ≥ Σ shears |slips·r|, by linear programmes, or None.

    Where nothing slips the shear is infinite.
    """
    from scipy.optimize import linprog  # takes a second to load

    sticks, size = shears > STICKS / 1e100, len(work)
    stuck = np.unique(np.round(slips[sticks], 9), axis=0)
    slips, shears = slips[~sticks], shears[~sticks]
    own = np.eye(len(shears))  # variables behind r: bounds of |slips·r|
    rows = np.block(
        [
            [into, np.zeros((len(into), len(shears)))],
            [slips, -own],
            [-slips, -own],
            [-work[None], shears[None]],
        ]
    )
    limits = np.append(np.zeros(len(rows) - 1), SLACK)
    equal = None if len(stuck) == 0 else np.pad(stuck, ((0, 0), (0, len(shears))))
    bounds = [(-1, 1)] * size + [(0, None)] * len(shears)
    for k in range(size):
        for sign in (1.0, -1.0):
            objective = np.zeros(size + len(shears))
            objective[k] = -sign
            right = None if equal is None else np.zeros(len(equal))
            found = linprog(objective, A_ub=rows, b_ub=limits, A_eq=equal, b_eq=right, bounds=bounds)
            if found.success and -found.fun > 1e-6:
                return np.asarray(found.x[:size])
    return None


def _in_words(motion: Array, middle: Array, size: float) -> str:
    """A motion as a translation or a rotation."""
    dim = len(middle)
    shift, turn = motion[:dim], motion[dim:] / size
    along = ", ".join(f"{x:.3g}" for x in shift / max(np.abs(shift).max(), 1e-300))
    if np.abs(turn).max() * size < 1e-6 * np.abs(shift).max():
        return f"along ({along})"
    if dim == 2:
        center = middle + np.array([-shift[1], shift[0]]) / turn[0]
    else:
        center = middle + np.cross(turn, shift) / (turn @ turn)
    place = ", ".join(f"{x:.3g}" for x in center)
    if dim == 2:
        return f"about the point ({place})"
    axis = ", ".join(f"{x:.3g}" for x in turn / np.abs(turn).max())
    return f"about an axis along ({axis}) through ({place})"
