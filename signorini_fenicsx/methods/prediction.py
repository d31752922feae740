"""Sets for a large problem to start from: those of a coarser mesh, then what unfinished solves ask for.

A prediction changes the number of steps only: the loop ends where the sets repeat, wherever it starts.
"""

import contextlib
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.backends.contract import Inexact
from signorini_fenicsx.backends.hybrid import HybridBackend
from signorini_fenicsx.base import progress
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.discrete.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.contact_sets import FacetSet
from signorini_fenicsx.discrete.spaces import Spaces
from signorini_fenicsx.meshes.sampling import sampled
from signorini_fenicsx.methods.set_rules import SetRule
from signorini_fenicsx.methods.task import Coarser


@dataclass(frozen=True)
class Prediction:
    """A set rule with its parameters.

    Attributes:
        rule: The algorithm.
        rho: Its ρ.
        eps: Its ε.
        coarser: Makes coarser meshes, if there are some.
        tuning: Sizes.
    """

    rule: SetRule
    rho: float
    eps: float
    coarser: Coarser | None
    tuning: Tuning

    def wanted(self, p: Array, flux: Array) -> SiteConditions:
        """What the rule makes of p and σ·n."""
        return self.rule.following(p, flux, self.rho, self.eps)

    def is_worth_it(self, spaces: Spaces) -> bool:
        """Whether a problem is so large that it costs less than it saves."""
        return spaces.V.dofmap.index_map.size_global >= self.tuning.predict_from

    def from_coarser_mesh(self, dim: int, factor: float = 1.0) -> FacetSet | None:
        """The contact set on a mesh coarser than one that is coarser by a factor (collective).

        None if there is no such mesh, or no solution on it; in 3D, where so coarse a mesh sees too little for what it
        costs.
        """
        if self.coarser is None or dim == 3:
            return None
        factor *= self.tuning.coarsening
        with contextlib.suppress(InputError, NumericalFailure):
            spaces, data = self.coarser(factor)
            start = None
            if spaces.V.dofmap.index_map.size_global >= self.tuning.coarsen_from:
                start = self.from_coarser_mesh(dim, factor)
            backend = HybridBackend(spaces, data, tuning=self.tuning, multigrid=True, prefix="coarse_")
            if backend.inexact is None:  # by the user's options
                return None
            conditions, _ = self.settle(backend.inexact, spaces, start)
            PETSc.garbage_cleanup(spaces.mesh.comm)  # in parallel PETSc only queues what Python lets go
            return FacetSet(spaces, conditions.kind == self.rule.contact)
        return None

    def settle(self, backend: Inexact, spaces: Spaces, start: FacetSet | None) -> tuple[SiteConditions, int]:
        """Solve until the sets repeat, each time no longer than it takes to see the next sets (collective).

        Ends early where not fewer sites change than two steps before.

        Args:
            backend: Solves from its last solution.
            spaces: Its spaces.
            start: Contact set to start from, on any mesh of the same domain, instead of the algorithm's own start.

        Returns:
            The last conditions, whose solution the backend holds if they repeated, and the number of solves stopped
            early.

        Raises:
            LinearSolveFailure: If the linear solver breaks down.
        """
        comm = spaces.mesh.comm
        if start is not None:
            conditions = self.transferred(start, spaces)
        else:
            conditions = contact_without_dirichlet(spaces) or self.rule.first(len(spaces.facets), self.eps)
        changed: list[int] = []
        while len(changed) < 3 or changed[-1] < changed[-3]:
            watch = _Watch(self, conditions, comm)
            wanted = self.wanted(*backend.solve_until(conditions, watch))
            changed.append(int(wanted.changes([conditions], comm)[0]))
            progress.detail("set update", len(changed))
            if changed[-1] == 0:
                return conditions, len(changed) - 1
            conditions = self._settled_nearby(backend, spaces, conditions, wanted)
        return conditions, len(changed)

    def transferred(self, contact: FacetSet, spaces: Spaces) -> SiteConditions:
        """Conditions that belong to a contact set on another mesh of the domain (collective).

        A facet is taken to be in contact where the other mesh's facet at its midpoint is.
        """
        (sample,) = sampled([contact.indicator()], spaces.Lambda.mesh, contact.spaces.domain, degree=0)
        inside = np.rint(sample.x.array[: len(spaces.facets)])
        return self.wanted(1 - inside, inside)  # either p or σ·n is 0

    def _settled_nearby(
        self, backend: Inexact, spaces: Spaces, conditions: SiteConditions, wanted: SiteConditions
    ) -> SiteConditions:
        """Follow the sets by solves on a patch around the facets that change, if it is small (collective).

        Where σ·n and p both vanish at the edge of the contact set, that moves by single facets, each step a solve.
        """
        layers = self.tuning.layers[spaces.mesh.topology.dim]
        solve = backend.solve_near(conditions.kind != wanted.kind, layers, self.tuning.patch_share)
        if solve is None:
            return wanted
        for _ in range(self.tuning.patch_steps):
            conditions = wanted
            wanted = self.wanted(*solve(conditions))
            if wanted.changes([conditions], spaces.mesh.comm)[0] == 0:
                break
        return wanted


class _Watch:
    """Says that a solve has gone far enough: the sets it asks for are not its own and have come to rest."""

    def __init__(self, prediction: Prediction, conditions: SiteConditions, comm: MPI.Comm):
        self._prediction, self._conditions, self._comm = prediction, conditions, comm
        self._last, self._steady = conditions, 0

    def __call__(self, p: Array, flux: Array) -> bool:
        """Take note of another iterate (collective)."""
        wanted, tuning = self._prediction.wanted(p, flux), self._prediction.tuning
        changing, moved = wanted.changes([self._conditions, self._last], self._comm).tolist()
        self._last = wanted
        self._steady = self._steady + 1 if moved <= tuning.leeway * changing else 0
        return changing > 0 and self._steady >= tuning.patience


def contact_without_dirichlet(spaces: Spaces) -> SiteConditions | None:
    """Contact everywhere instead of an algorithm's own start, if that might be a Neumann problem."""
    return None if spaces.has_dirichlet else SiteConditions.everywhere(Condition.ZERO_TRACE, len(spaces.facets))
