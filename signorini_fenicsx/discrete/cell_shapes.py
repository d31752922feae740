"""The cells of a mesh, which are simplices, as NumPy arrays.

The entries of one kind, such as the first coordinates of all first vertices, are one after the other in memory, as
`base/arrays.py` has them.
"""

from collections.abc import Iterator

import dolfinx.mesh
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, inverses, squares_of
from signorini_fenicsx.base.owned import cell_nodes

type Entities = npt.NDArray[np.int32]

AT_ONCE = 8_192
"""Number of cells."""


def corners(mesh: dolfinx.mesh.Mesh, cells: Entities | slice = slice(None)) -> Array:
    """Vertices of owned cells, by default of all, shape (cells, dim + 1, dim)."""
    x, nodes, dim = mesh.geometry.x, cell_nodes(mesh)[cells], mesh.topology.dim
    corners_of_cells = np.empty((*nodes.shape, dim), order="F")
    for vertex, of_vertex in enumerate(nodes.T):
        corners_of_cells[:, vertex] = x.take(of_vertex, axis=0)[:, :dim]  # far faster than x[of_vertex]
    return corners_of_cells


def facet_corners(mesh: dolfinx.mesh.Mesh, facets: Entities) -> Array:
    """Vertices of facets of this rank, shape (facets, dim, dim)."""
    dim = mesh.topology.dim
    nodes = dolfinx.mesh.entities_to_geometry(mesh, dim - 1, facets) if len(facets) else np.empty((0, dim), np.int32)
    return np.array(mesh.geometry.x[nodes, :dim])


def arms(mesh: dolfinx.mesh.Mesh, cells: Entities | slice = slice(None)) -> Array:
    """Vertices of owned cells less their centroids, by default of all, shape (cells, dim + 1, dim)."""
    vertices = corners(mesh, cells)
    vertices -= vertices[:, :1].copy(order="F")  # of coordinates that are far from 0 the mean would be rounded
    vertices -= np.einsum("cvi->ci", vertices)[:, None] / vertices.shape[1]
    return vertices


def hat_gradients(mesh: dolfinx.mesh.Mesh, cells: Entities | slice = slice(None)) -> Array:
    """Gradients of the barycentric coordinates of owned cells, by default all, shape (cells, dim + 1, dim)."""
    x = corners(mesh, cells)
    inverse = inverses((x[:, 1:] - x[:, :1]).transpose(0, 2, 1))
    return np.concatenate([-np.einsum("cvi->ci", inverse)[:, None], inverse], axis=1)


def nearest(places: Array, among: Array) -> npt.NDArray[np.intp]:
    """Which of some places is the nearest one, for each place on the same facet or cell, shape (…, places)."""
    return np.square(places[..., :, None, :] - among[..., None, :, :]).sum(axis=-1).argmin(axis=-1)


def some_at_a_time(mesh: dolfinx.mesh.Mesh) -> Iterator[slice]:
    """All owned cells, so many at a time that arrays of them stay in the cache of the processor."""
    number = len(cell_nodes(mesh))
    return (slice(first, min(first + AT_ONCE, number)) for first in range(0, number, AT_ONCE))


def squared_arms(mesh: dolfinx.mesh.Mesh, matrix: Array) -> Array:
    """The products y_v·By_v with y_v = x_v − x_T for the vertices v of each cell, shape (cells, dim + 1).

    B is a matrix per cell, or one for all.
    """
    squares, dim = np.empty(cell_nodes(mesh).shape, order="F"), mesh.topology.dim
    of_cells = np.broadcast_to(matrix, (len(squares), dim, dim))
    for some in some_at_a_time(mesh):
        squares[some] = squares_of(arms(mesh, some), of_cells[some])
    return squares


def mean_moments(squared: Array) -> Array:
    """Mean of (x − x_T)·B(x − x_T) over each cell: with `squared_arms` it is Σ_v y_v·By_v / ((d + 1)(d + 2))."""
    vertices = squared.shape[1]
    return np.asarray(np.einsum("cv->c", squared) / (vertices * (vertices + 1)))
