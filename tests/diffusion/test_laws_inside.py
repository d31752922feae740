"""Laws in Ω: exact solutions with rates and bounds, an independent programme, finer meshes, files, refusals."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from made_cases import refined
from makers.bounds import difference
from makers.scalar import AGREE_OF_LAWS, NOT_UNIQUE, examine, halved
from mpi4py import MPI

from signorini_fenicsx import (
    Corners,
    Diffusion,
    Evolution,
    InputError,
    Neumann,
    Obstacle,
    Options,
    Reaction,
    River,
    Seepage,
    Signorini,
    Storage,
    TwoSided,
    evolve,
    solve,
)
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.certificate.laws import gap
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.law import Given, Graph, Law
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.bound import inside
from signorini_fenicsx.physics.diffusion.bound.inside import nearest_to_graph
from signorini_fenicsx.physics.diffusion.solution import Solution

COMM = MPI.COMM_WORLD
EXACT = {"two_obstacles": 1.2, "saturation": 1.1, "dead_core": 1.45, "phases": 1.5}


def square(h: float, comm: MPI.Comm = COMM) -> Domain:
    return build_domain(comm, "square", h, mesh="structured")


def on_square(h: float = 0.2, options: Options | None = None, **data: object) -> Solution:
    solution: Solution = solve(square(h), Diffusion(**data), options)  # type: ignore[arg-type]
    return solution


def chain(rng: np.random.Generator, corners: int) -> Chains:
    """A chain with vertical, flat and sloped segments."""
    p = np.sort(rng.integers(-2, 3, (1, corners)), axis=1).astype(float)
    flux = -np.sort(rng.integers(-3, 4, (1, corners)), axis=1).astype(float)
    before, beyond = (rng.choice([0.0, 1.5, np.inf], 1) for _ in range(2))
    return Chains.through(p, flux, before, beyond)


def test_chains_add():
    """A sum is on the graph where p is what both allow, and the flux is a sum of theirs."""
    rng = np.random.default_rng(0)
    for _ in range(100):
        one, other = chain(rng, rng.integers(1, 4)), chain(rng, rng.integers(1, 4))
        ends = zip(one.extent()[:2], other.extent()[:2], (np.maximum, np.minimum), strict=True)
        low, high = (pick(a, b) for a, b, pick in ends)
        if low > high:
            with pytest.raises(ValueError, match="no p is allowed by both"):
                one.plus(other)
            continue
        total = one.plus(other)
        assert (np.diff(total.p) >= 0).all()
        assert (np.diff(total.flux) <= 0).all()
        for p in np.clip(rng.uniform(-3, 3, (5, 1)), low, high):
            parts = [each.ends_at(p) for each in (one, other)]
            assert not low < p < high or np.allclose(total.ends_at(p), np.sum(parts, axis=0))
        assert np.array_equal(np.array(total.extent()[:2]).ravel(), np.array([low, high]).ravel())


def test_nearest_to_graph():
    """No other η with the same mean, in the range of the graph, makes the sum smaller."""
    rng, points = np.random.default_rng(1), 5
    weights = rng.uniform(0.5, 1, points)
    for _ in range(60):
        law = chain(rng, rng.integers(1, 4))
        low_p, high_p, low, high = (end[0] for end in law.extent())
        v = np.clip(rng.uniform(-3, 3, (1, points)), low_p, high_p)
        s = -np.clip(rng.uniform(-4, 4, 1), low, high)
        omega, target = rng.uniform(0.1, 2, 1), s[:, None] + rng.normal(0, 0.5, (1, points))
        laws = law[np.zeros(points, dtype=int)]
        eta = nearest_to_graph(laws, v, s, target, omega, weights)
        assert weights @ eta[0] == pytest.approx(weights.sum() * s[0], abs=1e-9)

        def total(values: np.ndarray, v: np.ndarray = v, t: np.ndarray = target, omega: np.ndarray = omega) -> float:
            of_law = gap(laws, v[0], -values)  # noqa: B023
            return float(weights @ (of_law + omega / 2 * (values - t[0]) ** 2))

        best = total(eta[0])
        for _ in range(20):
            change = rng.normal(0, 0.3, points)
            change -= weights @ change / weights.sum()
            if ((low <= -(eta[0] + change)) & (-(eta[0] + change) <= high)).all():
                assert total(eta[0] + change) >= best - 1e-9


@pytest.mark.parametrize("name", EXACT)
def test_exact_solutions(name: str):
    """Order 1, and a bound above the error and near it that nears it on finer meshes."""
    ratios, errors = [], []
    for h in (1 / 8, 1 / 16):
        solution = solve_case(load_case(name).with_values({"solve.h": h}))
        error, certificate = solution.errors(), certify(solution)
        assert error is not None
        assert error["energy"] < certificate.sigma_bound <= certificate.bound
        assert certificate.guaranteed
        ratios.append(certificate.bound / error["energy"])
        errors.append(error["energy"])
    assert math.log2(errors[0] / errors[1]) > 0.9
    assert ratios[1] < min(ratios[0], EXACT[name])


def test_quadrature_of_kinks(monkeypatch: pytest.MonkeyPatch):
    """Where v passes a corner of a graph the quadrature is not exact: a finer one changes the bound very little."""
    solution = solve_case(load_case("saturation").with_values({"solve.h": 1 / 8}))
    bound = certify(solution).bound
    monkeypatch.setattr(inside, "SQUARE", 29)
    assert certify(solution).bound == pytest.approx(bound, rel=1e-3)


def test_short_forms():
    """The keys obstacle and c, and a reaction as a graph with one line, are the same laws."""
    short, long = (
        on_square(f=-8, **data) for data in ({"obstacle": -0.1}, {"conditions": [Obstacle(region="all", psi=-0.1)]})
    )
    np.testing.assert_array_equal(short.u.x.array, long.u.x.array)
    assert short.summary()["obstacle"] == long.summary()["obstacle"]
    assert short.certify().numbers() == long.certify().numbers()
    upside = on_square(f=8, conditions=[Obstacle(region="all", psi_upper=0.1)])
    np.testing.assert_allclose(upside.u.x.array, -short.u.x.array, atol=1e-14)
    assert upside.certify().bound == pytest.approx(short.certify().bound, rel=1e-10)
    key, law = on_square(f=8, c="3 + x"), on_square(f=8, c=1, conditions=[Reaction(region="all", c="2 + x")])
    np.testing.assert_allclose(law.u.x.array, key.u.x.array, atol=1e-13)
    assert law.certify().bound == pytest.approx(key.certify().bound, rel=1e-10)
    line = on_square(f=8, conditions=[Corners([[0, 0]], 3, 3, region="all")])
    np.testing.assert_allclose(line.u.x.array, on_square(f=8, c=3).u.x.array, atol=1e-13)
    assert line.certify().bound == pytest.approx(on_square(f=8, c=3).certify().bound, rel=0.01)


@pytest.mark.parametrize("seed", [3, 7, 22])
def test_random_laws(seed: int):
    """Random laws in Ω and on Γ_S, some of them in one half, against a quadratic programme."""
    result = examine(seed, several=True, inside=True)
    assert "sets repeat" in result.ending
    assert result.kkt < KKT
    assert result.difference < AGREE_OF_LAWS


def test_random_laws_that_contradict_each_other():
    """The program refuses them, and no random run ends by that."""
    assert examine(2, several=True, inside=True).ending == NOT_UNIQUE


LAWS: list[list[Law]] = [
    [Corners([["-0.1*y", "-4 - x"], ["-0.1*y", 1], ["0.1 + y/9", "4 + y"]], 2, region="all")],
    [Obstacle(region="west", psi="-0.06 - 0.02*x*y", psi_upper="0.1 + 0.05*y^2"), Reaction(region="east", c="9*x")],
    [Obstacle(region="all", psi="-0.1 - 0.02*sin(5*x)"), Corners([[0, -3], [0, 3]], region=["east"])],
    [Corners([[0, 0], [0.05, 8]], "vertical", 30, region="west"), TwoSided("left", 0.05, -0.05)],
]


@pytest.mark.parametrize("number", range(len(LAWS)))
def test_bounds_against_finer_meshes(number: int):
    """Data that vary, in parts of Ω, and laws on Γ_S beside: the bound is above the distance to a finer solution."""
    coarse = halved(square(0.2))
    u_D = 0 if number == 3 else "0.1*sin(8*x*y)*x*y"
    problem = Diffusion(f="30*sin(3*x + 4*y)", kappa="2 + sin(3*x)*cos(2*y)", u_D=u_D, conditions=LAWS[number])
    one, other = (solve(domain, problem) for domain in (coarse, refined(coarse, 2)))
    distance = difference(one, other)
    assert distance < certify(one).sigma_bound < 1.5 * distance


def test_in_space():
    """Two obstacles and a jump in a cube: the programme agrees, and the bound is above the distance to a finer mesh."""
    domain = build_domain(COMM, "cube", 0.5, mesh="structured")
    laws = [Obstacle(region="all", psi=-0.05, psi_upper="0.1 + 0.1*z"), Corners([[0.02, -2], [0.02, 2]], region="all")]
    problem = Diffusion(f="30*(x - 0.5)", conditions=[*laws, Signorini("bottom", psi=-0.02)])
    one, other = (solve(each, problem) for each in (domain, refined(domain, 1)))
    programme = solve(domain, problem, Options(algorithm="qp"))
    np.testing.assert_allclose(programme.sigma.x.array, one.sigma.x.array, atol=1e-7)
    distance = difference(one, other)
    assert distance < certify(one).sigma_bound < 2 * distance
    linear = solve(domain, problem, Options(element="RT1"))
    assert difference(linear, other) - certify(other).sigma_bound < certify(linear).sigma_bound < distance


@pytest.mark.parametrize(("algorithm", "backend"), [("alg1", "hybrid"), ("alg2", "mixed")])
def test_no_dirichlet(algorithm: str, backend: str):
    """Laws in Ω alone hold u where the load is in the range of s, also with laws on Γ_S; otherwise it is refused."""
    everywhere = Neumann(["left", "right", "bottom", "top"], "0.5*x")
    laws = [Corners([["-0.1 + 0.1*x", -5], [0.1, 0], [1.2, 3]], region="all"), everywhere]
    options = Options(algorithm=algorithm, backend=backend)
    solution = on_square(options=options, f="2*sin(6*y)", conditions=laws)
    total = solution.spaces.mesh.comm.allreduce(solution.force().x.array @ solution.spaces.cell_measures)
    load = 2 * (1 - math.cos(6)) / 6 + 0.25 + 0.25 + 0.5
    assert total == pytest.approx(-load, rel=1e-3)
    assert np.isfinite(solution.certify().bound)
    with pytest.raises(InputError, match="there is no solution"):
        on_square(options=options, f=9, conditions=laws)


@dataclass(frozen=True)
class Power(Law):
    """A sink that grows in steps."""

    rate: Given = 1.0
    segments = ("none", "slow", "fast")

    def graph(self, values):
        """The first corner is the reference."""
        rate = values["rate"]
        return Graph((0.0, 0.0), [(0.0, 0.0), (0.1, rate)], 0.0, 3 * rate)


def test_own_law():
    """A law of one's own in a region is that of its corners."""
    domain, load = square(0.1), "20*sin(5*x)"
    own, known = (
        solve(domain, Diffusion(f=load, conditions=[law]))
        for law in (Power(region="all", rate="4 + x"), Corners([[0, 0], [0.1, "4 + x"]], 0, "12 + 3*x", region="all"))
    )
    np.testing.assert_allclose(own.u.x.array, known.u.x.array, atol=1e-14)
    assert own.certify().bound == pytest.approx(known.certify().bound, rel=1e-12)
    assert set(own.summary()["regions"]["law.0"]) == {"none", "slow", "fast"}


