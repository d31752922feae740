"""The fluxes that balance what pairs pass on between the vertices of master facets, see `certificate.passed_on`."""

from functools import lru_cache
from itertools import combinations
from math import factorial

import basix
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.certificate import passed_on as of_pairs
from signorini_fenicsx.certificate.passed_on import PARTS, LatticeFields, kuhn_lattice
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric
from signorini_fenicsx.physics.diffusion.discrete.raviart_thomas import Cells, reference
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces


class Response(of_pairs.LatticeResponse):
    """Fluxes of RT1 for given ones through a facet."""

    def weights(self, edges: Array, compliance: Array) -> Array:
        """See the class above."""
        return edges.swapaxes(1, 2) @ compliance @ edges / np.abs(np.linalg.det(edges))[:, None, None]

    def pulled(self, _edges: Array, moments: Array) -> Array:
        """See the class above."""
        return moments

    def constants(self, edges: Array, compliance: Array, sizes: Array) -> Array:
        """See the class above: C_e² of `local_fields`."""
        dim = edges.shape[1]
        vertices = np.concatenate([np.zeros_like(edges[:, :, :1]), edges.cumsum(axis=2)], axis=2)
        first, second = np.array(list(combinations(range(dim + 1), 2))).T
        apart = vertices[:, :, first] - vertices[:, :, second]
        diameter = np.einsum("nip,nij,njp->np", apart, compliance, apart, optimize=True).max(axis=1, initial=0.0)
        measure = np.abs(np.linalg.det(edges)) / factorial(dim)
        return np.asarray(diameter * sizes / measure * (1 / np.pi**2 + 2 / (np.pi * dim)))


@lru_cache
def response(dim: int) -> Response:
    """The fluxes in this dimension."""
    element, cells = reference(dim), Cells(kuhn_lattice(dim, PARTS[dim]) / PARTS[dim])
    points, weights = basix.make_quadrature(SIMPLEX[dim], 4)
    values, through = element.values(points)[:, :, : element.free], element.tractions[:, : element.free]
    fluxes = np.einsum("nij,qjb->nqib", cells.map, values)
    masses = np.diag(weights * cells.determinant[0])  # all cells are as large
    return Response.of(dim, LatticeFields(fluxes, masses, np.broadcast_to(through, (len(fluxes), *through.shape))))


def passed_on(spaces: RT1Spaces, metric: CellMetric, y: fem.Function) -> Array:
    """How large ⟨r, w⟩ may be beside |w|_T for each owned cell; both sides of a piece are on one rank (collective)."""
    values = spaces.flux_values(y)
    flows = ((pair, -spaces.through(spaces.boundary_facets(pair.slaves), values)[:, :, None]) for pair in spaces.pairs)
    return of_pairs.passed_on(spaces, flows, metric.inverse / metric.low[:, None, None], response(spaces.dim))
