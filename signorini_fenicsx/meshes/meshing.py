"""Domains and how they are made: meshes of named shapes with a given h, and meshes from files."""

import functools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import dolfinx.mesh
import gmsh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError, telling
from signorini_fenicsx.base.local_options import unseen
from signorini_fenicsx.base.parallel import on_root, on_root_only
from signorini_fenicsx.base.signals import listen_again
from signorini_fenicsx.meshes.checks import FileMesh, check_boundary, diameters, faces
from signorini_fenicsx.meshes.cut import Side, cut, opened
from signorini_fenicsx.meshes.domain import Domain, distribute, largest_diameter
from signorini_fenicsx.meshes.files import MAX_CELLS, Sizes, is_geometry, read_mesh_file
from signorini_fenicsx.meshes.grids import Share, Simplices
from signorini_fenicsx.meshes.memory import check_memory
from signorini_fenicsx.meshes.named_faces import Rule, named
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.meshes.uniform import refined_diameter, refined_uniformly
from signorini_fenicsx.meshes.whole import handed_out

CURVATURE = 0.25
"""`Domain.curvature` of named shapes: radii of curvature R are at least 1/2, and a chord of length h ≤ R is at most
h²/(7R) from its circle; the ball has R = 1, and its triangles are at most h²/4 from it. More makes searches slow."""
REFINED_FROM = 60_000
"""Meshes with at least this many facets are made by uniform refinement, in parallel; Gmsh makes smaller ones in
seconds."""
COARSEST = 5_000
"""Smallest number of cells of a mesh that is refined uniformly; it resolves the shape well, and Gmsh makes it fast."""
TRIALS = 4
"""Most meshes of a shape in space of which the coarsest is refined; together they have fewer cells than that."""
NEAR = 0.985
"""A mesh is taken at once if its largest diameter is at least this share of the one asked for: a mesh with exactly that
diameter would have about 5 % fewer cells in space, which save less time than another mesh takes."""
GOOD = 0.6
"""Gmsh improves tetrahedra of a worse quality before they are refined; its default is 0.3."""


def estimated_cells(shape_name: str, h: float) -> float:
    """Rough number of cells of an unstructured mesh of a named shape with largest cell diameter h.

    Raises:
        InputError: If there are more than MAX_CELLS.
    """
    shape, edge = shape_of(shape_name), 0.65 * h
    cells = shape.measure / (edge**2 * math.sqrt(3) / 4 if shape.dim == 2 else edge**3 / (6 * math.sqrt(2)))
    return allowed(cells, h, shape_name)


def build_domain(comm: MPI.Comm, shape_name: str, h: float, *, mesh: str, diagonal: str | None = None) -> Domain:
    """Mesh a named shape so that its largest cell diameter is at most h and more than h/2 (collective).

    Args:
        comm: Communicator of the mesh.
        shape_name: Name of a shape, see `shapes`.
        h: Wanted largest cell diameter.
        mesh: "unstructured" (a large mesh is a uniform refinement of a mesh of Gmsh), "gmsh" or "structured".
        diagonal: How structured squares are cut: left, right (the default) or crossed.

    Raises:
        InputError: If h asks for more than MAX_CELLS cells, or for more than fit into memory; or if there is no mesh
            with this h.
    """
    shape, expected = shape_of(shape_name), estimated_cells(shape_name, h)  # refuses too many
    check_memory(comm, f"h = {h:g}", shape.dim, expected, h)
    levels = refinements(expected, shape.dim) if mesh == "unstructured" else 0
    if mesh == "structured" and shape.grid is not None:
        points, cells = shape.grid(h, diagonal or "right", Share(comm.rank, comm.size))
        domain = label_parts(distribute(comm, points, cells, shape.dim), shape_name, made="structured")
    else:
        domain = _from_gmsh(comm, shape_name, h, levels)
    if not h / 2 < domain.h <= h * (1 + 1e-12):
        raise InputError(
            f"h = {h:g}: {mesh} meshes of {shape_name} near this size have largest diameter {domain.h:.4g}, "
            "not in (h/2, h]; choose a smaller h"
        )
    return domain


