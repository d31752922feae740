"""Derivatives through contact: Taylor remainders of all data, corners, backends, ranks."""

from collections.abc import Callable
from typing import Any

import dolfinx.mesh
import numpy as np
import pytest
import ufl
from agreement import on_one_rank
from controlled import Controlled, constants, directions_of, function, move, pairing
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx import (
    Corners,
    Diffusion,
    Dirichlet,
    Friction,
    InputError,
    Neumann,
    Obstacle,
    Options,
    Reaction,
    Regulator,
    River,
    Signorini,
    Solver,
    TwoSided,
    Wall,
    domain_of,
    load_case,
    solve,
    solve_case,
)
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.derivatives import NotDifferentiable
from signorini_fenicsx.meshes.meshing import build_domain

COMM = MPI.COMM_WORLD
RT1 = Options(element="RT1")


def one_law(comm: MPI.Comm, options: Options | None = None) -> Controlled:
    """All data, in a problem with one law."""
    domain = build_domain(comm, "square", 0.15, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    k, q, g, u_D, psi, f = given = constants(domain, 1.3, 0.1, 0.3, 0.2, -0.05, 40.0)
    m = function(domain, lambda x: 1 + x[0] * x[1])
    conditions = [Signorini("bottom", psi=psi * x[0], q_S=q * x[0]), Neumann("right", g * x[1] ** 2)]
    problem = Diffusion(
        f=f * (x[0] - 0.6) * m, kappa=k * m + x[1] ** 2, c=m * k, u_D=u_D * x[0] ** 3, conditions=conditions
    )
    return Controlled(domain, problem, [*given, m], options)


def many_laws(comm: MPI.Comm, options: Options | None = None) -> Controlled:
    """Laws with slopes and several corners on all sides, one with a weighted mean; κ a matrix."""
    domain = build_domain(comm, "square", 0.15, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    beta, level, r, bed, k, low, high, g = given = constants(domain, 2.0, 0.05, 1.5, -0.3, 3.0, -0.4, 0.1, 0.05)
    kappa = function(domain, lambda x: 1 + 0.5 * np.sin(3 * x[0]), ("DG", 1))
    conditions = [
        Wall("bottom", beta=beta * (1 + x[0]), level=level * ufl.sin(4 * x[0])),
        River("left", r=r * (1 + x[1]), level=level + 0.1 * x[1], bed=bed, q=0.1),
        Regulator("right", k=k, g_low=low, g_high=high * (1 + x[1]), a=0.1 * level),
        Friction("top", g=g),
    ]
    matrix = ufl.as_matrix([[kappa, 0.3 * x[0]], [0.3 * x[0], 1 + kappa**2]])
    problem = Diffusion(f=20 * (x[0] - 0.6), kappa=matrix, conditions=conditions)
    return Controlled(domain, problem, [*given, kappa], options)


def in_the_domain(comm: MPI.Comm) -> Controlled:
    """Two laws in Ω that add up, and c > 0 with a reaction beside it."""
    domain = build_domain(comm, "square", 0.15, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    k, psi, slope, theta, c, upper = given = constants(domain, 1.2, -0.1, 2.0, 3.0, 0.7, 0.1)
    conditions = [
        Obstacle(region="all", psi=psi * (1 + x[1])),  # type: ignore[call-arg]
        Corners(region="all", corners=[(0.0, 0.0), (0.02, theta)], before=slope, beyond=slope),  # type: ignore[call-arg]
        Reaction(region="all", c=slope * x[1]),  # type: ignore[call-arg]
        TwoSided("bottom", psi=-0.05, psi_upper=upper * x[0]),
        Dirichlet(["top", "left", "right"], 0.0),
    ]
    problem = Diffusion(f=60 * (x[0] - 0.6), kappa=k + x[0], c=c * (1 + x[0]), conditions=conditions)
    return Controlled(domain, problem, given)


def across(comm: MPI.Comm, options: Options | None = None) -> Controlled:
    """Friction between two bodies."""
    mesh = dolfinx.mesh.create_unit_square(comm, 6, 6)
    sides = {"fault": lambda x: np.isclose(x[1], 0.5), "sides": lambda x: np.isclose(x[0] * (1 - x[0]), 0)}
    domain = domain_of(mesh, sides, inner=["fault"])
    x = ufl.SpatialCoordinate(domain.mesh)
    k, g, u_D = given = constants(domain, 1.1, 0.25, 0.5)
    conditions = [Friction("fault", g=g * (1 + x[0])), Neumann("sides", 0.1 * g)]
    problem = Diffusion(f=4 * (x[0] - 0.5) * k**2, kappa=k + x[1], u_D=u_D * x[1] * x[0], conditions=conditions)
    return Controlled(domain, problem, given, options)


def in_space(comm: MPI.Comm) -> Controlled:
    """Two laws on the sides of a mesh in space, with RT1."""
    domain = build_domain(comm, "cube", 0.9, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    k, g, beta, level, psi, c, f = given = constants(domain, 1.1, 0.2, 1.5, 0.1, -0.1, 0.8, 30.0)
    conditions = [
        Signorini("bottom", psi=psi * ufl.exp(x[0]), q_S=0.1 * g * x[1]),
        Wall("top", beta=beta * (1 + x[0] * x[1]), level=level * ufl.sin(4 * x[0])),
        Neumann("right", g * x[1] ** 2),
    ]
    f *= x[0] - 0.6
    return Controlled(
        domain, Diffusion(f=f, kappa=k + x[1], c=c * x[2], u_D=g * x[0], conditions=conditions), given, RT1
    )


PROBLEMS: dict[str, Callable[[MPI.Comm], Controlled]] = {
    "all data": one_law,
    "alg4": lambda comm: one_law(comm, options=Options(algorithm="alg4", eps=0.3)),
    "mixed": lambda comm: one_law(comm, options=Options(backend="mixed")),
    "laws": many_laws,
    "in Ω": in_the_domain,
    "inside": across,
    "RT1": lambda comm: one_law(comm, options=RT1),
    "RT1, alg3": lambda comm: one_law(comm, options=Options(algorithm="alg3", eps=0.02, element="RT1")),
    "RT1, laws": lambda comm: many_laws(comm, options=RT1),
    "RT1, inside": lambda comm: across(comm, options=RT1),
    "RT1, space": in_space,
}


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "RT1")) for name in PROBLEMS])
def test_taylor(name: str):
    """The remainder has order 2, so the gradient is that of the discrete problem; all controls move at once."""
    given = PROBLEMS[name](COMM)
    solver = Solver(given.domain, given.problem)
    solution = solver.solve(given.problem, given.options)
    value, gradients = solution.gradient(given.functional(solution), given.controls)
    remainders, directions = [], directions_of(given.controls)
    for step in (4e-3, 2e-3):
        move(given.controls, directions, step)
        other = solver.solve(given.problem, given.options)
        there = other.spaces.integrate(given.functional(other))
        move(given.controls, directions, -step)
        remainders.append(there - value - step * pairing(gradients, directions))
        assert (other.segments().segment == solution.segments().segment).all()
    change = solution.derivative(dict(zip(given.controls, directions, strict=True)))
    J, direct = given.functional(solution), 0.0
    for field, its in ((solution.sigma, change.sigma), (solution.u, change.u), (solution.p, change.p)):
        direct += solution.spaces.integrate(ufl.derivative(J, field, its))
    first = given.controls[0]
    direct += directions[0] * 2 * solution.spaces.integrate(first * solution.u * ufl.dx)
    assert pairing(gradients, directions) == pytest.approx(direct, rel=1e-9)
    assert abs(remainders[1]) < 0.05 * abs(there - value)
    assert np.log2(remainders[0] / remainders[1]) == pytest.approx(2, abs=0.1)


