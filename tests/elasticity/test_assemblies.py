"""Assemblies of bodies with meshes of their own by case files: exact and published numbers, `check`, wrong files."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from commands import read_rows, signorini
from mpi4py import MPI

from signorini_fenicsx import load_case, load_solution, solve_case
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.inspection import check
from signorini_fenicsx.cases.solving import adapt_case, evolve_case
from signorini_fenicsx.discrete import overlay
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.pictures.scene import gathered_scene

COMM = MPI.COMM_WORLD
BLOCKS = """
physics = "elasticity"
[geometry]
bodies = {up = {shape = "[0.2, 0.8] x [1, 1.5]", h = 0.3}, low = {shape = "square", h = 0.5, mesh = "structured"}}
[boundary]
neumann = ["up.left", "up.right", "low.left", "low.right"]
[problem]
young = {up = 1, low = 2}
poisson = 0
u_D = {"up.top" = [0, -0.05]}
"""
PAIR = """[[pair]]
slave = "up.bottom"
master = ["low.top"]
kind = "contact"
"""


@cache
def solved(name: str) -> Any:
    """A shipped case, solved once (collective)."""
    return solve_case(load_case(name))


def on(solution: Any, part: str) -> Any:
    """The contact on a part, as reports have it (collective)."""
    return solution.quantities()["contact"][part]


@pytest.mark.parallel([1, 3])
def test_a_roller_on_a_block() -> None:
    """NAFEMS has the peak 3585 and the half width 6.21."""
    solution = solved("roller")
    about, table = on(solution, "block.face"), solution.other_tables()["pairs"]
    if COMM.rank == 0:
        assert abs(table["measure"] @ table["pressure"] / 2 - 17500) < 0.01 * 17500
    assert abs(about["peak_pressure"]["largest"] - 3585) < 0.005 * 3585
    assert abs(about["width"] - 6.21) < 0.01 * 6.21


@pytest.mark.slow
def test_two_spheres() -> None:
    """Hertz has the peak 2798.3 and the radius 10."""
    about = on(solve_case(load_case("two_spheres")), "upper.face")
    assert abs(about["peak_pressure"]["largest"] - 2798.3) < 0.03 * 2798.3
    assert abs(np.sqrt(4 * about["area"] / np.pi) - 10) < 0.03 * 10


def test_a_press_fit() -> None:
    """Lamé's pressure, by the mean over the face."""
    solution = solved("press_fit")
    force = np.hypot(*solution.resultants()["shaft.face"][:2])
    assert abs(force / (2 * np.sqrt(2)) - 1.9963e-4) < 0.005 * 1.9963e-4
    assert any("curved" in note for note in solution.notes())


def test_a_block_slides() -> None:
    """The push is 0.3 times the weight in the end, whatever the mesh; the table feels both."""
    *_, last = (instant.solution for instant in evolve_case(load_case("sliding_block")))
    forces = last.resultants()
    assert np.allclose(forces["block.right"][:2], [0.006, 0], atol=1e-12)
    assert np.allclose(forces["table.top"][:2], [0.006, -0.02], atol=1e-12)


def test_a_lap_joint_slides() -> None:
    """The upper plate is held by 0.2 times the force of the bolt; the washer goes with it."""
    solution = solve_case(load_case("lap_joint"))
    forces = solution.resultants()
    assert 0.99 * 0.005 < forces["upper.right"][0] < 0.005 * (1 + 1e-9)
    assert abs(on(solution, "upper.top")["pressure_force"] - 0.025) < 1e-10
    assert np.abs(forces["washer.bottom"][:2]).max() < 1e-10


