"""PETSc's solvers with the program's defaults and the user's options; failures are raised.

An option without prefix reaches every solver of the program. An option with a prefix reaches only some, where it
overrides the one without: `facet_` the facet system, `mixed_` the saddle point, `coarse_` the facet systems of coarser
meshes, `primal_` conforming P1, `vi_` SNESVI, `newton_` SNES. Entries that are put into PETSc's database for a solver
are removed again.
"""

import contextlib
import re
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.base import progress
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, LinearSolveFailure
from signorini_fenicsx.base.signals import pass_on
from signorini_fenicsx.base.text import counted

MUMPS_WORKSPACE = {"mat_mumps_icntl_14": "100"}
"""MUMPS gets twice the workspace that it estimates: on several ranks and small meshes the estimate can be too small."""
SPARSE = 0.1
"""Share of entries that are not 0, below which right sides are sparse."""
OPTION_ERRORS = (56, 62, 63, 83, 86, 92)
"""PETSc's codes for: not supported, wrong value, out of range, unusable, unknown type, no such factorisation."""


@contextlib.contextmanager
def options_of(prefix: str, defaults: Mapping[str, str] = MUMPS_WORKSPACE) -> Iterator[None]:
    """While a solver is set up or runs, give it the user's options with this prefix as options without prefix.

    PETSc's own prefixes are not used: a solver with such a prefix does not see options without it, and some options are
    read only when PETSc factors or builds a hierarchy.

    Args:
        prefix: Such as "facet_"; empty for none.
        defaults: Options that no call can set; the user's values override them.
    """
    options = PETSc.Options()
    of_user = options.getAll()
    put = {name: value for name, value in defaults.items() if name not in of_user}
    put |= {name.removeprefix(prefix): value for name, value in of_user.items() if prefix and name.startswith(prefix)}
    for name, value in put.items():
        options.setValue(name, value or None)
        for used in (name, prefix + name):
            options.hasName(used)  # mark as used; PETSc warns of unused options at its end
    try:
        yield
    finally:
        for name in put:
            if name in of_user:
                options.setValue(name, of_user[name] or None)
            else:
                options.delValue(name)


class LinearSolver:
    """A KSP that takes the options with its prefix.

    Attributes:
        prefix: Prefix of its options.
        ksp: The solver.
    """

    def __init__(
        self,
        matrix: PETSc.Mat | None,
        prefix: str,
        comm: PETSc.Comm | None = None,
        defaults: Mapping[str, str] = MUMPS_WORKSPACE,
    ):
        """Create it, without a type (collective).

        Args:
            matrix: Its operator; None if it is set later.
            prefix: Prefix of its options.
            comm: Communicator, if there is no matrix.
            defaults: See `options_of`.
        """
        self.prefix, self._defaults = prefix, defaults
        self.ksp = PETSc.KSP().create(comm if matrix is None else matrix.getComm())
        if matrix is not None:
            self.ksp.setOperators(matrix)

    def options(self) -> contextlib.AbstractContextManager[None]:
        """While a part of it is set up, see `options_of`."""
        return options_of(self.prefix, self._defaults)

    @property
    def iterates(self) -> bool:
        """Whether the solver is a Krylov method."""
        return bool(self.ksp.getType() != "preonly")

    @property
    def factorises(self) -> bool:
        """Whether the solver is a factorisation and nothing else."""
        return not self.iterates and self.ksp.getPC().getType() in ("cholesky", "lu")

    def take_options(self) -> None:
        """Let the user's options change the defaults (collective).

        Raises:
            InputError: If PETSc refuses an option.
        """
        take_options(self.ksp, self.prefix, self._defaults)
        if self.iterates:  # preonly would compute a norm for it
            self.ksp.setMonitor(lambda ksp, number, norm: progress.detail("linear iterations", number))

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve, and raise if the solver failed (collective).

        Args:
            b: Right side.
            x: Solution, and the start if the solver takes one.

        Raises:
            InputError: If PETSc cannot do what the user's options ask for.
            LinearSolveFailure: If the solver does not converge or PETSc gives up.
        """
        with self._errors():
            self.ksp.solve(b, x)
        reason = self.ksp.getConvergedReason()
        if reason < 0:
            raise LinearSolveFailure(
                f"the linear solver {self.name()} stopped with PETSc's reason {reason} "
                f"after {counted(self.ksp.getIterationNumber(), 'iteration')}"
            )

    def solve_all(self, columns: Array) -> Array:
        """Solve with several right sides by a factorisation that there is, all at once (collective).

        On one rank MUMPS starts where a right side is not 0. That takes half the time if it is 0 nearly everywhere.

        Args:
            columns: The owned rows of the right sides, shape (owned, right sides).

        Returns:
            The owned rows of the solutions.

        Raises:
            InputError: If PETSc cannot do what the user's options ask for.
            LinearSolveFailure: If PETSc gives up.
        """
        pc, found = self.ksp.getPC(), np.empty(columns.shape, order="F")
        size = self.ksp.getOperators()[0].getSizes()[0], (PETSc.DECIDE, columns.shape[1])
        solutions = PETSc.Mat().createDense(size, array=found, comm=pc.getComm())
        alone = pc.getComm().getSize() == 1 and pc.getFactorSolverType() == "mumps"
        if alone and 0 < np.count_nonzero(columns) < SPARSE * columns.size:  # MUMPS refuses right sides without entries
            number, row = np.nonzero(columns.T)
            starts = np.searchsorted(number, np.arange(columns.shape[1] + 1)).astype(PETSc.IntType)
            entries = starts, row.astype(PETSc.IntType), columns[row, number]
            transposed = PETSc.Mat().createAIJ(columns.shape[::-1], csr=entries, comm=pc.getComm())
            with self._errors():
                pc.getFactorMatrix().matSolve(PETSc.Mat().createTranspose(transposed), solutions)
        else:
            right = PETSc.Mat().createDense(size, array=np.asfortranarray(columns), comm=pc.getComm())
            with self._errors():
                self.ksp.matSolve(right, solutions)
        return found

    def preconditioner(self) -> PETSc.PC:
        """The preconditioner, fitted to the present matrix (collective).

        Raises:
            InputError: If PETSc cannot do what the user's options ask for.
            LinearSolveFailure: If PETSc gives up.
        """
        with self._errors():
            self.ksp.setUp()
        return self.ksp.getPC()

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        """While it solves, with its options, PETSc's errors are those of the program."""
        with errors_of(self.name), self.options():
            yield

    def name(self) -> str:
        """Krylov method, preconditioner and, if there is a factorisation, its package."""
        return solver_name(self.ksp)


