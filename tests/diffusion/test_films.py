"""Laws with memory: exact steps of a film, rates in τ, its steady state, a law of one's own, ranks, restarts."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from in_time import run, run_in_two
from makers.bounds import difference
from mpi4py import MPI

from signorini_fenicsx import (
    Diffusion,
    Elasticity,
    Evolution,
    Film,
    InputError,
    Neumann,
    Options,
    evolve,
    load_case,
    load_solution,
    solve,
    solve_case,
)
from signorini_fenicsx.cases.case import validated
from signorini_fenicsx.cases.solving import evolve_case
from signorini_fenicsx.cases.toml_files import read_toml
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.certificate.step_bounds import StepBounds
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.show.states import states

COMM = MPI.COMM_WORLD
R, K, J = 2.0, 3.0, 0.3
FILM = Path(__file__).parents[1] / "capability_cases" / "film.toml"


def strip(comm: MPI.Comm = COMM) -> Domain:
    return build_domain(comm, "[0, 1] x [0, 0.125]", 0.2, mesh="structured")


def thickness(steps: int) -> float:
    """The film at t = 1 on a strip that is 1 long, with u = 1 at the other end; each step is the exact one."""
    painted = Diffusion(f=0, u_D=1, conditions=[Neumann(["bottom", "top"]), Film("right", r=R, k=K, j=J)])
    h, tau = 0.0, 1 / steps
    for instant in evolve(strip(), painted, Evolution(1.0, steps)):
        half = (1 - R * (h - tau * K * J)) / 2
        h = (math.sqrt(half**2 + R * (h - tau * K * J + tau * K)) - half) / R  # h' = h + τk(1/(1 + rh') − j)
        np.testing.assert_allclose(states(instant.solution)["h"], h, rtol=1e-9)
        np.testing.assert_allclose(instant.solution.p_at, -R * h * instant.solution.flux_at, rtol=1e-9)
    assert StepBounds().certify(instant).guaranteed
    return h


def test_rate_in_time():
    """Order 1 to the solution of y' = kr(1/y − j), y = 1 + rh: −y/j − ln(1 − jy)/j² = krt + c."""

    def time_of(y: float) -> float:
        return (-y / J - math.log(1 - J * y) / J**2) / (K * R)

    low, high = 1.0, 1 / J
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if time_of(middle) - time_of(1.0) < 1 else (low, middle)
    errors = [abs(thickness(steps) - (low - 1) / R) for steps in (8, 16)]
    assert errors[1] < 0.02
    assert 0.9 < math.log2(errors[0] / errors[1]) < 1.1


def test_electropainting():
    """Film grows only, where q > j; its steady state is the shipped Signorini problem."""
    case, steady = load_case("electropainting_growth"), solve_case(load_case("electropainting"))
    before = 0.0
    for instant in evolve_case(case.with_values({"time.steps": 3, "time.end": 40}), domain=steady.spaces.domain):
        solution = instant.solution
        h, q = states(solution)["h"], -solution.flux_at
        assert solution.p_at.min() >= 0.0
        assert (h - before).min() >= 0.0
        assert q[h > 0].min() > 0.6 > q[h == 0].max(initial=0.0) - 1e-12
        before = h
    measure = steady.spaces.facet_measure
    for found, limit in ((solution.p_at, steady.p_at), (solution.flux_at, steady.flux_at)):
        assert measure @ (found - limit) ** 2 < 1e-4 * (measure @ limit**2)
    assert solution.contact.facets == pytest.approx(steady.contact.facets, abs=2)


def test_bound_of_a_step():
    """Where some of the metal is bare and some is not: the bound is above the distance to a finer solution."""
    now = {"h": "max(0, x - 1/2)", "tau": 1, "flux": -1}
    film = Film("bottom", r="1 + x", k=2, j=0.5).in_step(now)
    one, other = (
        solve(build_domain(COMM, "square", h, mesh="structured"), Diffusion(f="3*x", u_D="1 + x", conditions=[film]))
        for h in (0.36, 0.09)
    )
    assert set(one.segments_of_parts()["bottom"]["growing"].values()) != {0}
    certificate = certify(one)
    assert difference(one, other) < certificate.sigma_bound < 1.6 * difference(one, other)


