"""Domains made of given points and cells; midpoints of facets define Γ_S."""

from collections.abc import Callable

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.meshes.domain import Domain, axis_part, distribute, largest_diameter

type Array = npt.NDArray[np.float64]
type Mask = npt.NDArray[np.bool_]


def own_domain(
    comm: MPI.Comm, points: npt.ArrayLike, cells: npt.ArrayLike, signorini: Callable[[Array], Mask]
) -> Domain:
    """A domain with Γ_S, called "bottom", made of the facets chosen by midpoints of shape (3, n) (collective)."""
    points, cells = np.asarray(points, dtype=np.float64), np.asarray(cells, dtype=np.int64)
    dim = points.shape[1]
    own = comm.rank == 0
    mesh = distribute(comm, points if own else points[:0], cells if own else cells[:0], dim)
    topology = mesh.topology
    topology.create_entities(dim - 1)
    topology.create_connectivity(dim - 1, dim)
    boundary = dolfinx.mesh.exterior_facet_indices(topology)
    inside = signorini(dolfinx.mesh.compute_midpoints(mesh, dim - 1, boundary).T)
    curvature = 1 / float(np.ptp(points, axis=0).max())
    return Domain(mesh, largest_diameter(mesh), {"bottom": axis_part("x")}, {"bottom": boundary[inside]}, {}, curvature)
