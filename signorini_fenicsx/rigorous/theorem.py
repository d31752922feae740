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
- *Trace.* See `trace`: v = u_D on Γ_D and v ≥ ψ on Γ_S, up to a function whose gradient is bounded.
- *κ.* Let L be a matrix of floats with LᵀκL ≥ θ > 0 on T. Then ‖κ^-½q‖_T ≤ θ^-½‖Lᵀq‖_T, and κ∇v − y = (κ̃∇v − y) +
  (κ − κ̃)∇v with κ̃ the linear interpolant. In the coordinates Lᵀx the cell is convex with a diameter ĥ, and |L⁻¹∇w|² ≤
  κ∇w·∇w/θ. So Poincaré's constant for energy norms is ĥ/(π√θ), and the trace constant C_e of `local_fields` has ĥ/√θ
  in place of δ_T.
- *Data.* Enclosures over parts of cells and facets give means, and ‖e − p‖ and sup |e − p| with p linear or quadratic.
"""

from collections.abc import Callable

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.certificate.proof import Proofs, Proven
from signorini_fenicsx.expressions.intervals import PI, Interval, enclosing
from signorini_fenicsx.physics.diffusion.linear_solution import LinearSolution
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.rigorous.balance import balanced
from signorini_fenicsx.rigorous.data import Given, deviation
from signorini_fenicsx.rigorous.discrete import (
    DIRICHLET,
    INSIDE,
    NEUMANN,
    SIGNORINI,
    Discrete,
    Facets,
    boundary,
    gathered,
)
from signorini_fenicsx.rigorous.elementary import FromArb
from signorini_fenicsx.rigorous.simplices import (
    Simplices,
    bernstein,
    flux_in_vertices,
    gradient_in_vertices,
    mean,
    root,
    root_above,
    simplices,
    square_norm,
    squared,
    total_above,
    with_midpoints,
)
from signorini_fenicsx.rigorous.tensor import Tensor
from signorini_fenicsx.rigorous.trace import admissible

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

    if not np.isfinite(total_above(np.concatenate([mismatch.hi, contact.hi, oscillation.hi])) + left):
        raise InputError("the data have no certain finite bounds, or not finite gradients, near Γ_D or Γ_S")
    twice_the_gap = total_above(np.concatenate([squared(mismatch).hi, contact.hi]))
    square = total_above(squared(oscillation).hi)
    return Proven(
        bound=total_above(np.array([root_above(twice_the_gap), root_above(square), left])),
        sigma_bound=total_above(np.array([root_above(total_above(np.array([twice_the_gap, square]))), left])),
        gap=twice_the_gap / 2,
        oscillation=root_above(square),
        remainder=left,
    )


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


def _trace_constant(cells: Simplices, kappa: Tensor, facets: Facets) -> Interval:
    """The constant C_e of `physics/diffusion/bound/local_fields`, with ĥ in place of δ_T."""
    factor = 1.0 / (PI * PI) + 2.0 / (PI * float(cells.dim))
    return root(facets.measure / cells.measure[facets.cells] * factor) * kappa.diameter[facets.cells]


def _prepared(solution: Solution, v: fem.Function) -> Callable[[], Proven | None]:
    """The proof of a scalar problem, to be run on rank 0 (collective).

    Raises:
        InputError: If there is no theorem for the problem.
    """
    if isinstance(solution, LinearSolution):
        raise InputError("the proof is for RT0 alone")
    if solution.data.laws.listed:
        raise InputError("the proof is for the law of Signorini alone")
    if solution.data.c_h is not None:
        raise InputError("the proof is for c = 0 alone")
    if solution.data.inside is not None:
        raise InputError("the proof is for problems without an obstacle and other laws in Ω")
    given = Given.of(solution.data.trees, FromArb())
    discrete = gathered(solution, v)
    return lambda: None if discrete is None else prove(discrete, given)


PROOFS = Proofs(500_000, _prepared)
