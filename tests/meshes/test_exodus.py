"""Exodus files: sides of all elements by number, sets of nodes, blocks as regions, both kinds of netCDF, refusals."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import netcdf_file

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.checks import checked
from signorini_fenicsx.meshes.files import read_mesh_file
from signorini_fenicsx.meshes.meshio_files import read_with_meshio

SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
CUBE = [*SQUARE, *[[x, y, 1] for x, y, _ in SQUARE]]
CORNER = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def chars(names: list[str]) -> np.ndarray:
    return np.array([list(name.ljust(32, "\0")) for name in names], dtype="S1")


def exodus(points: Any, blocks: list[tuple[str, Any]], sides: dict[str, Any], nodes: dict[str, Any]) -> dict[str, Any]:
    """The variables of a file; elements, sides and points are counted from 1, as in Exodus."""
    points, data = np.asarray(points, dtype=float), dict[str, Any]()
    data |= {f"coord{axis}": column for axis, column in zip("xyz", points.T, strict=False)}
    data |= {f"connect{i}": np.array(rows, np.int32) for i, (_, rows) in enumerate(blocks, start=1)}
    data |= {"eb_prop1": np.arange(10, 10 + len(blocks), dtype=np.int32)}
    for kind, keys, sets in (("ss", ("elem_ss", "side_ss"), sides), ("ns", ("node_ns",), nodes)):
        data |= {f"{kind}_prop1": np.arange(1, 1 + len(sets), dtype=np.int32)} if sets else {}
        data |= {f"{kind}_names": chars([name if not name.isdecimal() else "" for name in sets])} if sets else {}
        for i, rows in enumerate(sets.values(), start=1):
            columns = np.array(rows, np.int32).reshape(-1, len(keys)).T
            data |= {f"{key}{i}": column for key, column in zip(keys, columns, strict=True)}
    return data


def written(path: Path, data: dict[str, Any], types: list[str]) -> str:
    """The file, in netCDF-3 or as what netCDF-4 is, HDF5."""
    if path.suffix == ".exo":
        with h5py.File(path, "w") as file:
            for name, values in data.items():
                file[name] = values
            for i, each in enumerate(types, start=1):
                file[f"connect{i}"].attrs["elem_type"] = each
        return str(path)
    with netcdf_file(path, "w", version=2) as file:
        for name, values in data.items():
            dims = [f"{name}_{axis}" for axis in range(values.ndim)]
            for dim, size in zip(dims, values.shape, strict=True):
                file.createDimension(dim, size)
            variable = file.createVariable(name, values.dtype, dims)
            variable[:] = values
        for i, each in enumerate(types, start=1):
            file.variables[f"connect{i}"].elem_type = each
    return str(path)


def places(path: Path, points: Any, blocks: list[tuple[str, Any]], sides: dict[str, Any], nodes: Any = ()) -> Any:
    """The middles of the facets of each part."""
    file = Path(written(path, exodus(points, blocks, sides, dict(nodes)), [kind for kind, _ in blocks]))
    mesh = checked(read_with_meshio(file))
    return {name: mesh.points[facets].mean(axis=(0, 1)).round(6).tolist() for name, facets in mesh.parts.items()}


@pytest.mark.parametrize(
    ("kind", "points", "middles"),
    [
        ("TRI3", [p[:2] for p in CORNER], [(0.5, 0), (0.5, 0.5), (0, 0.5)]),
        ("QUAD4", [p[:2] for p in SQUARE], [(0.5, 0), (1, 0.5), (0.5, 1), (0, 0.5)]),
        ("TETRA", [*CORNER, [0, 0, 1]], [(1 / 3, 0, 1 / 3), (1 / 3,) * 3, (0, 1 / 3, 1 / 3), (1 / 3, 1 / 3, 0)]),
        ("HEX8", CUBE, [(0.5, 0, 0.5), (1, 0.5, 0.5), (0.5, 1, 0.5), (0, 0.5, 0.5), (0.5, 0.5, 0), (0.5, 0.5, 1)]),
        (
            "WEDGE",
            [*CORNER, *[[x, y, 1] for x, y, _ in CORNER]],
            [(0.5, 0, 0.5), (0.5, 0.5, 0.5), (0, 0.5, 0.5), (1 / 3, 1 / 3, 0), (1 / 3, 1 / 3, 1)],
        ),
        (
            "PYRAMID5",
            [*SQUARE, [0.5, 0.5, 1]],
            [(0.5, 1 / 6, 1 / 3), (5 / 6, 0.5, 1 / 3), (0.5, 5 / 6, 1 / 3), (1 / 6, 0.5, 1 / 3), (0.5, 0.5, 0)],
        ),
        ("SHELL4", SQUARE, [None, None, (0.5, 0), (1, 0.5), (0.5, 1), (0, 0.5)]),
        ("TRI", CORNER, [None, None, (0.5, 0), (0.5, 0.5), (0, 0.5)]),
    ],
)
def test_sides_of_elements(tmp_path: Path, kind: str, points: Any, middles: Any):
    """They are where Exodus' manual has them; those of a shell are its edges from the third on."""
    sides = {f"s{i}": [(1, i)] for i in range(1, len(middles) + 1)}
    found = places(tmp_path / "mesh.e", points, [(kind, [range(1, len(points) + 1)])], sides)
    wanted = {f"s{i}": list(each) for i, each in enumerate(middles, start=1) if each is not None}
    assert found.keys() == wanted.keys()
    for name, middle in wanted.items():  # a square face is cut along either diagonal, with the same middle
        np.testing.assert_allclose(found[name], middle, atol=1e-6)


