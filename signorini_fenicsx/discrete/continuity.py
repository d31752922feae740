"""Where data jump that should be continuous: between two facets that meet at a vertex."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces, extreme_around
from signorini_fenicsx.discrete.points import Entities, facet_lattice, from_within

SHARE = 0.01
"""A difference at a vertex is a jump from this share of the extent of the values on."""


def facet_nodes(space: fem.FunctionSpace, facets: Entities) -> Entities:
    """Nodes of boundary facets in a space of linear or quadratic functions, shape (facets, nodes of a facet)."""
    points = facet_lattice(space.mesh, facets, 1)
    closures = np.array(space.element.basix_element.entity_closure_dofs[space.mesh.topology.dim - 1])
    return np.take_along_axis(space.dofmap.list[points.cells], closures[points.local], axis=1)


def largest_jump(spaces: MeshSpaces, datum: Datum, facets: Entities) -> tuple[float, tuple[float, ...]]:
    """The largest difference of a scalar between facets that meet at a vertex, and where it is (collective).

    The values are limits from inside the facets, so that kinks, and roots that begin at a vertex, are no jumps. A jump
    inside a facet is not seen.

    Returns:
        The difference, 0 if it is no jump, and the vertex.
    """
    mesh = spaces.mesh
    if datum.number is not None:
        return 0.0, ()
    space = fenicsx.function_space(mesh, ("P", 1))
    limits, nodes = from_within(datum.values, facet_lattice(mesh, facets, 1)), facet_nodes(space, facets)
    high, low = (extreme_around(space, nodes, limits, largest=largest) for largest in (True, False))
    own, met = space.dofmap.index_map.size_local, np.isfinite(high) & np.isfinite(low)
    differences: Array = np.where(met, high, 0.0)[:own] - np.where(met, low, 0.0)[:own]
    ends = mesh.comm.allgather((limits.max(initial=-np.inf), -limits.min(initial=np.inf)))
    extent = float(np.sum(np.max(ends, axis=0)))
    most: tuple[float, tuple[float, ...]] = (0.0, ())
    if differences.max(initial=0.0) > SHARE * extent:
        worst = int(np.argmax(differences))
        place = space.tabulate_dof_coordinates()[worst, : mesh.geometry.dim]
        most = float(differences[worst]), tuple(place.tolist())
    return max(mesh.comm.allgather(most))
