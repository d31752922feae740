"""What an engineer reads off an elastic solution: largest values with their places, contact by part, the balance."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.parallel import gather_rows, on_root
from signorini_fenicsx.base.tolerances import TIE
from signorini_fenicsx.discrete.site_table import along_parts
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import split_vertices
from signorini_fenicsx.physics.elasticity.show.shown import in_space
from signorini_fenicsx.solving.fields import von_mises

if TYPE_CHECKING:  # it has these
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

SAME = 1e-9
"""Values that differ by less than this share of the largest are equal; of their places the first one is told."""
PRESSED = 1e-9
"""A facet whose mean pressure is more than this share of the largest pressure is in contact."""


def quantities(solution: ElasticSolution) -> dict[str, Any]:
    """The numbers of `quantities` in the summary (collective).

    The von Mises stress and |u| are convex in fields that are linear on simplices, and the pressure is linear on
    facets: they are largest at vertices.
    """
    spaces, data = solution.spaces, solution.data
    comm, dim = spaces.mesh.comm, spaces.dim
    stress = von_mises(in_space(spaces, data, solution.stresses)).ravel()
    size = np.linalg.norm(spaces.displacement_values(solution.u), axis=2).ravel()
    rounding = TIE * comm.allreduce(float(np.abs(solution.stresses).max(initial=0.0)), MPI.MAX)
    pressure = np.where(np.abs(solution.pressure) > rounding, solution.pressure, 0.0)
    return {
        "von_mises": largest_of(comm, stress, split_vertices(spaces.vertices).reshape(-1, dim)),
        "displacement": largest_of(comm, size, spaces.vertices.reshape(-1, dim)),
        "balance": solution.balance[1],
        "contact": {name: _of_part(solution, index, pressure) for index, name in enumerate(spaces.part_names)},
    } | ({"tools": {tool.part: tool.motion() for tool in data.tools}} if data.tools else {})


def largest_of(comm: MPI.Comm, values: Array, places: Array) -> dict[str, Any]:
    """The largest value and where it is: {} if there is none (collective)."""
    largest = comm.allreduce(float(values.max(initial=-np.inf)), MPI.MAX)
    near = places[values >= largest - SAME * abs(largest)] if np.isfinite(largest) else places[:0]
    first = min((min(each) for each in comm.allgather([tuple(x) for x in near.tolist()]) if each), default=None)
    return {} if first is None else {"largest": largest, "at": list(first)}


def _of_part(solution: ElasticSolution, part: int, pressures: Array) -> dict[str, Any]:
    """Pressure and area of a part of Γ_C, from the pressures at the vertices of all facets (collective)."""
    spaces = solution.spaces
    comm, dim = spaces.mesh.comm, spaces.dim
    rows = np.flatnonzero(spaces.part_of_facet == part)
    contact, pressure = spaces.contact.take(rows), pressures[rows]
    weights = contact.of_linear(pressure)  # ∫ pφ_a
    moments = np.einsum("na,nai->i", weights, contact.vertices)
    area = solution.touching[rows].sum(axis=1) @ contact.measure / dim
    *center, force, area = comm.allreduce(np.array([*moments, weights.sum(), area])).tolist()
    peak = largest_of(comm, pressure.ravel(), contact.vertices.reshape(-1, dim))
    numbers = {"peak_pressure": peak, "area": area, "pressure_force": force}
    if force > PRESSED * abs(peak["largest"]) * comm.allreduce(float(contact.measure.sum())):
        numbers["center_of_pressure"] = [x / force for x in center]
    if dim == 2:
        x = np.pad(contact.vertices.mean(axis=1), ((0, 0), (0, 1)))
        along = along_parts(spaces, np.full(len(rows), part), x)
        table = np.column_stack([along, contact.measure, pressure.mean(axis=1), contact.vertices.reshape(-1, 4)])
        gathered = gather_rows(comm, table)
        numbers["width"] = on_root(comm, partial(_width, gathered))
    return numbers


def _width(facets: Array | None) -> float:
    """The length in contact of a part in the plane.

    Args:
        facets: Rows of coordinate along the part, length, mean pressure, and both ends.
    """
    assert facets is not None
    facets = facets[np.lexsort(facets.T[::-1])]  # in order along the part
    _, length, pressure, *_ = facets.T
    ends = facets[:, 3:].reshape(-1, 2, 2)
    apart = np.linalg.norm(ends[:-1, :, None] - ends[1:, None], axis=3).min(axis=(1, 2))
    joined = apart <= SAME * np.minimum(length[:-1], length[1:])
    runs = np.split(np.arange(len(length)), np.flatnonzero(~joined) + 1)
    pressed = pressure > PRESSED * pressure.max(initial=0.0)
    return float(sum(_of_run(length[run], (pressure * length)[run], pressed[run]) for run in runs))


def _of_run(length: Array, force: Array, pressed: Mask) -> float:
    """The length in contact of facets that meet one after another.

    Where contact ends inside of the part the pressure falls like the root of the distance from its end, and the forces
    on the last two facets in contact tell this distance. Where the pressure rises, as at a punch, they do not: then
    contact ends with its last facet.
    """
    total = float(length[pressed].sum())
    changes = np.flatnonzero(pressed[1:] != pressed[:-1])
    for last, before, after in ((k, k - 1, k + 1) if pressed[k] else (k + 1, k + 2, k) for k in changes):
        if not 0 <= before < len(length) or not pressed[before]:
            continue
        ratio = (1 + force[before] / force[last]) ** (2 / 3)  # of the distances of the ends of both
        if ratio > 1 + length[before] / (length[last] + length[after]):
            total += length[before] / (ratio - 1) - length[last]
    return total
