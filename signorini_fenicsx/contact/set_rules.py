"""The four algorithms of the slides, each complete: a start, a rule from (p, σ·n) to the next conditions, and a clip.

A backend solves their linear problems under given conditions (NO_FLUX: σ·n = 0, ZERO_TRACE: p = 0, ROBIN: σ·n + βp =
0), and `loop.iterate_sets` repeats rule and solve. p and σ·n stand for p − ψ and σ·n − q_S on each site of Γ_S. Step
numbers are those of the slides. Only Algorithm 3 has a clip.

After one step of Algorithms 1 and 2, p or σ·n is 0 on each site, so only signs matter and ρ does not change the
iterates.

*Other laws.* The Signorini law has one corner, at ψ and q_S, and a rule says on which side of it a site continues. A
law with several corners is a chain of segments (see `contact/chains.py`). The same rule is asked at each corner, with
p and σ·n measured from there, and a site moves towards the segment behind all corners that it has passed, by one
segment in a step. Then as before only signs matter: with longer moves the sets would often cycle, and ρ would matter.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.chains import Chains, Condition, Kinds, Penalty


@dataclass(frozen=True)
class SetRule:
    """An active/inactive-set algorithm.

    Attributes:
        start: Condition on all sites in the start solve (Step 1). For other laws: if it is that of the sites in
            contact, the segment of the reference, otherwise the one behind it.
        rule: Maps p, σ·n and ρ to a `Condition` per site (Step 2).
        contact: Condition on the sites in contact.
        forgets_start: Whether Step 1 sets p and σ·n to 0 after its solve.
        penalty: Its penalty law, which gives β on ROBIN sites; None for the multiplier formulations.
        clip: Maps conditions and σ·n to the sites where σ·n is set to 0 after the solve (Step 3); None for no clip.
    """

    start: Condition
    rule: Callable[[Array, Array, float], Kinds]
    contact: Condition = Condition.ZERO_TRACE
    forgets_start: bool = False
    penalty: Penalty | None = None
    clip: Callable[[Kinds, Array], Mask] | None = None

    def law(self, chains: Chains, eps: float) -> Chains:
        """The law that the sites get in the end: with a penalty, that of the penalty."""
        return chains.with_penalty(self.penalty, eps)

    def first(self, law: Chains) -> Indices:
        """The segment of each site in the start solve (Step 1)."""
        return law.beside_reference(steep=self.start == self.contact)

    def following(self, law: Chains, p: Array, flux: Array, rho: float, present: "Present | None" = None) -> Indices:
        """The next segment of each site by the rule, from p and σ·n per site (Step 2).

        Raises:
            InputError: If the rule of a user gives something else than a condition for each site.
        """
        segment = np.zeros(len(p), dtype=np.int64)
        for corner in range(law.corners):
            trace, excess = p - law.p[:, corner], flux - law.flux[:, corner]
            if present is None:
                segment += self._leaves(trace, excess, rho)
                continue
            tied = (np.abs(trace) <= present.trace) & (np.abs(excess) <= present.flux)
            passed = self._leaves(np.where(tied, 0.0, trace), np.where(tied, 0.0, excess), rho)
            segment += passed if present.segment is None else np.where(tied, present.segment > corner, passed)
        if present is None or present.segment is None:
            return segment
        return law.towards(present.segment, segment)

    def _leaves(self, p: Array, flux: Array, rho: float) -> Mask:
        """The sites that are not in contact by the rule."""
        return (
            per_site("rule", self.rule(p, flux, rho), p, "iu", "whole numbers, the Condition of each") != self.contact
        )

    def clipped(self, kind: Kinds, flux: Array) -> Mask:
        """The sites where σ·n is set to 0 (Step 3), by a rule with a clip.

        Raises:
            InputError: If the clip of a user gives something else.
        """
        assert self.clip is not None
        return per_site("clip", self.clip(kind, flux), flux, "b", "truth values, whether σ·n is set to 0")


@dataclass(frozen=True)
class Present:
    """What the rule has to know of the present iterate besides p and σ·n.

    Attributes:
        segment: The segment of each site; a site where p and σ·n are rounding beside a corner stays on its side of it.
            None after the algorithm's own start, which is no decision: then a tie counts as p = σ·n = 0.
        trace: What is rounding in p, per site or for all.
        flux: What is rounding in σ·n, per site or for all.
    """

    segment: Indices | None
    trace: Array | float = 0.0
    flux: Array | float = 0.0


def per_site(name: str, given: object, sites: Array, kinds: str, right: str) -> Any:
    """What a function of a user gives for sites.

    Raises:
        InputError: If it is no array of one of these kinds of NumPy with a row for each site.
    """
    if isinstance(given, np.ndarray) and given.shape == sites.shape and given.dtype.kind in kinds:
        return given
    what = f"{given.dtype} of shape {given.shape}" if isinstance(given, np.ndarray) else type(given).__name__
    raise InputError(f"{name}: must return an array of {right}, shape {sites.shape}; it returns {what}")


def _either(where: Mask, kind: Condition, other: Condition) -> Kinds:
    return np.where(where, kind, other).astype(np.int8)


# Algorithm 1, for the multiplier formulation (MLM-I)_h, (9).
#   Step 1     Solve with σ·n = 0 on Γ_S, then set p = 0.
#   Step 2     Γ¹: the sites with σ·n − ρp < 0.
#   Step 3, 4  Solve with σ·n = 0 on Γ¹ and p = 0 elsewhere (11); p on Γ¹ by (12).
#   Step 5     Repeat from Step 2 until the sets repeat.


def rule_1(p: Array, flux: Array, rho: float) -> Kinds:
    """Step 2: a site is active, that is NO_FLUX, if σ·n − ρp < 0; ties are in contact."""
    return _either(flux - rho * p < 0, Condition.NO_FLUX, Condition.ZERO_TRACE)


ALGORITHM_1 = SetRule(start=Condition.NO_FLUX, forgets_start=True, rule=rule_1)


# Algorithm 2, for the multiplier formulation (MLM-II)_h, (10).
#   Step 1     As in Algorithm 1.
#   Step 2     Γ¹: the sites with p − ρσ·n < 0.
#   Step 3, 4  Solve with p = 0 on Γ¹ and σ·n = 0 elsewhere (13); p there by (14).
#   Step 5     Repeat from Step 2 until the sets repeat.


def rule_2(p: Array, flux: Array, rho: float) -> Kinds:
    """Step 2: a site is active, that is ZERO_TRACE, if p − ρσ·n < 0; ties are open."""
    return _either(p - rho * flux < 0, Condition.ZERO_TRACE, Condition.NO_FLUX)


ALGORITHM_2 = SetRule(start=Condition.NO_FLUX, forgets_start=True, rule=rule_2)


# Algorithm 3, for the penalty formulation (MPε-I)_h, (25): σ·n = [p]_-/ε.
#   Step 1  Solve with σ·n = 0 on Γ_S (33), with its p (34).
#   Step 2  Γ¹: the sites with p > 0. Solve with σ·n = 0 on Γ¹ (35a) and p = −εσ·n elsewhere (35b).
#   Step 3  Set σ·n to 0 where it is negative outside of Γ¹ (36); p moves with it (37).
#   Step 4  Repeat from Step 2 until the sets repeat.


def rule_3(p: Array, flux: Array, rho: float) -> Kinds:
    """Step 2: a site is active, that is NO_FLUX, if p > 0; ties are penalised."""
    return _either(p > 0, Condition.NO_FLUX, Condition.ROBIN)


def clip_3(kind: Kinds, flux: Array) -> Mask:
    """Step 3: the sites outside the active set where σ·n is negative (36)."""
    return (kind == Condition.ROBIN) & (flux < 0)


ALGORITHM_3 = SetRule(start=Condition.NO_FLUX, rule=rule_3, contact=Condition.ROBIN, penalty=Penalty.TRACE, clip=clip_3)


# Algorithm 4, for the penalty formulation (MPε-II)_h, (26): p = [σ·n]_-/ε.
#   Step 1  Solve with p = 0 on Γ_S (38).
#   Step 2  Γ¹: the sites with σ·n > 0. Solve with p = 0 on Γ¹ and σ·n = −εp elsewhere.
#   Step 3  Repeat from Step 2 until the sets repeat.


def rule_4(p: Array, flux: Array, rho: float) -> Kinds:
    """Step 2: a site is active, that is ZERO_TRACE, if σ·n > 0; ties are penalised."""
    return _either(flux > 0, Condition.ZERO_TRACE, Condition.ROBIN)


ALGORITHM_4 = SetRule(start=Condition.ZERO_TRACE, rule=rule_4, penalty=Penalty.FLUX)
