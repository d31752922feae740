"""The cells of a mesh, which are simplices, as NumPy arrays."""

from collections.abc import Iterator

import dolfinx.mesh
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.small_matrices import squares_of

type Entities = npt.NDArray[np.int32]

AT_ONCE = 32_768
"""Number of cells."""


def corners(mesh: dolfinx.mesh.Mesh, cells: Entities | slice = slice(None)) -> Array:
    """Vertices of cells of this rank, by default of all, shape (cells, dim + 1, dim)."""
    return mesh.geometry.x[mesh.geometry.dofmaps[0][cells], : mesh.topology.dim]


def arms(mesh: dolfinx.mesh.Mesh, cells: Entities | slice = slice(None)) -> Array:
    """Vertices of cells of this rank less their centroids, by default of all, shape (cells, dim + 1, dim)."""
    vertices = corners(mesh, cells)
    vertices -= np.einsum("cvi->ci", vertices)[:, None] / vertices.shape[1]
    return vertices


def some_at_a_time(mesh: dolfinx.mesh.Mesh) -> Iterator[slice]:
    """All cells of this rank, so many at a time that arrays of them stay in the cache of the processor."""
    number = len(mesh.geometry.dofmaps[0])
    return (slice(first, min(first + AT_ONCE, number)) for first in range(0, number, AT_ONCE))


def squared_arms(mesh: dolfinx.mesh.Mesh, matrix: Array) -> Array:
    """Y_v·By_v with y_v = x_v − x_T for the vertices v of each cell, shape (cells, dim + 1).

    B is a matrix per cell, or one for all.
    """
    squares, dim = np.empty(mesh.geometry.dofmaps[0].shape), mesh.topology.dim
    of_cells = np.broadcast_to(matrix, (len(squares), dim, dim))
    for some in some_at_a_time(mesh):
        squares[some] = squares_of(arms(mesh, some), of_cells[some])
    return squares


def mean_moments(squared: Array) -> Array:
    """Mean of (x − x_T)·B(x − x_T) over each cell: with `squared_arms` it is Σ_v y_v·By_v / ((d + 1)(d + 2))."""
    vertices = squared.shape[1]
    return np.asarray(np.einsum("cv->c", squared) / (vertices * (vertices + 1)))
