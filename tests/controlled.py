"""Problems with controls in their data, directions of these, and derivatives along them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from signorini_fenicsx import Domain, Options


@dataclass
class Controlled:
    """A problem with the controls in its data."""

    domain: Domain
    problem: Any
    controls: list[Any]
    options: Options | None = None

    def functional(self, solution: Any) -> Any:
        """Something of all parts of the solution, and of a control."""
        n, x, ds = solution.spaces.n, ufl.SpatialCoordinate(self.domain.mesh), solution.spaces.ds
        flux = ufl.dot(solution.sigma, n)
        J = (solution.u**2 * (1 + x[0]) + x[1] * ufl.inner(solution.sigma, solution.sigma)) * ufl.dx
        J += ((1 + x[0]) * solution.p**2 + x[1] * flux**2 + flux) * ds + flux * x[0] * ufl.ds
        return J + self.controls[0] ** 2 * solution.u * ufl.dx


def constants(domain: Domain, *values: float) -> list[fem.Constant]:
    return [fem.Constant(domain.mesh, value) for value in values]


def function(domain: Domain, of: Callable[[Any], Any], element: tuple[str, int] = ("P", 1)) -> fem.Function:
    found = fem.Function(fem.functionspace(domain.mesh, element))
    found.interpolate(of)
    return found


def directions_of(controls: list[Any]) -> list[Any]:
    """A direction of all controls, the same on any ranks."""
    directions: list[Any] = []
    for number, control in enumerate(controls):
        if isinstance(control, fem.Constant):
            directions.append((1 + number % 3) * (-1) ** number * abs(float(control.value)) / 3)
        else:
            directions.append(fem.Function(control.function_space))
            directions[-1].interpolate(lambda x: 0.3 * np.sin(5 * x[0] + x[1]))
    return directions


def move(controls: list[Any], directions: list[Any], step: float) -> None:
    """Change the values of the controls in place."""
    for control, direction in zip(controls, directions, strict=True):
        if isinstance(control, fem.Constant):
            control.value = control.value + step * direction
        else:
            control.x.array[:] += step * direction.x.array


def pairing(gradients: list[Any], directions: list[Any]) -> float:
    """The derivative in a direction."""
    terms = [
        direction.function_space.mesh.comm.allreduce(float(gradient @ direction.x.array[: len(gradient)]))
        if isinstance(direction, fem.Function)
        else gradient * direction
        for gradient, direction in zip(gradients, directions, strict=True)
    ]
    return float(sum(terms))
