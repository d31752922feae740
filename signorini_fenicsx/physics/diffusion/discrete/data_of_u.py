"""Data that depend on u: κ, and what soils store in a step in time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import function_of, owned_values
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.expressions import Tree
from signorini_fenicsx.expressions.given import Rows
from signorini_fenicsx.physics.diffusion.discrete.added_flux import AddedFlux
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import means_in_cells
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import OnCells, Quasilinear
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.discrete.storing import Storing, WaterBefore, from_places, in_places


@dataclass(frozen=True, kw_only=True)
class DataOfU(ABC):
    """What `Data` have of u. Where κ depends on it they are those of the last solve.

    Attributes:
        kappa: κ as given; where it depends on u, that of the last solve.
        c: c as given.
        f_h: P0 projection of f.
        kappa_h: P0 projection of κ, entry by entry; a `fem.Constant` if κ is a number, which no form is compiled for.
        c_h: P0 projection of c; None if it is 0 everywhere.
        conductance: Mean of κ divided by L: the size of σ·n that belongs to p = 1.
        memory: What the step of a problem in time takes from those before, in the space of u; its means are a part of
            f_h, but not of f.
        trees: The data that were given as numbers or as text, by name, as trees: these can be enclosed in intervals. κ
            of regions has names such as "kappa.core".
        quasilinear: κ as a function of u; None if it does not depend on u.
        b: The given flux in σ = κ∇u + b; None for none.
    """

    kappa: Datum
    c: Datum
    f_h: fem.Function
    kappa_h: fem.Function | fem.Constant
    c_h: fem.Function | None
    conductance: float
    trees: Mapping[str, Tree | Rows]
    memory: fem.Function | None = None
    quasilinear: Quasilinear | None = None
    b: AddedFlux | None = None

    def with_kappa(self, spaces: Spaces, values: Array, stored: tuple[Array, Array] | None = None) -> Self:
        """The data with another κ, by its values on each owned cell, see `Quasilinear` (collective).

        In a step in time what soils store is cu − load, with these two in the places of `Storing`: the means of c are
        those of the data, and the load is a part of `memory`.

        Raises:
            InputError: If κ is not positive.
        """
        comm = spaces.mesh.comm
        usable = np.where(values < np.inf, values, -np.inf)  # NaN is not
        least = comm.allreduce(float(usable.min(initial=np.inf)), MPI.MIN)
        if not least > 0:
            raise InputError(f"[problem] kappa: must be positive; for a u that occurs it is {least:.3g}")
        means = values.mean(axis=1)
        kappa_h = function_of(spaces.Q, means, "kappa_h")
        function = kappa_h if values.shape[1] == 1 else spaces.scalar(values)
        integral = comm.allreduce(float(spaces.cell_measures @ means))
        conductance = integral / spaces.length ** (spaces.mesh.geometry.dim + 1)
        data = replace(self, kappa=OnCells(function, values), kappa_h=kappa_h, conductance=conductance)
        return data if stored is None else data._storing(spaces, *stored)

    def _storing(self, spaces: Spaces, c: Array, load: Array) -> Self:
        """The data with what soils store (collective)."""
        of_u = self.quasilinear
        assert of_u is not None
        assert of_u.storing is not None
        storing, mean = replace(of_u.storing, slopes=c), c.mean(axis=1)
        memory, c_h = storing.before + load, function_of(spaces.Q, mean, "c_h")
        f_h = function_of(spaces.Q, (storing.f + memory).mean(axis=1) - of_u.constant * mean, "f_h")
        stores = spaces.mesh.comm.allreduce(bool(c.any()), MPI.LOR)
        return replace(
            self,
            c=OnCells(c_h, mean[:, None]),
            c_h=c_h if stores else None,
            f_h=f_h,
            memory=spaces.scalar(from_places(spaces, memory)),
            trees={name: tree for name, tree in self.trees.items() if name != "c"},
            quasilinear=replace(of_u, storing=storing),
        )

    def at_traces(self, spaces: Spaces, traces: Array) -> Self:
        """The data with the κ of û on the facets of the owned cells, and with what is stored then (collective).

        Raises:
            InputError: If κ is not positive.
        """
        of_u = self.quasilinear
        assert of_u is not None
        return self.with_stored(spaces, of_u.of_traces(traces)[0], traces)

    def with_stored(self, spaces: Spaces, kappa: Array, traces: Array) -> Self:
        """The data with this κ, and with what is stored for û on the facets of the owned cells (collective).

        Raises:
            InputError: If κ is not positive.
        """
        data, of_u = self.with_kappa(spaces, kappa), self.quasilinear
        if of_u is None or of_u.storing is None:
            return data
        means, moments = data._without_sources(spaces, traces)
        return data._storing(spaces, *of_u.storing.linear(means + of_u.constant, moments))

    @abstractmethod
    def _without_sources(self, spaces: Any, traces: Array) -> tuple[Array, Array]:
        """ū less the constant and M of the owned cells, see `storing`, for û on their facets (collective)."""

    def left(self, spaces: Spaces, u: Array, traces: Array) -> Self:
        """The data with what soils store linear around this u with one c on each cell, and its û (collective).

        Args:
            spaces: The spaces.
            u: It on the owned cells, with the same θ as the balance has.
            traces: û where `Quasilinear` looks at it.
        """
        of_u, stored = self.quasilinear, self.stored
        assert of_u is not None
        assert of_u.storing is not None
        assert stored is not None
        storing = replace(of_u.storing, traces=traces)
        data = replace(self, quasilinear=replace(of_u, storing=storing))
        return data._storing(spaces, *storing.with_one_slope(u, *stored))

    @property
    def stored(self) -> tuple[Array, Array] | None:
        """What soils store, see `with_kappa`; None if that is nothing."""
        if self.quasilinear is None or self.quasilinear.storing is None:
            return None
        storing = self.quasilinear.storing
        assert storing.slopes is not None
        assert self.memory is not None
        return storing.slopes, in_places(storing.spaces, storing.spaces.scalar_values(self.memory)) - storing.before

    @property
    def kappa_values(self) -> Array:
        """Where κ depends on u its values on each owned cell, see `with_kappa`."""
        assert isinstance(self.kappa, OnCells)
        return self.kappa.on_cells

    def after(self, memory: fem.Function | WaterBefore | None) -> Self:
        """The data of a step of a problem in time, with what it takes from those before; None for nothing."""
        if memory is None:
            return self
        if isinstance(memory, WaterBefore):
            of_u = self.quasilinear
            assert of_u is not None
            spaces = of_u.spaces
            f, before = self._projection_of_f(spaces), spaces.scalar_values(memory.content)
            f, before = in_places(spaces, f), in_places(spaces, before)
            storing = Storing(spaces, of_u.content, memory.rate, f, before, memory.traces)
            return replace(self, quasilinear=replace(of_u, storing=storing)).at_traces(spaces, memory.traces)
        f_h = function_of(self.f_h.function_space, owned_values(self.f_h) + means_in_cells(memory), "f_h")
        return replace(self, f_h=f_h, memory=memory)

    def _projection_of_f(self, spaces: Any) -> Array:
        """F_h on the owned cells as `Spaces.scalar` takes it (collective)."""
        return owned_values(self.f_h)

    @property
    def means_of_f(self) -> Array:
        """The mean of f on each owned cell: f_h without `memory`."""
        return owned_values(self.f_h) - self.means_of_memory

    @property
    def means_of_memory(self) -> Array:
        """The mean of `memory` on each owned cell, 0 without it."""
        return np.zeros_like(owned_values(self.f_h)) if self.memory is None else means_in_cells(self.memory)
