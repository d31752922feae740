"""The facets of Γ_S inside the domain, across which u may jump; the mesh is cut along them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.meshes.domain import Domain, facet_pairs


@dataclass(frozen=True)
class InnerFacets:
    """The facets of Γ_S that are inside the domain, and on each of them a second one, of the cell on the other side.

    There p is the jump of u, and σ·n is the flux out of the named side, which is that into the other.

    Attributes:
        rows: Rows of `Spaces.facets`.
        facets: The mesh facets of the other side.
        present: Whether any rank has such facets.
    """

    rows: npt.NDArray[np.intp]
    facets: npt.NDArray[np.int32]
    present: bool


def inner_facets(domain: Domain, facets: npt.NDArray[np.int32], inner: Sequence[str]) -> InnerFacets:
    """The Γ_S facets of this rank that are on inner parts, each with the one that lies on it (collective).

    Raises:
        InputError: If the two sides of an inner part do not consist of the same facets on each rank.
    """
    rows, across = [np.empty(0, dtype=np.intp)], [np.empty(0, dtype=np.int32)]
    for name in inner:
        named, other = facet_pairs(domain, name)
        order = np.argsort(facets)
        rows.append(order[np.searchsorted(facets[order], named)])
        across.append(other)
    return InnerFacets(np.concatenate(rows), np.concatenate(across), bool(inner))
