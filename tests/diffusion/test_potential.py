"""u of second order at points: its order for any κ and c, with contact, in the plane and in space."""

import numpy as np
import pytest
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Signorini, Solution, solve
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


def solved(name: str, h: float) -> Solution:
    """With contact on the bottom where x < 0.44."""
    shape, kappa, u, f, flux, c = PROBLEMS[name]
    on_bottom = Signorini("bottom", psi=f"{u} - max(x - 0.44, 0)", q_S=f"{flux} - max(0.44 - x, 0)")
    problem = Diffusion(f=f"{f} + ({c})*({u})", kappa=kappa, c=c, u_D=u, exact=u, conditions=[on_bottom])
    solution: Solution = solve(build_domain(COMM, shape, h, mesh="structured"), problem)
    return solution


@pytest.mark.parametrize("name", PROBLEMS)
def test_order(name: str):
    """Order 2, whatever κ and c, beside that of u_h."""
    dim = 3 if name == "cube" else 2
    coarse, fine = (solved(name, dim**0.5 / n).errors() for n in (16 // dim, 32 // dim))
    orders = {key: np.log2(coarse[key] / fine[key]) for key in ("u_L2", "u_potential_L2")}
    assert orders["u_potential_L2"] > 1.94, orders
    assert orders["u_L2"] < 1.1
