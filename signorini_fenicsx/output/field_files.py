"""Files of fields for ParaView: VTX and XDMF, and the room that they take."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree

from dolfinx import fem, io
from mpi4py import MPI

from signorini_fenicsx.base.errors import WriteFailure
from signorini_fenicsx.base.parallel import on_root

XINCLUDE = "http://www.w3.org/2001/XInclude"


def write_files(comm: MPI.Comm, folder: Path, sizes: Mapping[str, int], write: Callable[[], None]) -> None:
    """Write `solution.xdmf` and others, if there is room for them (collective).

    Args:
        comm: Communicator.
        folder: Where.
        sizes: About the largest sizes of the files, in bytes.
        write: Writes them (collective).

    Raises:
        OSError: On all ranks, if there is no room.
        WriteFailure: If a library cannot write, on this rank at least.
    """
    on_root(comm, lambda: check_room(folder, sizes))
    try:
        write()
    except RuntimeError as error:  # kept as the cause: it holds the open file, and closing that would abort
        raise WriteFailure("the fields for ParaView cannot be written") from error
    on_root(comm, lambda: join_grids(folder / "solution.xdmf"))


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


def write_vtx(comm: MPI.Comm, path: Path, functions: list[fem.Function]) -> None:
    """Write one file (collective). After a failure it is not closed: closing would wait for other ranks, or abort.

    The format is BP4: with ADIOS2's newer BP5, several ranks wait for each other forever if the disk is full.
    """
    file = io.VTXWriter(comm, path, functions, engine="BP4")
    file.write(0.0)
    file.close()


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
