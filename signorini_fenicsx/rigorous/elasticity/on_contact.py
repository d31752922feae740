"""What contact and friction add to the gap, enclosed, and tractions that they allow.

With N = |e|n, the field N×w is tangential for any w, in the plane JN w with a number w, and |N×w| ≤ |e||w|. So the
tractions q = −pN + N×w at the vertices of a facet with p ≥ 0 and |w| ≤ k are admissible for friction with the bound k
that is linear on the facet, and |e||v_t| = |N×v|. |v_t| is at most the mean of the lengths of its coefficients in
Bernstein's basis, in space of those on parts of the facet, as in `FacetCoefficients.lengths`.
"""

from functools import lru_cache

import numpy as np

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.facet_coefficients import parts_of_facet
from signorini_fenicsx.expressions.intervals import Interval, absolute, enclosing, stacked
from signorini_fenicsx.rigorous.simplices import cross, means_with_hats, node_ends, root, squared, total

SHORTER = 1 - 1e-14
"""Tractions are made shorter by this factor, so that rounding does not make them longer than the bound."""


def tangential(areas: Interval, w: Interval) -> Interval:
    """N×w, in the plane JN w, shape (…, d), from N of shape (…, d) and w of shape (…, d), in the plane (…, 1)."""
    return cross(areas, w) if areas.lo.shape[-1] == 3 else stacked([-areas[..., 1], areas[..., 0]]) * w


def shear_near(tractions: Array, normals: Array, most: Array) -> Array:
    """The w of tractions at the vertices of facets, cut to lengths that are certainly at most these.

    Args:
        tractions: σn, shape (facets, d, d).
        normals: n, shape (facets, d).
        most: Shape (facets, d).
    """
    n = normals[:, None]
    if n.shape[2] == 2:
        w = (tractions[..., 1] * n[..., 0] - tractions[..., 0] * n[..., 1])[..., None]
    else:
        w = np.cross(tractions, n)
    size = np.linalg.norm(w, axis=2)
    share = np.divide(most * SHORTER, size, out=np.ones_like(size), where=size > most * SHORTER)
    return np.asarray(share[..., None] * w)


def reactions(areas: Interval, sticks: Mask) -> Interval:
    """Matrices from a vector to a traction along N, and where facets stick to any traction, shape (…, d, d)."""
    dim, middle = areas.lo.shape[-1], (areas.lo + areas.hi) / 2
    middle = middle / np.maximum((middle**2).sum(axis=-1, keepdims=True), np.finfo(float).tiny)
    along = areas[..., None] * middle[..., None, :]
    columns = []
    for unit in np.eye(dim):
        w = (middle[..., 0] * unit[1] - middle[..., 1] * unit[0])[..., None] if dim == 2 else np.cross(unit, middle)
        columns.append(tangential(areas, enclosing(w)))
    return along + stacked(columns) * np.where(sticks, 1.0, 0.0)[..., None, None]


def changed(
    areas: Interval, bound: Interval, pressure: Array, w: Array, more: Interval, sticks: Mask
) -> tuple[Interval, Interval]:
    """The pressures p ≥ 0 and |e|y_t at the vertices of facets after a change of q = −pN + N×w.

    Args:
        areas: N, shape (facets, d).
        bound: k, shape (facets, d).
        pressure: p before, shape (facets, d).
        w: Shape (facets, d, d), in the plane (facets, d, 1).
        more: The change, shape (facets, d, d).
        sticks: Mask of the facets where it may have parts across N.

    Raises:
        InputError: If a pressure may be < 0, or a shear above its bound.
    """
    across = areas[:, None]
    normal = total(more * across) / total(squared(across))
    pressures = enclosing(pressure) - normal
    beside = more - normal[..., None] * across
    wide = root(total(squared(enclosing(w)))) + root(total(squared(beside)) / total(squared(across)))
    moved = sticks[:, None] & ~beside.is_zero.all(axis=2)
    beside = beside.where(moved[..., None], enclosing(np.zeros(beside.lo.shape)))
    if (pressures.lo < 0).any() or (moved & (wide.hi > bound.lo)).any():
        raise InputError("the stress cannot be balanced: what the solver leaves is larger than the tractions on Γ_C")
    return pressures, tangential(across, enclosing(w)) + beside


def pressed(pressure: Interval, off: Interval) -> Interval:
    """∫ (−y_nn)(g − v_n) over facets, from pressures at their vertices and coefficients of |e|(g − v_n)."""
    return _integral(pressure, off)


def rubbed(areas: Interval, bound: Interval, shear: Interval, v: Interval) -> Interval:
    """∫ k|v_t| + y_t·v_t over facets, or a bit more.

    Args:
        areas: N, shape (facets, d).
        bound: k at the vertices, shape (facets, d).
        shear: |e|y_t there, shape (facets, d, d).
        v: Coefficients of v, shape (facets, coefficients, d).
    """
    dim = v.lo.shape[2]
    work = enclosing(np.zeros(len(v.lo)))
    for i in range(dim):
        work = work + _integral(shear[..., i], v[..., i])
    corners, on_parts = _parts(dim)
    for corner, part in zip(corners, on_parts, strict=True):
        there = total(enclosing(part[..., None]) * v[:, None], axis=2)
        if dim == 2:
            turned = stacked([-areas[:, 1], areas[:, 0]])
            size = absolute(total(there * turned[:, None]))
        else:
            size = root(total(squared(tangential(areas[:, None], there))))
        most = total(enclosing(corner) * bound[:, None])
        work = work + _integral(most, size) / float(len(corners))
    return Interval(np.maximum(work.lo, 0.0), np.maximum(work.hi, 0.0))


def _integral(linear: Interval, quadratic: Interval) -> Interval:
    """Means over facets of linear functions, by values at the vertices, times quadratic ones, by coefficients."""
    return total(linear * means_with_hats(quadratic, linear.lo.shape[1] - 1))


@lru_cache
def _parts(dim: int) -> tuple[Array, Array]:
    """Hats at the corners of parts of a facet, and the coefficients there from those on the facet; all are exact.

    Shapes (parts, d, d) and (parts, coefficients, coefficients). An edge is one part.
    """
    corners, places = parts_of_facet(dim), node_ends(dim - 1)
    one, other = (corners[:, some] for some in zip(*places, strict=True))
    columns = [(one[..., i] * other[..., j] + one[..., j] * other[..., i]) / (1 + (i == j)) for i, j in places]
    return corners, np.stack(columns, axis=-1)
