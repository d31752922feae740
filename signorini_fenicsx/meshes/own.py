"""Domains from meshes of one's own."""

from collections.abc import Mapping

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.domain import AXES, Boundary, Domain, axis_part, bounding_box, largest_diameter
from signorini_fenicsx.meshes.meshing import OWN_CURVATURE

type Entities = npt.NDArray[np.int32]


def domain_of(
    mesh: dolfinx.mesh.Mesh,
    parts: Mapping[str, Entities],
    regions: Mapping[str, Entities] | None = None,
    name: str = "mesh",
) -> Domain:
    """A mesh with its parts as the solver wants them (collective).

    Args:
        mesh: Triangles or tetrahedra with straight edges, without ghost cells (`ghost_mode=GhostMode.none`).
        parts: Boundary facets of this rank by the name of their part.
        regions: Cells of this rank by the name of their region, for κ by region.
        name: What the domain is called.

    Raises:
        InputError: If the mesh cannot be used.
    """
    topology = mesh.topology
    dim = topology.dim
    if mesh.basix_cell().name not in ("triangle", "tetrahedron") or mesh.geometry.cmaps[0].degree != 1:
        raise InputError("the mesh must consist of triangles or tetrahedra with straight edges")
    if dim != mesh.geometry.dim:
        raise InputError(f"the mesh is a surface in space: its cells have dimension {dim}, not {mesh.geometry.dim}")
    if mesh.comm.allreduce(topology.index_map(dim).num_ghosts > 0, MPI.LOR):
        raise InputError("the mesh has ghost cells; make it with ghost_mode=dolfinx.mesh.GhostMode.none")
    topology.create_connectivity(dim - 1, dim)
    facets = {part: np.unique(chosen).astype(np.int32) for part, chosen in parts.items()}
    labels = {part: axis_part(_longest_axis(mesh, chosen)) for part, chosen in facets.items()}
    box = bounding_box(mesh.geometry.x, mesh.comm)
    curvature = OWN_CURVATURE / float((box[1] - box[0]).max())
    return Domain(mesh, largest_diameter(mesh), labels, facets, regions or {}, curvature, name)


def _longest_axis(mesh: dolfinx.mesh.Mesh, facets: Entities) -> str:
    """The coordinate along which a part extends most (collective)."""
    nodes = dolfinx.mesh.entities_to_geometry(mesh, mesh.topology.dim - 1, facets)
    low, high = bounding_box(mesh.geometry.x[nodes].reshape(-1, 3), mesh.comm)
    return AXES[int(np.argmax(high - low))]


def check_parts(domain: Domain, boundary: Boundary) -> None:
    """Refuse parts that are not there, are empty, overlap or lie inside the domain (collective).

    Raises:
        InputError: If there is one.
    """
    for key, names in vars(boundary).items():
        unknown = [part for part in names if part not in domain.parts]
        if unknown:
            raise InputError(f"{key}: unknown part '{unknown[0]}'; there are {', '.join(domain.parts)}")
    topology, comm = domain.mesh.topology, domain.mesh.comm
    free = np.zeros(topology.index_map(topology.dim - 1).size_local, dtype=bool)
    free[dolfinx.mesh.exterior_facet_indices(topology)] = True
    for name in [*boundary.signorini, *boundary.neumann]:
        facets = domain.facets[name]
        count, wrong = comm.allreduce(np.array([len(facets), np.count_nonzero(~free[facets])]))
        if count == 0:
            raise InputError(f"part '{name}' has no facet")
        if wrong > 0:
            raise InputError(f"part '{name}' has {wrong} facets that are inside the domain or in another part")
        free[facets] = False
