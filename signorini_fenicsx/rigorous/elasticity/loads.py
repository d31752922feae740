"""Loads of elastic bodies: their moments against linear fields, which stresses balance, and what is left of them.

On a cell f = P + δ with a quadratic P and δ enclosed. The moments of P are exact, those of δ in bounds. f_h = Qf is
constant on subcells and has these moments, and ‖f − f_h‖ ≤ ‖P − QP‖ + ‖δ‖ + ‖Qδ‖ with ‖Qδ‖ ≤ (1 + q)‖δ‖, q as in
`bound.korn`. Tractions and pressures likewise, with the projection Π₁ to linear functions in the place of Q.

(f − f_h, w)_T ≤ c_T‖f − f_h‖ ‖ε(w)‖_T and ⟨g − Π₁g, w⟩_e ≤ t_T‖g − Π₁g‖ ‖ε(w)‖_T, with c_T and t_T as in `bound.korn`,
but ĉ and t̂ are those of `scripts/measure.py proved-korn`.
"""

from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.expressions import Tree
from signorini_fenicsx.expressions.intervals import Interval, enclosing, stacked
from signorini_fenicsx.expressions.tree import polynomial_degree
from signorini_fenicsx.rigorous.data import deviation, enclosed_at
from signorini_fenicsx.rigorous.elasticity.discrete import ElasticDiscrete, Given
from signorini_fenicsx.rigorous.simplices import (
    Simplices,
    bernstein,
    mean_square,
    means_with_hats,
    node_ends,
    root,
    squared,
    total,
    with_midpoints,
)

PROVED = {2: (0.40, 1.01)}
"""Proved bounds of ĉ and t̂, by dimension."""
MOMENTS = {2: 1.12, 3: 1.49}
"""Upper bounds of q."""


@dataclass(frozen=True)
class Moments:
    """A function on simplices.

    Attributes:
        hats: Its means times the hats of the vertices, shape (n, k + 1).
        quadratic: Coefficients of P in Bernstein's basis.
        beyond: Upper bound of the root mean square of δ.
        degree: Of the function, if it is a polynomial.
    """

    hats: Interval
    quadratic: Interval
    beyond: Interval
    degree: int | None

    @classmethod
    def of(cls, tree: Tree, vertices: Array, given: Given, name: str) -> "Moments":
        """The moments of a tree on simplices with these vertices, shape (n, k + 1, d)."""
        dim, degree = vertices.shape[1] - 1, polynomial_degree(tree)
        if degree is not None and degree <= 2:
            nodes = enclosed_at(tree, with_midpoints(enclosing(vertices)), given.elementary)
            mean, norm = enclosing(np.zeros(len(vertices))), np.zeros(len(vertices))
        else:
            enclosed = deviation(tree, vertices, given.elementary, name=name, by="mean", order=2)
            nodes, mean, norm = enclosed.nodes, enclosed.mean, enclosed.norm
        quadratic = bernstein(nodes, dim)
        spread = root(enclosing(dim / (dim + 2.0))).hi * norm / (dim + 1) * (1 + 1e-14)
        rest = mean / float(dim + 1) + Interval(-spread, spread)
        return cls(means_with_hats(quadratic, dim) + rest[:, None], quadratic, enclosing(norm), degree)

    def linear(self) -> Interval:
        """Values at the vertices of Π₁ of it."""
        return _linear(self.hats)

    def off_linear(self) -> Interval:
        """A bound of the root mean square of it less Π₁."""
        if self.degree is not None and self.degree <= 1:
            return enclosing(np.zeros(len(self.beyond.lo)))
        dim = self.hats.lo.shape[1] - 1
        linear = _linear(means_with_hats(self.quadratic, dim))
        raised = stacked([(linear[:, i] + linear[:, j]) / 2.0 for i, j in node_ends(dim)])
        return root(mean_square(self.quadratic - raised, dim)) + self.beyond


def _linear(hats: Interval) -> Interval:
    """Values at the vertices of the linear functions with these means times the hats."""
    size = hats.lo.shape[1]
    return (hats * float(size + 1) - total(hats)[:, None]) * float(size)


