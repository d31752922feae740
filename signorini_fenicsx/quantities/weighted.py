"""The weight of an integral of u, or of a mean, and the cells or facets over which it is one."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.reference_cells import positive_quadrature
from signorini_fenicsx.discrete.datum import Datum, datum_of, quadrature_degree
from signorini_fenicsx.discrete.points import Points, facet_quadrature, in_cells
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.expressions.products import products
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.quantities.kinds import Integral

SHARPLY = 1e-6
"""What may be wrong of a weight's integral that is kept, or looks like 0, as a share of its size."""
NOTHING = 1e-12
"""An integral that is at most this share of what it could be by the size of its integrand is rounding of 0."""


@dataclass(frozen=True)
class Weighted:
    """A weight on a mesh.

    Attributes:
        domain: The mesh with its parts.
        kind: The integral.
        weight: The weight.
    """

    domain: Domain
    kind: Integral
    weight: Datum

    @classmethod
    def of(cls, domain: Domain, kind: Integral) -> Self:
        """The weight of an integral (collective).

        Raises:
            InputError: If it cannot be read.
        """
        names = "xyz"[: domain.mesh.geometry.dim]
        return cls(domain, kind, datum_of(domain, "weight", parsed(kind.weight, names, "weight")))

    @property
    def cells(self) -> Indices:
        """The owned cells over which it is an integral, if it is over cells."""
        if not self.kind.region:
            return owned_cells(self.domain.mesh).astype(np.int64)
        return np.unique(np.concatenate([self.domain.regions[name] for name in self.kind.region])).astype(np.int64)

    def points(self, power: int = 1) -> Iterator[Points]:
        """Points of a quadrature for a power of the weight in the cells, or in the facets of each part (collective)."""
        mesh, degree = self.domain.mesh, quadrature_degree(self.weight, power=power)
        if self.kind.parts:
            return (facet_quadrature(mesh, self.domain.facets[part], degree) for part in self.kind.parts)
        return in_cells(mesh, self.cells.astype(np.int32), *positive_quadrature(mesh.basix_cell(), degree))

    @cached_property
    def sizes(self) -> list[float]:
        """The integrals of the weight, of its square and of 1, by quadrature (collective when first used)."""
        sums = np.zeros(3)
        for points in self.points(power=2):
            values = self.weight.values(points)
            sums += [points.integrals(values**power).sum() for power in (1, 2, 0)]
        return self.domain.mesh.comm.allreduce(sums).tolist()

    def total(self, enough: float) -> tuple[float, float]:
        """The integral of the weight, and by how much it may be wrong; `enough` as in `products` (collective)."""
        if self.weight.pieces is None:
            return self.sizes[0], 0.0
        total = np.zeros(2)
        for points in self.points(power=2):
            measure = points.scale * points.weights.sum()
            for tree, rows in self.weight.trees_in(points.cells):
                some = points.vertices[rows], measure[rows]
                total += products(tree, *some, _one, 0, self.domain.frame, enough).total
        value, radius = self.domain.mesh.comm.allreduce(total).tolist()
        return value, radius

    def check_mean(self) -> None:
        """Refuse a weight with which there is no mean (collective).

        Raises:
            InputError: If its integral is 0 but for rounding; of texts that quadrature may miss this has to be proved.
        """
        integral, square, measure = self.sizes
        size = math.sqrt(square * measure)
        if abs(integral) > NOTHING * size or not math.isfinite(size):
            return
        value, radius = self.total(SHARPLY * size)
        if self.weight.pieces is None or abs(value) <= radius <= SHARPLY * size:
            raise InputError("weight: its integral is 0, so there is no mean with it")


def _one(numbers: Indices, x: Array) -> Array:
    """1 in points."""
    return np.ones(x.shape[:2])
