"""The mesh of the subcells into which the Johnson-Mercier element splits cells."""

from dataclasses import dataclass
from functools import cached_property

import dolfinx.mesh
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import cell_nodes, original_cells
from signorini_fenicsx.discrete.simplices import opposite
from signorini_fenicsx.meshes.domain import distribute


@dataclass(frozen=True)
class SplitMesh:
    """The mesh of the subcells of all cells or of some, on the ranks of their cells.

    Attributes:
        size: Number of all cells of the domain on this rank.
        mesh: The mesh.
        subcells: For each of its cells the number of the subcell: the cell's, times d + 1, plus the subcell's.
    """

    size: int
    mesh: dolfinx.mesh.Mesh
    subcells: Indices

    @cached_property
    def stresses(self) -> fem.FunctionSpace:
        """The space of the stresses (collective)."""
        dim = self.mesh.geometry.dim
        return fenicsx.function_space(self.mesh, ("DG", 1, (dim, dim)))

    @cached_property
    def cells(self) -> Indices:
        """The cell of this mesh for each subcell of the domain, shape (cells, d + 1); −1 where it has none."""
        numbers = np.full((self.size, self.mesh.geometry.dim + 1), -1)
        numbers.ravel()[self.subcells] = np.arange(len(self.subcells))
        return numbers

    def part(self, cells: Indices) -> "SplitMesh":
        """The subcells of some owned cells of the domain (collective)."""
        mine = np.sort(self.cells[cells].ravel()).astype(np.int32)
        mesh, entities = fenicsx.submesh(self.mesh, self.mesh.topology.dim, mine)
        owned = np.arange(len(mine), dtype=np.int32)
        return SplitMesh(self.size, mesh, self.subcells[entities.sub_topology_to_topology(owned, inverse=False)])

    def stress(self, values: Array) -> fem.Function:
        """The stress with these values at the vertices of the subcells, shape (cells, d + 1, d + 1, d, d)."""
        return self.function(self.stresses, values, "sigma")

    def function(self, space: fem.FunctionSpace, values: Array, name: str) -> fem.Function:
        """The linear function with these values at the vertices of the subcells, shape (cells, d + 1, d + 1, …)."""
        function = fem.Function(space, name=name)
        self.set_values(function, values)
        return function

    def set_values(self, function: fem.Function, values: Array) -> None:
        """Set a discontinuous linear function by its values at the vertices, shape (cells, d + 1, d + 1, …)."""
        space = function.function_space
        by_node = function.x.array.reshape(-1, *space.value_shape)
        by_node[space.dofmap.list] = values.reshape(-1, *values.shape[2:])[self.subcells]

    def values(self, function: fem.Function) -> Array:
        """Values at the vertices, shape (cells, d + 1, d + 1, …), of a discontinuous linear function on it."""
        shape = function.function_space.value_shape
        by_node = function.x.array.reshape(-1, *shape)[function.function_space.dofmap.list]
        in_order = np.empty_like(by_node)
        in_order[self.subcells] = by_node
        size = self.mesh.geometry.dim + 1
        return in_order.reshape(-1, size, size, *shape)


def split_mesh(mesh: dolfinx.mesh.Mesh, order: Indices, vertices: Array) -> SplitMesh:
    """Split all cells at their centroids (collective).

    Args:
        mesh: The mesh.
        order: Vertices of the owned cells in the order that the subcells have.
        vertices: Their coordinates, shape (cells, d + 1, d).
    """
    comm, dim = mesh.comm, mesh.topology.dim
    nodes, size = mesh.geometry.index_map(), len(order)
    begins = np.array(comm.allgather((nodes.local_range[0], size)))
    centroids_before = np.concatenate([[0], np.cumsum(begins[:, 1])])
    local = np.take_along_axis(cell_nodes(mesh), order, axis=1)
    numbers = nodes.local_to_global(local.ravel().astype(np.int32)).reshape(local.shape)
    numbers += centroids_before[np.searchsorted(begins[:, 0], numbers, side="right") - 1]
    first = nodes.local_range[1] + centroids_before[comm.rank]
    centroid = np.broadcast_to((first + np.arange(size))[:, None, None], (size, dim + 1, 1))
    cells = np.concatenate([numbers[:, opposite(dim)], centroid], axis=2).reshape(-1, dim + 1)
    points = np.concatenate([mesh.geometry.x[: nodes.size_local, :dim], vertices.mean(axis=1)])
    split = distribute(comm, points, cells, dim, stay=True)
    begin = split.topology.index_map(dim).local_range[0]
    return SplitMesh(size, split, original_cells(split) - begin)
