"""What v lacks of u_D and of the gap where they are of a higher degree than v on facets, in the plane.

On a facet e let t be what is given of u along a direction q, or on Γ_C the gap, and there q = n. v has, or stays off,
an interpolant p of t in its place, of the degree of v. Facets where a number stands for the gap, see `clear`, need
none. t − p is 0 in both ends a, b of e and in its middle. On the subcell S between e and the centroid c let
s = λ_a + λ_b, and

    d = s (t − p)(τ) q,   τ = λ_b/s,

the value at the point of e that c sees behind x; elsewhere d = 0. It is continuous, and v + d is admissible: it has
u_D, and on Γ_C g − v_n − d_n is what p − v_n was, and v_t + d_t is v_t, so no other term of the gap changes. With the
derivative r of t − p by τ

    |∇d| = |(t − p)∇s + r ((1 − τ)∇λ_b − τ∇λ_a)|

depends on τ alone, all of which have the same share of S, and ‖t − p‖ ≤ ‖r‖/2π over τ, as t − p is 0 at 0, ½ and 1. So

    ‖ε(d)‖_S ≤ |S|^½ (|∇s|/2π + max(|∇λ_a|, |∇λ_b|)) ‖r‖,

and ‖ℂ(ε(v + d) − ε₀) − y‖ is larger by at most the root of the largest eigenvalue of ℂ times this.

*Fluids.* There p is a cubic whose mean on e is that of t, the interpolant of t at equidistant points and a multiple of
6τ(1 − τ); this has a norm of r that is at most 1 + √12/3π times that with the interpolant, by the inequality above on
thirds of e, and ‖t − p‖ ≤ ‖r‖/π. d has no flow through e, but a divergence. On the cell T there is a w that is 0 around
it with ∇·w = ∇·d and ‖∇w‖ ≤ ‖∇·d‖/β. So v + d − w is admissible, and ‖ε(d − w)‖ ≤ ‖∇d‖ (1 + √2/β), where Σ|∇d|² over
the directions q stands for |∇d|². If T is in a disc of radius R, and star-shaped about all points of a disc of radius
ρ with the same centre,

    β ≥ ρ/(√2 R) (1 + (1 − ρ²/R²)^½)^-½

(Costabel and Dauge, arXiv 1303.6141); here it is the inscribed one. The means of t are enclosed, to see that those of
û, by quadrature, are equal to them up to rounding.

If ∇t is within ρ of the gradient of a polynomial of degree K on a part of e, ‖r‖ there is at most what a quadrature
shows that is exact for the squares of such polynomials, and 2|e|ρ.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets
from signorini_fenicsx.discrete.points import beside
from signorini_fenicsx.expressions import Tree, is_polynomial, values
from signorini_fenicsx.expressions.enclosures import means, shown, tilts
from signorini_fenicsx.expressions.products import SMALLEST
from signorini_fenicsx.expressions.series import DEGREE
from signorini_fenicsx.expressions.simplices import barycentric_gradients, constant, through
from signorini_fenicsx.physics.elasticity.bound.conforming import OUT
from signorini_fenicsx.physics.elasticity.bound.resolution import Resolution
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import split_vertices
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces

OF_BODIES, OF_FLUIDS = 2, 3
"""Degree of v; of a fluid it has to be so high that ∇·v can be 0."""
WITH_MEAN = 1 + math.sqrt(12) / (3 * math.pi)
"""How much larger ‖r‖ may be with a p that has the mean of t."""
SHARE = 1e-3
"""The bound of ‖r‖² may be too large by this share of itself,"""
ROUNDING = 1e-9
"""and that of ‖r‖ by this share of the derivative of t; else facets are cut."""

type _Given = tuple[str, BoundaryFacets, list[tuple[Datum, Array]]]
"""The name of a datum, facets, and the scalars whose sum with these factors is t on them."""


def degree_of(data: ElasticData) -> int:
    """The degree of v."""
    return OF_FLUIDS if data.material.incompressible else OF_BODIES


def lifts(spaces: ElasticSpaces, data: ElasticData) -> tuple[str, ...]:
    """The data for which there is a d: texts of which one at least is of a higher degree than v."""
    names, degree = [], degree_of(data)
    for name, datum in (("u_D", data.u_D), ("gap", data.gap)):
        is_text = all(
            part.pieces is not None
            for each, facets, scalars in _given(spaces, data)
            for scalar, _ in scalars
            for _, part in scalar.by_facets(facets.facets)
            if each == name
        )
        if spaces.dim == 2 and is_text and (datum.polynomial is None or datum.polynomial > degree):
            names.append(name)
    return tuple(names)


def lifted(resolution: Resolution, counted: Array, floors: Array) -> tuple[Array, tuple[str, ...]]:
    """‖ℂε(d)‖ in the energy norm on each owned cell, and the names of the data that it is for (collective).

    If it is more than what is counted, or no bound of ∇t is known somewhere, it is 0 and for none: then it is recorded
    that these data are not resolved.

    Args:
        resolution: Of the data.
        counted: Twice the gap of each cell besides.
        floors: What stands for the gap, see `clear`.
    """
    spaces, comm = resolution.spaces, resolution.spaces.mesh.comm
    names = lifts(spaces, resolution.data)
    if not names:
        return np.zeros_like(counted), ()
    off = _means_off(spaces, resolution.data) if resolution.data.material.incompressible else np.zeros(len(counted))
    if comm.allreduce(bool(off.any()), MPI.LOR):
        resolution.note("u_D", off > 0)
        return np.zeros_like(counted), ()
    sizes = {name: of_degree(resolution, (name,), degree_of(resolution.data), floors) for name in names}
    squares = np.sum([each**2 for each in sizes.values()], axis=0)
    if comm.allreduce(float(squares.sum())) <= comm.allreduce(float(counted.sum())):
        return np.sqrt(squares), names
    most = comm.allreduce(float(squares.max(initial=0.0)), MPI.MAX)
    for name, each in sizes.items():
        resolution.note(name, (each**2 >= most / 4) & (each > 0))
    return np.zeros_like(counted), ()


def of_degree(resolution: Resolution, names: Sequence[str], degree: int, floors: Array) -> Array:
    """‖ℂε(d)‖ for some data and a v of this degree, which has u_D as before all the same (collective)."""
    spaces, data, least = resolution.spaces, resolution.data, degree_of(resolution.data)
    squares = np.zeros((len(resolution.coarse), spaces.dim + 1))
    if not names:
        return squares[:, 0]
    for name, facets, scalars in _given(spaces, data):
        if name in names:  # directions are across each other
            size = _rising(spaces, facets, scalars, degree if name == "gap" else least, least)
            if name == "gap":
                size[np.isfinite(floors)] = 0.0
            squares[facets.cells, facets.local] += size**2
    subcells = split_vertices(spaces.vertices).reshape(-1, spaces.dim + 1, spaces.dim)
    gradients = np.linalg.norm(barycentric_gradients(subcells), axis=2).reshape(*squares.shape, -1)
    factors = gradients[..., -1] / (2 * np.pi) + gradients[..., :-1].max(axis=2)
    if data.material.incompressible:
        factors = WITH_MEAN * (gradients[..., -1] / np.pi + gradients[..., :-1].max(axis=2))
        factors *= (1 + np.sqrt(2) / inf_sup(spaces.vertices))[:, None]
    of_subcells = (spaces.cell_measures / (spaces.dim + 1))[:, None] * factors**2 * squares
    return np.asarray(np.sqrt(resolution.stiffest() * of_subcells.sum(axis=1)))


def inf_sup(vertices: Array) -> Array:
    """Lower bounds of β of triangles, shape (n,), from their vertices."""
    sides = np.linalg.norm(np.roll(vertices, 1, axis=1) - np.roll(vertices, -1, axis=1), axis=2)  # opposite to each
    centre = np.einsum("nv,nvi->ni", sides, vertices) / sides.sum(axis=1)[:, None]
    largest = np.linalg.norm(vertices - centre[:, None], axis=2).max(axis=1)
    area = np.abs(np.linalg.det(vertices[:, 1:] - vertices[:, :1])) / 2
    share = 2 * area / sides.sum(axis=1) / largest
    return np.asarray(share / np.sqrt(2 * (1 + np.sqrt(1 - share**2))))


def _means_off(spaces: ElasticSpaces, data: ElasticData) -> Array:
    """How far the means of û on facets may be from those of u_D, the most of each cell; 0 up to rounding (collective).

    It is infinite where no mean is enclosed.
    """
    comm, off = spaces.mesh.comm, np.zeros(len(spaces.order))
    of_u = [data.lift[spaces.unknowns(facets, k)].mean(axis=1) for facets, k, *_ in spaces.fixed]
    size = comm.allreduce(max((float(np.abs(each).max(initial=0.0)) for each in of_u), default=0.0), MPI.MAX)
    for (facets, _, axes, of), mean in zip(spaces.fixed, of_u, strict=True):
        away, unsure = -mean, np.zeros(len(mean))
        for r in of:
            for tree, rows in _pieces(data.u_D.components[r], facets, -1):
                ends, enough = facets.vertices[rows], max(OUT / 10 * size, SMALLEST)
                weight = np.full(len(ends), 1 / enough**2)
                found = means(tree, ends, constant(np.zeros(len(ends)), spaces.dim), spaces.frame, weight).mean
                away[rows] += axes[rows, r] * (found.lo + found.hi) / 2
                unsure[rows] += np.abs(axes[rows, r]) * (found.hi - found.lo) / 2
        away = np.abs(away) + unsure
        np.maximum.at(off, facets.cells, np.where(away <= OUT * size, 0.0, away))
    return off


def _given(spaces: ElasticSpaces, data: ElasticData) -> Iterator[_Given]:
    """What is given on facets, in all directions."""
    for facets, _, axes, of in spaces.fixed:
        yield "u_D", facets, [(data.u_D.components[r], axes[:, r]) for r in of]
    yield "gap", spaces.contact, [(data.gap, np.ones(len(spaces.contact.facets)))]


def _rising(
    spaces: ElasticSpaces, facets: BoundaryFacets, scalars: list[tuple[Datum, Array]], degree: int, exact: int
) -> Array:
    """Bounds of ‖r‖ on facets for p of a degree, infinite where none is known; 0 for polynomials that are exact."""
    bounds = np.zeros(len(facets.facets))
    for scalar, factors in scalars:
        for tree, rows in _pieces(scalar, facets, exact):
            rows = rows[factors[rows] != 0]
            bounds[rows] += np.abs(factors[rows]) * _of_tree(spaces, tree, facets.vertices[rows], degree)
    return bounds


def _of_tree(spaces: ElasticSpaces, tree: Tree, ends: Array, degree: int) -> Array:
    """Bounds of ‖r‖ between ends, where p has values inside the facets as in `from_within` (collective)."""
    nodes, step = np.linspace(0.0, 1.0, degree + 1), beside(spaces.mesh)
    near, far = (
        values(tree, ends[:, :1] + (nodes + share * (0.5 - nodes))[:, None] * (ends[:, 1:] - ends[:, :1]))
        for share in (step, 2 * step)
    )
    p = through(ends, nodes[:, None], 2 * near - far, degree)
    rising = shown(tree, ends, constant(np.zeros(len(ends)), spaces.dim), 2 * DEGREE)[1]
    weight = 1 / np.maximum(ROUNDING * rising, SMALLEST) ** 2 / max(spaces.mesh.comm.allreduce(len(ends)), 1)
    found = tilts(tree, ends, p, spaces.frame, weight, SHARE)
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) * found.tilt


def _pieces(datum: Datum, facets: BoundaryFacets, degree: int) -> Iterator[tuple[Tree, Indices]]:
    """The trees of a datum that are no polynomials of a degree, each with the numbers of its facets."""
    for mask, part in datum.by_facets(facets.facets):
        for tree, rows in part.trees_in(facets.cells):
            if not is_polynomial(tree, degree):
                yield tree, rows[mask[rows]]
