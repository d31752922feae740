"""Auxiliary-space multigrid for the Crouzeix-Raviart system: a smoother on facets, multigrid on conforming P1.

*Levels of multigrid for P1 on a mesh that was refined uniformly*: P1 on the meshes from which it was made.

GAMG is what is left on the coarsest of them. The operators between are Galerkin's, so levels need neither data nor
conditions of their own. GAMG's own levels from the finest mesh on take longer to set up for each set and give more
iterations.
"""

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.tolerances import ROUNDING
from signorini_fenicsx.discrete.mesh_spaces import owned_on_facets
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix, image_of
from signorini_fenicsx.linear.two_level import TwoLevel, choose_smoother, facet_vertices
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.uniform import parents
from signorini_fenicsx.physics.diffusion.discrete.nodes import Jumps
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.facet_system import FacetSystem


def use_coarser_meshes(pc: PETSc.PC, space: fem.FunctionSpace, domain: Domain) -> None:
    """Make `pc`, on P1, a multigrid on the meshes from which the domain's was refined, or else GAMG (collective).

    Args:
        pc: The preconditioner. Its option pc_mg_galerkin must be "both".
        space: P1 on the domain's mesh.
        domain: The domain.
    """
    steps = _interpolations(space, domain)
    if not steps:
        pc.setType("gamg")
        return
    pc.setType("mg")
    pc.setMGLevels(len(steps) + 1)
    for level, step in enumerate(reversed(steps), start=1):
        pc.setMGInterpolation(level, step)
        choose_smoother(pc, level, domain.mesh.topology.dim)
    coarsest = pc.getMGCoarseSolve()
    coarsest.setType("preonly")
    coarsest.getPC().setType("gamg")


def _interpolations(space: fem.FunctionSpace, domain: Domain) -> list[PETSc.Mat]:
    """Interpolations from each mesh to the next finer one, the finest first (collective).

    Unknowns are numbered by `space` on the finest mesh, and as the nodes of the other meshes are.
    """
    number = space.dofmap.index_map.size_local
    of_unknown = np.empty(number + space.dofmap.index_map.num_ghosts, dtype=np.int64)
    of_unknown[space.dofmap.list] = domain.mesh.geometry.dofmaps[0]
    rows, steps = of_unknown[:number], []
    while domain.coarser is not None:
        steps.append(_means(parents(domain)[rows], domain.coarser))
        domain = domain.coarser
        rows = np.arange(domain.mesh.geometry.index_map().size_local)
    return steps


def _means(pairs: Indices, coarse: Domain) -> PETSc.Mat:
    """The means of pairs of nodes of a mesh, or one value where both are the same (collective)."""
    nodes = coarse.mesh.geometry.index_map()
    columns = np.sort(nodes.local_to_global(pairs.ravel().astype(np.int32)).reshape(pairs.shape), axis=1)
    used = np.ones(pairs.shape, dtype=bool)
    used[:, 1] = columns[:, 0] != columns[:, 1]
    count = used.sum(axis=1)
    begins = np.concatenate([[0], np.cumsum(count)])
    return PETSc.Mat().createAIJ(
        [(len(pairs), PETSc.DETERMINE), (nodes.size_local, nodes.size_global)],
        csr=(begins.astype(PETSc.IntType), columns[used].astype(PETSc.IntType), np.repeat(1 / count, count)),
        comm=coarse.mesh.comm,
    )


SMOOTHERS = {
    f"{level}_{name}": value
    for level in ("mg_levels", "mg_coarse_mg_levels", "mg_coarse_mg_coarse_mg_levels")
    for name, value in (("pc_jacobi_type", "rowl1"), ("ksp_chebyshev_eigenvalues", "0.1,1.0"))
}
"""Where Jacobi divides by the sum of the absolute values of a row, no eigenvalue is above 1 for any sets, so none is
estimated. Estimates would cost ten products and twenty reductions on each level for each set, and are too small at
times: then the preconditioner is indefinite."""
DEFAULTS = SMOOTHERS | {"mg_coarse_pc_mg_galerkin": "both", "mg_coarse_mg_coarse_pc_gamg_aggressive_coarsening": "0"}
"""The last two matter on refined meshes only, see above."""
TIED = 1e-4
"""Share of its diagonal that makes an operator regular without Γ_D, while GAMG's interpolations are built."""