def coarser_domains(fine: Domain, made: Callable[[float], Domain] | None = None) -> Callable[[float], Domain]:
    """Makes meshes that are coarser by a factor: one from which the mesh was refined, or a new one.

    Args:
        fine: The mesh.
        made: Makes a mesh whose h is larger by a factor; None for meshes of the same named shape.

    Returns:
        A function that raises InputError if there is no such mesh (collective).
    """

    def of_shape(factor: float) -> Domain:
        if not fine.is_shape:
            raise InputError("a mesh of a file that was not refined has no coarser mesh")
        mesh = "structured" if fine.made == "structured" else "gmsh"
        return build_domain(fine.mesh.comm, fine.name, factor * fine.h, mesh=mesh)

    return lambda factor: fine.ancestor(factor) or (made or of_shape)(factor)


def _from_gmsh(comm: MPI.Comm, shape_name: str, h: float, levels: int) -> Domain:
    """Make a coarse mesh with Gmsh on rank 0, whose uniform refinement has cells of diameter at most h (collective)."""
    dim, asked = shape_of(shape_name).dim, h * 2**levels
    nothing: Simplices = (np.empty((0, dim)), np.empty((0, dim + 1), dtype=np.int64))  # DOLFINx needs it on other ranks
    points, cells = on_root_only(comm, partial(_gmsh_mesh, shape_name, asked, levels)) or nothing
    points, cells, together = _opened(shape_name, points, cells)
    domain = label_parts(distribute(comm, points, cells, dim, together=together), shape_name, made="Gmsh")
    for _ in range(levels):
        domain = refined_uniformly(domain)
    if levels > 0 and domain.h > h:  # vertices that moved to a curved boundary have made edges longer than expected
        return _from_gmsh(comm, shape_name, h * h / domain.h, levels)
    return domain


def refinements(cells: float, dim: int) -> int:
    """How often the mesh of Gmsh is refined uniformly for a mesh of about this number of cells."""
    facets = (dim + 1) / 2 * cells
    return 0 if facets < REFINED_FROM else max(1, math.floor(math.log2(cells / COARSEST) / dim))


def _opened(shape_name: str, points: Array, cells: Indices) -> tuple[Array, Indices, Indices | None]:
    """The mesh of a named shape, cut along its inner parts, and the pairs of cells there, see `distribute`."""
    shape = shape_of(shape_name)
    inner = [shape.parts[name] for name in shape.inside]
    if not inner:
        return points, cells, None
    everything, along = faces(cells), np.zeros((points.shape[1], len(points)))
    along[:] = points.T
    on_cut = np.any([part.contains(along)[everything].all(axis=1) for part in inner], axis=0)
    done = cut(points, cells, np.unique(everything[on_cut], axis=0))
    return done.points, done.cells, done.pairs


def label_parts(mesh: dolfinx.mesh.Mesh, shape_name: str, made: str = "given") -> Domain:
    """Find the facets of each boundary part of a named shape (collective)."""
    dim, shape = mesh.topology.dim, shape_of(shape_name)
    mesh.topology.create_connectivity(dim - 1, dim)
    facets = {
        name: dolfinx.mesh.locate_entities_boundary(mesh, dim - 1, part.contains) for name, part in shape.parts.items()
    }
    for name, part in shape.parts.items():
        if part.side:
            facets[name] = facets[name][part.side * height_of_cells(mesh, facets[name]) > 0]
    return Domain(mesh, largest_diameter(mesh), shape.parts, facets, {}, CURVATURE, shape_name, True, made)


def height_of_cells(mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32]) -> Array:
    """How far the cell behind each boundary facet is above it, in the last coordinate."""
    dim = mesh.topology.dim
    of_facets = mesh.topology.connectivity(dim - 1, dim)
    cells = of_facets.array[of_facets.offsets[facets]]
    middle = [
        dolfinx.mesh.compute_midpoints(mesh, d, some)[:, dim - 1] for d, some in ((dim, cells), (dim - 1, facets))
    ]
    return np.asarray(middle[0] - middle[1], dtype=np.float64)


class Source(Protocol):
    """Whatever a mesh is read or made from, on rank 0, that is no named shape."""

    @property
    def name(self) -> str:
        """Name of the domain."""

    @property
    def words(self) -> str:
        """What it is, in words for messages."""

    @property
    def made(self) -> str:
        """How the mesh is made, in words."""

    def size(self, h: float | None) -> tuple[int, float]:
        """Dimension and number of cells of the mesh; with h an estimate (rank 0).

        Raises:
            InputError: If the mesh cannot be used, or there are more than MAX_CELLS.
        """

    def read(self, h: float | None) -> tuple[FileMesh, int]:
        """The mesh with largest cell diameter h, or with sizes of its own; how often it is to be refined (rank 0).

        Raises:
            InputError: If the mesh cannot be used.
        """


