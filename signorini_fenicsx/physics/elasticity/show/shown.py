"""What is shown of an elastic solution: fields, tables, pictures, lines of a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import dolfinx.mesh
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.contact.laws import Friction, Signorini
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, linear_from_means
from signorini_fenicsx.discrete.mesh_spaces import NEUMANN
from signorini_fenicsx.discrete.simplices import blocks_of_cells, opposite
from signorini_fenicsx.discrete.site_table import Facets, SiteTable, along_parts
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import to_entries
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.solve.residuals import imbalance
from signorini_fenicsx.solving.drawn import PARTLY_FIXED, Drawn, whole_boundary
from signorini_fenicsx.solving.fields import IN_CELLS, Field, Fields, von_mises
from signorini_fenicsx.solving.solved import Columns

if TYPE_CHECKING:  # it shows this
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution


def fields(solution: ElasticSolution) -> Fields:
    """The fields, see `Solved.fields`: u_h and σ_h as they are, and what is missing in the equilibrium.

    On Γ_C they are u_h, pressure, gap and the states of contact and friction, at the vertices of each facet.
    """
    spaces, data, contact = solution.spaces, solution.data, solution.spaces.contact
    u, left = spaces.displacement_values(solution.u), imbalance(spaces, data, solution.stresses)
    on_cells = [
        Field("sigma", in_space(spaces, data, solution.stresses), order=2),
        Field("u", u, order=1, at_points=True),
        Field("equilibrium", np.linalg.norm(left, axis=2).max(axis=1)),
    ]
    if not spaces.part_names:
        return {IN_CELLS: on_cells}
    on_facets = [
        Field("u", u[contact.cells[:, None], opposite(spaces.dim)[contact.local]], order=1),
        Field("pressure", solution.pressure),
        Field("gap", solution.linear_gap),
        Field("contact", solution.touching, names=("open", "contact")),
    ]
    if data.laws.of_parts:
        segment = _labels(solution).reshape(solution.touching.shape)
        on_facets.append(Field("segment", segment, names=_segment_names(solution)))
    if data.friction:
        shear, slip, state = solution.on_all_contact()
        order = spaces.dim - 2  # in space they are vectors
        if order:
            shear, slip = _friction_vectors(solution)
        on_facets += [Field("shear", shear, order=order), Field("slip", slip, order=order)]
        on_facets.append(Field("friction", state, names=STATES))
    return {IN_CELLS: on_cells, "contact": on_facets}


def in_space(spaces: ElasticSpaces, data: ElasticData, stresses: Array) -> Array:
    """The stress at the vertices of the subcells as a matrix in space, shape (cells, d + 1, d + 1, 3, 3).

    In plane strain σ_zz is that of `Material.out_of_plane`, with means over the cell.
    """
    missing = 3 - spaces.dim
    padded = np.pad(stresses, (*[(0, 0)] * 3, (0, missing), (0, missing)))
    if data.material.in_strain:
        for cells in blocks_of_cells(spaces.mesh):
            share, rest = (values.mean(axis=1) for values in data.material.out_of_plane(data.points(spaces, cells)))
            padded[cells, :, :, 2, 2] = np.einsum("ne,nsae->nsa", share, to_entries(stresses[cells]))
            padded[cells, :, :, 2, 2] += rest[:, None, None]
    return padded


STATES = (*Friction.segments, "open", "slip")
"""The states of a vertex with friction; "slip" is that in space, which has no sign."""


@dataclass(frozen=True)
class ContactTable(SiteTable):
    """One row per vertex of each facet of Γ_C.

    Attributes:
        middle: Coordinate of the midpoint of the facet along the part.
        facet: Its midpoint, shape (rows, 3).
        measure: |e|.
        pressure: −σ_nn.
        gap: g − u_n, linear on the facet.
        touching: Whether it is in contact.
        segment: Index into the names of the segments of all laws.
        shear: σ_t, in space |σ_t|, NaN without friction.
        slip: u_t likewise.
        shear_vector: σ_t as a vector in space, shape (rows, 3).
        slip_vector: u_t likewise.
        state: Index into `STATES`, −1 without friction.
        forward: 1 where the coordinate along the part grows along the tangent, −1 where it falls; 0 in space.
    """

    middle: Array
    facet: Array
    measure: Array
    pressure: Array
    gap: Array
    touching: Mask
    segment: npt.NDArray[np.int64]
    shear: Array
    slip: Array
    shear_vector: Array
    slip_vector: Array
    state: npt.NDArray[np.int64]
    forward: npt.NDArray[np.int64]
    name = "contact"
    places = ("along", "x", "middle", "facet")

    @property
    def middles(self) -> Array:
        """The middle of the facet of each vertex, shape (rows, 3)."""
        return self.facet

    @property
    def shown(self) -> Indices:
        """What pictures tell apart, in `Drawn.segments`: the state of friction in contact, else the segment."""
        return np.where(self.touching & (self.state >= 0), self.state - len(STATES), self.segment)

    def in_contact(self, contact: object) -> Mask:
        """Mask of the vertices in contact."""
        return self.touching

    @property
    def _rubs(self) -> Mask:
        """Mask of the vertices that are in contact, or have a bound of the shear though they are not."""
        return self.touching | ((self.state >= 0) & (self.state != STATES.index("open")))

    @property
    def sliding(self) -> Array:
        """The slip of vertices that are not apart, else NaN."""
        return np.where(self._rubs, self.slip, np.nan)

    @property
    def sliding_vector(self) -> Array:
        """The slip as a vector likewise."""
        return np.where(self._rubs[:, None], self.slip_vector, np.nan)

    @property
    def number(self) -> Indices:
        """The number of the facet of each row; facets are counted as they come."""
        places = np.column_stack([self.part, self.facet])
        _, first, facet = np.unique(places, axis=0, return_index=True, return_inverse=True)
        return np.argsort(np.argsort(first))[facet.ravel()]


def table(solution: ElasticSolution) -> ContactTable:
    """The vertices of the facets of Γ_C of this rank."""
    spaces = solution.spaces
    contact, dim = spaces.contact, spaces.dim
    part = np.repeat(spaces.part_of_facet, dim).astype(np.int64)
    places = np.pad(contact.vertices, ((0, 0), (0, 0), (0, 3 - dim))).reshape(-1, 3)
    along, middles = along_parts(spaces, part, places), np.repeat(_middles(contact), dim, axis=0)
    shear, slip, state = (values.ravel() for values in solution.on_all_contact())
    shear_vector, slip_vector = _friction_vectors(solution)
    return ContactTable(
        part=part,
        along=along,
        x=places,
        middle=along_parts(spaces, part, middles),
        facet=middles,
        measure=np.repeat(contact.measure, dim),
        pressure=solution.pressure.ravel(),
        gap=solution.linear_gap.ravel(),
        touching=solution.touching.ravel(),
        segment=_labels(solution),
        shear=shear,
        slip=slip,
        shear_vector=shear_vector.reshape(-1, 3),
        slip_vector=slip_vector.reshape(-1, 3),
        state=np.nan_to_num(state, nan=-1.0).astype(np.int64),
        forward=np.repeat(_forward(contact, along), dim),
    )


def _middles(contact: BoundaryFacets) -> Array:
    """The midpoints of facets to the last digit, whatever the order of their vertices, shape (facets, 3)."""
    dim = contact.vertices.shape[2]
    return np.pad(np.sort(contact.vertices, axis=1).mean(axis=1), ((0, 0), (0, 3 - dim)))


def _friction_vectors(solution: ElasticSolution) -> Array:
    """σ_t and linear u_t as vectors in space at the vertices on Γ_C, shape (2, facets, d, 3); NaN without friction."""
    rough, missing = (solution.shear_vectors, linear_from_means(solution.slip_vectors)), 3 - solution.spaces.dim
    in_space = (np.pad(vectors, ((0, 0), (0, 0), (0, missing))) for vectors in rough)
    return np.stack([solution.spaces.site_kinds["slip"].spread(vectors, np.nan) for vectors in in_space])


def columns(solution: ElasticSolution, table: ContactTable) -> Columns:
    """The columns of `contact.csv`."""
    columns: dict[str, npt.NDArray] = {
        "part": np.array(solution.contact_parts)[table.part],
        "facet": table.number,
        "measure": table.measure,
        **dict(zip("xyz", table.x.T, strict=True)),
        "pressure": table.pressure,
        "gap": table.gap,
        "condition": np.where(table.touching, "contact", "open"),
    }
    if solution.data.laws.of_parts:
        columns["segment"] = np.array(_segment_names(solution))[table.segment]
    if not solution.data.friction:
        return columns
    states = np.array(STATES)[table.state]
    rubbing = {"shear": table.shear, "slip": table.slip, "friction": states}
    for name, vectors in {"shear": table.shear_vector, "slip": table.slip_vector}.items():
        rubbing |= {f"{name}_{axis}": vectors[:, i] for i, axis in enumerate("xyz") if solution.spaces.dim == 3}
    for name, values in rubbing.items():
        columns[name] = values.astype(object)
        columns[name][table.state < 0] = None
    return columns


def _segment_names(solution: ElasticSolution) -> list[str]:
    """Names of the segments of contact, then of those of all laws."""
    return [*Signorini.segments, *(name for law in solution.data.laws.of_parts for name in law.law.segments)]


def _labels(solution: ElasticSolution) -> npt.NDArray[np.int64]:
    """For each facet vertex the row of its segment in `_segment_names`."""
    labels, first = solution.segment.reshape(solution.touching.shape).astype(np.int64), len(Signorini.segments)
    for law in solution.data.laws.of_parts:
        labels[law.rows] = law.law.named(labels[law.rows]) + first
        first += len(law.law.segments)
    return labels.ravel()


def _forward(contact: BoundaryFacets, along: Array) -> npt.NDArray[np.int64]:
    """The sign with which the coordinate along the part grows along the tangent of each facet; 0 in space."""
    if contact.vertices.shape[2] == 3:
        return np.zeros(len(contact.facets), dtype=np.int64)
    tangents = np.column_stack([-contact.normals[:, 1], contact.normals[:, 0]])
    edges = np.einsum("ni,ni->n", contact.vertices[:, 1] - contact.vertices[:, 0], tangents)
    return np.sign(edges * np.diff(along.reshape(-1, 2), axis=1)[:, 0]).astype(np.int64)


@dataclass(frozen=True)
class BodyFacets(Facets):
    """One row per facet of Γ_C.

    Attributes:
        normals: The outer unit normals, shape (facets, d).
        gaps: The gap at the vertices of each facet, linear on it, shape (facets, d).
        apart: The gap before any displacement there, 0 but for parts inside the domain and slaves of pairs.
        paired: 1 for slaves of pairs, else 0.
    """

    normals: Array
    gaps: Array
    apart: Array
    paired: Array


def drawn(solution: ElasticSolution) -> Drawn:
    """The solution for pictures: for σ the largest von Mises stress of each cell (collective)."""
    spaces, nothing = solution.spaces, np.empty(0, dtype=np.int32)
    by_geometry = np.argsort(spaces.order, axis=1)[:, :, None]
    fixed = np.concatenate([nothing, *(spaces.domain.facets[part] for part in solution.boundary.fixed)])
    free = np.setdiff1d(spaces.neumann_facets, fixed)
    kinds = {NEUMANN: free, PARTLY_FIXED: fixed}
    u = np.take_along_axis(spaces.displacement_values(solution.u), by_geometry, axis=1)
    stress = von_mises(in_space(spaces, solution.data, solution.stresses)).max(axis=(1, 2))[:, None]
    named = solution.data.laws.of_parts or solution.data.friction
    return Drawn(
        corners={"u": u, "stress": np.repeat(stress[:, None], spaces.dim + 1, axis=1)},
        facets=_facets(solution),
        boundary=whole_boundary(spaces)
        | {kind: (facets, np.full(len(facets), np.nan)) for kind, facets in kinds.items()},
        cells={"u": u.mean(axis=1), "stress": stress},
        segments=[*_segment_names(solution), *STATES] if named else (),
        inside=[*solution.boundary.inner, *(part for pair in solution.boundary.pairs for part in pair.slave)],
    )


def _facets(solution: ElasticSolution) -> BodyFacets:
    spaces, contact = solution.spaces, solution.spaces.contact
    part = spaces.part_of_facet.astype(np.int64)
    middle = _middles(contact)
    apart = np.zeros((len(middle), spaces.dim))
    normal = spaces.site_kinds["normal"]
    means = normal.rows_of(solution.data.lift[normal.unknown] + solution.data.laws.p_h)
    slaves = np.concatenate([[], *(spaces.rows_of(joint) for joint in spaces.joints)]).astype(np.int64)
    opposite = np.concatenate([spaces.inner.rows, slaves])
    apart[opposite] = linear_from_means(means)[opposite]
    nodes = dolfinx.mesh.entities_to_geometry(spaces.mesh, spaces.dim - 1, contact.facets)
    numbers = np.take_along_axis(spaces.mesh.geometry.input_global_indices[nodes], contact.ranking, axis=1)
    ascending = np.argsort(numbers, axis=1)
    return BodyFacets(
        part=part,
        along=along_parts(spaces, part, middle),
        x=middle,
        measure=contact.measure,
        vertices=np.take_along_axis(numbers, ascending, axis=1),
        normals=contact.normals,
        gaps=np.take_along_axis(solution.linear_gap, ascending, axis=1),
        apart=np.take_along_axis(apart, ascending, axis=1),
        paired=np.isin(np.arange(len(middle)), slaves).astype(float),
    )


def lines(solution: ElasticSolution, summary: Mapping[str, Any]) -> dict[str, str]:
    """The lines of a report, see `Solved.lines`."""
    touching = f"{summary['touching_vertices']} facet vertices, measure {summary['contact_measure']:.6g}"
    texts = {
        **({"contact": touching} if solution.spaces.part_names else {}),
        "forces": _forces(summary["resultants"], solution.spaces.dim),
        "largest": _largest(summary["quantities"]),
    }
    for part, about in summary["quantities"]["contact"].items():
        texts[f"on {part}"] = _pressed(about)
    for part, about in summary["quantities"].get("tools", {}).items():
        texts[f"on {part}"] += f"; the tool has moved by {_moved(about)}"
    if "least_gap" in summary:
        least = f"negative, down to {summary['least_gap']:.4g}"
        other = "another body" if solution.boundary.inner or solution.boundary.pairs else "the foundation"
        texts["gap"] = f"{least}: there {other} reaches into the body at rest, and is taken to press it back"
    for part, segments in summary.get("segments", {}).items():
        counts = ", ".join(f"{name} {count['vertices']}" for name, count in segments.items())
        texts[f"on {part}"] += f"; facet vertices on each segment: {counts}"
    if "friction" in summary:
        states = (f"{name} {of_state['vertices']}" for name, of_state in summary["friction"].items())
        texts["friction"] = f"facet vertices: {', '.join(states)}"
    if "coulomb" in summary:
        texts["Coulomb"] = _fixed_point(summary["coulomb"])
    return texts


def _forces(resultants: dict[str, list[float]], dim: int) -> str:
    """The force on each part, and the largest of what is left of all forces and moments."""
    forces = {name: ", ".join(f"{value:.5g}" for value in values[:dim]) for name, values in resultants.items()}
    del forces["sum"]
    left = max(map(abs, resultants["sum"]))
    return f"{'  '.join(f'{name} ({force})' for name, force in forces.items())}; all together {left:.1e}"


def _largest(about: Mapping[str, Any]) -> str:
    """The largest stress and displacement with their places."""
    names = {"von_mises": "von Mises", "displacement": "|u|"}
    return ", ".join(f"{word} {_at(about[key])}" for key, word in names.items())


def _pressed(about: Mapping[str, Any]) -> str:
    """How a part is pressed."""
    words = [f"pressure at most {_at(about['peak_pressure'])}", f"area {about['area']:.5g}"]
    words += [f"width {about['width']:.5g}"] if "width" in about else []
    if "center_of_pressure" in about:
        words.append(f"center ({', '.join(f'{x:.4g}' for x in about['center_of_pressure'])})")
    return ", ".join(words)


def _moved(about: Mapping[str, Any]) -> str:
    """The motion of a tool."""
    words = [f"{length:.5g} along {axis}" for axis, length in about["displacement"].items()]
    words += [f"the angle {angle:.5g} about {axis}" for axis, angle in about.get("rotation", {}).items()]
    return " and ".join(words)


def _at(largest: Mapping[str, Any]) -> str:
    """A value and its place."""
    return f"{largest['largest']:.5g} at ({', '.join(f'{x:.4g}' for x in largest['at'])})"


def _fixed_point(about: Mapping[str, Any]) -> str:
    """How the bound of Coulomb's friction was found, and whether there may be others."""
    changes = about["changes"]
    few = ", ".join(f"{change:.0e}" for change in changes[-3:])
    others = "" if about["other_solutions"] == "none" else "; other solutions are not excluded"
    return f"the bound of the shear, in {counted(len(changes), 'step')}, at last off the law by {few}{others}"
