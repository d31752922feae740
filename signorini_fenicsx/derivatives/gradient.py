"""Derivatives of a functional of a solution, and of the solution itself, by what is in the data of its problem.

They are those of the discrete problem: the program solves no other, so a Taylor test has order 2 on any mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from ufl import Form

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.derivatives.controls import Control, check_control, gradient_of, occurs, sum_of


class Gradient(NamedTuple):
    """A functional of a solution with its gradient.

    Attributes:
        value: Its value.
        gradients: Its derivative by each control: a number for a constant; for a function the derivatives by its owned
            coefficients.
    """

    value: float
    gradients: list[float | Array]


def gradient(solution: Any, J: Form, controls: Sequence[Control]) -> Gradient:
    """The value of a functional and its derivatives by controls, by one linear solve (collective).

    Args:
        solution: A solution; the controls have the values with which it was solved.
        J: Integrals, in UFL, in its `sigma`, `u` and `p`, and in controls.
        controls: Scalar constants and functions in the data of the problem, or in J.

    Raises:
        InputError: If a control is none, or in neither; if the solution has no derivatives.
        LinearSolveFailure: If the linear solver does not converge.
    """
    for control in controls:
        check_control(control)
    problem, spaces = solution.linearised(), solution.spaces
    sensitivities = problem.adjoint(J)
    of_data = sum_of([seen.weighted(sensitivities[name]) for name, seen in problem.seen.items()])
    whole = J + of_data
    for number, control in enumerate(controls):
        if not occurs(control, whole):
            raise InputError(f"controls: number {number + 1} is in no datum of the problem that was solved")
    return Gradient(spaces.integrate(J), [gradient_of(spaces, whole, control) for control in controls])
