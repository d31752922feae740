"""Water above the water table: which share of a discharge passes where the pressure is negative.

The laws `seepage` and `river` are those of groundwater, with the head or the pressure head as u and Darcy's velocity
−σ. All soil is taken for saturated, although soil with a negative pressure lets through much less. A cell is above the
water table if its pressure is negative: the mean of u_h, less the height of its centroid if u is a head.

The *share* of a discharge through some facets is that of the water which has passed such cells, if water follows −σ_h
and mixes in each cell. So c = 1 in the cells above the table, and in others c is the mean over what flows in, with 0
for what comes from the boundary or from sources; the share is the mean of c over what leaves through the facets. Where
water enters through them the same is done with the way turned round, for what it is going to pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.owned import cell_dofs, owned_cells, sums_at
from signorini_fenicsx.base.tolerances import LINEAR, ROUNDING
from signorini_fenicsx.contact.laws import River, Seepage
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.points import in_facets
from signorini_fenicsx.linear.petsc import direct_solver
from signorini_fenicsx.meshes.domain import other_side
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import means_in_cells
from signorini_fenicsx.physics.diffusion.show.heads import INTEGRAL
from signorini_fenicsx.quantities.bracket import PASSES

if TYPE_CHECKING:  # it has these
    from signorini_fenicsx.physics.diffusion.solution import Solution

LESS = 1 - 1e-12
"""What is left of c from cell to cell, so that water that goes round and round has c = 0."""


def discharges(solution: Solution) -> dict[str, dict[str, float]]:
    """What flows in through each part of the boundary, see `heads`; nothing if u is nothing of water (collective).

    Of parts with a law of groundwater in saturated soil also the share above the water table.
    """
    water, boundary = solution.water_kind, solution.boundary
    if water is None or water.u == INTEGRAL:
        return {}
    inside = {*boundary.inner, *map(other_side, boundary.inner)}
    inside |= {part for pair in boundary.pairs for part in (*pair.slave, *pair.master)}
    parts = [part for part in solution.spaces.domain.facets if part not in inside]
    inflows = {part: water.inflow * solution.flux_through(part) for part in parts}
    rounding = LINEAR * max(map(abs, inflows.values()), default=0.0)
    found = {part: {"inflow": each if abs(each) > rounding else 0.0} for part, each in inflows.items()}
    for part in _parts_of_water(solution):
        found[part]["above_table"] = share_above_table(solution, [part]) or 0.0
    return found


def balance(solution: Solution) -> dict[str, float]:
    """What flows in through all of the boundary, comes from sources less what is stored, and what is left (collective).

    What is left is rounding.
    """
    assert solution.water_kind is not None
    sign, spaces = solution.water_kind.inflow, solution.spaces
    cells = solution.data.mean_sources(spaces, solution.u) + means_in_cells(solution.force())
    inflow = sign * solution.flux_through()
    from_sources = sign * spaces.mesh.comm.allreduce(float(spaces.cell_measures @ cells))
    return {"inflow": inflow, "sources": from_sources, "left": inflow + from_sources}


def of_step(solution: Solution) -> dict[str, float]:
    """The columns of `steps.csv` of water: what flows in through each part, and what is left of the balance."""
    if not solution.water:
        return {}
    inflows = {f"inflow {part}": about["inflow"] for part, about in solution.water.items()}
    return inflows | {"balance": balance(solution)["left"]}


def in_words(found: Mapping[str, Mapping[str, float]]) -> list[str]:
    """What `discharges` found as sentences."""
    return [
        f"through '{part}' {abs(about['inflow']):.4g} flow {'in' if about['inflow'] > 0 else 'out'}, "
        f"{100 * about['above_table']:.3g} % of it {PASSES}"
        for part, about in found.items()
        if about.get("above_table", 0.0) > 0
    ]


def _parts_of_water(solution: Solution) -> list[str]:
    """The parts with the laws of groundwater from which the pressure is known; none in other problems."""
    laws = [part for part in solution.data.laws.of_parts if isinstance(part.law, Seepage | River)]
    if solution.data.quasilinear is not None:  # soil is not taken for saturated
        return []
    levels = [part.data["level"].number for part in laws if isinstance(part.law, Seepage)]
    if solution.boundary.inner or any(level not in (None, 0.0) for level in levels):  # what else may be u
        return []
    return [name for part in laws for name in part.law.parts]


def _above_table(solution: Solution) -> Mask:
    """The owned cells with a negative pressure: u is the pressure head if all seepage faces have the level 0."""
    spaces, laws = solution.spaces, solution.data.laws.of_parts
    is_pressure = all(isinstance(part.law, Seepage) and part.data["level"].number == 0 for part in laws)
    height = corners(spaces.mesh, owned_cells(spaces.mesh)).mean(axis=1)[:, -1]
    return np.asarray(solution.u_means < (0.0 if is_pressure else height))


def share_above_table(solution: Solution, parts: Sequence[str]) -> float | None:
    """The share of the discharge through parts that passes cells above the water table (collective).

    None in problems that are none of groundwater.
    """
    if not _parts_of_water(solution):
        return None
    spaces, comm = solution.spaces, solution.spaces.mesh.comm
    facets = np.unique(np.concatenate([spaces.domain.facets[part] for part in parts])).astype(np.int32)
    on = in_facets(spaces.mesh, facets, np.full((1, spaces.mesh.topology.dim - 1), 1 / spaces.mesh.topology.dim))
    leaving = -solution.cell_flux.leaving
    way = 1.0 if comm.allreduce(float(leaving[on.cells, on.local].sum())) >= 0 else -1.0
    passed = np.maximum(way * leaving[on.cells, on.local], 0.0)
    c = _passed(solution, way * leaving)
    sums = np.array([passed @ c[on.cells], passed.sum(), np.abs(leaving).sum()])
    share, total, everywhere = comm.allreduce(sums).tolist()
    return share / total if total > ROUNDING * everywhere else 0.0


def _passed(solution: Solution, leaving: Array) -> Array:
    """C of each owned cell (collective)."""
    spaces, dry = solution.spaces, _above_table(solution)
    space, numbers = spaces.crouzeix_raviart, spaces.Q.dofmap.index_map
    first, size = numbers.local_range[0], len(leaving)
    ids = first + np.arange(size)
    dofs = cell_dofs(space)
    sums = sums_at(space.dofmap.index_map, dofs, np.column_stack([ids, np.ones(size)])[:, None])[dofs]
    entering = np.where(sums[:, :, 1] > 1, np.maximum(-leaving, 0.0), 0.0)
    through = np.maximum(np.maximum(leaving, 0.0).sum(axis=1), np.maximum(-leaving, 0.0).sum(axis=1))
    shares = np.where(dry[:, None] | (entering == 0), 0.0, entering / np.where(through > 0, through, 1.0)[:, None])
    columns = np.column_stack([ids, sums[:, :, 0] - ids[:, None]]).astype(PETSc.IntType)
    values = np.column_stack([np.ones(size), -LESS * shares])
    kept = values != 0
    csr = np.append(0, np.cumsum(kept.sum(axis=1))).astype(PETSc.IntType), columns[kept], values[kept]
    matrix = PETSc.Mat().createAIJ([[size, numbers.size_global]] * 2, csr=csr, comm=spaces.mesh.comm)
    c, wanted = matrix.createVecs()
    wanted.array_w[:] = dry
    solver = direct_solver(matrix, "lu", "water_")
    solver.solve(wanted, c)
    of_cells = c.array_r.copy()
    for each in (c, wanted, matrix):
        each.destroy()
    return of_cells
