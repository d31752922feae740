"""Cases: the shipped ones load; for each malformed one a sentence names place and reason; cases share a mesh."""

from pathlib import Path

import pytest
from mpi4py import MPI

from signorini_fenicsx import InputError, load_case
from signorini_fenicsx.cases.complaints import naming
from signorini_fenicsx.cases.domains import LastMesh
from signorini_fenicsx.physics.diffusion.case import Case

GOOD = """
title = "Good"
[geometry]
shape = "square"
[boundary]
signorini = ["top"]
[problem]
f = "x*y"
[solve]
algorithm = "alg2"
h = "1/8"
"""


def test_good_case(tmp_path: Path):
    path = tmp_path / "good.toml"
    path.write_text(GOOD, encoding="utf-8")
    case = load_case(path)
    assert (case.name, case.solve.algorithm, case.solve.h, case.solve.rho) == ("good", "alg2", 0.125, None)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"square"', '"circle"', r"\[geometry\] shape: unknown shape 'circle'; use one of square, lshape"),
        ('"square"', '"[0, 1] x [1, 1]"', "each interval must begin with the smaller number"),
        ('"square"', '"[0, 1] x [0, 1e-300]"', "sides of 1e-300 and 1 are too different, or outside"),
        ('"square"', '"[0, 1e70] x [0, 1e70]"', "sides of 1e.70 and 1e.70 are too different, or outside"),
        ('"square"', '"[0, 1] x [1, y]"', "'y' is not a number"),
        ('["top"]', '["lid"]', "unknown part 'lid' of square; its parts are left, right, bottom, top"),
        ('["top"]', '["top", "top"]', r"\[boundary\] 'top' is listed twice: in signorini$"),
        (
            '["top"]',
            '"top"',
            r"\[boundary\] signorini: must be a list of parts such as .*, not 'top'; their values",
        ),
        ('"alg2"', '"alg9"', "unknown algorithm 'alg9'; use one of alg1, alg2"),
        ('h = "1/8"', 'h = "0"', r"\[solve\] h: must be greater than 0"),
        ('h = "1/8"', "h = -1", "greater than 0"),
        ('h = "1/8"', "h = nan", r"\[solve\] h"),
        ('h = "1/8"', 'h = "big"', "'big' is not a number"),
        ('h = "1/8"', "h = 2", "larger than the domain"),
        ('h = "1/8"', "rho = 0", r"\[solve\] rho: must be greater than 0"),
        ('h = "1/8"', "rho = inf", r"\[solve\] rho"),
        ('h = "1/8"', "max_iterations = 0", "must be between 1 and"),
        ('h = "1/8"', "hh = 1", r"unknown key 'hh' in \[solve\]; known are algorithm"),
        ("[solve]", "[sulve]", "unknown key 'sulve'; known are title"),
        ('f = "x*y"', "", r"missing key 'f' in \[problem\]"),
        ('"x*y"', '"x*q"', r"\[problem\] f: expression 'x\*q': unknown name 'q'"),
        ('"x*y"', '"__import__(1)"', "unknown function '__import__'"),
        ('"x*y"', '"xy"', "unknown name 'xy'; known are pi, x, y"),
        ("title", "title = ", "not a TOML file"),
        ('"x*y"', "x*y", r"not a TOML file: .* 'f = x\*y'; texts are in quotation marks"),
        ("title = ", 'title = "C:\\meshes" #', r"Unescaped .*; in paths / takes the place of a backslash"),
        ('"x*y"', '"x*y"\nk = 2', r"unknown key 'k' in \[problem\]; .* .did you mean 'kappa'..$"),
        ('"x*y"', '"x*y"\nu_0 = 2', r"unknown key 'u_0' in \[problem\]; .*form; 'initial' is a key of \[time\]$"),
        ('"x*y"', '"x*y"\nh = 2', r"unknown key 'h' in \[problem\]; .*; 'h' is a key of \[solve\]$"),
        ('"x*y"', '"t"', "unknown name 't'; known are pi, x, y; t is the time of a case with .time.$"),
        ('"x*y"', '"x[0]"', r"'x\[0\]' is not allowed in an expression; it may have numbers"),
        ('"x*y"', '"x > 0 ? 1 : 2"', r"character 7; it may have .* and 1 if x > 0 else 2$"),
        ("[geometry]", "[law]\nkind = 'wall'\n[geometry]", r"law: must be a section with two brackets, \[\[law\]\]"),
        ('h = "1/8"', "max_iterations = 4.5", "max_iterations: must be a whole number, not 4.5"),
        (
            '["top"]',
            '["top"]\nneumann = "rest"',
            r"neumann: must be a list of parts .*, not 'rest'; .* without a list dirichlet",
        ),
        ('shape = "square"', 'shape = "half_disk"\nmesh = "structured"', "has no structured mesh"),
        ('shape = "square"', 'shape = "square"\ndiagonal = "left"', "diagonal applies to structured meshes"),
        ('shape = "square"', 'shape = "square"\nmesh = "fine"', "unknown mesh 'fine'"),
        ("[geometry]", "name = 'x'\n[geometry]", "unknown key 'name'"),
        ('"x*y"', "1" * 5000, "an integer of thousands of digits"),
        ('h = "1/8"', "h = 0x" + "f" * 5000, r"\[solve\] h: must be a number of at most 1000 bits"),
        ('"x*y"', f'"1 if {"not " * 480} x > 0 else 2"', "is nested too deeply"),
    ],
)
def test_malformed(tmp_path: Path, old: str, new: str, message: str):
    assert old in GOOD
    path = tmp_path / "bad.toml"
    path.write_text(GOOD.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        load_case(path)
    assert str(caught.value).startswith(str(path))


def test_a_file_in_another_encoding(tmp_path: Path):
    """It is refused with the place of its first letter that is not UTF-8."""
    path = tmp_path / "bad.toml"
    path.write_bytes(GOOD.replace("Good", "Gött").encode("latin-1"))
    with pytest.raises(InputError, match=f"not a TOML file: byte {GOOD.index('ood') + 1} is not UTF-8"):
        load_case(path)


def test_unknown_names():
    with pytest.raises(InputError, match="unknown case 'example7'; use one of ball, bar, biactive, "):
        load_case("example7")
    with pytest.raises(InputError, match="no such file"):
        load_case("nowhere/case.toml")


def test_overrides():
    case = load_case("example1").with_values({"solve.h": "2^-3", "geometry.mesh": "structured"})
    assert (case.solve.h, case.geometry.mesh, case.name) == (0.125, "structured", "example1")
    assert isinstance(case, Case)
    for key, value in {"solve.h": "0", "solve.x": 1, "x": 1, "title.x": 1, "solve": 3, "geometry.shape": "x"}.items():
        with pytest.raises(InputError):
            case.with_values({key: value})


def test_runs_on_one_mesh_share_it():
    """The last mesh is kept for cases on it, whatever their data are, and made again for others."""
    meshes, case = LastMesh(), load_case("example4").with_values({"solve.h": 0.5})
    first = meshes(case, MPI.COMM_SELF)
    assert meshes(case.with_values({"problem.f": "x", "solve.algorithm": "alg4"}), MPI.COMM_SELF) is first
    assert meshes(case.with_values({"solve.h": 0.25}), MPI.COMM_SELF) is not first
    assert meshes(case, MPI.COMM_SELF) is not first


@pytest.mark.parametrize("words", ["[time] scheme: no", "h = 1 is no", "element: there is no RT1"])
def test_what_only_a_solver_finds_names_the_case(words: str):
    """A sentence about a key of a case names the case, and the section where it does not."""
    section = "" if words[0] == "[" else r"\[solve\] "
    with pytest.raises(InputError, match=f"^case dam: {section}"), naming("dam"):
        raise InputError(words)
