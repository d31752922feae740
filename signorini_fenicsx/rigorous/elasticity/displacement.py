"""A continuous displacement that is u_D where u is given and off the foundation, near a quadratic one on subcells.

It is quadratic on each subcell, by coefficients in Bernstein's basis. Those at the nodes of Γ_D are the coefficients of
u_D, enclosed. On a facet of Γ_C with N = |e|n the displacement is off the foundation if all coefficients of |e|g − v·N
are ≥ 0. Where this is not certain, up to rounding, the coefficient of v is moved against the mean normal of the facets
at its node, along which u is not given. Where u_n is given it may be equal to g, which fractions decide: see `seam`.
Where two bodies touch v is the jump, and that of the named side is moved.
"""

from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.expressions import Tree, interval, is_polynomial
from signorini_fenicsx.expressions.intervals import Interval, enclosing
from signorini_fenicsx.rigorous.elasticity.discrete import NONE, ElasticDiscrete, Given
from signorini_fenicsx.rigorous.elasticity.seam import Seam, nodes_on_facet
from signorini_fenicsx.rigorous.simplices import EDGES, bernstein, facet_measures, total, with_midpoints

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
        return Interval(*(np.stack([getattr(each, end) for each in columns], axis=2) for end in ("lo", "hi")))


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
    places = nodes_on_facet(dim)
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
    nodes = numbers[cells[:, None], local[:, None], nodes_on_facet(discrete.dim)]
    x = with_midpoints(enclosing(discrete.facet_vertices(mask)))
    point = {axis: x[..., k] for k, axis in enumerate("xyz"[: discrete.dim])}
    return nodes, bernstein(interval(tree, point, given.elementary).on(nodes.shape), discrete.dim - 1)


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
