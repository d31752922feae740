"""Traces of a step with soils: û in which it begins, and how far Newton's method goes."""

from abc import abstractmethod
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import sums_at
from signorini_fenicsx.discrete.hybrid_system import TraceSystem


class SoilTraces(TraceSystem):
    """A system for traces, which have values on the facets of cells where `Quasilinear` looks at them."""

    _data: Any
    _numbers: Any
    _dofs: npt.NDArray[np.int32]

    @cached_property
    def cells_around(self) -> Array:
        """The number of cells with each û of this rank, ghosts too (collective when first used)."""
        return sums_at(self._numbers, self._dofs)

    def on_cells(self, x: PETSc.Vec) -> Array:
        """û on the facets of the owned cells, from the owned unknowns without what is given (collective)."""
        return self.traces_on_cells(self.with_lift(x))

    @abstractmethod
    def traces_on_cells(self, unknowns: Array) -> Array:
        """û on the facets of the owned cells, from all unknowns of this rank with what is given (collective)."""

    @abstractmethod
    def means_of_cells(self, traces: Array) -> Array:
        """The û of this rank, ghosts too, that is the mean of both sides where cells differ (collective)."""

    @property
    @abstractmethod
    def fixed(self) -> npt.NDArray[np.int32]:
        """The owned unknowns that are given."""

    def unknowns_of(self, traces: Array) -> Array:
        """The owned unknowns of this û on the facets of the owned cells, of u_D where that is given (collective)."""
        owned = (self.means_of_cells(traces) - self.lift)[: len(self.load)]
        owned[self.fixed] = 0.0
        return self.sides.unknowns(owned)

    def limited(self, start: Array, x: Array) -> Array:
        """These unknowns, or nearer ones to a start as far as soils allow, see `Soil.nearer` (collective)."""
        traces, wanted = (self.traces_on_cells(self.everywhere(each) + self.lift) for each in (start, x))
        moved = self.means_of_cells(self._data.quasilinear.nearer(traces, wanted) - wanted)
        return self.sides.unknowns(self.sides.values(x)[: len(x)] + moved[: len(x)])
