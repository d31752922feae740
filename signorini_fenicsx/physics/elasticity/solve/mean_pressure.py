"""The mean pressure of each cell of an incompressible body, which elimination on cells leaves out.

A stress without a deviator, q on T and 0 elsewhere, has no energy, and is in balance. So σ is given by û but for one
number m of each cell, and this goes with one equation: ∫_∂T û·n = 0. Let a bulk modulus of 2μK hold the mean pressure
alone, with (∫tr τ)(∫tr τ')/(2μd²K|T|) added to (𝔸τ, τ'). Then

    ∫_∂T û·n = |T|/(2μK) m_T      with m_T the mean of tr σ/d on T,

and the matrix is that of an ordinary body. Now take m_T as a stress that is given, and solve again: what is left of the
flow ∫_∂T û·n falls by about K each time. That is the method of Hestenes and Powell for [S Bᵀ; B 0].
"""

from typing import Self

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.linear_traces import facet_normals
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces

BULK = 1e4
"""K."""
MOST = 12
"""Solves at most, besides the first one."""
FALLS = 4
"""What is lost falls by this factor at least; else there is no flow under these conditions, or rounding is left."""
LEAVES = 1e-3
"""What a solve by an iteration leaves, as the next one has it on its right side too."""
ENOUGH = 1e-14
"""The flow out of a cell is rounding if it is at most this share of the largest of what flows through one."""


class MeanPressure:
    """The means m of cells, which grow from solve to solve.

    Attributes:
        values: m_T of each owned cell, that part of it which û does not give.
        wanted: ∫_∂T û·n, which is 0 but for the adjoint of a functional of pressures.
        of_response: The means of the last response, which is no solution for the data.
    """

    def __init__(self, comm: MPI.Comm, out: Array, stiffness: Array):
        """Begin with none.

        Args:
            comm: Communicator.
            out: ∫_∂T q·n for the unknowns q of each owned cell, shape (cells, n).
            stiffness: 2μK/|T| of each.
        """
        self._comm, self._out, self._stiffness = comm, out, stiffness
        self.values, self.wanted, self.of_response = np.zeros((3, len(out)))

    @classmethod
    def of_traces(cls, spaces: ElasticSpaces, softness: Array, measure: Array) -> Self:
        """Those for traces that are linear on facets.

        Args:
            spaces: The spaces.
            softness: 1/2μ of each owned cell.
            measure: Their |T|.
        """
        dim = spaces.dim
        out = np.repeat(facet_normals(spaces.vertices)[:, :, None] / dim, dim, axis=2).reshape(len(measure), -1, 1)
        spaces.to_unknowns(out, np.arange(len(measure), dtype=np.int32))
        return cls(spaces.mesh.comm, out[:, :, 0], BULK / (softness * measure))

    def of(self, values: Array) -> tuple[Array, float]:
        """What û adds to the means, and the flow out of cells as a share of that through them (collective).

        Args:
            values: û in the unknowns of each cell, shape (cells, n).
        """
        flows = self._out * values
        out = flows.sum(axis=1) - self.wanted
        sizes = [float(np.abs(each).max(initial=0.0)) for each in (out, flows, self.wanted)]
        left, *most = (self._comm.allreduce(size, MPI.MAX) for size in sizes)
        return self._stiffness * out, left / max(most) if max(most) > 0 else 0.0

    def pulls(self, means: Array) -> Array:
        """∫ m q·n over the boundary of each cell for its unknowns q, shape (cells, n)."""
        return np.asarray(means[:, None] * self._out)
