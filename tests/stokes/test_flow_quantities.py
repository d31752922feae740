"""Quantities of viscous flow from both sides: exact values in intervals, conservation, what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from elastic import box
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.fenicsx import function_space
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.contact.laws import Dirichlet
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.elasticity.problem import Pressure
from signorini_fenicsx.physics.stokes.problem import Outflow, Slip, Stokes
from signorini_fenicsx.physics.stokes.solution import StokesSolution
from signorini_fenicsx.quantities import Dissipation, Flow, Flux, Force, Mean, MeanPressure, Quantity
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.evolving import evolve
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
DUCT = 0.0351443
"""The flow in a square duct of side 1 for unit pressure gradient and viscosity (Boussinesq 1868)."""


def contains(found: Quantity, value: float, width: float) -> None:
    """The interval is guaranteed, has the value, but for its last digits, and is at most so wide."""
    assert found.guaranteed, found.reason
    assert found.lower - 1e-7 * abs(value) <= value <= found.upper + 1e-7 * abs(value)
    assert found.width <= width * abs(value)


def between_pressures(drop: float, dim: int, *conditions: object) -> list:
    """What drives a straight flow along x."""
    ends = [Dirichlet(part, 0, components="t") for part in ("x0", "x1")]
    sides = [Dirichlet(part, 0, components="n") for part in ("y1", "z1")[: dim - 1]]
    return [Pressure("x0", drop), *ends, *(sides if not conditions else ()), *conditions]


def test_the_flow_in_a_duct():
    """A quarter of it, with n = 2 cells along an edge."""
    found = solve(box(COMM, 2, [0.0] * 3, [0.5] * 3), Stokes(1, conditions=between_pressures(0.5, 3)))
    contains(found.quantity(Flow("x1")), DUCT / 4, 0.05)


def test_a_channel_with_slip():
    """All is exact: u = y(11/7 − y) where the upper wall slips under the shear 0.3."""
    conditions = between_pressures(1.4, 2, Slip("y1", g=0.3))
    found = solve(box(COMM, 2, [0.0, 0.0], [1.0, 1.0]), Stokes(0.7, conditions=conditions))
    flow = 11 / 14 - 1 / 3
    contains(found.quantity(Flow("x1")), flow, 1e-6)
    with_springs = [*conditions[:-1], Slip("y1", g=0.3, beta=0.5)]  # σ_t = −0.3 − u/2, so that u = y(4/3 − y)
    navier = solve(found.spaces.domain, Stokes(0.7, conditions=with_springs))
    contains(navier.quantity(Force("y1", direction=[1, 0])), -0.3 - 0.5 / 3, 1e-6)
    contains(found.quantity(Dissipation()), 1.4 * flow - 0.3 * 4 / 7, 1e-6)  # what the pressure does, less friction


def test_the_mean_pressure_where_a_wall_slips():
    """Intervals have those of a finer mesh; in a half of the domain, with a velocity of the wall."""
    ends = [Pressure("x0", 1), *(Dirichlet(part, 0, components="t") for part in ("x0", "x1")), Dirichlet("y0", 0)]
    wall, f = Slip("y1", g=0.1, beta=2, velocity=[1, 0]), ["32*(0.5 - y)*x", "0"]
    solved = [solve(halves(n), Stokes(1, f=f, conditions=[*ends, wall])) for n in (2, 4)]
    wide, narrow = (each.quantity(MeanPressure(region="left")) for each in solved)
    assert wide.guaranteed
    assert wide.lower < narrow.lower < narrow.value < narrow.upper < wide.upper
    assert narrow.width < 0.3 * wide.width


@pytest.mark.slow
def test_the_mean_pressure_in_space():
    """In a quarter of a duct."""
    in_space = solve(box(COMM, 1, [0.0] * 3, [0.5] * 3), Stokes(1, conditions=between_pressures(0.5, 3)))
    contains(in_space.quantity(MeanPressure()), 0.25, 0.2)


def test_of_steps():
    """What problems beside a step do is forgotten in the next one; it is guaranteed, for nothing is remembered."""
    ends = [Pressure("x0", "1.4*t"), *(Dirichlet(part, 0, components="t") for part in ("x0", "x1"))]
    exact = [f"t*y*({23 / 17!r} - y)", "0"]
    problem = Stokes(0.7, exact=exact, conditions=[*ends, Slip("y1", g="0.1*t", beta=1)])
    for instant in evolve(box(COMM, 2, [0.0, 0.0], [1.0, 1.0]), problem, Evolution(end=1, steps=2)):
        assert instant.solution.errors()["energy"] < 1e-9
        assert instant.solution.after == ""
        if instant.step == 1:
            found = instant.solution.quantity(MeanPressure())
            contains(found, 0.35, 1e-6)
            assert found.value == pytest.approx(0.35, rel=1e-9)


def halves(n: int) -> Domain:
    """The square with its left half as a region."""
    domain = box(COMM, n, [0.0, 0.0], [1.0, 1.0])
    x = domain.mesh.geometry.x[domain.mesh.geometry.dofmaps[0]].mean(axis=1)[
        : domain.mesh.topology.index_map(2).size_local
    ]
    left = x[:, 0] < 0.5
    return replace(domain, regions={"left": np.flatnonzero(left), "right": np.flatnonzero(~left)})


def outlet(n: int) -> StokesSolution:
    """A force turns the flow back at an outlet, which is closed there."""
    f, inlet = ["32*(0.5 - y)*x", "0"], Dirichlet("x0", ["y*(1 - y)", 0])
    return solve(box(COMM, n, [0.0, 0.0], [1.0, 1.0]), Stokes(1, f=f, conditions=[inlet, Outflow("x1")]))


def test_intervals_have_those_of_finer_meshes():
    """They overlap and become shorter."""
    coarse, fine = outlet(2), outlet(4)
    for kind, share in ((Dissipation(), 0.6), (Mean(direction=[0, 1]), 0.4)):
        wide, narrow = coarse.quantity(kind), fine.quantity(kind)
        assert wide.guaranteed
        assert narrow.guaranteed
        assert wide.lower < narrow.upper
        assert narrow.lower < wide.upper
        assert narrow.width < share * wide.width


def test_where_there_are_none():
    """A flux of κ∇u is none of flow, and a force on a part that ends on others has no bound."""
    found = outlet(4)
    with pytest.raises(InputError, match="viscous flow has Flow, "):
        found.quantity(Flux("x1"))
    assert not np.isfinite(found.quantity(Force("y0", direction=[0, 1])).width)
    closed = solve(box(COMM, 2, [0.0, 0.0], [1.0, 1.0]), Stokes(1, conditions=[Slip("y1", beta=3, velocity=[1, 0])]))
    assert closed.quantity(MeanPressure()).reason.startswith("u_n is known on the whole boundary of the fluid, and p")


def test_a_velocity_of_another_program():
    """The distance of dev ε of any velocity is between the bounds, by quadrature here."""
    mu, u = 0.7, ["y*(1 - y)*(1 + y)", "0"]
    conditions = [Dirichlet("x0", u), Outflow("x1", tangential="held")]
    found = solve(box(COMM, 4, [0.0, 0.0], [1.0, 1.0]), Stokes(mu, f=[f"{6 * mu}*y", "0"], conditions=conditions))
    mesh = found.spaces.mesh
    v, y = fem.Function(function_space(mesh, ("Lagrange", 2, (2,)))), ufl.SpatialCoordinate(mesh)[1]
    v.interpolate(lambda x: np.stack([x[1] * (1 - x[1] ** 2), 0.1 * x[0] * x[1]]))
    off = ufl.dev(ufl.sym(ufl.grad(v - ufl.as_vector([y * (1 - y**2), 0]))))
    distance = fem.assemble_scalar(fem.form(2 * mu * ufl.inner(off, off) * ufl.dx)) ** 0.5
    bound = certify(found, v=v)
    assert bound.guaranteed
    assert bound.lower <= distance <= bound.bound < 1.5 * distance
