"""The lines of laws that sites are on, and how they change with the data of the laws."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.conditions import Penalty
from signorini_fenicsx.contact.law import Graph
from signorini_fenicsx.discrete.part_laws import COMPLEX_STEP, PartLaw, chains_of, means_of
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


@dataclass(frozen=True)
class Lines:
    """One law on its sites, as u = value, or as flux + slope·u = value, and the derivatives by the means of its data.

    Attributes:
        part: The law.
        steep: Where it holds u.
        slopes: Change of the slope for each of its data, by its name in messages; 0 where it holds u.
        values: That of the value.
    """

    part: PartLaw
    steep: Mask
    slopes: Mapping[str, Array]
    values: Mapping[str, Array]

    @classmethod
    def of(cls, spaces: Spaces, part: PartLaw, segment: Indices, penalty: tuple[Penalty | None, float]) -> Lines:
        """The lines of the segments that the sites of a law are on (collective)."""
        means = means_of(spaces, part)
        kind, eps = penalty
        graph = part.law.falling(means)
        slopes: dict[str, Array] = {}
        values: dict[str, Array] = {}
        number = len(part.rows)
        slope = chains_of(graph, number).with_penalty(kind, eps).slope
        steep = np.isinf(slope[np.arange(number), segment])
        ends = None if kind is None else kind.slopes(eps)
        for name in means:
            moved = part.law.falling(means | {name: means[name] + 1j * COMPLEX_STEP})  # type: ignore[arg-type]
            if ends is not None:
                moved = replace(moved, before=ends[0], beyond=ends[1])
            slope, value = _line(moved, segment, steep)
            slopes[part.key(name)], values[part.key(name)] = slope.imag / COMPLEX_STEP, value.imag / COMPLEX_STEP
        return cls(part, steep, slopes, values)

    def changes(self, changes: Mapping[str, Array]) -> tuple[Array, Array]:
        """How slope and value change with the means."""
        varied = [name for name in self.slopes if name in changes]
        slope, value = (
            sum((of[name] * changes[name] for name in varied), start=np.zeros(len(self.steep)))
            for of in (self.slopes, self.values)
        )
        return slope, value

    def sensitivities(self, of_slope: Array, of_value: Array) -> Iterator[tuple[str, Array]]:
        """The derivatives of something by the means, from those by slope and value."""
        for name, slope in self.slopes.items():
            yield name, of_slope * slope + of_value * self.values[name]


def _line(graph: Graph, segment: Indices, steep: Mask) -> tuple[Array, Array]:
    """Slope, 0 on steep segments, and value of the line of a segment at each site."""
    number, last = len(segment), len(graph.corners)
    u, flux = (np.array([np.broadcast_to(corner[i], number) for corner in graph.corners]) for i in (0, 1))
    sites, before, after = np.arange(number), np.maximum(segment - 1, 0), np.minimum(segment, last - 1)
    run = np.where(before < after, u[after, sites] - u[before, sites], 1.0)
    inner = (flux[before, sites] - flux[after, sites]) / np.where(steep, 1.0, run)
    ends = [np.where(steep, 0.0, np.broadcast_to(slope, number)) for slope in (graph.before, graph.beyond)]
    slope = np.where(steep, 0.0, np.where(segment == 0, ends[0], np.where(segment == last, ends[1], inner)))
    return slope, np.where(steep, u[before, sites], flux[before, sites] + slope * u[before, sites])


def rays(slopes: tuple[Array, Array], values: tuple[Array, Array]) -> Chains:
    """Chains of the two rays that meet where two lines do, u = value where the slope is ∞, else flux + slope·u = value.

    Two equal lines are one.

    Args:
        slopes: Of the ray before the corner and of that beyond it.
        values: Of both lines.
    """
    steep = [np.isinf(slope) for slope in slopes]
    (before, beyond), (one, other) = (
        (np.where(hold, 0.0, slope) for hold, slope in zip(steep, slopes, strict=True)),
        values,
    )
    fall = before - beyond
    u = np.where(steep[0], one, np.where(steep[1], other, 0.0))
    u = np.where(steep[0] | steep[1] | (fall == 0), u, (one - other) / np.where(fall == 0, 1.0, fall))
    flux = np.where(steep[0], np.where(steep[1], 0.0, other - beyond * u), one - before * u)
    return Chains.through(u[:, None], flux[:, None], *slopes)
