"""The cells of a mesh, which are simplices, as NumPy arrays."""

import dolfinx.mesh
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.small_matrices import squares_of

type Entities = npt.NDArray[np.int32]


def corners(mesh: dolfinx.mesh.Mesh, cells: Entities | slice = slice(None)) -> Array:
    """Vertices of cells of this rank, by default of all, shape (cells, dim + 1, dim)."""
    return mesh.geometry.x[mesh.geometry.dofmaps[0][cells], : mesh.topology.dim]


def arms(mesh: dolfinx.mesh.Mesh) -> Array:
    """Vertices of all cells of this rank less their centroids, shape (cells, dim + 1, dim)."""
    vertices = corners(mesh)
    vertices -= np.einsum("cvi->ci", vertices)[:, None] / vertices.shape[1]
    return vertices


def mean_moments(mesh: dolfinx.mesh.Mesh, matrix: Array) -> Array:
    """Mean of (x − x_T)·B(x − x_T) over each cell of this rank, for a matrix B per cell, or one for all.

    With y_v = x_v − x_T for the vertices v of T it is Σ_v y_v·By_v / ((d + 1)(d + 2)).
    """
    squares, dim = squares_of(arms(mesh), matrix), mesh.topology.dim
    return np.asarray(np.einsum("cv->c", squares) / ((dim + 1) * (dim + 2)))
