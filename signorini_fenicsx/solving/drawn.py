"""What a physics gives of a solution for its pictures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.mesh_spaces import DIRICHLET, NEUMANN, SIGNORINI, MeshSpaces
from signorini_fenicsx.discrete.site_table import Facets

PARTLY_FIXED = 4
"""A part of the boundary that is fixed in some components only."""

type Kind = tuple[npt.NDArray[np.int32], Array]
"""Some facets, and the values of u that are known there; NaN where none is. Of bodies means of given tractions."""


@dataclass(frozen=True)
class Surfaces:
    """Facets that are not in Γ_S and have a table, on each rank its own.

    Attributes:
        names: Their parts.
        facets: The facets, `part` an index into these.
        table: Their values, a `SiteTable`.
        columns: The columns that are written of such a table.
    """

    names: Sequence[str]
    facets: Facets
    table: Any
    columns: Callable[[Any], Mapping[str, npt.NDArray]]


@dataclass(frozen=True)
class Drawn:
    """A solution for pictures, on each rank its own share.

    Attributes:
        corners: Values at the corners of each cell by their names, in the order of the geometry, shape
            (cells, dim + 1, k). "u" is among them, of a scalar as in `Solved.potential`.
        facets: Γ_S.
        boundary: The facets of each kind of boundary, which is `SIGNORINI`, `DIRICHLET`, `NEUMANN` or `PARTLY_FIXED`.
        cells: Values of each cell by their names. Of "states" pictures show the facets between different ones.
        edges: What these facets are called.
        segments: Names of what `SiteTable.shown` counts, if that is more than contact or not.
        inside: The parts of Γ_S inside the domain.
        lines: On rank 0 lines of maps by their names, each of shape (points, 2), in space triangles, (3, 3).
        words: What captions add.
        opposite: What is opposite to Γ_S and has a table, if there is such.
    """

    corners: Mapping[str, Array]
    facets: Facets
    boundary: dict[int, Kind]
    cells: Mapping[str, npt.NDArray] = field(default_factory=dict)
    edges: str = ""
    segments: Sequence[str] = ()
    inside: Sequence[str] = ()
    lines: Mapping[str, Sequence[Array]] = field(default_factory=dict)
    words: Sequence[str] = ()
    opposite: Surfaces | None = None


def whole_boundary(spaces: MeshSpaces, **values: Array) -> dict[int, Kind]:
    """The facets of each kind, with the values of u that are known on those of some, by their names."""
    kinds = {
        "signorini": (SIGNORINI, spaces.facets),
        "dirichlet": (DIRICHLET, spaces.dirichlet_facets),
        "neumann": (NEUMANN, spaces.neumann_facets),
    }
    return {kind: (facets, values.get(name, np.full(len(facets), np.nan))) for name, (kind, facets) in kinds.items()}
