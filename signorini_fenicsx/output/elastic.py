"""Writes an elastic solution: summary, tables, pictures, fields for ParaView."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.parallel import gather_rows, on_root
from signorini_fenicsx.base.rows import in_digits
from signorini_fenicsx.certificate.certify import Certificate
from signorini_fenicsx.output.elastic_body import gather_body
from signorini_fenicsx.output.tables import write_by_rank, write_columns
from signorini_fenicsx.physics.elasticity.solution import STATES, ElasticSolution
from signorini_fenicsx.physics.elasticity.spaces import BoundaryFacets


@dataclass(frozen=True)
class ContactTable:
    """One row per vertex of each facet of Γ_C, by part and along it.

    Attributes:
        part: Index into the parts of Γ_C.
        along: Coordinate along the part.
        x: Shape (rows, 3).
        facet: Midpoint of the facet, shape (rows, 3).
        pressure: −σ_nn.
        gap: g − u_n, linear on the facet.
        touching: Whether it is in contact.
        shear: σ_t, NaN without friction.
        slip: u_t likewise.
        state: Index into `STATES`, −1 without friction.
        forward: 1 where the coordinate along the part grows along the tangent, −1 where it falls; 0 in space.
    """

    part: npt.NDArray[np.int64]
    along: Array
    x: Array
    facet: Array
    pressure: Array
    gap: Array
    touching: Mask
    shear: Array
    slip: Array
    state: npt.NDArray[np.int64]
    forward: npt.NDArray[np.int64]


def write_table_of_contact(folder: Path, solution: ElasticSolution) -> None:
    """Write `contact.csv`; for a large Γ_C `contact/<rank>.parquet` with the facets of each rank instead (collective).

    Raises:
        OSError: On all ranks, if the disk is full.
    """
    comm, parts = solution.spaces.mesh.comm, solution.contact_parts
    friction = solution.data.friction is not None
    if solution.spaces.Lambda.dofmap.index_map.size_global <= solution.options.tuning.one_table_up_to:
        table = contact_table(solution)
        columns = {} if table is None else contact_columns(parts, table, friction=friction)
        on_root(comm, lambda: write_columns(folder / "contact.csv", columns))
        return
    own = _in_order(_contact_rows(solution))
    write_by_rank(comm, folder / "contact", lambda: contact_columns(parts, own, friction=friction))


def draw(folder: Path, solution: ElasticSolution, certificate: Certificate | None) -> None:
    """Draw an elastic solution on rank 0 (collective)."""
    table = contact_table(solution)
    body = gather_body(solution, None if certificate is None else certificate.indicator)

    def write() -> None:
        if table is not None and body is not None:
            from signorini_fenicsx.output.pictures import elastic  # costs a second, only where it is needed

            elastic.draw(folder, solution, table, body, certificate)

    on_root(solution.spaces.mesh.comm, write)


def contact_columns(parts: Sequence[str], table: ContactTable, *, friction: bool) -> dict[str, npt.NDArray]:
    """The columns of the table of Γ_C that is written."""
    columns: dict[str, npt.NDArray] = {
        "part": np.array(parts)[table.part],
        **dict(zip("xyz", table.x.T, strict=True)),
        "pressure": table.pressure,
        "gap": table.gap,
        "condition": np.where(table.touching, "contact", "open"),
    }
    if not friction:
        return columns
    states = np.array(STATES)[table.state]
    for name, values in {"shear": table.shear, "slip": table.slip, "friction": states}.items():
        columns[name] = values.astype(object)
        columns[name][table.state < 0] = None
    return columns


def contact_table(solution: ElasticSolution) -> ContactTable | None:
    """Collect the vertices of the facets of Γ_C on rank 0; None elsewhere (collective)."""
    rows = gather_rows(solution.spaces.mesh.comm, _contact_rows(solution))
    return None if rows is None else _in_order(rows)


def _contact_rows(solution: ElasticSolution) -> Array:
    """The columns of a `ContactTable` for the facets of this rank, shape (rows, 15)."""
    spaces = solution.spaces
    contact, dim = spaces.contact, spaces.dim
    x = np.pad(contact.vertices, ((0, 0), (0, 0), (0, 3 - dim)))
    part = np.repeat(spaces.part_of_facet, dim)
    along = np.empty(len(part))
    flat = x.reshape(-1, 3)
    for index, name in enumerate(spaces.part_names):
        along[part == index] = spaces.domain.parts[name].along(flat[part == index].T)
    middle = np.broadcast_to(np.sort(x, axis=1).mean(axis=1, keepdims=True), x.shape).reshape(-1, 3)
    values = [solution.pressure.ravel(), solution.linear_gap.ravel(), solution.touching.ravel()]
    values += [values.ravel() for values in solution.on_all_contact()]
    return np.column_stack([part, along, flat, middle, *values, np.repeat(_forward(contact, along), dim)])


def _forward(contact: BoundaryFacets, along: Array) -> Array:
    """The sign with which the coordinate along the part grows along the tangent of each facet; 0 in space."""
    if contact.vertices.shape[2] == 3:
        return np.zeros(len(contact.facets))
    tangents = np.column_stack([-contact.normals[:, 1], contact.normals[:, 0]])
    edges = np.einsum("ni,ni->n", contact.vertices[:, 1] - contact.vertices[:, 0], tangents)
    return np.sign(edges * np.diff(along.reshape(-1, 2), axis=1)[:, 0])


def _in_order(rows: Array) -> ContactTable:
    along, *places = in_digits(rows[:, 1:8]).T
    rows = rows[np.lexsort((*places[::-1], along, rows[:, 0]))]
    return ContactTable(
        part=rows[:, 0].astype(np.int64),
        along=rows[:, 1],
        x=rows[:, 2:5],
        facet=rows[:, 5:8],
        pressure=rows[:, 8],
        gap=rows[:, 9],
        touching=rows[:, 10] > 0,
        shear=rows[:, 11],
        slip=rows[:, 12],
        state=np.nan_to_num(rows[:, 13], nan=-1.0).astype(np.int64),
        forward=rows[:, 14].astype(np.int64),
    )
