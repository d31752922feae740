"""Projected successive over-relaxation for (VI) in P1, in parallel: vertices of one colour at a time.

Vertices of one colour share no matrix entry, so relaxing all of them at once is the same as relaxing one after another.
The colours come from a greedy walk over the vertices in the order of their coordinates, so that colours and iterates do
not depend on the ranks.
"""

import math
from functools import partial

import numpy as np
import numpy.typing as npt
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse.linalg import eigsh

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.parallel import on_root, on_root_only
from signorini_fenicsx.base.tolerances import STEP
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.physics.diffusion.solve.classical.gathered import RootRows, matrix_on_root
from signorini_fenicsx.physics.diffusion.solve.classical.primal import P1History, P1System, primal_outcome
from signorini_fenicsx.physics.diffusion.solve.task import DiffusionTask


def over_relaxation(task: DiffusionTask) -> Outcome:
    """u_i ← u_i − ω(Au − b)_i/A_ii, cut off at 0 on Γ_S, vertex by vertex, from u = 0 off Γ_D (collective).

    ω = 2/(1 + √(1 − μ²)) is Young's optimal value, with μ the spectral radius of Jacobi's iteration without contact.
    With it the number of sweeps is of order 1/h, instead of 1/h² for ω = 1.
    """
    system = P1System(task.spaces, task.data)
    sweep = _Sweep(system, *_colours_and_omega(system))
    details = {"omega": sweep.omega, "colours": float(sweep.colours)}
    u = np.zeros_like(system.load)
    u[system.dirichlet] = system.load[system.dirichlet]

    def conditions(u: Array) -> SiteConditions:
        return system.conditions(u[system.signorini] == 0, Condition.ZERO_TRACE)

    history = P1History(task, system, u, conditions(u))
    failure = None
    while (residual := system.residual(u)) > STEP:
        if len(history.steps) == task.max_iterations:
            failure = f"the natural residual is {residual:.1e} after {task.max_iterations} sweeps"
            break
        u = sweep(u)
        history.add(u, conditions(u))
    return primal_outcome(
        system,
        history,
        u,
        conditions(u),
        failure,
        reason="the natural residual is small",
        solver=f"SOR, {sweep.colours} colours",
        details=details,
    )


class _Sweep:
    """One sweep over all vertices, colour after colour."""

    def __init__(self, system: P1System, colour: npt.NDArray[np.int64], omega: float):
        """Cut the matrix into the rows of each colour (collective)."""
        self.omega = omega
        self.colours = int(system.spaces.mesh.comm.allreduce(int(colour.max(initial=-1)), MPI.MAX)) + 1
        offsets, columns, values = system.matrix.getValuesCSR()
        needed, local = np.unique(columns, return_inverse=True)
        rows = scipy.sparse.csr_array((values, local, offsets), shape=(len(colour), len(needed)))
        lower = np.full(len(colour), -np.inf)
        lower[system.signorini] = 0.0
        members = [np.flatnonzero(colour == index) for index in range(self.colours)]
        self._parts = [(one, rows[one], system.load[one], system.diagonal[one], lower[one]) for one in members]
        self._x = system.matrix.createVecRight()
        self._seen = PETSc.Vec().createSeq(len(needed), comm=MPI.COMM_SELF)
        self._scatter = PETSc.Scatter().create(
            self._x, PETSc.IS().createGeneral(needed, comm=MPI.COMM_SELF), self._seen, None
        )

    def __call__(self, u: Array) -> Array:
        """The next iterate (collective)."""
        u = u.copy()
        for colour, rows, load, diagonal, lower in self._parts:
            self._x.array_w[:] = u
            self._scatter.scatter(self._x, self._seen)
            residual = rows @ self._seen.array_r - load
            u[colour] = np.maximum(lower, u[colour] - self.omega * residual / diagonal)
        return u


def _colours_and_omega(system: P1System) -> tuple[npt.NDArray[np.int64], float]:
    """The colour of each owned vertex, and ω; both are computed on rank 0 (collective)."""
    rows = RootRows(system.spaces.mesh.comm, len(system.load))
    x = rows.gather(system.space.tabulate_dof_coordinates()[: len(system.load)])
    matrix = matrix_on_root(system.matrix)
    colour = on_root_only(rows.comm, partial(_greedy_colours, matrix, x))
    return rows.scatter(colour), on_root(rows.comm, partial(_omega, matrix))


def _omega(matrix: scipy.sparse.csr_array | None) -> float:
    """ω from the spectral radius of Jacobi's method (rank 0)."""
    assert matrix is not None
    scaling = scipy.sparse.diags_array(1 / np.sqrt(matrix.diagonal()))
    scaled, start = scaling @ matrix @ scaling, np.ones(matrix.shape[0])
    smallest = eigsh(scaled, 1, which="SA", tol=1e-2, v0=start, return_eigenvectors=False)[0]
    return 2 / (1 + math.sqrt(1 - (1 - smallest) ** 2))


def _greedy_colours(matrix: scipy.sparse.csr_array | None, x: Array | None) -> npt.NDArray[np.int64]:
    """Give one vertex after another, in the order of places x, the first colour that no neighbour has (rank 0)."""
    assert matrix is not None
    assert x is not None
    neighbours = np.split(matrix.indices, matrix.indptr[1:-1])
    colour = np.full(len(neighbours), -1)
    for vertex in np.lexsort(np.round(x, 10).T):
        taken = colour[neighbours[vertex]]
        colour[vertex] = np.setdiff1d(np.arange(len(taken) + 1), taken)[0]
    return colour
