"""Integrals of data times an admissible v, with how wrong they may be: for v as a polynomial on each cell.

v is quadratic, for RT1 cubic, but for cells near Γ_D and near bounds of u, where it is r away from p = v + v_1 of
`conforming`. There r is within δ of a polynomial: u_D and the levels that v contains are within ρ of one, and where a
bound b cuts v off, it changes v by at most sup (b − ℓ − p)_+. `products` encloses integrals of data e times p. If e is
within ρ_e of a polynomial, a quadrature that is exact for products and squares of both polynomials has ∫er, but for

    2|T|^½ (δ(‖e‖ + 2ρ_e|T|^½) + ρ_e(‖r‖_Q + δ|T|^½)).
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import dolfinx.mesh
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices
from signorini_fenicsx.base.owned import cell_dofs
from signorini_fenicsx.base.reference_cells import SIMPLEX, positive_quadrature
from signorini_fenicsx.discrete.bernstein import coefficients_of, degree_of, exponents, in_nodes, jet, raised
from signorini_fenicsx.discrete.cell_shapes import Entities
from signorini_fenicsx.discrete.datum import DEGREES, Datum, quadrature_degree
from signorini_fenicsx.discrete.points import CellPoints, cells_of_facets, facet_quadrature, in_cells
from signorini_fenicsx.expressions import Tree, is_polynomial, values
from signorini_fenicsx.expressions.enclosures import BESIDE, distances
from signorini_fenicsx.expressions.products import EXACT, Products, products
from signorini_fenicsx.expressions.series import DEGREE
from signorini_fenicsx.expressions.simplices import barycentric_gradients, bernstein, interpolated
from signorini_fenicsx.expressions.tree import polynomial_degree
from signorini_fenicsx.physics.diffusion.bound.added_flux import beside_b
from signorini_fenicsx.physics.diffusion.bound.certify import Admissible
from signorini_fenicsx.physics.diffusion.bound.hidden import degree_near
from signorini_fenicsx.physics.diffusion.bound.mismatch import Squares
from signorini_fenicsx.physics.diffusion.bound.resolution import SMALLEST

SHARP = 1e-3
"""How far v is from polynomials is found up to about this share of its error."""
SHARPLY = 1e-6
"""How sharply what is kept of weights is found, as a share of their size."""
MOST = 12
"""Polynomials up to this degree are known as such where v contains them."""
CUT_OFFS = 2
"""Degree of a product of two χ."""


@dataclass(frozen=True)
class NearPolynomial:
    """An admissible v as polynomials.

    Integrals are arrays of two numbers, the value and its radius, of this rank. Those of data given in Python are by
    quadrature, without a radius.

    Attributes:
        pair: Has v.
        p: The polynomials on the owned cells by their Bernstein coefficients, shape (cells, nodes).
        delta: δ, per owned cell.
        off: Bound of |r|.
        degree: Of the polynomials near r.
    """

    pair: Admissible
    p: Array
    delta: Array
    off: Array
    degree: int

    @classmethod
    def of(cls, pair: Admissible) -> "NearPolynomial":
        """The polynomials near the v of a solution (collective)."""
        spaces, data = pair.solution.spaces, pair.solution.data
        v = pair.trace.v
        p = v.x.array[cell_dofs(v.function_space)] + _of_linear(pair.trace.parts.moved, degree_of(v.function_space))
        of_u = spaces.length ** (1 - spaces.mesh.topology.dim / 2) / math.sqrt(data.conductance * spaces.length)
        return cls(pair, p, *_beside(pair, p, max(SHARP * pair.resolution.error * of_u, SMALLEST)))

    @property
    def order(self) -> int:
        """The degree of v."""
        return degree_of(self.pair.trace.v.function_space)

    def at(self, cells: AnyIndices, x: Array) -> Array:
        """The polynomials and their gradients in points of owned cells, shape (n, points, 1 + d)."""
        vertices = self.pair.resolution.vertices[cells]
        slopes = barycentric_gradients(vertices)
        arms = x - vertices.mean(axis=1, keepdims=True)
        return jet(self.p[cells], 1 / slopes.shape[1] + arms @ slopes.transpose(0, 2, 1), slopes)

    def integral(self, datum: Datum, cells: AnyIndices, enough: float, *, power: int = 1) -> Array:
        """The integral of a datum times v or v² over owned cells (collective); `enough` is as in `products`."""
        if datum.pieces is None:
            degree = quadrature_degree(datum) + power * self.order
            seen = self.seen(lambda at, jet: datum.values(at) * jet[:, :, 0] ** power, cells, degree)
            return np.array([seen.sum(), 0.0])
        total, measure, found = np.zeros(2), self.pair.solution.spaces.cell_measures, np.zeros((2, len(self.off)))
        for tree, rows in datum.trees_in(cells):
            some = cells[rows]
            of_tree = self._by_moments(tree, some) if power == 1 and self.pair.resolution.returns else None
            if of_tree is None or not self._comm.allreduce(of_tree.total[1]) <= enough:
                of_tree = self._enclosed(tree, some, lambda jet: jet[:, :, 0] ** power, power * self.order, enough)
            total, found[:, some] = total + of_tree.total, (of_tree.norm, of_tree.rho)
        near = np.intersect1d(cells, self.pair.trace.cells)
        if power == 2:
            off = self.off[near] * (2 * np.abs(self.p[near]).max(axis=1, initial=0.0) + self.off[near])
            total[1] += (off * np.sqrt(measure[near])) @ found[0, near]
            return total

        def rest(at: CellPoints, jet: Array) -> Array:
            return np.asarray(jet[:, :, 0] - self.at(at.cells, at.x)[:, :, 0])

        degree = self._degree(datum)
        seen, squares = (
            self.seen(density, near, degree)[near]
            for density in (lambda at, jet: datum.values(at) * rest(at, jet), lambda at, jet: rest(at, jet) ** 2)
        )
        return total + _with_rest(seen, squares, self.delta[near], found[:, near], measure[near])

    def of_gradient(self, hidden: Array) -> Array:
        """The integral of κ∇v·∇v + 2b·∇v; quadrature may miss `hidden` of the root of the first, per owned cell.

        Collective. It is ‖κ^½∇v + κ^-½b_h‖² − ‖κ^-½b_h‖² and twice the product of ∇v with b − b_h, see `added_flux`.
        """
        less_b, energies = self.pair.solution.data.less_b(self.pair.solution.spaces), self.pair.energies
        squares = energies.squares(less_b, self.pair.trace)
        rest = hidden * (2 * np.sqrt(squares.most) + hidden)
        found = _middle(squares) + np.array([0.0, rest.sum()])
        if less_b is None:
            return found
        of_b, beside = energies.squares(less_b), beside_b(self.pair.resolution, self.pair.metric)
        off = 2 * beside @ (np.sqrt(squares.most) + np.sqrt(of_b.most) + hidden)
        return found + _middle(of_b) * np.array([-1.0, 1.0]) + np.array([0.0, off])

    def on_facets(self, datum: Datum, facets: Entities, enough: float, *, jump: bool = False) -> Array:
        """The integral of a datum times v over boundary facets; inside the domain of its jump (collective)."""
        spaces, trace, total = self.pair.solution.spaces, self.pair.trace, np.zeros(2)
        degree = min(max(self._degree(datum), quadrature_degree(datum) + self.order, degree_near(trace)), DEGREES[1])
        on, order = facet_quadrature(self._mesh, facets, degree), np.argsort(spaces.facets)
        sides, on_gamma_s = [on.cells], order[np.searchsorted(spaces.facets[order], facets)] if jump else order[:0]
        if jump:
            across = np.full(len(order), -1)
            across[spaces.inner.rows] = cells_of_facets(self._mesh, spaces.inner.facets)[0]
            sides.append(across[on_gamma_s])
        measure, known = on.scale * on.weights.sum(), [part.pieces is not None for _, part in datum.by_facets(facets)]

        def p(row: AnyIndices, x: Array) -> Array:
            values = [self.at(side[row], x)[:, :, 0] for side in sides]
            return values[0] - np.sum(values[1:], axis=0)

        if jump:
            v = trace.on_gamma_s(facet_quadrature(self._mesh, spaces.facets, degree))[on_gamma_s]
        else:
            v = trace.jet(on, near=True)[:, :, 0]
        if not all(known):
            return np.array([on.integrals(datum.values(on) * v).sum(), 0.0])
        found = np.zeros((2, len(facets)))
        for mask, part in datum.by_facets(facets):
            for tree, rows in part.trees_in(on.cells[mask]):
                some = np.flatnonzero(mask)[rows]

                def w(row: Indices, x: Array, some: Indices = some) -> Array:
                    return p(some[row], x)

                of_tree = products(tree, on.vertices[some], measure[some], w, self.order, spaces.frame, enough)
                total, found[:, some] = total + of_tree.total, (of_tree.norm, of_tree.rho)
        rest = v - p(np.arange(len(facets)), on.x)
        seen, squares = on.integrals(datum.values(on) * rest), on.integrals(rest**2)
        return total + _with_rest(seen, squares, np.sum([self.delta[side] for side in sides], axis=0), found, measure)

    def _degree(self, datum: Datum) -> int:
        """Degree of a quadrature for products and squares of polynomials near a datum and near r."""
        of_datum = DEGREE if (exact := datum.polynomial) is None or exact > EXACT else exact
        return max(of_datum + self.degree, 2 * of_datum, 2 * self.degree)

    @property
    def _comm(self) -> MPI.Comm:
        return self._mesh.comm

    @property
    def _mesh(self) -> dolfinx.mesh.Mesh:
        return self.pair.solution.spaces.mesh

    def seen(self, density: Callable[[CellPoints, Array], Array], cells: AnyIndices, degree: int) -> Array:
        """Integrals by quadrature over some owned cells, 0 over others (collective).

        Args:
            density: What is integrated, from points and the jet of v there.
            cells: The cells, ascending.
            degree: Of the quadrature, where v is quadratic.
        """
        trace, integrals = self.pair.trace, np.zeros(len(self.off))
        near = np.isin(cells, trace.cells)
        for close, some in ((True, cells[near]), (False, cells[~near])):
            of_all = min(max(degree, degree_near(trace) if close else 0), DEGREES[1])
            rule = positive_quadrature(self._mesh.basix_cell(), of_all)
            for at in in_cells(self._mesh, some.astype(np.int32), *rule):
                integrals[at.cells] = at.integrals(density(at, trace.jet(at, near=close, gradient=True)))
        return integrals

    def _by_moments(self, tree: Tree, cells: AnyIndices) -> Products:
        """The integrals of a tree times p by those with each polynomial of Bernstein, which steps keep (collective)."""
        spaces, number = self.pair.solution.spaces, self.p.shape[1]
        in_middle = values(tree, self.pair.resolution.vertices[cells].mean(axis=1))
        size = self._comm.allreduce(float(np.abs(in_middle) @ spaces.cell_measures[cells]))

        def of_each(i: int) -> Products:
            unit = replace(self, p=np.broadcast_to(np.eye(number)[i], self.p.shape))
            return unit._enclosed(tree, cells, lambda jet: jet[:, :, 0], self.order, SHARPLY * size)

        def make() -> list[Products]:
            return [of_each(i) for i in range(number)]

        found = spaces.kept_results.get(self._comm, "moments", (tree, number), (cells,), make)
        value = sum(each.value * p for each, p in zip(found, self.p[cells].T, strict=True))
        radius = sum(each.radius * abs(p) for each, p in zip(found, self.p[cells].T, strict=True))
        return replace(found[0], value=value, radius=radius)

    def _enclosed(
        self, tree: Tree, cells: AnyIndices, of_jet: Callable[[Array], Array], degree: int, enough: float
    ) -> Products:
        """The integrals of a tree times what is made of p (collective)."""
        return products(
            tree,
            self.pair.resolution.vertices[cells],
            self.pair.solution.spaces.cell_measures[cells],
            lambda rows, x: of_jet(self.at(cells[rows], x)),
            degree,
            self.pair.solution.spaces.frame,
            enough,
        )


def _middle(squares: Squares) -> Array:
    """The sum of squares and its radius, on this rank."""
    return np.array(
        [(squares.seen + (squares.small - squares.large) / 2).sum(), (squares.small + squares.large).sum() / 2]
    )


def _of_linear(function: fem.Function, degree: int) -> Array:
    """The Bernstein coefficients of a linear function among polynomials of a degree, shape (cells, nodes)."""
    shares = exponents(function.function_space.mesh.basix_cell(), degree) / degree
    return np.asarray(function.x.array[cell_dofs(function.function_space)] @ shares.T)


def _beside(pair: Admissible, p: Array, tolerance: float) -> tuple[Array, Array, int]:
    """δ, the bound of |r|, and the degree of the polynomials near r (collective)."""
    vertices, parts, frame = pair.resolution.vertices, pair.trace.parts, pair.solution.spaces.frame
    cells, order = pair.trace.cells.astype(np.int64), degree_of(pair.trace.v.function_space)
    delta, off = np.zeros((2, len(vertices)))
    x, tops, enough, degree = vertices[cells], p[cells], np.full(len(cells), tolerance), order
    cell = SIMPLEX[vertices.shape[2]]

    def with_trees(datum: Datum, chi: fem.Function) -> Iterator[tuple[Tree, Indices]]:
        touched = chi.x.array[cell_dofs(chi.function_space)][cells].any(axis=1)
        return ((tree, rows[touched[rows]]) for tree, rows in datum.trees_in(cells))

    for datum, chi in ((parts.u_D[0], parts.near_dirichlet), *((level, near) for level, _, near in parts.levels)):
        for tree, rows in with_trees(datum, chi):
            off[cells[rows]] += BESIDE * distances(tree, x[rows], frame, enough[rows], order)
            if is_polynomial(tree, MOST):
                degree = max(degree, polynomial_degree(tree) or 0)
                continue
            degree = max(degree, DEGREE)
            delta[cells[rows]] += distances(tree, x[rows], frame, enough[rows])
    for bound in parts.bounds:
        depth = bound.depth * (1 - _of_linear(bound.near, order)[cells])
        free = np.ones(depth.shape)
        for level, _, chi in parts.levels:
            if level is bound.datum:  # v is b but for (1 − χ)(b − I_hb) and what p is beside I_hb
                free -= _of_linear(chi, order)[cells]
        for tree, rows in with_trees(bound.datum, bound.near):
            rho = BESIDE * distances(tree, x[rows], frame, enough[rows], order)[:, None]
            quadratic = rho if order == 2 else BESIDE * distances(tree, x[rows], frame, enough[rows], 2)[:, None]
            nearest = (
                (raised(bernstein(interpolated(tree, x[rows]), x[rows]), cell, order), quadratic),
                (coefficients_of(in_nodes(tree, x[rows], order), cell), free[rows] * rho),
            )
            ends = [bound.sign * (near - tops[rows]) - depth[rows] + beyond for near, beyond in nearest]
            above = np.min([end.max(axis=1, initial=0.0) for end in ends], axis=0)
            delta[cells[rows]] += above
            off[cells[rows]] = np.maximum(off[cells[rows]], above)
    return delta, off, degree + CUT_OFFS


def _with_rest(seen: Array, squares: Array, delta: Array, of_datum: Array, measure: Array) -> Array:
    """∫er by quadrature and its radius, see the module, from ∫r² by quadrature, ‖e‖ and ρ_e."""
    root, (norm, rho) = np.sqrt(measure), of_datum
    r = np.sqrt(squares) + delta * root
    radius = np.where(delta > 0, delta * (norm + 2 * np.where(delta > 0, rho, 0.0) * root), 0.0)
    radius += np.where(r > 0, np.where(r > 0, rho, 0.0) * r, 0.0)
    return np.array([seen.sum(), 2 * (root * radius).sum()])
