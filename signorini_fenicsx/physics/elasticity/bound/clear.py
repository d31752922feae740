"""Facets of Γ_C that are open, and the gap far enough: there a number stands for the gap in the bound.

v has to stay off the foundation, so it need not know a gap that it does not come near. Where the stress has no pressure
on a facet, its part of the gap identity is 0 for any v with v_n ≤ g. So a number c ≤ g in the place of g does: with
u_n < c ≤ g the best v is as good, and what g is beyond c, which may be steep or large, is in no polynomial. c may not
be below v_n where that is given. A g that is a quadratic stays, unless its coefficients are below c.
"""

import basix.ufl
import numpy as np

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.linear_traces import opposite
from signorini_fenicsx.discrete.points import facet_lattice
from signorini_fenicsx.expressions.enclosures import surely_above
from signorini_fenicsx.physics.elasticity.discrete.boundary_nodes import (
    contact_coefficients,
    given_along_normals,
    given_nodes,
)
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces

PARTS = 4
"""Parts of the edges of facets, for the points in which the gap is looked at first."""

OF_V = 2
"""Degree of v."""


def floors(spaces: ElasticSpaces, data: ElasticData, pressure: Array, displacement: Array) -> Array:
    """A number on each facet of Γ_C between u_n and the gap, proved to be below it by `enclosures`; −∞ where none is.

    It is for contact alone, and gaps by texts; a gap that is one number needs none, and quadratics rarely (collective).

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
    given, least = _at_nodes(spaces, data)
    u_n = np.maximum(u_n, given)
    at, corners = (facet_lattice(spaces.mesh, contact.facets, parts) for parts in (PARTS, 1))
    wanted = (u_n + gap.values(at).min(axis=1)) / 2
    is_open = (pressure == 0).all(axis=1) & (wanted > u_n)
    if gap.polynomial is not None and gap.polynomial <= OF_V:
        is_open &= least < wanted
    for rows in (*(law.rows for law in data.laws.of_parts), *map(spaces.rows_of, spaces.pairs)):
        is_open[rows] = False
    raised = gap.values(corners)
    for mask, part in gap.by_facets(contact.facets):
        raises = (raised - part.values(corners)).min(axis=1)  # of tools, linear on each facet
        for tree, rows in part.trees_in(contact.cells):
            rows = rows[(is_open & mask)[rows]]
            low = wanted[rows] - raises[rows]
            sure = surely_above(tree, contact.vertices[rows], spaces.frame, low)
            found[rows[sure]] = wanted[rows[sure]]
    return found


def _at_nodes(spaces: ElasticSpaces, data: ElasticData) -> tuple[Array, Array]:
    """On each facet of Γ_C the largest v_n that is given at a node, −∞ for none, and the least coefficient of the gap.

    Collective.
    """
    bernstein, mesh = basix.LagrangeVariant.bernstein, spaces.split.mesh
    element = basix.ufl.element("P", mesh.basix_cell(), OF_V, bernstein, shape=(spaces.dim,))
    space = fenicsx.function_space(mesh, element)
    on, found = contact_coefficients(spaces, spaces.split, space), np.full((2, len(spaces.contact.facets)), -np.inf)
    given, _ = given_along_normals(on, given_nodes(spaces, data, spaces.split, space))
    found[0, on.rows] = given.max(axis=1, initial=-np.inf)
    found[1, on.rows] = on.of(spaces.mesh, data.gap).min(axis=1, initial=np.inf)
    return found[0], found[1]
