"""The coarse space of a system of linear traces: conforming P1, of a body towards ν = ½ with normals of facets.

Where hardly any volume can change, linear displacements lock: they can hardly move at all, and the smoother is left
alone with what they miss. With one more unknown per facet, a trace n that is constant there, as in the element of
Bernardi and Raugel, volume passes from cell to cell, and the iterations hardly depend on ν. GAMG knows nothing of such
a space, so its problem, with a seventh of the unknowns in space, is factorised.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.discrete.linear_traces import LinearTraces, facet_normals, node_ranks
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.linear.petsc import MUMPS_WORKSPACE, set_direct
from signorini_fenicsx.linear.two_level import TwoLevel, facet_vertices

OF_ALL = {
    "mg_coarse_pc_mg_cycle_type": "w",
    "mg_coarse_pc_gamg_aggressive_coarsening": "0",
    "mg_coarse_mg_levels_ksp_max_it": "4",
    "mg_coarse_mat_mumps_icntl_14": MUMPS_WORKSPACE["mat_mumps_icntl_14"],
}
"""The coarse problem has a tenth of the entries, so a good solution by GAMG costs little."""
DEFAULTS = {
    2: OF_ALL | {"mg_levels_ksp_max_it": "4", "mat_mumps_icntl_7": "2"},
    3: OF_ALL | {"mg_levels_ksp_max_it": "2"},
}
"""For each dimension. In the plane MUMPS orders by minimum fill; nested dissection is slower and fills in as much. In
space fewer steps of the smoother take more iterations, but less time, above all where few iterations are enough."""
SMOOTHED = 0.05, 1.1
"""Shares of the largest eigenvalue, as it is estimated, between which the smoother reduces errors."""
ESTIMATE = 10
"""Steps of CG that estimate it."""
STIFF = 8.0
"""From this λ/μ on, that is ν = 0.444, the normals save more than the factorisation costs."""
SHIFT = 1e-10
"""Share of the coarse diagonal that is added to it: no motion is free, and nothing else is changed."""

DIRECT_UP_TO = {2: 500_000, 3: 60_000}
"""For each dimension, largest number of unknowns that are factorised; in space a factorisation fills in far more."""

MOST_ITERATIONS = 400
"""If CG needs more, it gives way to a factorisation."""

BLOCKS = "vpbjacobi"
"""Jacobi's method by blocks; pbjacobi keeps its first ones."""


