"""Quantities of the exact solution, proved from both sides.

>>> from mpi4py import MPI
>>> from signorini_fenicsx import Diffusion, Signorini, solve
>>> from signorini_fenicsx.meshes.meshing import build_domain
>>> square = build_domain(MPI.COMM_WORLD, "square", 0.1, mesh="structured")
>>> solution = solve(square, Diffusion(f=-10, conditions=[Signorini("bottom", psi=-0.1)]))
>>> mean = solution.quantity(Mean())
>>> mean.guaranteed, mean.lower < mean.value < mean.upper, round(mean.value, 2)
(True, True, -0.36)
"""

from signorini_fenicsx.quantities.bracket import Quantity
from signorini_fenicsx.quantities.kinds import (
    Dissipation,
    Energy,
    Flow,
    Flux,
    Force,
    Integral,
    Kind,
    Mean,
    MeanPressure,
    Moment,
)

__all__ = [
    "Dissipation",
    "Energy",
    "Flow",
    "Flux",
    "Force",
    "Integral",
    "Kind",
    "Mean",
    "MeanPressure",
    "Moment",
    "Quantity",
]
