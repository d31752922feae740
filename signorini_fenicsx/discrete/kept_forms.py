"""Compiled forms that are made once per mesh and then assembled with other coefficients.

To make a form takes UFL and DOLFINx some milliseconds, as much as to assemble it on some thousand cells.
"""

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
    """

    def __init__(self) -> None:
        self._kept: dict[Hashable, tuple[list[Coefficient], Any]] = {}

    def get(self, name: Hashable, make: Callable[..., Any], coefficients: tuple[Coefficient, ...]) -> Any:
        """What `make` made when this name was first asked for, with the values of these coefficients (collective).

        Args:
            name: Tells it from all others, but for the kinds of its coefficients.
            make: Compiles it in the coefficients that it gets.
            coefficients: Functions with up-to-date ghost values, and constants.

        Returns:
            A form, forms or an expression, to be used before the next call with this name.
        """
        key = name, *(_kind(coefficient) for coefficient in coefficients)
        if key not in self._kept:
            kept = [_copied(coefficient) for coefficient in coefficients]
            self._kept[key] = kept, make(*kept)
        kept, made = self._kept[key]
        for of_form, given in zip(kept, coefficients, strict=True):
            if isinstance(of_form, fem.Function):
                of_form.x.array[:] = given.x.array
            else:
                of_form.value = given.value
        return made


def _copied(coefficient: Coefficient) -> Coefficient:
    if isinstance(coefficient, fem.Constant):
        return fem.Constant(coefficient.ufl_domain(), np.array(coefficient.value))
    return fem.Function(coefficient.function_space)


def _kind(coefficient: Coefficient) -> Hashable:
    if isinstance(coefficient, fem.Function):
        return coefficient.function_space.ufl_element()
    return np.shape(coefficient.value)
