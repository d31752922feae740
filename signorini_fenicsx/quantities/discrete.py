"""Integrals and means of a discrete solution: where they are taken, and what they are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.reference_cells import positive_quadrature
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.points import Points, facet_quadrature, in_cells
from signorini_fenicsx.quantities.kinds import Integral, Mean


def where(spaces: MeshSpaces, kind: Integral, weight: Datum) -> Iterator[Points]:
    """Points of a quadrature in the cells of the regions, or in the facets of each part (collective)."""
    domain, mesh, degree = spaces.domain, spaces.mesh, quadrature_degree(weight)
    if kind.parts:
        yield from (facet_quadrature(mesh, domain.facets[part], degree) for part in kind.parts)
        return
    cells = owned_cells(mesh)
    if kind.region:
        cells = np.unique(np.concatenate([domain.regions[name] for name in kind.region])).astype(np.int32)
    yield from in_cells(mesh, cells, *positive_quadrature(mesh.basix_cell(), degree))


def mean_of(kind: Integral, sums: Array) -> float:
    """The integral, for a mean over that of the weight."""
    integral, of_weight = sums.tolist()
    return integral / of_weight if isinstance(kind, Mean) and of_weight != 0 else integral