@pytest.mark.parametrize("ending", ["e", "exo", "g"])
def test_blocks_and_sets(tmp_path: Path, ending: str):
    """Two blocks are regions; sets without names have their numbers; a set of sides goes before one of nodes."""
    points, path = [*[p[:2] for p in SQUARE], [2, 0], [2, 1]], tmp_path / f"mesh.{ending}"
    blocks = [("QUAD4", [[1, 2, 3, 4]]), ("TRI3", [[2, 5, 6], [2, 6, 3]])]
    sides = {"right": [(2, 2)], "2": [(1, 4)], "fault": [(1, 2)]}
    nodes = {"bottom": [1, 2, 5], "right": [3, 4, 6]}
    found = places(path, points, blocks, sides, nodes)
    assert found == {"right": [2, 0.5], "2": [0, 0.5], "fault": [1, 0.5], "bottom": [1, 0]}
    regions = checked(read_with_meshio(path)).regions
    assert {name: len(cells) for name, cells in regions.items()} == {"10": 2, "11": 2}


def test_values_at_points(tmp_path: Path):
    """They are those of the last time, names with x and y at the end one vector, as MOOSE writes them."""
    data = exodus([p[:2] for p in SQUARE], [("QUAD4", [[1, 2, 3, 4]])], {}, {})
    values = {"u": [0, 1, 2, 3], "disp_x": [1, 1, 1, 1], "disp_y": [2, 2, 2, 2]}
    data["name_nod_var"] = chars(list(values))
    data |= {f"vals_nod_var{i}": np.array([[9.0] * 4, of]) for i, of in enumerate(values.values(), start=1)}
    read = read_mesh_file(written(tmp_path / "mesh.e", data, ["QUAD4"])).values
    assert {name: each.tolist() for name, each in read.items()} == {"u": [0, 1, 2, 3], "disp": [[1, 2]] * 4}


@pytest.mark.parametrize(
    ("kind", "points", "sides", "message"),
    [
        ("QUAD4", SQUARE, {"s": [(2, 1)]}, "set of sides 's' is on elements that there are not"),
        ("QUAD9", SQUARE, {}, "quad9"),
    ],
)
def test_refusals(tmp_path: Path, kind: str, points: Any, sides: Any, message: str):
    """One sentence says what is wrong."""
    corners = [*range(1, 5), *[1] * 5] if kind == "QUAD9" else range(1, 5)
    with pytest.raises(InputError, match=message):
        places(tmp_path / "mesh.e", points, [(kind, [corners])], sides)
    (tmp_path / "mesh.e").write_bytes(b"CDF\x05")
    with pytest.raises(InputError, match="is no Exodus file of netCDF-3 or netCDF-4"):
        read_with_meshio(tmp_path / "mesh.e")
