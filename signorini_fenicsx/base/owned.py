"""What a rank owns: the first cells of a mesh and the first entries of a function. Ghosts follow, which others own."""

import math
from weakref import WeakKeyDictionary

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import common, fem, la

type Entities = npt.NDArray[np.int32]

_NODES: WeakKeyDictionary[dolfinx.mesh.Mesh, Entities] = WeakKeyDictionary()


def number_of_cells(mesh: dolfinx.mesh.Mesh) -> int:
    """The number of owned cells."""
    return mesh.topology.index_map(mesh.topology.dim).size_local


def owned_cells(mesh: dolfinx.mesh.Mesh) -> Entities:
    """All owned cells."""
    return np.arange(number_of_cells(mesh), dtype=np.int32)


def cell_nodes(mesh: dolfinx.mesh.Mesh) -> Entities:
    """Numbers of the vertices of the owned cells, shape (cells, dim + 1).

    They are kept with the mesh: DOLFINx copies them all whenever it is asked, also for some cells at a time.
    """
    nodes = _NODES.get(mesh)
    if nodes is None:
        nodes = _NODES[mesh] = mesh.geometry.dofmaps[0][: number_of_cells(mesh)]
    return nodes


def original_cells(mesh: dolfinx.mesh.Mesh) -> npt.NDArray[np.int64]:
    """The numbers that the owned cells had where the mesh was made."""
    return mesh.topology.original_cell_index[: number_of_cells(mesh)]


def cell_dofs(space: fem.FunctionSpace) -> Entities:
    """Degrees of freedom of the owned cells, shape (cells, those of one)."""
    return space.dofmap.list[: number_of_cells(space.mesh)]


def cells_behind(mesh: dolfinx.mesh.Mesh, facets: Entities) -> Entities:
    """The cell behind each boundary facet."""
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    links = mesh.topology.connectivity(dim - 1, dim)
    return np.asarray(links.array[links.offsets[facets]], dtype=np.int32)


def cells_of_facets(mesh: dolfinx.mesh.Mesh, facets: Entities) -> tuple[Entities, Entities]:
    """The cell behind each boundary facet, and the number of the facet in it."""
    topology, dim, cells = mesh.topology, mesh.topology.dim, cells_behind(mesh, facets)
    topology.create_connectivity(dim, dim - 1)
    of_cells = topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)[cells]
    return cells, np.argmax(of_cells == facets[:, None], axis=1).astype(np.int32)


def owned_values(function: fem.Function) -> npt.NDArray:
    """The owned entries of a function, a view; in P0 they are the values in the owned cells, in their order."""
    dofmap = function.function_space.dofmap
    return function.x.array[: dofmap.index_map.size_local * dofmap.index_map_bs]


def set_owned(function: fem.Function, values: npt.ArrayLike) -> None:
    """Set the owned entries of a function, ghosts updated (collective)."""
    owned_values(function)[:] = values
    function.x.scatter_forward()


def function_of(space: fem.FunctionSpace, values: npt.ArrayLike, name: str | None = None) -> fem.Function:
    """A function by its owned entries, ghosts updated (collective)."""
    function = fem.Function(space, name=name)
    set_owned(function, values)
    return function


def function_at(
    space: fem.FunctionSpace, dofs: npt.NDArray[np.integer], values: npt.ArrayLike, name: str | None = None
) -> fem.Function:
    """A function by its values at some degrees of freedom of this rank, 0 at the others, ghosts updated (collective).

    In a space of vectors they are blocks, and a value is a vector.
    """
    function, size = fem.Function(space, name=name), space.dofmap.index_map_bs
    (function.x.array if size == 1 else function.x.array.reshape(-1, size))[dofs] = values
    function.x.scatter_forward()
    return function


def with_ghosts(index_map: common.IndexMap, owned: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Rows of numbers of what this rank owns of an index map, and after them those of ghosts (collective)."""
    everywhere = la.vector(index_map, owned.shape[1])
    everywhere.array[: owned.size] = owned.ravel()
    everywhere.scatter_forward()
    return np.asarray(everywhere.array).reshape(-1, owned.shape[1])


def sums_at(
    index_map: common.IndexMap, numbers: npt.NDArray[np.integer], values: npt.ArrayLike = 1.0
) -> npt.NDArray[np.float64]:
    """Add up values for each thing that an index map numbers, over all ranks, ghosts updated (collective).

    Args:
        index_map: The map.
        numbers: Numbers of things on this rank, in any shape and as often as one likes.
        values: A value for each of these numbers, its entries behind their axes; or what can be broadcast to this.

    Returns:
        The sums, shape (things, *shape of a value); 0 for a thing without numbers.
    """
    shape = np.shape(values)[numbers.ndim :]
    sums = la.vector(index_map, math.prod(shape))
    rows = sums.array.reshape(-1, sums.block_size)
    summands = np.broadcast_to(values, (*numbers.shape, *shape)).reshape(numbers.size, sums.block_size)
    for column, of_column in enumerate(summands.T):
        rows[:, column] = np.bincount(numbers.ravel(), of_column, len(rows))
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    return rows.reshape(-1, *shape)
