"""The facet system of elasticity: one SPD problem for the traces, and the stresses recovered from them.

See `forms/elasticity.py` for what is eliminated on each cell.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import la
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import sums_at
from signorini_fenicsx.discrete.matrices import identity_with, of_cells
from signorini_fenicsx.physics.elasticity.data import ElasticData, blocks_of_cells
from signorini_fenicsx.physics.elasticity.johnson_mercier import (
    Cells,
    Reference,
    compliance_product,
    facet_normals,
    reference,
    to_entries,
    to_matrices,
)
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.supports import Supports


@dataclass(frozen=True)
class Eliminated:
    """Some cells after elimination. x are the unknowns of a cell's facets, and the way back is affine in them.

    Attributes:
        cells: Which cells.
        geometry: Their vertices.
        matrix: Shape (cells, n, n).
        load: What f adds to the right side, shape (cells, n).
        stress: Coefficients of the stress for each unknown, shape (cells, basis, n).
        stress_of_f: Those without x, shape (cells, basis).
        displacement: Fᵀu at the vertices for each unknown, shape (cells, (d + 1) d, n).
        displacement_of_f: That without x, shape (cells, (d + 1) d).
    """

    cells: npt.NDArray[np.int32]
    geometry: Cells
    matrix: Array
    load: Array
    stress: Array
    stress_of_f: Array
    displacement: Array
    displacement_of_f: Array


def eliminate(
    element: Reference,
    cells: Cells,
    tractions: Array,
    product: Array,
    moments: Array,
    numbers: npt.NDArray[np.int32],
    functional: Array | float = 0.0,
) -> Eliminated:
    """Eliminate all but the traces.

    Args:
        element: The reference element.
        cells: The cells.
        tractions: ⟨q, τn⟩ of each stress of the basis for each unknown of the traces, shape (cells, n, basis).
        product: (𝔸τ, τ'), shape (cells, basis, basis).
        moments: (f, φ_v), shape (cells, d + 1, d).
        numbers: The numbers of the cells.
        functional: A right side of the first equation: its values at the stresses of the basis, shape (cells, basis).
    """
    functional = np.broadcast_to(functional, product.shape[:2])
    free, count = element.free, len(cells.vertices)
    balance = -np.linalg.solve(cells.derivative, moments.transpose(0, 2, 1)).transpose(0, 2, 1).reshape(count, -1)
    of_free, of_rest = tractions[:, :, :free], tractions[:, :, free:]
    coupled = product[:, free:, :free]
    reduced = functional[:, :free] - np.einsum("nmf,nm->nf", coupled, balance)
    right = np.concatenate([of_free.transpose(0, 2, 1), reduced[:, :, None]], axis=2)
    multipliers = np.linalg.solve(product[:, :free, :free], right)
    stress, stress_of_f = multipliers[:, :, :-1], multipliers[:, :, -1]
    matrix = of_free @ stress
    load = -np.einsum("nib,nb->ni", of_free, stress_of_f) - np.einsum("nib,nb->ni", of_rest, balance)
    displacement_of_f = functional[:, free:] - np.einsum("nmf,nf->nm", coupled, stress_of_f)
    displacement_of_f -= np.einsum("nml,nl->nm", product[:, free:, free:], balance)
    rest = np.zeros((count, balance.shape[1], stress.shape[2]))
    return Eliminated(
        cells=numbers,
        geometry=cells,
        matrix=(matrix + matrix.transpose(0, 2, 1)) / 2,
        load=load,
        stress=np.concatenate([stress, rest], axis=1),
        stress_of_f=np.concatenate([stress_of_f, balance], axis=1),
        displacement=of_rest.transpose(0, 2, 1) - coupled @ stress,
        displacement_of_f=displacement_of_f,
    )


class ElasticSystem:
    """The elastic facet system, assembled once.

    Attributes:
        spaces: The spaces.
        matrix: Without conditions.
        load: Right side for x − lift.
        tractions: ⟨g_N, q⟩ for each owned unknown.
        element: The reference element.
        loaded: Whether there are loads, or strains and stresses that the body has without them.
    """

    def __init__(self, spaces: ElasticSpaces, data: ElasticData):
        """Eliminate and assemble (collective)."""
        self.spaces, self._data = spaces, data
        self.element = reference(spaces.dim)
        self._blocks = list(self._eliminated())
        jumps = jumps_to_sides(spaces)
        self.matrix = self._assembled() if jumps is None else self._assembled().ptap(jumps)
        index_map, size = spaces.traces.dofmap.index_map, spaces.traces.dofmap.index_map_bs
        self.tractions = data.load[: size * index_map.size_local]
        self.load = self._load_of(self._blocks, data.lift) + self.tractions
        given = any(values.any() for values in (self.tractions, *(block.stress_of_f for block in self._blocks)))
        self.loaded: bool = spaces.mesh.comm.allreduce(given, MPI.LOR)

    def _load_of(self, blocks: Sequence[Eliminated], lift: Array) -> Array:
        """The right side for x − lift, without given tractions: owned entries (collective)."""
        index_map, size = self.spaces.traces.dofmap.index_map, self.spaces.traces.dofmap.index_map_bs
        load, lift = la.vector(index_map, size), self._on_sides(lift)
        for block in blocks:
            unknowns = self._unknowns(block.cells)
            of_cells = block.load - np.einsum("nij,nj->ni", block.matrix, lift[unknowns])
            load.array[:] += np.bincount(unknowns.ravel(), of_cells.ravel(), len(load.array))
        load.scatter_reverse(la.InsertMode.add)
        return self._of_jumps(load.array[: size * index_map.size_local])

    def respond(self, stresses: Array, moments: Array, solve: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
        """Solve with any right side (collective).

        Args:
            stresses: A functional of the stress: its values for unit entries of the stress at each vertex of each
                subcell, shape (cells, d + 1, d + 1, d, d).
            moments: (f, φ_v) of each cell, shape (cells, d + 1, d).
            solve: Gives x, ghosts too, from the right side for the owned unknowns, without given tractions.

        Returns:
            σ and u as `recover` gives them, and x.
        """
        blocks = list(self._eliminated(stresses, moments))
        x = solve(self._load_of(blocks, np.zeros_like(self._data.lift)))
        return *self.recover(x, blocks=blocks), x

    def _eliminated(self, stresses: Array | None = None, moments: Array | None = None) -> Iterator[Eliminated]:
        """The cells after elimination, with the data or another right side, see `respond` (collective)."""
        spaces, data = self.spaces, self._data
        framed = [(facets.cells, facets.local, matrices) for facets, matrices in spaces.frames]
        for numbers in blocks_of_cells(spaces):
            cells = Cells(spaces.vertices[numbers])
            of_f = data.moments_of_f(spaces, numbers, cells.measure) if moments is None else moments[numbers]
            masses = data.masses(spaces, numbers, cells.measure)
            own = data.strains(spaces, numbers, cells.measure) if stresses is None and data.material.own else None
            if len(numbers) == 0:  # other ranks have more cells
                continue
            basis = cells.stresses(self.element.stresses)
            functional: Array | float = 0.0
            given = -own if own is not None else to_entries(stresses[numbers]) if stresses is not None else None
            if given is not None:
                functional = np.einsum("nve,nveb->nb", given.reshape(basis.shape[:3]), basis)
            product = compliance_product(basis, masses)
            tractions = cells.tractions(self.element.tractions)
            for facets, local, matrices in framed:
                mine = np.flatnonzero(np.isin(facets, numbers))
                transform(tractions, facets[mine] - numbers[0], local[mine], matrices[mine])
            eliminated = eliminate(self.element, cells, tractions, product, of_f, numbers, functional)
            _add_supports(eliminated.matrix, data.supports, numbers)
            yield eliminated

    def _unknowns(self, cells: npt.NDArray[np.int32]) -> Indices:
        """Unknowns of the facets of cells, shape (cells, (d + 1) d²)."""
        size = self.spaces.dim**2
        blocks = self.spaces.dofs[cells].astype(np.int64)
        return (blocks[:, :, None] * size + np.arange(size)).reshape(len(cells), -1)

    def _on_sides(self, x: Array) -> Array:
        """Traces on both sides of facets inside the domain, from the jumps and those of the other side."""
        named, across = self.spaces.sides
        on_sides = x.copy()
        on_sides[named] += x[across]
        return on_sides

    def _of_jumps(self, forces: Array) -> Array:
        """The forces on the jumps and on the traces of the other side, from those on both sides."""
        named, across = self.spaces.sides
        of_jumps = forces.copy()
        of_jumps[across] += forces[named]
        return of_jumps

    def _assembled(self) -> PETSc.Mat:
        dofs, dofmap = self.spaces.dofs, self.spaces.traces.dofmap
        parts = ((dofs[block.cells], block.matrix) for block in self._blocks)
        return of_cells(self.spaces.mesh.comm, dofmap.index_map, dofmap.index_map_bs, *parts)

    def recover(
        self, x: Array, *, with_f: bool = True, blocks: Sequence[Eliminated] | None = None
    ) -> tuple[Array, Array]:
        """σ at the vertices of the subcells and u at those of the cells, from all unknowns of this rank.

        Args:
            x: The unknowns, ghosts too.
            with_f: Whether σ balances f; without it x is a correction.
            blocks: Cells after elimination with another right side; None for that of the data.

        Returns:
            Shapes (cells, d + 1, d + 1, d, d) and (cells, d + 1, d), with the vertices as in `ElasticSpaces.order`.
        """
        spaces, dim, x = self.spaces, self.spaces.dim, self._on_sides(x)
        sigma = np.empty((len(spaces.order), dim + 1, dim + 1, dim, dim))
        u = np.empty((len(spaces.order), dim + 1, dim))
        for block in self._blocks if blocks is None else blocks:
            unknowns, cells = x[self._unknowns(block.cells)], block.geometry
            coefficients = np.einsum("nbi,ni->nb", block.stress, unknowns) + with_f * block.stress_of_f
            on_reference = np.tensordot(coefficients, self.element.stresses, (1, 2))
            mapped = to_matrices(on_reference @ cells.mapped.swapaxes(1, 2))
            sigma[block.cells] = mapped.reshape(-1, dim + 1, dim + 1, dim, dim)
            pulled = np.einsum("nmi,ni->nm", block.displacement, unknowns) + with_f * block.displacement_of_f
            u[block.cells] = np.linalg.solve(
                cells.derivative.transpose(0, 2, 1), pulled.reshape(-1, dim + 1, dim).transpose(0, 2, 1)
            ).transpose(0, 2, 1)
        return sigma, u

    def everywhere(self, owned: Array) -> Array:
        """Unknowns of this rank, ghosts too, from the owned ones (collective)."""
        x = la.vector(self.spaces.traces.dofmap.index_map, self.spaces.dim**2)
        x.array[: len(owned)] = owned
        x.scatter_forward()
        return np.asarray(x.array)

    def of_supports(self, x: Array) -> Array:
        """⟨Kû, q⟩ over the supports for each owned unknown, from the owned unknowns x."""
        supports, forces = self._data.supports, np.zeros((len(x) // self.spaces.dim**2, self.spaces.dim**2))
        blocks = supports.facets.blocks
        forces[blocks] = np.einsum("nij,nj->ni", supports.masses, x.reshape(forces.shape)[blocks])
        return forces.ravel()

    def forces(self, stresses: Array) -> Array:
        """⟨σn, q⟩ summed over the cells for each owned unknown, from values as `recover` gives them (collective)."""
        spaces, dim = self.spaces, self.spaces.dim
        mass = (1 + np.eye(dim)) / (dim * (dim + 1))
        pulls = np.einsum("nsaij,nsj->nsai", stresses[:, :, :dim], facet_normals(spaces.vertices))
        by_block = sums_at(spaces.traces.dofmap.index_map, spaces.dofs, mass @ pulls).reshape(-1, dim**2)
        for facets, matrices in spaces.frames:
            by_block[facets.blocks] = np.einsum("nij,ni->nj", matrices, by_block[facets.blocks])
        return self._of_jumps(by_block.ravel()[: len(self.load)])


def jumps_to_sides(spaces: ElasticSpaces, *, back: bool = False) -> PETSc.Mat | None:
    """The matrix from (jump, û⁻) to (û⁺, û⁻) on facets inside the domain, or its inverse (collective).

    None without such facets.

    Args:
        spaces: The spaces.
        back: Whether it is the inverse.
    """
    if not spaces.inner.present:
        return None
    numbers, size = spaces.traces.dofmap.index_map, spaces.dim**2
    named, across = (size * numbers.local_range[0] + each for each in spaces.sides)
    values = np.full(len(named), -1.0 if back else 1.0)
    return identity_with(spaces.mesh.comm, size * numbers.size_local, named, across, values, block=size)


def _add_supports(matrices: Array, supports: Supports, numbers: npt.NDArray[np.int32]) -> None:
    """Add the stiffness of supports to the matrices of these cells."""
    facets, size = supports.facets, supports.stiffness.shape[1] ** 2
    mine = np.flatnonzero(np.isin(facets.cells, numbers))
    rows = facets.local[mine, None] * size + np.arange(size)
    cells = (facets.cells[mine] - numbers[0])[:, None, None]
    np.add.at(matrices, (cells, rows[:, :, None], rows[:, None]), supports.masses[mine])


def transform(tractions: Array, cells: Indices, local: Indices, matrices: Array) -> None:
    """Let tractions be those of the unknowns of a frame on some facets."""
    size = matrices.shape[1]
    rows = local[:, None] * size + np.arange(size)
    tractions[cells[:, None], rows] = matrices.transpose(0, 2, 1) @ tractions[cells[:, None], rows]
