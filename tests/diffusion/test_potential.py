"""u of second order at points: its order for any κ and c, with contact, in the plane and in space."""

import numpy as np
import pytest
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Options, Signorini, Solution, solve
from signorini_fenicsx.meshes.meshing import build_domain

COMM = MPI.COMM_WORLD
U = "x*y + y*y - x*x*x"
PARTED = "(x - 0.5)*(1 + x + y)*(1 if x < 0.5 else 0.01)"
IN_SPACE = "x*y + z*z - x*x*x + y*z"
PROBLEMS = {  # of the shape: κ, u, −∇·(κ∇u), the flux through the bottom, c
    "number": ("square", 1.0, U, "6*x - 2", "-x", 0.0),
    "scalar": ("square", "1 + x", U, "(1 + x)*(6*x - 2) + 3*x*x - y", "-(1 + x)*x", "3*x"),
    "matrix": ("square", [[2, 0.5], [0.5, 1]], U, "12*x - 3", "1.5*x*x - x", 5.0),
    "jumps": ("square", "1 if x < 0.5 else 100", PARTED, "-2", "0.5 - x", 0.0),
    "cube": ("cube", [[2, 0.5, 0], [0.5, 1, 0], [0, 0, 1]], IN_SPACE, "12*x - 3", "-y", 2.0),
}


def solved(name: str, h: float, element: str) -> Solution:
    """With contact on the bottom where x < 0.44, in space 1/2."""
    shape, kappa, u, f, flux, c = PROBLEMS[name]
    end = 0.5 if shape == "cube" else 0.44
    on_bottom = Signorini("bottom", psi=f"{u} - max(x - {end}, 0)", q_S=f"{flux} - max({end} - x, 0)")
    problem = Diffusion(f=f"{f} + ({c})*({u})", kappa=kappa, c=c, u_D=u, exact=u, conditions=[on_bottom])
    domain = build_domain(COMM, shape, h, mesh="structured")
    solution: Solution = solve(domain, problem, Options(element=element))
    return solution


@pytest.mark.parametrize(("element", "order"), [("RT0", 1), ("RT1", 2)])
@pytest.mark.parametrize("name", PROBLEMS)
def test_order(name: str, element: str, order: int):
    """One order more than u_h, whatever κ and c."""
    dim = 3 if name == "cube" else 2
    coarse, fine = (solved(name, dim**0.5 / n, element).errors() for n in (12 // dim, 24 // dim))
    orders = {key: np.log2(coarse[key] / fine[key]) for key in ("u_L2", "u_potential_L2")}
    assert orders["u_potential_L2"] > {1: 1.9, 2: 2.4}[order], orders
    assert orders["u_L2"] < order + 0.1
