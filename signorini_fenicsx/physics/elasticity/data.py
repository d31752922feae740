"""The data of an elastic contact problem as the discrete problem sees them: values in points, moments on facets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.data_values import check_means, check_nodes
from signorini_fenicsx.discrete.datum import DEGREES, Datum, datum_of, datum_on_parts, regional_datum
from signorini_fenicsx.discrete.points import CellPoints, in_facets
from signorini_fenicsx.discrete.seen import Values, values_in
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.physics.elasticity.friction import FrictionBounds, friction_bounds
from signorini_fenicsx.physics.elasticity.johnson_mercier import SIMPLEX, SplitQuadrature, split_vertices
from signorini_fenicsx.physics.elasticity.normal_laws import NormalLaws, normal_laws
from signorini_fenicsx.physics.elasticity.problem import NORMAL, ElasticProblem, Plane
from signorini_fenicsx.physics.elasticity.spaces import BoundaryFacets, ElasticSpaces, linear_values
from signorini_fenicsx.physics.elasticity.split_mesh import SplitMesh
from signorini_fenicsx.physics.elasticity.vector_datum import (
    PressureDatum,
    VectorDatum,
    vector_datum_of,
    vector_on_parts,
)

DEGREE, MOST = DEGREES
BLOCK = {2: 4096, 3: 512}
"""Cells, by dimension, whose values are held at a time: some tens of megabytes."""


@dataclass(frozen=True)
class ElasticData:
    """The data on a mesh.

    Attributes:
        f: Force.
        u_D: Displacement where it is given.
        g_N: Tractions and pressures, by the part where they are given; "" is everywhere.
        tractions: ∫ g_N φ_a over the facets of `spaces.neumann`, shape (facets, d, d).
        gap: g.
        laws: Contact, or other laws between the opening p = g − u_n and the pressure −σ_nn, on Γ_C.
        exact: u, where it is known.
        young: E.
        poisson: ν.
        in_space: Whether θ is ν/(1 + ν), as in space and for plane stress; otherwise it is ν.
        quadrature: What the discrete problem takes f, E and ν by.
        lift: û where it is given, g less p at the reference of its law in the normal component on Γ_C, `slipped` in
            the tangential one where there is friction, and 0 elsewhere: unknowns of this rank, ghosts too.
        load: ⟨g_N, q⟩ for each owned unknown, and the pressures at the references of the laws.
        fixed: Owned unknowns that are given.
        friction: Bounds of the shear; None without friction.
        slipped: u_t at the sites with friction at the end of the last step in time, 0 without one; the slip is what
            comes after it.
        given: The constants and functions in the data, with the values that they had.
    """

    f: VectorDatum
    u_D: VectorDatum
    g_N: Mapping[str, VectorDatum | PressureDatum]
    tractions: Array
    gap: Datum
    laws: NormalLaws
    exact: VectorDatum | None
    young: Datum
    poisson: Datum
    in_space: bool
    quadrature: SplitQuadrature
    lift: Array
    load: Array
    fixed: npt.NDArray[np.int32]
    friction: FrictionBounds | None
    slipped: Array
    given: Values = ()

    @property
    def uniform(self) -> bool:
        """Whether E and ν are numbers, perhaps one for each region."""
        return self.young.polynomial == 0 and self.poisson.polynomial == 0

    def points(self, spaces: ElasticSpaces, cells: npt.NDArray[np.int32]) -> CellPoints:
        """The points of the quadrature."""
        return CellPoints(spaces.mesh, cells, self.quadrature.points, self.quadrature.weights)

    def moduli(self, points: CellPoints) -> tuple[Array, Array]:
        """1/2μ and θ, shape (cells, points) (collective)."""
        young, poisson = self.young.values(points), self.poisson.values(points)
        return (1 + poisson) / young, poisson / (1 + poisson) if self.in_space else poisson

    def stiffness_of_volume(self, spaces: ElasticSpaces) -> float:
        """The largest λ/μ, without limit as ν → ½; in plane stress λ is that in the plane (collective)."""
        largest = 0.0
        for cells in blocks_of_cells(spaces):
            _, theta = self.moduli(self.points(spaces, cells))
            largest = max(largest, float((2 * theta / (1 - spaces.dim * theta)).max(initial=0.0)))
        return float(spaces.mesh.comm.allreduce(largest, MPI.MAX))

    def moments_of_f(self, spaces: ElasticSpaces, cells: npt.NDArray[np.int32], measure: Array) -> Array:
        """(f, φ_v) for the hats of the vertices of cells with these |T|, shape (cells, d + 1, d) (collective)."""
        subcells, number, _ = self.quadrature.hats.shape
        values = self.f.values(self.points(spaces, cells)).reshape(len(cells), subcells, number, spaces.dim)
        sums = np.einsum("nsqr,sqv,q->nvr", values, self.quadrature.hats, self.quadrature.weights, optimize=True)
        return measure[:, None, None] / subcells * np.take_along_axis(sums, spaces.order[cells][:, :, None], axis=1)

    def masses(self, spaces: ElasticSpaces, cells: npt.NDArray[np.int32], measure: Array) -> tuple[Array, Array]:
        """∫ φ_a φ_b/2μ and ∫ θ φ_a φ_b/2μ over the subcells of cells, see `compliance_product` (collective).

        Args:
            spaces: The spaces.
            cells: The cells.
            measure: Their |T|.
        """
        inverse, theta = self.moduli(self.points(spaces, cells))
        local, weights = self.quadrature.local, self.quadrature.weights
        size = local.shape[1]
        products = np.einsum("q,qa,qb->qab", weights, local, local)
        cell, subcell, vertex = (place[..., None] for place in spaces.as_dolfinx(cells))
        order = cell, subcell, vertex, vertex.swapaxes(2, 3)
        of_all, of_traces = (
            measure[:, None, None, None] / size * np.tensordot(values, products, 1)[order]
            for values in (inverse.reshape(-1, size, len(weights)), (inverse * theta).reshape(-1, size, len(weights)))
        )
        return of_all, of_traces


def blocks_of_cells(spaces: ElasticSpaces) -> Iterator[npt.NDArray[np.int32]]:
    """The owned cells, so many at a time and equally often on all ranks (collective)."""
    size = len(spaces.order)
    parts = max(spaces.mesh.comm.allreduce(-(-size // BLOCK[spaces.dim]), MPI.MAX), 1)
    yield from np.array_split(np.arange(size, dtype=np.int32), parts)


def elastic_data(spaces: ElasticSpaces, problem: ElasticProblem, slipped: Array | None = None) -> ElasticData:
    """Read the data and check them; in a step in time with the slip of the last step (collective).

    Raises:
        InputError: If something is not finite where it is needed, E ≤ 0 or ν not between −1 and ½ somewhere, or a
            region has no value; if plane stress is asked for in space.
    """
    dim = spaces.dim
    if dim == 3 and problem.plane != Plane.STRAIN:
        raise InputError(f"[problem] plane: a body in space is not in plane {problem.plane}; leave it out")
    f = vector_datum_of(spaces, "f", problem.f, continuous=False)
    _check_where_given(spaces, problem.u_D)
    u_D = vector_on_parts(spaces, "u_D", problem.u_D)
    g_N = _tractions_given(spaces, problem)
    gap = datum_on_parts(spaces, "gap", problem.gap)
    young = regional_datum(spaces, "young", parsed(problem.young, "xyz"[:dim], "[problem] young"))
    poisson = regional_datum(spaces, "poisson", parsed(problem.poisson, "xyz"[:dim], "[problem] poisson"))
    uniform = young.polynomial == 0 and poisson.polynomial == 0
    of_f = DEGREE if f.polynomial is None else f.polynomial
    quadrature = SplitQuadrature.of_degree(dim, min(max(2 if uniform else DEGREE, of_f + 1), MOST))
    lift = fem.Function(spaces.traces)
    load = la.vector(lift.function_space.dofmap.index_map, dim**2)
    laws = normal_laws(spaces, problem.normal)
    fixed = _set_given(spaces, u_D, gap, lift)
    lift.x.array[spaces.sites] -= laws.opening
    tractions = _traction_moments(spaces, g_N)
    _add_tractions(spaces, tractions, load)
    load.array[spaces.sites] -= spaces.site_measure * laws.pressure
    slipped = np.zeros(len(spaces.slip_sites)) if slipped is None else slipped
    lift.x.array[spaces.slip_sites] = slipped
    lift.x.scatter_forward()
    data = ElasticData(
        f=f,
        u_D=u_D,
        g_N=g_N,
        tractions=tractions,
        gap=gap,
        laws=laws,
        exact=None if problem.exact is None else vector_datum_of(spaces, "exact", problem.exact),
        young=young,
        poisson=poisson,
        in_space=problem.plane == Plane.STRESS or dim == 3,
        quadrature=quadrature,
        lift=lift.x.array.astype(np.float64),
        load=load.array,
        fixed=fixed,
        friction=friction_bounds(spaces, problem.laws),
        slipped=slipped,
        given=values_in(problem),
    )
    _check_cells(spaces, data)
    return data


def _check_where_given(spaces: ElasticSpaces, u_D: Any) -> None:
    """Refuse a displacement for a part on which none is given.

    Raises:
        InputError: If there is one.
    """
    boundary = spaces.boundary
    free = {part for part in (*boundary.contact, *boundary.neumann) if part not in boundary.fixed}
    for part in [part for part in u_D if part in free] if isinstance(u_D, Mapping) else []:
        what = "in contact" if part in boundary.contact else "in neumann"
        raise InputError(f"[problem] u_D.{part}: no displacement is given on this part, it is {what}")


def _check_cells(spaces: ElasticSpaces, data: ElasticData) -> None:
    """Make sure of f, E and ν in the points of the quadrature (collective)."""
    force, low, high, stiff, soft = 0.0, np.inf, -np.inf, np.inf, -np.inf
    for cells in blocks_of_cells(spaces):
        points = data.points(spaces, cells)
        young, poisson = (np.nan_to_num(datum.values(points), nan=-np.inf) for datum in (data.young, data.poisson))
        force = max(force, float(np.nan_to_num(abs(data.f.values(points)), nan=np.inf, posinf=np.inf).max(initial=0.0)))
        stiff, soft = min(stiff, float(young.min(initial=np.inf))), max(soft, float(young.max(initial=-np.inf)))
        low, high = min(low, float(poisson.min(initial=np.inf))), max(high, float(poisson.max(initial=-np.inf)))
    comm = spaces.mesh.comm
    check_means("f", "in the domain", np.array([force]), spaces)
    ends = np.array([stiff, low, -high, -soft])
    comm.Allreduce(MPI.IN_PLACE, ends, MPI.MIN)
    stiff, low, high, soft = ends[0], ends[1], -ends[2], -ends[3]
    if not (stiff > 0 and soft < np.inf):
        raise InputError(f"[problem] young: must be positive and finite everywhere; its smallest value is {stiff:.3g}")
    check_means("young", "in the domain", np.array([stiff, soft]), spaces)
    if not (low > -1 and high < 0.5):
        wrong = low if not low > -1 else high
        raise InputError(f"[problem] poisson: must be between -1 and 1/2, without these; it is {wrong:.6g} somewhere")


def moduli_on_split(
    spaces: ElasticSpaces, data: ElasticData, split: SplitMesh, degree: int
) -> tuple[tuple[fem.Function, fem.Function], ufl.Measure]:
    """2μ and θ in the points of a quadrature, and the measure that takes them there (collective).

    Args:
        spaces: The spaces.
        data: The data.
        split: The split mesh, or a part of it.
        degree: For which the quadrature is exact; at least that of the data.
    """
    mesh, dim = split.mesh, spaces.dim
    rule = SplitQuadrature.of_degree(dim, max(degree, data.quadrature.degree))
    element = basix.ufl.quadrature_element(mesh.basix_cell(), degree=rule.degree, scheme="default")
    space = fenicsx.function_space(mesh, element)
    mu2, theta = fem.Function(space), fem.Function(space)
    for block in blocks_of_cells(spaces):
        cells = block[split.cells[block, 0] >= 0]
        shape = len(cells), dim + 1, len(rule.weights)
        order = spaces.order[cells]
        points = CellPoints(spaces.mesh, cells, rule.points, rule.weights)
        there = points.x.reshape(*shape, dim)
        there = np.take_along_axis(there, order[:, :, None, None], axis=1)
        here = np.einsum("qa,nsai->nsqi", rule.local, split_vertices(spaces.vertices[cells]))
        nearest = np.square(here[:, :, :, None] - there[:, :, None]).sum(axis=4).argmin(axis=3)
        dofs = space.dofmap.list[split.cells[cells]]
        for function, values in zip((mu2, theta), data.moduli(points), strict=True):
            by_subcell = np.take_along_axis(values.reshape(shape), order[:, :, None], axis=1)
            function.x.array[dofs] = np.take_along_axis(by_subcell, nearest, axis=2)
    mu2.x.array[:] = 1 / mu2.x.array
    metadata = {"quadrature_degree": rule.degree, "quadrature_scheme": "default"}
    return (mu2, theta), ufl.Measure("dx", domain=mesh, metadata=metadata)


def facet_rule(dim: int, degree: int) -> tuple[Array, Array]:
    """Points and weights of the reference facet, exact for hats times a polynomial of this degree."""
    points, weights = basix.make_quadrature(SIMPLEX[dim - 1], min(degree + 1, MOST))
    return points, weights


def facet_moments(
    spaces: ElasticSpaces, name: str, datum: Datum | VectorDatum | PressureDatum, facets: BoundaryFacets, where: str
) -> Array:
    """∫ value φ_a over facets (collective).

    Raises:
        InputError: If the values are not finite, or of no usable size.
    """
    degree = DEGREE if datum.polynomial is None else datum.polynomial
    points = in_facets(spaces.mesh, facets.facets, *facet_rule(spaces.dim, degree))
    values = datum.values(points)
    check_means(name, where, values, spaces)
    return facets.moments(values, points.points, points.weights)


def _set_given(spaces: ElasticSpaces, u_D: VectorDatum, gap: Datum, lift: fem.Function) -> npt.NDArray[np.int32]:
    """Write what û is where it is given, or g on Γ_C; returns the unknowns that are given (collective)."""
    unknowns = []
    for facets, k, letter in spaces.fixed:
        moments = facet_moments(spaces, "u_D", u_D, facets, "where the displacement is given")
        values = linear_values(moments, facets.measure)
        along = np.einsum("nar,nr->na", values, facets.normals) if letter == NORMAL else values[..., AXES.index(letter)]
        places = spaces.unknowns(facets, k)
        lift.x.array[places] = along
        unknowns.append(places.ravel())
    check_nodes(spaces, "gap", gap, spaces.contact.facets, "on Γ_C")
    moments = facet_moments(spaces, "gap", gap, spaces.contact, "on Γ_C")
    lift.x.array[spaces.sites] = moments.ravel() / spaces.site_measure
    return np.concatenate(unknowns)


def _tractions_given(spaces: ElasticSpaces, problem: ElasticProblem) -> dict[str, VectorDatum | PressureDatum]:
    """The tractions and pressures by part (collective).

    Raises:
        InputError: If a text cannot be read, a part is unknown, or it has both.
    """
    by_part = problem.g_N if isinstance(problem.g_N, Mapping) else {"": problem.g_N} if problem.g_N is not None else {}
    found: dict[str, VectorDatum | PressureDatum] = {
        part: vector_datum_of(spaces, f"g_N.{part}".rstrip("."), each) for part, each in by_part.items()
    }
    for part, given in problem.pressure.items():
        name = f"pressure.{part}"
        if part in found or "" in found:
            raise InputError(f"[problem] {name}: a traction g_N is given there, too; give one of them, by part")
        _check_loaded(spaces, "pressure", part)
        datum = datum_of(spaces, name, parsed(given, "xyz"[: spaces.dim], f"[problem] {name}"))
        found[part] = PressureDatum(name, datum, spaces.part(part).normals)
    return found


def _check_loaded(spaces: ElasticSpaces, key: str, part: str) -> None:
    """Refuse a load on a part that is not in Γ_N.

    Raises:
        InputError: If it is not.
    """
    known = [*spaces.boundary.neumann, *spaces.boundary.fixed]
    if part not in known:
        where = f"only on {', '.join(known)}" if known else "as no part is in Γ_N"
        raise InputError(f"[problem] {key}: no traction is given on part '{part}', {where}")


def _traction_moments(spaces: ElasticSpaces, g_N: Mapping[str, VectorDatum | PressureDatum]) -> Array:
    """∫ g_N φ_a over the facets of `spaces.neumann`; 0 on parts without one (collective).

    Raises:
        InputError: If σn is given on no such part.
    """
    facets = spaces.neumann
    moments = np.zeros((len(facets.facets), spaces.dim, spaces.dim))
    for name, datum in g_N.items():
        if name:
            _check_loaded(spaces, "g_N", name)
        part = spaces.part(name) if name else facets
        here = np.searchsorted(facets.facets, part.facets)
        moments[here] = facet_moments(spaces, datum.name, datum, part, "where the traction is given")
    return moments


def _add_tractions(spaces: ElasticSpaces, moments: Array, load: la.Vector) -> None:
    """⟨g_N, q⟩ on Γ_N and on parts that are fixed in some components, each for its own unknowns."""
    by_block = load.array.reshape(-1, spaces.dim**2)
    by_block[spaces.neumann.blocks] = moments.reshape(-1, spaces.dim**2)
    for part, matrices in spaces.frames[1:]:
        by_block[part.blocks] = np.einsum("nij,ni->nj", matrices, by_block[part.blocks])
