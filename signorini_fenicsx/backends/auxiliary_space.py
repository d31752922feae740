"""Auxiliary-space multigrid for the Crouzeix-Raviart system: a smoother on facets, multigrid on conforming P1."""

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from petsc4py import PETSc

from signorini_fenicsx.backends.coarser_levels import use_coarser_meshes
from signorini_fenicsx.backends.jumps import jumps_of_facets
from signorini_fenicsx.backends.two_level import TwoLevel, facet_vertices
from signorini_fenicsx.discrete.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.nodes import Jumps
from signorini_fenicsx.discrete.sources import Sources
from signorini_fenicsx.discrete.spaces import Spaces, owned_on_facets
from signorini_fenicsx.forms.crouzeix_raviart import reaction, stiffness

SMOOTHERS = {
    f"{level}_{name}": value
    for level in ("mg_levels", "mg_coarse_mg_levels", "mg_coarse_mg_coarse_mg_levels")
    for name, value in (("pc_jacobi_type", "rowl1"), ("ksp_chebyshev_eigenvalues", "0.1,1.0"))
}
"""Where Jacobi divides by the sum of the absolute values of a row, no eigenvalue is above 1 for any sets, so none is
estimated. Estimates would cost ten products and twenty reductions on each level for each set, and are too small at
times: then the preconditioner is indefinite."""
DEFAULTS = SMOOTHERS | {"mg_coarse_pc_mg_galerkin": "both", "mg_coarse_mg_coarse_pc_gamg_aggressive_coarsening": "0"}
"""The last two matter on refined meshes only, see `coarser_levels`."""


class AuxiliarySpace:
    """The coarse level of a two-level PCMG: P1 ⊂ CR has 3 times (2D) to 12 times (3D) fewer unknowns.

    It has the facet conditions too, otherwise many more iterations are needed: vertices of ZERO_TRACE facets and of Γ_D
    are fixed, ROBIN facets add their lumped mass. Where the facet system has jumps, P1 has them too. Cells in contact
    with an obstacle add what they add to the system.
    """

    def __init__(self, spaces: Spaces, data: Data, s: fem.Function | None, pc: PETSc.PC):
        """Assemble the P1 operator and the interpolation, and make `pc` a two-level multigrid (collective).

        `s` is that of the sources of the facet system, see `Sources`.
        """
        self._spaces, self._weak = spaces, data.conductance
        self._space = fem.functionspace(spaces.mesh, ("Lagrange", 1))
        u, v = ufl.TrialFunction(self._space), ufl.TestFunction(self._space)
        form, self._s = stiffness(u, v, ufl.dx, data.kappa_h), None if s is None else s.copy()
        if self._s is not None:
            form += reaction(u, v, ufl.dx, self._s)
        self._form, self._by_cells = fem.form(form), data.obstacle is not None
        self._jumps = Jumps.of(self._space, spaces)
        basis = None if self._jumps is None else self._jumps.basis
        self._operator = ConstrainedMatrix(self._form, PETSc.Mat.Option.SPD, basis)
        self._beta = fem.Function(spaces.Lambda)
        self._robin = spaces.form(self._beta * v * spaces.ds)
        self._dirichlet = owned_on_facets(self._space, spaces.dirichlet_facets)
        self._has_hierarchy = False
        self._all = np.arange(self._space.dofmap.index_map.size_local, dtype=np.int32)

        interpolation = facet_means(self._space, data.u_lift.function_space)
        to_jumps = jumps_of_facets(spaces, back=True)
        if to_jumps is not None:
            interpolation = to_jumps.matMult(interpolation.matMult(basis))
        self._levels = TwoLevel(pc, interpolation, "jacobi")
        self._levels.coarse.setOperators(self._operator.matrix)
        if self._jumps is None:
            use_coarser_meshes(self._levels.coarse.getPC(), self._space, spaces.domain)

    def update(self, conditions: SiteConditions, essential: npt.NDArray[np.int32], present: Sources) -> None:
        """Take over new facet conditions (collective).

        Args:
            conditions: Conditions of the Γ_S facets.
            essential: Owned Crouzeix-Raviart unknowns that are fixed.
            present: The sources under these conditions and those of the cells.
        """
        if not self._has_hierarchy:
            self._build_hierarchy()
        if self._by_cells and self._s is not None and present.s is not None:
            self._s.x.array[:] = present.s.x.array
            self._operator.renew(self._form)
        held = owned_on_facets(self._space, self._spaces.facets[conditions.kind == Condition.ZERO_TRACE])
        if self._jumps is not None:
            held = np.setdiff1d(held, self._jumps.tips)
        fixed = np.union1d(self._dirichlet, held).astype(np.int32)
        self._operator.impose(fixed, self._all, self._lumped_robin(conditions))
        self._levels.leave_out(essential, fixed)

    def _build_hierarchy(self) -> None:
        """Build the interpolations once; later only the operators are renewed (collective).

        Those of GAMG come from the problem with all of Γ_S free. If they vanished on Γ_S, they could not correct
        errors on facets that a later set frees. Vertices that a later set fixes do no harm: the operators have them.
        """
        if self._by_cells and self._s is not None and not self._spaces.has_dirichlet:
            self._s.x.array[:] = self._weak / self._spaces.length
            self._operator.renew(self._form)
        self._operator.impose(self._dirichlet, self._all, self._tied_down())
        self._levels.coarse.setFromOptions()
        self._levels.coarse.setUp()
        self._has_hierarchy = True

    def _tied_down(self) -> npt.NDArray[np.float64]:
        """What makes the operator regular without Γ_D: a weak Robin condition on Γ_S."""
        spaces = self._spaces
        if spaces.has_dirichlet:
            return np.zeros(len(self._all))
        return self._lumped_robin(SiteConditions.everywhere(Condition.ROBIN, len(spaces.facets), self._weak))

    def _lumped_robin(self, conditions: SiteConditions) -> npt.NDArray[np.float64]:
        robin = conditions.kind == Condition.ROBIN
        self._beta.x.array[: len(robin)] = np.where(robin, conditions.beta, 0.0)
        self._beta.x.scatter_forward()
        lumped = fem.assemble_vector(self._robin)
        lumped.scatter_reverse(la.InsertMode.add)
        if self._jumps is not None:
            lumped.array[self._jumps.tips] = 0.0
        return lumped.array[: len(self._all)]


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
