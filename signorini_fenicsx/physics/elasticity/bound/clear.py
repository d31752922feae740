"""Facets of Γ_C that are open, and the gap far enough: there a number stands for the gap in the bound.

v has to stay off the foundation, so it need not know a gap that it does not come near. Where the stress has no pressure
on a facet, its part of the gap identity is 0 for any v with v_n ≤ g. So a number c ≤ g in the place of g does: with
u_n < c ≤ g the best v is as good, and what g is beyond c, which may be steep or large, is in no polynomial.
"""

from __future__ import annotations

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.points import facet_lattice
from signorini_fenicsx.expressions import TREES
from signorini_fenicsx.expressions.enclosures import surely_above
from signorini_fenicsx.physics.elasticity.data import ElasticData
from signorini_fenicsx.physics.elasticity.johnson_mercier import opposite
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces

PARTS = 4
"""Parts of the edges of facets, for the points in which the gap is looked at first."""


def floors(spaces: ElasticSpaces, data: ElasticData, pressure: Array, displacement: Array) -> Array:
    """A number on each facet of Γ_C between u_n and the gap, proved to be below it by `enclosures`; −∞ where none is.

    It is for contact alone, and gaps by texts; a gap that is one number needs none (collective).

    Args:
        spaces: The spaces.
        data: The data.
        pressure: −y_nn at the vertices of the facets, shape (facets, d).
        displacement: u at the vertices of the cells, shape (cells, d + 1, d).
    """
    contact, inner, across, gap = spaces.contact, spaces.inner.rows, spaces.across, data.gap
    found = np.full(len(contact.facets), -np.inf)
    if gap.polynomial == 0:
        return found
    behind = opposite(spaces.dim)
    u = displacement[contact.cells[:, None], behind[contact.local]]
    u_n = np.einsum("nai,ni->na", u, contact.normals).max(axis=1)
    other = displacement[across.cells[:, None], behind[across.local]]
    u_n[inner] -= np.einsum("nai,ni->na", other, contact.normals[inner]).min(axis=1)
    at, corners = (facet_lattice(spaces.mesh, contact.facets, parts) for parts in (PARTS, 1))
    wanted = (u_n + gap.values(at).min(axis=1)) / 2
    is_open = (pressure == 0).all(axis=1) & (wanted > u_n)
    for law in data.laws.of_parts:
        is_open[law.rows] = False
    raised = gap.values(corners)
    for mask, part in gap.by_facets(contact.facets):
        raises = (raised - part.values(corners)).min(axis=1)  # of tools, linear on each facet
        for tree, inside in part.pieces or ():
            assert isinstance(tree, TREES)
            rows = np.flatnonzero(is_open & mask & (True if inside is None else inside[contact.cells]))
            low = wanted[rows] - raises[rows]
            sure = surely_above(tree, contact.vertices[rows], spaces.frame, low)
            found[rows[sure]] = wanted[rows[sure]]
    return found
