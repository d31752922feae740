"""First case files: what `init` writes passes `check` and can be solved, and so does what `cases --show` prints."""

import io
import sys
import tomllib
from pathlib import Path

import pytest
from commands import signorini
from mpi4py import MPI

from signorini_fenicsx import __version__, evolve_case, load_case, solve_case
from signorini_fenicsx.base import confined
from signorini_fenicsx.base.shipped import case_names, data_folder
from signorini_fenicsx.cases.first_case import Place, words

FIRST = [
    ("--on", "bottom=signorini", "--on", "left,right=neumann"),
    ("--on", "bottom=friction", "--on", "left=wall", "--on", "right=regulator", "--on", "top=graph"),
    ("--on", "bottom=two-sided", "--on", "left=seepage", "--on", "right=river"),
    ("--on", "bottom=film", "--on", "left,right=neumann"),
    ("--shape", "slit", "--on", "slit=signorini", "--on", "left=neumann"),
    ("--shape", "cube", "--on", "bottom=signorini", "--on", "left,right=neumann"),
    ("--mesh", str(data_folder("meshes") / "dam.msh"), "--on", "face=seepage", "--on", "base,top=neumann"),
    ("--physics", "elasticity", "--on", "bottom=friction", "--on", "left,right=neumann"),
    ("--physics", "elasticity", "--on", "bottom=contact", "--on", "left=symmetry", "--on", "right,top=neumann"),
    ("--physics", "elasticity", "--on", "bottom=wall", "--on", "left=two-sided", "--on", "right=regulator"),
    ("--physics", "elasticity", "--on", "bottom=graph", "--on", "left=signorini", "--on", "right=joint_springs"),
    ("--physics", "elasticity", "--shape", "slit", "--on", "slit=contact", "--on", "left=neumann"),
]


@pytest.mark.parametrize("options", FIRST)
def test_a_first_case_can_be_solved(tmp_path: Path, options: tuple[str, ...]):
    """Also those with all laws that there are."""
    done = signorini(tmp_path, "init", "mine.toml", *options)
    assert (done.returncode, done.stderr) == (0, "")
    case = load_case(tmp_path / "mine.toml")
    case = case if case.geometry.file else case.with_values({"solve.h": 0.5})
    assert (
        solve_case(case, MPI.COMM_SELF) if case.time is None else next(evolve_case(case, MPI.COMM_SELF)).solution
    ).converged


def box_file(path: Path, low: list[float], high: list[float]) -> None:
    """A mesh file of a rectangle with four cells."""
    (x, y), (z, w) = low, high
    points = [(x, y), (z, y), (z, w), (x, w), ((x + z) / 2, (y + w) / 2)]
    names = ["bottom", "right", "top", "left"]
    sides = [f"{i + 1} 1 2 {i + 1} {i + 1} {i + 1} {(i + 1) % 4 + 1}" for i in range(4)]
    cells = [f"{i + 5} 2 2 9 9 {i + 1} {(i + 1) % 4 + 1} 5" for i in range(4)]
    path.write_text(
        "\n".join(
            [
                *("$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", "4"),
                *(f'1 {i + 1} "{name}"' for i, name in enumerate(names)),
                *("$EndPhysicalNames", "$Nodes", "5", *(f"{i + 1} {a} {b} 0" for i, (a, b) in enumerate(points))),
                *("$EndNodes", "$Elements", "8", *sides, *cells, "$EndElements", ""),
            ]
        )
    )


@pytest.mark.parametrize(("physics", "kind"), [("elasticity", "contact"), ("diffusion", "friction")])
def test_parts_of_bodies_that_face_each_other_are_pairs(tmp_path: Path, physics: str, kind: str):
    """The part that is covered is the slave; a condition on a part that is in no pair takes it out of one."""
    for name, low, high in (("low", [0, 0], [1, 1]), ("up", [0.2, 1.01], [0.8, 1.5]), ("side", [1.02, 0], [2, 1])):
        box_file(tmp_path / f"{name}.msh", low, high)
    bodies = [word for name in ("low", "up", "side") for word in ("--body", f"{name}={name}.msh")]
    bodies += ["--physics", physics]
    files = {name: str(tmp_path / f"{name}.msh") for name in ("low", "up", "side")}
    if physics == "elasticity":
        assert {pair.slave for pair in Place.of_bodies(files, tmp_path).pairs} == {"up.bottom", "low.right"}
    options = ["--on", f"low.top={kind}", "--on", "side.left=dirichlet", "--on", "up.left,up.right=neumann"]
    assert signorini(tmp_path, "init", "mine.toml", *bodies, *options).returncode == 0
    (pair,) = load_case(tmp_path / "mine.toml").pair
    assert (pair.slave, pair.master, pair.kind) == (["up.bottom"], ["low.top"], kind)
    assert "100 % of the slave is opposite to the master, at 0.01 to 0.01" in (tmp_path / "mine.toml").read_text()


