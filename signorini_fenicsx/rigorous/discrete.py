"""A discrete flux and trace as arrays of floats on one process; the theorem needs nothing else of a solution."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_dofs, cell_nodes, number_of_cells, original_cells
from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.base.reference_cells import EDGES
from signorini_fenicsx.discrete.linear_traces import opposite
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.expressions.intervals import Interval
from signorini_fenicsx.meshes.domain import membership
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.rigorous.simplices import BareCells, facet_measures

INSIDE, SIGNORINI, DIRICHLET, NEUMANN = 0, 1, 2, 3
"""Kinds of facets."""


@dataclass(frozen=True)
class MeshCells(BareCells):
    """The cells of a mesh.

    Attributes:
        corners: Numbers of these vertices, the same for the same vertex, shape (cells, d + 1).
        facets: Number of the facet opposite to each vertex, shape (cells, d + 1).
    """

    corners: Indices
    facets: Indices


@dataclass(frozen=True)
class Discrete(MeshCells):
    """A mesh, a flux in RT0 and a continuous function in P2.

    Attributes:
        kinds: Kind of each facet.
        fluxes: Flux of σ_h out of the cell through each of these facets; two cells that share one have opposite floats.
        v: Values in the nodes of P2, vertices first, then edges as in `EDGES`.
        regions: Names of the regions, and a mask of the cells in them, shape (cells, regions).
    """

    kinds: npt.NDArray[np.int8]
    fluxes: Array
    v: Array
    regions: tuple[tuple[str, ...], Mask]


@dataclass(frozen=True)
class MeshFacets:
    """Some facets, each with one of its cells.

    Attributes:
        cells: The cell of each facet.
        local: Index of the facet in this cell.
        nodes: Its nodes among the nodes of P2 of the cell, vertices first, shape (facets, nodes).
        corners: Its vertices, shape (facets, d, d).
        measure: |e|.
    """

    cells: Indices
    local: Indices
    nodes: Indices
    corners: Array
    measure: Interval


def boundary(discrete: Discrete, kind: int) -> MeshFacets:
    """All facets of one kind."""
    return facets_at(discrete, discrete.kinds == kind)


def facets_at(cells_of_mesh: MeshCells, chosen: Mask) -> MeshFacets:
    """The facets at which a mask of the facets of all cells is True."""
    dim = cells_of_mesh.dim
    cells, local = np.nonzero(chosen)
    nodes = nodes_of_facets(dim)[local]
    corners = cells_of_mesh.vertices[cells[:, None], nodes[:, :dim]]
    return MeshFacets(cells, local, nodes, corners, facet_measures(corners))


def nodes_of_facets(dim: int) -> Indices:
    """The nodes of P2 of a cell on the facet opposite to each vertex, in the order of a facet."""
    number = {edge: dim + 1 + index for index, edge in enumerate(EDGES[dim])}
    return np.array([[*x, *(number[x[a], x[b]] for a, b in EDGES[dim - 1])] for x in opposite(dim).tolist()])


def gathered(solution: Solution, v: fem.Function) -> Discrete | None:
    """Gather a solution and a P2 function on rank 0, with the cells in their original order (collective).

    Args:
        solution: The solution.
        v: The P2 function by its Bernstein coefficients, as in `Certificate.v`.

    Returns:
        Both as arrays on rank 0; None on other ranks.
    """
    spaces, mesh = solution.spaces, solution.spaces.mesh
    dim = mesh.topology.dim
    cells, corners = number_of_cells(mesh), cell_nodes(mesh)
    inside = membership(spaces.domain)
    whole = gathered_rows(
        spaces,
        corners,
        {
            "fluxes": _outward_fluxes(solution, cells),
            "kinds": _kinds(spaces)[mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)[:cells]],
            "v": v.x.array[cell_dofs(v.function_space)],
            "inside": inside[:cells],
        },
    )
    if whole is None:
        return None
    facets = whole["facets"]
    return Discrete(
        vertices=whole["vertices"],
        corners=whole["corners"],
        facets=facets,
        kinds=whole["kinds"],
        fluxes=opposed(facets, whole["fluxes"]),
        v=_nodal(whole["corners"], whole["v"]),
        regions=(tuple(spaces.domain.regions), whole["inside"].astype(bool)),
    )


def gathered_rows(
    spaces: MeshSpaces, nodes: npt.NDArray[np.integer], columns: dict[str, npt.NDArray[Any]]
) -> dict[str, npt.NDArray[Any]] | None:
    """Gather what is known of cells on rank 0, with the cells in their original order (collective).

    Args:
        spaces: The spaces.
        nodes: The nodes at the vertices of the owned cells, shape (cells, d + 1).
        columns: Further arrays of the owned cells, by name.

    Returns:
        The arrays, and the three of `MeshCells` by their names; None on other ranks.
    """
    mesh = spaces.mesh
    comm, dim = mesh.comm, mesh.topology.dim
    own = {
        "order": original_cells(mesh),
        "corners": mesh.geometry.input_global_indices[nodes],
        "vertices": mesh.geometry.x[nodes, :dim],
    }
    rows = {name: gather_rows(comm, column) for name, column in (own | columns).items()}
    if any(values is None for values in rows.values()):
        return None
    order = np.argsort(rows["order"])  # type: ignore[arg-type]
    whole = {name: np.asarray(values)[order] for name, values in rows.items()}
    numbers = whole["corners"]
    facets = np.stack([np.sort(np.delete(numbers, i, axis=1), axis=1) for i in range(dim + 1)], axis=1)
    _, facet = np.unique(facets.reshape(-1, dim), axis=0, return_inverse=True)
    return whole | {"vertices": alike(numbers, whole["vertices"]), "facets": facet.reshape(-1, dim + 1)}


def alike(numbers: Indices, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Give all entries with one number the first of their values, because ranks may differ by rounding."""
    _, first, own = np.unique(numbers, return_index=True, return_inverse=True)
    return values.reshape(-1, *values.shape[numbers.ndim :])[first][own.reshape(numbers.shape)]


