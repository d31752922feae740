"""The table of an elastic solution: what there is at the vertices of the facets of Γ_C."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.contact.laws import Friction
from signorini_fenicsx.discrete.site_table import SiteTable, along_parts
from signorini_fenicsx.physics.elasticity.spaces import BoundaryFacets
from signorini_fenicsx.solving.solved import Columns

if TYPE_CHECKING:  # a solution has this table
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

STATES = (*Friction.segments, "open")
"""The states of a vertex with friction."""


@dataclass(frozen=True)
class ContactTable(SiteTable):
    """One row per vertex of each facet of Γ_C.

    Attributes:
        facet: Midpoint of the facet, shape (rows, 3).
        pressure: −σ_nn.
        gap: g − u_n, linear on the facet.
        touching: Whether it is in contact.
        shear: σ_t, NaN without friction.
        slip: u_t likewise.
        state: Index into `STATES`, −1 without friction.
        forward: 1 where the coordinate along the part grows along the tangent, −1 where it falls; 0 in space.
    """

    facet: Array
    pressure: Array
    gap: Array
    touching: Mask
    shear: Array
    slip: Array
    state: npt.NDArray[np.int64]
    forward: npt.NDArray[np.int64]
    name = "contact"
    places = ("along", "x", "facet")


def contact_table(solution: ElasticSolution) -> ContactTable:
    """The vertices of the facets of Γ_C of this rank."""
    spaces = solution.spaces
    contact, dim = spaces.contact, spaces.dim
    x = np.pad(contact.vertices, ((0, 0), (0, 0), (0, 3 - dim)))
    part, places = np.repeat(spaces.part_of_facet, dim).astype(np.int64), x.reshape(-1, 3)
    along = along_parts(spaces, part, places)
    shear, slip, state = (values.ravel() for values in solution.on_all_contact())
    return ContactTable(
        part=part,
        along=along,
        x=places,
        facet=np.repeat(np.sort(x, axis=1).mean(axis=1), dim, axis=0),
        pressure=solution.pressure.ravel(),
        gap=solution.linear_gap.ravel(),
        touching=solution.touching.ravel(),
        shear=shear,
        slip=slip,
        state=np.nan_to_num(state, nan=-1.0).astype(np.int64),
        forward=np.repeat(_forward(contact, along), dim),
    )


def contact_columns(solution: ElasticSolution, table: ContactTable) -> Columns:
    """The columns of `contact.csv`."""
    columns: dict[str, npt.NDArray] = {
        "part": np.array(solution.contact_parts)[table.part],
        **dict(zip("xyz", table.x.T, strict=True)),
        "pressure": table.pressure,
        "gap": table.gap,
        "condition": np.where(table.touching, "contact", "open"),
    }
    if solution.data.friction is None:
        return columns
    states = np.array(STATES)[table.state]
    for name, values in {"shear": table.shear, "slip": table.slip, "friction": states}.items():
        columns[name] = values.astype(object)
        columns[name][table.state < 0] = None
    return columns


def _forward(contact: BoundaryFacets, along: Array) -> npt.NDArray[np.int64]:
    """The sign with which the coordinate along the part grows along the tangent of each facet; 0 in space."""
    if contact.vertices.shape[2] == 3:
        return np.zeros(len(contact.facets), dtype=np.int64)
    tangents = np.column_stack([-contact.normals[:, 1], contact.normals[:, 0]])
    edges = np.einsum("ni,ni->n", contact.vertices[:, 1] - contact.vertices[:, 0], tangents)
    return np.sign(edges * np.diff(along.reshape(-1, 2), axis=1)[:, 0]).astype(np.int64)
