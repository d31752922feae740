"""The hybrid system of RT1: one SPD problem for û at the vertices of facets, and σ and u recovered from it."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import sums_at
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.discrete.hybrid_system import Eliminated, HybridSystem, eliminate
from signorini_fenicsx.discrete.linear_traces import (
    facet_normals,
    linear_from_means,
    means_of_linear,
    opposite,
)
from signorini_fenicsx.discrete.vertex_laws import InCells
from signorini_fenicsx.physics.diffusion.discrete.raviart_thomas import Cells, reference
from signorini_fenicsx.physics.diffusion.discrete.rt1_data import RT1Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces
from signorini_fenicsx.physics.diffusion.solve.soil_traces import SoilTraces


class VertexSystem(SoilTraces, HybridSystem):
    """The hybrid system of RT1, assembled once.

    Attributes:
        spaces: The spaces.
    """

    def __init__(self, spaces: RT1Spaces, data: RT1Data):
        """Eliminate and assemble (collective)."""
        self.spaces, self._data, self._in_cells = spaces, data, None
        if data.inside:
            none = SiteConditions.everywhere(Condition.NO_FLUX, len(data.cells_at.p_h))
            self._in_cells = InCells.of(data.cells_at, none)
        super().__init__(spaces.traces, spaces.dofs, spaces.sides)
        self._take_loads()

    def _take_loads(self) -> None:
        """Find the right side (collective)."""
        self.tractions = self._data.load
        self.load = self.load_of(self._blocks, self._data.lift) + self.tractions

    def impose_in_cells(self, conditions: SiteConditions) -> None:
        """Let the laws in Ω be under these conditions of the vertices of cells (collective)."""
        self._in_cells = InCells.of(self._data.cells_at, conditions)
        self.assemble_again()
        self._take_loads()

    def renew(self, data: RT1Data) -> bool:
        """Go on with other data; False if these have another matrix (collective)."""
        same = data.kappa is self._data.kappa and data.c is self._data.c  # in the points of quadratures, too
        if data.inside or not same or not data.same_operator(self._data, self.spaces):
            return False
        self._data = data
        self.eliminate_again()
        self._take_loads()
        return True

    def eliminated(self, functional: Array | None = None, moments: Array | None = None) -> Iterator[Eliminated[Cells]]:
        """The cells after elimination, with the data or another right side (collective).

        Args:
            functional: A functional of σ: its values at the basis of each cell, shape (cells, basis).
            moments: (f, φ_v) of each cell, shape (cells, d + 1).
        """
        spaces, data, element = self.spaces, self._data, reference(self.spaces.dim)
        for cells in spaces.blocks():
            numbers, product, reaction = cells.numbers, data.products(spaces, cells), data.reactions(spaces, cells)
            of_f = data.moments_of_f(spaces, cells) if moments is None else moments[numbers]
            of_b = data.of_b(spaces, cells) if functional is None else None
            if len(numbers) == 0:  # other ranks have more cells
                continue
            tractions = np.broadcast_to(element.tractions, (len(numbers), *element.tractions.shape)).copy()
            spaces.to_unknowns(tractions, numbers)
            of_sigma = functional[numbers] if functional is not None else 0.0 if of_b is None else of_b
            if self._in_cells is None:
                yield eliminate(cells, tractions, product, -of_f, of_sigma, reaction)
            else:
                yield self._with_laws(cells, tractions, product, of_f, of_sigma, reaction, self._in_cells)

    def _with_laws(
        self,
        cells: Cells,
        tractions: Array,
        product: Array,
        of_f: Array,
        of_sigma: Array | float,
        reaction: Array | None,
        laws: InCells,
    ) -> Eliminated[Cells]:
        """Eliminate cells with laws in Ω, with u in the basis dual to the hats, and fluxes dual to that.

        With X from means by the hats to values at the vertices u = Xû, and the fluxes have moments of ∇· against the
        functions of û. Where û is held, the flux of this moment is one of the unknowns.
        """
        free, units = reference(self.spaces.dim).free, np.eye(self.spaces.dim + 1)
        values, means = linear_from_means(units), means_of_linear(units)  # X and its inverse
        share, to_dual = cells.measure / len(units), np.eye(product.shape[1])
        to_dual[free:, free:] = means
        springs = share[:, None, None] * laws.stiffness[cells.numbers]
        springs = springs if reaction is None else springs + values @ reaction @ values
        block = eliminate(
            cells,
            tractions @ to_dual,
            to_dual @ product @ to_dual,
            -of_f @ values - share[:, None] * laws.load[cells.numbers],
            of_sigma @ to_dual if isinstance(of_sigma, np.ndarray) else of_sigma,
            reaction=springs,
            held=(laws.held[cells.numbers], laws.values[cells.numbers]),
        )
        return replace(
            block,
            flux=to_dual @ block.flux,
            flux_of_f=block.flux_of_f @ to_dual,
            u=values @ block.u,
            u_of_f=block.u_of_f @ values,
        )

    def take_kappa(self, data: RT1Data) -> None:
        """Go on with the same data but for κ (collective)."""
        self._data = data
        self.assemble_again()
        self._take_loads()

    def traces_on_cells(self, unknowns: Array) -> Array:
        """See `SoilTraces`, shape (cells, (d + 1) d) (collective)."""
        values = self.sides.values(unknowns)[self._unknowns(np.arange(len(self._dofs), dtype=np.int32))]
        for facets, matrices in self.spaces.frames:
            places = facets.cells[:, None], facets.local[:, None] * self.spaces.dim + np.arange(self.spaces.dim)
            values[places] = np.einsum("fij,fj->fi", matrices, values[places])
        return np.asarray(values)

    def means_of_cells(self, traces: Array) -> Array:
        """See `SoilTraces` (collective)."""
        of_facets = traces.reshape(*self._dofs.shape, self.spaces.dim)
        means = sums_at(self._numbers, self._dofs, of_facets) / self.cells_around[:, None]
        for facets, matrices in self.spaces.frames:
            means[facets.blocks] = np.linalg.solve(matrices, means[facets.blocks][:, :, None])[:, :, 0]
        return means.ravel()

    @property
    def fixed(self) -> npt.NDArray[np.int32]:
        """See `SoilTraces`."""
        return self._data.fixed

    def in_cells(self, x: PETSc.Vec) -> tuple[Array, Array]:
        """The means of u by the hats less their references, and −s at the vertices of cells with laws (collective)."""
        return self._data.in_cells(self.spaces, *self.recover(self.with_lift(x)))

    def by_kappa(self, x: PETSc.Vec) -> Array:
        """The derivatives of ⟨σ·n, q⟩ on the facets of each cell by κ at its vertices, shape (cells, n, d + 1).

        Collective. q has a value 1 at a vertex of a facet. They are what (κ⁻²σ φ_v, τ) on the right gives: as the cells
        are symmetric, its product with the σ of q.
        """
        sigma, _ = self.recover(self.with_lift(x))
        functionals = self._data.by_kappa(self.spaces, sigma)
        found = np.zeros((len(sigma), (self.spaces.dim + 1) * self.spaces.dim, functionals.shape[2]))
        for block in self._blocks:
            cells = block.cells.numbers
            found[cells] = block.flux.transpose(0, 2, 1) @ functionals[cells, : block.flux.shape[1]]
        return found

    def of_cells(self, matrices: Array) -> PETSc.Mat:
        """The sum of matrices of the owned cells, from û at the vertices of their facets to ⟨σ·n, q⟩ (collective)."""
        transposed = matrices.transpose(0, 2, 1).copy()
        self.spaces.to_unknowns(transposed, np.arange(len(matrices), dtype=np.int32))
        return self.sum_of([(self._dofs, transposed.transpose(0, 2, 1))])

    def fields(self, parts: Iterable[tuple[Eliminated[Cells], Array, Array]]) -> tuple[Array, Array]:
        """σ at the nodes and u at the vertices of the cells, shapes (cells, nodes, d) and (cells, d + 1)."""
        count, dim = len(self.spaces.order), self.spaces.dim
        sigma, u = np.empty((count, len(reference(dim).at_nodes), dim)), np.empty((count, dim + 1))
        for block, of_flux, of_u in parts:
            sigma[block.cells.numbers] = block.cells.at_nodes(of_flux)
            u[block.cells.numbers] = of_u
        return sigma, u

    def through(self, sigma: Array) -> Array:
        """See `HybridSystem.through`."""
        spaces = self.spaces
        through = np.einsum("nsaj,nsj->nsa", sigma[:, opposite(spaces.dim)], facet_normals(spaces.vertices))
        return np.asarray(through[:, :, :, None])
