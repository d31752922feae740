"""The two problems of the benchmark, cases `transition` and `transition3d`, for programs that cannot read cases.

Formulas are written for whatever supports arithmetic: NumPy arrays, NGSolve's coefficient functions.
"""

from collections.abc import Callable, Sequence
from typing import Any

Positive = Callable[[Any], Any]
"""max(·, 0) in the caller's arithmetic."""


def solution(x: Sequence[Any], positive: Positive) -> Any:
    """The solution u = t_+³ − z t_-³; z is the last coordinate and t = x − 0.413 in 2D, x² + y² − 0.49 in 3D."""
    t, _, _ = _level(x)
    return positive(t) ** 3 - x[-1] * positive(-t) ** 3


def gradient(x: Sequence[Any], positive: Positive) -> tuple[Any, ...]:
    """∇u."""
    t, slope, _ = _level(x)
    along = 3 * positive(t) ** 2 + 3 * x[-1] * positive(-t) ** 2
    return (*(along * s for s in slope), -(positive(-t) ** 3))


def load(x: Sequence[Any], positive: Positive) -> Any:
    """The load f = −Δu."""
    t, slope, curvature = _level(x)
    square = sum(s * s for s in slope)
    first = 3 * curvature * (positive(t) ** 2 + x[-1] * positive(-t) ** 2)
    return -6 * square * (positive(t) - x[-1] * positive(-t)) - first


def _level(x: Sequence[Any]) -> tuple[Any, tuple[Any, ...], float]:
    """t, its gradient in the plane of Γ_S, its Laplacian there."""
    if len(x) == 2:
        return x[0] - 0.413, (1.0,), 0.0
    return x[0] * x[0] + x[1] * x[1] - 0.49, (2 * x[0], 2 * x[1]), 4.0
