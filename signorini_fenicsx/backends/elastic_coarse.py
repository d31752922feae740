"""The coarse space of the elastic facet system: conforming P1 displacements, with GAMG and the rigid motions."""

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.backends.two_level import TwoLevel, facet_vertices
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.elastic_spaces import ElasticSpaces

DEFAULTS = {
    "mg_levels_ksp_max_it": "4",
    "mg_levels_ksp_chebyshev_esteig": "0,0.05,0,1.1",
    "mg_coarse_pc_mg_cycle_type": "w",
    "mg_coarse_pc_gamg_aggressive_coarsening": "0",
    "mg_coarse_mg_levels_ksp_max_it": "4",
}
"""The coarse problem has a tenth of the entries, so a good solution costs little; towards ν = ½ it saves a third of the
iterations."""
SHIFT = 1e-10
"""Share of the coarse diagonal that is added to it: no motion is free, and nothing else is changed."""


class ElasticCoarse:
    """The traces of continuous linear displacements are traces of the facet system, so Galerkin's operator is theirs.

    It is made anew for each set, while GAMG's hierarchy is that of all of Γ_C free, see
    `AuxiliarySpace._build_hierarchy`. Vertices of fixed unknowns stay free: the operator holds them as springs do.
    """

    def __init__(self, spaces: ElasticSpaces, system: PETSc.Mat, pc: PETSc.PC):
        """Make `pc` a two-level multigrid with a smoother on the facets' blocks (collective).

        Args:
            spaces: The spaces.
            system: The facet system, whose values change with the conditions.
            pc: The preconditioner.
        """
        self._system = system
        size = spaces.dim**2
        system.setVariableBlockSizes(np.full(system.getLocalSize()[0] // size, size, dtype=PETSc.IntType))
        self._space = fem.functionspace(spaces.mesh, ("Lagrange", 1, (spaces.dim,)))
        self._levels = TwoLevel(
            pc, trace_interpolation(spaces, self._space), "vpbjacobi"
        )  # pbjacobi keeps its first blocks
        self._matrix: PETSc.Mat | None = None

    def update(self, fixed: npt.NDArray[np.int32], essential: npt.NDArray[np.int32]) -> None:
        """Take over new conditions, which the system has (collective).

        Args:
            fixed: Owned unknowns that are fixed under all conditions.
            essential: Those fixed under these.
        """
        if self._matrix is None:
            self._matrix = self._galerkin(fixed)
            self._matrix.setOption(PETSc.Mat.Option.SPD, True)
            self._matrix.setNearNullSpace(self._rigid_motions())
            self._levels.coarse.setOperators(self._matrix)
            self._levels.coarse.setFromOptions()
            self._levels.coarse.setUp()
        self._galerkin(essential)

    def _galerkin(self, essential: npt.NDArray[np.int32]) -> PETSc.Mat:
        self._levels.leave_out(essential, np.empty(0, dtype=np.int32))
        found = self._system.PtAP(self._levels.interpolation, result=self._matrix)
        diagonal = found.getDiagonal()
        largest = diagonal.max()[1]
        own = diagonal.array_r
        diagonal.array_w[:] = np.where(own > 1e-14 * largest, SHIFT * own, largest)
        found.setDiagonal(diagonal, PETSc.InsertMode.ADD_VALUES)
        return found

    def _rigid_motions(self) -> PETSc.NullSpace:
        dim = self._space.mesh.geometry.dim
        size = self._space.dofmap.index_map.size_local
        x: Array = self._space.tabulate_dof_coordinates()[:size, :dim].ravel()
        coordinates = PETSc.Vec().createWithArray(x, bsize=dim, comm=self._space.mesh.comm)
        return PETSc.NullSpace().createRigidBody(coordinates)


def trace_interpolation(spaces: ElasticSpaces, displacements: fem.FunctionSpace) -> PETSc.Mat:
    """The unknowns of the traces of continuous linear displacements (collective).

    Args:
        spaces: The spaces.
        displacements: The displacements, in P1.
    """
    dim, mesh = spaces.dim, spaces.mesh
    of_facet = facet_vertices(displacements, spaces.traces)
    rows, columns = spaces.traces.dofmap.index_map, displacements.dofmap.index_map
    number = np.empty(columns.size_local + columns.num_ghosts, dtype=np.int64)
    number[displacements.dofmap.list] = mesh.geometry.input_global_indices[mesh.geometry.dofmaps[0]]
    of_facet = np.take_along_axis(of_facet, np.argsort(number[of_facet], axis=1), axis=1)

    size = dim**2
    vertices = columns.local_to_global(of_facet.ravel()).reshape(-1, dim, 1)
    values = np.broadcast_to(np.eye(size), (len(of_facet), size, size)).copy()
    for facets, matrices in spaces.frames:
        values[facets.blocks] = np.linalg.inv(matrices)
    places = (vertices * dim + np.arange(dim)).reshape(-1, 1, size)
    ascending = np.argsort(places, axis=2)
    places, values = np.take_along_axis(places, ascending, axis=2), np.take_along_axis(values, ascending, axis=2)
    used = values != 0
    begins = np.concatenate([[0], np.cumsum(used.sum(axis=2).ravel())]).astype(PETSc.IntType)
    indices = np.broadcast_to(places, values.shape)[used].astype(PETSc.IntType)
    return PETSc.Mat().createAIJ(
        [(size * rows.size_local, size * rows.size_global), (dim * columns.size_local, dim * columns.size_global)],
        bsize=(size, dim),
        csr=(begins, indices, values[used]),
        comm=mesh.comm,
    )