class AuxiliarySpace:
    """The coarse level of a two-level PCMG: P1 ⊂ CR has 3 times (2D) to 12 times (3D) fewer unknowns.

    Its operator is Galerkin's, which is that of P1. It has the facet conditions too, otherwise many more iterations are
    needed: vertices of ZERO_TRACE facets and of Γ_D are fixed, ROBIN facets add their lumped mass. Where the facet
    system has jumps, P1 has them too.
    """

    def __init__(self, spaces: Spaces, system: FacetSystem, operator: ConstrainedMatrix, pc: PETSc.PC):
        """Make the interpolation and the P1 operator, and make `pc` a two-level multigrid (collective).

        Args:
            spaces: The discrete spaces.
            system: The facet system.
            operator: Its matrix, without and under conditions.
            pc: The preconditioner.
        """
        self._spaces, self._system, self._facets = spaces, system, operator
        self._space = fenicsx.function_space(spaces.mesh, ("Lagrange", 1))
        self._jumps = Jumps.of(self._space, spaces)
        self._interpolation = facet_means(self._space, spaces.crouzeix_raviart)
        to_jumps = system.sides.inverse()
        if self._jumps.basis is not None and to_jumps is not None:
            self._interpolation = to_jumps.matMult(self._interpolation.matMult(self._jumps.basis[0]))
        self._operator = ConstrainedMatrix(self._galerkin(), PETSc.Mat.Option.SPD)
        self._dirichlet = owned_on_facets(self._space, spaces.dirichlet_facets)
        self._has_hierarchy = False
        self._all = np.arange(self._space.dofmap.index_map.size_local, dtype=np.int32)
        self._levels = TwoLevel(pc, self._interpolation)
        choose_smoother(pc, 1, spaces.mesh.topology.dim, jumps=self._jumps.basis is not None)
        self._levels.coarse.setOperators(self._operator.matrix)
        if self._jumps.basis is None:
            use_coarser_meshes(self._levels.coarse.getPC(), self._space, spaces.domain)

    def update(self, _fixed: npt.NDArray[np.int32], essential: npt.NDArray[np.int32]) -> None:
        """Take over new facet conditions, which the system has (collective).

        Args:
            _fixed: Owned Crouzeix-Raviart unknowns that are fixed under all conditions.
            essential: Those fixed under these.
        """
        if not self._has_hierarchy:
            self._build_hierarchy()
        if self._system.follows_cells:
            self._galerkin().copy(self._operator.natural, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        held = np.isin(self._spaces.site_kinds["facet"].unknown, essential)
        vertices = np.setdiff1d(owned_on_facets(self._space, self._spaces.facets[held]), self._jumps.tips)
        fixed = np.union1d(self._dirichlet, vertices).astype(np.int32)
        self._operator.impose(fixed, self._all, self._lumped_springs(held))
        self._levels.leave_out(essential, fixed)

    def _build_hierarchy(self) -> None:
        """Build the interpolations once; later only the operators are renewed (collective).

        Those of GAMG come from the problem with all of Γ_S free. If they vanished on Γ_S, they could not correct
        errors on facets that a later set frees. Vertices that a later set fixes do no harm: the operators have them.
        """
        share = 0.0 if self._spaces.held else TIED
        self._operator.impose(self._dirichlet, self._all, share * self._operator.natural.getDiagonal().array_r)
        self._levels.coarse.setFromOptions()
        self._levels.coarse.setUp()
        self._has_hierarchy = True

    def _galerkin(self) -> PETSc.Mat:
        """The operator without conditions on facets, without what PETSc keeps for another product (collective)."""
        product = self._system.matrix.ptap(self._interpolation)
        operator = product.duplicate(copy=True)
        product.destroy()
        return operator

    def _lumped_springs(self, held: Mask) -> Array:
        """The springs of the facets of Γ_S that are not held, shared out to their vertices (collective)."""
        unknown = self._spaces.site_kinds["facet"].unknown[~held]
        stiff, natural = (each.getDiagonal().array_r[unknown] for each in (self._facets.matrix, self._system.matrix))
        of_facets = np.zeros(len(self._system.load))
        of_facets[unknown] = np.where(stiff > natural * (1 + ROUNDING), stiff - natural, 0.0)
        return image_of(self._interpolation, of_facets, transposed=True)


def facet_means(vertices: fem.FunctionSpace, facets: fem.FunctionSpace) -> PETSc.Mat:
    """The inclusion of P1 in the Crouzeix-Raviart functions: a facet has the mean of its vertices (collective).

    `dolfinx.fem.petsc.interpolation_matrix` is not used: it takes about as long as the assembly of both stiffness
    matrices, and stores a 0 for the vertex opposite to each facet.

    Args:
        vertices: P1.
        facets: Crouzeix-Raviart functions on the same mesh.
    """
    owned, columns, rows = facet_vertices(vertices, facets), vertices.dofmap.index_map, facets.dofmap.index_map
    d = owned.shape[1]
    indices = np.sort(columns.local_to_global(owned.ravel()).reshape(owned.shape), axis=1).astype(PETSc.IntType)
    return PETSc.Mat().createAIJ(
        [(space.size_local, space.size_global) for space in (rows, columns)],
        csr=(np.arange(len(owned) + 1, dtype=PETSc.IntType) * d, indices.ravel(), np.full(owned.size, 1 / d)),
        comm=facets.mesh.comm,
    )
