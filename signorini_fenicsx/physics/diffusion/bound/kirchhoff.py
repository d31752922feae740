"""Kirchhoff's transformation: where κ = k(x) g(u), w = G(u) with G' = g makes −∇·(κ∇u) = f linear, with σ = k∇w.

Vertical and flat segments of laws stay such, with G of the u at which they are vertical. So if g > 0 on the range of u,
w solves the linear problem, and the flux of u is the only flux of that. What is guaranteed of the flux of w, in the
norm of k⁻¹, is guaranteed for the problem of u itself, whatever method found u.

g is a sum of powers of u and of exponentials of linear functions of u, written as such; k may differ between regions.
Its range is enclosed by comparison with numbers: u is at most the largest given u and bound of u if f ≤ 0 and least
fluxes are at most 0; and likewise from below. Where that is not so the range has no end, and g > 0 is asked for up to
infinity, with a positive lower bound. As it is asked for on all of the range, with the g of its ends beyond them, there
is one such u: that of w.

Gardner's soil with the head h as u is of this kind where ψ = h − z ≤ 0: κ = K e^{−αz} e^{αh}. ψ = 0 solves the problem
with f = 0, with the flux K n_z. So by comparison ψ ≤ 0 in all of Ω if f ≤ 0, where u is given or has an upper bound
that is at most z, and elsewhere the least flux is at most K n_z. All this is enclosed; the floor of k_r does not count.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.contact.laws import Dirichlet, Neumann, Seepage, Signorini, TwoSided
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.points import in_facets
from signorini_fenicsx.expressions import (
    TREES,
    Binary,
    Tree,
    depends_on,
    difference,
    exactly,
    interval,
    linear_terms,
    values,
)
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.expressions.intervals import Interval
from signorini_fenicsx.expressions.tree import Call, Coordinate, Negative, Number, polynomial_degree, substituted
from signorini_fenicsx.physics.diffusion.bound.equilibrated import distance
from signorini_fenicsx.physics.diffusion.bound.local_fields import cell_metric
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.soils import FORMS, Gardner
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.solving.solver import solve

type Terms = tuple[tuple[float, Tree], ...]
NAMED = "the exact solution, by Kirchhoff's transformation"
"""Of which solution the bound is then."""
OF_U: Mapping[type, Sequence[str]] = {
    Dirichlet: ["value"],
    Neumann: [],
    Signorini: ["psi"],
    TwoSided: ["psi", "psi_upper"],
    Seepage: ["level"],
}
"""The laws whose segments are vertical or flat, and their data that are values of u."""
FLUXES: Mapping[int, Mapping[type, Sequence[str]]] = {
    1: {Neumann: ["value"], Signorini: ["q_S"]},
    -1: {Neumann: ["value"], Seepage: ["rain"]},
}
"""And those without an upper (1) or a lower bound (−1) of u, with the flux beyond their vertical segments."""
STEEP = 20.0
"""Gardner's soils with a larger αH have a k of too many orders."""
ROUNDING = 1e-12
"""Of the components of normals."""
FAR = 40.0
"""The logarithm of the size of u from which a range without an end is one part."""
PARTS = 256
"""On so many parts of the range g is enclosed."""


class _NotThere(Exception):
    """What a transformation needs is not there."""


def linear_solution(solution: Solution) -> Solution | None:
    """The solution of the problem for w, on the same mesh; None where there is no such problem (collective)."""
    data, problem = solution.data, solution.problem
    if data.quasilinear is None or data.b is not None or data.c_h is not None or data.inside:
        return None
    if solution.step is not None or solution.boundary.inner or any(type(law) not in OF_U for law in problem.laws):
        return None
    dim = solution.spaces.mesh.geometry.dim
    try:
        soil = problem.kappa
        k, g = _of_soil(soil, dim) if isinstance(soil, Gardner) else _separated(problem.parsed(dim).kappa)
        if not (_is_dry(solution, soil) if isinstance(soil, Gardner) else _positive(solution, g)):
            return None
        posed = _transformed(problem.parsed(dim), k, g, "xyz"[:dim])
    except _NotThere:
        return None
    found: Solution = solve(solution.spaces.domain, posed, solution.options)
    return found


