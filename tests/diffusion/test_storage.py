"""Storage in time: Stefan's problem with one and two phases, oxygen, soil; contents, bounds of steps."""

import itertools
import math

import numpy as np
import pytest
from made_cases import refined
from makers.bounds import difference
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Evolution, Neumann, Obstacle, Signorini, Storage, evolve
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import evolve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.certificate.step_bounds import StepBounds
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.solving.evolving import Instant

COMM = MPI.COMM_WORLD


def strip(h: float, comm: MPI.Comm = COMM) -> Domain:
    return build_domain(comm, "[0, 1] x [0, 0.125]", h, mesh="structured")


def balances(instants: list[Instant], tau: float) -> list[float]:
    """What is lost in each step: the change of the content less what flows in, as a share of the content."""
    contents = [instant.steps.of_step(instant.solution)["content"] for instant in instants]
    inflow = [tau * instant.solution.flux_through() for instant in instants]
    changes = [after - before for before, after in itertools.pairwise(contents)]
    return [(change - flow) / contents[-1] for change, flow in zip(changes, inflow[1:], strict=True)]


@pytest.mark.parametrize(("name", "front"), [("melting", 2 * 0.6200626333135955), ("thawing", 0.6131077129969326)])
def test_similarity_solutions(name: str, front: float):
    """Order 1 of u in h with steps of h², the front where it is, nothing lost, guaranteed bounds."""
    errors = []
    for n in (8, 16):
        case = load_case(name).with_values({"solve.h": 1.0001 * math.sqrt(2) / n, "time.steps": n * n // 16})
        instants = list(evolve_case(case))
        last = instants[-1].solution
        errors.append(last.errors()["u_L2"])
        found = last.summary()["regions"]["law.0"]
        liquid = 8 * (found["water"]["measure"] + found["mush"]["measure"] / 2)
        assert liquid == pytest.approx(front * math.sqrt(case.time.end), abs=1.5 / n)
        assert max(map(abs, balances(instants, case.time.end / case.time.steps))) < 1e-12
        certificate = certify(last)
        assert certificate.guaranteed
        assert certificate.relative < 0.5
    assert math.log2(errors[0] / errors[1]) > 0.85


def test_all_is_held():
    """A jump of storage that takes all of the load holds u = 0 in every cell; σ = 0 is no failure, and θ is f t."""
    graph = Storage(region="all", corners=[[0, 0], [0, 1]], beyond=1)
    warmed = Diffusion(f="0.5 + x", conditions=[graph, Signorini("bottom", psi=-1), Neumann("top")])
    for instant in evolve(strip(0.2), warmed, Evolution(end=0.2, steps=2)):
        assert max(vars(instant.solution.kkt).values()) < 1e-12
        assert abs(instant.solution.u.x.array).max() < 1e-15
        content = instant.steps.of_step(instant.solution)["content"]
        assert content == pytest.approx(0.125 * instant.t, rel=1e-12)


def test_oxygen():
    """The front and the value at the sealed surface that Crank and Gupta (1972) and later papers have."""
    case = load_case("oxygen").with_values({"solve.h": 1.0001 * math.sqrt(2) / 32, "time.steps": 50})
    of_time = {round(instant.t, 4): instant.solution for instant in evolve_case(case)}
    for t, front, surface in ((0.06, 0.9918, 0.2236), (0.1, 0.9350, 0.1432), (0.14, 0.7989, 0.0779)):
        solution = of_time[t]
        used = -8 * solution.force().x.array @ solution.spaces.cell_measures
        middles = solution.spaces.mesh.geometry.x[solution.spaces.mesh.geometry.dofmaps[0]].mean(axis=1)
        assert used == pytest.approx(front, abs=0.02)
        assert solution.u.x.array[np.argmin(middles[:, 0])] == pytest.approx(surface, abs=0.004)
    assert of_time[0.2].u.x.array.max() < 1e-3


def column(n: int, steps: int, end: float) -> tuple[np.ndarray, np.ndarray]:
    """The case soil in one dimension, by finite volumes and Newton's method: u and θ at the end."""
    corners, values = np.array([0.0, 0.1, 0.5]), np.array([0.05, 0.25, 0.4])
    h, tau = 1 / n, end / steps
    u = np.full(n, 0.01)
    laplace = (np.diag(np.full(n, 2.0)) - np.diag(np.ones(n - 1), 1) - np.diag(np.ones(n - 1), -1)) / h**2
    laplace[0, 0], laplace[-1, -1] = 1 / h**2, 3 / h**2
    theta = np.interp(u, corners, values)
    for step in range(1, steps + 1):
        rain = 2.0 if step * tau < 0.3 else 0.0
        before = theta
        for held in (False, True):
            matrix, load = laplace.copy(), np.zeros(n)
            load[-1] += 2 * 0.01 / h**2
            if held:
                matrix[0, 0] += 2 / h**2
                load[0] += 2 * 0.5 / h**2
            else:
                load[0] += rain / h
            for _ in range(50):
                theta = np.interp(u, corners, values)
                slope = np.where((u < 0) | (u > 0.5), 0.0, np.where(u < 0.1, 2.0, 0.375))
                residual = (theta - before) / tau + matrix @ u - load
                change = np.linalg.solve(matrix + np.diag(slope / tau), -residual)
                u = u + change
                if np.abs(change).max() < 1e-12:
                    break
            if u[0] + rain * h / 2 <= 0.5:
                break
    return u, theta


def test_soil():
    """Against a fine solution in one dimension: u at the end of the rain and after some draining, and nothing lost."""
    case = load_case("soil").with_values({"solve.h": 1.0001 * math.sqrt(2) / 20, "time.end": 0.4, "time.steps": 40})
    instants = list(evolve_case(case))
    assert max(map(abs, balances(instants, 0.01))) < 1e-12
    states = {instant.step: instant.solution.summary()["segments"]["left"]["seepage"]["facets"] for instant in instants}
    assert (states[1], states[20] > 0, states[40]) == (0, True, 0)
    for step in (28, 40):
        u, _ = column(256, step, 0.01 * step)
        solution = instants[step - 1].solution
        x = solution.spaces.mesh.geometry.x[solution.spaces.mesh.geometry.dofmaps[0]].mean(axis=1)[:, 0]
        expected = np.interp(x, (np.arange(256) + 0.5) / 256, u)
        assert np.abs(solution.u.x.array - expected).max() < 0.012
    assert "law.0.rain" not in certify(instants[27].solution).by_quadrature


def test_storage_is_capacity():
    """A θ that is linear is a capacity, in both schemes, beside an obstacle and in time-dependent data."""
    data = {"f": "-10*t*x", "obstacle": -0.1}
    line = Storage([[0, 0]], 2, 2, region="all")
    domain = build_domain(COMM, "square", 0.15, mesh="structured")
    for scheme in ("implicit-euler", "bdf2"):
        known, found = (
            list(evolve(domain, Diffusion(**data, conditions=conditions), Evolution(1, 5, 0.1, capacity, scheme)))
            for conditions, capacity in (([], 2), ([line], None))
        )
        for one, other in zip(known, found, strict=True):
            np.testing.assert_allclose(other.solution.u.x.array, one.solution.u.x.array, atol=1e-12)
    bounds = StepBounds()
    assert all(np.isfinite(bounds.certify(instant).bound) for instant in found)


def test_bound_of_a_step():
    """The bound of a step is above the distance to a finer solution of the same step, and near it."""
    problem = Diffusion(f="8*sin(4*x)", conditions=[Neumann("left"), Obstacle(region="all", psi=-0.2)])
    graph = {"corners": [[0, 0], [0, 0.1], [0.1, 0.3]], "before": 1, "beyond": 2}
    coarse = build_domain(COMM, "square", 0.15, mesh="structured")
    one, other = (
        next(iter(evolve(domain, problem, Evolution(0.05, 1, capacity=graph)))).solution
        for domain in (coarse, refined(coarse, 2))
    )
    assert difference(one, other) < certify(one).sigma_bound < 1.5 * difference(one, other)


@pytest.mark.parametrize(
    ("capacity", "u_0"),
    [
        ({"corners": [[0, 0]], "before": 1, "beyond": 1}, "sin(40*x)"),
        pytest.param(
            {"corners": [[-0.5, -0.2], [0, 0], [0.1, 1]], "before": 0.5, "beyond": 2},
            "sin(40*x)",
            marks=pytest.mark.slow,
        ),
        ({"corners": [[0, 0], [0, 1]], "before": 1, "beyond": 1}, "sin(5*x)"),
        ("0.1 + x", "sin(5*x)"),
    ],
)
def test_the_start_within_cells_is_in_the_bound(capacity: dict[str, object] | str, u_0: str):
    """The content of u_0 in each point, not that of its means."""
    coarse = build_domain(COMM, "square", 0.3, mesh="structured")
    problem = Diffusion(f=1, conditions=[Neumann("top")])
    one, other = (
        next(iter(evolve(domain, problem, Evolution(0.05, 1, u_0, capacity))))
        for domain in (coarse, refined(coarse, 2))
    )
    assert StepBounds().certify(one).sigma_bound > difference(one.solution, other.solution)
