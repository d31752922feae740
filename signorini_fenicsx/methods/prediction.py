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
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.discrete.chains import Chains
from signorini_fenicsx.discrete.conditions import SiteConditions
from signorini_fenicsx.discrete.contact_sets import FacetSegments
from signorini_fenicsx.discrete.spaces import Spaces
from signorini_fenicsx.meshes.sampling import sampled
from signorini_fenicsx.methods.set_rules import SetRule
from signorini_fenicsx.methods.task import Coarser


@dataclass(frozen=True)
class Prediction:
    """A set rule with its parameters.

    Attributes:
        rule: The algorithm.
        rho: Its ρ, None for that of the law.
        eps: Its ε.
        coarser: Makes coarser meshes, if there are some.
        tuning: Sizes.
    """

    rule: SetRule
    rho: float | None
    eps: float
    coarser: Coarser | None
    tuning: Tuning

    def law(self, chains: Chains) -> Chains:
        """The law that the sites get in the end."""
        return self.rule.law(chains, self.eps)

    def wanted(self, law: Chains, p: Array, flux: Array) -> SiteConditions:
        """What the rule makes of p and σ·n."""
        return law.conditions(self.rule.following(law, p, flux, self.rho))

    def is_worth_it(self, spaces: Spaces) -> bool:
        """Whether a problem is so large that it costs less than it saves."""
        return spaces.V.dofmap.index_map.size_global >= self.tuning.predict_from

    def from_coarser_mesh(self, dim: int, factor: float = 1.0) -> FacetSegments | None:
        """The segments on a mesh coarser than one that is coarser by a factor (collective).

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
            conditions, _ = self.settle(backend.inexact, spaces, backend.chains, start)
            PETSc.garbage_cleanup(spaces.mesh.comm)  # in parallel PETSc only queues what Python lets go
            return FacetSegments(spaces, self.law(backend.chains).segments(conditions))
        return None

    def settle(
        self, backend: Inexact, spaces: Spaces, chains: Chains, start: FacetSegments | None
    ) -> tuple[SiteConditions, int]:
        """Solve until the sets repeat, each time no longer than it takes to see the next sets (collective).

        Ends early where not fewer sites change than two steps before.

        Args:
            backend: Solves from its last solution.
            spaces: Its spaces.
            chains: The law of each facet.
            start: Segments to start from, on any mesh of the same domain, instead of the algorithm's own start.

        Returns:
            The last conditions, whose solution the backend holds if they repeated, and the number of solves stopped
            early.

        Raises:
            LinearSolveFailure: If the linear solver breaks down.
        """
        comm, law = spaces.mesh.comm, self.law(chains)
        if start is not None:
            conditions = self.transferred(start, spaces, law)
        else:
            conditions = contact_without_dirichlet(spaces, chains) or law.conditions(self.rule.first(law))
        changed: list[int] = []
        while len(changed) < 3 or changed[-1] < changed[-3]:
            watch = _Watch(self, law, conditions, comm)
            wanted = self.wanted(law, *backend.solve_until(conditions, watch))
            changed.append(int(wanted.changes([conditions], comm)[0]))
            if changed[-1] == 0:
                return conditions, len(changed) - 1
            conditions = self._settled_nearby(backend, spaces, law, conditions, wanted)
        return conditions, len(changed)

    def transferred(self, earlier: FacetSegments, spaces: Spaces, law: Chains) -> SiteConditions:
        """Conditions that belong to segments on another mesh of the domain (collective).

        A facet is taken to be on the segment that the other mesh's facet at its midpoint is on.
        """
        (sample,) = sampled([earlier.function()], spaces.Lambda.mesh, earlier.spaces.domain, degree=0)
        segment = np.rint(sample.x.array[: len(spaces.facets)])
        return law.conditions(np.clip(segment, 0, law.count).astype(np.int8))

    def _settled_nearby(
        self, backend: Inexact, spaces: Spaces, law: Chains, conditions: SiteConditions, wanted: SiteConditions
    ) -> SiteConditions:
        """Follow the sets by solves on a patch around the facets that change, if it is small (collective).

        Where σ·n and p both vanish at the edge of the contact set, that moves by single facets, each step a solve.
        """
        layers = self.tuning.layers[spaces.mesh.topology.dim]
        solve = backend.solve_near(conditions.differ(wanted), layers, self.tuning.patch_share)
        if solve is None:
            return wanted
        for _ in range(self.tuning.patch_steps):
            conditions = wanted
            wanted = self.wanted(law, *solve(conditions))
            if wanted.changes([conditions], spaces.mesh.comm)[0] == 0:
                break
        return wanted


class _Watch:
    """Says that a solve has gone far enough: the sets it asks for are not its own and have come to rest."""

    def __init__(self, prediction: Prediction, law: Chains, conditions: SiteConditions, comm: MPI.Comm):
        self._prediction, self._law, self._conditions, self._comm = prediction, law, conditions, comm
        self._last, self._steady = conditions, 0

    def __call__(self, p: Array, flux: Array) -> bool:
        """Take note of another iterate (collective)."""
        wanted, tuning = self._prediction.wanted(self._law, p, flux), self._prediction.tuning
        changing, moved = wanted.changes([self._conditions, self._last], self._comm).tolist()
        self._last = wanted
        self._steady = self._steady + 1 if moved <= tuning.leeway * changing else 0
        return changing > 0 and self._steady >= tuning.patience


def contact_without_dirichlet(spaces: Spaces, chains: Chains) -> SiteConditions | None:
    """Contact everywhere instead of an algorithm's own start, if that might be a Neumann problem.

    Under other laws than that of Signorini it is the steepest segment.
    """
    return None if spaces.has_dirichlet else chains.conditions(chains.steepest())
