"""Distributed solutions as plain arrays on rank 0, for tables and pictures."""

from dataclasses import dataclass

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.discrete.spaces import DIRICHLET, NEUMANN, SIGNORINI, cells_and_dofs
from signorini_fenicsx.meshes.domain import Domain, Marks, facet_vertices, membership
from signorini_fenicsx.solving.solution import Solution

TINY = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class FacetTable:
    """One row per Γ_S facet of all ranks, ordered by part and then along the part.

    Attributes:
        part: Index into the parts of Γ_S.
        x: Midpoints, shape (facets, 3).
        along: Coordinate along the part.
        measure: |e|.
        u: u_h in the cell behind the facet.
        p: Trace p_h.
        flux: σ_h·n.
        psi: Mean of ψ.
        q_S: Mean of q_S.
        condition: Final condition.
        segment: Final segment, a row of `BoundaryLaws.names`.
        vertices: Rows of `Fields.points`, ascending, shape (facets, dim).
    """

    part: Indices
    x: Array
    along: Array
    measure: Array
    u: Array
    p: Array
    flux: Array
    psi: Array
    q_S: Array
    condition: npt.NDArray[np.int64]
    segment: Indices
    vertices: Indices


@dataclass(frozen=True)
class Boundary:
    """One row per boundary facet of all ranks.

    Attributes:
        kind: `spaces.SIGNORINI`, `DIRICHLET` or `NEUMANN`.
        u: The known values of u: p_h on Γ_S, the mean of u_D on Γ_D, NaN on Γ_N.
        vertices: Rows of `Fields.points`, ascending, shape (facets, dim).
    """

    kind: npt.NDArray[np.int64]
    u: Array
    vertices: Indices


@dataclass(frozen=True)
class Fields:
    """Mesh and cell values of all ranks.

    Attributes:
        points: Shape (points, dim).
        cells: Shape (cells, dim + 1).
        u: Shape (cells,).
        sigma: σ_h at the centroids, shape (cells, dim).
        divergence: ∇·σ_h, shape (cells,).
        indicator: η_T of the certificate, shape (cells,); None without a certificate.
    """

    points: Array
    cells: Indices
    u: Array
    sigma: Array
    divergence: Array
    indicator: Array | None


def gather_facets(solution: Solution) -> FacetTable | None:
    """Collect the Γ_S facets on rank 0; None on other ranks (collective)."""
    spaces = solution.spaces
    size = len(spaces.facets)
    midpoints = dolfinx.mesh.compute_midpoints(spaces.mesh, spaces.mesh.topology.dim - 1, spaces.facets)
    along = np.empty(size)
    for index, name in enumerate(spaces.part_names):
        on_part = spaces.part_of_facet == index
        along[on_part] = spaces.domain.parts[name].along(midpoints[on_part].T)
    columns = [
        spaces.part_of_facet,
        *midpoints.T,
        along,
        spaces.facet_measure,
        solution.u.x.array[spaces.cells],
        solution.p.x.array[:size],
        spaces.normal_flux(solution.sigma),
        solution.data.psi_h,
        solution.data.q_Sh,
        solution.outcome.conditions.kind,
        solution.data.laws.labels(solution.segments().segment),
        *facet_vertices(spaces.mesh, spaces.facets).T,
    ]
    rows = gather_rows(spaces.mesh.comm, np.column_stack(columns))
    if rows is None:
        return None
    scale = 2.0 ** np.ceil(np.log2(np.abs(rows[:, 1:5]).max(initial=TINY)))
    *x, along = np.round(rows[:, 1:5].T / scale, 10)  # rounded, so that the order does not depend on the partition
    rows = rows[np.lexsort((*x[::-1], along, rows[:, 0]))]
    return FacetTable(
        part=rows[:, 0].astype(np.int64),
        x=rows[:, 1:4],
        along=rows[:, 4],
        measure=rows[:, 5],
        u=rows[:, 6],
        p=rows[:, 7],
        flux=rows[:, 8],
        psi=rows[:, 9],
        q_S=rows[:, 10],
        condition=rows[:, 11].astype(np.int64),
        segment=rows[:, 12].astype(np.int64),
        vertices=rows[:, 13:].astype(np.int64),
    )


