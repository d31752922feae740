"""Joints on springs across and along, which slip by Tresca or Coulomb: exact states in steps, files, refusals."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bodies_apart import apart, box_cells
from commands import read_rows, signorini
from elastic import box
from in_time import run, run_in_two
from made_cases import SQUARE_BODY
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.contact.laws import Dirichlet, Neumann
from signorini_fenicsx.discrete.pairs import Pair
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.physics.elasticity.conditions import Contact, Coulomb, JointSprings, Tresca
from signorini_fenicsx.physics.elasticity.problem import Elasticity
from signorini_fenicsx.physics.elasticity.show.tables import STATES
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.quantities import Energy, Force
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.evolving import evolve
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
NORMAL, SHEAR, MU = 2.0, 0.5, 0.4
PRESSURE = 0.1 / (1 + 1 / NORMAL)
"""Under a top that is moved down by 0.1, E = 1, ν = 0."""
ALONG = {2: [1.0], 3: [0.6, 0.8]}
"""Where blocks are moved to, by dimension."""


def unit_box(dim: int, n: int) -> Domain:
    """The unit square or cube with n cells along each edge."""
    return box(COMM, n, [0.0] * dim, [1.0] * dim)


def block(dim: int, slide: str, shear: str, friction: Tresca | Coulomb) -> Elasticity:
    """A block on a joint whose top is moved along `ALONG` by `slide`; `shear` is its uniform shear stress."""
    axis, pulls = "xyz"[dim - 1], []
    for name, part in zip("xy", ALONG[dim], strict=False):
        up = [f"{part}*({shear})"]
        pulls += [Neumann(f"{name}0", ["0"] * (dim - 1) + [f"-{up[0]}"]), Neumann(f"{name}1", ["0"] * (dim - 1) + up)]
    top = [*(f"{part}*({slide})" for part in ALONG[dim]), "-0.1"]
    joint = JointSprings(f"{axis}0", NORMAL, SHEAR, friction)
    return Elasticity(young=1, poisson=0, conditions=[joint, Dirichlet(f"{axis}1", top), *pulls])


def held(solution: ElasticSolution) -> int:
    """Number of facet vertices whose springs along the joint hold (collective)."""
    return int(COMM.allreduce(np.count_nonzero(solution.states == STATES.index("stick"))))


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize(("dim", "friction"), [(2, Coulomb(MU)), (2, Tresca(MU * PRESSURE)), (3, Coulomb(MU))])
def test_slip_and_back(dim: int, friction: Tresca | Coulomb):
    """The block slides until the joint slips, and back on its springs: what has slipped stays; so says the bound."""
    most = MU * PRESSURE
    slipped = 0.16 - most / 0.5 - most / SHEAR  # less what the block (G = ½) and the springs take
    back = (0.1 - slipped) / (1 / 0.5 + 1 / SHEAR)
    slide, shear = "0.16 - 0.06*(t - 1)", f"{most} + {back - most}*(t - 1)"
    problem = block(dim, slide, shear, friction)
    for instant in evolve(unit_box(dim, 2), problem, Evolution(end=2, steps=2)):
        solution, stress = instant.solution, (most, back)[instant.step - 1]
        strain = np.diag([0.0] * (dim - 1) + [-PRESSURE])
        strain[-1, :-1] = strain[:-1, -1] = stress * np.array(ALONG[dim])
        assert COMM.allreduce(float(abs(solution.stresses - strain).max(initial=0.0)), MPI.MAX) < 1e-12
        along = stress / SHEAR + slipped
        assert COMM.allreduce(float(abs(solution.slip - along).max(initial=0.0)), MPI.MAX) < 1e-12
        assert held(solution) == (0, 4 if dim == 2 else 24)[instant.step - 1]
        assert solution.certify().bound < 1e-6 * solution.norms()["energy"]


def curved(dim: int, normal: float, shear: float) -> Elasticity:
    """A joint whose shear grows up to its bound 0.2 at x = ½, and which slips beyond; the same for all y in space."""
    axis, bound, depth = "xyz"[dim - 1], 0.2, 0.1 / (1 + normal)
    before, beyond = "max(0.5 - x, 0)", "max(x - 0.5, 0)"
    way = f"(2*{axis} + {1 / shear})"  # what the block (G = ½) and the springs give way under a unit
    u = [f"{beyond}^3 + ({bound} - {before}^3)*{way}", *["0"] * (dim - 2), f"-{depth}*(1 + {normal}*{axis})"]
    f = [f"6*({before}*{way} - {beyond})", *["0"] * (dim - 2), f"-3*{before}^2"]
    conditions = [
        JointSprings(f"{axis}0", normal, shear, Tresca(bound)),
        *(Dirichlet(part, u) for part in (f"{axis}1", "x0", "x1")),
        *(Neumann(part) for part in ("y0", "y1") if dim == 3),
    ]
    return Elasticity(young=1, poisson=0, f=f, conditions=conditions, exact=u)


@pytest.mark.parametrize(("normal", "shear"), [(2.0, 1.0), (1e3, 1e3)])
def test_bound_and_rates(normal: float, shear: float):
    """The bound is above the error, but for oscillation by some per cent, and both are of order 2."""
    errors, bounds = [], []
    for n in (4, 8):
        solution = solve(unit_box(2, n), curved(2, normal, shear))
        errors.append(solution.errors()["energy"])
        certificate = solution.certify()
        bounds.append(certificate.bound)
        assert errors[-1] < bounds[-1] < 1.3 * errors[-1] + certificate.oscillation
        assert held(solution) < 2 * n
    assert errors[1] < errors[0] / 3.2
    assert bounds[1] < bounds[0] / 3.5


def test_bound_in_space():
    """The error is that of the plane, and the bound as near."""
    in_plane, in_space = (solve(unit_box(dim, 2), curved(dim, 2.0, 1.0)) for dim in (2, 3))
    error, certificate = in_space.errors()["energy"], in_space.certify()
    assert error == pytest.approx(in_plane.errors()["energy"], rel=0.15)
    assert error < certificate.bound < 1.1 * error + certificate.oscillation


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_stiff_springs_are_none(dim: int, folder: Path):
    """With stiff springs it is friction without any, where stick and slip are side by side; saved, it is the same."""
    axis, gap = "xyz"[dim - 1], "0.02*x + 0.01*y" if dim == 3 else "0.02*x"
    free = [Neumann(f"{name}{end}") for name in "xy"[: dim - 1] for end in (0, 1)]
    domain, sides = unit_box(dim, 6 if dim == 2 else 2), [Dirichlet(f"{axis}1", [0.05, 0.02, -0.1][-dim:]), *free]
    joint = JointSprings(f"{axis}0", 1e9, 1e8, Coulomb(0.3), gap=gap)
    contact = Contact(f"{axis}0", gap=gap, friction=Coulomb(0.3))
    on_joint, on_plane = (
        solve(domain, Elasticity(young=1, poisson=0.3, conditions=[each, *sides])) for each in (joint, contact)
    )
    assert np.array_equal(on_joint.states, on_plane.states)
    assert 0 < held(on_joint) < on_joint.states.size
    assert abs(on_joint.stresses - on_plane.stresses).max() < 1e-6
    assert on_joint.certify().bound == pytest.approx(on_plane.certify().bound, rel=0.01)
    on_joint.write(folder / "kept")
    again = load_solution(folder / "kept", COMM)
    assert np.allclose(again.slip, on_joint.slip, rtol=0, atol=1e-14)
    assert again.certify().bound == pytest.approx(on_joint.certify().bound, rel=1e-6)


def test_quantities():
    """Energy and forces of a block that sticks on its joint have intervals around what they are."""
    shear = 0.1 / (1 / 0.5 + 1 / SHEAR)
    solution = solve(unit_box(2, 1), block(2, "0.1", str(shear), Coulomb(MU)))
    stored = PRESSURE**2 * (1 + 1 / NORMAL) / 2 + shear**2 * (1 / 0.5 + 1 / SHEAR) / 2
    for kind, exact in ((Energy(), stored), (Force("y0", [1, 0]), -shear)):
        found = solution.quantity(kind)
        assert found.lower - 1e-9 <= exact <= found.upper + 1e-9
        assert found.upper - found.lower < 1e-5


def test_between_bodies_that_share_no_nodes():
    """A pair has the joint between its bodies: a uniform state, whose bound is rounding."""
    shear = MU * PRESSURE
    lower = box_cells([3, 2], [0, -1], [1, 0])
    upper = box_cells([2, 2], [0, 0], [1, 1], seed=1)
    sides = {
        "top": ("upper", lambda x: np.isclose(x[1], 1)),
        "bottom": ("lower", lambda x: np.isclose(x[1], -1)),
        "above": ("upper", lambda x: np.isclose(x[1], 0)),
        "below": ("lower", lambda x: np.isclose(x[1], 0)),
        **{
            f"{name}{end}": (name, lambda x, end=end: np.isclose(x[0], end))
            for name in ("upper", "lower")
            for end in (0, 1)
        },
    }
    domain = apart(COMM, {"upper": upper, "lower": lower}, sides)
    down = PRESSURE * (2 + 1 / NORMAL)
    pulls = [Neumann(f"{name}{end}", [0, shear * (2 * end - 1)]) for name in ("upper", "lower") for end in (0, 1)]
    conditions = [
        Dirichlet("top", [0.5, -down]),
        Dirichlet("bottom", 0),
        Pair("above", "below", JointSprings((), NORMAL, SHEAR, Coulomb(MU))),
        *pulls,
    ]
    solution = solve(domain, Elasticity(young=1, poisson=0, conditions=conditions))
    assert abs(solution.stresses - [[0, shear], [shear, -PRESSURE]]).max() < 1e-12
    assert solution.certify().bound < 1e-6 * solution.norms()["energy"]


def refused_derivative() -> None:
    """A derivative of a block on a joint."""
    solve(unit_box(2, 1), block(2, "0", "0", Tresca(1))).linearised(1e-9)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (refused_derivative, "derivatives are not there with springs along a joint"),
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
    assert all(0 < float(row["bound"]) < 0.1 for row in read_rows(folder / "whole" / "steps.csv"))


def test_case_file(folder: Path):
    """`solve` takes the law, says of what its bound is, and refuses a stiffness that is not positive."""
    (folder / "case.toml").write_text(CASE, encoding="utf-8")
    ended = signorini(folder, "solve", "case.toml", "--output", "found")
    assert ended.returncode == 0, ended.stderr
    assert "Tresca's problem with the last bound of the friction" in ended.stdout
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
