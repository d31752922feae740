"""A problem linearised at its solution: what is the same for all physics.

Under the segments of their laws that the sites are on, a discrete problem is linear. Its change with the data, and the
adjoint state of a functional, are solutions of the same system. A physics says what is seen of its data, and solves
(`solved`, `by`). What moves values of û, loads or lines of laws is linear in the numbers that are seen, see `Effect`.

A biactive site, on a corner of its law, moves along one of the two rays of the moved corner. Which one is found like
the sets of a solution, by Algorithm 1 on the change, see `TangentProblem`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from mpi4py import MPI
from ufl import Form

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.contact.backend import Backend, PlainBackend, SitePairs
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions
from signorini_fenicsx.contact.loop import settled_change
from signorini_fenicsx.discrete.datum import DEGREES, Datum
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, LinearTraces, linear_values
from signorini_fenicsx.discrete.seen import Seen, moments_seen, values_seen
from signorini_fenicsx.discrete.vertex_laws import VertexLaws, law_degree, law_points, lines_by_data

type Solved = tuple[Array, Array, Any]
"""p and the flux of each site, and the change that has them."""


@dataclass(frozen=True)
class Effect:
    """What the numbers that are seen of a datum make: other numbers, linear in them.

    Attributes:
        kind: What these are: "line" for the lines of laws, one number per site, see `Linearised.lines`.
        seen: The numbers that are seen, a of them at each of n places.
        places: Where the others are, shape (n, k).
        matrices: What they are, shape (n, k, a).
    """

    kind: str
    seen: Seen
    places: Indices
    matrices: Array

    def add(self, numbers: Array, changes: Array) -> None:
        """Add the change with these changes of what is seen, in place."""
        moments = changes.reshape(len(self.places), self.matrices.shape[2])
        numbers[self.places] += np.einsum("nka,na->nk", self.matrices, moments)

    def sensitivities(self, by: Array) -> Array:
        """The derivatives of something by what is seen, from those by the numbers."""
        derivatives: Array = np.einsum("nka,nk->na", self.matrices, by[self.places])
        return derivatives.ravel()


class Linearised(ABC):
    """A problem linearised at its solution.

    Attributes:
        seen: The numbers that the discrete problem sees of each datum that is given in UFL, by its name in messages.
        biactive: Mask of the sites on a corner of their law.
        refusal: What a site is called that has no derivative, and why it has none.
    """

    refusal: tuple[str, str]

    def __init__(self, solution: Any, backend: Any, law: Chains, tolerance: float):
        """Take a solution and what solves under its conditions (collective).

        Args:
            solution: The solution.
            backend: The backend.
            law: The law of each site.
            tolerance: Sites whose p and σ·n are on a corner of their law, but for this share of their sizes, are
                biactive.

        Raises:
            InputError: If a datum is seen in a way that has no derivative.
        """
        self._solution, self._backend, self._law = solution, backend, law
        self._spaces, self._data = solution.spaces, solution.data
        self._conditions, iterate = solution.outcome.conditions, solution.outcome.iterate
        self._held: Mask = self._conditions.kind == Condition.ZERO_TRACE
        self._segment = law.segments(self._conditions, (iterate.p, iterate.flux))
        self._beside = self._sides(tolerance)
        self.biactive: Mask = self._beside != 0
        self._effects = dict(self.effects()) | dict(self.lines(self._segment))
        self.seen = dict(self.plain()) | {name: effect.seen for name, effect in self._effects.items()}

    @abstractmethod
    def plain(self) -> Iterator[tuple[str, Seen]]:
        """What is seen and makes no other numbers, by the names of data (collective)."""

    def effects(self) -> Iterator[tuple[str, Effect]]:
        """What the data make besides lines (collective)."""
        yield from ()

    @abstractmethod
    def lines(self, segment: Indices) -> Iterator[tuple[str, Effect]]:
        """What the data of laws make, among it lines, if sites are on these segments (collective).

        A line moves by the change of u where it is vertical, elsewhere by that of σ·n at the present u.
        """

    @abstractmethod
    def by(self, J: Form, besides: Any) -> dict[str, Array]:
        """The derivatives of J by what is seen and plain, and by the numbers that are made, see `adjoint`."""

    def largest(self, p: Array, flux: Array) -> tuple[Array, Array]:
        """The largest sizes of what are like p and σ·n, for all sites; 1 where it is 0 (collective)."""
        comm, sites = self._spaces.mesh.comm, self._backend.sites
        of_p, of_flux = (comm.allreduce(np.abs(each).max(initial=0.0), MPI.MAX) for each in (p, flux))
        return np.full(sites, of_p if of_p > 0 else 1.0), np.full(sites, of_flux if of_flux > 0 else 1.0)

    @abstractmethod
    def scales(self) -> tuple[Array, Array]:
        """Sizes > 0 of p and σ·n at the sites (collective)."""

    def places(self) -> Array:
        """Where the biactive sites of this rank are, shape (sites, dim): by default vertices of facets."""
        return np.asarray(self._backend.places()[self.biactive, : self._spaces.mesh.geometry.dim])

    def refused(self, _chains: Chains) -> Mask:
        """The biactive sites that have no derivative along these rays."""
        return np.zeros(len(self.biactive), dtype=bool)

    def _sides(self, tolerance: float) -> Indices:
        """Which way the other segment is of each site that is on a corner; 0 at other sites (collective)."""
        iterate = self._solution.outcome.iterate
        return self._law.beside(self._segment, iterate.p, iterate.flux, self.scales(), tolerance)

    def adjoint(self, J: Form, besides: Any = None) -> dict[str, Array]:
        """The derivatives of J by all numbers that are seen, but for where the data stand in J itself (collective).

        Args:
            J: What is differentiated.
            besides: The derivatives of what is differentiated besides, see `Steps.functional` of `solving.evolution`;
                None if nothing is.

        Returns:
            They, and those by what is in no datum, such as what earlier steps in time have left.
        """
        by = self.by(J, besides)
        return by | {name: effect.sensitivities(by[effect.kind]) for name, effect in self._effects.items()}

    def settled(self, changes: Mapping[str, Array], solve: Callable[[SiteConditions, Indices], Solved]) -> Any:
        """The change that `solve` gives when the biactive sites have chosen their rays (collective).

        Args:
            changes: The changes of what is seen.
            solve: Solves for the change under conditions; it also gets the segments of all sites.

        Raises:
            InputError: If a biactive site has no derivative.
            NumericalFailure: If the sets of biactive sites do not settle.
        """
        lower, upper = (self._segment + pick(self._beside, 0) for pick in (np.minimum, np.maximum))
        chains = rays(*(self._moved(changes, segment) for segment in (lower, upper)))
        masks = self.biactive, self.refused(chains)
        number, refused = self._spaces.mesh.comm.allreduce(
            np.array([np.count_nonzero(mask) for mask in masks])
        ).tolist()
        if refused > 0:
            noun, why = self.refusal
            raise InputError(f"derivative: {counted(refused, noun)} {why}")

        def solved(conditions: SiteConditions) -> Solved:
            return solve(conditions, np.where(chains.segments(conditions) == 1, upper, lower))

        tangent = TangentProblem(self._backend, chains, solved)
        start = chains.conditions((self._beside < 0).astype(np.int64))
        settled_change(tangent, start, number, self._solution.options.max_iterations)
        return tangent.found

    def _moved(self, changes: Mapping[str, Array], segment: Indices) -> tuple[Array, Array]:
        """The slopes of lines, and how they move (collective)."""
        values = np.zeros(len(segment))
        for name, effect in self.lines(segment):
            if effect.kind == "line":
                effect.add(values, changes[name])
        return np.take_along_axis(self._law.slope, segment[:, None], axis=1)[:, 0], values


def to_values(facets: BoundaryFacets) -> Array:
    """The matrices from moments to the values of linear functions at the vertices, shape (facets, d, d)."""
    return linear_values(units(facets), facets.measure)


def units(facets: BoundaryFacets) -> Array:
    """A unit matrix for each facet, shape (facets, d, d)."""
    dim = facets.vertices.shape[1]
    return np.broadcast_to(np.eye(dim), (len(facets.facets), dim, dim))


def by_moments(
    spaces: LinearTraces,
    name: str,
    kind: str,
    datum: Datum,
    facets: BoundaryFacets,
    places: AnyIndices,
    matrices: Array,
    degree: int = DEGREES[0] + 1,
) -> Iterator[tuple[str, Effect]]:
    """What the moments of a datum over facets make, part by part, if it is given in UFL (collective).

    Args:
        spaces: The spaces.
        name: Name of the datum.
        kind: Of the effect.
        datum: The datum.
        facets: The facets.
        places: As in `Effect`, those of each facet.
        matrices: Likewise.
        degree: Of the quadrature by which the discrete problem has them.
    """
    for number, (chosen, part) in enumerate(datum.by_facets(facets.facets)):
        if part.pieces is None:
            seen = moments_seen(spaces, part, facets.take(np.flatnonzero(chosen)), min(degree, DEGREES[1]))
            yield f"{name}.{number}", Effect(kind, seen, places[chosen].astype(np.int64), matrices[chosen])


class HybridLinearised(Linearised):
    """A problem linearised at its solution by a hybrid system."""

    @abstractmethod
    def _by_changes(self, changes: Mapping[str, Array]) -> tuple[Any, ...]:
        """The right sides that `HybridSystem.respond` takes, for changes of what is seen (collective)."""

    @abstractmethod
    def _solved(self, numbers: Mapping[str, Array], conditions: SiteConditions, segment: Indices) -> Solved:
        """The traces of the change on these segments, for these numbers (collective)."""

    def _lines(
        self, laws: VertexLaws, present: tuple[Indices, Array], penalty: Callable[[Chains], Chains] = lambda each: each
    ) -> Iterator[tuple[str, Effect]]:
        """What data of laws in points make of lines at vertices of facets, see `lines_by_data` (collective)."""
        spaces = self._spaces
        for part in laws.of_parts:
            points, facets = law_points(spaces, part), spaces.contact.take(part.rows)
            sites, degree = spaces.dim * part.rows[:, None] + np.arange(spaces.dim), law_degree(part)
            for name, lines in lines_by_data(spaces, part, points, present, penalty):
                seen = values_seen(spaces, part.data[name], facets, points, degree)
                yield part.key(name), Effect("line", seen, sites, lines)

    def _responded(self, numbers: Mapping[str, Array], changes: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """What a hybrid system gives for changes: σ and u as it recovers them, and its unknowns (collective).

        Args:
            numbers: Of each kind of effect, "load" among them; changed in place.
            changes: Of what is seen.
        """
        system = self._backend.system
        for name, effect in self._effects.items():
            if effect.kind in numbers:
                effect.add(numbers[effect.kind], changes[name])

        def solve(load: Array) -> Array:
            numbers["load"] += load
            return np.asarray(system.everywhere(self.settled(changes, partial(self._solved, numbers))))

        sigma, u, x = system.respond(*self._by_changes(changes), solve=solve)
        return sigma, u, x


class TangentProblem(PlainBackend):
    """The problem that the change of a solution solves, as a backend: its sites are on lines or two rays from a corner.

    Attributes:
        found: The change of the last solve.
    """

    name = "tangent"

    def __init__(self, backend: Backend[Any], chains: Chains, solve: Callable[[SiteConditions], Solved]):
        """Take the backend of the problem, the rays of the sites, and what solves for the change."""
        self.noun, self.comm, self.sites, self.dofs = backend.noun, backend.comm, backend.sites, backend.dofs
        self.solver, self.places = backend.solver, backend.places
        self.chains, self._solve, self.found = chains, solve, None

    def solve(self, conditions: SiteConditions) -> SitePairs:
        """Solve as `Backend.solve` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        p, flux, self.found = self._solve(conditions)
        return SitePairs(p=p, flux=flux, linear_iterations=1)

    def scales(self, iterate: SitePairs) -> tuple[Array, Array]:
        """The largest of both over all sites, see `Backend.scales` (collective)."""
        of_p, of_flux = (
            np.full(self.sites, self.comm.allreduce(np.abs(each).max(initial=0.0), MPI.MAX))
            for each in (iterate.p, iterate.flux)
        )
        return of_p, of_flux

    def change(self, iterate: SitePairs, before: SitePairs) -> tuple[float, float]:
        """Norms of what changed at the sites (collective)."""
        squares = [((one - other) ** 2).sum() for one, other in ((iterate.flux, before.flux), (iterate.p, before.p))]
        of_flux, of_p = np.sqrt(self.comm.allreduce(np.array(squares))).tolist()
        return of_flux, of_p


def rays(first: tuple[Array, Array], last: tuple[Array, Array]) -> Chains:
    """Chains of the two rays that meet where two lines do, u = value where the slope is ∞, else flux + slope·u = value.

    Two equal lines are one.

    Args:
        first: Slopes and values of the lines before the corner.
        last: Those of the lines beyond it.
    """
    (before, one), (beyond, other) = first, last
    steep = np.isinf(before), np.isinf(beyond)
    rise, fall = np.where(steep[0], 0.0, before), np.where(steep[1], 0.0, beyond)
    bend = np.where(steep[0] | steep[1], 0.0, rise - fall)
    u = np.where(steep[0], one, np.where(steep[1], other, 0.0))
    u = np.where(bend == 0, u, (one - other) / np.where(bend == 0, 1.0, bend))
    flux = np.where(steep[0], np.where(steep[1], 0.0, other - fall * u), one - rise * u)
    return Chains.through(u[:, None], flux[:, None], before, beyond)
