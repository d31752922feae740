"""Values of functions of one mesh at points of another mesh; the meshes need not be nested."""

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import basix
import basix.ufl
import dolfinx.geometry
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.meshes.domain import Domain

QUADRATURE_DEGREE = 2
"""Exact for squares of differences of linear functions on fine cells that one coarse cell covers."""
FINER_DEGREES = 30, 16, 10, 6
POINTS_PER_CELL, POINTS = 80, 300_000
"""Quadratures of finer degrees have at most so many points in a cell, and over all ranks."""
AT_A_TIME = 100_000
"""So many points are looked at together."""
AT_BOUNDARY = 1e-10
"""A point outside a mesh counts as on its boundary up to this distance, relative to the size of the mesh."""
ASIDE = 1e-6 * np.array([1.0, 0.2, 0.43])
"""The cell of a point is that of a point so far from it in a mesh of size 1: on a facet the order of the cells, which
depends on the ranks, would decide. DOLFINx takes points within 5e-8 for those of a cell."""

WIDE = 0.25
"""A gap at a curved boundary is wide if it is more than this share of the largest cell diameter."""


def curve_gap(domain: Domain) -> float:
    """Upper bound of the distance between this mesh and a finer mesh of the same domain with a curved boundary."""
    return domain.curvature * domain.h**2


@dataclass(frozen=True)
class Scaling:
    """A frame in which a domain is near 0 and has a size around 1: (x − origin) · factor.

    Attributes:
        origin: The middle of the domain, shape (3,).
        factor: A power of 2, so that scaling is exact; 1/4 for named shapes.
    """

    origin: Array
    factor: float

    def of(self, x: Array) -> Array:
        """Points in this frame, shape (n, 3)."""
        return self.factor * (x - self.origin)

    def back(self, x: Array) -> Array:
        """Points of this frame in that of the domain, shape (n, 3)."""
        return x / self.factor + self.origin


@contextlib.contextmanager
def of_unit_size(domain: Domain, *meshes: dolfinx.mesh.Mesh) -> Iterator[Scaling]:
    """Move meshes of a domain into a frame inside this context, because DOLFINx searches with fixed tolerances.

    Collective.
    """
    frame = Scaling(domain.box().mean(axis=0), 2.0 ** round(math.log2(domain.curvature)))
    before = [mesh.geometry.x.copy() for mesh in meshes]
    try:
        for mesh, x in zip(meshes, before, strict=True):
            mesh.geometry.x[:] = frame.of(x)
        yield frame
    finally:
        for mesh, x in zip(meshes, before, strict=True):
            mesh.geometry.x[:] = x


def squares_degree(mesh: dolfinx.mesh.Mesh) -> int:
    """The degree of a quadrature of squares of differences from functions on another mesh.

    Where a coarse cell ends inside a fine one the difference jumps, and no quadrature is exact. Such errors have any
    sign, so that few are left of many cells; few cells get more points. A norm is then right to about 0.5 % in Ω.
    """
    cells = mesh.topology.index_map(mesh.topology.dim).size_global
    for degree in FINER_DEGREES:
        points = len(basix.make_quadrature(mesh.basix_cell(), degree)[1])
        if points <= POINTS_PER_CELL and points * cells <= POINTS:
            return degree
    return QUADRATURE_DEGREE


def measure(mesh: dolfinx.mesh.Mesh, degree: int) -> ufl.Measure:
    """The measure of a mesh, by quadrature of a degree."""
    return ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": degree, "quadrature_scheme": "default"})


def sampled(
    functions: Sequence[fem.Function],
    mesh: dolfinx.mesh.Mesh,
    source: Domain,
    *,
    degree: int = QUADRATURE_DEGREE,
    cells: npt.NDArray[np.int32] | None = None,
) -> list[fem.Function]:
    """Functions of one other mesh at the quadrature points of this mesh (collective).

    Args:
        functions: Functions on one other mesh, or on this mesh; the latter are returned unchanged.
        mesh: This mesh.
        source: The domain of the other mesh, or whose boundary the other mesh covers.
        degree: Degree of the quadrature.
        cells: The owned cells of this mesh where they are wanted, 0 elsewhere; None for all.
    """
    if cells is None:
        cells = owned_cells(mesh)
    samples = []
    search = None  # the search of points is expensive, and the same for all functions
    for function in functions:
        space = function.function_space
        if space.mesh is mesh:
            samples.append(function)
            continue
        element = basix.ufl.quadrature_element(mesh.basix_cell(), function.ufl_shape, degree=degree)
        sample = fem.Function(fenicsx.function_space(mesh, element))
        with of_unit_size(source, mesh, space.mesh) as frame:
            search = search or _search(sample.function_space, space, cells, source, frame)
            sample.interpolate_nonmatching(function, cells, search)
            if space.ufl_element().pullback is ufl.contravariant_piola:  # fluxes per area: J/det J
                sample.x.array[:] *= frame.factor ** (mesh.topology.dim - 1)
        samples.append(sample)
    return samples


