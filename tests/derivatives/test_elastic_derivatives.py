"""Derivatives through elastic contact: Taylor remainders of all data, laws, pairs; corners, load steps, ranks."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import ufl
from agreement import on_one_rank
from bodies_apart import two
from controlled import Controlled, constants, directions_of, function, move, pairing
from mpi4py import MPI

from signorini_fenicsx import (
    Contact,
    Coulomb,
    Dirichlet,
    Elasticity,
    Evolution,
    Neumann,
    Pair,
    Regulator,
    Solver,
    Tied,
    Tresca,
    TwoSided,
    Wall,
    evolve,
    solve,
)
from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.contact.laws import Corners
from signorini_fenicsx.derivatives import NotDifferentiable, gradient_in_time
from signorini_fenicsx.discrete.seen import parts_of
from signorini_fenicsx.linear.gmres import gmres
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.solving.evolving import Instant

COMM = MPI.COMM_WORLD


def block(comm: MPI.Comm, *, friction: bool) -> Controlled:
    """A block pressed and pushed onto a curved foundation."""
    domain = build_domain(comm, "square", 0.36, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    E, nu, gap, push, force, traction, bound = given = constants(domain, 1.5, 0.3, 0.02, 0.3, -0.1, 0.2, 0.12)
    stiffness = function(domain, lambda x: 1 + 0.3 * x[0])
    law = Coulomb(2 * bound * (1 + x[0]), 0.01 * bound) if friction else None
    conditions = [
        Contact("bottom", gap=gap * (1 + 60 * (x[0] - 0.5) ** 2), friction=law),
        Dirichlet("top", [push * x[0], -push * (1 + 0.2 * x[0])]),
        Neumann("left", [0.1 * traction, 0]) if friction else Dirichlet("left", [0.1 * push * x[1], 0], components="n"),
        Neumann("right", [traction * x[1] ** 3, -0.3 * traction]),
    ]
    problem = Elasticity(
        young=E * stiffness, poisson=nu * (1 - 0.2 * x[1]), f=[0.1, force * x[0]], plane="stress", conditions=conditions
    )
    return Controlled(domain, problem, [*given, stiffness] if friction else [*given[:-1], stiffness])


def material(comm: MPI.Comm) -> Controlled:
    """A block of an orthotropic material whose axes turn, with strain and stress of its own."""
    domain = build_domain(comm, "square", 0.36, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    E, nu, shear, turn, strain, stress = given = constants(domain, 1.5, 0.3, 0.5, 0.4, 0.05, 0.03)
    own = ufl.as_matrix([[strain * x[0], 0.2 * strain], [0.2 * strain, strain**2]])
    conditions = [
        Contact("bottom", gap=0.02, friction=Coulomb(0.3)),
        Dirichlet("top", ["0.05*x", "-0.15"]),
        Neumann(["left", "right"]),
    ]
    problem = Elasticity(
        young=[E, 2 * E * (1 + x[1]), 1.5],
        poisson=[nu, 0.2, nu],
        shear=[shear, 0.5, shear],
        axes=[[1.0, turn * (1 + x[1])]],
        eigenstrain=own,
        initial_stress=stress * (1 + x[0]),
        conditions=conditions,
    )
    return Controlled(domain, problem, given)


def on_laws(comm: MPI.Comm, *, springs: bool) -> Controlled:
    """A block that a sloping displacement presses onto something with a law, and tears off it, beside another law."""
    domain = build_domain(comm, "square", 0.36, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    E, a, b, c, gap, push = given = constants(domain, 1.5, 0.04, 0.1, 3.0, 0.02, 0.3)
    level = function(domain, lambda x: 0.02 * x[0], ("P", 1))
    laws: list[Any] = [
        Wall("bottom", beta=c * (1 + x[0]), level=a + level),
        TwoSided("right", psi_upper=0.5 * a + 0.3 * level, psi=-b - level, q_S=0.5 * a),
    ]
    if not springs:
        laws = [
            Corners("bottom", [(0, 5 * a), (b, a + level), (1.5 * b, 0)], before="vertical", beyond=c * a),
            Regulator("right", k=c, g_low=-a, g_high=4 * a * (1.2 - x[1]), a=0.1 * a + level),
        ]
    moved = Dirichlet("top", [push * 0.2 * x[0], -push * (1 - 1.2 * x[0])])
    problem = Elasticity(young=E, poisson=0.3, conditions=[*laws, moved, Neumann("left")])
    posed = replace(problem.on(domain), gap=gap * (1 + x[0] ** 2))
    return Controlled(domain, posed, [*given, level])


def in_space(comm: MPI.Comm, *, friction: bool) -> Controlled:
    """A cube that is pressed and turned on a foundation, or pressed and torn on springs."""
    domain = build_domain(comm, "cube", 0.9, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    E, nu, bound, push = given = constants(domain, 1.5, 0.3, 0.02, 0.1)
    touching = Contact("bottom", gap=0.1 * bound * (1 + x[0] ** 2), friction=Coulomb(10 * bound * (1 + x[0])))
    springs = Wall("bottom", beta=100 * bound, level=bound * (1 + x[1]))
    conditions = [
        touching if friction else springs,
        Dirichlet("top", [push * x[1], push * 0.3, -push * (1 + (0.2 if friction else -1.9) * x[0])]),
        Neumann(["left", "right", "front", "back"]),
    ]
    return Controlled(domain, Elasticity(young=E, poisson=nu, conditions=conditions), given)


def of_pair(comm: MPI.Comm, law: str, dim: int = 2) -> Controlled:
    """Two boxes whose meshes share no nodes, pressed and pushed on one another; one of them ends inside a facet."""
    numbers = ((3, 2), (4, 2)) if dim == 2 else ((2, 1, 1), (1, 2, 1))
    domain, last = two(comm, *numbers, gap=0.0 if law == "tied" else 0.02), dim - 1
    x = ufl.SpatialCoordinate(domain.mesh)
    E, nu, push, traction, bound = given = constants(domain, 1.5, 0.3, 0.1, 0.05, 0.03)
    laws: dict[str, Any] = {"tresca": Tresca(bound * (1 + x[0])), "coulomb": Coulomb(10 * bound), "tied": Tied()}
    meeting = Pair(f"u{last}0", f"l{last}1", laws.get(law), gap=0.2 * bound if law == "coulomb" else "distance")
    moved = Dirichlet(f"u{last}1", [push * (0.3 + x[0]), *[0.0] * (dim - 2), -push * (1 - 0.9 * x[0])])
    sides = [f"{body}{axis}{end}" for body in "ul" for axis in range(last) for end in (0, 1)]
    conditions = [meeting, moved, Dirichlet(f"l{last}0", 0), Neumann(sides[1:]), Neumann(sides[0], [traction] * dim)]
    body = Elasticity(young=E * (1 + 0.2 * x[0]), poisson=nu, conditions=conditions)
    return Controlled(domain, body, given[: 4 if law == "tied" else 5])


def functional(given: Controlled, solution: Any) -> Any:
    """Something of σ and u, and of a control."""
    x, y = ufl.SpatialCoordinate(given.domain.mesh), ufl.SpatialCoordinate(solution.sigma.function_space.mesh)
    sigma, u = solution.sigma, solution.u
    J = sigma[0, 1] * sigma[1, 1] * (1 + y[0]) * ufl.dx + 0.3 * ufl.tr(sigma) * y[1] * ufl.ds
    return J + (u[0] * u[1] + given.controls[0] * u[0] * x[1]) * ufl.dx + u[1] ** 2 * ufl.ds


PROBLEMS: dict[str, Callable[[MPI.Comm], Controlled]] = {
    "none": partial(block, friction=False),
    "coulomb": partial(block, friction=True),
    "material": material,
    "wall, joint": partial(on_laws, springs=True),
    "layer, regulator": partial(on_laws, springs=False),
    "wall in space": partial(in_space, friction=False),
    "coulomb in space": partial(in_space, friction=True),
    **{f"pair, {law}": partial(of_pair, law=law) for law in ("coulomb", "tied")},
    "pair in space": partial(of_pair, law="tresca", dim=3),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "wall in space")) for name in PROBLEMS]
)
def test_taylor(name: str):
    """The remainder has order 2: the gradient is that of the discrete problem."""
    given = PROBLEMS[name](COMM)
    solver = Solver(given.domain, given.problem)
    solution = solver.solve(given.problem)
    states = np.unique(solution.outcome.conditions.kind)
    assert len(states) != 1  # 0 where all is tied
    value, gradients = solution.gradient(functional(given, solution), given.controls)
    remainders, directions = [], directions_of(given.controls)
    for step in (4e-3, 2e-3):
        move(given.controls, directions, step)
        other = solver.solve(given.problem)
        there = sum(other.spaces.integrate(part) for part in parts_of(functional(given, other)))
        move(given.controls, directions, -step)
        remainders.append(there - value - step * pairing(gradients, directions))
        assert (other.outcome.conditions.kind == solution.outcome.conditions.kind).all()
    change = solution.derivative(dict(zip(given.controls, directions, strict=True)))
    J = functional(given, solution)
    direct = sum(
        solution.spaces.integrate(ufl.derivative(part, whole, its))
        for part in parts_of(J)
        for whole, its in ((solution.sigma, change.sigma), (solution.u, change.u))
        if whole in part.coefficients()
    )
    x = ufl.SpatialCoordinate(given.domain.mesh)
    direct += directions[0] * solution.spaces.integrate(solution.u[0] * x[1] * ufl.dx)
    assert pairing(gradients, directions) == pytest.approx(direct, rel=1e-7)
    assert abs(remainders[1]) < 0.05 * abs(there - value)
    assert np.log2(remainders[0] / remainders[1]) == pytest.approx(2, abs=0.1)


@pytest.mark.parallel(2)
@pytest.mark.parametrize("name", ["pair, coulomb", "layer, regulator"])
def test_ranks(name: str):
    """Value and derivatives do not depend on the number of ranks."""

    def derivatives(comm: MPI.Comm) -> list[float]:
        given = PROBLEMS[name](comm)
        solution = solve(given.domain, given.problem)
        value, gradients = solution.gradient(functional(given, solution), given.controls)
        numbers = [gradient for gradient in gradients if not isinstance(gradient, np.ndarray)]
        return [value, pairing(gradients, directions_of(given.controls)), *numbers]

    assert derivatives(COMM) == pytest.approx(on_one_rank(derivatives), rel=1e-8, abs=1e-10)


def test_an_adjoint_that_is_not_found(monkeypatch: pytest.MonkeyPatch):
    """With Coulomb's law the adjoint is found by GMRES; where that does not end there is no gradient."""
    monkeypatch.setattr("signorini_fenicsx.physics.elasticity.derivative.linearised.gmres", partial(gmres, most=1))
    given = block(COMM, friction=True)
    solution = solve(given.domain, given.problem)
    with pytest.raises(NumericalFailure, match="GMRES has not found it after 1 step"):
        solution.gradient(functional(given, solution), given.controls)