@pytest.mark.parametrize("kind", ["contact", "friction", "tied"])
def test_tables_and_pictures_have_the_other_side(tmp_path: Path, kind: str) -> None:
    """The tractions on masters and tied slaves add up to the forces, and each has its panels."""
    mu = "mu = 0.2\n" if kind == "friction" else ""
    text = BLOCKS.replace("[0, -0.05]", "[0.02, -0.05]") + PAIR.replace("contact", kind) + mu
    (tmp_path / "case.toml").write_text(text)
    solution = solve_case(load_case(tmp_path / "case.toml"))
    write_solution(solution, tmp_path / "out", fields=False)
    rows = read_rows(tmp_path / "out" / "pairs.csv")
    assert {row["part"] for row in rows} == ({"low.top", "up.bottom"} if kind == "tied" else {"low.top"})
    for part, sign in (("low.top", -1), ("up.bottom", 1)):
        here = [row for row in rows if row["part"] == part]
        force = [sum(float(row["measure"]) * float(row[name]) / 2 for row in here) for name in ("shear", "pressure")]
        expected = sign * np.array(solution.resultants()[part][:2])
        assert not here or np.allclose(force, expected, atol=1e-14)
    scene = gathered_scene(solution)
    assert scene is not None
    assert scene.opposite is not None
    _, panels = scene.files["pressure"]
    shown = {(panel.what, *(panel.scene or scene).labels) for panel in panels}
    assert ("pressure", *scene.opposite.labels) in shown
    assert (("shear_vector", *scene.opposite.labels) in shown) == (kind != "contact")
    assert (("sliding_vector", "up.bottom") in shown) == (kind != "tied")


def test_steps_have_the_other_side(tmp_path: Path) -> None:
    """The tables and pictures of steps have what acts on masters and tied slaves in each of them."""
    text = BLOCKS.replace("[0, -0.05]", '["0.02*t", "-0.05*t"]') + PAIR.replace("contact", "tied")
    (tmp_path / "case.toml").write_text(text + "[time]\nend = 1\nsteps = 2\n")
    done = signorini(tmp_path, "solve", "case.toml", "--output", "out", "--plot")
    assert done.returncode == 0
    rows = read_rows(tmp_path / "out" / "pairs.csv")
    steps = read_rows(tmp_path / "out" / "steps.csv")
    for part in ("low.top", "up.bottom"):
        for step in steps:
            here = [row for row in rows if (row["part"], row["step"]) == (part, step["step"])]
            force = sum(float(row["measure"]) * float(row["pressure"]) / 2 for row in here)
            assert abs(force) == pytest.approx(abs(float(step[f"{part}_force_y"])), rel=1e-12)
    assert (tmp_path / "out" / "pairs.png").exists()
    assert not (tmp_path / "out" / "contact.png").exists()


def test_derivatives_by_the_path_of_a_pair(tmp_path: Path) -> None:
    """By mu of a pair beside laws, which are listed before it; contact without friction counts, read again too."""
    law = '[[law]]\nkind = "contact"\nparts = ["low.left"]\n'
    law += '[[law]]\nkind = "friction"\nparts = ["up.left"]\ngap = 0.001\nmu = 0.1\n'
    free = BLOCKS.replace('"up.left", ', "").replace('"low.left", ', "")
    text = free.replace("[0, -0.05]", "[0.02, -0.05]") + law
    (tmp_path / "case.toml").write_text(text + PAIR.replace("contact", "friction") + "mu = 0.2\n")
    case = load_case(tmp_path / "case.toml")
    solution, more, less = (solve_case(case.with_values({"pair.0.mu": mu})) for mu in (0.2, 0.2 + 1e-5, 0.2 - 1e-5))

    def squares(of: Any) -> ufl.Form:
        return ufl.inner(of.sigma, of.sigma) * ufl.dx(of.sigma.function_space.mesh)

    _, (gradient,) = solution.gradient(squares(solution), ["pair.0.mu"])
    above, below = (each.spaces.integrate(squares(each)) for each in (more, less))
    assert (above - below) / 2e-5 == pytest.approx(gradient, rel=1e-6)
    write_solution(solution, tmp_path / "out", fields=False)
    for of in (solution, load_solution(tmp_path / "out")):
        assert of.gradient(squares(of), ["pair.0.mu", "law.1.mu"])[1][0] == pytest.approx(gradient, rel=1e-9)
        for path in ("pair.1.mu", "law.0.mu"):
            with pytest.raises(InputError, match=f"{path}: there is no such number"):
                of.gradient(squares(of), [path])
    with pytest.raises(InputError, match=r"law.1.mu: must be finite and not negative"):
        solve_case(case.with_values({"law.1.mu": "-1"}))


