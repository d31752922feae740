"""What a `.geo` file may say: Gmsh meshes it as it would alone, and whatever it says touches nothing."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import dolfinx.mesh
import numpy as np
import pytest
from geo_texts import HOSTILE, SQUARE, USUAL
from mpi4py import MPI

from signorini_fenicsx.base import confined
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.shipped import data_folder
from signorini_fenicsx.meshes import meshing
from signorini_fenicsx.meshes.files import read_mesh_file

ALWAYS = ("loops", "fields", "formulas made", "solids", "dam.geo")
"""The usual texts that are not among the slow tests; of hostile ones it is each of so many:"""
EACH = 10


@pytest.fixture(scope="module")
def gmsh() -> Iterator:
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    yield gmsh
    gmsh.finalize()


def meshed(gmsh, file: Path) -> tuple[int, set[str]]:
    """The number of cells, and the names of the groups of them and of their facets."""
    gmsh.clear()
    gmsh.option.restoreDefaults()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(file))
    dim = gmsh.model.getDimension()
    gmsh.model.mesh.generate(dim)
    groups = [group for group in gmsh.model.getPhysicalGroups() if group[0] >= dim - 1]
    names = {gmsh.model.getPhysicalName(*group) or str(group[1]) for group in groups}
    return len(gmsh.model.mesh.getElementsByType({2: 2, 3: 4}[dim])[0]), names


SHIPPED = {file.name: file.read_text() for file in sorted(data_folder("meshes").glob("*.geo"))}


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(text, id=name, marks=() if name in ALWAYS else pytest.mark.slow)
        for name, text in (USUAL | SHIPPED).items()
    ],
)
def test_usual_constructions(tmp_path: Path, gmsh, text: str):
    file = tmp_path / "mesh.geo"
    file.write_text(text + "\n")
    ours = read_mesh_file(str(file))
    assert (len(ours.cells), set(ours.parts) | set(ours.regions)) == meshed(gmsh, file)


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(text, id=str(number), marks=pytest.mark.slow if number % EACH else ())
        for number, text in enumerate(HOSTILE)
    ],
)
def test_hostile_texts_touch_nothing(tmp_path: Path, text: str):
    """No file is written, no program started; what Gmsh cannot do is said in one sentence."""
    file, hacked = tmp_path / "mesh.geo", tmp_path / "hacked"
    file.write_text(SQUARE + text.replace("hacked", str(hacked)))
    with contextlib.suppress(InputError):
        mesh = read_mesh_file(str(file))
        assert all(name.isprintable() for name in mesh.parts)
    assert [path.name for path in tmp_path.iterdir()] == ["mesh.geo"]


def test_a_system_that_cannot_confine_a_process_reads_no_geometry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from signorini_fenicsx.meshes import file_worker

    monkeypatch.setattr(confined, "seal", lambda: False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "square.geo").write_text(SQUARE)
    with pytest.raises(InputError, match="which this system cannot confine"):
        file_worker._by_gmsh(data_folder("meshes") / "dam.geo", None, 0, 1e8, [])


def test_curved_geometries_are_refined_from_coarser_meshes(monkeypatch: pytest.MonkeyPatch):
    """New points are on the arc of the clamp's toe; no mesh with the size of the file is needed at full h."""
    monkeypatch.setattr(meshing, "REFINED_FROM", 10_000)
    monkeypatch.setattr(meshing, "COARSEST", 500)
    asked = []
    monkeypatch.setattr(
        meshing, "read_mesh_file", lambda *about, **sizes: asked.append(about) or read_mesh_file(*about)
    )
    parts = {"signorini": ["toe", "heel"], "neumann": ["washer", "free"], "dirichlet": ["stop"]}
    domain = meshing.own_domain(MPI.COMM_SELF, meshing.MeshFile(str(data_folder("meshes") / "clamp.geo")), 1.2, parts)
    assert asked[-1][2] == 2
    assert 0.6 < domain.h <= 1.2
    toe = domain.mesh.geometry.x[dolfinx.mesh.entities_to_geometry(domain.mesh, 1, domain.facets["toe"])]
    assert len(toe) > 100
    assert np.hypot(toe[..., 0] - 8, toe[..., 1] - 160.1) == pytest.approx(np.hypot(8, 159.9), rel=1e-14)
