"""The tables of an elastic solution: the vertices of the facets of Γ_C, and of what is opposite to them in pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.tolerances import TIE
from signorini_fenicsx.contact.laws import Friction, Signorini
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, linear_from_means, means_of_linear
from signorini_fenicsx.discrete.pairing import MeshPair
from signorini_fenicsx.discrete.site_table import Facets, SiteTable, Surfaces, along_parts
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.solving.solved import Columns

if TYPE_CHECKING:  # it has these
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

STATES = (*Friction.segments, "open", "slip")
"""The states of a vertex with friction; "slip" is that in space, which has no sign."""


@dataclass(frozen=True)
class TractionTable(SiteTable):
    """One row per vertex of each facet of some parts.

    Attributes:
        middle: Coordinate of the midpoint of the facet along the part.
        facet: Its midpoint, shape (rows, 3).
        measure: |e|.
        forward: 1 where the coordinate along the part grows along the tangent, −1 where it falls; 0 in space.
        pressure: −σ_nn.
        touching: Whether it is in contact; of what has no law, whether there is any traction.
        shear: σ_t, in space |σ_t|; on Γ_C NaN without friction.
        shear_vector: σ_t as a vector in space, shape (rows, 3).
    """

    middle: Array
    facet: Array
    measure: Array
    forward: npt.NDArray[np.int64]
    pressure: Array
    touching: Mask
    shear: Array
    shear_vector: Array
    name = "pairs"
    places = ("along", "x", "middle", "facet")

    @property
    def middles(self) -> Array:
        """The middle of the facet of each vertex, shape (rows, 3)."""
        return self.facet

    def in_contact(self, contact: object) -> Mask:
        """Mask of the vertices in contact."""
        return self.touching

    @property
    def number(self) -> Indices:
        """The number of the facet of each row; facets are counted as they come."""
        places = np.column_stack([self.part, self.facet])
        _, first, facet = np.unique(places, axis=0, return_index=True, return_inverse=True)
        return np.argsort(np.argsort(first))[facet.ravel()]


@dataclass(frozen=True)
class ContactTable(TractionTable):
    """One row per vertex of each facet of Γ_C.

    Attributes:
        gap: g − u_n, linear on the facet.
        segment: Index into the names of the segments of all laws.
        slip: u_t as `shear` has σ_t.
        slip_vector: u_t as a vector in space, shape (rows, 3).
        state: Index into `STATES`, −1 without friction.
    """

    gap: Array
    segment: npt.NDArray[np.int64]
    slip: Array
    slip_vector: Array
    state: npt.NDArray[np.int64]
    name = "contact"

    @property
    def shown(self) -> Indices:
        """What pictures tell apart, in `Surfaces.segments`: the state of friction in contact, else the segment."""
        return np.where(self.touching & (self.state >= 0), self.state - len(STATES), self.segment)

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


def table(solution: ElasticSolution) -> ContactTable:
    """The vertices of the facets of Γ_C of this rank."""
    spaces = solution.spaces
    shear, slip, state = solution.on_all_contact()
    shear_vector, slip_vector = friction_vectors(solution)
    for pair in spaces.pairs:  # without friction the slip is no unknown
        rows = spaces.rows_of(pair)
        smooth = ~np.isin(rows, spaces.rough_rows)
        slides = jumps(solution, pair)[: len(rows)][smooth]
        slip_vector[rows[smooth]] = _in_space(slides)
        slip[rows[smooth]] = _along(spaces.contact.normals[rows[smooth]], slides)
    return ContactTable(
        **_places(spaces, spaces.contact, spaces.part_of_facet, spaces.part_names),
        pressure=solution.pressure.ravel(),
        gap=solution.linear_gap.ravel(),
        touching=solution.touching.ravel(),
        segment=labels(solution),
        shear=shear.ravel(),
        slip=slip.ravel(),
        shear_vector=shear_vector.reshape(-1, 3),
        slip_vector=slip_vector.reshape(-1, 3),
        state=np.nan_to_num(state.ravel(), nan=-1.0).astype(np.int64),
    )


def _places(spaces: ElasticSpaces, facets: BoundaryFacets, parts: npt.NDArray, names: Sequence[str]) -> dict[str, Any]:
    """The columns of a `TractionTable` that say where its rows are."""
    dim, part = spaces.dim, np.repeat(parts, spaces.dim).astype(np.int64)
    places, middle = _in_space(facets.vertices).reshape(-1, 3), np.repeat(middles(facets), dim, axis=0)
    along = along_parts(spaces, part, places, names)
    return {
        "part": part,
        "along": along,
        "x": places,
        "middle": along_parts(spaces, part, middle, names),
        "facet": middle,
        "measure": np.repeat(facets.measure, dim),
        "forward": np.repeat(_forward(facets, along), dim),
    }


def _in_space(vectors: Array) -> Array:
    """Vectors as those in space."""
    return np.pad(vectors, (*[(0, 0)] * (vectors.ndim - 1), (0, 3 - vectors.shape[-1])))


def _along(normals: Array, vectors: Array) -> Array:
    """Tangential vectors at the vertices of facets as numbers: along n turned to the left, in space their lengths."""
    if vectors.shape[-1] == 3:
        return np.asarray(np.linalg.norm(vectors, axis=2))
    return np.einsum("nai,ni->na", vectors, np.column_stack([-normals[:, 1], normals[:, 0]]))


def middles(contact: BoundaryFacets) -> Array:
    """The midpoints of facets to the last digit, whatever the order of their vertices, shape (facets, 3)."""
    return _in_space(np.sort(contact.vertices, axis=1).mean(axis=1))


def friction_vectors(solution: ElasticSolution) -> Array:
    """σ_t and linear u_t as vectors in space at the vertices on Γ_C, shape (2, facets, d, 3); NaN without friction."""
    rough = solution.shear_vectors, linear_from_means(solution.slip_vectors)
    return np.stack([solution.spaces.site_kinds["slip"].spread(_in_space(vectors), np.nan) for vectors in rough])


def jumps(solution: ElasticSolution, pair: MeshPair) -> Array:
    """The tangential part of u_h less u_h∘χ on the slaves of a pair, shape (slaves, d, d) (collective).

    These are values at the vertices of the linear functions with its means weighted by the hats.
    """
    spaces = solution.spaces
    u = spaces.displacement_values(solution.u)

    def on(numbers: npt.NDArray[np.int32]) -> Array:
        facets = spaces.boundary_facets(numbers)
        return u[facets.cells][np.arange(spaces.dim + 1) != facets.local[:, None]].reshape(-1, spaces.dim, spaces.dim)

    means = means_of_linear(on(pair.slaves)) - pair.opposite(spaces.mesh.comm, on(pair.masters))
    normals = pair.slave.normals[:, None]
    return linear_from_means(means - normals * (means * normals).sum(axis=2, keepdims=True))


def opposite_surfaces(solution: ElasticSolution) -> Surfaces | None:
    """The masters of pairs and the slaves that are tied; None without pairs (collective).

    They have the traction σ_h n, which on masters is what their slaves pass on and what is given there besides.
    """
    spaces = solution.spaces
    sides = [name for pair in spaces.pairs for name in (*pair.parts.slave, *pair.parts.master)]
    names = [name for name in dict.fromkeys(sides) if name not in spaces.part_names]
    if not names:
        return None
    counts = [len(spaces.domain.facets[name]) for name in names]
    facets = spaces.boundary_facets(np.concatenate([spaces.domain.facets[name] for name in names]))
    part = np.repeat(np.arange(len(names)), counts)
    tractions = spaces.tractions(facets, solution.stresses)
    pulls = np.einsum("nai,ni->na", tractions, facets.normals)
    shears = tractions - pulls[:, :, None] * facets.normals[:, None]
    size = np.linalg.norm(tractions, axis=2)
    rounding = TIE * spaces.mesh.comm.allreduce(float(size.max(initial=0.0)), MPI.MAX)
    pulls[np.abs(pulls) <= rounding], shears[np.linalg.norm(shears, axis=2) <= rounding] = 0.0, 0.0
    places = _places(spaces, facets, part, names)
    rows = TractionTable(
        **places,
        pressure=-pulls.ravel(),
        touching=(size > rounding).ravel(),
        shear=_along(facets.normals, shears).ravel(),
        shear_vector=_in_space(shears).reshape(-1, 3),
    )
    first = slice(None, None, spaces.dim)
    numbers, _ = vertex_numbers(spaces, facets)
    surface = Facets(places["part"][first], places["middle"][first], places["facet"][first], facets.measure, numbers)
    return Surfaces(names, surface, rows, partial(_opposite_columns, names, solution))


def vertex_numbers(spaces: ElasticSpaces, facets: BoundaryFacets) -> tuple[Indices, Indices]:
    """The numbers of the vertices of facets in the mesh, ascending, and where these are among the vertices."""
    nodes = dolfinx.mesh.entities_to_geometry(spaces.mesh, spaces.dim - 1, facets.facets)
    numbers = np.take_along_axis(spaces.mesh.geometry.input_global_indices[nodes], facets.ranking, axis=1)
    ascending = np.argsort(numbers, axis=1)
    return np.take_along_axis(numbers, ascending, axis=1), ascending


def other_tables(solution: ElasticSolution) -> dict[str, Columns]:
    """`pairs.csv`: the tractions on masters and on tied slaves, see `Solved.other_tables` (collective)."""
    if (surfaces := solution.opposite) is None:
        return {}
    table = surfaces.table.gathered(solution.spaces.mesh.comm)
    return {"pairs": {} if table is None else surfaces.columns(table)}


def _opposite_columns(names: Sequence[str], solution: ElasticSolution, table: TractionTable) -> Columns:
    """The columns of `pairs.csv`, whose parts have these names."""
    masters = [name for pair in solution.boundary.pairs for name in pair.master]
    return {
        "part": np.array(names)[table.part],
        "side": np.array(["master" if name in masters else "slave" for name in names])[table.part],
        "facet": table.number,
        "measure": table.measure,
        **dict(zip("xyz", table.x.T, strict=True)),
        "pressure": table.pressure,
        "shear": table.shear,
        **_vectors({"shear": table.shear_vector}, solution.spaces.dim),
    }


def _vectors(named: Mapping[str, Array], dim: int) -> dict[str, Array]:
    """The columns of vectors in space; in the plane a number says all."""
    return {
        f"{name}_{axis}": vectors[:, i] for name, vectors in named.items() for i, axis in enumerate("xyz") if dim == 3
    }


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
        columns["segment"] = np.array(segment_names(solution))[table.segment]
    friction, pairs = bool(solution.data.friction), solution.spaces.pairs
    shown = {"shear": friction, "slip": friction or any(not pair.parts.tied for pair in pairs)}
    numbers = {"shear": table.shear, "slip": table.slip}
    vectors = _vectors({"shear": table.shear_vector, "slip": table.slip_vector}, solution.spaces.dim)
    if friction:
        numbers["friction"] = np.where(table.state < 0, np.nan, table.state)
    for name, values in (numbers | vectors).items():
        if shown.get(name.partition("_")[0], friction):
            texts = np.array(STATES)[table.state] if name == "friction" else values
            columns[name] = texts.astype(object)
            columns[name][np.isnan(values)] = None
    return columns


def segment_names(solution: ElasticSolution) -> list[str]:
    """Names of the segments of contact, then of those of all laws."""
    return [*Signorini.segments, *(name for law in solution.data.laws.of_parts for name in law.law.segments)]


def labels(solution: ElasticSolution) -> npt.NDArray[np.int64]:
    """For each facet vertex the row of its segment in `segment_names`."""
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
