"""Stresses of Johnson and Mercier as real numbers: symmetric, with continuous tractions, in balance with moments.

A stress y of this element, see `forms/elasticity.py`, is given by its tractions at the vertices of facets and the
moments of its load. With q = |e| yn for the facet e_i opposite to vertex i it is y∇λ_i = −q/(d|T|), as n = −∇λ_i
|T|d/|e|. On a cell y = FŷFᵀ with F = (x_k − x_0)_k, ŷ is a stress on the reference simplex, and

    ŷ∇̂λ_i = (∇λ_k·y∇λ_i)_k,        ∫ŷ/|T̂| = (∇λ_k·W_l/|T|)_kl,    W_l = ∫ yn λ_l over ∂T + ∫ f λ_l,

the latter because W_l = ∫ y∇λ_l + ∫(∇·y + f)λ_l. Its values at the vertices of subcells are linear in these numbers,
with rational coefficients, which `_coefficients` solves for exactly. So y is enclosed in real arithmetic, and −∇·y is
the load that is constant on subcells and has the moments of f, if forces and moments on the cell are in balance: these
make ∫ŷ symmetric. `equilibrated` makes them so. What force and moment a facet of a tree lacks, see `balance`, it gets
by the traction q = α + β×(x − x_e) with this force and moment. A body on whose boundary no facet may take any traction
is first brought in balance as a whole, by tractions in directions in which u is given, and by pressures.
"""

from fractions import Fraction
from functools import lru_cache
from itertools import combinations

import numpy as np
from flint import fmpq, fmpq_mat
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.linear_traces import opposite
from signorini_fenicsx.expressions.intervals import Interval, enclosing, stacked
from signorini_fenicsx.forms.elasticity import pairs
from signorini_fenicsx.rigorous.balance import balanced
from signorini_fenicsx.rigorous.discrete import MeshCells
from signorini_fenicsx.rigorous.elasticity.discrete import NONE
from signorini_fenicsx.rigorous.simplices import Simplices, total


@lru_cache
def _coefficients(dim: int) -> Interval:
    """ŷ at the vertices of subcells from ŷ∇̂λ_i at the vertices of facets and the entries of ∫ŷ/|T̂|.

    Shape ((d + 1)² entries, (d + 1) d² + entries).
    """
    size, entries = dim + 1, pairs(dim)
    gradients = [[-1] * dim, *(np.eye(dim, dtype=int).tolist())]
    places = {(i, k): n for i in range(size) for n, k in enumerate([k for k in range(size) if k != i])}

    def pull(subcell: int, place: int, row: int, direction: list[int]) -> dict[int, int]:
        """The component `row` of ŷ times a direction, as coefficients of the values of ŷ."""
        coefficients = {}
        for column, factor in enumerate(direction):
            entry = entries.index((min(row, column), max(row, column)))
            coefficients[(subcell * size + place) * len(entries) + entry] = factor
        return coefficients

    rows = [pull(i, a, r, gradients[i]) for i in range(size) for a in range(dim) for r in range(dim)]
    rows += [{vertex * len(entries) + n: 1 for vertex in range(size * size)} for n in range(len(entries))]
    number = len(rows)
    for i, j in combinations(range(size), 2):
        across = [a - b for a, b in zip(gradients[i], gradients[j], strict=True)]
        shared = [(places[i, k], places[j, k]) for k in range(size) if k not in (i, j)]
        for mine, other in [*shared, (dim, dim)]:
            for r in range(dim):
                row = pull(i, mine, r, across)
                for place, factor in pull(j, other, r, across).items():
                    row[place] = row.get(place, 0) - factor
                rows.append(row)
    unknowns = size * size * len(entries)
    matrix = fmpq_mat(unknowns, unknowns, [fmpq(row.get(k, 0)) for row in rows for k in range(unknowns)])
    means = [size * size if n >= size * dim * dim else 1 for n in range(number)]  # a mean is a sum over this number
    right = fmpq_mat(unknowns, number, [fmpq(means[m] * (n == m)) for n in range(unknowns) for m in range(number)])
    exact = [Fraction(int(each.p), int(each.q)) for each in matrix.solve(right).entries()]
    near = np.array([float(each) for each in exact])
    below = np.array([Fraction(x) > each for x, each in zip(near.tolist(), exact, strict=True)])
    beyond = np.array([Fraction(x) < each for x, each in zip(near.tolist(), exact, strict=True)])
    lo, hi = np.where(below, np.nextafter(near, -np.inf), near), np.where(beyond, np.nextafter(near, np.inf), near)
    return Interval(lo.reshape(unknowns, number), hi.reshape(unknowns, number))


