"""Simplices by their vertices, in batches: their maps from the reference cell, normals, measures.

Facet i of a cell is opposite to its vertex i, and its vertices are in the order of those of the cell.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import factorial

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import number_of_cells

BLOCK = {2: 4096, 3: 512}
"""Cells, by dimension, whose values are held at a time: some tens of megabytes."""


def opposite(dim: int) -> Indices:
    """Vertices of each facet of a simplex, ascending: shape (d + 1, d)."""
    return np.array([[k for k in range(dim + 1) if k != i] for i in range(dim + 1)])


def facet_normals(vertices: Array) -> Array:
    """|e| n for the facet opposite to each vertex, n pointing outwards, shape (cells, d + 1, d)."""
    dim = vertices.shape[2]
    edges = vertices[:, 1:] - vertices[:, :1]
    gradients = np.linalg.inv(edges).transpose(0, 2, 1)
    gradients = np.concatenate([-gradients.sum(axis=1, keepdims=True), gradients], axis=1)
    measures = np.abs(np.linalg.det(edges)) / factorial(dim)
    return -dim * measures[:, None, None] * gradients


def null_space(matrix: Array) -> Array:
    """An orthonormal basis of the vectors that a matrix maps to 0, as columns; as SciPy's, which is slow to load."""
    _, sizes, vectors = np.linalg.svd(matrix)
    rank = int(np.count_nonzero(sizes > 1e-10 * sizes.max(initial=0.0)))
    return vectors[rank:].T


@dataclass(frozen=True)
class Simplices:
    """Some cells by their vertices.

    Attributes:
        vertices: Shape (cells, d + 1, d).
    """

    vertices: Array

    @property
    def dim(self) -> int:
        """The dimension d."""
        return int(self.vertices.shape[2])

    @cached_property
    def derivative(self) -> Array:
        """F, shape (cells, d, d)."""
        return (self.vertices[:, 1:] - self.vertices[:, :1]).transpose(0, 2, 1)

    @cached_property
    def determinant(self) -> Array:
        """|det F|."""
        return np.abs(np.linalg.det(self.derivative))

    @cached_property
    def measure(self) -> Array:
        """|T|."""
        return self.determinant / factorial(self.dim)


def blocks_of_cells(mesh: dolfinx.mesh.Mesh) -> Iterator[npt.NDArray[np.int32]]:
    """The owned cells, so many at a time and equally often on all ranks (collective)."""
    size = number_of_cells(mesh)
    parts = max(mesh.comm.allreduce(-(-size // BLOCK[mesh.topology.dim]), MPI.MAX), 1)
    yield from np.array_split(np.arange(size, dtype=np.int32), parts)
