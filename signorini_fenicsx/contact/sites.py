"""Sites with a type: where they are, how much they weigh, and where their values stand in the arrays of a problem.

A problem has sites of one kind or of several: facets of Γ_S, on parts inside the domain with the jump of u, and cells
with laws in Ω; in elastic contact the vertices of the facets of Γ_C, with friction once more for each tangent. The
arrays of p, σ·n, segments and conditions have the kinds behind each other, in the order of `Sites`:

    normal, slip = spaces.site_kinds
    normal.of(p), slip.of(flux)      # a view of each kind, one entry per site
    normal.rows_of(p)                # the same by facet, shape (facets, d)
    flux[slip.pressing]              # the pressures under the vertices with friction, shape (facets with friction, d)
    slip.spread(slip.rows_of(p))     # rows of all facets of Γ_C, 0 on those without friction

Arrays may end before the last kind: without laws in Ω there are no values of cells, and `of` is empty.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices


def _nothing() -> Indices:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class SiteKind:
    """The sites of one kind of this rank, all owned, possibly none.

    Attributes:
        name: What they are: "facet", "cell", "normal" or "slip".
        count: Number of all facets of Γ_S of this rank, or of all its owned cells.
        rows: Those of them that have such sites.
        measure: |e| or |T| of each site, of a facet's vertex its share of |e|.
        shape: How many sites a facet or a cell has, () for one: (d,) for its vertices, (d, d − 1) with tangents.
        unknown: The unknown of each site in the linear system; empty if sites are none.
        sign: The p of a site grows with its unknown, or falls.
        pressing: For each vertex with friction its site in the normal direction, shape (facets with friction, d).
        first: Number of sites of the kinds before.
    """

    name: str
    count: int
    rows: Indices
    measure: Array
    shape: tuple[int, ...] = ()
    unknown: AnyIndices = field(default_factory=_nothing)
    sign: float = 1.0
    pressing: Indices = field(default_factory=_nothing)
    first: int = 0

    def __len__(self) -> int:
        return len(self.measure)

    @property
    def at(self) -> slice:
        """Where its sites stand."""
        return slice(self.first, self.first + len(self))

    def of(self, values: Any) -> Any:
        """What an array, conditions or chains of all sites have for these: a view."""
        return values[self.at]

    @property
    def called(self) -> str:
        """What the sites are called in results."""
        return "vertices" if self.shape else f"{self.name}s"

    def rows_of(self, values: np.ndarray) -> np.ndarray:
        """The values of these sites by facet or cell, of an array of all sites, shape (rows, *shape, …)."""
        return self.of(values).reshape(len(self.rows), *self.shape, *values.shape[1:])

    def numbers(self, rows: Indices) -> Indices:
        """The numbers of the sites of some rows, if all rows have sites."""
        return np.arange(len(self)).reshape(self.count, *self.shape)[rows].ravel()

    def spread(self, rows: np.ndarray, others: float = 0.0) -> np.ndarray:
        """Rows of its facets as rows of all facets of Γ_S, with one number on the others; the same for cells."""
        everywhere = np.full((self.count, *rows.shape[1:]), others)
        everywhere[self.rows] = rows
        return everywhere


class Sites:
    """All sites of this rank, kind behind kind.

    Attributes:
        unknown: Those of the kinds, see `SiteKind.unknown`.
        measure: That of each site.
        sign: Likewise.
    """

    def __init__(self, *kinds: SiteKind):
        """Put kinds behind each other."""
        ends = np.cumsum([0, *(len(kind) for kind in kinds)])
        self._kinds = {kind.name: replace(kind, first=int(first)) for kind, first in zip(kinds, ends, strict=False)}
        self.unknown, self.measure = (
            np.concatenate([getattr(kind, name) for kind in kinds]) for name in ("unknown", "measure")
        )
        self.sign: Array = np.repeat([kind.sign for kind in kinds], [len(kind) for kind in kinds])

    def spread(self, values: np.ndarray) -> list[np.ndarray]:
        """Values of all sites but cells as rows of all facets of Γ_S, one array for each kind."""
        return [kind.spread(kind.rows_of(values)) for kind in self if kind.name != "cell"]

    def gathered(self, *rows: np.ndarray) -> np.ndarray:
        """The values of sites from rows as `spread` gives them."""
        return np.concatenate([of_kind[kind.rows].ravel() for kind, of_kind in zip(self, rows, strict=False)])

    def __iter__(self) -> Iterator[SiteKind]:
        return iter(self._kinds.values())

    def __contains__(self, name: str) -> bool:
        return name in self._kinds

    def __getitem__(self, name: str) -> SiteKind:
        return self._kinds[name]

    def __len__(self) -> int:
        return len(self.measure)
