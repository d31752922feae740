"""The problem that the change of an elastic solution solves: its sites are on lines or two rays from a corner."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.contact.backend import Pairs, PlainBackend
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.solve.backend import ElasticBackend
from signorini_fenicsx.physics.elasticity.solve.coulomb import newton


class Tangent(PlainBackend):
    """Solves for the traces of the change under segments of the laws; p and the flux are measured from moved corners.

    A biactive site has the two segments that meet at its corner for rays, any other site its own segment alone. With
    Coulomb's law the bounds change with the pressures.

    Attributes:
        x: The traces of the last solve.
    """

    name = "tangent"

    def __init__(
        self,
        backend: ElasticBackend,
        data: ElasticData,
        segments: tuple[Indices, Indices],
        numbers: Mapping[str, Array],
        laws: tuple[Array, Array],
        pressure: Array,
        load: Array,
    ):
        """Take what the data add.

        Args:
            backend: Solves under conditions.
            data: The data on the mesh.
            segments: The lower and the upper segment of each site; equal if it is not biactive.
            numbers: The changes of û where it is given and of gaps ("lift"), of bounds ("bound") and of μ ("mu").
            laws: What `lines_by_data` says for these segments, at the sites in the normal direction.
            pressure: That at the vertices with friction, shape (facets, d).
            load: The right side but for the sites.
        """
        self.noun, self.comm, self.sites, self.dofs = backend.noun, backend.comm, backend.sites, backend.dofs
        self._backend, self._data, self._segments, self._laws = backend, data, segments, laws
        self._numbers, self._pressure, self._load = numbers, pressure, load
        law = backend.chains
        before, beyond = (np.take_along_axis(law.slope, each[:, None], axis=1)[:, 0] for each in segments)
        corner = np.zeros((self.sites, 1))
        self.chains = Chains.through(corner, corner, before, beyond)
        self._normal, self._slip = backend.spaces.site_kinds

    @property
    def sloped(self) -> Mask:
        """The biactive sites at the end of a slope, whose rays are not those of their neighbours."""
        ends = (self.chains.kinds == Condition.ROBIN).any(axis=1)
        return np.asarray(ends & (self._segments[0] != self._segments[1]))

    def solver(self) -> str:
        """Name of the linear solver in use."""
        return self._backend.solver()

    def solve(self, conditions: SiteConditions) -> Pairs:
        """Solve as `Backend.solve` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        backend, spaces, (normal, slip) = self._backend, self._backend.spaces, self._backend.spaces.site_kinds
        upper = self.chains.segments(conditions) == 1
        segment = np.where(upper, *reversed(self._segments))
        law = np.where(normal.of(upper), *reversed(self._laws))
        actual = backend.chains.conditions(segment)
        held, gap = normal.of(actual.kind) == Condition.ZERO_TRACE, self._numbers["lift"][normal.unknown]
        lift, load = self._numbers["lift"].copy(), self._load.copy()
        lift[normal.unknown] = np.where(held, gap - law, 0.0)
        pull = np.where(held, 0.0, stiffness_times(self._data, normal.of(actual), gap) - law)
        load[normal.unknown] += normal.measure * pull
        bound, friction = self._numbers["bound"], backend.friction
        sides = friction.directions(slip.of(segment))
        lift[slip.unknown] *= slip.of(actual.kind) == Condition.ZERO_TRACE
        load[slip.unknown] += self._shear(sides, bound)
        x = backend.solve_homogeneous(actual, load, lift)
        if friction.by_pressure:
            slope = friction.slope(np.where(self._touching, 1.0, self._pressure))
            moved = spaces.pressure_of(backend.flux(x, self._load))
            left = self._numbers["mu"] * self._pressure.ravel() + (slope * moved).ravel()
            more = newton(backend, actual, (sides, slope), left.reshape(slope.shape)).ravel()
            load = np.zeros_like(load)
            load[slip.unknown] = self._shear(sides, more)
            x.axpy(1.0, backend.solve_homogeneous(actual, load))
            bound = bound + more
        self.x = np.array(x.array_r)
        return self._pairs(conditions, gap, bound, backend.flux(x, self._load))

    @property
    def _touching(self) -> Mask:
        """The biactive vertices among those with friction, shape (facets, d)."""
        return np.asarray((self._segments[0] != self._segments[1])[self._slip.pressing])

    def _shear(self, sides: Array, bound: Array) -> Array:
        """The forces of these bounds of the shear."""
        return np.asarray(sides * self._slip.measure * np.repeat(bound, self._backend.spaces.dim - 1))

    def _pairs(self, conditions: SiteConditions, gap: Array, bound: Array, flux: Array) -> Pairs:
        """The trace p and the flux from the moved corners."""
        normal, slip, width = self._normal, self._slip, self._backend.spaces.dim - 1
        steep = np.isinf(normal.of(self.chains.slope)[:, 0])
        opening, pressure = (np.where(steep, *pair) for pair in (self._laws, reversed(self._laws)))
        slipped = self.x[slip.unknown] - self._numbers["lift"][slip.unknown]
        p = np.append(gap - self.x[normal.unknown] - opening, slipped)
        shear = np.repeat(bound, width) * np.subtract(1.0, 2 * slip.of(self._segments[0]))
        flux = flux - np.append(pressure, shear)
        p, flux = conditions.clean(p, flux, np.inf)
        return Pairs(p=p, flux=flux, linear_iterations=1)

    def scales(self, iterate: Pairs) -> tuple[Array, Array]:
        """The largest of both over all sites, see `Backend.scales` (collective)."""
        largest = np.array([np.abs(each).max(initial=0.0) for each in (iterate.p, iterate.flux)])
        self.comm.Allreduce(MPI.IN_PLACE, largest, MPI.MAX)
        of_p, of_flux = (np.full(self.sites, each) for each in largest)
        return of_p, of_flux

    def change(self, iterate: Pairs, before: Pairs) -> tuple[float, float]:
        """Norms of what changed at the sites (collective)."""
        squares = [
            float(((one - other) ** 2).sum()) for one, other in ((iterate.flux, before.flux), (iterate.p, before.p))
        ]
        of_flux, of_p = np.sqrt(self.comm.allreduce(np.array(squares))).tolist()
        return of_flux, of_p

    def places(self) -> Array:
        """One row per site, see `Backend.places`."""
        return self._backend.places()


def stiffness_times(data: ElasticData, conditions: SiteConditions, p: Array) -> Array:
    """What springs take from the pressures at facet vertices under conditions and means p; 0 where there are none."""
    if not data.laws.of_parts:
        return np.zeros_like(p)
    springs = data.laws.springs(conditions)
    return np.asarray(np.einsum("nij,nj->ni", springs.stiffness, p.reshape(springs.rest.shape)).ravel())
