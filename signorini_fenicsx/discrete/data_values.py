"""Values of the data over all ranks: their extent, their sum, and checks that they are finite and of usable size."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.spaces import Spaces, cells_and_dofs

DATA_RANGE = 1e-100, 1e100
ROUNDING = 1e-12
"""Relative size of a sum of loads that counts as rounding."""


def check_nodes(spaces: Spaces, name: str, value: Expr, facets: npt.NDArray[np.int32], where: str) -> None:
    """Make sure that continuous data are finite at the vertices and edge midpoints of these facets (collective).

    Raises:
        InputError: If they are not.
    """
    mesh = spaces.mesh
    space = fem.functionspace(mesh, ("P", 2))
    nodes = fem.locate_dofs_topological(space, mesh.topology.dim - 1, facets)
    cells = np.unique(cells_and_dofs(spaces.V, facets)[0])
    function = fem.Function(space)
    function.interpolate(fem.Expression(value, space.element.interpolation_points), cells)
    if not mesh.comm.allreduce(bool(np.isfinite(function.x.array[nodes]).all()), op=MPI.LAND):
        raise InputError(f"[problem] {name}: not finite everywhere {where}")


def check_means(name: str, where: str, means: Array, spaces: Spaces) -> None:
    """Make sure that means are finite, and neither too large nor too small (collective).

    Raises:
        InputError: If they are not.
    """
    comm = spaces.mesh.comm
    if not comm.allreduce(bool(np.isfinite(means).all()), op=MPI.LAND):
        raise InputError(f"[problem] {name}: not finite everywhere {where}")
    largest = comm.allreduce(float(np.abs(means).max(initial=0.0)), MPI.MAX)
    low, high = DATA_RANGE
    if largest != 0 and not low <= largest <= high:
        raise InputError(f"[problem] {name}: its largest value, {largest:.1e}, is outside {low:g} … {high:g}; scale it")


def extent(values: Array, comm: MPI.Comm) -> tuple[float, float]:
    """The smallest and the largest value over all ranks (collective)."""
    ends = np.array([-values.min(initial=np.inf), values.max(initial=-np.inf)])
    comm.Allreduce(MPI.IN_PLACE, ends, MPI.MAX)
    return -float(ends[0]), float(ends[1])


def total(loads: Array, comm: MPI.Comm) -> float:
    """The sum of the loads of all ranks, 0 if it is only rounding (collective)."""
    total, size = comm.allreduce(np.array([loads.sum(), np.abs(loads).sum()])).tolist()
    return 0.0 if abs(total) <= ROUNDING * size < np.inf else total
