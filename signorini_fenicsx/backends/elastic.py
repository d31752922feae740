"""The elastic backend: the facet system, factorised, with a contact condition per facet vertex of Γ_C."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from dolfinx import la
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.backends.contract import Backend, Inexact, Iterate
from signorini_fenicsx.backends.elastic_system import ElasticSystem
from signorini_fenicsx.backends.facets import FieldChange
from signorini_fenicsx.backends.petsc import direct_solver
from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.chains import Chains
from signorini_fenicsx.discrete.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.discrete.elastic_data import ElasticData
from signorini_fenicsx.discrete.elastic_spaces import ElasticSpaces


class ElasticBackend:
    """Solves under one condition per facet vertex of Γ_C: p = g − u_n there, and the flux is the pressure −σ_nn.

    ZERO_TRACE is contact, NO_FLUX a free vertex.
    """

    name = "elastic"
    noun = ("vertex", "vertices")
    inexact: Inexact | None = None
    precise: Callable[[], Backend[Iterate]] | None = None

    def __init__(self, spaces: ElasticSpaces, data: ElasticData, prefix: str = "facet_"):
        """Assemble (collective).

        Args:
            spaces: The spaces.
            data: The data.
            prefix: Of its PETSc options.

        Raises:
            InputError: If PETSc refuses an option.
        """
        self.spaces, self._data = spaces, data
        self.comm = spaces.mesh.comm
        self.sites = len(spaces.sites)
        self.chains = Chains.at_corner(self.sites)
        self.system = ElasticSystem(spaces, data)
        self._operator = ConstrainedMatrix(self.system.matrix, PETSc.Mat.Option.SPD)
        self.dofs = self._operator.matrix.getSize()[0]
        self._solver = direct_solver(self._operator.matrix, "cholesky", prefix)
        self._x, self._b = self._operator.matrix.createVecs()
        self._x.set(0.0)
        self._largest = 0.0, 0.0

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return self._solver.name()

    def solve(self, conditions: SiteConditions) -> Iterate:
        """Solve as `Backend.solve` says (collective).

        Raises:
            InputError: If a condition is neither contact nor free.
            LinearSolveFailure: If the linear solver fails.
        """
        if conditions.counts(self.comm)[Condition.ROBIN] > 0:
            raise InputError("elastic contact takes no penalty; use alg1 or alg2")
        contact = conditions.kind == Condition.ZERO_TRACE
        essential = np.concatenate([self._data.fixed, self.spaces.sites[contact]])
        none = np.empty(0, dtype=np.int32)
        self._operator.impose(essential, none, none)
        self._b.array_w[:] = self.system.load
        self._b.array_w[essential] = 0.0
        self._x.array_w[essential] = 0.0
        self._solver.solve(self._b, self._x)
        return self._recovered(conditions)

    def _recovered(self, conditions: SiteConditions) -> Iterate:
        spaces = self.spaces
        index_map = spaces.traces.dofmap.index_map
        x = la.vector(index_map, spaces.dim**2)
        owned: Array = self._x.array_r
        x.array[: len(owned)] = owned
        x.scatter_forward()
        stresses, displacements = self.system.recover(x.array + self._data.lift)
        pressure = -spaces.normal_stress(stresses)
        p, flux = conditions.clean(-owned[spaces.sites], pressure, 1.0)
        self._largest = self._extent(np.abs(displacements), np.abs(stresses))
        return Iterate(
            p=p,
            flux=flux,
            linear_iterations=self._solver.ksp.getIterationNumber(),
            sigma=spaces.split.stress(stresses),
            u=spaces.displacement(displacements),
        )

    def without_flux(self, iterate: Iterate, where: Mask) -> Iterate:
        """Refused: there is no clip without a penalty.

        Raises:
            InputError: Always.
        """
        raise InputError("elastic contact takes no penalty; use alg1 or alg2")

    def scales(self, iterate: Iterate) -> tuple[Array, Array]:
        """The largest |u| and the largest |σ|, see `Backend.scales`."""
        u, sigma = self._largest
        return np.full(self.sites, u), np.full(self.sites, sigma)

    @cached_property
    def change(self) -> FieldChange:
        """Norms of what changed, see `Backend.change`."""
        return FieldChange(self.spaces.split.stresses, self.spaces.displacements)

    def places(self) -> Array:
        """The vertex, and the sum of its facet's vertices."""
        vertices = self.spaces.contact.vertices
        of_facet = np.broadcast_to(np.sort(vertices, axis=1).sum(axis=1, keepdims=True), vertices.shape)
        return np.concatenate([vertices, of_facet], axis=2).reshape(self.sites, 2 * self.spaces.dim)

    def in_mixed_spaces(self, iterate: Iterate, conditions: SiteConditions) -> tuple[Iterate, SiteConditions]:
        """As they are: σ in the Johnson-Mercier space, u linear on each cell, and conditions per facet vertex."""
        return iterate, conditions

    def _extent(self, *values: Array) -> tuple[float, float]:
        largest = np.array([one.max(initial=0.0) for one in values])
        self.comm.Allreduce(MPI.IN_PLACE, largest, MPI.MAX)
        u, sigma = largest.tolist()
        return u, sigma
