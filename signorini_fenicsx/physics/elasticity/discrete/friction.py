"""Friction on Γ_C: the bounds of the shear at facet vertices.

|σ_t| ≤ g, and u_t = 0 where it is less; σ_t = −g where u_t > 0, σ_t = g where u_t < 0 (Tresca). Both are linear on a
facet if û_t has the basis that û_n has. So a facet vertex is a site with three states, and with bounds g_i at the
vertices such that Σ g_i φ_i ≤ g the shear is admissible on the whole facet. In Coulomb's law μ times the pressure is
added, which is not known before; see `coulomb`. In space σ_t = −g u_t/|u_t| where u_t ≠ 0, which `slipping` makes
linear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.discrete.datum import Datum, datum_of
from signorini_fenicsx.discrete.lattices import lattice
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets
from signorini_fenicsx.discrete.points import from_within, in_facets
from signorini_fenicsx.discrete.vertex_laws import VertexLaws, shared_compliance
from signorini_fenicsx.expressions.given import Given, parsed
from signorini_fenicsx.physics.elasticity.conditions import CoulombLaw, is_normal
from signorini_fenicsx.physics.elasticity.discrete.joints import SpringsAlong
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.discrete.tools import Tool
from signorini_fenicsx.physics.elasticity.problem import GivenVector

STICKS = 1e300
"""The bound where nothing slips, with which Coulomb's friction starts."""
LONGEST = 1e3
"""Springs along a joint give way at the start by no more than this, in lengths of the domain."""
SAMPLES = 8
"""Parts of a facet at whose ends a bound that is not linear is compared with its interpolant."""


@dataclass(frozen=True)
class Slipping:
    """A linear law at the vertices with friction in space: σ_t = −gθs − (g/a)(I − θssᵀ)u_t, or u_t = 0.

    With θ = 1 it is Newton's, with θ = 0 one whose energy is above that of friction, g|u_t|, and equal to it where
    |u_t| = a. Where g follows the pressure λ, a slope m and the last λ' add −m(λ − λ')s.

    Attributes:
        direction: The unit vector s in the frame of the facet, 0 where nothing slips, shape (facets, 3, 2).
        size: a, the last |u_t|, shape (facets, 3).
        turning: θ, shape (facets, 3).
        slope: m where g follows the pressure, 0 elsewhere, shape (facets, 3).
        pressed: mλ', shape (facets, 3).
    """

    direction: Array
    size: Array
    turning: Array | float = 1.0
    slope: Array | float = 0.0
    pressed: Array | float = 0.0

    @classmethod
    def nowhere(cls, facets: int, dim: int) -> Slipping:
        """No slip on so many facets, as in the plane."""
        return cls(np.zeros((facets, dim, dim - 1)), np.ones((facets, dim)))