class TraceCoarse:
    """Two levels for a system of displacements or of their traces, of which those in P1 are some: Galerkin's operator.

    It is made anew for each set, while GAMG's hierarchy is that of all of Γ_C free, see
    `AuxiliarySpace._build_hierarchy`. Vertices of fixed unknowns stay free: the operator holds them as springs do.

    CG and the smoother multiply by a copy of the system that has one triangle alone, in blocks: half of the time.
    """

    def __init__(
        self,
        system: PETSc.Mat,
        size: int,
        space: fem.FunctionSpace,
        interpolation: PETSc.Mat,
        pc: PETSc.PC,
        *,
        normals: bool = False,
        in_blocks: PETSc.Mat | None = None,
    ):
        """Make `pc` a two-level multigrid with a smoother on blocks (collective).

        Args:
            system: The system without conditions; later its values are those under conditions.
            size: Size of its blocks.
            space: Displacements in P1.
            interpolation: From these to the system.
            pc: The preconditioner.
            normals: Whether the coarse space has the normals of the facets, too.
            in_blocks: The copy in blocks, if it has the conditions as the system has them; otherwise it is made anew.
        """
        self._system, self._normals, self._space, self._pc = system, normals, space, pc
        system.setVariableBlockSizes(np.full(system.getLocalSize()[0] // size, size, dtype=PETSc.IntType))
        self._levels = TwoLevel(pc, interpolation)
        self._smoother = pc.getMGSmoother(1)
        self._smoother.setType("chebyshev")
        self._smoother.getPC().setType(BLOCKS)
        self._smooth_up_to_largest()
        if normals:
            set_direct(self._levels.coarse, "cholesky")
        self._matrix: PETSc.Mat | None = None
        self._in_blocks, self._converts = in_blocks or PETSc.Mat(), in_blocks is None
        pc.setUseAmat(True)

    def update(self, fixed: npt.NDArray[np.int32], essential: npt.NDArray[np.int32]) -> None:
        """Take over new conditions, which the system has (collective).

        Args:
            fixed: Owned unknowns that are fixed under all conditions.
            essential: Those fixed under these.
        """
        self._system.setOption(PETSc.Mat.Option.SYMMETRIC, True)  # PETSc forgets it where entries were added
        if self._converts:
            self._in_blocks = self._system.convert("sbaij", self._in_blocks)
        self._pc.setOperators(self._in_blocks, self._system)
        first = self._matrix is None
        self._matrix = self._galerkin(fixed if first and not self._normals else essential)
        if first:
            self._matrix.setOption(PETSc.Mat.Option.SPD, True)
            self._levels.coarse.setOperators(self._matrix)
            self._levels.coarse.setFromOptions()
            if not self._normals:
                if self._space.dofmap.index_map_bs > 1:
                    self._matrix.setNearNullSpace(self._rigid_motions())
                self._levels.coarse.setUp()
                self._galerkin(essential)

    def _smooth_up_to_largest(self) -> None:
        """Tell the smoother the eigenvalues, which PETSc would estimate again under all conditions (collective).

        With A the system and D its blocks, conditions leave the quotients xᵀAx/xᵀDx of a smaller space, and springs
        within the blocks bring these nearer to 1: so the largest one is an upper bound under all conditions.
        """
        x, b = self._system.createVecs()
        b.setRandom()
        estimate = PETSc.KSP().create(self._system.getComm())
        estimate.setOperators(self._system)
        estimate.setType("cg")
        estimate.getPC().setType(BLOCKS)
        estimate.setTolerances(max_it=ESTIMATE)
        estimate.setComputeEigenvalues(True)
        estimate.solve(b, x)
        largest = estimate.computeEigenvalues().real.max()
        for each in (estimate, x, b):
            each.destroy()
        options, name = PETSc.Options(), f"{self._smoother.getOptionsPrefix()}ksp_chebyshev_eigenvalues"
        options.setValue(name, ",".join(str(share * largest) for share in SMOOTHED))
        self._smoother.setFromOptions()
        options.delValue(name)

    def _galerkin(self, essential: npt.NDArray[np.int32]) -> PETSc.Mat:
        self._levels.leave_out(essential, np.empty(0, dtype=np.int32))
        product = self._system.PtAP(self._levels.interpolation, result=self._matrix)
        diagonal = product.getDiagonal()
        largest = diagonal.max()[1]
        entries = diagonal.array_r
        diagonal.array_w[:] = np.where(entries > 1e-14 * largest, SHIFT * entries, largest)
        product.setDiagonal(diagonal, PETSc.InsertMode.ADD_VALUES)
        return product

    def _rigid_motions(self) -> PETSc.NullSpace:
        dim = self._space.mesh.geometry.dim
        size = self._space.dofmap.index_map.size_local
        x: Array = self._space.tabulate_dof_coordinates()[:size, :dim].ravel()
        coordinates = PETSc.Vec().createWithArray(x, bsize=dim, comm=self._space.mesh.comm)
        return PETSc.NullSpace().createRigidBody(coordinates)


def facet_solver(
    spaces: LinearTraces,
    tuning: Tuning | None,
    operator: ConstrainedMatrix,
    *,
    direct: bool = False,
    with_normals: Callable[[], bool] = lambda: False,
) -> FacetSolver[TraceCoarse]:
    """The linear solver of a system of linear traces: a factorisation, or CG with multigrid (collective).

    Args:
        spaces: The spaces.
        tuning: Has the size from which CG with multigrid is the default.
        operator: The system.
        direct: Whether to factorise in any case, without the user's options for the facet system.
        with_normals: Whether the coarse space has the normals (collective).

    Raises:
        InputError: If PETSc refuses an option.
    """
    size, dim, dofs = spaces.traces.dofmap.index_map_bs, spaces.dim, operator.matrix.getSize()[0]

    def coarse(pc: PETSc.PC) -> TraceCoarse:
        space = fenicsx.function_space(spaces.mesh, ("Lagrange", 1, (size // dim,) if size > dim else ()))
        normals, in_blocks = with_normals(), operator.in_blocks()
        interpolation = trace_interpolation(spaces, space, normals=normals)
        return TraceCoarse(operator.matrix, size, space, interpolation, pc, normals=normals, in_blocks=in_blocks)

    large = not direct and (tuning or Tuning()).is_large(dofs, DIRECT_UP_TO[dim])
    prefix = "certificate_" if direct else "facet_"
    return FacetSolver(operator.matrix, prefix, DEFAULTS[dim], coarse if large else None, MOST_ITERATIONS)


def trace_interpolation(spaces: LinearTraces, displacements: fem.FunctionSpace, *, normals: bool) -> PETSc.Mat:
    """The unknowns of the traces of continuous linear displacements, and of n on single facets (collective).

    Columns are those of the displacements of a rank, then those of its facets if there are `normals`.

    Args:
        spaces: The spaces.
        displacements: P1 functions, of a body its displacements.
        normals: Whether there is a column for n on each facet.
    """
    dim, mesh = spaces.dim, spaces.mesh
    of_facet = facet_vertices(displacements, spaces.traces)
    rows, columns = spaces.traces.dofmap.index_map, displacements.dofmap.index_map
    number = np.empty(columns.size_local + columns.num_ghosts, dtype=np.int64)
    number[displacements.dofmap.list] = node_ranks(mesh, cut=spaces.inner.present)[mesh.geometry.dofmaps[0]]
    of_facet = np.take_along_axis(of_facet, np.argsort(number[of_facet], axis=1), axis=1)

    size, count = spaces.traces.dofmap.index_map_bs, len(of_facet)
    parts = size // dim  # components
    vertices = columns.local_to_global(of_facet.ravel()).astype(np.int64)
    starts = np.array(mesh.comm.allgather([columns.local_range[0], rows.local_range[0]]))
    before = starts[np.searchsorted(starts[:, 0], vertices, side="right") - 1, 1] if normals else 0  # columns of facets
    places = ((parts * vertices + before).reshape(count, dim, 1) + np.arange(parts)).reshape(count, size)
    values = np.broadcast_to(np.eye(size), (count, size, size)).copy()
    if normals:
        last = parts * columns.local_range[1] + rows.local_range[0] + np.arange(count)
        places = np.column_stack([places, last])
        values = np.concatenate([values, _normals_at_vertices(spaces)[:count, :, None]], axis=2)
    for facets, matrices in spaces.frames:
        values[facets.blocks] = np.linalg.solve(matrices, values[facets.blocks])
    ascending = np.argsort(places, axis=1)[:, None]
    places = np.take_along_axis(places[:, None], ascending, axis=2)
    values = np.take_along_axis(values, ascending, axis=2)
    used = values != 0
    begins = np.concatenate([[0], np.cumsum(used.sum(axis=2).ravel())]).astype(PETSc.IntType)
    indices = np.broadcast_to(places, values.shape)[used].astype(PETSc.IntType)
    owned, of_all = columns.size_local, columns.size_global
    of_sides = PETSc.Mat().createAIJ(
        [
            (size * rows.size_local, size * rows.size_global),
            (parts * owned + normals * rows.size_local, parts * of_all + normals * rows.size_global),
        ],
        bsize=(size, 1 if normals else parts),
        csr=(begins, indices, values[used]),
        comm=mesh.comm,
    )
    to_jumps = spaces.sides.inverse()
    return of_sides if to_jumps is None else to_jumps.matMult(of_sides)


def _normals_at_vertices(spaces: LinearTraces) -> Array:
    """The normal n of each facet, outer to one of its cells, for each of its vertices, shape (facets, d²)."""
    areas = facet_normals(spaces.vertices)
    normals = np.empty((spaces.dofs.max(initial=-1) + 1, spaces.dim))
    normals[spaces.dofs] = areas / np.linalg.norm(areas, axis=2, keepdims=True)
    return np.tile(normals, spaces.dim)
