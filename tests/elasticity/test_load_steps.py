"""Loads on an elastic body in steps: an exact history of slip, bounds of steps, restart, tables, refusals."""

from pathlib import Path

import numpy as np
import pytest
from commands import read_rows, signorini
from dolfinx.mesh import create_unit_square
from elastic import box
from mpi4py import MPI

from signorini_fenicsx import (
    Coulomb,
    Elasticity,
    Evolution,
    InputError,
    Options,
    StepBounds,
    certify,
    evolve,
    load_solution,
)
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.laws import Dirichlet, Neumann
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.elasticity.conditions import Contact, Tresca
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.show.tables import ContactTable
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.system import ElasticSystem
from signorini_fenicsx.solving.solver import Solver, solve

COMM = MPI.COMM_WORLD
PUSHED = "(0.4*t if t < 1 else 0.8 - 0.4*t)"
SHEAR = "(min(0.2*t, 0.05) if t < 1 else max(0.25 - 0.2*t, -0.05))"
"""A block that sticks until t = 0.25, slips until it is pushed back at t = 1, sticks, and slips back after t = 1.5."""


def block(friction: Tresca | Coulomb) -> Elasticity:
    """A block under uniform pressure 0.1 and uniform shear, E = 1, ν = 0, whose upper end is pushed to and fro."""
    return Elasticity(
        young=1.0,
        poisson=0.0,
        exact=[f"{PUSHED} - 2*{SHEAR}*(1 - y)", "-0.1*y"],
        conditions=[
            Contact("bottom", friction=friction),
            Dirichlet("top", [PUSHED, "-0.1"]),
            Neumann("left", ["0", f"-{SHEAR}"]),
            Neumann("right", ["0", SHEAR]),
        ],
    )


def test_exact_history():
    """Stick, slip, stick at the slip that was reached, slip back: exact in each step, and so is its bound."""
    domain, bounds, states = build_domain(COMM, "square", 0.5, mesh="structured"), StepBounds(), []
    for instant in evolve(domain, block(Coulomb(0.5)), Evolution(end=2.0, steps=8)):
        solution, t = instant.solution, instant.t
        errors = solution.errors()
        assert errors is not None
        assert max(errors["energy"], errors["u_L2"]) < 1e-10
        slipped = 0.0 if t <= 0.25 else 0.4 * t - 0.1 if t < 1 else 0.3 if t <= 1.5 else 0.9 - 0.4 * t
        np.testing.assert_allclose(solution.slip, slipped, atol=1e-9)
        assert bounds.certify(instant).bound < 1e-7
        states.append(max(solution.friction_states().items(), key=lambda item: item[1]["measure"])[0])
    assert states == ["stick", "slip-", "slip-", "slip-", "stick", "stick", "slip+", "slip+"]


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("tuning", [Tuning(), Tuning(direct_up_to=0)])
def test_one_system_for_all_loads(tuning: Tuning, monkeypatch: pytest.MonkeyPatch):
    """Other tractions, forces and bounds of friction keep the matrix; another material, or a support, does not."""
    made: list[ElasticData] = []
    first = ElasticSystem.__init__
    monkeypatch.setattr(ElasticSystem, "__init__", lambda system, *of: (made.append(of[1]), first(system, *of))[1])
    domain, options = box(COMM, 4, [0.0, 0.0], [2.0, 1.0]), Options(tuning=tuning)

    def loaded(pull: float, f: str = "0", young: float = 1.0, mu: float = 0.3) -> Elasticity:
        law = Contact("y0", gap="0.01*x", friction=Coulomb(mu))
        return Elasticity(young, 0.3, f=["0", f], conditions=[law, Neumann("y1", [0.02, -pull]), Neumann("x1")])

    solver = Solver(domain, loaded(0.1))
    problems = [loaded(0.1), loaded(0.2), loaded(0.2, f="-x"), loaded(0.2, mu=0.1), loaded(0.2, young=2.0)]
    found = [solver.solve(problem, options) for problem in problems]
    assert len(made) == 2
    for problem, solution in zip(problems, found, strict=True):
        alone = solve(domain, problem, options)
        np.testing.assert_array_equal(solution.touching, alone.touching)
        np.testing.assert_allclose(solution.stresses, alone.stresses, rtol=0, atol=1e-9 * np.abs(alone.stresses).max())


@pytest.mark.parallel([1, 3])
def test_start_from_another_mesh():
    """The first sets and bounds of the shear are those of a start on another mesh, not the numbers of its sites."""
    evolution, (coarse, fine) = (
        Evolution(end=1.0, steps=1),
        (build_domain(COMM, "square", h, mesh="structured") for h in (0.5, 0.2)),
    )
    (start,) = evolve(coarse, block(Coulomb(0.5)), evolution)
    (free,), (begun,) = (evolve(fine, block(Coulomb(0.5)), evolution, start=of) for of in (None, start.solution))
    np.testing.assert_allclose(begun.solution.slip, free.solution.slip, atol=1e-9)
    assert len(begun.solution.outcome.history) <= 2 < len(free.solution.outcome.history)


