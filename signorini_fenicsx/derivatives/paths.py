"""Controls by paths: numbers of a problem as case files name them, such as "problem.kappa.rock" and "pair.0.mu"."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import Any

import dolfinx.mesh
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.law import EVERYWHERE, Law
from signorini_fenicsx.expressions import TREES, is_polynomial, values
from signorini_fenicsx.expressions.given import parsed

SECTIONS = {"law": ["laws"], "pair": ["laws"], "soil": ["kappa"]}
"""Where a problem has the sections of a case file other than `[problem]`."""


def with_constants(solution: Any, controls: Iterable[Any]) -> tuple[Any, list[Any]]:
    """The solution of a problem with constants in the place of the numbers at some paths (collective).

    Args:
        solution: A solution.
        controls: Constants and functions, and paths.

    Returns:
        The solution, and the controls with these constants in the place of paths.

    Raises:
        InputError: If there is no number at a path.
    """
    problem = solution.problem
    constants: list[Any] = []
    for control in controls:
        if isinstance(control, str):
            section, *names = control.split(".")
            if section == "soil" and names[:1] == [EVERYWHERE]:
                names = names[1:]
            if section in ("law", "pair"):
                names = _in_laws(problem, section, names)
            make = partial(_constant, control, solution.spaces.mesh, constants)
            problem = _replaced(problem, [*SECTIONS.get(section, []), *names], make, control)
        else:
            constants.append(control)
    return solution if problem is solution.problem else solution.of_problem(problem), constants


def _in_laws(problem: Any, section: str, names: Sequence[str]) -> list[str]:
    """A path in the laws of a problem, from one in the laws or pairs of a case file, which may be several of these."""
    number, key, *_ = *names, "", ""
    laws = [(i, law) for i, (name, law) in enumerate(problem.named_laws) if name == f"{section}.{number}"]
    return [next((str(i) for i, law in laws if hasattr(law, key)), ""), *names[1:]]


def _constant(path: str, mesh: dolfinx.mesh.Mesh, constants: list[Any], given: Any) -> fem.Constant:
    """A constant with the value of a number, also added to a list.

    Raises:
        InputError: If it is no number.
    """
    tree = parsed(given, "xyzt", path)
    if not (isinstance(tree, TREES) and is_polynomial(tree, 0)):
        raise InputError(f"{path}: is no number; in Python put a Constant or Function there")
    constants.append(fem.Constant(mesh, float(values(tree, np.zeros(3)))))
    return constants[-1]


def _replaced(given: Any, names: Sequence[str], make: Callable[[Any], Any], path: str) -> Any:
    """A given datum, or a table of them, with another value at one place.

    Raises:
        InputError: If there is no such place.
    """
    if not names:
        return make(given)
    name, *rest = names
    if isinstance(given, Mapping) and name in given:
        return {**given, name: _replaced(given[name], rest, make, path)}
    if isinstance(given, list | tuple) and name.isdigit() and int(name) < len(given):
        inner = _replaced(given[int(name)], rest, make, path)
        return type(given)(inner if index == int(name) else each for index, each in enumerate(given))
    has_fields = is_dataclass(given) and not isinstance(given, TREES)
    if has_fields and name in [field.name for field in fields(given) if field.init]:
        changed = replace(given, **{name: _replaced(getattr(given, name), rest, make, path)})
        if isinstance(given, Law):
            object.__setattr__(changed, "region", given.region)
        return changed
    raise InputError(f"{path}: there is no such number in the problem; paths are such as problem.kappa or law.0.g")
