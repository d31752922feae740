"""The facets of Γ_S inside the domain, across which u may jump; the mesh is cut along them."""

from collections.abc import Sequence
from dataclasses import dataclass

import dolfinx.mesh
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.meshes.domain import Domain, other_side


@dataclass(frozen=True)
class InnerFacets:
    """The facets of Γ_S that are inside the domain, and on each of them a second one, of the cell on the other side.

    There p is the jump of u, and σ·n is the flux out of the named side, which is that into the other.

    Attributes:
        rows: Rows of `Spaces.facets`.
        facets: The mesh facets of the other side.
        present: Whether any rank has such facets.
    """

    rows: npt.NDArray[np.intp]
    facets: npt.NDArray[np.int32]
    present: bool


def inner_facets(domain: Domain, facets: npt.NDArray[np.int32], inner: Sequence[str]) -> InnerFacets:
    """Those of the Γ_S facets of this rank that are on inner parts, each with the one that lies on it.

    Both have the same vertices but for their numbers, and so exactly the same sums of coordinates.
    """
    rows, across = [np.empty(0, dtype=np.intp)], [np.empty(0, dtype=np.int32)]
    for name in inner:
        row = np.flatnonzero(np.isin(facets, domain.facets[name]))
        other = domain.facets[other_side(name)]
        here, there = (np.lexsort(_places(domain.mesh, some).T) for some in (facets[row], other))
        rows.append(row[here])
        across.append(other[there])
    return InnerFacets(np.concatenate(rows), np.concatenate(across), bool(inner))


def _places(mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32]) -> Array:
    """Sums of the coordinates of the vertices of facets; they identify a facet."""
    nodes = dolfinx.mesh.entities_to_geometry(mesh, mesh.topology.dim - 1, facets)
    return np.asarray(np.sort(mesh.geometry.x[nodes], axis=1).sum(axis=1), dtype=np.float64)
