"""Derivatives of a functional of a solution, and of the solution itself, by what is in the data of its problem.

They are those of the discrete problem: the program solves no other, so a Taylor test has order 2 on any mesh.

*Controls*: constants and functions in the data of a problem, by which something is differentiated.
"""

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl import Form
from ufl.algorithms.map_integrands import map_integrands
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import collector_off, on_root_only
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.derivatives.paths import with_constants
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces, assembled
from signorini_fenicsx.discrete.seen import Control, Values, parts_of, values_of
from signorini_fenicsx.meshes.sampling import at_points
from signorini_fenicsx.solving.evolving import Instant

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


BIACTIVE = 1e-8
"""Sites that are on a corner of their law but for this share of the sizes of p and σ·n are biactive."""


class NotDifferentiable(UserWarning):
    """The warning that a gradient is one of several.

    Attributes:
        places: The midpoints of the biactive sites, shape (sites, dim).
    """

    def __init__(self, places: Array, tolerance: float):
        """Say it, with the first place."""
        first = ", ".join(f"{x:.4g}" for x in places[0])
        sites = counted(len(places), "site")
        super().__init__(
            f"{sites} may leave a corner of the law, as at ({first}) to {tolerance:g}: one of several gradients"
        )
        self.places = places


class Gradient(NamedTuple):
    """A functional of a solution with its gradient.

    Attributes:
        value: Its value.
        gradients: Its derivative by each control: a number for a constant; for a function the derivatives by its owned
            coefficients.
    """

    value: float
    gradients: list[float | Array]


@dataclass(frozen=True)
class Change:
    """The change of a solution with its data: functions of the spaces of σ, u and p.

    Attributes:
        sigma: The change of σ.
        u: The change of u.
        p: The change of p; None in elasticity.
        spaces: The discrete spaces.
    """

    sigma: fem.Function
    u: fem.Function
    p: fem.Function | None
    spaces: MeshSpaces

    def __repr__(self) -> str:
        names = [name for name in ("sigma", "u", "p") if getattr(self, name) is not None]
        return f"<Change of {', '.join(names)} on {self.spaces.domain.name}>"

    def at(self, points: npt.ArrayLike) -> tuple[Array, Array]:
        """The changes of u_h and σ_h at points (collective).

        Raises:
            InputError: On all ranks, if the points of one rank have another shape.
        """
        u, sigma = (at_points(self.spaces.domain, function, points) for function in (self.u, self.sigma))
        return u, sigma


def gradient(solution: Any, J: Form, controls: Sequence[Control | str], tolerance: float = BIACTIVE) -> Gradient:
    """The value of a functional and its derivatives by controls, by one linear solve (collective).

    Where sites are biactive there is no gradient. Then it is that under the present segments, and rank 0 warns, see
    `NotDifferentiable`.

    Args:
        solution: A solution; the controls have the values with which it was solved.
        J: Integrals, in UFL, in its `sigma`, `u` and `p`, and in controls.
        controls: Scalar constants and functions in the data of the problem, or in J; or paths to numbers in it, such as
            "problem.kappa.rock".
        tolerance: Which sites are biactive.

    Raises:
        InputError: If a control is none, or in neither, or was changed since the solve; if the solution has no
            derivatives, or is a step in time.
        LinearSolveFailure: If the linear solver does not converge.
    """
    _refuse_steps(solution)
    value, gradients, _ = _of_step(solution, J, controls, tolerance)
    return Gradient(value, _all_there(gradients))


@collector_off()
def gradient_in_time(
    instants: Sequence[Instant],
    J: Callable[[Instant], Form],
    controls: Sequence[Control | str],
    tolerance: float = BIACTIVE,
) -> Gradient:
    """The value of a functional of all steps in time and its derivatives by controls, step by step backwards.

    It costs one linear solve, and a factorisation, for each step (collective).

    Args:
        instants: All steps from the first one, as `evolve` gives them.
        J: For each step integrals in its solution and in controls; J is their sum.
        controls: As in `gradient`; they are the same at all times. They may be in the initial values, too.
        tolerance: Which sites are biactive.

    Raises:
        InputError: If a control is none, or in no datum, or was changed since the solve; if there are laws of storage
            and controls in the initial values, or other laws in Ω.
        LinearSolveFailure: If the linear solver does not converge.
    """
    if [instant.step for instant in instants] != list(range(1, len(instants) + 1)):
        raise InputError("instants: must be all steps from the first one")
    sums: list[float | Array | None] = [None for _ in controls]
    value, later = 0.0, dict[int, Any]()
    for instant in reversed(instants):
        left = later.pop(instant.step, None)
        more = None if left is None else instant.steps.functional(instant.solution, left)
        its_value, gradients, by = _of_step(instant.solution, J(instant), controls, tolerance, more)
        value += its_value
        sums = [_plus(whole, part) for whole, part in zip(sums, gradients, strict=True)]
        for step, by_left in instant.steps.by_earlier(instant.step, by):
            later[step] = later.get(step, 0.0) + by_left
    if later:
        steps = instants[0].steps
        at_start, plain = steps.at_start(later.pop(0)), [None if isinstance(each, str) else each for each in controls]
        parts = [None if each is None else _by_control(steps.spaces, at_start, each) for each in plain]
        sums = [_plus(whole, part) for whole, part in zip(sums, parts, strict=True)]
    return Gradient(value, _all_there(sums))


