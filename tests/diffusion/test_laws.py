"""The laws on Γ_S: exact solutions, several laws at once, every method against another, what is refused."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_cases import EXACT, Spring, many, on_grid
from makers.scalar import examine
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.contact.laws import Corners, Dirichlet, Friction, Neumann, Regulator, Signorini, TwoSided, Wall
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.physics.diffusion.problem import Diffusion
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Solver, solve

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("name", EXACT)
def test_exact_solutions(name: str):
    """Order 1 in σ, u and p, a few steps, and values on Γ_S that are in the graph to rounding."""
    coarse, fine = (on_grid(name, n) for n in ((24, 48) if name == "staircase" else (12, 24)))
    before, after = (solution.errors() for solution in (coarse, fine))
    assert before is not None
    assert after is not None
    rates = {key: math.log2(before[key] / after[key]) for key in ("sigma_L2", "u_L2", "p_L2")}
    assert min(rates.values()) > 0.95, rates
    assert len(fine.outcome.history) <= 9
    assert max(vars(fine.kkt).values()) < 1e-11
    (segments,) = fine.segments_of_parts().values()
    assert min(segment["facets"] for segment in segments.values()) > 4
    assert sum(segment["measure"] for segment in segments.values()) == pytest.approx(1)


@pytest.mark.parametrize("name", EXACT)
def test_other_ways_to_the_same_solution(name: str):
    """Both backends and algorithms, an interior-point method, and SNESVI where the law is a bound."""
    expected = on_grid(name, 12)
    ways = [("alg1", "mixed", 1e-10), ("alg2", "hybrid", 1e-10), ("qp", "hybrid", 1e-8)]
    for algorithm, backend, tolerance in [*ways, ("vi", "hybrid", 1e-10)]:
        if algorithm == "vi" and name != "two_sided":
            with pytest.raises(InputError, match=r"vi does not take the law .* it takes signorini and two-sided"):
                on_grid(name, 12, solve__algorithm=algorithm)
            continue
        found = on_grid(name, 12, solve__algorithm=algorithm, solve__backend=backend)
        for key in ("sigma", "u", "p"):
            one, other = (getattr(solution, key).x.array for solution in (found, expected))
            size = np.abs(getattr(expected, "u" if key == "p" else key).x.array).max()
            np.testing.assert_allclose(one, other, rtol=0, atol=tolerance * size, err_msg=f"{algorithm} {key}")
        np.testing.assert_array_equal(found.segments().segment, expected.segments().segment)


@pytest.mark.parallel([1, 3])
def test_all_laws_at_once(folder: Path):
    """Without Γ_D, on ranks without facets of some laws; multigrid and a prediction change nothing; a file keeps it."""
    case = many()
    solution, other = solve_case(case, COMM), solve_case(case.with_values({"solve.algorithm": "alg2"}))
    assert max(vars(solution.kkt).values()) < 1e-10
    assert solution.norms() == pytest.approx(other.norms(), rel=1e-9)
    assert solution.segments_of_parts() == other.segments_of_parts()
    large = solve_case(case, COMM, tuning=Tuning(direct_up_to=0, predict_from=0, coarsen_from=0))
    assert large.norms() == pytest.approx(solution.norms(), rel=1e-8)
    write_solution(solution, folder, fields=False)
    read = load_solution(folder, COMM)
    assert read.norms() == pytest.approx(solution.norms(), rel=1e-12)
    assert read.segments_of_parts() == solution.segments_of_parts()
    again = solve_case(case, COMM, domain=read.spaces.domain, start=read)
    assert len(again.outcome.history) <= 2


@pytest.mark.parametrize("seed", range(4))
def test_random_problem(seed: int):
    result = examine(seed, several=True)
    assert (result.good and result.difference < 1e-6) or np.isnan(result.difference), result


def test_corners_that_coincide():
    """Twice the same corner, and a two-sided bound without room, which is a Dirichlet condition."""
    domain = build_domain(COMM, "square", 0.2, mesh="unstructured")
    f = "20*(x - 0.6)"
    corners = [(-0.05, 0.3), (-0.05, 0.3), (0, 0.1), (0, 0.1), (0, 0.1)]
    twice, once = (
        solve(domain, Diffusion(f, conditions=[Corners(["bottom"], some, "vertical", 2)]))
        for some in (corners, corners[1:3])
    )
    np.testing.assert_allclose(twice.sigma.x.array, once.sigma.x.array, atol=1e-12)
    assert max(vars(twice.kkt).values()) < 1e-11
    for algorithm in ("alg1", "alg2", "qp", "vi"):
        closed = Diffusion(f, u_D="0.1*x", conditions=[TwoSided(["bottom"], psi_upper="0.1*x", psi="0.1*x")])
        found = solve(domain, closed, Options(algorithm=algorithm))
        assert max(vars(found.kkt).values()) < 1e-8
        assert found.outcome.iterate.p == pytest.approx(0, abs=1e-10)


def test_laws_in_python():
    """Objects as data; a law of one's own is the graph with the same line; a Signorini law is the short form."""
    domain = build_domain(COMM, "square", 0.2, mesh="unstructured")
    f = "20*(x - 0.6)"
    spring = solve(domain, Diffusion(f, conditions=[Spring(["bottom"], stiffness=3.0)]))
    line = solve(domain, Diffusion(f, conditions=[Corners(["bottom"], [(0, 0), (1, -3)], 3, 3)]))
    np.testing.assert_allclose(spring.sigma.x.array, line.sigma.x.array, atol=1e-12)
    assert spring.spaces.normal_flux(spring.sigma) == pytest.approx(-3 * spring.outcome.iterate.p, abs=1e-12)
    short = solve(domain, Diffusion(f, conditions=[Signorini(["bottom", "left"], "0.01*x", 0.1)]))
    laws = [Signorini("bottom", "0.01*x", 0.1), TwoSided("left", psi_upper=1e3, psi="0.01*x", q_S=0.1)]
    long = solve(domain, Diffusion(f, conditions=laws))
    assert long.norms() == pytest.approx(short.norms(), rel=1e-12)
    assert [step.changed for step in long.outcome.history] == [step.changed for step in short.outcome.history]