def test_a_law_of_ones_own():
    """The membrane of the guide, by its steps in one dimension."""
    guide = (Path(__file__).parents[2] / "docs" / "guide" / "time.md").read_text(encoding="utf-8")
    (block,) = (text for text in re.findall(r"```python\n(.*?)```", guide, re.DOTALL) if "LawWithMemory" in text)
    names: dict[str, object] = {"domain": strip(), "__name__": "guide"}
    exec(compile(block, "time.md", "exec"), names)
    m = 0.0
    for _ in range(10):
        s = 3 / (1 + 0.5 * m)
        m += 0.1 * s / (1 + s)
    np.testing.assert_allclose(states(names["instant"].solution)["m"], m, rtol=1e-12)


def test_a_film_inside_the_domain():
    """Between two bodies of fluid u jumps by r h q."""
    slit = build_domain(COMM, "slit", 0.3, mesh="unstructured")
    problem = Diffusion(f="y", conditions=[Film("slit", r=2, k=5, j=0.01)])
    solutions = [instant.solution for instant in evolve(slit, problem, Evolution(1, 2))]
    for solution in solutions:
        np.testing.assert_allclose(solution.p_at, -2 * states(solution)["h"] * solution.flux_at, atol=1e-9)
    assert (states(solutions[1])["h"] > states(solutions[0])["h"]).all()


@pytest.mark.parallel([1, 3])
def test_ranks_restarts_and_files(tmp_path: Path):
    """The same on any number of ranks; a run that is ended and goes on ends the same; the last state is read again."""
    folder = Path(COMM.bcast(str(tmp_path)))
    case = load_case(FILM)
    run(case, folder / "whole", certify_steps=False)
    run_in_two(case, folder / "parts", 2)
    one, other = (load_solution(folder / name) for name in ("whole", "parts"))
    for solution in (one, other):
        sizes = solution.summary()["states"]
        assert sizes["law.0 h"]["mean"] == pytest.approx(0.26346202367429666, abs=1e-9)
        assert sizes["law.1 h"]["largest"] == pytest.approx(0.668961713911158, abs=1e-9)
    if COMM.rank == 0:
        first, second = ((folder / name / "facets.csv").read_text(encoding="utf-8") for name in ("whole", "parts"))
        rows = [[line.split(",")[-1] for line in text.splitlines()[1:]] for text in (first, second)]
        np.testing.assert_allclose(*[np.array(each, dtype=float) for each in rows], atol=1e-12)
    longer = case.with_values({"time.end": 2, "time.steps": 8})
    *_, last = evolve_case(longer, COMM)
    *_, again = evolve_case(case, COMM, start=one)  # which has the thickness of the last state
    for law, of in last.solution.summary()["states"].items():
        assert again.solution.summary()["states"][law] == pytest.approx(of, abs=1e-9)


def test_refusals():
    """What there is not is told in one sentence."""
    film, square = Film("bottom", r=1, k=1), build_domain(COMM, "square", 0.5, mesh="structured")

    def steps(law: Film, element: str | None = None, **about: str) -> None:
        problem = Diffusion(f=0, u_D=1, conditions=[law])
        next(evolve(square, problem, Evolution(1, 2, **about), Options(element=element)))

    for fails, message in (
        (lambda: solve(square, Diffusion(f=0, conditions=[film])), "has a memory"),
        (lambda: solve(square, Elasticity(young=1, poisson=0.3, conditions=[film])), "has a memory"),
        (lambda: steps(film, "RT1"), "no RT1 for laws with memory"),
        (lambda: steps(film, scheme="bdf2"), "implicit-euler"),
        (lambda: steps(Film("bottom", r="x - 1/2", k=1)), "r must be positive"),
        (lambda: steps(Film("bottom", r=1, k=1, h="-x")), "h must not be negative"),
        (lambda: validated(Case, {**read_toml(FILM), "time": None}, "film", "film"), "needs \\[time\\]"),
    ):
        with pytest.raises(InputError, match=message):
            fails()
    instant = next(evolve(square, Diffusion(f=0, u_D=1, conditions=[film]), Evolution(1, 2)))
    with pytest.raises(InputError, match="laws with memory"):
        instant.solution.linearised(1e-9)
