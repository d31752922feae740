"""Mesh files in XML and HDF5 that are wrong or refer to others: one sentence each."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.checks import checked
from signorini_fenicsx.meshes.meshio_files import read_with_meshio

POINTS, CELLS = "0 0 1 0 0 1", "0 1 2"
VTU = """<?xml version="1.0"?>{head}<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">
<UnstructuredGrid><Piece NumberOfPoints="{count}" NumberOfCells="1"><Points>
<DataArray type="Float64" NumberOfComponents="{width}" format="ascii">{points}</DataArray></Points><Cells>
<DataArray type="Int64" Name="connectivity" format="ascii">{cells}</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">{end}</DataArray>
<DataArray type="Int64" Name="types" format="ascii">{kind}</DataArray>{more}
</Cells></Piece></UnstructuredGrid></VTKFile>
"""
FACES = """<DataArray type="Int64" Name="faces" format="ascii">4 3 0 1 2 3 0 1 3 3 0 2 3 3 1 2 3</DataArray>
<DataArray type="Int64" Name="faceoffsets" format="ascii">17</DataArray>"""
TRIANGLE = {
    "head": "",
    "count": 3,
    "width": 3,
    "points": "0 0 0 1 0 0 0 1 0",
    "cells": CELLS,
    "end": 3,
    "kind": 5,
    "more": "",
}
TETRAHEDRON = {"count": 4, "points": "0 0 0 1 0 0 0 1 0 0 0 1", "cells": "0 1 2 3", "end": 4}
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
HEADS = {
    "bomb": BOMB + "]>",
    "a file as entity": '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>',
    "parameters": '<!DOCTYPE x [<!ENTITY % a SYSTEM "file:///etc/passwd"> %a;]>',
    "defaults": '<!DOCTYPE x [<!ATTLIST DataArray more CDATA "' + "a" * 1000 + '">]>',
}


def vtu(**changes: object) -> str:
    """A triangle in VTK's XML format, with changes."""
    return VTU.format(**TRIANGLE | changes)


def grid(name: str, kind: str, cells: str, shape: str, more: str) -> str:
    """A grid as DOLFINx writes it."""
    return (
        f'<Grid Name="{name}"><Topology TopologyType="{kind}"><DataItem Dimensions="{shape}" Format="XML">{cells}'
        f"</DataItem></Topology>{more}</Grid>"
    )


def numbers(values: str) -> str:
    """The numbers of `MeshTags`."""
    count = len(values.split())
    item = f'<DataItem Dimensions="{count} 1" Format="XML">{values}</DataItem>'
    return f'<Attribute Name="t" Center="Cell">{item}</Attribute>'


def xdmf(
    points: str = POINTS,
    shape: str = "3 2",
    triangle: tuple[str, str] = (CELLS, "1 3"),
    sides: tuple[str, str] = ("0 1 1 2", "2 2"),
    tags: str = "7 8",
    cell: tuple[str, str] = (CELLS, "1 3"),
    item: str = 'Format="XML"',
) -> str:
    """A triangle with numbers on two sides and on itself, as DOLFINx writes it, with changes."""
    where = f'<Geometry GeometryType="XY"><DataItem Dimensions="{shape}" {item}>{points}</DataItem></Geometry>'
    return (
        '<?xml version="1.0"?><!DOCTYPE Xdmf SYSTEM "Xdmf.dtd" []><Xdmf Version="3.0"><Domain>'
        + grid("mesh", "Triangle", *triangle, where)
        + grid("sides", "PolyLine", *sides, numbers(tags))
        + grid("cells", "Triangle", *cell, numbers("3"))
        + "</Domain></Xdmf>"
    )


def hdf(name: str) -> str:
    """An XDMF file whose points are in an HDF5 file."""
    return xdmf(points=f"{name}:/points", item='Format="HDF"')


