"""Domains from DOLFINx meshes of the user."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import dolfinx.mesh
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError, check_kind, check_names
from signorini_fenicsx.base.owned import sums_at
from signorini_fenicsx.base.parallel import collector_off, on_root
from signorini_fenicsx.meshes.checks import FileMesh
from signorini_fenicsx.meshes.cut import ANY, along_last_axis, opened
from signorini_fenicsx.meshes.domain import AXES, Domain, axis_part, bounding_box, largest_diameter, other_side
from signorini_fenicsx.meshes.whole import OWN_CURVATURE, check_pairs, gathered, handed_out

type Entities = npt.NDArray[np.int32]
type Chosen = npt.ArrayLike | Callable[[Array], Mask]
"""Numbers of entities of this rank; or a function from points of shape (3, n) to a mask, as for DOLFINx's locate
functions: an entity is chosen if all its vertices are."""


@collector_off()
def domain_of(
    mesh: dolfinx.mesh.Mesh,
    parts: Mapping[str, Chosen],
    regions: Mapping[str, Chosen] | None = None,
    name: str = "mesh",
    *,
    inner: Sequence[str] = (),
    pairs: Sequence[Sequence[str]] = (),
) -> Domain:
    """A mesh with its parts, in the form that the solver needs (collective).

    The parts of `inner` are inside the domain: a crack, a fault, two bodies that touch. The mesh is cut along them, so
    that u may jump there. Then the domain has a new mesh, made on rank 0, and UFL data must be written on
    `domain.mesh`; likewise with `pairs`.

    Args:
        mesh: Triangles or tetrahedra with straight edges, with or without ghost cells.
        parts: Facets of the boundary, or inside, for each name of a part: their numbers on this rank, with or without
            ghosts, or a function of points; the same names on all ranks.
        regions: Cells for each name of a region likewise, for data by region.
        name: Name of the domain.
        inner: Names of the parts inside the domain. The named side of each, out of which n points, is where the last
            coordinate is larger, if its condition has no `side`. It has to have one where facets are along that axis.
        pairs: The names of the parts on both sides of each `Pair`, whose cells get to one rank: only there its error
            has a bound.

    Raises:
        InputError: If the mesh cannot be used, or a part or region is given neither by numbers nor by a function.
    """
    check_kind("mesh", mesh, dolfinx.mesh.Mesh)
    check_kind("parts", parts, Mapping, hint='; an example is {"bottom": facets}')
    topology = mesh.topology
    dim = topology.dim
    if mesh.basix_cell().name not in ("triangle", "tetrahedron") or mesh.geometry.cmaps[0].degree != 1:
        raise InputError("the mesh must consist of triangles or tetrahedra with straight edges")
    if mesh.geometry.x.dtype != np.float64:
        raise InputError(f"the mesh has coordinates of type {mesh.geometry.x.dtype}; make it with dtype=np.float64")
    if dim != mesh.geometry.dim:
        raise InputError(f"the mesh is a surface in space: its cells have dimension {dim}, not {mesh.geometry.dim}")
    topology.create_connectivity(dim - 1, dim)
    check_names("inner", inner)
    facets = {
        part: _entities(mesh, dim - 1, f"parts['{part}']", chosen, inside=part in inner)
        for part, chosen in parts.items()
    }
    cells = {region: _entities(mesh, dim, f"regions['{region}']", chosen) for region, chosen in (regions or {}).items()}
    check_pairs(pairs, parts)
    if inner or pairs:
        whole, cut = gathered(mesh, facets, cells), list[FileMesh]()

        def open_them() -> frozenset[str]:
            assert whole is not None
            unsided = [part for part in inner if part in whole.parts and along_last_axis(whole, part)]
            cut.append(opened(whole, inner, dict.fromkeys(unsided, ANY)) if inner else whole)
            return frozenset(unsided)

        unsided = on_root(mesh.comm, open_them)
        return replace(handed_out(mesh.comm, cut[0] if cut else None, name, pairs=pairs), unsided=unsided)
    labels = {part: axis_part(_longest_axis(mesh, chosen)) for part, chosen in facets.items()}
    box = bounding_box(mesh.geometry.x, mesh.comm)
    curvature = OWN_CURVATURE / float((box[1] - box[0]).max())
    return Domain(mesh, largest_diameter(mesh), labels, facets, cells, curvature, name)


def _entities(mesh: dolfinx.mesh.Mesh, dim: int, key: str, chosen: Chosen, *, inside: bool = False) -> Entities:
    """Chosen owned entities, ascending; a function chooses facets of the boundary if not `inside` (collective).

    Raises:
        InputError: On all ranks, if one of them gets neither numbers of such entities nor a function.
    """
    if callable(chosen):
        probe = np.asarray(chosen(np.zeros((3, 2))))
        if probe.shape != (2,) or probe.dtype != bool:
            raise InputError(f"{key}: the function of points of shape (3, n) must return n truth values")
        everywhere = inside or dim == mesh.topology.dim
        locate = dolfinx.mesh.locate_entities if everywhere else dolfinx.mesh.locate_entities_boundary
        return _owned(mesh, dim, locate(mesh, dim, chosen))
    index_map = mesh.topology.index_map(dim)
    size = index_map.size_local + index_map.num_ghosts
    try:
        numbers = np.asarray(chosen)
    except ValueError:  # rows of different lengths
        numbers = np.empty(1)
    if numbers.size == 0:
        numbers = np.empty(0, dtype=np.int32)
    kind = "facet" if dim < mesh.topology.dim else "cell"
    wrong = ""
    if numbers.ndim != 1 or not np.issubdtype(numbers.dtype, np.integer):
        wrong = f"{key}: must be an array of {kind} numbers, integers, or a function of points that returns a mask"
    elif np.any((numbers < 0) | (numbers >= size)):
        wrong = f"{key}: there is no {kind} {numbers[(numbers < 0) | (numbers >= size)][0]}; a rank has {size}, from 0"
    wrong = max(mesh.comm.allgather(wrong))
    if wrong:
        raise InputError(wrong)
    return _owned(mesh, dim, numbers)


def _owned(mesh: dolfinx.mesh.Mesh, dim: int, numbers: Indices) -> Entities:
    """The owned entities, ascending, that any rank lists (collective)."""
    index_map = mesh.topology.index_map(dim)
    return np.flatnonzero(sums_at(index_map, numbers)[: index_map.size_local]).astype(np.int32)


def _longest_axis(mesh: dolfinx.mesh.Mesh, facets: Entities) -> str:
    """The coordinate in which a part is longest (collective)."""
    nodes = dolfinx.mesh.entities_to_geometry(mesh, mesh.topology.dim - 1, facets)
    low, high = bounding_box(mesh.geometry.x[nodes].reshape(-1, 3), mesh.comm)
    return AXES[int(np.argmax(high - low))]


def check_parts(domain: Domain, named: Mapping[str, Sequence[str]]) -> None:
    """Refuse parts that do not exist, are empty, overlap or lie inside the domain (collective).

    Args:
        domain: The mesh with its parts.
        named: By its kind the parts that each kind of boundary consists of.

    Raises:
        InputError: If there is such a part.
    """
    check_kind("domain", domain, Domain)
    for key, names in named.items():
        unknown = [part for part in names if part not in domain.parts]
        if unknown:
            raise InputError(f"{key}: unknown part '{unknown[0]}'; there are {', '.join(domain.parts)}")
    inner = named.get("inner", ())
    for part in domain.parts:
        if part in inner and other_side(part) not in domain.parts:
            raise InputError(f"inner: the mesh is not cut along '{part}'")
        if part in inner and not any(part in names for key, names in named.items() if key != "inner"):
            raise InputError(f"inner: '{part}' needs a law: a part of Γ_S is what has one")
        if part not in inner and other_side(part) in domain.parts:
            raise InputError(f"'{part}' is inside the domain: it belongs to inner, with a law")
    named = {key: [other_side(part) for part in names] if key == "inner" else names for key, names in named.items()}
    topology, comm = domain.mesh.topology, domain.mesh.comm
    free = np.zeros(topology.index_map(topology.dim - 1).size_local, dtype=bool)
    free[dolfinx.mesh.exterior_facet_indices(topology)] = True
    for name in itertools.chain.from_iterable(named.values()):
        facets = domain.facets[name]
        count, wrong = comm.allreduce(np.array([len(facets), np.count_nonzero(~free[facets])]))
        if count == 0:
            raise InputError(f"part '{name}' has no facet")
        if wrong > 0:
            raise InputError(f"part '{name}' has {wrong} facets that are inside the domain or in another part")
        free[facets] = False
