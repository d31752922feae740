"""Distributed meshes with named boundary parts and regions; these are passed on as vertices by files and refinement."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar
from weakref import WeakKeyDictionary

import basix.ufl
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from ufl.finiteelement import AbstractFiniteElement

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices, Mask, inverses
from signorini_fenicsx.base.errors import InputError, check_names
from signorini_fenicsx.base.owned import cell_nodes, number_of_cells, original_cells, owned_cells
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.base.rows import fetch_rows, find_rows
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.expressions.cutting import Frame
from signorini_fenicsx.meshes.paired_parts import PairedParts, paired_parts, without_law

AXES = "xyz"
FAR = 4.0
"""A coordinate is far from 0 if it is this many times as large as the domain in its direction."""
COARSEST = 1e-6
"""Floats carry a mesh if neighbouring ones are nearer than this share of the heights of its cells. Rounding changes the
shape of a cell by about this share."""

_ROUNDING: WeakKeyDictionary[dolfinx.mesh.Mesh, float] = WeakKeyDictionary()


@dataclass(frozen=True)
class Part:
    """A named part of the boundary.

    Attributes:
        along: Maps points of shape (3, n) to the coordinate along the part; facets are listed and drawn in this order.
        label: Name of this coordinate.
        nearest: Maps points of shape (3, n) near a curved part to its nearest points; None for plane or unknown parts.
    """

    along: Callable[[Array], Array]
    label: str
    nearest: Callable[[Array], Array] | None = None


def other_side(name: str) -> str:
    """The name of the part that lies on an inner part: the same facets seen from the cells on the other side."""
    return f"{name} (other side)"


API = ("box", "cells", "facets", "h", "mesh", "name", "origin", "parts", "regions")
"""What a notebook offers of a domain."""


@dataclass(frozen=True)
class Domain:
    """A distributed mesh with named boundary parts and regions.

    Attributes:
        mesh: The mesh. A facet of the boundary is owned by the rank that owns its cell.
        h: Largest cell diameter over all ranks.
        parts: Boundary parts, in the order of the shape or file. Along an inner part the mesh is cut, so it consists of
            facets of the boundary, and a second part, see `other_side`, of those that lie on them. The cells of both
            are on one rank.
        facets: For each part its owned facets, ascending. Parts from a file may overlap, or not cover all
            facets.
        regions: For each region of a file its owned cells, ascending; none for named shapes.
        curvature: The distance between two meshes of the domain with edges ≤ h is at most curvature·h².
        name: Name of the shape or the file.
        is_shape: Whether it is one of the named shapes.
        made: How the mesh was made, in words.
        coarser: The mesh of which this one is a uniform refinement, with all cells on the rank of their parents, if
            there is one.
        unsided: The parts inside the domain of which a condition has to name the side, as the last coordinate does not.
        together: Groups of parts, those of pairs of surfaces: the cells behind each group are on one rank.
        changed: What has become of other cells of its file than simplices of first order, in words.
    """

    mesh: dolfinx.mesh.Mesh
    h: float
    parts: Mapping[str, Part]
    facets: Mapping[str, npt.NDArray[np.int32]]
    regions: Mapping[str, npt.NDArray[np.int32]]
    curvature: float
    name: str = "mesh"
    is_shape: bool = False
    made: str = "given"
    coarser: "Domain | None" = None
    unsided: frozenset[str] = frozenset()
    together: tuple[tuple[str, ...], ...] = ()
    changed: str = ""

    def __post_init__(self) -> None:
        """Refuse a mesh far from 0 whose cells are too small for its coordinates (collective).

        Raises:
            InputError: If it is one.
        """
        box = self.box()
        far = np.abs(box).max(axis=0) > FAR * (box[1] - box[0])
        if far.any() and (share := rounding(self.mesh)) > COARSEST:
            largest = np.abs(box[:, far]).max()
            raise InputError(
                f"mesh {self.name}: floating-point numbers near {largest:.4g} are {np.spacing(largest):.1e} apart, "
                f"{share:.1e} of the height of a cell, and at most {COARSEST:g} is exact enough; measure coordinates "
                "from a point of the domain"
            )

    def __repr__(self) -> str:
        return f"<Domain {self.name}: {self.cells} cells, h = {self.h:.4g}, parts {', '.join(self.parts)}>"

    def __dir__(self) -> list[str]:
        return sorted(API)

    @property
    def cells(self) -> int:
        """Number of cells over all ranks."""
        topology = self.mesh.topology
        return topology.index_map(topology.dim).size_global

    def origin(self) -> str:
        """How the mesh was made, in words, with its uniform refinements."""
        levels, first = 0, self
        while first.coarser is not None:
            levels, first = levels + 1, first.coarser
        return first.made + (f", refined uniformly {counted(levels, 'time')}" if levels else "")

    def ancestor(self, factor: float) -> "Domain | None":
        """The mesh, coarser by about this factor, from which this one was refined uniformly; None if there is none."""
        coarser = self.coarser
        while coarser is not None and coarser.h < 0.75 * factor * self.h:
            coarser = coarser.coarser
        return coarser

    @collector_off()
    def box(self) -> Array:
        """Smallest and largest coordinates, shape (2, 3) (collective)."""
        return bounding_box(self.mesh.geometry.x, self.mesh.comm)

    @cached_property
    def frame(self) -> Frame:
        """The domain, for enclosures (collective when first used)."""
        return Frame(self.box()[:, : self.mesh.geometry.dim], self.cells, self.mesh.comm)


@dataclass(frozen=True)
class Boundary:
    """The parts of the boundary that are Γ_S and Γ_N; the rest is Γ_D.

    Attributes:
        signorini: Names of the parts of Γ_S; those of laws are added.
        neumann: Names of the parts of Γ_N.
        inner: Names of the parts inside the domain, across which u may jump. They are part of Γ_S: the law of such a
            part is one between the jump of u and σ·n, with n outward from the named side.
        pairs: Pairs of surfaces that share no nodes. Slaves with a law are part of Γ_S.
    """

    signorini: Sequence[str] = ()
    neumann: Sequence[str] = ()
    inner: Sequence[str] = ()
    pairs: Sequence[PairedParts] = ()
    physics: ClassVar[str] = "diffusion"

    def __post_init__(self) -> None:
        """Refuse a string instead of a list."""
        for key in ("signorini", "neumann", "inner"):
            check_names(key, getattr(self, key))
            object.__setattr__(self, key, list(getattr(self, key)))  # as they are read from files
        object.__setattr__(self, "pairs", paired_parts(self.pairs, self.signorini))

    @property
    def named(self) -> dict[str, Sequence[str]]:
        """The parts of each kind."""
        paired = without_law(self.pairs)
        return {"signorini": self.signorini, "neumann": self.neumann, "inner": self.inner, "paired": paired}


def bounding_box(points: Array, comm: MPI.Comm) -> Array:
    """Smallest and largest coordinates of points of all ranks, shape (2, 3) (collective)."""
    bounds = np.stack([points.min(axis=0, initial=np.inf), (-points).min(axis=0, initial=np.inf)])
    comm.Allreduce(MPI.IN_PLACE, bounds, op=MPI.MIN)
    return np.stack([bounds[0], -bounds[1]])


def rounding(mesh: dolfinx.mesh.Mesh) -> float:
    """How much rounding of the coordinates may change barycentric ones in the cells, at most 1 (collective).

    In a cell whose edges follow the axes this is the distance of neighbouring floats as a share of its heights.
    """
    if mesh not in _ROUNDING:
        dim, x, cells = mesh.topology.dim, mesh.geometry.x, cell_nodes(mesh)
        apart = np.spacing(np.abs(bounding_box(x, mesh.comm)).max(axis=0)[:dim])
        edges = x[cells[:, 1:], :dim] - x[cells[:, :1], :dim]
        with np.errstate(all="ignore"):  # a cell may have become flat
            changes = np.einsum("civ,i->cv", np.abs(inverses(edges)), apart)
        largest = np.nan_to_num(changes, nan=1.0).max(initial=0.0)
        _ROUNDING[mesh] = min(mesh.comm.allreduce(float(largest), MPI.MAX), 1.0)
    return _ROUNDING[mesh]


def axis_part(label: str) -> Part:
    """A part whose facets are ordered by one of the coordinates x, y, z."""
    axis = AXES.index(label)
    return Part(lambda x: x[axis], label)


def coordinate_element(dim: int) -> AbstractFiniteElement:
    """Element of the coordinates of triangles or tetrahedra with straight edges."""
    return basix.ufl.element("Lagrange", {2: "triangle", 3: "tetrahedron"}[dim], 1, shape=(dim,))


def distribute(
    comm: MPI.Comm, points: Array, cells: Indices, dim: int, *, stay: bool = False, together: Indices | None = None
) -> dolfinx.mesh.Mesh:
    """Make a distributed mesh without ghost cells (collective).

    Args:
        comm: Communicator of the mesh.
        points: Some points on each rank; their numbers continue from rank to rank.
        cells: Some cells on each rank, by the numbers of their points.
        dim: Dimension.
        stay: Leave each cell on the rank that gives it; otherwise DOLFINx chooses a partition with few neighbours.
        together: Pairs of cells that go to the same rank, numbered like the points; all ranks may list some. None on
            all ranks if there are none.
    """

    def chosen(partition: Callable[[], npt.NDArray[np.int32]]) -> npt.NDArray[np.int32]:
        ranks = np.full(len(cells), comm.rank, dtype=np.int32) if stay else partition()
        if together is not None:
            _bring_together(comm, ranks, together)
        return ranks

    own = stay or together is not None
    return fenicsx.partitioned(comm, cells, coordinate_element(dim), points, chosen if own else None)


def _bring_together(comm: MPI.Comm, ranks: npt.NDArray[np.int32], pairs: Indices) -> None:
    """Give the cells of each pair the lower one of their ranks, in place, until all pairs agree (collective)."""
    pairs = np.concatenate(comm.allgather(pairs))
    cells, place = np.unique(pairs, return_inverse=True)
    one, other = place.reshape(pairs.shape).T
    own = cells - sum(comm.allgather(len(ranks))[: comm.rank])
    is_own = (own >= 0) & (own < len(ranks))
    lowest = np.full(len(cells), comm.size, dtype=np.int32)
    lowest[is_own] = ranks[own[is_own]]
    comm.Allreduce(MPI.IN_PLACE, lowest, MPI.MIN)
    while np.any(lowest[one] != lowest[other]):
        lower = np.minimum(lowest[one], lowest[other])
        for ends in (one, other):
            np.minimum.at(lowest, ends, lower)
    ranks[own[is_own]] = lowest[is_own]


def brought_together(comm: MPI.Comm, groups: Sequence[Indices]) -> Indices:
    """The pairs for `distribute` by which all cells of each group get to one rank (collective).

    Args:
        comm: Communicator.
        groups: Some cells of each on each rank, by their numbers there.
    """
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for cells in groups:
        first = comm.allreduce(int(cells.min(initial=np.iinfo(np.int64).max)), MPI.MIN)
        pairs.append(np.column_stack([np.full_like(cells, first), cells]))
    return np.concatenate(pairs)


def largest_diameter(mesh: dolfinx.mesh.Mesh) -> float:
    """Largest cell diameter (collective)."""
    return float(mesh.comm.allreduce(mesh.h(mesh.topology.dim, owned_cells(mesh)).max(initial=0.0), MPI.MAX))


def marked(
    mesh: dolfinx.mesh.Mesh, facets: Mapping[str, Indices], cells: Mask | None, regions: Iterable[str]
) -> dict[str, Any]:
    """What a `Domain` has on a mesh: its largest cell diameter, parts and regions (collective).

    Args:
        mesh: The mesh.
        facets: For each part the facets that this rank knows, as ascending vertices in the original numbering of the
            mesh, shape (n, dim).
        cells: Mask of the cells in each region, shape (cells, regions), for the cells that this rank passed when
            the mesh was made; None if it passed none.
        regions: Names of the regions.
    """
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    of_regions = {}
    if names := list(regions):
        inside = fetch_rows(mesh.comm, original_cells(mesh), cells)
        of_regions = {name: np.flatnonzero(inside[:, k]).astype(np.int32) for k, name in enumerate(names)}
    outer = found(mesh, facets, dolfinx.mesh.exterior_facet_indices(mesh.topology))
    return {"mesh": mesh, "h": largest_diameter(mesh), "facets": outer, "regions": of_regions}


def found(
    mesh: dolfinx.mesh.Mesh, marked: Mapping[str, Indices], among: npt.NDArray[np.int32]
) -> dict[str, npt.NDArray[np.int32]]:
    """Facets of this rank that any rank has marked (collective).

    Args:
        mesh: The mesh.
        marked: For each name the facets as vertices, see `facet_vertices`; the same names on all ranks.
        among: Facets of this rank that are searched, ascending.

    Returns:
        For each name the facets of this rank, ascending.
    """
    if not marked:
        return {}
    inside = find_rows(mesh.comm, facet_vertices(mesh, among), list(marked.values())) >= 0
    return {name: among[inside[:, column]] for column, name in enumerate(marked)}


def facet_vertices(mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32]) -> Indices:
    """Vertices of facets of this rank, ascending, in the original numbering of the mesh, shape (facets, dim)."""
    nodes = dolfinx.mesh.entities_to_geometry(mesh, mesh.topology.dim - 1, facets)
    return np.sort(mesh.geometry.input_global_indices[nodes], axis=1).reshape(-1, mesh.topology.dim)


def facet_pairs(domain: Domain, name: str) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """The facets of an inner part on this rank, and the one of the other side that lies on each (collective).

    Both have the same vertices but for their numbers, and so exactly the same sums of coordinates.

    Raises:
        InputError: If the sides do not consist of the same facets on each rank.
    """
    mesh = domain.mesh
    sides = [domain.facets[part] for part in (name, other_side(name))]
    nodes = [dolfinx.mesh.entities_to_geometry(mesh, mesh.topology.dim - 1, facets) for facets in sides]
    places = [np.sort(mesh.geometry.x[some], axis=1).sum(axis=1).reshape(-1, 3) for some in nodes]
    orders = [np.lexsort(some.T) for some in places]
    first, second = (some[order] for some, order in zip(places, orders, strict=True))
    same = np.array_equal(first, second)
    if not mesh.comm.allreduce(same, MPI.LAND):
        raise InputError(f"the two sides of '{name}' do not consist of the same facets")
    named, across = (facets[order] for facets, order in zip(sides, orders, strict=True))
    return named, across


def membership(domain: Domain) -> Mask:
    """Mask of the owned cells in each region, shape (cells, regions)."""
    return in_regions(domain.regions, number_of_cells(domain.mesh))


def in_regions(regions: Mapping[str, AnyIndices], number: int) -> Mask:
    """Mask of so many cells in each region, shape (cells, regions), from the numbers of its cells."""
    table = np.zeros((number, len(regions)), dtype=bool)
    for column, cells in enumerate(regions.values()):
        table[cells, column] = True
    return table
