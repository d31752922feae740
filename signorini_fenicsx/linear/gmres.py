"""GMRES for matrices that are known by their products, and for a matrix with some of its rows added to others."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.linear.petsc import errors_of, solver_name

EXACT = 1e-8
"""GMRES stops at this share of the right side."""
DIRECTIONS = 200
"""Steps of GMRES at most."""
RESTART = 50
"""Steps after which GMRES with a matrix begins anew, for the sake of memory."""

type Product = Callable[[Array], Array]
type Added = tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], Array]


class _Product:
    """What PETSc asks of a matrix and of a preconditioner."""

    def __init__(self, product: Product):
        self._product = product

    def mult(self, _matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        y.array_w[:] = self._product(np.array(x.array_r))

    apply = mult


def gmres(
    comm: MPI.Comm,
    product: Product,
    right: Array,
    precondition: Product | None = None,
    restart: int = DIRECTIONS,
    share: float = EXACT,
) -> tuple[Array, int]:
    """Solve with a matrix that is known by its products to a share of the right side (collective).

    Returns:
        The solution, or how far `DIRECTIONS` steps come, and the number of steps.

    Raises:
        LinearSolveFailure: If PETSc gives up.
    """
    b = PETSc.Vec().createMPI((len(right), PETSc.DETERMINE), comm=comm)
    b.array_w[:] = right
    x = b.duplicate()
    matrix = PETSc.Mat().createPython((b.getSizes(), b.getSizes()), _Product(product), comm=comm)
    matrix.setUp()
    solver = PETSc.KSP().create(comm)
    solver.setOperators(matrix)
    solver.setType("gmres")
    solver.setGMRESRestart(restart)
    solver.getPC().setType("none")
    if precondition is not None:
        solver.getPC().setType("python")
        solver.getPC().setPythonContext(_Product(precondition))
        solver.setPCSide(PETSc.PC.Side.RIGHT)
    solver.setTolerances(rtol=share, max_it=DIRECTIONS)
    with errors_of(lambda: solver_name(solver)):
        solver.solve(b, x)
    solution = np.array(x.array_r), solver.getIterationNumber()
    for each in (solver, matrix, b, x):
        each.destroy()
    return solution


def coupled(
    matrix: PETSc.Mat,
    natural: PETSc.Mat,
    preconditioner: PETSc.PC,
    load: Array,
    held: npt.NDArray[np.int32],
    added: Added,
    start: PETSc.Vec,
    share: float,
    least: float,
) -> tuple[int, bool]:
    """Solve with 0 at unknowns that are held, where rows of the matrix have shares of other rows added (collective).

    Args:
        matrix: The matrix with the conditions.
        natural: The matrix without conditions, which has the rows that are added.
        preconditioner: One for the matrix with the conditions.
        load: The right side, of the owned unknowns.
        held: Those that are held.
        added: Owned rows, what rows are added to them, which may be held, and their shares.
        start: Where GMRES starts, with 0 at unknowns that are held; gets the solution.
        share: GMRES leaves this share of what there is at its start,
        least: or this share of the right side.

    Returns:
        The number of steps, and whether no more than the least share is left.

    Raises:
        LinearSolveFailure: If PETSc gives up.
    """
    rows, others, shares = added
    x, image = matrix.createVecs()

    def product(values: Array) -> Array:
        x.array_w[:] = values
        matrix.mult(x, image)
        image_values = np.array(image.array_r)
        natural.mult(x, image)
        image_values[rows] += shares * image.array_r[others]
        return image_values

    def precondition(values: Array) -> Array:
        x.array_w[:] = values
        preconditioner.apply(x, image)
        return np.array(image.array_r)

    load = load.copy()
    load[held] = 0.0
    left = load - product(start.array_r)
    left[held] = 0.0
    comm = matrix.getComm().tompi4py()
    size, at_start = np.sqrt(comm.allreduce(np.array([load @ load, left @ left]))).tolist()
    if at_start <= least * size:
        return 0, True
    enough = least * size / at_start
    step, steps = gmres(comm, product, left, precondition, RESTART, max(share, enough))
    start.array_w[:] = start.array_r + step
    return steps, share <= enough and steps < DIRECTIONS
