"""The spaces V_h × Q_h × Λ_h = RT0 × P0 × P0(Γ_S) and the facet arrays on which the algorithms work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import basix.ufl
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.compiling import guard_compiler
from signorini_fenicsx.discrete.cell_shapes import squared_arms
from signorini_fenicsx.discrete.inner_facets import InnerFacets, inner_facets
from signorini_fenicsx.discrete.kept_forms import Build, Coefficient, KeptForms
from signorini_fenicsx.meshes.domain import Domain

type Names = Sequence[str]

SIGNORINI = 1
DIRICHLET = 2
NEUMANN = 3


@dataclass(frozen=True)
class Spaces:
    """Discrete spaces on one domain.

    Facet arrays run over the Γ_S facets of this rank, which are all owned (possibly none), in the order of the
    multiplier's degrees of freedom.

    Attributes:
        domain: The mesh and its boundary parts.
        V: RT0, the flux σ.
        Q: P0, the scalar u.
        Lambda: P0 on the facet submesh of Γ_S, the trace p.
        entity_map: From the submesh of Γ_S to the mesh.
        part_names: The parts of Γ_S.
        part_of_facet: Index into `part_names` for each Γ_S facet.
        facets: Mesh facet of each Γ_S facet.
        cells: Mesh cell behind each Γ_S facet.
        flux_dofs: RT0 degree of freedom of each Γ_S facet.
        basis_flux: ∫_e φ·n of its basis function φ, with its sign.
        facet_measure: |e| of each Γ_S facet.
        dirichlet_facets: Mesh facets of Γ_D on this rank.
        has_dirichlet: Whether any rank has facets of Γ_D.
        neumann_facets: Mesh facets of Γ_N on this rank.
        neumann_cells: Mesh cell behind each Γ_N facet.
        neumann_dofs: RT0 degree of freedom of each Γ_N facet.
        neumann_basis_flux: ∫_e φ·n of its basis function.
        neumann_measure: |e| of each Γ_N facet.
        inner: The facets of Γ_S inside the domain, with those of their other sides.
        n: Outer unit normal.
        ds: Measure of Γ_S on the mesh.
        ds_dirichlet: Measure of Γ_D on the mesh.
        ds_neumann: Measure of Γ_N on the mesh.
        kept_forms: The forms of `kept`.
    """

    domain: Domain
    V: fem.FunctionSpace
    Q: fem.FunctionSpace
    Lambda: fem.FunctionSpace
    entity_map: dolfinx.mesh.EntityMap
    part_names: tuple[str, ...]
    part_of_facet: npt.NDArray[np.int32]
    facets: npt.NDArray[np.int32]
    cells: npt.NDArray[np.int32]
    flux_dofs: npt.NDArray[np.int32]
    basis_flux: Array
    facet_measure: Array
    dirichlet_facets: npt.NDArray[np.int32]
    has_dirichlet: bool
    neumann_facets: npt.NDArray[np.int32]
    neumann_cells: npt.NDArray[np.int32]
    neumann_dofs: npt.NDArray[np.int32]
    neumann_basis_flux: Array
    neumann_measure: Array
    inner: InnerFacets
    n: ufl.FacetNormal
    ds: ufl.Measure
    ds_dirichlet: ufl.Measure
    ds_neumann: ufl.Measure
    kept_forms: KeptForms = field(default_factory=KeptForms)

    @property
    def mesh(self) -> dolfinx.mesh.Mesh:
        """The mesh."""
        return self.domain.mesh

    def normal_flux(self, sigma: fem.Function) -> Array:
        """σ·n per Γ_S facet, where it is constant."""
        return self.basis_flux * sigma.x.array[self.flux_dofs] / self.facet_measure

    @cached_property
    def outer_rows(self) -> npt.NDArray[np.intp]:
        """The rows of `facets` that are on the boundary of the domain, not inside it."""
        return np.setdiff1d(np.arange(len(self.facets)), self.inner.rows)

    @cached_property
    def across(self) -> tuple[npt.NDArray[np.int32], Array]:
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
            dofs, opposite = self.across
            sigma.x.array[dofs] = opposite * sigma.x.array[self.flux_dofs[self.inner.rows]]
            sigma.x.scatter_forward()

    def join_across(self, values: Array) -> None:
        """Make of a linear function of σ, given in all degrees of freedom, one of fluxes equal on both sides, in place.

        Collective when first used. The other sides of inner facets get 0.
        """
        if self.inner.present:
            dofs, opposite = self.across
            values[self.flux_dofs[self.inner.rows]] += opposite * values[dofs]
            values[dofs] = 0.0

    @cached_property
    def cell_measures(self) -> Array:
        """|T| of the owned cells; there are no ghosts."""
        return assembled(fem.Constant(self.mesh, 1.0) * ufl.TestFunction(self.Q) * ufl.dx)

    @cached_property
    def cell_diameters(self) -> Array:
        """The longest edge of each owned cell."""
        dim = self.mesh.topology.dim
        return self.mesh.h(dim, np.arange(self.mesh.topology.index_map(dim).size_local, dtype=np.int32))

    @cached_property
    def squared_arms(self) -> Array:
        """|x_v − x_T|² for the vertices of each owned cell and its centroid, shape (cells, dim + 1)."""
        return squared_arms(self.mesh, np.eye(self.mesh.topology.dim))

    @cached_property
    def outflow(self) -> Array:
        """∫_T ∇·φ for each owned cell T and each basis function φ of RT0 there, shape (cells, dim + 1)."""
        point = np.zeros((1, self.mesh.topology.dim))  # ∇·φ is constant
        divergence = fem.Expression(ufl.div(ufl.TestFunction(self.V)), point)
        cells = np.arange(len(self.cell_measures), dtype=np.int32)
        return np.asfortranarray(divergence.eval(self.mesh, cells)[:, 0] * self.cell_measures[:, None])

    @cached_property
    def length(self) -> float:
        """L = |Ω|^(1/d) (collective when first used)."""
        return float(self.mesh.comm.allreduce(self.cell_measures.sum()) ** (1 / self.mesh.topology.dim))

    @cached_property
    def crouzeix_raviart(self) -> fem.FunctionSpace:
        """Crouzeix-Raviart functions, for lifts and the facet system."""
        return fem.functionspace(self.mesh, ("CR", 1))

    @cached_property
    def broken_crouzeix_raviart(self) -> fem.FunctionSpace:
        """The same without continuity: each cell has an unknown of its own for each of its facets."""
        return fem.functionspace(self.mesh, basix.ufl.element("CR", self.mesh.basix_cell(), 1, discontinuous=True))

    @cached_property
    def Q_matrix(self) -> fem.FunctionSpace:
        """P0 matrices, for κ_h."""
        dim = self.mesh.geometry.dim
        return fem.functionspace(self.mesh, ("DG", 0, (dim, dim)))

    def multiplier(self, values: npt.NDArray, name: str = "p") -> fem.Function:
        """A function of Λ_h with these values per Γ_S facet, ghosts updated (collective)."""
        function = fem.Function(self.Lambda, name=name)
        function.x.array[: len(values)] = values
        function.x.scatter_forward()
        return function

    def form(self, ufl_form: ufl.Form | fem.Form) -> fem.Form:
        """Compile a form that may contain functions of Λ_h (collective)."""
        return fem.form(ufl_form, entity_maps=[self.entity_map])

    def integrate(self, form: ufl.Form | fem.Form) -> float:
        """Integral over all ranks (collective)."""
        return float(self.mesh.comm.allreduce(fem.assemble_scalar(self.form(form))))

    def kept(self, build: Build, *coefficients: Coefficient) -> Any:
        """The form `build(spaces, *coefficients)`, compiled at the first call, see `kept_forms` (collective).

        Args:
            build: A function of a module that gives a UFL form, or blocks of them.
            coefficients: Functions and constants with up-to-date ghost values.
        """

        def make(*own: Coefficient) -> Any:
            return fem.form(build(self, *own), entity_maps=[self.entity_map])

        return self.kept_forms.get(build, make, coefficients)


def build_spaces(domain: Domain, signorini: Names, neumann: Names = (), inner: Names = ()) -> Spaces:
    """Create the spaces for Γ_S and Γ_N made of the named parts; the rest of the boundary is Γ_D (collective).

    The parts of Γ_S in `inner` are inside the domain.
    """
    guard_compiler()
    mesh = domain.mesh
    dim = mesh.topology.dim
    gamma, entity_map, *_ = dolfinx.mesh.create_submesh(mesh, dim - 1, _facets_of(domain, signorini))
    V = fem.functionspace(mesh, ("RT", 1))
    Q = fem.functionspace(mesh, ("DG", 0))
    Lambda = fem.functionspace(gamma, ("DG", 0))

    submesh_cells = np.arange(gamma.topology.index_map(dim - 1).size_local, dtype=np.int32)
    facets = np.empty_like(submesh_cells)
    facets[Lambda.dofmap.list[:, 0]] = entity_map.sub_topology_to_topology(submesh_cells, inverse=False)
    neumann_facets = _facets_of(domain, neumann)
    across = inner_facets(domain, facets, inner)
    dirichlet_facets = np.setdiff1d(
        dolfinx.mesh.exterior_facet_indices(mesh.topology), np.concatenate([facets, neumann_facets, across.facets])
    )
    boundary = [
        (marker, fem.compute_integration_domains(fem.IntegralType.exterior_facet, mesh.topology, np.sort(part)))
        for marker, part in ((SIGNORINI, facets), (DIRICHLET, dirichlet_facets), (NEUMANN, neumann_facets))
    ]
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=boundary)
    n = ufl.FacetNormal(mesh)

    cells, flux_dofs = cells_and_dofs(V, facets)
    part_of_facet = np.empty(len(facets), dtype=np.int32)
    for index, name in enumerate(signorini):
        part_of_facet[np.isin(facets, domain.facets[name])] = index
    measure = assembled(ufl.TestFunction(Lambda) * ds(SIGNORINI), [entity_map])
    flux_of_basis = assembled(ufl.dot(ufl.TestFunction(V), n) * ds((SIGNORINI, NEUMANN)))
    neumann_cells, neumann_dofs = cells_and_dofs(V, neumann_facets)
    area_of_basis = assembled(ufl.FacetArea(mesh) * ufl.dot(ufl.TestFunction(V), n) * ds(NEUMANN))
    return Spaces(
        domain=domain,
        V=V,
        Q=Q,
        Lambda=Lambda,
        entity_map=entity_map,
        part_names=tuple(signorini),
        part_of_facet=part_of_facet,
        facets=facets,
        cells=cells,
        flux_dofs=flux_dofs,
        basis_flux=flux_of_basis[flux_dofs],
        facet_measure=measure[: len(facets)],
        dirichlet_facets=dirichlet_facets,
        has_dirichlet=mesh.comm.allreduce(len(dirichlet_facets) > 0, MPI.LOR),
        neumann_facets=neumann_facets,
        neumann_cells=neumann_cells,
        neumann_dofs=neumann_dofs,
        neumann_basis_flux=flux_of_basis[neumann_dofs],
        neumann_measure=area_of_basis[neumann_dofs] / flux_of_basis[neumann_dofs],
        inner=across,
        n=n,
        ds=ds(SIGNORINI),
        ds_dirichlet=ds(DIRICHLET),
        ds_neumann=ds(NEUMANN),
    )


def _facets_of(domain: Domain, parts: Names) -> npt.NDArray[np.int32]:
    return np.unique(np.concatenate([np.empty(0, dtype=np.int32), *(domain.facets[name] for name in parts)]))


def cells_and_dofs(
    V: fem.FunctionSpace, facets: npt.NDArray[np.int32]
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """The cell behind each boundary facet, and the facet's degree of freedom in a space with one per facet."""
    topology = V.mesh.topology
    dim = topology.dim
    topology.create_connectivity(dim - 1, dim)
    topology.create_connectivity(dim, dim - 1)
    facet_cells = topology.connectivity(dim - 1, dim)
    cells = facet_cells.array[facet_cells.offsets[facets]]
    cell_facets = topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)[cells]
    local = np.argmax(cell_facets == facets[:, None], axis=1)
    return cells, V.dofmap.list[cells, local]  # a cell's degrees of freedom have the order of its facets


def owned_on_facets(space: fem.FunctionSpace, facets: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Owned degrees of freedom on these facets, those that other ranks pass included (collective)."""
    dofs = fem.locate_dofs_topological(space, space.mesh.topology.dim - 1, facets)
    return dofs[dofs < space.dofmap.index_map.size_local]


def assembled(form: ufl.Form | fem.Form, entity_maps: Sequence[dolfinx.mesh.EntityMap] = ()) -> Array:
    """Vector of a linear form, complete for owned entries only (collective)."""
    vector = fem.assemble_vector(fem.form(form, entity_maps=entity_maps))
    vector.scatter_reverse(la.InsertMode.add)
    return vector.array
