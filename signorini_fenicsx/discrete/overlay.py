"""The overlay of two surfaces that share no nodes: which point of a master facet is opposite to which of a slave facet.

From a point x of a slave facet a line goes along the direction d of the facet, both ways. χ(x) = x + γ(x) d is its
nearest crossing with a master facet that faces the slave, n·d < 0. Where one master facet is met, χ and γ are affine:
a slave facet is cut into *pieces*, simplices with one master facet each. A slave facet is *covered* if all its points
have a χ; of others nothing is passed on.

All is in barycentric coordinates of the slave facet. Those of the master facet at χ are a linear function of them, and
so is γ: a piece is cut out of the slave facet by d inequalities between linear functions, in the plane and in space.
"""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask

FACING = 1e-6
"""A master facet faces a slave if n·d is below minus this."""
NOTHING = 1e-12
"""A share of a facet that is rounding: a corner that near an edge is on it, and a piece that small is none."""
WHOLE = 1e-9
"""A facet is covered up to this share of it."""
NEARLY = 0.05
"""Up to this share of a facet may stand out at its ends, as chords of one arc do: its last pieces are stretched."""
NEAR = 1.5
"""Facets whose balls may meet a line are looked for in balls around it that are so many times as large."""
CLASS = 2
"""Facets are looked for by sizes; those of one class differ by a factor of 2 to this power."""
AT_ONCE = 200_000
"""Pairs of facets that are in memory at the same time."""


@dataclass(frozen=True)
class Pieces:
    """Pieces of slave facets, each a simplex on one slave facet, with its image under χ on one master facet.

    In a piece all is affine: the coordinates at a point with the barycentric coordinates β in it are β @ on_slave and
    β @ on_master, and the gap there is β @ gap. Sorted by the slave facet, then by the master facet.

    Attributes:
        slave: The row of the slave facet.
        master: The row of the master facet.
        on_slave: The corners, by barycentric coordinates on the slave facet, shape (pieces, d corners, d).
        on_master: χ of the corners, by barycentric coordinates on the master facet, likewise.
        gap: γ d·ν in the corners, ν the outer unit normal of the slave facet, shape (pieces, d); negative where the
            surfaces overlap.
        share: |s|/|e| of the piece s and its slave facet e.
        stretch: J = |χ(s)|/|s|.
    """

    slave: Indices
    master: Indices
    on_slave: Array
    on_master: Array
    gap: Array
    share: Array
    stretch: Array

    def __len__(self) -> int:
        """The number of pieces."""
        return len(self.slave)

    def take(self, rows: Indices | Mask) -> Self:
        """A selection of the pieces."""
        return type(self)(*(getattr(self, each.name)[rows] for each in fields(self)))

    @property
    def weights(self) -> Array:
        """∫ φ_a Φ_b∘χ over each piece over ∫ φ_a, for the hats φ_a of the slave and Φ_b of the master facet.

        Shape (pieces, d, d). Over the pieces of a covered facet the rows add up to 1.
        """
        return np.asarray(self._means(self.on_master))

    def means(self, slaves: int) -> Array:
        """The means of the gap weighted by the hats of the slave facets, shape (slaves, d)."""
        means = np.zeros((slaves, self.on_slave.shape[2]))
        np.add.at(means, self.slave, self._means(self.gap[..., None])[..., 0])
        return means

    def _means(self, values: Array) -> Array:
        """∫ φ_a f over each piece over ∫ φ_a, from f in the corners, shape (pieces, d corners, …)."""
        size = self.on_slave.shape[1]
        mass = (1 + np.eye(size)) / (size + 1)
        return np.asarray(np.einsum("n,nva,vw,nwb->nab", self.share, self.on_slave, mass, values, optimize=True))

    def covered(self, slaves: int) -> Array:
        """The share of each slave facet that has a χ."""
        return np.bincount(self.slave, self.share, slaves)


@dataclass(frozen=True)
class Surface:
    """Some facets.

    Attributes:
        corners: Their corners, shape (facets, d, d).
        normals: Their outer unit normals.
    """

    corners: Array
    normals: Array

    @property
    def balls(self) -> tuple[Array, Array]:
        """Middles and radii of balls that have the facets in them."""
        middles = self.corners.mean(axis=1)
        return middles, np.linalg.norm(self.corners - middles[:, None], axis=2).max(axis=1, initial=0.0)

    @property
    def measure(self) -> Array:
        """|e|."""
        edges = self.corners[:, 1:] - self.corners[:, :1]
        return np.asarray(np.sqrt(np.linalg.det(edges @ edges.swapaxes(1, 2))) / max(1, edges.shape[1]))


