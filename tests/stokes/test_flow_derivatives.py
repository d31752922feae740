"""Derivatives of flows by the viscosity, loads and data of laws, of velocities and pressures, against differences."""

import numpy as np
import pytest
import ufl
from controlled import Controlled, constants
from elastic import box
from mpi4py import MPI

from signorini_fenicsx import Dirichlet, Leak, Options, Outflow, Slip, Stokes, solve
from signorini_fenicsx.base.errors import LinearSolveFailure
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.physics.stokes.solution import StokesSolution

COMM = MPI.COMM_WORLD
STEP = 1e-4


def flow(comm: MPI.Comm = COMM) -> Controlled:
    """A flow that is driven in, and by a wall, leaks through the top, and leaves by an outlet that is partly closed."""
    domain = box(comm, 4, [0.0, 0.0], [1.0, 1.0])
    mu, force, outside, least, g, inlet, slip = given = constants(domain, 1.0, 1.0, 0.3, -0.05, 0.2, 0.5, 0.05)
    x = ufl.SpatialCoordinate(domain.mesh)
    conditions = [
        Dirichlet("x0", ufl.as_vector([inlet * x[1], 0 * inlet])),
        Outflow("x1", pressure=outside, least=least),
        Leak("y1", g=g),
        Slip("y0", g=slip, beta=0.5, velocity=[0.1, 0]),
    ]
    f = ufl.as_vector([32 * force * (0.5 - x[1]) * x[0], 0 * force])
    return Controlled(domain, Stokes(mu * (1 + x[0]), f=f, conditions=conditions), list(given))


def functional(found: StokesSolution, number: int) -> ufl.Form:
    """An integral of velocities, of stresses with their pressures, or of squares of these."""
    y = ufl.SpatialCoordinate(found.spaces.split.mesh)
    if number == 0:
        return found.u[0] * ufl.sin(ufl.SpatialCoordinate(found.spaces.mesh)[1]) * ufl.dx
    weight = ufl.as_matrix([[1.0, 0.3], [0.3, 0.5 * y[0]]])
    return (ufl.inner(found.sigma, weight) if number == 1 else ufl.inner(found.sigma, found.sigma)) * ufl.dx


@pytest.mark.parametrize(("large", "directions"), [(0, 1), (10**9, 2)])
def test_gradients(large: int, directions: int):
    """By CG and by a factorisation they are central differences of solutions, along random directions of all data."""
    made, options = flow(), Options(tuning=Tuning(direct_up_to=large))
    found = solve(made.domain, made.problem, options)
    assert all(segment["vertices"] > 0 for segment in found.segments_of_parts()["x1"].values())
    gradients = [found.gradient(functional(found, number), made.controls).gradients for number in range(3)]
    rng = np.random.default_rng(large)
    for direction in rng.uniform(0.5, 1, (directions, len(made.controls))) * rng.choice([-1, 1], len(made.controls)):
        values = []
        for step in (STEP, -2 * STEP):
            for control, share in zip(made.controls, direction, strict=True):
                control.value = control.value + share * step
            beside = solve(made.domain, made.problem, options)
            values.append([beside.spaces.integrate(functional(beside, number)) for number in range(3)])
        for control, share in zip(made.controls, direction, strict=True):
            control.value = control.value + share * STEP
        differences = (np.array(values[0]) - values[1]) / (2 * STEP)
        assert [direction @ each for each in gradients] == pytest.approx(differences.tolist(), rel=1e-6, abs=1e-7)


@pytest.mark.parallel(2)
def test_gradients_on_several_ranks():
    """They are those on one, also where ranks have no facet with a law."""
    gradients = []
    for made in (flow(), flow(MPI.COMM_SELF)):
        found = solve(made.domain, made.problem)
        gradients.append(found.gradient(functional(found, 1), made.controls).gradients)
    assert gradients[0] == pytest.approx(gradients[1], rel=1e-9)


def test_the_change_of_a_solution():
    """The change along a direction of the data is a difference, in pressures as well."""
    made = flow()
    found = solve(made.domain, made.problem)
    change = found.derivative({made.controls[0]: 1.0, made.controls[4]: 0.5})
    sides = []
    for sign in (1, -1):
        for control, share in ((0, 1.0), (4, 0.5)):
            made.controls[control].value += sign * STEP * share * (1 if sign > 0 else 2)
        sides.append(solve(made.domain, made.problem))
    off = (sides[0].sigma.x.array - sides[1].sigma.x.array) / (2 * STEP) - change.sigma.x.array
    assert np.abs(off).max() < 1e-5 * np.abs(change.sigma.x.array).max()


def test_a_pressure_that_is_known_up_to_a_constant():
    """In a closed box there is no derivative of it, but of differences of pressures."""
    domain = box(COMM, 4, [0.0, 0.0], [1.0, 1.0])
    (lid,) = constants(domain, 1.0)
    conditions = [Dirichlet("y1", ufl.as_vector([lid, 0 * lid])), Dirichlet(["x0", "x1", "y0"], 0)]
    found = solve(domain, Stokes(1, conditions=conditions))
    y = ufl.SpatialCoordinate(found.spaces.split.mesh)
    J = ufl.tr(found.sigma) * (y[0] - 0.5) * ufl.dx
    assert found.gradient(J, [lid]).gradients[0] == pytest.approx(found.spaces.integrate(J), rel=1e-9)
    with pytest.raises(LinearSolveFailure, match="up to a constant"):
        found.gradient(ufl.tr(found.sigma) * ufl.dx, [lid])
