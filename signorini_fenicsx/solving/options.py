"""How a problem is solved: algorithm, backend and their parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Real

from signorini_fenicsx.base.errors import InputError, check_kind
from signorini_fenicsx.base.text import did_you_mean
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import BackendFactory
from signorini_fenicsx.contact.set_rules import SetRule
from signorini_fenicsx.methods.registry import METHODS, Method

BACKENDS = ("hybrid", "mixed")
"""The backends of diffusion by name."""
ELEMENTS = ("RT0", "RT1")
"""The elements of diffusion by name: fluxes of order one, those of the slides, and of order two."""
OWN = "own"
"""Name in results of a method that is not in the registry."""


@dataclass(frozen=True)
class Options:
    """How to solve, like the section `[solve]` of a case file without h.

    Bodies and flows take alg1, alg2, or your own rule without penalty and clip, and have no backend, element, ρ or ε.

    Attributes:
        algorithm: A name that `signorini methods` lists, or your own rule or method.
        backend: Solves the linear problems of the set rules: "hybrid", "mixed", or your own backend.
        element: The element of diffusion: "RT0" with u in P0, or "RT1" with u in P1, which is of one order more; None
            for RT0, in adaptive refinement for RT1 where it is there.
        rho: ρ > 0 of the set rule or the projection iteration; None for the default of the method.
        eps: ε > 0 of the penalty and stabilised methods.
        max_iterations: Iterations allowed; None for the default of the method.
        predict: Whether large problems start from predicted sets.
        tuning: Sizes from which the program works differently.

    Raises:
        InputError: If a name is unknown or a number is not positive.
    """

    algorithm: str | Method | SetRule = "alg1"
    backend: str | BackendFactory = "hybrid"
    element: str | None = None
    rho: float | None = None
    eps: float = 1e-8
    max_iterations: int | None = None
    predict: bool = True
    tuning: Tuning = field(default_factory=Tuning)

    def __post_init__(self) -> None:
        """Refuse unknown names and numbers that are not positive."""
        for key, names in (("algorithm", METHODS), ("backend", BACKENDS), ("element", ELEMENTS)):
            value = getattr(self, key)
            if isinstance(value, str) and value not in names:
                meant = did_you_mean(value, names)
                raise InputError(f"{key}: unknown name '{value}'; use one of {', '.join(names)}{meant}")
        check_kind("algorithm", self.algorithm, str, Method, SetRule)
        if not callable(self.backend):
            check_kind("backend", self.backend, str, hint="; a function that makes a backend will do too")
        if self.element is not None:
            check_kind("element", self.element, str)
        check_kind("tuning", self.tuning, Tuning)
        for key in ("rho", "eps", "max_iterations"):
            value = getattr(self, key)
            if value is None and key != "eps":
                continue
            check_kind(key, value, Real)
            if not value > 0:
                raise InputError(f"{key}: must be greater than 0, not {value}")

    @classmethod
    def of(cls, given: Options | None) -> Options:
        """The given options, or the defaults for None.

        Raises:
            InputError: If it is something else.
        """
        options = Options() if given is None else given
        check_kind("options", options, Options)
        return options

    @property
    def method(self) -> Method:
        """The method that these options choose."""
        if isinstance(self.algorithm, SetRule):
            return Method.of_rule("a rule of one's own", "", self.algorithm)
        return METHODS[self.algorithm] if isinstance(self.algorithm, str) else self.algorithm

    @property
    def algorithm_name(self) -> str:
        """Name of the method in results."""
        return self.algorithm if isinstance(self.algorithm, str) else OWN

    @property
    def backend_name(self) -> str:
        """Name of the backend that was asked for; the backend in use may have another name."""
        return self.backend if isinstance(self.backend, str) else OWN
