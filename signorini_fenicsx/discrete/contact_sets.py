"""Sets of facets of Γ_S, on meshes that need not match: how much they overlap and how far they are apart."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import basix
import dolfinx.geometry
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_dofs, cell_nodes, function_at, function_of
from signorini_fenicsx.base.parallel import passed_on
from signorini_fenicsx.discrete.cell_shapes import nearest
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.meshes.sampling import QUADRATURE_DEGREE, curve_gap, of_unit_size, sampled

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
    """The segment of its law that each site is on, from which a problem can start, on another mesh too.

    Attributes:
        spaces: Where they are.
        segment: Number of its segment for each site of `spaces.site_kinds`; without laws in Ω none of cells.
        carried: What else the vertices of facets hand on, by name, shape (facets, d, …): with friction the "bound" of
            the shear and, where it is known, the "slip", u_t in space of those that slip.
        u: The u of a solution at the vertices of the owned cells, shape (cells, d + 1), where it tells more than the
            segments, as where κ depends on u; None for none.
    """

    spaces: MeshSpaces
    segment: Indices
    carried: Mapping[str, Array] = field(default_factory=dict)
    u: Array | None = None

    def of(self, name: str) -> Indices:
        """The segments of one kind of sites."""
        return self.spaces.site_kinds[name].of(self.segment)

    def on(self, spaces: MeshSpaces) -> "Segments":
        """The segments on another mesh of the domain, by `near_facets`, of a cell that at its centroid (collective)."""
        if spaces is self.spaces:
            return self
        rows = [_shaped(each, spaces) for each in self.spaces.site_kinds.spread(self.segment)]
        found = near_facets([*rows, *self.carried.values()], self.spaces, spaces)
        segment = np.rint(spaces.site_kinds.gathered(*found[: len(rows)])).astype(np.int64)
        if spaces.mesh.comm.allreduce("cell" in self.spaces.site_kinds and len(self.of("cell")) > 0, MPI.LOR):
            segment = np.append(segment, self._in_cells(spaces))
        carried = dict(zip(self.carried, found[len(rows) :], strict=True))
        return Segments(spaces, segment, carried, self.u_on(spaces))

    def u_on(self, spaces: Any) -> Array | None:
        """The u on another mesh of the domain, or on this one as it is (collective)."""
        if self.u is None or spaces.mesh is self.spaces.mesh:
            return self.u
        space = fenicsx.function_space(self.spaces.mesh, ("DG", 1))
        u = function_at(space, cell_dofs(space), self.u, "u")
        (sample,) = sampled([u], spaces.mesh, self.spaces.domain)
        values = sample.x.array[sample.function_space.dofmap.list[: len(spaces.cell_measures)]]
        points = basix.make_quadrature(spaces.mesh.basix_cell(), QUADRATURE_DEGREE)[0]  # as many as vertices
        hats = np.column_stack([1 - points.sum(axis=1), points])
        return np.asarray(values @ np.linalg.inv(hats).T)

    def _in_cells(self, spaces: Any) -> Indices:
        """The segment of each cell of another mesh: at its centroid, or near each of its vertices (collective).

        Of values at vertices it is that of the linear function, rounded.
        """
        source: Any = self.spaces
        comm, (_, kind), (_, wanted) = spaces.mesh.comm, source.site_kinds, spaces.site_kinds
        cells = kind.rows_of(self.segment)
        most = comm.allreduce(int(cells.max(initial=0)), MPI.MAX)
        usual = int(np.argmax(comm.allreduce(np.bincount(cells.ravel(), minlength=most + 1))))
        near = self._near_others((cells != usual).reshape(len(cells), -1).any(axis=1), spaces.mesh)
        numbers = (source.scalar if kind.shape else partial(function_of, source.Q))(cells - usual)
        degree = QUADRATURE_DEGREE if wanted.shape else 0
        (sample,) = sampled([numbers], spaces.mesh, self.spaces.domain, degree=degree, cells=near)
        found = sample.x.array[sample.function_space.dofmap.list[: wanted.count]]
        if wanted.shape:
            points = basix.make_quadrature(spaces.mesh.basix_cell(), degree)[0]
            hats = np.column_stack([1 - points.sum(axis=1), points])[:, spaces.order]
            found = np.take_along_axis(found, hats.argmax(axis=0), axis=1)
        return np.rint(found).astype(np.int64).ravel() + usual

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


def _shaped(rows: np.ndarray, spaces: MeshSpaces) -> np.ndarray:
    """Values by facet in the place of those by vertex, or the other way, as the sites of other spaces are."""
    (kind, *_), dim = spaces.site_kinds, spaces.mesh.topology.dim
    if rows.ndim == 1 and kind.shape:
        return np.repeat(rows[:, None], dim, axis=1)
    return rows[:, 0] if rows.ndim > 1 and not kind.shape else rows


def near_facets(values: Sequence[Array], source: MeshSpaces, target: MeshSpaces) -> list[Array]:
    """What values on the facets of Γ_S of one mesh are on those of another mesh of the domain (collective).

    One value of a facet is that at its midpoint. Of values at vertices each facet takes as many as it has vertices, in
    points inside it, each near a vertex, where it is plain on which facet of the other mesh they are.

    Args:
        values: One per facet, shape (facets,), or at vertices as linear functions, shape (facets, d, …); not both.
        source: The spaces on their mesh.
        target: Those on the other mesh.
    """
    if not target.part_names:
        return list(values)
    gamma, dim, by_vertex = target.Lambda.mesh, target.mesh.topology.dim, values[0].ndim > 1
    make, degree = (source.linear_multiplier, QUADRATURE_DEGREE) if by_vertex else (source.multiplier, 0)
    samples = sampled([make(each) for each in values], gamma, source.domain, degree=degree)
    points = basix.make_quadrature(gamma.basix_cell(), degree)[0]
    hats = np.column_stack([1 - points.sum(axis=1), points])
    size = target.Lambda.dofmap.index_map.size_local
    facets = target.Lambda.dofmap.list[:size, 0]
    places = np.einsum("qa,fai->fqi", hats, gamma.geometry.x[gamma.geometry.dofmaps[0][:size], :dim])
    near = nearest(target.corners[facets], places)
    found = []
    for sample in samples:
        shape = sample.ufl_shape
        at_points = sample.x.array.reshape(-1, *shape)[sample.function_space.dofmap.list[:size]]
        rows = np.empty((size, dim, *shape))
        rows[facets] = np.take_along_axis(at_points, near.reshape(*near.shape, *[1] * len(shape)), axis=1)
        found.append(rows if by_vertex else rows[:, 0])
    return found


def jaccard(coarse: FacetSet, fine: FacetSet) -> float:
    """|A ∩ B| / |A ∪ B|, 1 if both are empty (collective).

    Computed by quadrature on the facets of `fine`: exact, except on facets that `coarse` covers in part.
    """
    gamma = fine.spaces.Lambda.mesh
    (covered,) = sampled([coarse.indicator()], gamma, coarse.spaces.domain, degree=OVERLAP_DEGREE)
    inside = fine.indicator()
    dx = ufl.Measure("dx", gamma, metadata={"quadrature_degree": OVERLAP_DEGREE, "quadrature_scheme": "default"})
    forms = [fenicsx.form(integrand * dx) for integrand in (covered * inside, covered + inside - covered * inside)]
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


def by_part(spaces: MeshSpaces, laws: Iterable[Any], segment: Indices) -> dict[str, dict[str, dict[str, float]]]:
    """Number and measure of the sites on each segment of a law, by part and name of the segment (collective).

    Args:
        spaces: The spaces, with the names of the parts.
        laws: The laws with their parts.
        segment: The segment that each facet of Γ_S, or each vertex of these, is on.
    """
    states, (kind, *_) = {}, spaces.site_kinds
    for law in (each.law for each in laws):
        for part in law.parts:
            on = kind.numbers(spaces.rows_on(part))
            states[part] = by_state(
                spaces.mesh.comm, law.segments, law.named(segment[on]), kind.measure[on], kind.called
            )
    return states
