"""The problems of the benchmark, and the primal-dual active set by which other programs solve them.

Formulas are written for whatever supports arithmetic: NumPy arrays, NGSolve's coefficient functions.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

type Array = npt.NDArray[np.float64]
type Points = Sequence[Any]
TRANSITION = 0.413
SINGULAR = f"((x - {TRANSITION})^2 + {{z}}^2)^(3/4)*cos(3/2*atan2(abs({{z}}), {TRANSITION} - x))"


@dataclass(frozen=True)
class Arithmetic:
    """What the caller calls max(·, 0) and the square root."""

    positive: Callable[[Any], Any]
    sqrt: Callable[[Any], Any]


@dataclass(frozen=True)
class Problem:
    """−Δu = f with u = u_D on Γ_D and Γ_S: u ≥ 0, ∇u·n ≥ 0, one of them 0.

    Attributes:
        case: The case of this program.
        dim: Its dimension.
        solution: u, at least on Γ_D.
        load: f; None for 0.
        gradient: ∇u; None where it is not known.
        values: What the case has otherwise.
        energy: Of u, where ∇u is not known: −½‖σ_h‖² of `adapt` with a target of 7e-5, and half the square of the bound
            at most above.
        heights: The last coordinate on Γ_S; the rest of the boundary is Γ_D.
        least: The least value of u on Γ_S.
        press: Of an elastic block, which is held where x = 0, the traction on its top; load is along the same axis.
    """

    case: str
    dim: int
    solution: Callable[[Points, Arithmetic], Any]
    load: Callable[[Points, Arithmetic], Any] | None
    gradient: Callable[[Points, Arithmetic], tuple[Any, ...]] | None = None
    values: Mapping[str, object] = field(default_factory=dict)
    energy: float = 0.0
    heights: Sequence[float] = (0.0,)
    least: float = 0.0
    press: float = 0.0

    def parts(self, x: Array) -> npt.NDArray[np.str_]:
        """The part of the boundary on which facets with these middles are, shape (d, n)."""
        below = np.min([np.abs(x[-1] - height) for height in self.heights], axis=0) < 1e-12
        if not self.press:
            return np.where(below, "contact", "held")
        return np.select(
            [below, np.isclose(x[0], 0), np.isclose(x[-1], 1)], ["contact", "held", "pressed"], default="free"
        )


def _level(x: Points) -> tuple[Any, tuple[Any, ...], float]:
    """A function whose sign tells contact, its gradient in the plane of Γ_S, its Laplacian there."""
    if len(x) == 2:
        return x[0] - TRANSITION, (1.0,), 0.0
    return x[0] * x[0] + x[1] * x[1] - 0.49, (2 * x[0], 2 * x[1]), 4.0


def _smooth(x: Points, of: Arithmetic) -> Any:
    """The function t_+³ − z t_-³ with the level t and the last coordinate z."""
    t, _, _ = _level(x)
    return of.positive(t) ** 3 - x[-1] * of.positive(-t) ** 3


def _smooth_gradient(x: Points, of: Arithmetic) -> tuple[Any, ...]:
    t, slope, _ = _level(x)
    along = 3 * of.positive(t) ** 2 + 3 * x[-1] * of.positive(-t) ** 2
    return (*(along * s for s in slope), -(of.positive(-t) ** 3))


def _smooth_load(x: Points, of: Arithmetic) -> Any:
    t, slope, curvature = _level(x)
    square = sum(s * s for s in slope)
    first = 3 * curvature * (of.positive(t) ** 2 + x[-1] * of.positive(-t) ** 2)
    return -6 * square * (of.positive(t) - x[-1] * of.positive(-t)) - first


def _singular(x: Points, of: Arithmetic) -> Any:
    """The real part of w^(3/2) with w = t + iz, t = 0.413 − x and the last coordinate z: contact where t < 0."""
    t = TRANSITION - x[0]
    r = of.sqrt(t * t + x[-1] * x[-1])
    return of.sqrt(of.positive(r + t) / 2) * (2 * t - r)


def _singular_gradient(x: Points, of: Arithmetic) -> tuple[Any, ...]:
    t = TRANSITION - x[0]
    r = of.sqrt(t * t + x[-1] * x[-1])
    along, up = (1.5 * of.sqrt(of.positive(r + sign * t) / 2) for sign in (1, -1))
    return (-along, *(0 * x[0] for _ in x[1:-1]), -up)


def _zero(x: Points, _: Arithmetic) -> Any:
    return 0 * x[0]


def _of_singular(dim: int) -> Problem:
    text = SINGULAR.format(z="xyz"[dim - 1])
    name = {2: "singular", 3: "singular3d"}[dim]
    return Problem(name, dim, _singular, None, _singular_gradient, {"problem.u_D": text, "exact.u": text})


PROBLEMS = {
    "transition": Problem("transition", 2, _smooth, _smooth_load, _smooth_gradient),
    "singular": _of_singular(2),
    "example1": Problem(
        "example1",
        2,
        _zero,
        lambda x, _: 50 * (0.5 - x[0]) * (0.5 - x[1]),
        energy=-0.0899361378,
        heights=(0.0, 1.0),
    ),
    "transition3d": Problem("transition3d", 3, _smooth, _smooth_load, _smooth_gradient),
    "singular3d": _of_singular(3),
}
YOUNG, POISSON, GAP, WEIGHT, PRESS = 1.0, 0.3, 0.02, -0.3, -0.1
"""Of a block of length 2 that is fixed on one side and pressed onto a foundation."""
BLOCKS = {
    f"block{dim}d": Problem("", dim, _zero, lambda x, _: WEIGHT + 0 * x[0], least=-GAP, press=PRESS) for dim in (2, 3)
}


@dataclass(frozen=True)
class Result:
    """Nodal values, nodal contact forces, the mask of active nodes, steps."""

    u: Array
    force: Array
    active: npt.NDArray[np.bool_]
    steps: int


def primal_dual_active_set(
    solve: Callable[[npt.NDArray[np.bool_], Array], Array],
    residual: Callable[[Array], Array],
    contact: npt.NDArray[np.int64],
    start: Array,
    least: float = 0.0,
    first: npt.NDArray[np.bool_] | None = None,
) -> Result:
    """Solve with u at its least value on the active nodes until these repeat (Ito, Kunisch).

    Args:
        solve: From the mask of active nodes and the last solution to the next solution.
        residual: A u − b.
        contact: Nodes on Γ_S.
        start: First iterate.
        least: The least value of u on Γ_S.
        first: The active nodes of the first step; none if it is None.

    Raises:
        RuntimeError: If the nodes have not settled after 100 steps.
    """
    u, active = start, np.zeros(len(start), dtype=bool) if first is None else first
    for steps in range(1, 101):
        u = solve(active, u)
        force = residual(u)
        following = np.zeros_like(active)
        following[contact] = np.where(active[contact], force[contact] > 0, u[contact] < least)
        if (following == active).all():
            return Result(u, np.where(active, force, 0.0), active, steps)
        active = following
    raise RuntimeError("the active nodes do not settle")


def kkt_residual(result: Result, residual: Array, free: npt.NDArray[np.int64], contact: npt.NDArray[np.int64]) -> float:
    """The largest scale-free residual: u ≥ 0, force ≥ 0, complementarity, equilibrium of the free nodes."""
    u, force = result.u[contact], result.force[contact]
    scale_u, scale_f = np.linalg.norm(result.u), np.linalg.norm(residual)
    equilibrium = np.linalg.norm((residual - result.force)[free]) / scale_f
    signs = max(np.linalg.norm(np.minimum(u, 0)) / scale_u, np.linalg.norm(np.minimum(force, 0)) / scale_f)
    return float(max(equilibrium, signs, np.abs(u @ force) / (scale_u * scale_f)))
