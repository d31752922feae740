"""Primal-dual active set, as users of a general finite element library would write it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

type Array = npt.NDArray[np.float64]


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
