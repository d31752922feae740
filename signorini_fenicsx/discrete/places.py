"""Points that are the same on all ranks, and the owned cells in which they lie: where a solution is read off."""

from dataclasses import dataclass
from typing import Self

import dolfinx.geometry
import dolfinx.mesh
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.discrete.cell_shapes import Entities, corners, hat_gradients
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.sampling import AT_BOUNDARY


def shares_in(mesh: dolfinx.mesh.Mesh, x: Array, cells: Entities | slice) -> tuple[Array, Array]:
    """Barycentric coordinates of points in owned cells, and the gradients of these.

    Args:
        mesh: The mesh.
        x: A point for each cell, or one for all, shape (cells or 1, dim).
        cells: The cells.

    Returns:
        Shapes (cells, dim + 1) and (cells, dim + 1, dim).
    """
    gradients = hat_gradients(mesh, cells)
    shares = np.einsum("nvi,ni->nv", gradients, x - corners(mesh, cells)[:, 0])
    shares[:, 0] += 1
    return shares, gradients


@dataclass(frozen=True)
class Places:
    """Points, the same on all ranks, with the owned cells of a mesh around each, of which there may be several.

    Attributes:
        mesh: The mesh.
        points: The points, shape (n, dim).
        rows: The point of each pair of a point and a cell that has it.
        cells: The cell of each pair.
    """

    mesh: dolfinx.mesh.Mesh
    points: Array
    rows: Indices
    cells: Entities

    @classmethod
    def of(cls, domain: Domain, points: Array, mesh: dolfinx.mesh.Mesh | None = None) -> Self:
        """The places of points (collective).

        Args:
            domain: The domain.
            points: Shape (n, dim), the same on all ranks.
            mesh: A mesh of parts of its cells, if not its own.
        """
        mesh = domain.mesh if mesh is None else mesh
        padding, dim = AT_BOUNDARY * float(np.ptp(domain.box(), axis=0).max()), mesh.topology.dim
        rows, cells = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int32)
        if len(own := owned_cells(mesh)) and len(points):
            tree = dolfinx.geometry.bb_tree(mesh, dim, entities=own, padding=padding)
            near = dolfinx.geometry.compute_collisions_points(tree, np.pad(points, ((0, 0), (0, 3 - dim))))
            rows, cells = np.repeat(np.arange(len(points)), np.diff(near.offsets)), near.array
            shares, gradients = shares_in(mesh, points[rows], cells)
            inside = (shares >= -padding * np.linalg.norm(gradients, axis=2)).all(axis=1)
            rows, cells = rows[inside], cells[inside]
        return cls(mesh, points, rows, cells)

    def means(self, values: Array) -> Array:
        """Means over the cells around each point, of values for each pair; NaN where there is none (collective)."""
        values = np.asarray(values, dtype=np.float64).reshape(len(self.rows), -1)
        local = np.zeros((len(self.points), 1 + values.shape[1]))
        np.add.at(local, self.rows, np.column_stack([np.ones(len(self.rows)), values]))
        total = self.mesh.comm.allreduce(local)
        with np.errstate(invalid="ignore"):
            return np.asarray(total[:, 1:] / total[:, :1])

    def of_function(self, function: fem.Function) -> Array:
        """A function on this mesh with up-to-date ghost values, shape (n, *shape of a value) (collective)."""
        x = np.pad(self.points[self.rows], ((0, 0), (0, 3 - self.points.shape[1])))
        shape = function.ufl_shape
        values = function.eval(x, self.cells).reshape(len(x), -1) if len(x) else np.empty((0, 1))
        size = int(np.prod(shape))
        return self.means(values if len(x) else np.empty((0, size))).reshape(len(self.points), *shape)
