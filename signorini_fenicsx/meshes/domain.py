"""Distributed meshes with named boundary parts and regions, which refinement and files hand on by their vertices."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import basix.ufl
import dolfinx.graph
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from ufl.finiteelement import AbstractFiniteElement

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import scatter_rows

AXES = "xyz"


@dataclass(frozen=True)
class Part:
    """A named part of the boundary.

    Attributes:
        along: Coordinate along the part for points of shape (3, n): its facets are listed and drawn in this order.
        label: Name of that coordinate.
        nearest: Nearest points of a curved part to points of shape (3, n) near it; None for a plane or an unknown one.
    """

    along: Callable[[Array], Array]
    label: str
    nearest: Callable[[Array], Array] | None = None


@dataclass(frozen=True)
class Domain:
    """A distributed mesh with named boundary parts and regions.

    Attributes:
        mesh: The mesh; without ghost cells, so a boundary facet lives on one rank only, with its cell.
        h: Largest cell diameter over all ranks.
        parts: Boundary parts, in the order of the shape or file.
        facets: For each part its facets of this rank, ascending. Parts from a file may overlap or leave facets.
        regions: For each region of a file its cells of this rank, ascending; none for named shapes.
        curvature: Two meshes of the domain with edges ≤ h are nowhere further apart than curvature·h².
        name: Of the shape or the file.
        is_shape: Whether it is one of the named shapes.
    """

    mesh: dolfinx.mesh.Mesh
    h: float
    parts: Mapping[str, Part]
    facets: Mapping[str, npt.NDArray[np.int32]]
    regions: Mapping[str, npt.NDArray[np.int32]]
    curvature: float
    name: str = "mesh"
    is_shape: bool = False

    def box(self) -> Array:
        """Smallest and largest coordinates, shape (2, 3) (collective)."""
        return bounding_box(self.mesh.geometry.x, self.mesh.comm)


@dataclass(frozen=True)
class Boundary:
    """Which parts of the boundary are Γ_S and Γ_N; the rest is Γ_D.

    Attributes:
        signorini: Names of the parts of Γ_S, at least one.
        neumann: Names of the parts of Γ_N.
    """

    signorini: Sequence[str]
    neumann: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Refuse a string in the place of a list."""
        for key in ("signorini", "neumann"):
            if isinstance(getattr(self, key), str):
                raise InputError(f"{key}: must be a list of names, such as ['{getattr(self, key)}']")


@dataclass(frozen=True)
class Marks:
    """Parts and regions of a mesh, as far as this rank has them.

    Attributes:
        facets: For each part the vertices of its facets, ascending and numbered as the mesh was made, shape (n, dim).
        cells: Which cells are in which region, shape (cells, regions); rank 0 has all, in the order in which the mesh
            was made, the others None.
        regions: Names of the regions.
    """

    facets: Mapping[str, Indices]
    cells: Mask | None
    regions: tuple[str, ...]


def bounding_box(points: Array, comm: MPI.Comm) -> Array:
    """Smallest and largest coordinates of points of all ranks, shape (2, 3) (collective)."""
    bounds = np.stack([points.min(axis=0, initial=np.inf), (-points).min(axis=0, initial=np.inf)])
    comm.Allreduce(MPI.IN_PLACE, bounds, op=MPI.MIN)
    return np.stack([bounds[0], -bounds[1]])


def axis_part(label: str) -> Part:
    """A part listed by one of the coordinates x, y, z."""
    axis = AXES.index(label)
    return Part(lambda x: x[axis], label)


def coordinate_element(dim: int) -> AbstractFiniteElement:
    """Element of the coordinates of triangles or tetrahedra with straight edges."""
    return basix.ufl.element("Lagrange", {2: "triangle", 3: "tetrahedron"}[dim], 1, shape=(dim,))


