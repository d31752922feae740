"""The hybrid system of RT1: one SPD problem for û in P1 on facets, and σ and u recovered from it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.hybrid_system import Eliminated, HybridSystem, eliminate
from signorini_fenicsx.discrete.simplices import blocks_of_cells, facet_normals, opposite
from signorini_fenicsx.physics.diffusion.discrete.linear_data import LinearData
from signorini_fenicsx.physics.diffusion.discrete.linear_spaces import LinearSpaces
from signorini_fenicsx.physics.diffusion.discrete.raviart_thomas import Cells, reference


class FluxSystem(HybridSystem):
    """The hybrid system of RT1, assembled once.

    Attributes:
        spaces: The spaces.
    """

    def __init__(self, spaces: LinearSpaces, data: LinearData):
        """Eliminate and assemble (collective)."""
        self.spaces, self._data = spaces, data
        super().__init__(spaces.traces, spaces.dofs, spaces.sides)
        self._take_loads()

    def _take_loads(self) -> None:
        """Find the right side (collective)."""
        self.tractions = self._data.load
        self.load = self.load_of(self._blocks, self._data.lift) + self.tractions

    def renew(self, data: LinearData) -> bool:
        """Go on with other data; False if these have another matrix (collective)."""
        if not data.same_operator(self._data, self.spaces) or data.kappa is not self._data.kappa:
            return False
        self._data = data
        self.eliminate_again()
        self._take_loads()
        return True

    def eliminated(self, functional: Array | None = None, moments: Array | None = None) -> Iterator[Eliminated]:
        """The cells after elimination, with the data or another right side (collective).

        Args:
            functional: A functional of σ: its values at the basis of each cell, shape (cells, basis).
            moments: (f, φ_v) of each cell, shape (cells, d + 1).
        """
        spaces, data, element = self.spaces, self._data, reference(self.spaces.dim)
        for numbers in blocks_of_cells(spaces.mesh):
            cells = Cells(spaces.vertices[numbers])
            product, reaction = data.products(spaces, numbers, cells), data.reactions(spaces, numbers, cells)
            of_f = data.moments_of_f(spaces, numbers, cells) if moments is None else moments[numbers]
            if len(numbers) == 0:  # other ranks have more cells
                continue
            tractions = np.broadcast_to(element.tractions, (len(numbers), *element.tractions.shape)).copy()
            spaces.to_unknowns(tractions, numbers)
            of_sigma = 0.0 if functional is None else functional[numbers]
            yield eliminate(numbers, cells, tractions, product, -of_f, of_sigma, reaction)

    def fields(self, parts: Iterable[tuple[Eliminated, Array, Array]]) -> tuple[Array, Array]:
        """σ at the nodes and u at the vertices of the cells, shapes (cells, nodes, d) and (cells, d + 1)."""
        count, dim = len(self.spaces.order), self.spaces.dim
        sigma, u = np.empty((count, len(reference(dim).at_nodes), dim)), np.empty((count, dim + 1))
        for block, of_flux, of_u in parts:
            sigma[block.cells] = block.geometry.at_nodes(of_flux)
            u[block.cells] = of_u
        return sigma, u

    def forces(self, sigma: Array) -> Array:
        """⟨σ·n, q⟩ summed over the cells for each owned unknown, see `HybridSystem.forces` (collective)."""
        spaces = self.spaces
        through = np.einsum("nsaj,nsj->nsa", sigma[:, opposite(spaces.dim)], facet_normals(spaces.vertices))
        return spaces.forces(through[:, :, :, None])
