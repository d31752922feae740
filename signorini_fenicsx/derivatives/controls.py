"""Controls: constants and functions in the data of a problem, by which something is differentiated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl import Form
from ufl.algorithms.map_integrands import map_integrands
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces, assembled

type Control = fem.Constant | fem.Function


def check_control(control: Any) -> None:
    """Refuse what is no control.

    Raises:
        InputError: If it is neither a scalar constant nor a function.
    """
    if not isinstance(control, fem.Constant | fem.Function):
        raise InputError(f"controls: are Constants and Functions of DOLFINx, not {type(control).__name__}")
    if isinstance(control, fem.Constant) and control.ufl_shape:
        raise InputError(f"controls: a Constant must be a scalar, and one has the shape {control.ufl_shape}")


def occurs(control: Control, form: Form) -> bool:
    """Whether a control is in a form."""
    return any(control is other for other in (*form.coefficients(), *form.constants()))


def varied(form: Form, control: Control, direction: Any) -> Form:
    """The derivative of a form by a control in a direction: a number, or a function of the same space."""
    if isinstance(control, fem.Function):
        return ufl.derivative(form, control, direction)
    return direction * _by_constant(form, control)


def gradient_of(spaces: MeshSpaces, form: Form, control: Control) -> float | Array:
    """The derivative of a form by a control: for a function by each of its owned coefficients (collective)."""
    if isinstance(control, fem.Constant):
        return spaces.integrate(_by_constant(form, control)) if occurs(control, form) else 0.0
    space = control.function_space
    size = space.dofmap.index_map.size_local * space.dofmap.index_map_bs
    if not occurs(control, form):
        return np.zeros(size)
    return assembled(ufl.derivative(form, control, ufl.TestFunction(space)), [spaces.entity_map])[:size]


def _by_constant(form: Form, control: fem.Constant) -> Form:
    """The derivative by a constant, integrand by integrand."""
    variable = ufl.variable(control)

    def derivative(integrand: Expr) -> Expr:
        return ufl.diff(ufl.replace(integrand, {control: variable}), variable)

    return map_integrands(derivative, form)


def sum_of(forms: Sequence[Form]) -> Form:
    """Their sum; without integrals if there are none."""
    return sum(forms, start=ufl.Form([]))
