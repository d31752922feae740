"""What every physics has on a mesh: P0 on its cells and on Γ_S, and the facets of each kind of boundary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, positions
from signorini_fenicsx.base.owned import (
    cell_nodes,
    cells_behind,
    cells_of_facets,
    function_of,
    number_of_cells,
    owned_cells,
)
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.contact.sites import SiteKind, Sites
from signorini_fenicsx.discrete.cell_shapes import facet_corners, nearest
from signorini_fenicsx.discrete.kept_forms import Build, Coefficient, KeptForms
from signorini_fenicsx.discrete.known import Kept
from signorini_fenicsx.expressions.cutting import Frame
from signorini_fenicsx.meshes.domain import Domain, facet_pairs

if TYPE_CHECKING:  # it needs these facets
    from signorini_fenicsx.discrete.pairing import MeshPair

type Names = Sequence[str]
type Facets = npt.NDArray[np.int32]

SIGNORINI = 1
DIRICHLET = 2
NEUMANN = 3


@dataclass(frozen=True, kw_only=True)
class MeshSpaces:
    """P0 on the cells and on Γ_S, and the facets of Γ_S, Γ_N and Γ_D. In elastic contact Γ_C is this Γ_S.

    Facet arrays run over the Γ_S facets of this rank, which are all owned (possibly none), in the order of the
    multiplier's degrees of freedom.

    Attributes:
        domain: The mesh and its boundary parts.
        Q: P0 on the cells.
        Lambda: P0 on the facet submesh of Γ_S.
        entity_map: From the submesh of Γ_S to the mesh.
        part_names: The parts of Γ_S.
        part_of_facet: Index into `part_names` for each Γ_S facet.
        facets: Mesh facet of each Γ_S facet.
        cells: Mesh cell behind each Γ_S facet.
        facet_measure: |e| of each Γ_S facet.
        dirichlet_facets: Mesh facets of Γ_D on this rank.
        has_dirichlet: Whether any rank has facets of Γ_D.
        neumann_facets: Mesh facets of Γ_N on this rank.
        inner: The facets of Γ_S inside the domain, with those of their other sides.
        pairs: Pairs of surfaces. A slave with a law is in Γ_S: there p is a jump.
        n: Outer unit normal.
        ds: Measure of Γ_S on the mesh.
        ds_dirichlet: Measure of Γ_D on the mesh.
        ds_neumann: Measure of Γ_N on the mesh.
        kept_forms: The forms of `kept`.
        kept_results: What is proved of data and of constants on this mesh.
        notices: What is worth knowing of the mesh with these parts, in sentences.
    """

    domain: Domain
    Q: fem.FunctionSpace
    Lambda: fem.FunctionSpace
    entity_map: dolfinx.mesh.EntityMap
    part_names: tuple[str, ...]
    part_of_facet: npt.NDArray[np.int32]
    facets: npt.NDArray[np.int32]
    cells: npt.NDArray[np.int32]
    facet_measure: Array
    dirichlet_facets: npt.NDArray[np.int32]
    has_dirichlet: bool
    neumann_facets: npt.NDArray[np.int32]
    inner: InnerFacets
    pairs: tuple[MeshPair, ...] = ()
    n: ufl.FacetNormal
    ds: ufl.Measure
    ds_dirichlet: ufl.Measure
    ds_neumann: ufl.Measure
    kept_forms: KeptForms = field(default_factory=KeptForms)
    kept_results: Kept = field(default_factory=Kept)
    notices: list[str] = field(default_factory=list)

    @property
    def mesh(self) -> dolfinx.mesh.Mesh:
        """The mesh."""
        return self.domain.mesh

    @cached_property
    def held(self) -> bool:
        """Whether each component of the domain has facets of Γ_D (collective when first used)."""
        from signorini_fenicsx.discrete.bodies import without  # which needs these spaces

        return self.has_dirichlet and (not self.several or without(self, self.dirichlet_facets)[1] == 0)

    @property
    def several(self) -> bool:
        """Whether the domain may have several components, between which there are laws."""
        return self.inner.present or len(self.pairs) > 0

    @cached_property
    def bodies(self) -> npt.NDArray[np.int64]:
        """The number of its body for each owned cell, see `discrete.bodies` (collective when first used)."""
        from signorini_fenicsx.discrete.bodies import bodies  # which needs these spaces

        return bodies(self.crouzeix_raviart)

    @property
    def facets_of_mesh(self) -> int:
        """Number of facets of the mesh, over all ranks."""
        return self.mesh.topology.index_map(self.mesh.topology.dim - 1).size_global

    @cached_property
    def outer_rows(self) -> npt.NDArray[np.intp]:
        """The rows of `facets` that are on the boundary of the domain, neither inside it nor opposite to a master."""
        return np.setdiff1d(np.arange(len(self.facets)), np.append(self.inner.rows, self.slave_rows))

    @property
    def slave_rows(self) -> npt.NDArray[np.intp]:
        """The rows of `facets` of slaves of pairs."""
        return np.concatenate([np.empty(0, dtype=np.intp), *map(self.rows_of, self.pairs)])

    def rows_on(self, *parts: str) -> npt.NDArray[np.intp]:
        """The rows of `facets` that are on some parts of Γ_S."""
        return np.flatnonzero(np.isin(self.part_of_facet, [self.part_names.index(part) for part in parts]))

    def rows_of(self, pair: MeshPair) -> npt.NDArray[np.intp]:
        """The rows of `facets` of the slaves of a pair; none if they are tied."""
        if pair.parts.tied:
            return np.empty(0, dtype=np.intp)
        return positions(self.facets, pair.slaves)

    @cached_property
    def site_kinds(self) -> Sites:
        """The facets of Γ_S, and the owned cells for laws in Ω (collective when first used)."""
        facets, cells = self.facet_measure, self.cell_measures
        unknown = cells_and_dofs(self.crouzeix_raviart, self.facets)[1]
        return Sites(
            SiteKind("facet", len(facets), np.arange(len(facets)), facets, unknown=unknown),
            SiteKind("cell", len(cells), np.arange(len(cells)), cells, unknown=unknown[:0]),
        )

    def note(self, sentence: str) -> None:
        """Add a notice, once."""
        if sentence not in self.notices:
            self.notices.append(sentence)

    @cached_property
    def crouzeix_raviart(self) -> fem.FunctionSpace:
        """Crouzeix-Raviart functions, with one unknown per facet."""
        return fenicsx.function_space(self.mesh, ("CR", 1))

    @cached_property
    def on_boundary(self) -> tuple[fem.FunctionSpace, dolfinx.mesh.EntityMap]:
        """Linear functions on each boundary facet, and the map from their mesh (collective when first used)."""
        dim, topology = self.mesh.topology.dim, self.mesh.topology
        facets = dolfinx.mesh.exterior_facet_indices(topology)
        boundary, entity_map = fenicsx.submesh(self.mesh, dim - 1, facets)
        return fenicsx.function_space(boundary, ("DG", 1)), entity_map

    @property
    def entity_maps(self) -> list[dolfinx.mesh.EntityMap]:
        """The maps that forms need from other meshes."""
        return [self.entity_map, *([self.on_boundary[1]] if "on_boundary" in vars(self) else [])]

    @cached_property
    def cell_measures(self) -> Array:
        """|T| of the owned cells."""
        measures = assembled(fem.Constant(self.mesh, 1.0) * ufl.TestFunction(self.Q) * ufl.dx)
        return measures[: number_of_cells(self.mesh)]

    @cached_property
    def cell_diameters(self) -> Array:
        """The longest edge of each owned cell."""
        return self.mesh.h(self.mesh.topology.dim, owned_cells(self.mesh))

    @cached_property
    def length(self) -> float:
        """L = |Ω|^(1/d) (collective when first used)."""
        return float(self.mesh.comm.allreduce(self.cell_measures.sum()) ** (1 / self.mesh.topology.dim))

    @property
    def frame(self) -> Frame:
        """The domain, for enclosures (collective when first used)."""
        return self.domain.frame

    @property
    def nodes(self) -> npt.NDArray[np.integer]:
        """The nodes at the vertices of the owned cells, in the order of values there, shape (cells, d + 1)."""
        return cell_nodes(self.mesh)

    @property
    def corners(self) -> Array:
        """The vertices of the facets of Γ_S, in the order of values there, shape (facets, d, d)."""
        return facet_corners(self.mesh, self.facets)

    @collector_off()
    def multiplier(self, values: npt.NDArray, name: str = "p") -> fem.Function:
        """A function of Λ_h with these values per Γ_S facet, ghosts updated (collective)."""
        return function_of(self.Lambda, values, name)

    @collector_off()
    def linear_multiplier(self, values: npt.NDArray) -> fem.Function:
        """A function that is linear on each Γ_S facet, of values at `corners`, shape (facets, d, …) (collective)."""
        space = fenicsx.function_space(self.Lambda.mesh, ("DG", 1, values.shape[2:]))
        function = fem.Function(space, name="values")
        self.set_linear(function, values)
        return function

    def set_linear(self, function: fem.Function, values: npt.NDArray) -> None:
        """Set such a function by its values, ghosts updated (collective)."""
        places, rows = self._linear_places
        by_node = function.x.array.reshape(-1, *values.shape[2:])
        by_node[function.function_space.dofmap.list[: len(rows)]] = values[rows[:, None], places]
        function.x.scatter_forward()

    def linear_values(self, function: fem.Function) -> npt.NDArray:
        """The values, or other coefficients, of such a scalar function at `corners`, shape (facets, d)."""
        places, rows = self._linear_places
        values = np.empty(places.shape)
        values[rows[:, None], places] = function.x.array[function.function_space.dofmap.list[: len(rows)]]
        return values

    @property
    def _linear_places(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.int32]]:
        """For each cell of the mesh of Γ_S which of `corners` its vertices are, and its facet.

        Vertices are found by their places: the mesh of Γ_S may have those of a facet in another order.
        """
        gamma, dim = self.Lambda.mesh, self.mesh.topology.dim
        size = self.Lambda.dofmap.index_map.size_local
        facets = self.Lambda.dofmap.list[:size, 0]
        nodes = dolfinx.mesh.entities_to_geometry(gamma, dim - 1, np.arange(size, dtype=np.int32))
        x = gamma.geometry.x[nodes, :dim]
        return nearest(x, self.corners[facets]), facets

    @collector_off()
    def form(self, ufl_form: ufl.Form | fem.Form) -> fem.Form:
        """Compile a form that may contain functions of Λ_h (collective)."""
        return fenicsx.form(ufl_form, entity_maps=self.entity_maps)

    @collector_off()
    def integrate(self, form: ufl.Form | fem.Form) -> float:
        """Integral over all ranks (collective)."""
        return float(self.mesh.comm.allreduce(fem.assemble_scalar(self.form(form))))

    def kept(self, build: Build, *coefficients: Coefficient) -> Any:
        """The form `build(spaces, *coefficients)`, compiled at the first call, see `kept_forms` (collective).

        Args:
            build: A function of a module that gives a UFL form, or blocks of them.
            coefficients: Functions and constants with up-to-date ghost values.
        """

        def make(*copies: Coefficient) -> Any:
            return fenicsx.form(build(self, *copies), entity_maps=self.entity_maps)

        return self.kept_forms.get(build, make, coefficients)


def build_mesh_spaces(
    domain: Domain,
    signorini: Names,
    neumann: Names = (),
    inner: Names = (),
    pairs: Sequence[MeshPair] = (),
    free: Sequence[Facets] = (),
) -> MeshSpaces:
    """Create P0 and the facets for Γ_S and Γ_N made of the named parts; the rest of the boundary is Γ_D (collective).

    The parts of Γ_S in `inner` are inside the domain. Slave facets that no master covers are not in Γ_S. They are
    free, and masters and slaves that are tied have what passes: neither is in Γ_D. Facets of `free` are in Γ_N.
    """
    mesh = domain.mesh
    dim = mesh.topology.dim
    left_out = _all([each.left_out for each in pairs])
    gamma, entity_map = fenicsx.submesh(mesh, dim - 1, np.setdiff1d(_facets_of(domain, signorini), left_out))
    Lambda = fenicsx.function_space(gamma, ("DG", 0))
    submesh_cells = np.arange(gamma.topology.index_map(dim - 1).size_local, dtype=np.int32)
    facets = np.empty_like(submesh_cells)
    facets[Lambda.dofmap.list[:, 0]] = entity_map.sub_topology_to_topology(submesh_cells, inverse=False)
    neumann_facets = _all([_facets_of(domain, neumann), *free])
    across = inner_facets(domain, facets, inner)
    dirichlet_facets = np.setdiff1d(
        dolfinx.mesh.exterior_facet_indices(mesh.topology),
        np.concatenate([facets, neumann_facets, across.facets, left_out, *(each.without_law for each in pairs)]),
    )
    boundary = [
        (marker, fem.compute_integration_domains(fem.IntegralType.exterior_facet, mesh.topology, np.sort(part)))
        for marker, part in ((SIGNORINI, facets), (DIRICHLET, dirichlet_facets), (NEUMANN, neumann_facets))
    ]
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=boundary)
    part_of_facet = np.empty(len(facets), dtype=np.int32)
    for index, name in enumerate(signorini):
        part_of_facet[np.isin(facets, domain.facets[name])] = index
    measure = assembled(ufl.TestFunction(Lambda) * ds(SIGNORINI), [entity_map])
    return MeshSpaces(
        domain=domain,
        Q=fenicsx.function_space(mesh, ("DG", 0)),
        Lambda=Lambda,
        entity_map=entity_map,
        part_names=tuple(signorini),
        part_of_facet=part_of_facet,
        facets=facets,
        cells=cells_behind(mesh, facets),
        facet_measure=measure[: len(facets)],
        dirichlet_facets=dirichlet_facets,
        has_dirichlet=mesh.comm.allreduce(len(dirichlet_facets) > 0, MPI.LOR),
        neumann_facets=neumann_facets,
        inner=across,
        pairs=tuple(pairs),
        n=ufl.FacetNormal(mesh),
        ds=ds(SIGNORINI),
        ds_dirichlet=ds(DIRICHLET),
        ds_neumann=ds(NEUMANN),
        notices=[domain.changed] if domain.changed else [],
    )


def _facets_of(domain: Domain, parts: Names) -> Facets:
    return _all([domain.facets[name] for name in parts])


def _all(facets: Sequence[Facets]) -> Facets:
    return np.unique(np.concatenate([np.empty(0, dtype=np.int32), *facets]))


def cells_and_dofs(
    V: fem.FunctionSpace, facets: npt.NDArray[np.int32]
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """The cell behind each boundary facet, and the facet's degree of freedom in a space with one per facet."""
    cells, local = cells_of_facets(V.mesh, facets)
    return cells, V.dofmap.list[cells, local]  # a cell's degrees of freedom have the order of its facets