@dataclass(frozen=True)
class FrictionBounds:
    """Bounds of the shear on the facets with friction of this rank, in the order of `ElasticSpaces.rough`.

    Without friction there are no such facets, and it is false.

    Attributes:
        bound: g_i at their vertices, shape (facets, d).
        given: What of g_i does not follow the pressure.
        mu: μ there; 0 where g is given.
        coulomb: Whether g follows the pressure, per facet.
        texts: The given g that are not linear on facets, each with its name and the rows where it holds.
        by_pressure: Whether g follows the pressure somewhere, on any rank.
        somewhere: Whether there is friction, on any rank.
        slipping: The linear law, in space; in the plane nothing slips by it.
        springs: Those along joints; None if there are none, on any rank.
        longest: No u_t is longer.
    """

    bound: Array
    given: Array
    mu: Array
    coulomb: Mask
    texts: tuple[tuple[str, Datum, Indices], ...]
    by_pressure: bool
    somewhere: bool
    slipping: Slipping
    springs: SpringsAlong | None = None
    longest: float = 1.0

    def __bool__(self) -> bool:
        return self.somewhere

    @property
    def in_space(self) -> bool:
        """Whether there is friction whose law turns with the slip, on any rank."""
        return self.somewhere and self.bound.shape[1] == 3

    @cached_property
    def chains(self) -> Chains:
        """The law of each site, between u_t and σ_t; in space between their components, stick or a given σ_t."""
        if not self.in_space:
            springs = np.inf if self.springs is None else self.springs.stiffness
            g, none = np.minimum(self.bound, self.longest * springs).ravel(), np.zeros(self.bound.size)
            reach = g / np.broadcast_to(springs, self.bound.shape).ravel()
            return Chains.through(np.column_stack([-reach, reach]), np.column_stack([g, -g]), none, none)
        sticks, force = np.repeat(self.held.ravel(), 2), self._linear[1].ravel()
        p, flux, slope = np.where(sticks, 0.0, STICKS), np.where(sticks, -STICKS, force), np.where(sticks, np.inf, 0.0)
        return Chains.through(p[:, None], flux[:, None], slope, slope)

    @cached_property
    def laws(self) -> VertexLaws:
        """The laws along joints, whose springs share what they do as those across them."""
        chains, none = self.chains, np.zeros(self.bound.size)
        return VertexLaws((), chains, none, none, shared_compliance(chains, 2), 2)

    @property
    def sticks(self) -> Mask:
        """Mask of the vertices in space at which u_t = 0 is held, shape (facets, 3)."""
        return (self.bound > 0) & ~self.slipping.direction.any(axis=2)

    @property
    def held(self) -> Mask:
        """Mask of those of them that no springs let go."""
        return self.sticks if self.springs is None else self.sticks & ~self.springs.somewhere[:, None]

    @cached_property
    def _linear(self) -> tuple[Array, Array, Array]:
        """The linear law in space at the sites of each facet: its stiffness, f, and the derivatives by the pressures.

        The stiffness is (g/a)(I − θssᵀ) for each vertex, with the springs of joints for all of them together. Shapes
        (facets, 6, 6), (facets, 6, 1) and (facets, 6, 3).
        """
        s, slope, (number, dim) = self.slipping.direction, np.zeros(self.bound.shape), self.bound.shape
        slips = s.any(axis=2)
        slope[slips] = (self.bound / self.slipping.size)[slips]
        turning = np.broadcast_to(self.slipping.turning, slope.shape)[:, :, None, None]
        stiffness: Array = slope[:, :, None, None] * (np.eye(dim - 1) - turning * s[:, :, :, None] * s[:, :, None])
        part = np.where(self.sticks, 0.0, self.slipping.pressed - self.bound * self.slipping.turning)
        forces = (part[:, :, None] * s).reshape(number, dim * (dim - 1), 1)
        by_pressure = -np.broadcast_to(self.slipping.slope, slope.shape)[:, :, None] * s
        slopes = np.einsum("nak,ab->nakb", by_pressure, np.eye(dim)).reshape(number, dim * (dim - 1), dim)
        whole = np.einsum("nakl,ab->nakbl", stiffness, np.eye(dim)).reshape(*forces.shape[:2], dim * (dim - 1))
        if self.in_space and self.springs is not None:
            return self.springs.in_series(self.sticks, whole, forces, slopes)
        return whole, forces, slopes

    @property
    def slopes(self) -> Array:
        """The derivative of σ_t at the sites by the pressures of the facet in the linear law in space."""
        return self._linear[2].reshape(-1, self.bound.shape[1])

    @property
    def stiffness(self) -> Array:
        """−∂σ_t/∂u_t in the linear law in space for the sites of each facet, shape (facets, 6, 6)."""
        return self._linear[0]

    def resisted(self, slip: Array) -> Array:
        """What the linear law in space adds to −σ_t, of u_t at the sites."""
        return np.einsum("nij,nj->ni", self.stiffness, slip.reshape(self.stiffness.shape[:2])).ravel()

    def pressed(self, pressure: Array) -> Array:
        """What the linear law in space adds to σ_t at the sites, of the pressure at their vertices."""
        return np.einsum("nij,nj->ni", self._linear[2], pressure).ravel()

    def left(self, slip: Array, shear: Array) -> Array:
        """What slips at vertices: u_t without what springs give way under σ_t, shape (facets, d, d − 1) each."""
        return slip if self.springs is None else self.springs.left(slip, shear)

    def held_across(self, moves: Array) -> Array:
        """What of motions of the sites in space the linear law resists, shape (sites, motions)."""
        s = self.slipping.direction
        resists = (s.any(axis=2) & (self.bound > 0)) | (self.sticks & ~self.held)
        at = np.where(resists[:, :, None, None], moves.reshape(*s.shape, moves.shape[1]), 0.0)
        turning = np.broadcast_to(self.slipping.turning, self.bound.shape)[:, :, None, None]
        resisted: Array = at - turning * s[:, :, :, None] * np.einsum("nak,nakm->nam", s, at)[:, :, None]
        return resisted.reshape(moves.shape)

    def directions(self, segments: Indices) -> Array:
        """σ_t at the sites for each unit of the bound, 0 where nothing slips.

        Args:
            segments: Number of the segment of each site with friction.
        """
        if not self.in_space:
            return np.subtract(1.0, segments)  # σ_t is g, less than g, −g on the segments
        return -self.slipping.direction.ravel()

    def residuals(self, slip: Array, shear: Array, unit: Array) -> tuple[Array, Array]:
        """How far |σ_t| is above g, and the distance of u_t and σ_t to the graph, both of shape (facets, d).

        In the plane it is that of `Chains.distances`. In space it is that of σ_t to −P(k u_t − σ_t), where P goes to
        the nearest vector that is not longer than g.

        Args:
            slip: u_t, shape (facets, d, d − 1).
            shear: σ_t likewise.
            unit: k, one of u_t is so many of σ_t, shape (facets, d).
        """
        if not self.in_space:
            _, above, off = self.chains.distances(slip.ravel(), shear.ravel(), unit.ravel())
            return above.reshape(unit.shape), off.reshape(unit.shape)
        size, slip = np.linalg.norm(shear, axis=2), self.left(slip, shear)
        left = shear + shortened(unit[:, :, None] * slip - shear, self.bound)
        return np.maximum(size - self.bound, 0.0), np.asarray(np.linalg.norm(left, axis=2))

    def fixed(self) -> FrictionBounds:
        """The friction with these bounds, whatever the pressure is: Tresca's."""
        nowhere = Slipping.nowhere(*self.bound.shape)
        return replace(self, coulomb=np.zeros_like(self.coulomb), by_pressure=False, slipping=nowhere)

    def following(self, pressure: Array) -> FrictionBounds:
        """The bounds by Coulomb's law under this pressure at the vertices, shape (facets, d)."""
        return self.with_bounds(self.given + self.mu * np.maximum(pressure, 0.0))

    def slope(self, pressure: Array) -> Array:
        """The derivatives of the bounds by the pressure, shape (facets, d): μ where they depend on it, else 0."""
        return np.where(self.coulomb[:, None] & (pressure > 0), self.mu, 0.0)

    def turned(self, slip: Array) -> FrictionBounds:
        """The friction in space with Newton's linear law at this u_t, shape (facets, 3, 2), where vertices slip."""
        return self.along(np.where(self.slipping.direction.any(axis=2)[:, :, None], slip, 0.0))

    def along(self, slip: Array) -> FrictionBounds:
        """The friction in space with Newton's linear law where this u_t is not 0, shape (facets, 3, 2)."""
        size = np.linalg.norm(slip, axis=2)
        size = np.where(size > 0, size, 1.0)
        return replace(self, slipping=Slipping(slip / size[:, :, None], size))

    def with_bounds(self, bound: Array) -> FrictionBounds:
        """The friction with new bounds where they are by the pressure, shape (facets, d)."""
        return replace(self, bound=np.where(self.coulomb[:, None], bound, self.bound))

    def towards(self, other: FrictionBounds, share: float) -> FrictionBounds:
        """The friction with bounds between these and others; with 1, or where nothing has slipped, with the others."""
        between = (1 - share) * self.bound + share * other.bound
        return self.with_bounds(np.where(self.bound >= STICKS, other.bound, between))

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


