"""The input of pictures: gathered arrays of one solution on rank 0, and values computed from them."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from matplotlib import patheffects

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import owned_values
from signorini_fenicsx.base.polylines import chains
from signorini_fenicsx.base.rows import in_digits
from signorini_fenicsx.base.tolerances import TIE
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.plot import Plot, plot_of
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.contact.history import Step
from signorini_fenicsx.discrete.mesh_spaces import DIRICHLET, NEUMANN
from signorini_fenicsx.discrete.site_table import Facets, Surfaces
from signorini_fenicsx.meshes.domain import membership
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.gather import (
    PARTLY_FIXED,
    DrawnBoundary,
    DrawnFields,
    boundary_of,
    fields_of,
    sample_of,
)
from signorini_fenicsx.pictures.panels import File, Overlay, Panel, Pictures
from signorini_fenicsx.pictures.sample import Sample
from signorini_fenicsx.solving.physics import PHYSICS
from signorini_fenicsx.solving.solved import Solved


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


@dataclass(frozen=True, eq=False)
class Scene:
    """A solution for pictures (rank 0).

    Attributes:
        solution: The solution, of which this rank has a share.
        caption: Algorithm, mesh and certified error, in mathematical type.
        fields: Mesh and values in the cells.
        boundary: The whole boundary.
        surfaces: What has tables: Γ_S, or what stands in its place, and others.
        besides: What is drawn over maps besides what can be seen from these.
        given: What is drawn over maps, if not the boundary and what the physics has.
        frame: Smallest and largest coordinates of maps, shape (2, 2), if not those of the domain.
    """

    solution: Solved
    caption: str
    fields: DrawnFields
    boundary: DrawnBoundary
    surfaces: Sequence[Surfaces]
    besides: Sequence[Overlay] = ()
    given: Sequence[Overlay] | None = None
    frame: Array | None = None

    @property
    def surface(self) -> Surfaces:
        """Γ_S, or what stands in its place."""
        return self.surfaces[0]

    @property
    def facets(self) -> Facets:
        """Its facets."""
        return self.surface.facets

    @property
    def sites(self) -> Any:
        """Its table."""
        return self.surface.table

    @cached_property
    def opposite(self) -> Scene | None:
        """The scene with what is opposite to Γ_S in its place, if that has a table too."""
        return replace(self, surfaces=self.surfaces[1:]) if len(self.surfaces) > 1 else None

    @property
    def pictures(self) -> Pictures:
        """What its physics draws."""
        return PHYSICS[self.solution.physics].pictures

    @property
    def title(self) -> str:
        """Title of the problem."""
        return self.solution.title or self.solution.name

    @property
    def dim(self) -> int:
        """Dimension, 2 or 3."""
        return int(self.fields.points.shape[1])

    @cached_property
    def files(self) -> Mapping[str, File]:
        """The panels of each file, see `Pictures.files`."""
        return self.pictures.files(self)

    @property
    def labels(self) -> dict[str, str]:
        """For each part of Γ_S, or of what stands in its place, the name of the coordinate along it."""
        return {name: self.solution.spaces.domain.parts[name].label for name in self.surface.names}

    @property
    def history(self) -> list[Step]:
        """Steps of the algorithm."""
        return self.solution.outcome.history

    @property
    def plot(self) -> Plot:
        """Names of u and of the flux, and level lines."""
        return plot_of(self.solution.source)

    @property
    def gamma(self) -> str:
        """What Γ_S is called, in mathematical type; the parts that stand in its place."""
        letter, names = rf"$\Gamma_{self.solution.gamma[-1]}$", list(self.surface.names)
        return self.word(letter) if names == list(self.solution.spaces.part_names) else ", ".join(names)

    def word(self, text: str) -> str:
        """What legends of this physics say in the place of a text."""
        return self.pictures.words.get(text, text)

    @cached_property
    def rows(self) -> Indices:
        """The rows of the table of sites that belong to each facet, shape (facets, sites)."""
        order, of_sites = (
            np.lexsort((*in_digits(x).T, part))
            for x, part in ((self.facets.x, self.facets.part), (self.sites.middles, self.sites.part))
        )
        rows = np.empty((len(order), len(of_sites) // len(order) if len(order) else 1), dtype=np.int64)
        rows[order] = of_sites.reshape(rows.shape)
        return rows

    def on_facets(self, column: str) -> Array:
        """The means of a column of the table of sites over each facet."""
        values: Array = getattr(self.sites, column)[self.rows].mean(axis=1)
        return values

    def shows(self, panel: Panel, part: str) -> bool:
        """Whether there is more of a panel on a part than 0; what tells its peak tells this too."""
        plane = self.dim == 2
        columns = [getattr(self.sites, key) for key in panel.curves] if plane else [self.on_facets(panel.what)]
        on_part = (self.sites if plane else self.facets).part == list(self.labels).index(part)
        sizes = [np.abs(np.nan_to_num(each)) for each in columns]
        return panel.peak or any(np.any(each[on_part] > TIE * each.max(initial=0.0)) for each in sizes)

    @cached_property
    def by_parts(self) -> list[Scene]:
        """The scene of each part of Γ_S, or of what stands in its place, alone."""
        alone = []
        for index, name in enumerate(self.labels):
            tables = (replace(each, **_rows(each, each.part == index)) for each in (self.facets, self.sites))
            facets, table = (replace(each, part=0 * each.part) for each in tables)
            surface = replace(self.surface, names=[name], facets=facets, table=table)
            alone.append(replace(self, surfaces=[surface]))
        return alone

    @cached_property
    def touching(self) -> Mask:
        """Mask of the facets of Γ_S in contact."""
        touching: Mask = self.sites.in_contact(self.solution.method.contact)[self.rows].any(axis=1)
        return touching

    @cached_property
    def groups(self) -> list[Group]:
        """Γ_S in contact and not in contact, or by the segments of the laws in their order; none of them empty.

        The colour of a segment does not depend on which others have facets, so it stays in time.
        """
        groups = [Group("contact", style.CONTACT, self.touching), Group("no contact", style.FREE, ~self.touching)]
        if segments := self.surface.segments:
            names = np.array(segments)[self.sites.shown[self.rows].min(axis=1, initial=len(segments) - 1)]
            colours = style.colours_of(segments)
            groups = [Group(each, colours[each], names == each) for each in dict.fromkeys(segments)]
        return [group for group in groups if group.facets.any()]

    def colours_in_cells(self, names: Collection[str]) -> dict[str, str]:
        """The colours of segments of laws in Ω: that of a segment of this name on Γ_S, for others none of these."""
        on_gamma = style.colours_of(self.surface.segments)
        return on_gamma | style.colours_of([name for name in names if name not in on_gamma], [*on_gamma.values()])

    @cached_property
    def measure(self) -> Array:
        """|T| per cell."""
        corners = self.fields.points[self.fields.cells]
        edges = corners[:, 1:] - corners[:, :1]
        return np.abs(np.linalg.det(edges)) / (2 if self.dim == 2 else 6)

    def usual(self, values: Array) -> tuple[float, float, str]:
        """Colour limits for values in the cells, see `style.limits`."""
        return style.limits(values, self.measure)

    @cached_property
    def fronts(self) -> tuple[str, Indices]:
        """Facets between cells in different states of laws in Ω, shape (facets, dim), and what they are called."""
        found = ((name, self.between(of_cells[:, None])) for name, of_cells in self.fields.states.items())
        return next(found, ("", np.empty((0, self.dim), dtype=np.int64)))

    def between(self, groups: npt.NDArray) -> Indices:
        """Facets between cells in different groups; these are a mask, a column for each, or numbers in a column."""
        cells, corners = self.fields.cells, list(itertools.combinations(range(self.dim + 1), self.dim))
        facets = np.sort(np.concatenate([cells[:, some] for some in corners]), axis=1)
        _, region = np.unique(groups, axis=0, return_inverse=True)
        both = np.column_stack([facets, np.tile(region.ravel(), len(corners))])
        different = np.unique(both, axis=0)[:, : self.dim]
        between, times = np.unique(different, axis=0, return_counts=True)
        return between[times == 2]

    @cached_property
    def over(self) -> Sequence[Overlay]:
        """What is drawn over maps: what the physics has; in the plane regions, the boundary, Γ_S by its groups too."""
        if self.given is not None:
            return self.given
        return [*self.pictures.over(self, self._usual() if self.dim == 2 else []), *self.besides]

    def _usual(self) -> list[Overlay]:
        """Γ_S by its groups, the other kinds of boundary and the borders of regions, in the plane."""
        points, boundary = self.fields.points, self.boundary
        black = {"color": "black", "linewidth": 1.2, "clip_on": False}
        edge = [patheffects.Stroke(linewidth=4.5, foreground="black"), patheffects.Normal()]
        groups = [
            Overlay(
                f"{self.gamma}, {group.name}",
                [points[vertices] for _, vertices in chains(self.facets.vertices[group.facets])],
                {"color": group.colour, "linewidth": 3, "clip_on": False, "zorder": 5}
                | {"solid_capstyle": "butt", "path_effects": edge},
            )
            for group in self.groups
        ]
        kinds = [
            Overlay(
                self.word(name),
                [points[vertices] for _, vertices in chains(boundary.vertices[boundary.kind == kind])],
                black | {"linestyle": look},
            )
            for kind, name, look in (
                (DIRICHLET, r"$\Gamma_D$", "-"),
                (NEUMANN, r"$\Gamma_N$", ":"),
                (PARTLY_FIXED, "partly fixed", "-."),
            )
        ]
        dashed, regions = {"color": "black", "linewidth": 0.8, "linestyle": "--"}, self.fields.in_cells.get("regions")
        borders = [] if regions is None else [points[each] for _, each in chains(self.between(regions))]
        return [*groups, *kinds, Overlay("regions", borders, dashed)]

    def with_surface(self, **changed: Any) -> Scene:
        """The scene with what is changed of Γ_S, such as its table."""
        return replace(self, surfaces=[replace(self.surface, **changed), *self.surfaces[1:]])

    def at(self, points: Array, over: Sequence[Overlay] = ()) -> Scene:
        """The scene with its points in other places, and with other things over its maps."""
        return replace(self, fields=replace(self.fields, points=points), given=over)


def sizes(values: Array) -> Array:
    """Numbers, of vectors their lengths."""
    return values if values.ndim == 1 else np.linalg.norm(values, axis=1)


def scale_on_gamma(panel: Panel, scenes: Sequence[Scene]) -> tuple[float, float, str]:
    """Colour limits for a column of tables, and the ends of the colour bar to extend; facets with NaN do not count.

    Those of lengths of vectors, and of what has a peak, begin at 0.
    """
    columns = [scene.on_facets(panel.what) for scene in scenes]
    values, measure = np.concatenate([sizes(each) for each in columns]), [scene.facets.measure for scene in scenes]
    finite = np.isfinite(values)
    least = 0.0 if panel.peak or columns[0].ndim > 1 else values[finite].min()
    low, high, extend = style.limits(values[finite] - least, np.concatenate(measure)[finite])
    return 0.0 if least == 0 else low + least, high + least, extend


def gathered_scene(
    solution: Solved,
    certificate: Certificate | None = None,
    indicator: fem.Function | None = None,
    sample: Sample | None = None,
) -> Scene | None:
    """The scene of a solution on rank 0; None elsewhere (collective).

    Args:
        solution: The solution.
        certificate: Its error bound, if there is one.
        indicator: η_T of another bound.
        sample: The sample of its mesh, if that is known.
    """
    drawn, spaces = PHYSICS[solution.physics].pictures.drawn(solution), solution.spaces
    sample, comm = sample or sample_of(spaces), spaces.mesh.comm
    indicator = certificate.indicator if certificate is not None else indicator
    cells = {**drawn.cells, **({} if indicator is None else {"indicator": owned_values(indicator)})}
    if len(spaces.domain.regions) > 1:
        cells["regions"] = membership(spaces.domain)
    fields = fields_of(sample, drawn.corners, cells, drawn.states)
    boundary = boundary_of(spaces.mesh, drawn.boundary, sample)
    surfaces = [surface for each in drawn.surfaces if (surface := each.gathered(comm)) is not None]
    if fields is None or boundary is None:
        return None
    places = (replace(each.facets, vertices=sample.rows_of(each.facets.vertices)) for each in surfaces)
    return Scene(
        solution=solution,
        caption=caption(solution, [fields.count, *drawn.words], certificate),
        fields=fields,
        boundary=boundary,
        surfaces=[replace(each, facets=facets) for each, facets in zip(surfaces, places, strict=True)],
        besides=drawn.over,
    )


def _rows(table: Any, rows: Mask) -> dict[str, npt.NDArray]:
    """The columns of a table on some of its rows."""
    return {key: values[rows] for key, values in vars(table).items()}


def caption(solution: Solved, words: Sequence[str], certificate: Certificate | None) -> str:
    """Algorithm, h, ε, cells and the certified error, in Matplotlib's mathematical type."""
    h = solution.spaces.domain.h
    asked = solution.source.solve.h if isinstance(solution.source, CaseFile) and solution.spaces.domain.is_shape else h
    h = asked if asked / 2 < h <= asked * (1 + 1e-12) else h
    eps = [rf"$\varepsilon = {style.power(solution.options.eps)}$"] if solution.method.has_eps else []
    bound = style.bound_in_words(certificate)
    method = solution.approach.replace("_h", "$_h$")
    return ", ".join([method, rf"$h = {style.power(h)}$", *eps, *words, *bound])
