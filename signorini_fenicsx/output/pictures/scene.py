"""The input of pictures: gathered arrays of one solution on rank 0, and values computed from them."""

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.cases.plot import Plot
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.contact.conditions import Condition
from signorini_fenicsx.contact.history import Step
from signorini_fenicsx.discrete.site_table import FacetTable, SiteTable
from signorini_fenicsx.output.gather import Boundary, Fields
from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.output.pictures.sheet import Sheet

UNNAMED = Plot()
"""Of problems that name nothing."""


@dataclass(frozen=True)
class Group:
    """Facets of Γ_S that pictures show alike.

    Attributes:
        name: What legends call them.
        colour: Their colour.
        facets: Which ones.
    """

    name: str
    colour: str
    facets: Mask


@dataclass(frozen=True)
class Scene:
    """A solution for pictures (rank 0).

    Attributes:
        title: Title of the problem.
        caption: Algorithm and mesh, in mathematical type.
        fields: Mesh and cell values.
        facets: Γ_S.
        boundary: The whole boundary.
        labels: For each part of Γ_S the name of the coordinate along it.
        contact: Condition on the facets in contact.
        segments: Names of the segments of all laws, if there are others than the Signorini law.
        history: Steps of the algorithm.
        strength: What |σ_h| is called.
        gamma: What Γ_S is called.
        edges: What the facets between cells in different states of laws in Ω are called.
        columns: What the columns of `steps.csv` are called that have measures of cells under laws in Ω.
        inside: The parts of Γ_S inside the domain.
        phreatic_line: Points of the phreatic line of a dam, shape (points, 2), or None.
        physics: Name of the physics.
        plot: Names of u and of the flux, and level lines.
        sites: The table of the solution.
    """

    title: str
    caption: str
    fields: Fields
    facets: FacetTable
    boundary: Boundary
    labels: dict[str, str]
    contact: Condition
    segments: Sequence[str]
    history: list[Step]
    strength: str = r"$|\sigma_h|$"
    gamma: str = r"$\Gamma_S$"
    edges: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    inside: Collection[str] = ()
    phreatic_line: Array | None = None
    physics: str = "diffusion"
    sites: SiteTable | None = None
    plot: Plot = UNNAMED

    @property
    def dim(self) -> int:
        """Dimension, 2 or 3."""
        return int(self.fields.points.shape[1])

    @property
    def touching(self) -> Mask:
        """Mask of the facets of Γ_S in contact."""
        return self.facets.condition == self.contact

    @cached_property
    def groups(self) -> list[Group]:
        """Γ_S in contact and not in contact, or by the segments of the laws; none of them empty.

        The colour of a segment does not depend on which others have facets, so it stays in time.
        """
        groups = [Group("contact", style.CONTACT, self.touching), Group("no contact", style.FREE, ~self.touching)]
        if self.segments:
            names, colours = np.array(self.segments)[self.facets.segment], dict[str, str]()
            others = itertools.cycle(style.SEGMENTS)
            for each in sorted(set(self.segments)):
                own = style.OF_SEGMENT.get(each)  # "contact" and "lower" have one colour, but not in one picture
                colours[each] = next(others) if own is None or own in colours.values() else own
            groups = [Group(each, colour, names == each) for each, colour in colours.items()]
        return [group for group in groups if group.facets.any()]

    @cached_property
    def measure(self) -> Array:
        """|T| per cell."""
        corners = self.fields.points[self.fields.cells]
        edges = corners[:, 1:] - corners[:, :1]
        return np.abs(np.linalg.det(edges)) / (2 if self.dim == 2 else 6)

    @cached_property
    def u(self) -> Array:
        """u_h at the vertices: p_h on Γ_S, u_D on Γ_D, elsewhere the mean over the cells around."""
        inner = self.fields.u
        finite = np.isfinite(self.boundary.u)
        vertices = self.boundary.vertices[finite].ravel()
        count = np.bincount(vertices, minlength=len(inner))
        total = np.bincount(vertices, np.repeat(self.boundary.u[finite], self.dim), minlength=len(inner))
        return np.where(count > 0, total / np.maximum(count, 1), inner)

    @cached_property
    def sigma_norm(self) -> Array:
        """|σ_h| per cell, at its centroid."""
        return np.linalg.norm(self.fields.sigma, axis=1)

    def interfaces(self) -> Indices:
        """Edges between cells of different regions, in the plane: shape (edges, 2)."""
        regions = self.fields.regions
        return self._facets_between(regions if regions is not None and regions.shape[1] > 1 else None)

    def free_boundary(self) -> Indices:
        """Facets between cells in different states of laws in Ω, shape (facets, dim)."""
        states = self.fields.states
        return self._facets_between(None if states is None else states[:, None])

    def _facets_between(self, groups: Mask | Indices | None) -> Indices:
        """Facets between cells in different groups; these are a mask, a column for each, or numbers in a column."""
        if groups is None:
            return np.empty((0, self.dim), dtype=np.int64)
        cells, corners = self.fields.cells, list(itertools.combinations(range(self.dim + 1), self.dim))
        facets = np.sort(np.concatenate([cells[:, some] for some in corners]), axis=1)
        _, region = np.unique(groups, axis=0, return_inverse=True)
        both = np.column_stack([facets, np.tile(region.ravel(), len(corners))])
        different = np.unique(both, axis=0)[:, : self.dim]
        between, times = np.unique(different, axis=0, return_counts=True)
        return between[times == 2]


