"""Predicted sets from which a large problem starts: those of a coarser mesh, then updates by solves that stop early.

A prediction changes only the number of steps. The result is the same, because the loop ends only when the sets repeat.
"""

import contextlib
from dataclasses import dataclass
from functools import partial

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base import progress
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import Backend, Inexact, Iterate
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.conditions import SiteConditions
from signorini_fenicsx.contact.history import History, reached
from signorini_fenicsx.contact.set_rules import Present, SetRule
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.methods.task import Coarser

PREDICT_FROM = 5_000
"""Number of facets of the mesh from which a prediction saves more than it costs."""
NOTHING = -1.0
"""Size of p or σ·n below which it is rounding: nothing is."""
COARSENING_IN_CELLS = 2.0
"""Mesh size of the coarser mesh of a prediction with laws in Ω, divided by that of the finer mesh."""
MOST_STEPS = 200
"""Largest number of set updates on a coarser mesh with laws in Ω."""


@dataclass(frozen=True)
class Prediction:
    """A set rule with its parameters.

    Attributes:
        rule: The algorithm.
        rho: Its ρ.
        eps: Its ε.
        coarser: Makes coarser meshes; None if there are none.
        tuning: Has the sizes from which a prediction is worth its cost.
    """

    rule: SetRule
    rho: float
    eps: float
    coarser: Coarser | None
    tuning: Tuning

    def law(self, chains: Chains) -> Chains:
        """The law of each site, changed by the penalty if there is one."""
        return self.rule.law(chains, self.eps)

    def wanted(self, law: Chains, segment: Indices, p: Array, flux: Array) -> SiteConditions:
        """The next conditions by the rule, from p and σ·n per site with each site on a segment."""
        present = Present(segment, NOTHING, NOTHING)
        return law.conditions(self.rule.following(law, p, flux, self.rho, present))

    def is_worth_it(self, spaces: MeshSpaces) -> bool:
        """Whether the problem is so large that a prediction saves more than it costs."""
        return self.tuning.predicts(spaces.facets_of_mesh, PREDICT_FROM)

    def with_laws_inside(self, spaces: MeshSpaces, factor: float = 1.0) -> Segments | None:
        """The segments on a mesh that is coarser by 2, from those on one that is coarser still (collective).

        From a cold start the edge of a set of cells, such as those on an obstacle, moves by one cell per step, so that
        the number of steps grows like 1/h. From the contact on a mesh that is coarser by 2 a few steps are left.

        Args:
            spaces: The spaces on the present mesh.
            factor: How much coarser than the problem's mesh it is.

        Returns:
            The set. None if the present mesh is small, or there is no coarser mesh or no solution on it.
        """
        if self.coarser is None or spaces.facets_of_mesh < self.tuning.predict_in_cells_from:
            return None
        factor *= COARSENING_IN_CELLS
        with contextlib.suppress(InputError, NumericalFailure):
            coarse, backend_of = self.coarser(factor)
            start = self.with_laws_inside(coarse, factor)
            backend = backend_of(False)
            law, conditions = self.law(backend.chains), self.start(coarse, backend.chains, start)
            for _ in range(MOST_STEPS):
                pairs = backend.solve(conditions)
                wanted = self.wanted(law, law.segments(conditions), pairs.p, pairs.flux)
                if wanted.same(conditions, coarse.mesh.comm):
                    break
                conditions = wanted
            PETSc.garbage_cleanup(coarse.mesh.comm)  # in parallel PETSc frees objects only here
            return Segments.of_sites(coarse, law.segments(conditions))
        return None

    def from_coarser_mesh(self, present: MeshSpaces, factor: float = 1.0) -> Segments | None:
        """The segments on a coarser mesh, from those on one that is coarser still (collective).

        Args:
            present: The spaces on the present mesh.
            factor: How much coarser than the problem's mesh it is.

        Returns:
            The set. None if the present mesh is small, or there is no coarser mesh or no solution on it, and in 3D:
            there a mesh that coarse predicts too little for its cost.
        """
        if self.coarser is None or present.mesh.topology.dim == 3:
            return None
        if present.facets_of_mesh < self.tuning.coarsen_from:
            return None
        factor *= self.tuning.coarsening
        with contextlib.suppress(InputError, NumericalFailure):
            spaces, backend_of = self.coarser(factor)
            start = self.from_coarser_mesh(spaces, factor)
            backend = backend_of(True)
            if backend.inexact is None:  # the user's options chose a direct solver
                return None
            first = self.start(spaces, backend.chains, start)
            conditions, _ = self.settle(backend, backend.inexact, spaces, first)
            PETSc.garbage_cleanup(spaces.mesh.comm)  # in parallel PETSc frees objects only here
            return Segments(spaces, self.law(backend.chains).segments(conditions))
        return None

    def settle(
        self,
        backend: Backend[Iterate],
        inexact: Inexact,
        spaces: MeshSpaces,
        conditions: SiteConditions,
        history: History | None = None,
    ) -> tuple[SiteConditions, Iterate | None]:
        """Solve until the sets repeat; each solve stops as soon as the next sets are known (collective).

        Ends early if a step changes at least as many sites as two steps before.

        Args:
            backend: The backend.
            inexact: Its solves, each from the last solution.
            spaces: Its spaces.
            conditions: Those to start from.
            history: Gets a rough step for each solve that was stopped early, except the start; None for no steps.

        Returns:
            The last conditions, and the last iterate that was stopped early if the history has it. If the sets
            repeated, the backend holds the solution under these conditions.

        Raises:
            LinearSolveFailure: If the linear solver breaks down.
        """
        comm, law = spaces.mesh.comm, self.law(backend.chains)
        changed: list[int] = []
        iterate: Iterate | None = None
        while len(changed) < 3 or changed[-1] < changed[-3]:
            watch = _Watch(self, law, conditions, comm)
            wanted = self.wanted(law, watch.segment, *inexact.solve_until(conditions, watch))
            changed.append(int(wanted.changes([conditions], comm)[0]))
            progress.detail("set update", len(changed))
            if changed[-1] == 0:
                break
            if history is not None:
                before, iterate = iterate, inexact.reached(conditions)
                if iterate is not None and before is not None:
                    with reached(partial(backend.in_mixed_spaces, iterate, conditions), history.steps):
                        change = backend.change(iterate, before)
                        spent = iterate.linear_iterations
                        history.append(conditions, change, linear_iterations=spent, rough=True)
            conditions = self._settled_nearby(inexact, spaces, law, conditions, wanted)
        return conditions, iterate

    def start(self, spaces: MeshSpaces, chains: Chains, earlier: Segments | None) -> SiteConditions:
        """The first conditions: from the segments of another mesh, or the algorithm's own start (collective)."""
        law = self.law(chains)
        if earlier is not None:
            return self.transferred(earlier, spaces, law)
        return contact_without_dirichlet(spaces, chains) or law.conditions(self.rule.first(law))

    def transferred(self, earlier: Segments, spaces: MeshSpaces, law: Chains) -> SiteConditions:
        """Conditions for the segments of another mesh of the domain (collective).

        A facet is on the segment of the other mesh's facet at its midpoint, and a cell on that of the cell there.
        """
        return law.conditions(np.minimum(earlier.on(spaces), law.count))

    def _settled_nearby(
        self, backend: Inexact, spaces: MeshSpaces, law: Chains, conditions: SiteConditions, wanted: SiteConditions
    ) -> SiteConditions:
        """Follow the sets by solves on a patch around the facets that change, if this patch is small (collective).

        Where σ·n and p both vanish at the edge of the contact set, the edge moves by one facet per step. On a patch
        such steps are cheap.
        """
        layers = self.tuning.layers[spaces.mesh.topology.dim]
        solve = backend.solve_near(conditions.differ(wanted), layers, self.tuning.patch_share)
        if solve is None:
            return wanted
        for _ in range(self.tuning.patch_steps):
            conditions = wanted
            wanted = self.wanted(law, law.segments(conditions), *solve(conditions))
            if wanted.changes([conditions], spaces.mesh.comm)[0] == 0:
                break
        return wanted


class _Watch:
    """Stops a solve once its iterates ask for other sets than its own and these hardly change any more.

    Attributes:
        segment: The segment of each site in this solve.
    """

    def __init__(self, prediction: Prediction, law: Chains, conditions: SiteConditions, comm: MPI.Comm):
        self._prediction, self._law, self._conditions, self._comm = prediction, law, conditions, comm
        self._last, self._steady = conditions, 0
        self.segment = law.segments(conditions)

    def __call__(self, p: Array, flux: Array) -> bool:
        """Look at the next iterate; return whether to stop (collective)."""
        wanted, tuning = self._prediction.wanted(self._law, self.segment, p, flux), self._prediction.tuning
        changing, moved = wanted.changes([self._conditions, self._last], self._comm).tolist()
        self._last = wanted
        self._steady = self._steady + 1 if moved <= tuning.leeway * changing else 0
        return changing > 0 and self._steady >= tuning.patience


def contact_without_dirichlet(spaces: MeshSpaces, chains: Chains) -> SiteConditions | None:
    """Contact everywhere if there is no Γ_D: an algorithm's own start may be a Neumann problem. None otherwise.

    For other laws it is the steepest segment.
    """
    return None if spaces.held else chains.conditions(chains.steepest())