def _search(
    samples: fem.FunctionSpace, space: fem.FunctionSpace, cells: npt.NDArray[np.int32], source: Domain, frame: Scaling
) -> dolfinx.geometry.PointOwnershipData:
    """The cells of a mesh in a frame in which the points of some cells of another mesh are (collective)."""
    mesh = samples.mesh
    aside, before = _aside(mesh), mesh.geometry.x.copy()
    mesh.geometry.x[:] += aside
    try:
        if mesh.comm.size > 1:
            found = _search_points(samples, space, cells, source, frame)
        else:
            found = _search_by_cells(samples, space, cells, source, frame, aside)
    finally:
        mesh.geometry.x[:] = before
    return fenicsx.owned_points(found.src_owner, found.dest_owner, found.dest_points - aside, found.dest_cells)


def _search_by_cells(
    samples: fem.FunctionSpace,
    space: fem.FunctionSpace,
    cells: npt.NDArray[np.int32],
    source: Domain,
    frame: Scaling,
    aside: Array,
) -> dolfinx.geometry.PointOwnershipData:
    """The cells in which the points are, on one rank, of a mesh that was moved aside.

    A cell that is in one of the other mesh as a whole, seen by its vertices, has all its points there, and points of
    others are searched in boxes. DOLFINx, which measures distances, takes ten times as long.
    """
    mesh, points = samples.mesh, samples.element.interpolation_points
    corners = mesh.geometry.x[mesh.geometry.dofmaps[0][cells]]
    behind = _cells_around(space.mesh, corners.mean(axis=1))
    for vertex in corners.swapaxes(0, 1):
        rows = np.flatnonzero(behind >= 0)
        behind[rows[~_are_inside(space.mesh, behind[rows], vertex[rows] - aside)]] = -1
    owners = np.repeat(behind[:, None], len(points), axis=1)
    x = np.column_stack([1 - points.sum(axis=1), points]) @ corners
    rest = np.flatnonzero(behind < 0)
    owners[rest] = _cells_around(space.mesh, x[rest].reshape(-1, 3)).reshape(-1, len(points))
    rest = rest[(owners[rest] < 0).any(axis=1)]
    if len(rest):
        far = _search_points(samples, space, cells[rest], source, frame)
        of_far = far.src_owner.copy()
        of_far[of_far >= 0] = far.dest_cells
        owners[rest] = of_far.reshape(-1, len(points))
    cell, within = owners.ravel(), owners.ravel() >= 0
    rank = np.where(within, 0, -1).astype(np.int32)
    return fenicsx.owned_points(rank, rank[within], x.reshape(-1, 3)[within], cell[within])


def _aside(mesh: dolfinx.mesh.Mesh) -> Array:
    """The step `ASIDE` in the space of a mesh, shape (3,); 0 for facets, which it would leave."""
    return np.where(np.arange(3) < mesh.geometry.dim, ASIDE, 0.0) * (mesh.topology.dim == mesh.geometry.dim)


def _search_points(
    samples: fem.FunctionSpace, space: fem.FunctionSpace, cells: npt.NDArray[np.int32], source: Domain, frame: Scaling
) -> dolfinx.geometry.PointOwnershipData:
    """The cells in which the points are, each searched on its own (collective).

    At a curved boundary points may be outside, as far as `curve_gap`: then the nearest cells are meant. Where that is
    much for a cell, boxes so wide around all cells make a search ten times as long, and one without them is tried.
    """
    gap = curve_gap(source)
    if gap > WIDE * source.h:
        search = fem.create_interpolation_data(samples, space, cells, padding=AT_BOUNDARY)
        found = (search.src_owner >= 0).all() and _are_inside(space.mesh, search.dest_cells, search.dest_points).all()
        if space.mesh.comm.allreduce(bool(found), MPI.LAND):
            return search
    padding = max(frame.factor * gap, 2 * float(ASIDE.max()))
    return fem.create_interpolation_data(samples, space, cells, padding=padding)