@dataclass(frozen=True)
class Pictures:
    """How the solutions of a physics are drawn (rank 0).

    Attributes:
        caption: Gives what stands below the title: algorithm, mesh, certified error, in mathematical type.
        draw_files: Draws all files of a scene into a folder.
        overview: Gives the picture that a notebook shows.
        draw_steps: Draws a run in time into a folder, from its scene at the end and from tables, times and rows.
        animated: Whether a run in time has an animation in the plane.
    """

    caption: Callable[[Any, Fields, Certificate | None], str]
    draw_files: Callable[[Path, Scene], None]
    overview: Callable[[Scene], Sheet]
    draw_steps: Callable[..., None]
    animated: bool = False


def thinned(points: Array, triangles: Indices, most: int) -> tuple[Indices, Indices]:
    """Fewer triangles with the same corners and edges, for pictures of large meshes.

    All vertices within a box of a grid are replaced by one of them: the one that is farthest from the mean of its
    neighbours, so that boundaries stay in place.

    Returns:
        The remaining triangles, and their rows in `triangles`.
    """
    rows = np.arange(len(triangles))
    if len(triangles) <= most:
        return triangles, rows
    corners = np.zeros((len(triangles), 3, 3))
    corners[:, :, : points.shape[1]] = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.sqrt(np.linalg.norm(normals, axis=1).sum() / most)  # twice the area; two triangles per box
    box = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    _, box_of = np.unique(box, axis=0, return_inverse=True)
    box_of = box_of.ravel()
    vertices, others = triangles.ravel(), np.roll(triangles, 1, axis=1).ravel()
    count = np.maximum(np.bincount(vertices, minlength=len(points)), 1)
    offsets = [np.bincount(vertices, x[others] - x[vertices], minlength=len(points)) / count for x in points.T]
    order = np.lexsort((np.linalg.norm(offsets, axis=0), box_of))
    last = np.append(np.diff(box_of[order]) > 0, True)
    chosen = order[last][box_of]
    moved = chosen[triangles]
    kept = (moved[:, 0] != moved[:, 1]) & (moved[:, 1] != moved[:, 2]) & (moved[:, 2] != moved[:, 0])
    return moved[kept], rows[kept]


def chains(edges: Indices) -> list[tuple[Indices, Indices]]:
    """Edges joined end to end.

    Args:
        edges: Vertices of each, shape (edges, 2).

    Returns:
        For each chain the rows of its edges, and its vertices in order, one more than edges. The last vertex of a
        closed chain is its first one.
    """
    around: dict[int, list[int]] = {}
    for row, ends in enumerate(edges.tolist()):
        for vertex in ends:
            around.setdefault(vertex, []).append(row)
    left = set(range(len(edges)))
    ends_of = edges.tolist()
    starts = [row for row, (a, b) in enumerate(ends_of) if len(around[a]) == 1 or len(around[b]) == 1]
    chains = []
    for row in [*starts, *range(len(edges))]:
        if row not in left:
            continue
        a, b = ends_of[row]
        vertices, rows = ([b, a] if len(around[b]) == 1 else [a, b]), [row]
        left.discard(row)
        while (following := next((r for r in around[vertices[-1]] if r in left), None)) is not None:
            left.discard(following)
            rows.append(following)
            a, b = ends_of[following]
            vertices.append(a if b == vertices[-1] else b)
        chains.append((np.array(rows), np.array(vertices)))
    return chains


def creases(points: Array, triangles: Indices, angle: float = 30) -> Indices:
    """Edges where triangles end or meet at more than this angle, shape (edges, 2), for triangles of any orientation."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [0, 2]]]), axis=1)
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    order = np.lexsort(edges.T)
    first, second = order[:-1], order[1:]
    pair = np.all(edges[first] == edges[second], axis=1)
    cosine = np.abs(np.sum(normals[first % len(triangles)] * normals[second % len(triangles)], axis=1))
    flat = cosine >= np.cos(np.radians(angle))
    inner = np.zeros(len(edges), dtype=bool)
    inner[first] |= pair & flat
    inner[second] |= pair & flat
    return np.unique(edges[~inner], axis=0)