def gather_boundary(solution: Solution) -> Boundary | None:
    """Collect the whole boundary on rank 0; None on other ranks (collective)."""
    spaces = solution.spaces
    lift = solution.data.u_lift
    u_D = lift.x.array[cells_and_dofs(lift.function_space, spaces.dirichlet_facets)[1]]
    p = solution.p.x.array[: len(spaces.facets)]
    blocks = [
        (SIGNORINI, spaces.facets, p),
        (DIRICHLET, spaces.dirichlet_facets, u_D),
        (NEUMANN, spaces.neumann_facets, np.full(len(spaces.neumann_facets), np.nan)),
    ]
    columns = [
        np.column_stack([np.full(len(facets), kind), values, facet_vertices(spaces.mesh, facets)])
        for kind, facets, values in blocks
    ]
    rows = gather_rows(spaces.mesh.comm, np.concatenate(columns))
    if rows is None:
        return None
    return Boundary(rows[:, 0].astype(np.int64), rows[:, 1], rows[:, 2:].astype(np.int64))


def gather_marks(domain: Domain) -> Marks:
    """Collect parts and regions on rank 0; empty on other ranks (collective)."""
    comm = domain.mesh.comm
    facets = {}
    for name, local in domain.facets.items():
        vertices = gather_rows(comm, facet_vertices(domain.mesh, local))
        facets[name] = (
            np.empty((0, domain.mesh.topology.dim), dtype=np.int64) if vertices is None else _sorted(vertices)
        )
    cells = None
    if domain.regions:
        inside = gather_rows(comm, membership(domain))
        order = gather_rows(comm, domain.mesh.topology.original_cell_index)
        cells = None if inside is None or order is None else inside[np.argsort(order)]
    return Marks(facets, cells, tuple(domain.regions))


def _sorted(rows: Indices) -> Indices:
    return rows[np.lexsort(rows.T[::-1])]


def centroid_flux(solution: Solution) -> fem.Function:
    """σ_h at the cell centroids, as a P0 vector field (collective)."""
    mesh = solution.spaces.mesh
    sigma = fem.Function(fem.functionspace(mesh, ("DG", 0, (mesh.geometry.dim,))), name="sigma")
    sigma.interpolate(solution.sigma)
    return sigma


def gather_fields(solution: Solution, indicator: fem.Function | None = None) -> Fields | None:
    """Collect mesh and cell values on rank 0; None on other ranks (collective)."""
    mesh = solution.spaces.mesh
    comm, geometry, dim = mesh.comm, mesh.geometry, mesh.geometry.dim
    size = mesh.topology.index_map(mesh.topology.dim).size_local
    ids = gather_rows(comm, geometry.input_global_indices)
    points = gather_rows(comm, geometry.x[:, :dim])
    cells = gather_rows(comm, geometry.input_global_indices[geometry.dofmaps[0][:size]])
    u = gather_rows(comm, solution.u.x.array[:size])
    sigma = gather_rows(comm, centroid_flux(solution).x.array.reshape(-1, dim)[:size])
    divergence = fem.Function(solution.spaces.Q)
    divergence.interpolate(fem.Expression(ufl.div(solution.sigma), solution.spaces.Q.element.interpolation_points))
    div_sigma = gather_rows(comm, divergence.x.array[:size])
    eta = None if indicator is None else gather_rows(comm, indicator.x.array[:size])
    order = gather_rows(comm, mesh.topology.original_cell_index[:size])
    if ids is None or points is None or cells is None or u is None or sigma is None:
        return None
    if div_sigma is None or order is None:
        return None
    used, first = np.unique(ids, return_index=True)
    rows = np.argsort(order)
    return Fields(
        points[first],
        np.searchsorted(used, cells)[rows],
        u[rows],
        sigma[rows],
        div_sigma[rows],
        None if eta is None else eta[rows],
    )
