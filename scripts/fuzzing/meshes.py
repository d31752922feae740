"""Broken mesh files of many formats: broken text, broken bytes, and well-formed files with invalid meshes."""

import contextlib
import io
import itertools
import random
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import meshio
import numpy as np
from broken_input import MESH_MUTATIONS, msh_text, square_msh, write_broken_mesh

from fuzzing import BINARY, CASE, OUTPUT, TEXT, Broken, Valid, damaged
from signorini_fenicsx.meshes.checks import faces

FORMATS = {
    "msh22": (".msh", "gmsh22", {"binary": False}),
    "msh22 binary": (".msh", "gmsh22", {"binary": True}),
    "msh4": (".msh", "gmsh", {"binary": False}),
    "msh4 binary": (".msh", "gmsh", {"binary": True}),
    "vtu ascii": (".vtu", "vtu", {"binary": False}),
    "vtu binary": (".vtu", "vtu", {"binary": True, "compression": None}),
    "vtu zlib": (".vtu", "vtu", {"binary": True, "compression": "zlib"}),
    "vtk": (".vtk", "vtk", {"binary": False}),
    "vtk binary": (".vtk", "vtk", {"binary": True}),
    "xdmf": (".xdmf", "xdmf", {"data_format": "HDF"}),
    "xdmf xml": (".xdmf", "xdmf", {"data_format": "XML"}),
    "medit": (".mesh", "medit", {}),
    "medit binary": (".meshb", "medit", {}),
    "abaqus": (".inp", "abaqus", {}),
    "med": (".med", "med", {}),
    "off": (".off", "off", {}),
    "obj": (".obj", "obj", {}),
    "nastran": (".bdf", "nastran", {}),
    "dolfin": (".xml", "dolfin-xml", {}),
}
"""Formats that meshio writes: the ending, meshio's name of the format, its options."""
SUFFIXES = (
    ".msh", ".vtu", ".xdmf", ".mesh", ".geo", ".stl", ".e", ".cgns", ".h5m", ".ply", ".txt", "", ".xml", ".ugrid",
    ".node",
)  # fmt: skip
LAUGHS = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))
DOCTYPES = (
    f'<!DOCTYPE VTKFile [<!ENTITY l0 "lol">{LAUGHS}]>',
    '<!DOCTYPE VTKFile [<!ENTITY l9 SYSTEM "file:///etc/hostname">]>',
    '<!DOCTYPE VTKFile [<!ENTITY % p SYSTEM "http://127.0.0.1:9/x.dtd"> %p; <!ENTITY l9 "1">]>',
    '<!DOCTYPE VTKFile [<!ENTITY l9 "' + "1 " * 5_000_000 + '">]>',
)
POLYHEDRON = """<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"><UnstructuredGrid>
<Piece NumberOfPoints="4" NumberOfCells="1"><Points><DataArray type="Float64" NumberOfComponents="{n}" format="ascii">
0 0 0 1 0 0 0 1 0 0 0 1</DataArray></Points><Cells><DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3
</DataArray><DataArray type="Int64" Name="offsets" format="ascii">4</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">{kind}</DataArray>
<DataArray type="Int64" Name="faces" format="ascii">4 3 0 1 2 3 0 1 3 3 0 2 3 3 1 2 3</DataArray>
<DataArray type="Int64" Name="faceoffsets" format="ascii">17</DataArray></Cells></Piece></UnstructuredGrid></VTKFile>"""
DOLFINX = """<Xdmf Version="3.0"><Domain><Grid Name="mesh" GridType="Uniform">
<Topology TopologyType="Triangle" NumberOfElements="{cells}" NodesPerElement="3">{topology}</Topology>
<Geometry GeometryType="XY">{geometry}</Geometry></Grid>
<Grid Name="sides" GridType="Uniform">
<Topology TopologyType="PolyLine" NumberOfElements="{sides}" NodesPerElement="2">{lines}</Topology>
<Attribute Name="sides" AttributeType="Scalar" Center="Cell">{numbers}</Attribute></Grid></Domain></Xdmf>"""