def stresses_of(cells: Simplices, pulls: Interval, moments: Interval) -> Interval:
    """The stress y at the vertices of the subcells, shape (cells, d + 1, d + 1, d, d).

    Args:
        cells: The cells.
        pulls: q at the vertices of facets, shape (cells, d + 1, d, d).
        moments: ∫ f λ_k, shape (cells, d + 1, d).
    """
    dim, count = cells.dim, len(cells.vertices)
    entries, coefficients = pairs(dim), _coefficients(dim)
    hatted = enclosing(np.zeros((count, len(coefficients.lo))))
    for n, each in enumerate([*_tractions(cells, pulls), *_means(cells, pulls, moments)]):
        column = coefficients[:, n]
        some = np.flatnonzero(~column.is_zero)
        hatted = hatted.put(np.s_[:, some], hatted[:, some] + each[:, None] * column[some])
    hatted = hatted.reshape(count, dim + 1, dim + 1, len(entries))
    x = enclosing(cells.vertices)
    arms = [x[:, k] - x[:, 0] for k in range(1, dim + 1)]
    columns: dict[tuple[int, int], Interval] = {}
    for i, j in entries:
        terms = []
        for n, (k, m) in enumerate(entries):
            factor = arms[k][:, i] * arms[m][:, j]
            factor = factor if k == m else factor + arms[m][:, i] * arms[k][:, j]
            terms.append(hatted[..., n] * factor[:, None, None])
        columns[i, j] = columns[j, i] = sum(terms[1:], terms[0])
    rows = [stacked([columns[i, j] for j in range(dim)]) for i in range(dim)]
    return stacked(rows, axis=-2)


def _tractions(cells: Simplices, pulls: Interval) -> list[Interval]:
    """ŷ∇̂λ_i at the vertices of facets, one column for each facet, vertex and component."""
    across = (cells.measure * -float(cells.dim))[:, None, None, None]
    columns = total(cells.gradients[:, None, None, 1:] * pulls[..., None, :]) / across
    return [columns[:, i, a, k] for i, a, k in np.ndindex(columns.lo.shape[1:])]


def _means(cells: Simplices, pulls: Interval, moments: Interval) -> list[Interval]:
    """The entries of ∫ŷ/|T̂|, one column each."""
    through, slopes = _moments(pulls), cells.gradients[:, 1:]
    of_hats = [
        sum((through[:, i, b] for i, b in np.argwhere(opposite(cells.dim) == vertex)), moments[:, vertex])
        for vertex in range(1, cells.dim + 1)
    ]
    both = [total(slopes[:, k] * of_hats[m]) + total(slopes[:, m] * of_hats[k]) for k, m in pairs(cells.dim)]
    return [each / (cells.measure * 2.0) for each in both]


def _moments(pulls: Interval) -> Interval:
    """∫ q λ_a over simplices of measure 1 for linear q with these values at the vertices, shape (…, k, d)."""
    corners = pulls.lo.shape[-2]
    return (pulls + total(pulls, axis=-2)[..., None, :]) / float(corners * (corners + 1))


def wrenches(x: Interval, pulls: Interval, origin: Array) -> Interval:
    """Forces and moments about a point of fields on simplices, linear and given by q = |e| times their values.

    Args:
        x: Vertices of the simplices, shape (…, k, d).
        pulls: q there, shape (…, k, d).
        origin: The point.

    Returns:
        The d components of the force, then the moments r_i q_j − r_j q_i for i < j, shape (…, d + d(d − 1)/2).
    """
    return wrench_of_moments(x, _moments(pulls), origin)


def wrench_of_moments(x: Interval, moments: Interval, origin: Array) -> Interval:
    """Force and moment of what has these moments against the hats of simplices, as `wrenches` has them."""
    dim, arms = x.lo.shape[-1], x - origin
    columns = [total(moments[..., i]) for i in range(dim)]
    columns += [total(_turning(arms, moments, i, j)) for i, j in combinations(range(dim), 2)]
    return stacked(columns)


def _turning(arm: Interval, force: Interval, i: int, j: int) -> Interval:
    """The component ij of the moment of a force."""
    return arm[..., i] * force[..., j] - arm[..., j] * force[..., i]


def pulls_with(x: Interval, wrench: Interval, origin: Array) -> Interval:
    """Fields q = α + β×(x − x_e) on facets with these forces and moments, at their vertices, shape (facets, d, d).

    Args:
        x: Vertices of the facets, shape (facets, d, d).
        wrench: As `wrenches` gives them, shape (facets, d + d(d − 1)/2).
        origin: The point about which the moments are.
    """
    dim = x.lo.shape[-1]
    turns = list(combinations(range(dim), 2))
    middle = total(x, axis=1) / float(dim)
    arms = x - middle[:, None]
    force = wrench[:, :dim]
    lever = middle - origin
    moments = [wrench[:, dim + n] - _turning(lever, force, i, j) for n, (i, j) in enumerate(turns)]

    fields = _turns(arms)
    share = float(dim * (dim + 1))
    rows = [stacked([total(_turning(arms, field, i, j)) / share for field in fields]) for i, j in turns]
    rates = solved(stacked(rows, axis=1), stacked(moments))
    pulls = force[:, None]
    for n, field in enumerate(fields):
        pulls = pulls + field * rates[:, n, None, None]
    return pulls


