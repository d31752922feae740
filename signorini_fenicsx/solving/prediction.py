"""Facet sets for a large problem to start from: those of a coarser mesh, then what unfinished solves ask for.

A prediction changes the number of steps only: the active-set loop ends where the sets repeat, wherever it starts.
"""

import contextlib
from collections.abc import Callable

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.backends.contract import Array
from signorini_fenicsx.backends.hybrid import HybridBackend
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.cases.discretisation import discrete_data, mesh_case
from signorini_fenicsx.discrete.conditions import Condition, FacetConditions
from signorini_fenicsx.discrete.contact_sets import FacetSet
from signorini_fenicsx.discrete.spaces import Spaces, build_spaces
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.sampling import sampled
from signorini_fenicsx.methods.registry import Algorithm, By

type Rule = Callable[[Array, Array], FacetConditions]

PREDICT_FROM = 60_000
"""Facets of the mesh from which the sets are predicted; below, a cold start takes tenths of a second."""
COARSENING = 4.0
"""Mesh size of the coarser mesh, in multiples of the finer one's."""
COARSEN_FROM = 30000
"""Facets of a coarser mesh from which it gets a prediction itself; below, its own mesh costs more than it saves."""
PATIENCE = 2
"""Iterations of the linear solver over which the sets it asks for must stand still."""
LEEWAY = 0.05
"""Share of the facets that want to change which may still waver then: where many change, the next solve sees to it."""
LAYERS = {2: 32, 3: 4}
"""Cells, by dimension, between a facet that changes and the edge of the patch on which the sets then settle."""
PATCH_SHARE = 0.02
"""Share of all unknowns up to which a patch costs little beside a step of the solver."""
PATCH_STEPS = 10
"""Set updates on a patch at most; where the sets move on for longer, they leave the patch."""


def worth_predicting(case: Case, algorithm: Algorithm, spaces: Spaces) -> bool:
    """Whether the case wants its sets predicted and is large enough."""
    large = spaces.V.dofmap.index_map.size_global >= PREDICT_FROM
    return large and case.solve.predict and algorithm.by is By.SETS


def rule_of(case: Case, algorithm: Algorithm) -> Rule:
    """The algorithm's rule with the parameters of a case."""
    rho, eps = case.solve.rho or 1.0, case.solve.eps
    return lambda p, flux: algorithm.next_conditions(p, flux, rho, eps)


def predicted_sets(case: Case, algorithm: Algorithm, comm: MPI.Comm) -> FacetSet | None:
    """The contact set of a case on a coarser mesh, which is predicted likewise (collective).

    None if there is no such mesh, or no solution on it.
    """
    coarse = case.with_values({"solve.h": COARSENING * case.solve.h})
    with contextlib.suppress(InputError, NumericalFailure):
        domain = mesh_case(coarse, comm)
        contact = _solved_sets(coarse, algorithm, domain)
        PETSc.garbage_cleanup(domain.mesh.comm)  # in parallel PETSc only queues what Python lets go
        return contact
    return None


def _solved_sets(case: Case, algorithm: Algorithm, domain: Domain) -> FacetSet:
    """The contact set of a case on its mesh (collective)."""
    spaces = build_spaces(domain, case.boundary.signorini, case.boundary.neumann)
    start = None
    if spaces.V.dofmap.index_map.size_global >= COARSEN_FROM:
        start = predicted_sets(case, algorithm, domain.mesh.comm)
    backend = HybridBackend(spaces, discrete_data(case, spaces), multigrid=True)
    conditions, _ = settle_sets(backend, algorithm, case, start)
    return FacetSet(spaces, conditions.kind == algorithm.contact)


def settle_sets(
    backend: HybridBackend, algorithm: Algorithm, case: Case, start: FacetSet | None
) -> tuple[FacetConditions, int]:
    """Solve until the sets repeat, each time no longer than it takes to see the next sets (collective).

    Ends early where not fewer facets change than two steps before.

    Args:
        backend: Solves from its last solution.
        algorithm: Start and rule.
        case: Its parameters.
        start: Contact set to start from, on any mesh of the same domain, instead of the algorithm's own start.

    Returns:
        The last conditions, whose solution the backend holds if they repeated, and the number of solves stopped early.

    Raises:
        LinearSolveFailure: If the linear solver breaks down.
    """
    spaces, rule = backend.spaces, rule_of(case, algorithm)
    comm = spaces.mesh.comm
    conditions = (
        transferred(start, spaces, rule)
        if start
        else contact_without_dirichlet(spaces) or algorithm.cold_start(len(spaces.facets), case.solve.eps)
    )
    changed: list[int] = []
    while len(changed) < 3 or changed[-1] < changed[-3]:
        watch = _Watch(conditions, rule, comm)
        wanted = rule(*backend.solve_until(conditions, watch))
        changed.append(int(wanted.changes([conditions], comm)[0]))
        if changed[-1] == 0:
            return conditions, len(changed) - 1
        conditions = _settled_nearby(backend, conditions, wanted, rule)
    return conditions, len(changed)


def contact_without_dirichlet(spaces: Spaces) -> FacetConditions | None:
    """Contact everywhere instead of an algorithm's own start, if that might be a Neumann problem."""
    if spaces.has_dirichlet:
        return None
    return FacetConditions(np.full(len(spaces.facets), Condition.ZERO_TRACE, dtype=np.int8))


def transferred(contact: FacetSet, spaces: Spaces, rule: Rule) -> FacetConditions:
    """Conditions that belong to a contact set on another mesh of the domain (collective).

    A facet is taken to be in contact where the other mesh's facet at its midpoint is.
    """
    (sample,) = sampled([contact.indicator()], spaces.Lambda.mesh, contact.spaces.domain, degree=0)
    inside = np.rint(sample.x.array[: len(spaces.facets)])
    return rule(1 - inside, inside)  # either p or σ·n is 0


class _Watch:
    """Says that a solve has gone far enough: the sets it asks for are not its own and have come to rest."""

    def __init__(self, conditions: FacetConditions, rule: Rule, comm: MPI.Comm):
        self._conditions, self._rule, self._comm = conditions, rule, comm
        self._last, self._steady = conditions, 0

    def __call__(self, p: Array, flux: Array) -> bool:
        """Take note of another iterate (collective)."""
        wanted = self._rule(p, flux)
        changing, moved = wanted.changes([self._conditions, self._last], self._comm).tolist()
        self._last = wanted
        self._steady = self._steady + 1 if moved <= LEEWAY * changing else 0
        return changing > 0 and self._steady >= PATIENCE


def _settled_nearby(
    backend: HybridBackend, conditions: FacetConditions, wanted: FacetConditions, rule: Rule
) -> FacetConditions:
    """Follow the sets by solves on a patch around the facets that change, if it is small (collective).

    Where σ·n and p both vanish at the edge of the contact set, that moves by single facets, each step a solve.
    """
    spaces = backend.spaces
    patch = backend.patch(conditions.kind != wanted.kind, LAYERS[spaces.mesh.topology.dim])
    if patch.size > PATCH_SHARE * backend.dofs:
        return wanted
    for _ in range(PATCH_STEPS):
        conditions = wanted
        wanted = rule(*backend.solve_on(patch, conditions))
        if wanted.changes([conditions], spaces.mesh.comm)[0] == 0:
            break
    return wanted
