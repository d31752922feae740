"""The stresses that balance what pairs pass on between the vertices of master facets, see `certificate.passed_on`."""

from functools import lru_cache

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.certificate import passed_on as of_pairs
from signorini_fenicsx.certificate.passed_on import PARTS, LatticeFields, kuhn_lattice
from signorini_fenicsx.physics.elasticity.bound.korn import trace_constants
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells, reference
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces


class Response(of_pairs.LatticeResponse):
    """Stresses of Johnson and Mercier for tractions."""

    def weights(self, edges: Array, compliance: Array) -> Array:
        """See the class above."""
        paths = Cells(np.concatenate([np.zeros_like(edges[:, :1]), edges.swapaxes(1, 2)], axis=1))
        return np.asarray(paths.determinant[:, None, None] * (paths.mapped.swapaxes(1, 2) @ compliance @ paths.mapped))

    def pulled(self, edges: Array, moments: Array) -> Array:
        """See the class above."""
        return np.einsum("nij,nkaj->nkai", np.linalg.inv(edges), moments)

    def constants(self, edges: Array, compliance: Array, sizes: Array) -> Array:
        """See the class above, by `korn`."""
        softest = np.linalg.eigvalsh(compliance)[:, -1]
        return np.asarray(softest * trace_constants(edges.cumsum(axis=2), sizes) ** 2)


@lru_cache
def response(dim: int) -> Response:
    """The stresses in this dimension."""
    element, cells = reference(dim), Cells(kuhn_lattice(dim, PARTS[dim]) / PARTS[dim])
    hats, free = (1 + np.eye(dim + 1)) / ((dim + 1) * (dim + 2)), slice(None, element.free)
    masses = np.kron(np.eye(dim + 1), hats * cells.measure[0] / (dim + 1))  # all cells are as large
    through = cells.tractions(element.tractions)[:, :, free]
    return Response.of(dim, LatticeFields(cells.stresses(element.stresses[:, :, free]), masses, through))


def passed_on(spaces: ElasticSpaces, stresses: Array, compliance: Array) -> Array:
    """How large ⟨r, w⟩ may be beside |w|_T for each owned cell; both sides of a piece are on one rank (collective).

    Args:
        spaces: The spaces.
        stresses: Values of σ_h, as in `SplitMesh.values`.
        compliance: On each owned cell a matrix that is at least 𝔸 there, shape (cells, entries, entries).
    """
    flows = ((pair, -spaces.tractions(spaces.boundary_facets(pair.slaves), stresses)) for pair in spaces.pairs)
    return of_pairs.passed_on(spaces, flows, compliance, response(spaces.dim))
