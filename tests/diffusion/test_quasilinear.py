"""κ that depends on u: exact columns of soil, a dam, texts and functions, orders, ranks, bounds, files, bad input."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx import (
    Diffusion,
    Dirichlet,
    InputError,
    Neumann,
    NumericalFailure,
    Options,
    Seepage,
    Signorini,
    Solution,
    Wall,
    load_case,
    load_solution,
    solve,
    solve_case,
)
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.extend import write_solution
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.soils import SOILS, BrooksCorey, Gardner, Soil, VanGenuchten
from signorini_fenicsx.quantities import Flux

COMM = MPI.COMM_WORLD
RT1 = Options(element="RT1")


def column(n: int, comm: MPI.Intracomm = COMM) -> Domain:
    """A column of two cells of squares in width, 2 high."""
    return build_domain(comm, f"[0, {4 / n}] x [0, 2]", 2.0001 / n, mesh="structured", diagonal="crossed")


@pytest.mark.parametrize(("options", "rain"), [(Options(), 0.3), (Options(), -2e-4), (RT1, 0.3)])
def test_gardners_column(options: Options, rain: float):
    """Rain, or evaporation, above a water table has an exact solution; its flux is exact, its head of order two."""
    errors, alpha = [], 4.0
    for n in (16, 32):
        conditions = [Neumann(["left", "right"], 0), Neumann("top", rain), Dirichlet("bottom", 0)]
        solution = solve(column(n), Diffusion(kappa=Gardner(1.0, alpha), f=0, conditions=conditions), options)
        assert solution.flux_through("bottom") == pytest.approx(-rain * 4 / n, rel=1e-10)
        z = np.arange(7) / 4 + 0.6 / n  # at the same place of a cell
        exact = z + np.log((1 - rain) * np.exp(-alpha * z) + rain) / alpha
        found = solution.at(np.column_stack([np.full(7, 1.1 / n), z]))[0]
        errors.append(np.abs(found - exact).max())
    assert errors[1] < 2e-3
    assert errors[1] < errors[0] / 3


@pytest.mark.parametrize("options", [Options(), RT1])
def test_kirchhoff(options: Options):
    """−∇·((1 + u)∇u) = 1 is −Δw = 1 for w = u + u²/2, as a text and as a function of x and u; contact stays contact."""
    square, conditions = build_domain(COMM, "square", 0.2, mesh="structured"), [Signorini("bottom", psi=0.2)]
    texts, functions = (
        solve(square, Diffusion(kappa=kappa, f=1, conditions=conditions), options)
        for kappa in ("1 + u", lambda x, u: 1 + u)
    )
    linear = solve(square, Diffusion(f=1, conditions=[Signorini("bottom", psi=0.2 + 0.02)]), options)
    assert texts.norms() == pytest.approx(functions.norms(), rel=1e-8)
    assert texts.contact.facets == linear.contact.facets
    assert texts.norms()["sigma_L2"] == pytest.approx(linear.norms()["sigma_L2"], rel=5e-3)
    assert texts.outcome.details["kappa_change"] < 1e-9
    assert texts.outcome.details["unsure_cells"] == 0  # what is in Python cannot be enclosed
    assert functions.outcome.details["unsure_cells"] == functions.spaces.mesh.topology.index_map(2).size_global


@pytest.mark.parametrize(
    ("options", "laws"),
    [
        (RT1, {"obstacle": -0.1}),
        (Options(), {"obstacle": -0.1, "c": 3}),
        (RT1, {"conditions": [Wall("bottom", beta=5, level=-0.05)]}),
    ],
)
def test_other_laws(options: Options, laws: dict):
    """Laws in Ω, terms cu and slopes go with a κ of u, which may be nearly a number."""
    square = build_domain(COMM, "square", 0.25, mesh="structured")
    small, none = (solve(square, Diffusion(kappa=kappa, f=-8, **laws), options) for kappa in ("1 + u^2/1e7", "1"))
    assert small.norms() == pytest.approx(none.norms(), rel=1e-5, abs=1e-9)
    varied = solve(square, Diffusion(kappa="1 + u^2", f=-8, **laws), options)
    assert varied.outcome.reason.endswith("u gives the κ of its problem")
    assert varied.outcome.details["kappa_change"] < 1e-8
    assert varied.norms()["sigma_L2"] != pytest.approx(none.norms()["sigma_L2"], rel=1e-5)


def test_a_kappa_that_does_not_vary_is_the_same():
    """With k_r = 1 everywhere the numbers are those of a number for κ."""
    square, conditions = build_domain(COMM, "square", 0.2, mesh="structured"), [Signorini("bottom", psi=-0.1)]
    wet = solve(square, Diffusion(kappa=VanGenuchten(2.0, 1.0, 2.0, air_entry=9.0), f=-2, conditions=conditions))
    plain = solve(square, Diffusion(kappa=2.0, f=-2, conditions=conditions))
    assert wet.norms() == pytest.approx(plain.norms(), rel=1e-10)
    assert wet.certify().bound == pytest.approx(plain.certify().bound, rel=1e-8)


@pytest.mark.parametrize("soil", [VanGenuchten(2.0, 3.5, 1.3), BrooksCorey(1.0, 2.0, 0.5), Gardner(1.0, 2.0)])
def test_slopes_of_soils(soil: Soil):
    """The slopes of κ and of the content are those of differences, and both are continuous at saturation."""
    psi, x = -np.logspace(-3, 0.8, 12), np.zeros((12, 2))
    for curve in (soil, soil.content):
        value, slope = curve(x, psi)
        step = 1e-6 * np.abs(psi)
        difference = (curve(x, psi + step)[0] - curve(x, psi - step)[0]) / (2 * step)
        np.testing.assert_allclose(slope, difference, rtol=1e-5, atol=1e-7 * np.abs(slope).max())
        assert (np.diff(value) <= 0).all()
    assert soil(x[:1], np.array([-1e-9]))[0] == pytest.approx(soil.K, rel=0.01)


def slope_problem(soil: Soil) -> Diffusion:
    """Water that seeps through a square whose left side stands in water."""
    return Diffusion(
        kappa=soil,
        f=0,
        conditions=[Dirichlet("left", 0.9), Seepage("right", level="y"), Neumann(["top", "bottom"], 0)],
    )


@pytest.mark.parallel(2)
def test_ranks():
    """Seepage through soil is the same on any ranks, and what flows in flows out."""
    soil = VanGenuchten(1e-3, 4.0, 1.6)
    found = []
    for comm, options in (
        (COMM, Options()),
        (MPI.COMM_SELF, Options()),
        (COMM, RT1),
        (MPI.COMM_SELF, RT1),
    ):
        solution = solve(build_domain(comm, "square", 0.3, mesh="structured"), slope_problem(soil), options)
        assert solution.flux_through("left") == pytest.approx(-solution.flux_through("right"), rel=1e-9)
        found.append(solution.norms())
    assert found[0] == pytest.approx(found[1], rel=1e-10)
    assert found[2] == pytest.approx(found[3], rel=1e-10)


@pytest.mark.parametrize("options", [Options(), RT1])
def test_start_on_another_mesh(options: Options):
    """From the u of a coarser mesh Newton's method begins at once: the same solution in fewer steps."""
    problem, comm = slope_problem(VanGenuchten(1e-3, 4.0, 1.6)), COMM
    coarse, fine = (build_domain(comm, "square", h, mesh="structured") for h in (0.3, 0.15))
    cold, near = solve(fine, problem, options), solve(fine, problem, options, start=solve(coarse, problem, options))
    assert near.norms() == pytest.approx(cold.norms(), rel=1e-7)
    assert len(near.outcome.history) < len(cold.outcome.history) - 6


