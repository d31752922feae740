"""Probes, sections, the phreatic line, discharges and pictures of water: exact values, any ranks, files, bad input."""

from pathlib import Path

import numpy as np
import pytest
from commands import read_rows, signorini
from in_time import ending_after
from mpi4py import MPI

from signorini_fenicsx import (
    Diffusion,
    Dirichlet,
    InputError,
    Neumann,
    Options,
    Seepage,
    Signorini,
    load_case,
    solve,
    solve_case,
)
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.show.heads import HEAD, MINUS_HEAD, PRESSURE
from signorini_fenicsx.physics.diffusion.soils import Gardner, VanGenuchten
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.pictures.rendering import arrow_heads
from signorini_fenicsx.pictures.scene import gathered_scene
from signorini_fenicsx.pictures.space import Space

COMM = MPI.COMM_WORLD
RT1 = Options(element="RT1")
AROUND = [[0.2, 0.1], [0.9, 0.25], [0.85, 0.8], [0.31, 0.77], [0.2, 0.1]]
"""A closed section, anticlockwise, that cuts cells."""


def square(comm: MPI.Intracomm = COMM, h: float = 0.3) -> Domain:
    return build_domain(comm, "square", h, mesh="structured")


def area(points: list[list[float]]) -> float:
    x, y = np.array(points).T
    return float(x[:-1] @ y[1:] - x[1:] @ y[:-1]) / 2


@pytest.mark.parametrize("options", [Options(), RT1])
def test_sections_of_the_plane(options: Options):
    """What flows through a closed section is the source inside, to rounding; through facets it is that of a part."""
    solution = solve(square(), Diffusion(f=3, u_D="x*y", conditions=[Signorini("bottom", psi=-0.01)]), options)
    through = solution.through_section(AROUND)
    assert through.flux == pytest.approx(-3 * area(AROUND), abs=1e-13)
    assert through.measure == pytest.approx(np.linalg.norm(np.diff(AROUND, axis=0), axis=1).sum())
    bottom = solution.flux_through("bottom")
    on_boundary, on_facets = (solution.through_section([[0, y], [1, y]]) for y in (0, 0.5))
    assert on_boundary.flux == pytest.approx(bottom, abs=1e-13)
    beyond = [[-1, -1], [2, -1], [2, 0.5], [-1, 0.5], [-1, -1]]
    below = solution.through_section(beyond)
    assert below.measure == pytest.approx(1)
    assert on_facets.flux == pytest.approx(-below.flux, abs=1e-13)
    outer = sum(
        solution.through_section(edge).flux for edge in ([[1, 0], [1, 0.5]], [[0, 0.5], [0, 0]], [[0, 0], [1, 0]])
    )
    assert below.flux == pytest.approx(-3 / 2 - outer, abs=1e-13)
    with pytest.raises(InputError, match="at least two points"):
        solution.through_section([[0, 0]])


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("options", [Options(), RT1])
def test_sections_in_space(options: Options):
    """A plane across cells, and one on facets, have the flux of an affine solution."""
    cube = build_domain(COMM, "cube", 0.9, mesh="structured")
    solution = solve(cube, Diffusion(f=0, u_D="x + 2*y - 3*z"), options)
    for point, normal, size in (((0.5, 0.5, 0.5), (1, 1, 1), 3 * 3**0.5 / 4), ((0, 0, 0.5), (0, 0, 2), 1.0)):
        through = solution.through_section([point], normal)
        assert through.measure == pytest.approx(size, rel=1e-12)
        assert through.flux == pytest.approx(np.array([1, 2, -3]) @ normal / np.linalg.norm(normal) * size, abs=1e-12)


@pytest.mark.parallel([1, 3])
def test_probes():
    """Probes are the same on all ranks: an affine u with its flux, also in vertices; none outside."""
    solution = solve(square(), Diffusion(kappa=2, f=0, u_D="x - 2*y"))
    x = np.array([[0.5, 0.5], [0.13, 0.77], [1, 1], [1.1, 0.5]])
    found = solution.probe(x)
    assert found["u"][:3] == pytest.approx(x[:3] @ [1, -2], abs=1e-12)
    assert found["sigma"][:3] == pytest.approx(np.tile([2, -4], (3, 1)), abs=1e-12)
    assert np.isnan(found["u"][3])
    with pytest.raises(InputError, match="shape"):
        solution.probe([0.5, 0.5])


