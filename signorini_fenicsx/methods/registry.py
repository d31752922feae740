"""The active/inactive-set algorithms: each is a start and a rule, a pure function of the facet values p and σ·n.

| algorithm | formulation | rule, per facet of Γ_S                                    | start          |
|-----------|-------------|-----------------------------------------------------------|----------------|
| alg1      | (MLM-I)_h   | σ·n = 0 where σ·n − ρp < 0, else p = 0                    | σ·n = 0, p := 0|
| alg2      | (MLM-II)_h  | p = 0 where p − ρσ·n < 0, else σ·n = 0                    | as alg1        |
| alg3      | (MPε-I)_h   | σ·n = 0 where p > 0, else p = −εσ·n; then σ·n clipped ≥ 0 | σ·n = 0        |
| alg4      | (MPε-II)_h  | p = 0 where σ·n > 0, else σ·n = −εp                       | p = 0          |
| snes1     | (MPε-I)_h   | none: PETSc SNES solves (25)                              | 0              |
| snes2     | (MPε-II)_h  | none: PETSc SNES solves (26)                              | 0              |
| vi        | (MLM-I)_h   | none: PETSc SNESVI minimises over p ≥ 0                   | 0              |

The classical methods have no rule either, see `signorini_fenicsx.methods.classical`; slimane has that of alg1.

After one step of alg1 and alg2 one of p and σ·n is 0 on each facet, so only signs matter and ρ changes no iterate.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.discrete.conditions import Condition, FacetConditions

type Array = npt.NDArray[np.float64]
type Rule = Callable[[Array, Array, float], npt.NDArray[np.int8]]


class By(Enum):
    """What runs an algorithm: the active-set loop, SNES on the block system, SNESVI on the facet system, or its own."""

    SETS = "sets"
    SNES = "snes"
    SNESVI = "snesvi"
    CLASSICAL = "classical"


class Penalty(Enum):
    """The two penalty laws on Γ_S.

    Either is the Signorini condition itself with a shifted quantity, which `shift` adds:
    TRACE, σ·n = [p]_-/ε, says p + εσ·n ≥ 0, σ·n ≥ 0, one of them 0;
    FLUX, p = [σ·n]_-/ε, says p ≥ 0, σ·n + εp ≥ 0, one of them 0.
    """

    TRACE = "I"
    FLUX = "II"

    def beta(self, eps: float) -> float:
        """β of σ·n + βp = 0 where the penalty acts."""
        return 1 / eps if self is Penalty.TRACE else eps

    def shift(self, p: Array, flux: Array, eps: float) -> tuple[Array, Array]:
        """The pair (p, σ·n), shifted so that a penalty solution satisfies the Signorini condition."""
        return (p + eps * flux, flux) if self is Penalty.TRACE else (p, flux + eps * p)


@dataclass(frozen=True)
class Algorithm:
    """An active/inactive-set algorithm, or a formulation that PETSc's nonlinear solvers take.

    Attributes:
        title: What it solves and where it is defined.
        reference: Where it comes from.
        start: Condition of all Γ_S facets in the start solve (Step 1).
        rule: From p, σ·n and ρ per facet to the next conditions (Step 2).
        contact: Condition of the facets in contact.
        forgets_start: Whether Step 1 sets p and σ·n to 0 after its solve.
        penalty: Its penalty law, if it has one.
        clips: Whether Step 3 clips σ·n to ≥ 0 (36).
        by: What solves it; without the loop the rule is not used.
        stabilised: Whether ε adds −ε(u, v) to the mass balance.
        max_iterations: Iterations allowed unless the case says else.
    """

    title: str
    reference: str
    start: Condition
    rule: Rule
    contact: Condition = Condition.ZERO_TRACE
    forgets_start: bool = False
    penalty: Penalty | None = None
    clips: bool = False
    by: By = By.SETS
    stabilised: bool = False
    max_iterations: int = 50

    @property
    def has_eps(self) -> bool:
        """Whether its solution depends on ε."""
        return self.penalty is not None or self.stabilised

    def cold_start(self, facets: int, eps: float) -> FacetConditions:
        """Conditions of the start solve on this rank's Γ_S facets (Step 1)."""
        return FacetConditions(np.full(facets, self.start, dtype=np.int8), self._beta(eps))

    def next_conditions(self, p: Array, flux: Array, rho: float, eps: float) -> FacetConditions:
        """What the rule makes of p and σ·n on this rank's Γ_S facets (Step 2)."""
        return FacetConditions(self.rule(p, flux, rho), self._beta(eps))

    def _beta(self, eps: float) -> float:
        return 1.0 if self.penalty is None else self.penalty.beta(eps)


def mlm1_rule(p: Array, flux: Array, rho: float) -> npt.NDArray[np.int8]:
    """Algorithm 1, Step 2: the active set, where σ·n − ρp < 0, gets σ·n = 0 (11a)."""
    return np.where(flux - rho * p < 0, Condition.NO_FLUX, Condition.ZERO_TRACE).astype(np.int8)