def bound_by(solution: Solution, of_w: Solution, certificate: Certificate) -> Certificate:
    """The bound of the flux of a solution, by that of the solution for w (collective).

    Its v is near w, and its indicators are those of w.
    """
    apart = distance(of_w.spaces, cell_metric(of_w.spaces, of_w.data), of_w.sigma, solution.sigma)
    sums = {name: getattr(certificate, name) + apart for name in ("bound", "sigma_bound", "remainder")}
    relative = (
        certificate.relative * sums["bound"] / certificate.bound if certificate.bound > 0 else certificate.relative
    )
    return replace(certificate, **sums, relative=relative, of=NAMED, about={"kirchhoff": True})


def _transformed(problem: Problem, k: Any, g: Terms, names: str) -> Problem:
    """The problem for w.

    Raises:
        _NotThere: If a value of u is neither a number nor a text.
    """

    def of_law(law: Any) -> Any:
        return law.with_data(
            lambda key, given: _G(g, parsed(given, names, key)) if key.rpartition(".")[2] in OF_U[type(law)] else given
        )

    laws = [of_law(law) for law in problem.laws]
    return replace(
        problem, kappa=k, form=FORMS[0], u_D=_G(g, problem.u_D), psi=_G(g, problem.psi), exact=None, laws=laws
    )


def _positive(solution: Solution, g: Terms) -> bool:
    """Whether g is enclosed above 0 on an enclosure of the range of u (collective)."""
    ends = [_most(solution, sign) for sign in (-1, 1)]
    low, high = (
        sign * of_u if of_fluxes <= 0 else sign * np.inf for sign, (of_u, of_fluxes) in zip((-1, 1), ends, strict=True)
    )
    away = np.append(np.sinh(np.linspace(0, FAR, PARTS)), np.inf)
    if np.isfinite([low, high]).all():
        steps = np.linspace(low, high, PARTS + 1)
    elif np.isfinite(low):
        steps = low + away
    else:
        steps = high - away[::-1] if np.isfinite(high) else np.concatenate([-away[::-1], away])
    box = {"u": Interval(steps[:-1], steps[1:])}
    with np.errstate(all="ignore"):
        total = sum((interval(term, box) * factor for factor, term in g), Interval(0 * steps[:-1], 0 * steps[:-1]))
    return bool((total.lo > 0).all())


def _of_soil(soil: Gardner, dim: int) -> tuple[Tree, Terms]:
    """The factors k and g of Gardner's soil."""
    heights = Call("exp", (Binary("*", exactly(-soil.alpha), Coordinate("xyz"[dim - 1])),))
    return Binary("*", exactly(soil.K), heights), (
        (1.0, Call("exp", (Binary("*", exactly(soil.alpha), Coordinate("u")),))),
    )


def _is_dry(solution: Solution, soil: Gardner) -> bool:
    """Whether ψ ≤ 0 is sure for the solution of the problem with Gardner's soil (collective)."""
    spaces = solution.spaces
    low, high = spaces.domain.box()[:, spaces.mesh.geometry.dim - 1]
    return soil.alpha * (high - low) <= STEEP and soil.air_entry == 0 and max(_most(solution, 1, soil)) <= 0


def _most(solution: Solution, sign: int, soil: Gardner | None = None) -> tuple[float, float]:
    """How far values of u are above a number, 0, and how far fluxes and f are above those of it, enclosed (collective).

    Args:
        solution: Has the data.
        sign: −1 for how far they are below.
        soil: It takes the height in the place of the number, with its flux in the soil.
    """
    spaces, data, mesh = solution.spaces, solution.data, solution.spaces.mesh
    z, K = Coordinate("xyz"[mesh.geometry.dim - 1]), 0.0 if soil is None else soil.K
    listed = [(data.u_D, spaces.dirichlet_facets, True), (data.g_N, spaces.neumann_facets, False)]
    for part in data.laws.of_parts:
        facets = spaces.facets[part.rows]
        listed += [(part.data[key], facets, True) for key in OF_U[type(part.law)]]
        listed += [(part.data[key], facets, False) for key in FLUXES[sign].get(type(part.law), [])]
    most = {True: -np.inf, False: -np.inf}
    for datum, facets, is_u in listed:
        on = in_facets(mesh, facets, np.full((1, mesh.topology.dim - 1), 1 / mesh.topology.dim))
        taken = np.broadcast_to(0.0 if is_u else K * (on.normals[:, -1] + ROUNDING), len(facets))
        for tree, rows in datum.trees_in(on.cells):
            above = difference(tree, z) if is_u and soil is not None else tree
            above = above if sign > 0 else Negative(above)
            off = _largest(above, on.vertices[rows]) - taken[rows]
            most[is_u] = max(most[is_u], off.max(initial=-np.inf))
        most[is_u] = most[is_u] if datum.pieces is not None else np.inf
    vertices = corners(mesh)
    for tree, rows in data.f.trees_in(np.arange(len(vertices))):
        off = _largest(tree if sign > 0 else Negative(tree), vertices[rows])
        most[False] = max(most[False], off.max(initial=-np.inf))
    most[False] = most[False] if data.f.pieces is not None else np.inf
    return mesh.comm.allreduce(float(most[True]), MPI.MAX), mesh.comm.allreduce(float(most[False]), MPI.MAX)


