"""Distributed solutions as plain arrays on rank 0, for tables and pictures."""

from dataclasses import dataclass
from typing import Any

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.base.rows import in_digits
from signorini_fenicsx.discrete.mesh_spaces import DIRICHLET, NEUMANN, SIGNORINI, MeshSpaces, cells_and_dofs
from signorini_fenicsx.meshes.domain import cells_behind, facet_vertices, membership
from signorini_fenicsx.output.sample import Sample
from signorini_fenicsx.physics.diffusion.solution import Solution

PARTLY_FIXED = 4
"""A part of the boundary that is fixed in some components only."""


@dataclass(frozen=True)
class FacetTable:
    """One row per facet of Γ_S, on rank 0 for all ranks, ordered by part and then along the part.

    Attributes:
        part: Index into the parts of Γ_S.
        x: Midpoints, shape (facets, 3).
        along: Coordinate along the part.
        measure: |e|.
        u: u_h in the cell behind the facet; for a facet inside the domain the jump of u_h.
        p: Trace p_h, or the jump p_h.
        flux: σ_h·n.
        psi: Mean of ψ.
        q_S: Mean of q_S.
        condition: Final condition.
        segment: Final segment, a row of `BoundaryLaws.names`.
        vertices: Their numbers in the mesh, ascending, in a scene rows of `Fields.points`, shape (facets, dim).
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
        kind: `spaces.SIGNORINI`, `DIRICHLET` or `NEUMANN`; `PARTLY_FIXED` of an elastic body.
        u: The known values of u: p_h on Γ_S, the mean of u_D on Γ_D, NaN on Γ_N and inside the domain.
        vertices: Their numbers in the mesh, ascending, in a scene rows of `Fields.points`, shape (facets, dim).
    """

    kind: npt.NDArray[np.int64]
    u: Array
    vertices: Indices


@dataclass(frozen=True)
class Fields:
    """Mesh and values for pictures, of all cells or of a sample of them, see `Sample`.

    Attributes:
        ids: For each point its number in the mesh, ascending.
        points: Shape (points, dim).
        cells: Shape (cells, dim + 1).
        u: u_h at the points, the mean over the cells around.
        sigma_at_points: σ_h likewise, shape (points, dim).
        sigma: σ_h at the centroids, shape (cells, dim).
        divergence: ∇·σ_h, shape (cells,).
        of: Number of cells of the mesh.
        indicator: η_T of the certificate, shape (cells,); None without a certificate.
        contact: Whether a cell is in contact with the obstacle, shape (cells,); None without an obstacle.
        regions: Mask of the cells in each region, shape (cells, regions); None without regions.
    """

    ids: Indices
    points: Array
    cells: Indices
    u: Array
    sigma_at_points: Array
    sigma: Array
    divergence: Array
    of: int
    indicator: Array | None = None
    contact: Mask | None = None
    regions: Mask | None = None

    @property
    def count(self) -> str:
        """How many cells there are, and in the picture."""
        return f"{self.of} cells" + (f", a sample of {len(self.cells)} drawn" if len(self.cells) < self.of else "")