REFUSED = {
    "polyhedra": ("vtu", vtu(**TETRAHEDRON, kind=42, more=FACES), "1 element of kind 'polyhedron4'; only triangles"),
    "a polygon": ("vtu", vtu(kind=7), "polygon"),
    "one coordinate": ("vtu", vtu(width=1, points="0 1 2"), r"shape \(3, 1\); 2 or 3 coordinates"),
    "four coordinates": ("vtu", vtu(width=4, points="0 " * 12), r"shape \(3, 4\); 2 or 3 coordinates"),
    "a point that is not there": ("vtu", vtu(cells="0 1 9"), "a point that is not in the file"),
    "offsets of another mesh": ("vtu", vtu(end=-5), "mesh|cannot be read|points for each|holds"),
    "xdmf: cells too wide": (
        "xdmf",
        xdmf(triangle=("0 1 2 0", "1 4")),
        r"kind 'triangle' has the shape \(1, 4\); 3 points",
    ),
    "xdmf: cells in a row": ("xdmf", xdmf(triangle=(CELLS, "3")), r"kind 'triangle' has the shape \(3,\); 3 points"),
    "xdmf: sides too wide": (
        "xdmf",
        xdmf(sides=("0 1 2 0", "1 4"), tags="7"),
        r"'line' has the shape \(1, 4\); 2 points",
    ),
    "xdmf: tagged cells too wide": ("xdmf", xdmf(cell=("0 1 2 0", "1 4")), r"'triangle' has the shape \(1, 4\)"),
    "xdmf: other cells": ("xdmf", xdmf(cell=("0 1 1", "1 3")), "a cell that the mesh does not have"),
    "xdmf: one coordinate": ("xdmf", xdmf(points="0 1 2", shape="3 1"), r"shape \(3, 1\); 2 or 3 coordinates"),
    "xdmf: points in a row": ("xdmf", xdmf(shape="6"), r"shape \(6,\); 2 or 3 coordinates"),
    "xdmf: numbers missing": ("xdmf", xdmf(tags="7"), "the grid 'sides' has 1 numbers for 2 elements"),
    "xdmf: sides out of range": ("xdmf", xdmf(sides=("0 1 1 9", "2 2")), "a point that is not in the file"),
    "xdmf: not a number": ("xdmf", xdmf(points="0 0 1 0 0 x"), "cannot be read"),
    "xdmf: too few": ("xdmf", xdmf(points="0 0 1"), "cannot be read"),
    "xdmf: a file elsewhere": ("xdmf", hdf("/etc/passwd"), "'/etc/passwd', which is outside the folder of the mesh"),
    "xdmf: a file above": ("xdmf", hdf("../x.h5"), "'../x.h5', which is outside the folder"),
    "xdmf: through a link": ("xdmf", hdf("link/x.h5"), "'link/x.h5', which is outside the folder"),
    "xdmf: no such file": ("xdmf", hdf("none.h5"), "'none.h5', and there is no such file"),
    "xdmf: bytes of a file": ("xdmf", xdmf(points="/etc/passwd", item='Format="Binary"'), "in the format 'Binary'"),
    "xdmf: an external link": ("xdmf", hdf("external.h5"), "'points' in external.h5 is a link to another file"),
    "xdmf: a link to a link": ("xdmf", hdf("soft.h5"), "'out' in soft.h5 is a link to another file"),
    "xdmf: values elsewhere": ("xdmf", hdf("raw.h5"), "the values of 'points' in raw.h5 are in another file"),
    "xdmf: a virtual array": ("xdmf", hdf("virtual.h5"), "the values of 'points' in virtual.h5 are in another file"),
    "xdmf: another element": ("xdmf", hdf("../x.h5").replace("DataItem", "Item"), "'../x.h5', which is outside"),
    "xdmf: in capitals": ("XDMF", hdf("external.h5"), "is a link to another file"),
    "xdmf: in capitals, a bomb": (
        "XDMF",
        xdmf().replace('<!DOCTYPE Xdmf SYSTEM "Xdmf.dtd" []>', BOMB + "]>"),
        "declares",
    ),
    "xdmf: not HDF5": ("xdmf", hdf("mesh.xdmf"), "cannot be read"),
    "not XML": ("vtu", "\0\1\2", "is not XML"),
    "vtu: a bomb": ("vtu", vtu(head=HEADS["bomb"]), "declares entities or defaults"),
    **{
        f"xdmf: {name}": ("xdmf", xdmf().replace('<!DOCTYPE Xdmf SYSTEM "Xdmf.dtd" []>', head), "declares entities")
        for name, head in HEADS.items()
    },
}


def write_hdf5(folder: Path) -> None:
    """HDF5 files that refer to others in all the ways there are."""
    (folder / "link").symlink_to(folder.parent)
    values = np.array([[0, 0], [1, 0], [0, 1]], dtype=float)
    with h5py.File(folder / "good.h5", "w") as file:
        file["points"] = values
        file["again"] = file["/"]  # a loop
    with h5py.File(folder / "external.h5", "w") as file:
        file["points"] = h5py.ExternalLink("good.h5", "/points")
    with h5py.File(folder / "soft.h5", "w") as file:
        file["points"] = h5py.SoftLink("/group/out/points")
        file.create_group("group")["out"] = h5py.ExternalLink("good.h5", "/")
    with h5py.File(folder / "raw.h5", "w") as file:
        file.create_dataset("points", shape=(3, 2), dtype=float, external=[("/etc/passwd", 0, 48)])
    with h5py.File(folder / "virtual.h5", "w") as file:
        layout = h5py.VirtualLayout((3, 2), float)
        layout[:] = h5py.VirtualSource("good.h5", "points", (3, 2))
        file.create_virtual_dataset("points", layout)


@pytest.mark.parametrize("name", REFUSED)
def test_files_are_refused(tmp_path: Path, name: str):
    suffix, text, message = REFUSED[name]
    write_hdf5(tmp_path)
    file = tmp_path / f"mesh.{suffix}"
    file.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        checked(read_with_meshio(file))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("suffix", "text"), [("vtu", vtu()), ("xdmf", xdmf()), ("xdmf", hdf("good.h5"))])
def test_what_was_changed_is_a_mesh(tmp_path: Path, suffix: str, text: str):
    write_hdf5(tmp_path)
    (tmp_path / f"mesh.{suffix}").write_text(text)
    mesh = checked(read_with_meshio(tmp_path / f"mesh.{suffix}"))
    assert len(mesh.cells) == 1
    assert mesh.parts.keys() == ({"7", "8"} if suffix == "xdmf" else set())
