"""Rigid tools under given forces: exact states, friction, bodies held by tools, bounds, steps, files, refusals."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import signorini
from elastic import box
from mpi4py import MPI

from signorini_fenicsx import (
    Coulomb,
    Elasticity,
    Evolution,
    InputError,
    Options,
    Tresca,
    certify,
    compare,
    evolve,
    load_case,
    load_solution,
    solve,
    solve_case,
)
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.laws import Dirichlet, Neumann, Wall
from signorini_fenicsx.physics.elasticity.conditions import Contact

COMM = MPI.COMM_WORLD


@pytest.mark.parallel([1, 3])
def test_bent_block_is_exact():
    """σ_zz = a + bx + cy in a block that a tool presses and bends about two axes, ν = 0: exact, and so is the bound."""
    a, b, c = -0.1, 0.06, -0.04
    u = [f"-{b}*z^2/2", f"-({c})*z^2/2", f"({a} + {b}*x + ({c})*y)*z"]
    tool = Contact("z1", force={"z": a}, moment={"x": c / 12, "y": -b / 12})
    sides = Neumann(["x0", "x1", "y0", "y1"])
    body = Elasticity(1.0, 0.0, exact=u, conditions=[Dirichlet("z0", 0), sides, tool])
    solution = solve(box(COMM, 1, [-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]), body)
    errors = solution.errors()
    assert errors is not None
    assert errors["energy"] < 1e-12
    moved = solution.quantities()["tools"]["z1"]
    assert moved["displacement"]["z"] == pytest.approx(a)
    assert moved["rotation"] == pytest.approx({"x": c, "y": -b})
    assert certify(solution).bound < 1e-7


def punched(force: float | str = -0.1, **more: Any) -> Elasticity:
    """A block under a round punch that moves along y and turns."""
    tool = Contact("y1", gap="0.5*(x - 0.4)^2", force={"y": force}, moment={"z": 0.0}, **more)
    return Elasticity(1.0, 0.3, conditions=[Dirichlet("y0", 0), Neumann(["x0", "x1"]), tool])


def test_the_force_of_a_motion():
    """A foundation where the tool has come to has the same stress; the bound is above the distance to finer meshes."""
    coarse, fine = (solve(box(COMM, n, [0.0, 0.0], [1.0, 1.0]), punched()) for n in (4, 8))
    about = coarse.quantities()["tools"]["y1"]
    gap = f"0.5*(x - 0.4)^2 + {about['displacement']['y']} + {about['rotation']['z']}*(x - 0.5)"
    fixed = Contact("y1", gap=gap)
    body = Elasticity(1.0, 0.3, conditions=[Dirichlet("y0", 0), Neumann(["x0", "x1"]), fixed])
    again = solve(coarse.spaces.domain, body)
    np.testing.assert_allclose(again.stresses, coarse.stresses, atol=1e-13)
    assert coarse.resultants()["y1"] == pytest.approx([0.0, -0.1, -0.05], abs=1e-14)
    bound = certify(coarse)
    assert bound.guaranteed
    assert bound.bound == pytest.approx(certify(again).bound, rel=1e-6)
    distance = compare(fine, coarse).norms.energy
    assert distance < bound.bound + certify(fine).bound
    assert bound.bound < 1.4 * distance


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parallel([1, 3])
def test_held_by_a_tool(dim: int):
    """A block on a rough floor that a rough tool presses and pushes is held by both; slip is relative to it."""
    last, flat = "yz"[dim - 2], "xy"[: dim - 1]
    law, sides = Coulomb(0.5), Neumann([f"{axis}{end}" for axis in flat for end in "01"])
    push = dict.fromkeys(flat, 0.03)
    tool = Contact(f"{last}1", gap="0.1*(x - 0.4)^2", friction=law, force={last: -0.1, **push})
    body = Elasticity(1.0, 0.3, conditions=[sides, Contact(f"{last}0", friction=law), tool])
    solution = solve(box(COMM, 2, [0.0] * dim, [1.0] * dim), body)
    force = [*(dim - 1) * [0.03], -0.1]
    for part, sign in ((f"{last}1", 1), (f"{last}0", -1)):
        assert solution.resultants()[part][:dim] == pytest.approx(sign * np.array(force), abs=1e-12)
    bound, slip, shear = solution.data.friction.bound, solution.slip_vectors, solution.shear_vectors
    np.testing.assert_allclose(bound, 0.5 * solution.pressure[solution.spaces.rough_rows], atol=1e-9)
    size = np.linalg.norm(slip, axis=2)
    slips = (size > 1e-9) & (bound > 1e-9)
    assert COMM.allreduce(int(slips.sum())) > 0
    along = -(bound / np.where(slips, size, 1.0))[slips, None] * slip[slips]
    np.testing.assert_allclose(shear[slips], along, atol=1e-10)
    assert certify(solution).relative < 0.5


def test_on_springs():
    """A body on springs alone, pressed by a tool: its bound is above the distance to a finer mesh."""

    def body(n: int) -> Any:
        conditions = [Neumann("x1"), Dirichlet("x0", 0, components="x"), Wall("y0", beta="1 + x")]
        tool = Contact("y1", gap="0.3*(x - 0.4)^2", force={"y": -0.1}, moment={"z": 0.0})
        return solve(box(COMM, n, [0.0, 0.0], [1.0, 1.0]), Elasticity(1.0, 0.3, conditions=[*conditions, tool]))

    coarse, fine = body(3), body(9)
    assert coarse.resultants()["y0"][1] == pytest.approx(0.1, abs=1e-12)
    distance, bound = compare(fine, coarse).norms.energy, certify(coarse).bound
    assert distance < bound + certify(fine).bound < 2 * distance


def test_in_steps():
    """The force on a tool may depend on time, and friction is against the slip on the tool in the step before."""
    tool = Contact("y1", friction=Coulomb(0.2), force={"y": "-0.1", "x": "(0.01*t if t < 2.5 else 0)"})
    body = Elasticity(1.0, 0.3, conditions=[Dirichlet("y0", 0), Neumann(["x0", "x1"]), tool])
    domain, moved = box(COMM, 4, [0.0, 0.0], [1.0, 1.0]), []
    for instant in evolve(domain, body, Evolution(end=3.0, steps=3)):
        moved.append(instant.solution.quantities()["tools"]["y1"]["displacement"]["x"])
        row, force = instant.solution.of_step(), instant.solution.resultants()["y1"]
        assert [row["y1_tool_x"], row["y1_tool_y"] < -0.05] == [moved[-1], True]
        assert 0.1 < row["y1_peak_pressure"] == instant.solution.pressure.max()
        assert row["von_mises"] > row["y1_peak_pressure"] / 2
        assert force[:2] == pytest.approx([0.01 * instant.t * (instant.t < 2.5), -0.1], abs=1e-12)
    assert moved[1] > 2 * moved[0]  # edges slip
    assert moved[2] > 0.02 * moved[1]  # and do not slip back all the way


CASE = """physics = "elasticity"
geometry = {shape = "square", mesh = "structured"}
boundary = {neumann = ["left", "right"]}
problem = {young = 1, poisson = 0.3}
solve = {h = "1/4"}
[[law]]
kind = "friction"
parts = ["top"]
mu = 0.5
gap = "0.2*(x - 0.4)^2"
force = {y = -0.1, x = 0.02}
moment = {z = 0}
"""


def test_case_file(tmp_path: Path):
    """The summary, the report and the file have the motion; wrong keys are refused in one sentence."""
    (tmp_path / "press.toml").write_text(CASE, encoding="utf-8")
    done = signorini(tmp_path, "solve", "press.toml", "--output", "out")
    assert done.returncode == 0, done.stderr
    assert "the tool has moved by" in done.stdout
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    moved = summary["quantities"]["tools"]["top"]
    assert moved["displacement"]["y"] < -0.05
    assert summary["resultants"]["top"][:2] == pytest.approx([0.02, -0.1], abs=1e-12)
    again = load_solution(tmp_path / "out")
    assert again.quantities()["tools"]["top"]["rotation"] == pytest.approx(moved["rotation"])
    assert certify(again).bound == pytest.approx(summary["certificate"]["bound"], rel=1e-6)
    wrong = {
        "[[law]] force on part 'top', z: unknown axis; there are x, y": ("y = -0.1", "z = -0.1"),
        "[[law]] force on part 'top', y: must be a number": ("y = -0.1", 'y = "x"'),
        "force: must be a table, {name = value}, not 3": ("force = {y = -0.1, x = 0.02}", "force = 3"),
        "force: a tool is on one part": ('parts = ["top"]', 'parts = ["top", "bottom"]'),
        "of the law 'wall'; known are kind, parts, gap, beta, level; a law with it is contact or friction": (
            'kind = "friction"\nparts = ["top"]\nmu = 0.5',
            'kind = "wall"\nparts = ["top"]\nbeta = 1',
        ),
        "that is the tool on 'top'": ("y = -0.1", "y = 0.1"),
    }
    for number, (message, change) in enumerate(wrong.items()):
        (tmp_path / f"{number}.toml").write_text(CASE.replace(*change), encoding="utf-8")
        done = signorini(tmp_path, "solve", f"{number}.toml", "--output", f"out{number}")
        assert (done.returncode, message in done.stderr) == (2, True), done.stderr


def test_bolted_joint():
    """The shipped joint: two tools with opposite forces press plates together; they carry a pull, at most μP."""
    case = load_case("joint")
    solution = solve_case(case)
    forces = solution.resultants()
    assert forces["joint"][0] == pytest.approx(600)
    assert [forces[part][2] for part in ("washer", "head", "joint")] == pytest.approx([-4000, 4000, 4000])
    moved = {tool: about["displacement"]["z"] for tool, about in solution.quantities()["tools"].items()}
    assert moved["washer"] < 0 < moved["head"]
    assert min(state["vertices"] for state in solution.friction_states().values()) > 0
    with pytest.raises(InputError, match=r"slides away, .*: on this motion the loads do the work .* no pressure with"):
        solve_case(case.with_values({"problem.g_N": {"pulled": [-13.5, 0, 0]}}), domain=solution.spaces.domain)


def test_no_derivatives():
    """Derivatives are those of a foundation that stays."""
    solution = solve(box(COMM, 2, [0.0, 0.0], [1.0, 1.0]), punched())
    with pytest.raises(InputError, match="derivatives are not there where a tool moves"):
        solution.linearised(1e-8)


@pytest.mark.parametrize("law", [None, Tresca(0.01), Coulomb(0.3)], ids=["none", "Tresca", "Coulomb"])
@pytest.mark.parallel([1, 3])
def test_iterated(law: Tresca | Coulomb | None):
    """CG finds what a factorisation does; solves are rough at first where no bound has to be found from them."""
    domain = box(COMM, 8, [0.0, 0.0], [1.0, 1.0])
    by_cg, direct = (
        solve(domain, punched(friction=law), Options(tuning=Tuning(direct_up_to=size, predict_from=1)))
        for size in (0, None)
    )
    assert by_cg.outcome.linear_solver.startswith("cg")
    assert any(step.rough for step in by_cg.outcome.history) == (not isinstance(law, Coulomb))
    assert not any(step.rough for step in direct.outcome.history)
    np.testing.assert_allclose(by_cg.data.tools[0].moved, direct.data.tools[0].moved, rtol=1e-8)
    np.testing.assert_allclose(by_cg.stresses, direct.stresses, atol=1e-8)
