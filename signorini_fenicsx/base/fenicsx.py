"""What the program uses of DOLFINx that changes from version to version: its compiler of forms, meshes, refinement.

DOLFINx looks up each form in its cache again, even if the process has loaded it, and lists the whole cache to do so.
This takes most of the time of a small solve. Here a process keeps the forms that it has loaded, and they have a folder
of their own in the cache, so that the forms of other programs cost nothing. DOLFINx's own compiler is replaced only
while a function of this module runs; forms that the user makes are compiled as ever.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import dolfinx.geometry
import dolfinx.graph
import dolfinx.jit
import dolfinx.mesh
import ffcx.naming
import ffcx.options
import numpy as np
import numpy.typing as npt
from dolfinx import common, cpp, fem
from mpi4py import MPI
from ufl.finiteelement import AbstractFiniteElement

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.compiling import PATIENCE, in_a_sentence, patiently
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.local_options import JSON, unseen
from signorini_fenicsx.base.owned import original_cells
from signorini_fenicsx.base.parallel import on_root_only
from signorini_fenicsx.base.progress import COMPILING, doing

OWN = "signorini_fenicsx"
"""Folder of the cache for the forms of this program."""
OF_DOLFINX, OF_FFCX = JSON
NEEDED = {"language": "C", "scalar_type": "float64", "sum_factorization": False, "part": "full"}
"""Options of FFCx without which no form of this program is compiled, or not all of it."""
LOADED: dict[str, Any] = {}
"""The forms that this process has loaded or compiled, by signature of form and options."""
FEW = 10
"""At most so many unknowns of a cell, or blocks of them; not those of quadratures."""
SPACES = "_spaces_of_signorini_fenicsx"
"""Attribute of a mesh: the elements and the objects of DOLFINx of its spaces, by what `function_space` was given."""

type Facets = npt.NDArray[np.int32]

_compile_here: Callable[..., Any] = dolfinx.jit.ffcx_jit.__wrapped__  # without its own broadcasts, which lose errors


def form(
    integrals: Any, *, entity_maps: Sequence[dolfinx.mesh.EntityMap] = (), options: dict[str, Any] | None = None
) -> Any:
    """Compile a UFL form, or blocks of them (collective).

    Args:
        integrals: The form; one that is compiled already is returned.
        entity_maps: From the meshes of its coefficients to that of its integrals.
        options: For FFCx.
    """
    with _own_compiler():
        return fem.form(integrals, form_compiler_options=options, entity_maps=entity_maps)


def function_space(mesh: dolfinx.mesh.Mesh, element: Any) -> fem.FunctionSpace:
    """The space of an element, or of its family, degree and shape, on a mesh (collective).

    The mesh keeps what spaces of an element with few unknowns share, without a circle of references.
    """
    known: dict[Any, tuple[Any, Any]] = vars(mesh).setdefault(SPACES, {})
    if element in known:
        return fem.FunctionSpace(mesh, *known[element])
    with _own_compiler():
        made = fem.functionspace(mesh, element)
    if made.dofmap.dof_layout.num_dofs <= FEW:
        known[element] = made.ufl_element(), made._cpp_object
    return made


def expression(value: Any, points: Array) -> fem.Expression:
    """A UFL expression, to be evaluated in points of the reference cell (collective)."""
    with _own_compiler():
        return fem.Expression(value, points)


def submesh(mesh: dolfinx.mesh.Mesh, dim: int, entities: Facets) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.EntityMap]:
    """The mesh of some entities of a mesh, and the map from it to the mesh (collective)."""
    made, entity_map, *_ = dolfinx.mesh.create_submesh(mesh, dim, entities)
    return made, entity_map


def sub_index_map(
    index_map: common.IndexMap, numbers: npt.NDArray[np.int32]
) -> tuple[common.IndexMap, npt.NDArray[np.int32]]:
    """Number some of the things that an index map numbers (collective).

    Args:
        index_map: The map.
        numbers: Those of this rank, ghosts too, ascending; on all ranks the same ones.

    Returns:
        The new map, and the old number of each of its things.
    """
    made, old = cpp.common.create_sub_index_map(index_map, numbers, False)
    return made, old


def partitioned(
    comm: MPI.Comm,
    cells: Indices,
    element: AbstractFiniteElement,
    points: Array,
    ranks: Callable[[Callable[[], Facets]], Facets] | None = None,
) -> dolfinx.mesh.Mesh:
    """Make a distributed mesh without ghost cells (collective).

    Args:
        comm: Communicator of the mesh.
        cells: Some cells on each rank, by the numbers of their points.
        element: Element of the coordinates.
        points: Some points on each rank; their numbers continue from rank to rank.
        ranks: Chooses the rank of each cell that this rank gives, from a function that computes a partition with few
            neighbours (collective); None for this partition.
    """
    default = dolfinx.mesh.create_cell_partitioner(dolfinx.mesh.GhostMode.none, 2)  # type: ignore[call-arg]  # overload

    def chosen(*graph: Any) -> object:
        assert ranks is not None
        own = ranks(lambda: default(*graph).array.copy())
        return dolfinx.graph.adjacencylist(own[:, None])._cpp_object

    return dolfinx.mesh.create_mesh(comm, cells, element, points, None if ranks is None else chosen)


def bisected(
    mesh: dolfinx.mesh.Mesh, edges: Facets
) -> tuple[dolfinx.mesh.Mesh, npt.NDArray[np.int32], npt.NDArray[np.int8]]:
    """Halve some edges, and others as needed for conformity, by longest-edge bisection (collective).

    Returns:
        The refined mesh, with cells on the ranks of their parents. For each of its cells, in its order, the parent, and
        for each facet the facet of the parent that contains it, or −1.
    """
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(1, dim)
    fine, parents, facets = dolfinx.mesh.refine(
        mesh, edges, partitioner=None, option=dolfinx.mesh.RefinementOption.parent_cell_and_facet
    )
    order = original_cells(fine) - fine.topology.index_map(dim).local_range[0]  # parents are not in it
    return fine, parents[order], facets.reshape(-1, dim + 1)[order]


def owned_points(
    src_owner: npt.NDArray[np.int32],
    dest_owner: npt.NDArray[np.int32],
    dest_points: Array,
    dest_cells: npt.NDArray[np.int32],
) -> dolfinx.geometry.PointOwnershipData:
    """DOLFINx's record of the ranks and cells in which points are, shape (n, 3)."""
    found = src_owner, dest_owner, dest_points.ravel(), dest_cells
    return dolfinx.geometry.PointOwnershipData(cpp.geometry.PointOwnershipData_float64(*found))


