"""Elastic supports of parts of Γ_N, and of walls on which a fluid slips.

A support is a part whose traction is σn = g_N − Ku with a stiffness K per area, symmetric and without negative
eigenvalues: springs that push and pull along n, across it, or both. Its energy ½∫ Ku·u is added. On a facet K is
constant and û linear, and so is σn. What û is there follows from σn, but for what K does not hold.

On a wall with slip K is β across n. Friction there is −σ_t − β(u_t − w), with the velocity w of the wall; the springs
pull on what of û_t the unknowns have, which is that without w.

In the gap identity of `forms/elasticity.py` −y n = Kw − g_N with some w, and a support adds

    ½∫ K(v − w)·(v − w)

to the right side, and on the left the same of (v, u) and of (u, w): twice (v − u)·(σ − y)n = (v − u)·K(w − u) is what
these two leave of it. For y = σ_h, w is û.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tolerances import ROUNDING
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, linear_from_means, linear_values
from signorini_fenicsx.expressions.given import number_of, parsed
from signorini_fenicsx.meshes.paired_parts import without_law
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.problem import GivenStiffness

HELD = 1e-12
"""Directions in which a stiffness is less than this share of its largest are not held."""


@dataclass(frozen=True)
class Supports:
    """The elastic supports.

    Attributes:
        facets: Their facets.
        stiffness: K on each of them, shape (facets, d, d).
        frames: The values at the vertices that their unknowns stand for, see `ElasticSpaces.frames`.
        slip: β on each facet with friction, in the order of `ElasticSpaces.rough`.
    """

    facets: BoundaryFacets
    stiffness: Array
    frames: Array
    slip: Array

    @property
    def masses(self) -> Array:
        """∫ Kq·q' for all pairs of unknowns q and q' of each facet, shape (facets, d², d²)."""
        dim = self.stiffness.shape[1]
        hats = (1 + np.eye(dim)) / (dim * (dim + 1))
        masses = np.einsum("n,ab,nij->naibj", self.facets.measure, hats, self.stiffness).reshape(-1, dim**2, dim**2)
        return np.asarray(self.frames.swapaxes(1, 2) @ masses @ self.frames)

    def of_slip(self, slip: Array) -> Array:
        """What the springs of walls add to σ_t at the sites with friction, from the means of u_t − w there."""
        dim = self.stiffness.shape[1]
        rows = slip.reshape(-1, dim, dim - 1)
        return np.asarray((self.slip[:, None, None] * linear_from_means(rows)).ravel())

    @property
    def share(self) -> Array:
        """K over its largest eigenvalue, shape (facets, d, d)."""
        return self.stiffness / np.linalg.norm(self.stiffness, 2, axis=(1, 2))[:, None, None]

    def moved(self, spaces: ElasticSpaces, tractions: Array, stresses: Array, on_walls: Array) -> Array:
        """The w at the vertices from tractions and a stress, 0 where K does not hold it, shape (facets, d, d).

        Args:
            spaces: The spaces.
            tractions: ∫ g_N φ_a over the facets of `spaces.neumann`.
            stresses: Values of σ as in `SplitMesh.values`.
            on_walls: The tractions at the vertices of the facets with friction, shape (facets, d, d).
        """
        walls, rows = self.walls(spaces)
        loaded, pulls = np.flatnonzero(~walls), np.empty((len(walls), *on_walls.shape[1:]))
        at = np.searchsorted(spaces.neumann.facets, self.facets.facets[loaded])
        pulls[loaded], pulls[walls] = linear_values(tractions[at], self.facets.measure[loaded]), on_walls[rows]
        softness = np.linalg.pinv(self.stiffness, rcond=HELD, hermitian=True)
        return np.einsum("nij,naj->nai", softness, pulls - spaces.tractions(self.facets, stresses))

    def walls(self, spaces: ElasticSpaces) -> tuple[Mask, Indices]:
        """Mask of the facets that are on walls with slip, and which of `ElasticSpaces.rough` these are."""
        walls = np.isin(self.facets.facets, spaces.rough.facets)
        return walls, np.searchsorted(spaces.rough.facets, self.facets.facets[walls])

    def let_go(self, values: Array) -> Array:
        """Values on the facets, without their components that K holds."""
        held = np.linalg.pinv(self.stiffness, rcond=HELD, hermitian=True) @ self.stiffness
        return values - np.einsum("nij,naj->nai", held, values)


def supports_of(spaces: ElasticSpaces, given: Mapping[str, GivenStiffness]) -> Supports:
    """The supports of a problem.

    Raises:
        InputError: If a part is not in Γ_N, or a stiffness is not numbers, symmetric, and of no negative eigenvalue.
    """
    dim, boundary = spaces.dim, spaces.boundary
    supports, frames = [np.zeros((0, dim, dim))], [np.zeros((0, dim**2, dim**2))]
    numbers, slip = [np.zeros(0, dtype=np.int32)], np.zeros(len(spaces.rough.facets))
    for part, value in given.items():
        walls = part in boundary.turned and part not in boundary.neumann
        name = f"slip on '{part}', beta" if walls else f"[problem] support.{part}"
        if not walls and (part not in boundary.neumann or part in without_law(boundary.pairs)):
            raise InputError(f"{name}: a support is on a part in neumann, which is in no pair")
        facets = spaces.part(part)
        numbers.append(facets.facets)
        supports.append(_stiffness(name, parsed(value, "xyz"[:dim], name), facets.normals))
        frames.append(np.tile(np.eye(dim**2), (len(facets.facets), 1, 1)))
        if walls:
            frames[-1] = spaces.frames[0][1][np.searchsorted(spaces.contact.facets, facets.facets)]
            along = np.einsum("nii->n", supports[-1]) / (dim - 1)
            slip[np.searchsorted(spaces.rough.facets, facets.facets)] = along
    all_numbers = np.concatenate(numbers)
    order = np.argsort(all_numbers)
    stiffness, all_frames = np.concatenate(supports)[order], np.concatenate(frames)[order]
    return Supports(spaces.boundary_facets(all_numbers[order]), stiffness, all_frames, slip)


def _stiffness(name: str, given: Any, normals: Array) -> Array:
    """K on facets with these normals.

    Raises:
        InputError: See `supports_of`.
    """
    dim = normals.shape[1]
    across = np.einsum("ni,nj->nij", normals, normals)
    if not isinstance(given, list):
        along = beside = number_of(name, given)
    elif len(given) == 2 and not any(isinstance(entry, list) for entry in given):
        along, beside = (number_of(name, entry) for entry in given)
    else:
        rows = [[number_of(name, entry) for entry in row] if isinstance(row, list) else [] for row in given]
        if len(rows) != dim or any(len(row) != dim for row in rows):
            raise InputError(f"{name}: must be a number, two along n and across it, or a matrix of {dim} rows of {dim}")
        matrix = np.array(rows)
        least, *_, largest = np.linalg.eigvalsh(matrix)
        skew = np.abs(matrix - matrix.T).max()
        if skew > ROUNDING * np.abs(matrix).max() or least < -HELD * largest or largest <= 0:
            raise InputError(f"{name}: must be symmetric and not 0, with no negative eigenvalue")
        return np.broadcast_to((matrix + matrix.T) / 2, (len(normals), dim, dim))
    if min(along, beside) < 0 or max(along, beside) == 0:
        raise InputError(f"{name}: must not be negative, and not 0 in all directions")
    return np.asarray((along - beside) * across + beside * np.eye(dim))
