"""The error bound as a theorem: the gap identity with every number in it enclosed.

What is proved. Ω is the union of the simplices whose vertices are the stored floats. Γ_D, Γ_N and Γ_S are its marked
facets. f, κ, u_D, g_N, ψ, q_S are the functions written in the case file, with exact literals and exact pi. u solves
Signorini's problem, and σ = κ∇u. σ_h is the RT0 field whose fluxes through facets are the stored floats. Then
`Proven.sigma_bound` is an upper bound of ‖σ − σ_h‖, and `Proven.bound` one of ‖σ − σ_h‖ and of |∇(v − u)|, in energy
norms. It does not matter how σ_h and v were computed.

Proof. The argument is that of `certificate`, here with exact ingredients.

- *Flux.* y has the mean of g_N on facets of Γ_N, at least the mean of q_S on facets of Γ_S, and ∇·y + mean of f is 0 in
  all cells, see `balance`. So the bound has no term C_F‖c‖, and no Γ_D is needed. ‖y − σ_h‖ is enclosed. Where
  certainly y·n ≥ q_S, r = 0, and ⟨r − s, v − ψ⟩ is at most the integral of r − s times sup (v − ψ). Elsewhere r is q_S
  minus its mean.
- *Trace.* See below: v = u_D on Γ_D and v ≥ ψ on Γ_S, up to a function whose gradient is bounded.
- *κ.* Let L be a matrix of floats with LᵀκL ≥ θ > 0 on T. Then ‖κ^-½q‖_T ≤ θ^-½‖Lᵀq‖_T, and κ∇v − y = (κ̃∇v − y) +
  (κ − κ̃)∇v with κ̃ the linear interpolant. In the coordinates Lᵀx the cell is convex with a diameter ĥ, and |L⁻¹∇w|² ≤
  κ∇w·∇w/θ. So Poincaré's constant for energy norms is ĥ/(π√θ), and the trace constant C_e of `local_fields` has ĥ/√θ
  in place of δ_T.
- *Data.* Enclosures over parts of cells and facets give means, and ‖e − p‖ and sup |e − p| with p linear or quadratic.

*A continuous function that is u_D on Γ_D and at least ψ on Γ_S, from the certificate's v*.

Let P be the P2 function with v's values in the nodes on Γ_D and floats near u_D in all other nodes, and let χ be the
sum of the hat functions of the vertices on Γ_D. Then v + χ(u_D − P) is u_D on Γ_D. Hat functions λ of the other
vertices on Γ_S, times ρ ≥ 0, raise this function until it is at least ψ on Γ_S. On a facet let q = v − Pψ, with Pψ a
quadratic near ψ, and let ‖·‖ denote largest values.

- If no vertex is on Γ_D, χ = 0 and q + Σρλ ≥ ‖ψ − Pψ‖ is sufficient.
- Otherwise the data must satisfy u_D ≥ ψ where χ = 1. Let s(x) be x with each barycentric coordinate of a vertex off
  Γ_D distributed over the vertices on Γ_D, so χ(s) = 1 and |x − s| ≤ (1 − χ)h. Let d = u_D − P. The height of the
  function above ψ in s is u_D − ψ. Its height in x minus its height in s is at least

      q(x) − q(s) + Σρλ − (1 − χ)(χ h‖∇d‖ + ‖d‖ + max_e ‖∇(ψ − Pψ)·e‖),

  with edges e. This quadratic must be ≥ 0; `_lifts` tests it by Bernstein coefficients.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.reference_cells import EDGES
from signorini_fenicsx.certificate.proof import Proofs, Proven
from signorini_fenicsx.expressions import difference, values
from signorini_fenicsx.expressions.intervals import PI, Interval, enclosing, larger, stacked
from signorini_fenicsx.physics.diffusion.rt1_solution import RT1Solution
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.rigorous.balance import balanced
from signorini_fenicsx.rigorous.data import Deviation, Given, deviation, places, smallest
from signorini_fenicsx.rigorous.discrete import (
    DIRICHLET,
    INSIDE,
    NEUMANN,
    SIGNORINI,
    Discrete,
    MeshFacets,
    alike_in_nodes,
    boundary,
    gathered,
    pairs,
)
from signorini_fenicsx.rigorous.elementary import FromArb
from signorini_fenicsx.rigorous.simplices import (
    Simplices,
    bernstein,
    flux_in_vertices,
    gradient_in_vertices,
    mean,
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


@dataclass(frozen=True)
class Enclosed:
    """The admissible function.

    Attributes:
        nodes: Its quadratic part in the nodes of P2 of each cell.
        extra: Upper bound of ‖∇((u_D − P)χ)‖ per cell.
        height: Upper bound of the mean of the function minus ψ over each Γ_S facet.
        highest: Upper bound of the values of the function minus ψ there.
    """

    nodes: Interval
    extra: Interval
    height: Interval
    highest: Interval


def admissible(discrete: Discrete, cells: Simplices, given: Given) -> Enclosed:
    """Make the trace of v admissible.

    Raises:
        InputError: If u_D may be < ψ where Γ_D and Γ_S meet.
    """
    on_dirichlet = _nodes_on(discrete, DIRICHLET)
    correction = _dirichlet(discrete, cells, given, on_dirichlet)
    facets = boundary(discrete, SIGNORINI)
    psi = deviation(given.psi, facets.corners, given.elementary, name="psi")
    dim = discrete.dim - 1
    q = enclosing(discrete.v[facets.cells[:, None], facets.nodes]) - psi.nodes
    fixed = on_dirichlet[facets.cells[:, None], facets.nodes[:, : dim + 1]]
    spare = _spare(facets, fixed, q, psi, correction) + _at_seam(given, facets, fixed)[:, None]
    lifts = _lifts(discrete.corners[facets.cells[:, None], facets.nodes[:, : dim + 1]], fixed, spare, discrete.corners)
    rise = [enclosing(lifts[discrete.corners[:, k]]) for k in range(discrete.dim + 1)]
    lift = stacked([*rise, *((rise[i] + rise[j]) / 2.0 for i, j in EDGES[discrete.dim])])
    above = q + lift[facets.cells[:, None], facets.nodes]
    beside = np.where(fixed.any(axis=1), correction.size[facets.cells], 0.0)
    height = mean(above, dim) - psi.mean + beside
    highest = enclosing(bernstein(above, dim).hi.max(axis=1)) + psi.largest + beside
    extra = enclosing(correction.extra)
    return Enclosed(enclosing(discrete.v) + lift, extra, *(larger(each, enclosing(0.0)) for each in (height, highest)))


@dataclass(frozen=True)
class _Correction:
    """Upper bounds per cell: of ‖∇(χ(u_D − P))‖, of |u_D − P| and of |∇(u_D − P)|."""

    extra: Array
    size: Array
    slope: Array


def _nodes_on(discrete: Discrete, kind: int) -> Mask:
    """Mask of the nodes of P2 of each cell that lie on facets of this kind, of this or other cells."""
    facets, dim = boundary(discrete, kind), discrete.dim
    corners = discrete.corners
    on_kind = np.zeros(discrete.v.shape, dtype=bool)
    of_facet = corners[facets.cells[:, None], facets.nodes[:, :dim]]
    on_kind[:, : dim + 1] = np.isin(corners, of_facet)
    for number, (i, j) in enumerate(EDGES[dim]):
        edges = np.concatenate([pairs(of_facet[:, a], of_facet[:, b]) for a, b in EDGES[dim - 1]])
        on_kind[:, dim + 1 + number] = np.isin(pairs(corners[:, i], corners[:, j]), edges)
    return on_kind


def _dirichlet(discrete: Discrete, cells: Simplices, given: Given, on_dirichlet: Mask) -> _Correction:
    count, dim = len(discrete.v), discrete.dim
    extra, size, slope = np.zeros(count), np.zeros(count), np.zeros(count)
    near = np.flatnonzero(on_dirichlet[:, : dim + 1].any(axis=1))
    if len(near) > 0:
        vertices = discrete.vertices[near]
        sampled = values(given.u_D, places(with_midpoints(enclosing(vertices))))
        wanted = np.where(on_dirichlet[near], discrete.v[near], alike_in_nodes(discrete.corners[near], sampled))
        enclosed = deviation(given.u_D, vertices, given.elementary, name="u_D", by="tilt", wanted=wanted)
        missed = enclosing(wanted) - enclosed.nodes
        chi = on_dirichlet[near, : dim + 1]
        hats = enclosing(np.where(chi[..., None], 1.0, 0.0)) * cells.gradients[near]
        steep = root(total(squared(total(hats, axis=1))))
        steep = Interval(steep.lo, np.where(chi.all(axis=1), 0.0, steep.hi))  # χ = 1 on these
        near_cells = cells.some(near)
        sup = (enclosing(enclosed.largest) + bernstein(missed, dim).largest.max(axis=1)).hi
        gradient = gradient_in_vertices(near_cells, missed)
        steepest = root(total(squared(gradient))).hi.max(axis=1)
        size[near], slope[near] = sup, (enclosing(enclosed.slope) + steepest).hi
        bent = root(square_norm(near_cells, with_midpoints(gradient)))
        flat = root(square_norm(near_cells, missed))
        whole = root(near_cells.measure)
        extra[near] = (bent + whole * enclosed.tilt + steep * (flat + whole * enclosed.norm)).hi
    return _Correction(extra, size, slope)


def _at_seam(given: Given, facets: MeshFacets, fixed: Mask) -> Array:
    """Lower bound ≥ 0 of u_D − ψ on those faces of each Γ_S facet that are on Γ_D; 0 if there are none.

    Raises:
        InputError: If u_D ≥ ψ is not certain there.
    """
    width = fixed.shape[1]
    lowest = np.where(fixed.any(axis=1), np.inf, 0.0)
    above = difference(given.u_D, given.psi)
    for size in range(1, width + 1):
        for face in itertools.combinations(range(width), size):
            chosen = fixed[:, face].all(axis=1)
            if chosen.any():
                corners = facets.corners[chosen][:, face]
                lowest[chosen] = np.minimum(lowest[chosen], smallest(above, corners, given.elementary))
    if not (lowest >= 0).all():
        where = ", ".join(f"{x:.4g}" for x in facets.corners[np.argmin(lowest)].mean(axis=0))
        raise InputError(f"where Γ_D meets Γ_S, u_D ≥ psi is not certain near ({where})")
    return lowest


def _spare(facets: MeshFacets, fixed: Mask, q: Interval, psi: Deviation, correction: _Correction) -> Interval:
    """Bernstein coefficients of the quadratic of the module, without Σρλ, on each facet."""
    dim = fixed.shape[1] - 1
    edges = EDGES[dim]
    coefficients = bernstein(q, dim)
    column = [coefficients[:, k] for k in range(coefficients.lo.shape[1])]
    of_pair = {(k, k): column[k] for k in range(dim + 1)} | {edge: column[dim + 1 + n] for n, edge in enumerate(edges)}
    share = fixed / np.maximum(fixed.sum(axis=1, keepdims=True), 1)  # exact but for thirds, which need all fixed
    to = [[np.where(fixed[:, k], float(k == j), share[:, j]) for j in range(dim + 1)] for k in range(dim + 1)]

    def moved(k: int, m: int) -> Interval:
        """The coefficient of q(s)."""
        terms = [of_pair[min(i, j), max(i, j)] * (to[k][i] * to[m][j]) for i in range(dim + 1) for j in range(dim + 1)]
        return sum(terms[1:], terms[0])

    h = root(
        sum(
            (total(squared(enclosing(facets.corners[:, i]) - facets.corners[:, j])) for i, j in edges),
            enclosing(np.zeros(len(fixed))),
        )
    )  # not less than the longest edge
    steep = h * correction.slope[facets.cells]
    flat = enclosing(psi.rise) + correction.size[facets.cells]
    seam = fixed.any(axis=1)
    spare = []
    for k, m in [(k, k) for k in range(dim + 1)] + list(edges):
        free = 2.0 - fixed[:, k] - fixed[:, m]
        mixed = fixed[:, k] != fixed[:, m]
        beside = of_pair[k, m] - moved(k, m) - flat * (free / 2) - steep * np.where(mixed, 0.5, 0.0)
        spare.append(beside.where(seam, of_pair[k, m] - psi.largest))
    return stacked(spare)


def _lifts(vertices: Indices, fixed: Mask, spare: Interval, corners: Indices) -> Array:
    """ρ of each vertex: enough to make the quadratics of all its facets ≥ 0; 0 for vertices on Γ_D.

    Σ a_i λ_i² + 2 Σ c_ij λ_i λ_j ≥ 0 if a_i ≥ 0 and c_ij ≥ −√(a_i a_j), or ≥ −½√(a_i a_j) for triangles: with t_i =
    √a_i λ_i the sum is at least (t_1 − t_2)², or Σ (t_i − t_j)²/2. ρ_i adds ρ_i to a_i, and ρ_i/2 to all c_ij.
    """
    dim = fixed.shape[1] - 1
    part = 1.0 if dim == 1 else 0.5
    lack = np.maximum(-spare.lo, 0.0)
    lifts = np.zeros(int(corners.max()) + 1)
    for k in range(dim + 1):
        np.maximum.at(lifts, vertices[:, k], np.where(fixed[:, k], 0.0, lack[:, k]))
    for number, (i, j) in enumerate(EDGES[dim]):
        ends = (enclosing(np.maximum(spare.lo[:, k], 0.0)) for k in (i, j))
        lacking = np.maximum((-spare[:, dim + 1 + number] - part * root(next(ends) * next(ends))).hi, 0.0)
        for k, other in ((i, j), (j, i)):
            needed = lacking * np.where(fixed[:, other], 2.0, 1.0)
            np.maximum.at(lifts, vertices[:, k], np.where(fixed[:, k], 0.0, needed))
    return lifts


VARIES = 1e-3
"""If q_S varies by less than this share of the flux, it counts as constant, and its tiny r stays in the oscillation."""


def prove(discrete: Discrete, given: Given) -> Proven:
    """Bound the error of any discrete flux and trace.

    Raises:
        InputError: If the argument gives no bound for these data or this mesh.
    """
    if (np.bincount(discrete.facets.ravel())[discrete.facets] != np.where(discrete.kinds == INSIDE, 2, 1)).any():
        raise InputError("conditions are given on facets inside the domain, or facets have three cells")
    cells = simplices(discrete.vertices)
    kappa = given.conductivity(cells, discrete)
    constant = kappa.diameter / PI
    load, oscillation = _load(cells, constant, given)
    fluxes, least, pressed, on_facets = _boundary_fluxes(discrete, cells, kappa, given)
    outlets = _outlets(discrete, fluxes, least)
    y = balanced(discrete.facets, outlets, fluxes, load)
    excess = _excess(discrete, y, least)
    trace = admissible(discrete, cells, given)

    slopes = with_midpoints(gradient_in_vertices(cells, trace.nodes))
    y_nodes, left_nodes = (with_midpoints(flux_in_vertices(cells, f)) for f in (y, y - discrete.fluxes))
    mismatch = root(square_norm(cells, kappa.half(kappa.times(slopes) - y_nodes)))
    mismatch = (mismatch + kappa.deviation_norm(square_norm(cells, slopes))) / root(kappa.theta)
    mismatch = mismatch + kappa.root_largest * trace.extra
    contact = 2.0 * excess * trace.highest.where(pressed, trace.height)
    oscillation = (oscillation + on_facets) / root(kappa.theta)
    left = root_above(total_above((square_norm(cells, kappa.half(left_nodes)) / kappa.theta).hi))
    return proven(np.concatenate([squared(mismatch).hi, contact.hi]), squared(oscillation).hi, left)


def _load(cells: Simplices, constant: Interval, given: Given) -> tuple[Interval, Interval]:
    """∫_T f, and a bound of `constant` times ‖f − its mean‖_T, by ‖f − c‖ ≤ ‖p − c‖ + ‖f − p‖ for any number c."""
    f = deviation(given.f, cells.vertices, given.elementary, by="mean", name="f")
    nodes = f.nodes
    middle = mean(nodes, cells.dim)
    spread = root(square_norm(cells, nodes - middle[:, None]))
    return cells.measure * (middle + f.mean), constant * (spread + root(cells.measure) * f.norm)


def _boundary_fluxes(
    discrete: Discrete, cells: Simplices, kappa: Tensor, given: Given
) -> tuple[Interval, Interval, Mask, Interval]:
    """Fluxes that are admissible for g_N and q_S.

    On Γ_N the flux is the integral of g_N. On Γ_S it stays, or becomes the integral of q_S if it is less than that.

    Returns:
        The fluxes, ∫q_S on the facets of Γ_S, a mask of those facets where r = 0, and the oscillation per cell.
    """
    lo, hi = discrete.fluxes.copy(), discrete.fluxes.copy()
    oscillation = np.zeros(len(lo))
    least, pressed = enclosing(np.empty(0)), np.empty(0, dtype=bool)
    for kind, name in ((NEUMANN, "g_N"), (SIGNORINI, "q_S")):
        facets = boundary(discrete, kind)
        if len(facets.cells) == 0:
            continue
        g = deviation(getattr(given, name), facets.corners, given.elementary, by="mean", name=name)
        dim = discrete.dim - 1
        wanted = facets.measure * (mean(g.nodes, dim) + g.mean)
        place = (facets.cells, facets.local)
        if kind == SIGNORINI:
            least, flux = wanted, enclosing(discrete.fluxes[place])
            wanted = flux.where(flux.lo >= least.hi, least)
        lo[place], hi[place] = wanted.lo, wanted.hi
        coefficients = bernstein(g.nodes, dim)
        highest, lowest = enclosing(coefficients.hi.max(axis=1)), enclosing(coefficients.lo.min(axis=1))
        spread = (highest - lowest) / 2.0 + g.norm
        rest = (_trace_constant(cells, kappa, facets) * root(facets.measure) * spread).hi
        if kind == SIGNORINI:
            varies = spread.hi * facets.measure.hi > VARIES * np.abs(discrete.fluxes[place])
            pressed = varies & (discrete.fluxes[place] >= (facets.measure * (highest + g.largest)).hi)
            pressed &= (discrete.kinds == DIRICHLET).any()  # otherwise the imbalance leaves through such facets
            rest[pressed] = 0.0
        np.add.at(oscillation, facets.cells, rest)
        for _ in range(2):  # a cell has at most four facets: three roundings, of half a step each
            oscillation = np.where(oscillation > 0, np.nextafter(oscillation, np.inf), 0.0)
    return Interval(lo, hi), least, pressed, enclosing(oscillation)


def _outlets(discrete: Discrete, fluxes: Interval, least: Interval) -> Mask:
    """Mask of the facets through which the imbalance may leave: Γ_D or, without it, those of Γ_S with large fluxes."""
    outlets = discrete.kinds == DIRICHLET
    if not outlets.any() and len(least.lo):
        on_signorini = discrete.kinds == SIGNORINI
        more = fluxes.lo[on_signorini] - least.hi
        outlets[on_signorini] = more >= max(more.max() / 2, np.finfo(float).tiny)
    return outlets


def _excess(discrete: Discrete, y: Interval, least: Interval) -> Interval:
    """The flux through each facet of Γ_S minus the integral of q_S, which must be ≥ 0.

    Raises:
        InputError: If it may be < 0 by more than the width of that integral.
    """
    if len(least.lo) == 0:
        return enclosing(0.0)
    place = np.nonzero(discrete.kinds == SIGNORINI)
    flux = y[place]
    more = flux - least
    same = (flux.lo == least.lo) & (flux.hi == least.hi)  # y·n is q_S exactly
    if not (same | (more.lo >= 0)).all():
        raise InputError("the flux cannot be balanced: the rounding errors are larger than the flux through Γ_S")
    return enclosing(np.zeros(len(same))).where(same, more)


def _trace_constant(cells: Simplices, kappa: Tensor, facets: MeshFacets) -> Interval:
    """The constant C_e of `physics/diffusion/bound/local_fields`, with ĥ in place of δ_T."""
    factor = 1.0 / (PI * PI) + 2.0 / (PI * float(cells.dim))
    return root(facets.measure / cells.measure[facets.cells] * factor) * kappa.diameter[facets.cells]


def _prepared(solution: Solution, v: fem.Function) -> Callable[[], Proven | None]:
    """The proof of a scalar problem, to be run on rank 0 (collective).

    Raises:
        InputError: If there is no theorem for the problem.
    """
    if isinstance(solution, RT1Solution):
        raise InputError("the proof is for RT0 alone")
    if solution.data.laws.listed:
        raise InputError("the proof is for the law of Signorini alone")
    if solution.data.c_h is not None:
        raise InputError("the proof is for c = 0 alone")
    if solution.data.inside:
        raise InputError("the proof is for problems without an obstacle and other laws in Ω")
    given = Given.of(solution.data.trees, FromArb())
    discrete = gathered(solution, v)
    return lambda: None if discrete is None else prove(discrete, given)


PROOFS = Proofs(500_000, _prepared)
