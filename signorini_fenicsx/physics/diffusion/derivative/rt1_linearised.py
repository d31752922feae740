"""A diffusion problem with RT1 linearised at its solution, see `linearised` for RT0.

The traces û are unknowns on all facets, and on Γ_S their means weighted by the hats. With all of it

    (κ⁻¹σ, τ) + (u, ∇·τ) − ⟨û, τ·n⟩ + (∇·σ, v) − (cu, v) − ⟨σ·n, q⟩ = −(f, v) − ⟨g, q⟩   for all τ, v, and q,

q = 0 where û is given, and g the fluxes of Γ_N and of the laws, springs among them. The left side is symmetric. So with
J on the right side, and û = 0 where it is given, its solution is the adjoint state (λ_σ, λ_u, λ_û), and

    dJ = −(d(κ⁻¹)σ, λ_σ) + (dc u − df, λ_u) − ⟨dg, λ_û⟩ + J_û dû + ⟨dû, λ_σ·n⟩ where û is given.

κ and c are seen by their values in the points of their quadratures, and so are data on the boundary; f by its moments.
"""

from collections.abc import Iterator, Mapping
from functools import cached_property, partial
from itertools import combinations

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array, Indices, Mask, scaled
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import cell_dofs
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions
from signorini_fenicsx.derivatives.linearised import Effect, HybridLinearised, Solved, by_moments, to_values, units
from signorini_fenicsx.discrete.datum import DEGREES, quadrature_degree
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells, linear_from_means
from signorini_fenicsx.discrete.seen import Seen, derivative_by, seen_in_points
from signorini_fenicsx.physics.diffusion.derivative.linearised import check_differentiable
from signorini_fenicsx.physics.diffusion.discrete.raviart_thomas import Cells, reference
from signorini_fenicsx.physics.diffusion.discrete.rt1_data import as_matrices, data_points, hats_in
from signorini_fenicsx.physics.diffusion.rt1_solution import RT1Solution
from signorini_fenicsx.physics.diffusion.solve.rt1_backend import RT1Backend