def test_dry_sand():
    """Sand in a dam, whose k_r falls by ten orders: powers of κ find it, and failed ways end soon."""
    sand = Diffusion(
        f=0,
        kappa=VanGenuchten(8.25e-5, 14.5, 2.68),
        conditions=[Dirichlet("left", 5.0), Seepage("right", level="y"), Neumann(["top", "bottom"], 0)],
    )
    solution = solve(build_domain(COMM, "[0, 9] x [0, 9]", 1.4143, mesh="structured"), sand)
    assert solution.outcome.details["kappa_change"] < 1e-6
    assert len(solution.outcome.history) < 250


def test_iterative_solvers():
    """Where CG solves the linear problems GMRES makes Newton's steps, and the solution is the same."""
    square, problem = build_domain(COMM, "square", 0.3, mesh="structured"), slope_problem(VanGenuchten(1e-3, 4.0, 1.6))
    direct, iterative = (solve(square, problem, Options(tuning=Tuning(direct_up_to=most))) for most in (10**6, 0))
    assert iterative.outcome.linear_solver == "cg+mg"
    assert iterative.norms() == pytest.approx(direct.norms(), rel=1e-8)


def test_bound_quantity_and_files(tmp_path: Path):
    """The bound is that for the last κ and says so, the discharge has an interval, and a file keeps κ."""
    square = build_domain(COMM, "square", 0.15, mesh="structured")
    problem = Diffusion(kappa="0.1 + 0.9/(1 + exp(y - u))", f=0, conditions=slope_problem(Gardner(1, 1)).conditions)
    solution = solve(square, problem)
    certificate = solution.certify()
    assert certificate.proved
    assert not certificate.guaranteed
    assert certificate.summary()["guaranteed_for"] == "the exact solution of the problem with the last κ"
    discharge = solution.quantity(Flux(["right"]))
    assert discharge.lower < discharge.value < discharge.upper
    assert "last κ" in discharge.of
    write_solution(solution, tmp_path / "out")
    read = load_solution(tmp_path / "out", COMM)
    assert read.norms() == pytest.approx(solution.norms(), rel=1e-12)
    assert read.certify().bound == pytest.approx(certificate.bound, rel=1e-10)


