"""Problems in time: rates and bounds in h and τ, the steady end, any method, ranks, cost of steps, bad input."""


import numpy as np
from mpi4py import MPI

from signorini_fenicsx.discrete.evolution import Evolution
from signorini_fenicsx.discrete.problem import Problem
from signorini_fenicsx.meshes.domain import Boundary, Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.solving.evolving import evolve
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solution import Solution

COMM = MPI.COMM_WORLD
BOTTOM = Boundary(["bottom"])
PLUS, MINUS = "max(x - 0.3 - 0.4*t, 0)", "max(0.3 + 0.4*t - x, 0)"
U = f"{PLUS}^3 - y*{MINUS}^3"
MOVING = Problem(f=f"-1.2*({PLUS}^2 + y*{MINUS}^2) - 6*({PLUS} - y*{MINUS})", u_D=U, exact=U)
"""On y = 0 contact for x < 0.3 + 0.4 t; capacity 1."""
START = "max(x - 0.3, 0)^3 - y*max(0.3 - x, 0)^3"


def square(h: float) -> Domain:
    return build_domain(COMM, "square", h, mesh="structured")


def moving(h: float, steps: int, scheme: str = "implicit-euler", **options: object) -> Solution:
    """The moving transition at t = 1."""
    evolution = Evolution(end=1.0, steps=steps, initial=START, scheme=scheme)
    *_, last = evolve(square(h), BOTTOM, MOVING, evolution, Options(**options))
    return last.solution


def difference(one: Solution, other: Solution) -> float:
    """‖u − u'‖ on one mesh."""
    change = one.u.x.array - other.u.x.array
    return float(np.sqrt(COMM.allreduce(one.spaces.cell_measures @ change**2)))


def test_orders_in_space():
    """Order 1 in σ, u and p with τ = h, and errors below their bounds; the transition within some facets."""
    errors = []
    for h in (1 / 8, 1 / 16, 1 / 32):
        found = moving(h, round(1 / h)).errors()
        assert "div_sigma_L2" not in found
        assert found["contact_hausdorff"] < 3 * h
        errors.append([found[name] / h for name in ("sigma_L2", "u_L2", "p_L2")])
    errors = np.array(errors)
    assert np.all(errors < [0.27, 0.055, 0.016])
    assert np.all(np.log2(errors[:-1] / errors[1:]) > -0.06)


def test_orders_in_time():
    """On one mesh, against many steps: order 1 of implicit Euler, order 2 of BDF2, and their sizes."""
    best = moving(1 / 8, 256, "bdf2")
    for scheme, order, bound in (("implicit-euler", 0.9, 2e-3), ("bdf2", 1.7, 1e-3)):
        errors = [difference(moving(1 / 8, steps, scheme), best) for steps in (4, 8, 16)]
        assert errors[0] < bound
        assert np.all(np.log2(np.array(errors[:-1]) / errors[1:]) > order), (scheme, errors)