OBLIQUE = [(0.05, 0.0), (0.2, 0.0), (0.2, 0.1), (0.15, 0.12), (-0.2, 0.1), (-0.1, 0.05)]
"""Where the upper end of a block in space is at the end of each step."""


def slipped_in_space() -> list[tuple[np.ndarray, np.ndarray]]:
    """The slip of such a block and its shear, E = 1, ν = 0, height 1, |σ_t| ≤ 0.05: σ = (U − s)/2, or it slips."""
    found, slip = [], np.zeros(2)
    for end in OBLIQUE:
        shear = (np.array(end) - slip) / 2
        size = np.linalg.norm(shear)
        shear = shear if size <= 0.05 else 0.05 * shear / size
        slip = np.array(end) - 2 * shear
        found.append((slip, shear))
    return found


def in_steps(values: list[float]) -> str:
    """A text in t that has these values in steps of length 1."""
    text = f"{values[-1]:.17g}"
    for step, value in reversed(list(enumerate(values[:-1], start=1))):
        text = f"({value:.17g} if t < {step + 0.5} else {text})"
    return text


@pytest.mark.parametrize("friction", [Tresca(0.05), Coulomb(0.5)])
@pytest.mark.parallel([1, 3])
def test_exact_history_in_space(friction: Tresca | Coulomb):
    """Stick, slip, oblique slip twice, slip back and stick there: exact in each step, and its bound, too."""
    expected = slipped_in_space()
    slip, shear = ([in_steps([each[k][i] for each in expected]) for i in range(2)] for k in range(2))
    u = [*(f"{s} + 2*{tau}*z" for s, tau in zip(slip, shear, strict=True)), "-0.1*z"]
    body = Elasticity(1.0, 0.0, u_D=u, exact=u, conditions=[Contact("z0", friction=friction)])
    domain, states = box(COMM, 1, [0.0] * 3, [1.0] * 3), []
    for instant, (s, tau) in zip(evolve(domain, body, Evolution(end=6.0, steps=6)), expected, strict=True):
        solution = instant.solution
        errors = solution.errors()
        assert errors is not None
        assert max(errors["energy"], errors["u_L2"]) < 1e-10
        for found, vector in ((solution.slip_vectors, s), (solution.shear_vectors, -tau)):
            np.testing.assert_allclose(found, np.broadcast_to(np.append(vector, 0.0), found.shape), atol=1e-9)
        assert certify(solution).bound < 1e-7
        states.append(solution.friction_states()["slip"]["measure"])
    assert states == pytest.approx([0, 1, 1, 0, 1, 0])


def turned(domain: Domain) -> list[ElasticSolution]:
    """Two steps of a block that is pressed and pushed, then twisted."""
    twist = "(t - 1 if t > 1 else 0)"
    u = [f"0.02*t - 0.1*(y - 0.4)*{twist}", f"0.1*(x - 0.5)*{twist}", "-0.05"]
    sides = Neumann(["x0", "x1", "y0", "y1"])
    body = Elasticity(1.0, 0.3, conditions=[Contact("z0", friction=Coulomb(0.5)), Dirichlet("z1", u), sides])
    return [instant.solution for instant in evolve(domain, body, Evolution(end=2.0, steps=2))]


def test_second_step_in_space(folder: Path):
    """Friction is against what comes after the first step, its bound falls with h, and a file keeps both slips."""
    coarse, fine = (turned(box(COMM, n, [0.0] * 3, [1.0, 1.0, 0.5])) for n in (1, 2))
    first, last = fine
    friction = last.data.friction
    assert friction
    after = last.slip_vectors - first.slip_vectors
    size = np.linalg.norm(after, axis=2)
    slips = size > 1e-10
    assert slips.any()
    along = -(friction.bound / np.where(slips, size, 1.0))[slips, None] * after[slips]
    np.testing.assert_allclose(last.shear_vectors[slips], along, atol=1e-12)
    bound = certify(last)
    assert bound.bound < 0.75 * certify(coarse[1]).bound
    last.write(folder / "out")
    again = load_solution(folder / "out", problem=last.problem)
    np.testing.assert_allclose(np.sort(again.slip_vectors, axis=None), np.sort(last.slip_vectors, axis=None))
    assert again.kkt.complementarity < 1e-10
    assert certify(again).bound == pytest.approx(bound.bound, rel=1e-6)


