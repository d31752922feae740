"""A given flux b on a mesh: σ = κ∇u + b.

In the mixed method (κ_h⁻¹b, τ) stands on the right side. On a cell that is ⟨z, τ·n⟩ for all τ of RT0, with one number z
per facet. So û + z stands in the Crouzeix-Raviart form of the method where û does without b, see `facet_system.Loads`:
for a b that is constant on a cell z is κ_h⁻¹b·(x − x_T) in the midpoints of the facets.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, inverted, scaled
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import cell_dofs, function_at, owned_cells
from signorini_fenicsx.discrete.bernstein import coefficients_of, interpolation, nodes
from signorini_fenicsx.discrete.cell_shapes import arms
from signorini_fenicsx.discrete.data_values import check_cells
from signorini_fenicsx.discrete.datum import Datum, datum_of, quadrature_degree
from signorini_fenicsx.discrete.known import Known
from signorini_fenicsx.discrete.points import Points, cell_quadrature, in_cells
from signorini_fenicsx.discrete.vectors import vector_datum_of
from signorini_fenicsx.expressions.simplices import INSIDE
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux, RT1Flux
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import has_soils
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.soils import FORMS

DEGREE = 2
"""Of the polynomials near b."""


@dataclass(frozen=True)
class AddedFlux:
    """b, by its components.

    Attributes:
        spaces: The discrete spaces.
        components: The components of b, or of κ⁻¹b.
        by_kappa: Whether they are those of κ⁻¹b, so that b changes with κ.
    """

    spaces: Spaces
    components: tuple[Datum, ...]
    by_kappa: bool = False

    @property
    def degree(self) -> int:
        """Degree of a quadrature for it times linear functions."""
        return quadrature_degree(*self.components) + 1

    @property
    def in_ufl(self) -> Expr | None:
        """The flux b in UFL, if it was given so and can have controls."""
        given = not self.by_kappa and any(each.pieces is None for each in self.components)
        return ufl.as_vector([each.ufl for each in self.components]) if given else None

    def _values(self, points: Points) -> Array:
        return np.stack([each.values(points) for each in self.components], axis=2)

    def at(self, points: Points, kappa: Datum) -> Array:
        """The flux b in points, shape (n, points, dim) (collective)."""
        return scaled(kappa.values(points), self._values(points)) if self.by_kappa else self._values(points)

    def over_kappa(self, points: Points, kappa: Datum) -> Array:
        """κ⁻¹b in points (collective)."""
        return self._values(points) if self.by_kappa else scaled(inverted(kappa.values(points)), self._values(points))

    @cached_property
    def _moments(self) -> tuple[Array, Array]:
        """The means of the components b_j over the owned cells, and those of b_j(x − x_T)_i (collective)."""
        mesh, means = self.spaces.mesh, []
        for points in cell_quadrature(mesh, owned_cells(mesh), self.degree):
            values = self._values(points)[..., None]
            known = np.concatenate([values, values * points.arms[:, :, None]], axis=3)
            means.append(points.means(known))
        of_cells = np.concatenate(means)
        return of_cells[:, :, 0], of_cells[:, :, 1:]

    @property
    def means(self) -> Array:
        """The means of the components on the owned cells, shape (cells, dim) (collective when first used)."""
        return self._moments[0]

    def sizes(self, kappa_h: Array) -> Array:
        """About |b| on the owned cells (collective when first used)."""
        means = np.einsum("nij,nj->ni", kappa_h, self.means) if self.by_kappa else self.means
        return np.asarray(np.linalg.norm(means, axis=1))

    def jumps(self, kappa_h: Array) -> Array:
        """The z on the facets of the owned cells, shape (cells, dim + 1) (collective when first used).

        Args:
            kappa_h: κ_h of each cell, or one for all, shape (cells or 1, dim, dim).
        """
        means, moments = self._moments
        inverse = np.eye(means.shape[1])[None] if self.by_kappa else np.linalg.inv(kappa_h)
        inverse = np.broadcast_to(inverse, (len(means), *inverse.shape[1:]))
        across = np.einsum("nij,nj,nvi->nv", inverse, means, arms(self.spaces.mesh))
        return np.asarray((np.einsum("nij,nji->n", inverse, moments)[:, None] - across) / means.shape[1])

    def less_projected(self, flux: CellFlux) -> fem.Function:
        """A flux of RT0 less the linear function on each cell that has the products of b with RT0 (collective)."""
        mesh, dim = self.spaces.mesh, self.spaces.mesh.topology.dim
        (means, moments), y = self._moments, arms(mesh)
        spread = np.einsum("nvi,nvj->nij", y, y) / ((dim + 1) * (dim + 2))
        b = means[:, None] + np.einsum("nji,nik,nvk->nvj", moments, np.linalg.inv(spread), y)
        space = fenicsx.function_space(mesh, ("DG", 1, (dim,)))
        return function_at(space, cell_dofs(space), flux.in_vertices() - b, "driving")

    def near(self, kappa: Datum) -> Array:
        """The quadratics near b, by their values in the nodes of the owned cells, shape (cells, nodes, dim).

        Collective. They have the values of b in points inside the cells, see `quadratics.interpolated`.
        """
        mesh, cell = self.spaces.mesh, self.spaces.mesh.basix_cell()
        places, middle = nodes(cell, DEGREE), 1 / (mesh.topology.dim + 1)
        from_inside = interpolation(cell, DEGREE, middle + (places - middle) / INSIDE)
        inside = middle + INSIDE * (places - middle)
        return np.concatenate(
            [from_inside @ self.at(points, kappa) for points in in_cells(mesh, owned_cells(mesh), inside)]
        )

    def taken_from(self, flux: CellFlux, kappa: Datum) -> RT1Flux:
        """A flux less the quadratics near b (collective)."""
        mesh = self.spaces.mesh
        cell = mesh.basix_cell()
        values = [flux.at(points) for points in in_cells(mesh, owned_cells(mesh), nodes(cell, DEGREE))]
        less = np.moveaxis(np.concatenate(values) - self.near(kappa), 2, 0)
        return RT1Flux.by_components(flux.spaces, np.stack([coefficients_of(each, cell) for each in less]))

    def function(self, kappa: Datum) -> fem.Function:
        """The quadratics near b as a function (collective)."""
        mesh = self.spaces.mesh
        space = fenicsx.function_space(mesh, ("DG", DEGREE, (mesh.topology.dim,)))
        values = interpolation(mesh.basix_cell(), DEGREE, space.element.interpolation_points) @ self.near(kappa)
        return function_at(space, cell_dofs(space), values, "b")


def gravity(spaces: Spaces) -> AddedFlux:
    """κe_z, with the height z as the last coordinate."""
    dim = spaces.mesh.geometry.dim
    return AddedFlux(spaces, tuple(datum_of(spaces, "b", float(i == dim - 1)) for i in range(dim)), by_kappa=True)


def b_of(spaces: Spaces, problem: Problem, known: Known) -> AddedFlux | None:
    """The given flux of a problem, with soils by the pressure head that of gravity; None for none (collective).

    Raises:
        InputError: If the form is for soils, and κ is not that of soils everywhere; for a b beside gravity; see
            `added_flux`.
    """
    given: Any = problem.b
    if problem.form not in FORMS:
        raise InputError(f"[problem] form: must be {' or '.join(FORMS)}, not {problem.form!r}")
    if problem.form == FORMS[0]:
        if given is None or isinstance(given, AddedFlux):
            return given
        return known.get("b", given, lambda: added_flux(spaces, given))
    if not has_soils(problem.kappa, everywhere=True):
        raise InputError(f"[problem] form: '{problem.form}' is for κ that are soils, everywhere")
    if given is not None:
        raise InputError(f"[problem] b: with the form '{problem.form}' gravity is the given flux; leave out b")
    return gravity(spaces)


def added_flux(spaces: Spaces, given: Any) -> AddedFlux:
    """The flux from what was given: a vector, or one for each region (collective).

    Raises:
        InputError: If it has not one component for each dimension, or is not finite.
    """
    b = AddedFlux(spaces, vector_datum_of(spaces, "b", given, continuous=False).components)
    check_cells("b", b.means, spaces)
    return b
