"""The spaces V_h × Q_h × Λ_h = RT0 × P0 × P0(Γ_S) and the facet arrays on which the algorithms work."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import function_of
from signorini_fenicsx.discrete.cell_shapes import squared_arms
from signorini_fenicsx.discrete.mesh_spaces import (
    NEUMANN,
    SIGNORINI,
    MeshSpaces,
    Names,
    assembled,
    build_mesh_spaces,
    cells_and_dofs,
)
from signorini_fenicsx.discrete.pairing import joints
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.paired_parts import PairedParts


@dataclass(frozen=True, kw_only=True)
class Spaces(MeshSpaces):
    """The discrete spaces of one domain: `Q` for the scalar u, `Lambda` for the trace p, and RT0.

    Attributes:
        V: RT0, the flux σ.
        flux_dofs: RT0 degree of freedom of each Γ_S facet.
        basis_flux: ∫_e φ·n of its basis function φ, with its sign.
        neumann_cells: Mesh cell behind each Γ_N facet.
        neumann_dofs: RT0 degree of freedom of each Γ_N facet.
        neumann_basis_flux: ∫_e φ·n of its basis function.
        neumann_measure: |e| of each Γ_N facet.
    """

    V: fem.FunctionSpace
    flux_dofs: npt.NDArray[np.int32]
    basis_flux: Array
    neumann_cells: npt.NDArray[np.int32]
    neumann_dofs: npt.NDArray[np.int32]
    neumann_basis_flux: Array
    neumann_measure: Array
    degree: int = 0

    @property
    def scalar_space(self) -> fem.FunctionSpace:
        """The space of u."""
        return self.Q

    def scalar(self, values: Array) -> fem.Function:
        """The u with these values on the owned cells, of RT1 at their vertices (collective)."""
        return function_of(self.Q, values.ravel(), "u")

    def normal_flux(self, sigma: fem.Function) -> Array:
        """σ·n per Γ_S facet, where it is constant."""
        return self.basis_flux * sigma.x.array[self.flux_dofs] / self.facet_measure

    @cached_property
    def fluxes_across(self) -> tuple[npt.NDArray[np.int32], Array]:
        """The other sides of inner facets (collective when first used).

        Returns:
            Their RT0 degrees of freedom, and what these are for each unit on the named sides, so that σ·n is the same.
        """
        across = self.inner.facets
        entities = fem.compute_integration_domains(fem.IntegralType.exterior_facet, self.mesh.topology, np.sort(across))
        ds = ufl.Measure("ds", domain=self.mesh, subdomain_data=[(1, entities)])
        dofs = cells_and_dofs(self.V, across)[1]
        flux = assembled(ufl.dot(ufl.TestFunction(self.V), self.n) * ds(1))[dofs]
        return dofs, -self.basis_flux[self.inner.rows] / flux

    def carry_across(self, sigma: fem.Function) -> None:
        """Give the other sides of inner facets the σ·n of the named sides, in place, ghosts updated (collective)."""
        if self.inner.present:
            dofs, opposite = self.fluxes_across
            sigma.x.array[dofs] = opposite * sigma.x.array[self.flux_dofs[self.inner.rows]]
            sigma.x.scatter_forward()

    def join_across(self, values: Array) -> None:
        """Make of a linear function of σ, given in all degrees of freedom, one of fluxes equal on both sides, in place.

        Collective when first used. The other sides of inner facets get 0.
        """
        if self.inner.present:
            dofs, opposite = self.fluxes_across
            values[self.flux_dofs[self.inner.rows]] += opposite * values[dofs]
            values[dofs] = 0.0

    @cached_property
    def squared_arms(self) -> Array:
        """|x_v − x_T|² for the vertices of each owned cell and its centroid, shape (cells, dim + 1)."""
        return squared_arms(self.mesh, np.eye(self.mesh.topology.dim))

    @cached_property
    def outflow(self) -> Array:
        """∫_T ∇·φ for each owned cell T and each basis function φ of RT0 there, shape (cells, dim + 1)."""
        point = np.zeros((1, self.mesh.topology.dim))  # ∇·φ is constant
        divergence = fenicsx.expression(ufl.div(ufl.TestFunction(self.V)), point)
        cells = np.arange(len(self.cell_measures), dtype=np.int32)
        return np.asfortranarray(divergence.eval(self.mesh, cells)[:, 0] * self.cell_measures[:, None])

    @cached_property
    def centroids(self) -> fem.Function:
        """The centroids x_T as a P0 vector function."""
        dim = self.mesh.geometry.dim
        centroid = fem.Function(fenicsx.function_space(self.mesh, ("DG", 0, (dim,))))
        centroid.interpolate(lambda x: x[:dim])
        return centroid

    @cached_property
    def broken_crouzeix_raviart(self) -> fem.FunctionSpace:
        """Crouzeix-Raviart's space without continuity: each cell has an unknown of its own for each of its facets."""
        return fenicsx.function_space(self.mesh, basix.ufl.element("CR", self.mesh.basix_cell(), 1, discontinuous=True))

    @cached_property
    def Q_matrix(self) -> fem.FunctionSpace:
        """P0 matrices, for κ_h."""
        dim = self.mesh.geometry.dim
        return fenicsx.function_space(self.mesh, ("DG", 0, (dim, dim)))


def build_spaces(
    domain: Domain, signorini: Names, neumann: Names = (), inner: Names = (), pairs: Sequence[PairedParts] = ()
) -> Spaces:
    """Create the spaces for Γ_S and Γ_N made of the named parts; the rest of the boundary is Γ_D (collective).

    The parts of Γ_S in `inner` are inside the domain.
    """
    on_mesh = build_mesh_spaces(domain, signorini, neumann, inner, joints(domain, pairs, cut=bool(inner)))
    mesh, n, ds = domain.mesh, on_mesh.n, on_mesh.ds.reconstruct(subdomain_id="everywhere")
    V = fenicsx.function_space(mesh, ("RT", 1))
    flux_dofs = cells_and_dofs(V, on_mesh.facets)[1]
    flux_of_basis = assembled(ufl.dot(ufl.TestFunction(V), n) * ds((SIGNORINI, NEUMANN)))
    neumann_cells, neumann_dofs = cells_and_dofs(V, on_mesh.neumann_facets)
    area_of_basis = assembled(ufl.FacetArea(mesh) * ufl.dot(ufl.TestFunction(V), n) * ds(NEUMANN))
    return Spaces(
        **vars(on_mesh),
        V=V,
        flux_dofs=flux_dofs,
        basis_flux=flux_of_basis[flux_dofs],
        neumann_cells=neumann_cells,
        neumann_dofs=neumann_dofs,
        neumann_basis_flux=flux_of_basis[neumann_dofs],
        neumann_measure=area_of_basis[neumann_dofs] / flux_of_basis[neumann_dofs],
    )
