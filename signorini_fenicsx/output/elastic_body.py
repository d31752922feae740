"""An elastic solution as plain arrays on rank 0, for pictures."""

from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.discrete.mesh_spaces import DIRICHLET, NEUMANN, SIGNORINI
from signorini_fenicsx.meshes.domain import facet_vertices
from signorini_fenicsx.output.gather import PARTLY_FIXED, Boundary, FacetTable, Fields, sample_of
from signorini_fenicsx.physics.elasticity.fields import in_space, von_mises
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution


@dataclass(frozen=True)
class Body:
    """What pictures show of an elastic solution, in the form that scalar solutions have (rank 0).

    Attributes:
        fields: Mesh and cell values: for σ the largest von Mises stress, shape (cells, 1), and for u |u|.
        facets: Γ_C: for p the mean gap, for σ·n the mean pressure.
        boundary: The whole boundary.
        displacement: u at the vertices, the mean over the cells around, shape (points, d).
        normals: The outer unit normals of Γ_C, shape (facets, d).
        gaps: The gap at the vertices of each facet of Γ_C, linear on it, shape (facets, d).
    """

    fields: Fields
    facets: FacetTable
    boundary: Boundary
    displacement: Array
    normals: Array
    gaps: Array


def gather_body(solution: ElasticSolution, indicator: fem.Function | None = None) -> Body | None:
    """Collect an elastic solution on rank 0; None elsewhere (collective)."""
    spaces = solution.spaces
    dim, sample = spaces.dim, sample_of(spaces)
    stress = von_mises(in_space(solution)).max(axis=(1, 2))
    by_geometry = np.argsort(spaces.order, axis=1)[:, :, None]
    u = np.take_along_axis(spaces.displacement_values(solution.u), by_geometry, axis=1)
    at_points = sample.at_points(np.concatenate([u, np.repeat(stress[:, None, None], dim + 1, axis=1)], axis=2))
    in_cells = sample.in_cells(stress)
    eta = None if indicator is None else sample.in_cells(indicator.x.array)
    (facets, normals, gaps), boundary = _facets(solution), _boundary(solution)
    if at_points is None or in_cells is None or facets is None or boundary is None:
        return None
    fields = Fields(
        ids=sample.ids,
        points=sample.points,
        cells=sample.cells,
        u=np.linalg.norm(at_points[:, :dim], axis=1),
        sigma_at_points=at_points[:, dim:],
        sigma=in_cells[:, None],
        divergence=np.zeros(len(in_cells)),
        of=sample.of,
        indicator=eta,
    )
    facets.vertices[:] = sample.rows_of(facets.vertices)
    boundary.vertices[:] = sample.rows_of(boundary.vertices)
    return Body(fields, facets, boundary, at_points[:, :dim], normals, gaps)


def _facets(solution: ElasticSolution) -> tuple[FacetTable | None, Array, Array]:
    spaces = solution.spaces
    contact, dim = spaces.contact, spaces.dim
    middle = np.pad(contact.vertices.mean(axis=1), ((0, 0), (0, 3 - dim)))
    along = np.empty(len(middle))
    for index, name in enumerate(spaces.part_names):
        mine = spaces.part_of_facet == index
        along[mine] = spaces.domain.parts[name].along(middle[mine].T)
    columns: list[np.ndarray] = [
        spaces.part_of_facet,
        along,
        middle,
        contact.measure,
        solution.gap.mean(axis=1),
        solution.pressure.mean(axis=1),
        solution.contact_set().inside,
        contact.normals,
        solution.linear_gap,
        facet_vertices(spaces.mesh, contact.facets),
    ]
    rows = gather_rows(spaces.mesh.comm, np.column_stack(columns))
    if rows is None:
        return None, contact.normals, solution.linear_gap
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    none = np.zeros(len(rows))
    table = FacetTable(
        part=rows[:, 0].astype(np.int64),
        x=rows[:, 2:5],
        along=rows[:, 1],
        measure=rows[:, 5],
        u=none,
        p=rows[:, 6],
        flux=rows[:, 7],
        psi=none,
        q_S=none,
        condition=rows[:, 8].astype(np.int64),
        segment=none.astype(np.int64),
        vertices=rows[:, 9 + 2 * dim :].astype(np.int64),
    )
    return table, rows[:, 9 : 9 + dim], rows[:, 9 + dim : 9 + 2 * dim]


def _boundary(solution: ElasticSolution) -> Boundary | None:
    spaces = solution.spaces
    none = np.empty(0, dtype=np.int32)
    fixed = np.concatenate([none, *(spaces.domain.facets[part] for part in solution.boundary.fixed)])
    free = np.setdiff1d(spaces.neumann_facets, fixed)
    kinds = {SIGNORINI: spaces.facets, DIRICHLET: spaces.dirichlet_facets, NEUMANN: free, PARTLY_FIXED: fixed}
    columns = [
        np.column_stack([np.full(len(facets), kind), facet_vertices(spaces.mesh, facets)])
        for kind, facets in kinds.items()
    ]
    rows = gather_rows(spaces.mesh.comm, np.concatenate(columns))
    if rows is None:
        return None
    return Boundary(rows[:, 0].astype(np.int64), np.full(len(rows), np.nan), rows[:, 1:].astype(np.int64))