def _cells_around(mesh: dolfinx.mesh.Mesh, points: Array) -> npt.NDArray[np.int32]:
    """A cell that each point is in, of a mesh on one rank; −1 without one."""
    tree = dolfinx.geometry.bb_tree(mesh, mesh.topology.dim, padding=AT_BOUNDARY)
    found = np.full(len(points), -1, dtype=np.int32)
    for start in range(0, len(points), AT_A_TIME):
        some = points[start : start + AT_A_TIME]
        near = dolfinx.geometry.compute_collisions_points(tree, some)
        numbers = np.repeat(np.arange(len(some)), np.diff(near.offsets))
        inside = np.flatnonzero(_are_inside(mesh, near.array, some[numbers]))[::-1]
        found[start + numbers[inside]] = near.array[inside]  # the first one
    return found


def _are_inside(mesh: dolfinx.mesh.Mesh, cells: npt.NDArray[np.int32], points: Array) -> Mask:
    """Mask of the points that are each in its cell, or in its facet in a mesh of facets, but for rounding."""
    corners = mesh.geometry.x[mesh.geometry.dofmaps[0][cells]]
    edges, arms = corners[:, 1:] - corners[:, :1], points - corners[:, 0]
    if mesh.topology.dim == mesh.geometry.dim:  # products of edges of a flat cell are alike but for rounding
        plain = slice(mesh.geometry.dim)
        shares = np.linalg.solve(edges[:, :, plain].swapaxes(1, 2), arms[:, plain, None])
    else:
        shares = np.linalg.solve(edges @ edges.swapaxes(1, 2), edges @ arms[:, :, None])
    shares = shares.clip(0, 1)
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), 1)
    inside: Mask = (np.abs((shares * edges).sum(axis=1) - arms) <= AT_BOUNDARY).all(axis=1)
    return inside


def at_points(domain: Domain, function: fem.Function, points: npt.ArrayLike) -> Array:
    """A function at any points (collective).

    Args:
        domain: The domain of its mesh, or of that of whose cells this one has parts.
        function: A function with up-to-date ghost values.
        points: Points of this rank, shape (n, dim); their cells may be on any rank.

    Returns:
        The values, shape (n, *shape of a value): NaN outside the mesh; where cells meet, those of one of them, the
        same on any number of ranks.

    Raises:
        InputError: On all ranks, if the points of one of them have another shape.
    """
    comm, domain = domain.mesh.comm, replace(domain, mesh=function.function_space.mesh)
    wanted = _in_space(domain.mesh, points)
    inside = np.isfinite(wanted).all(axis=1)
    padding = AT_BOUNDARY * float(np.ptp(domain.box(), axis=0).max())
    with of_unit_size(domain, domain.mesh) as frame:
        near_0, aside = frame.of(wanted[inside]), _aside(domain.mesh)
        owners = dolfinx.geometry.determine_point_ownership(domain.mesh, near_0, frame.factor * padding)
        inside[inside] = owners.src_owner >= 0
        near_0 = near_0[owners.src_owner >= 0] + aside
        owners = dolfinx.geometry.determine_point_ownership(domain.mesh, near_0, 2 * float(ASIDE.max()))
    places = [np.flatnonzero(inside)[owners.src_owner == rank] for rank in range(comm.size)]
    x = frame.back(owners.dest_points - aside)
    of_owners = function.eval(x, owners.dest_cells).reshape(-1, *function.ufl_shape)
    answers = comm.alltoall([of_owners[owners.dest_owner == rank] for rank in range(comm.size)])
    values = np.full((len(wanted), *function.ufl_shape), np.nan)
    for place, answer in zip(places, answers, strict=True):
        values[place] = answer
    return values


def _in_space(mesh: dolfinx.mesh.Mesh, points: npt.ArrayLike) -> Array:
    """Points in the form of DOLFINx, shape (n, 3) (collective).

    Raises:
        InputError: On all ranks, if the points of one rank have another shape.
    """
    dim, wrong = mesh.geometry.dim, False
    try:
        coordinates = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        coordinates, wrong = np.empty((0, dim)), True
    if coordinates.size == 0:
        coordinates = np.empty((0, dim))
    wrong = wrong or coordinates.ndim != 2 or coordinates.shape[1] != dim
    if mesh.comm.allreduce(wrong, MPI.LOR):
        raise InputError(f"points: must be an array of shape (n, {dim}), a row for each point")
    return np.pad(coordinates, ((0, 0), (0, 3 - dim)))