def facet_table(solution: Solution) -> FacetTable:
    """The Γ_S facets of this rank, in their order on it; vertices have the original numbers of the mesh."""
    spaces = solution.spaces
    size, u = len(spaces.facets), solution.u.x.array[spaces.cells]
    u[spaces.inner.rows] -= solution.u.x.array[cells_behind(spaces.mesh, spaces.inner.facets)]
    midpoints = dolfinx.mesh.compute_midpoints(spaces.mesh, spaces.mesh.topology.dim - 1, spaces.facets).reshape(-1, 3)
    along = np.empty(size)
    for index, name in enumerate(spaces.part_names):
        on_part = spaces.part_of_facet == index
        along[on_part] = spaces.domain.parts[name].along(midpoints[on_part].T)
    return FacetTable(
        part=spaces.part_of_facet.astype(np.int64),
        x=midpoints,
        along=along,
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


def gather_facets(solution: Solution) -> FacetTable | None:
    """Collect the Γ_S facets on rank 0, in order; None on other ranks (collective)."""
    comm, columns = solution.spaces.mesh.comm, vars(facet_table(solution))
    rows = {key: gather_rows(comm, values) for key, values in columns.items()}
    found = {key: values for key, values in rows.items() if values is not None}
    return in_order(FacetTable(**found)) if found else None


def in_order(table: FacetTable) -> FacetTable:
    """A table ordered by part and then along the part (not collective)."""
    places = np.column_stack([table.x, table.along])
    *x, along = in_digits(places).T
    order = np.lexsort((*x[::-1], along, table.part))
    return FacetTable(**{key: rows[order] for key, rows in vars(table).items()})


def gather_boundary(solution: Solution) -> Boundary | None:
    """Collect the whole boundary on rank 0; None on other ranks (collective)."""
    spaces = solution.spaces
    lift = solution.data.u_lift
    u_D = lift.x.array[cells_and_dofs(lift.function_space, spaces.dirichlet_facets)[1]]
    p = solution.p.x.array[: len(spaces.facets)].copy()
    p[spaces.inner.rows] = np.nan
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


def gather_free_boundary(solution: Solution) -> Array | None:
    """Midpoint and measure of each facet between a cell in contact and another, on rank 0, shape (facets, 4)."""
    spaces, space = solution.spaces, solution.spaces.crouzeix_raviart
    mesh, dofs, dim = spaces.mesh, solution.free_boundary(), spaces.mesh.topology.dim
    mesh.topology.create_connectivity(dim, dim - 1)
    of_dof = np.empty(space.dofmap.index_map.size_local + space.dofmap.index_map.num_ghosts, dtype=np.int32)
    of_dof[space.dofmap.list.ravel()] = mesh.topology.connectivity(dim, dim - 1).array
    corners = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, dim - 1, of_dof[dofs])].reshape(-1, dim, 3)
    edges = corners[:, 1:] - corners[:, :1]
    measure = np.sqrt(np.linalg.det(edges @ edges.transpose(0, 2, 1))) / (dim - 1)
    rows = gather_rows(mesh.comm, np.column_stack([corners.mean(axis=1), measure]))
    return None if rows is None else rows[np.lexsort(in_digits(rows[:, :3]).T[::-1])]


def cell_values(solution: Solution) -> dict[str, Array]:
    """u_h, σ_h at the centroids and ∇·σ_h in the cells of this rank, named as in `Fields` (collective)."""
    flux = solution.cell_flux
    return {"u": solution.u.x.array, "sigma": flux.centroid, "divergence": flux.divergence}


def sample_of(spaces: MeshSpaces) -> Sample:
    """The mesh for pictures of a solution on these spaces (collective)."""
    return Sample(spaces.mesh, np.concatenate([spaces.facets, spaces.dirichlet_facets, spaces.neumann_facets]))


def gather_fields(solution: Solution, indicator: fem.Function | None = None) -> Fields | None:
    """Collect mesh and values for pictures on rank 0; None on other ranks (collective)."""
    domain, sample, inside = solution.spaces.domain, sample_of(solution.spaces), solution.outcome.iterate.contact
    in_cells, dim = cell_values(solution), solution.spaces.mesh.topology.dim
    both = np.column_stack([in_cells["u"], in_cells["sigma"]])
    at_points = sample.at_points(np.repeat(both[:, None], dim + 1, axis=1))
    found: dict[str, Any] = {key: sample.in_cells(in_cells[key]) for key in ("sigma", "divergence")}
    if indicator is not None:
        found["indicator"] = sample.in_cells(indicator.x.array)
    if inside is not None:
        found["contact"] = sample.in_cells(inside)
    if domain.regions:
        found["regions"] = sample.in_cells(membership(domain))
    if at_points is None:
        return None
    return Fields(
        ids=sample.ids,
        points=sample.points,
        cells=sample.cells,
        u=at_points[:, 0],
        sigma_at_points=at_points[:, 1:],
        of=sample.of,
        **found,
    )
