"""Where u is given at facets of Γ_C: whether u_n ≤ g, in exact arithmetic, because both may be equal.

Vertices are floats and data polynomials, so N = |e|n, |e|² and the coefficients of g and of a = u_D·N in Bernstein's
basis are fractions, if the numbers of the data are. |e|g ≥ a is the same as |e|²g|g| ≥ a|a|, because t|t| grows with t.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Indices, Mask
from signorini_fenicsx.expressions import Tree, rational
from signorini_fenicsx.expressions.intervals import Interval
from signorini_fenicsx.rigorous.elasticity.discrete import NONE, ElasticDiscrete, Given
from signorini_fenicsx.rigorous.simplices import EDGES


def nodes_on_facet(dim: int) -> Indices:
    """Places of the coefficients on the facet opposite to the last vertex of a subcell, in the order on facets."""
    number = {edge: dim + 1 + index for index, edge in enumerate(EDGES[dim])}
    return np.array([*range(dim), *(number[edge] for edge in EDGES[dim - 1])])


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
                nodes = self.numbers[cells[:, None], local[:, None], nodes_on_facet(self.discrete.dim)]
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
    """Those of a quadratic on facets in Bernstein's basis, shape (facets, coefficients); None if not rational."""
    dim = x.shape[1]
    i, j = np.array([(k, k) for k in range(dim)] + list(EDGES[dim - 1])).T
    values = rational(tree, (x[:, i] + x[:, j]) / 2)
    return None if values is None else 2 * values - (values[:, i] + values[:, j]) / 2
