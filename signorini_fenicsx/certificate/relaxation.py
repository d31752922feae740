"""Lowering the gap of v: a quadratic function of Bernstein's coefficients under lower bounds on Γ_S.

A quadratic on an edge with the end values a, b ≥ 0 and Bernstein's coefficient m in between is a(1−t)² + 2mt(1−t) +
bt², which is ≥ 0 for 0 ≤ t ≤ 1 if and only if m ≥ −√(ab). On a triangle it is ≥ 0 if m ≥ −½√(ab) on each of the edges:
in the variables √a λ_a its matrix, 1 on the diagonal and ≥ −½ elsewhere, is the sum of one with entries ≥ 0 and of
3/2 I − ½ 11ᵀ, which is positive semidefinite. (If a = 0, then m ≥ 0.)
"""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.spaces import assembled
from signorini_fenicsx.forms.crouzeix_raviart import stiffness
from signorini_fenicsx.forms.mixed import flux_product

type Indices = npt.NDArray[np.int32]

STEPS, MOST_STEPS = 5, 320
"""Of CG in the first round, and at most; each has twice as many as that before. κ that jumps by 1e6 on bad cells needs
hundreds, others end in the first rounds."""
ROUNDS = 16
WORTH = 0.05
"""There is a further round if it may gain this part of the gap: by steps like the last one, what projection took, or
nodes that leave their bound."""


@dataclass(frozen=True)
class Edges:
    """The middle nodes of some edges of this rank, and the nodes at their ends."""

    middle: Indices
    ends: Indices

    def to_bernstein(self, values: Array) -> None:
        """Turn values in the middle into Bernstein's coefficients, in place."""
        values[self.middle] = 2 * values[self.middle] - values[self.ends].sum(axis=1) / 2


def all_edges(space: fem.FunctionSpace) -> Edges:
    """Each edge once, in a space of quadratics whose nodes are those of Bernstein's or Lagrange's basis."""
    nodes = space.dofmap.list
    vertices = space.mesh.topology.dim + 1
    ends = np.array(basix.topology(space.mesh.basix_cell())[1])
    middle, first = np.unique(nodes[:, vertices:].ravel(), return_index=True)
    return Edges(middle, nodes[:, ends].reshape(-1, 2)[first])


class Obstacle:
    """w ≥ 0 on Γ_S by lower bounds of its coefficients.

    Attributes:
        nodes: Nodes of this rank on Γ_S that are not on Γ_D.
    """

    def __init__(self, edges: Edges, nodes: Indices, dim: int):
        self.nodes = nodes
        chosen = np.isin(edges.middle, nodes)
        self._edges = Edges(edges.middle[chosen], edges.ends[chosen])
        self._part = 1.0 if dim == 2 else 0.5

    def lower(self, w: Array) -> Array:
        """The bound of each node, −∞ off Γ_S."""
        bound = np.full(len(w), -np.inf)
        bound[self.nodes] = 0.0
        a, b = np.maximum(w[self._edges.ends], 0.0).T
        bound[self._edges.middle] = -self._part * np.sqrt(a * b)
        return bound

    def project(self, w: Array) -> None:
        """Raise vertices to 0, then the middles of edges to their bound, in place."""
        vertices = np.setdiff1d(self.nodes, self._edges.middle)
        w[vertices] = np.maximum(w[vertices], 0.0)
        np.maximum(w, self.lower(w), out=w)


