"""The flux through a section of the domain: a polyline in the plane, or a plane in space, integrated cell by cell.

σ_h·n is a polynomial in each cell, so that the integral over what a cell cuts out of the section is exact, and as ∇·σ_h
is an ordinary function, what flows through a closed section is ∫∇·σ_h inside, to rounding. Where the section follows
facets, both cells have them: each counts with one over the number of those that cover it.

*Points that are the same on all ranks, and the owned cells in which they lie*: where a solution is read off.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import dolfinx.geometry
import dolfinx.mesh
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.base.rows import in_digits
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
class Spots:
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
        if len(owned := owned_cells(mesh)) and len(points):
            tree = dolfinx.geometry.bb_tree(mesh, dim, entities=owned, padding=padding)
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


GAUSS = 0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)
"""Two points on an interval, by which the integral of a cubic is exact."""
MIDDLES = np.array([[0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]])
"""Three points on a triangle, by which that of a quadratic is."""
PIECES = {
    **{(1, 0, 2): [[(0, 1), (0, 2)]], (2, 0, 1): [[(0, 2), (1, 2)]]},
    **{(1, 0, 3): [[(0, 1), (0, 2), (0, 3)]], (3, 0, 1): [[(0, 3), (1, 3), (2, 3)]]},
    (2, 0, 2): [[(0, 2), (0, 3), (1, 3)], [(0, 2), (1, 3), (1, 2)]],
    **{(1, 1, 2): [[(1, 1), (0, 2), (0, 3)]], (2, 1, 1): [[(2, 2), (0, 3), (1, 3)]]},
    **{(1, 2, 1): [[(1, 1), (2, 2), (0, 3)]]},
    **{(0, 3, 1): [[(0, 0), (1, 1), (2, 2)]], (1, 3, 0): [[(1, 1), (2, 2), (3, 3)]]},
}
"""What a plane cuts out of a tetrahedron with so many vertices below, on and above it, in this order: triangles whose
corners are on edges between two of these, or are a vertex. Of a triangle between vertices a line with such ends."""


class Through(NamedTuple):
    """What passes a section.

    Attributes:
        flux: ∫σ_h·n over it: a number, of a stress the force, shape (dim,).
        measure: Its length or area inside the domain.
    """

    flux: Array
    measure: float


@dataclass(frozen=True)
class Profile:
    """A polyline in the plane, or a plane in space, the same on all ranks.

    Attributes:
        points: The points of the polyline, shape (n, 2); in space one point of the plane, shape (1, 3). The normal
            points to the right of who walks along the polyline, so outwards if it is closed, anticlockwise.
        normal: The normal of the plane, of any length; None for a polyline.
    """

    points: Array
    normal: Array | None = None

    def through(self, domain: Domain, sigma: fem.Function) -> Through:
        """What passes, the same on all ranks (collective).

        Args:
            domain: The domain.
            sigma: The flux or stress, at most quadratic on each cell of its mesh, with up-to-date ghost values.

        Raises:
            InputError: If a plane has facets of a mesh with pairs of surfaces, which may cover each other in part.
        """
        mesh = sigma.function_space.mesh
        size = float(np.ptp(domain.box(), axis=0).max())
        if self.normal is not None:
            pieces = [self._on_plane(mesh, sigma, AT_BOUNDARY * size, paired=bool(domain.together))]
        else:
            ends = zip(self.points[:-1], self.points[1:], strict=True)
            pieces = [_on_segment(mesh, sigma, a, b, AT_BOUNDARY * size) for a, b in ends]
        total = mesh.comm.bcast(np.sum(pieces, axis=0))
        return Through(total[0] if sigma.ufl_shape[1:] == () else total[:-1], float(total[-1]))

    def measure(self, domain: Domain) -> float:
        """The length or area of the section inside the domain (collective)."""
        along = fem.Function(fenicsx.function_space(domain.mesh, ("DG", 0, (domain.mesh.geometry.dim,))))
        return self.through(domain, along).measure

    def _on_plane(self, mesh: dolfinx.mesh.Mesh, sigma: fem.Function, near: float, *, paired: bool) -> Array:
        """The flux and the area, on rank 0 (collective)."""
        assert self.normal is not None
        normal = self.normal / np.linalg.norm(self.normal)
        x = corners(mesh)
        away = (x - self.points[0]) @ normal
        away[np.abs(away) <= near] = 0.0
        order = np.argsort(np.sign(away), axis=1, kind="stable")
        x, away = np.take_along_axis(x, order[:, :, None], axis=1), np.take_along_axis(away, order, axis=1)
        counts = np.stack([(away < 0).sum(axis=1), (away == 0).sum(axis=1), (away > 0).sum(axis=1)], axis=1)
        if paired and mesh.comm.allreduce(bool((counts[:, 1] == 3).any()), MPI.LOR):
            raise InputError("section: beside pairs of surfaces a plane must not follow facets; move it a little")
        rows = [np.empty((0, 3 + 1 + len(np.atleast_1d(np.zeros(sigma.ufl_shape[1:])))))]
        for key, triangles in (each for each in PIECES.items() if sum(each[0]) == 4):
            cells = np.flatnonzero((counts == key).all(axis=1))
            for edges in triangles:
                cut = np.stack([_between(x[cells], away[cells], *edge) for edge in edges], axis=1)
                area = np.linalg.norm(np.cross(cut[:, 1] - cut[:, 0], cut[:, 2] - cut[:, 0]), axis=1) / 2
                means = _normal_means(sigma, MIDDLES @ cut, cells, normal)
                on_facet = np.where(key[1] == 3, cut.mean(axis=1), np.nan)
                rows.append(np.column_stack([on_facet, area[:, None] * means, area]))
        gathered = gather_rows(mesh.comm, np.concatenate(rows))
        if gathered is None:
            return np.zeros(rows[0].shape[1] - 3)
        weights, facets = np.ones(len(gathered)), np.flatnonzero(np.isfinite(gathered[:, 0]))
        if len(facets):
            middles = in_digits(gathered[facets, :3])
            _, place, count = np.unique(middles, axis=0, return_inverse=True, return_counts=True)
            weights[facets] = 1 / count[place.ravel()]
        return np.asarray(weights @ gathered[:, 3:])


def _between(x: Array, away: Array, one: int, other: int) -> Array:
    """Where the edges between two vertices pass the plane; the vertex if it is the same."""
    if one == other:
        return x[:, one]
    share = away[:, one] / (away[:, one] - away[:, other])
    return np.asarray(x[:, one] + share[:, None] * (x[:, other] - x[:, one]))


def _on_segment(mesh: dolfinx.mesh.Mesh, sigma: fem.Function, a: Array, b: Array, near: float) -> Array:
    """The flux through a segment and its length inside the domain, on rank 0 (collective)."""
    cells = owned_cells(mesh)
    (at_a, gradients), (at_b, _) = (shares_in(mesh, end[None], slice(None)) for end in (a, b))
    margin = near * np.linalg.norm(gradients, axis=2)
    on_facet = (np.abs(at_a) <= margin) & (np.abs(at_b) <= margin)
    slope = np.where(on_facet, 0.0, at_b - at_a)
    outside = (slope == 0) & ~on_facet & (at_a < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        passed = -at_a / slope
    first = np.where(slope > 0, passed, 0.0).max(axis=1, initial=0.0)
    last = np.where(slope < 0, passed, 1.0).min(axis=1, initial=1.0)
    cells = cells[(first < last) & ~outside.any(axis=1)]
    first, last = first[cells], last[cells]
    along = b - a
    length = float(np.linalg.norm(along))
    ends = np.stack([first, last], axis=1) @ np.array([[1 - t, t] for t in GAUSS]).T
    means = _normal_means(sigma, a + ends[:, :, None] * along, cells, np.array([along[1], -along[0]]) / length)
    rows = gather_rows(mesh.comm, np.column_stack([first, last, means, np.ones(len(cells))]))
    if rows is None:
        return np.zeros(means.shape[1] + 1)
    return np.asarray(length * (_covered(rows[:, 0], rows[:, 1]) @ rows[:, 2:]))


def _covered(first: Array, last: Array) -> Array:
    """The lengths of intervals, where several cover the same each with its share."""
    ends = np.concatenate([first, last])
    order = np.argsort(ends, kind="stable")
    covering = np.cumsum(np.repeat([1, -1], len(first))[order])[:-1]
    pieces = np.diff(ends[order]) / np.maximum(covering, 1)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    sums = np.concatenate([[0.0], np.cumsum(pieces)])
    return np.asarray(sums[place[len(first) :]] - sums[place[: len(first)]])


def _normal_means(sigma: fem.Function, points: Array, cells: Indices, normal: Array) -> Array:
    """Means of σ·n over points of cells, shape (cells, 1 or dim)."""
    count, dim = points.shape[1], points.shape[2]
    shape = sigma.ufl_shape
    if not len(cells):
        return np.empty((0, len(np.atleast_1d(np.zeros(shape[1:])))))
    x = np.pad(points.reshape(-1, dim), ((0, 0), (0, 3 - dim)))
    values = sigma.eval(x, np.repeat(cells, count).astype(np.int32)).reshape(len(cells), count, *shape)
    return np.asarray((values.mean(axis=1) @ normal).reshape(len(cells), -1))
