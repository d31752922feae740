"""Directions from which a solution in space is seen, and the planes on which its inside is shown."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.pictures.geometry import creases
from signorini_fenicsx.pictures.rendering import screen
from signorini_fenicsx.pictures.scene import Scene

USUAL_VIEW = np.array([1.0, -1.6, 0.9]) / np.linalg.norm([1.0, -1.6, 0.9])
VIEWS = [
    np.array([np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)])
    for up in np.radians([25, -25, 50, -50])
    for turn in np.radians([-60, -30, 30, 60, 120, 150, 210, 240])
]
"""Possible directions of view, the usual ones first."""
WITHIN = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [3, 3, 0], [3, 0, 3], [0, 3, 3]]) / 6
"""Barycentric coordinates of points of a triangle, which decide whether it is seen."""
SLANTED = 0.6, 0.8
"""The cosine between the view of a cut and its normal: the surface beside the cut is seen too."""
MARGIN = 0.1
"""No cut is nearer to an end of the domain than this share of its size."""
KEPT = 0.3
"""Not less of the domain than this, along the normal of a cut, stays behind it."""


type Inside = Callable[[Array], Mask]
"""Tells which points are in the domain."""

ENOUGH = 1000
"""About how many facets of Γ_S decide from where a cut is seen."""


@dataclass(frozen=True)
class Cut:
    """A plane through the domain, seen from one side; what is before it is taken away.

    Attributes:
        normal: Its unit normal, to the side of the eye.
        origin: A point of it.
        view: The direction to the eye.
    """

    normal: Array
    origin: Array
    view: Array

    def is_before(self, x: Array) -> Mask:
        """Mask of the points on the side of the eye."""
        return (x - self.origin) @ self.normal > 0

    def turned_inside(self, corners: Array, normals: Array) -> Mask:
        """Which triangles before the plane, or across it, turn their inner side to the eye.

        Args:
            corners: Shape (triangles, 3, 3).
            normals: Outer normals of the triangles.
        """
        return self.is_before(self._nearest(corners)) & (normals @ self.view < 0)

    def _nearest(self, corners: Array) -> Array:
        """The corner of each triangle that is most before the plane."""
        nearest: Array = corners[np.arange(len(corners)), np.argmax(corners @ self.normal, axis=1)]
        return nearest

    def shown_from_inside(self, corners: Array, normals: Array, is_inside: Inside) -> Mask:
        """Which of these the cut does not hide; `is_inside` tells which points are in the domain."""
        nearest, turned = self._nearest(corners), self.turned_inside(corners, normals)
        height = (nearest[turned] - self.origin) @ self.normal / (self.view @ self.normal)
        turned[turned] = ~is_inside(nearest[turned] - height[:, None] * self.view)  # their shadows on the plane
        return turned


def best_cuts(scene: Scene, is_inside: Inside) -> list[Cut]:
    """Cuts along two coordinate planes, first along the one that the free boundary crosses most.

    The free boundary is where facets of Γ_S in different states meet, or cells in different states of laws in Ω. The
    first cut has half of it on each side, so that it shows both states; the second one has half of the contact set on
    each side. Both are seen from where most of each state is visible.

    Args:
        scene: A solution in space.
        is_inside: Tells which points are in the domain.
    """
    points = scene.fields.points
    low, high = points.min(axis=0), points.max(axis=0)
    ends = points[_free_edges(scene)]
    steps, middles = np.abs(ends[:, 1] - ends[:, 0]), ends.mean(axis=1)
    crossings = steps.sum(axis=0) / (high - low)
    axes = sorted(range(3), key=lambda axis: (-round(float(crossings[axis]), 6), (1, 0, 2)[axis]))[:2]
    facets, held = scene.facets, scene.touching
    places = (middles, steps), (facets.x[held], np.repeat(facets.measure[held, None], 3, axis=1))
    origins = [
        _median(x[:, axis], weights[:, axis], low, high, axis) for axis, (x, weights) in zip(axes, places, strict=True)
    ]
    return [_seen_best(scene, axis, origin, is_inside) for axis, origin in zip(axes, origins, strict=True)]


def _median(places: Array, weights: Array, low: Array, high: Array, axis: int) -> Array:
    """The middle of the domain, moved along an axis to the weighted median of places, but not near the ends."""
    origin = (low + high) / 2
    if weights.sum() > 0:
        order = np.argsort(places)
        total = np.cumsum(weights[order])
        share = (places[order][np.searchsorted(total, total[-1] / 2)] - low[axis]) / (high - low)[axis]
        origin[axis] = low[axis] + np.clip(share, MARGIN, 1 - MARGIN) * (high - low)[axis]
    return origin


def _free_edges(scene: Scene) -> Indices:
    """Edges where facets in different states meet; the rim of Γ_S where all are in one state, shape (edges, 2)."""
    points, (_, inside) = scene.fields.points, scene.fronts
    rims = [creases(points, scene.facets.vertices[group.facets], angle=180) for group in scene.groups]
    edges, times = np.unique(np.concatenate([*rims, np.empty((0, 2), np.int64)]), axis=0, return_counts=True)
    around = np.concatenate([inside[:, [0, 1]], inside[:, [1, 2]], inside[:, [0, 2]]])
    between = np.concatenate([edges[times > 1], around])
    return between if len(between) else edges


def _seen_best(scene: Scene, axis: int, origin: Array, is_inside: Inside) -> Cut:
    """The cut at a right angle to an axis, from the side that shows most of the states of Γ_S."""
    x = scene.fields.points[:, axis]
    share = float(np.clip((origin[axis] - x.min()) / np.ptp(x), KEPT, 1 - KEPT))  # below the plane
    cuts = [
        Cut(np.sign(view[axis]) * np.eye(3)[axis], origin, view)
        for view in VIEWS
        if SLANTED[0] <= abs(view[axis]) <= SLANTED[1] and (share if view[axis] > 0 else 1 - share) > KEPT
    ]
    some = slice(None, None, max(1, len(scene.facets.x) // ENOUGH))
    vertices, measure = scene.facets.vertices[some], scene.facets.measure[some]
    corners, normals = scene.fields.points[vertices], outward(scene, vertices)
    seen = np.zeros((len(cuts), len(vertices)))
    for row, cut in zip(seen, cuts, strict=True):
        slant, is_before = normals @ cut.view, cut.is_before(corners.mean(axis=1))
        shown = np.where(is_before, cut.shown_from_inside(corners, normals, is_inside), slant > 0)
        row[:] = measure * shown * np.abs(slant)
    return cuts[best_view(seen, [group.facets[some] for group in scene.groups], np.array([cut.view for cut in cuts]))]


def best_view(seen: Array, groups: Sequence[Mask], views: Array) -> int:
    """The view that shows most of each group of facets; one that shows nothing of one of them is no good.

    Args:
        seen: The visible area of each facet in each view, shape (views, facets).
        groups: Masks of facets.
        views: Directions, shape (views, 3); among equal ones the usual one is preferred.
    """
    score = np.zeros(len(views))
    for group in groups:
        area = seen[:, group].sum(axis=1)
        score += np.sqrt(area / max(area.max(), 1e-300))
    return int(np.argmax((score + 1e-3) * (1 + 0.25 * views @ USUAL_VIEW)))


def outward(scene: Scene, triangles: Indices) -> Array:
    """Unit normals of triangles of the boundary, out of their cells."""
    points, boundary = scene.fields.points, scene.boundary
    both = np.sort(np.concatenate([boundary.vertices, triangles]), axis=1)
    _, first, number = np.unique(both, axis=0, return_index=True, return_inverse=True)
    middles = boundary.middles[first[number.ravel()[len(boundary.vertices) :]]]
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    away = np.sum(normals * (corners.mean(axis=1) - middles), axis=1)
    return normals * np.sign(away)[:, None]


def seen_from(scene: Scene, view: Array) -> Array:
    """The visible area of each triangle of Γ_S from a direction: its projected area, or 0 if it is hidden."""
    if len(scene.facets.measure) == 0:
        return scene.facets.measure
    corners = scene.fields.points[scene.facets.vertices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slant = np.abs(normals @ view) / np.linalg.norm(normals, axis=1)
    across, up = screen(view)
    places = np.einsum("pc,fcx->fpx", WITHIN, corners)
    depth, size = places @ view, 0.6 * np.sqrt(scene.facets.measure.max())
    pixel = np.floor(places @ np.column_stack([across, up]) / size).astype(np.int64)
    _, where = np.unique(pixel.reshape(-1, 2), axis=0, return_inverse=True)
    nearest = np.full(where.max() + 1, -np.inf)
    np.maximum.at(nearest, where.ravel(), depth.ravel())
    room = size * (0.5 + np.minimum(np.sqrt(1 - np.minimum(slant, 1) ** 2) / np.maximum(slant, 1e-9), 3))
    visible = np.mean(depth > nearest[where].reshape(depth.shape) - room[:, None], axis=1)
    return scene.facets.measure * visible * np.minimum(slant, 0.35)
