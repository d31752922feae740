"""What a discrete problem sees of its data: numbers that are integrals of them with fixed functions, such as means.

With the form ∫ d·v of a datum d these are its values for the basis functions v, each divided by a number. So the change
of the numbers with d is the derivative of this form, and if S are the derivatives of something by them, its derivative
by what is in d is that of the form with v = Σ (S/number) times a basis function.

*What a discrete problem with linear traces sees of data on boundary facets*: moments, or values in points.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import basix.ufl
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl import Form
from ufl.algorithms.analysis import extract_coefficients, extract_constants
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, positions
from signorini_fenicsx.base.owned import cell_dofs
from signorini_fenicsx.discrete.cell_shapes import nearest
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, LinearTraces
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.discrete.points import FacetPoints, facet_type
from signorini_fenicsx.expressions import TREES

type Control = fem.Constant | fem.Function
type Values = Sequence[tuple[Control, Array]]
"""Constants and functions with the values that they had on this rank."""
type Vary = Callable[[Form], Form]
"""The derivative of a form in a direction, of the same rank."""


@dataclass(frozen=True)
class Seen:
    """The numbers that a discrete problem sees of one datum.

    Attributes:
        form: The integral of the datum with a function v, in UFL.
        space: That of v.
        dofs: The basis function of each number; all are owned.
        scale: What the integral is divided by, one value each.
        entity_maps: From other meshes that the form needs.
    """

    form: Callable[[Expr], Form]
    space: fem.FunctionSpace
    dofs: npt.NDArray[np.int32]
    scale: Array
    entity_maps: Sequence[dolfinx.mesh.EntityMap] = ()

    def changes(self, vary: Vary) -> Array:
        """Derivatives of the numbers that are seen, by the datum (collective)."""
        form = vary(self.form(ufl.TestFunction(self.space)))
        if not form.integrals():
            return np.zeros(len(self.dofs))
        return assembled(form, self.entity_maps)[self.dofs] / self.scale

    def weighted(self, by: Array) -> Form:
        """The sum of the numbers of all ranks, each times one of these, as a form (collective)."""
        v = fem.Function(self.space)
        v.x.array[self.dofs] = by / self.scale
        v.x.scatter_forward()
        return self.form(v)


def seen_in_cells(space: fem.FunctionSpace, datum: Datum, cells: npt.NDArray[np.int32], measures: Array) -> Seen:
    """The means of a datum over some owned cells with these measures; of a matrix those of its entries.

    The space is P0, that of a matrix for one.
    """
    size = int(np.prod(datum.shape, dtype=int))
    dofs = (size * cells[:, None] + np.arange(size)).ravel().astype(np.int32)
    dx = ufl.dx(degree=quadrature_degree(datum))
    return Seen(lambda v: ufl.inner(datum.ufl, v) * dx, space, dofs, np.repeat(measures, size))


def seen_in_points(
    mesh: dolfinx.mesh.Mesh, number: Expr, rule: tuple[Array, Array], scale: Array, degree: int | None = None
) -> Seen:
    """The values of a number or a matrix in points of the owned cells.

    Args:
        mesh: The mesh.
        number: It, in UFL.
        rule: The points on the reference cell and their weights.
        scale: The weights of the points in the cells, shape (cells, points) or any other of this size.
        degree: That of the rule, where forms with points of other rules may be added.
    """
    points, weights = rule
    element = basix.ufl.quadrature_element(mesh.basix_cell(), number.ufl_shape, points=points, weights=weights)
    space, size = fenicsx.function_space(mesh, element), int(np.prod(number.ufl_shape, dtype=int))
    dofs = size * cell_dofs(space).reshape(-1, 1) + np.arange(size)
    dx = ufl.dx(degree=degree)
    return Seen(lambda v: ufl.inner(number, v) * dx, space, dofs.ravel().astype(np.int32), np.repeat(scale, size))


def values_in(given: Any) -> Values:
    """The constants and functions in what was given, in dataclasses, mappings and sequences, with their values now."""
    if isinstance(given, Expr):
        terminals = [*extract_coefficients(given), *extract_constants(given)]
        return [(each, values_of(each).copy()) for each in terminals if isinstance(each, fem.Constant | fem.Function)]
    inner: Iterable[Any] = ()
    if isinstance(given, Mapping):
        inner = given.values()
    elif isinstance(given, list | tuple):
        inner = given
    elif is_dataclass(given) and not isinstance(given, TREES):
        inner = (getattr(given, each.name) for each in fields(given))
    return [pair for each in inner for pair in values_in(each)]


def values_of(control: Control) -> Array:
    """The values of a control on this rank."""
    return control.x.array if isinstance(control, fem.Function) else np.asarray(control.value)


def parts_of(form: Form) -> list[Form]:
    """A form as parts that DOLFINx compiles: on one mesh, as a stress has its own, and with one set of subdomains."""
    kinds: dict[tuple[Any, int], list[Any]] = {}
    for integral in form.integrals():
        kinds.setdefault((integral.ufl_domain(), id(integral.subdomain_data())), []).append(integral)
    return [Form(integrals) for integrals in kinds.values()]


def derivative_by(function: fem.Function, form: Form, entity_maps: Sequence[dolfinx.mesh.EntityMap]) -> fem.Function:
    """The derivative of a form by each coefficient of a function, as coefficients, ghosts updated (collective)."""
    derivative = fem.Function(function.function_space)
    for part in parts_of(form):
        if any(function is other for other in part.coefficients()):
            by_function = ufl.derivative(part, function, ufl.TestFunction(function.function_space))
            derivative.x.array[:] += assembled(by_function, entity_maps)
    derivative.x.scatter_forward()
    return derivative


def moments_seen(spaces: LinearTraces, datum: Datum, facets: BoundaryFacets, degree: int) -> Seen:
    """The moments ∫ d φ_a of a datum over facets, by a quadrature of this degree (collective)."""
    dofs = dofs_on_boundary(spaces, facets).ravel()
    return _seen(spaces, datum, facets, degree, spaces.on_boundary[0], dofs, np.ones(len(dofs)))


def dofs_on_boundary(spaces: LinearTraces, facets: BoundaryFacets) -> npt.NDArray[np.int32]:
    """The degrees of freedom of `on_boundary` at the vertices of facets, shape (facets, d)."""
    cells, corners = _on_boundary(spaces, facets)
    dofs: npt.NDArray[np.int32] = spaces.on_boundary[0].dofmap.list[cells]
    return np.take_along_axis(dofs, nearest(facets.vertices, corners), axis=1)


def values_seen(spaces: LinearTraces, datum: Datum, facets: BoundaryFacets, points: FacetPoints, degree: int) -> Seen:
    """The values of a datum in the points of a quadrature of this degree in facets (collective)."""
    boundary = spaces.on_boundary[0].mesh
    rule = {"points": points.points, "weights": points.weights}
    space = fenicsx.function_space(boundary, basix.ufl.quadrature_element(facet_type(spaces.dim), **rule))
    cells, corners = _on_boundary(spaces, facets)
    hats = np.column_stack([1 - points.points.sum(axis=1), points.points])
    dofs = np.take_along_axis(space.dofmap.list[cells], nearest(points.x, hats @ corners), axis=1).ravel()
    weights = facets.measure[:, None] * points.weights / points.weights.sum()
    return _seen(spaces, datum, facets, degree, space, dofs, weights.ravel())


def _on_boundary(spaces: LinearTraces, facets: BoundaryFacets) -> tuple[npt.NDArray[np.int32], Array]:
    """Facets as cells of the mesh of the boundary, with their vertices in the order that they have there."""
    space, entity_map = spaces.on_boundary
    boundary, dim = space.mesh, spaces.dim
    cells = np.arange(boundary.topology.index_map(dim - 1).size_local, dtype=np.int32)
    numbers = entity_map.sub_topology_to_topology(cells, inverse=False)
    of_facets = positions(numbers, facets.facets).astype(np.int32)
    nodes = dolfinx.mesh.entities_to_geometry(boundary, dim - 1, of_facets)
    return of_facets, boundary.geometry.x[nodes, :dim]


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
