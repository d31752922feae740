"""A hybrid system of any element: all but the traces is eliminated on the cells, and recovered from them.

On a cell (κ⁻¹σ, τ) + (u, ∇·τ) = ⟨û, τn⟩ and −(∇·σ, v) + (cu, v) = (f, v) for the fluxes and the u of the element; of a
body σ is the stress and κ⁻¹ the compliance. The basis of the fluxes begins with those of divergence 0. Each of the
others has one moment of ∇· against the functions of u, which is 1, so that f gives its coefficient. What is left is a
problem for û alone that is symmetric and positive semidefinite.

`HybridSystem` has three verbs: it *eliminates*, it *recovers* σ and u from û, and it *responds* to any right side. A
physics says what its cells are (`eliminated`) and what coefficients stand for (`fields`).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import sums_at, with_ghosts
from signorini_fenicsx.discrete.matrices import OfCells, identity_with, of_cells
from signorini_fenicsx.linear.constrained_matrix import image_of


class Sides:
    """Facets whose unknowns are jumps: û less a mean of û on facets that are opposite.

    The unknowns x of such facets, and those of the opposite ones, stand for û = x + Px, where P has rows of the former
    and columns of the latter. On parts inside the domain P is a copy: x is û⁺ − û⁻ and û⁻. Of two surfaces that share
    no nodes its entries are means over the pieces of their overlay. The equation of the jump is that of û before, which
    says what σn is, and the equation of û on the other side says that it takes this σn. So a law between the jump and
    σn is imposed like one between û and σn on the boundary, and the matrix stays positive definite. As P² = 0, the
    way back is x = û − Pû.

    Attributes:
        basis: I + P; None without such facets.
    """

    def __init__(self, traces: fem.FunctionSpace, entries: tuple[Indices, Indices, Array], *, present: bool):
        """Make the matrix (collective).

        Args:
            traces: A block of unknowns per facet.
            entries: Rows, as owned unknowns of this rank; columns, as unknowns over all ranks; and values of P.
            present: Whether there are any on some rank.
        """
        self._traces, self._entries = traces, entries
        self._owned = traces.dofmap.index_map_bs * traces.dofmap.index_map.size_local
        self.basis = self._identity_with(entries[2]) if present else None

    def values(self, x: Array) -> Array:
        """û from the unknowns x of this rank, ghosts too, which are no jumps (collective)."""
        return x if self.basis is None else np.append(image_of(self.basis, x[: self._owned]), x[self._owned :])

    def forces(self, forces: Array) -> Array:
        """The forces on the owned unknowns x, from those on û (collective)."""
        return forces if self.basis is None else image_of(self.basis, forces, transposed=True)

    def of_unknowns(self, matrix: PETSc.Mat) -> PETSc.Mat:
        """A matrix for the unknowns x, from one for û (collective)."""
        return matrix if self.basis is None else matrix.ptap(self.basis)

    def unknowns(self, traces: Array) -> Array:
        """The owned unknowns x from û there (collective)."""
        if (inverse := self.inverse()) is None:
            return traces
        x = image_of(inverse, traces)
        inverse.destroy()
        return x

    def inverse(self) -> PETSc.Mat | None:
        """I − P, the inverse of `basis`; None without such facets (collective)."""
        return None if self.basis is None else self._identity_with(-self._entries[2])

    def _identity_with(self, values: Array) -> PETSc.Mat:
        numbers, size = self._traces.dofmap.index_map, self._traces.dofmap.index_map_bs
        rows, columns, _ = self._entries
        rows = size * numbers.local_range[0] + rows
        return identity_with(self._traces.mesh.comm, self._owned, rows, columns, values, block=size)


def copies(
    traces: fem.FunctionSpace, named: npt.NDArray[np.integer], across: npt.NDArray[np.integer]
) -> tuple[Indices, Indices, Array]:
    """The entries of P where the other side has the same facets, from the owned unknowns of both, see `Sides`."""
    first = traces.dofmap.index_map_bs * traces.dofmap.index_map.local_range[0]
    return named.astype(np.int64), first + across.astype(np.int64), np.ones(len(named))


@dataclass(frozen=True)
class Eliminated[Cells]:
    """Some cells after elimination. x are the unknowns of a cell's facets, and the way back is affine in them.

    Attributes:
        cells: The cells, of the class that the element has.
        matrix: Shape (cells, n, n); `kept` cells have none, as it is assembled.
        load: What f adds to the right side, shape (cells, n).
        flux: Coefficients of σ for each unknown, shape (cells, basis, n), or of the fluxes of divergence 0 alone, where
            the others have none.
        flux_of_f: Those without x, shape (cells, basis).
        u: Coefficients of u for each unknown, one for each flux that is not of divergence 0, shape (cells, m, n).
        u_of_f: Those without x, shape (cells, m).
    """

    cells: Cells
    matrix: Array
    load: Array
    flux: Array
    flux_of_f: Array
    u: Array
    u_of_f: Array

    def kept(self) -> "Eliminated[Cells]":
        """What it takes to recover, without the matrix."""
        return replace(self, matrix=np.empty(0))


def eliminate[Cells](
    cells: Cells,
    tractions: Array,
    product: Array,
    balance: Array,
    functional: Array | float = 0.0,
    reaction: Array | None = None,
    held: tuple[Mask, Array] | None = None,
) -> Eliminated[Cells]:
    """Eliminate all but the traces.

    Args:
        cells: The cells, of the class that the element has.
        tractions: ⟨q, τn⟩ of each flux of the basis for each unknown q of the traces, shape (cells, n, basis).
        product: (κ⁻¹τ, τ'), shape (cells, basis, basis).
        balance: The coefficients that f gives, those of the last fluxes of the basis, shape (cells, m).
        functional: A right side of the first equation: its values at the fluxes of the basis, shape (cells, basis).
        reaction: (cv, v') for the functions of u, which f does not carry, shape (cells, m, m); None for 0.
        held: Mask of coefficients of u that are given, and their values, 0 elsewhere, shape (cells, m) each, if there
            is a reaction. There the flux takes what it takes, and `balance` does not count.
    """
    if reaction is not None:
        none = np.zeros(balance.shape)
        without = eliminate(cells, tractions, product, none, functional)
        return _with_reaction(without, product, balance, reaction, *(held or (none > 0, none)))
    functional = np.broadcast_to(functional, product.shape[:2])
    free = product.shape[1] - balance.shape[1]
    of_free, of_rest = tractions[:, :, :free], tractions[:, :, free:]
    coupled = product[:, free:, :free]
    reduced = functional[:, :free] - np.einsum("nmf,nm->nf", coupled, balance)
    right = np.concatenate([of_free.transpose(0, 2, 1), reduced[:, :, None]], axis=2)
    solved = np.linalg.solve(product[:, :free, :free], right)
    flux, flux_of_f = solved[:, :, :-1], solved[:, :, -1]
    matrix = of_free @ flux
    u_of_f = functional[:, free:] - np.einsum("nmf,nf->nm", coupled, flux_of_f)
    u_of_f -= np.einsum("nml,nl->nm", product[:, free:, free:], balance)
    return Eliminated(
        cells=cells,
        matrix=(matrix + matrix.transpose(0, 2, 1)) / 2,
        load=-np.einsum("nib,nb->ni", of_free, flux_of_f) - np.einsum("nib,nb->ni", of_rest, balance),
        flux=flux,
        flux_of_f=np.concatenate([flux_of_f, balance], axis=1),
        u=of_rest.transpose(0, 2, 1) - coupled @ flux,
        u_of_f=u_of_f,
    )


def responses(product: Array, number: int) -> tuple[Array, Array]:
    """What units of the last fluxes of the basis, of this number, bring where û is 0.

    Returns:
        The coefficients of the fluxes of divergence 0, shape (cells, free, m), and S, where u = −S times the units.
    """
    free = product.shape[1] - number
    coupled = product[:, free:, :free]
    by_unit = -np.linalg.solve(product[:, :free, :free], coupled.transpose(0, 2, 1))
    return by_unit, product[:, free:, free:] + coupled @ by_unit


def _with_reaction[Cells](
    without: Eliminated[Cells], product: Array, balance: Array, reaction: Array, held: Mask, values: Array
) -> Eliminated[Cells]:
    """`eliminate` with −(∇·σ, v) + (cu, v) = (f, v), from the same without f and c.

    The coefficients that ∇·σ gives depend on u.
    Without c they are b, and u = u_x x + u_0 − Sb with S from the fluxes that b brings. With c they are b + Cu, so that
    u = (I + SC)⁻¹ (u_x x + u_0 − Sb), and they are (I + CS)⁻¹ (b + C(u_x x + u_0)): where S is large b + Cu would lose
    digits. Where u is held they take the place of u among the unknowns z, with I for C.
    """
    free_u, right = ~held, np.where(held, 0.0, balance + np.einsum("nml,nl->nm", reaction, values))
    reaction = np.where(free_u[:, :, None] & free_u[:, None], reaction, held[:, :, None] * np.eye(held.shape[1]))
    units, (by_unit, compliance) = np.eye(balance.shape[1]), responses(product, balance.shape[1])
    of_flux = np.concatenate([by_unit, np.broadcast_to(units, (len(balance), *units.shape))], axis=1)
    moved = np.linalg.inv(free_u[:, :, None] * units + compliance @ reaction)
    z, off = moved @ without.u, without.u_of_f - values
    z_of_f = np.einsum("nml,nl->nm", moved, off - np.einsum("nml,nl->nm", compliance, right))
    given = np.einsum("nlm,nl->nm", moved, right + np.einsum("nml,nl->nm", reaction, off))
    by_x = moved.transpose(0, 2, 1) @ reaction @ without.u
    matrix = without.matrix + without.u.transpose(0, 2, 1) @ by_x
    return replace(
        without,
        matrix=(matrix + matrix.transpose(0, 2, 1)) / 2,
        load=without.load - np.einsum("nmi,nm->ni", without.u, given),
        flux=np.pad(without.flux, ((0, 0), (0, units.shape[0]), (0, 0))) + of_flux @ by_x,
        flux_of_f=without.flux_of_f + np.einsum("nbm,nm->nb", of_flux, given),
        u=free_u[:, :, None] * z,
        u_of_f=np.where(held, values, z_of_f),
    )


class TraceSystem(ABC):
    """A system for the traces, assembled once. On facets inside the domain its unknowns are jumps, see `Sides`.

    Attributes:
        matrix: Without conditions.
        load: Right side for x − lift, of each owned unknown.
        sides: The unknowns on facets inside the domain.
    """

    load: Array

    def __init__(self, traces: fem.FunctionSpace, dofs: npt.NDArray[np.int32], sides: Sides):
        """Eliminate and assemble (collective).

        Args:
            traces: A block of unknowns per facet.
            dofs: The blocks of each owned cell, shape (cells, d + 1).
            sides: Its unknowns on facets inside the domain.
        """
        self._traces, self._dofs, self.sides = traces, dofs, sides
        self._numbers, self._size = traces.dofmap.index_map, traces.dofmap.index_map_bs
        self.matrix = self._assembled()

    @abstractmethod
    def _assembled(self) -> PETSc.Mat:
        """Eliminate, and assemble the matrix (collective)."""

    @property
    @abstractmethod
    def lift(self) -> Array:
        """The values of û that are given, ghosts too."""

    @abstractmethod
    def recover(self, x: Array) -> tuple[Array, Array]:
        """σ and u, from all unknowns of this rank, ghosts too, and the lift (collective)."""

    @abstractmethod
    def renew(self, data: Any) -> bool:
        """Go on with other data; whether the matrix stays, without which a `HybridSystem` cannot (collective)."""

    def sum_of(self, parts: Iterable[OfCells]) -> PETSc.Mat:
        """The sum of matrices of cells, for the unknowns (collective)."""
        return self.sides.of_unknowns(of_cells(self._traces.mesh.comm, self._numbers, self._size, [self._dofs], parts))

    def gathered(self, of_cells: Array) -> Array:
        """Numbers for the unknowns û of each owned cell, added up for the owned unknowns x (collective)."""
        sums = sums_at(self._numbers, self._dofs, of_cells.reshape(*self._dofs.shape, self._size))
        return self.sides.forces(sums.ravel()[: self._size * self._numbers.size_local])

    def everywhere(self, owned: Array) -> Array:
        """Unknowns of this rank, ghosts too, from the owned ones (collective)."""
        return with_ghosts(self._numbers, owned.reshape(-1, self._size)).ravel()

    def with_lift(self, x: PETSc.Vec) -> Array:
        """The unknowns of this rank and the lift, ghosts too (collective)."""
        return self.everywhere(x.array_r) + self.lift


class HybridSystem(TraceSystem):
    """A system for the traces of an element of order two, whose cells are eliminated block by block.

    Attributes:
        spaces: The spaces, which are `LinearTraces`.
        tractions: The part of the right side that is given on facets.
    """

    spaces: Any
    tractions: Array
    _data: Any

    @property
    def lift(self) -> Array:
        """See `TraceSystem.lift`."""
        return np.asarray(self._data.lift)

    def _assembled(self) -> PETSc.Mat:
        """Eliminate, and assemble the matrix (collective)."""
        self._blocks = list[Eliminated[Any]]()
        return self.sum_of(self._parts())

    def assemble_again(self) -> None:
        """Eliminate and assemble with other cells of the same facets; the matrix gets other entries (collective)."""
        matrix = self._assembled()
        matrix.copy(self.matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        matrix.destroy()

    def _parts(self) -> Iterator[OfCells]:
        """The matrices of the cells, block by block, of which the rest is kept (collective)."""
        for block in self.eliminated():
            self._blocks.append(block.kept())
            yield self._dofs[block.cells.numbers], block.matrix

    @abstractmethod
    def eliminated(self, *loads: Any) -> Iterator[Eliminated[Any]]:
        """The cells after elimination, with the data or other right sides, see `respond` (collective)."""

    @abstractmethod
    def fields(self, parts: Iterable[tuple[Eliminated[Any], Array, Array]]) -> tuple[Array, Array]:
        """σ and u of all cells from their coefficients, block by block."""

    @abstractmethod
    def through(self, sigma: Array) -> Array:
        """|e| σn from each owned cell, as `LinearTraces.forces` takes it, from σ as `recover` gives it."""

    def forces(self, sigma: Array) -> Array:
        """⟨σn, q⟩ summed over the cells for each owned unknown q, from σ as `recover` gives it (collective)."""
        return np.asarray(self.spaces.forces(self.through(sigma)))

    def eliminate_again(self) -> None:
        """Eliminate with other data and the same matrix (collective)."""
        self._blocks = []  # both would take twice the memory
        self._blocks = [block.kept() for block in self.eliminated()]

    def load_of(self, blocks: Sequence[Eliminated[Any]], lift: Array | None = None) -> Array:
        """The right side for x − lift, without given fluxes: owned entries (collective)."""
        of_cells = np.zeros((len(self._dofs), self._dofs.shape[1] * self._size))
        for block in blocks:
            of_cells[block.cells.numbers] = block.load
        forces = self.gathered(of_cells)
        return forces if lift is None else forces - image_of(self.matrix, lift[: len(forces)])

    def recover(
        self, x: Array, *, with_f: bool = True, blocks: Sequence[Eliminated[Any]] | None = None
    ) -> tuple[Array, Array]:
        """σ and u as `fields` gives them, from all unknowns of this rank.

        Args:
            x: The unknowns, ghosts too.
            with_f: Whether σ balances f; without it x is a correction.
            blocks: Cells after elimination with another right side; None for that of the data.
        """
        x = self.sides.values(x)

        def parts() -> Iterator[tuple[Eliminated[Any], Array, Array]]:
            for block in self._blocks if blocks is None else blocks:
                traces = x[self._unknowns(block.cells.numbers)]
                flux, varying = with_f * block.flux_of_f, block.flux.shape[1]
                flux[:, :varying] += np.einsum("nbi,ni->nb", block.flux, traces)
                yield block, flux, np.einsum("nmi,ni->nm", block.u, traces) + with_f * block.u_of_f

        return self.fields(parts())

    def respond(self, *loads: Any, solve: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
        """Solve with any right side (collective).

        Args:
            loads: The right sides as `eliminated` takes them.
            solve: Gives x, ghosts too, from the right side for the owned unknowns, without given fluxes.

        Returns:
            σ and u as `recover` gives them, and x.
        """
        blocks = list(self.eliminated(*loads))
        x = solve(self.load_of(blocks))
        return *self.recover(x, blocks=blocks), x

    def _unknowns(self, cells: npt.NDArray[np.int32]) -> Indices:
        """Unknowns of the facets of cells, shape (cells, n)."""
        blocks = self._dofs[cells].astype(np.int64)
        return (blocks[:, :, None] * self._size + np.arange(self._size)).reshape(len(cells), -1)
