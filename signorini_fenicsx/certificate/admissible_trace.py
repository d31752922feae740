"""A continuous function near u that is admissible in the gap identity: v = u_D on Γ_D and v ≥ ψ on Γ_S.

v is quadratic on each cell, except near Γ_D and Γ_S where u_D and ψ are not quadratic. Let I_h be the interpolant in
vertices and midpoints of edges, and w = v − I_hψ, given by its Bernstein coefficients. Then in general

    v = I_hψ + max(w + w_⁺ + χ_t(ψ − I_hψ) + χ_D(u_D − I_hψ − χ_t(ψ − I_hψ) − w_D), ψ − I_hψ − ℓ on Γ_S).

χ_D, χ_t and w_⁺ are continuous and linear on each cell. χ_D is 1 on Γ_D, where w_D = w. χ_t is 1 in those vertices of
Γ_S whose facets on Γ_S all touch (w = 0); where χ_t = 1, v is ψ itself. On the other facets w_⁺ raises v by as much as
v is below ψ in sampled points, and the maximum ensures v ≥ ψ in all other points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
from dolfinx import fem, la
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.small_matrices import squares_of, times
from signorini_fenicsx.certificate.metric import CellMetric
from signorini_fenicsx.certificate.relaxation import Edges, Obstacle, all_edges, relax
from signorini_fenicsx.discrete.datum import quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import extreme_around
from signorini_fenicsx.discrete.points import (
    Points,
    facet_lattice,
    facet_type,
    in_cells,
    in_facets,
    owned_cells,
    quadratic_nodes,
)
from signorini_fenicsx.physics.diffusion.data import Data
from signorini_fenicsx.physics.diffusion.jets import cut_off, larger
from signorini_fenicsx.physics.diffusion.nodes import facet_nodes, largest_around
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.spaces import Spaces

type Indices = npt.NDArray[np.int32]

FAR_BELOW = 20.0
"""The maximum in the module must not change v away from Γ_S, so ℓ has to grow fast enough. A quadratic function on a
cell that is ≥ 0 on Γ_S falls from there by less than this times its largest nodal value: its Lebesgue constant is at
most 2, and by Markov's inequality its slope is at most 8 times its maximum. On Γ_D u_D − ψ may fall faster and is
sampled."""
BEYOND = "u_D is beyond a bound of u where Γ_D meets Γ_S"
SAMPLES = 12
"""Parts of the edges of facets, for the points in which v is compared with ψ."""
ROOM = 1.001, 2.0
"""v is raised by its sampled distance below ψ times the first factor, or the second if the facet touches Γ_D: there one
vertex cannot rise."""


class HasJet(Protocol):
    """A function that is known by its jet."""

    def jet(self, points: Points, *, gradient: bool = False) -> Array:
        """Its jet, see `discrete.points` (collective)."""
        ...


@dataclass(frozen=True)
class Trace:
    """A continuous function near u.

    Attributes:
        v: Quadratic on cells, with the values of u_D in its nodes on Γ_D.
        exact: The admissible function: v changed to be u_D itself on Γ_D and ≥ ψ itself on Γ_S; None if that is v.
        above: Gives the admissible function − ψ in points of Γ_S.
        cells: Owned cells on which v and exact may differ.
        at_dirichlet: Those of these cells where u_D itself enters.
        touching: Those of these cells where χ_t > 0, so that ψ itself enters.
        altered: Those of these cells where not only an obstacle in Ω may make a difference.
        lowest: Lower bound of v − I_hψ per facet of Γ_S.
        hindrance: Why no continuous function is admissible, in words; empty if one is. The same on all ranks.
        degree: Degree of a quadrature in `cells`.
    """

    v: fem.Function
    exact: HasJet | None
    above: Callable[[Points], Array]
    cells: Indices
    at_dirichlet: Indices
    touching: Indices
    altered: Indices
    lowest: Array
    hindrance: str
    degree: int

    def jet(self, points: Points, *, near: bool, gradient: bool = False) -> Array:
        """The jet of the admissible function in points of `cells` (near) or of others (collective)."""
        if near and self.exact is not None:
            return self.exact.jet(points, gradient=gradient)
        return points.quadratic(self.v, gradient=gradient)


def admissible_trace(solution: Solution, metric: CellMetric, y: fem.Function) -> Trace:
    """The reconstruction, made continuous and admissible, with a small gap to y (collective)."""
    spaces, data = solution.spaces, solution.data
    mesh = spaces.mesh
    facet_dim = mesh.topology.dim - 1
    v = averaged(solution, metric)
    space = v.function_space
    edges = all_edges(space)
    on_signorini = fem.locate_dofs_topological(space, facet_dim, spaces.facets)
    on_dirichlet = fem.locate_dofs_topological(space, facet_dim, spaces.dirichlet_facets)
    in_contact = fem.locate_dofs_topological(space, facet_dim, spaces.facets[solution.contact_set().inside])

    nodes = quadratic_nodes(mesh.basix_cell())
    w_D, psi = (datum.at_nodes(space, nodes) for datum in (data.u_D, data.psi))  # values, not coefficients
    w_D.x.array[:] -= psi.x.array
    w = v.copy()
    w.x.array[:] -= psi.x.array
    w.x.array[in_contact] = 0.0
    w.x.array[on_dirichlet] = w_D.x.array[on_dirichlet]
    largest = mesh.comm.allreduce(max(np.abs(each.x.array).max(initial=0.0) for each in (v, psi)), MPI.MAX)
    on_both = w_D.x.array[np.intersect1d(on_signorini, on_dirichlet)]
    feasible = mesh.comm.allreduce(bool((on_both >= -1e-12 * largest).all()), MPI.LAND)
    hindrance = "" if feasible else BEYOND
    for function in (w, w_D, psi):
        edges.to_bernstein(function.x.array)
    room = None if data.psi.number is not None else _overshoot(spaces, data, psi, edges)
    obstacle = Obstacle(edges, np.setdiff1d(on_signorini, on_dirichlet), mesh.topology.dim, room)
    obstacle.project(w.x.array)
    relax(w, psi, y, data.kappa_h, _excess(spaces, data, y, space), on_dirichlet, obstacle)
    v.x.array[:] = w.x.array + psi.x.array
    if data.u_D.number is not None and data.psi.number is not None:
        nowhere, zero = (np.empty(0, dtype=np.int32),) * 4, np.zeros(len(spaces.facets))
        return Trace(v, None, lambda points: points.quadratic(w)[:, :, 0], *nowhere, zero, hindrance, 0)
    return _with_exact_data(spaces, data, v, w, w_D, psi, hindrance=hindrance)


def _with_exact_data(
    spaces: Spaces,
    data: Data,
    v: fem.Function,
    w: fem.Function,
    w_D: fem.Function,
    psi: fem.Function,
    *,
    hindrance: str,
) -> Trace:
    """The trace with u_D and ψ themselves instead of their interpolants (collective)."""
    mesh = spaces.mesh
    facet_dim = mesh.topology.dim - 1
    linear = fenicsx.function_space(mesh, ("Lagrange", 1))
    near_dirichlet, near_signorini, touching, raised, floor = (fem.Function(linear) for _ in range(5))
    on_dirichlet = fem.locate_dofs_topological(linear, facet_dim, spaces.dirichlet_facets)
    near_dirichlet.x.array[on_dirichlet] = 1.0
    near_signorini.x.array[fem.locate_dofs_topological(linear, facet_dim, spaces.facets)] = 1.0

    near, corners = near_dirichlet.x.array.copy(), facet_nodes(linear, spaces.facets)
    if data.psi.number is None:
        near += near_signorini.x.array
        touches = (w.x.array[facet_nodes(w.function_space, spaces.facets)] == 0).all(axis=1)
        touching.x.array[:] = near_signorini.x.array - largest_around(linear, corners, 1.0 - touches)
    exact = ExactTrace(data, w, w_D, psi, near_dirichlet, near_signorini, touching, raised, floor)
    if data.psi.number is None:
        low = exact.unlimited(facet_lattice(mesh, spaces.facets, SAMPLES))[:, :, 0].min(axis=1, initial=0.0)
        fixed = np.isin(corners, on_dirichlet).any(axis=1)
        raised.x.array[:] = largest_around(linear, corners, -np.where(fixed, *ROOM[::-1]) * low)
        raised.x.array[on_dirichlet] = 0.0
    cells, at_dirichlet, touched = (
        np.flatnonzero(some[linear.dofmap.list].any(axis=1)).astype(np.int32)
        for some in (near, near_dirichlet.x.array, touching.x.array)
    )
    at_seam = near_signorini.x.array[linear.dofmap.list].any(axis=1)
    on_wall = facet_lattice(mesh, spaces.dirichlet_facets, SAMPLES)
    lowest = exact.unlimited(on_wall.among(at_seam)).min(initial=0.0)
    depth = mesh.comm.allreduce(max(FAR_BELOW * np.abs(w.x.array).max(initial=0.0), -2 * SAMPLES * lowest), MPI.MAX)
    floor.x.array[:] = -depth * (1 - near_signorini.x.array)
    height = w.x.array[facet_nodes(w.function_space, spaces.facets)].min(axis=1)
    degree = quadrature_degree(data.u_D, data.psi, data.kappa)
    return Trace(v, exact, exact.above, cells, at_dirichlet, touched, cells, height, hindrance, degree)


@dataclass(frozen=True)
class ExactTrace:
    """The function of the module by its parts, as jets in points, see `discrete.points`.

    Attributes:
        data: u_D and ψ.
        w: The function above I_hψ, quadratic.
        w_D: The same on Γ_D, I_h(u_D − ψ).
        psi: I_hψ.
        near_dirichlet: χ_D.
        near_signorini: Likewise 1 on Γ_S.
        touching: χ_t.
        raised: w_⁺.
        floor: 0 at Γ_S, and elsewhere so low that it changes nothing.
    """

    data: Data
    w: fem.Function
    w_D: fem.Function
    psi: fem.Function
    near_dirichlet: fem.Function
    near_signorini: fem.Function
    touching: fem.Function
    raised: fem.Function
    floor: fem.Function

    def unlimited(self, points: Points, *, gradient: bool = False) -> Array:
        """What the maximum of the module limits, less I_hψ and what it misses of ψ at Γ_S (collective)."""

        def linear(function: fem.Function) -> Array:
            return points.linear(function, gradient=gradient)

        missed, psi = self._missed(points, gradient=gradient), points.quadratic(self.psi, gradient=gradient)
        w, w_D = (points.quadratic(function, gradient=gradient) for function in (self.w, self.w_D))
        kept = cut_off(linear(self.touching), missed)
        at_dirichlet = self.data.u_D.jet(points, gradient=gradient) - psi - kept - w_D
        above = w + kept - cut_off(linear(self.near_signorini), missed)
        return above + cut_off(linear(self.near_dirichlet), at_dirichlet) + linear(self.raised)

    def above(self, points: Points) -> Array:
        """The function less ψ on Γ_S (collective)."""
        return self._limited(points)[:, :, 0]

    def jet(self, points: Points, *, gradient: bool = False) -> Array:
        """Its jet (collective)."""
        near = points.linear(self.near_signorini, gradient=gradient)
        missed = cut_off(near, self._missed(points, gradient=gradient))
        return self._limited(points, gradient=gradient) + points.quadratic(self.psi, gradient=gradient) + missed

    def _limited(self, points: Points, *, gradient: bool = False) -> Array:
        return larger(self.unlimited(points, gradient=gradient), points.linear(self.floor, gradient=gradient))

    def _missed(self, points: Points, *, gradient: bool) -> Array:
        """ψ − I_hψ."""
        psi = self.data.psi.jet(points, gradient=gradient)
        return psi - (points.quadratic(self.psi, gradient=gradient) if self.data.psi.number is None else psi)


def _overshoot(spaces: Spaces, data: Data, psi: fem.Function, edges: Edges) -> tuple[Array, Array]:
    """How far I_hψ is above ψ in points of edges, see `Obstacle`; 0 where it is below, and off Γ_S (collective)."""
    space, facet = psi.function_space, facet_type(spaces.mesh.topology.dim)
    corners, t = basix.geometry(facet), np.arange(1, SAMPLES) / SAMPLES
    ends = np.array(basix.topology(facet)[1])
    along = (1 - t)[:, None] * corners[ends[:, None, 0]] + t[:, None] * corners[ends[:, None, 1]]
    points = in_facets(spaces.mesh, spaces.facets, along.reshape(-1, corners.shape[1]))
    above = np.maximum(points.quadratic(psi)[:, :, 0] - data.psi.values(points), 0.0)
    above = above.reshape(len(above), len(ends), len(t))
    nodes, number = facet_nodes(space, spaces.facets), space.dofmap.index_map.local_to_global
    first, second = (number(nodes[:, ends[:, end]].ravel()).reshape(-1, len(ends)) for end in (0, 1))
    above = np.where((first > second)[:, :, None], above[:, :, ::-1], above)  # all ranks go by these numbers
    middle = nodes[:, len(corners) :]
    found = np.stack([extreme_around(space, middle, at, largest=True)[edges.middle] for at in np.moveaxis(above, 2, 0)])
    found = np.maximum(found, 0.0).T
    turned = number(edges.ends[:, 0]) > number(edges.ends[:, 1])
    return t, np.where(turned[:, None], found[:, ::-1], found)


def _excess(spaces: Spaces, data: Data, y: fem.Function, space: fem.FunctionSpace) -> Array:
    """∫ (y·n − q_Sh) φ per node of this rank; a facet adds the same to all its nodes (collective)."""
    nodes = facet_nodes(space, spaces.facets)
    per_node = spaces.facet_measure * (spaces.normal_flux(y) - data.q_Sh) / nodes.shape[1]
    excess = fem.Function(space)
    np.add.at(excess.x.array, nodes.ravel(), np.repeat(per_node, nodes.shape[1]))
    excess.x.scatter_reverse(la.InsertMode.add)
    return np.asarray(excess.x.array, dtype=np.float64)


def averaged(solution: Solution, metric: CellMetric) -> fem.Function:
    """The reconstruction, averaged over the cells around each node with weights κ_h (collective).

    On each cell T the reconstruction is the quadratic with gradient κ_h⁻¹σ_h and mean u_h: exact where σ_h and u_h are.
    With r = x − x_T, m = r·κ_h⁻¹r and the mean M of m over T, σ_h = σ_h(x_T) + sr gives the quadratic
    u_h + κ_h⁻¹σ_h(x_T)·r + s(m − M)/2. The result has values in the nodes, not yet Bernstein coefficients.
    """
    mesh, flux = solution.spaces.mesh, solution.cell_flux
    element = basix.ufl.element("P", mesh.basix_cell(), 2, basix.LagrangeVariant.bernstein)
    v = fem.Function(fenicsx.function_space(mesh, element), name="v")
    total = fem.Function(v.function_space)
    nodes = v.function_space.dofmap.list
    of_cells, values = _weights(solution.data), np.empty(nodes.shape, order="F")
    constant = solution.u.x.array - flux.slope * metric.moment / 2
    for points in in_cells(mesh, owned_cells(mesh), quadratic_nodes(mesh.basix_cell())):
        cells, inverse, slope = points.rows, metric.inverse[points.rows], flux.slope[points.rows, None]
        gradient = times(flux.centroid[cells, None], inverse)[:, 0]
        values[cells] = np.einsum("npi,ni->np", points.arms, gradient) + slope / 2 * squares_of(points.arms, inverse)
        values[cells] += constant[cells, None]
    values *= of_cells[:, None]
    for function, summands in ((v, values), (total, np.broadcast_to(of_cells[:, None], values.shape))):
        function.x.array[:] = np.bincount(nodes.ravel(), summands.ravel(), len(function.x.array))
        function.x.scatter_reverse(la.InsertMode.add)
        function.x.scatter_forward()
    v.x.array[:] /= total.x.array
    return v


def _weights(data: Data) -> Array:
    """Mean eigenvalue of κ_h per owned cell."""
    if data.kappa.number is not None:
        return np.ones(len(data.f_h.x.array))
    entries = data.kappa_h.x.array.reshape(len(data.f_h.x.array), *(data.kappa.shape or (1, 1)))
    means: Array = np.trace(entries, axis1=1, axis2=2) / entries.shape[1]
    return means