@pytest.mark.parametrize("friction", ["tresca", "coulomb"])
def test_biactive(friction: str):
    """At vertices that touch without pressure the derivative is one-sided and exact; no gradient is claimed."""
    domain = build_domain(COMM, "square", 0.36, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    push, bound = given = constants(domain, 0.3, 0.05)
    gap = function(domain, lambda x: 0 * x[0], ("DG", 1))
    law: Any = Tresca(bound) if friction == "tresca" else Coulomb(8 * bound)
    pulled = Dirichlet("top", [0.3 * push * (1 + x[0]), -push * (1 - 1.8 * x[0])])
    conditions = [Contact("bottom", gap=gap, friction=law), pulled, Neumann(["left", "right"])]
    problem = Elasticity(young=1.5, poisson=0.3, conditions=conditions)
    free = solve(domain, problem)
    places, contact = gap.function_space.tabulate_dof_coordinates()[:, :2], free.spaces.contact
    for facet in np.flatnonzero((free.pressure < 1e-9).all(axis=1)):
        for vertex, opening in zip(contact.vertices[facet], free.linear_gap[facet], strict=True):
            dofs = gap.function_space.dofmap.list[contact.cells[facet]]
            gap.x.array[dofs[np.square(places[dofs] - vertex).sum(axis=1).argmin()]] -= opening
    solution, changes = solve(domain, problem), []
    for control, sign in ((push, 0.3), (push, -0.3), (bound, 0.05)):
        change = solution.derivative({control: sign})
        control.value += 1e-5 * sign
        there = solve(domain, problem)
        control.value -= 1e-5 * sign
        for after, before, its in ((there.u, solution.u, change.u), (there.sigma, solution.sigma, change.sigma)):
            assert after.x.array == pytest.approx(before.x.array + 1e-5 * its.x.array, abs=1e-9)
        changes.append(change.u.x.array)
    assert np.abs(changes[0] + changes[1]).max() > 0.01
    with pytest.warns(NotDifferentiable, match="4 sites"):
        solution.gradient(functional(Controlled(domain, problem, given), solution), given)


@pytest.mark.parametrize(("friction", "shape"), [("coulomb", "square"), ("tresca", "cube")])
def test_in_steps(friction: str, shape: str):
    """Loads in steps, with friction against the slip of the last one: backwards through all; it turns in space."""
    domain = build_domain(COMM, shape, 0.36 if shape == "square" else 1.0, mesh="structured")
    E, bound, gap = given = constants(domain, 1.5, 0.05, 0.01)
    law: Any = Tresca(bound) if friction == "tresca" else Coulomb(6 * bound)
    across = [] if shape == "square" else ["0.2*t^2*(1 - x)"]
    pulled = Dirichlet("top", ["0.5*t*(1 - t)*(1 + x)", *across, "-0.1*(1 + x)*(0.3 + t)"])
    sides = ["left", "right", *(["front", "back"] if across else [])]
    conditions = [Contact("bottom", gap=gap, friction=law), pulled, Neumann(sides)]
    problem, evolution = Elasticity(young=E, poisson=0.3, conditions=conditions), Evolution(end=1.2, steps=4)

    def J(instant: Instant) -> Any:
        u, x = instant.solution.u, ufl.SpatialCoordinate(domain.mesh)
        return instant.t * (u[0] ** 2 * (1 + x[1]) + u[0] * u[1]) * ufl.dx

    def value() -> float:
        return sum(each.solution.spaces.integrate(J(each)) for each in evolve(domain, problem, evolution))

    instants = list(evolve(domain, problem, evolution))
    states = {tuple(instant.solution.states.ravel()) for instant in instants}
    assert len(states) > 1
    at, gradients = gradient_in_time(instants, J, given)
    remainders, directions = [], directions_of(given)
    for step in (4e-3, 2e-3):
        move(given, directions, step)
        remainders.append(value() - at - step * pairing(gradients, directions))
        move(given, directions, -step)
    assert abs(remainders[1]) < 0.05 * 2e-3 * abs(pairing(gradients, directions))
    assert np.log2(remainders[0] / remainders[1]) == pytest.approx(2, abs=0.1)
