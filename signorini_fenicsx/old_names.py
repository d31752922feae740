"""The Python names of version 0.4, which version 0.5 still has; each warns and says how to write it now."""

import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any

from signorini_fenicsx import extend
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.meshes.domain import Boundary
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.elasticity.problem import Coulomb, CoulombLaw, ElasticBoundary, ElasticProblem
from signorini_fenicsx.solving.evolving import evolve as evolve_problem
from signorini_fenicsx.solving.solver import Solver
from signorini_fenicsx.solving.solver import solve as solve_problem

IN_DIFFUSION = "Diffusion(…, conditions=[…])"
IN_ELASTICITY = "Elasticity(…, conditions=[…])"


def taking_old_calls[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """A function of a mesh and a problem that takes boundary and data in the place of the problem, with a warning."""

    @wraps(function)
    def wrapped(*given: Any, **named: Any) -> Any:
        places = [place for place, each in enumerate(given) if isinstance(each, Boundary | ElasticBoundary)]
        if places:
            place = places[0]
            boundary, data = given[place], given[place + 1 : place + 2] or (named.pop("problem", None),)
            kind = IN_DIFFUSION if isinstance(boundary, Boundary) else IN_ELASTICITY
            warnings.warn(f"a problem is given as {kind} now, without a boundary", DeprecationWarning, stacklevel=2)
            given = (*given[:place], (boundary, *data), *given[place + 2 :])
        return function(*given, **named)

    return wrapped


def _coulomb(kind: type[Coulomb], *given: Any, **named: Any) -> Coulomb | CoulombLaw:
    """Coulomb's law, on parts if there are two arguments, with a warning."""
    if len(given) + len(named) < 2:
        return object.__new__(kind)
    warnings.warn(
        "Coulomb's law on parts is Contact(parts, friction=Coulomb(mu)) now", DeprecationWarning, stacklevel=2
    )
    return CoulombLaw(*given, **named)


Coulomb.__new__ = _coulomb  # type: ignore[method-assign, assignment]
evolve = taking_old_calls(evolve_problem)
solve = taking_old_calls(solve_problem)
Solver.__init__ = taking_old_calls(Solver.__init__)  # type: ignore[method-assign]

OLD = {
    "Boundary": (Boundary, IN_DIFFUSION),
    "Problem": (Problem, IN_DIFFUSION),
    "ElasticBoundary": (ElasticBoundary, IN_ELASTICITY),
    "ElasticProblem": (ElasticProblem, IN_ELASTICITY),
    "ElasticSolution": (None, "Solution, which all solutions are"),
    "solve_elastic": (solve, "solve(domain, problem, options)"),
    "certify_elastic": (certify, "certify(solution)"),
    "load_any_case": (load_case, "load_case(name)"),
    "load_any_solution": (load_solution, "load_solution(folder)"),
} | {name: (getattr(extend, name), f"signorini_fenicsx.extend.{name}") for name in extend.__all__}
"""What each old name stands for, and how to write it."""


def old_name(name: str) -> Any:
    """What an old name stands for, with a warning.

    Raises:
        AttributeError: If there was no such name.
    """
    if name not in OLD:
        raise AttributeError(f"module 'signorini_fenicsx' has no attribute {name!r}")
    found, now = OLD[name]
    warnings.warn(f"signorini_fenicsx.{name} is {now} now", DeprecationWarning, stacklevel=3)
    if name == "ElasticSolution":
        from signorini_fenicsx.physics.elasticity.solution import ElasticSolution  # with most of elasticity

        return ElasticSolution
    return found