def dam(what: str, comm: MPI.Intracomm = COMM, options: Options | None = None) -> Solution:
    """A square dam of saturated soil with a seepage face on the right; u is the word."""
    level = {HEAD: "0.9", MINUS_HEAD: "-0.9", PRESSURE: "0.9 - y"}[what]
    face = {
        HEAD: Seepage("right", level="y"),
        MINUS_HEAD: Signorini("right", psi="-y"),
        PRESSURE: Seepage("right", level=0),
    }[what]
    held = [Dirichlet("left", level), face]
    flux = {HEAD: 0, MINUS_HEAD: 0, PRESSURE: 1}[what]
    walls = [Neumann("bottom", flux), Neumann("top", -flux)]
    return solve(square(comm, 0.15), Diffusion(f=0, conditions=[*held, *walls]), options)


@pytest.mark.parametrize("options", [Options(), RT1])
def test_water_is_water(options: Options):
    """With the head and with minus the head as u the phreatic line, pressures and discharges are the same."""
    head, minus = dam(HEAD, options=options), dam(MINUS_HEAD, options=options)
    assert (head.water_kind.u, minus.water_kind.u) == (HEAD, MINUS_HEAD)
    (one,), (other,) = head.phreatic, minus.phreatic
    assert one == pytest.approx(other, abs=1e-9)
    assert one[0] == pytest.approx([0, 0.9], abs=0.03)
    assert 0.3 < one[-1, 1] < 0.9
    assert one[-1, 0] == pytest.approx(1)
    assert (np.diff(one[:, 1]) < 5e-3).all()
    x = [[0.3, 0.4], [0.5, 0.5]]
    assert head.probe(x)["pressure"] == pytest.approx(minus.probe(x)["pressure"], abs=1e-10)
    assert head.probe(x)["pressure"] == pytest.approx(head.probe(x)["u"] - np.array(x)[:, 1])
    inflows = {part: about["inflow"] for part, about in head.water.items()}
    assert inflows == pytest.approx({part: about["inflow"] for part, about in minus.water.items()}, abs=1e-10)
    assert abs(head.summary()["water_balance"]["left"]) < 1e-10 * inflows["left"]
    pressures = [{field.name: field for field in each.fields()["solution"]}["pressure"] for each in (head, minus)]
    assert pressures[0].values == pytest.approx(pressures[1].values, abs=1e-9)
    assert pressures[0].cell_means == pytest.approx(pressures[1].cell_means, abs=1e-9)


@pytest.mark.parallel(2)
def test_ranks():
    """The phreatic line and all that is read off are the same on any number of ranks."""
    many, one = dam(HEAD), dam(HEAD, MPI.COMM_SELF)
    lines = COMM.bcast(many.phreatic)
    assert len(lines) == len(one.phreatic) == 1
    assert lines[0] == pytest.approx(one.phreatic[0], abs=1e-10)
    for name, values in one.probe(AROUND).items():
        assert many.probe(AROUND)[name] == pytest.approx(values, abs=1e-10)
    assert many.through_section(AROUND).flux == pytest.approx(one.through_section(AROUND).flux, abs=1e-12)
    assert many.water["left"] == pytest.approx(one.water["left"], rel=1e-10)


