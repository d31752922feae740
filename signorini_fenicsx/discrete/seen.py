"""What a discrete problem sees of its data: numbers that are integrals of them with fixed functions, such as means.

With the form ∫ d·v of a datum d these are its values for the basis functions v, each divided by a number. So the change
of the numbers with d is the derivative of this form, and if S are the derivatives of something by them, its derivative
by what is in d is that of the form with v = Σ (S/number) times a basis function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.mesh_spaces import assembled

type Vary = Callable[[Form], Form]
"""The derivative of a form in a direction, of the same rank."""


@dataclass(frozen=True)
class Seen:
    """The numbers that a discrete problem sees of one datum.

    Attributes:
        form: The integral of the datum with a function v, in UFL.
        space: That of v.
        dofs: The basis function of each number; all are owned.
        scale: What the integral is divided by, one value each.
    """

    form: Callable[[Expr], Form]
    space: fem.FunctionSpace
    dofs: npt.NDArray[np.int32]
    scale: Array

    def changes(self, vary: Vary) -> Array:
        """How the numbers change with the datum (collective)."""
        form = vary(self.form(ufl.TestFunction(self.space)))
        return assembled(form)[self.dofs] / self.scale if form.integrals() else np.zeros(len(self.dofs))

    def weighted(self, by: Array) -> Form:
        """The sum of the numbers of all ranks, each times one of these, as a form (collective)."""
        v = fem.Function(self.space)
        v.x.array[self.dofs] = by / self.scale
        v.x.scatter_forward()
        return self.form(v)
