"""Makes domains: meshes of named shapes with a given h, and meshes from files."""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import dolfinx.mesh
import gmsh
import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.signals import listen_again
from signorini_fenicsx.meshes.checks import FileMesh, check_boundary, diameters
from signorini_fenicsx.meshes.domain import (
    AXES,
    Domain,
    Marks,
    axis_part,
    distribute,
    largest_diameter,
    marked_domain,
)
from signorini_fenicsx.meshes.files import MAX_CELLS, read_mesh_file
from signorini_fenicsx.meshes.grids import Simplices
from signorini_fenicsx.meshes.shapes import SHAPES, Shape

CURVATURE = 1.0
"""`Domain.curvature` of named shapes: radii of curvature R are at least 1/8, and a chord of length h is at most h²/(8R)
from its circle."""
OWN_CURVATURE = 8.0
"""`Domain.curvature` of a domain of size 1 from a file, on the assumption that radii are at least 1/64."""


def estimated_cells(shape_name: str, h: float) -> float:
    """Rough number of cells of an unstructured mesh of a named shape with largest cell diameter h.

    Raises:
        InputError: If there are more than MAX_CELLS.
    """
    shape, edge = SHAPES[shape_name], 0.65 * h
    cells = shape.measure / (edge**2 * math.sqrt(3) / 4 if shape.dim == 2 else edge**3 / (6 * math.sqrt(2)))
    return _allowed(cells, h, shape_name)


def build_domain(comm: MPI.Comm, shape_name: str, h: float, *, mesh: str, diagonal: str | None = None) -> Domain:
    """Mesh a named shape so that its largest cell diameter is at most h and more than h/2 (collective).

    Args:
        comm: Communicator of the mesh; rank 0 generates it.
        shape_name: Key of SHAPES.
        h: Wanted largest cell diameter.
        mesh: "unstructured" (Gmsh) or "structured".
        diagonal: How structured squares are cut: left, right (the default) or crossed.

    Raises:
        InputError: If h asks for more than MAX_CELLS cells or no mesh with this h exists.
    """
    shape = SHAPES[shape_name]
    estimated_cells(shape_name, h)  # raises if there are too many

    def generate() -> Simplices:
        if mesh == "structured" and shape.grid is not None:
            points, cells = shape.grid(h, diagonal or "right")
        else:
            points, cells = _gmsh_mesh(shape, h)
        achieved = float(diameters(points, cells).max())
        if not h / 2 < achieved <= h * (1 + 1e-12):
            raise InputError(
                f"h = {h:g}: {mesh} meshes of {shape_name} near this size have largest diameter {achieved:.4g}, "
                "not in (h/2, h]; choose a smaller h"
            )
        return points, cells

    simplices = on_root_only(comm, generate, shape.dim)
    return label_parts(distribute(comm, *simplices, shape.dim), shape_name)


def on_root_only(comm: MPI.Comm, generate: Callable[[], Simplices], dim: int) -> Simplices:
    """Generate a mesh on rank 0; other ranks get empty arrays, which `create_mesh` needs (collective)."""
    made: list[Simplices] = []
    on_root(comm, lambda: made.append(generate()))
    return made[0] if made else (np.empty((0, dim)), np.empty((0, dim + 1), dtype=np.int64))


def label_parts(mesh: dolfinx.mesh.Mesh, shape_name: str) -> Domain:
    """Find the facets of each boundary part of a named shape (collective)."""
    dim, shape = mesh.topology.dim, SHAPES[shape_name]
    mesh.topology.create_connectivity(dim - 1, dim)
    facets = {
        name: dolfinx.mesh.locate_entities_boundary(mesh, dim - 1, part.contains) for name, part in shape.parts.items()
    }
    return Domain(mesh, largest_diameter(mesh), shape.parts, facets, {}, CURVATURE, shape_name, is_shape=True)


