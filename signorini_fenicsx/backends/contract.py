"""What the active-set loop needs from a discretisation: one linear solve under given facet conditions."""

import re
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.discrete.conditions import FacetConditions
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.spaces import Spaces

type Array = npt.NDArray[np.float64]


MUMPS_WORKSPACE = "mat_mumps_icntl_14"
"""PETSc's name for the part of the estimate, in per cent, that is added to it."""


OPTION_ERRORS = (56, 62, 63, 83, 86, 92)
"""PETSc's codes for: not supported, wrong value, out of range, unusable, unknown type, no such factorisation."""


@dataclass(frozen=True)
class Iterate:
    """Solution of one linear mixed problem. Functions hold owned and up-to-date ghost values.

    Attributes:
        sigma: Flux in RT0.
        u: Scalar in P0.
        p: Trace above its bound, p − ψ, per Γ_S facet of this rank.
        flux: Flux above its bound, σ·n − q_S, per Γ_S facet of this rank.
        linear_iterations: Iterations of the Krylov solver; 1 for a direct one.
    """

    sigma: fem.Function
    u: fem.Function
    p: Array
    flux: Array
    linear_iterations: int


class LinearSolveFailure(NumericalFailure):
    """A Krylov or direct solver of PETSc gave up."""


def set_direct(ksp: PETSc.KSP, factorisation: str) -> None:
    """Factor with MUMPS, "lu" or "cholesky", unless the user's options say else."""
    ksp.setType("preonly")
    ksp.getPC().setType(factorisation)
    ksp.getPC().setFactorSolverType("mumps")


def direct_solver(matrix: PETSc.Mat, factorisation: str) -> PETSc.KSP:
    """A solver that factors with MUMPS, "lu" or "cholesky", unless the user's options say else (collective).

    Raises:
        InputError: If PETSc refuses an option.
    """
    ksp = PETSc.KSP().create(matrix.getComm())
    ksp.setOperators(matrix)
    set_direct(ksp, factorisation)
    take_options(ksp)
    return ksp


def take_options(solver: PETSc.KSP | PETSc.SNES) -> None:
    """Let the user's PETSc options change a solver that has its defaults (collective).

    MUMPS gets twice the workspace that it estimates, which on several ranks and small meshes is sometimes too little.

    Raises:
        InputError: If PETSc refuses an option.
    """
    options = PETSc.Options()
    if not options.hasName(MUMPS_WORKSPACE):
        options[MUMPS_WORKSPACE] = 100
        options.hasName(MUMPS_WORKSPACE)  # or PETSc complains at its end where nobody has asked for it
    try:
        solver.setFromOptions()
    except PETSc.Error as error:
        raise InputError(f"PETSc options: {petsc_reason(error)}") from None


def solve_linear(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
    """Solve and make sure of it (collective).

    Args:
        ksp: The linear solver.
        b: Right side.
        x: Solution, and the start if the solver takes one.

    Raises:
        InputError: If PETSc does not know what its options ask for.
        LinearSolveFailure: If the solver does not converge or PETSc gives up.
    """
    try:
        ksp.solve(b, x)
    except PETSc.Error as error:
        refuse_options(error)
        raise LinearSolveFailure(f"the linear solver {solver_name(ksp)} failed: {petsc_reason(error)}") from None
    reason = ksp.getConvergedReason()
    if reason < 0:
        raise LinearSolveFailure(
            f"the linear solver {solver_name(ksp)} stopped with PETSc's reason {reason} "
            f"after {ksp.getIterationNumber()} iterations"
        )


def solver_name(ksp: PETSc.KSP) -> str:
    """Krylov method, preconditioner and, if it factors, the package that does."""
    pc = ksp.getPC()
    package = pc.getFactorSolverType() if pc.getType() in ("lu", "cholesky") else None
    return "+".join(part for part in (ksp.getType(), pc.getType(), package) if part)


def petsc_reason(error: PETSc.Error) -> str:
    """The sentence at the end of PETSc's stack of calls."""
    *_, last = str(error).splitlines()
    return last.partition("] ")[2] or last


def refuse_options(error: RuntimeError) -> None:
    """Say that an error, raised by PETSc or by DOLFINx for it, is one of the user's options, if it is one.

    Raises:
        InputError: If PETSc does not know what its options ask for.
    """
    told = re.search(r"PETSc error code is: (\d+), *(.*?)(\. |$)", str(error))
    code = int(told[1]) if told else getattr(error, "ierr", 0)
    if code in OPTION_ERRORS and PETSc.Options().getAll():
        reason = told[2] if told else petsc_reason(error)
        raise InputError(f"PETSc options: {reason} (PETSc's error {code})") from None


class Backend(Protocol):
    """A discretisation of the mixed Poisson problem, set up once, that accepts facet conditions."""

    name: str
    spaces: Spaces
    data: Data
    dofs: int
    """Number of unknowns of its linear system."""

    def solve(self, conditions: FacetConditions) -> Iterate:
        """Solve with these conditions on Γ_S, u = u_D on Γ_D, σ·n = g_N on Γ_N (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        ...

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        ...