@pytest.mark.parametrize("form", ["head", "pressure"])
def test_water_table_in_soil(form: str):
    """Rain on soil: with q = rain/K the head is 0.5 + qy below the water table, which is at 0.5/(1 − q)."""
    soil, q = Gardner(2.0, 1.0), 0.3
    conditions = [Neumann(["left", "right"], 0), Neumann("top", 2 * q), Dirichlet("bottom", 0.5)]
    solution = solve(square(h=0.1), Diffusion(kappa=soil, f=0, conditions=conditions, form=form))
    (line,) = solution.phreatic
    assert line[:, 1] == pytest.approx(0.5 / (1 - q), abs=2e-3)
    found = solution.probe([[0.4, 0.3], [0.4, 0.9]])
    assert found["pressure"][0] == pytest.approx(0.5 + 0.3 * q - 0.3, abs=1e-3)
    assert found["saturation"][0] == 1
    assert found["saturation"][1] == pytest.approx(np.exp(found["pressure"][1]))
    assert solution.water["bottom"]["inflow"] == pytest.approx(-2 * q)
    assert solve(square(), Diffusion(f=1)).water_kind is None


def test_what_u_is():
    """A case says what u is of water where laws do not tell, or that it is none."""
    case = load_case("hillslope").with_values({"solve.h": 2})
    solution = solve_case(case)
    assert solution.water_kind.u == MINUS_HEAD
    assert solution.water["top"]["inflow"] > 0
    assert solve_case(case.with_values({"plot.water": False})).water == {}
    with pytest.raises(InputError, match="must be true, false, or one of head, minus head, pressure head, not 'ice'"):
        case.with_values({"plot.water": "ice"})


def test_surface_in_space():
    """In space the phreatic surface is that of the plane, for soil between two ditches."""
    cube = build_domain(COMM, "cube", 0.45, mesh="structured")
    conditions = [Dirichlet("left", 0.8), Dirichlet("right", 0.2), Neumann(["front", "back", "bottom", "top"], 0)]
    solution = solve(cube, Diffusion(kappa=VanGenuchten(1.0, 2.0, 2.0), f=0, conditions=conditions))
    triangles = np.array(solution.phreatic)
    edges = triangles[:, 1:] - triangles[:, :1]
    assert np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2 == pytest.approx(1.17, abs=0.05)
    assert triangles[..., 2].min() > 0.15
    assert triangles[..., 2].max() < 0.85
    if (found := gathered_scene(solution)) is not None:
        outside, surface = found.over
        wet = np.array(outside.points)
        assert [outside.label, surface.label] == ["water outside", "phreatic surface"]
        assert set(wet[..., 0].ravel()) == {0.0, 1.0}
        assert 0.5 < wet[..., 2].max() < 1
        head, streams, pressure, _ = found.files["water"][1]
        np.testing.assert_allclose(pressure.what, head.what - found.fields.points[:, 2])
        _, seeds = Space(found).streamlines(streams)
        assert arrow_heads(seeds, 0.1).n_cells > 50 * 16
        assert seeds["flow"][:, 0].mean() > 0.1  # from left to right, the head falls


CASE = """
[geometry]
shape = "square"
mesh = "structured"
[boundary]
neumann = ["bottom", "top"]
dirichlet = ["left"]
[[law]]
parts = ["right"]
kind = "seepage"
level = "y"
[problem]
f = 0
u_D = 0.9
[solve]
h = 0.3
[[probe]]
name = "P"
points = [0.5, 0.25]
[[probe]]
name = "wells"
file = "wells.csv"
[[section]]
name = "S"
points = [[0.4, -1], [0.4, 2]]
"""
TIME = """
[time]
end = 1
steps = 3
initial = 0.9
"""


def test_files(tmp_path: Path):
    """A case has its readings in tables, summary and report; its checkpoint does without the file of points."""
    (tmp_path / "case.toml").write_text(CASE, encoding="utf-8")
    (tmp_path / "wells.csv").write_text("name, x, y\nA,0.1,0.2\n\nB,0.9,0.1\n", encoding="utf-8")
    ended = signorini(tmp_path, "solve", "case.toml", "--output", "out")
    assert ended.returncode == 0
    assert "probe wells A" in ended.stdout
    assert "section S" in ended.stdout
    assert [row["probe"] for row in read_rows(tmp_path / "out" / "probes.csv")] == ["P", "wells A", "wells B"]
    (section,) = read_rows(tmp_path / "out" / "sections.csv")
    assert float(section["measure"]) == pytest.approx(1)
    assert (tmp_path / "out" / "phreatic.xdmf").exists()
    assert float(read_rows(tmp_path / "out" / "phreatic.csv")[0]["x"]) == 0
    (tmp_path / "wells.csv").unlink()
    assert signorini(tmp_path, "export", "out", "--output", "again").returncode == 0
    again, first = (read_rows(tmp_path / folder / "probes.csv") for folder in ("again", "out"))
    assert [float(row["u"]) for row in again] == pytest.approx([float(row["u"]) for row in first], rel=1e-12)


