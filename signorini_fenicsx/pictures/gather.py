"""Distributed solutions as plain arrays on rank 0, for pictures."""

from collections.abc import Mapping
from dataclasses import dataclass

import dolfinx.mesh
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import cells_behind
from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.discrete.mesh_spaces import DIRICHLET, NEUMANN, SIGNORINI, MeshSpaces
from signorini_fenicsx.meshes.domain import facet_vertices
from signorini_fenicsx.pictures.sample import Sample

PARTLY_FIXED = 4
"""A part of the boundary that is fixed in some components only."""

type Known = tuple[npt.NDArray[np.int32], Array]
"""Some facets, and the values that are known there, NaN where none is: of a scalar u itself, of bodies tractions."""


@dataclass(frozen=True)
class DrawnBoundary:
    """One row per boundary facet of all ranks.

    Attributes:
        kind: `SIGNORINI`, `DIRICHLET` or `NEUMANN` of `discrete.mesh_spaces`, or `PARTLY_FIXED`.
        known: What is known there, see `Known`, shape (facets, k).
        vertices: Rows of `DrawnFields.points`, ascending by their numbers in the mesh, shape (facets, dim).
        middles: The middle of the cell of each facet, shape (facets, dim).
    """

    kind: npt.NDArray[np.int64]
    known: Array
    vertices: Indices
    middles: Array


@dataclass(frozen=True)
class DrawnFields:
    """Mesh and values for pictures, of all cells or of a sample of them, see `Sample`.

    Attributes:
        ids: For each point its number in the mesh, ascending.
        points: Shape (points, dim).
        cells: Shape (cells, dim + 1).
        of: Number of cells of the mesh.
        at_points: Values at the points by their names, the means over the cells around, shape (points, k).
        in_cells: Values in the cells by their names; "indicator" is η_T, "regions" a mask with a column for each.
        states: Numbers of cells by what lines between different ones are called.
    """

    ids: Indices
    points: Array
    cells: Indices
    of: int
    at_points: Mapping[str, Array]
    in_cells: Mapping[str, npt.NDArray]
    states: Mapping[str, npt.NDArray]

    @property
    def count(self) -> str:
        """How many cells there are, and in the picture."""
        return f"{self.of} cells" + (f", a sample of {len(self.cells)} drawn" if len(self.cells) < self.of else "")


def sample_of(spaces: MeshSpaces) -> Sample:
    """The mesh for pictures of a solution on these spaces (collective)."""
    return Sample(spaces.mesh, np.concatenate([spaces.facets, spaces.dirichlet_facets, spaces.neumann_facets]))


def whole_boundary(spaces: MeshSpaces, **values: Array) -> dict[int, Known]:
    """The facets of each kind of boundary, with the values that are known on those of some, by their names."""
    kinds = {
        "signorini": (SIGNORINI, spaces.facets),
        "dirichlet": (DIRICHLET, spaces.dirichlet_facets),
        "neumann": (NEUMANN, spaces.neumann_facets),
    }
    return {kind: (facets, values.get(name, np.full(len(facets), np.nan))) for name, (kind, facets) in kinds.items()}


def boundary_of(mesh: dolfinx.mesh.Mesh, kinds: Mapping[int, Known], sample: Sample) -> DrawnBoundary | None:
    """The boundary on rank 0; None elsewhere (collective)."""
    columns = [
        np.column_stack([values, np.full(len(facets), kind), facet_vertices(mesh, facets), _middles(mesh, facets)])
        for kind, (facets, values) in kinds.items()
    ]
    rows = gather_rows(mesh.comm, np.concatenate(columns))
    if rows is None:
        return None
    dim = mesh.topology.dim
    known, (kind, vertices, middles) = rows[:, : -2 * dim - 1], np.split(rows[:, -2 * dim - 1 :], [1, 1 + dim], axis=1)
    return DrawnBoundary(kind[:, 0].astype(np.int64), known, sample.rows_of(vertices.astype(np.int64)), middles)


def _middles(mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32]) -> Array:
    """The middle of the cell behind each facet."""
    nodes = mesh.geometry.dofmaps[0][cells_behind(mesh, facets)]
    return mesh.geometry.x[nodes, : mesh.topology.dim].mean(axis=1).reshape(-1, mesh.topology.dim)


def fields_of(
    sample: Sample, corners: Mapping[str, Array], cells: Mapping[str, npt.NDArray], states: Mapping[str, npt.NDArray]
) -> DrawnFields | None:
    """The values of all ranks on rank 0; None elsewhere (collective)."""
    ends = np.cumsum([values.shape[2] for values in corners.values()])
    at_points = sample.at_points(np.concatenate(list(corners.values()), axis=2))
    in_cells, of_states = (
        {name: rows for name, values in some.items() if (rows := sample.in_cells(values)) is not None}
        for some in (cells, states)
    )
    if at_points is None:
        return None
    named = dict(zip(corners, np.split(at_points, ends[:-1], axis=1), strict=True))
    return DrawnFields(sample.ids, sample.points, sample.cells, sample.of, named, in_cells, of_states)
