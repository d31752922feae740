"""GMRES for matrices that are known by their products."""

from collections.abc import Callable

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.linear.petsc import errors_of, solver_name

EXACT = 1e-8
"""GMRES stops at this share of the right side."""
DIRECTIONS = 200
"""Steps of GMRES at most."""

type Product = Callable[[Array], Array]


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
    most: int = DIRECTIONS,
) -> tuple[Array, int, bool]:
    """Solve with a matrix that is known by its products to a share of the right side (collective).

    Returns:
        The solution, or how far so many steps come, the number of steps, and whether they have reached the share.

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
    solver.setType("gmres" if precondition is None else "fgmres")  # which preconditions once less
    solver.setGMRESRestart(restart)
    solver.getPC().setType("none")
    if precondition is not None:
        solver.getPC().setType("python")
        solver.getPC().setPythonContext(_Product(precondition))
        solver.setPCSide(PETSc.PC.Side.RIGHT)
    solver.setTolerances(rtol=share, max_it=most)
    with errors_of(lambda: solver_name(solver)):
        solver.solve(b, x)
    solution = np.array(x.array_r), solver.getIterationNumber(), solver.getConvergedReason() > 0
    for each in (solver, matrix, b, x):
        each.destroy()
    return solution
