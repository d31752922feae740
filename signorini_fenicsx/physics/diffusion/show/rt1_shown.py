"""What is shown of a solution with RT1: fields and tables by vertices of cells and facets, beside `shown.py`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import cells_behind
from signorini_fenicsx.physics.diffusion.show.shown import (
    CONDITIONS,
    GammaTable,
    of_facets,
)
from signorini_fenicsx.physics.diffusion.show.shown import other_tables as shown_tables
from signorini_fenicsx.pictures.gather import Known, whole_boundary
from signorini_fenicsx.solving.solved import Columns

if TYPE_CHECKING:  # it shows this
    from signorini_fenicsx.physics.diffusion.rt1_solution import RT1Solution


@dataclass(frozen=True)
class VertexTable(GammaTable):
    """One row per facet of Γ_S, with means over it, and what there is at its vertices.

    Attributes:
        means_at: The means of p_h by the hats, shape (facets, d).
        p_at: p_h.
        flux_at: σ_h·n.
        condition_at: The condition of the vertex.
        segment_at: Its segment, an index into the names of the segments of all laws.
        x_at: The vertices, shape (facets, d, 3).
    """

    means_at: Array
    p_at: Array
    flux_at: Array
    condition_at: npt.NDArray[np.int64]
    segment_at: Indices
    x_at: Array


def table(solution: RT1Solution) -> VertexTable:
    """The Γ_S facets of this rank, in their order on it; vertices have the original numbers of the mesh."""
    spaces, data, kind = solution.spaces, solution.data, solution.spaces.site_kinds["facet"]
    condition = kind.rows_of(solution.outcome.conditions.kind).astype(np.int64)
    segment = data.laws.labels(kind.rows_of(solution.segments().segment))
    strongest = np.argmax(condition, axis=1)[:, None]
    u = solution.u_means[spaces.cells]
    u[spaces.inner.rows] -= solution.u_means[spaces.across.cells]
    for pair in spaces.pairs:
        of_masters = np.repeat(solution.u_means[cells_behind(spaces.mesh, pair.masters), None], spaces.dim, axis=1)
        if not pair.parts.tied:
            u[spaces.rows_of(pair)] -= pair.opposite(spaces.mesh.comm, of_masters).mean(axis=1)
    return VertexTable(
        **of_facets(solution),
        u=u,
        p=solution.p_means,
        flux=solution.flux_at.mean(axis=1),
        condition=np.take_along_axis(condition, strongest, axis=1)[:, 0],
        segment=np.take_along_axis(segment, strongest, axis=1)[:, 0],
        means_at=kind.rows_of(solution.iterate.means),
        p_at=solution.p_at,
        flux_at=solution.flux_at,
        condition_at=condition,
        segment_at=segment,
        x_at=np.pad(spaces.contact.vertices, ((0, 0), (0, 0), (0, 3 - spaces.dim))),
    )


def other_tables(solution: RT1Solution) -> dict[str, Columns]:
    """`vertices.csv`: the vertices of the facets of Γ_S, facet by facet as in `facets.csv`; and that of `shown`.

    Collective.
    """
    spaces, laws, tables = solution.spaces, solution.data.laws, shown_tables(solution)
    rows = table(solution).gathered(spaces.mesh.comm)
    if rows is None or not spaces.part_names:
        return tables | ({"vertices": {}} if spaces.part_names else {})  # the name is known on all ranks
    dim = spaces.dim
    return tables | {
        "vertices": {
            "part": np.repeat(np.array(spaces.part_names)[rows.part], dim),
            "facet": np.repeat(np.arange(len(rows.part)), dim),
            **dict(zip("xyz", rows.x_at.reshape(-1, 3).T, strict=True)),
            "measure": np.repeat(rows.measure / dim, dim),
            "p": rows.p_at.ravel(),
            "flux": rows.flux_at.ravel(),
            "condition": np.array(CONDITIONS)[rows.condition_at.ravel()],
            **({"segment": np.array(laws.names())[rows.segment_at.ravel()]} if laws.listed else {}),
        }
    }


def traces(solution: RT1Solution) -> dict[int, Known]:
    """The facets of each kind of boundary, see `shown.traces`."""
    spaces, p = solution.spaces, solution.p_means.copy()
    p[np.setdiff1d(np.arange(len(p)), spaces.outer_rows)] = np.nan
    u_D = solution.data.lift[spaces.unknowns(spaces.dirichlet)].mean(axis=1)
    return whole_boundary(spaces, signorini=p, dirichlet=u_D)
