"""A given flux b in σ = κ∇u + b: exact solutions, orders, bounds, quantities, derivatives, soils by pressure."""

from pathlib import Path

import numpy as np
import pytest
import ufl
from agreement import on_one_rank
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx import (
    Diffusion,
    Dirichlet,
    Evolution,
    InputError,
    Neumann,
    Options,
    Seepage,
    Signorini,
    evolve,
    load_solution,
    solve,
)
from signorini_fenicsx.certificate.certify import bound_field
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.extend import write_solution
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.soils import Gardner, Soil, VanGenuchten
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.quantities import Energy, Flux, Mean

COMM = MPI.COMM_WORLD
RT1 = Options(element="RT1")
ALL = [Options(), RT1, Options(backend="mixed"), Options(element="RT1", backend="mixed")]


@pytest.mark.parametrize("options", ALL)
def test_patch(options: Options):
    """A constant b and a linear u are exact for a number, a matrix and in space, where laws hold as well."""
    for shape, kappa, b in (("square", 2, ["1", "-3"]), ("square", [[2, "0.5"], ["0.5", 1]], [1, -3])):
        domain = build_domain(COMM, shape, 0.3, mesh="structured")
        flux = np.array([3.0, 1.0] if kappa == 2 else [4.0, -0.5])
        conditions = [Signorini("bottom", psi="x", q_S=-9), Neumann("right", flux[0])]
        solution = solve(domain, Diffusion(f=0, kappa=kappa, b=b, u_D="x + 2*y", conditions=conditions), options)
        np.testing.assert_allclose(solution.cell_flux.in_vertices() - flux, 0, atol=1e-11)
        assert solution.flux_through("bottom") == pytest.approx(-flux[1] * solution.flux_through("right") / flux[0])
        if options.backend == "hybrid":
            assert solution.certify().bound < 1e-7


@pytest.mark.parametrize("options", ALL[:2])
def test_in_space(options: Options):
    """In space too; at rest σ = 0 is rounding beside b, and is told as such."""
    cube = build_domain(COMM, "cube", 0.6, mesh="structured")
    problem = Diffusion(f=0, kappa=2, b=[0, 0, 6], u_D="-3*z", conditions=[Neumann(["left", "right"], 0)])
    solution = solve(cube, problem, options)
    assert solution.norms()["sigma_L2"] < 1e-10
    assert solution.certify().bound < 1e-7


U, B = "sin(2*x)*exp(y)", ["x*exp(y)", "cos(x + y)"]
F = "-(1 + x)*(-4 + 1)*sin(2*x)*exp(y) - 2*cos(2*x)*exp(y) - exp(y) + sin(x + y)"


@pytest.mark.parametrize(("options", "order"), [(Options(), 1), (RT1, 2)])
def test_orders_and_bounds(options: Options, order: int):
    """The error is of the order of the element, and the bound is a theorem that is hardly larger."""
    errors = []
    for h in (0.3, 0.15):
        square = build_domain(COMM, "square", h, mesh="structured")
        problem = Diffusion(
            f=F, kappa="1 + x", b=B, u_D=U, exact=U, conditions=[Signorini("left", psi=-9, q_S="-2*exp(y)")]
        )
        solution = solve(square, problem, options)
        certificate = solution.certify()
        errors.append(solution.errors()["energy"])
        assert certificate.guaranteed
        assert 1 <= certificate.bound / errors[-1] < 1.6
    assert np.log2(errors[0] / errors[1]) > order - 0.15
    v, x = fem.Function(fem.functionspace(square.mesh, ("P", 1))), ufl.SpatialCoordinate(square.mesh)
    v.interpolate(lambda x: np.sin(2 * x[0]) * np.exp(x[1]))
    off = ufl.grad(v - ufl.sin(2 * x[0]) * ufl.exp(x[1]))
    error = solution.spaces.integrate((1 + x[0]) * ufl.inner(off, off) * ufl.dx(degree=8)) ** 0.5
    field = bound_field(solution, v)
    assert field.guaranteed
    assert field.lower <= error <= field.bound