DAM = """
[geometry]
file = "dam.geo"
[boundary]
neumann = ["base", "top"]
dirichlet = ["water"]
[[law]]
parts = ["outlet"]
kind = "seepage"
level = "y"
[problem]
f = 0
u_D = 3
[soil.core]
model = "van Genuchten"
K = 1e-8
alpha = 1
n = 1.3
[soil.shell]
model = "Gardner"
K = 1e-5
alpha = 2
"""


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("alpha = 2", "alpha = -2"), "soil"),
        (("alpha = 2", "alpha = 2\ntheta_r = 0.5\ntheta_s = 0.3"), "theta_s: must be above theta_r"),
        (("alpha = 2", "alpha = 2\nn = 2"), "a Gardner soil has none"),
        (("n = 1.3", ""), "n: must be a number for a van Genuchten soil"),
        (("u_D = 3", "u_D = 3\nkappa = 1"), "leave out \\[problem\\] kappa"),
        (("u_D = 3", 'u_D = 3\nform = "suction"'), "unknown form 'suction'"),
        (("u_D = 3", 'u_D = 3\nform = "pressure"\nb = [0, 1]'), "leave out b"),
        (("[soil.core]", "[time]\nend = 1\nsteps = 2\ncapacity = 2\n[soil.core]"), "leave out \\[time\\] capacity"),
        (("[soil.core]", "[soil.all]"), "leave out the other soils"),
    ],
)
def test_bad_soils(tmp_path: Path, change: tuple[str, str], told: str):
    """Numbers out of range, and what contradicts a soil, are refused in a sentence."""
    path = tmp_path / "dam.toml"
    path.write_text(DAM.replace(*change))
    with pytest.raises(InputError, match=told):
        load_case(path)


def test_soils_of_a_case(tmp_path: Path):
    """A case file makes its soils, which are proved by no theorem; a κ that vanishes is refused."""
    path = tmp_path / "dam.toml"
    path.write_text(DAM)
    case: CaseFile = load_case(path)
    kappa = case.posed(2).kappa
    assert kappa == {"core": VanGenuchten(1e-8, 1.0, 1.3), "shell": Gardner(1e-5, 2.0)}
    assert "depend on u" in case.unproved
    assert {*SOILS} == {"van Genuchten", "Gardner", "Brooks-Corey"}
    square = build_domain(COMM, "square", 0.3, mesh="structured")
    clay: dict[str, object] = {"clay": Gardner(1.0, 1.0)}
    for given, told in (("u - 9", "kappa: must be positive"), (clay, r"^\[soil\]: unknown region .*; \[soil.all\] is")):
        with pytest.raises(InputError, match=told):
            solve(square, Diffusion(kappa=given, f=1))
    with pytest.raises(InputError, match="alg1 or alg2"):
        solve(square, Diffusion(kappa="1 + u^2", f=1), Options(algorithm="alg3"))


def test_failure():
    """Where no u is found that gives its κ, the run says by how much κ still changes, and keeps the state."""
    square = build_domain(COMM, "square", 0.6, mesh="structured")
    with pytest.raises(NumericalFailure, match="the last u still changes κ by") as failure:
        solve(square, Diffusion(kappa="exp(-60*u)", f=9, conditions=[Signorini("bottom")]))
    assert not failure.value.solution.converged


