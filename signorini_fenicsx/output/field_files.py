"""Files of fields for ParaView: VTX and XDMF, and the room that they take."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import dolfinx.mesh
from dolfinx import fem, io
from mpi4py import MPI

from signorini_fenicsx.base.errors import WriteFailure
from signorini_fenicsx.base.parallel import give_back_memory, on_root

XINCLUDE = "http://www.w3.org/2001/XInclude"
NUMBER, PLACE, VTX = 8, 24, 9
"""Bytes of a number, of a point, and of what VTX adds to a point."""


def check_room(folder: Path, sizes: Mapping[str, int]) -> None:
    """Make sure that there is disk space for the files, because ADIOS2 and HDF5 abort on a full disk (rank 0).

    The space is allocated and freed again.

    Raises:
        OSError: If the disk is full.
    """
    places = {folder / f"{name}.room": size for name, size in sizes.items()}
    try:
        for place, size in places.items():
            with place.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, size)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from None
    finally:
        for place in places:
            place.unlink(missing_ok=True)


def write_vtx(path: Path, functions: Sequence[fem.Function]) -> None:
    """Write functions of one element, if there is room for the file (collective).

    The format is BP4: with ADIOS2's newer BP5, several ranks wait for each other forever if the disk is full.

    Raises:
        OSError: On all ranks, if there is no room.
        WriteFailure: If the library cannot write, on this rank at least.
    """
    mesh, layout = functions[0].function_space.mesh, functions[0].function_space.dofmap.dof_layout
    points = max(layout.num_dofs, mesh.topology.dim + 1)
    of_point = PLACE + VTX + NUMBER * sum(map(_width, functions))
    give_back_memory()  # the file takes more than the fields
    with _written(mesh.comm, path, _cells(mesh) * (points * of_point + (points + 1) * NUMBER)):
        file = io.VTXWriter(mesh.comm, path, list(functions), engine="BP4")
        file.write(0.0)
        file.close()


def write_xdmf(path: Path, functions: Sequence[fem.Function]) -> None:
    """Write functions in P0 beside the mesh, if there is room for the file (collective).

    Raises:
        OSError: On all ranks, if there is no room.
        WriteFailure: If the library cannot write, on this rank at least.
    """
    mesh = functions[0].function_space.mesh
    points = mesh.geometry.index_map().size_global * mesh.geometry.dim * NUMBER
    of_cell = NUMBER * (mesh.topology.dim + 1 + sum(map(_width, functions)))
    with _written(mesh.comm, path.with_suffix(".h5"), _cells(mesh) * of_cell + points):
        file = io.XDMFFile(mesh.comm, path, "w")
        file.write_mesh(mesh)
        for function in functions:
            file.write_function(function)
        file.close()
    on_root(mesh.comm, lambda: join_grids(path))


@contextmanager
def _written(comm: MPI.Comm, path: Path, size: int) -> Iterator[None]:
    """Make sure that there is room for a file of about this size, and tell if a library fails (collective).

    After a failure the file is not closed: closing would wait for other ranks, or abort.
    """
    on_root(comm, lambda: check_room(path.parent, {path.name: size + 12_000 + 3_000 * comm.size}))
    try:
        yield
    except RuntimeError as error:  # kept as the cause: it holds the open file
        raise WriteFailure("the fields for ParaView cannot be written") from error


def sizes_of_series(exact: Sequence[fem.Function], means: Sequence[fem.Function], steps: int) -> dict[str, int]:
    """About the largest sizes of the files of fields over time, in bytes (collective)."""
    (of_exact, of_means), heads = (functions[0].function_space for functions in (exact, means)), 20_000 + 7_000 * steps
    points = max(of_exact.dofmap.dof_layout.num_dofs, of_exact.mesh.topology.dim + 1)
    size = _cells(of_exact.mesh) * points * (PLACE + VTX + NUMBER + steps * NUMBER * sum(map(_width, exact)))
    mesh = of_means.mesh
    of_points = mesh.geometry.index_map().size_global * mesh.geometry.dim * NUMBER
    of_cells = _cells(mesh) * NUMBER * (mesh.topology.dim + 1 + steps * sum(map(_width, means)))
    room = heads + 3_000 * mesh.comm.size
    return {"solution.bp": size + room, "solution.h5": of_points + of_cells + room}


def _cells(mesh: dolfinx.mesh.Mesh) -> int:
    return int(mesh.topology.index_map(mesh.topology.dim).size_global)


def _width(function: fem.Function) -> int:
    """How many numbers the files have for a value: vectors and tensors are those in space."""
    return 3 ** len(function.ufl_shape)


def join_grids(path: Path) -> None:
    """Make one grid of the mesh and all functions, with a time, so that all readers can read the file (rank 0).

    DOLFINx writes one grid for each function, which meshio cannot read. PyVista needs a time in the grid, where meshio
    refuses it. So the grid refers VTK to a copy with a time, inside an element whose children meshio skips.
    """
    tree = ElementTree.parse(path)
    domain = tree.getroot()[0]
    mesh, *functions = list(domain)
    for grid in functions:
        mesh.extend(grid.iter("Attribute"))
        domain.remove(grid)
    mesh.set("Reference", "/Xdmf/Domain/Grid/Information/Grid")
    parts = " or ".join(f"self::{kind}" for kind in ("Topology", "Geometry", "Attribute"))
    information = ElementTree.SubElement(mesh, "Information", Name="with a time", Value="0")
    information.text = "<none/>"  # meshio needs XML here
    timed = ElementTree.SubElement(information, "Grid", Name="mesh", GridType="Uniform")
    ElementTree.SubElement(timed, f"{{{XINCLUDE}}}include", xpointer=f"xpointer(/Xdmf/Domain/Grid/*[{parts}])")
    ElementTree.SubElement(timed, "Time", Value="0")
    tree.write(path, encoding="utf-8", xml_declaration=True)


def join_series(path: Path) -> None:
    """Make one series of all functions, each time with its mesh, so that all readers can read the file (rank 0).

    DOLFINx writes a series for each function, whose times include the mesh in a way that VTK does not know.
    """
    tree = ElementTree.parse(path)
    domain = tree.getroot()[0]
    mesh, first, *others = list(domain)
    for grids in zip(first, *others, strict=True):
        time = grids[0].find("Time")
        parts = [*mesh, *([] if time is None else [time]), *(grid.find("Attribute") for grid in grids)]
        grids[0][:] = [part for part in parts if part is not None]
        grids[0].set("Name", "mesh")
    for other in others:
        domain.remove(other)
    first.set("Name", "fields")
    tree.write(path, encoding="utf-8", xml_declaration=True)
