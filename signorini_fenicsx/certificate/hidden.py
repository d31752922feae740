"""What quadrature may miss of u_D, ψ and an obstacle, which v contains themselves.

Let d be the difference between such a datum and its P2 interpolant. v contains χd near Γ_D and Γ_S, with χ linear on
each cell, and ‖κ^½∇(χd)‖_T ≤ κ_max^½ (‖∇d‖ + |T|^½ |∇χ| sup|d|). With an obstacle in Ω v contains max(w, d) with a
quadratic w, which has nothing of d in the cells where the Bernstein coefficients of w are at least sup|d|; there is no
χ, but (λ, v − ψ), in which d is at most |T| λ sup|d|.

Integrals over these cells use d in the points of a quadrature. If these points show less than a third of ∇d, and the
rest may be more than all other terms of the bound, the datum is not resolved.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.certificate.admissible_trace import Indices, Trace
from signorini_fenicsx.certificate.enclosures import cell_vertices, enclose, facet_vertices
from signorini_fenicsx.certificate.interpolants import bernstein, edge_order, in_nodes, quadratic_of, seen_slope
from signorini_fenicsx.certificate.metric import CellMetric
from signorini_fenicsx.certificate.obstacle import Force
from signorini_fenicsx.certificate.resolution import OVERLOOKED, Resolution, of_all_cells
from signorini_fenicsx.expressions.quadratics import barycentric_gradients

SEEN = 0.25
"""Enclosures stop where the part that is not quadratic is about half of this share of the error."""


def hidden_parts(resolution: Resolution, trace: Trace, metric: CellMetric, force: Force | None) -> Array:
    """Bound of what may be hidden of ‖κ^½∇v‖_T and of √(2λ, v − ψ)_T, per owned cell (collective).

    v contains ψ where it touches, and where it was raised to ψ. It cannot have been raised on facets where
    v − I_hψ ≥ sup |ψ − I_hψ|.

    Args:
        resolution: Encloses the data.
        trace: Has v.
        metric: Metric of the owned cells.
        force: λ, None without an obstacle.
    """
    spaces, extra = resolution.spaces, np.zeros(len(metric.volume))
    touching = np.union1d(trace.touching, spaces.cells[_facets_of_psi(resolution, trace)]).astype(np.int32)
    where: list[tuple[str, Indices]] = [("u_D", trace.at_dirichlet), ("psi", touching)]
    where += [] if force is None else [("obstacle", _cells_of_obstacle(resolution, trace))]
    for name, cells in where:
        tree = resolution.tree(name)
        if tree is None:
            continue
        vertices, inverse = cell_vertices(spaces.mesh)[cells], of_all_cells(metric.inverse, len(extra))[cells]
        strip = spaces.mesh.comm.allreduce(metric.volume[cells].sum())
        kappa_max = (2 - metric.low[cells]) / np.linalg.eigvalsh(inverse)[:, 0]
        steep = SEEN / 2 * resolution.error / np.sqrt(max(strip, 1e-300) * kappa_max)
        p = quadratic_of(vertices, in_nodes(tree, vertices))
        found = resolution.enclosed(name, tree, vertices, p, steep, cells, "tilt")
        hidden = found.tilt > OVERLOOKED * seen_slope(tree, vertices, p)
        if name == "obstacle" and force is not None:
            more = metric.volume[cells] * (kappa_max * found.tilt**2 + 2 * force.largest[cells] * found.sup)
            extra[cells] = np.hypot(extra[cells], np.where(hidden, np.sqrt(more), 0.0))
            continue
        decay = 2 * np.linalg.norm(barycentric_gradients(vertices), axis=2).max(axis=1, initial=0.0)
        more = np.sqrt(kappa_max * metric.volume[cells]) * (found.tilt + decay * found.sup)
        extra[cells] += np.where(hidden, more, 0.0)
    return extra


def overlooked(resolution: Resolution, beside: Array) -> None:
    """Record that quadrature may overlook u_D, ψ or an obstacle in the cells where `beside` is large (collective)."""
    mesh = resolution.spaces.mesh
    worst = beside >= mesh.comm.allreduce(beside.max(initial=0.0), MPI.MAX) / 4
    given = ["u_D", "psi"] + ([] if resolution.data.obstacle is None else ["obstacle"])
    names = ", ".join(name for name in given if resolution.encloses(name))
    resolution.lost.add(names)
    resolution.note(names, cell_vertices(mesh)[worst].mean(axis=1), np.flatnonzero(worst))


def _facets_of_psi(resolution: Resolution, trace: Trace) -> Mask:
    """Mask of the facets of Γ_S where ψ may be larger than the quadratic v (collective)."""
    spaces, tree = resolution.spaces, resolution.tree("psi")
    if tree is None:
        return np.zeros(len(spaces.facets), dtype=bool)
    vertices = facet_vertices(spaces.mesh, spaces.facets)
    p = quadratic_of(vertices, in_nodes(tree, vertices))
    tolerance = np.maximum(trace.lowest, 0.0)
    enough = np.where(tolerance > 0, tolerance, np.inf)
    found = enclose(tree, vertices, p, enough, spaces.mesh.comm, scale=resolution.scale(), by="sup")
    return np.asarray(found.sup > tolerance)


def _cells_of_obstacle(resolution: Resolution, trace: Trace) -> Indices:
    """Owned cells where the obstacle may be larger than the quadratic v, or v is not quadratic (collective)."""
    mesh, tree = resolution.spaces.mesh, resolution.tree("obstacle")
    vertices = cell_vertices(mesh)
    if tree is None:
        return np.empty(0, dtype=np.int32)
    corners = vertices.shape[1]
    nodes = trace.v.function_space.dofmap.list[: len(vertices), [*range(corners), *edge_order(corners)]]
    p = quadratic_of(vertices, in_nodes(tree, vertices))
    above = np.maximum((trace.v.x.array[nodes] - bernstein(p, vertices)).min(axis=1), 0.0)
    above[trace.altered] = 0.0
    enough = np.where(above > 0, above, np.inf)
    found = enclose(tree, vertices, p, enough, mesh.comm, scale=resolution.scale(), by="sup")
    return np.flatnonzero(found.sup > above).astype(np.int32)
