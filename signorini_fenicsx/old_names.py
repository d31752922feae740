"""The Python names of version 0.4, which version 0.5 still has; each warns and says how to write it now."""

import warnings
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Any

from signorini_fenicsx import extend
from signorini_fenicsx.meshes.domain import Boundary
from signorini_fenicsx.physics.elasticity.problem import Coulomb, CoulombLaw, ElasticBoundary

IN_DIFFUSION = "Diffusion(…, conditions=[…])"
IN_ELASTICITY = "Elasticity(…, conditions=[…])"
OLD = {
    "Boundary": ("meshes.domain.Boundary", IN_DIFFUSION),
    "Problem": ("physics.diffusion.problem.Problem", IN_DIFFUSION),
    "ElasticBoundary": ("physics.elasticity.problem.ElasticBoundary", IN_ELASTICITY),
    "ElasticProblem": ("physics.elasticity.problem.ElasticProblem", IN_ELASTICITY),
    "ElasticSolution": ("physics.elasticity.solution.ElasticSolution", "Solution, which all solutions are"),
    "solve_elastic": ("api.solve", "solve(domain, problem, options)"),
    "certify_elastic": ("api.certify", "certify(solution)"),
    "load_any_case": ("api.load_case", "load_case(name)"),
    "load_any_solution": ("api.load_solution", "load_solution(folder)"),
} | {name: (f"extend.{name}", f"signorini_fenicsx.extend.{name}") for name in extend.__all__}
"""Where each old name is now, and how to write it."""


def old_name(name: str) -> Any:
    """What an old name stands for, with a warning.

    Raises:
        AttributeError: If there was no such name.
    """
    if name not in OLD:
        raise AttributeError(f"module 'signorini_fenicsx' has no attribute {name!r}")
    place, now = OLD[name]
    warnings.warn(f"signorini_fenicsx.{name} is {now} now", DeprecationWarning, stacklevel=3)
    module, _, attribute = place.rpartition(".")
    return getattr(import_module(f"signorini_fenicsx.{module}"), attribute)


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
