"""What quadrature may miss of loads that are texts.

Let p be the polynomial near a load g on a simplex, a subcell or a facet, that has the moments of g by the quadrature of
the data: quadratic on subcells, cubic on facets. Its moments are those that σ_h balances, and `oscillation` counts it
and ‖g − p‖_Q. With d = g − p, `expressions.enclosures` has bounds of ‖d‖ and of ‖Π₁d‖, Π₁ the projection to linear
fields on the simplex. d − Π₁d is orthogonal to linear fields as what is counted is, so only ‖d‖ − ‖d‖_Q is missing
there. Π₁d is a load that nothing balances: `body` bounds what all of them do together. If g is within ρ of a
polynomial of degree K on the simplex S, then ‖d‖ ≤ ‖d‖_Q + 2ρ|S|^½ and ‖Π₁d‖ ≤ 2ρ|S|^½, as p has the moments by
quadrature. Where this is too much S is cut, see `means`.

*Friction.* The discrete problem has linear bounds ĝ of the shear on facets in the place of g, and |y_t| ≤ ĝ. On each
facet let g̃ be ĝ or max(g, ĝ): y is admissible for the problem with g̃, too. Let ũ be its solution. With g̃ in the gap
the identity of `forms/elasticity.py` bounds |v − ũ|, and for u lacks at most ∫|g − g̃| |w_t|, w = u − v, on both sides
where two bodies touch, as g|u_t| + y_t·u_t ≥ (g − g̃)|u_t| and g̃|v_t| + σ_t·v_t ≥ (g̃ − g)|v_t|. So |g − g̃| adds like a
load. With g̃ = ĝ this is |g − ĝ|. With g̃ = max(g, ĝ) it is (ĝ − g)₊ alone, which is small, and the gap is larger by at
most ‖g − ĝ‖_e ‖v_t‖_e, which is 0 where v sticks. In steps of time u_t and v_t are less the last slip.

For facets of weights ρ_e, C of `body` and t_T of `korn`, a_T the largest eigenvalue of 𝔸,

    Σ ρ_e ‖w‖_e² = Σ ρ_e (‖Π₁w‖_e² + ‖w − Π₁w‖_e²) ≤ (C² + max_T a_T Σ_e⊂T ρ_e t_T²) |w|²,

so the load adds at most the root of this factor times (Σ ‖g − g̃‖_e²/ρ_e)^½. Good weights are like the load.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import basix
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices, Mask, positions
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.base.tolerances import ROUNDING
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.lattices import lagrange, lattice
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, blocks_of_cells
from signorini_fenicsx.discrete.points import CellPoints, in_facets
from signorini_fenicsx.discrete.vectors import PressureDatum, VectorDatum
from signorini_fenicsx.expressions import Tree, is_polynomial
from signorini_fenicsx.expressions.enclosures import distances, means, ranges
from signorini_fenicsx.expressions.products import SMALLEST
from signorini_fenicsx.expressions.series import DEGREE as OF_SERIES
from signorini_fenicsx.expressions.simplices import Parts, Quadratic, barycentric, barycentric_gradients, through
from signorini_fenicsx.physics.elasticity.bound.body import constant_of_body, constant_of_facets, length_of_facets
from signorini_fenicsx.physics.elasticity.bound.korn import korn_constants, trace_constants
from signorini_fenicsx.physics.elasticity.bound.local_fields import INSIDE, ON_FACETS
from signorini_fenicsx.physics.elasticity.bound.resolution import Resolution
from signorini_fenicsx.physics.elasticity.discrete.data import DEGREE, LARGEST_DEGREE, ElasticData
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells, SplitQuadrature, split_vertices
from signorini_fenicsx.physics.elasticity.discrete.on_facets import facet_rule
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces

MUCH = 0.5
"""If what may be missed is more than this share of the bound, loads are not resolved."""
SHARE = 0.03
"""Enclosures stop where what may be missed is about this share of the bound."""
ALONG = 1e-10
"""A direction with less than this left is one in which u is given."""
AGAINST_LOADS = (0.0, 1 / 16, 1 / 4, 1.0, 4.0, 16.0, 1e9)
"""max(g, ĝ) is in the gap of a facet if so many times what this adds is at most the load squared; the best counts."""
LEAST_WEIGHT = 0.01
"""What is added to weights of facets, whose largest is 1."""
HALVINGS = 5
"""Parts of facets on which ĝ − g may be large are halved so often."""


def is_enclosed(datum: VectorDatum | PressureDatum) -> bool:
    """Whether a load is known as texts, some of which are no polynomials that quadrature integrates exactly."""
    is_text = all(scalar.pieces is not None for scalar in datum.scalars)
    return is_text and (datum.polynomial is None or datum.polynomial > LARGEST_DEGREE // 2)


def loads_of(spaces: ElasticSpaces, data: ElasticData) -> list[tuple[BoundaryFacets, VectorDatum | PressureDatum]]:
    """All tractions, each with its facets."""
    loads = [(spaces.part(name) if name else spaces.neumann, datum) for name, datum in data.g_N.items()]
    return [*loads, *((pull.facets, pull.datum) for pull in data.pulls)]


def fit(basis: Array, weights: Array) -> Array:
    """The matrix from values in points to the coefficients of their best approximation, shape (basis, points)."""
    weighted = weights[:, None] * basis
    return np.linalg.solve(basis.T @ weighted, weighted.T)


@dataclass
class _Enclosures:
    """Enclosures of d of one load on simplices, which come in blocks.

    Attributes:
        spaces: The spaces.
        datum: The load.
        degree: That of p.
        enough: Root mean square of a load that is small.
        squares: Mean squares of d by quadrature, and bounds of those of d and of Π₁d, for each block (simplices, 3).
        rough: By scalar and piece the numbers of simplices to be cut, their vertices, and p there.
    """

    spaces: ElasticSpaces
    datum: VectorDatum | PressureDatum
    degree: int
    enough: float
    squares: list[Array] = field(default_factory=list)
    rough: dict[tuple[int, int], list[tuple[Indices, Array, Array]]] = field(default_factory=dict)

    def trees(self, scalar: int, cells: AnyIndices) -> Iterator[tuple[int, Tree, Indices]]:
        """The trees of a scalar that quadrature does not integrate exactly, each with its rows of some cells."""
        for number, (tree, rows) in enumerate(self.datum.scalars[scalar].trees_in(cells)):
            if not is_polynomial(tree, OF_SERIES):
                yield number, tree, rows

    def add(self, cells: AnyIndices, vertices: Array, near: Array, seen: Array, acting: Mask | None = None) -> None:
        """Look at simplices, and keep those that have to be cut.

        Args:
            cells: The owned cell of each.
            vertices: Shape (n, k + 1, d).
            near: p in the lattice, shape (n, points, scalars).
            seen: The mean squares of d by quadrature, shape (n, scalars).
            acting: Which scalars count, shape (n, scalars); None for all.
        """
        acting = np.ones(seen.shape, dtype=bool) if acting is None else acting
        seen = np.where(acting, seen, 0.0)
        limit = self.enough / math.sqrt(seen.shape[1])
        begin = sum(map(len, self.squares))
        bounds = np.stack([seen.sum(axis=1), seen.sum(axis=1), np.zeros(len(cells))], axis=1)
        for scalar in range(seen.shape[1]):
            for number, tree, rows in self.trees(scalar, cells):
                rows = rows[acting[rows, scalar]]
                rho = 2 * distances(tree, vertices[rows], self.spaces.frame, np.full(len(rows), limit / 2))
                fine = rho <= limit
                root, rho, chosen = np.sqrt(seen[rows[fine], scalar]), rho[fine], rows[fine]
                bounds[chosen, 1] += rho * (2 * root + rho)
                bounds[chosen, 2] += rho**2
                chosen = rows[~fine]
                bounds[chosen, 1] -= seen[chosen, scalar]
                kept = begin + chosen, vertices[chosen], near[chosen, :, scalar]
                self.rough.setdefault((scalar, number), []).append(kept)
        self.squares.append(bounds)

    def roots(self) -> Array:
        """Roots of the mean squares, after cuts, shape (3, simplices) (collective)."""
        bounds, comm = np.concatenate(self.squares), self.spaces.mesh.comm
        for scalar in range(len(self.datum.scalars)):
            for number, tree, _ in self.trees(scalar, np.arange(0)):
                rows, vertices, near = map(np.concatenate, zip(*self.rough[scalar, number], strict=True))
                limit = self.enough / math.sqrt(len(self.datum.scalars))
                weight = np.full(len(rows), 1 / (limit**2 * max(comm.allreduce(len(rows)), 1)))
                nodes = lattice(vertices.shape[1], self.degree)[:, 1:] / self.degree
                p = through(vertices, nodes, near, self.degree)
                cut = means(tree, vertices, p, self.spaces.frame, weight, linear=True)
                bounds[rows, 1] += cut.norm**2
                bounds[rows, 2] += cut.linear**2
        return np.sqrt(np.maximum(bounds, 0.0)).T


@dataclass(frozen=True)
class _Missed:
    """What may be missed of one load, per owned cell.

    Attributes:
        name: Its name.
        beyond: By how much (d, w) may be larger than what is counted, beside ‖ε(w)‖_T.
        linear: ‖Π₁d‖² on the cell, or over l on its facets, see `body`.
        measure: |T|, or l times the measure of these facets.
    """

    name: str
    beyond: Array
    linear: Array
    measure: Array


def missed(resolution: Resolution, compliance: Array, counted: Array) -> tuple[Array, float]:
    """What may be missed of all loads: more of the oscillation of the owned cells, and of the bound (collective).

    If this is much beside what is counted, it is 0, and recorded that the loads are not resolved.

    Args:
        resolution: Of the data.
        compliance: On each owned cell a matrix that is at least 𝔸 there, shape (cells, entries, entries).
        counted: What each of these adds to the bound besides.
    """
    spaces, data, comm = resolution.spaces, resolution.data, resolution.spaces.mesh.comm
    tractions = [(facets, datum) for facets, datum in loads_of(spaces, data) if is_enclosed(datum)]
    if not (tractions or is_enclosed(data.f)) or resolution.no_constant:
        return np.zeros_like(counted), 0.0
    loaded = np.zeros((len(counted), spaces.dim + 1), dtype=bool)
    for facets, _ in tractions:
        loaded[facets.cells, facets.local] = True
    of_body = constant_of_body(spaces, compliance, loaded)
    if not math.isfinite(of_body):
        resolution.no_constant = "as no constant of Korn was found for the body"
        return np.zeros_like(counted), 0.0
    bound = math.sqrt(comm.allreduce(float((counted**2).sum())))
    enough = max(SHARE * bound / of_body, SMALLEST)
    of_each = [_of_force(spaces, data, enough / spaces.length ** (spaces.dim / 2))] if is_enclosed(data.f) else []
    for facets, datum in tractions:
        share = length_of_facets(spaces) / max(comm.allreduce(float(facets.measure.sum())), SMALLEST)
        of_each.append(_of_traction(spaces, data, facets, datum, enough * math.sqrt(share)))
    beyond = np.sqrt(np.linalg.eigvalsh(compliance)[:, -1]) * sum(each.beyond for each in of_each)
    sums = comm.allreduce(np.array([(beyond**2).sum(), *(each.linear.sum() for each in of_each)]))
    together = of_body * float(np.sqrt(sums[1:]).sum())  # several loads may be on one facet
    if math.sqrt(sums[0]) + together <= MUCH * bound:
        resolution.linear = np.sum([np.sqrt(each.linear * each.measure) for each in of_each], axis=0)
        return beyond, together
    of_loads = [np.nan_to_num(each.beyond**2 + of_body**2 * each.linear, nan=np.inf) for each in of_each]
    most = comm.allreduce(max(each.max(initial=0.0) for each in of_loads), MPI.MAX)
    for each, sizes in zip(of_each, of_loads, strict=True):
        resolution.note(each.name, (sizes >= most / 4) & (sizes > 0))
    return np.zeros_like(counted), 0.0


def force_near(
    spaces: ElasticSpaces, data: ElasticData, numbers: npt.NDArray[np.int32]
) -> tuple[SplitQuadrature, Array, Array]:
    """The quadratics near f on the subcells of some owned cells (collective).

    Returns:
        The quadrature; the quadratics in the lattices of the subcells, shape (cells, d + 1, points, d); and the mean
        squares of what is left by this quadrature, shape (cells, d + 1, d).
    """
    dim, degree = spaces.dim, data.quadrature.degree
    if not is_enclosed(data.f):
        degree = max(degree, degree_of_square(data.f, degree), 2 * ON_FACETS)
    rule = SplitQuadrature.of_degree(dim, degree)
    points = CellPoints(spaces.mesh, numbers, rule.points, rule.weights)
    values = data.f.values(points).reshape(len(numbers), dim + 1, len(rule.weights), dim)
    basis = lagrange(rule.local, INSIDE)
    near = np.einsum("nsqi,aq->nsai", values, fit(basis, rule.weights))
    rest = values - np.einsum("qa,nsai->nsqi", basis, near)
    return rule, near, np.einsum("q,nsqi->nsi", rule.weights, rest**2)


def without_given(spaces: ElasticSpaces, part: BoundaryFacets, values: Array) -> Array:
    """Tractions on a part without their components along which u is given there, shape (facets, points, d)."""
    values = values.copy()
    for fixed, _, directions, _ in spaces.fixed[spaces.dim :]:
        rows = np.flatnonzero(np.isin(part.facets, fixed.facets))
        axes = directions[positions(fixed.facets, part.facets[rows])]
        values[rows] -= np.einsum("nqj,nj,ni->nqi", values[rows], axes, axes)
    return values


def traction_rule(data: ElasticData, dim: int, datum: VectorDatum | PressureDatum) -> tuple[Array, Array]:
    """The hats in the points of a quadrature on facets for a traction, and its weights, whose sum is 1."""
    if is_enclosed(datum):
        points, weights = facet_rule(dim, DEGREE if datum.polynomial is None else datum.polynomial)
    else:
        least = max(data.quadrature.degree, 2 * ON_FACETS)
        points, weights = basix.make_quadrature(SIMPLEX[dim - 1], max(degree_of_square(datum, least), least))
    return points, weights / weights.sum()


def degree_of_square(datum: VectorDatum | PressureDatum, otherwise: int) -> int:
    """Degree of a quadrature that is exact for the square of a datum, if there is one."""
    return otherwise if datum.polynomial is None else min(2 * datum.polynomial, LARGEST_DEGREE)


def _of_force(spaces: ElasticSpaces, data: ElasticData, enough: float) -> _Missed:
    """What may be missed of f (collective)."""
    size, enclosures = spaces.dim + 1, _Enclosures(spaces, data.f, INSIDE, enough)
    for numbers in blocks_of_cells(spaces.mesh):
        _, near, seen = force_near(spaces, data, numbers)
        vertices = split_vertices(corners(spaces.mesh, numbers)).reshape(-1, size, spaces.dim)
        near, seen = (each.reshape(len(vertices), *each.shape[2:]) for each in (near, seen))
        enclosures.add(np.repeat(numbers, size), vertices, near, seen)
    squares = np.square(enclosures.roots()).reshape(3, -1, size).mean(axis=2)
    seen, norm, linear = np.sqrt(squares * spaces.cell_measures)
    constants = korn_constants(Cells(spaces.vertices).derivative)
    return _Missed(data.f.name, constants * np.maximum(norm - seen, 0.0), linear**2, spaces.cell_measures)


def _of_traction(
    spaces: ElasticSpaces, data: ElasticData, facets: BoundaryFacets, datum: VectorDatum | PressureDatum, enough: float
) -> _Missed:
    """What may be missed of a traction on some facets (collective)."""
    points, weights = traction_rule(data, spaces.dim, datum)
    basis = lagrange(np.column_stack([1 - points.sum(axis=1), points]), ON_FACETS)
    at = in_facets(spaces.mesh, facets.facets, points)
    values = np.stack([scalar.values(at) for scalar in datum.scalars], axis=2)
    near = np.einsum("nqi,aq->nai", values, fit(basis, weights))
    enclosures = _Enclosures(spaces, datum, ON_FACETS, enough)
    squares = np.einsum("q,nqi->ni", weights, (values - basis @ near) ** 2)
    directions = np.broadcast_to(datum.directions, (*squares.shape, spaces.dim))
    acting = np.linalg.norm(without_given(spaces, facets, directions), axis=2) > ALONG
    enclosures.add(facets.cells, at.vertices, near, squares, acting)
    seen, norm, linear = enclosures.roots() * np.sqrt(facets.measure)
    constants = trace_constants(Cells(spaces.vertices[facets.cells]).derivative, facets.measure)
    length = length_of_facets(spaces)
    columns = constants * np.maximum(norm - seen, 0.0), linear**2 / length, length * facets.measure
    return _Missed(datum.name, *(np.bincount(facets.cells, each, len(spaces.order)) for each in columns))


def friction_missed(
    resolution: Resolution, compliance: Array, slips: Array, squares: Array, oscillation: Array
) -> tuple[Array, Array]:
    """Twice the gap and the oscillation per owned cell with what texts for g of friction add (collective).

    The oscillation is infinite if nothing is known. Where g may be negative it is recorded that g is not resolved.

    Args:
        resolution: Of the data.
        compliance: As in `missed`.
        slips: ‖v_t‖ less the last slip on the facets with friction.
        squares: Twice the gap without this.
        oscillation: The oscillation without this.
    """
    spaces, data = resolution.spaces, resolution.data
    off, above = np.zeros((2, len(spaces.rough.facets)))
    for name, datum, rows in data.friction.texts:
        facets, bound = spaces.rough.take(rows), data.friction.bound[rows]
        resolution.note(name, _maybe_negative(spaces, datum, facets, bound))
        off[rows] = off_linear(spaces, datum, facets, bound)
        above[rows] = np.minimum(off[rows], _above(spaces, datum, facets, bound, off[rows]))
    comm, least, best = spaces.mesh.comm, math.inf, (squares, np.full_like(oscillation, np.inf))
    known = comm.allreduce(bool(np.isfinite(off).all()), MPI.LAND)
    for loads in (_RubbingLoads.of(spaces, compliance, like) for like in (off, above) if known):
        for times in AGAINST_LOADS if math.isfinite(loads.constant) else ():
            in_gap = 2 * off * slips * times <= loads.sizes(off)
            of_gap = squares + np.bincount(spaces.rough.cells, np.where(in_gap, 2 * off * slips, 0.0), len(squares))
            of_loads = loads.added(np.where(in_gap, above, off), oscillation)
            sums = comm.allreduce(np.array([of_gap.sum(), (of_loads**2).sum()]))
            found = float(np.sqrt(np.maximum(sums, 0.0)).sum())
            if found < least:
                least, best = found, (of_gap, of_loads)
    return best


@dataclass(frozen=True)
class _RubbingLoads:
    """Loads |r| ≤ d on the facets with friction, where two bodies touch on both sides.

    Attributes:
        spaces: The spaces.
        constant: Bound of (Σ ρ‖w‖_e²)^½ beside |w|.
        weights: ρ, for each facet with friction.
        cells: The cell of each facet, then those on the other sides.
        rows: Which facets with friction these are.
    """

    spaces: ElasticSpaces
    constant: float
    weights: Array
    cells: Indices
    rows: Indices

    @classmethod
    def of(cls, spaces: ElasticSpaces, compliance: Array, like: Array) -> "_RubbingLoads":
        """The loads that are like these ‖d‖, of which the root mean squares on facets are the weights (collective)."""
        comm, weights = spaces.mesh.comm, like / np.sqrt(spaces.rough.measure)
        most = comm.allreduce(weights.max(initial=0.0), MPI.MAX)
        weights = weights / max(most, SMALLEST) + LEAST_WEIGHT
        touching = np.flatnonzero(np.isin(spaces.inner.rows, spaces.rough_rows))
        across = spaces.across.take(touching)
        opposite = np.searchsorted(spaces.rough_rows, spaces.inner.rows[touching])
        cells = np.append(spaces.rough.cells, across.cells).astype(np.int64)
        rows = np.append(np.arange(len(weights)), opposite)
        of_facets = np.zeros((len(spaces.order), spaces.dim + 1))
        of_facets[cells, np.append(spaces.rough.local, across.local)] = weights[rows]
        constants = trace_constants(Cells(spaces.vertices[cells]).derivative, spaces.rough.measure[rows])
        rest = np.bincount(cells, weights[rows] * constants**2, len(compliance)) * np.linalg.eigvalsh(compliance)[:, -1]
        most = comm.allreduce(rest.max(initial=0.0), MPI.MAX)
        of_body = constant_of_facets(spaces, compliance, of_facets)
        return cls(spaces, math.hypot(of_body, math.sqrt(most)), weights, cells, rows)

    def sizes(self, load: Array) -> Array:
        """The square of what each adds alone, from ‖d‖."""
        return np.asarray((self.constant * load) ** 2 / self.weights)

    def added(self, load: Array, oscillation: Array) -> Array:
        """The oscillation of the owned cells with these ‖d‖ (collective)."""
        of_loads = np.bincount(self.cells, self.sizes(load)[self.rows], len(oscillation))
        sums = np.sqrt(self.spaces.mesh.comm.allreduce(np.array([(oscillation**2).sum(), of_loads.sum()])))
        return np.asarray(np.sqrt(oscillation**2 + of_loads * (1 + 2 * sums[0] / max(sums[1], SMALLEST))))


def _above(spaces: ElasticSpaces, datum: Datum, facets: BoundaryFacets, bound: Array, off: Array) -> Array:
    """‖(ĝ − g)₊‖ on facets, as narrowly as is needed beside `off`, which is ‖g − ĝ‖ (collective)."""
    gradient = np.einsum("na,nai->ni", bound, barycentric_gradients(facets.vertices))
    enough = np.maximum(SHARE * off / np.sqrt(facets.measure), _rounding(spaces, bound))
    parts, squares = Parts(facets.vertices, np.arange(len(bound)), np.ones(len(bound))), np.zeros(len(bound))
    for level in range(HALVINGS + 1):
        arms = parts.vertices.mean(axis=1) - facets.vertices.mean(axis=1)[parts.simplex]
        middle = bound.mean(axis=1)[parts.simplex] + np.einsum("ni,ni->n", gradient[parts.simplex], arms)
        linear = Quadratic(middle, gradient[parts.simplex], np.zeros((len(middle), spaces.dim, spaces.dim)))
        excess, cells = np.zeros(len(middle)), facets.cells[parts.simplex]
        for tree, rows in datum.trees_in(cells):
            some = parts.simplex[rows]
            least = ranges(tree, parts.vertices[rows], linear.of(rows), spaces.frame, -enough[some], np.inf).lo
            excess[rows] = np.maximum(-least, 0.0)
        done = (excess <= enough[parts.simplex]) | (level == HALVINGS)
        squares += np.bincount(parts.simplex[done], (parts.share * excess**2)[done], len(bound))
        parts = parts.take(~done).halves()
    return np.sqrt(facets.measure * squares)


def _maybe_negative(spaces: ElasticSpaces, datum: Datum, facets: BoundaryFacets, bound: Array) -> Mask:
    """The owned cells on whose facets a text is not proved to be ≥ 0, but for rounding (collective)."""
    found = np.zeros(len(spaces.order), dtype=bool)
    low = -_rounding(spaces, bound)
    for tree, rows in datum.trees_in(facets.cells):
        least = ranges(tree, facets.vertices[rows], None, spaces.frame, low, np.inf).lo
        found[facets.cells[rows[~(least >= low)]]] = True
    return found


def _rounding(spaces: ElasticSpaces, bound: Array) -> float:
    """What is rounding in a bound of friction (collective)."""
    return ROUNDING * spaces.mesh.comm.allreduce(float(bound.max(initial=0.0)), MPI.MAX)


def off_linear(spaces: ElasticSpaces, datum: Datum, facets: BoundaryFacets, bound: Array) -> Array:
    """‖g − ĝ‖ on facets from the values of ĝ at their vertices, at most (collective)."""
    vector = VectorDatum("g", (datum,))
    points, weights = facet_rule(spaces.dim, DEGREE)  # exact for the square of what has degree 4, see `trees`
    at = in_facets(spaces.mesh, facets.facets, points)
    rest = datum.values(at) - np.einsum("nqa,na->nq", barycentric(facets.vertices, at.x), bound)
    seen = rest**2 @ (weights / weights.sum())
    sizes = np.array([seen.sum(), len(seen)])
    spaces.mesh.comm.Allreduce(MPI.IN_PLACE, sizes)
    enough = max(SHARE * math.sqrt(sizes[0] / max(sizes[1], 1.0)), SMALLEST)
    enclosures = _Enclosures(spaces, vector, ON_FACETS, enough)
    near = (bound @ (lattice(spaces.dim, ON_FACETS) / ON_FACETS).T)[..., None]
    enclosures.add(facets.cells, facets.vertices, near, seen[:, None])
    return np.asarray(enclosures.roots()[1] * np.sqrt(facets.measure))