def test_a_given_u_is_no_contact():
    """Where u is given there is nothing to decide: these facets do not count, though their law is one on Γ_S."""
    square = build_domain(COMM, "square", 0.2, mesh="structured")
    held = Signorini("bottom", psi=-0.05)
    alone = Diffusion(f="40*(x - 0.6)", conditions=[held])
    beside = replace(alone, conditions=[held, Dirichlet("left", 0), Dirichlet("top", "0.1*x*(1 - x)")])
    assert 0 < solve(square, alone).contact.facets < 7
    both = solve(square, beside)
    assert both.contact == tuple(both.segments_of_parts()["bottom"]["contact"].values())


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (
            {"kind": "friction", "g": "x - 1/2"},
            r"law.0 \(friction\): g must not be negative, as at \(0",
        ),
        ({"kind": "two-sided", "psi_upper": "-y - 1"}, "psi must not be above psi_upper, as at"),
        ({"kind": "wall", "beta": "-1"}, "beta must not be negative"),
        ({"kind": "regulator", "k": "0", "g_low": 0, "g_high": 1}, "k must be positive"),
        ({"kind": "regulator", "k": "1", "g_low": 2, "g_high": 1}, "g_low must not be above g_high"),
        ({"kind": "graph", "corners": [[0, 1], [-1, 0]]}, "u must not fall from corner 0 to 1"),
        ({"kind": "graph", "corners": [[0, 1], [1, 2]]}, "κ∇u·n must not grow from corner 0 to 1"),
        ({"kind": "graph", "corners": [[0, 1]], "before": -1}, "before must not be negative"),
        ({"kind": "graph", "corners": [0, 1]}, "law.0: corners: must be pairs"),
        ({"kind": "frction", "g": "1"}, r"law.0.kind: unknown law 'frction'; .* \(did you mean 'friction'\?\)"),
        (
            {"kind": "friction", "G": "1"},
            "law.0: unknown key 'G' of the law 'friction'; known are kind, parts, region, g",
        ),
        ({"kind": "wall"}, "law.0: missing key 'beta' of the law 'wall'"),
        ({"kind": "friction", "g": "1 +"}, "law.0.g: "),
        ({"kind": "friction", "g": True}, "g: must be an expression"),
        ({"kind": "friction", "g": "1", "parts": ["bottm"]}, "law.0.parts: unknown part 'bottm'"),
        ({"kind": "friction", "g": "1", "parts": ["left"]}, "'left' is listed twice: in signorini and in law.0.parts"),
        ({"kind": "friction", "g": "1", "parts": []}, "law.0: the law 'friction' needs parts, a list of parts"),
        ({"kind": "friction", "g": "1/(x - x)"}, "law.0.g: not finite everywhere on its parts"),
    ],
)
def test_what_is_refused(law: dict[str, object], message: str):
    """One sentence that says what, and where."""
    case = load_case("example1").with_values({"solve.h": 0.3, "boundary.signorini": ["left"]})
    with pytest.raises(InputError, match=message):
        solve_case(case.with_values({"law": [{"parts": ["bottom"]} | law]}))