def test_laws_of_hydrologists():
    """Seepage is an upper bound with the rain as inflow; a river leaks in proportion to the head, cut at its bed."""
    sides = Neumann(["left", "right"])
    for rain, level, held in ((3.0, 0.5, True), (0.2, 0.5, False), (-1.0, 0.1, False)):
        wet = on_square(f=0, conditions=[sides, Seepage("top", rain=rain, level=level)])
        p, flux = (float(values[0]) for values in (wet.p.x.array, wet.spaces.normal_flux(wet.sigma)))
        assert (p, flux) == pytest.approx((level, level) if held else (rain, rain), abs=1e-12)
    for head, flux in ((0.8, 2 * (1 - 0.8) / (1 + 2)), (-3.0, 2 * (1 - 0.5))):
        solution = on_square(f=0, u_D=head, conditions=[sides, River("top", r=2, level=1, bed=0.5)])
        found = float(solution.spaces.normal_flux(solution.sigma)[0])
        assert found == pytest.approx(flux, abs=1e-12)


WRONG = [
    ('region = "all"\nparts = ["left"]\nkind = "graph"\ncorners = [[0, 0]]', "needs parts, a list of parts"),
    ('kind = "graph"\ncorners = [[0, 0]]', "needs parts, a list of parts"),
    ('region = "all"\nkind = "friction"\ng = 1', "law.0: the law 'friction' has parts; the laws with regions are"),
    ('parts = ["left"]\nkind = "obstacle"\npsi = 1', "the law 'obstacle' has region; the laws with parts are"),
    ('region = "all"\nkind = "obstacle"', "obstacle: needs psi, psi_upper or both"),
    ('region = "clay"\nkind = "reaction"\nc = 1', "law.0.region: unknown region 'clay' of the mesh; it has none"),
    ('region = "all"\nkind = "reaction"\nc = -1', "must not be negative; it is -1"),
    (
        'region = "all"\nkind = "reaction"\nk = 1',
        "unknown key 'k' of the law 'reaction'; known are kind, parts, region, c",
    ),
    ('region = "all"\nkind = "graph"\ncorners = [[0, 1], [1, 0]]', "s must not fall from corner 0 to 1"),
    ('region = "all"\nkind = "graph"\ncorners = [[1, 0], [0, 1]]', "u must not fall from corner 0 to 1"),
    ('region = "all"\nkind = "obstacle"\npsi = "x"', "law.0.psi: is above u_D on Γ_D, as at"),
    ('region = "all"\nkind = "obstacle"\npsi_upper = "-x"', "law.0.psi_upper: is below u_D on Γ_D, as at"),
    ('region = "all"\nkind = "obstacle"\npsi = 0\npsi_upper = "-y"', "psi must not be above psi_upper"),
    ('region = "all"\nkind = "storage"\ncorners = [[0, 0]]', "law.0: the law 'storage' needs [time]"),
]


