"""The methods by name: what each solves, its source, and how it runs.

An entry here gives a new method a name. It can also run without one: `solve` takes a `Method` as well as a name.

| method                    | in                                   | formulation                                  |
|---------------------------|--------------------------------------|----------------------------------------------|
| alg1 … alg4               | `contact/set_rules.py`               | (MLM-I)_h, (MLM-II)_h, (MPε-I)_h, (MPε-II)_h |
| snes1, snes2              | `physics/diffusion/solve/newton.py`  | (MPε-I)_h, (MPε-II)_h                        |
| vi                        | `physics/diffusion/solve/newton.py`  | (MLM-I)_h, p ≥ 0 as a bound                  |
| the ten classical methods | `physics/diffusion/solve/classical/` | see there                                    |

Set rules, as those of alg1 to alg4, are run by `by_sets.py`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

from signorini_fenicsx.contact.chains import Condition, Penalty
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.contact.laws import Signorini, TwoSided
from signorini_fenicsx.contact.set_rules import ALGORITHM_1, ALGORITHM_2, ALGORITHM_3, ALGORITHM_4, SetRule
from signorini_fenicsx.methods.by_sets import solve_by_sets
from signorini_fenicsx.methods.task import Task

MANY = 100_000
"""Iterations allowed for methods with cheap iterations."""
UZAWA: Mapping[str, Any] = {"has_rho": True, "max_iterations": MANY}
IN_CELLS = 20
"""Factor of the iterations allowed where cells are sites."""


@dataclass(frozen=True)
class Method:
    """A way to solve a discrete Signorini problem.

    Attributes:
        title: What it solves and where it is defined.
        reference: Its source in the literature.
        run: Solves a task of diffusion (collective).
        contact: Condition on the facets in contact.
        penalty: Its penalty law, or None; with one the KKT residuals are those of the penalty formulation.
        stabilised: Whether ε adds −ε(u, v) to the mass balance.
        starts_from_sets: Whether it can start from a contact set.
        needs_dirichlet: Whether it needs a Γ_D, a part of the boundary where u = u_D.
        laws: The laws that it takes in [[law]]; None for all.
        takes_inner: Whether it takes parts of Γ_S inside the domain.
        laws_inside: Whether it takes laws in Ω, as an obstacle is one.
        max_iterations: Iterations allowed unless the options say otherwise.
        on_one_rank: Whether it collects the whole mesh on one rank, see `Tuning.on_one_rank_up_to`.
        dense: Whether it needs dense matrices on Γ_S, see `Tuning.dense_up_to`.
        has_rho: Whether it has a ρ.
        takes_order_two: Whether it takes the element of order two of diffusion.
        rule: The set rule that `run` runs with a backend, and that elastic contact takes; None if it runs something
            else.
    """

    title: str
    reference: str
    run: Callable[[Task], Outcome]
    contact: Condition = Condition.ZERO_TRACE
    penalty: Penalty | None = None
    stabilised: bool = False
    starts_from_sets: bool = False
    needs_dirichlet: bool = False
    laws: tuple[type[Law], ...] | None = (Signorini,)
    takes_inner: bool = False
    laws_inside: bool = False
    max_iterations: int = 50
    on_one_rank: bool = False
    dense: bool = False
    has_rho: bool = False
    takes_order_two: bool = False
    rule: SetRule | None = None

    @classmethod
    def of_rule(cls, title: str, reference: str, rule: SetRule) -> Self:
        """The method that runs a set rule."""
        run = partial(solve_by_sets, rule)
        exact = rule.penalty is None
        laws = None if exact else (Signorini,)
        return cls(
            title,
            reference,
            run,
            rule.contact,
            rule.penalty,
            has_rho=True,
            rule=rule,
            starts_from_sets=True,
            laws=laws,
            takes_inner=exact,
            laws_inside=exact,
            takes_order_two=True,
        )

    def most_iterations(self, corners: int, sites: int, *, in_cells: bool = False) -> int:
        """Iterations allowed unless the options say otherwise, for laws with so many corners on so many sites.

        A site moves by one segment of its law in a step. Where cells are sites a cold start takes about 1/h steps. The
        edge of a set may move by one site in a step, so set rules may take as many as there are sites.
        """
        usual = (self.max_iterations + corners - 1) * (IN_CELLS if in_cells else 1)
        return usual if self.rule is None else max(usual, corners * sites)

    @property
    def has_eps(self) -> bool:
        """Whether its solution depends on ε."""
        return self.penalty is not None or self.stabilised


LAGRANGE = "Wang, Hu, Zhou: J. Comput. Appl. Math. (2024)"
PENALTY = "Hu, Wang, Zhou: ESAIM M2AN (2024)"
GLOWINSKI = "Glowinski: Numerical Methods for Nonlinear Variational Problems (1984)"


def _alone(name: str, *first: object) -> Callable[[Any], Outcome]:
    """A method for diffusion alone, called with these arguments and the task."""
    return lambda task: task.alone(name)(*first, task)


def _classical(title: str, reference: str, name: str, **options: Any) -> Method:
    """A classical method."""
    return Method(title, reference, _alone(name), needs_dirichlet=True, **options)


METHODS: Mapping[str, Method] = {
    "alg1": Method.of_rule("Algorithm 1 for (MLM-I)_h", LAGRANGE, ALGORITHM_1),
    "alg2": Method.of_rule("Algorithm 2 for (MLM-II)_h", LAGRANGE, ALGORITHM_2),
    "alg3": Method.of_rule("Algorithm 3 for (MPε-I)_h", PENALTY, ALGORITHM_3),
    "alg4": Method.of_rule("Algorithm 4 for (MPε-II)_h", PENALTY, ALGORITHM_4),
    "snes1": Method(
        "PETSc SNES for (MPε-I)_h",
        PENALTY,
        _alone("solve_by_newton", Penalty.TRACE),
        contact=Condition.ROBIN,
        penalty=Penalty.TRACE,
    ),
    "snes2": Method(
        "PETSc SNES for (MPε-II)_h", PENALTY, _alone("solve_by_newton", Penalty.FLUX), penalty=Penalty.FLUX
    ),
    "vi": Method(
        "PETSc SNESVI for (MLM-I)_h",
        "Benson, Munson: Optim. Methods Softw. (2006)",
        _alone("solve_bound_constrained"),
        laws=(Signorini, TwoSided),
        takes_inner=True,
        takes_order_two=True,
    ),
    "uzawa": _classical("Uzawa iteration for (VL), conforming P1", GLOWINSKI, "primal_uzawa", laws=(), **UZAWA),
    "psor": _classical(
        "projected over-relaxation for (VI), conforming P1",
        GLOWINSKI,
        "over_relaxation",
        laws=(),
        max_iterations=MANY,
        on_one_rank=True,
    ),
    "primal-pdas": _classical(
        "primal-dual active set for (VI), conforming P1",
        "Ito, Kunisch: Lagrange Multiplier Approach (2008)",
        "primal_dual_active_set",
        laws=(),
    ),
    "primal-penalty": _classical(
        "penalty (P_ε) by semismooth Newton, conforming P1",
        "[Haslinger 04] of the slides",
        "primal_penalty",
        laws=(),
        contact=Condition.ROBIN,
        penalty=Penalty.TRACE,
    ),
    "mixed-uzawa1": _classical("Uzawa iteration in σ·n, L² projection, for (MLM-I)_h", LAGRANGE, "flux_uzawa", **UZAWA),
    "mixed-uzawa2": _classical("Uzawa iteration in p, L² projection, for (MLM-II)_h", LAGRANGE, "trace_uzawa", **UZAWA),
    "mixed-uzawa-h12": _classical(
        "Uzawa iteration in p, H^{1/2} projection, for (MLM-II)_h",
        "Gatica, Maischak, Stephan: ESAIM M2AN (2011)",
        "half_uzawa",
        **UZAWA,
        dense=True,
    ),
    "mixed-uzawa-wang": _classical(
        "Uzawa iteration in u, a constrained minimisation each, for (MVI)_h",
        "[Wang 09] of the slides",
        "minimisation_uzawa",
        **UZAWA,
    ),
    "slimane": _classical(
        "stabilised unilateral mixed form, ∇·σ + f = εu",
        "Slimane, Bendali, Laborde: ESAIM M2AN (2004)",
        "stabilised_form",
        stabilised=True,
        has_rho=True,
    ),
    "qp": _classical(
        "(MVI)_h as a quadratic programme, interior point (PIQP)",
        "Theorem 2 of the slides",
        "quadratic_programme",
        laws=None,
        takes_inner=True,
        laws_inside=True,
        max_iterations=250,
        on_one_rank=True,
    ),
}
"""All methods by their names on the command line."""


def methods_that(chosen: Callable[[Method], object]) -> str:
    """The names of the methods for which this is true, in words: "alg1, alg2 and qp"."""
    *names, last = (name for name, method in METHODS.items() if chosen(method))
    return f"{', '.join(names)} and {last}"