@dataclass(frozen=True)
class MeshFile:
    """A mesh file, or a geometry for Gmsh, as the source of a mesh.

    Attributes:
        path: The path.
        faces: Names for faces, see `named_faces`.
        sizes: Sizes of cells at parts or regions of a geometry, see `read_mesh_file`.
    """

    path: str
    faces: Mapping[str, Rule] = MappingProxyType({})
    sizes: Sizes = ()

    @property
    def name(self) -> str:
        """See `Source`."""
        return Path(self.path).name

    @property
    def words(self) -> str:
        """See `Source`."""
        return f"mesh {self.path}"

    @property
    def made(self) -> str:
        """See `Source`."""
        return "Gmsh" if is_geometry(self.path) else "file"

    def size(self, h: float | None) -> tuple[int, float]:
        """See `Source`."""
        return expected_size(self.path, h, self.sizes)

    def read(self, h: float | None) -> tuple[FileMesh, int]:
        """See `Source`."""
        levels, by_gmsh = self._refinements(h)
        return named(self._coarse_enough(h, levels, by_gmsh), self.faces, self.path), levels

    def _refinements(self, h: float | None) -> tuple[int, int]:
        """How often the mesh of a geometry is refined uniformly by us, and how often by Gmsh (rank 0).

        Gmsh knows where new points of a curved boundary are. In space its children would be flat.
        """
        if h is None or not is_geometry(self.path):
            return 0, 0
        dim, cells = self.size(h)
        levels = refinements(cells, dim)
        if own_size(self.path, self.sizes).straight:
            return levels, 0
        return 0, levels if dim == 2 else 0

    def _coarse_enough(self, h: float | None, levels: int, by_gmsh: int) -> FileMesh:
        """A mesh whose uniform refinement has cells of diameter at most h (rank 0)."""
        asked = None if h is None else h * 2**levels
        mesh = read_mesh_file(self.path, asked, by_gmsh, self.sizes)
        while h is not None and asked is not None and levels > 0 and mesh.dim == 3:
            achieved = 2 * refined_diameter(mesh.points, mesh.cells)
            if achieved <= h * 2**levels:
                break
            asked *= 0.98 * h * 2**levels / achieved
            mesh = read_mesh_file(self.path, asked, sizes=self.sizes)
        return mesh


def own_domain(
    comm: MPI.Comm,
    source: Source,
    h: float | None,
    conditions: Mapping[str, Sequence[str]],
    sides: Mapping[str, Side] | None = None,
    pairs: Sequence[Sequence[str]] = (),
) -> Domain:
    """Read or make a mesh that is of no named shape, and check it (collective).

    Args:
        comm: Communicator of the mesh; rank 0 reads it.
        source: Its source.
        h: Wanted largest cell diameter of a mesh that is made; None for the sizes of the source.
        conditions: The parts with each kind of condition, see `check_boundary`; the mesh is cut along those of "inner".
        sides: The named sides of inner parts, see `cut.opened`.
        pairs: The parts of each pair of surfaces, see `Domain.together`.

    Raises:
        InputError: If the source, its mesh or its parts cannot be used, or the mesh does not fit into memory.
    """
    read: list[FileMesh] = []
    if h is not None:
        check_memory(comm, f"{source.words}, h = {h:g}", *on_root(comm, lambda: source.size(h)), h)

    def about() -> tuple[int, int, int, str]:
        mesh, levels = source.read(h)
        read.append(usable(source, mesh, conditions, sides or {}))
        return mesh.dim, len(mesh.cells), levels, mesh.changed

    dim, size, levels, changed = on_root(comm, about)
    check_memory(comm, source.words, dim, size * 2 ** (dim * levels))
    domain = handed_out(comm, read[0] if read else None, source.name, source.made, pairs)
    for _ in range(levels):
        domain = refined_uniformly(domain)
    return replace(domain, changed=changed)


def usable(
    source: Source, mesh: FileMesh, conditions: Mapping[str, Sequence[str]], sides: Mapping[str, Side]
) -> FileMesh:
    """The mesh of a source, cut along its inner parts (rank 0).

    Args:
        source: The source, for messages.
        mesh: The mesh.
        conditions: See `own_domain`.
        sides: See `own_domain`.

    Raises:
        InputError: If its parts do not define a problem.
    """
    with telling(source.words):
        mesh = opened(mesh, inner, sides) if (inner := conditions.get("inner", ())) else mesh
        check_boundary(mesh, conditions)
    return mesh


