"""What a discrete problem with linear traces sees of data on boundary facets: moments, or values in points."""

import basix.ufl
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, LinearTraces
from signorini_fenicsx.discrete.points import FacetPoints, facet_type
from signorini_fenicsx.discrete.seen import Seen


def moments_seen(spaces: LinearTraces, datum: Datum, facets: BoundaryFacets, degree: int) -> Seen:
    """The moments ∫ d φ_a of a datum over facets, by a quadrature of this degree (collective)."""
    dofs = dofs_on_boundary(spaces, facets).ravel()
    return _seen(spaces, datum, facets, degree, spaces.on_boundary[0], dofs, np.ones(len(dofs)))


def dofs_on_boundary(spaces: LinearTraces, facets: BoundaryFacets) -> npt.NDArray[np.int32]:
    """The degrees of freedom of `on_boundary` at the vertices of facets, shape (facets, d)."""
    cells, corners = _on_boundary(spaces, facets)
    dofs: npt.NDArray[np.int32] = spaces.on_boundary[0].dofmap.list[cells]
    return np.take_along_axis(dofs, _nearest(facets.vertices, corners), axis=1)


def values_seen(spaces: LinearTraces, datum: Datum, facets: BoundaryFacets, points: FacetPoints, degree: int) -> Seen:
    """The values of a datum in the points of a quadrature of this degree in facets (collective)."""
    boundary = spaces.on_boundary[0].mesh
    rule = {"points": points.points, "weights": points.weights}
    space = fenicsx.function_space(boundary, basix.ufl.quadrature_element(facet_type(spaces.dim), **rule))
    cells, corners = _on_boundary(spaces, facets)
    hats = np.column_stack([1 - points.points.sum(axis=1), points.points])
    dofs = np.take_along_axis(space.dofmap.list[cells], _nearest(points.x, hats @ corners), axis=1).ravel()
    weights = facets.measure[:, None] * points.weights / points.weights.sum()
    return _seen(spaces, datum, facets, degree, space, dofs, weights.ravel())


def _on_boundary(spaces: LinearTraces, facets: BoundaryFacets) -> tuple[npt.NDArray[np.int32], Array]:
    """Facets as cells of the mesh of the boundary, with their vertices in the order that they have there."""
    space, entity_map = spaces.on_boundary
    boundary, dim = space.mesh, spaces.dim
    cells = np.arange(boundary.topology.index_map(dim - 1).size_local, dtype=np.int32)
    numbers = entity_map.sub_topology_to_topology(cells, inverse=False)
    order = np.argsort(numbers)
    of_facets = order[np.searchsorted(numbers, facets.facets, sorter=order)].astype(np.int32)
    nodes = dolfinx.mesh.entities_to_geometry(boundary, dim - 1, of_facets)
    return of_facets, boundary.geometry.x[nodes, :dim]


def _nearest(places: Array, among: Array) -> npt.NDArray[np.intp]:
    """Which of some places is the nearest one on the same facet, shape (facets, places)."""
    return np.square(places[:, :, None] - among[:, None]).sum(axis=3).argmin(axis=2)


def _seen(
    spaces: LinearTraces,
    datum: Datum,
    facets: BoundaryFacets,
    degree: int,
    space: fem.FunctionSpace,
    dofs: npt.NDArray[np.int32],
    scale: Array,
) -> Seen:
    listed = np.sort(facets.facets)
    entities = fem.compute_integration_domains(fem.IntegralType.exterior_facet, spaces.mesh.topology, listed)
    ds = ufl.Measure("ds", domain=spaces.mesh, subdomain_data=[(1, entities)])(1, degree=degree)
    return Seen(lambda v: datum.ufl * v * ds, space, dofs, scale, [spaces.on_boundary[1]])