def test_bounds_of_steps():
    """The bounds of steps that slip, and stick where they have slipped, fall with h, and are guaranteed."""
    pushed = Elasticity(
        young=1.0,
        poisson=0.3,
        conditions=[
            Contact("bottom", friction=Tresca("0.01 + 0.01*x")),
            Dirichlet("top", ["0.04*sin(2.5*t)", "-0.02"]),
            Neumann(["left", "right"]),
        ],
    )
    coarse, fine = (
        [instant.solution.certify() for instant in evolve(square, pushed, Evolution(end=1.5, steps=3))]
        for square in (build_domain(COMM, "square", size, mesh="structured") for size in (0.25, 0.125))
    )
    for one, two in zip(coarse, fine, strict=True):
        assert two.bound < one.bound / 2**0.5
        assert two.guaranteed
        assert two.relative < 0.15


CASE = """physics = "elasticity"
geometry = {shape = "square", mesh = "structured"}
boundary = {neumann = ["left", "right"]}
law = [{kind = "friction", parts = ["bottom"], mu = 0.3}]
problem = {young = 1, poisson = 0.3, u_D = ["0.05*sin(2*pi*t)", "-0.02"]}
time = {end = 1, steps = 4}
solve = {h = "1/4"}
"""


def test_case_file(folder: Path):
    """The tables have forces and displacements of each step; wrong files are refused."""
    (folder / "push.toml").write_text(CASE, encoding="utf-8")
    done = signorini(folder, "solve", "push.toml", "--output", "out", "--certify-steps", "--plot")
    assert done.returncode == 0, done.stderr
    assert "Tresca's problem with the last bound of the friction" in done.stdout
    assert "friction   at the end facet vertices: " in done.stdout
    rows = read_rows(folder / "out" / "steps.csv")
    assert [float(row["top_u_x"]) for row in rows] == pytest.approx([0.05, 0, -0.05, 0], abs=1e-3)
    for row in rows:
        forces = [float(row[f"{part}_force_x"]) for part in ("top", "bottom")]
        assert sum(forces) == pytest.approx(0.0, abs=1e-10)
        assert abs(forces[1]) <= 0.3 * float(row["contact_force"]) * (1 + 1e-9)
        assert (float(row["bound"]) > 0, row["guaranteed"]) == (True, "False")
    assert float(rows[1]["bottom_force_x"]) * float(rows[3]["bottom_force_x"]) < 0  # it is not back where it was
    names = {path.name for path in (folder / "out").iterdir()}
    assert names >= {"forces.png", "contact.png", "solution.bp", "solution.xdmf", "contact.csv"}
    pulse = ("--set", 'problem.u_D=["0", "0.001*exp(-1e4*(x - 0.3)^2) - 0.02"]', "--set", "time.steps=1", "--h", "1/2")
    done = signorini(folder, "solve", "push.toml", *pulse, "--output", "pulse", "--certify-steps")
    assert "not all are guaranteed: u_D not enclosed or not resolved" in done.stdout
    for old, new, message in (
        ("steps = 4", 'steps = 4, scheme = "bdf2"', "unknown key 'scheme' in [time]"),
        ("time =", "#", "unknown name 't'"),
    ):
        (folder / "wrong.toml").write_text(CASE.replace(old, new), encoding="utf-8")
        done = signorini(folder, "check", "wrong.toml")
        assert (done.returncode, message in done.stderr) == (2, True), done.stderr


def test_capacity_of_a_body():
    """What only diffusion has is refused."""
    square = build_domain(COMM, "square", 0.5, mesh="structured")
    with pytest.raises(InputError, match="steps of loads have no initial, capacity and scheme"):
        next(evolve(square, block(Tresca(0.05)), Evolution(end=1.0, steps=2, capacity=2.0)))


@pytest.mark.parallel([1])
def test_rows_of_a_facet_follow_each_other():
    """Two by two along a part in the plane, as pictures take them, also where y grows and x falls along it."""
    square = create_unit_square(COMM, 4, 4)
    square.geometry.x[:, 0] -= square.geometry.x[:, 1] / 2
    parts = {
        "left": lambda x: np.isclose(x[0], -x[1] / 2),
        "top": lambda x: np.isclose(x[1], 1),
        "free": lambda x: np.isclose(x[1], 0) | np.isclose(x[0], 1 - x[1] / 2),
    }
    top = Dirichlet("top", ["-0.05", "0.02"])
    problem = Elasticity(1.0, 0.3, conditions=[Contact("left", gap="0.06*y^2"), Neumann("free"), top])
    table = solve(domain_of(square, parts), problem).table().in_order()
    assert isinstance(table, ContactTable)
    assert table.number.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    np.testing.assert_allclose(table.x.reshape(-1, 2, 3).mean(axis=1), table.facet[::2])
    assert np.ptp(table.pressure.reshape(-1, 2), axis=1).max() > 0.01
