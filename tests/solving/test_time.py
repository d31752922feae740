"""Problems in time: rates and bounds in h and τ, the steady end, any method, cost of steps, bad input."""

import gc

import numpy as np
import pytest
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Domain, Evolution, InputError, Options, Signorini, Solver, Wall, evolve, solve
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.linear.petsc import LinearSolver
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.discrete import data as data_module
from signorini_fenicsx.physics.diffusion.solution import Solution

COMM = MPI.COMM_WORLD
PLUS, MINUS = "max(x - 0.3 - 0.4*t, 0)", "max(0.3 + 0.4*t - x, 0)"
U = f"{PLUS}^3 - y*{MINUS}^3"
LOAD = f"-1.2*({PLUS}^2 + y*{MINUS}^2) - 6*({PLUS} - y*{MINUS})"
MOVING = Diffusion(f=LOAD, u_D=U, exact=U, conditions=[Signorini("bottom")])
"""On y = 0 contact for x < 0.3 + 0.4 t; capacity 1."""
START = "max(x - 0.3, 0)^3 - y*max(0.3 - x, 0)^3"


def square(h: float) -> Domain:
    return build_domain(COMM, "square", h, mesh="structured")


def moving(h: float, steps: int, scheme: str = "implicit-euler", **options: object) -> Solution:
    """The moving transition at t = 1."""
    evolution = Evolution(end=1.0, steps=steps, initial=START, scheme=scheme)
    *_, last = evolve(square(h), MOVING, evolution, Options(**options))
    return last.solution


def difference(one: Solution, other: Solution) -> float:
    """‖u − u'‖ on one mesh."""
    change = one.u.x.array - other.u.x.array
    return float(np.sqrt(COMM.allreduce(one.spaces.cell_measures @ change**2)))


def test_orders_in_space():
    """Order 1 in σ, u and p with τ = 2h, and errors below their bounds; the transition within some facets."""
    errors = []
    for size in (1 / 8, 1 / 16):
        solution = moving(size, round(1 / (2 * size)))
        found, h = solution.errors(), solution.spaces.domain.h
        assert "div_sigma_L2" not in found
        assert found["contact_hausdorff"] < 3 * h
        errors.append([found[name] / h for name in ("sigma_L2", "u_L2", "p_L2")])
    errors = np.array(errors)
    assert np.all(errors < [0.315, 0.051, 0.015])
    assert np.all(np.log2(errors[:-1] / errors[1:]) > -0.04)


def test_orders_in_time():
    """On one mesh, against many steps: order 1 of implicit Euler, order 2 of BDF2, and their sizes."""
    best = moving(1 / 4, 40, "bdf2")
    for scheme, order, bound in (("implicit-euler", 0.88, 4.5e-4), ("bdf2", 1.9, 2.7e-4)):
        errors = [difference(moving(1 / 4, steps, scheme), best) for steps in (4, 8)]
        assert errors[0] < bound
        assert np.log2(errors[0] / errors[1]) > order, (scheme, errors)


@pytest.mark.parametrize("algorithm", ["alg1", "alg4", "vi"])
def test_the_steady_state_is_the_solution(algorithm: str):
    """With data that settle down the end is that of `solve`, for laws, regions of c and methods of any kind."""

    def settling(share: str) -> Diffusion:
        laws = [Wall("left", beta=2, level=f"0.3*{share}")] if algorithm == "alg1" else []
        conditions = [Signorini("bottom", "-0.01*x"), *laws]
        return Diffusion(f=f"20*(x - 0.6)*{share}", kappa="1 + y", c="x", conditions=conditions)

    evolution = Evolution(end=60.0, steps=16, initial="sin(9*x)", capacity="1/2 if x > 0.5 else 1/5")
    options, domain = Options(algorithm=algorithm, eps=1e-9), square(1 / 8)
    *_, last = evolve(domain, settling("(1 - exp(-9*t))"), evolution, options)
    steady = solve(domain, settling("1"), options)
    assert 0 < steady.contact[0] < steady.spaces.Lambda.dofmap.index_map.size_global
    for one, other in ((last.solution.sigma, steady.sigma), (last.solution.u, steady.u), (last.solution.p, steady.p)):
        np.testing.assert_allclose(one.x.array, other.x.array, atol=1e-8)


