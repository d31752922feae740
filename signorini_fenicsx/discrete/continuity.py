"""Where data jump that should be continuous: between facets or cells that meet at a vertex, and inside of them."""

import basix
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import cell_dofs
from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.discrete.data_values import in_problem
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces, extreme_around
from signorini_fenicsx.discrete.points import CellPoints, Entities, Points, facet_lattice, from_within
from signorini_fenicsx.expressions import Tree, values

SHARE = 0.01
"""A difference at a vertex is a jump from this share of the extent of the values on."""
SAME = 1e-9
"""Jumps that differ by less than this share are equal."""
HALVINGS = 30, 10
"""So often the way from the middle of a simplex to a vertex is halved towards where the values differ most, and again:
what is then less than half of it is steep, what is more than twice as much is a pole, and no jump."""
AT_VERTEX = 1e-6
"""What is nearer to a vertex than this share of the way to it is at the vertex."""

NO_TRACE = "a function with this trace has no finite energy, and there is no bound of the error"
TIGHTER = "u obeys the tighter side, and its error falls slowly; a mesh with edges along the jump is best"
"""What follows for a u that is given, and for a bound of u."""

type Jump = tuple[float, tuple[float, ...]]
"""The size of a jump, 0 for none, and where it is."""


def facet_nodes(space: fem.FunctionSpace, facets: Entities) -> Entities:
    """Nodes of boundary facets in a space of linear or quadratic functions, shape (facets, nodes of a facet)."""
    points = facet_lattice(space.mesh, facets, 1)
    closures = np.array(space.element.basix_element.entity_closure_dofs[space.mesh.topology.dim - 1])
    return np.take_along_axis(space.dofmap.list[points.cells], closures[points.local], axis=1)


def jump_in_words(
    spaces: MeshSpaces, name: str, datum: Datum, entities: Entities, so: str, *, cells: bool = False
) -> list[str]:
    """One sentence on the largest jump of a datum that should be continuous, none if there is none (collective).

    Args:
        spaces: The spaces.
        name: The name of the datum.
        datum: A scalar.
        entities: Owned boundary facets, or owned cells.
        so: What follows.
        cells: Whether they are cells.
    """
    jump, place = largest_jump(spaces, datum, entities, cells=cells)
    return [f"{in_problem(name)}: jumps by {jump:.3g} at {place_in_words(place)}; {so}"] if jump > 0 else []


def largest_jump(spaces: MeshSpaces, datum: Datum, entities: Entities, *, cells: bool = False) -> Jump:
    """The largest difference of a scalar at a vertex of facets or cells, or inside one, and where it is (collective).

    At vertices the values are limits from inside, so that kinks, and roots that begin at a vertex, are no jumps. Inside
    only texts are looked at, on the ways from the middle to the vertices.

    Args:
        spaces: The spaces.
        datum: The scalar.
        entities: Owned boundary facets, or owned cells.
        cells: Whether they are cells.
    """
    mesh = spaces.mesh
    if datum.number is not None:
        return 0.0, ()
    space = fenicsx.function_space(mesh, ("P", 1))
    points: Points = facet_lattice(mesh, entities, 1)
    if cells:
        points = CellPoints(mesh, entities, basix.geometry(mesh.basix_cell()), np.empty(0))
    nodes = cell_dofs(space)[entities] if cells else facet_nodes(space, entities)
    limits = from_within(datum.values, points)
    high, low = (extreme_around(space, nodes, limits, largest=largest) for largest in (True, False))
    owned, met = space.dofmap.index_map.size_local, np.isfinite(high) & np.isfinite(low)
    differences: Array = np.where(met, high, 0.0)[:owned] - np.where(met, low, 0.0)[:owned]
    ends = mesh.comm.allgather((limits.max(initial=-np.inf), -limits.min(initial=np.inf)))
    extent = float(np.sum(np.max(ends, axis=0)))
    found = [(differences, space.tabulate_dof_coordinates()[:owned, : mesh.geometry.dim])]
    for mask, part in [(np.ones(len(entities), dtype=bool), datum)] if cells else datum.by_facets(entities):
        for tree, rows in part.trees_in(points.cells):
            rows = rows[mask[rows]]
            sizes, places = jumps_inside(tree, points.vertices[rows])
            found.append((sizes.ravel(), places.reshape(-1, mesh.geometry.dim)))
    most: Jump = 0.0, ()
    for sizes, places in found:
        if sizes.max(initial=0.0) > max(SHARE * extent, most[0]):
            equal = places[sizes >= (1 - SAME) * sizes.max()]  # of which the last one is told, on any number of ranks
            most = float(f"{sizes.max():.8g}"), max(tuple(place) for place in np.round(equal, 9).tolist())
    return max(mesh.comm.allgather(most))


def jumps_inside(tree: Tree, vertices: Array) -> tuple[Array, Array]:
    """The jump of a tree between the middle of each simplex and each of its vertices, 0 for none, and where it is.

    Shapes (n, vertices) and (n, vertices, dim). A value at the vertex alone is none.
    """
    shape = vertices.shape[:2]
    near = np.repeat(vertices.mean(axis=1), vertices.shape[1], axis=0)
    far, way = vertices.reshape(near.shape), vertices.reshape(near.shape) - near
    at_near, at_far = (values(tree, x[:, None])[:, 0] for x in (near, far))
    sizes = []
    for number in HALVINGS:
        for _ in range(number):
            middle = (near + far) / 2
            between = values(tree, middle[:, None])[:, 0]
            nearer = np.abs(between - at_near) > np.abs(at_far - between)
            far, at_far = np.where(nearer[:, None], middle, far), np.where(nearer, between, at_far)
            near, at_near = np.where(nearer[:, None], near, middle), np.where(nearer, at_near, between)
        sizes.append(np.nan_to_num(np.abs(at_far - at_near), nan=0.0, posinf=0.0))
    within = np.linalg.norm(vertices.reshape(near.shape) - far, axis=1) > AT_VERTEX * np.linalg.norm(way, axis=1)
    jumps = np.where(within & (sizes[1] > sizes[0] / 2) & (sizes[1] < 2 * sizes[0]), sizes[1], 0.0)
    return jumps.reshape(shape), far.reshape(vertices.shape)