@dataclass(frozen=True)
class OwnSize:
    """Properties of the mesh of a file with the file's own sizes."""

    dim: int
    cells: int
    h: float
    straight: bool


def own_size(path: str, sizes: Sizes = ()) -> OwnSize:
    """The properties of a file as it is now; a file that has not changed is read once."""
    about = os.stat(path) if os.path.exists(path) else None
    return _read_own_size(path, sizes, about and (about.st_ino, about.st_size, about.st_mtime_ns))


@functools.cache
def _read_own_size(path: str, sizes: Sizes, _version: tuple[int, int, int] | None) -> OwnSize:
    mesh = read_mesh_file(path, sizes=sizes)
    return OwnSize(mesh.dim, len(mesh.cells), float(diameters(mesh.points, mesh.cells).max()), mesh.straight)


def expected_size(path: str, h: float | None, sizes: Sizes = ()) -> tuple[int, float]:
    """Dimension and number of cells of the mesh of a file; with h an estimate from its own sizes (rank 0).

    Raises:
        InputError: If the file or its mesh cannot be used, or there are more than MAX_CELLS.
    """
    own = own_size(path, sizes)
    return own.dim, own.cells if h is None else allowed(own.cells * (own.h / h) ** own.dim, h, path)


def allowed(cells: float, h: float, name: str) -> float:
    """This number of cells of a mesh.

    Raises:
        InputError: If there are more than MAX_CELLS.
    """
    if cells > MAX_CELLS:
        raise InputError(f"h = {h:g} asks for about {cells:.1e} cells of {name}; at most {MAX_CELLS:.0e} are made")
    return cells


def _gmsh_mesh(shape_name: str, h: float, levels: int) -> Simplices:
    """Mesh with Gmsh, with another size parameter each time, until no cell is larger than h (rank 0 only).

    If the mesh will be refined uniformly, twice the diameters of the cells of the next mesh count instead: children of
    a tetrahedron may be longer than half of it, but this happens only in the first refinement. A few tetrahedra that
    are too long decide then about all, so several meshes are tried, and that with the fewest cells is taken, or the
    first one that is nearly as coarse as it may be.
    """
    shape = shape_of(shape_name)
    trials = TRIALS if shape.dim == 3 and levels > 0 else 1
    best: Simplices | None = None
    with unseen():  # Gmsh has a PETSc of its own
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    listen_again()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
        gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 0)
        if trials > 1:
            gmsh.option.setNumber("Mesh.OptimizeThreshold", GOOD)
        shape.outline()
        gmsh.model.geo.synchronize()
        size = {2: 0.72, 3: 0.47}[shape.dim] * h
        while trials > 0 or best is None:
            gmsh.option.setNumber("Mesh.MeshSizeMin", size)
            gmsh.option.setNumber("Mesh.MeshSizeMax", size)
            gmsh.model.mesh.clear()
            gmsh.model.mesh.generate(shape.dim)
            mesh = _gmsh_simplices(shape.dim)
            achieved = _diameter_in_time(shape_name, *mesh, levels)
            if achieved <= h and (best is None or len(mesh[1]) < len(best[1])):
                best = mesh
            trials = 0 if NEAR * h <= achieved <= h else trials - 1
            size *= (0.99 if trials > 0 else 0.94) * h / achieved
        return best[0] + np.array(shape.corner or 0.0), best[1]
    finally:
        gmsh.finalize()


def _diameter_in_time(shape_name: str, points: Array, cells: Indices, levels: int) -> float:
    """Largest diameter of these cells; twice that of their children if they will be refined uniformly (rank 0 only)."""
    shape = shape_of(shape_name)
    if levels == 0:
        return float(diameters(points, cells).max())
    if all(part.nearest is None for part in shape.parts.values()):
        return 2 * refined_diameter(points, cells)
    return 2 * refined_uniformly(label_parts(distribute(MPI.COMM_SELF, points, cells, shape.dim), shape_name)).h


def _gmsh_simplices(dim: int) -> Simplices:
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    _, nodes = gmsh.model.mesh.getElementsByType({2: 2, 3: 4}[dim])  # Gmsh's numbers of triangle and tetrahedron
    row = np.empty(int(tags.max()) + 1, dtype=np.int64)
    row[tags.astype(np.int64)] = np.arange(len(tags))
    used, cells = np.unique(row[nodes.astype(np.int64)], return_inverse=True)  # removes centres of circles
    return coordinates.reshape(-1, 3)[used, :dim], cells.reshape(-1, dim + 1).astype(np.int64)