def test_gradient_by_soils():
    """The gradient by numbers of soils and by data is that of differences, with seepage and with gravity as b."""
    square = build_domain(COMM, "square", 0.3, mesh="structured")
    K, alpha, n, level = (fem.Constant(square.mesh, value) for value in (1e-1, 3.0, 1.8, 0.85))
    for form in ("head", "pressure"):
        z = 0.0 if form == "head" else ufl.SpatialCoordinate(square.mesh)[1]
        seepage = Seepage("right", level="y" if form == "head" else 0)
        conditions = [Dirichlet("left", level - z), seepage, Neumann(["top", "bottom"], 0)]
        problem = Diffusion(kappa=VanGenuchten(K, alpha, n), f=0.01, form=form, conditions=conditions)

        def value(problem: Diffusion = problem) -> tuple[float, Any, Any]:
            solution = solve(square, problem)
            flux = ufl.dot(solution.sigma, solution.spaces.n)
            J = (solution.u**2 + ufl.inner(solution.sigma, solution.sigma)) * ufl.dx + flux * ufl.ds
            return solution.spaces.integrate(J), solution, J

        _, solution, J = value()
        gradients = solution.gradient(J, [K, alpha, n, level]).gradients
        controls = (K, alpha, n, level)
        starts = [float(control.value) for control in controls]
        for shares in ((0.7, -0.9, 0.8, 1.0), (0.6, 1.0, -0.7, 0.5)):  # of all at once
            ends = []
            for by in (1e-5, -1e-5):
                for control, start, share in zip(controls, starts, shares, strict=True):
                    control.value = start * (1 + share * by)
                ends.append(value()[0])
            for control, start in zip(controls, starts, strict=True):
                control.value = start
            change = np.multiply(starts, shares) @ gradients
            assert change == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=2e-5)


@pytest.mark.parametrize("options", [Options(), RT1])
def test_guaranteed_by_kirchhoff(options: Options):
    """Where κ = k(x) g(u) bounds and intervals of fluxes are theorems for the problem itself; else for the last κ."""
    square = build_domain(COMM, "square", 0.25, mesh="structured")
    conditions = [Signorini("bottom", psi=0.2), Neumann(["left", "right"], 0)]

    def of(kappa: str) -> Solution:
        return solve(square, Diffusion(kappa=kappa, f=1, u_D="1 + x", conditions=conditions), options)

    known, other = of("(1 + x)*exp(2*u)"), of("1 + x*u^2")
    flux = known.quantity(Flux("bottom"))
    assert "last κ" not in flux.of
    assert flux.proved
    assert [solution.certify().guaranteed for solution in (known, other)] == [True, False]
    if options is RT1:  # of RT0 in `test_bound_quantity_and_files`
        assert "last κ" in other.quantity(Flux("bottom")).of
    else:
        assert [of(kappa).certify().guaranteed for kappa in ("3 + u*u", "4 - u")] == [True, False]
    of_w = Diffusion(
        kappa="1 + x",
        f=1,
        u_D="exp(2 + 2*x)/2",
        conditions=[Signorini("bottom", psi=float(np.exp(0.4) / 2)), *conditions[1:]],
    )
    exact = solve(build_domain(COMM, "square", 0.15, mesh="structured"), of_w, RT1).flux_through("bottom")
    assert flux.lower < exact < flux.upper


@pytest.mark.parametrize(("element", "order"), [("RT0", 1), ("RT1", 2)])
def test_tracys_box(element: str, order: int):
    """Tracy's exact head in a box of dry soil: the error is of the order of the element."""
    errors = []
    for h in (0.178, 0.089):
        case = load_case("tracy_box").with_values(
            {"solve.h": h, "geometry.mesh": "structured", "solve.element": element}
        )
        solution = solve_case(case)
        errors.append(solution.errors())
    assert np.log2(errors[0]["energy"] / errors[1]["energy"]) > 0.93 * order
    assert np.log2(errors[0]["u_potential_L2"] / errors[1]["u_potential_L2"]) > 1.8


@pytest.mark.parametrize(
    ("level", "top", "guaranteed"), [(0, 0.3, True), (0, -0.01, True), (0.4, 0.3, False), (0, 1.2, False)]
)
def test_gardners_soil_that_is_dry_for_sure(level: float, top: float, guaranteed: bool):
    """What is proved for Gardner's soil is for the problem itself where all of the soil is above the water table."""
    conditions = [Neumann(["left", "right"], 0), Neumann("top", top), Dirichlet("bottom", level)]
    solution = solve(column(8), Diffusion(kappa=Gardner(1.0, 2.0), f=0, conditions=conditions))
    assert solution.certify().guaranteed == guaranteed
    if top == 0.3 and guaranteed:
        discharge = solution.quantity(Flux("bottom"))
        assert discharge.lower <= -top * 4 / 8 * (1 - 1e-9)
        assert discharge.upper >= -top * 4 / 8 - 1e-12
        assert "Kirchhoff" in discharge.of
