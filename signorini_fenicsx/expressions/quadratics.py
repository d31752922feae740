"""Quadratic functions on single simplices of any dimension, without a mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import AnyIndices, Array, Mask
from signorini_fenicsx.base.reference_cells import SIMPLEX, orthonormal
from signorini_fenicsx.expressions.evaluation import values
from signorini_fenicsx.expressions.tree import Tree

INSIDE = 0.75
"""Distance of the nodes of an interpolant from the centroid, relative to that of the nodes of P2."""


@dataclass(frozen=True)
class Polynomial:
    """Polynomials of any degree on n simplices.

    Attributes:
        coefficients: In an orthonormal basis on the reference simplex, shape (n, basis).
        slopes: Gradients of barycentric coordinates, shape (n, dim + 1, dim).
        degree: Their degree.
    """

    coefficients: Array
    slopes: Array
    degree: int

    def of(self, rows: AnyIndices | Mask) -> Polynomial:
        """Those of a selection of the simplices."""
        return Polynomial(self.coefficients[rows], self.slopes[rows], self.degree)

    def at(self, arms: Array) -> Array:
        """Values in points minus centroids, shape (n, points, dim); the result has the shape (n, points, 1)."""
        number, points, dim = arms.shape
        places = 1 / (dim + 1) + np.einsum("nqi,nvi->nqv", arms, self.slopes[:, 1:])
        table = orthonormal(SIMPLEX[dim], self.degree).tabulate(0, places.reshape(-1, dim))[0][:, :, 0]
        return np.einsum("nqb,nb->nq", table.reshape(number, points, table.shape[1]), self.coefficients)[:, :, None]


@dataclass(frozen=True)
class Quadratic:
    """p(x) = value + gradient·(x − x_T) + ½(x − x_T)·hessian (x − x_T) on each simplex T with centroid x_T.

    Attributes:
        value: Shape (n,).
        gradient: Shape (n, d), along T.
        hessian: Shape (n, d, d), symmetric, along T.
    """

    value: Array
    gradient: Array
    hessian: Array

    def of(self, rows: AnyIndices | Mask) -> Quadratic:
        """The quadratic functions on some of the simplices."""
        return Quadratic(self.value[rows], self.gradient[rows], self.hessian[rows])

    def at(self, arms: Array) -> Array:
        """Values, and gradients as the last columns, in points x with x − x_T given, shape (n, points, 1 + d)."""
        bend = np.einsum("nij,nqj->nqi", self.hessian, arms)
        value = self.value[:, None] + ((self.gradient[:, None] + bend / 2) * arms).sum(axis=2)
        return np.concatenate([value[:, :, None], self.gradient[:, None] + bend], axis=2)


def quadratic(vertices: Array, at_vertices: Array, at_midpoints: Array) -> Quadratic:
    """The quadratic with given values.

    Args:
        vertices: Vertices of n simplices of dimension k, shape (n, k + 1, d).
        at_vertices: Values there, shape (n, k + 1).
        at_midpoints: Values in the midpoints of edges, in the order of `edges`, shape (n, (k + 1)k/2).
    """
    corners = vertices.shape[1]
    slopes = barycentric_gradients(vertices)
    # p = Σ a_v λ_v + 4 Σ_{v<w} b_vw λ_v λ_w, where b_vw is the value in the midpoint minus the mean of the ends
    bend = np.zeros((len(vertices), corners, corners))
    for column, (v, w) in enumerate(edges(corners)):
        bend[:, v, w] = bend[:, w, v] = 4 * (at_midpoints[:, column] - (at_vertices[:, v] + at_vertices[:, w]) / 2)
    value = at_vertices.mean(axis=1) + bend.sum(axis=(1, 2)) / (2 * corners**2)
    gradient = np.einsum("nv,nvi->ni", at_vertices + bend.sum(axis=2) / corners, slopes)
    return Quadratic(value, gradient, np.einsum("nvi,nvw,nwj->nij", slopes, bend, slopes))


def interpolated(tree: Tree, vertices: Array) -> Quadratic:
    """The quadratic with the values of a tree in six points inside each simplex, ten in 3D (three on an edge).

    The points are nodes of P2 moved inside. So data that jump between simplices are taken from the right side.
    """
    centre = vertices.mean(axis=1, keepdims=True)
    ends = np.array(edges(vertices.shape[1])).T
    corners = centre + INSIDE * (vertices - centre)
    midpoints = (corners[:, ends[0]] + corners[:, ends[1]]) / 2
    in_nodes = [values(tree, x) for x in (corners, midpoints)]
    return quadratic(corners, *in_nodes)


def constant(means: Array, dim: int) -> Quadratic:
    """Constant functions with these values, as quadratics."""
    return Quadratic(means, np.zeros((len(means), dim)), np.zeros((len(means), dim, dim)))


def bernstein(p: Quadratic, vertices: Array) -> Array:
    """Bernstein coefficients of quadratics, shape (n, nodes); every value is a weighted mean of them."""
    corners = vertices.shape[1]
    first, second = np.array(edges(corners)).T
    arms = vertices - vertices.mean(axis=1, keepdims=True)
    slope = np.einsum("nvi,ni->nv", arms, p.gradient)
    bend = np.einsum("nvi,nij,nwj->nvw", arms, p.hessian, arms) / 2
    of_vertices = p.value[:, None] + slope + np.einsum("nvv->nv", bend)
    of_edges = p.value[:, None] + (slope[:, first] + slope[:, second]) / 2 + bend[:, first, second]
    return np.concatenate([of_vertices, of_edges], axis=1)


def edges(corners: int) -> list[tuple[int, int]]:
    """Pairs of vertices of a simplex."""
    return [(v, w) for v in range(corners) for w in range(v + 1, corners)]


def barycentric_gradients(vertices: Array) -> Array:
    """Gradients of the barycentric coordinates along each simplex, shape (n, k + 1, d)."""
    inverse = np.linalg.pinv((vertices[:, 1:] - vertices[:, :1]).transpose(0, 2, 1))
    return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
