"""The linear solver of a facet system: CG with multigrid, which may give way to a factorisation; or that alone."""

import contextlib
from collections.abc import Callable, Iterator

from petsc4py import PETSc

from signorini_fenicsx.base.errors import LinearSolveFailure
from signorini_fenicsx.base.tolerances import LINEAR
from signorini_fenicsx.linear.petsc import MUMPS_WORKSPACE, LinearSolver, set_direct

TO_THE_END = LINEAR / 10
"""With `LINEAR` the certificate often needs one more solve for the balance."""


class FacetSolver[Levels](LinearSolver):
    """A solver of an SPD system. CG with multigrid starts from the present x and can stop early.

    Attributes:
        levels: What fits multigrid to the present conditions; None without multigrid.
        gives_way: Whether a factorisation would take the place of CG.
    """

    def __init__(
        self,
        matrix: PETSc.Mat,
        prefix: str,
        defaults: dict[str, str],
        make: Callable[[PETSc.PC], Levels] | None,
        most: int | None,
        tolerance: float = TO_THE_END,
    ):
        """Set defaults, then the user's options (collective).

        Args:
            matrix: Its operator.
            prefix: Prefix of its options.
            defaults: Those of multigrid, see `options_of`.
            make: Makes the preconditioner a multigrid; None if a factorisation is the default.
            most: If CG needs more iterations, it gives way to a factorisation; None if never.
            tolerance: Relative residual at which CG stops.

        Raises:
            InputError: If PETSc refuses an option.
        """
        super().__init__(matrix, prefix, defaults=MUMPS_WORKSPACE | defaults)
        self._matrix, self._remark = matrix, ""
        self._early_stop = EarlyStop()
        self.levels: Levels | None = None
        self.gives_way = make is not None and most is not None
        if make is None:
            self.factorise()
            return
        pc = self.ksp.getPC()
        self.ksp.setType("cg")
        self.ksp.setTolerances(rtol=tolerance, max_it=most)
        self.ksp.setInitialGuessNonzero(True)
        pc.setType("mg")
        levels = make(pc)
        self._take_options()
        if not self.iterates:
            self.ksp.setInitialGuessNonzero(False)
        if pc.getType() == "mg":
            self.levels = levels

    def factorise(self) -> None:
        """Factorise in all solves from now on, unless the user's options say otherwise (collective).

        Raises:
            InputError: If PETSc refuses an option.
        """
        self.levels, self.gives_way = None, False
        self.ksp = PETSc.KSP().create(self._matrix.getComm())
        self.ksp.setOperators(self._matrix)
        set_direct(self.ksp, "cholesky")
        self._take_options()

    def _take_options(self) -> None:
        self.take_options()
        if self.iterates:
            self.ksp.addConvergenceTest(self._early_stop, prepend=True)

    @contextlib.contextmanager
    def stopping(self, enough: Callable[[PETSc.Vec], bool]) -> Iterator[None]:
        """Solves stop as soon as `enough` returns True for an iterate; it is called on all ranks."""
        self._early_stop.asks = enough
        try:
            yield
        finally:
            self._early_stop.asks = None

    @property
    def share(self) -> float:
        """Iterations stop when they leave this share of what there was at their start, or come to their tolerance."""
        return self._early_stop.share

    @share.setter
    def share(self, share: float) -> None:
        self._early_stop.share = share

    @property
    def is_asked(self) -> bool:
        """Whether something else tells when solves stop, see `stopping`."""
        return self._early_stop.asks is not None

    @property
    def converged(self) -> bool:
        """Whether the last solve came to its tolerance; False too if it was that of a factorisation."""
        reason = self.ksp.getConvergedReason()
        return bool(reason > 0 and reason != PETSc.KSP.ConvergedReason.CONVERGED_ITS)

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve, and if CG fails and gives way, factorise now and from now on (collective).

        Args:
            b: Right side.
            x: Solution, and the start of an iteration.

        Raises:
            InputError: If PETSc cannot do what the user's options ask for.
            LinearSolveFailure: If the solver does not converge or PETSc gives up.
        """
        try:
            super().solve(b, x)
        except LinearSolveFailure as failure:
            if not self.gives_way:
                raise
            self.factorise()
            if not self.factorises:  # by the user's options it would be the solver that just failed
                set_direct(self.ksp, "cholesky")
            self._remark = f" because {failure}"
            super().solve(b, x)

    def name(self) -> str:
        """The name of the solver in use, and why if it took the place of CG."""
        return super().name() + self._remark


class EarlyStop:
    """A test that PETSc calls before its own test of convergence.

    It holds no reference to the backend, because PETSc would keep the backend alive.

    Attributes:
        asks: Returns whether an iterate is good enough; None while there is no such test.
        share: A norm of the residual that is at most this share of the first one is good enough.
    """

    asks: Callable[[PETSc.Vec], bool] | None = None
    share = 0.0
    _at_start = 0.0

    def __call__(self, ksp: PETSc.KSP, iteration: int, norm: float) -> PETSc.KSP.ConvergedReason:
        """Stop, or leave the decision to PETSc (collective)."""
        if iteration == 0:
            self._at_start = norm
            return PETSc.KSP.ConvergedReason.CONVERGED_ITERATING
        stop = norm < self.share * self._at_start
        if self.asks is not None:
            x = ksp.buildSolution()
            stop = self.asks(x) or stop
            x.destroy()  # only this reference; waiting for garbage collection, it would keep the solver alive
        return PETSc.KSP.ConvergedReason.CONVERGED_ITS if stop else PETSc.KSP.ConvergedReason.CONVERGED_ITERATING
