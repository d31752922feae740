"""The problem that the change of a solution solves, as a backend: its sites are on lines or two rays from a corner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import cell_dofs, owned_values
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.mesh_spaces import cells_and_dofs
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.facet_system import Loads
from signorini_fenicsx.physics.diffusion.solve.facets import FacetBackend
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend


class Tangent(FacetBackend):
    """Solves for the change of a solution under conditions on its sites; p and σ·n are measured from 0."""

    name = "tangent"

    def __init__(self, spaces: Spaces, data: Data, hybrid: HybridBackend, loads: Loads, chains: Chains):
        """Take the backend that solves, what the data add to the right side, and the rays of the sites."""
        super().__init__(spaces, data)
        self._hybrid, self._loads, self._chains = hybrid, loads, chains
        self.dofs = hybrid.dofs

    @property
    def chains(self) -> Chains:
        """The rays of each site."""
        return self._chains

    def solver(self) -> str:
        """Name of the linear solver in use."""
        return self._hybrid.solver()

    def solve(self, conditions: SiteConditions) -> Iterate:
        """Solve as `Backend.solve` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        spaces, loads, space = self.spaces, self._loads, self.spaces.crouzeix_raviart
        values, held = np.broadcast_to(conditions.value, self.sites), conditions.kind == Condition.ZERO_TRACE
        trace, pulled = np.where(held, values, 0.0), np.where(held, 0.0, values)
        dofs = cells_and_dofs(space, spaces.facets)[1]
        on_facets = np.zeros(len(loads.forces) + space.dofmap.index_map.num_ghosts)
        on_facets[dofs] = self.facets.of(trace)  # only the cell behind a facet of Γ_S has it
        forces = loads.forces.copy()
        forces[dofs] += self.facets.of(pulled) * spaces.facet_measure
        loads = replace(loads, jumps=loads.jumps + on_facets[cell_dofs(space)], forces=forces)
        if self.data.inside is not None:
            loads = replace(loads, source=loads.source + self.cells.of(pulled), held=self.cells.of(trace))
        sigma, u, traces = self._hybrid.respond(conditions, loads)
        p, flux = traces[dofs] + self.facets.of(trace), spaces.normal_flux(sigma)
        if self.data.inside is not None:
            p, flux = np.append(p, owned_values(u)), np.append(flux, self._minus_s(sigma, owned_values(u)))
        p, flux = conditions.clean(p, flux, self.data.conductance)
        return Iterate(p=p, flux=flux, linear_iterations=1, sigma=sigma, u=u)

    def _minus_s(self, sigma: fem.Function, u: Array) -> Array:
        """The change of −s = −∇·σ − f + cu in each cell."""
        c = 0.0 if self.data.c_h is None else owned_values(self.data.c_h)
        through = self.spaces.outflow * sigma.x.array[cell_dofs(self.spaces.V)]
        minus_s: Array = -np.einsum("cf->c", through) / self.spaces.cell_measures - self._loads.source + c * u
        return minus_s