def _plus(whole: float | Array | None, part: float | Array | None) -> float | Array | None:
    """The sum of two derivatives, None for one by what is not there."""
    return part if whole is None else whole if part is None else whole + part


def _by_control(spaces: MeshSpaces, form: Form, control: Control) -> float | Array | None:
    """The derivative of a form by a control; None if it is not there (collective)."""
    return gradient_of(spaces, form, control) if occurs(control, form) else None


def _all_there(gradients: Sequence[float | Array | None]) -> list[float | Array]:
    """The derivatives by all controls.

    Raises:
        InputError: If one is by what is in no datum.
    """
    derivatives = []
    for number, each in enumerate(gradients):
        if each is None:
            raise InputError(f"controls: number {number + 1} is in no datum of the problem that was solved")
        derivatives.append(each)
    return derivatives


def _of_step(
    solution: Any, J: Form, controls: Sequence[Control | str], tolerance: float, more: Any = None
) -> tuple[float, list[float | Array | None], Mapping[str, Array]]:
    """The value, the gradient for given memory, and the derivatives by what the discrete problem sees (collective).

    Args:
        solution: The solution.
        J: The functional.
        controls: The controls.
        tolerance: Which sites are biactive.
        more: The derivatives of what comes later by what this step leaves, see `solving.evolution.Steps.functional`.
    """
    problem, constants = _linearised(solution, controls, tolerance)
    spaces, comm = solution.spaces, solution.spaces.mesh.comm
    places = np.concatenate(comm.allgather(problem.places()))
    if len(places) > 0:  # a filter may make it an error
        on_root_only(comm, lambda: warnings.warn(NotDifferentiable(places, tolerance), stacklevel=7))
    sensitivities = problem.adjoint(J, more)
    whole = J + sum_of([seen.weighted(sensitivities[name]) for name, seen in problem.seen.items()])
    value = sum(spaces.integrate(part) for part in parts_of(J))
    return value, [_by_control(spaces, whole, control) for control in constants], sensitivities


def _linearised(solution: Any, controls: Iterable[Control | str], tolerance: float) -> tuple[Any, list[Control]]:
    """The problem linearised at a solution, and the controls, with constants in the place of paths (collective).

    Raises:
        InputError: If a control is none, or was changed since the solve; if the solution has no derivatives.
    """
    posed, constants = with_constants(solution, controls)
    for control in constants:
        check_control(control)
    problem = posed.linearised(tolerance)
    check_unchanged(solution.spaces, solution.data.given)
    return problem, constants


def _refuse_steps(solution: Any) -> None:
    """Refuse a step of a problem in time, which depends on controls by the steps before as well.

    Raises:
        InputError: If it is one.
    """
    if solution.step is not None:
        raise InputError(f"{solution.name}: step {solution.step} of a problem in time; use gradient_in_time")


def derivative(solution: Any, direction: Mapping[Control | str, Any], tolerance: float = BIACTIVE) -> Change:
    """The change of a solution, by one linear solve (collective).

    Biactive sites move along one of the two segments that meet there, so it is the derivative in this direction alone,
    and one linear solve for each set of theirs.

    Args:
        solution: A solution; the controls have the values with which it was solved.
        direction: For each control, or path, its change: for a function one of its space, else a number.
        tolerance: Which sites are biactive.

    Raises:
        InputError: If a control is none, or in no datum, or was changed since the solve; if the solution has no
            derivatives, or is a step in time.
        LinearSolveFailure: If the linear solver does not converge.
        NumericalFailure: If the sets of biactive sites do not settle.
    """
    _refuse_steps(solution)
    problem, controls = _linearised(solution, direction, tolerance)
    moved = list(zip(controls, direction.values(), strict=True))
    used: set[int] = set()

    def vary(form: Form) -> Form:
        present = [number for number, control in enumerate(controls) if occurs(control, form)]
        used.update(present)
        return sum_of([varied(form, *moved[number]) for number in present])

    changes = {name: seen.changes(vary) for name, seen in problem.seen.items()}
    if len(used) < len(controls):
        raise InputError(
            f"direction: {counted(len(controls) - len(used), 'control')} in no datum of the problem that was solved"
        )
    return Change(**problem.change(changes), spaces=solution.spaces)
