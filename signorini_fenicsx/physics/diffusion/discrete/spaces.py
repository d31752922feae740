"""The spaces V_h × Q_h × Λ_h = RT0 × P0 × P0(Γ_S) and the facet arrays on which the algorithms work.

*The spaces of RT1*: fluxes of order two, u in P1 on each cell, traces that are linear on each facet.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import cell_dofs, cell_nodes, function_at, function_of, owned_values, sums_at
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.contact.sites import SiteKind, Sites
from signorini_fenicsx.discrete.bernstein import interpolation, renumbered
from signorini_fenicsx.discrete.bernstein import nodes as bernstein_nodes
from signorini_fenicsx.discrete.cell_shapes import corners, squared_arms
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, LinearTraces, linear_traces, opposite
from signorini_fenicsx.discrete.mesh_spaces import (
    NEUMANN,
    SIGNORINI,
    MeshSpaces,
    Names,
    assembled,
    build_mesh_spaces,
    cells_and_dofs,
)
from signorini_fenicsx.discrete.pairing import pairs_on
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.paired_parts import PairedParts
from signorini_fenicsx.physics.diffusion.discrete.raviart_thomas import Cells, nodes, reference


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

    def scalar_values(self, u: fem.Function) -> Array:
        """The values of such a function on the owned cells, of RT1 at their vertices."""
        return owned_values(u)

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

    def out_of_cells(self, through: Array) -> fem.Function:
        """The flux in RT0 with these ∫σ·n out of the owned cells through their facets (collective)."""
        return function_at(self.V, cell_dofs(self.V), through / self.outflow, "sigma")

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
    on_mesh = build_mesh_spaces(domain, signorini, neumann, inner, pairs_on(domain, pairs, cut=bool(inner)))
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


@dataclass(frozen=True, kw_only=True)
class RT1Spaces(LinearTraces, Spaces):
    """The spaces of one domain for RT1, beside those of RT0, for which data have their means.

    Unknown a of a facet is û at its vertex a. On Γ_S û is in the basis dual to the hats φ_a, so that its coefficient is
    the φ_a-weighted mean of û, and the residual that belongs to it |e|/d times σ·n at the vertex a. On a part inside
    the domain the unknowns of the named side are the jump, on a slave of a pair û less the mean of û opposite to it.
    """

    cell_type = Cells

    @property
    def nodes(self) -> npt.NDArray[np.integer]:
        """The nodes at the vertices of the owned cells in DOLFINx's order."""
        return cell_nodes(self.mesh)

    @cached_property
    def flux_space(self) -> fem.FunctionSpace:
        """RT1, which DOLFINx counts as degree 2."""
        return fenicsx.function_space(self.mesh, ("RT", 2))

    @cached_property
    def scalar_space(self) -> fem.FunctionSpace:
        """P1 on each cell."""
        return fenicsx.function_space(self.mesh, ("DG", 1))

    @cached_property
    def _places(self) -> Indices:
        """Which of `bernstein.nodes` of degree 2 each node of the owned cells is, see `raviart_thomas.nodes`."""
        return renumbered(SIMPLEX[self.dim], 2, self.order, np.rint(2 * nodes(self.dim)).astype(np.int64))

    @cached_property
    def _maps(self) -> tuple[Array, Array, npt.NDArray[np.uint32]]:
        """F/det F of the owned cells in DOLFINx's order, its inverse, and how DOLFINx turns their facets."""
        x = corners(self.mesh)  # differences of vertices: DOLFINx rounds F where coordinates are far from 0
        derivative = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
        self.mesh.topology.create_entity_permutations()
        turned = self.mesh.topology.get_cell_permutation_info()[: len(x)]
        push = derivative / np.linalg.det(derivative)[:, None, None]
        return push, np.linalg.inv(push), turned

    def flux(self, values: Array) -> fem.Function:
        """The flux with these values at the nodes of the owned cells, shape (cells, nodes, d) (collective)."""
        return function_at(self.flux_space, cell_dofs(self.flux_space), self._coefficients(values), "sigma")

    def _coefficients(self, values: Array) -> Array:
        """DOLFINx's coefficients of a flux with these values at the nodes of the owned cells, cell by cell."""
        element = self.flux_space.element.basix_element
        at_points = interpolation(SIMPLEX[self.dim], 2, element.points)
        to_dofs = np.einsum(
            "biq,qa->aib", element.interpolation_matrix.reshape(-1, self.dim, len(at_points)), at_points
        )
        _, pull, turned = self._maps
        by_dolfinx = np.empty_like(values)
        np.put_along_axis(by_dolfinx, self._places[:, :, None], values, axis=1)
        pulled = by_dolfinx @ pull.transpose(0, 2, 1)
        dofs = np.ascontiguousarray(np.tensordot(pulled, to_dofs, ((1, 2), (0, 1)))).ravel()
        if len(values) > 0:  # DOLFINx divides by the number of cells
            self.flux_space.element.Tt_inv_apply(dofs, turned, 1)
        return dofs.reshape(-1, to_dofs.shape[2])

    def by_basis(self, functional: fem.Function) -> Array:
        """A functional of fluxes as the sum of one on each owned cell, by its values at the basis there.

        Args:
            functional: Its values at the basis of `flux_space`, ghosts updated.
        """
        cells, dofs = Cells(self.vertices), cell_dofs(self.flux_space)
        shares = (functional.x.array / sums_at(self.flux_space.dofmap.index_map, dofs))[dofs]
        units = np.eye(len(reference(self.dim).basis))
        return np.column_stack(
            [
                np.einsum(
                    "nd,nd->n",
                    shares,
                    self._coefficients(cells.at_nodes(np.broadcast_to(unit, (len(dofs), len(unit))))),
                )
                for unit in units
            ]
        )

    def flux_values(self, sigma: fem.Function) -> Array:
        """The values of a flux at the nodes of the owned cells, see `raviart_thomas.nodes`."""
        return np.asarray(np.take_along_axis(self.by_dolfinx(sigma), self._places[:, :, None], axis=1))

    def by_dolfinx(self, sigma: fem.Function) -> Array:
        """The values of a flux in `bernstein.nodes` of degree 2 of the owned cells, shape (cells, nodes, d)."""
        basis = self.flux_space.element.basix_element.tabulate(0, bernstein_nodes(SIMPLEX[self.dim], 2))[0]
        dofs, (push, _, turned) = sigma.x.array[cell_dofs(self.flux_space)].ravel(), self._maps
        if len(push) > 0:  # DOLFINx divides by the number of cells
            self.flux_space.element.Tt_apply(dofs, turned, 1)
        return np.asarray(np.tensordot(dofs.reshape(-1, basis.shape[1]), basis, (1, 1)) @ push.transpose(0, 2, 1))

    def scalar(self, values: Array) -> fem.Function:
        """The function with these values at the vertices of the owned cells, shape (cells, d + 1) (collective)."""
        return function_at(self.scalar_space, self.at_vertices(self.scalar_space), values, "u")

    def scalar_values(self, u: fem.Function) -> Array:
        """The values of such a function at the vertices of the owned cells."""
        return u.x.array[self.at_vertices(self.scalar_space)]

    def through(self, facets: BoundaryFacets, values: Array) -> Array:
        """σ·n at the vertices of boundary facets, shape (facets, d), of values at the nodes."""
        at_vertices = values[facets.cells[:, None], opposite(self.dim)[facets.local]]
        return np.einsum("naj,nj->na", at_vertices, facets.normals)

    @cached_property
    def frames(self) -> list[tuple[BoundaryFacets, Array]]:
        """The facets of Γ_S and the other sides of those inside the domain, see `LinearTraces.frames`."""
        dual = (self.dim + 1) * np.eye(self.dim) - 1
        of_jumps = self.contact, self.across, self.boundary_facets(self.tied)
        return [(facets, np.broadcast_to(dual, (len(facets.facets), *dual.shape))) for facets in of_jumps]

    def unknowns(self, facets: BoundaryFacets) -> npt.NDArray[np.int32]:
        """The unknowns of facets, shape (facets, d)."""
        return np.asarray(facets.blocks[:, None] * self.dim + np.arange(self.dim, dtype=np.int32))

    @cached_property
    def site_kinds(self) -> Sites:
        """The vertices of the facets of Γ_S, and those of all owned cells for laws in Ω."""
        number, dim, cells = len(self.facets), self.dim, self.cell_measures
        share, in_cells = np.repeat(self.contact.measure / dim, dim), np.repeat(cells / (dim + 1), dim + 1)
        unknown = self.unknowns(self.contact).ravel()
        return Sites(
            SiteKind("facet", number, np.arange(number), share, (dim,), unknown),
            SiteKind("cell", len(cells), np.arange(len(cells)), in_cells, (dim + 1,), unknown[:0]),
        )

    @property
    def outer_sites(self) -> Indices:
        """The sites on the boundary, not inside the domain."""
        sites: Indices = (self.outer_rows[:, None] * self.dim + np.arange(self.dim)).ravel()
        return sites


def rt1_spaces(spaces: Spaces) -> RT1Spaces:
    """The spaces of RT1 on the mesh of those of RT0 (collective)."""
    return RT1Spaces(**linear_traces(spaces, (spaces.mesh.topology.dim,)) | {"degree": 1})
