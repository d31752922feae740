"""Functions of other programs for cases: the mesh with the parts of the case, and the function on it."""

import dolfinx.mesh
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import refuse_time
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.fields import on_mesh_of, read_field
from signorini_fenicsx.meshes.meshing import label_parts
from signorini_fenicsx.meshes.uniform import refined_uniformly


def field_of_case(
    case: CaseFile, path: str, name: str | None, levels: int, comm: MPI.Comm = MPI.COMM_WORLD
) -> tuple[Domain, fem.Function]:
    """The mesh of a case with a function from a file on it (collective).

    A case on a named shape takes the mesh of the file; one on a mesh file has that mesh.

    Args:
        case: The case.
        path: The file, see `read_field`.
        name: Name of the values; None if there are no others.
        levels: How often the mesh is refined uniformly, so that the flux is more exact than the function.
        comm: Communicator of the mesh.

    Raises:
        InputError: If the file cannot be used, or its function is not one on this mesh.
    """
    refuse_time(case)
    if case.parts.named.get("inner"):
        raise InputError(f"field {path}: {case.name} has parts inside the domain, where a file has one value and u two")
    source, field = read_field(comm, path, name, vector=case.is_vector)
    shape = case.geometry.shape
    domain = mesh_case(case, comm) if shape is None else source
    for _ in range(levels):
        domain = refined_uniformly(domain)
    if shape is not None:
        domain = _labelled(domain, shape, path)
    return domain, field if domain.mesh is source.mesh else on_mesh_of(domain, field, source)


def _labelled(domain: Domain, shape: str, path: str) -> Domain:
    """The mesh with the parts of a named shape (collective).

    Raises:
        InputError: If its boundary is not that of the shape.
    """
    labelled = label_parts(domain.mesh, shape, made=domain.origin())
    outer = len(dolfinx.mesh.exterior_facet_indices(domain.mesh.topology))
    apart = np.array([len(np.unique(np.concatenate(list(labelled.facets.values())))) - outer])
    if domain.mesh.comm.allreduce(np.abs(apart).sum()) > 0:
        raise InputError(f"field {path}: the boundary of its mesh is not that of the shape '{shape}'")
    return labelled
