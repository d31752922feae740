"""Enclosures of integrals of products ew over simplices, of an expression e and a polynomial w.

Let e be within ρ of a polynomial of degree K on a part of a simplex, and Q a quadrature with positive weights that is
exact for this polynomial times w, and for w². Then the mean of ew is in Q(ew) ± 2ρQ(w²)^½. If e itself is a polynomial
for which Q is exact, ρ counts as 0. Parts are cut along jumps and kinks of e, see `cutting`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.expressions.cutting import CHUNK, Frame, in_parts
from signorini_fenicsx.expressions.enclosures import distances, in_points
from signorini_fenicsx.expressions.evaluation import values
from signorini_fenicsx.expressions.series import DEGREE, Remainder
from signorini_fenicsx.expressions.simplices import Parts
from signorini_fenicsx.expressions.tree import Tree, is_polynomial, polynomial_degree

EXACT = 15
"""Polynomials up to this degree, and their squares, are integrated exactly."""
OF_SUMS, SHARPEST = 1e-12, 1e-10
"""Rounding of a sum as a share of that of the sizes, and the sharpest that is aimed at, as a share of it."""
SMALLEST = 1e-100
"""Tolerances are at least this."""


@dataclass(frozen=True)
class Products:
    """Integrals over each of n simplices.

    Attributes:
        value: Near that of ew.
        radius: It is at most so far from it; infinite where nothing is known.
        norm: Upper bound of the root of that of e².
        rho: On the simplex as a whole e is within this of a polynomial for which quadratures are exact.
    """

    value: Array
    radius: Array
    norm: Array
    rho: Array

    @property
    def total(self) -> Array:
        """The sums of values and radii, shape (2,)."""
        return np.array([self.value.sum(), self.radius.sum()])


def products(
    tree: Tree,
    vertices: Array,
    measure: Array,
    w: Callable[[Indices, Array], Array],
    degree: int,
    frame: Frame,
    enough: float,
) -> Products:
    """Enclose integrals (collective): a width of `enough` is aimed at for the sum over all simplices.

    Args:
        tree: e.
        vertices: Vertices of n simplices of this rank, of any dimension ≥ 1, shape (n, vertices, dim).
        measure: Of each simplex.
        w: Gives w from numbers of simplices, and points in each, of shape (m, points, dim).
        degree: Its degree.
        frame: The domain.
        enough: The width.
    """
    number, comm, exact = len(vertices), frame.comm, polynomial_degree(tree) if is_polynomial(tree, EXACT) else None
    of_tree = DEGREE if exact is None else exact
    rule = max(degree + of_tree, 2 * of_tree, 2 * degree, 1)

    def look(parts: Parts) -> Array:
        """Means of ew, |ew|, e² and w² by quadrature."""
        x, weights = in_points(parts.vertices, rule)
        e, of_w = values(tree, x), w(parts.simplex, x)
        return np.stack([each @ weights for each in (e * of_w, np.abs(e * of_w), e**2, of_w**2)], axis=1)

    seen = np.zeros((number, 4))
    for begin in range(0, number, CHUNK):
        own = np.arange(begin, min(begin + CHUNK, number))
        seen[own] = look(Parts(vertices[own], own, np.ones(len(own))))
    middle, size, squares, of_w = seen.T
    radius, norm, whole = np.zeros(number), np.sqrt(squares), np.zeros(number)
    if exact is None:
        sum_of_w, sum_of_sizes = comm.allreduce(np.array([measure @ np.sqrt(of_w), measure @ size])).tolist()
        enough = max(enough, SHARPEST * sum_of_sizes, SMALLEST) / 4
        limit = np.full(number, enough / max(2 * sum_of_w, SMALLEST))
        whole = distances(tree, vertices, frame, limit)
        fine = whole <= limit
        rho, rough = np.where(fine, whole, 0.0), np.flatnonzero(~fine & (of_w > 0))
        norm, radius = norm + 2 * rho, 2 * rho * np.sqrt(of_w)

        def of_rest(parts: Parts, remainder: Remainder) -> Array:
            seen, rho = look(Parts(parts.vertices, rough[parts.simplex], parts.share)), 2 * remainder.distance()
            return np.column_stack([seen[:, :2], rho * np.sqrt(seen[:, 3]), (np.sqrt(seen[:, 2]) + rho) ** 2])

        def need(parts: Parts, of_parts: Array) -> Array:
            return np.asarray(measure[rough[parts.simplex]] * parts.share * of_parts[:, 2] / enough)

        parts, of_parts = in_parts([tree], vertices[rough], frame, of_rest, need)
        middle[rough], size[rough], radius[rough], squares = parts.sums(of_parts, len(rough))
        norm[rough] = np.sqrt(squares)
    radius = radius + OF_SUMS * size
    unknown = ~np.isfinite(middle) | np.isnan(radius)
    middle[unknown], radius[unknown] = 0.0, np.inf
    return Products(measure * middle, measure * radius, norm * np.sqrt(measure), whole)
