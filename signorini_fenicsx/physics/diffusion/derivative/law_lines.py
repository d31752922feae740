"""How the lines of laws that sites are on change with the data of the laws."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.discrete.part_laws import COMPLEX_STEP, PartLaw, chains_of, means_of
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


def moved_lines(
    spaces: Spaces, part: PartLaw, segment: Indices, u: Array, penalty: tuple[float, float] | None
) -> Iterator[tuple[str, Mask, Array]]:
    """The derivatives of lines by the means of the data that are given in UFL (collective).

    They are by a complex step, which has no error but rounding.

    Args:
        spaces: The discrete spaces.
        part: A law.
        segment: The segment that each of its sites is on.
        u: The present u there.
        penalty: The slopes before and beyond the corner of a penalty, or None.

    Yields:
        The name of a datum; where the line is vertical; and the derivative of its u there, elsewhere of σ·n at the
        present u.
    """
    means, weights = means_of(spaces, part), part.law.weights
    for name, datum in part.data.items():
        if datum.pieces is not None and (name not in weights or part.data[weights[name]].pieces is not None):
            continue
        graph = part.law.falling(means | {name: means[name] + 1j * COMPLEX_STEP})  # type: ignore[arg-type]
        if penalty is not None:
            graph = replace(graph, before=penalty[0], beyond=penalty[1])
        chains = chains_of(replace(graph, reference=(0.0, 0.0)), len(part.rows))
        slope, value = (
            np.take_along_axis(each, segment[:, None], axis=1)[:, 0] for each in (chains.slope, chains.value)
        )
        steep = np.isinf(slope)
        yield name, steep, (value - np.where(steep, 0.0, slope) * u).imag / COMPLEX_STEP
