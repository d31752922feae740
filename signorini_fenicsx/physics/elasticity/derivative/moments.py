"""What the elastic problem sees of data on the boundary: their moments ∫ d φ_a, and what it makes of these."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.datum import DEGREES, Datum, datum_of
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, linear_values
from signorini_fenicsx.discrete.seen import Seen
from signorini_fenicsx.discrete.vertex_laws import VertexLaws
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.physics.elasticity.discrete.data import DEGREE, ElasticData
from signorini_fenicsx.physics.elasticity.discrete.normal_laws import lines_by_data
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.discrete.vector_datum import PressureDatum
from signorini_fenicsx.physics.elasticity.problem import NORMAL, CoulombLaw, ElasticProblem, is_normal


@dataclass(frozen=True)
class Moments:
    """The moments of a datum over facets, and some numbers that are linear in them.

    Attributes:
        seen: The moments, facet by facet.
        places: Where the numbers are, shape (facets, n).
        matrices: What they are, shape (facets, n, d).
    """

    seen: Seen
    places: Indices
    matrices: Array

    def add(self, numbers: Array, changes: Array) -> None:
        """Add the change with these changes of the moments, in place."""
        moments = changes.reshape(len(self.places), self.matrices.shape[2])
        numbers[self.places] += np.einsum("nka,na->nk", self.matrices, moments)

    def sensitivities(self, by: Array) -> Array:
        """The derivatives of something by the moments, from those by the numbers."""
        derivatives: Array = np.einsum("nka,nk->na", self.matrices, by[self.places])
        return derivatives.ravel()


def on_boundary(
    spaces: ElasticSpaces, data: ElasticData, problem: ElasticProblem
) -> Iterator[tuple[str, str, Moments]]:
    """The moments of all data in UFL: what is made of them, their names, and they (collective).

    They make values of û ("lift"), its right side ("load"), and at the sites with friction bounds ("bound") and μ
    ("mu").

    Raises:
        InputError: If a bound of friction is not linear in x.
    """
    for number, (facets, k, letter) in enumerate(spaces.fixed):
        for r, component in enumerate(data.u_D.components):
            if letter in (NORMAL, AXES[r]):
                share = facets.normals[:, r] if letter == NORMAL else np.ones(len(facets.facets))
                matrices = share[:, None, None] * _to_values(facets)
                for part, moments in _of_datum(
                    spaces, component, facets, spaces.unknowns(facets, k).astype(np.int64), matrices
                ):
                    yield "lift", f"u_D.{number}.{r}.{part}", moments
    contact = spaces.contact
    normal = spaces.site_kinds["normal"]
    places = normal.rows_of(normal.unknown).astype(np.int64)
    matrices = np.eye(spaces.dim) / normal.rows_of(normal.measure)[:, :, None]
    for part, moments in _of_datum(spaces, data.gap, contact, places, matrices):
        yield "lift", f"gap.{part}", moments
    yield from _tractions(spaces, data)
    yield from _friction(spaces, problem)


def _tractions(spaces: ElasticSpaces, data: ElasticData) -> Iterator[tuple[str, str, Moments]]:
    """Moments of g_N, which make the right side (collective)."""
    facets, dim = spaces.neumann, spaces.dim
    plain = np.broadcast_to(np.eye(dim**2), (len(facets.facets), dim**2, dim**2)).copy()
    for framed, matrices in spaces.frames[1:]:
        listed = np.isin(framed.facets, facets.facets)
        plain[np.searchsorted(facets.facets, framed.facets[listed])] = matrices[listed]
    by_component = plain.reshape(-1, dim, dim, dim**2)  # from (a, r) to the unknowns
    last = np.full(len(facets.facets), -1)
    for index, name in enumerate(data.g_N):
        last[np.isin(facets.facets, spaces.domain.facets[name]) if name else slice(None)] = index
    places = facets.blocks[:, None].astype(np.int64) * dim**2 + np.arange(dim**2)
    for index, (name, datum) in enumerate(data.g_N.items()):
        rows = np.flatnonzero(last == index)
        if isinstance(datum, PressureDatum):
            loads = [(datum.pressure, -np.einsum("narj,nr->nja", by_component[rows], facets.normals[rows]))]
        else:
            each = enumerate(datum.components)
            loads = [(component, by_component[rows, :, r].transpose(0, 2, 1)) for r, component in each]
        for r, (component, matrices) in enumerate(loads):
            for part, moments in _of_datum(spaces, component, facets.take(rows), places[rows], matrices):
                yield "load", f"g_N.{name}.{r}.{part}", moments


def _friction(spaces: ElasticSpaces, problem: ElasticProblem) -> Iterator[tuple[str, str, Moments]]:
    """Moments of bounds of friction, and of μ (collective).

    Raises:
        InputError: If one is not linear in x.
    """
    rough = spaces.rough.facets
    order = np.argsort(rough)
    for index, law in enumerate(problem.laws):
        if is_normal(law):
            continue
        name = "mu" if isinstance(law, CoulombLaw) else "g"
        key = f"law.{index}.{name}"
        datum = datum_of(spaces, key, parsed(getattr(law, name), "xyz"[: spaces.dim], key))
        _check_linear(key, datum)
        for part in law.parts:
            facets = spaces.part(part)
            rows = order[np.searchsorted(rough, facets.facets, sorter=order)]
            places = spaces.dim * rows[:, None] + np.arange(spaces.dim)
            for _, moments in _of_datum(spaces, datum, facets, places, _to_values(facets)):
                yield "mu" if name == "mu" else "bound", f"{key}.{part}", moments


def of_laws(
    spaces: ElasticSpaces, laws: VertexLaws, segment: Indices, opening: Array
) -> Iterator[tuple[str, str, Moments]]:
    """The moments of the data of laws that are given in UFL, which move the lines of these segments (collective).

    They make what `lines_by_data` says, at the sites ("law").

    Args:
        spaces: The spaces.
        laws: The laws.
        segment: The segment of each facet vertex of Γ_C.
        opening: The opening there, in means.

    Raises:
        InputError: If a datum is not linear in x.
    """
    for part in laws.of_parts:
        moving = [name for name, datum in part.data.items() if datum.pieces is None]
        facets = spaces.contact.take(part.rows)
        places = spaces.dim * part.rows[:, None] + np.arange(spaces.dim)
        for name, lines in lines_by_data(spaces, part, moving, segment, opening):
            key, datum = part.key(name), part.data[name]
            _check_linear(key, datum)
            for number, moments in _of_datum(spaces, datum, facets, places, lines @ _to_values(facets)):
                yield "law", f"{key}.{number}", moments


def _check_linear(key: str, datum: Datum) -> None:
    """Refuse a datum in UFL that is not linear.

    Raises:
        InputError: If it is not.
    """
    if datum.pieces is None and datum.degree > 1:
        raise InputError(f"{key}: there are derivatives only if it is linear in x and y")


def _to_values(facets: BoundaryFacets) -> Array:
    """The matrices from moments to the values of linear functions at the vertices, shape (facets, d, d)."""
    dim = facets.vertices.shape[1]
    units = np.broadcast_to(np.eye(dim), (len(facets.facets), dim, dim))
    return linear_values(units, facets.measure)


def _of_datum(
    spaces: ElasticSpaces, datum: Datum, facets: BoundaryFacets, places: Indices, matrices: Array
) -> Iterator[tuple[int, Moments]]:
    """The moments of a datum over facets, part by part, if it is given in UFL (collective)."""
    for number, (chosen, own) in enumerate(datum.by_facets(facets.facets)):
        if own.pieces is None:
            yield (
                number,
                Moments(_seen(spaces, own, facets.take(np.flatnonzero(chosen))), places[chosen], matrices[chosen]),
            )


def _seen(spaces: ElasticSpaces, datum: Datum, facets: BoundaryFacets) -> Seen:
    """The moments of a datum over facets (collective)."""
    space, entity_map = spaces.on_boundary
    dim, topology = spaces.dim, spaces.mesh.topology
    boundary = space.mesh
    size = boundary.topology.index_map(dim - 1).size_local
    cells = np.arange(size, dtype=np.int32)
    numbers = entity_map.sub_topology_to_topology(cells, inverse=False)
    order = np.argsort(numbers)
    mine = order[np.searchsorted(numbers, facets.facets, sorter=order)].astype(np.int32)
    nodes = dolfinx.mesh.entities_to_geometry(boundary, dim - 1, mine)
    corners = boundary.geometry.x[nodes, :dim]
    nearest = np.square(facets.vertices[:, :, None] - corners[:, None]).sum(axis=3).argmin(axis=2)
    dofs = np.take_along_axis(space.dofmap.list[mine], nearest, axis=1).ravel()
    entities = fem.compute_integration_domains(fem.IntegralType.exterior_facet, topology, np.sort(facets.facets))
    degree = min(DEGREE + 1, DEGREES[1])
    ds = ufl.Measure("ds", domain=spaces.mesh, subdomain_data=[(1, entities)])(1, degree=degree)

    def form(v: Expr) -> Form:
        return datum.ufl * v * ds

    return Seen(form, space, dofs, np.ones(len(dofs)), [entity_map])
