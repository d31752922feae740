"""A scalar u on bodies with meshes of their own: exact patch tests, any ranks, a matching mesh as a limit, refusals."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies_apart import joined, two
from commands import signorini
from mpi4py import MPI

from signorini_fenicsx.api import (
    Corners,
    Diffusion,
    Dirichlet,
    Friction,
    InputError,
    Neumann,
    Options,
    Pair,
    Reaction,
    Regulator,
    Signorini,
    Solution,
    Tied,
    TwoSided,
    VanGenuchten,
    Wall,
    load_case,
    load_solution,
    solve,
    solve_case,
)
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.quantities.kinds import Energy, Flux, Integral

JUMPS = [
    (Tied(), 0.0),
    (Signorini(()), 0.0),
    (Wall((), beta=4), -0.25),
    (Friction((), g=2), 0.0),
    (TwoSided((), psi_upper=0.3, psi=-0.1), -0.1),
    (Regulator((), k=5, g_low=-2, g_high=2), -0.2),
    (Corners((), corners=[(-0.5, 1.5), (0.5, -0.5)]), -0.25),
]
"""Laws, and the jump of u under which κ∇u·n = 1."""
SLABS = """
[geometry]
bodies = {up = {shape = "[0.2, 0.8] x [1, 1.5]", h = 0.3}, low = {shape = "[0.2, 0.8] x [0, 1]", h = 0.4}}
[boundary]
neumann = ["up.left", "up.right", "low.left", "low.right"]
[problem]
f = 0
kappa = {up = 1, low = 2}
u_D = {"up.top" = 1}
"""
PAIR = """[[pair]]
slave = "low.top"
master = "up.bottom"
kind = "graph"
corners = [[-1, 4], [1, -4]]
"""


def largest(solution: Solution, values: np.ndarray) -> float:
    """The largest |values| over all ranks."""
    return float(solution.spaces.mesh.comm.allreduce(float(np.abs(values).max(initial=0.0)), MPI.MAX))


def vertical(upper: tuple[int, ...], lower: tuple[int, ...], law: Any, jump: float, gap: float) -> Solution:
    """What flows down through two boxes, 1 everywhere."""
    last = len(upper) - 1
    sides = [f"{body}{axis}{end}" for body in "ul" for axis in range(last) for end in (0, 1)]
    held = [Dirichlet(f"u{last}1", jump - 1), Dirichlet(f"l{last}0", 1)]
    pair = Pair(f"u{last}0", f"l{last}1", law)
    return solve(two(MPI.COMM_SELF, upper, lower, gap=gap), Diffusion(f=0, conditions=[Neumann(sides), *held, pair]))


@pytest.mark.parametrize(
    ("law", "jump", "upper", "lower"),
    [*((*each, (3, 2), (2, 3)) for each in JUMPS), *((*each, (2, 2, 2), (3, 2, 2)) for each in JUMPS[:3:2])],
)
def test_a_uniform_flux(upper: tuple[int, ...], lower: tuple[int, ...], law: Any, jump: float) -> None:
    """A uniform flux passes from one body to the other, apart or not, under any law; RT1 is the element."""
    gap = 0.25 if isinstance(law, Wall | Tied) else 0.0
    solution = vertical(upper, lower, law, jump, gap)
    exact = np.zeros(len(upper))
    exact[-1] = -1.0
    assert solution.options.element == "RT1"
    assert largest(solution, solution.sigma_values - exact) < 1e-12
    height = solution.spaces.vertices[..., -1]
    above = height.min(axis=1) > gap - 1e-9
    off = solution.u_values - np.where(above[:, None], gap + jump - height, -height)
    assert largest(solution, off) < 1e-12


@pytest.mark.parametrize("direction", ["normal", [0.0, -1.0]])
def test_a_linear_u_on_a_slanted_interface(direction: Any) -> None:
    """A linear u is exact in perfect contact, whatever its direction is."""
    domain = two(MPI.COMM_SELF, (5, 3), (7, 2), shear=0.4)
    names = [
        f"{body}{part}" for body, parts in (("u", ("00", "01", "11")), ("l", ("00", "01", "10"))) for part in parts
    ]
    conditions = [Dirichlet(names, "3 + 2*x - y"), Pair("u10", "l11", Tied(), direction=direction, within=0.3)]
    solution = solve(domain, Diffusion(f=0, exact="3 + 2*x - y", conditions=conditions))
    assert max(solution.errors().values()) < 1e-11
    x = solution.spaces.vertices
    np.testing.assert_allclose(solution.u_values, 3 + 2 * x[..., 0] - x[..., 1], atol=1e-12)
    np.testing.assert_allclose(solution.sigma_values - [2.0, -1.0], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("law", "kappa", "tolerance"),
    [
        (Tied(), 1, 1e-12),
        (Wall((), beta=4), 1, 1e-12),
        (Friction((), g=0.3), 1, 1e-12),
        (Signorini((), psi="0.1*x"), 1, 1e-12),
        (Friction((), g=0.3), "1 + u^2", 1e-8),
        (Signorini((), psi="0.1*x"), VanGenuchten(1, 2, 2), 1e-8),
    ],
)
def test_a_matching_mesh_as_one_cut_inside(law: Any, kappa: Any, tolerance: float) -> None:
    """Where both surfaces have the same facets a pair is what a part inside is, to rounding or the change of κ."""
    given = [Dirichlet("l10", 0), Dirichlet("u11", "sin(3*x)")]
    cases = [(two(MPI.COMM_SELF, (4, 3), (4, 3)), Neumann([f"{body}0{end}" for body in "ul" for end in (0, 1)]))]
    cases.append((joined((4, 3)), Neumann(["x0", "x1"])))
    inner = TwoSided("u10", psi_upper=0) if isinstance(law, Tied) else type(law)("u10", **law.data())
    found = []
    for (domain, sides), meeting in zip(cases, (Pair("u10", "l11", law), inner), strict=True):
        problem = Diffusion(f="1 + x", kappa=kappa, c=0.5, conditions=[*given, sides, meeting])
        found.append(solve(domain, problem, Options(element="RT1")))
    assert {key: found[0].norms()[key] for key in ("sigma_L2", "u_L2", "div_sigma_L2")} == pytest.approx(
        {key: found[1].norms()[key] for key in ("sigma_L2", "u_L2", "div_sigma_L2")}, rel=tolerance
    )


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(
    ("upper", "lower", "law"),
    [
        ((6, 4), (9, 5), Tied()),
        ((6, 4), (9, 5), Friction((), g=0.3)),
        ((3, 2, 2), (4, 3, 2), Wall((), beta=4, level=2)),
    ],
)
def test_multigrid_as_a_factorisation(upper: tuple[int, ...], lower: tuple[int, ...], law: Any) -> None:
    """CG with multigrid finds what a factorisation does, apart and with a source, and what leaves one side arrives."""
    last, found = len(upper) - 1, []
    domain = two(MPI.COMM_WORLD, upper, lower, gap=0.05)
    sides = [f"{body}{axis}{end}" for body in "ul" for axis in range(last) for end in (0, 1)]
    given = [Neumann(sides, "x"), Dirichlet(f"l{last}0", 1), Dirichlet(f"u{last}1", "3*x")]
    problem = Diffusion(f=1, kappa=2, conditions=[*given, Pair(f"u{last}0", f"l{last}1", law)])
    for size in (10**9, 0):
        found.append(solve(domain, problem, Options(tuning=Tuning(direct_up_to=size))))
    assert found[0].outcome.linear_solver != found[1].outcome.linear_solver
    assert found[1].norms() == pytest.approx(found[0].norms(), rel=1e-9)
    flows = [sum_over(found[1], part) for part in (f"u{last}0", f"l{last}1")]
    assert flows[0] == pytest.approx(-flows[1], rel=1e-9, abs=1e-9)


def sum_over(solution: Solution, part: str) -> float:
    """∫ σ·n over a part (collective)."""
    facets = solution.spaces.part(part)
    means = solution.spaces.through(facets, solution.sigma_values).mean(axis=1)
    return float(solution.spaces.mesh.comm.allreduce(float(facets.measure @ means)))


def test_a_case_file(tmp_path: Path) -> None:
    """Three resistances in a row, by a case file; its solution is read, and its error bounded by rounding."""
    (tmp_path / "slabs.toml").write_text(SLABS + PAIR)
    ended = signorini(tmp_path, "solve", "slabs.toml", "--output", "out")
    assert ended.returncode == 0
    read = load_solution(tmp_path / "out")
    assert read.certify().bound < 1e-8
    np.testing.assert_allclose(read.sigma_values - [0.0, 1 / (0.5 + 0.25 + 0.5)], 0.0, atol=1e-12)
    ended = signorini(tmp_path, "check", "slabs.toml")
    assert "low.top: slave of up.bottom, graph" in ended.stdout
    assert "pieces; distance 0 to 0" in ended.stdout


def test_a_heat_sink() -> None:
    """All heat of the chip goes through the joint and into the air; the chip is nearly as hot as by a sum by hand."""
    solution = solve_case(load_case("heat_sink"))
    chip = solution.spaces.domain.regions["chip"]
    measure = solution.spaces.cell_measures[chip]
    heat = [sum_over(solution, part) for part in ("chip.top", "sink.base", "sink.air")]
    np.testing.assert_allclose(heat, [-1, 1, -1], rtol=1e-9)
    assert 100.2 < measure @ solution.u_values[chip].mean(axis=1) / measure.sum() < 1.03 * 100.2


STORED = '[[law]]\nkind = "storage"\nregion = "up"\ncorners = [[0, 0]]\nbefore = 1\nbeyond = 1\n'


@pytest.mark.parametrize(
    ("pair", "words"),
    [
        (PAIR + "gap = 1\n", "unknown key 'gap'"),
        (PAIR.replace("graph", "contact"), "unknown kind of a pair 'contact'"),
        (PAIR.replace("graph", "river"), "unknown kind of a pair 'river'"),
        (PAIR.replace("up.bottom", "up.tip"), "unknown part 'up.tip'"),
        (PAIR.replace("up.bottom", "up.left"), "is listed twice"),
        (PAIR.replace("[[-1, 4], [1, -4]]", '[["log(x - 1)", 0]]'), "pair.0.corners.0.0: not finite everywhere"),
        (PAIR + "direction = [0, -1]\n", "no facet of the slave is covered"),
        (PAIR + "[solve]\nelement = 'RT0'\n", "pairs of surfaces take RT1"),
        (PAIR + "[solve]\nbackend = 'mixed'\n", "pairs take the hybrid"),
        (PAIR + STORED + "[time]\nend = 1\nsteps = 1\n", "no RT1 for storage; pairs of surfaces take no other"),
        (PAIR + "[solve]\nalgorithm = 'amf'\n", "alg1"),
    ],
)
def test_wrong_pairs_are_refused(tmp_path: Path, pair: str, words: str) -> None:
    """Wrong pairs are refused in a sentence."""
    (tmp_path / "wrong.toml").write_text(SLABS + pair)
    ended = signorini(tmp_path, "check", "wrong.toml")
    assert ended.returncode == 2
    assert words in ended.stdout + ended.stderr


def test_what_pairs_have_not() -> None:
    """No energy, no integrals over parts of pairs, no flux where they are tied, no law that is none of jumps."""
    domain = two(MPI.COMM_SELF, (3, 2), (2, 3))
    free = Neumann([f"{body}0{end}" for body in "ul" for end in (0, 1)])
    problem = Diffusion(f=1, conditions=[free, Pair("u10", "l11", Tied())])
    solution = solve(domain, problem)
    for kind, words in (
        (Energy(), "paired"),
        (Integral(parts="u10"), "'u10' of a pair is tied"),
        (Flux("u10"), "'u10' of a pair is tied"),
        (Flux("l11"), "master of a pair"),
    ):
        with pytest.raises(InputError, match=words):
            solution.quantity(kind)
    for law in (None, Dirichlet(()), "tied"):
        with pytest.raises(InputError, match="law must be"):
            Diffusion(f=1, conditions=[Pair("u10", "l11", law)])
    with pytest.raises(InputError, match=r"pair.0 .reaction.: this law is one of regions"):
        solve(domain, Diffusion(f=1, conditions=[free, Pair("u10", "l11", Reaction((), c=1))]))
    with pytest.raises(InputError, match="gap is of bodies"):
        Diffusion(f=1, conditions=[Pair("u10", "l11", Tied(), gap=0.1)])


@pytest.mark.parametrize("held", [["l10"], ["u11"]])
def test_a_body_that_only_a_pair_holds(held: list[str]) -> None:
    """Bodies in perfect contact are one for the question whether a solution is unique; laws carry what they can."""
    domain = two(MPI.COMM_SELF, (3, 2), (2, 3))
    others = [part for part in ("l10", "u11") if part not in held]
    free = Neumann([f"{body}0{end}" for body in "ul" for end in (0, 1)] + others)
    for law in (Tied(), Friction((), g=2), Wall((), beta=1)):
        problem = Diffusion(f=1, conditions=[free, Dirichlet(held, 0), Pair("u10", "l11", law)])
        if isinstance(law, Wall) and held == ["l10"]:
            with pytest.raises(InputError, match="no solution"):
                solve(domain, problem)
        else:
            flow = sum_over(solve(domain, problem), held[0])
            assert flow == pytest.approx(-2.0, rel=1e-9)
