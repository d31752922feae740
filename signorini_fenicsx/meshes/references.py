"""Checks the references in mesh files: XML may refer to HDF5 files in its folder, and nothing may grow when read."""

from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import h5py

from signorini_fenicsx.base.errors import InputError

XML = (".vtu", ".xdmf", ".xmf", ".xml")
HDF5 = (".h5m", ".hmf", ".med", ".cgns")


def check_references(path: Path) -> None:
    """Check a file before a library reads it.

    Raises:
        InputError: If it has a reference that is not allowed, or declares XML entities.
    """
    suffix = path.suffix.lower()  # like meshio
    if suffix in XML:
        _check_head(path)
    if suffix in HDF5:
        _check_hdf5(path)
    if suffix in (".xdmf", ".xmf"):
        for file in {_beside(path, item) for item in ElementTree.parse(path).iter()} - {None}:
            _check_hdf5(Path(str(file)))


class _Root(Exception):
    """Ends the parser at the first element, after which nothing can be declared."""


def _check_head(path: Path) -> None:
    """Refuse declarations: entities can be other files or fill the memory. The empty DOCTYPE of DOLFINx is allowed."""

    def refuse(*_: object) -> None:
        raise InputError(
            "declares entities or defaults in its DOCTYPE, which can grow or be other files; leave them out"
        )

    def stop(*_: object) -> None:
        raise _Root

    parser = expat.ParserCreate()
    parser.EntityDeclHandler = parser.AttlistDeclHandler = refuse
    parser.ElementDeclHandler = parser.NotationDeclHandler = refuse
    parser.StartElementHandler = stop
    try:
        with path.open("rb") as file:
            parser.ParseFile(file)
    except _Root:
        return
    except expat.ExpatError as error:
        raise InputError(f"is not XML ({error})") from None


def _beside(path: Path, item: ElementTree.Element) -> Path | None:
    """The HDF5 file of an array in XDMF, or None; meshio reads arrays from elements with any name."""
    kind, text = item.get("Format", "XML"), (item.text or "").strip()
    if kind == "XML":
        return None
    if kind != "HDF":
        raise InputError(f"has an array in the format '{kind}'; use XML or HDF")
    name = text.partition(":")[0]
    folder = path.resolve().parent
    if not name or Path(name).is_absolute() or not (folder / name).resolve().is_relative_to(folder):
        raise InputError(f"has an array in '{name}', which is outside the folder of the mesh")
    if not (folder / name).is_file():
        raise InputError(f"has an array in '{name}', and there is no such file beside it")
    return folder / name


def _check_hdf5(path: Path) -> None:
    """Refuse links to other files, and arrays whose values lie in other files."""
    with h5py.File(path, "r") as file:
        seen: set[int] = set()
        todo: list[h5py.Group] = [file]
        while todo:
            group = todo.pop()
            for name in group:
                try:
                    link = group.get(name, getlink=True)
                except TypeError:
                    link = None
                if isinstance(link, h5py.SoftLink):  # its target is checked in its own place
                    continue
                if not isinstance(link, h5py.HardLink):
                    raise InputError(
                        f"'{name}' in {path.name} is a link to another file; an array has to be in the file"
                    )
                item = group[name]
                address = h5py.h5o.get_info(item.id).addr
                if isinstance(item, h5py.Group) and address not in seen:
                    todo.append(item)
                seen.add(address)
                if isinstance(item, h5py.Dataset) and (item.is_virtual or item.external):
                    raise InputError(
                        f"the values of '{name}' in {path.name} are in another file; an array has to be in the file"
                    )
