"""Compiled forms that are made once per mesh and then assembled with other coefficients.

To make a form takes UFL and DOLFINx some milliseconds, as much as to assemble it on some thousand cells.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
from dolfinx import fem

type Coefficient = fem.Function | fem.Constant
type Build = Callable[..., Any]
"""Gives UFL from its coefficients. It is a function of a module, for it is also the name of what is kept."""


class KeptForms:
    """Forms and expressions in functions of their own, which take the values of the coefficients of each call.

    These functions are made in the order of the arguments, as another order would make, and compile, another form.
    Those of different forms share their memory.
    """

    def __init__(self) -> None:
        self._kept: dict[Hashable, tuple[list[Coefficient], Any]] = {}
        self._vectors: dict[Hashable, Any] = {}

    def get(self, name: Hashable, make: Callable[..., Any], coefficients: tuple[Coefficient, ...]) -> Any:
        """What `make` made when this name was first asked for, with the values of these coefficients (collective).

        Args:
            name: Tells it from all others, but for the kinds of its coefficients.
            make: Compiles it in the coefficients that it gets.
            coefficients: Functions with up-to-date ghost values, and constants.

        Returns:
            A form, forms or an expression, to be used before the next call.
        """
        kinds = [_kind(coefficient) for coefficient in coefficients]
        key = name, *kinds
        if key not in self._kept:
            own = [self._own(kinds[: i + 1], coefficient) for i, coefficient in enumerate(coefficients)]
            self._kept[key] = own, make(*own)
        own, made = self._kept[key]
        for mine, theirs in zip(own, coefficients, strict=True):
            if isinstance(mine, fem.Function):
                mine.x.array[:] = theirs.x.array
            else:
                mine.value = theirs.value
        return made

    def _own(self, kinds: list[Hashable], coefficient: Coefficient) -> Coefficient:
        """A coefficient of this kind, the last one; in one call each has a vector of its own."""
        if isinstance(coefficient, fem.Constant):
            return fem.Constant(coefficient.ufl_domain(), np.array(coefficient.value))
        space = coefficient.function_space
        vector = self._vectors.setdefault((kinds[-1], kinds.count(kinds[-1])), fem.Function(space).x)
        return fem.Function(space, vector)


def _kind(coefficient: Coefficient) -> Hashable:
    if isinstance(coefficient, fem.Function):
        return coefficient.function_space.ufl_element()
    return np.shape(coefficient.value)