def relax(
    w: fem.Function, psi: fem.Function, y: fem.Function, kappa: Expr, excess: Array, fixed: Indices, obstacle: Obstacle
) -> None:
    """Lower ½‖κ_h∇v − y‖² + ⟨y·n − q_Sh, w⟩, v = w + I_hψ, by rounds of CG (collective).

    In each round nodes on their bound are held there unless the gap falls above it; then w is projected. What the
    average adds to the error varies from node to node, and that is what the first steps remove.

    Args:
        w: Bernstein's coefficients, within their bounds; changed in place.
        psi: I_hψ.
        y: In RT0.
        kappa: κ_h.
        excess: ∫ (y·n − q_Sh) φ per node φ of this rank.
        fixed: Nodes on Γ_D.
        obstacle: What holds on Γ_S.
    """
    gap = _Gap(w.function_space, psi, y, kappa, excess)
    best = w.x.array.copy()
    present, descent = gap.at(w)
    lowest, steps = present, STEPS
    size = len(descent)
    loose = np.ones(size, dtype=bool)
    loose[fixed[fixed < size]] = False
    for _ in range(ROUNDS):
        free = loose & ((w.x.array > obstacle.lower(w.x.array))[:size] | (descent > 0))
        change, gained, last = gap.lowered(np.where(free, descent, 0.0), free, steps)
        w.x.array[:size] += change
        w.x.scatter_forward()
        obstacle.project(w.x.array)
        before, (present, descent) = present, gap.at(w)
        if present < lowest:
            best[:], lowest = w.x.array, present
        taken_back = present - (before - gained)
        steps = min(2 * steps, MOST_STEPS)
        if taken_back + steps * last + gap.alone(descent, loose & ~free) < WORTH * present:
            break
    w.x.array[:] = best
    gap.destroy()


class _Gap:
    """The quadratic function of w, in the owned nodes."""

    def __init__(self, space: fem.FunctionSpace, psi: fem.Function, y: fem.Function, kappa: Expr, excess: Array):
        trial, test = ufl.TrialFunction(space), ufl.TestFunction(space)
        self._matrix = assemble_matrix(fem.form(stiffness(trial, test, ufl.dx, kappa)))
        self._matrix.assemble()
        self._in, self._out = self._matrix.createVecs()
        self._diagonal = self._matrix.getDiagonal()
        self._comm = space.mesh.comm
        size = self._in.getLocalSize()
        self._psi, self._excess = psi.x.array[:size], excess[:size]
        self._flux = assembled(ufl.inner(y, ufl.grad(test)) * ufl.dx)[:size]
        self._constant = self._comm.allreduce(fem.assemble_scalar(fem.form(flux_product(y, y, ufl.dx, kappa)))) / 2

    def at(self, w: fem.Function) -> tuple[float, Array]:
        """The gap, and how it falls with each node (collective)."""
        above = w.x.array[: len(self._psi)]
        v = above + self._psi
        stiff = self._times(v)
        value = self._comm.allreduce(v @ (stiff / 2 - self._flux) + self._excess @ above)
        return value + self._constant, self._flux - self._excess - stiff

    def alone(self, descent: Array, nodes: npt.NDArray[np.bool_]) -> float:
        """By how much nodes can lower the gap that move upwards each by itself (collective)."""
        upwards = np.where(nodes, np.maximum(descent, 0.0), 0.0)
        return float(self._comm.allreduce(upwards @ (upwards / self._diagonal.array_r)) / 2)

    def lowered(self, residual: Array, free: npt.NDArray[np.bool_], steps: int) -> tuple[Array, float, float]:
        """Some steps of CG on the free nodes, preconditioned by the diagonal (collective).

        Returns:
            The change, by how much it lowers the gap, and by how much its last step does.
        """
        change, direction = np.zeros_like(residual), np.zeros_like(residual)
        gained, last, size = 0.0, 0.0, np.inf
        for _ in range(steps):
            scaled = residual / self._diagonal.array_r
            earlier, size = size, self._comm.allreduce(residual @ scaled)
            if size == 0:
                break
            direction = scaled + size / earlier * direction
            image = np.where(free, self._times(direction), 0.0)
            length = size / self._comm.allreduce(direction @ image)
            change += length * direction
            residual = residual - length * image
            last = length * size / 2
            gained += last
        return change, gained, last

    def _times(self, values: Array) -> Array:
        """The matrix times values (collective)."""
        self._in.array_w[:] = values
        self._matrix.mult(self._in, self._out)
        return self._out.array_r.copy()

    def destroy(self) -> None:
        """Free what PETSc holds (collective)."""
        for thing in (self._matrix, self._in, self._out, self._diagonal):
            thing.destroy()