@contextlib.contextmanager
def errors_of(name: Callable[[], str]) -> Iterator[None]:
    """While a solver with this name runs, PETSc's errors are those of the program, and a signal ends it.

    Raises:
        InputError: If PETSc cannot do what the user's options ask for.
        LinearSolveFailure: If PETSc gives up.
    """
    try:
        yield
    except PETSc.Error as error:
        pass_on(error)
        refuse_options(error)
        raise LinearSolveFailure(f"the linear solver {name()} failed: {petsc_reason(error)}") from None


def set_direct(ksp: PETSc.KSP, factorisation: str) -> None:
    """Make a factorisation with MUMPS, "lu" or "cholesky", the default."""
    ksp.setType("preonly")
    ksp.getPC().setType(factorisation)
    ksp.getPC().setFactorSolverType("mumps")


def direct_solver(matrix: PETSc.Mat, factorisation: str, prefix: str) -> LinearSolver:
    """A solver that factors with MUMPS, "lu" or "cholesky", unless the user's options say otherwise (collective).

    Raises:
        InputError: If PETSc refuses an option.
    """
    solver = LinearSolver(matrix, prefix)
    set_direct(solver.ksp, factorisation)
    solver.take_options()
    return solver


def take_options(solver: PETSc.KSP | PETSc.SNES, prefix: str, defaults: Mapping[str, str] = MUMPS_WORKSPACE) -> None:
    """Let the user's PETSc options change a solver that has its defaults (collective).

    Args:
        solver: The solver.
        prefix: Prefix of its options.
        defaults: See `options_of`.

    Raises:
        InputError: If PETSc refuses an option.
    """
    try:
        with options_of(prefix, defaults):
            solver.setFromOptions()
    except PETSc.Error as error:
        raise InputError(f"PETSc options: {petsc_reason(error)}") from None


def snes_failure(
    snes: PETSc.SNES, solve: Callable[[], object], prefix: str, defaults: Mapping[str, str] = MUMPS_WORKSPACE
) -> str | None:
    """Let SNES solve, and say why that failed; None if it did not (collective).

    Args:
        snes: The solver.
        solve: Calls it.
        prefix: Prefix of its options.
        defaults: See `options_of`.

    Raises:
        InputError: If PETSc cannot do what the user's options ask for.
    """
    try:
        with options_of(prefix, defaults):
            solve()
    except PETSc.Error as error:
        pass_on(error)
        refuse_options(error)
        return f"PETSc: {petsc_reason(error)}"
    reason = snes.getConvergedReason()
    if reason > 0:
        return None
    return f"SNES reason {reason} after {counted(snes.getIterationNumber(), 'iteration')}"


def solver_name(ksp: PETSc.KSP) -> str:
    """Krylov method, preconditioner and, if there is a factorisation, its package."""
    pc = ksp.getPC()
    package = pc.getFactorSolverType() if pc.getType() in ("lu", "cholesky") else None
    return "+".join(part for part in (ksp.getType(), pc.getType(), package) if part)


def petsc_reason(error: PETSc.Error) -> str:
    """The sentence at the end of PETSc's stack of calls."""
    *_, last = str(error).splitlines()
    return last.partition("] ")[2] or last


def refuse_options(error: RuntimeError) -> None:
    """Raise an error of PETSc, or of DOLFINx about PETSc, as bad input if the user's options caused it.

    Raises:
        InputError: If PETSc cannot do what the user's options ask for.
    """
    told = re.search(r"PETSc error code is: (\d+), *(.*?)(\. |$)", str(error))
    code = int(told[1]) if told else getattr(error, "ierr", 0)
    if code in OPTION_ERRORS and PETSc.Options().getAll():
        reason = told[2] if told else petsc_reason(error)
        raise InputError(f"PETSc options: {reason} (PETSc's error {code})") from None