def own_domain(comm: MPI.Comm, path: str, h: float | None, conditions: Mapping[str, Sequence[str]]) -> Domain:
    """Read a mesh, or make the mesh of a `.geo` file, and check it (collective).

    Args:
        comm: Communicator of the mesh; rank 0 reads it.
        path: Path of the file.
        h: Wanted largest cell diameter for the mesh of a `.geo` file; None for the sizes in the file.
        conditions: The parts with each kind of condition, see `check_boundary`.

    Raises:
        InputError: If the file, its mesh or its parts cannot be used.
    """
    read: list[FileMesh] = []

    def about() -> tuple[int, dict[str, str], tuple[str, ...], float]:
        mesh = read_mesh_file(path, h)
        try:
            check_boundary(mesh, conditions)
        except InputError as error:
            raise InputError(f"mesh {path}: {error}") from None
        read.append(mesh)
        labels = {name: AXES[_longest_axis(mesh.points[facets])] for name, facets in mesh.parts.items()}
        return mesh.dim, labels, tuple(mesh.regions), OWN_CURVATURE / float(np.ptp(mesh.points, axis=0).max())

    dim, labels, regions, curvature = on_root(comm, about)
    points, cells = np.empty((0, dim)), np.empty((0, dim + 1), dtype=np.int64)
    facets: Mapping[str, Indices] = {name: np.empty((0, dim), dtype=np.int64) for name in labels}
    inside = None
    if read:
        points, cells, facets = read[0].points, read[0].cells, read[0].parts
        inside = np.zeros((len(cells), len(regions)), dtype=bool)
        for column, chosen in enumerate(read[0].regions.values()):
            inside[chosen, column] = True
    parts = {name: axis_part(label) for name, label in labels.items()}
    mesh, marks = distribute(comm, points, cells, dim), Marks(facets, inside, regions)
    return marked_domain(mesh, parts, marks, curvature=curvature, name=Path(path).name)


@functools.cache
def _own_size(path: str) -> tuple[int, int, float]:
    mesh = read_mesh_file(path)
    return mesh.dim, len(mesh.cells), float(diameters(mesh.points, mesh.cells).max())


def expected_cells(path: str, h: float | None) -> float:
    """Number of cells of the mesh of a file; for a `.geo` file with h an estimate from its own sizes (rank 0).

    Raises:
        InputError: If the file or its mesh cannot be used, or there are more than MAX_CELLS.
    """
    dim, cells, own_h = _own_size(path)
    return cells if h is None else _allowed(cells * (own_h / h) ** dim, h, path)


def _allowed(cells: float, h: float, name: str) -> float:
    if cells > MAX_CELLS:
        raise InputError(f"h = {h:g} asks for about {cells:.1e} cells of {name}; at most {MAX_CELLS:.0e} are made")
    return cells


def _longest_axis(points: Array) -> int:
    return int(np.argmax(np.ptp(points.reshape(-1, points.shape[-1]), axis=0))) if points.size else 0


def _gmsh_mesh(shape: Shape, h: float) -> Simplices:
    """Mesh with Gmsh and reduce its size parameter until no cell is larger than h (rank 0 only)."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    listen_again()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
        gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 0)
        shape.outline()
        gmsh.model.geo.synchronize()
        size, achieved = {2: 0.72, 3: 0.47}[shape.dim] * h, math.inf
        while achieved > h:
            gmsh.option.setNumber("Mesh.MeshSizeMin", size)
            gmsh.option.setNumber("Mesh.MeshSizeMax", size)
            gmsh.model.mesh.clear()
            gmsh.model.mesh.generate(shape.dim)
            points, cells = _gmsh_simplices(shape.dim)
            achieved = float(diameters(points, cells).max())
            size *= 0.94 * h / achieved
        return points, cells
    finally:
        gmsh.finalize()


def _gmsh_simplices(dim: int) -> Simplices:
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    _, nodes = gmsh.model.mesh.getElementsByType({2: 2, 3: 4}[dim])  # Gmsh's numbers of triangle and tetrahedron
    row = np.empty(int(tags.max()) + 1, dtype=np.int64)
    row[tags.astype(np.int64)] = np.arange(len(tags))
    used, cells = np.unique(row[nodes.astype(np.int64)], return_inverse=True)  # removes centres of circles
    return coordinates.reshape(-1, 3)[used, :dim], cells.reshape(-1, dim + 1).astype(np.int64)
