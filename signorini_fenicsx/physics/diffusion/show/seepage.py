"""What Baiocchi's solution says of the seepage through a rectangular dam: phreatic line, separation height, discharge.

w(x, y) is the integral of the pressure from y up to the phreatic line, above which w = 0. So ∇w = 0 on this line, and
below it Δw = 1. On the downstream face, x = L, −∂w/∂x at height y is the water that leaves above y; it falls to 0 at
the separation point, where the phreatic line meets the face.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import dolfinx.mesh
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import cell_dofs, sums_at
from signorini_fenicsx.base.rows import in_digits
from signorini_fenicsx.discrete.points import in_facets

if TYPE_CHECKING:  # it has this
    from signorini_fenicsx.physics.diffusion.dam import Dam
    from signorini_fenicsx.physics.diffusion.solution import Solution

FEW = 3
"""Facets of the face from which the outflow is continued, in a straight line, to a point beside them."""


@dataclass(frozen=True)
class DamSeepage:
    """The seepage through a dam.

    Attributes:
        discharge: (H² − h²)/(2L), by Dupuit and Charny, per unit of width and of hydraulic conductivity.
        outflow: The same from the solution, −∂w/∂x at the foot of the downstream face.
        separation_height: Height of the separation point.
        phreatic_line: Points of the phreatic line, from upstream to downstream, shape (points, 2).
    """

    discharge: float
    outflow: float
    separation_height: float
    phreatic_line: Array

    def in_words(self) -> str:
        """All numbers of the seepage in words, for a report."""
        outflow = f"discharge {self.discharge:.6g} (outflow {self.outflow:.6g})"
        return f"separation height {self.separation_height:.6g}, {outflow}"

    def summary(self) -> dict[str, float]:
        """All numbers of the seepage, ready for JSON."""
        return {name: value for name, value in vars(self).items() if isinstance(value, float)}


def seepage(solution: Solution) -> DamSeepage | None:
    """The seepage of a solution of a case with [dam], None for other solutions; the same on all ranks (collective)."""
    dam: Dam | None = getattr(solution.source, "dam", None)
    if dam is None:
        return None
    height, outflow, is_open = _downstream(solution).T
    top, foot = np.flatnonzero(is_open)[-FEW:], slice(None, FEW)
    separation = float(np.polyfit(outflow[top], height[top], 1)[1]) if len(top) == FEW else float("nan")
    return DamSeepage(
        discharge=(dam.H**2 - dam.h**2) / (2 * dam.L),
        outflow=float(np.polyfit(height[foot], outflow[foot], 1)[1]) if len(height) >= FEW else float("nan"),
        separation_height=separation,
        phreatic_line=_phreatic_line(solution),
    )


def _downstream(solution: Solution) -> Array:
    """Height, −∂w/∂x and whether the cell behind is wet, for each facet of the face, from below (collective)."""
    spaces, contact = solution.spaces, solution.held_cells
    middle = in_facets(spaces.mesh, spaces.domain.facets["right"], np.array([[0.5]]))
    slope = solution.cell_flux.at(middle)[:, 0, 0]
    rows = np.column_stack([middle.x[:, 0, 1], -slope, ~contact[middle.cells]])
    rows = np.concatenate(spaces.mesh.comm.allgather(rows))
    return rows[np.argsort(rows[:, 0])]


def _phreatic_line(solution: Solution) -> Array:
    """One point for each wet cell beside a dry one (collective).

    Near the line w = d²/2 with the distance d from it. So ∇w has the length d and points away from the line, and x −
    ∇w(x) is on the line.
    """
    spaces, contact = solution.spaces, solution.held_cells
    space = spaces.crouzeix_raviart
    dofs = cell_dofs(space)
    dry = sums_at(space.dofmap.index_map, dofs[contact])
    beside = np.flatnonzero((dry[dofs] > 0).any(axis=1) & ~contact).astype(np.int32)
    centroids = dolfinx.mesh.compute_midpoints(spaces.mesh, 2, beside).reshape(-1, 3)[:, :2]
    points = centroids - solution.cell_flux.centroid[beside]
    points = np.concatenate(spaces.mesh.comm.allgather(points))
    return points[np.lexsort(in_digits(points).T[::-1])]