def opposed(facets: Indices, fluxes: Array) -> Array:
    """The flux out of the first cell of each facet, and its negative for the second cell; it may have components."""
    _, first = np.unique(facets, return_index=True)
    other = np.ones(facets.size, dtype=bool)
    other[first] = False
    signs = np.where(other, -1.0, 1.0).reshape(*facets.shape, *[1] * (fluxes.ndim - 2))
    return np.asarray(signs * alike(facets, fluxes))


def pairs(one: Indices, other: Indices) -> Indices:
    """One number for each unordered pair."""
    return np.minimum(one, other) << 32 | np.maximum(one, other)


def alike_in_nodes(corners: Indices, values: Array) -> Array:
    """Give all cells at a node of P2 the same value, the first one."""
    dim = corners.shape[1] - 1
    ends = np.array(EDGES[dim]).T
    edges = alike(pairs(corners[:, ends[0]], corners[:, ends[1]]), values[:, dim + 1 :])
    return np.column_stack([alike(corners, values[:, : dim + 1]), edges])


def _nodal(corners: Indices, coefficients: Array) -> Array:
    """Values in the nodes of P2 from Bernstein coefficients, with the same floats in neighbouring cells."""
    dim = corners.shape[1] - 1
    ends = np.array(EDGES[dim]).T
    in_nodes = alike_in_nodes(corners, coefficients)
    in_nodes[:, dim + 1 :] = in_nodes[:, dim + 1 :] / 2 + (in_nodes[:, ends[0]] + in_nodes[:, ends[1]]) / 4
    return in_nodes


def _outward_fluxes(solution: Solution, cells: int) -> Array:
    """Fluxes out of each cell of this rank: a sign times one float per facet (collective)."""
    spaces, sigma = solution.spaces, solution.sigma
    form = fenicsx.form(ufl.div(ufl.TrialFunction(spaces.V)) * ufl.TestFunction(spaces.Q) * ufl.dx)
    of_basis = fem.assemble_matrix(form).to_scipy().tocsr()  # ∫_T ∇·φ: the flux of a basis function out of a cell
    dofs = cell_dofs(spaces.V)
    flux = np.asarray(of_basis[np.arange(cells)[:, None], dofs].todense())
    size = spaces.mesh.comm.bcast(float(np.abs(flux).flat[0]) if flux.size else 0.0)
    return np.sign(flux) * (size * sigma.x.array[dofs])


def _kinds(spaces: Spaces) -> npt.NDArray[np.int8]:
    """Kind of each facet of this rank."""
    topology = spaces.mesh.topology
    index_map = topology.index_map(topology.dim - 1)
    kinds = np.zeros(index_map.size_local + index_map.num_ghosts, dtype=np.int8)
    for kind, facets in (
        (SIGNORINI, spaces.facets),
        (DIRICHLET, spaces.dirichlet_facets),
        (NEUMANN, spaces.neumann_facets),
    ):
        kinds[facets] = kind
    return kinds