def distribute(
    comm: MPI.Comm, points: Array, cells: Indices, dim: int, partitioner: Callable | None = None
) -> dolfinx.mesh.Mesh:
    """Make a distributed mesh without ghost cells (collective).

    Args:
        comm: Communicator of the mesh.
        points: Some points on each rank, numbered from rank to rank.
        cells: Some cells on each rank, of those numbers.
        dim: Dimension.
        partitioner: Says which rank gets a cell, as DOLFINx wants it; DOLFINx's own if there is none.
    """
    return dolfinx.mesh.create_mesh(comm, cells, coordinate_element(dim), points, partitioner)


def stay(comm: MPI.Comm, cells: int) -> Callable[..., object]:
    """A partitioner for `distribute` that leaves each cell on its rank, which has so many."""

    def here(*_: object) -> object:
        return dolfinx.graph.adjacencylist(np.full((cells, 1), comm.rank, dtype=np.int32))._cpp_object

    return here


def largest_diameter(mesh: dolfinx.mesh.Mesh) -> float:
    """Largest cell diameter (collective)."""
    dim = mesh.topology.dim
    cells = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
    return float(mesh.comm.allreduce(mesh.h(dim, cells).max(initial=0.0), MPI.MAX))


def marked_domain(
    mesh: dolfinx.mesh.Mesh,
    parts: Mapping[str, Part],
    marks: Marks,
    *,
    curvature: float,
    name: str,
    is_shape: bool = False,
) -> Domain:
    """Find the marked facets and cells on a mesh (collective)."""
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    size = mesh.topology.index_map(dim).size_local
    inside = scatter_rows(mesh.comm, mesh.topology.original_cell_index[:size], marks.cells) if marks.regions else None
    regions = {
        name: np.flatnonzero(inside[:, column]).astype(np.int32)
        for column, name in enumerate(marks.regions)
        if inside is not None
    }
    facets = found(mesh, marks.facets, dolfinx.mesh.exterior_facet_indices(mesh.topology))
    return Domain(mesh, largest_diameter(mesh), parts, facets, regions, curvature, name, is_shape)


def found(
    mesh: dolfinx.mesh.Mesh, marked: Mapping[str, Indices], among: npt.NDArray[np.int32]
) -> dict[str, npt.NDArray[np.int32]]:
    """Facets of this rank that any rank has marked (collective).

    Args:
        mesh: The mesh.
        marked: By name the vertices of facets as `facet_vertices` gives them, of the same names on all ranks.
        among: Facets of this rank that may be.

    Returns:
        By name these facets, ascending.
    """
    mine = facet_vertices(mesh, among)
    gathered = mesh.comm.allgather(marked)
    wanted = [np.concatenate([one[name] for one in gathered]) for name in marked]
    _, number = np.unique(np.concatenate([mine, *wanted]), axis=0, return_inverse=True)
    facet = np.full(int(number.max(initial=-1)) + 1, -1, dtype=np.int32)
    facet[number[: len(mine)]] = among
    ends = len(mine) + np.cumsum([0, *map(len, wanted)])
    rows = {name: facet[number[a:b]] for name, a, b in zip(marked, ends, ends[1:], strict=False)}
    return {name: np.unique(facets[facets >= 0]) for name, facets in rows.items()}


def facet_vertices(mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32]) -> Indices:
    """Vertices of facets of this rank, numbered as the mesh was made, ascending: shape (facets, dim)."""
    nodes = dolfinx.mesh.entities_to_geometry(mesh, mesh.topology.dim - 1, facets)
    return np.sort(mesh.geometry.input_global_indices[nodes], axis=1).reshape(-1, mesh.topology.dim)


def membership(domain: Domain) -> Mask:
    """Which owned cells are in which region, shape (cells, regions)."""
    size = domain.mesh.topology.index_map(domain.mesh.topology.dim).size_local
    table = np.zeros((size, len(domain.regions)), dtype=bool)
    for column, cells in enumerate(domain.regions.values()):
        table[cells, column] = True
    return table
