"""Periodic sides, a tied pair whose master is moved: exact states, order two, balance, bounds, ranks, refusals."""

import dolfinx.mesh
import numpy as np
import pytest
from elastic import box
from mpi4py import MPI

from signorini_fenicsx.api import Contact, Pressure
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.laws import Dirichlet, Neumann, Wall
from signorini_fenicsx.discrete.pairs import Pair, Tied
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.diffusion.problem import Diffusion
from signorini_fenicsx.physics.elasticity.problem import Elasticity
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
SIDES = Pair("left", "right", Tied(), shift=[-1, 0])


def square(n: int) -> Domain:
    """The unit square, whose left and right side are on one process."""
    at = {"left": (0, 0), "right": (0, 1), "bottom": (1, 0), "top": (1, 1)}
    parts = {name: lambda x, place=place: np.isclose(x[place[0]], place[1]) for name, place in at.items()}
    return domain_of(dolfinx.mesh.create_unit_square(COMM, n, n), parts, pairs=[("left", "right")])


@pytest.mark.parallel([1, 3])
def test_a_wave():
    """A wave, y (1 − y) sin(2πx + ½): order two, what leaves on one side comes in on the other, and a bound."""
    f, exact = "(4*pi^2*y*(1 - y) + 2)*sin(2*pi*x + 0.5)", "y*(1 - y)*sin(2*pi*x + 0.5)"
    problem = Diffusion(f=f, exact=exact, conditions=[SIDES, Dirichlet(["bottom", "top"], 0)])
    errors = []
    for n in (6, 12):
        solution = solve(square(n), problem)
        assert abs(solution.flux_through("left") + solution.flux_through("right")) < 1e-13
        assert abs(solution.flux_through("left")) > 0.9
        errors.append(solution.errors()["energy"])
    assert errors[0] > 3.7 * errors[1]
    certificate = solution.certify()
    assert certificate.guaranteed
    assert errors[1] < certificate.bound < 1.2 * errors[1]


def test_a_sheared_layer():
    """A layer with u = (y/5, 0) has no tractions to be given on its periodic sides, whose forces are opposite."""
    conditions = [SIDES, Dirichlet("bottom", 0), Dirichlet("top", [0.2, 0])]
    solution = solve(square(3), Elasticity(young=1, poisson=0.3, conditions=conditions))
    shear = 0.2 / (2 * 1.3)
    assert abs(solution.stresses - [[0, shear], [shear, 0]]).max() < 1e-13
    left, right = (np.array(solution.resultants()[name][:2]) for name in ("left", "right"))
    assert np.allclose(left, [0, -shear], atol=1e-13)
    assert np.allclose(left, -right, atol=1e-13)


def test_a_load_that_would_tip_it():
    """Periodic sides do not turn: a moment of the loads is no rigid motion, but a motion along them is one."""
    conditions = [SIDES, Dirichlet("top", 0, components="x"), Contact("bottom"), Pressure("top", "x - 0.4")]
    solution = solve(square(3), Elasticity(young=1, poisson=0.3, conditions=conditions))
    assert abs(solution.resultants()["bottom"][1] - 0.1) < 1e-12
    conditions = [SIDES, Dirichlet("bottom", 0, components="y"), Pressure("top", 0.1)]
    with pytest.raises(InputError, match=r"the body can move rigidly, along \(1, 0\)"):
        solve(square(2), Elasticity(young=1, poisson=0.3, conditions=conditions))


def test_in_space():
    """A cube with u = z and a periodic pair of sides."""
    cube = box(COMM, 2, [0.0] * 3, [1.0] * 3)
    sides = Pair("x0", "x1", Tied(), shift=[-1, 0, 0])
    solution = solve(cube, Diffusion(f=0, conditions=[sides, Dirichlet(["z0", "z1"], "z"), Neumann(["y0", "y1"], 0)]))
    assert abs(solution.flux_through("z1") - 1) < 1e-13
    assert abs(solution.flux_through("x0")) < 1e-13


@pytest.mark.parametrize(
    ("shift", "words"), [([1.0, 0.0], "no facet of the slave is covered"), ([-1.0], "shift has 1 components")]
)
def test_refused(shift: list[float], words: str):
    """What moves no side onto the other one."""
    domain, sides = square(2), Pair("left", "right", Tied(), shift=shift)
    with pytest.raises(InputError, match=words):
        solve(domain, Diffusion(f=0, conditions=[sides, Dirichlet("bottom", 0)]))


@pytest.mark.parametrize(("law", "shift"), [(Wall((), beta=1), [1, 0]), (Tied(), ["x"])])
def test_with_a_law(law: object, shift: list):
    """There are no laws between periodic sides, and a shift is a vector."""
    with pytest.raises(InputError, match="of a pair that is tied"):
        Pair("left", "right", law, shift=shift)
