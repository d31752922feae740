"""What a `.geo` file may say: usual constructions mesh as Gmsh alone would mesh them, hostile ones touch nothing."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from geo_texts import HOSTILE, OCC, SQUARE, USUAL

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.shipped import data_folder
from signorini_fenicsx.meshes.geo_text import allowed_tokens, text_for_gmsh
from signorini_fenicsx.meshes.geo_words import ALLOWED, REFUSED, TEXT


@pytest.fixture(scope="module")
def gmsh() -> Iterator:
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    yield gmsh
    gmsh.finalize()


def meshed(gmsh, file: Path) -> tuple:
    """How many elements there are of each kind, and the names of the groups."""
    gmsh.clear()
    gmsh.option.restoreDefaults()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(file))
    gmsh.model.mesh.generate(gmsh.model.getDimension())
    kinds, elements, _ = gmsh.model.mesh.getElements()
    names = {gmsh.model.getPhysicalName(*group) for group in gmsh.model.getPhysicalGroups()}
    return dict(zip(kinds.tolist(), map(len, elements), strict=True)), names


@pytest.mark.parametrize("name", [*USUAL, *(file.name for file in sorted(data_folder("meshes").glob("*.geo")))])
def test_usual_constructions(tmp_path: Path, gmsh, name: str):
    text = USUAL[name] if name in USUAL else (data_folder("meshes") / name).read_text()
    alone, ours = tmp_path / "alone.geo", tmp_path / "ours.geo"
    alone.write_text(text + "\n")
    ours.write_text(text_for_gmsh(allowed_tokens(text.encode())))
    assert meshed(gmsh, ours) == meshed(gmsh, alone)
    assert gmsh.model.getDimension() >= 2


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_hostile_texts_are_refused(text: str):
    for before in ("", SQUARE, OCC):
        with pytest.raises(InputError) as caught:
            allowed_tokens((before + text).encode())
        assert "\n" not in str(caught.value)
        assert "\x1b" not in str(caught.value)


def test_enough_hostile_texts():
    assert len(set(HOSTILE)) >= 150


def test_no_word_is_on_two_lists():
    assert not ALLOWED & REFUSED
    assert not TEXT & (ALLOWED | REFUSED)