@pytest.mark.parametrize(("law", "message"), WRONG)
def test_wrong_case_files(law: str, message: str, tmp_path: Path):
    """One sentence that says what, and where."""
    path = tmp_path / "wrong.toml"
    path.write_text(f'[geometry]\nshape = "square"\n[problem]\nf = 1\n[solve]\nh = 0.3\n[[law]]\n{law}\n')
    with pytest.raises(InputError) as refused:
        solve_case(load_case(path))
    assert message in str(refused.value)


def test_refusals_in_python():
    """Laws in the wrong place, obstacles that contradict one another, methods that take no laws in Ω."""
    with pytest.raises(InputError, match="region: is in the place of parts"):
        Corners(parts="left", corners=[[0, 0]], region="all")
    with pytest.raises(InputError, match=r"law.0 \(signorini\): this law is one of parts of the boundary"):
        on_square(f=1, conditions=[Signorini(region="all")])
    walls = Neumann(["left", "right", "bottom", "top"])
    with pytest.raises(InputError, match="with the laws before it no u is left in some cells"):
        on_square(f=1, conditions=[Obstacle(region="all", psi=1), Obstacle(region="all", psi_upper=0), walls])
    above = Obstacle(region="all", psi=0)
    with pytest.raises(InputError, match=r"law.0.psi: is above all u that law.1 allows on Γ_S, as at \(0.5, 0\)"):
        on_square(f=1, conditions=[above, TwoSided("bottom", psi=-1, psi_upper="x*(x - 1)")])
    below = Obstacle(region="all", psi_upper="x*(1 - x)*y")
    with pytest.raises(InputError, match=r"law.0.psi_upper: is below all u that psi allows on Γ_S, as at \(0.5, 1\)"):
        on_square(f=1, conditions=[below, Signorini("top", psi="2*x*(1 - x)")])
    with pytest.raises(InputError, match="alg3 does not take laws in Ω; alg1, alg2 and qp do"):
        on_square(f=1, options=Options(algorithm="alg3"), conditions=[Corners([[0, 0], [0, 1]], region="all")])
    with pytest.raises(InputError, match="storage: this law is of problems in time"):
        on_square(f=1, conditions=[Storage(corners=[[0, 0]], beyond=1, region="all")])
    jump = Diffusion(f=1, conditions=[Storage([[0, 0], [0, 1]], 1, 1, region="all")])
    with pytest.raises(InputError, match="a storage that jumps, as of melting, needs implicit-euler"):
        next(iter(evolve(square(0.3), jump, Evolution(end=1, steps=2, scheme="bdf2"))))