def _turns(arms: Interval) -> list[Interval]:
    """The fields of the turns i < j alone: their component j is r_i, their component i −r_j."""
    dim, fields = arms.lo.shape[-1], []
    for i, j in combinations(range(dim), 2):
        columns = [enclosing(np.zeros(arms.lo.shape[:-1]))] * dim
        columns[i], columns[j] = -arms[..., j], arms[..., i]
        fields.append(stacked(columns))
    return fields


def solved(matrix: Interval, right: Interval) -> Interval:
    """The solutions of linear systems with matrices of shape (…, m, m), enclosed.

    With R near the inverse of A and ‖I − RA‖ < 1 it is |x − x̃| ≤ ‖R(b − Ax̃)‖/(1 − ‖I − RA‖) for any x̃.

    Raises:
        InputError: If a matrix may be singular.
    """
    middle = (matrix.lo + matrix.hi) / 2
    with np.errstate(all="ignore"):
        regular = np.isfinite(middle).all(axis=(-1, -2)) & (np.linalg.cond(middle) < 1 / np.finfo(float).eps)
    inverse = np.linalg.inv(np.where(regular[..., None, None], middle, np.eye(middle.shape[-1])))
    near = np.einsum("...ij,...j->...i", inverse, (right.lo + right.hi) / 2)
    left = right - total(matrix * near[..., None, :])
    off = total(enclosing(inverse[..., None]) * matrix[..., None, :, :], axis=-2) - np.eye(middle.shape[-1])
    norm = total(enclosing(off.largest)).hi.max(axis=-1)
    moved = total(enclosing(inverse) * left[..., None, :]).largest.max(axis=-1)
    if not (regular & (norm < 1)).all():
        raise InputError("a cell is too flat, or what is given of u and contact do not hold the body")
    radius = (enclosing(moved) / (1.0 - enclosing(norm))).hi[..., None]
    return enclosing(near) + Interval(-radius, radius)


def equilibrated(
    cells_of_mesh: MeshCells, pair: Indices, outlets: Mask, holds: Interval, pulls: Interval, moments: Interval
) -> Interval:
    """The tractions q with forces and moments on each cell in balance, corrected along a tree, see `balance`.

    A body without outlets is first brought in balance as a whole, by q = Hr on its boundary with a rigid motion r.
    Where two bodies touch this is at the cost of the one that is nearer to outlets.

    Args:
        cells_of_mesh: The cells.
        pair: Where two bodies touch a number of the two facets, NONE elsewhere, shape (cells, d + 1).
        outlets: For each facet of each cell, whether any traction may act there on the boundary.
        holds: H on the other facets, 0 where the traction is given, shape (cells, d + 1, d, d).
        pulls: q at the vertices of facets, opposite for two that are shared or touch, shape (cells, d + 1, d, d).
        moments: ∫ f λ_k, shape (cells, d + 1, d).

    Raises:
        InputError: If a body is not held.
    """
    vertices, dim = cells_of_mesh.vertices, cells_of_mesh.dim
    origin = vertices.reshape(-1, dim).mean(axis=0)
    load = wrench_of_moments(enclosing(vertices), moments, origin)
    roots = np.zeros_like(outlets)
    bodies, across = bodies_of(cells_of_mesh), _across(pair)
    level = _levels(bodies, across, outlets, ~holds.is_zero.all(axis=(2, 3)) & (pair == NONE))
    for body in np.argsort(-level, kind="stable")[: np.count_nonzero(level)]:
        mine = bodies == body
        outer = mine[:, None] & (np.bincount(cells_of_mesh.facets.ravel())[cells_of_mesh.facets] == 1)
        nearer = level[bodies[across[..., 0]]] < level[body]
        outer &= (pair == NONE) | nearer
        place = np.nonzero(outer)
        more = _in_balance(cells_of_mesh, bodies == body, place, holds, pulls, load[mine], origin)
        touching = pair[place] != NONE
        pulls = _added(pulls, place, more)
        other = across[place][touching]
        pulls = _added(pulls, (other[:, 0], other[:, 1]), -more[touching])
        roots[np.argmax(mine), 0] = True
    return along_tree(cells_of_mesh, outlets, roots, pulls, load, origin)