def _largest(tree: Tree, vertices: Array) -> Array:
    """Upper bounds of a tree on simplices, shape (n,); ∞ where there is none."""
    box = {
        name: Interval(vertices[..., i].min(axis=1), vertices[..., i].max(axis=1))
        for i, name in enumerate("xyz"[: vertices.shape[2]])
    }
    with np.errstate(all="ignore"):
        highest = np.broadcast_to(interval(tree, box).hi, len(vertices))
    return np.where(np.isnan(highest), np.inf, highest)


def _separated(kappa: Any) -> tuple[Any, Terms]:
    """The factors k and g; of regions g is the same but for a number.

    Raises:
        _NotThere: If κ is no such product.
    """
    of_regions = kappa if isinstance(kappa, Mapping) else {"": kappa}
    known = {name: _split(tree) for name, tree in of_regions.items()}
    (g, *others) = [terms for _, terms in known.values()]
    if any(other != g for other in others):
        raise _NotThere
    k = {name: factor for name, (factor, _) in known.items()}
    return (k if isinstance(kappa, Mapping) else k[""]), g


def _split(tree: Any) -> tuple[Tree, Terms]:
    """The factors k and g, with 1 for the number of the first term of g."""
    if not isinstance(tree, TREES):
        raise _NotThere
    k, of_u = _product(tree)
    terms = linear_terms(of_u)
    first = terms[0][0]
    if first == 0 or not np.isfinite([factor for factor, _ in terms]).all():
        raise _NotThere
    return Binary("*", exactly(first), k), tuple((factor / first, term) for factor, term in terms)


def _product(tree: Tree) -> tuple[Tree, Tree]:
    """A factor without u, and one of u alone."""
    if not depends_on(tree, "u"):
        return tree, exactly(1.0)
    if not any(depends_on(tree, name) for name in "xyzt"):
        return exactly(1.0), tree
    if isinstance(tree, Binary) and tree.sign in "*/":
        (k, g), (other, h) = _product(tree.left), _product(tree.right)
        if tree.sign == "*" or h == exactly(1.0):
            return Binary(tree.sign, k, other), g if h == exactly(1.0) else Binary("*", g, h)
    raise _NotThere


def _G(g: Terms, given: Any) -> Any:
    """G of a given u, number or text, or of one for each part."""
    if isinstance(given, Mapping):
        return {name: _G(g, value) for name, value in given.items()}
    tree = exactly(float(given)) if isinstance(given, int | float) else given
    if not isinstance(tree, TREES):
        raise _NotThere
    total: Tree = exactly(0.0)
    for factor, term in g:
        total = Binary("+", total, _integrated(factor, term, tree))
    return total


def _integrated(factor: float, term: Tree, u: Tree) -> Tree:
    """The integral of a term, at u."""
    power = _power(term)
    if power is not None:
        return Binary("*", exactly(factor / (power + 1)), Binary("^", u, exactly(float(power + 1))))
    if isinstance(term, Call) and term.name == "exp" and polynomial_degree(term.arguments[0]) == 1:
        at_0, at_1 = (
            float(values(substituted(term.arguments[0], "u", exactly(end)), np.zeros(3))) for end in (0.0, 1.0)
        )
        if at_1 != at_0:
            return Binary("*", exactly(factor / (at_1 - at_0)), substituted(term, "u", u))  # type: ignore[arg-type]
    raise _NotThere


def _power(term: Tree) -> int | None:
    """The power of u that a term is; None if it is none."""
    match term:
        case Number(value=1.0):
            return 0
        case Coordinate():
            return 1
        case Binary(sign="^", left=Coordinate(), right=Number(value=value)) if value.is_integer() and value >= 0:
            return int(value)
        case Binary(sign="*", left=left, right=right):
            one, other = _power(left), _power(right)
            return None if one is None or other is None else one + other
    return None
