"""Lowering the gap of v: a quadratic function of Bernstein's coefficients under lower bounds on Γ_S.

A quadratic on an edge with the end values a, b ≥ 0 and Bernstein's coefficient m in between is a(1−t)² + 2mt(1−t) + bt²,
which is ≥ 0 for 0 ≤ t ≤ 1 if and only if m ≥ −√(ab). On a triangle it is ≥ 0 if m ≥ −½√(ab) on each of the edges: in
the variables √a λ_a its matrix, 1 on the diagonal and ≥ −½ elsewhere, is the sum of one with entries ≥ 0 and one that is
positive semidefinite, 3/2 I − ½ 11ᵀ.
"""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix
from petsc4py import PETSc

from forms.crouzeix_raviart import stiffness
from forms.mixed import flux_product
from signorini_fenicsx.data import Data
from signorini_fenicsx.spaces import Spaces, assembled

type Array = npt.NDArray[np.float64]
type Indices = npt.NDArray[np.int32]

STEPS = 5
"""Of CG in the first round; each further one has twice as many as that before."""
ROUNDS = 5
WORTH = 0.05
"""A round that gains less than this part of the gap is the last one."""


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
    w: fem.Function, psi: fem.Function, y: fem.Function, spaces: Spaces, data: Data, fixed: Indices, obstacle: Obstacle
) -> None:
    """Lower ½‖κ_h∇v − y‖² + ⟨y·n − q_Sh, w⟩, v = w + I_hψ, by rounds of CG (collective).

    In each round nodes on their bound are held there unless the gap falls above it; then w is projected. What the
    average adds to the error varies from node to node, and that is what the first steps remove.

    Args:
        w: Bernstein's coefficients, within their bounds; changed in place.
        psi: I_hψ.
        y: In RT0.
        spaces: The discrete spaces.
        data: For κ_h and q_Sh.
        fixed: Nodes on Γ_D.
        obstacle: What holds on Γ_S.
    """
    gap = _Gap(w.function_space, psi, y, spaces, data)
    best = w.x.array.copy()
    lowest, descent = gap.at(w)
    for number in range(ROUNDS):
        size = len(descent)
        free = (w.x.array > obstacle.lower(w.x.array))[:size] | (descent > 0)
        free[fixed[fixed < size]] = False
        w.x.array[:size] += gap.lowered(np.where(free, descent, 0.0), free, STEPS * 2**number)
        w.x.scatter_forward()
        obstacle.project(w.x.array)
        reached, descent = gap.at(w)
        if reached < lowest:
            best[:] = w.x.array
        if not reached < (1 - WORTH) * lowest:
            break
        lowest = reached
    w.x.array[:] = best
    gap.destroy()


class _Gap:
    """The quadratic function of w, in the owned nodes."""

    def __init__(self, space: fem.FunctionSpace, psi: fem.Function, y: fem.Function, spaces: Spaces, data: Data):
        trial, test = ufl.TrialFunction(space), ufl.TestFunction(space)
        self._matrix = assemble_matrix(fem.form(stiffness(trial, test, data.kappa_h)))
        self._matrix.assemble()
        self._in, self._out = self._matrix.createVecs()
        self._diagonal = self._matrix.getDiagonal()
        size = self._in.getLocalSize()
        self._psi = psi.x.array[:size]
        flux = ufl.inner(y, ufl.grad(test)) * ufl.dx
        excess = ufl.dot(y - data.sigma_lift, spaces.n) * test * spaces.ds
        self._of_flux, self._of_excess = assembled(flux)[:size], assembled(excess)[:size]
        self._constant = spaces.integrate(flux_product(y, y, data.kappa_h)) / 2
        self._comm = space.mesh.comm

    def at(self, w: fem.Function) -> tuple[float, Array]:
        """The gap, and how it falls with each node (collective)."""
        above = w.x.array[: len(self._psi)]
        v = above + self._psi
        stiff = self._times(v)
        value = self._comm.allreduce(v @ (stiff / 2 - self._of_flux) + self._of_excess @ above)
        return value + self._constant, self._of_flux - self._of_excess - stiff

    def lowered(self, residual: Array, free: npt.NDArray[np.bool_], steps: int) -> Array:
        """A change of the free nodes by some steps of CG, preconditioned by the diagonal (collective)."""
        change = np.zeros_like(residual)
        direction, size = np.zeros_like(residual), np.inf
        for _ in range(steps):
            scaled = residual / self._diagonal.array_r
            last, size = size, self._comm.allreduce(residual @ scaled)
            if size == 0:
                break
            direction = scaled + size / last * direction
            image = np.where(free, self._times(direction), 0.0)
            length = size / self._comm.allreduce(direction @ image)
            change += length * direction
            residual = residual - length * image
        return change

    def _times(self, values: Array) -> Array:
        """The matrix times values (collective)."""
        self._in.array_w[:] = values
        self._matrix.mult(self._in, self._out)
        return self._out.array_r.copy()

    def destroy(self) -> None:
        """Free what PETSc holds (collective)."""
        for thing in (self._matrix, self._in, self._out, self._diagonal):
            thing.destroy()
