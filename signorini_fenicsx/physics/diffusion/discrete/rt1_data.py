"""The data of a problem for RT1: their moments against the hats, and κ and c in points of cells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem, la

from signorini_fenicsx.base.arrays import AnyIndices, Array
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.discrete.datum import DEGREES, Datum, quadrature_degree
from signorini_fenicsx.discrete.hybrid_system import eliminate, responses
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, linear_values, means_of_linear
from signorini_fenicsx.discrete.points import CellPoints, facet_quadrature
from signorini_fenicsx.discrete.vertex_laws import VertexLaws, vertex_laws
from signorini_fenicsx.physics.diffusion.discrete.added_flux import AddedFlux
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import at_vertices
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.raviart_thomas import Cells, order_number, reference
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces
from signorini_fenicsx.physics.diffusion.discrete.storing import hats_in_places


@dataclass(frozen=True, kw_only=True)
class RT1Data(Data):
    """The data on a mesh for RT1, beside their means.

    Attributes:
        laws_at: The laws on Γ_S at the vertices of facets.
        cells_at: The laws in Ω at the vertices of cells, of none without laws.
        lift: û where it is given, and at the reference of its law on Γ_S, 0 elsewhere: unknowns of this rank, ghosts
            too.
        load: ⟨g_N, q⟩ for each owned unknown q, and the fluxes at the references of the laws.
        given_flux: Π₁g_N at the vertices of the facets of Γ_N, shape (facets, d).
        fixed: Owned unknowns of Γ_D, and of slaves that are tied.
        constant: What is taken from u, see `less`.
    """

    laws_at: VertexLaws
    cells_at: VertexLaws
    lift: Array
    load: Array
    given_flux: Array
    fixed: npt.NDArray[np.int32]
    constant: float = 0.0

    @cached_property
    def chains(self) -> Chains:
        """The law of each facet vertex of Γ_S and, with laws in Ω, of each vertex of each owned cell."""
        return self.laws_at.chains.followed_by(self.cells_at.chains)

    def products(self, spaces: RT1Spaces, cells: Cells) -> Array:
        """(κ⁻¹τ, τ') for all pairs of the basis on cells, shape (cells, basis, basis) (collective)."""
        if self.kappa.polynomial == 0:
            kappa = self.kappa.values(data_points(spaces, cells.numbers, 0).first)
            return cells.product(np.linalg.inv(as_matrices(kappa, spaces.dim)[:, 0]))
        points = data_points(spaces, cells.numbers, quadrature_degree(self.kappa))
        inverse = np.linalg.inv(as_matrices(self.kappa.values(points), spaces.dim))
        basis = reference(spaces.dim).permuted(points.points)[order_number(spaces.order[cells.numbers])]
        return cells.product_in_points(inverse, basis, points.weights)

    def of_b(self, spaces: RT1Spaces, cells: Cells) -> Array | None:
        """(κ⁻¹b, τ) for the basis, shape (cells, basis), as the products have κ; None without b (collective)."""
        if self.b is None:
            return None
        points = data_points(spaces, cells.numbers, self.degree_of(self.b))
        basis = reference(spaces.dim).permuted(points.points)[order_number(spaces.order[cells.numbers])]
        values = self.b.over_kappa(points, self.kappa)
        return np.asarray(np.einsum("q,nqi,nij,nqjb->nb", points.weights, values, cells.derivative, basis))

    def degree_of(self, b: AddedFlux) -> int:
        """Degree for `data_points` of κ⁻¹b."""
        return max(b.degree, 0 if self.kappa.polynomial == 0 else quadrature_degree(self.kappa))

    def by_kappa(self, spaces: RT1Spaces, sigma: Array) -> Array:
        """(φ_v κ⁻²σ, τ) for the hats of the vertices of cells and the basis, shape (cells, basis, d + 1) (collective).

        With a given flux b it is σ − b in the place of σ, unless b is a multiple of κ.

        Args:
            spaces: The spaces.
            sigma: The values of σ at the nodes of the owned cells.
        """
        found = np.zeros((len(sigma), len(reference(spaces.dim).basis), spaces.dim + 1))
        for cells in spaces.blocks():
            numbers, points = cells.numbers, data_points(spaces, cells.numbers, quadrature_degree(self.kappa))
            weight = hats_in(spaces, points) / self.kappa.values(points).T[:, :, None] ** 2
            basis = reference(spaces.dim).permuted(points.points)[order_number(spaces.order[numbers])]
            of_sigma = cells.coefficients(sigma[numbers])
            values = np.einsum("nij,nqjb,nb->nqi", cells.map, basis, of_sigma, optimize=True)
            if self.b is not None and not self.b.by_kappa:
                values = values - self.b.at(points, self.kappa)
            found[numbers] = np.einsum(
                "q,qnv,nqi,nij,nqjb->nbv", points.weights, weight, values, cells.derivative, basis, optimize=True
            )
        return found

    def reactions(self, spaces: RT1Spaces, cells: Cells) -> Array | None:
        """(cφ_v, φ_w) for the hats of the vertices of cells; None if c = 0 (collective)."""
        if self.c_h is None:
            return None
        if self.quasilinear is not None and self.quasilinear.storing is not None:
            return self.quasilinear.storing.products(cells.numbers)
        return _products(spaces, self.c, cells)

    def _projection_of_f(self, spaces: RT1Spaces) -> Array:
        """Π₁f at the vertices of the owned cells (collective)."""
        return projected(spaces, self.f)

    def _without_sources(self, spaces: RT1Spaces, traces: Array) -> tuple[Array, Array]:
        """See `Data` (collective)."""
        element, hats = reference(spaces.dim), hats_in_places(spaces)
        means, moments = np.empty((len(traces), len(hats))), np.empty((len(traces), len(hats), len(hats)))
        for cells in spaces.blocks():
            numbers, product, of_b = cells.numbers, self.products(spaces, cells), self.of_b(spaces, cells)
            if len(numbers) == 0:  # other ranks have more cells
                continue
            of_traces = (traces[numbers] @ element.tractions)[:, None]
            none, compliance = np.zeros((len(numbers), len(hats))), responses(product, len(hats))[1]
            block = eliminate(cells, of_traces, product, none, 0.0 if of_b is None else of_b)
            means[numbers] = (block.u[:, :, 0] + block.u_of_f) @ hats.T
            share = cells.measure[:, None, None] / len(hats)
            moments[numbers] = share * (hats @ compliance @ hats.T)
        return means, moments

    def moments_of_f(self, spaces: RT1Spaces, cells: Cells) -> Array:
        """(f, φ_v) for the hats of the vertices of cells, shape (cells, d + 1) (collective)."""
        moments = _moments(spaces, self.f, cells)
        if self.memory is not None:
            moments += _times(cells.hat_masses(), spaces.scalar_values(self.memory)[cells.numbers])
        if self.constant == 0 or (reactions := self.reactions(spaces, cells)) is None:
            return moments
        return moments - self.constant * reactions.sum(axis=2)

    def mean_sources(self, spaces: RT1Spaces, u: fem.Function) -> Array:
        """See `Data.mean_sources` (collective)."""
        values, means = spaces.scalar_values(u), np.empty(len(spaces.order))
        for cells in spaces.blocks():
            moments, reactions = self.moments_of_f(spaces, cells), self.reactions(spaces, cells)
            if reactions is not None:
                moments -= _times(reactions, values[cells.numbers])
            means[cells.numbers] = moments.sum(axis=1) / cells.measure
        return means

    def in_cells(self, spaces: RT1Spaces, sigma: Array, u: Array) -> tuple[Array, Array]:
        """U less its reference and −s at the vertices of the owned cells, of fields as `VertexSystem` has them.

        Collective. s is the linear function with (s, v) = (f − cu + ∇·σ, v) for all linear v.

        Returns:
            The means of u by the hats, less the references, and the values of −s, shape (sites,) each.
        """
        s, free = np.empty_like(u), reference(spaces.dim).free
        for cells in spaces.blocks():
            of_s = self.moments_of_f(spaces, cells) + cells.coefficients(sigma[cells.numbers])[:, free:]
            if (reaction := self.reactions(spaces, cells)) is not None:
                of_s -= np.einsum("nvw,nw->nv", reaction, u[cells.numbers])
            s[cells.numbers] = linear_values(of_s, cells.measure)
        return means_of_linear(u).ravel() - self.cells_at.p_h, -s.ravel()

    def less(self, spaces: Spaces, constant: float) -> RT1Data:
        """The data of the problem for u − constant, see `Data.less` (collective)."""
        if constant == 0:
            return self
        assert isinstance(spaces, RT1Spaces)
        p_h, outer = self.laws_at.p_h.copy(), spaces.outer_sites
        p_h[outer] -= constant
        given = np.concatenate([spaces.unknowns(spaces.dirichlet).ravel(), spaces.site_kinds.unknown[outer]])
        means = super().less(spaces, constant)
        assert isinstance(means, RT1Data)
        inside = replace(self.cells_at, p_h=self.cells_at.p_h - constant)
        return replace(means, constant=constant, cells_at=inside)._moved(
            spaces, given, self.lift[given] - constant, p_h
        )

    @property
    def bound(self) -> Array:
        """See `Data.bound`."""
        return self.laws_at.p_h

    def with_bound(self, spaces: Spaces, psi_h: Array) -> RT1Data:
        """See `Data.with_bound` (collective)."""
        assert isinstance(spaces, RT1Spaces)
        return self._moved(spaces, spaces.site_kinds.unknown, psi_h, psi_h)

    def _moved(self, spaces: RT1Spaces, unknowns: AnyIndices, values: Array, p_h: Array) -> RT1Data:
        """The data with other values of the lift at some owned unknowns, and other references (collective)."""
        lift = la.vector(spaces.traces.dofmap.index_map, spaces.dim)
        lift.array[:] = self.lift
        lift.array[unknowns] = values
        lift.scatter_forward()
        return replace(self, lift=lift.array.copy(), laws_at=replace(self.laws_at, p_h=p_h))


def data_points(spaces: RT1Spaces, numbers: npt.NDArray[np.int32], degree: int) -> CellPoints:
    """Points in cells for data of this degree against two linear functions."""
    rule = basix.make_quadrature(SIMPLEX[spaces.dim], min(degree + 2, DEGREES[1]))
    return CellPoints(spaces.mesh, numbers, *rule)


def hats_in(spaces: RT1Spaces, points: CellPoints) -> Array:
    """The hats of the vertices of cells, in their order, in points, shape (points, cells, d + 1)."""
    hats: Array = points.barycentric[0][:, spaces.order[points.cells]]
    return hats


def _moments(spaces: RT1Spaces, datum: Datum, cells: Cells) -> Array:
    """(f, φ_v) of a datum for the hats of the vertices of cells, shape (cells, d + 1) (collective)."""
    points = data_points(spaces, cells.numbers, quadrature_degree(datum) - 2)  # the rule of the means
    values = cells.determinant[:, None] * points.weights * datum.values(points)
    return np.asarray(np.einsum("nq,qnv->nv", values, hats_in(spaces, points)))


def _products(spaces: RT1Spaces, datum: Datum, cells: Cells) -> Array:
    """(cφ_v, φ_w) of a datum for the hats of the vertices of cells (collective)."""
    if datum.polynomial == 0:
        return cells.hat_masses(datum.values(data_points(spaces, cells.numbers, 0).first)[:, 0])
    points = data_points(spaces, cells.numbers, quadrature_degree(datum))
    hats = hats_in(spaces, points)
    scale = cells.determinant[:, None] * points.weights * datum.values(points)
    return np.asarray(np.einsum("nq,qnv,qnw->nvw", scale, hats, hats, optimize=True))


def _times(matrices: Array, values: Array) -> Array:
    """The product with a matrix for each cell."""
    return np.asarray((matrices @ values[:, :, None])[:, :, 0])


def projected(spaces: RT1Spaces, datum: Datum, u: Array | None = None) -> Array:
    """Π₁ of a datum, or of its product with u, at the vertices of the owned cells, shape (cells, d + 1) (collective).

    Args:
        spaces: The spaces.
        datum: The datum.
        u: The values of u at the vertices, in the order of `LinearTraces.order`.
    """
    values = np.empty(spaces.order.shape)
    for cells in spaces.blocks():
        of_datum = _moments(spaces, datum, cells) if u is None else _products(spaces, datum, cells)
        moments = of_datum if u is None else _times(of_datum, u[cells.numbers])
        values[cells.numbers] = _times(np.linalg.inv(cells.hat_masses()), moments)
    return values


def as_matrices(kappa: Array, dim: int) -> Array:
    """κ in points as matrices, of scalars or matrices in points, shape (cells, points, d, d)."""
    return np.asarray(np.eye(dim) * kappa[:, :, None, None]) if kappa.ndim == 2 else kappa


def rt1_data(spaces: RT1Spaces, data: Data) -> RT1Data:
    """The data for RT1, from those with their means, which are checked (collective)."""
    laws, sites = vertex_laws(spaces, data.laws.of_parts), spaces.site_kinds["facet"]
    lift, load = fem.Function(spaces.traces), la.vector(spaces.traces.dofmap.index_map, spaces.dim)
    on_dirichlet, on_tied = map(spaces.unknowns, (spaces.dirichlet, spaces.boundary_facets(spaces.tied)))
    lift.x.array[on_dirichlet] = _linear(spaces, data.u_D, spaces.dirichlet)
    lift.x.array[sites.unknown] = laws.p_h
    lift.x.scatter_forward()
    given_flux = _linear(spaces, data.g_N, spaces.neumann)
    load.array[spaces.unknowns(spaces.neumann)] = spaces.neumann.of_linear(given_flux)
    load.array[sites.unknown] = sites.measure * laws.flux_h
    owned = spaces.dim * spaces.traces.dofmap.index_map.size_local
    given = {name: getattr(data, name) for name in data.__dataclass_fields__}
    linear = RT1Data(
        **given,
        laws_at=laws,
        cells_at=at_vertices(spaces, data.inside),
        lift=lift.x.array.astype(np.float64),
        load=load.array[:owned].copy(),
        given_flux=given_flux,
        fixed=np.append(on_dirichlet, on_tied),
    )
    if data.quasilinear is None:
        return linear
    of_u = replace(data.quasilinear, spaces=spaces)
    return replace(linear, quasilinear=of_u).with_kappa(spaces, of_u.first)


def _linear(spaces: RT1Spaces, datum: Datum, facets: BoundaryFacets) -> Array:
    """The vertex values of the linear function on each facet that is nearest to a datum (collective)."""
    points = facet_quadrature(spaces.mesh, facets.facets, min(quadrature_degree(datum) + 1, DEGREES[1]))
    return linear_values(facets.moments(datum.values(points), points.points, points.weights), facets.measure)