def test_steps(tmp_path: Path):
    """In time there is a row for each probe and step, also after a restart, and what flows in is in `steps.csv`."""
    (tmp_path / "case.toml").write_text(CASE + TIME, encoding="utf-8")
    (tmp_path / "wells.csv").write_text("x,y\n0.1,0.2\n", encoding="utf-8")
    with ending_after(2):
        assert signorini(tmp_path, "solve", "case.toml", "--output", "out").returncode == 1
    assert signorini(tmp_path, "solve", "case.toml", "--output", "out", "--restart", "--plot").returncode == 0
    assert (tmp_path / "out" / "phreatic.png").exists()
    assert (tmp_path / "out" / "probes.png").exists()
    probes = read_rows(tmp_path / "out" / "probes.csv")
    assert [(row["step"], row["probe"]) for row in probes] == [
        (str(n), name) for n in (1, 2, 3) for name in ("P", "wells")
    ]
    assert {row["step"] for row in read_rows(tmp_path / "out" / "phreatic.csv")} == {"1", "2", "3"}
    steps = read_rows(tmp_path / "out" / "steps.csv")
    section = read_rows(tmp_path / "out" / "sections.csv")[-1]
    assert float(section["flux"]) < 0
    assert float(steps[-1]["inflow left"]) < -float(section["flux"]) < -float(steps[-1]["inflow right"])
    assert [abs(float(row["balance"])) < 1e-12 for row in steps] == [True] * 3
    assert all(float(row["inflow left"]) > 0 > float(row["inflow right"]) for row in steps)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "[0.5, 0.25]",
            "[0.5, 1.25]",
            "[[probe]] P: (0.5, 1.25) is outside the domain, which is within [0, 1] x [0, 1]",
        ),
        ("[0.5, 0.25]", "[0.5, 0.25, 0]", "[[probe]] P: points must have 2 coordinates, as the mesh has"),
        ("[0.5, 0.25]", '"here"', "probe.0.points: must be a point such as [1, 2], or a list of points, not 'here'"),
        ("[0.5, 0.25]", "[0.5, nan]", "probe.0.points"),
        ('"wells"', '"P"', "[[probe]] 'P' is the name of two"),
        ("[0.4, 2]]", "[0.4, -1]]", "points: two points that follow one another are the same"),
        ("[0.4, 2]]", "[0.5, -1]]", "[[section]] S: does not cross the domain"),
        ("[[0.4, -1], [0.4, 2]]", "[0.4, -1]", "points: must be a polyline"),
        ('"wells.csv"', '"none.csv"', "[[probe]] wells: none.csv: No such file or directory"),
    ],
)
def test_bad_input(old: str, new: str, words: str, tmp_path: Path):
    """What cannot be read off is refused in a sentence before anything is solved."""
    (tmp_path / "wells.csv").write_text("x,y\n0.1,0.2\n", encoding="utf-8")
    (tmp_path / "case.toml").write_text(CASE.replace(old, new), encoding="utf-8")
    ended = signorini(tmp_path, "check", "case.toml")
    assert ended.returncode == 2
    assert words in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


@pytest.mark.parametrize("text", ["", "x,z\n1,2\n", "x,y\n", "x,y\n1\n", "x,y\n1,two\n"])
def test_bad_points(text: str, tmp_path: Path):
    """A file of points that is none is refused in a sentence with its name."""
    (tmp_path / "wells.csv").write_text(text, encoding="utf-8")
    (tmp_path / "case.toml").write_text(CASE, encoding="utf-8")
    with pytest.raises(InputError, match=r"wells\.csv: "):
        load_case(tmp_path / "case.toml")