def test_a_step_with_sets_that_stand_still_is_one_solve(monkeypatch: pytest.MonkeyPatch):
    """Soon no step factorises, and each solves one linear system; the forms and data that stay are not made again."""
    counted = {"solves": 0, "means": 0}
    solve_once, take_means = LinearSolver.solve, data_module.cell_means

    def count(self: LinearSolver, *args: object) -> None:
        counted["solves"] += 1
        solve_once(self, *args)

    def count_means(*args: object) -> object:
        counted["means"] += 1
        return take_means(*args)

    monkeypatch.setattr(LinearSolver, "solve", count)
    monkeypatch.setattr(data_module, "cell_means", count_means)
    problem = Diffusion(f="(20 + exp(-t))*(x - 0.6)", u_D="x*(1 - exp(-t))", conditions=[Signorini("bottom")])
    numbers, means, data = [], [], []
    for instant in evolve(Solver(square(1 / 8), problem), problem, Evolution(50.0, 25)):
        numbers.append(counted["solves"])
        means.append(counted["means"])
        data.append(instant.solution.data)
    assert np.all(np.diff(numbers)[-10:] <= 1)  # none where the load stays the same
    assert np.all(np.diff(means)[1:] == 0)
    assert data[-1].c_h is data[-2].c_h
    assert data[-1].u_D is not data[-2].u_D


@pytest.mark.parallel([1, 2])
def test_a_step_starts_from_earlier_solutions():
    """From their combination nearest in energy: after three steps a load that they span is solved at once."""
    options = Options(tuning=Tuning(direct_up_to=0))
    solver = Solver(square(1 / 8), Diffusion(0, conditions=[Signorini("bottom")]))
    loads = ["x - 0.6", "x - 0.6 + y/9", "x - 0.6 + sin(9*x)/9", "x - 0.6 + y/7 - sin(9*x)/8"]
    found = [solver.solve(Diffusion(f=loads[0], conditions=[Signorini("bottom", -1)]), options)]
    for f in loads[1:]:
        found.append(solver.solve(Diffusion(f=f, conditions=[Signorini("bottom", -1)]), options, start=found[-1]))
    taken = [sum(step.linear_iterations for step in each.outcome.history) for each in found]
    assert taken[3] <= 2 < taken[2]
    anew = solve(square(1 / 8), Diffusion(f=loads[3], conditions=[Signorini("bottom", -1)]), options)
    np.testing.assert_allclose(found[3].u.x.array, anew.u.x.array, atol=1e-11)


def test_nothing_grows():
    """With the collector off, as in programs, what is left after 50 steps is what is left after 25."""
    problem, left = Diffusion(f="20*(x - 0.6)*sin(t)", u_D="x*sin(t)/9", conditions=[Signorini("bottom", -0.1)]), []
    gc.disable()
    for instant in evolve(square(0.5), problem, Evolution(end=9.0, steps=55)):
        if instant.step in (27, 52):
            left.append(len(gc.get_objects()))
    assert left[1] - left[0] < 50


def test_at_rest_u_is_rounding():
    """Until ψ rises above 0 at t = 1.5; nothing drives u before, and its rounding is no load of the next step."""
    problem = Diffusion(f=0, c="x", conditions=[Signorini("bottom", "t - 1.5")])
    found = [each.solution.norms()["u_L2"] for each in evolve(square(0.25), problem, Evolution(2.0, 8))]
    assert max(found[:6]) < 1e-15
    assert min(found[6:]) > 0.01


def test_bad_input():
    """Each in one sentence that says what and where."""
    domain = square(0.5)
    for evolution, problem, message in [
        ({"end": 0.0, "steps": 1}, {}, r"\[time\] end: must be a time > 0"),
        ({"end": 1.0, "steps": 0}, {}, r"\[time\] steps: must be a whole number"),
        (
            {"end": 1.0, "steps": 1, "scheme": "magic"},
            {},
            r"\[time\] scheme: unknown 'magic'; use one of implicit-euler",
        ),
        ({"end": 1.0, "steps": 1, "capacity": "x - 0.5"}, {}, r"\[time\] capacity: must not be negative"),
        ({"end": 1.0, "steps": 1, "capacity": 0}, {}, r"\[time\] capacity: is 0 everywhere"),
        ({"end": 1.0, "steps": 1, "capacity": {"clay": 1}}, {}, r"\[time\] capacity: unknown region 'clay'"),
        ({"end": 1.0, "steps": 1, "initial": "1/(x - x)"}, {}, r"\[time\] initial: not finite everywhere"),
        ({"end": 1.0, "steps": 1, "initial": "t"}, {}, "unknown name 't'"),
        ({"end": 1.0, "steps": 2}, {"c": "-3*t"}, r"\[problem\] c: must not be negative"),
        (
            {"end": 1.0, "steps": 2},
            {"f": "x/(t - 0.5)"},
            r"\[problem\] f: cannot be evaluated: .* by zero",
        ),
        ({"end": 1.0, "steps": 1}, {"psi": "(-2)^(t/2)"}, r"\[problem\] psi: cannot be evaluated: math domain"),
        ({"end": 1.0, "steps": 2}, {"c": lambda x: x[0]}, r"\[time\]: c and capacity must be numbers, texts or UFL"),
    ]:
        below = Signorini("bottom", psi=problem.pop("psi", 0.0))
        with pytest.raises(InputError, match=message):
            list(evolve(domain, Diffusion(**{"f": 1} | problem, conditions=[below]), Evolution(**evolution)))