def mlm2_rule(p: Array, flux: Array, rho: float) -> npt.NDArray[np.int8]:
    """Algorithm 2, Step 2: the active set, where p − ρσ·n < 0, gets p = 0; the rest gets σ·n = 0 (13a)."""
    return np.where(p - rho * flux < 0, Condition.ZERO_TRACE, Condition.NO_FLUX).astype(np.int8)


def trace_penalty_rule(p: Array, flux: Array, rho: float) -> npt.NDArray[np.int8]:
    """Algorithm 3, Step 2: the active set, where p > 0, gets σ·n = 0 (35a); the rest σ·n + p/ε = 0 (35b)."""
    return np.where(p > 0, Condition.NO_FLUX, Condition.ROBIN).astype(np.int8)


def flux_penalty_rule(p: Array, flux: Array, rho: float) -> npt.NDArray[np.int8]:
    """Algorithm 4, Step 2: the active set, where σ·n > 0, gets p = 0; the rest σ·n + εp = 0."""
    return np.where(flux > 0, Condition.ZERO_TRACE, Condition.ROBIN).astype(np.int8)


LAGRANGE = "Wang, Hu, Zhou: J. Comput. Appl. Math. (2024)"
PENALTY = "Hu, Wang, Zhou: The mixed penalty method for the Signorini problem (2024)"
GLOWINSKI = "Glowinski: Numerical Methods for Nonlinear Variational Problems (1984)"
MANY = 100_000
"""Iterations allowed to methods whose iterations are cheap."""


def _classical(title: str, reference: str, **options: Any) -> Algorithm:
    return Algorithm(title, reference, Condition.NO_FLUX, mlm1_rule, by=By.CLASSICAL, **options)


ALGORITHMS: Mapping[str, Algorithm] = {
    "alg1": Algorithm("Algorithm 1 for (MLM-I)_h", LAGRANGE, Condition.NO_FLUX, mlm1_rule, forgets_start=True),
    "alg2": Algorithm("Algorithm 2 for (MLM-II)_h", LAGRANGE, Condition.NO_FLUX, mlm2_rule, forgets_start=True),
    "alg3": Algorithm(
        "Algorithm 3 for (MPε-I)_h",
        PENALTY,
        Condition.NO_FLUX,
        trace_penalty_rule,
        Condition.ROBIN,
        penalty=Penalty.TRACE,
        clips=True,
    ),
    "alg4": Algorithm(
        "Algorithm 4 for (MPε-II)_h", PENALTY, Condition.ZERO_TRACE, flux_penalty_rule, penalty=Penalty.FLUX
    ),
    "snes1": Algorithm(
        "PETSc SNES for (MPε-I)_h",
        PENALTY,
        Condition.NO_FLUX,
        trace_penalty_rule,
        Condition.ROBIN,
        penalty=Penalty.TRACE,
        by=By.SNES,
    ),
    "snes2": Algorithm(
        "PETSc SNES for (MPε-II)_h", PENALTY, Condition.ZERO_TRACE, flux_penalty_rule, penalty=Penalty.FLUX, by=By.SNES
    ),
    "vi": Algorithm(
        "PETSc SNESVI for (MLM-I)_h",
        "Benson, Munson: Optim. Methods Softw. (2006)",
        Condition.NO_FLUX,
        mlm1_rule,
        by=By.SNESVI,
    ),
    "uzawa": _classical("Uzawa iteration for (VL), conforming P1", GLOWINSKI, max_iterations=MANY),
    "psor": _classical("projected over-relaxation for (VI), conforming P1", GLOWINSKI, max_iterations=MANY),
    "primal-pdas": _classical(
        "primal-dual active set for (VI), conforming P1", "Ito, Kunisch: Lagrange Multiplier Approach (2008)"
    ),
    "primal-penalty": _classical(
        "penalty (P_ε) by semismooth Newton, conforming P1",
        "[Haslinger 04] of the slides",
        contact=Condition.ROBIN,
        penalty=Penalty.TRACE,
    ),
    "mixed-uzawa1": _classical("Uzawa iteration in σ·n, L² projection, for (MLM-I)_h", LAGRANGE, max_iterations=MANY),
    "mixed-uzawa2": _classical("Uzawa iteration in p, L² projection, for (MLM-II)_h", LAGRANGE, max_iterations=MANY),
    "mixed-uzawa-h12": _classical(
        "Uzawa iteration in p, H^{1/2} projection, for (MLM-II)_h",
        "Gatica, Maischak, Stephan: ESAIM M2AN (2011)",
        max_iterations=MANY,
    ),
    "mixed-uzawa-wang": _classical(
        "Uzawa iteration in u, a constrained minimisation each, for (MVI)_h",
        "[Wang 09] of the slides",
        max_iterations=MANY,
    ),
    "slimane": _classical(
        "stabilised unilateral mixed form, ∇·σ + f = εu",
        "Slimane, Bendali, Laborde: ESAIM M2AN (2004)",
        stabilised=True,
    ),
    "qp": _classical(
        "(MVI)_h as a quadratic programme, interior point (PIQP)", "Theorem 2 of the slides", max_iterations=250
    ),
}