def mesh_file(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A mesh that is broken in a known way, in its bytes or as a mesh; or a hostile file."""
    way = rng.choice([_known, _bytes, _bytes, _bytes, _structure, _structure, _dolfinx, _hostile])
    file, about, refused = way(rng, folder)
    if not (folder / "case.toml").exists():
        (folder / "case.toml").write_text(CASE.format(file=file, part=1), encoding="utf-8")
    command = rng.choice(["check", "check", "check", "info", "solve"])
    words = [command, "case.toml"] + (["--output", OUTPUT] if command == "solve" else [])
    return Broken(words, about, refused, earlier=command == "solve" and rng.random() < 0.5)


type Made = tuple[str, str, bool]


def _known(rng: random.Random, folder: Path) -> Made:
    """The ways of `tests/broken_input.py`; all these files must be refused."""
    index = rng.randrange(len(MESH_MUTATIONS))
    write_broken_mesh(folder, rng, index).rename(folder / "case.toml")
    return f"mesh{index}.msh", MESH_MUTATIONS[index].__name__.strip("_"), True


def square(rng: random.Random) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points, cells, sides and the numbers of the parts of a small square."""
    n = rng.choice([1, 2, 3, 4])
    nodes, elements = square_msh(n)
    points = np.array([[float(x) for x in line.split()[1:]] for line in nodes])
    rows = [[int(word) for word in line.split()] for line in elements]
    cells = np.array([row[5:] for row in rows if row[1] == 2]) - 1
    sides = np.array([row[5:] for row in rows if row[1] == 1]) - 1
    return points, cells, sides, np.array([row[3] for row in rows if row[1] == 1])


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Suppress the hints that meshio prints."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        yield


def _written(folder: Path, name: str, mesh: meshio.Mesh) -> Path:
    suffix, form, options = FORMATS[name]
    path = folder / f"mesh{suffix}"
    with warnings.catch_warnings(action="ignore"), _silence():
        meshio.write(path, mesh, form, **options)
    return path


def _mesh(rng: random.Random, name: str) -> meshio.Mesh:
    """A valid mesh, with part numbers in the form of its format."""
    points, cells, sides, numbers = square(rng)
    flat = points[:, :2] if name in ("xdmf", "medit", "dolfin") else points
    tags = [np.full(len(cells), 3), numbers]
    key = {"msh": "gmsh:physical", "med": "cell_tags" if name == "med" else "medit:ref"}.get(name[:3], "number")
    blocks = [("triangle", cells), ("line", sides)][: 1 if name == "obj" else 2]
    data = {key: tags}
    if name.startswith("msh"):
        data["gmsh:geometrical"] = tags
    nodes = {"gmsh:dim_tags": np.tile([2, 1], (len(points), 1))} if name.startswith("msh4") else {}
    return meshio.Mesh(flat, blocks, nodes, {} if name in ("off", "obj", "dolfin", "nastran") else data)


def _bytes(rng: random.Random, folder: Path) -> Made:
    """A valid file with damage; for XDMF in its text or in its arrays."""
    name = rng.choice(sorted(FORMATS))
    path = _written(folder, name, _mesh(rng, name))
    if name == "xdmf" and rng.random() < 0.5:
        path = path.with_suffix(".h5")
    text = "binary" not in name and path.suffix not in (".h5", ".med") and rng.random() < 0.8
    data, about = damaged(rng, path.read_bytes(), TEXT if text else BINARY)
    path.write_bytes(data)
    path = path.with_suffix(".xdmf") if path.suffix == ".h5" else path
    if rng.random() < 0.1:
        other = path.with_suffix(rng.choice(SUFFIXES))
        if other != path:
            path = path.rename(other)
            about += f" as {other.suffix}"
    return path.name, f"{name} {about}", False


def _structure(rng: random.Random, folder: Path) -> Made:
    """A well-formed file with an invalid mesh."""
    name = rng.choice([name for name in FORMATS if name not in ("med", "dolfin")])
    mesh = _mesh(rng, name)
    way = rng.choice(STRUCTURES)
    way(rng, mesh)
    try:
        path = _written(folder, name, mesh)
    except (Exception, SystemExit):  # meshio cannot write it: use the format that accepts all
        name, path = "vtu ascii", folder / "mesh.vtu"
        with contextlib.suppress(Exception, SystemExit):
            _written(folder, name, mesh)
    return path.name, f"{name} {way.__name__}", way in (sheets, hanging)


def bad_points(rng: random.Random, mesh: meshio.Mesh) -> None:
    """Points that are not finite, far away, all equal, or of another dimension."""
    points = mesh.points.astype(float).copy()
    match rng.randrange(7):
        case 0:
            points[rng.randrange(len(points))] = rng.choice([np.nan, np.inf, 1e308, -1e-320])
        case 1:
            points[:] = 0.5
        case 2:
            points = points[:, :1]
        case 3:
            points = np.column_stack([points, points])
        case 4:
            points = points * rng.choice([1e-200, 1e-160, 1e160, 1e300])
        case 5:
            points = points[: len(points) // 2]
        case _:
            points = points + rng.choice([1e8, 1e16])
    mesh.points = points


def bad_cells(rng: random.Random, mesh: meshio.Mesh) -> None:
    """Cells with missing or repeated vertices, or with vertices of another number or type."""
    block = rng.choice(mesh.cells)
    data = block.data.copy()
    match rng.randrange(6):
        case 0:
            data[rng.randrange(len(data)), 0] = rng.choice([-1, 10**6, 2**31 - 1, 2**40, len(mesh.points)])
        case 1:
            data[:, 1] = data[:, 0]
        case 2:
            data = data[:0]
        case 3:
            data = np.column_stack([data, data[:, :1]])
        case 4:
            data = data.astype(float) + rng.choice([0.5, 0, np.nan])
        case _:
            data = data[:, ::-1][rng.sample(range(len(data)), len(data))]
    block.data = data


def bad_kinds(rng: random.Random, mesh: meshio.Mesh) -> None:
    """Cells with a kind that does not fit their vertices."""
    kinds = [
        "triangle",
        "quad",
        "tetra",
        "line",
        "vertex",
        "triangle6",
        "polygon5",
        "hexahedron",
        "wedge",
        "VTK_LAGRANGE_TRIANGLE",
    ]
    rng.choice(mesh.cells).type = rng.choice(kinds)


def bad_numbers(rng: random.Random, mesh: meshio.Mesh) -> None:
    """Part numbers that are invalid, missing, or of another length."""
    for key, arrays in mesh.cell_data.items():
        index = rng.randrange(len(arrays))
        values = arrays[index]
        arrays[index] = rng.choice(
            [
                values * np.nan,
                values[:-1],
                values * 0,
                values - 2**40,
                values + 0.5,
                values[:, None] * [1, 1],
                values[:0],
            ]
        )
        if rng.random() < 0.3:
            mesh.cell_data = {key: arrays, "more": [array.copy() for array in arrays]}
            return


def sheets(rng: random.Random, mesh: meshio.Mesh) -> None:
    """All cells twice, in the same place."""
    points, cells = mesh.points, mesh.cells[0].data
    mesh.points = np.concatenate([points, points])
    mesh.cells[0].data = np.concatenate([cells, cells + len(points)])
    _add_numbers(mesh, len(cells))


def hanging(rng: random.Random, mesh: meshio.Mesh) -> None:
    """A cell cut in two at an edge that its neighbour does not cut; the first cells are [a, b, c] and [a, c, d]."""
    cells = mesh.cells[0].data
    (a, b, c), middle = cells[0], len(mesh.points)
    mesh.points = np.concatenate([mesh.points, (mesh.points[[a]] + mesh.points[[c]]) / 2])
    mesh.cells[0].data = np.concatenate([[[a, b, middle]], cells[1:], [[middle, b, c]]])
    _add_numbers(mesh, 1)


def _add_numbers(mesh: meshio.Mesh, count: int) -> None:
    """Part numbers, and Gmsh's entities, for new cells and points."""
    for arrays in mesh.cell_data.values():
        arrays[0] = np.concatenate([arrays[0], arrays[0][:count]])
    for key, values in mesh.point_data.items():
        mesh.point_data[key] = np.concatenate([values, values])[: len(mesh.points)]


STRUCTURES: tuple[Callable[[random.Random, meshio.Mesh], None], ...] = (
    *(bad_points, bad_points, bad_cells, bad_cells, bad_kinds, bad_numbers, sheets, hanging),
)


def _dolfinx(rng: random.Random, folder: Path) -> Made:
    """XDMF as DOLFINx writes it, with wrong widths, names or numbers, or damaged."""
    points, cells, sides, numbers = square(rng)
    arrays = {"topology": cells, "geometry": points[:, :2], "lines": sides, "numbers": numbers}
    broken = rng.choice(list(arrays))
    way = rng.choice(["widths", "indices", "names", "text", "sound"])
    heavy = rng.random() < 0.5
    if way == "widths":
        arrays[broken] = rng.choice(
            [arrays[broken].ravel(), arrays[broken][:-1], np.column_stack([arrays[broken]] * 2)]
        )
    elif way == "indices":
        arrays[broken] = arrays[broken] + rng.choice([-5, 10**6, 2**40, 0.5, np.nan])
    with h5py.File(folder / "mesh.h5", "w") as file:
        for key, values in arrays.items():
            file[key] = values

    def item(key: str) -> str:
        size = " ".join(map(str, arrays[key].shape))
        place = rng.choice(["nothing.h5:/x", "mesh.h5:/x", "mesh.h5", ":", "../home/.profile:/x"])
        text = f"mesh.h5:/{key}" if heavy else " ".join(map(str, arrays[key].ravel().tolist()))
        text = place if way == "names" and key == broken else text
        return f'<DataItem Dimensions="{size}" Format="{"HDF" if heavy else "XML"}">{text}</DataItem>'

    text = DOLFINX.format(cells=len(cells), sides=len(sides), **{key: item(key) for key in arrays})
    data = damaged(rng, text.encode(), TEXT)[0] if way == "text" else text.encode()
    (folder / "mesh.xdmf").write_bytes(data)
    return "mesh.xdmf", f"dolfinx {broken} {way}", False


def _hostile(rng: random.Random, folder: Path) -> Made:
    """XML entities, links to other files, polyhedra, devices, and things that are not files."""
    way = rng.choice(["entities", "link", "polyhedron", "place", "place", "geo in msh"])
    if way == "entities":
        path = _written(folder, rng.choice(["vtu ascii", "xdmf xml"]), _mesh(rng, "xdmf xml"))
        text = path.read_text(encoding="utf-8").replace('<?xml version="1.0"?>', "")
        path.write_text(rng.choice(DOCTYPES) + text.replace("0 ", "&l9; ", 1), encoding="utf-8")
        return path.name, way, True
    if way == "link":
        path = _written(folder, "xdmf", _mesh(rng, "xdmf"))
        with h5py.File(folder / "mesh.h5", "a") as file, h5py.File(folder.parent / "home" / "other.h5", "w") as other:
            key = rng.choice(list(file))
            other["data"] = file[key][()]
            del file[key]
            file[key] = rng.choice([h5py.ExternalLink("../home/other.h5", "data"), h5py.SoftLink(f"/{key}")])
        return path.name, way, True
    if way == "polyhedron":
        text = POLYHEDRON.format(n=rng.choice([3, 1, 2, 4, 0, -3, 10**12]), kind=rng.choice([42, 41, 10, 200, -1]))
        (folder / "mesh.vtu").write_text(text, encoding="utf-8")
        return "mesh.vtu", way, True  # with the kind of a tetrahedron it has no part 1
    if way == "geo in msh":
        (folder / "mesh.msh").write_text(
            '$MeshFormat\n2.2 0 8\n$EndMeshFormat\nSystemCall "touch hacked";', encoding="utf-8"
        )
        return "mesh.msh", way, True
    name = rng.choice(
        ["folder.msh", "loop.vtu", "null.xdmf", "zeros.mesh", "none.med", "a b é.msh", "x" * 300, "\\u0000", "."]
    )
    if name == "folder.msh":
        (folder / name).mkdir()
    elif name in ("loop.vtu", "null.xdmf"):
        (folder / name).symlink_to(name if name[0] == "l" else "/dev/null")
    elif name == "zeros.mesh":
        (folder / name).write_bytes(bytes(100_000))
    elif name == "a b é.msh":
        (folder / name).write_text(msh_text(*square_msh(2)), encoding="utf-8")
    return name, f"place {name[:20]!r}", name != "a b é.msh"


LAW_OF = {"diffusion": "signorini", "elasticity": "contact"}


def unjoined(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A valid mesh of two bodies; whether it is refused depends on their distance and on what their faces have."""
    dim, physics = rng.choice([2, 2, 3]), rng.choice(list(LAW_OF))
    place, distance = rng.choice(
        [("apart", 10 ** rng.uniform(-3, 0)), ("on it", 0.0), ("in it", -(10 ** rng.uniform(-4, -1)))]
    )
    low = np.array([*(rng.choice([0.0, rng.uniform(-0.15, 0.8)]) for _ in range(dim - 1)), 1 + distance])
    high = low + [rng.choice([1.0, rng.uniform(0.2, 2)]) for _ in range(dim)]
    _write(rng, folder, [(np.zeros(dim), np.ones(dim)), (low, high)])
    laws = [face for face in ("face", "other face") if rng.random() < 0.6]
    free = [face for face in ("face", "other face", "sides") if face not in laws]
    zero = [0] * dim if physics == "elasticity" else 0
    lines = ['physics = "elasticity"'] if physics == "elasticity" else []
    lines += ["[geometry]", 'file = "bodies.msh"', "[boundary]"]
    lines += [f"{LAW_OF[physics]} = {laws}", f"neumann = {free}", "[problem]"]
    lines += [f"u_D = {{bottom = {zero}, top = {zero}}}"] if physics == "elasticity" else ["f = -0.1", "psi = 0"]
    lines += ["young = 1", "poisson = 0.3", f"f = {[0] * (dim - 1) + [-0.01]}"] if physics == "elasticity" else []
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    solved = place == "apart" or (place == "on it" and not laws)
    command = ["solve", "case.toml", "--output", OUTPUT] if solved or rng.random() < 0.5 else ["check", "case.toml"]
    about = f"{physics}, {dim}D, {place}: {distance:.2g}, laws on {laws}"
    return Broken(command, about, refused=not solved, solved=solved, bounded=solved)


def _write(rng: random.Random, folder: Path, boxes: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Write the mesh: turned, moved, and in any unit of length."""
    dim, points, cells, parts = len(boxes[0][0]), [], [], {}
    for names, (low, high) in zip((("bottom", "face"), ("other face", "top")), boxes, strict=True):
        x, simplices = _grid(low, high, [rng.choice([1, 2, 3]) for _ in low])
        facets, times = np.unique(faces(simplices), axis=0, return_counts=True)
        facets = facets[times == 1]
        ends = [np.isclose(x[facets][..., -1], end[-1], atol=1e-9).all(axis=1) for end in (low, high)]
        first = sum(map(len, points))
        for name, chosen in zip((*names, "sides"), (*ends, ~np.any(ends, axis=0)), strict=True):
            parts.setdefault(name, []).append(facets[chosen] + first)
        points.append(x)
        cells.append(simplices + first)
    turn, _ = np.linalg.qr([[rng.gauss(0, 1) for _ in range(dim)] for _ in range(dim)])
    moved = np.concatenate(points) @ (turn if rng.random() < 0.5 else np.eye(dim)) + rng.choice(
        [0.0, rng.uniform(-3, 3)]
    )
    moved = np.pad(moved * 10 ** rng.choice([0, 0, rng.uniform(-3, 3)]), ((0, 0), (0, 3 - dim)))
    kinds = {2: ("triangle", "line"), 3: ("tetra", "triangle")}[dim]
    blocks = [(kinds[0], np.concatenate(cells)), *((kinds[1], np.concatenate(part)) for part in parts.values())]
    tags = [np.full(len(elements), number, dtype=np.int32) for number, (_, elements) in enumerate(blocks, start=1)]
    names = {name: np.array([number, dim - 1]) for number, name in enumerate(parts, start=2)}
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    mesh = meshio.Mesh(moved, blocks, cell_data=data, field_data=names)
    meshio.write(folder / "bodies.msh", mesh, file_format="gmsh22", binary=False)


def _grid(low: np.ndarray, high: np.ndarray, counts: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """A box of so many boxes, each of simplices along its edges from its first corner to its last one."""
    ticks = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    points = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, len(low))
    number = np.arange(len(points)).reshape([n + 1 for n in counts])
    cells = []
    for corner in itertools.product(*map(range, counts)):
        for order in itertools.permutations(range(len(low))):
            steps = np.cumsum([np.zeros(len(low), int), *(np.eye(len(low), dtype=int)[k] for k in order)], axis=0)
            cells.append([number[tuple(corner + step)] for step in steps])
    return points, np.array(cells)