@pytest.mark.parametrize("options", ALL[:2])
def test_in_time(options: Options):
    """With a b that varies in time u = tx + y has the flux (2t, 2)."""
    square = build_domain(COMM, "square", 0.4, mesh="structured")
    problem = Diffusion(f="x", b=["t", "1"], u_D="t*x + y", conditions=[Neumann("right", "2*t")])
    *_, last = evolve(square, problem, Evolution(end=1, steps=2, initial="y"), options)
    np.testing.assert_allclose(last.solution.cell_flux.in_vertices() - [2, 2], 0, atol=1e-10)


@pytest.mark.parametrize("options", ALL[:2])
def test_a_gradient_is_another_u(options: Options):
    """With b = κ∇φ, φ linear, it is the problem of u + φ: contact, cu and an obstacle move with it."""
    square, phi = build_domain(COMM, "square", 0.2, mesh="structured"), "(0.3*x - 0.4*y)"
    for laws in ({"c": 4}, {"obstacle": -0.1}):
        given = {key: f"{value} - {phi}" for key, value in laws.items() if key == "obstacle"} | {"c": laws.get("c", 0)}
        f = f"-6 - {given['c']}*{phi}"
        conditions = [Signorini("bottom", psi=f"-0.05 - {phi}")]
        moved = solve(
            square, Diffusion(f=f, kappa=2, b=[0.6, -0.8], u_D=f"-{phi}", conditions=conditions, **given), options
        )
        plain = solve(square, Diffusion(f=-6, kappa=2, conditions=[Signorini("bottom", psi=-0.05)], **laws), options)
        assert moved.contact.facets == plain.contact.facets
        assert moved.norms()["sigma_L2"] == pytest.approx(plain.norms()["sigma_L2"], rel=1e-9)
        assert moved.certify().bound == pytest.approx(plain.certify().bound, rel=1e-3)


def test_backends_regions_quantities_and_files(tmp_path: Path):
    """Both backends agree, intervals hold the value, files are right, and what is not there is told."""
    square = build_domain(COMM, "square", 0.2, mesh="structured")
    conditions = [Signorini("bottom", psi=-0.05), Neumann(["left", "right"], 0)]
    problem = Diffusion(f=1, kappa="1 + x*y", b=B, conditions=conditions)
    fine = solve(build_domain(COMM, "square", 0.15, mesh="structured"), problem, RT1)
    values = fine.flux_through("bottom"), fine.spaces.integrate(fine.u * ufl.dx)
    for element, kind, value in zip(("RT0", "RT1"), (Flux("bottom"), Mean()), values, strict=True):
        solution = solve(square, problem, Options(element=element))
        mixed = solve(square, problem, Options(element=element, backend="mixed"))
        assert solution.norms() == pytest.approx(mixed.norms(), rel=1e-9)
        quantity = solution.quantity(kind)
        assert quantity.proved
        assert quantity.lower < value < quantity.upper
        write_solution(solution, tmp_path / element)
        read = load_solution(tmp_path / element, COMM)
        assert read.certify().bound == pytest.approx(solution.certify().bound, rel=1e-9)
    with pytest.raises(InputError, match="alg1 to alg4"):
        solve(square, problem, Options(algorithm="qp"))
    with pytest.raises(InputError, match="b: has 3 components, not 2"):
        solve(square, Diffusion(f=1, b=[1, 2, 3]))


@pytest.mark.parametrize(
    ("element", "width", "b", "f"), [("RT0", 3e-2, "exp(x)", "2 - exp(x)"), ("RT1", 6e-3, "x^2", "2 - 2*x")]
)
def test_energy(element: str, width: float, b: str, f: str):
    """The energy ½(κ∇u, ∇u) + (b, ∇u) − (f, u) of u = x(1 − x) is −1/6 and proved, where ∇·b + f = 2."""
    conditions = [Dirichlet(["left", "right"], 0), Neumann(["bottom", "top"], 0)]
    square = build_domain(COMM, "square", 0.36, mesh="structured")
    found = solve(square, Diffusion(f=f, b=[b, 0], conditions=conditions), Options(element=element)).quantity(Energy())
    assert found.proved
    assert found.lower < -1 / 6 < found.upper
    assert found.lower < found.value < found.upper
    assert found.width < width


