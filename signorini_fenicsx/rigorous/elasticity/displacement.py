"""A continuous displacement that is u_D where u is given and off the foundation, near a quadratic one on subcells.

It is quadratic on each subcell, by coefficients in Bernstein's basis. Those at the nodes of Γ_D are the coefficients of
u_D, enclosed. On a facet of Γ_C with N = |e|n the displacement is off the foundation if all coefficients of |e|g − v·N
are ≥ 0. Where this is not certain, up to rounding, the coefficient of v is moved against the mean normal of the facets
at its node, along which u is not given. Where u_n is given it may be equal to g, which fractions decide.
Where two bodies touch v is the jump, and that of the named side is moved.

*Where u is given at facets of Γ_C*: whether u_n ≤ g, in exact arithmetic, because both may be equal.

Vertices are floats and data polynomials, so N = |e|n, |e|² and the coefficients of g and of a = u_D·N in Bernstein's
basis are fractions, if the numbers of the data are. |e|g ≥ a is the same as |e|²g|g| ≥ a|a|, because t|t| grows with t.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.reference_cells import EDGES
from signorini_fenicsx.expressions import Tree, is_polynomial, rational
from signorini_fenicsx.expressions.intervals import Interval, enclosing, stacked
from signorini_fenicsx.rigorous.data import enclosed_at
from signorini_fenicsx.rigorous.discrete import nodes_of_facets
from signorini_fenicsx.rigorous.elasticity.discrete import NONE, ElasticDiscrete, Given
from signorini_fenicsx.rigorous.simplices import bernstein, facet_measures, node_ends, total, with_midpoints


@dataclass(frozen=True)
class Seam:
    """The coefficients on Γ_C.

    Attributes:
        discrete: The solution.
        given: Its data.
        numbers: Those of the nodes of subcells.
        areas: N of the facets of Γ_C, shape (facets, d).
        sides: The nodes of these facets, and those of the other body, NONE where there is none, shape (facets,
            coefficients) each.
    """

    discrete: ElasticDiscrete
    given: Given
    numbers: Indices
    areas: Interval
    sides: tuple[Indices, Indices]

    def met(self, doubtful: Mask) -> Mask:
        """Which coefficients of |e|g − u·N are certainly ≥ 0, because u is given along N, among some."""
        certain = np.zeros_like(doubtful)
        wanted = np.unique([side[doubtful] for side in self.sides])
        u = self._at_nodes(wanted[wanted != NONE])
        rows = np.flatnonzero(doubtful.any(axis=1)) if u else np.empty(0, dtype=int)
        places = tuple(each[rows] for each in np.nonzero(self.discrete.gap != NONE))
        x = _fractions(self.discrete.facet_vertices_of(places))
        gap = self._gap(places, x)
        for row, corners, heights in zip(rows.tolist(), x, gap, strict=True):
            area = _area(corners)
            if sum(float(n) * m for n, m in zip(area, self.areas.lo[row] + self.areas.hi[row], strict=True)) < 0:
                area = [-n for n in area]
            square = sum((n * n for n in area), Fraction(0))
            for k in np.flatnonzero(doubtful[row]):
                node, other = (int(side[row, k]) for side in self.sides)
                wide, along = heights[k], [i for i, n in enumerate(area) if n != 0]
                ends = [(1, node)] + ([(-1, other)] if other != NONE else [])
                if wide is not None and all((end, i) in u for _, end in ends for i in along):
                    a = sum((sign * u[end, i] * area[i] for sign, end in ends for i in along), Fraction(0))
                    certain[row, k] = square * wide * abs(wide) >= a * abs(a)
        return certain

    def _at_nodes(self, wanted: Indices) -> dict[tuple[int, int], Fraction]:
        """The coefficients of u_D at some nodes, by node and component, where these are given as fractions."""
        found: dict[tuple[int, int], Fraction] = {}
        for component in range(self.discrete.dim if len(wanted) else 0):
            for tree, mask in self.given.each(self.discrete.displacement[..., component]):
                cells, local = np.nonzero(mask)
                nodes = self.numbers[cells[:, None], local[:, None], nodes_of_facets(self.discrete.dim)[-1]]
                near = np.isin(nodes, wanted).any(axis=1)
                x = _fractions(self.discrete.facet_vertices_of((cells[near], local[near])))
                coefficients = _coefficients(tree, x) if near.any() else None
                if coefficients is not None:
                    ends = ((node, component) for node in nodes[near].ravel().tolist())
                    found.update(zip(ends, coefficients.ravel(), strict=True))
        return found

    def _gap(self, places: tuple[Indices, ...], x: Any) -> Any:
        """The coefficients of g on some facets, shape (facets, coefficients), None where they are no fractions."""
        gap = np.full((len(x), self.sides[0].shape[1]), None, dtype=object)
        for tree, chosen in self.given.each(self.discrete.gap[places]):
            gap[chosen] = _coefficients(tree, x[chosen])
        return gap


def _fractions(x: Any) -> Any:
    """Floats as fractions."""
    return np.array([Fraction(each) for each in x.ravel().tolist()], dtype=object).reshape(x.shape)


def _area(corners: Any) -> list[Fraction]:
    """N or −N of a facet, from the fractions of its vertices, shape (d, d)."""
    spans = corners[1:] - corners[0]
    if len(spans) == 1:
        return [spans[0, 1], -spans[0, 0]]
    a, b = spans
    return [(a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]) / 2 for i in range(3)]


def _coefficients(tree: Tree, x: Any) -> Any:
    """Coefficients of a quadratic on facets in Bernstein's basis, shape (facets, coefficients); None if irrational."""
    dim = x.shape[1]
    i, j = np.array(node_ends(dim - 1)).T
    values = rational(tree, (x[:, i] + x[:, j]) / 2)
    return None if values is None else 2 * values - (values[:, i] + values[:, j]) / 2