@dataclass(frozen=True)
class FromBefore:
    """What an elastic problem takes from one that is solved.

    Attributes:
        slipped: u_t at the sites with friction at the end of the last step in time; None for 0.
        friction: The bounds of the shear, in the place of those of the laws; None for these.
        moved: Foundations, or bodies against each other, that have moved.
        pulls: Tractions on parts besides those of the problem, or pressures where a scalar is given.
    """

    slipped: Array | None = None
    friction: FrictionBounds | None = None
    moved: Sequence[Tool] = ()
    pulls: Mapping[str, GivenVector | Given] = field(default_factory=dict)


def shortened(vectors: Array, longest: Array) -> Array:
    """The vectors, those that are too long cut to the length allowed; shapes (…, k) and (…)."""
    size = np.linalg.norm(vectors, axis=-1)
    share = np.divide(longest, size, out=np.ones_like(size), where=size > longest)
    shorter: Array = share[..., None] * vectors
    return shorter


def friction_bounds(
    spaces: ElasticSpaces, laws: Sequence[tuple[str, Law]], joint: Mapping[str, Given]
) -> FrictionBounds:
    """Read the laws of friction, each with its name in messages (collective).

    Raises:
        InputError: If g or μ is negative or not finite somewhere, or a stiffness of joints is not positive.
    """
    rubbing = [(name, law) for name, law in laws if not is_normal(law)]
    rough, dim = spaces.rough, spaces.dim
    number = len(rough.facets)
    coulomb = any(isinstance(law, CoulombLaw) for _, law in rubbing)
    bound, given, mu = np.zeros((3, number, dim))
    nowhere, by_pressure = Slipping.nowhere(number, dim), np.zeros(number, dtype=bool)
    bounds = FrictionBounds(bound, given, mu, by_pressure, (), coulomb, bool(rubbing), nowhere)
    texts = []
    for of_law, law in rubbing:
        for part in law.parts:
            rows = np.flatnonzero(np.isin(rough.facets, spaces.domain.facets[part]))  # a pair leaves some facets out
            given[rows], datum = _lower_values(spaces, f"{of_law}.g", law.data()["g"], rough.take(rows))
            bound[rows] = given[rows]
            if isinstance(law, CoulombLaw):
                mu[rows], _ = _lower_values(spaces, f"{of_law}.mu", law.mu, rough.take(rows))
                bound[rows], by_pressure[rows] = STICKS, True
            elif not is_linear(datum):
                texts.append((f"{of_law}.g", datum, rows))
    return replace(bounds, texts=tuple(texts), springs=_springs(spaces, joint), longest=LONGEST * spaces.length)