def along_tree(
    cells_of_mesh: MeshCells, outlets: Mask, roots: Mask, pulls: Interval, load: Interval, origin: Array
) -> Interval:
    """The tractions with a correction along a tree that begins at outlets, or in cells of bodies that are in balance.

    Args:
        cells_of_mesh: The cells.
        outlets: Mask of the facets where any traction may act.
        roots: Mask with one facet of each body that is in balance; nothing is changed there.
        pulls: As for `equilibrated`.
        load: Force and moment of the load of each cell, shape (cells, d + d(d − 1)/2).
        origin: The point about which moments are.
    """
    on_facets = enclosing(cells_of_mesh.vertices)[:, opposite(cells_of_mesh.dim)]
    surplus = total(wrenches(on_facets, pulls, origin), axis=1) + load
    none = enclosing(np.zeros((*outlets.shape, surplus.lo.shape[1])))
    lacking = balanced(cells_of_mesh.facets, outlets | roots, none, surplus)
    changed = np.nonzero(~lacking.is_zero.all(axis=2) & ~roots)  # what leaves at a root is 0
    return _added(pulls, changed, pulls_with(on_facets[changed], lacking[changed], origin))


def _across(pair: Indices) -> Indices:
    """The cell and the local number of the facet that touches each facet; of others themselves."""
    beyond: Indices = np.stack(list(np.indices(pair.shape)), axis=-1)
    both = np.argwhere(pair != NONE)
    places = both[np.argsort(pair[tuple(both.T)], kind="stable")].reshape(-1, 2, 2)
    for one, other in ((0, 1), (1, 0)):
        beyond[places[:, one, 0], places[:, one, 1]] = places[:, other]
    return beyond


def _levels(bodies: Indices, across: Indices, outlets: Mask, held: Mask) -> Indices:
    """How far each body is from one with outlets, or where there is none from one with facets that hold it.

    It is 0 for bodies with outlets alone.
    """
    count = int(bodies.max()) + 1
    level = np.full(count, count + 1)
    own, other = np.broadcast_to(bodies[:, None], across.shape[:2]), bodies[across[..., 0]]
    for begin, mask in enumerate((outlets, held)):
        some = np.unique(bodies[mask.any(axis=1)])
        level[some[level[some] > count]] = begin
        for _ in range(count):
            np.minimum.at(level, own, level[other] + (own != other))
    return level


def bodies_of(cells_of_mesh: MeshCells) -> Indices:
    """The number of the body in which each cell is."""
    facets = cells_of_mesh.facets
    count, number = len(facets), int(facets.max()) + 1
    cells = np.repeat(np.arange(count), facets.shape[1])
    ones, shape = np.ones(facets.size, dtype=np.int8), (count + number, count + number)
    graph = coo_array((ones, (cells, count + facets.ravel())), shape=shape)
    return np.asarray(connected_components(graph, directed=False)[1][:count], dtype=np.int64)


def _added(pulls: Interval, place: tuple[Indices, ...], more: Interval) -> Interval:
    """The tractions with more at some facets."""
    return pulls.put(place, pulls[place] + more)


def _in_balance(
    cells_of_mesh: MeshCells,
    body: Mask,
    place: tuple[Indices, ...],
    holds: Interval,
    pulls: Interval,
    load: Interval,
    origin: Array,
) -> Interval:
    """Tractions Hr at some facets that bring a body in balance as a whole, shape (facets, d, d)."""
    facets, dim = cells_of_mesh.facets, cells_of_mesh.dim
    corners = cells_of_mesh.vertices[place[0][:, None], opposite(dim)[place[1]]]
    size = 2.0 ** np.ceil(np.log2(np.ptp(corners.reshape(-1, dim), axis=0).max()))  # exact, so that units do not matter
    scale = np.concatenate([np.ones(dim), np.full(dim * (dim - 1) // 2, size)])
    x, arms = enclosing(corners), (enclosing(corners) - origin) / size
    motions = [*(enclosing(np.broadcast_to(each, corners.shape)) for each in np.eye(dim)), *_turns(arms)]
    hold = holds[place]
    answers = [total(hold[:, None] * motion[..., None, :]) for motion in motions]
    matrix = stacked([total(wrenches(x, each, origin), axis=0) / scale for each in answers])
    outer = np.nonzero(body[:, None] & (np.bincount(facets.ravel())[facets] == 1))
    around = enclosing(cells_of_mesh.vertices[outer[0][:, None], opposite(dim)[outer[1]]])
    lacking = total(wrenches(around, pulls[outer], origin), axis=0) + total(load, axis=0)
    rates = solved(matrix, -lacking / scale)
    more = enclosing(np.zeros(corners.shape))
    for n, answer in enumerate(answers):
        more = more + answer * rates[n]
    return more
