"""Friction on Γ_C in the plane: the bounds of the shear at facet vertices.

|σ_t| ≤ g, and u_t = 0 where it is less; σ_t = −g where u_t > 0, σ_t = g where u_t < 0 (Tresca). Both are linear on a
facet if û_t has the basis that û_n has. So a facet vertex is a site with three states, and with bounds g_i at the
vertices such that Σ g_i φ_i ≤ g the shear is admissible on the whole facet. In Coulomb's law g is μ times the pressure,
which is not known before; see `coulomb`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.chains import Chains, joined
from signorini_fenicsx.discrete.datum import datum_of
from signorini_fenicsx.discrete.points import from_within, in_facets
from signorini_fenicsx.expressions.given import Given, parsed
from signorini_fenicsx.physics.elasticity.problem import CoulombLaw, ElasticLaw, is_normal
from signorini_fenicsx.physics.elasticity.spaces import BoundaryFacets, ElasticSpaces

STICKS = 1e300
"""The bound where nothing slips, with which Coulomb's friction starts."""
SAMPLES = 8
"""Parts of a facet at whose ends a bound that is not linear is compared with its interpolant."""


@dataclass(frozen=True)
class FrictionBounds:
    """Bounds of the shear on the facets with friction of this rank, in the order of `ElasticSpaces.rough`.

    Attributes:
        bound: g_i at their vertices, shape (facets, 2).
        mu: μ there; 0 where g is given.
        coulomb: Whether g is μ times the pressure, per facet.
        inexact: Names of data that are not linear on facets.
        by_pressure: Whether g is μ times the pressure somewhere, on any rank.
    """

    bound: Array
    mu: Array
    coulomb: Mask
    inexact: tuple[str, ...]
    by_pressure: bool

    @property
    def chains(self) -> Chains:
        """The law of each site, between u_t and σ_t."""
        return friction_chains(self.bound.ravel())

    def following(self, pressure: Array) -> FrictionBounds:
        """The bounds by Coulomb's law under this pressure at the vertices, shape (facets, 2)."""
        return self.with_bounds(self.mu * np.maximum(pressure, 0.0))

    def with_bounds(self, bound: Array) -> FrictionBounds:
        """The friction with new bounds where they are by the pressure, shape (facets, 2)."""
        return replace(self, bound=np.where(self.coulomb[:, None], bound, self.bound))

    def moved(self, step: Array) -> FrictionBounds:
        """The bounds after a step of those by the pressure; none is negative."""
        return self.with_bounds(np.maximum(self.bound + step, 0.0))

    def distance(self, other: FrictionBounds, spaces: ElasticSpaces) -> float:
        """‖g' − g‖ on Coulomb's facets (collective)."""
        change, _ = self._norms(other, spaces)
        return change

    def change(self, other: FrictionBounds, spaces: ElasticSpaces) -> float:
        """‖g' − g‖/‖g'‖ on Coulomb's facets, where g = 0 in the place of the start (collective).

        Away from the start it is 1 also if nothing is pressed, so that g' = 0.
        """
        change, size = self._norms(other, spaces)
        left = spaces.mesh.comm.allreduce(int(np.count_nonzero(self.bound >= STICKS)))
        return change / size if size > 0 else float(change > 0 or left > 0)

    def _norms(self, other: FrictionBounds, spaces: ElasticSpaces) -> tuple[float, float]:
        """‖g' − g‖ and ‖g'‖ on Coulomb's facets, where g = 0 in the place of the start (collective)."""
        before = np.where(self.bound >= STICKS, 0.0, self.bound)
        squares = [(values[self.coulomb] ** 2).sum(axis=1) for values in (other.bound - before, other.bound)]
        weights = spaces.rough.measure[self.coulomb]
        sums = spaces.mesh.comm.allreduce(np.array([weights @ values for values in squares]))
        change, size = np.sqrt(sums).tolist()
        return change, size


def friction_chains(g: Array) -> Chains:
    """The law |σ·n| ≤ g, p = 0 where it is less, at sites with these g."""
    none = np.zeros_like(g)
    return Chains.through(np.column_stack([none, none]), np.column_stack([g, -g]), none, none)


def law_of_sites(spaces: ElasticSpaces, normal: Chains, friction: FrictionBounds | None) -> Chains:
    """The law of each site of an elastic problem: in the normal direction, then friction by these bounds."""
    if friction is None:
        return normal
    number = len(spaces.sites) + len(spaces.slip_sites)
    rows = np.split(np.arange(number), [len(spaces.sites)])
    return joined(list(zip(rows, (normal, friction.chains), strict=True)), number)


def friction_bounds(spaces: ElasticSpaces, laws: Sequence[ElasticLaw]) -> FrictionBounds | None:
    """Read the laws; None if there are none (collective).

    Raises:
        InputError: If g or μ is negative or not finite somewhere, or in space.
    """
    rubbing = [(index, law) for index, law in enumerate(laws) if not is_normal(law)]
    if not rubbing:
        return None
    if spaces.dim == 3:
        raise InputError("friction: only in two dimensions")
    rough = spaces.rough
    number, order = len(rough.facets), np.argsort(rough.facets)
    coulomb = any(isinstance(law, CoulombLaw) for _, law in rubbing)
    found = FrictionBounds(np.zeros((number, 2)), np.zeros((number, 2)), np.zeros(number, dtype=bool), (), coulomb)
    inexact = []
    for index, law in rubbing:
        name = "mu" if isinstance(law, CoulombLaw) else "g"
        given = getattr(law, name)
        for part in law.parts:
            facets = spaces.part(part)
            here = order[np.searchsorted(rough.facets, facets.facets, sorter=order)]
            values, linear = _lower_values(spaces, f"law.{index}.{name}", given, facets)
            if isinstance(law, CoulombLaw):
                found.mu[here], found.bound[here], found.coulomb[here] = values, STICKS, True
            else:
                found.bound[here] = values
        inexact += [] if linear else [f"law.{index}.{name}"]
    return replace(found, inexact=tuple(inexact))


def _lower_values(spaces: ElasticSpaces, name: str, given: Given, facets: BoundaryFacets) -> tuple[Array, bool]:
    """Values at the vertices of linear functions below a datum, and whether they are the datum itself (collective)."""
    datum = datum_of(spaces, name, parsed(given, "xy", name))
    places = np.append([0.0, 1.0], np.arange(1, SAMPLES) / SAMPLES)[:, None]
    points = in_facets(spaces.mesh, facets.facets, places)
    values = datum.values(points)
    low = float(np.nan_to_num(values, nan=-np.inf, posinf=-np.inf).min(initial=np.inf))
    if spaces.mesh.comm.allreduce(low, MPI.MIN) < 0:
        raise InputError(f"{name}: must be finite and not negative everywhere on its parts")
    at_vertices = values[:, :2]
    linear = datum.polynomial is not None and datum.polynomial <= 1
    if not linear:
        values = np.maximum(from_within(datum.values, points), 0.0)
        at_vertices = values[:, :2]
        interpolant = at_vertices @ np.stack([1 - places[:, 0], places[:, 0]])
        at_vertices = np.maximum(at_vertices + np.minimum(values - interpolant, 0).min(axis=1, keepdims=True), 0.0)
    return np.take_along_axis(at_vertices, facets.ranking, axis=1), linear
