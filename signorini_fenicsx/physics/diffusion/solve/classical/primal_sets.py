"""Primal-dual active set for (VI) and semismooth Newton for (P_ε) in P1, by the loop of the set rules on vertices."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.contact.backend import Iterate, PlainBackend, SitePairs
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.loop import Parameters, iterate_sets
from signorini_fenicsx.contact.set_rules import ALGORITHM_2, ALGORITHM_3, SetRule
from signorini_fenicsx.physics.diffusion.solve.classical.primal import P1Change, P1System, not_solved
from signorini_fenicsx.physics.diffusion.solve.task import DiffusionTask

PRIMAL_DUAL = replace(ALGORITHM_2, forgets_start=False)
"""u = 0 where λ − u > 0, λ = 0 elsewhere; it starts from the solution with λ = 0."""
PENALTY = replace(ALGORITHM_3, clip=None)
"""λ = −u/ε where u ≤ 0, λ = 0 elsewhere; it starts from the solution with λ = 0. This is Newton's method for a
piecewise linear problem."""


@dataclass(frozen=True)
class VertexPairs(SitePairs):
    """u_i − ψ and λ_i − q_S at the vertices of Γ_S.

    Attributes:
        u: Values at all owned vertices, on Γ_S those of u − ψ.
    """

    u: Array


class ConformingBackend(PlainBackend):
    """A `Backend` for conforming P1, whose sites are the vertices of Γ_S that are not on Γ_D.

    Attributes:
        system: The P1 system.
        u: Its last solution, see `VertexPairs.u`.
    """

    name = P1System.name
    noun = ("vertex", "vertices")

    def __init__(self, task: DiffusionTask, contact: Condition):
        """Assemble (collective).

        Args:
            task: The problem.
            contact: Condition of the facets in contact.

        Raises:
            InputError: If PETSc refuses an option.
        """
        self.system = P1System(task.spaces, task.data)
        self.comm, self.sites, self.dofs = task.spaces.mesh.comm, len(self.system.signorini), self.system.dofs
        self.chains = Chains.at_corner(self.sites)
        self._contact, self._conductance = contact, task.data.conductance
        self._slope = 1 / task.eps if contact == Condition.ROBIN else 1.0
        self.u: Array = np.zeros_like(self.system.load)

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return self.system.solver()

    def solve(self, conditions: SiteConditions) -> VertexPairs:
        """Solve as `Backend.solve` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        system = self.system
        fixed = system.signorini[conditions.kind == Condition.ZERO_TRACE]
        robin = conditions.kind == Condition.ROBIN
        system.change_matrix(fixed=fixed, added=np.where(robin, conditions.beta * system.weights, 0.0))
        b = system.load.copy()
        b[fixed] = 0.0
        self.u = system.solve(b)
        self.u[fixed] = 0.0
        reaction = (system.times(self.u) - system.load)[system.signorini] / system.weights
        p, flux = conditions.clean(self.u[system.signorini], reaction, self._conductance)
        return VertexPairs(p=p, flux=flux, linear_iterations=1, u=self.u)

    def scales(self, iterate: VertexPairs) -> tuple[Array, Array]:
        """The largest |u|, and the λ that it would give at each vertex through the matrix diagonal (collective)."""
        largest = max(self.comm.allgather(float(np.abs(iterate.u).max(initial=0.0))))
        diagonal = self.system.diagonal[self.system.signorini]
        return np.full(self.sites, largest), largest * diagonal / self.system.weights

    def change(self, iterate: VertexPairs, before: VertexPairs) -> tuple[float, float]:
        """Norms of what changed (collective)."""
        return self._norms(iterate.u - before.u)

    @cached_property
    def _norms(self) -> P1Change:
        return P1Change(self.system)

    def places(self) -> Array:
        """Coordinates of the vertices, shape (sites, 3)."""
        return self.system.space.tabulate_dof_coordinates()[self.system.signorini]

    def in_mixed_spaces(self, iterate: VertexPairs, conditions: SiteConditions) -> tuple[Iterate, SiteConditions]:
        """The projected flux, means of u and p; facets with all vertices in contact are in contact (collective)."""
        touching = conditions.kind == self._contact
        return self.system.recover(iterate.u), self.system.conditions(touching, self._contact, self._slope)


def primal_dual_active_set(task: DiffusionTask) -> Outcome:
    """(VI) by the primal-dual active set method (collective).

    Raises:
        LinearSolveFailure: If the start cannot be solved.
    """
    return _on_vertices(task, PRIMAL_DUAL)


def primal_penalty(task: DiffusionTask) -> Outcome:
    """(P_ε) by Newton's method (collective).

    Raises:
        LinearSolveFailure: If the start cannot be solved.
    """
    return _on_vertices(task, PENALTY)


def _on_vertices(task: DiffusionTask, rule: SetRule) -> Outcome:
    """Run the loop and judge its result by the natural residual of (VI) or, with a penalty, of (P_ε) (collective)."""
    backend = ConformingBackend(task, rule.contact)
    parameters = Parameters(eps=task.eps, max_iterations=task.max_iterations)
    outcome = iterate_sets(backend, rule, parameters, on_step=task.on_step)
    residual = backend.system.residual(backend.u, 0.0 if rule.penalty is None else task.eps)
    failure = None if outcome.converged else outcome.reason
    failure = failure or not_solved(residual)
    return replace(outcome, converged=failure is None, reason=failure or outcome.reason, own_residual=residual)
