"""Elastic supports of parts of Γ_N.

A support is a part whose traction is σn = g_N − Ku with a stiffness K per area, symmetric and without negative
eigenvalues: springs that push and pull along n, across it, or both. Its energy ½∫ Ku·u is added. On a facet K is
constant and û linear, and so is σn. What û is there follows from σn, but for what K does not hold.

In the gap identity of `forms/elasticity.py` −y n = Kw − g_N with some w, and a support adds

    ½∫ K(v − w)·(v − w)

to the right side, and on the left the same of (v, u) and of (u, w): twice (v − u)·(σ − y)n = (v − u)·K(w − u) is what
these two leave of it. For y = σ_h, w is û.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tolerances import ROUNDING
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, linear_values
from signorini_fenicsx.expressions.given import number_of, parsed
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
    """

    facets: BoundaryFacets
    stiffness: Array

    @property
    def masses(self) -> Array:
        """∫ Kq·q' for the hats of each vertex and component of q and q', shape (facets, d², d²)."""
        dim = self.stiffness.shape[1]
        hats = (1 + np.eye(dim)) / (dim * (dim + 1))
        masses = np.einsum("n,ab,nij->naibj", self.facets.measure, hats, self.stiffness)
        return np.asarray(masses.reshape(-1, dim**2, dim**2))

    @property
    def share(self) -> Array:
        """K over its largest eigenvalue, shape (facets, d, d)."""
        return self.stiffness / np.linalg.norm(self.stiffness, 2, axis=(1, 2))[:, None, None]

    def moved(self, spaces: ElasticSpaces, tractions: Array, stresses: Array) -> Array:
        """The w at the vertices from tractions and a stress, 0 where K does not hold it, shape (facets, d, d).

        Args:
            spaces: The spaces.
            tractions: ∫ g_N φ_a over the facets of `spaces.neumann`.
            stresses: Values of σ as in `SplitMesh.values`.
        """
        rows = np.searchsorted(spaces.neumann.facets, self.facets.facets)
        pulls = linear_values(tractions[rows], self.facets.measure)
        softness = np.linalg.pinv(self.stiffness, rcond=HELD, hermitian=True)
        return np.einsum("nij,naj->nai", softness, pulls - spaces.tractions(self.facets, stresses))

    def let_go(self, values: Array) -> Array:
        """Values on the facets, without their components that K holds."""
        held = np.linalg.pinv(self.stiffness, rcond=HELD, hermitian=True) @ self.stiffness
        return values - np.einsum("nij,naj->nai", held, values)


def supports_of(spaces: ElasticSpaces, given: Mapping[str, GivenStiffness]) -> Supports:
    """The supports of a problem.

    Raises:
        InputError: If a part is not in Γ_N, or a stiffness is not numbers, symmetric, and of no negative eigenvalue.
    """
    supports = [np.zeros((0, spaces.dim, spaces.dim))]
    numbers = [np.zeros(0, dtype=np.int32)]
    for part, value in given.items():
        name = f"[problem] support.{part}"
        if part not in spaces.boundary.neumann:
            raise InputError(f"{name}: a support is on a part in neumann")
        facets = spaces.part(part)
        numbers.append(facets.facets)
        supports.append(_stiffness(name, parsed(value, "xyz"[: spaces.dim], name), facets.normals))
    all_numbers, stiffness = np.concatenate(numbers), np.concatenate(supports)
    order = np.argsort(all_numbers)
    return Supports(spaces.boundary_facets(all_numbers[order]), stiffness[order])


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
