"""The mesh of pictures on rank 0: that of a solution, or a sample of it whose size does not grow with the mesh."""

from functools import cached_property

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_nodes, sums_at
from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.meshes.domain import facet_vertices

MOST_CELLS = {2: 30_000, 3: 150_000}
"""A mesh in the plane, or in space, with more cells than this is drawn by a sample of about as many."""
PER_BOX = {2: 2, 3: 8}
"""About how many cells of a sample there are for each of its vertices."""
FLAT = 1e-3
"""A cell of a sample whose volume is smaller than this, for edges of length 1, is left out."""


class Sample:
    """Cells and vertices for pictures, and the values there.

    In a large mesh all vertices within a box of a grid are replaced by one of them: the one that is farthest from the
    mean of the cells around it, so that boundaries stay in place. Cells whose corners are all in different boxes
    remain, one for each set of boxes. All facets of the boundary remain as they are. Nothing depends on the partition.

    Args:
        mesh: The mesh (collective).
        facets: The facets of this rank whose vertices remain.

    Attributes:
        ids: For each vertex its number in the mesh, ascending; on other ranks than 0 empty, like the two following.
        points: Shape (vertices, dim).
        cells: Rows of `points`, shape (cells, dim + 1).
        of: Number of cells of the mesh.
    """

    ids: Indices
    points: Array
    cells: Indices

    def __init__(self, mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32]) -> None:
        geometry, topology = mesh.geometry, mesh.topology
        self._mesh, self._dim = mesh, topology.dim
        self._dofs = cell_nodes(mesh)
        self._x = geometry.x[:, : self._dim]
        self.of = int(topology.index_map(self._dim).size_global)
        self.is_whole = self.of <= MOST_CELLS[self._dim]
        ids = geometry.input_global_indices
        box, urgent = (ids, np.zeros(len(ids))) if self.is_whole else self._boxes()
        self._choose_vertices(box, urgent, np.isin(ids, facet_vertices(mesh, facets)))
        self._choose_cells(box[self._dofs])

    def _boxes(self) -> tuple[Indices, Array]:
        """The box of each node of this rank, and how far from the mean of the cells around it is, in boxes."""
        comm, x = self._mesh.comm, self._x
        ends = np.concatenate([-x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)])
        comm.Allreduce(MPI.IN_PLACE, ends, MPI.MAX)
        low, high = -ends[: self._dim], ends[self._dim :]
        corners = x[self._dofs]
        volume = comm.allreduce(_volume(corners).sum())
        side = (volume * PER_BOX[self._dim] / MOST_CELLS[self._dim]) ** (1 / self._dim)
        side = (high - low).max() / max(round((high - low).max() / side), 1)  # without the rounding of the volume
        place = np.floor((x - low) / side + 1e-9).astype(np.int64)
        numbers = np.floor((high - low) / side + 1e-9).astype(np.int64) + 1
        centroids = np.repeat(corners.mean(axis=1, keepdims=True), self._dim + 1, axis=1)
        away = np.linalg.norm(self._around(centroids) - x, axis=1) / side
        return np.ravel_multi_index(tuple(place.T), tuple(numbers)), np.round(away, 6)

    def _choose_vertices(self, box: Indices, urgent: Array, kept: Mask) -> None:
        """One vertex of each box, the most urgent one, and those to be kept."""
        comm, x, ids = self._mesh.comm, self._x, self._mesh.geometry.input_global_indices
        first = _firsts(box, (*x.T[::-1], -urgent))
        self._nodes = np.union1d(first, np.flatnonzero(kept))
        columns = [box, ids, urgent, kept, x]
        rows = gather_rows(comm, np.column_stack([each[self._nodes] for each in columns]))
        if rows is None:
            self.ids, self.points = np.empty(0, dtype=np.int64), np.empty((0, self._dim))
            return
        boxes, numbers = rows[:, :2].astype(np.int64).T
        first = _firsts(boxes, (*rows[:, :3:-1].T, -rows[:, 2]))
        taken = np.union1d(first, np.flatnonzero(rows[:, 3]))
        self.ids, place = np.unique(numbers[taken], return_index=True)
        self._taken = taken[place]
        self.points = rows[self._taken, 4:]
        self._boxes_with_rows = boxes[first], np.searchsorted(self.ids, numbers[first])

    def _choose_cells(self, boxes: Indices) -> None:
        """The cells whose corners are in different boxes, one for each set of boxes; in the whole mesh all."""
        comm = self._mesh.comm
        centroids = np.sort(self._x[self._dofs], axis=1).mean(axis=1)  # whatever the order of the corners
        apart = (np.diff(np.sort(boxes, axis=1), axis=1) > 0).all(axis=1)
        chosen = np.flatnonzero(apart)
        self._local = chosen if self.is_whole else chosen[_different(boxes[chosen], centroids[chosen])]
        numbers, middles = gather_rows(comm, boxes[self._local]), gather_rows(comm, centroids[self._local])
        if numbers is None or middles is None:
            self.cells = np.empty((0, self._dim + 1), dtype=np.int64)
            return
        named, rows = self._boxes_with_rows
        self.cells = rows[np.searchsorted(named, numbers)]
        if self.is_whole:
            self._order = np.lexsort(middles.T[::-1])
        else:
            self._order = _different(numbers, middles)
            corners = self.points[self.cells[self._order]]
            edges = np.linalg.norm(corners[:, 1:] - corners[:, :1], axis=2).max(axis=1)
            self._order = self._order[_volume(corners) > FLAT * edges**self._dim]
        self.cells = self.cells[self._order]

    def in_cells[V: np.generic](self, values: npt.NDArray[V]) -> npt.NDArray[V] | None:
        """Values of the cells of this rank as values of the cells of the sample; None on other ranks (collective)."""
        rows = gather_rows(self._mesh.comm, values[self._local])
        return None if rows is None else rows[self._order]

    def at_points(self, values: Array) -> Array | None:
        """Means over the cells around each vertex of the sample; None on other ranks (collective).

        Args:
            values: For each corner of each cell of this rank, in the order of the geometry, shape (cells, dim + 1, k).
        """
        rows = gather_rows(self._mesh.comm, self._around(values)[self._nodes])
        return None if rows is None else rows[self._taken]

    def rows_of(self, ids: Indices) -> Indices:
        """Rows of `points`, by the numbers in the mesh (rank 0)."""
        return np.searchsorted(self.ids, ids)

    @cached_property
    def _around(self) -> "MeansAround":
        return MeansAround(self._mesh, self._dofs)


