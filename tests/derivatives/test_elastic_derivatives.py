"""Derivatives through elastic contact: Taylor remainders of all data, with friction by Tresca and Coulomb; ranks."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import ufl
from mpi4py import MPI
from test_derivatives import Controlled, constants, directions_of, function, move, pairing

from signorini_fenicsx import (
    Contact,
    Coulomb,
    Dirichlet,
    Elasticity,
    Neumann,
    Regulator,
    Solver,
    Tresca,
    TwoSided,
    Wall,
    solve,
)
from signorini_fenicsx.contact.laws import Corners
from signorini_fenicsx.discrete.seen import parts_of
from signorini_fenicsx.meshes.meshing import build_domain

COMM = MPI.COMM_WORLD


def block(comm: MPI.Comm, friction: str, plane: str = "strain") -> Controlled:
    """A block pressed and pushed onto a curved foundation."""
    domain = build_domain(comm, "square", 0.36, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    E, nu, gap, push, force, traction, bound = given = constants(domain, 1.5, 0.3, 0.02, 0.3, -0.1, 0.2, 0.12)
    stiffness = function(domain, lambda x: 1 + 0.3 * x[0])
    laws: dict[str, Any] = {"tresca": Tresca(bound * (1 + x[0])), "coulomb": Coulomb(2 * bound * (1 + x[0]))}
    conditions = [
        Contact("bottom", gap=gap * (1 + 60 * (x[0] - 0.5) ** 2), friction=laws.get(friction)),
        Dirichlet("top", [push * x[0], -push * (1 + 0.2 * x[0])]),
        Neumann("left", [0.1 * traction, 0]) if friction else Dirichlet("left", [0.1 * push * x[1], 0], components="n"),
        Neumann("right", [traction * x[1] ** 3, -0.3 * traction]),
    ]
    problem = Elasticity(
        young=E * stiffness, poisson=nu * (1 - 0.2 * x[1]), f=[0.1, force * x[0]], plane=plane, conditions=conditions
    )
    return Controlled(domain, problem, [*given, stiffness] if friction else [*given[:-1], stiffness])


def on_laws(comm: MPI.Comm, law: str) -> Controlled:
    """A block that a sloping displacement presses onto something with a law, and tears off it."""
    domain = build_domain(comm, "square", 0.36, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    E, a, b, c, gap, push = constants(domain, 1.5, 0.04, 0.1, 3.0, 0.02, 0.3)
    level = function(domain, lambda x: 0.02 * x[0], ("P", 1))
    wall = Wall("bottom", beta=c * (1 + x[0]), level=a + level)
    joint = TwoSided("bottom", psi_upper=0.5 * a + 0.3 * level, psi=-b - level, q_S=0.5 * a)
    regulator = Regulator("bottom", k=c, g_low=-a, g_high=4 * a * (1 + x[0]), a=0.1 * a + level)
    layer = Corners("bottom", [(0, 5 * a), (b, a + level), (1.5 * b, 0)], before="vertical", beyond=c * a)
    steps = Corners("bottom", [(-b, 4 * a), (-b, a), (-0.5 * b, level)])
    own, given = {
        "wall": (wall, [a, c]),
        "joint": (joint, [a, b]),
        "regulator": (regulator, [a, c]),
        "layer": (layer, [a, b, c]),
        "steps": (steps, [a, b]),
    }[law]
    conditions = [
        own,
        Dirichlet("top", [push * 0.2 * x[0], -push * (1 - 1.2 * x[0])]),
        Neumann(["left", "right"]),
    ]
    problem = Elasticity(young=E, poisson=0.3, conditions=conditions)
    boundary, posed = problem.on(domain)
    return Controlled(domain, (boundary, replace(posed, gap=gap * (1 + x[0] ** 2))), [E, gap, push, *given, level])


def in_space(comm: MPI.Comm, friction: str) -> Controlled:
    """A cube that is pressed and turned on a foundation."""
    domain = build_domain(comm, "cube", 0.9, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    E, nu, bound, push = given = constants(domain, 1.5, 0.3, 0.02, 0.1)
    law: Any = Tresca(bound * (1 + x[0])) if friction == "tresca" else Coulomb(10 * bound * (1 + x[0]))
    conditions = [
        Contact("bottom", gap=0.1 * bound * (1 + x[0] ** 2), friction=law),
        Dirichlet("top", [push * x[1], push * 0.3, -push * (1 + 0.2 * x[0])]),
        Neumann(["left", "right", "front", "back"]),
    ]
    return Controlled(domain, Elasticity(young=E, poisson=nu, conditions=conditions), given)


def functional(given: Controlled, solution: Any) -> Any:
    """Something of σ and u, and of a control."""
    x, y = ufl.SpatialCoordinate(given.domain.mesh), ufl.SpatialCoordinate(solution.sigma.function_space.mesh)
    sigma, u = solution.sigma, solution.u
    J = sigma[0, 1] * sigma[1, 1] * (1 + y[0]) * ufl.dx + 0.3 * ufl.tr(sigma) * y[1] * ufl.ds
    return J + (u[0] * u[1] + given.controls[0] * u[0] * x[1]) * ufl.dx + u[1] ** 2 * ufl.ds


PROBLEMS: dict[str, Callable[[MPI.Comm], Controlled]] = {
    "none": lambda comm: block(comm, ""),
    "stress": lambda comm: block(comm, "", "stress"),
    "tresca": lambda comm: block(comm, "tresca"),
    "coulomb": lambda comm: block(comm, "coulomb"),
    **{law: partial(on_laws, law=law) for law in ("wall", "joint", "regulator", "layer", "steps")},
    "tresca in space": lambda comm: in_space(comm, "tresca"),
    "coulomb in space": lambda comm: in_space(comm, "coulomb"),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_taylor(name: str):
    """The remainder has order 2: the gradient is that of the discrete problem."""
    given = PROBLEMS[name](COMM)
    solver = Solver(given.domain, given.problem)
    solution = solver.solve(given.problem)
    states = np.unique(solution.outcome.conditions.kind)
    assert len(states) > 1
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


@pytest.mark.parallel(3)
@pytest.mark.parametrize("name", ["coulomb", "regulator"])
def test_ranks(name: str):
    """Value and derivatives do not depend on the number of ranks."""
    found = []
    for comm in (COMM, MPI.COMM_SELF):
        given = PROBLEMS[name](comm)
        solution = solve(given.domain, given.problem)
        value, gradients = solution.gradient(functional(given, solution), given.controls)
        numbers = [gradient for gradient in gradients if not isinstance(gradient, np.ndarray)]
        found.append([value, pairing(gradients, directions_of(given.controls)), *numbers])
    assert found[0] == pytest.approx(found[1], rel=1e-8, abs=1e-10)
