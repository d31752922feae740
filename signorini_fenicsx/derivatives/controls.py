"""Controls: constants and functions in the data of a problem, by which something is differentiated."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl import Form
from ufl.algorithms.map_integrands import map_integrands
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces, assembled
from signorini_fenicsx.discrete.seen import Control, Values, parts_of, values_of

ROUNDING = 1e-10
"""A share of the largest value of a control by which it may differ from what was solved with."""


def check_control(control: Any) -> None:
    """Refuse what is no control.

    Raises:
        InputError: If it is neither a scalar constant nor a function.
    """
    if not isinstance(control, fem.Constant | fem.Function):
        raise InputError(f"controls: are Constants and Functions of DOLFINx, not {type(control).__name__}")
    if isinstance(control, fem.Constant) and control.ufl_shape:
        raise InputError(f"controls: a Constant must be a scalar, and one has the shape {control.ufl_shape}")


def check_unchanged(spaces: MeshSpaces, given: Values) -> None:
    """Refuse derivatives of a solution whose data have changed in place since it was solved (collective).

    Raises:
        InputError: On all ranks, if they have on one.
    """
    changed = any(
        bool((np.abs(values_of(control) - before) > ROUNDING * np.abs(before).max(initial=0.0)).any())
        for control, before in given
    )
    if spaces.mesh.comm.allreduce(changed, MPI.LOR):
        raise InputError(
            "a Constant or Function in the data has other values than when the problem was solved; solve again, or "
            "ask for derivatives before you change it"
        )


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
    forms = [part for part in parts_of(form) if occurs(control, part)]
    if isinstance(control, fem.Constant):
        return sum(spaces.integrate(_by_constant(part, control)) for part in forms)
    space = control.function_space
    gradient = np.zeros(space.dofmap.index_map.size_local * space.dofmap.index_map_bs)
    for part in forms:
        by_control = ufl.derivative(part, control, ufl.TestFunction(space))
        gradient += assembled(by_control, spaces.entity_maps)[: len(gradient)]
    return gradient


def _by_constant(form: Form, control: fem.Constant) -> Form:
    """The derivative by a constant, integrand by integrand."""
    variable = ufl.variable(control)

    def derivative(integrand: Expr) -> Expr:
        return ufl.diff(ufl.replace(integrand, {control: variable}), variable)

    return map_integrands(derivative, form)


def sum_of(forms: Sequence[Form]) -> Form:
    """The sum of forms; a form without integrals if there are none."""
    return sum(forms, start=ufl.Form([]))