ROUNDS = 20
"""Rounds in which nodes are moved off foundations."""


@dataclass(frozen=True)
class Displacement:
    """The admissible displacement v.

    Attributes:
        coefficients: Shape (cells, d + 1, coefficients, d).
        off: Coefficients of |e|g − v·N on the facets of Γ_C, ≥ 0, shape (facets, coefficients).
        on_contact: Those of v there, where two bodies touch of its jump, shape (facets, coefficients, d).
    """

    coefficients: Interval
    off: Interval
    on_contact: Interval

    @property
    def values(self) -> Interval:
        """Values in the nodes of P2."""
        dim, c = self.coefficients.lo.shape[-1], self.coefficients
        columns = [c[:, :, k] for k in range(c.lo.shape[2])]
        for number, (i, j) in enumerate(EDGES[dim]):
            columns[dim + 1 + number] = columns[dim + 1 + number] / 2.0 + (columns[i] + columns[j]) / 4.0
        return stacked(columns, axis=2)


def admissible(discrete: ElasticDiscrete, given: Given, areas: Interval) -> Displacement:
    """The displacement near that of a solution.

    Args:
        discrete: The solution.
        given: Its data.
        areas: N of the facets of Γ_C, shape (facets, d).

    Raises:
        InputError: If u_D or g are not quadratic, or if it is not certain that u_D is off the foundation.
    """
    names, first, numbers = np.unique(discrete.nodes, return_index=True, return_inverse=True)
    numbers, dim = numbers.reshape(discrete.nodes.shape), discrete.dim
    v = discrete.v.reshape(-1, dim)[first]
    at_nodes = Interval(v, v.copy())
    fixed = np.zeros((len(names), dim), dtype=bool)
    for component in range(dim):
        for tree, mask in given.each(discrete.displacement[..., component]):
            _give(at_nodes, fixed, component, *_on_facets(discrete, given, "u_D", tree, mask, numbers))
    on = discrete.gap != NONE
    cells, local = np.nonzero(on)
    places = nodes_of_facets(dim)[-1]
    nodes = numbers[cells[:, None], local[:, None], places]
    touching, across = discrete.pairs
    other = numbers[across[0][:, None], across[1][:, None], places]
    x = discrete.facet_vertices(on)
    if (discrete.facet_vertices_of(across) != x[touching]).any():
        raise InputError("where two bodies touch, their facets are not certainly the same")
    g = enclosing(np.zeros(nodes.shape))
    for tree, mask in given.each(discrete.gap):
        _, gap = _on_facets(discrete, given, "gap", tree, mask, numbers)
        g = g.put(mask[on], gap)
    wide = g * facet_measures(x)[:, None]
    beyond = np.full(nodes.shape, NONE)
    beyond[touching] = other
    seam = Seam(discrete, given, numbers, areas, (nodes, beyond))
    on_dirichlet, met = fixed[nodes].any(axis=2), np.zeros(nodes.shape, dtype=bool)
    for _ in range(ROUNDS):
        jump = _jump(at_nodes, nodes, touching, other)
        off = wide - total(jump * areas[:, None])
        met |= seam.met((off.lo < 0) & on_dirichlet & ~met)
        off = Interval(*(np.where(met, np.maximum(each, 0.0), each) for each in (off.lo, off.hi)))
        if (off.lo >= 0).all():
            return Displacement(at_nodes[numbers], off, jump)
        at_nodes = at_nodes - _moves(off, nodes, areas, fixed, x)
    raise InputError("v cannot be moved off the foundation")


