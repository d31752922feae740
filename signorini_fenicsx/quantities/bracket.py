"""An interval for a quantity of the exact solution, from two problems that the program solves.

*Theorem.* Let u with σ = κ∇u solve a problem with monotone laws: t ∈ ∂φ(u) at each site, a point of Γ_S or of Ω, with t
= −σ·n on Γ_S and t = f + ∇·σ in Ω. Let Q(w) = ∫qw and τ > 0. Let v be admissible for this problem, and y' for that with
the load f + τq, η' its value at the sites. Then

    τ(Q(u) − Q(v)) ≤ ¼‖κ∇v − y'‖² + ∫ sup (t − η')(v − u) over all (u, t) in the graph.

*Proof.* Both fluxes balance their loads: τQ(u − v) = (y' − σ, ∇(u − v)) + ∫ (t − η')(v − u). The second term is at most
the integral of the sup. The first one is (σ − y', ∇v − κ⁻¹σ), a quadratic in σ, largest at σ = ½(κ∇v + y').

With a load R that y' does not balance, R(w) ≤ Σ osc_T|∇w|_T + m|∇w|, ¼ ((Σ (‖κ∇v − y'‖_T + osc_T)²)^½ + m)² takes the
place of the first term, for the same reason. Q(v) is enclosed, see `products`.

The right side is small for v near u(−τ) and y' near σ(+τ), the solutions with the loads f − τq and f + τq: without laws
v = u − τz and y' = σ + τζ with the dual solution, and what is left is a product of two errors. So an upper bound of
Q(u) takes the v of one of these solutions and the y' of the other one, and a lower bound the other two. Both hold for
any τ; a few are tried.

Without laws τ times their distance is ¼ Σ ‖κ∇v₋ − y₋‖² + ‖κ∇v₊ − y₊‖², the two gaps, because 2τQ(v₊ − v₋) is
(y₊ − y₋, ∇(v₊ − v₋)). So these say where cells have to be refined; the cells of the right sides above do not, as they
have τ²|∇z|² in them.

*A flux* F = ⟨σ·n, 1⟩ through parts of Γ_D and Γ_S is the same with other data: here v obeys u = u_D − τ, or laws moved
by −τ in u, on these parts, and y' is admissible for the problem itself. Then

    τ(F(y') − F(σ)) ≤ ¼‖κ∇v − y'‖² + ∫ sup (t − η')(v + τ − u),

because (σ − y', ∇(v − u)) is ⟨(σ − y')·n, v + τ − u⟩ − τ(F(σ) − F(y')). Where such a part meets another one
with a given u, v would have to jump by τ, and there is no bound: the flux is unbounded on the energy space.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

from signorini_fenicsx.base.arrays import Array

MOST = 24
"""Largest number of τ that are tried: the best one falls like h^{4/3}, far below the first one on fine meshes."""
SMALLER, AGAIN = 16.0, 3
"""If the problems beside that of a solution have none, τ is made smaller by this factor, so often at most."""
ENOUGH = 0.98
"""A factor of 2 in τ that leaves more than this share of the interval gains nothing."""
NEAR, AHEAD = 1.5, 2
"""In each direction the search ends with an interval that is so many times as long as the best, or after so many that
gain nothing: where sets of contact change between two τ, one of them may be longer than its neighbours."""
LINEAR, FASTEST = 0.002, {0.5: 1 / 16, 2.0: 16.0}
"""While the length changes as τ or 1/τ does, by slopes that differ by this share at most, the best τ is more than 14
times as far, and a step may be this factor; the search ends where the slope leaves too little to gain. So it is where u
is known but for rounding, or where a part of the length is that of loads that are enclosed."""
KNOWN = 1e-8
"""The search also ends with an interval that is at most this share of its ends: then they are known but for rounding,
and each smaller τ would make it shorter."""
FARTHER = 3.0
"""An interval that is so many times as long as that of a problem nearby has another τ."""
PASSES = "passes where the pressure is negative, in soil that is taken for saturated"
"""What is said of that share."""
QUANTITY, VALUE = "quantities.", ".value"
"""What the keys of a quantity in tables begin with, before its name, and that of its value ends with."""
EXCLUDED = "the bounds exclude each other"
"""What is said where the lower bound is above the upper one, before why the bounds are not guaranteed."""
WEIGHT = "the integral of its weight is not known"
"""What is said of a mean where it may be 0."""
UNBOUNDED = "this flux is unbounded on the energy space"
"""What is said of a flux through parts that end where u is given, or held, on other parts."""


@dataclass(frozen=True)
class Quantity:
    """A quantity of the exact solution.

    Attributes:
        value: That of the discrete solution, which may be outside of the interval.
        lower: Lower bound.
        upper: Upper bound.
        proved: Whether both are proved, for the solution `of`: all data are enclosed and resolved.
        reason: Why they are not; empty if they are.
        of: Of which solution it is a quantity, in words; empty if it is that of the problem itself.
        above_table: Of a discharge of groundwater the share that passes where the pressure is negative, else None.
        tau: The τ with the shortest interval, divided by ‖σ_h‖; 0 where there is none.
        shares: What each owned cell adds to the length of the interval; None where there is none.
        symbol: What stands for it in words, such as Q; may be empty.
        unit: Its unit in words; may be empty.
    """

    value: float
    lower: float
    upper: float
    proved: bool
    reason: str = ""
    of: str = ""
    above_table: float | None = None
    tau: float = 0.0
    shares: Array | None = field(default=None, compare=False, repr=False)
    symbol: str = ""
    unit: str = ""

    @classmethod
    def in_row(cls, name: str, row: Mapping[str, Any]) -> Self | None:
        """What a row of a table has of a quantity for the next one; None without it."""
        keys = [f"{QUANTITY}{name}.{key}" for key in ("value", "lower", "upper", "tau")]
        if any(key not in row for key in keys):
            return None
        value, lower, upper, tau = (float(row[key]) for key in keys)
        return cls(value, lower, upper, False, tau=tau)

    @property
    def guaranteed(self) -> bool:
        """Whether both are proved for the solution of the problem itself."""
        return self.proved and not self.of

    @property
    def width(self) -> float:
        """The length of the interval."""
        return self.upper - self.lower

    @property
    def middle(self) -> float:
        """The middle of the interval."""
        return (self.lower + self.upper) / 2

    def divided(self, total: float, radius: float) -> "Quantity":
        """The mean, whose value it has: by the interval of an integral and that of its weight, within a radius."""
        if not abs(total) > radius:
            return replace(self, lower=-math.inf, upper=math.inf, proved=False, reason=self.reason or WEIGHT)
        ends = [end / (total + sign * radius) for end in (self.lower, self.upper) for sign in (-1.0, 1.0)]
        return replace(self, lower=min(ends), upper=max(ends))

    def columns(self, name: str) -> dict[str, float | bool | str]:
        """All of it for a row of a table."""
        found = replace(self, symbol="", unit="").summary() | {"tau": self.tau}
        return {f"{QUANTITY}{name}.{key}": value for key, value in found.items()}

    def summary(self) -> dict[str, float | bool | str]:
        """The quantity ready for JSON; an interval of another problem is guaranteed only with the name of that one."""
        names = ("value", "lower", "upper", "guaranteed", "reason", "above_table")
        entries = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        entries |= {name: getattr(self, name) for name in ("symbol", "unit") if getattr(self, name)}
        return entries | ({"guaranteed_for": self.of} if self.proved and self.of else {})


NOT_FOUND = Quantity(math.nan, -math.inf, math.inf, False, "it could not be found")
"""What there is of a quantity whose computation fails, beside the reason that the run tells."""


@dataclass(frozen=True)
class Half:
    """A quarter of the squares, and the sups at the sites, for the v and the y' of two solutions.

    Attributes:
        value: Their sum.
        reason: Why it is not guaranteed; empty if it is.
        of_cells: What each owned cell adds.
        unseen: What is added to the bound, whatever τ is.
    """

    value: float
    reason: str
    of_cells: Array
    unseen: float = 0.0


@dataclass(frozen=True)
class Ends:
    """Bounds of a quantity from one τ.

    Attributes:
        lower: Lower bound; −∞ for none.
        upper: Upper bound; ∞ for none.
        scale: ‖σ_h‖ divided by the size of what changes it, a τ that may well be the best.
        reason: Why they are not guaranteed, or infinite; empty for neither.
        shares: Gives what each owned cell adds to their distance (collective).
    """

    lower: float
    upper: float
    scale: float
    reason: str
    shares: Callable[[], Array] | None = None

    @property
    def width(self) -> float:
        """The distance of the ends of the interval."""
        return self.upper - self.lower

    @property
    def known(self) -> bool:
        """Whether no other τ needs to be tried."""
        return self.width <= KNOWN * max(abs(self.lower), abs(self.upper))


def power_of_two(number: float) -> float:
    """The power of two that is nearest to a positive number."""
    return float(2.0 ** round(math.log2(number)))


def bracket(
    ends: Callable[[float], Ends], first: float, value: float, *, before: float = 0.0, alone: bool = False
) -> Quantity:
    """The interval from several τ: that which the first one suggests, and others by factors of 2 (collective).

    Args:
        ends: Bounds from one τ.
        first: The first τ, of the right size but for a factor.
        value: That of the discrete solution.
        before: Length of the interval of a problem nearby, whose best τ is the first one: others start from it unless
            the interval is now much longer.
        alone: Whether then no other is tried.

    Returns:
        The interval; its `tau` is the best τ itself.
    """
    tried: dict[float, Ends] = {}

    def width(tau: float) -> float:
        if tau not in tried:
            tried[tau] = ends(tau)
            least = min(each.width for each in tried.values())
            for other, each in tried.items():  # of those that are not the best nothing else is kept
                tried[other] = each if each.width == least else replace(each, shares=None)
        return tried[tau].width

    while not math.isfinite(width(first)) and tried[first].scale == 0 and len(tried) < AGAIN:
        first /= SMALLER
    near = width(first) <= FARTHER * before < math.inf
    scale = 0.0 if near else tried[first].scale
    tau = power_of_two(scale) if 0 < scale < math.inf else first
    while not math.isfinite(width(tau)) and tau > 2 * first and math.isfinite(width(first)) and len(tried) < MOST:
        tau = power_of_two(math.sqrt(tau * first))  # too far from the problem itself for its solver
    if not width(tau) <= width(first):  # such as one with which u_D is beyond a bound
        tau = first
    ended = not math.isfinite(width(tau)) or (near and alone)
    for factor in (0.5, 2.0, 0.5):  # the last time where the steps were long
        step, longest, ahead, misses, slope = factor, FASTEST[factor], tau * factor, 0, math.inf
        while not ended and not tried[tau].known and misses < AHEAD and len(tried) < MOST:
            gain = width(ahead) / width(tau)
            if gain < ENOUGH:
                x, further = (t if factor < 1 else 1 / t for t in (tau, ahead))
                before, slope = slope, (width(tau) - width(ahead)) / (x - further)
                tau, misses, linear = ahead, 0, abs(slope / before - 1) < LINEAR
                ended = linear and slope * further < (1 - ENOUGH) * width(tau)
                step = longest if linear else factor
            elif step != factor:  # it was too long
                step, longest, ahead = factor, factor, tau
            elif gain < NEAR:
                misses += 1
            else:
                break
            ahead *= step
    best = max(tried.values(), key=lambda each: each.lower), min(tried.values(), key=lambda each: each.upper)
    lower, upper = best[0].lower, best[1].upper
    reason = best[0].reason or best[1].reason
    if lower > upper:
        reason, lower, upper = ": ".join(filter(None, [EXCLUDED, reason])), upper, lower
    finite = math.isfinite(upper - lower)
    shares = min(tried.values(), key=lambda each: each.width).shares if finite and not (near and alone) else None
    proved, of_cells = finite and not reason, shares() if shares else None
    return Quantity(value, lower, upper, proved, reason, tau=tau if finite else 0.0, shares=of_cells)
