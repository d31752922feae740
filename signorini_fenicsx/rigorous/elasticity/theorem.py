"""The error bound of elastic contact as a theorem: the gap identity with every number in it enclosed.

What is proved. Ω is the union of the simplices whose vertices are the stored floats. f, E, ν, ε₀, u_D, g_N, the
pressures and g are the functions written in the case file, with exact literals and exact pi. u solves the problem of
contact, with friction that of Tresca; where the bound of the shear is by the pressure it is the stored linear function
on each facet. σ = ℂ(ε(u) − ε₀). σ_h is the field that is linear on each subcell, where the stored floats are its values
at the vertices. Then `Proven.sigma_bound` is an upper bound of ‖σ − σ_h‖, and `Proven.bound` one of ‖σ − σ_h‖ and of
|v − u|, in energy norms. It does not matter how σ_h and v were computed.

Proof. The argument is that of `forms.elasticity`, here with exact ingredients.

- *Stress.* y is a stress of Johnson and Mercier that is in balance with f in all cells, as real numbers, see `stress`.
  On Γ_N it has the linear part of the traction that is given, on Γ_C a pressure ≥ 0 and a shear within the bound, see
  `on_contact`. ‖y − σ_h‖ is enclosed. So no constant of Korn of the body is needed, and it does not matter what solvers
  leave. What is left of loads in cells and on facets is bounded by constants of these, see `loads`.
- *Displacement.* See `displacement`: v = u_D where u is given, and v_n ≤ g on Γ_C.
- *Material.* 𝔸 stands in the place of κ in `tensor`, and ℂ in that of κ⁻¹: with LᵀAL ≥ θ > 0 it is ‖ε(v) − 𝔸y‖_ℂ ≤
  θ^-½‖Lᵀ(ε(v) − 𝔸y)‖, and ‖τ‖_𝔸 = ‖𝔸τ‖_ℂ. An eigenstrain ε₀ is added to 𝔸y: a linear function on each cell, and
  what is left of it in its largest size.
"""

from collections.abc import Callable

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.certificate.proof import Proofs, Proven
from signorini_fenicsx.discrete.linear_traces import facet_normals, opposite
from signorini_fenicsx.expressions import Binary, is_polynomial
from signorini_fenicsx.expressions.intervals import Interval, enclosing, stacked
from signorini_fenicsx.expressions.tree import Negative, exactly
from signorini_fenicsx.forms.elasticity import pairs
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import split_vertices
from signorini_fenicsx.physics.elasticity.scope import outside
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.rigorous.data import Term, enclosed_at, linear_on
from signorini_fenicsx.rigorous.discrete import opposed
from signorini_fenicsx.rigorous.elasticity.discrete import NONE, ElasticDiscrete, Given, gathered
from signorini_fenicsx.rigorous.elasticity.displacement import admissible
from signorini_fenicsx.rigorous.elasticity.loads import Moments, constants, force
from signorini_fenicsx.rigorous.elasticity.on_contact import changed, pressed, reactions, rubbed, shear_near, tangential
from signorini_fenicsx.rigorous.elasticity.stress import equilibrated, stresses_of
from signorini_fenicsx.rigorous.elementary import FromArb
from signorini_fenicsx.rigorous.simplices import (
    Simplices,
    facet_measures,
    gradient_in_vertices,
    proven,
    root,
    root_above,
    simplices,
    square_norm,
    squared,
    total,
    total_above,
    with_midpoints,
)
from signorini_fenicsx.rigorous.tensor import Tensor

PRESSED = 1e-9
"""Pressures below this share of the largest one are 0."""
LARGE = 0.1
"""Where contact has to hold a body, facets with pressures above this share of the largest one do."""
STICKS = 0.9
"""Across their normal those do on which the shear is below this share of its bound."""