def _springs(spaces: ElasticSpaces, joint: Mapping[str, Given]) -> SpringsAlong | None:
    """The springs along joints (collective).

    Raises:
        InputError: If a stiffness is not positive.
    """
    if not joint:
        return None
    stiffness, data = np.full((len(spaces.rough.facets), spaces.dim), np.inf), []
    for part, given in joint.items():
        rows = np.flatnonzero(np.isin(spaces.rough.facets, spaces.domain.facets[part]))
        name = f"shear of '{part}'"
        stiffness[rows], datum = _lower_values(spaces, name, given, spaces.rough.take(rows))
        data.append((name, datum, rows))
    if spaces.mesh.comm.allreduce(float(stiffness.min(initial=np.inf)), MPI.MIN) <= 0:
        raise InputError("joint_springs: the stiffness along a joint must be positive")
    return SpringsAlong(stiffness, data)


def is_linear(datum: Datum) -> bool:
    """Whether a datum is known to be linear."""
    return datum.polynomial is not None and datum.polynomial <= 1


def _lower_values(spaces: ElasticSpaces, name: str, given: Given, facets: BoundaryFacets) -> tuple[Array, Datum]:
    """Values at the vertices of linear functions below a datum, and the datum (collective)."""
    dim = spaces.dim
    datum = datum_of(spaces, name, parsed(given, "xyz"[:dim], name))
    hats = lattice(dim, SAMPLES) / SAMPLES
    hats = np.concatenate([np.eye(dim), hats[hats.max(axis=1) < 1]])
    places = hats[:, 1:]
    points = in_facets(spaces.mesh, facets.facets, places)
    values = datum.values(points)
    low = float(np.nan_to_num(values, nan=-np.inf, posinf=-np.inf).min(initial=np.inf))
    if (low := spaces.mesh.comm.allreduce(low, MPI.MIN)) < 0:
        found = f"; its smallest value is {low:.3g}" if np.isfinite(low) else ""
        raise InputError(f"{name}: must be finite and not negative everywhere on its parts{found}")
    at_vertices = values[:, :dim]
    if not is_linear(datum):
        values = np.maximum(from_within(datum.values, points), 0.0)
        at_vertices = values[:, :dim]
        interpolant = at_vertices @ hats.T
        at_vertices = np.maximum(at_vertices + np.minimum(values - interpolant, 0).min(axis=1, keepdims=True), 0.0)
    return np.take_along_axis(at_vertices, facets.ranking, axis=1), datum