def test_meshes_of_bodies_are_read_once_for_their_pairs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Each file is read by a process of its own, which takes longer than all else for a small mesh."""
    files = {name: str(tmp_path / f"{name}.msh") for name in ("low", "up")}
    for file, low, high in zip(files.values(), ([0, 0], [0.2, 1.01]), ([1, 1], [0.8, 1.5]), strict=True):
        box_file(Path(file), low, high)
    times, run = [], confined.run
    monkeypatch.setattr(confined, "run", lambda *arguments: times.append(1) or run(*arguments))
    assert len(Place.of_bodies(files, tmp_path).pairs) == 1
    assert len(times) == len(files)


def test_bodies_of_one_file_are_paired(tmp_path: Path):
    """Two rectangles of one file that share no nodes, as solids of one drawing do; a name is better than a number."""
    (tmp_path / "two.geo").write_text(
        'SetFactory("OpenCASCADE"); Rectangle(1) = {0, 0, 0, 1, 0.5}; Rectangle(2) = {0, 0.5, 0, 1, 0.5};\n'
        'Physical Surface("soft") = {1}; Physical Surface("hard") = {2};\n'
        'Physical Curve("ground") = {1}; Physical Curve("below") = {3}; Physical Curve("above") = {5};\n'
        'Physical Curve("Line3") = {3}; Physical Curve("Line5") = {5}; MeshSize{:} = 0.5;\n'
    )
    assert signorini(tmp_path, "init", "mine.toml", "--mesh", "two.geo", "--on", "below=wall").returncode == 0
    (pair,) = load_case(tmp_path / "mine.toml").pair
    assert (pair.slave, pair.master, pair.kind) == (["below"], ["above"], "wall")


def test_every_condition_is_written_above():
    for physics in ("diffusion", "elasticity"):
        tried = [options for options in FIRST if ("elasticity" in options) == (physics == "elasticity")]
        used = {entry.rpartition("=")[2] for options in tried for entry in options if "=" in entry}
        assert used | {"dirichlet"} == set(words(physics))


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "give a condition, such as --on left=signorini; the parts are left, right, bottom, top"),
        (["--on", "bottom"], "must be PART=CONDITION"),
        (["--on", "bottom=signorini", "--on", "bottom=wall"], "'bottom' has a condition already"),
        (["--on", "botom=signorini"], "unknown part 'botom'"),
        (["--on", "bottom=signorin"], "did you mean 'signorini'"),
        (["--on", "bottom=contact"], "unknown condition 'contact'"),
        (["--physics", "elastic", "--on", "bottom=contact"], "did you mean 'elasticity'"),
        (["--shape", "sqare", "--on", "bottom=signorini"], "did you mean 'square'"),
        (["--mesh", "none.msh", "--on", "bottom=signorini"], "no such file"),
        (["--mesh", "none.msh", "--shape", "square"], "one of --shape, --mesh and --body"),
        (["--shape", "slit", "--on", "slit=neumann"], "is inside the domain"),
        (["--on", "left,right,bottom,top=neumann"], "no part of the boundary is left for u = u_D"),
        (["--physics", "elasticity", "--on", "bottom=contact", "--on", "left,right,top=neumann"], "can move"),
    ],
)
def test_what_cannot_be_written_is_told(folder: Path, options: list[str], message: str):
    done = signorini(folder, "init", "mine.toml", *options)
    assert done.returncode == 2
    assert message in done.stderr
    assert not (folder / "mine.toml").exists()


def test_a_file_is_not_replaced(tmp_path: Path):
    (tmp_path / "mine.toml").write_text("mine")
    done = signorini(tmp_path, "init", "mine.toml", "--on", "bottom=signorini")
    assert (done.returncode, (tmp_path / "mine.toml").read_text()) == (2, "mine")
    assert "must end in .toml" in signorini(tmp_path, "init", "mine", "--on", "bottom=signorini").stderr
    (tmp_path / "link.toml").symlink_to("other.toml")
    for name in ("link.toml", "nowhere/first.toml"):
        done = signorini(tmp_path, "init", name, "--on", "bottom=signorini")
        assert (done.returncode, f"init: {name}: cannot be written" in done.stderr) == (2, True)
    assert {path.name for path in tmp_path.iterdir()} == {"mine.toml", "link.toml"}


class Answers(io.StringIO):
    """Someone at a terminal."""

    def isatty(self) -> bool:
        """Say so."""
        return True


def test_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The defaults are taken, a misspelt word is asked for again, and an end of answers writes nothing."""
    monkeypatch.setattr(sys, "stdin", Answers("\n\n\nneumann\nsignorinu\nsignorini\n\n"))
    done = signorini(tmp_path, "init")
    assert done.returncode == 0, done.stderr
    assert "did you mean 'signorini'?" in done.stdout
    case = load_case(tmp_path / "my-case.toml")
    assert (case.boundary.signorini, case.boundary.neumann) == (["bottom"], ["right"])
    for physics, law in (("diffusion", "signorini"), ("elasticity", "contact")):
        monkeypatch.setattr(sys, "stdin", Answers(f"\n{physics}\n" + 4 * "\n"))
        done = signorini(tmp_path, "init", f"{physics}.toml")
        assert done.returncode == 0, done.stderr
        assert f"on top [{law}]" in done.stdout  # the last part has a law if no other one has
    monkeypatch.setattr(sys, "stdin", Answers("square\n"))
    assert "the answers ended; nothing is written" in signorini(tmp_path, "init", "other.toml").stderr


def test_shipped_cases_are_printed(tmp_path: Path):
    """What is printed is the case, wherever it is saved."""
    for name in case_names():
        shown, case = signorini(tmp_path, "cases", name, "--show").stdout, load_case(name)
        (tmp_path / f"{name}.toml").write_text(shown, encoding="utf-8")
        assert load_case(tmp_path / f"{name}.toml") == case
        assert (tomllib.loads(shown)["title"], name) == (case.title, case.name)
    assert signorini(tmp_path, "cases", "dam").stdout.startswith("dam  dam.msh  Seepage")
    for wrong, message in ((["--show"], "give the name of a case"), (["dma", "--show"], "did you mean 'dam'")):
        done = signorini(tmp_path, "cases", *wrong)
        assert (done.returncode, message in done.stderr) == (2, True)


def test_the_version(tmp_path: Path):
    assert signorini(tmp_path, "--version").stdout == f"signorini_fenicsx {__version__}\n"