def _jump(at_nodes: Interval, nodes: Indices, touching: Mask, other: Indices) -> Interval:
    """The coefficients of v on the facets of Γ_C, where two bodies touch of the jump."""
    coefficients = at_nodes[nodes]
    return coefficients.put(touching, coefficients[touching] - at_nodes[other])


def _on_facets(
    discrete: ElasticDiscrete, given: Given, name: str, tree: Tree, mask: Mask, numbers: Indices
) -> tuple[Indices, Interval]:
    """The nodes of some facets, and the coefficients of a quadratic there, shape (facets, coefficients) each.

    Raises:
        InputError: If the tree is not quadratic.
    """
    if not is_polynomial(tree, 2):
        raise InputError(f"the proof is for quadratic {name} alone")
    cells, local = np.nonzero(mask)
    nodes = numbers[cells[:, None], local[:, None], nodes_of_facets(discrete.dim)[-1]]
    x = with_midpoints(enclosing(discrete.facet_vertices(mask)))
    return nodes, bernstein(enclosed_at(tree, x, given.elementary), discrete.dim - 1)


def _give(at_nodes: Interval, fixed: Mask, component: int, nodes: Indices, values: Interval) -> None:
    """Set a component at some nodes.

    Raises:
        InputError: If it was set before, and is not certainly the same.
    """
    before = fixed[nodes, component]
    already = at_nodes[nodes, component]
    same = (already.lo == already.hi) & (already.lo == values.lo) & (already.lo == values.hi)
    if (before & ~same).any():
        raise InputError("where parts with different u_D meet, it is not certain that these are the same")
    at_nodes[nodes, component] = values
    fixed[nodes, component] = True


def _moves(off: Interval, nodes: Indices, areas: Interval, fixed: Mask, x: Array) -> Array:
    """How far to move each node, so that no coefficient should be < 0: twice as far, because of rounding.

    Raises:
        InputError: If no motion helps.
    """
    lack = np.maximum(-off.lo, 0.0)
    away, middle = np.zeros(fixed.shape), (areas.lo + areas.hi) / 2
    np.add.at(away, nodes, np.broadcast_to(middle[:, None], (*nodes.shape, fixed.shape[1])))
    away[fixed] = 0.0
    size = np.linalg.norm(away, axis=1, keepdims=True)
    away = np.where(size > 0, away / np.where(size > 0, size, 1.0), 0.0)
    down = np.einsum("nki,ni->nk", away[nodes], middle)
    rho = np.zeros(len(fixed))
    np.maximum.at(rho, nodes, np.divide(2 * lack, down, out=np.where(lack > 0, np.inf, 0.0), where=down > 0))
    if not np.isfinite(rho).all():
        facet = np.argmax(np.isinf(rho[nodes]).any(axis=1))
        where = ", ".join(f"{each:.4g}" for each in x[facet].mean(axis=0))
        most = lack[facet].max() / np.linalg.norm(middle[facet])
        raise InputError(
            f"where u is given, u_n ≤ gap is not certain near ({where}): u_n − gap is up to {most:.1e}. Right is u_n "
            "below gap, or equal to it at the stored vertices, with u_D and gap as polynomials that are texts with "
            "decimal numbers; if only rounding is between them, a gap that is larger by 1e-12"
        )
    return np.asarray(away * rho[:, None])
