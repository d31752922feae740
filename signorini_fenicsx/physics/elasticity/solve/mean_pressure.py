"""The mean pressure of each cell of an incompressible body, which elimination on cells leaves out.

A stress without a deviator, q on T and 0 elsewhere, has no energy, and is in balance. So σ is given by û but for one
number m of each cell, and this goes with one equation: ∫_∂T û·n = 0. Let a bulk modulus of 2μK hold the mean pressure
alone, with (∫tr τ)(∫tr τ')/(2μd²K|T|) added to (𝔸τ, τ'). Then

    ∫_∂T û·n = |T|/(2μK) m_T      with m_T the mean of tr σ/d on T,

and the matrix is that of an ordinary body. Now take m_T as a stress that is given, and solve again: what is left of the
flow ∫_∂T û·n falls by about K each time. That is the method of Hestenes and Powell for [S Bᵀ; B 0].

Where a viscosity jumps by more than K, few of the flows, such as that of all of a thin fluid before a thick one, hardly
fall. Then steps are those of conjugate gradients for the means.
"""

from typing import Self

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.linear_traces import facet_normals
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces

BULK = 1e4
"""K."""
MOST = 24
"""Solves at most, besides the first one."""
FALLS, STALLS = 4, 2
"""What is lost falls by this factor in so many solves; else no flow exists under these conditions, or rounding is left.
"""
NEAR = 0.5
"""A step has the length 1 if that is nearer than this to the best one."""
BETTER = 0.5
"""Another length is taken if what is lost is then less than this share of what is lost with the length 1."""
FLAT = 1e-7
"""Flows against which this share of the stiffness acts, at most, do not change under these conditions."""
LEAVES = 1e-3
"""What a solve by an iteration leaves, as the next one has it on its right side too."""
ENOUGH = 1e-14
"""The flow out of a cell is rounding if it is at most this share of the largest of what flows through one."""


class MeansOfCells:
    """The means m of cells, which grow from solve to solve.

    Attributes:
        values: m_T of each owned cell, that part of it which û does not give.
        grown: ∫_∂T û·n by the data, that of tr ε₀ over T.
        wanted: That of the last response, which is 0 but for the adjoint of a functional of pressures.
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
        self.values, self.grown, self.wanted, self.of_response = np.zeros((4, len(out)))

    @classmethod
    def of_traces(cls, spaces: ElasticSpaces, softness: Array, measure: Array) -> Self:
        """The means for traces that are linear on facets.

        Args:
            spaces: The spaces.
            softness: 1/2μ of each owned cell.
            measure: Their |T|.
        """
        dim = spaces.dim
        out = np.repeat(facet_normals(spaces.vertices)[:, :, None] / dim, dim, axis=2).reshape(len(measure), -1, 1)
        spaces.to_unknowns(out, np.arange(len(measure), dtype=np.int32))
        return cls(spaces.mesh.comm, out[:, :, 0], BULK / (softness * measure))

    def of(self, values: Array, wanted: Array) -> tuple[Array, float]:
        """What û adds to the means, and the flow out of cells as a share of that through them (collective).

        Args:
            values: û in the unknowns of each cell, shape (cells, n).
            wanted: ∫_∂T û·n as it should be.
        """
        flows = self._out * values
        out = flows.sum(axis=1) - wanted
        sizes = [float(np.abs(each).max(initial=0.0)) for each in (out, flows, wanted)]
        left, *most = (self._comm.allreduce(size, MPI.MAX) for size in sizes)
        return self._stiffness * out, left / max(most) if max(most) > 0 else 0.0

    def search(self) -> "Search":
        """The steps of one problem."""
        return Search(self._comm, self._stiffness)

    def pulls(self, means: Array) -> Array:
        """∫ m q·n over the boundary of each cell for its unknowns q, shape (cells, n)."""
        return np.asarray(means[:, None] * self._out)


class Search:
    """The directions and lengths of steps by conjugate gradients; the means that flows ask for are its residuals."""

    def __init__(self, comm: MPI.Comm, stiffness: Array):
        """Begin.

        Args:
            comm: Communicator.
            stiffness: 2μK/|T| of each owned cell.
        """
        self._comm, self._weights = comm, 1 / stiffness
        self._means = self._way = np.zeros(len(stiffness))

    def _product(self, one: Array, other: Array) -> float:
        return float(self._comm.allreduce(float((one * other) @ self._weights)))

    def direction(self, means: Array, *, again: bool) -> Array:
        """The next direction, from what flows ask for, again after a step by which they fell little (collective)."""
        before = self._product(self._means, self._means) if again else 0.0
        share = max(self._product(means - self._means, means) / before, 0.0) if before > 0 else 0.0
        self._means, self._way = means, means + share * self._way
        return self._way

    def length(self, means: Array) -> float:
        """The length of a step, from what flows ask for after one of length 1 (collective)."""
        falls, size = self._product(self._way, self._means - means), self._product(self._way, self._way)
        best = self._product(self._means, self._way) / falls if falls > FLAT * size else 1.0
        return best if abs(best - 1) > NEAR else 1.0
