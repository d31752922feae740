"""A look at an expression on simplices, first in boxes that contain many of them, then in parts of each.

*Boxes.* They are smaller and smaller ones, until they are small enough for what is asked.
*Parts.* Simplices are cut into parts: along the switch of a condition if one is undecided, else through the middle of
the longest edge. All parts with more than half of the mean uncertainty are cut at once; if there is no room for so
many, the worst of them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.expressions.series import Remainder
from signorini_fenicsx.expressions.simplices import Parts
from signorini_fenicsx.expressions.taylor import Regions, Switch, expanded
from signorini_fenicsx.expressions.tree import Tree

FIRST, LAST = 2, 18
"""The largest and the smallest boxes have 2 to the power of minus this times the extent of the domain."""
ROOM = 0.25
"""Simplices of up to this share of a box are looked at in boxes, which are enlarged by so much on each side."""
MOST, MOST_EACH = 20_000, 2
"""Largest number of parts that are looked at: the first number plus the second per simplex of the mesh."""
SLIVER = 0.02
"""Parts are not cut near a vertex: at least this share of an edge away, unless the cut is exact."""
STEEP = 4.0
"""Sizes whose ratio is beyond this vary."""
WIDE = 2.0
"""A part is cut so many times its blur away from a switch that is not affine."""
FINEST = 1e-12
"""Parts with less than this share of their simplex are not cut."""
CHUNK = 4096
"""Regions looked at at once."""
EXACT = 1e-9
"""A switch with a blur below this share of its variation counts as affine."""
RAISES = 60
"""How often the threshold is raised until there is room."""


@dataclass(frozen=True)
class Frame:
    """The box of the domain of expressions, and how many simplices share it.

    Attributes:
        box: Its lower and upper corner, shape (2, dim).
        simplices: Number of simplices of the mesh, on all ranks.
        comm: Communicator.
    """

    box: Array
    simplices: int
    comm: MPI.Comm

    @property
    def scale(self) -> float:
        """The largest extent of the box of the domain."""
        return float((self.box[1] - self.box[0]).max())


def look_everywhere(
    tree: Tree, vertices: Array, frame: Frame, look: Callable[[Remainder, Indices], Mask], *, rough: bool = True
) -> None:
    """Look at simplices in smaller and smaller boxes, and last in their own, until `look` says that this is enough.

    The boxes depend on the simplex alone, so that the results do not depend on the number of ranks. `rough` as below.
    """

    def remainder_of(regions: Regions, rows: Indices | slice, reach: Array) -> Remainder:
        return Remainder.of(expanded([tree], regions, rough=rough)[0][0], regions.half, rows, reach)

    lo, hi = vertices.min(axis=1).T, vertices.max(axis=1).T
    middle, size, todo = (lo + hi) / 2, (hi - lo).max(axis=0, initial=0.0), np.arange(len(vertices))
    x = np.moveaxis(vertices, 0, -1).swapaxes(0, 1)
    first, last = frame.box
    done = np.zeros(len(vertices), dtype=bool)
    for level in range(FIRST, LAST):
        width = frame.scale / 2**level
        todo = todo[~done[todo] & (size[todo] <= ROOM * width)]
        if len(todo) == 0:
            break
        place = np.floor((middle[:, todo] - first[:, None]) / width).astype(np.int64)
        key, rows = np.unique(place.T @ (2 ** (level + 1)) ** np.arange(len(place)), return_inverse=True)
        index = np.stack([key // 2 ** (axis * (level + 1)) % 2 ** (level + 1) for axis in range(len(place))])
        corner = first[:, None] + (index - ROOM) * width
        low, high = (np.clip(end, first[:, None], last[:, None]) for end in (corner, corner + (1 + 2 * ROOM) * width))
        for chunk, own in _chunks(len(key), rows):
            regions = Regions.of_boxes(low[:, chunk], high[:, chunk])
            half = np.where(regions.half > 0, regions.half, 1.0)
            box, some = rows[own] - chunk.start, todo[own]
            reach = (np.abs(x[:, :, some] - regions.centre[:, None, box]) / half[:, None, box]).max(axis=1)
            done[some] = look(remainder_of(regions, box, reach), some)
    left = np.flatnonzero(~done)
    for some in (left[begin : begin + CHUNK] for begin in range(0, len(left), CHUNK)):
        regions = Regions.of_simplices(vertices[some], frame.scale)
        look(remainder_of(regions, slice(None), np.ones_like(regions.half)), some)


def _chunks(number: int, rows: Indices) -> Iterator[tuple[slice, Indices]]:
    """Some boxes at a time, and the positions of the simplices in them; `rows` has the box of each simplex."""
    order = np.argsort(rows, kind="stable")
    for begin in range(0, number, CHUNK):
        ends = np.searchsorted(rows[order], [begin, begin + CHUNK])
        yield slice(begin, begin + CHUNK), order[slice(*ends)]


def in_parts(
    trees: Sequence[Tree],
    vertices: Array,
    frame: Frame,
    look: Callable[..., Array],
    need: Callable[[Parts, Array], Array],
    sizes: Callable[[Array], Array] | None = None,
    *,
    rough: bool = True,
) -> tuple[Parts, Array]:
    """Cut simplices into parts until the needs of all parts together are at most 1 (collective).

    Args:
        trees: The expressions.
        vertices: Those of the simplices.
        frame: The domain.
        look: Gives what is known of parts from the remainder of each expression there, shape (parts, columns).
        need: As in `cut_as_needed`.
        sizes: Gives sizes > 0 in points, see `_by_sizes`.
        rough: Whether series may be rough; False if `look` needs gradients.
    """

    def looked(parts: Parts) -> tuple[Array, Array]:
        regions = Regions.of_simplices(parts.vertices, frame.scale)
        series, switch = expanded(trees, regions, rough=rough)
        whole = slice(None), np.ones_like(regions.half)
        seen = look(parts, *(Remainder.of(each, regions.half, *whole) for each in series))
        return seen, _cuts(parts, regions, switch, sizes)

    return cut_as_needed(vertices, looked, need, MOST + MOST_EACH * frame.simplices, frame.comm)


def cut_as_needed(
    vertices: Array,
    looked: Callable[[Parts], tuple[Array, Array]],
    need: Callable[[Parts, Array], Array],
    room: int,
    comm: MPI.Comm,
) -> tuple[Parts, Array]:
    """Cut simplices into parts until the needs of all parts together are at most 1 (collective).

    Args:
        vertices: Those of the simplices.
        looked: Gives what is known of some parts, shape (parts, columns), and their cuts, see `halving`.
        need: Gives from what is known how much each part needs to be cut; NaN counts as ∞.
        room: Largest number of parts that are looked at, on all ranks.
        comm: Communicator.
    """

    def look(parts: Parts) -> tuple[Array, ...]:
        begins = range(0, max(len(parts.simplex), 1), CHUNK)
        chunks = [looked(parts.take(slice(begin, begin + CHUNK))) for begin in begins]
        return tuple(np.concatenate(each) for each in zip(*chunks, strict=True))

    parts = Parts(vertices, np.arange(len(vertices)), np.ones(len(vertices)))
    of_parts, cuts = look(parts)
    left = room - comm.allreduce(len(vertices))
    while True:
        needs = np.where(parts.share > FINEST, need(parts, of_parts), 0.0)
        needs[np.isnan(needs)] = np.inf
        total, number = comm.allreduce(np.array([needs.sum(), len(needs)])).tolist()
        if not total > 1:
            return parts, of_parts
        chosen = _worst(needs, (total if np.isfinite(total) else 1.0) / (2 * number), left // 2, comm)
        if not comm.allreduce(np.count_nonzero(chosen)):
            return parts, of_parts
        first, second = cuts[chosen, :2].astype(np.int64).T
        halves = parts.take(chosen).cut(first, second, cuts[chosen, 2])
        left -= comm.allreduce(len(halves.simplex))
        parts = parts.take(~chosen).and_(halves)
        of_parts, cuts = (
            np.concatenate([old[~chosen], new]) for old, new in zip((of_parts, cuts), look(halves), strict=True)
        )


def halving(parts: Parts) -> Array:
    """Cuts through the middle of the longest edges: the numbers of their vertices, and the share of it at the first."""
    return np.column_stack([*parts.longest(), np.full(len(parts.simplex), 0.5)])


def _worst(needs: Array, least: float, most: int, comm: MPI.Comm) -> Mask:
    """Mask of the parts that need more than `least`, or of as many of the worst as there is room for (collective)."""
    for _ in range(RAISES):
        chosen = needs > least
        if comm.allreduce(np.count_nonzero(chosen)) <= most:
            return chosen
        least *= 4
    return np.zeros(len(needs), dtype=bool)


def _cuts(parts: Parts, regions: Regions, switch: Switch, sizes: Callable[[Array], Array] | None) -> Array:
    """Cuts of the parts: the numbers of two vertices each, and the share of their edge at the first."""
    first, second = parts.longest()
    share, rows = np.full(len(first), 0.5), np.arange(len(first))
    if sizes is not None:
        steep, *by_sizes = _by_sizes(parts.vertices, sizes)
        first, second, share = (np.where(steep, *pair) for pair in zip(by_sizes, (first, second, share), strict=True))
    a = switch.at + np.einsum("in,icn->cn", switch.slope, regions.corners)
    low, high = a.argmin(axis=0), a.argmax(axis=0)
    least, most = a[low, rows], a[high, rows]
    exact = switch.blur <= EXACT * (most - least)
    margin = np.where(exact, 0.0, SLIVER)
    for level in (np.where(exact, 0.0, -WIDE * switch.blur), np.where(exact, 0.0, WIDE * switch.blur)):
        with np.errstate(all="ignore"):
            place = (level - least) / (most - least)
        is_cut = switch.undecided & (place > margin) & (place < 1 - margin)
        first, second, share = (np.where(is_cut, *pair) for pair in ((low, first), (high, second), (place, share)))
    return np.column_stack([first, second, share])


def _by_sizes(vertices: Array, sizes: Callable[[Array], Array]) -> tuple[Mask, Indices, Indices, Array]:
    """Which parts are cut where sizes vary, and the cuts as in `_cuts`.

    An edge is cut where a linear size is the geometric mean of those at its ends: (x − x_0)² is 0 there if it is 0 on
    the edge. First come edges with a far smaller size in this place, then those with the largest ratio of their ends.
    """
    pairs = np.column_stack(np.triu_indices(vertices.shape[1], 1))
    with np.errstate(all="ignore"):
        a, b = np.moveaxis(sizes(vertices)[:, pairs], 2, 0)
        place = np.nan_to_num((np.sqrt(a * b) - a) / (b - a), nan=0.5)
        place = np.clip(place, SLIVER, 1 - SLIVER)
        x = (1 - place[..., None]) * vertices[:, pairs[:, 0]] + place[..., None] * vertices[:, pairs[:, 1]]
        least = np.minimum(a, b)
        ratio = np.stack([least / sizes(x), np.maximum(a, b) / least])
        crossed = ratio[0].max(axis=1) > STEEP
    rows, chosen = np.arange(len(vertices)), np.where(crossed[:, None], *ratio).argmax(axis=1)
    steep = crossed | (ratio[1][rows, chosen] > STEEP)
    first, second = pairs[chosen].T
    return steep, first, second, place[rows, chosen]