def owned_on_facets(space: fem.FunctionSpace, facets: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Owned degrees of freedom on these facets, those that other ranks pass included (collective)."""
    dofs = fem.locate_dofs_topological(space, space.mesh.topology.dim - 1, facets)
    return dofs[dofs < space.dofmap.index_map.size_local]


def extreme_around(space: fem.FunctionSpace, nodes: npt.NDArray[np.integer], values: Array, *, largest: bool) -> Array:
    """The largest or smallest value of the facets around each node, infinite where there is none (collective)."""
    sign = 1.0 if largest else -1.0
    extreme = fem.Function(space)
    extreme.x.array[:] = -np.inf
    np.maximum.at(extreme.x.array, nodes.ravel(), sign * values.ravel())
    extreme.x.petsc_vec.ghostUpdate(addv=PETSc.InsertMode.MAX_VALUES, mode=PETSc.ScatterMode.REVERSE)
    extreme.x.scatter_forward()
    return np.asarray(sign * extreme.x.array, dtype=np.float64)


def assembled(form: ufl.Form | fem.Form, entity_maps: Sequence[dolfinx.mesh.EntityMap] = ()) -> Array:
    """Vector of a linear form, complete for owned entries only (collective)."""
    vector = fem.assemble_vector(fenicsx.form(form, entity_maps=entity_maps))
    vector.scatter_reverse(la.InsertMode.add)
    return vector.array


@dataclass(frozen=True)
class InnerFacets:
    """The facets of Γ_S that are inside the domain, and on each of them a second one, of the cell on the other side.

    There p is the jump of u, and σ·n is the flux out of the named side, which is that into the other.

    Attributes:
        rows: Rows of `Spaces.facets`.
        facets: The mesh facets of the other side.
        present: Whether any rank has such facets.
    """

    rows: npt.NDArray[np.intp]
    facets: npt.NDArray[np.int32]
    present: bool


def inner_facets(domain: Domain, facets: npt.NDArray[np.int32], inner: Sequence[str]) -> InnerFacets:
    """The Γ_S facets of this rank that are on inner parts, each with the one that lies on it (collective).

    Raises:
        InputError: If the two sides of an inner part do not consist of the same facets on each rank.
    """
    rows, across = [np.empty(0, dtype=np.intp)], [np.empty(0, dtype=np.int32)]
    for name in inner:
        named, other = facet_pairs(domain, name)
        rows.append(positions(facets, named))
        across.append(other)
    return InnerFacets(np.concatenate(rows), np.concatenate(across), bool(inner))