def overlay(slave: Surface, master: Surface, directions: Array, within: float) -> Pieces:
    """The pieces of slave facets, also of those that are not covered.

    Args:
        slave: The slave facets.
        master: The master facets.
        directions: Unit vectors d, shape (slaves, d); one that points into its facet's body meets nothing.
        within: The largest |γ|; a piece with a larger one in a corner is left out.
    """
    number, dim = slave.corners.shape[:2]
    found = [_no_pieces(dim)]
    i, j = _candidates(slave, master, directions, within)
    for rows in np.array_split(np.arange(len(i)), -(-len(i) // AT_ONCE) or 1):
        found.append(_cut_out(slave, master, directions, i[rows], j[rows]))
    pieces = _joined(found)
    pieces = pieces.take(np.abs(pieces.gap).max(axis=1, initial=0.0) <= within)
    pieces = _nearest(pieces, number)
    pieces = _to_the_ends(pieces, number)
    along = np.einsum("ni,ni->n", directions, slave.normals)
    pieces = pieces.take(np.lexsort([pieces.master, pieces.slave]))
    size = np.abs(np.linalg.det(pieces.on_master)) * master.measure[pieces.master]
    areas = np.abs(np.linalg.det(pieces.on_slave))
    stretch = size / (areas * slave.measure[pieces.slave])
    gap = pieces.gap * along[pieces.slave, None]
    return Pieces(pieces.slave, pieces.master, pieces.on_slave, pieces.on_master, gap, areas, stretch)


def _no_pieces(dim: int) -> Pieces:
    none, numbers = np.empty((0, dim, dim)), np.empty(0, dtype=np.int64)
    return Pieces(numbers, numbers, none, none, none[:, 0], np.empty(0), np.empty(0))


def _joined(parts: list[Pieces]) -> Pieces:
    return Pieces(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(Pieces)))


def _candidates(slave: Surface, master: Surface, directions: Array, within: float) -> tuple[Indices, Indices]:
    """Pairs of a slave and a master facet whose balls meet along the line through the middle of the slave facet.

    The search goes along the line in steps by the distance to the nearest middle, so that nothing is passed over.
    """
    from scipy.spatial import cKDTree  # slow to import

    (middle, radius), (others, radii) = slave.balls, master.balls
    none = np.empty(0, dtype=np.int64)
    pairs = [np.empty((0, 2), dtype=np.int64)]
    outward = np.einsum("ni,ni->n", directions, slave.normals) > FACING
    sizes = np.floor(np.log2(radii / radii.min(initial=np.inf)) / CLASS) if len(radii) > 0 else none
    for size in np.unique(sizes):
        rows = np.flatnonzero(sizes == size)
        tree, reach = cKDTree(others[rows]), radius + radii[rows].max()
        for sign in (1, -1):
            live, away = np.flatnonzero(outward), np.zeros(len(middle))
            while len(live) > 0:
                x = middle[live] + sign * away[live, None] * directions[live]
                distance, _ = tree.query(x)
                near = distance <= NEAR * reach[live]
                balls = tree.query_ball_point(x[near], NEAR * reach[live[near]])
                counts = np.array([len(ball) for ball in balls], dtype=np.int64)
                met = rows[np.concatenate([none, *balls]).astype(np.int64)]
                pairs.append(np.column_stack([np.repeat(live[near], counts), met]))
                free = np.sqrt(np.maximum(distance**2 - reach[live] ** 2, 0.0))
                away[live] += np.where(near, reach[live], free)
                live = live[away[live] <= within + 2 * reach[live]]
    i, j = np.unique(np.concatenate(pairs), axis=0).T
    apart, d = others[j] - middle[i], directions[i]
    along = np.einsum("ni,ni->n", apart, d)
    beside = np.linalg.norm(apart - along[:, None] * d, axis=1) <= (1 + WHOLE) * (radius[i] + radii[j])
    facing = np.einsum("ni,ni->n", master.normals[j], d) < -FACING
    kept = beside & facing & (np.abs(along) <= within + radius[i] + radii[j])
    return i[kept], j[kept]


def _cut_out(slave: Surface, master: Surface, directions: Array, i: Indices, j: Indices) -> Pieces:
    """The pieces of slave facets i over master facets j; γ is in the place of the gap."""
    start = master.corners[j, 0]
    edges = master.corners[j, 1:] - start[:, None]
    matrices = np.concatenate([edges, -directions[i, None]], axis=1).swapaxes(1, 2)
    solved = np.linalg.solve(matrices, (slave.corners[i] - start[:, None]).swapaxes(1, 2)).swapaxes(1, 2)
    gamma, rest = solved[:, :, -1], solved[:, :, :-1]
    image = np.concatenate([1 - rest.sum(axis=2, keepdims=True), rest], axis=2)  # of the corners of the slave facet
    kept = (image.max(axis=1) > NOTHING).all(axis=1)
    i, j, gamma, image = i[kept], j[kept], gamma[kept], image[kept]
    polygons = np.broadcast_to(np.eye(image.shape[1]), image.shape)
    counts = np.full(len(i), image.shape[1])
    for b in range(image.shape[2]):
        polygons, counts = _cut(polygons, counts, np.einsum("nva,na->nv", polygons, image[:, :, b]))
    rows, on_slave = _simplices(polygons, counts)
    none = np.zeros(len(rows))
    gaps = np.einsum("nva,na->nv", on_slave, gamma[rows])
    return Pieces(i[rows], j[rows], on_slave, on_slave @ image[rows], gaps, none, none)


def _cut(polygons: Array, counts: Indices, levels: Array) -> tuple[Array, Indices]:
    """Convex polygons where a linear function is not negative, from its values at the vertices.

    In the plane polygons are segments, whose vertices may be there several times.

    Args:
        polygons: Vertices in their order, shape (n, most, coordinates).
        counts: How many each has.
        levels: Shape (n, most).
    """
    most = polygons.shape[1]
    place = np.arange(most)
    levels = np.where(np.abs(levels) <= NOTHING, 0.0, levels)
    live = place < counts[:, None]
    after = np.where(place + 1 < counts[:, None], place + 1, 0)
    next_level, next_one = np.take_along_axis(levels, after, 1), np.take_along_axis(polygons, after[..., None], 1)
    crossed = live & (levels * next_level < 0)
    weight = np.where(crossed, levels / np.where(crossed, levels - next_level, 1.0), 0.0)
    both = np.stack([polygons, polygons + weight[..., None] * (next_one - polygons)], axis=2)
    kept = np.stack([live & (levels >= 0), crossed], axis=2).reshape(len(polygons), 2 * most)
    counts = kept.sum(axis=1)
    order = np.argsort(~kept, axis=1, kind="stable")[:, : max(1, counts.max(initial=0))]
    return np.take_along_axis(both.reshape(len(polygons), 2 * most, polygons.shape[2]), order[..., None], 1), counts


def _simplices(polygons: Array, counts: Indices) -> tuple[Indices, Array]:
    """The simplices of polygons that are not flat: the number of the polygon of each, and its corners."""
    most, dim = polygons.shape[1:]
    if dim == 2:
        live = np.arange(most) < counts[:, None]
        ends = [np.where(live, polygons[..., 0], sign * np.inf) for sign in (-1, 1)]
        low, high = ends[1].min(axis=1, initial=np.inf), ends[0].max(axis=1, initial=-np.inf)
        rows = np.flatnonzero(high - low > NOTHING)
        first = np.column_stack([high[rows], low[rows]])
        return rows, np.stack([first, 1 - first], axis=2)
    numbers, corners = [np.empty(0, dtype=np.int64)], [np.empty((0, 3, 3))]
    for last in range(2, most):
        rows = np.flatnonzero(counts > last)
        numbers.append(rows)
        corners.append(polygons[rows][:, [0, last - 1, last]])
    rows, simplices = np.concatenate(numbers), np.concatenate(corners)
    kept = np.abs(np.linalg.det(simplices)) > NOTHING
    return rows[kept], simplices[kept]


def _nearest(pieces: Pieces, slaves: int) -> Pieces:
    """Of pieces on one another the nearest: each is cut by those of its facet that are nearer.

    There are such pieces only where a line crosses several master facets.
    """
    sizes = np.abs(np.linalg.det(pieces.on_slave))
    several = np.bincount(pieces.slave, sizes, slaves) > 1 + WHOLE
    if not several.any():
        return pieces
    kept = [pieces.take(~several[pieces.slave])]
    for facet in np.flatnonzero(several):
        rows = np.flatnonzero(pieces.slave == facet)
        rows = rows[np.argsort(np.abs(pieces.gap[rows].mean(axis=1)), kind="stable")]
        nearer = [np.linalg.inv(pieces.on_slave[one]) for one in rows]
        for number, one in enumerate(rows):
            left = pieces.on_slave[[one]]
            for other in nearer[:number]:
                left = _without(left, other)
            kept.append(_parts_of(pieces.take(np.full(len(left), one)), left))
    return _joined(kept)


def _without(simplices: Array, other: Array) -> Array:
    """What is left of simplices outside another one, of which this is the inverse of the corners."""
    parts, polygons = [np.empty((0, *simplices.shape[1:]))], simplices
    counts = np.full(len(simplices), simplices.shape[1])
    for b in range(other.shape[1]):
        levels = polygons @ other[:, b]
        parts.append(_simplices(*_cut(polygons, counts, -levels))[1])
        polygons, counts = _cut(polygons, counts, levels)
    return np.concatenate(parts)


def _parts_of(pieces: Pieces, corners: Array) -> Pieces:
    """Parts of pieces, with these corners on the slave facet."""
    inside = corners @ np.linalg.inv(pieces.on_slave)
    gap = np.einsum("nva,na->nv", inside, pieces.gap)
    return Pieces(pieces.slave, pieces.master, corners, inside @ pieces.on_master, gap, pieces.share, pieces.stretch)


def _to_the_ends(pieces: Pieces, slaves: int) -> Pieces:
    """Stretch the last pieces of facets that stand out a little, see `NEARLY`."""
    share = np.bincount(pieces.slave, np.abs(np.linalg.det(pieces.on_slave)), slaves)
    on_slave = pieces.on_slave.copy()
    for facet in np.flatnonzero((share < 1 - WHOLE) & (share > 1 - NEARLY)):
        rows = np.flatnonzero(pieces.slave == facet)
        stretched = _stretched(on_slave[rows])
        sizes = np.linalg.det(stretched) * np.sign(np.linalg.det(on_slave[rows]))
        if abs(sizes.sum() - 1) <= WHOLE and (sizes > -NOTHING).all():
            on_slave[rows] = stretched
    pieces = replace(pieces, on_slave=on_slave)
    return pieces.take(np.abs(np.linalg.det(on_slave)) > NOTHING)  # one between an end and the side may be flat now


def _stretched(corners: Array) -> Array:
    """The pieces of a facet whose vertices where they end inside it are moved to its corners and its sides.

    A vertex near each corner without one moves there, if it can be one that is on no side, and all others to the side
    that is nearest.
    """
    dim = corners.shape[2]
    flat = corners.reshape(-1, dim)
    _, first, number = np.unique(np.round(flat, 9), axis=0, return_index=True, return_inverse=True)
    vertices, of_pieces = flat[first], number.reshape(-1, dim)
    sides = np.sort(np.concatenate([np.delete(of_pieces, k, axis=1) for k in range(dim)]), axis=1)
    sides, times = np.unique(sides, axis=0, return_counts=True)
    inside = ~(vertices[sides] <= WHOLE).all(axis=1).any(axis=1)
    ends = np.isin(np.arange(len(vertices)), sides[(times == 1) & inside])
    for corner, unit in enumerate(np.eye(dim)):
        away = 1 - vertices[:, corner]
        if ends.any() and away.min() > WHOLE:
            near = ends & (away <= 2 * away[ends].min())
            on_side = (vertices <= WHOLE).any(axis=1)
            nearest = np.argmin(np.where(near, away + on_side, np.inf))
            vertices[nearest], ends[nearest] = unit, False
    rows = np.flatnonzero(ends & (vertices > WHOLE).all(axis=1))
    vertices[rows, vertices[rows].argmin(axis=1)] = 0.0
    vertices[rows] /= vertices[rows].sum(axis=1, keepdims=True)
    return np.asarray(vertices[of_pieces])


def common_parts(simplices: Array, others: Array) -> tuple[Indices, Array]:
    """What pairs of simplices have in common, as simplices: which pair each is of, and its corners."""
    inverse = np.linalg.inv(others)
    polygons, counts = simplices, np.full(len(simplices), simplices.shape[1])
    for b in range(others.shape[1]):
        polygons, counts = _cut(polygons, counts, np.einsum("nva,na->nv", polygons, inverse[:, :, b]))
    return _simplices(polygons, counts)