class MeansAround:
    """The mean over the cells around each node of this rank, of values at the vertices of these cells.

    Args:
        mesh: The mesh.
        nodes: The nodes at the vertices of the owned cells, in the order of the values (collective).
    """

    def __init__(self, mesh: dolfinx.mesh.Mesh, nodes: npt.NDArray[np.integer]) -> None:
        self._numbers, self._nodes = mesh.geometry.index_map(), nodes
        self._count = sums_at(self._numbers, nodes)[:, None]

    def __call__(self, values: Array) -> Array:
        """The means, shape (nodes, k), of values of shape (cells, dim + 1, k) (collective)."""
        return np.asarray(sums_at(self._numbers, self._nodes, values) / self._count)


def _firsts(groups: Indices, keys: tuple[Array, ...]) -> Indices:
    """The row of each group that is first by the keys, the last of which counts most; ascending by group."""
    order = np.lexsort((*keys, groups))
    return order[np.diff(groups[order], prepend=-1) != 0]


def _different(boxes: Indices, middles: Array) -> Indices:
    """One row for each set of boxes, the first one by its middle."""
    corners = np.sort(boxes, axis=1)
    order = np.lexsort((*middles.T[::-1], *corners.T))
    new = np.ones(len(order), dtype=bool)
    new[1:] = (np.diff(corners[order], axis=0) != 0).any(axis=1)
    return order[new]


def _volume(corners: Array) -> Array:
    """The measures of simplices."""
    return np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / (2 if corners.shape[2] == 2 else 6)
