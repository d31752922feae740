"""Distributed solutions as plain arrays on rank 0, for tables and pictures."""

from dataclasses import dataclass, replace
from typing import Any

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cells_behind, owned_values
from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.site_table import FacetTable, SiteTable
from signorini_fenicsx.meshes.domain import Domain, facet_vertices, membership
from signorini_fenicsx.output.sample import Sample
from signorini_fenicsx.solving.drawn import Drawn
from signorini_fenicsx.solving.solved import Solved


@dataclass(frozen=True)
class Boundary:
    """One row per boundary facet of all ranks.

    Attributes:
        kind: `spaces.SIGNORINI`, `DIRICHLET` or `NEUMANN`; `PARTLY_FIXED` of an elastic body.
        u: The known values of u: p_h on Γ_S, the mean of u_D on Γ_D, NaN on Γ_N and inside the domain.
        vertices: Their numbers in the mesh, ascending, in a scene rows of `Fields.points`, shape (facets, dim).
        middles: The middle of the cell of each facet, shape (facets, dim).
    """

    kind: npt.NDArray[np.int64]
    u: Array
    vertices: Indices
    middles: Array


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
        contact: Whether laws in Ω hold u in a cell, shape (cells,); None without such laws.
        states: The segment of its laws that each cell is on, shape (cells,); None without laws in Ω.
        displacement: u_h at the points, shape (points, dim), where it is a displacement: then `u` is its length.
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
    states: Indices | None = None
    displacement: Array | None = None
    regions: Mask | None = None

    @property
    def count(self) -> str:
        """How many cells there are, and in the picture."""
        return f"{self.of} cells" + (f", a sample of {len(self.cells)} drawn" if len(self.cells) < self.of else "")


@dataclass(frozen=True)
class Gathered:
    """A solution for pictures on rank 0; facets have rows of `Fields.points` for vertices.

    Attributes:
        of: What the solution gives of this rank.
        fields: Mesh and values.
        facets: Γ_S.
        sites: The table of the solution.
        boundary: The whole boundary.
    """

    of: Drawn
    fields: Fields
    facets: FacetTable
    sites: SiteTable
    boundary: Boundary


def gather(solution: Solved, indicator: fem.Function | None = None) -> Gathered | None:
    """Collect a solution of any physics on rank 0 for pictures; None on other ranks (collective)."""
    drawn, comm, sample = solution.drawn(), solution.spaces.mesh.comm, sample_of(solution.spaces)
    fields, boundary = _fields(solution.spaces.domain, drawn, sample, indicator), _boundary(solution.spaces.mesh, drawn)
    facets, sites = drawn.facets.gathered(comm), solution.table().gathered(comm)
    if fields is None or facets is None or sites is None or boundary is None:
        return None
    facets = replace(facets, vertices=sample.rows_of(facets.vertices))
    return Gathered(drawn, fields, facets, sites, replace(boundary, vertices=sample.rows_of(boundary.vertices)))


def sample_of(spaces: MeshSpaces) -> Sample:
    """The mesh for pictures of a solution on these spaces (collective)."""
    return Sample(spaces.mesh, np.concatenate([spaces.facets, spaces.dirichlet_facets, spaces.neumann_facets]))


def _boundary(mesh: dolfinx.mesh.Mesh, drawn: Drawn) -> Boundary | None:
    columns = [
        np.column_stack([np.full(len(facets), kind), values, facet_vertices(mesh, facets), _middles(mesh, facets)])
        for kind, (facets, values) in drawn.boundary.items()
    ]
    rows = gather_rows(mesh.comm, np.concatenate(columns))
    if rows is None:
        return None
    dim = mesh.topology.dim
    return Boundary(rows[:, 0].astype(np.int64), rows[:, 1], rows[:, 2:-dim].astype(np.int64), rows[:, -dim:])


def _middles(mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32]) -> Array:
    """The middle of the cell behind each facet."""
    nodes = mesh.geometry.dofmaps[0][cells_behind(mesh, facets)]
    return mesh.geometry.x[nodes, : mesh.topology.dim].mean(axis=1).reshape(-1, mesh.topology.dim)


def _fields(domain: Domain, drawn: Drawn, sample: Sample, indicator: fem.Function | None) -> Fields | None:
    corners, width = drawn.u.shape[1:]
    both = np.concatenate([drawn.u, np.repeat(drawn.sigma[:, None], corners, axis=1)], axis=2)
    at_points = sample.at_points(both)
    of_cells = {
        "sigma": drawn.sigma,
        "divergence": np.zeros(len(drawn.u)) if drawn.divergence is None else drawn.divergence,
        "contact": drawn.contact,
        "states": drawn.states,
        "indicator": None if indicator is None else owned_values(indicator),
        "regions": membership(domain) if domain.regions else None,
    }
    of_sample: dict[str, Any] = {key: sample.in_cells(rows) for key, rows in of_cells.items() if rows is not None}
    if at_points is None:
        return None
    u = at_points[:, :width]
    return Fields(
        ids=sample.ids,
        points=sample.points,
        cells=sample.cells,
        u=u[:, 0] if width == 1 else np.linalg.norm(u, axis=1),
        displacement=None if width == 1 else u,
        sigma_at_points=at_points[:, width:],
        of=sample.of,
        **of_sample,
    )
