"""RT1 in time: exact steps, order two in h and τ under a moving contact, bounds, starts, ranks, quantities."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ufl
from in_time import run
from makers.bounds import difference
from mpi4py import MPI
from test_time import MOVING, START

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import evolve_case
from signorini_fenicsx.certificate.step_bounds import StepBounds
from signorini_fenicsx.contact.law import EVERYWHERE
from signorini_fenicsx.contact.laws import Neumann, Obstacle, Signorini, Storage, Wall
from signorini_fenicsx.derivatives.gradient import gradient_in_time
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.physics.diffusion.problem import Diffusion
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.quantities import Mean
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.evolving import evolve
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
RT1 = Options(element="RT1")
SMALL = {"solve.element": "RT1", "solve.h": 0.36, "time.steps": 4, "time.scheme": "bdf2"}


def grid(n: int, dim: int = 2, comm: MPI.Comm = COMM) -> Domain:
    shape = "square" if dim == 2 else "cube"
    return build_domain(comm, shape, 1.0001 * math.sqrt(dim) / n, mesh="structured")


def moving(n: int, steps: int, element: str = "RT1") -> Solution:
    """The moving transition at t = 1."""
    *_, last = evolve(grid(n), MOVING, Evolution(1.0, steps, START, scheme="bdf2"), Options(element=element))
    return last.solution


@pytest.mark.parametrize(("dim", "scheme"), [(2, "bdf2"), (3, "implicit-euler")])
def test_exact_steps(dim: int, scheme: str):
    """What is linear in space and time is exact to rounding, with data that vary in cells, contact and a wall."""
    u, c = "(2*y - x)*(1 + t)", "1 + y"
    laws = [
        Signorini("bottom" if dim == 2 else "front", psi=u, q_S="-3*(1 + t)"),
        Wall("left", beta=2, level=f"{u} + (1 + t)/2"),
        Neumann("right", "-1 - t"),
    ]
    problem = Diffusion(f=f"(1 + x)*(2*y - x) + ({c})*{u}", c=c, u_D=u, exact=u, conditions=laws)
    evolution = Evolution(end=0.5, steps=3, initial="2*y - x", capacity="1 + x", scheme=scheme)
    *_, last = evolve(grid(2, dim), problem, evolution, RT1)
    assert max(last.solution.errors().values()) < 1e-13


def test_moving_contact():
    """Order two in σ, u, p with τ ~ h, errors far below those of RT0, and bounds that are near them."""
    bounds = StepBounds()
    for instant in evolve(grid(4), MOVING, Evolution(1.0, 8, START, scheme="bdf2"), RT1):
        certificate = bounds.certify(instant)
        assert certificate.guaranteed
    errors = [solution.errors() for solution in (instant.solution, moving(8, 16))]
    for key, most in (("sigma_L2", 2.6e-3), ("u_L2", 5.3e-4), ("p_L2", 3.4e-4)):
        assert math.log2(errors[0][key] / errors[1][key]) > 1.9
        assert errors[1][key] < most
    lowest = moving(8, 16, "RT0").errors()
    assert errors[1]["sigma_L2"] < lowest["sigma_L2"] / 20
    assert errors[1]["u_L2"] < lowest["u_L2"] / 15
    assert 1 < certificate.sigma_bound / errors[0]["sigma_L2"] < 1.06
    assert 1 < certificate.bound / errors[0]["sigma_L2"] < 1.3


def test_orders_in_time():
    """Where u is linear in space: order 1 of implicit Euler and 2 of BDF2, with bounds of the errors."""
    u = "(x + 2*y)*cos(3*t)"
    f = f"-3*(1 + x)*(x + 2*y)*sin(3*t) + {u}"
    problem = Diffusion(f=f, c=1, u_D=u, exact=u, conditions=[Neumann("right", "cos(3*t)")])
    for scheme, order, most in (("implicit-euler", 0.9, 4e-2), ("bdf2", 1.85, 1e-2)):
        errors = []
        for steps in (8, 16):
            evolution = Evolution(1.0, steps, "x + 2*y", "1 + x", scheme)
            *_, last = evolve(grid(2), problem, evolution, RT1)
            errors.append(last.solution.errors()["u_L2"])
        assert errors[1] < most
        assert math.log2(errors[0] / errors[1]) > order, (scheme, errors)


def test_an_obstacle_that_sinks():
    """Far nearer to steps on a fine mesh than RT0, with a bound above the error of the step."""
    conditions = [Obstacle(region="all", psi="-0.1 - 0.05*t"), Signorini("bottom", psi="-0.05")]
    problem = Diffusion(f="-20*t + 10*x", conditions=conditions)
    evolution, found = Evolution(1.0, 4, capacity="1 + x", scheme="bdf2"), {}
    for element, n in (("RT0", 8), ("RT1", 8), ("RT1", 16)):
        *_, last = evolve(grid(n), problem, evolution, Options(element=element))
        found[element, n] = last.solution
    fine = found.pop(("RT1", 16))
    rough, sharp = (difference(each, fine) for each in found.values())
    assert 4 * sharp < rough
    assert sharp < found["RT1", 8].certify().sigma_bound < 3 * sharp
    assert fine.on_obstacle()["contact_measure"] > 0.4


def test_starts_from_another_element():
    """u_0 of another solution: of RT1 on the same mesh as it is, of RT0 its potential, of RT1 for RT0 in centroids."""
    problem = Diffusion(f="1 + x", u_D="x*y", conditions=[Signorini("bottom")])
    steady = {element: solve(grid(4), problem, Options(element=element)) for element in ("RT0", "RT1")}
    evolution = Evolution(end=1.0, steps=1)
    for options in (Options(element="RT0"), RT1):
        *_, last = evolve(grid(4), problem, evolution, options, start=steady[options.element])
        np.testing.assert_allclose(last.solution.u.x.array, steady[options.element].u.x.array, atol=1e-13)
    for element in ("RT0", "RT1"):
        other = "RT1" if element == "RT0" else "RT0"
        *_, last = evolve(grid(4), problem, replace(evolution, end=1e-6), Options(element=element), start=steady[other])
        np.testing.assert_allclose(last.solution.u_means, steady[other].u_means, atol=1e-3)


@pytest.mark.parallel(2)
def test_ranks(tmp_path: Path):
    """Numbers and bounds of the last step do not depend on the number of ranks, and it is read as it was written."""
    case, found = load_case("moving_transition").with_values(SMALL | {"time.steps": 2}), []
    for comm in (COMM, MPI.COMM_SELF):
        bounds = StepBounds()
        for instant in evolve_case(case, comm):
            certificate = bounds.certify(instant)
        found.append(instant.solution.norms() | {"bound": certificate.bound})
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    folder = COMM.bcast(tmp_path)
    run(case, folder / "x", certify_steps=False)
    written, last = load_solution(folder / "x", MPI.COMM_SELF), instant
    np.testing.assert_allclose(written.data.memory.x.array, last.solution.data.memory.x.array, atol=1e-12)
    assert vars(written.kkt) == pytest.approx(vars(last.solution.kkt), abs=1e-13)


def test_quantities():
    """The intervals of a step are proved, far shorter than those of RT0, and have its u in them."""
    problem = Diffusion(f="20*(x - 0.6)*(1 + t)", conditions=[Signorini("bottom")])

    def second(n: int, element: str) -> Solution:
        *_, last = evolve(grid(n), problem, Evolution(1.0, 2, scheme="bdf2"), Options(element=element))
        return last.solution

    rough, middle = (second(8, element).quantity(Mean()) for element in ("RT0", "RT1"))
    assert rough.proved
    assert middle.proved
    assert middle.width < rough.width / 10
    fine = second(12, "RT1")
    assert middle.lower < fine.spaces.integrate(fine.u * ufl.dx) < middle.upper


def test_refused():
    """Storage has no RT1, said before anything is solved; derivatives in time have none."""
    stored = Storage(region=EVERYWHERE, corners=[[0, 0]], before=1, beyond=2)
    problem = Diffusion(f=1, conditions=[Signorini("bottom"), stored])
    instants = list(evolve(grid(2), replace(MOVING, c=1), Evolution(1.0, 1), RT1))
    with pytest.raises(InputError, match="with RT1 there are no derivatives in time"):
        gradient_in_time(instants, lambda instant: instant.solution.u * ufl.dx, ["problem.c"])
    with pytest.raises(InputError, match="there is no RT1 for storage; take RT0"):
        next(evolve(grid(2), problem, Evolution(1.0, 1), RT1))