HOLDING: list[tuple[list[Law], float, float, float]] = [
    ([Friction(["bottom"], g="2*x + 0.5")], 1.4, math.nan, 1.6),  # slips where g is small
    ([Friction(["bottom"], g=0.5), Friction(["top"], g=2)], 2.0, 0.5, 2.6),  # slips at the bottom, sticks at the top
    ([Wall(["bottom"], beta=2, level=1)], -3.0, -0.5, 0.1),
    ([Regulator(["bottom"], k=2, g_low=-1, g_high=3)], 0.8, 0.4, 1.1),
    ([TwoSided(["bottom"], psi=-1, psi_upper=2)], 1.0, 2.0, math.nan),
    ([Corners(["bottom"], corners=[[0, 1], [0, 0], [1, 0], [1, -1]])], 0.5, 1.0, 1.2),
]
"""Laws that alone hold u, a load f, u at the bottom if it is constant, and a load that is too large if any is."""


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(("laws", "f", "level", "excess"), HOLDING)
def test_laws_that_hold_a_body_alone(laws: list[Law], f: float, level: float, excess: float):
    """Without Γ_D and c the law fixes the constant where the load needs no larger flux than it allows."""
    domain = build_domain(COMM, "square", 0.25, mesh="structured")
    rest = [part for part in ("bottom", "left", "right", "top") if all(part not in law.parts for law in laws)]
    conditions = [*laws, Neumann(rest)]
    for options in (Options(), Options("alg2", backend="mixed"), Options(tuning=Tuning(direct_up_to=0))):
        solution = solve(domain, Diffusion(f=f, conditions=conditions), options)
        assert certify(solution).bound < 0.5
        p, spaces = solution.p.x.array, solution.spaces
        bottom = np.flatnonzero(spaces.part_of_facet == spaces.part_names.index("bottom"))
        if not math.isnan(level):
            assert p[bottom] == pytest.approx(level, abs=1e-9)
    if not math.isnan(excess):
        with pytest.raises(InputError, match="there is no solution"):
            solve(domain, Diffusion(f=excess, conditions=conditions))


def test_what_methods_refuse(folder: Path):
    """Penalties and classical methods are for Signorini's law; with nothing to hold u there is no solution."""
    for algorithm in ("alg3", "snes2", "uzawa", "mixed-uzawa1"):
        with pytest.raises(InputError, match=f"{algorithm} does not take the law 'friction' of law.0"):
            solve_case(load_case("friction").with_values({"solve.algorithm": algorithm, "solve.h": 0.3}))
    closed = {
        "boundary.signorini": [],
        "law": [{"parts": ["bottom", "left", "top", "right"], "kind": "friction", "g": 1}],
    }
    case = load_case("example1").with_values({"solve.h": 0.3} | closed)
    for f in (5, -5, 4):
        with pytest.raises(InputError, match="∫f \\+ ∫g_N plus the flux that the laws allow is between"):
            solve_case(case.with_values({"problem.f": f}))
    assert solve_case(case.with_values({"problem.f": "3 + sin(9*x)*cos(3*y)"})).converged
    with pytest.raises(InputError, match="no part of the boundary is left for u = u_D"):
        solve_case(case.with_values({"law": [], "boundary.neumann": ["bottom", "left", "top", "right"]}))
    water = {"law": [{"parts": ["bottom", "left", "top", "right"], "kind": "seepage", "level": "y"}], "problem.f": 0}
    with pytest.raises(InputError, match="part of the boundary to Γ_D, such as what is under water: a seepage face"):
        solve_case(case.with_values(water))
    with pytest.raises(InputError, match=r"law.0.g: the case has no \[\[law\]\]"):
        load_case("example1").with_values({"law.0.g": 1})
    with pytest.raises(InputError, match=r"law.1.g: there is no number 1"):
        case.with_values({"law.1.g": 2})


def test_names_of_segments():
    law = Corners("bottom", [(0, 1), (0, -1)], names=["low", "at 0", "high"])
    solution = solve(build_domain(COMM, "square", 0.5, mesh="structured"), Diffusion(f=1, conditions=[law]))
    (segments,) = solution.segments_of_parts().values()
    assert list(segments) == ["low", "at 0", "high"]
    for wrong in (["low", "high"], ["low", "low", "high"], "low"):
        with pytest.raises(InputError, match="names: must be 3 different names, one for each segment of the graph"):
            Corners(["bottom"], [(0, 1), (0, -1)], names=wrong)


@pytest.mark.parallel([1, 2])
def test_one_problem_after_another(folder: Path):
    """A `Solver` goes on with other loads and other data of the laws, by one factorisation on few facets."""
    case = many(**{"boundary.signorini": [], "law.0.g": "0.3"})
    domain = mesh_case(case, COMM)
    solver = Solver(domain, case.posed(domain.mesh.geometry.dim))
    for load, g in [(10, 0.3), (-4, 0.1), (7, 0.5), (3, 0.2)]:
        problem = case.with_values({"problem.f": f"{load}*sin(7*x)*cos(5*y)", "law.0.g": g}).posed(2)
        kept, fresh = (
            solver.solve(problem),
            solve(domain, replace(problem, boundary=case.posed(domain.mesh.geometry.dim).boundary)),
        )
        assert kept.norms() == pytest.approx(fresh.norms(), rel=1e-10)
        assert kept.segments_of_parts() == fresh.segments_of_parts()
    with pytest.raises(InputError, match="problem: has other parts in signorini"):
        solver.solve(replace(problem, laws=[Friction(["bottom"], 1)]))
    with pytest.raises(InputError, match=r"law.1.parts: 'left' is listed twice"):
        solver.solve(replace(problem, laws=[Friction(["left"], 1), Friction(["left"], 1)]))
