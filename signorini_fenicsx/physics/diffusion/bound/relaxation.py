"""A smaller gap of v, a quadratic function of Bernstein coefficients between bounds on Γ_S."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix, interpolation_matrix
from mpi4py import MPI
from petsc4py import PETSc
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.discrete.trace_multigrid import DEFAULTS, TraceCoarse
from signorini_fenicsx.forms.crouzeix_raviart import stiffness
from signorini_fenicsx.forms.mixed import flux_product
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix, image_of
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.physics.diffusion.discrete.nodes import Jumps
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

type Indices = npt.NDArray[np.int32]
type Weight = tuple[Expr, ufl.Measure]
"""κ_h or κ, with the measure in which it is to be integrated."""

STEPS, MANY_STEPS = 5, 40
"""Steps of CG in the first round; each round has twice as many as the one before. From so many on CG has two levels and
goes on to its tolerance: with the diagonal alone κ that jumps needs a thousand steps, and more on finer meshes."""
TOLERANCE = 0.03
"""What it may leave of the first residual, in a norm that is nearly that of the gap."""
MOST = 100
"""If it needs more iterations, it gives way to a factorisation."""
ROUNDS = 16
WORTH = 0.05
"""There is another round if it may gain this share of the gap: by more steps like the last one, by regaining what the
projection lost, or by nodes that leave their bound."""
NOTHING = 1e-28
"""A round ends early where the squared residual is this share of the first one, which is rounding."""


TIE = 1e-12
"""Relative size of what is rounding where coefficients are compared with bounds, and descents with 0."""


@dataclass(frozen=True)
class Box:
    """Bounds of coefficients on Γ_S, infinite elsewhere.

    Attributes:
        low: The least value of each node of this rank.
        high: The largest.
    """

    low: Array
    high: Array

    @classmethod
    def of(
        cls, hard: tuple[Array, Array], soft: tuple[Array, Array], fixed: Indices, v: Array, held: npt.NDArray[np.bool_]
    ) -> "Box":
        """Bounds that must hold, and tighter ones; none if fixed.

        Where the tighter ones contradict one another v stays if it is held, and else they are left.
        """
        fits = soft[0] <= soft[1]
        low, high = (
            np.where(fits, tight, np.where(held, np.clip(v, *hard), wide))
            for tight, wide in zip(soft, hard, strict=True)
        )
        low[fixed], high[fixed] = -np.inf, np.inf
        return cls(low, high)

    def free(self, w: Array, descent: Array, comm: MPI.Comm) -> npt.NDArray[np.bool_]:
        """The owned nodes between their bounds, or that want to be by more than rounding (collective)."""
        size, tiny = len(descent), TIE * comm.allreduce(float(np.abs(descent).max(initial=0.0)), MPI.MAX)
        above, below = w[:size] > self.low[:size], w[:size] < self.high[:size]
        return (above | (descent > tiny)) & (below | (descent < -tiny)) & (self.low < self.high)[:size]

    def faced(self, excess: Array) -> Array:
        """The bound towards which the excess drives each coefficient, 0 where there is none."""
        bound = np.where(excess > 0, self.low, self.high)
        return np.where(np.isfinite(bound), bound, 0.0)

    def project(self, w: Array, beside: float = 0.0) -> None:
        """Move coefficients to their bounds, in place, also those that are so near to one."""
        w[w < self.low + beside] = self.low[w < self.low + beside]
        w[w > self.high - beside] = self.high[w > self.high - beside]


@dataclass(frozen=True)
class SpringsInCells:
    """Half of ∫β(v − t)² in Ω as a part of the gap.

    Attributes:
        beta: β in P0.
        load: ∫βtφ per node φ of this rank.
        constant: Half of ∫βt².
    """

    beta: fem.Function
    load: Array
    constant: float


@dataclass(frozen=True)
class Stiffness:
    """The quadratic part of the gap, (κ∇u, ∇v) + ⟨βu, v⟩ on Γ_S and in Ω.

    Attributes:
        spaces: Where the jumps of v are.
        kappa: κ_h, or κ.
        beta: β in P0(Γ_S); None for 0.
        springs: Of laws in Ω; None for none.
    """

    spaces: Spaces
    kappa: Weight
    beta: fem.Function | None = None
    springs: SpringsInCells | None = None

    def form(self, u: Expr, v: Expr, part: str = "full", *, on_gamma_s: bool = True) -> fem.Form:
        """The form, or the diagonal of its matrix; with the part on Γ_S or without (collective)."""
        form, maps = stiffness(u, v, self.kappa[1], self.kappa[0]), []
        if self.springs is not None:
            form += self.springs.beta * u * v * ufl.dx
        if on_gamma_s and self.beta is not None:
            form, maps = form + self.rubbing(u, v), [self.spaces.entity_map]
        return fenicsx.form(form, options={"part": part}, entity_maps=maps)

    def rubbing(self, u: Expr, v: Expr) -> ufl.Form:
        """⟨βu, v⟩ on Γ_S."""
        return self.beta * u * v * self.spaces.ds

    def matrix(self, space: fem.FunctionSpace, jumps: Jumps) -> PETSc.Mat:
        """The matrix, in the jumps if there are any (collective)."""
        trial, test = ufl.TrialFunction(space), ufl.TestFunction(space)
        if jumps.basis is None:
            return _assembled(self.form(trial, test))
        matrix = _assembled(self.form(trial, test, on_gamma_s=False)).ptap(jumps.basis[0])
        if self.beta is not None:
            rubbing, size = _assembled(self.spaces.form(self.rubbing(trial, test))), space.dofmap.index_map.size_local
            tips = jumps.tips[jumps.tips < size].astype(np.int32)
            rubbing.zeroRowsColumns(tips + rubbing.getOwnershipRange()[0], diag=0.0)
            matrix.axpy(1.0, rubbing)
        return matrix


def relax(
    v: fem.Function,
    stiffness: Stiffness,
    y: Expr,
    excess: Array,
    fixed: Indices,
    box: Box,
    jumps: Jumps,
    *,
    by_nodes: bool,
) -> None:
    """Reduce ½‖κ_h∇v − y‖² + ½⟨βv, v⟩ + the excess times v on Γ_S, with springs in Ω, by rounds of CG (collective).

    In each round a node on its bound is fixed, unless moving it inside reduces the gap. After the round v is projected
    to the bounds. The averaging in v makes errors that vary from node to node; the first steps remove these.

    Args:
        v: Bernstein coefficients within their bounds, with ghosts; changed in place.
        stiffness: Of the gap.
        y: Flux, in RT0 or of a function.
        excess: ∫ (y·n − level) φ on Γ_S, with the forces of bounds in Ω, per node φ of this rank.
        fixed: Nodes on Γ_D.
        box: The bounds.
        jumps: The jumps at facets inside the domain, which v has in it.
        by_nodes: First v is on its bound in the nodes that would be beyond it after one Jacobi step of the excess
            alone: where (κ_h∇v − y, ∇φ) = 0 that is a step of the gap.
    """
    gap = _Gap(v.function_space, stiffness, y, excess, box.faced(excess), jumps)
    if by_nodes:
        gap.touch(v, box, fixed)
    best = v.x.array.copy()
    present, descent, size_of_gap = gap.at(v)
    lowest, steps = present, STEPS
    size = len(descent)
    loose = np.ones(size, dtype=bool)
    loose[fixed[fixed < size]] = False
    free = loose & box.free(v.x.array, descent, v.function_space.mesh.comm)
    for _ in range(ROUNDS):
        change, gained, left = gap.lowered(np.where(free, descent, 0.0), free, steps)
        v.x.array[:size] += change
        v.x.scatter_forward()
        box.project(v.x.array)
        before, (present, descent, size_of_gap) = present, gap.at(v)
        if present < lowest:
            best[:], lowest = v.x.array, present
        taken_back = present - (before - gained)
        steps *= 2
        kept, free = free, loose & box.free(v.x.array, descent, v.function_space.mesh.comm)
        if taken_back + left + gap.by_leaving(descent, free & ~kept, gained) < WORTH * size_of_gap:
            break
    v.x.array[:] = best
    gap.destroy()


def _assembled(form: fem.Form) -> PETSc.Mat:
    matrix = assemble_matrix(form)
    matrix.assemble()
    return matrix


class _Gap:
    """The gap as a quadratic function of v in the owned nodes.

    Its matrix costs as much as thirty applications of the form, and more memory than the rest of the certificate. So it
    is assembled only for jumps, and for many steps of CG.
    """

    def __init__(
        self,
        space: fem.FunctionSpace,
        stiffness: Stiffness,
        y: Expr,
        excess: Array,
        faced: Array,
        jumps: Jumps,
    ):
        trial, test = ufl.TrialFunction(space), ufl.TestFunction(space)
        self._comm, size = space.mesh.comm, space.dofmap.index_map.size_local
        self._excess, self._faced = excess[:size], faced[:size]
        self._flux = assembled(ufl.inner(y, ufl.grad(test)) * ufl.dx)[:size]
        kappa, dx = stiffness.kappa
        self._constant = self._comm.allreduce(fem.assemble_scalar(fenicsx.form(flux_product(y, y, dx, kappa)))) / 2
        if stiffness.springs is not None:
            self._flux += stiffness.springs.load[:size]
            self._constant += stiffness.springs.constant
        self._given, self._rubbing = fem.Function(space), None
        self._image = stiffness.form(self._given, test)
        if stiffness.beta is not None:
            self._rubbing = stiffness.spaces.form(stiffness.rubbing(self._given, test))
        self._space, self._stiffness, self._jumps = space, stiffness, jumps
        self._solver: FacetSolver[TraceCoarse] | None = None
        self._matrix: PETSc.Mat | None = None
        self._flux = jumps.transposed(self._flux)
        if jumps.basis is None:
            self._diagonal = assembled(stiffness.form(trial, test, "diagonal"))[:size]
        else:
            self._diagonal = self.assemble().getDiagonal().array

    def assemble(self) -> PETSc.Mat:
        """Go on with the matrix, and return it (collective)."""
        if self._matrix is None:
            self._matrix = self._stiffness.matrix(self._space, self._jumps)
        return self._matrix

    def at(self, v: fem.Function) -> tuple[float, Array, float]:
        """The gap, its negative derivative by each owned node, and its size (collective).

        The excess counts from the bounds that it faces; where none of these holds v the gap is known up to a constant,
        and its size is at least ½‖κ_h∇v − y‖².
        """
        values = v.x.array[: len(self._excess)]
        stiff = self._times(values)
        on_signorini, inside = self._excess @ (values - self._faced), values @ (stiff / 2 - self._flux)
        if self._rubbing is not None:
            rubbing = values @ self._applied(self._rubbing, values) / 2
            on_signorini, inside = on_signorini + rubbing, inside - rubbing
        on_signorini, inside = self._comm.allreduce(np.array([on_signorini, inside])).tolist()
        inside += self._constant
        return inside + on_signorini, self._flux - self._excess - stiff, max(inside, inside + on_signorini)

    def touch(self, v: fem.Function, box: Box, fixed: Indices) -> None:
        """Let v be on its bound in nodes where a step by the excess alone goes beyond it, in place (collective)."""
        size = len(self._excess)
        values, step = v.x.array[:size], self._excess / self._diagonal
        step[fixed[fixed < size]] = 0.0
        values[:] = np.where(step > 0, np.where(values - step < box.low[:size], box.low[:size], values), values)
        values[:] = np.where(step < 0, np.where(values - step > box.high[:size], box.high[:size], values), values)
        v.x.scatter_forward()

    def by_leaving(self, descent: Array, nodes: npt.NDArray[np.bool_], gained: float) -> float:
        """About what is gained by nodes that leave their bounds: that of each alone (collective).

        Where CG needs two levels a node may take others far along, so it may be what the last round has gained.
        """
        chosen = np.where(nodes, descent, 0.0)
        alone = float(self._comm.allreduce(chosen @ (chosen / self._diagonal)) / 2)
        return gained if self._solver is not None and alone > 0 else alone

    def lowered(self, residual: Array, free: npt.NDArray[np.bool_], steps: int) -> tuple[Array, float, float]:
        """Some steps of CG on the free nodes with the diagonal, or more with two levels (collective).

        Args:
            residual: 0 in the other nodes; changed in place.
            free: The free nodes.
            steps: Their number.

        Returns:
            The change of v, by how much it reduces the gap, and about how much the next round may gain by more steps.
        """
        if steps >= MANY_STEPS:
            return self._nearly_solved(residual, free)
        change, direction = np.zeros_like(residual), np.zeros_like(residual)
        gained, last, size, least = 0.0, 0.0, np.inf, 0.0
        for _ in range(steps):
            scaled = residual / self._diagonal
            earlier, size = size, self._comm.allreduce(residual @ scaled)
            least = least or NOTHING * size
            if size <= least:
                break
            direction *= size / earlier
            direction += scaled
            image = self._times(direction)
            image *= free
            length = size / self._comm.allreduce(direction @ image)
            change += length * direction
            residual -= length * image
            last = length * size / 2
            gained += last
        return change, gained, 2 * steps * last

    def _nearly_solved(self, residual: Array, free: npt.NDArray[np.bool_]) -> tuple[Array, float, float]:
        """The change of v that is nearly the best one of the free nodes, by CG with two levels (collective)."""
        fixed, none = np.flatnonzero(~free).astype(np.int32), np.empty(0, dtype=np.int32)
        if self._solver is None:
            self._under_bounds = ConstrainedMatrix(self.assemble(), PETSc.Mat.Option.SPD)
            matrix, dim = self._under_bounds.matrix, self._space.mesh.topology.dim
            self._solver = FacetSolver(matrix, "facet_", DEFAULTS[dim], self._levels, MOST, TOLERANCE)
            self._solver.ksp.setNormType(PETSc.KSP.NormType.NATURAL)
        self._under_bounds.impose(fixed, none, 0.0)
        if self._solver.levels is not None:
            self._solver.levels.update(fixed, fixed)
        change, right = self._under_bounds.matrix.createVecs()
        right.array_w[:] = residual
        change.set(0.0)
        self._solver.solve(right, change)
        found = change.array_r.copy()
        for vector in (right, change):
            vector.destroy()
        gained = float(self._comm.allreduce(residual @ found)) / 2
        return found, gained, TOLERANCE**2 * gained

    def _levels(self, pc: PETSc.PC) -> TraceCoarse:
        """The second level: functions that are linear on cells, with jumps where v has them (collective)."""
        linear = fenicsx.function_space(self._space.mesh, ("Lagrange", 1))
        interpolation, of_linear = interpolation_matrix(linear, self._space), Jumps.of(linear, self._stiffness.spaces)
        interpolation.assemble()
        if self._jumps.basis is not None and of_linear.basis is not None:
            interpolation = self._jumps.basis[1].matMult(interpolation.matMult(of_linear.basis[0]))
        return TraceCoarse(self._under_bounds.matrix, 1, linear, interpolation, pc)

    def _times(self, values: Array) -> Array:
        """The matrix times values (collective)."""
        if self._matrix is None:
            return self._applied(self._image, values)
        return image_of(self._matrix, values)

    def _applied(self, image: fem.Form, values: Array) -> Array:
        """A form of `_given` and a test function for these values (collective)."""
        self._given.x.array[: len(values)] = values
        self._given.x.scatter_forward()
        return assembled(image)[: len(values)]

    def destroy(self) -> None:
        """Free what PETSc holds (collective)."""
        if self._matrix is not None:
            self._matrix.destroy()