def prove(discrete: ElasticDiscrete, given: Given) -> Proven:
    """Bound the error of any discrete stress and displacement.

    Raises:
        InputError: If the argument gives no bound for these data or this mesh.
    """
    cells = simplices(discrete.vertices)
    subcells = _split(cells)
    compliance = _compliance(discrete, given, subcells)
    areas = cells.gradients * cells.measure[:, None, None] * -float(cells.dim)  # |e|n
    moments, off = force(discrete, given, cells)
    contact = discrete.gap != NONE
    normal = areas[contact]
    bound = _bound(discrete, given)
    pulls, off_facets = _loads(discrete, given, areas)
    pulls, pressures, shear = _on_contact(discrete, areas, bound, pulls)
    outlets = (discrete.displacement != NONE).all(axis=2)
    sticks = _sticking(discrete, bound, shear)
    holds = _holds(discrete, areas, pressures, sticks)
    in_balance = equilibrated(discrete, discrete.pair, outlets, holds, pulls, moments)
    y = stresses_of(cells, in_balance, moments)
    more = _difference(pulls[contact], in_balance[contact])
    pressure, rubbing = changed(normal, bound, pressures[contact], shear, more, sticks[contact])
    v = admissible(discrete, given, normal)

    y_entries = _entries(y)
    strains = _strains(subcells, v.values), *_own_strain(discrete, given)
    mismatch = _energy(compliance, subcells, y_entries, strains)
    left = _energy(compliance, subcells, y_entries - _entries(enclosing(discrete.stresses)))
    on_contact = pressed(pressure, v.off)
    rough = bound.hi.any(axis=1)
    on_rough = rubbed(normal[rough], bound[rough], rubbing[rough], v.on_contact[rough])
    twice_the_gap = np.concatenate([squared(mismatch).hi, 2 * on_contact.hi, 2 * on_rough.hi])
    oscillation = squared(_oscillation(compliance, cells, off, off_facets)).hi
    return proven(twice_the_gap, oscillation, root_above(total_above(squared(left).hi)))


def _oscillation(compliance: Tensor, cells: Simplices, off: Interval, off_facets: Interval) -> Interval:
    """How large (f − f_h, w)_T + ⟨g_N − Π₁g_N, w⟩ may be beside |w|_T, see `loads`."""
    if off.is_zero.all() and off_facets.is_zero.all():
        return off
    of_cells, of_facets = constants(cells)
    measures = facet_measures(cells.vertices[:, opposite(cells.dim)])
    on_facets = total(off_facets * root(measures)) / root(cells.measure)
    softness = compliance.root_largest.hi.reshape(len(cells.vertices), -1).max(axis=1)
    return (of_cells * off + of_facets * on_facets) * softness


def _split(cells: Simplices) -> Simplices:
    """The subcells; their vertices are up to rounding, their measures and gradients are not."""
    dim, facets = cells.dim, opposite(cells.dim)
    gradients = []
    for i in range(dim + 1):
        own = cells.gradients[:, i]
        hats = [cells.gradients[:, k] - own for k in facets[i]]
        gradients.append(stacked([*hats, own * float(dim + 1)], axis=1))
    vertices, measure = split_vertices(cells.vertices).reshape(-1, dim + 1, dim), cells.measure / float(dim + 1)
    of_subcells = np.repeat(np.arange(len(cells.vertices)), dim + 1)
    return Simplices(vertices, measure[of_subcells], stacked(gradients, axis=1).reshape(*vertices.shape))


def _compliance(discrete: ElasticDiscrete, given: Given, subcells: Simplices) -> Tensor:
    """𝔸 on the subcells, (1 + ν)/E times the unit matrix, and the same number beside it for all normal stresses."""
    dim, number, terms = discrete.dim, len(pairs(discrete.dim)), list[Term]()
    for young, with_young in given.each(discrete.material[:, 0]):
        for poisson, with_poisson in given.each(discrete.material[:, 1]):
            longer = Binary("+", exactly(1), poisson)
            across = Binary("*", poisson, longer) if dim == 2 and given.in_strain else poisson
            on_diagonal, both = [(k, k) for k in range(number)], with_young & with_poisson
            terms += [
                (Binary("/", longer, young), both, on_diagonal),
                (Binary("/", Negative(across), young), both, list(np.ndindex(dim, dim))),
            ]
    found = linear_on(discrete.vertices, (number, number), terms, given.elementary, "young or poisson")
    deviations = root(total(total(squared(enclosing(found[1]))))).hi
    of_subcells = _on_subcells(found[0]), np.repeat(deviations, dim + 1)
    return Tensor(subcells, *of_subcells, name="the compliance of young and poisson")


