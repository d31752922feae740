"""Joints on springs across and along, which slip by Tresca or Coulomb: exact states in steps, files, refusals."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from commands import read_rows, signorini
from elastic import box
from in_time import run, run_in_two
from made_cases import SQUARE_BODY
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.contact.laws import Dirichlet, Neumann
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.physics.elasticity.conditions import Contact, Coulomb, JointSprings, Tresca
from signorini_fenicsx.physics.elasticity.problem import Elasticity
from signorini_fenicsx.physics.elasticity.show.tables import STATES
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.quantities import Energy
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.evolving import evolve
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
NORMAL, SHEAR, MU = 2.0, 0.5, 0.4
PRESSURE = 0.1 / (1 + 1 / NORMAL)
"""Under a top that is moved down by 0.1, E = 1, ν = 0."""


def block(slide: str, shear: str, friction: Tresca | Coulomb) -> Elasticity:
    """A block on a joint whose top is moved along x by `slide`; `shear` is its uniform shear stress."""
    return Elasticity(
        young=1,
        poisson=0,
        conditions=[
            JointSprings("y0", NORMAL, SHEAR, friction),
            Dirichlet("y1", [slide, "-0.1"]),
            Neumann("x0", ["0", f"-({shear})"]),
            Neumann("x1", ["0", shear]),
        ],
    )


def held(solution: ElasticSolution) -> int:
    """Number of facet vertices whose springs along the joint hold (collective)."""
    return int(COMM.allreduce(np.count_nonzero(solution.states == STATES.index("stick"))))


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("friction", [Coulomb(MU), Tresca(MU * PRESSURE)])
def test_slip_and_back(friction: Tresca | Coulomb):
    """The block slides until the joint slips, and back on its springs: what has slipped stays."""
    most = MU * PRESSURE
    slipped = 0.16 - most / 0.5 - most / SHEAR  # less what the block (G = ½) and the springs take
    back = (0.1 - slipped) / (1 / 0.5 + 1 / SHEAR)
    slide, shear = "0.16 - 0.06*(t - 1)", f"{most} + {back - most}*(t - 1)"
    problem = block(slide, shear, friction)
    for instant in evolve(box(COMM, 2, [0.0, 0.0], [1.0, 1.0]), problem, Evolution(end=2, steps=2)):
        solution, stress = instant.solution, (most, back)[instant.step - 1]
        strain = [[0.0, stress], [stress, -PRESSURE]]
        assert COMM.allreduce(float(abs(solution.stresses - strain).max(initial=0.0)), MPI.MAX) < 1e-12
        along = stress / SHEAR + slipped
        assert COMM.allreduce(float(abs(solution.slip - along).max(initial=0.0)), MPI.MAX) < 1e-12
        assert held(solution) == (0, 4)[instant.step - 1]


def test_stiff_springs_are_none(folder: Path):
    """With stiff springs it is friction without any, where stick and slip are side by side; saved, it is the same."""
    domain, sides = box(COMM, 6, [0.0, 0.0], [1.0, 1.0]), [Dirichlet("y1", [0.05, -0.1]), Neumann("x0"), Neumann("x1")]
    joint = JointSprings("y0", 1e9, 1e8, Coulomb(0.3), gap="0.02*x")
    contact = Contact("y0", gap="0.02*x", friction=Coulomb(0.3))
    on_joint, on_plane = (
        solve(domain, Elasticity(young=1, poisson=0.3, conditions=[each, *sides])) for each in (joint, contact)
    )
    assert np.array_equal(on_joint.states, on_plane.states)
    assert 0 < held(on_joint) < on_joint.states.size
    assert abs(on_joint.stresses - on_plane.stresses).max() < 1e-6
    on_joint.write(folder / "kept")
    assert np.allclose(load_solution(folder / "kept", COMM).slip, on_joint.slip, rtol=0, atol=1e-14)


def refused_in_space() -> None:
    """Springs along a joint of a cube."""
    problem = Elasticity(young=1, poisson=0, conditions=[JointSprings("z0", 1, 1, Tresca(1)), Dirichlet("z1", 0)])
    solve(box(COMM, 1, [0.0] * 3, [1.0] * 3), problem)


def refused_quantity() -> None:
    """The energy of a block on a joint."""
    solve(box(COMM, 1, [0.0] * 2, [1.0] * 2), block("0", "0", Tresca(1))).quantity(Energy())


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (refused_in_space, "joint_springs: springs along a joint are there in the plane only"),
        (refused_quantity, "Energy: none is there with springs along a joint"),
        (lambda: JointSprings("y0", 1, 1, 0.3), "friction: "),
    ],
)
def test_refused(wrong: Callable[[], object], words: str):
    """What is not there is refused in a sentence."""
    with pytest.raises(InputError, match=words):
        wrong()


CASE = f"""{SQUARE_BODY}
[[law]]
kind = "joint_springs"
parts = ["bottom"]
normal = 2
shear = 0.5
mu = 0.4

[problem]
young = 1
poisson = 0
u_D = ["0.08", "-0.1"]
g_N = {{left = ["0", "-0.02"], right = ["0", "0.02"]}}

[solve]
h = 1
"""


def test_after_a_restart(folder: Path):
    """What has slipped is kept from step to step: a run in two pieces is one in one piece."""
    of_time = "\n[time]\nend = 3\nsteps = 3\n"
    text = CASE.replace('u_D = ["0.08", "-0.1"]', 'u_D = ["0.1*t*(3 - t)", "-0.1"]').replace("mu = 0.4", "mu = 0.2")
    (folder / "case.toml").write_text(text + of_time, encoding="utf-8")
    case = load_case(folder / "case.toml")
    run(case, folder / "whole", certify_steps=True)
    run_in_two(case, folder / "two", step=2)
    one, other = (read_rows(folder / name / "contact.csv") for name in ("whole", "two"))
    slips = [[float(row["slip"]) for row in rows] for rows in (one, other)]
    assert np.allclose(*slips, rtol=0, atol=1e-12)
    assert {row["friction"] for row in one} == {"slip+", "slip-", "stick"}
    assert [row["bound"] for row in read_rows(folder / "whole" / "steps.csv")] == ["inf"] * 3


def test_case_file(folder: Path):
    """`solve` takes the law, says that there is no bound, and refuses a stiffness that is not positive."""
    (folder / "case.toml").write_text(CASE, encoding="utf-8")
    ended = signorini(folder, "solve", "case.toml", "--output", "found")
    assert ended.returncode == 0, ended.stderr
    assert "no error bound: none is there for springs along a joint" in ended.stdout
    assert "bottom (-0.02, 0.066667)" in ended.stdout
    for change, words in (
        ("law.0.shear=0", "the stiffness along a joint must be positive"),
        ("law.0.g=-1", "g: must be finite and not negative"),
        ('law.0.kind="joint"', "joint_springs"),
    ):
        for command in ("check", "solve"):
            refused = signorini(folder, command, "case.toml", "--set", change)
            assert refused.returncode == 2, refused.stdout
            assert words in refused.stderr
