"""The bound of viscous flow against exact flows: smooth ones, under any pressure, and where laws change."""

import dolfinx.fem
import numpy as np
import pytest
import ufl
from elastic import box, half_plane_contact
from mpi4py import MPI

from signorini_fenicsx import Dirichlet, Neumann, Outflow, Pressure, Slip, Stokes, certify, solve
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.physics.elasticity.bound.lifted import inf_sup
from signorini_fenicsx.physics.stokes.solution import StokesSolution

COMM = MPI.COMM_WORLD
MU = 0.7
POTENTIAL = ["4*x^3 - 12*x*y^2", "4*y^3 - 12*x^2*y"]
"""u = ∇φ with φ harmonic, which needs no force and no pressure: σn = 2μ∇∇φ n."""
ON_THE_RIGHT = [f"{2 * MU}*(12*x^2 - 12*y^2)", f"{-48 * MU}*x*y"]
WAVES = ["exp(x)*cos(y)", "-exp(x)*sin(y)"]


def bounded(low: list[float], high: list[float], n: int, problem: Stokes) -> tuple[StokesSolution, Certificate]:
    """A solution on a box with its certificate."""
    found = solve(box(COMM, n, low, high), problem)
    assert found.converged
    return found, certify(found)


def divergence(v: dolfinx.fem.Function) -> float:
    """‖∇·v‖/‖∇v‖ (collective)."""
    forms = (ufl.inner(each, each) * ufl.dx for each in (ufl.div(v), ufl.grad(v)))
    squares = [COMM.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form))) for form in forms]
    return (squares[0] / squares[1]) ** 0.5


@pytest.mark.parallel([1, 3])
def test_the_bound_of_a_smooth_flow_is_the_error():
    """It is guaranteed, as u_D is a cubic; what tractions do besides is in it, and a pressure of 1e6 is rounding."""
    for level in (0.0, 1e6):
        right = Neumann("x1", [f"{ON_THE_RIGHT[0]} - {level}", ON_THE_RIGHT[1]])
        problem = Stokes(MU, u_D=POTENTIAL, exact=POTENTIAL, conditions=[right])
        found, certificate = bounded([0.0, 0.0], [1.0, 1.0], 4, problem)
        assert certificate.guaranteed
        assert divergence(certificate.v) < 1e-13
        assert 0.999 < (certificate.bound - certificate.oscillation) / found.errors()["energy"] < 1.001
        assert certificate.oscillation < 0.1 * certificate.bound
        assert certificate.bound == pytest.approx(0.3214773585, rel=1e-6 if level else 1e-9)


def test_in_space():
    """Cubics on split tetrahedra are as good, and where u_D is no cubic the word goes there."""
    u = [*WAVES, "0"]
    found, certificate = bounded([0.0] * 3, [1.0] * 3, 2, Stokes(MU, u_D=u, exact=u))
    assert certificate.reservation == "u_D not in the discrete spaces"
    assert not certificate.guaranteed
    assert divergence(certificate.v) < 1e-13
    assert 1 <= certificate.bound / found.errors()["energy"] < 1.01


def test_a_velocity_that_is_no_polynomial():
    """In the plane what v lacks of it is in the bound, which stays guaranteed; not so where its means are unknown."""
    found, certificate = bounded([0.0, 0.0], [1.0, 1.0], 4, Stokes(MU, u_D=WAVES, exact=WAVES))
    assert certificate.guaranteed
    assert 1.05 < certificate.bound / found.errors()["energy"] < 1.1
    for place, known in ((0.5, True), (0.3, False)):  # at vertices, and between some
        kink = [f"(abs(y - {place}) + {2 * place - 1}*y)*(2*x - 1)^2", "0"]
        _, certificate = bounded([0.0, 0.0], [1.0, 1.0], 4, Stokes(MU, u_D=kink))
        assert certificate.guaranteed == known
        assert certificate.reservation.startswith("" if known else "u_D is not resolved near")
    equilateral = np.array([[[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)]]])
    assert inf_sup(equilateral) == pytest.approx(np.sin(np.pi / 12))


def test_loads_that_vary():
    """What y does not balance of them is half of the error; without it the bound is the error, of σ alone 1.15."""
    u = ["sin(pi*x)*cos(pi*y)", "-cos(pi*x)*sin(pi*y)"]
    f = [f"{2 * MU}*pi^2*({each})" for each in u]
    found, certificate = bounded([0.0, 0.0], [1.0, 1.0], 8, Stokes(MU, f=f, u_D=u, exact=u))
    error = found.errors()["energy"]
    assert certificate.guaranteed
    assert 0.99 < (2 * certificate.gap) ** 0.5 / error < 1
    assert 0.45 < certificate.oscillation / error < 0.5
    assert 1.1 < certificate.sigma_bound / error < 1.2


def test_where_a_law_changes_its_segment():
    """The flow is like r^(3/2) at the end of what is open; the order is nearly 1.5, that of the bound as well."""
    u, errors, bounds = [f"-({each})" for each in half_plane_contact(0.5)], [], []
    problem = Stokes(1 / 3, u_D=u, exact=u, conditions=[Outflow("y0")])
    for n, ratio in ((6, 1.3), (12, 1.1)):
        found, certificate = bounded([-1.0, 0.0], [1.0, 1.0], n, problem)
        errors.append(found.errors()["energy"])
        bounds.append(certificate.bound)
        assert 1 <= bounds[-1] / errors[-1] < ratio
    assert errors[0] / errors[1] > 2**1.4
    assert bounds[0] / bounds[1] > 2**1.4


def test_a_wall_on_which_the_fluid_slips():
    """With a threshold the flow is exact, and the bound rounding; where the viscosity varies it is guaranteed, too."""
    ends = [Pressure("x0", 2 * MU), *(Dirichlet(part, 0, components="t") for part in ("x0", "x1"))]
    _, certificate = bounded([0.0, 0.0], [1.0, 1.0], 4, Stokes(MU, conditions=[*ends, Slip("y1", g=0.3)]))
    assert certificate.guaranteed
    assert certificate.relative < 1e-7
    for velocity in (None, [0.2, 0]):
        wall = Slip("y1", g=0.3, beta=0.5, velocity=velocity)
        _, certificate = bounded([0.0, 0.0], [1.0, 1.0], 4, Stokes(MU, conditions=[*ends, wall]))
        assert certificate.guaranteed
        assert certificate.relative < 1e-7
    _, certificate = bounded([0.0, 0.0], [1.0, 1.0], 4, Stokes("1 + x*y", conditions=[*ends, Slip("y1", g=0.3)]))
    assert certificate.guaranteed
    assert certificate.relative < 0.2
