"""From a case to what is solved: its mesh, its spaces and its data on them."""

import numpy as np
import ufl
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.discrete.data import Data, check_finite, project_data
from signorini_fenicsx.discrete.spaces import Spaces
from signorini_fenicsx.expressions import parse_expression
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain, estimated_cells, expected_cells, own_domain
from signorini_fenicsx.meshes.sampling import curve_gap


def discrete_data(case: Case, spaces: Spaces) -> Data:
    """The data of a case and their means (collective).

    Raises:
        InputError: If one of them, or the exact u, cannot be used, see `project_data`.
    """
    if case.exact.u is not None:
        u = parse_expression(case.exact.u, ufl.SpatialCoordinate(spaces.mesh))
        cells = np.arange(spaces.Q.dofmap.index_map.size_local, dtype=np.int32)
        check_finite(spaces, "[exact] u", "in the domain", u, cells)
    return project_data(spaces, case.problem.read(spaces.mesh.geometry.dim))


def mesh_case(case: Case, comm: MPI.Comm) -> Domain:
    """Mesh the domain of a case, or read its mesh (collective).

    Raises:
        InputError: If there is no mesh with the case's h, or the file's mesh does not suit the case.
    """
    geometry = case.geometry
    if geometry.shape is not None:
        return build_domain(comm, geometry.shape, case.solve.h, mesh=geometry.mesh, diagonal=geometry.diagonal)
    domain = own_domain(comm, geometry.file or "", case.file_h, case.boundary.model_dump(exclude_none=True))
    case.check_dimension(domain.mesh.topology.dim)
    return domain


def rough_cells(case: Case) -> float:
    """About how many cells the mesh of a case has, without making it; a file is read (rank 0).

    Raises:
        InputError: If the file or its mesh cannot be used, or there are too many.
    """
    geometry = case.geometry
    if geometry.shape is not None:
        return estimated_cells(geometry.shape, case.solve.h)
    return expected_cells(geometry.file or "", case.file_h)


def check_solvability(spaces: Spaces, data: Data) -> None:
    """Without Γ_D the total load decides (collective).

    The flux leaves through Γ_S alone: ∫ (σ·n − q_S) on Γ_S = −m with m = ∫f + ∫g_N + ∫q_S, and must not be negative. If
    it is 0, u is a solution of the Neumann problem that any large constant may be added to.

    Raises:
        InputError: If there is no solution, or more than one.
    """
    if not spaces.has_dirichlet and data.total_load >= 0:
        verdict = "there is no solution" if data.total_load > 0 else "u is not unique"
        raise InputError(
            "no part of the boundary is left to u = u_D, and the total load ∫f + ∫g_N + ∫q_S is "
            f"{data.total_load:.3g}: {verdict}; it must be negative, or part of the boundary in Γ_D"
        )


def same_domain(case: Case, domain: Domain, other_case: Case, other: Domain) -> bool:
    """Whether two meshes are of one domain: by the name of the shape; with files, by bounding boxes (collective)."""
    if case.geometry.shape is not None and other_case.geometry.shape is not None:
        return case.geometry.shape == other_case.geometry.shape
    if domain.mesh.topology.dim != other.mesh.topology.dim:
        return False
    distance = np.abs(domain.box() - other.box()).max()
    return bool(distance <= curve_gap(domain) + curve_gap(other))