def _own_strain(discrete: ElasticDiscrete, given: Given) -> tuple[Interval, Array]:
    """The entries of ε₀ at the vertices of subcells, linear on each cell, and bounds of the rest on subcells.

    In plane strain ε_zz = 0, and ν times the zz of the eigenstrain is in the normal entries.
    """
    dim, number = discrete.dim, len(pairs(discrete.dim))
    terms: list[Term] = [(tree, mask, [(k,)]) for k in range(number) for tree, mask in given.each(discrete.own[:, k])]
    if dim == 2 and given.in_strain:
        for beyond, with_beyond in given.each(discrete.own[:, -1]):
            for poisson, with_poisson in given.each(discrete.material[:, 1]):
                both = with_beyond & with_poisson
                terms += [(Binary("*", poisson, beyond), both, [(k,) for k in range(dim)])] if both.any() else []
    corners, deviations = linear_on(discrete.vertices, (number,), terms, given.elementary, "eigenstrain")
    weights = stacked([enclosing(1.0)] * dim + [root(enclosing(2.0))] * (number - dim))
    sizes = root(total(squared(deviations * weights)))
    return _on_subcells(corners * weights), np.repeat(sizes.hi, dim + 1)


def _on_subcells(corners: Interval) -> Interval:
    """Linear functions on cells at the vertices of subcells, shape (subcells, d + 1, …)."""
    dim = corners.lo.shape[1] - 1
    middle = total(corners, axis=1) / float(dim + 1)
    on_subcells = [stacked([*(corners[:, k] for k in each), middle], axis=1) for each in opposite(dim)]
    return stacked(on_subcells, axis=1).reshape(-1, *corners.lo.shape[1:])


def _bound(discrete: ElasticDiscrete, given: Given) -> Interval:
    """The bound of the shear at the vertices of the facets of Γ_C, shape (facets, d).

    Raises:
        InputError: If one is not linear.
    """
    contact = discrete.gap != NONE
    bounds = discrete.bound[contact]
    bound, numbers, x = Interval(bounds, bounds.copy()), discrete.rubbing[contact], discrete.facet_vertices(contact)
    for tree, mask in given.each(numbers):
        if not is_polynomial(tree, 1):
            raise InputError("the proof is for linear g of friction alone")
        values = enclosed_at(tree, enclosing(x[mask]), given.elementary)
        bound.lo[mask], bound.hi[mask] = np.maximum(values.lo, 0.0), values.hi
    return bound


def _loads(discrete: ElasticDiscrete, given: Given, areas: Interval) -> tuple[Interval, Interval]:
    """The pulls q = |e| yn at vertices of facets, before cells are in balance, and a bound of ‖g_N − Π₁g_N‖ on facets.

    In directions in which u is given, and inside, they are those of σ_h, elsewhere what the data say.
    """
    dim = discrete.dim
    outer = facet_normals(discrete.vertices)
    own = np.einsum("niakl,nil->niak", discrete.stresses[:, :, :dim], outer)
    inside = np.bincount(discrete.facets.ravel())[discrete.facets] == 2
    own = np.where(inside[..., None, None], opposed(discrete.facets, own), own)
    free = inside[..., None] | (discrete.displacement != NONE)
    own = np.where(free[:, :, None], own, 0.0)
    pulls = Interval(own, own.copy())
    x = discrete.vertices[:, opposite(dim)]
    squares = Interval(*np.zeros((2, *inside.shape)))
    for k in range(dim):
        for tree, mask in given.each(np.where(free[..., k], NONE, discrete.traction[..., k])):
            data = Moments.of(tree, x[mask], given, "g_N")
            pull = data.linear() * facet_measures(x[mask])[:, None]
            pulls[mask, :, k] = pull
            more = squares[mask] + squared(data.off_linear())
            squares[mask] = more
    for tree, mask in given.each(discrete.pressure):
        data = Moments.of(tree, x[mask], given, "pressure")
        pull = (-data.linear())[..., None] * areas[mask, None]
        pull = pulls[mask].where(free[mask][:, None], pull)
        pulls[mask] = pull
        more = squared(data.off_linear())
        squares[mask] = more
    return pulls, root(squares * facet_measures(x))


def _on_contact(
    discrete: ElasticDiscrete, areas: Interval, bound: Interval, pulls: Interval
) -> tuple[Interval, Array, Array]:
    """The tractions q with those on Γ_C, the pressures of these at the vertices of facets, and their w."""
    outer, dim = facet_normals(discrete.vertices), discrete.dim
    contact = discrete.gap != NONE
    pressure = _pressures(discrete, outer) * contact[..., None]
    pressure[pressure < PRESSED * pressure.max(initial=0.0)] = 0.0
    normals = outer[contact] / np.linalg.norm(outer[contact], axis=1, keepdims=True)
    at_vertices = np.einsum("naij,nj->nai", discrete.stresses[:, :, :dim][contact], normals)
    shear, across = shear_near(at_vertices, normals, bound.lo), areas[contact, None]
    traction = enclosing(-pressure[contact][..., None]) * across + tangential(across, enclosing(shear))
    pulls[contact] = traction
    touching, other = discrete.pairs
    pulls.lo[other], pulls.hi[other] = -traction.hi[touching], -traction.lo[touching]
    pressure[other] = pressure[contact][touching]
    return pulls, pressure, shear


