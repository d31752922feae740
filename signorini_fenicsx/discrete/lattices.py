"""Equidistant points of simplices by whole numbers, and the polynomials that are 1 in one of them.

A point of the lattice of degree k has the hats α/k with whole numbers α whose sum is k. Another order of the vertices
orders the entries of α differently, and nothing else.
"""

from functools import lru_cache

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices


@lru_cache
def lattice(vertices: int, degree: int) -> Indices:
    """α of all points of a simplex with so many vertices, shape (points, vertices)."""
    if vertices == 1:
        return np.array([[degree]])
    rows = [np.insert(lattice(vertices - 1, degree - first), 0, first, axis=1) for first in range(degree, -1, -1)]
    return np.concatenate(rows)


def numbers_in(points: Indices, degree: int) -> Indices:
    """The number of points in their lattice, from α of shape (…, vertices)."""
    weights = (degree + 1) ** np.arange(points.shape[-1])
    keys = lattice(points.shape[-1], degree) @ weights
    number = np.zeros(keys.max(initial=0) + 1, dtype=np.int64)
    number[keys] = np.arange(len(keys))
    return number[points @ weights]


def lagrange(hats: Array, degree: int) -> Array:
    """The polynomials that are 1 in one point of the lattice and 0 in the others, shape (…, points)."""
    basis = np.ones((*hats.shape[:-1], len(lattice(hats.shape[-1], degree))))
    for index, point in enumerate(lattice(hats.shape[-1], degree)):
        for vertex, steps in enumerate(point):
            for step in range(steps):
                basis[..., index] *= (degree * hats[..., vertex] - step) / (step + 1)
    return basis


def lagrange_slopes(hats: Array, degree: int) -> Array:
    """Derivatives of the Lagrange functions by the hats as independent variables, shape (…, points, vertices)."""
    slopes = np.zeros((*hats.shape[:-1], len(lattice(hats.shape[-1], degree)), hats.shape[-1]))
    for index, point in enumerate(lattice(hats.shape[-1], degree)):
        factors = [(vertex, step) for vertex, steps in enumerate(point) for step in range(steps)]
        for left_out, (vertex, step) in enumerate(factors):
            term = np.full(hats.shape[:-1], degree / (step + 1))
            for other, (v, s) in enumerate(factors):
                if other != left_out:
                    term = term * (degree * hats[..., v] - s) / (s + 1)
            slopes[..., index, vertex] += term
    return slopes
