"""Counts the linear problems of columns of the 12 soils of Carsel and Parrish (1988) over time.

Usage: python scripts/soil_columns.py [SOIL …]

A column is 1 m high, in metres and days. Drained: it is saturated, and the head at the bottom falls to 0. Rain: over a
water table at the bottom, with water at rest at first, rain of half of K until 0.1 m have fallen. Evaporation: the
same, with 5 mm a day taken from the top as long as the pressure head there is above -100 m. For each the table has the
mean and the largest number of linear problems per step, how many steps were halved, and the largest error of mass.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import sys

import dolfinx
import numpy as np
from mpi4py import MPI
from soils import SOILS

from signorini_fenicsx import Diffusion, Dirichlet, Evolution, Neumann, NumericalFailure, Signorini, domain_of, evolve
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.diffusion.soils import VanGenuchten

PER_DAY = 0.24
"""One cm/h in m/day."""
LAYERS, STEPS = 20, 20
BESIDE = Neumann(["left", "right"], 0)


def scenarios(K: float) -> dict[str, tuple[float, float, list[Law]]]:
    """The days, the head at first and the conditions of each."""
    taken, given = Signorini("top", psi=-99, q_S=-0.005), Neumann("top", K / 2)
    return {
        "drained": (2.0, 1.0, [BESIDE, Neumann("top", 0), Dirichlet("bottom", 0)]),
        "rain": (0.2 / K, 0.0, [BESIDE, given, Dirichlet("bottom", 0)]),
        "evaporation": (20.0, 0.0, [BESIDE, taken, Dirichlet("bottom", 0)]),
    }


def column() -> Domain:
    """A column of LAYERS squares, each of two triangles."""
    width = 1 / LAYERS
    mesh = dolfinx.mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (width, 1)], [1, LAYERS])
    sides = {"bottom": (1, 0.0), "top": (1, 1.0), "left": (0, 0.0), "right": (0, width)}
    return domain_of(mesh, {name: lambda x, i=i, at=at: np.isclose(x[i], at) for name, (i, at) in sides.items()})


def row(name: str, what: str) -> str:
    """What one column takes."""
    alpha, n, k, theta_r, theta_s = SOILS[name]
    K = PER_DAY * k
    end, first, conditions = scenarios(K)[what]
    problem = Diffusion(kappa=VanGenuchten(K, alpha, n, theta_r, theta_s), f=0, conditions=conditions)
    solves, halved, balance = [], 0, 0.0
    try:
        for step in evolve(column(), problem, Evolution(end, STEPS, initial=first)):
            solves.append(step.numbers["linear_solves"])
            halved += step.numbers["parts"] > 1
            balance = max(balance, step.numbers["mass_error"])
    except NumericalFailure as failure:
        return f"fails in step {len(solves) + 1}: {failure}"
    return f"{np.mean(solves):.1f}, {max(solves)}, {halved} halved, mass to {balance:.0e}"


for name in sys.argv[1:] or SOILS:
    for what in scenarios(1.0):
        sys.stdout.write(f"{name:16} {what:12} {row(name, what)}\n")
        sys.stdout.flush()
