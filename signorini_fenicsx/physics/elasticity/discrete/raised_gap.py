"""Gaps that differ by linear functions on facets: of tools that move, and of tools that are surface meshes.

The distance to a surface mesh along the normal of a facet of Γ_C is taken at the vertices of the facet, and is linear
between them. So the gap is as the mesh of the body sees the tool: the tool itself where it is plane over each facet.
The discrete problem has exactly this gap, and the bound is one of the distance to the solution with it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets
from signorini_fenicsx.discrete.points import FacetPoints, Points
from signorini_fenicsx.meshes.domain import other_side
from signorini_fenicsx.meshes.surfaces import read_surface
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces


@dataclass(frozen=True)
class RaisedGap(Datum):
    """A gap that is larger by a linear function on each of some facets of Γ_C.

    Attributes:
        gap: The gap without it.
        facets: The facets, ascending.
        offsets: The function at the origin, for each facet.
        slopes: Its gradient along each of them, shape (facets, d).
    """

    gap: Datum
    facets: npt.NDArray[np.int32]
    offsets: Array
    slopes: Array

    @classmethod
    def of(cls, gap: Datum, facets: BoundaryFacets, by: Array) -> "RaisedGap":
        """A gap raised by a function with these values at the vertices of facets, shape (facets, d)."""
        edges = facets.vertices[:, 1:] - facets.vertices[:, :1]
        slopes = np.einsum("nik,nk->ni", np.linalg.pinv(edges), by[:, 1:] - by[:, :1])
        offsets = by[:, 0] - np.einsum("ni,ni->n", slopes, facets.vertices[:, 0])
        order = np.argsort(facets.facets)
        return cls(gap.ufl, gap, facets.facets[order], offsets[order], slopes[order])

    @property
    def degree(self) -> int:
        """The degree that is estimated."""
        return max(self.gap.degree, 1)

    @property
    def number(self) -> None:
        """The gap is not one number: None."""

    @property
    def polynomial(self) -> int | None:
        """The degree of the polynomial that it is on each facet, or None."""
        return None if self.gap.polynomial is None else max(self.gap.polynomial, 1)

    def by_facets(self, facets: npt.NDArray[np.int32]) -> list[tuple[Mask, Datum]]:
        """The data of the gap on facets; the function that raises it is none of the data."""
        return self.gap.by_facets(facets)

    def _look(self, points: Points, *, slope: bool) -> Array:
        assert isinstance(points, FacetPoints)
        assert not slope
        gaps = np.array(self.gap.values(points))
        on = np.flatnonzero(np.isin(points.facets, self.facets))
        rows = np.searchsorted(self.facets, points.facets[on])
        gaps[on] += self.offsets[rows, None] + np.einsum("nqi,ni->nq", points.x[on], self.slopes[rows])
        return gaps


def beyond_surfaces(spaces: ElasticSpaces, gap: Datum, surfaces: Mapping[str, str | Path]) -> Datum:
    """A gap that is that to surfaces from files, by part, and the given one more (collective).

    A vertex from which the normal misses the surface is as far from it as the domain is long.

    Raises:
        InputError: If a file cannot be used, or is nowhere in reach.
    """
    comm = spaces.mesh.comm
    for part, path in surfaces.items():
        if part not in spaces.boundary.contact or other_side(part) in spaces.domain.parts:
            raise InputError(f"[[law]] surface: part '{part}' is not in contact with a foundation")
        facets, key = spaces.part(part), (part, str(path))
        if key not in spaces.distances:
            surface = read_surface(comm, path, spaces.dim)
            directions = np.repeat(facets.normals, spaces.dim, axis=0)
            spaces.distances[key] = surface.distances(facets.vertices.reshape(-1, spaces.dim), directions)
        distances = spaces.distances[key].reshape(-1, spaces.dim)
        if not comm.allreduce(bool(np.isfinite(distances).any()), MPI.LOR):
            raise InputError(f"surface {path}: no line along the normal from a vertex of part '{part}' meets it")
        far = float(np.ptp(spaces.domain.box()[:, : spaces.dim], axis=0).max())
        gap = RaisedGap.of(gap, facets, np.where(np.isfinite(distances), distances, far))
    return gap