@pytest.mark.parallel(2)
@pytest.mark.parametrize("name", ["in Ω", "inside", "RT1, laws"])
def test_ranks(name: str):
    """Value and derivatives do not depend on the number of ranks."""

    def derivatives(comm: MPI.Comm) -> list[float]:
        given = PROBLEMS[name](comm)
        solution = solve(given.domain, given.problem, given.options)
        value, gradients = solution.gradient(given.functional(solution), given.controls)
        numbers = [gradient for gradient in gradients if isinstance(gradient, float)]
        return [value, pairing(gradients, directions_of(given.controls)), *numbers]

    assert derivatives(COMM) == pytest.approx(on_one_rank(derivatives), rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("options", [Options(), RT1], ids=["RT0", "RT1"])
def test_biactive(options: Options):
    """On a corner of the law the derivative is one-sided, exact, and no gradient is claimed."""
    domain = build_domain(COMM, "square", 0.15, mesh="structured")
    (f,) = constants(domain, -4.0)
    psi, lift, bump = (function(domain, lambda x: 0 * x[0], element) for element in (("DG", 1), ("P", 1), ("P", 1)))
    psi.x.array[:] = -1.0
    bump.interpolate(lambda x: np.sin(6 * x[0]) * x[1])
    problem = Diffusion(f=f, conditions=[Signorini("bottom", psi=psi), Dirichlet(["top", "left", "right"], lift)])
    free = solve(domain, problem, options)
    places, sites = psi.function_space.tabulate_dof_coordinates()[:, 0], free.p_at[0].size
    for row in range(2, 6):  # p − ψ = σ·n − q_S = 0 on these four facets
        dofs, ends = psi.function_space.dofmap.list[free.spaces.cells[row]], free.spaces.corners[row, :, 0]
        values = np.broadcast_to(free.p_at[row], 2)
        psi.x.array[dofs] = values[0] + (values[1] - values[0]) * (places[dofs] - ends[0]) / (ends[1] - ends[0])
    solution = solve(domain, problem, options)
    for sign in (1.0, -1.0):
        change = solution.derivative({f: sign, lift: bump})
        f.value, lift.x.array[:] = -4.0 + 0.01 * sign, 0.01 * bump.x.array
        there = solve(domain, problem, options)
        f.value, lift.x.array[:] = -4.0, 0.0
        for part, before, its in (
            (there.u, solution.u, change.u),
            (there.p, solution.p, change.p),
            (there.sigma, solution.sigma, change.sigma),
        ):
            assert part.x.array == pytest.approx(before.x.array + 0.01 * its.x.array, abs=1e-11)
    assert solution.derivative({f: 1.0}).p.x.array[3 * sites] > 0
    assert solution.derivative({f: -1.0}).p.x.array[3 * sites] == pytest.approx(0, abs=1e-14)
    with pytest.warns(NotDifferentiable, match=f"{4 * sites} sites") as warned:
        solution.gradient(solution.u * ufl.dx, [f])
    assert warned[0].message.places.shape == (4 * sites, 2)  # type: ignore[union-attr]
    assert warned[0].filename == __file__


def test_biactive_sites_that_change_one_by_one():
    """In a thin strip at rest a load at its end lifts one facet after the other: 56 steps, as many as in a solve."""
    mesh = dolfinx.mesh.create_rectangle(MPI.COMM_SELF, [(0, 0), (80, 0.2)], (80, 1))
    parts = {"bottom": lambda x: np.isclose(x[1], 0), "free": lambda x: np.isclose(x[0], 0) | np.isclose(x[1], 0.2)}
    load, f = (fem.Function(fem.functionspace(mesh, ("DG", 0))) for _ in range(2))
    load.interpolate(lambda x: np.where(x[0] < 1, 60.0, -1.0))
    f.x.array[:] = -1.0
    domain, problem = domain_of(mesh, parts), Diffusion(f=f, conditions=[Signorini("bottom"), Neumann("free")])
    pressed = solve(domain, problem)
    f.x.array[:] = 0.0
    change = solve(domain, problem, start=pressed).derivative({f: load})
    f.x.array[:] = load.x.array
    lifted = solve(domain, problem, Options(predict=False), start=pressed)
    assert len(lifted.outcome.history) > 55
    assert change.p.x.array == pytest.approx(lifted.p.x.array, rel=1e-9, abs=1e-8)


def test_refusals():
    """What is no control, is in no datum, or solves another problem."""
    given = one_law(COMM)
    solution = solve(given.domain, given.problem)
    (stranger,) = constants(given.domain, 1.0)
    with pytest.raises(InputError, match="not float"):
        solution.gradient(solution.u * ufl.dx, [1.0])
    with pytest.raises(InputError, match="number 2 is in no datum"):
        solution.gradient(solution.u * ufl.dx, [given.controls[0], stranger])
    with pytest.raises(InputError, match="1 control in no datum"):
        solution.derivative({stranger: 1.0})
    with pytest.raises(InputError, match="must be a scalar"):
        solution.derivative({fem.Constant(given.domain.mesh, (1.0, 2.0)): 1.0})
    load = given.controls[-2]
    load.value *= 2
    with pytest.raises(InputError, match="other values than when the problem was solved"):
        solution.gradient(solution.u * ufl.dx, given.controls)
    load.value /= 2
    other = solve(given.domain, given.problem, Options(algorithm="slimane", eps=1e-3))
    with pytest.raises(InputError, match="solves another discrete problem"):
        other.gradient(other.u * ufl.dx, given.controls)


def test_paths():
    """Numbers of a case are controls by their paths; the gradient is that of differences."""
    case = load_case("dam")
    solver = Solver(mesh_case(case, COMM), case.posed(2))
    paths = ["problem.kappa.core", "problem.kappa.shell"]
    solution = solve_case(case, domain=solver)
    _, gradients = solution.gradient(solution.u**2 * ufl.dx, [*paths, "problem.f"])
    change = solution.derivative({paths[0]: 1.0})
    of_core = solution.spaces.integrate(2 * solution.u * change.u * ufl.dx)
    assert gradients[0] == pytest.approx(of_core, rel=1e-9)
    for core, shell, gradient in ((1e-3, 0.0, gradients[0]), (0.0, 1e-3, gradients[1])):
        sides = []
        for sign in (1, -1):
            kappa = {"core": 0.3 + sign * core, "shell": 1.0 + sign * shell}
            other = solve_case(case.with_values({"problem.kappa": kappa}), domain=solver)
            sides.append(other.spaces.integrate(other.u**2 * ufl.dx))
        assert (sides[0] - sides[1]) / 2e-3 == pytest.approx(gradient, rel=1e-4)
    for path, match in (("problem.psi", "no number"), ("problem.kappa.rock", "no such"), ("law.0.g", "no such")):
        with pytest.raises(InputError, match=match):
            solution.gradient(solution.u * ufl.dx, [path])


@pytest.mark.parametrize("options", [Options(), RT1], ids=["RT0", "RT1"])
def test_kept_factors(options: Options):
    """A solver that knows all traces on Γ_S from one factorisation gives the same gradient, and solves on after it."""
    domain = build_domain(COMM, "square", 0.15, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    f, psi = controls = constants(domain, 10.0, -0.05)
    problem = Diffusion(f=f * (x[0] - 0.6), conditions=[Signorini("bottom", psi=psi), Neumann("right")])
    solver, present = Solver(domain, problem), []
    for value in (10.0, 20.0, 30.0, 40.0, 50.0):
        f.value = value
        kept, fresh = solver.solve(problem, options), solve(domain, problem, options)
        found = [each.gradient(each.u**2 * ufl.dx + each.p * each.spaces.ds, controls) for each in (kept, fresh)]
        assert kept.u.x.array == pytest.approx(fresh.u.x.array, abs=1e-11)
        assert found[0].gradients == pytest.approx(found[1].gradients, rel=1e-9)
        present.append(solver._system.kept.present)
        assert kept.backend_of(type(present[0])) is present[0] is present[-1]
    assert present[-1].cheap or options is RT1


def test_transition():
    """By the position of a transition: that of the exact solution, and differences of the program."""
    errors = []
    for h in (0.1, 0.025):
        domain = build_domain(COMM, "square", h, mesh="structured")
        x, (a,) = ufl.SpatialCoordinate(domain.mesh), constants(domain, 0.413)
        right, left = ufl.max_value(x[0] - a, 0), ufl.max_value(a - x[0], 0)  # the data of the case `transition`
        u = right**3 - x[1] * left**3
        problem = Diffusion(f=-6 * (right - x[1] * left), u_D=u, conditions=[Signorini("bottom")])
        solver, sides = Solver(domain, problem), []
        solution = solver.solve(problem)
        _, (gradient,) = solution.gradient(solution.u**2 * x[0] * ufl.dx, [a])
        moved = 2 * u * (-3 * right**2 - 3 * x[1] * left**2)
        errors.append(gradient - solution.spaces.integrate(moved * x[0] * ufl.dx(degree=8)))
        for step in (1e-4, -1e-4):
            a.value = 0.413 + step
            there = solver.solve(problem)
            sides.append(there.spaces.integrate(there.u**2 * x[0] * ufl.dx))
        a.value = 0.413
        assert (sides[0] - sides[1]) / 2e-4 == pytest.approx(gradient, rel=1e-3)
    assert abs(errors[1]) < abs(errors[0]) / 8


def test_biactive_case():
    """Where Γ_S is biactive but for the error of the mesh, the tolerance decides which derivative is meant."""
    domain = build_domain(COMM, "square", 0.1, mesh="structured")
    x, (t,) = ufl.SpatialCoordinate(domain.mesh), constants(domain, 0.0)
    right = ufl.max_value(x[0] - 1 / 3, 0)  # the data of the case `biactive`
    f = -12 * right**2 + t * ufl.sin(9 * x[0])
    problem = Diffusion(f=f, u_D=right**4, conditions=[Signorini("bottom")])
    solution = solve(domain, problem)

    def J(of: Any) -> float:
        return of.spaces.integrate(of.u**2 * ufl.dx + of.p * (1 + x[0]) * of.spaces.ds)

    for sign in (1.0, -1.0):
        t.value = 0.4 * sign
        there = J(solve(domain, problem))
        t.value, off = 0.0, []
        for tolerance in (1e-2, 1e-8):
            change = solution.derivative({t: sign}, tolerance=tolerance)
            slope = 2 * solution.u * change.u * ufl.dx + change.p * (1 + x[0]) * solution.spaces.ds
            off.append(abs(there - J(solution) - 0.4 * solution.spaces.integrate(slope)) / abs(there - J(solution)))
        assert off[0] < 0.12
        assert off[1] > 0.5
    with pytest.warns(NotDifferentiable, match="8 sites"):
        solution.gradient(solution.u * ufl.dx, [t], tolerance=1e-2)