def _pressures(discrete: ElasticDiscrete, outer: Array) -> Array:
    """Numbers near −σ_nn at the vertices of all facets, from |e|n, shape (cells, d + 1, d)."""
    pressures = np.einsum("nij,niajk,nik->nia", outer, discrete.stresses[:, :, : discrete.dim], outer)
    return -pressures / (outer**2).sum(axis=2)[..., None]


def _sticking(discrete: ElasticDiscrete, bound: Interval, shear: Array) -> Mask:
    """Mask of the facets of Γ_C, on both sides where bodies touch, on which the shear is below its bound."""
    contact = discrete.gap != NONE
    sticks = np.zeros(contact.shape, dtype=bool)
    sticks[contact] = ((bound.lo > 0) & (np.linalg.norm(shear, axis=2) <= STICKS * bound.lo)).all(axis=1)
    touching, other = discrete.pairs
    sticks[other] = sticks[contact][touching]
    return sticks


def _holds(discrete: ElasticDiscrete, areas: Interval, pressure: Array, sticks: Mask) -> Interval:
    """H of `equilibrated`: directions in which u is given, and on Γ_C along N and where it sticks across N.

    On Γ_C it is 0 where the pressure is not large.
    """
    pressed = pressure.min(axis=2) > LARGE * pressure.max(initial=0.0)
    held = np.where((discrete.displacement != NONE)[..., None], np.eye(discrete.dim), 0.0)
    return reactions(areas, sticks).where(pressed[..., None, None], enclosing(held))


def _difference(before: Interval, after: Interval) -> Interval:
    """By how much tractions on facets have changed, 0 where they are the same."""
    same = ((before.lo == after.lo) & (before.hi == after.hi)).all(axis=(1, 2))
    return enclosing(np.zeros(before.lo.shape)).where(same[:, None, None], after - before)


def _entries(matrices: Interval) -> Interval:
    """The entries of symmetric matrices at the vertices of subcells, shape (subcells, d + 1, entries)."""
    dim = matrices.lo.shape[-1]
    twice = root(enclosing(2.0))
    columns = [matrices[..., i, j] * (1.0 if i == j else twice) for i, j in pairs(dim)]
    return stacked(columns).reshape(-1, dim + 1, len(columns))


def _strains(subcells: Simplices, values: Interval) -> Interval:
    """The entries of ε(v) at the vertices of subcells, from values of v in the nodes of P2."""
    dim = subcells.dim
    flat = values.reshape(len(subcells.vertices), -1, dim)
    slopes = [gradient_in_vertices(subcells, flat[..., i]) for i in range(dim)]
    half = root(enclosing(2.0)) / 2.0
    columns = [slopes[i][..., i] if i == j else (slopes[i][..., j] + slopes[j][..., i]) * half for i, j in pairs(dim)]
    return stacked(columns)


def _energy(
    compliance: Tensor, subcells: Simplices, stress: Interval, strains: tuple[Interval, Interval, Array] | None = None
) -> Interval:
    """A bound of ‖𝔸y + ε₀ − ε‖_ℂ of each subcell, which without strains is ‖y‖_𝔸, from entries at the vertices.

    The strains are ε, ε₀ and bounds of what is not linear in ε₀.
    """
    y = with_midpoints(stress)
    off, size = compliance.times(y), compliance.deviation_norm(square_norm(subcells, y))
    if strains is not None:
        of_v, own, beyond = strains
        off = off - with_midpoints(of_v) if own.is_zero.all() else off + with_midpoints(own - of_v)
        size = size + compliance.half_norm(subcells.measure * squared(enclosing(beyond)))
    return (root(square_norm(subcells, compliance.half(off))) + size) / root(compliance.theta)


def _prepared(solution: ElasticSolution, v: fem.Function) -> Callable[[], Proven | None]:
    """The proof of an elastic problem, to be run on rank 0 (collective).

    Raises:
        InputError: If there is no theorem for the problem.
    """
    reason = outside(solution.problem)
    if reason or solution.step is not None:
        raise InputError(reason or "the proof is not for steps in time")
    discrete = gathered(solution, v, FromArb())
    return lambda: None if discrete is None else prove(*discrete)


PROOFS = Proofs(50_000, _prepared)
