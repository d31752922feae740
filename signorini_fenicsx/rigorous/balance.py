"""Fluxes that balance the load of every cell exactly: errors by rounding and quadrature flow out along a tree."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from signorini_fenicsx.base.arrays import Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.expressions.intervals import Interval


def balanced(facets: Indices, outlets: Mask, fluxes: Interval, load: Interval) -> Interval:
    """The fluxes plus a correction with Σ_i Φ_i = −∫_T f in every cell T, as real numbers.

    The correction is 0 except on the facets of a tree that joins every cell with an outlet. The imbalance of a cell and
    of all cells behind it flows through one facet, so the correction is unique. It is enclosed.

    Args:
        facets: Number of each facet of each cell, shape (cells, d + 1).
        outlets: For each facet of each cell, whether it is on the boundary and any flux may leave there.
        fluxes: Outward fluxes, shape (cells, d + 1); two cells that share a facet have opposite fluxes. They may have
            components, such as a force and its moment, in further axes.
        load: ∫_T f.

    Raises:
        InputError: If a part of the domain has no outlet.
    """
    cells, width = facets.shape
    surplus = load
    for i in range(width):
        surplus = surplus + fluxes[:, i]
    order, parents, through = _tree(facets, outlets)
    depth = np.zeros(cells + 1, dtype=np.int64)
    for cell in order[1:]:
        depth[cell] = depth[parents[cell]] + 1
    carried = -surplus
    changed = Interval(fluxes.lo.copy(), fluxes.hi.copy())
    inner = order[1:]
    for level in range(int(depth.max(initial=0)), 0, -1):
        chosen = inner[depth[inner] == level]
        leaving = carried[chosen]
        changed[chosen, through[chosen]] += leaving
        if level == 1:
            break
        above = parents[chosen]
        entry = np.argmax(facets[above] == facets[chosen, through[chosen]][:, None], axis=1)
        changed[above, entry] += -leaving
        for place in range(width):  # the children of one parent, one after the other
            rank = _rank_among_equals(above)
            now = rank == place
            carried[above[now]] += leaving[now]
    return changed


def _rank_among_equals(values: Indices) -> Indices:
    """For each entry, the number of earlier entries with the same value."""
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    first = np.searchsorted(ordered, ordered, side="left")
    rank = np.empty_like(values)
    rank[order] = np.arange(len(values)) - first
    return rank


def _tree(facets: Indices, outlets: Mask) -> tuple[Indices, Indices, Indices]:
    """A tree from the outside to all cells. The outside is the node with the number `cells`.

    Returns:
        The nodes in breadth-first order, the parent of each cell, and the cell's facet towards its parent.

    Raises:
        InputError: If a cell cannot be reached.
    """
    cells, width = facets.shape
    flat = facets.ravel()
    order = np.argsort(flat, kind="stable")
    same = flat[order][1:] == flat[order][:-1]
    one, other = order[:-1][same], order[1:][same]
    left, right = (one // width).astype(np.int64), (other // width).astype(np.int64)
    out_cell = np.flatnonzero(outlets.any(axis=1))
    rows = np.concatenate([left, out_cell])
    columns = np.concatenate([right, np.full(len(out_cell), cells)])
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(cells + 1, cells + 1)).tocsr()
    visited, parents = breadth_first_order(graph, cells, directed=False)
    if len(visited) <= cells:
        count = connected_components(graph, directed=False)[0] - 1
        raise InputError(f"{count} part(s) of the domain have no facet through which flux may leave")
    through = np.argmax(outlets, axis=1)
    inner = parents[:cells] != cells
    shared = facets[inner][:, :, None] == facets[parents[:cells][inner]][:, None, :]
    through[inner] = np.argmax(shared.any(axis=2), axis=1)
    return visited.astype(np.int64), parents.astype(np.int64), through.astype(np.int64)
