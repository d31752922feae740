"""The facet system of elasticity: one SPD problem for the traces, and the stresses recovered from them.

See `forms/elasticity.py` for what is eliminated on each cell.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from hashlib import blake2b

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.hybrid_system import Eliminated, HybridSystem, eliminate
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells, facet_normals
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import (
    Cells,
    compliance_product,
    reference,
    to_entries,
    to_matrices,
)
from signorini_fenicsx.physics.elasticity.discrete.material import mean_compliances
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.discrete.supports import Supports
from signorini_fenicsx.physics.elasticity.solve.mean_pressure import BULK, MeansOfCells


class ElasticSystem(HybridSystem):
    """The elastic facet system, assembled once.

    Attributes:
        spaces: The spaces.
        element: The reference element.
        loaded: Whether there are loads, or strains and stresses that the body has without them.
        mean: The mean pressures of cells where the body is incompressible; None where it is not.
    """

    mean: MeansOfCells | None = None

    def __init__(self, spaces: ElasticSpaces, data: ElasticData):
        """Eliminate and assemble (collective)."""
        self.spaces, self.element = spaces, reference(spaces.dim)
        self._take(data)
        super().__init__(spaces.traces, spaces.dofs, spaces.sides)
        if data.material.incompressible:
            softness = [_softness(data.compliances(spaces, cells)) for cells in blocks_of_cells(spaces.mesh)]
            self.mean = MeansOfCells.of_traces(spaces, np.concatenate(softness), Cells(spaces.vertices).measure)
        self._take_loads()

    def _take(self, data: ElasticData) -> None:
        """Take data, with digests of what the solver, but for laws, and of what the loads of cells have of them."""
        self._data, self._digests = data, (blake2b(data.supports.masses.tobytes() + data.fixed.tobytes()), blake2b())

    def renew(self, data: ElasticData) -> bool:
        """Go on with other data; False if these have another matrix (collective)."""
        before = self._digests
        self._take(data)
        for cells in self.spaces.blocks():
            self._of_cells(cells)
        same = np.array([one.digest() == other.digest() for one, other in zip(before, self._digests, strict=True)])
        self.spaces.mesh.comm.Allreduce(MPI.IN_PLACE, same, MPI.LAND)
        if same[0] and not same[1]:
            self._take(data)
            self.eliminate_again()
        if same[0]:
            self._take_loads()
        return bool(same[0])

    def _take_loads(self) -> None:
        """Find the right side (collective)."""
        spaces, data = self.spaces, self._data
        owned = self._size * self._numbers.size_local
        self.tractions = data.load[:owned]
        walls, lift = data.supports.facets.blocks[data.supports.walls(spaces)[0]], data.lift[:owned]
        moving = np.zeros((owned // self._size, self._size))
        moving[walls] = lift.reshape(moving.shape)[
            walls
        ]  # the springs of walls with slip pull on what is faster than these
        self.load = self.load_of(self._blocks, data.lift) + self.tractions + self.of_supports(moving.ravel())
        if self.mean is not None:
            self.load -= self.pulls_of_means(self.mean.values)
            self.mean.grown = np.concatenate([data.growth(spaces, cells) for cells in spaces.blocks()])
        given = any(values.any() for values in (self.tractions, *(block.flux_of_f for block in self._blocks)))
        self.loaded: bool = spaces.mesh.comm.allreduce(given, MPI.LOR)

    def _of_cells(self, cells: Cells) -> tuple[Array, Array, Array | None]:
        """The compliances of cells, their moments of f and those of strains, if any (collective)."""
        spaces, data, (of_matrix, of_loads) = self.spaces, self._data, self._digests
        compliances, of_f = data.compliances(spaces, cells.numbers), data.moments_of_f(spaces, cells)
        strains = data.strains(spaces, cells) if data.material.strains else None
        of_matrix.update(compliances.tobytes())
        for loads in (of_f, of_f[:0] if strains is None else strains):
            of_loads.update(loads.tobytes())
        return compliances, of_f, strains

    def pulls_of_means(self, means: Array) -> Array:
        """⟨mn, q⟩ summed over the cells for each owned unknown (collective)."""
        assert self.mean is not None
        return self.gathered(self.mean.pulls(means))

    def means(self, x: Array, wanted: Array) -> tuple[Array, float]:
        """What all unknowns of this rank add to the mean pressures, see `MeansOfCells.of` (collective)."""
        assert self.mean is not None
        cells = np.arange(len(self.spaces.order), dtype=np.int32)
        return self.mean.of(self.sides.values(x)[self._unknowns(cells)], wanted)

    def take_means(self, means: Array, pulls: Array) -> None:
        """Take means of pressures as given besides, with what they take from the right side."""
        assert self.mean is not None
        self.mean.values += means
        self.load = self.load - pulls

    def respond(self, *loads: Array, solve: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
        """σ, u and x as `HybridSystem.respond` gives them, with the mean pressures of the response (collective)."""
        if self.mean is None:
            return super().respond(*loads, solve=solve)
        self.mean.wanted = -np.einsum("nsaii->n", loads[0])
        sigma, u, x = super().respond(*loads, solve=solve)
        sigma += self.mean.of_response[:, None, None, None, None] * np.eye(self.spaces.dim)
        self.mean.wanted = np.zeros_like(self.mean.wanted)
        return sigma, u, x

    def recover(
        self, x: Array, *, with_f: bool = True, blocks: Sequence[Eliminated[Cells]] | None = None
    ) -> tuple[Array, Array]:
        """σ and u as `HybridSystem.recover` gives them, with the mean pressures that are given."""
        sigma, u = super().recover(x, with_f=with_f, blocks=blocks)
        if with_f and blocks is None and self.mean is not None:
            sigma += self.mean.values[:, None, None, None, None] * np.eye(self.spaces.dim)
        return sigma, u

    def eliminated(self, stresses: Array | None = None, moments: Array | None = None) -> Iterator[Eliminated[Cells]]:
        """The cells after elimination, with the data or another right side (collective).

        Args:
            stresses: A functional of the stress: its values for unit entries of the stress at each vertex of each
                subcell, shape (cells, d + 1, d + 1, d, d).
            moments: (f, φ_v) of each cell, shape (cells, d + 1, d).
        """
        spaces, data = self.spaces, self._data
        for cells in spaces.blocks():
            numbers = cells.numbers
            if stresses is None or moments is None:
                compliances, of_f, strains = self._of_cells(cells)
            else:
                compliances, of_f, strains = data.compliances(spaces, numbers), moments[numbers], None
            masses = data.masses(spaces, cells, compliances)
            if len(numbers) == 0:  # other ranks have more cells
                continue
            basis = cells.stresses(self.element.stresses)
            functional: Array | float = 0.0
            given = -strains if strains is not None else to_entries(stresses[numbers]) if stresses is not None else None
            if given is not None:
                functional = np.einsum("nve,nveb->nb", given.reshape(basis.shape[:3]), basis)
            product = compliance_product(basis, masses)
            if data.material.incompressible:
                traces = basis[:, :, : spaces.dim].sum(axis=2).mean(axis=1)
                weight = _softness(compliances) * cells.measure / (spaces.dim**2 * BULK)
                product += (weight[:, None] * traces)[:, :, None] * traces[:, None]
            tractions = cells.tractions(self.element.tractions)
            spaces.to_unknowns(tractions, numbers)
            balance = -np.linalg.solve(cells.derivative, of_f.transpose(0, 2, 1)).transpose(0, 2, 1)
            balance = balance.reshape(len(numbers), -1)
            eliminated = eliminate(cells, tractions, product, balance, functional)
            _add_supports(eliminated.matrix, data.supports, numbers)
            yield eliminated

    def fields(self, parts: Iterable[tuple[Eliminated[Cells], Array, Array]]) -> tuple[Array, Array]:
        """σ at the vertices of the subcells and u at those of the cells.

        Shapes (cells, d + 1, d + 1, d, d) and (cells, d + 1, d), with the vertices as in `ElasticSpaces.order`.
        """
        count, dim = len(self.spaces.order), self.spaces.dim
        sigma, u = np.empty((count, dim + 1, dim + 1, dim, dim)), np.empty((count, dim + 1, dim))
        for block, of_stress, of_u in parts:
            cells = block.cells
            on_reference = np.tensordot(of_stress, self.element.stresses, (1, 2))
            mapped = to_matrices(on_reference @ cells.mapped.swapaxes(1, 2))
            sigma[cells.numbers] = mapped.reshape(-1, dim + 1, dim + 1, dim, dim)
            pulled = of_u.reshape(-1, dim + 1, dim).transpose(0, 2, 1)
            u[cells.numbers] = np.linalg.solve(cells.derivative.transpose(0, 2, 1), pulled).transpose(0, 2, 1)
        return sigma, u

    def of_supports(self, x: Array) -> Array:
        """⟨Kû, q⟩ over the supports for each owned unknown, from the owned unknowns x."""
        supports, forces = self._data.supports, np.zeros((len(x) // self.spaces.dim**2, self.spaces.dim**2))
        blocks = supports.facets.blocks
        forces[blocks] = np.einsum("nij,nj->ni", supports.masses, x.reshape(forces.shape)[blocks])
        return forces.ravel()

    def through(self, sigma: Array) -> Array:
        """See `HybridSystem.through`."""
        spaces = self.spaces
        return np.einsum("nsaij,nsj->nsai", sigma[:, :, : spaces.dim], facet_normals(spaces.vertices))


def _softness(compliances: Array) -> Array:
    """The mean of 1/2μ on cells with these 𝔸 in points."""
    return np.asarray(mean_compliances(compliances)[0].mean(axis=1))


def _add_supports(matrices: Array, supports: Supports, numbers: npt.NDArray[np.int32]) -> None:
    """Add the stiffness of supports to the matrices of these cells."""
    facets, size = supports.facets, supports.stiffness.shape[1] ** 2
    common = np.flatnonzero(np.isin(facets.cells, numbers))
    rows = facets.local[common, None] * size + np.arange(size)
    cells = (facets.cells[common] - numbers[0])[:, None, None]
    np.add.at(matrices, (cells, rows[:, :, None], rows[:, None]), supports.masses[common])
