"""The terms of v at nodes, of which pieces of facets have some several times, see `active_terms`."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Mask

FREE = 1e-12
"""A condition of whose unit direction less than this square is free is left out; what is given meets it, or nothing."""
DIGITS = 12
"""Conditions on pieces of a facet are the same if they give a random function the same value to so many digits."""
PART = 1e-7
"""A facet of which so much is missing is a piece."""
SLIVER = 1e-3
"""Springs of conditions on pieces have the share of these of a facet, but not less than this."""


@dataclass(frozen=True)
class Collected:
    """Terms at nodes.

    Attributes:
        nodes: Those of each, shape (terms, nodes).
        axes: What each component takes of the nodes' coefficients, shape (terms, components, nodes, d).
        bound: g, shape (terms, components).
        forces: Those near the minimum, likewise.
        most: w.
        one_sided: Whether no component of a force is negative.
        stiffness: By which each gives way, ∞ but for springs along joints.
        share: The share of its facet on which each is.
    """

    nodes: npt.NDArray[np.int32]
    axes: Array
    bound: Array
    forces: Array
    most: Array
    one_sided: Mask
    stiffness: Array
    share: Array

    @property
    def on_pieces(self) -> Mask:
        """Which are on pieces of facets."""
        return np.asarray(self.share < 1 - PART)

    def once(self, kinds: Array) -> "Collected":
        """The terms that are not given, and one for those that are the same on several pieces, with all their forces.

        Args:
            kinds: Of each, shape (terms, n).
        """
        size = np.abs(self.bound).max(initial=np.finfo(float).tiny)
        random = np.random.default_rng(0).random((1 + self.nodes.max(initial=0), *self.axes.shape[1::2]))
        along = np.einsum("kmsj,ksmj->k", self.axes, random[self.nodes])
        alone = np.where(self.on_pieces, -1, np.arange(len(self.share)))
        keys = np.column_stack([alone, kinds, along.round(DIGITS), (self.bound / size).round(DIGITS)])
        _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(first)
        first, which = first[order], np.argsort(order)[which.ravel()]
        free = np.flatnonzero((self.axes[first] ** 2).sum(axis=(1, 2, 3)) > FREE)
        kept = first[free]

        def total(values: Array) -> Array:
            sums = np.zeros((len(first), *values.shape[1:]))
            np.add.at(sums, which, values)
            return sums[free]

        share = np.where(self.on_pieces[kept], np.clip(total(self.share), SLIVER, 1 - 2 * PART), 1.0)
        return Collected(
            nodes=self.nodes[kept],
            axes=self.axes[kept],
            bound=self.bound[kept],
            forces=total(self.forces),
            most=total(self.most),
            one_sided=self.one_sided[kept],
            stiffness=total(self.stiffness),
            share=share,
        )
