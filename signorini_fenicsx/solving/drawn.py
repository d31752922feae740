"""What a physics gives of a solution for its pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.discrete.mesh_spaces import DIRICHLET, NEUMANN, SIGNORINI, MeshSpaces
from signorini_fenicsx.discrete.site_table import FacetTable

PARTLY_FIXED = 4
"""A part of the boundary that is fixed in some components only."""

type Kind = tuple[npt.NDArray[np.int32], Array]
"""Some facets, and the values of u that are known there; NaN where none is."""


@dataclass(frozen=True)
class Drawn:
    """A solution for pictures, on each rank its own share.

    Attributes:
        u: u at the corners of each cell, in the order of the geometry, see `Solved.potential`, shape
            (cells, dim + 1, 1); a displacement has shape (cells, dim + 1, dim).
        sigma: σ_h at the centroids, or what stands for it, shape (cells, components).
        facets: Γ_S.
        boundary: The facets of each kind of boundary, which is `SIGNORINI`, `DIRICHLET`, `NEUMANN` or `PARTLY_FIXED`.
        divergence: ∇·σ_h of each cell; None for 0.
        contact: Whether laws in Ω hold u in a cell, as an obstacle does in contact; None without such laws.
        states: The segment of its laws that each cell is on; None without laws in Ω.
        edges: What the facets between cells in different states are called.
        columns: What pictures call the columns of `steps.csv` that have measures of cells under laws in Ω.
        segments: Names of the segments of all laws, if there are others than the Signorini law.
        inside: The parts of Γ_S inside the domain.
        strength: What |σ_h| is called.
        gamma: What Γ_S is called.
        phreatic_line: Points of the phreatic line of a dam, on all ranks, shape (points, 2); None if there is none.
    """

    u: Array
    sigma: Array
    facets: FacetTable
    boundary: dict[int, Kind]
    divergence: Array | None = None
    contact: Mask | None = None
    states: Indices | None = None
    edges: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    segments: Sequence[str] = ()
    inside: Sequence[str] = ()
    strength: str = r"$|\sigma_h|$"
    gamma: str = r"$\Gamma_S$"
    phreatic_line: Array | None = None


def whole_boundary(spaces: MeshSpaces, **values: Array) -> dict[int, Kind]:
    """The facets of each kind, with the values of u that are known on those of some, by their names."""
    kinds = {
        "signorini": (SIGNORINI, spaces.facets),
        "dirichlet": (DIRICHLET, spaces.dirichlet_facets),
        "neumann": (NEUMANN, spaces.neumann_facets),
    }
    return {kind: (facets, values.get(name, np.full(len(facets), np.nan))) for name, (kind, facets) in kinds.items()}