@pytest.mark.parametrize("options", ALL[:2])
def test_derivatives(options: Options):
    """The derivatives by κ and by numbers in b are those of differences, and so is the change of the solution."""
    square = build_domain(COMM, "square", 0.3, mesh="structured")
    k, a = fem.Constant(square.mesh, 1.5), fem.Constant(square.mesh, 0.4)
    x = ufl.SpatialCoordinate(square.mesh)
    b = ufl.as_vector([a * x[1] ** 2, 0.3 - a * a])
    problem = Diffusion(f=1, kappa=k, b=b, conditions=[Signorini("bottom", psi=-0.05)])

    def solved(by: tuple[float, float] = (0.0, 0.0)) -> Solution:
        k.value, a.value = 1.5 + by[0], 0.4 + by[1]
        return solve(square, problem, options)

    def functional(solution: Solution) -> ufl.Form:
        return solution.u**2 * ufl.dx + ufl.inner(solution.sigma, solution.sigma) * ufl.dx

    steps = np.array([(1e-5, 0), (0, 1e-5)])
    values = [[each.spaces.integrate(functional(each)) for each in map(solved, (by, -by))] for by in steps]
    by_differences = [(one - other) / 2e-5 for one, other in values]
    solution = solved()
    assert solution.gradient(functional(solution), [k, a])[1] == pytest.approx(by_differences, rel=1e-6)
    change = solution.derivative({a: 1.0})
    far, near = (each.u.x.array for each in map(solved, (steps[1], -steps[1])))
    assert change.u.x.array == pytest.approx((far - near) / 2e-5, abs=1e-8)


def water_in_soil(form: str, soil: Soil) -> Diffusion:
    """Seepage through a square that stands in water on its left, by head or by pressure."""
    height = "y" if form == "head" else "0"
    above = 0.8 if form == "head" else "0.8 - y"
    conditions = [Dirichlet("left", above), Seepage("right", level=height), Neumann(["top", "bottom"], 0)]
    return Diffusion(f=0, kappa=soil, form=form, conditions=conditions)


@pytest.mark.parametrize(("options", "soil"), [(ALL[0], VanGenuchten(1e-3, 4.0, 1.6)), (RT1, Gardner(1e-3, 3.0))])
def test_pressure_is_head(options: Options, soil: Soil):
    """With the pressure head as u, gravity as b, soils have the flux, saturation and bound that the head gives."""
    square = build_domain(COMM, "square", 0.25, mesh="structured")
    head, pressure = (solve(square, water_in_soil(form, soil), options) for form in ("head", "pressure"))
    assert pressure.flux_through("right") == pytest.approx(head.flux_through("right"), rel=1e-7)
    np.testing.assert_allclose(pressure.u_means, head.u_means - corners(square.mesh).mean(axis=1)[:, 1], atol=1e-6)
    certificate = pressure.certify()
    assert certificate.bound == pytest.approx(head.certify().bound, rel=1e-3)
    assert certificate.summary()["guaranteed_for"] == "the exact solution of the problem with the last κ"
    if options is RT1:
        discharge = pressure.quantity(Flux("left"))
        assert discharge.proved
        assert discharge.lower < pressure.flux_through("left") < discharge.upper


@pytest.mark.parallel(2)
def test_ranks():
    """Fluxes, bounds, a gradient and starts from other meshes do not depend on the number of ranks."""

    def numbers(comm: MPI.Comm) -> list[float]:
        square, fine = (build_domain(comm, "square", h, mesh="structured") for h in (0.3, 0.15))
        K = fem.Constant(square.mesh, 1e-2)
        found = []
        for element in ("RT0", "RT1"):
            options = Options(element=element)
            solution = solve(square, Diffusion(f=1, kappa="1 + x*y", b=B, conditions=[Signorini("bottom")]), options)
            found += [*solution.norms().values(), solution.certify().bound]
        problem = water_in_soil("pressure", VanGenuchten(K, 4.0, 1.6))
        wet = solve(square, problem)
        found += [wet.norms()["u_L2"], solve(fine, problem, start=wet).norms()["u_L2"]]
        J = wet.u**2 * ufl.dx + ufl.inner(wet.sigma, wet.sigma) * ufl.dx
        found += wet.gradient(J, [K]).gradients
        by_w = solve(square, Diffusion(f=1, kappa="exp(u)", conditions=[Signorini("bottom")]), options)
        return [*found, by_w.certify().bound]

    assert numbers(COMM) == pytest.approx(on_one_rank(numbers), rel=1e-7)