@contextlib.contextmanager
def _own_compiler() -> Iterator[None]:
    """Let DOLFINx compile by `compiled`."""
    theirs = dolfinx.jit.ffcx_jit
    dolfinx.jit.ffcx_jit = compiled
    try:
        yield
    finally:
        dolfinx.jit.ffcx_jit = theirs


def compiled(
    comm: MPI.Comm,
    ufl_object: Any,
    form_compiler_options: dict[str, Any] | None = None,
    jit_options: dict[str, Any] | None = None,
) -> Any:
    """Stand in for `dolfinx.jit.ffcx_jit`: rank 0 compiles forms that are not in the cache, all load (collective).

    Raises:
        InputError: If a configuration file of these libraries has an option that they do not have.
        OSError: On all ranks, if there is no working C compiler, or the cache cannot be used.
    """
    _check_files()
    options = dolfinx.jit.get_options(jit_options)
    if "cache_dir" not in (jit_options or {}):
        options["cache_dir"] = Path(options["cache_dir"]) / OWN
    signature = ffcx.naming.compute_signature([_exact(ufl_object)], str((form_compiler_options, options)))
    cache = options["cache_dir"]

    def work(timeout: int) -> Any:
        return _compile_here(ufl_object, form_compiler_options, options | {"timeout": timeout})

    module = on_root_only(comm, lambda: _kept(signature, lambda: patiently(work, cache)))
    failure: OSError | None = None
    if comm.rank != 0:
        try:
            with in_a_sentence(cache):
                module = _kept(signature, lambda: work(PATIENCE))
        except OSError as error:
            failure = error
    failures = [error for error in comm.allgather(failure) if error is not None]
    if failures:
        raise failures[0]
    return module


def _exact(ufl_object: Any) -> Any:
    """The object with its points by their bytes: FFCx would take what NumPy prints, which is slow, rounded and cut."""
    if not isinstance(ufl_object, tuple):
        return ufl_object
    expr, points = ufl_object
    return expr, (points.shape, points.tobytes())


@cache  # both libraries read their files once too
def _check_files() -> None:
    """Refuse what configuration files of DOLFINx and FFCx say if compiling would end with a traceback."""
    kinds = {key: type(value) for key, (value, _) in dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS.items()}
    with unseen():
        options = dolfinx.jit.get_options()
        try:
            of_forms = ffcx.options.get_options()
        except (TypeError, ValueError) as error:
            raise InputError(f"{OF_FFCX}: {error}") from None
    _check_options(OF_DOLFINX, options, kinds | {"cache_dir": Path, "cffi_libraries": object})
    _check_options(OF_FFCX, of_forms, {key: kind for key, (kind, *_) in ffcx.options.FFCX_DEFAULT_OPTIONS.items()})
    for key, value in NEEDED.items():
        if of_forms[key] != value:
            raise InputError(f"{OF_FFCX}: this program needs {key} = {value}")


def _check_options(file: str, options: dict[str, Any], kinds: dict[str, Any]) -> None:
    for key, value in options.items():
        if key not in kinds:
            raise InputError(f"{file}: there is no option '{key}'; known are {', '.join(kinds)}")
        if not isinstance(value, (int, float) if kinds[key] is float else kinds[key]):
            raise InputError(f"{file}: '{key}' must be a {kinds[key].__name__}")


def _kept(signature: str, work: Callable[[], Any]) -> Any:
    """The form that this process keeps under this signature, or the result of `work`, which is then kept."""
    if signature not in LOADED:
        with doing(COMPILING):  # or loading, which is short
            LOADED[signature] = work()
    return LOADED[signature]