def test_results_of_other_coverage_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What an earlier overlay left uncovered is said, not called damaged alone."""
    case = tmp_path / "case.toml"
    case.write_text(BLOCKS.replace("[0.2, 0.8]", "[0.2, 1.01]") + PAIR)
    monkeypatch.setattr(overlay, "NEARLY", 0.0)
    write_solution(solve_case(load_case(case)), tmp_path / "out", fields=False)
    monkeypatch.undo()
    done = signorini(tmp_path, "export", "out", "--output", "out2")
    assert done.returncode == 2
    assert "covered in pairs now: it is damaged, or of another version" in " ".join(done.stderr.split())


def test_bodies_in_contact_are_drawn_in_contact() -> None:
    """A cylinder on a block and a shaft in its hub, with distances of meshes, are not enlarged.

    Between meshes that fit together a given gap is half of the shape of each body, enlarged as the displacement.
    """
    for name in ("roller", "press_fit"):
        scene = gathered_scene(solved(name))
        assert scene is not None
        assert scene.files["deformed"][0].endswith("× 1")
    blocks = load_case("two_cylinders")
    shrunk = blocks.with_values({"law.0.gap": "-1e-3", "problem.u_D": {"top": [0, 0]}})
    for case, factor in ((blocks, 1), (shrunk, 100)):
        scene = gathered_scene(solve_case(case))
        assert scene is not None
        title, panels = scene.files["deformed"]
        assert title.endswith(f"gap × {factor}")
        assert panels[0].scene is not None
        drawn, facets = panels[0].scene.fields.points, scene.facets
        _, place, count = np.unique(scene.fields.points, axis=0, return_inverse=True, return_counts=True)
        other = {place[point]: point for point in np.setdiff1d(np.arange(len(drawn)), facets.vertices)}
        assert (count[place[facets.vertices]] == 2).all()
        between = [drawn[point, 1] - drawn[other[place[point]], 1] for point in facets.vertices.ravel()]
        np.testing.assert_allclose(between, factor * facets.gaps.ravel(), atol=0.01)


WRONG = [
    (PAIR.replace('"up.bottom"', "3"), "pair.0.slave"),
    ('slave = "up.bottom"', "missing"),
    (PAIR + "mu = 0.3", "unknown key 'mu' of the pair 'contact'"),
    (PAIR + 'gap = "distance*2"', "distance"),
    (PAIR + "direction = [0]", "direction"),
    (PAIR + 'direction = "up"', 'must be "normal"'),
    (PAIR + "within = 0", "within"),
    (
        PAIR + '[[law]]\nkind = "friction"\nmu = 0.1\nparts = ["up.bottom"]',
        "listed twice: in law.0.parts and in pair.0.slave",
    ),
    (PAIR + "[problem.support]\n'low.top' = 1", "a support is on a part in neumann, which is in no pair"),
    (PAIR + 'gap = "distance - w"', "pair.0.gap"),
    (PAIR.replace("low.top", "low.tip"), "pair.0.master: unknown part 'low.tip'"),
    (PAIR.replace("low.top", "up.bottom"), "up.bottom"),
    (PAIR.replace("low.top", "low.left"), "listed twice"),
    (PAIR.replace("contact", "glue"), "unknown kind of a pair 'glue'; use one of contact, friction, tied"),
    (PAIR.replace("contact", "friction"), "must have g"),
    (PAIR.replace("contact", "friction") + 'mu = "x - 5"', "pair.0.mu: must be finite and not negative"),
    (PAIR.replace("contact", "wall") + "beta = -1", "pair.0 (wall): beta must not be negative"),
    (PAIR + "within = 1e-3\ndirection = [0, 1]", "no facet of the slave is covered"),
    ('[[law]]\nkind = "contact"\nparts = ["up.bottom", "low.top"]', "in a case file [[pair]]"),
]


@pytest.mark.parametrize(("pair", "words"), WRONG)
def test_wrong_pairs_are_refused(tmp_path: Path, pair: str, words: str) -> None:
    """One sentence, exit status 2, nothing written."""
    text = pair if pair.startswith("[[") else "[[pair]]\n" + pair
    (tmp_path / "case.toml").write_text(BLOCKS + text)
    done = signorini(tmp_path, "solve", "case.toml", "--output", "out")
    assert done.returncode == 2
    assert words in " ".join(done.stderr.split())
    assert not (tmp_path / "out").exists()


def test_check_tells_how_surfaces_cover_each_other(tmp_path: Path) -> None:
    """Facets, pieces, distances, and that a finer slave should be the master."""
    (tmp_path / "case.toml").write_text(BLOCKS.replace("[1, 1.5]", "[1.25, 1.75]") + PAIR)
    done = signorini(tmp_path, "check", "case.toml")
    assert done.returncode == 0
    told = " ".join(done.stdout.split())
    assert "up.bottom on low.top: 3 slave facets; 3 master facets; 5 pieces; distance 0.25 to 0.25" in told
    assert "swap slave and master" in told
    assert "slave of low.top, contact" in told


def test_a_curved_slave_on_a_flat_master_is_advised_against() -> None:
    """The other way round nothing is said."""
    case = load_case("roller")
    assert not any("swap" in note for note in check(case, COMM).remarks)
    pair = {"slave": "roller.face", "master": "block.face", "kind": "contact", "gap": "x^2/100", "direction": [0, -1]}
    assert any(
        "is curved and the master flat; swap" in note
        for note in check(case.with_values({"pair": [pair]}), COMM).remarks
    )


@pytest.mark.parametrize(("young", "told"), [({"up": 4, "low": 2}, True), ({"up": 2, "low": 4}, False)])
def test_a_stiff_slave_is_advised_against(tmp_path: Path, young: dict[str, float], told: bool) -> None:
    """Between facets of one size the softer body should be the slave."""
    (tmp_path / "case.toml").write_text(BLOCKS.replace("h = 0.3", "h = 0.5") + PAIR)
    case = load_case(tmp_path / "case.toml").with_values({"problem.young": young})
    assert any("stiffer than the master" in note for note in check(case, COMM).remarks) == told


@pytest.mark.slow
def test_adapt_refines_what_is_opposite_to_a_slave() -> None:
    """The pressure of a stiff, curved slave stays near Hertz's; with the master as it was it is 5 % too large."""
    case = load_case("roller")
    sizes = {"roller": 35, "block": 30}
    bodies = {name: {"file": case.geometry.bodies[name].file, "h": h} for name, h in sizes.items()}
    pair = {"slave": "roller.face", "master": "block.face", "kind": "contact", "gap": "x^2/100", "direction": [0, -1]}
    solution, certificate = adapt_case(case.with_values({"geometry.bodies": bodies, "pair": [pair]}), max_cells=1100)
    assert certificate.relative < 0.013
    assert abs(on(solution, "roller.face")["peak_pressure"]["largest"] - 3585) < 0.02 * 3585


def test_bodies_in_no_pair_may_not_overlap(tmp_path: Path) -> None:
    """A pair takes the overlap of its bodies; a third body in them is refused."""
    deep = BLOCKS.replace("[1, 1.5]", "[0.99, 1.49]")
    (tmp_path / "case.toml").write_text(deep + PAIR)
    assert signorini(tmp_path, "check", "case.toml").returncode == 0
    third = deep.replace("low = {", 'third = {shape = "[0, 1] x [0.1, 0.2]", h = 1}, low = {')
    (tmp_path / "case.toml").write_text(third.replace("low = 2}", "low = 2, third = 1}") + PAIR)
    done = signorini(tmp_path, "check", "case.toml")
    assert done.returncode == 2
    assert "two bodies overlap" in done.stderr
