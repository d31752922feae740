"""An obstacle u ≥ ψ in Ω in the bound.

Let y ∈ RT0 have −∇·y ≥ f_h in each cell, and v ≥ ψ in Ω. The force λ has to be ≥ 0 in each point and not only in the
mean. So it can take f as it is: let f̃ = f in the cells where −∇·y ≥ f in all points, f̃ = f_h in the others, and
λ = −∇·y − f̃. For the obstacle problem with the load f̃, whose solution ũ has the force λ̃ = −∇·κ∇ũ − f̃,

    ½‖κ^½∇v − κ^-½y‖² + (λ, v − ψ) = ½|∇(v − ũ)|² + ½‖y − κ∇ũ‖² + (λ̃, v − ψ) + (λ, ũ − ψ).

Proof. The difference of both sides is (∇(v − ũ), κ∇ũ − y) + (λ, v − ũ) − (λ̃, v − ψ). The first term is (v − ũ, λ̃ − λ),
and (λ̃, ũ − ψ) = 0. So all cancel. The last two terms on the right are ≥ 0. With laws on Γ_S these add what they add
without an obstacle.

With a term cu, λ = −∇·y − f̃ + c_h u*, and both sides have the terms of `reaction`.

The variational inequalities of u and ũ, each tested with the other one, give |∇(u − ũ)| ≤ osc as without an obstacle:
both are taken over the same functions v ≥ ψ. osc is that of f − f̃. So in contact f may jump and is not paid for. Only
the range of f is needed there, which intervals enclose, and (λ, v − ψ) is bounded with the largest λ of each cell.

v is the maximum of ψ and of a function that is quadratic on each cell, by Bernstein coefficients not below those of
I_hψ. In vertices off Γ_D all of whose cells touch it is lowered by as much as I_hψ may be above ψ, so that v is ψ
itself there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem, la
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.certificate.admissible_trace import Trace
from signorini_fenicsx.certificate.law_bounds import Bound
from signorini_fenicsx.certificate.relaxation import Edges
from signorini_fenicsx.certificate.resolution import Resolution
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.discrete.points import cell_quadrature, owned_cells, quadratic_nodes
from signorini_fenicsx.physics.diffusion.data import Data
from signorini_fenicsx.physics.diffusion.obstacle import Obstacle
from signorini_fenicsx.physics.diffusion.spaces import Spaces

ROOM = 2.0
"""Factor of the largest I_hψ − ψ in the points of a quadrature."""


def force(spaces: Spaces, y: fem.Function, source: fem.Function, contact: Mask | None) -> Array:
    """λ = −∇·y − source per owned cell in contact, 0 where this is less and in all other cells (collective).

    Without contact λ would be the error of the linear solver, and (λ, v − ψ) would add it up with one sign.
    """
    divergence = assembled(ufl.div(y) * ufl.TestFunction(spaces.Q) * ufl.dx) / spaces.cell_measures
    pushing = np.maximum(-divergence - source.x.array, 0.0)
    return pushing if contact is None else np.where(contact, pushing, 0.0)


@dataclass(frozen=True)
class Force:
    """λ, per owned cell.

    Attributes:
        largest: Upper bound of λ.
        takes_f: Mask of the cells where f̃ = f.
    """

    largest: Array
    takes_f: Mask

    @classmethod
    def of(
        cls, data: Data, y: fem.Function, level: fem.Function, contact: Mask | None, resolution: Resolution
    ) -> Force:
        """That of a flux, with u* as `level` (collective)."""
        largest = force(resolution.spaces, y, data.source(level), contact)
        takes_f = np.zeros(len(largest), dtype=bool)
        if data.f.number is not None:
            return cls(largest, takes_f)
        most = largest + data.f_h.x.array - (0.0 if data.memory is None else data.memory.x.array)
        cells = np.flatnonzero(largest > 0)
        f = resolution.range_of("f", data.f, cells, most[cells])
        takes_f[cells] = f.hi <= most[cells]
        largest[cells] = np.where(takes_f[cells], most[cells] - f.lo, largest[cells])
        return cls(largest, takes_f)


def is_quadratic(psi: Datum) -> bool:
    """Whether ψ is its own quadratic interpolant."""
    return psi.polynomial is not None and psi.polynomial <= 2


def coefficients(psi: Datum, space: fem.FunctionSpace, edges: Edges) -> Array:
    """Bernstein coefficients of I_hψ (collective)."""
    interpolant = psi.at_nodes(space, quadratic_nodes(space.mesh.basix_cell()))
    edges.to_bernstein(interpolant.x.array)
    return np.asarray(interpolant.x.array, dtype=np.float64)


def add_load(load: fem.Function, spaces: Spaces, forces: Array) -> None:
    """Add ∫λφ for each node φ, on this rank: all Bernstein polynomials of a cell have the same integral."""
    nodes = load.function_space.dofmap.list
    np.add.at(load.x.array, nodes.ravel(), np.repeat(forces * spaces.cell_measures / nodes.shape[1], nodes.shape[1]))


def touch(v: fem.Function, contact: Mask | None, floor: Array, on_dirichlet: Indices) -> None:
    """Let v be I_hψ in the nodes of all cells in contact with the obstacle, but not on Γ_D (collective)."""
    if contact is None:
        return
    touched = fem.Function(v.function_space)
    touched.x.array[v.function_space.dofmap.list[contact]] = 1.0
    touched.x.scatter_reverse(la.InsertMode.add)
    touched.x.scatter_forward()
    touched.x.array[on_dirichlet] = 0.0
    v.x.array[:] = np.where(touched.x.array > 0, floor, v.x.array)


def lower_inside(v: fem.Function, floor: Array, obstacle: Obstacle, edges: Edges, given: Indices) -> None:
    """Lower v in the vertices all of whose cells touch, so that the maximum with ψ is ψ there (collective).

    In nodes where v is given, as on Γ_D, it stays.
    """
    if is_quadratic(obstacle.psi):
        return
    mesh, space = v.function_space.mesh, v.function_space
    above, interpolant = np.zeros(len(obstacle.means)), fem.Function(space)
    interpolant.x.array[:] = floor
    for points in cell_quadrature(mesh, owned_cells(mesh), quadrature_degree(obstacle.psi)):
        missed = points.quadratic(interpolant)[:, :, 0] - obstacle.psi.values(points)
        above[points.cells] = missed.max(axis=1, initial=0.0)
    cells = space.dofmap.list
    vertices = cells[:, : mesh.topology.dim + 1]
    apart = (v.x.array[cells] > floor[cells]).any(axis=1)
    depth, free = fem.Function(space), fem.Function(space)
    for function, values in ((depth, ROOM * above), (free, 1.0 * apart)):
        np.maximum.at(function.x.array, vertices.ravel(), np.repeat(values, vertices.shape[1]))
        function.x.petsc_vec.ghostUpdate(addv=PETSc.InsertMode.MAX_VALUES, mode=PETSc.ScatterMode.REVERSE)
        function.x.scatter_forward()
    depth.x.array[free.x.array > 0] = 0.0
    depth.x.array[given] = 0.0
    depth.x.array[edges.middle] = depth.x.array[edges.ends].mean(axis=1)  # linear on each cell
    v.x.array[:] -= depth.x.array


def bound(obstacle: Obstacle, linear: fem.FunctionSpace) -> Bound:
    """ψ as a bound of u everywhere."""
    everywhere = fem.Function(linear)
    everywhere.x.array[:] = 1.0
    return Bound(obstacle.psi, 1.0, everywhere, 0.0)


def gap(obstacle: Obstacle, spaces: Spaces, trace: Trace, forces: Array) -> Array:
    """2(λ, v − ψ) per owned cell, at most, with `forces` ≥ λ (collective)."""
    found = np.zeros(len(forces))
    cells = np.flatnonzero(forces > 0).astype(np.int32)
    far, near = np.setdiff1d(cells, trace.cells), np.intersect1d(cells, trace.cells)
    for close, some in ((False, far), (True, near)):
        for points in cell_quadrature(spaces.mesh, some, max(trace.degree, quadrature_degree(obstacle.psi))):
            above = trace.jet(points, near=close)[:, :, 0] - obstacle.psi.values(points)
            found[points.cells] = 2 * forces[points.cells] * points.integrals(np.maximum(above, 0.0))
    return found
