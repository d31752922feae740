"""Sets of facets of Γ_S, on meshes that need not match: how much they overlap and how far they are apart."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import dolfinx.geometry
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_nodes, function_of, owned_values
from signorini_fenicsx.base.parallel import passed_on
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.meshes.sampling import curve_gap, of_unit_size, sampled

OVERLAP_DEGREE = 10
"""Quadrature degree for the part of a facet that the other set covers; it is found to about 1/6 of the facet."""
SUBDIVISIONS = 4
"""Parts of each edge of a facet; distances are measured from the points of this grid."""


@dataclass(frozen=True)
class FacetSet:
    """Some facets of Γ_S.

    Attributes:
        spaces: The spaces on the mesh of these facets.
        inside: Mask of `spaces.facets`: True for those in the set.
    """

    spaces: MeshSpaces
    inside: npt.NDArray[np.bool_]

    def indicator(self) -> fem.Function:
        """1 on the set, 0 off it, in P0(Γ_S) (collective)."""
        return self.spaces.multiplier(self.inside, "indicator")

    def points(self) -> Array:
        """A grid of points on each facet of this rank, vertices included, shape (points, 3)."""
        mesh = self.spaces.mesh
        dim = mesh.topology.dim
        nodes = dolfinx.mesh.entities_to_geometry(mesh, dim - 1, self.spaces.facets[self.inside])
        steps = np.indices((SUBDIVISIONS + 1,) * (dim - 1)).reshape(dim - 1, -1).T / SUBDIVISIONS
        steps = steps[steps.sum(axis=1) <= 1]
        weights = np.column_stack([1 - steps.sum(axis=1), steps])
        return np.einsum("pc,fcx->fpx", weights, mesh.geometry.x[nodes]).reshape(-1, 3)


@dataclass(frozen=True)
class Segments:
    """The segment of its law that each facet of Γ_S is on, from which another mesh can start.

    Attributes:
        spaces: Where they are.
        segment: Number of its segment for each of `spaces.facets`.
        cells: The same for each owned cell, if there are laws in Ω; otherwise None.
    """

    spaces: MeshSpaces
    segment: Indices
    cells: Indices | None = None

    @classmethod
    def of_sites(cls, spaces: MeshSpaces, segment: Indices) -> Self:
        """The segments of facets and, if there are more, of the cells behind them (collective)."""
        number = len(spaces.facets)
        more = spaces.mesh.comm.allreduce(len(segment) > number, MPI.LOR)
        return cls(spaces, segment[:number], segment[number:] if more else None)

    def on(self, spaces: MeshSpaces) -> Indices:
        """The segments for the sites of another mesh of the domain: that at the midpoint of each (collective)."""
        if spaces is self.spaces:
            return self.segment if self.cells is None else np.append(self.segment, self.cells)
        segments = np.empty(0, dtype=np.int64)
        if spaces.part_names:
            segments = self._sample(self.spaces.multiplier(self.segment, "segment"), spaces.Lambda.mesh)
        segments = segments[: len(spaces.facets)]
        if self.cells is None:
            return segments
        usual = self._usual(self.cells)
        numbers = function_of(self.spaces.Q, self.cells - usual)
        near = self._near_others(self.cells != usual, spaces.mesh)
        return np.append(segments, self._sample(numbers, spaces.mesh, near) + usual)

    def _usual(self, segment: Indices) -> int:
        """The segment that most cells of all ranks are on (collective)."""
        comm = self.spaces.mesh.comm
        most = comm.allreduce(int(segment.max(initial=0)), MPI.MAX)
        return int(np.argmax(comm.allreduce(np.bincount(segment, minlength=most + 1))))

    def _sample(
        self, numbers: fem.Function, mesh: dolfinx.mesh.Mesh, cells: npt.NDArray[np.int32] | None = None
    ) -> Indices:
        (sample,) = sampled([numbers], mesh, self.spaces.domain, degree=0, cells=cells)
        return np.rint(owned_values(sample)).astype(np.int64)

    def _near_others(self, others: Mask, mesh: dolfinx.mesh.Mesh) -> npt.NDArray[np.int32]:
        """Owned cells of another mesh with their centroid in the box around all cells of a mask (collective).

        The search of cells takes longer than anything else in a prediction.
        """
        geometry, gap = self.spaces.mesh.geometry, curve_gap(self.spaces.domain)
        corners = geometry.x[self.spaces.nodes[others]].reshape(-1, 3)
        ends = np.stack([corners, -corners]).min(axis=1, initial=np.inf)
        mesh.comm.Allreduce(MPI.IN_PLACE, ends, MPI.MIN)
        low, high = ends[0] - gap, gap - ends[1]
        centroids = mesh.geometry.x[cell_nodes(mesh)].mean(axis=1)
        return np.flatnonzero(np.all((low <= centroids) & (centroids <= high), axis=1)).astype(np.int32)


def transferred(contact: FacetSet, spaces: MeshSpaces) -> Mask:
    """Which facets of Γ_S are in a set of another mesh of the domain: those whose midpoints are (collective)."""
    return Segments(contact.spaces, contact.inside.astype(np.int64)).on(spaces) > 0


def jaccard(coarse: FacetSet, fine: FacetSet) -> float:
    """|A ∩ B| / |A ∪ B|, 1 if both are empty (collective).

    Computed by quadrature on the facets of `fine`: exact, except on facets that `coarse` covers in part.
    """
    gamma = fine.spaces.Lambda.mesh
    (theirs,) = sampled([coarse.indicator()], gamma, coarse.spaces.domain, degree=OVERLAP_DEGREE)
    mine = fine.indicator()
    dx = ufl.Measure("dx", gamma, metadata={"quadrature_degree": OVERLAP_DEGREE, "quadrature_scheme": "default"})
    forms = [fenicsx.form(integrand * dx) for integrand in (theirs * mine, theirs + mine - theirs * mine)]
    both, either = gamma.comm.allreduce(np.array([fem.assemble_scalar(form) for form in forms])).tolist()
    return both / either if either > 0 else 1.0


def hausdorff(one: FacetSet, other: FacetSet) -> float:
    """Hausdorff distance, 0 if both sets are empty, infinite if one is (collective).

    Distances to facets are exact, but they are measured only from `FacetSet.points`. So the result may be too small by
    at most an eighth of the largest facet's diameter in 2D, a quarter in 3D.
    """
    return max(_largest_distance(one, other), _largest_distance(other, one))


def _largest_distance(one: FacetSet, other: FacetSet) -> float:
    """The largest distance of points of one set to the other set (collective)."""
    comm = one.spaces.mesh.comm
    points = np.unique(one.points(), axis=0)
    nearest = np.full(len(points), np.inf)
    gamma = other.spaces.Lambda.mesh
    dim = gamma.topology.dim
    cells = np.flatnonzero(other.inside[other.spaces.Lambda.dofmap.list[:, 0]]).astype(np.int32)
    with of_unit_size(other.spaces.domain, gamma) as frame:
        if len(cells) > 0:
            tree = dolfinx.geometry.bb_tree(gamma, dim, entities=cells)
            middles = dolfinx.geometry.create_midpoint_tree(gamma, dim, cells)
        for _ in range(comm.size):
            if len(cells) > 0 and len(points) > 0:
                closest = dolfinx.geometry.compute_closest_entity(tree, middles, gamma, frame.of(points))
                squares = dolfinx.geometry.squared_distance(gamma, dim, closest, frame.of(points))
                nearest = np.minimum(nearest, np.sqrt(squares) / frame.factor)
            points, nearest = passed_on(comm, (points, nearest))
    return float(comm.allreduce(nearest.max(initial=0.0), MPI.MAX))


def by_state(
    comm: MPI.Comm, names: Sequence[str], state: Indices, measure: Array, sites: str
) -> dict[str, dict[str, float]]:
    """Number and measure of the sites in each state, by the name of the state (collective).

    Args:
        comm: Communicator.
        names: The names of the states.
        state: The number of the state of each site of this rank.
        measure: Of each site.
        sites: What the sites are called.
    """
    local = np.stack([np.bincount(state, weights, len(names)) for weights in (None, measure)])
    counts, measures = comm.allreduce(local).tolist()
    return {
        name: {sites: int(count), "measure": size} for name, count, size in zip(names, counts, measures, strict=True)
    }


def by_part(
    spaces: MeshSpaces,
    laws: Iterable[Any],
    segment: Indices,
    part_of_site: npt.NDArray[np.int32],
    measure: Array,
    sites: str,
) -> dict[str, dict[str, dict[str, float]]]:
    """Number and measure of the sites on each segment of a law, by part and name of the segment (collective).

    Args:
        spaces: The spaces, with the names of the parts.
        laws: The laws with their parts.
        segment: The segment that each site is on.
        part_of_site: The number of the part of each site.
        measure: Of each site.
        sites: What the sites are called.
    """
    states = {}
    for law in (each.law for each in laws):
        for part in law.parts:
            on = part_of_site == spaces.part_names.index(part)
            states[part] = by_state(spaces.mesh.comm, law.segments, law.named(segment[on]), measure[on], sites)
    return states