def force(discrete: ElasticDiscrete, given: Given, cells: Simplices) -> tuple[Interval, Interval]:
    """∫ f λ_k, shape (cells, d + 1, d), and a bound of ‖f − f_h‖ per cell."""
    dim, count = cells.dim, len(cells.vertices)
    moments = Interval(*np.zeros((2, count, dim + 1, dim)))
    squares = Interval(*np.zeros((2, count)))
    for k in range(dim):
        for tree, mask in given.each(discrete.force[:, k]):
            enclosed = Moments.of(tree, discrete.vertices[mask], given, "f")
            moments[mask, :, k] = enclosed.hats
            if enclosed.degree == 0:
                continue
            size = root(off_subcells(enclosed, dim)) + enclosed.beyond * (2 + MOMENTS[dim])
            more = squares[mask] + squared(size)
            squares[mask] = more
    return moments * cells.measure[:, None, None], root(squares * cells.measure)


def off_subcells(moments: Moments, dim: int) -> Interval:
    """The mean square of P − QP on cells."""
    size, hats = dim + 1, means_with_hats(moments.quadratic, dim)
    middle = total(hats)
    columns = {end: moments.quadratic[:, n] for n, end in enumerate(node_ends(dim))}

    def blossom(one: int, other: int) -> Interval:
        """The polar form at two vertices, of which `size` is the centroid."""
        if other == size:
            terms = [blossom(one, k) for k in range(size)] if one != size else [blossom(k, size) for k in range(size)]
            return sum(terms[1:], terms[0]) / float(size)
        return columns[min(one, other), max(one, other)]

    squares = []
    for subcell in range(size):
        corners = [k for k in range(size) if k != subcell] + [size]
        constant = middle * float(dim + 2) - hats[:, subcell] * float(size**2)
        own = stacked([blossom(*sorted((corners[i], corners[j]))) - constant for i, j in node_ends(dim)])
        squares.append(mean_square(own, dim))
    return sum(squares[1:], squares[0]) / float(size)


def constants(cells: Simplices) -> tuple[Interval, Interval]:
    """c_T, and t_T but for (|e|/|T|)^½, of cells.

    Raises:
        InputError: If none are proved in this dimension.
    """
    if cells.dim not in PROVED:
        raise InputError("the proof in space is for f that is constant and g_N and pressures that are linear alone")
    korn, trace = PROVED[cells.dim]
    half = root(enclosing(3.0)) / 2.0
    one, zero = enclosing(1.0), enclosing(0.0)
    edges = stacked([stacked([one, one / 2.0]), stacked([zero, half])], axis=0)  # of the regular simplex, as columns
    slopes = cells.gradients[:, 1:]
    inverse = total(edges[None, :, :, None] * slopes[:, None], axis=2)  # F⁻¹
    products = total(inverse[:, :, None] * inverse[:, None])
    sizes = eigenvalues(products)
    stretch = root(enclosing(sizes.hi)) / enclosing(sizes.lo)
    return stretch * korn, stretch * root(half / 2.0) * trace


def eigenvalues(matrices: Interval) -> Interval:
    """Intervals that contain all eigenvalues of symmetric positive matrices, shape (n, d, d).

    With vectors V near eigenvectors xᵀGx/xᵀx is for x = Vz between those of VᵀGV and VᵀV, by Gershgorin's circles.
    """
    _, vectors = np.linalg.eigh((matrices.lo + matrices.hi) / 2)
    v = enclosing(vectors)
    image = total(matrices[..., None] * v[:, None], axis=2)
    turned = total(v[:, :, :, None] * image[:, :, None], axis=1)
    unit = total(v[:, :, :, None] * v[:, :, None], axis=1) - np.eye(vectors.shape[-1])
    near = total(enclosing(unit.largest)).hi.max(axis=1)
    size = matrices.lo.shape[-1]
    diagonal = turned[:, range(size), range(size)]
    beside = total(enclosing(np.where(np.eye(size, dtype=bool), 0.0, turned.largest)))
    least, most = (diagonal - beside).lo.min(axis=1), (diagonal + beside).hi.max(axis=1)
    lo = (enclosing(least) / (1.0 + enclosing(near))).lo
    return Interval(np.maximum(lo, np.finfo(float).tiny), (enclosing(most) / (1.0 - enclosing(near))).hi)
