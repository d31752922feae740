"""The law of a viscous fluid, ε = 𝔸σ with 𝔸σ = dev σ/2μ: that of an incompressible body, with E = 3μ and ν = ½."""

from collections.abc import Iterator, Mapping

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.points import CellPoints
from signorini_fenicsx.discrete.vectors import VectorDatum, vector_datum_of
from signorini_fenicsx.physics.elasticity.discrete.material import SPACE, Material, read_datum, strains_of
from signorini_fenicsx.physics.elasticity.discrete.on_facets import facet_moments
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem, PlaneState


class Viscous(Material):
    """The law on a mesh; the viscosity μ is in the place of E, and a number ε₀ says how fast volumes grow."""

    incompressible = True
    words = ("viscosity",)

    def seen(self, stresses: Array) -> Array:
        """The deviators, see `Material.seen`."""
        mean = np.einsum("...ii->...", stresses) / self.dim
        return np.asarray(stresses - mean[..., None, None] * np.eye(self.dim))

    @classmethod
    def of(cls, spaces: MeshSpaces, problem: ElasticProblem) -> "Viscous":
        """Read the viscosity, a number or a text, or one of these for each region (collective).

        Raises:
            InputError: If it cannot be read, or a region has no value.
        """
        young, strains = (read_datum(spaces, "viscosity", problem.viscosity),), strains_of(spaces, problem)
        return cls(spaces.mesh.geometry.dim, PlaneState.STRAIN, young, poisson=(), shear=(), axes=(), strains=strains)

    def compliance(self, points: CellPoints) -> Array:
        """𝔸 in points, shape (cells, points, entries, entries) (collective)."""
        number = len(self._kept)
        deviator = np.eye(number)
        deviator[: self.dim, : self.dim] -= 1 / self.dim
        return np.asarray(deviator / (2 * self.young[0].values(points)[..., None, None]))

    def strain(self, points: CellPoints) -> Array:
        """ε₀ in points, shape (cells, points, entries) (collective)."""
        return np.asarray(self._own(points)[..., self._kept])

    def out_of_plane(self, points: CellPoints) -> tuple[Array, Array]:
        """The σ_zz = −p by the entries of σ, and without σ, see `Material.out_of_plane`."""
        share = np.zeros((*points.shape, len(self._kept)))
        share[..., : self.dim] = 1 / self.dim
        return share, np.zeros(points.shape)

    def looked_at(self, points: CellPoints) -> Iterator[tuple[str, Array]]:
        """What has to be checked in points (collective)."""
        with np.errstate(all="ignore"):
            yield "viscosity", self.young[0].values(points)
            yield from self._own_looked_at(points)

    def softness_in_space(self, points: CellPoints) -> Array:
        """The eigenvalues of 𝔸 in space, shape (cells, points, 6) (collective)."""
        one = 1 / (2 * self.young[0].values(points))
        return np.stack([0 * one, *[one] * (len(SPACE) - 1)], axis=-1)


def velocity_of_walls(spaces: ElasticSpaces, problem: ElasticProblem, u_D: VectorDatum) -> Array:
    """The velocity w with which walls move along themselves, in the means at the sites with friction (collective).

    Raises:
        InputError: If it is not linear.
    """
    given = problem.u_D if isinstance(problem.u_D, Mapping) else {}
    slipped = np.zeros((len(spaces.rough.facets), spaces.dim, spaces.dim))
    for part in problem.rough if spaces.boundary.turned else []:
        if (value := given.get(part)) is not None:
            degree = vector_datum_of(spaces, f"u_D.{part}", value).polynomial
            if degree is None or degree > 1:
                raise InputError(f"[problem] u_D.{part}: the velocity of a wall with slip must be linear in x, y, z")
            rows = np.flatnonzero(np.isin(spaces.rough.facets, spaces.domain.facets[part]))
            facets = spaces.rough.take(rows)
            moments = facet_moments(spaces, "u_D", u_D, facets, f"on part '{part}'")
            slipped[rows] = moments * spaces.dim / facets.measure[:, None, None]
    return spaces.in_frames(slipped)
