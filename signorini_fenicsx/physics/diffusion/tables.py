"""The tables of a solution of a diffusion problem."""

from __future__ import annotations

from typing import TYPE_CHECKING

import dolfinx.mesh
import numpy as np

from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.base.rows import in_digits
from signorini_fenicsx.contact.conditions import Condition
from signorini_fenicsx.discrete.site_table import FacetTable, along_parts
from signorini_fenicsx.meshes.domain import cells_behind, facet_vertices
from signorini_fenicsx.solving.solved import Columns

if TYPE_CHECKING:  # a solution has these tables
    from signorini_fenicsx.physics.diffusion.solution import Solution


def facet_table(solution: Solution) -> FacetTable:
    """The Γ_S facets of this rank, in their order on it; vertices have the original numbers of the mesh."""
    spaces = solution.spaces
    part = spaces.part_of_facet.astype(np.int64)
    size, u = len(spaces.facets), solution.u.x.array[spaces.cells]
    u[spaces.inner.rows] -= solution.u.x.array[cells_behind(spaces.mesh, spaces.inner.facets)]
    midpoints = dolfinx.mesh.compute_midpoints(spaces.mesh, spaces.mesh.topology.dim - 1, spaces.facets).reshape(-1, 3)
    return FacetTable(
        part=part,
        along=along_parts(spaces, part, midpoints),
        x=midpoints,
        measure=spaces.facet_measure,
        u=u,
        p=solution.p.x.array[:size],
        flux=spaces.normal_flux(solution.sigma),
        psi=solution.data.psi_h,
        q_S=solution.data.q_Sh,
        condition=solution.outcome.conditions.kind.astype(np.int64),
        segment=solution.data.laws.labels(solution.segments().segment),
        vertices=facet_vertices(spaces.mesh, spaces.facets),
    )


def facet_columns(solution: Solution, table: FacetTable) -> Columns:
    """The columns of `facets.csv`; `segment` is among them if there are other laws than Signorini's."""
    laws = solution.data.laws
    return {
        "part": np.array(solution.spaces.part_names)[table.part],
        **dict(zip("xyz", table.x.T, strict=True)),
        **{key: getattr(table, key) for key in ("measure", "p", "flux")},
        "condition": np.array([condition.name.lower() for condition in Condition])[table.condition],
        **({"segment": np.array(laws.names())[table.segment]} if laws.listed else {}),
    }


def free_boundary(solution: Solution) -> Columns:
    """Midpoint and measure of each facet between a cell in contact with the obstacle and another, on rank 0."""
    spaces, space = solution.spaces, solution.spaces.crouzeix_raviart
    mesh, dofs, dim = spaces.mesh, solution.free_boundary(), spaces.mesh.topology.dim
    mesh.topology.create_connectivity(dim, dim - 1)
    of_dof = np.empty(space.dofmap.index_map.size_local + space.dofmap.index_map.num_ghosts, dtype=np.int32)
    of_dof[space.dofmap.list.ravel()] = mesh.topology.connectivity(dim, dim - 1).array
    corners = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, dim - 1, of_dof[dofs])].reshape(-1, dim, 3)
    edges = corners[:, 1:] - corners[:, :1]
    measure = np.sqrt(np.linalg.det(edges @ edges.transpose(0, 2, 1))) / (dim - 1)
    rows = gather_rows(mesh.comm, np.column_stack([corners.mean(axis=1), measure]))
    if rows is None:
        return {}
    in_order = rows[np.lexsort(in_digits(rows[:, :3]).T[::-1])]
    return dict(zip(("x", "y", "z", "measure"), in_order.T, strict=True))