class LinearisedFluxes(HybridLinearised):
    """A diffusion problem with RT1 linearised at its solution; biactive sites are vertices of facets of Γ_S."""

    refusal = "vertex", "may leave a slope that it shares with others of its facet, so there is none"

    def scales(self) -> tuple[Array, Array]:
        """The largest u and the largest σ, for all sites (collective)."""
        return self.largest(self._solution.u.x.array, self._solution.sigma_values)

    def refused(self, chains: Chains) -> Mask:
        """The biactive sites at the end of a slope that couples vertices: neighbours change the rays."""
        coupled = (self._data.laws_at.shared > 0).any(axis=1) & (not self._law.plain)
        return self.biactive & (chains.kinds == Condition.ROBIN).any(axis=1) & coupled.repeat(self._spaces.dim)

    def plain(self) -> Iterator[tuple[str, Seen]]:
        """The moments of f, and κ, c and a given flux b in points of cells (collective)."""
        spaces, data = self._spaces, self._data
        for name, datum in (("kappa", data.kappa), ("c", data.c)):
            if datum.pieces is None:
                yield name, self._in_quadrature(datum.ufl, quadrature_degree(datum))
        if data.f.pieces is None:
            dofs = np.take_along_axis(cell_dofs(spaces.scalar_space), spaces.order, axis=1).ravel()
            dx = ufl.dx(degree=quadrature_degree(data.f))
            yield "f", Seen(lambda v: data.f.ufl * v * dx, spaces.scalar_space, dofs, np.ones(len(dofs)))
        if data.b is not None and (b := data.b.in_ufl) is not None:
            yield "b", self._in_quadrature(b, data.degree_of(data.b))

    def _in_quadrature(self, number: Expr, degree: int) -> Seen:
        """A datum in the points that `data_points` has for this degree."""
        degree = min(degree + 2, DEGREES[1])
        points, weights = basix.make_quadrature(SIMPLEX[self._spaces.dim], degree)
        scale = self._spaces.cell_measures[:, None] * weights / weights.sum()
        return seen_in_points(self._spaces.mesh, number, (points, weights), scale, degree)

    def effects(self) -> Iterator[tuple[str, Effect]]:
        """What u_D and g_N make: values of û ("lift"), its right side ("load") (collective)."""
        spaces, data = self._spaces, self._data
        for name, datum, facets, kind, matrices in (
            ("u_D", data.u_D, spaces.dirichlet, "lift", to_values),
            ("g_N", data.g_N, spaces.neumann, "load", units),
        ):
            places, degree = spaces.unknowns(facets), quadrature_degree(datum) + 1
            yield from by_moments(spaces, name, kind, datum, facets, places, matrices(facets), degree)

    def lines(self, segment: Indices) -> Iterator[tuple[str, Effect]]:
        """See `Linearised.lines` (collective)."""
        solution = self._solution
        penalty = partial(Chains.with_penalty, penalty=solution.method.penalty, eps=solution.options.eps)
        return self._lines(self._data.laws_at, (segment, solution.iterate.means), penalty)

    def change(self, changes: Mapping[str, Array]) -> dict[str, fem.Function]:
        """The changes of σ, u and p with these numbers (collective).

        A biactive site moves along one of the two rays of the moved corner.

        Raises:
            InputError: If vertices may leave a slope that they share.
            NumericalFailure: If the sets of those sites do not settle.
        """
        spaces, system = self._spaces, self._backend.system
        numbers = {kind: np.zeros(len(system.load)) for kind in ("lift", "load")}
        sigma, u, x = self._responded(numbers, changes)
        p = linear_from_means(x[spaces.site_kinds.unknown].reshape(-1, spaces.dim))
        return {"sigma": spaces.flux(sigma), "u": spaces.scalar(u), "p": spaces.linear_multiplier(p)}

    def _solved(self, numbers: Mapping[str, Array], conditions: SiteConditions, segment: Indices) -> Solved:
        """The traces of the change on these segments (collective)."""
        (kind, _), backend, actual = self._spaces.site_kinds, self._backend, self._law.conditions(segment)
        held, lift, load = actual.kind == Condition.ZERO_TRACE, numbers["lift"].copy(), numbers["load"].copy()
        lift[kind.unknown] = np.where(held, conditions.value, 0.0)
        load[kind.unknown] += kind.measure * np.where(held, 0.0, conditions.value)
        x = backend.solve_homogeneous(actual, load, lift)
        flux, x = backend.flux(x, numbers["load"]), np.array(x.array_r)
        return *conditions.clean(x[kind.unknown], flux, np.inf), x

    def _by_changes(self, changes: Mapping[str, Array]) -> tuple[Array, Array]:
        """The functional of τ and the moments of f that the changes of data in cells give (collective)."""
        spaces, element, sigma = self._spaces, reference(self._spaces.dim), self._solution.sigma_values
        moments = np.zeros((len(spaces.order), spaces.dim + 1))
        functional = np.zeros((len(moments), element.basis.shape[1]))
        moments += changes.get("f", np.zeros(moments.size)).reshape(moments.shape)
        for numbers, weights, hats, _ in self._in_points("c"):
            change = weights * changes["c"].reshape(len(moments), -1)[numbers]
            moments[numbers] -= np.einsum("nq,nqv,nqw,nw->nv", change, hats, hats, self._u[numbers], optimize=True)

        def add(numbers: npt.NDArray[np.int32], weights: Array, hats: Array, strain: Array) -> None:
            """Add the products with the basis of what replaces κ⁻¹σ in points."""
            at_nodes = np.einsum("nq,nqa,nqi->nai", weights, _quadratics(hats), strain, optimize=True)
            pulled = at_nodes @ Cells(spaces.vertices[numbers]).map
            functional[numbers] += np.tensordot(pulled, element.at_nodes, ((1, 2), (0, 1)))

        for numbers, weights, hats, kappa in self._in_points("kappa"):
            size, inverse = kappa.shape[2:], np.linalg.inv(as_matrices(kappa, spaces.dim))
            change = as_matrices(changes["kappa"].reshape(len(moments), -1, *size)[numbers], spaces.dim)
            driving = _quadratics(hats) @ sigma[numbers] - self._b_at(numbers)
            add(numbers, weights, hats, (inverse @ change @ inverse @ driving[..., None])[..., 0])
        for numbers, weights, hats, kappa in self._in_points("b"):
            change = changes["b"].reshape(len(moments), -1, spaces.dim)[numbers]
            add(numbers, weights, hats, scaled(np.linalg.inv(as_matrices(kappa, spaces.dim)), change))
        return functional, moments

    def by(self, J: Form, besides: None) -> dict[str, Array]:
        """See `Linearised.by`."""
        spaces, system, (kind, _) = self._spaces, self._backend.system, self._spaces.site_kinds
        solution, maps = self._solution, self._spaces.entity_maps
        by_sigma, by_u, by_p = (derivative_by(each, J, maps) for each in (solution.sigma, solution.u, solution.p))
        of_p = linear_from_means(spaces.linear_values(by_p)).ravel()

        def solve(load: Array) -> Array:
            load = load.copy()
            load[kind.unknown] -= of_p
            return system.everywhere(self._backend.solve_homogeneous(self._conditions, load).array_r)

        sigma, u, x = system.respond(spaces.by_basis(by_sigma), -spaces.scalar_values(by_u), solve=solve)
        forces = system.forces(sigma)
        line = np.where(self._held, of_p + forces[kind.unknown], -kind.measure * x[kind.unknown])
        return self._by_cells(sigma, u) | {"lift": forces, "load": -x[: len(forces)], "line": line, "f": -u.ravel()}

    def _by_cells(self, sigma: Array, u: Array) -> dict[str, Array]:
        """The derivatives by κ and c in the points of their quadratures, from the adjoint state (collective)."""
        by = {name: [np.empty(0)] for name in ("kappa", "c", "b") if name in self.seen}
        for numbers, weights, hats, _ in self._in_points("c"):
            values = np.einsum("nqv,nv->nq", hats, u[numbers]) * np.einsum("nqv,nv->nq", hats, self._u[numbers])
            by["c"].append((weights * values).ravel())
        for numbers, weights, hats, kappa in self._in_points("kappa"):
            shapes, inverse = _quadratics(hats), np.linalg.inv(as_matrices(kappa, self._spaces.dim))
            driving = shapes @ self._solution.sigma_values[numbers] - self._b_at(numbers)
            strain = np.einsum("nqij,nqj->nqi", inverse, driving)
            adjoint = np.einsum("nqji,nqj->nqi", inverse, shapes @ sigma[numbers])
            entries = "nq,nqi,nqj->nqij" if self._data.kappa.shape else "nq,nqi,nqi->nq"
            by["kappa"].append(np.einsum(entries, weights, adjoint, strain).ravel())
        for numbers, weights, hats, kappa in self._in_points("b"):
            inverse = np.linalg.inv(as_matrices(kappa, self._spaces.dim))
            by["b"].append((weights[..., None] * scaled(inverse, _quadratics(hats) @ sigma[numbers])).ravel())
        return {name: np.concatenate(blocks) for name, blocks in by.items()}

    def _b_at(self, numbers: npt.NDArray[np.int32]) -> Array | float:
        """The given flux b in the points of κ on some cells; 0 without it (collective)."""
        b, kappa = self._data.b, self._data.kappa
        return 0.0 if b is None else b.at(data_points(self._spaces, numbers, quadrature_degree(kappa)), kappa)

    @cached_property
    def _u(self) -> Array:
        """U at the vertices of the cells."""
        return self._spaces.scalar_values(self._solution.u)

    def _in_points(self, name: str) -> Iterator[tuple[npt.NDArray[np.int32], Array, Array, Array]]:
        """The cells, block by block, where κ, c or b is seen in points (collective).

        Yields:
            Their numbers; the weights of the points, shape (cells, points); the hats there, shape (cells, points,
            d + 1); and the datum there, for b κ.
        """
        if name not in self.seen:
            return
        spaces, data = self._spaces, self._data
        datum = data.kappa if name == "b" else getattr(data, name)
        degree = data.degree_of(data.b) if name == "b" else quadrature_degree(datum)
        for numbers in blocks_of_cells(spaces.mesh):
            points = data_points(spaces, numbers, degree)
            weights = spaces.cell_measures[numbers, None] * points.weights / points.weights.sum()
            hats = hats_in(spaces, points).transpose(1, 0, 2)
            yield numbers, weights, hats, datum.values(points)


def _quadratics(hats: Array) -> Array:
    """The quadratic functions of the nodes, see `raviart_thomas.nodes`, shape (…, nodes), by the hats."""
    edges = [4 * hats[..., i] * hats[..., j] for i, j in combinations(range(hats.shape[-1]), 2)]
    return np.concatenate([hats * (2 * hats - 1), np.stack(edges, axis=-1)], axis=-1)


def linearised(solution: RT1Solution, tolerance: float) -> LinearisedFluxes:
    """A problem linearised at its solution, with the factors of the solver that has just solved it (collective).

    Raises:
        InputError: If κ depends on u.
    """
    check_differentiable(solution)
    if solution.data.quasilinear is not None:
        raise InputError("derivatives: with RT1 there are none where κ depends on u; take RT0")
    return LinearisedFluxes(solution, solution.backend_of(RT1Backend), solution.law, tolerance)
