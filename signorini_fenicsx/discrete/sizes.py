"""The sizes of u and σ in a solution, beside which other values are rounding."""

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.tolerances import LINEAR, ROUNDING


class Sizes:
    """The largest |u| and |σ| of the last solution.

    If nothing loads the body and σ is rounding beside that of a strain by the largest gap, the body is at rest: then
    the latter is the size, beside which all is rounding.
    """

    def __init__(self, comm: MPI.Comm, lift: Array, stiffness: Array, *, loaded: bool):
        """Take the values of û that are given and of gaps, the stiffness of the sites, and whether there are loads."""
        self._comm, self._last = comm, (0.0, 0.0)
        farthest, stiffest = self.extent(np.abs(lift), stiffness)
        self._at_rest = (0.0, 0.0) if loaded else (farthest, stiffest * farthest)

    def extent(self, *values: Array) -> tuple[float, float]:
        """The largest of two kinds of values (collective)."""
        u, sigma = (float(self._comm.allreduce(one.max(initial=0.0), MPI.MAX)) for one in values)
        return u, sigma

    def take(self, displacements: Array, stresses: Array) -> None:
        """Take a solution (collective)."""
        self._last = self.extent(np.abs(displacements), np.abs(stresses))

    @property
    def largest(self) -> tuple[float, float]:
        """The sizes of u and σ."""
        (u, sigma), (gap, by_gap) = self._last, self._at_rest
        return (max(u, gap), by_gap) if sigma < LINEAR * by_gap else self._last

    @property
    def rounding(self) -> float:
        """What is rounding in tractions."""
        return ROUNDING * self.largest[1]
