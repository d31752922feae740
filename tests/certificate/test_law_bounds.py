"""The certificate under every law: above the error and near it, for penalties' own solutions too, and its parts."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import signorini
from made_cases import EXACT, on_grid, refined
from makers.bounds import difference
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Neumann
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.certificate.laws import with_mean
from signorini_fenicsx.certificate.proof import proof_of
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.contact.laws import Corners, Friction, Regulator, River, Signorini, TwoSided, Wall
from signorini_fenicsx.meshes.domain import Boundary, Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.bound import relaxation
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD


def coarse_and_fine(h: float, shape: str = "square", times: int = 2) -> list[Domain]:
    """A structured mesh, and the one that so many refinements make of it."""
    coarse = build_domain(COMM, shape, h, mesh="structured")
    return [coarse, refined(coarse, times)]


@pytest.mark.parametrize("name", EXACT)
def test_exact_solutions(name: str):
    """On resolved data the bound is at most some per cent above the error."""
    solution = on_grid(name, 32 if name == "staircase" else 16)
    errors, certificate = solution.errors(), certify(solution)
    assert errors is not None
    assert errors["sigma_L2"] < certificate.sigma_bound < 1.05 * errors["sigma_L2"]
    assert errors["sigma_L2"] < certificate.bound < 1.3 * errors["sigma_L2"]
    assert certificate.by_quadrature == ()
    assert certificate.guaranteed


@pytest.mark.parametrize("algorithm", ["alg3", "alg4"])
def test_penalties_have_solutions_of_their_own(algorithm: str):
    """With u exact for the penalty problem, from ε so large that it is another problem to a tiny one."""
    s, plus, minus = "(x - 0.413)", "max(x - 0.413, 0)", "max(0.413 - x, 0)"
    for eps in (10.0, 0.1, 1e-6):
        if algorithm == "alg3":
            u, f = f"{s}^3 - y*{1 / eps}*{minus}^3", f"-6*{s} + 6*y*{1 / eps}*{minus}"
        else:
            u, f = f"{plus}^3 - y*({minus}^3 - {eps}*{plus}^3)", f"-6*{plus} + 6*y*({minus} - {eps}*{plus})"
        given = {"solve__algorithm": algorithm, "solve__eps": eps}
        solution = on_grid("transition", 16, problem__f=f, problem__u_D=u, exact__u=u, **given)
        errors, certificate = solution.errors(), certify(solution)
        assert errors is not None
        assert certificate.of == "the exact solution of the penalty problem"
        assert errors["sigma_L2"] < certificate.sigma_bound < 1.02 * errors["sigma_L2"], eps
        assert not certify(solution, for_signorini=True).of


@pytest.mark.parametrize("algorithm", ["alg3", "alg4"])
def test_tiny_penalties(algorithm: str):
    """Nearly rigid, with ψ and q_S that vary and without Γ_D: the bound is that for the Signorini problem.

    Nearly flat as well: for a kink of q_S in an open facet two quadratures of its mean differed (alg4: was 32 times).
    """
    case = load_case("example1").with_values({"solve.h": 0.2, "solve.algorithm": algorithm, "problem.f": "3*x - 2"})
    parts = {"boundary.signorini": ["bottom"], "boundary.neumann": ["left", "right", "top"]}
    values = parts | {"problem.psi": "0.1*sin(20*x)", "problem.q_S": "-max(x - 0.2, 0)*exp(x^3)", "solve.eps": 1e-11}
    solution = solve_case(case.with_values(values))
    assert certify(solution).bound < 1.02 * certify(solution, for_signorini=True).bound


PSI = {"psi": "-0.05*cos(y)", "psi_upper": "0.05 + 0.02*cos(9*y)", "q_S": "0.5*sin(6*y)"}
CORNERS = [["-0.1*y", "0.4 + y"], ["-0.1*y", 0.1], ["0.1 + y/9", "0.1*cos(y)"], ["0.3 + y", "-y"]]
LAWS: list[tuple[Law, ...]] = [
    (Friction(["bottom"], "0.4 + 0.3*sin(9*x)"), Signorini(["left"], psi="0.1*sin(5*y) - 0.1", q_S="cos(7*y)")),
    (TwoSided(["right"], **PSI), Friction(["top"], "x")),
    (Wall(["bottom"], beta="exp(6*x)", level="0.2*sin(2*pi*x)"), Wall(["left"], beta=0.1, level="y")),
    (Regulator(["top"], k="1 + 50*x", g_low="-0.3 - 0.1*x", g_high="0.2*(1 + sin(5*x))", a="0.1*cos(7*x)"),),
    (Corners(["right"], CORNERS, 2, "vertical"),),
]


@pytest.mark.parametrize("laws", LAWS)
def test_data_that_vary(laws: tuple[Law, ...]):
    """Against a mesh with cells of a quarter of the size, where data vary within facets and u_D is not quadratic."""
    problem = Diffusion("20*sin(3*x + 4*y)", kappa="2 + sin(3*x)*cos(2*y)", u_D="0.1*sin(8*x*y)*x*y", conditions=laws)
    one, other = (solve(domain, problem) for domain in coarse_and_fine(0.14))
    certificate, distance = certify(one), difference(one, other)
    assert distance < certificate.sigma_bound < 1.2 * distance
    assert certificate.by_quadrature != ()
    assert not certificate.guaranteed


STEEP = [
    River(["bottom"], 1e6, 0.5, 0.2),  # was 515
    River(["bottom"], "1e9*(1 + x)", "0.5 + 0.3*sin(7*x)", "0.2 + 0.2*sin(5*x)"),  # was 16000
    Regulator(["bottom"], 1e6, -3e9, 3e9, "0.1*sin(9*x)"),  # was 5e6
    Corners(["bottom"], [[-0.1, 2e5], ["0.1 + 0.1*sin(7*x)", 0]], 0, "vertical"),
    Corners(["bottom"], [["-0.1", 2e4], ["0.1 + 0.1*sin(7*x)", 0]], 0, "vertical"),  # was 5.3
    Corners(["bottom"], [[-1.0, 2e8], [0.1, 1.0], [0.1, -1.0], [1.0, -3e3]], 5.0, 1e9),
]


@pytest.mark.parametrize("law", STEEP, ids=["river", "sine", "regulator", "vertical", "stiff", "mixed"])
def test_long_steep_segments(law: Law):
    """The function v is where y·n is on a steep segment, however long this is, and not at one of its ends."""
    one, other = (
        solve(each, Diffusion("20*sin(3*x + 4*y)", conditions=[Neumann(["left", "right"], 0), law]))
        for each in coarse_and_fine(0.25)
    )
    assert difference(one, other) < certify(one).sigma_bound < 1.12 * difference(one, other)


LOAD, WALLS = "20*sin(3*x + 4*y)", ["left", "right", "bottom", "top"]
STEEP_INSIDE: dict[str, tuple[float, str, str, list[str], list[tuple[Any, Any]], dict[str, Any]]] = {
    "long": (1.55, LOAD, "1", [], [(0, 0), (1, 1e9)], {}),  # was 54
    "both sides": (1.95, LOAD, "1", [], [(0, -1), (0.1, 1)], {"before": 1e9, "beyond": 1e9}),  # a flux not balanced
    "two on one line": (2.1, LOAD, "1", [], [(0, -2), (0, 0)], {"before": 100, "beyond": "vertical"}),  # 16
    "gentle before": (1.6, LOAD, "1e-3", [], [(-0.6, -0.01), (0.01, 0)], {"beyond": 1e6}),  # 28
    "level": (1.2, "1 + x", "1e-2", WALLS, [(f"0.1*sin(7*x) + {u}", 1e8 * u) for u in (0, 1)], {"before": 1}),  # 214
}


@pytest.mark.parametrize("name", STEEP_INSIDE)
def test_steep_segments_inside(name: str):
    """Laws in Ω likewise: v is pulled to where s is on a sloped segment, held there by a rigid one, and off others."""
    most, f, kappa, walls, corners, ends = STEEP_INSIDE[name]
    problem = Problem(
        f, kappa, laws=[Corners(corners=corners, region="all", **ends)], boundary=Boundary([], neumann=walls)
    )
    one, other = (solve(each, problem) for each in coarse_and_fine(0.25))
    assert difference(one, other) < certify(one).bound < most * difference(one, other)


@pytest.mark.parametrize(
    ("law", "backend"),
    [
        (Corners(["bottom"], [(0, 1e12), (1, 0)]), "hybrid"),
        (Corners(["bottom"], [("0.1*x", 1e12), ("0.1*x + 1", -2e12)], "vertical"), "mixed"),
        (River(["bottom"], 1e12, "0.3 + 0.1*x", -0.5), "hybrid"),
    ],
    ids=["end", "between", "river"],
)
def test_corners_far_from_what_flows(law: Law, backend: str):
    """Fluxes are measured from where nothing flows: from a corner with 1e12 twelve digits would be lost."""
    domain = build_domain(COMM, "square", 0.25, mesh="structured")
    solution = solve(domain, Diffusion(LOAD, conditions=[Neumann(["left", "right"], 0), law]), Options(backend=backend))
    assert max(vars(solution.kkt).values()) < 1e-12


def test_signorini_by_either_way():
    """As a law, also with a far upper bound, it is certified like the short form but for how v is kept above ψ."""
    domain, f = build_domain(COMM, "square", 0.1, mesh="unstructured"), "20*(x - 0.6)"
    for psi, q_S in [(0.0, 0.0), ("0.05*sin(9*x) - 0.05", "sin(5*x)")]:
        short = certify(solve(domain, Diffusion(f, conditions=[Signorini("bottom", psi, q_S)])))
        for law in (Signorini(["bottom"], psi, q_S), TwoSided(["bottom"], 100, psi, q_S)):
            long = certify(solve(domain, Diffusion(f, conditions=[law])))
            assert long.sigma_bound == pytest.approx(short.sigma_bound, rel=0.02)
            assert long.oscillation == pytest.approx(short.oscillation, rel=0.02)


def test_three_dimensions():
    laws = [Friction(["bottom"], "0.3 + x*y"), TwoSided(["left"], psi_upper=0.05, psi=-0.05), Wall(["top"], 3, "0.2*x")]
    one, other = (solve(each, Diffusion("20*(x - 0.5)", conditions=laws)) for each in coarse_and_fine(0.5, "cube", 1))
    distance = difference(one, other)
    assert distance < certify(one).sigma_bound < 2 * distance


@pytest.mark.parametrize("name", ["regulator", "staircase"])
def test_few_rounds(name: str, monkeypatch: pytest.MonkeyPatch):
    """The function v is found in few steps of CG, although the gap is known up to a constant, and v at its bounds."""
    steps = []
    lowered = relaxation._Gap.lowered

    def counted(self: object, residual: object, free: object, number: int) -> object:
        steps.append(number)
        return lowered(self, residual, free, number)  # type: ignore[arg-type]

    monkeypatch.setattr(relaxation._Gap, "lowered", counted)
    certify(solve_case(load_case(name), MPI.COMM_SELF))
    assert 0 < sum(steps) <= 40


def test_bounds_that_contradict():
    """Where u_D is beyond a bound, or two laws leave no room, no function of finite energy exists."""
    domain = build_domain(COMM, "square", 0.25, mesh="structured")
    for laws, u_D, reason in [
        ([TwoSided(["bottom"], 0.1)], 1, "u_D is beyond a bound of u where Γ_D meets Γ_S"),
        ([Signorini(["bottom"], 0.2), TwoSided(["left"], 0.1)], 0, "the bounds of u leave no room where parts of Γ_S"),
    ]:
        certificate = certify(solve(domain, Diffusion(1, u_D=u_D, conditions=laws)))
        assert certificate.bound == math.inf
        assert certificate.if_none.startswith(reason)


def test_friction_of_nothing():
    """With g = 0 both slips are one line; v goes by the sign of u, and the bound is that of an open part."""
    domain, f = build_domain(COMM, "square", 0.2, mesh="unstructured"), "20*(x - 0.3)"
    slipping = solve(domain, Diffusion(f, conditions=[Friction(["bottom"], 0)]))
    free = solve(domain, Diffusion(f, conditions=[Signorini("bottom", -100)]))
    assert certify(slipping).bound == pytest.approx(certify(free).bound, rel=0.02)


def test_rounding_is_no_contradiction():
    """Where u = ψ everywhere, what u_D is below ψ by rounding is nothing."""
    domain = build_domain(COMM, "square", 0.25, mesh="structured")
    problem = Diffusion(0, u_D="0.1 + 0.3*x + 0.7*y", conditions=[Signorini("top", "0.7*y + 0.3*x + 0.1")])
    assert certify(solve(domain, problem)).bound < 1e-7


def test_mean_of_a_limited_function():
    """The mean is as given and the limits hold, with one, both or neither of them infinite."""
    rng = np.random.default_rng(1)
    weights, base, low = rng.random(7), rng.normal(size=(200, 7)), rng.normal(size=(200, 7))
    weights /= weights.sum()
    for down, up in [
        (low, low + rng.random((200, 7))),
        (low, np.full_like(low, np.inf)),
        (-np.inf * low**2, np.inf * low**2),
    ]:
        least = np.where(np.isfinite(down), down, -3.0) @ weights
        most = np.where(np.isfinite(up), up, 5.0) @ weights
        mean = least + (most - least) * rng.random(200)
        found = with_mean(base, down, up, mean, weights)
        np.testing.assert_allclose(found @ weights, mean, atol=1e-12)
        assert np.all((found >= down) & (found <= up))


def test_what_is_not_proved(folder: Path):
    """The proof is for Signorini's law; the command says so before it solves."""
    for case, reason in (("friction", "without [[law]]"), ("sphere", "without an obstacle")):
        ended = signorini(folder, "solve", case, "--h", "1/4", "--rigorous")
        assert ended.returncode == 2
        assert reason in ended.stderr
    solution = on_grid("wall", 4)
    assert "Signorini alone" in proof_of(solution, certify(solution).v).reason


def test_penalty_bounds_of_the_command_line(folder: Path):
    """The line and the summary say which problem the bound is for."""
    base = ["solve", "example1", "--h", "1/4", "--algorithm", "alg3", "--eps", "1e-2", "--output", "out"]
    assert "to the exact solution of the penalty problem" in signorini(folder, *base).stdout
    assert '"of_penalty": true' in (folder / "out" / "summary.json").read_text(encoding="utf-8")
    assert "penalty problem" not in signorini(folder, *base, "--for-signorini").stdout
