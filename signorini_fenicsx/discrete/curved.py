"""Parts of the boundary that are curved, of which a mesh has the polygon or polyhedron."""

import numpy as np

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.discrete.continuity import facet_nodes
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces, extreme_around
from signorini_fenicsx.discrete.points import facet_lattice
from signorini_fenicsx.meshes.domain import other_side

BEND = 1e-6, 0.8
"""Facets that meet at a vertex bend there as on a curve if their normals differ by an angle between these."""
MOST = 0.5
"""A part is curved if facets bend so at more than this share of the vertices between them."""


def curved_parts(spaces: MeshSpaces) -> list[str]:
    """The parts whose facets bend a bit at most of their vertices, as those of a curved one do (collective).

    Of a mesh from a file only the facets are known: a polygon with one facet on each of many sides counts as curved.
    """
    mesh, facets_of = spaces.mesh, spaces.domain.facets
    space, dim, names = fenicsx.function_space(mesh, ("P", 1)), mesh.geometry.dim, []
    size = space.dofmap.index_map.size_local
    for name in (name for name in facets_of if name not in map(other_side, facets_of)):
        facets = facets_of[name]
        points, nodes = facet_lattice(mesh, facets, 1), facet_nodes(space, facets)
        edges = points.vertices[:, 1:] - points.vertices[:, :1]
        normals = np.linalg.svd(edges)[2][:, -1]  # either of both directions
        squares = np.einsum("ni,nj->nij", normals, normals)
        bends = np.zeros(size)
        for i, j in zip(*np.triu_indices(dim), strict=True):
            product = np.repeat(squares[:, i, j, None], nodes.shape[1], axis=1)
            high, low = (extreme_around(space, nodes, product, largest=largest)[:size] for largest in (True, False))
            bends = np.maximum(bends, np.where(np.isfinite(high), high, 0.0) - np.where(np.isfinite(low), low, 0.0))
        on_part, least, most = np.isfinite(high), *BEND
        counts = np.array([((bends > least) & (bends < most)).sum(), on_part.sum()])
        bent, everything = mesh.comm.allreduce(counts).tolist()
        if bent > MOST * everything:
            names.append(name)
    return names


def of_polygon(spaces: MeshSpaces) -> list[str]:
    """One sentence if parts are curved, none otherwise (collective)."""
    if not (names := curved_parts(spaces)):
        return []
    which, polygon = ", ".join(names), {2: "polygon", 3: "polyhedron"}[spaces.mesh.geometry.dim]
    return [f"curved parts ({which}): solution, bounds and intervals are those of the {polygon} that the mesh covers"]
