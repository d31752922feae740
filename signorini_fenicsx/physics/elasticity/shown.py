"""What is shown of an elastic solution: fields, tables, pictures, lines of a report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.contact.laws import Friction
from signorini_fenicsx.discrete.mesh_spaces import NEUMANN
from signorini_fenicsx.discrete.site_table import FacetTable, SiteTable, along_parts
from signorini_fenicsx.meshes.domain import facet_vertices
from signorini_fenicsx.physics.elasticity.data import blocks_of_cells
from signorini_fenicsx.physics.elasticity.residuals import imbalance
from signorini_fenicsx.physics.elasticity.spaces import BoundaryFacets
from signorini_fenicsx.solving.drawn import PARTLY_FIXED, Drawn, whole_boundary
from signorini_fenicsx.solving.solved import Columns

if TYPE_CHECKING:  # it shows this
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution


def fields(solution: ElasticSolution) -> Iterator[tuple[str, list[fem.Function]]]:
    """The functions of each file, see `Solved.fields`; `solution.bp` is on the mesh of the subcells."""
    spaces, split, dim = solution.spaces, solution.spaces.split, solution.spaces.dim
    stresses = in_space(solution)  # VTX takes no others
    at_vertices = spaces.displacement_values(solution.u)
    corners = np.array([[k for k in range(dim + 1) if k != i] for i in range(dim + 1)])
    centroids = np.broadcast_to(at_vertices.mean(axis=1)[:, None, None], (len(at_vertices), dim + 1, 1, dim))
    in_subcells = np.concatenate([at_vertices[:, corners], centroids], axis=2)
    linear = {"sigma": stresses, "u": in_subcells, "von_mises": von_mises(stresses)}
    yield (
        "solution.bp",
        [
            split.function(fenicsx.function_space(split.mesh, ("DG", 1, values.shape[3:])), values, name)
            for name, values in linear.items()
        ],
    )
    values = {"pressure": solution.pressure, "gap": solution.linear_gap, "contact": solution.touching}
    if solution.data.friction is not None:
        values |= dict(zip(("shear", "slip", "friction"), solution.on_all_contact(), strict=True))
    yield "contact.bp", [solution.on_contact(each, name) for name, each in values.items()]
    means = {
        "u": at_vertices.mean(axis=1),
        "sigma": stresses.mean(axis=(1, 2)),
        "von_mises": von_mises(stresses.mean(axis=(1, 2))),
        "equilibrium": np.linalg.norm(imbalance(spaces, solution.data, solution.stresses), axis=2).max(axis=1),
    }
    functions = []
    for name, each in means.items():
        functions.append(fem.Function(fenicsx.function_space(spaces.mesh, ("DG", 0, each.shape[1:])), name=name))
        functions[-1].x.array[:] = each.ravel()  # no ghost cells, and a degree of freedom per cell in their order
    yield "solution.xdmf", functions


def in_space(solution: ElasticSolution) -> Array:
    """The stress at the vertices of the subcells as a matrix in space, shape (cells, d + 1, d + 1, 3, 3).

    In plane strain σ_zz = ν tr σ, with the mean of ν over the cell.
    """
    spaces, data = solution.spaces, solution.data
    missing = 3 - spaces.dim
    found = np.pad(solution.stresses, (*[(0, 0)] * 3, (0, missing), (0, missing)))
    if missing and not data.in_space:
        for cells in blocks_of_cells(spaces):
            poisson = data.poisson.values(data.points(spaces, cells)).mean(axis=1)
            found[cells, :, :, 2, 2] = poisson[:, None, None] * np.einsum("nsaii->nsa", solution.stresses[cells])
    return found


def von_mises(stresses: Array) -> Array:
    """Equivalent stress of matrices in space, shape (…, 3, 3)."""
    deviator = stresses - np.einsum("...ii->...", stresses)[..., None, None] / 3 * np.eye(3)
    found: Array = np.sqrt(1.5 * (deviator**2).sum(axis=(-1, -2)))
    return found


STATES = (*Friction.segments, "open")
"""The states of a vertex with friction."""


@dataclass(frozen=True)
class ContactTable(SiteTable):
    """One row per vertex of each facet of Γ_C.

    Attributes:
        facet: Midpoint of the facet, shape (rows, 3).
        pressure: −σ_nn.
        gap: g − u_n, linear on the facet.
        touching: Whether it is in contact.
        shear: σ_t, NaN without friction.
        slip: u_t likewise.
        state: Index into `STATES`, −1 without friction.
        forward: 1 where the coordinate along the part grows along the tangent, −1 where it falls; 0 in space.
    """

    facet: Array
    pressure: Array
    gap: Array
    touching: Mask
    shear: Array
    slip: Array
    state: npt.NDArray[np.int64]
    forward: npt.NDArray[np.int64]
    name = "contact"
    places = ("along", "x", "facet")


def table(solution: ElasticSolution) -> ContactTable:
    """The vertices of the facets of Γ_C of this rank."""
    spaces = solution.spaces
    contact, dim = spaces.contact, spaces.dim
    x = np.pad(contact.vertices, ((0, 0), (0, 0), (0, 3 - dim)))
    part, places = np.repeat(spaces.part_of_facet, dim).astype(np.int64), x.reshape(-1, 3)
    along = along_parts(spaces, part, places)
    shear, slip, state = (values.ravel() for values in solution.on_all_contact())
    return ContactTable(
        part=part,
        along=along,
        x=places,
        facet=np.repeat(np.sort(x, axis=1).mean(axis=1), dim, axis=0),
        pressure=solution.pressure.ravel(),
        gap=solution.linear_gap.ravel(),
        touching=solution.touching.ravel(),
        shear=shear,
        slip=slip,
        state=np.nan_to_num(state, nan=-1.0).astype(np.int64),
        forward=np.repeat(_forward(contact, along), dim),
    )


def columns(solution: ElasticSolution, table: ContactTable) -> Columns:
    """The columns of `contact.csv`."""
    columns: dict[str, npt.NDArray] = {
        "part": np.array(solution.contact_parts)[table.part],
        **dict(zip("xyz", table.x.T, strict=True)),
        "pressure": table.pressure,
        "gap": table.gap,
        "condition": np.where(table.touching, "contact", "open"),
    }
    if solution.data.friction is None:
        return columns
    states = np.array(STATES)[table.state]
    for name, values in {"shear": table.shear, "slip": table.slip, "friction": states}.items():
        columns[name] = values.astype(object)
        columns[name][table.state < 0] = None
    return columns


def _forward(contact: BoundaryFacets, along: Array) -> npt.NDArray[np.int64]:
    """The sign with which the coordinate along the part grows along the tangent of each facet; 0 in space."""
    if contact.vertices.shape[2] == 3:
        return np.zeros(len(contact.facets), dtype=np.int64)
    tangents = np.column_stack([-contact.normals[:, 1], contact.normals[:, 0]])
    edges = np.einsum("ni,ni->n", contact.vertices[:, 1] - contact.vertices[:, 0], tangents)
    return np.sign(edges * np.diff(along.reshape(-1, 2), axis=1)[:, 0]).astype(np.int64)


@dataclass(frozen=True)
class BodyFacets(FacetTable):
    """Γ_C: for p the mean gap, for σ·n the mean pressure.

    Attributes:
        normals: The outer unit normals, shape (facets, d).
        gaps: The gap at the vertices of each facet, linear on it, shape (facets, d).
    """

    normals: Array
    gaps: Array


def drawn(solution: ElasticSolution) -> Drawn:
    """The solution for pictures: for σ the largest von Mises stress of each cell (collective)."""
    spaces, nothing = solution.spaces, np.empty(0, dtype=np.int32)
    by_geometry = np.argsort(spaces.order, axis=1)[:, :, None]
    fixed = np.concatenate([nothing, *(spaces.domain.facets[part] for part in solution.boundary.fixed)])
    free = np.setdiff1d(spaces.neumann_facets, fixed)
    kinds = {NEUMANN: free, PARTLY_FIXED: fixed}
    return Drawn(
        u=np.take_along_axis(spaces.displacement_values(solution.u), by_geometry, axis=1),
        sigma=von_mises(in_space(solution)).max(axis=(1, 2))[:, None],
        facets=_facets(solution),
        boundary=whole_boundary(spaces)
        | {kind: (facets, np.full(len(facets), np.nan)) for kind, facets in kinds.items()},
        strength="von Mises stress",
        gamma=r"$\Gamma_C$",
    )


def _facets(solution: ElasticSolution) -> BodyFacets:
    spaces, contact = solution.spaces, solution.spaces.contact
    part = spaces.part_of_facet.astype(np.int64)
    middle = np.pad(contact.vertices.mean(axis=1), ((0, 0), (0, 3 - spaces.dim)))
    none = np.zeros(len(middle))
    return BodyFacets(
        part=part,
        along=along_parts(spaces, part, middle),
        x=middle,
        measure=contact.measure,
        u=none,
        p=solution.gap.mean(axis=1),
        flux=solution.pressure.mean(axis=1),
        psi=none,
        q_S=none,
        condition=solution.contact_set().inside.astype(np.int64),
        segment=none.astype(np.int64),
        vertices=facet_vertices(spaces.mesh, contact.facets),
        normals=contact.normals,
        gaps=solution.linear_gap,
    )


def lines(solution: ElasticSolution, summary: Mapping[str, Any]) -> dict[str, str]:
    """The lines of a report, see `Solved.lines`."""
    found = {
        "contact": f"{summary['touching_vertices']} facet vertices, measure {summary['contact_measure']:.6g}",
        "forces": _forces(summary["resultants"], solution.spaces.dim),
    }
    if "least_gap" in summary:
        least = f"negative, down to {summary['least_gap']:.4g}"
        found["gap"] = f"{least}: there the foundation reaches into the body at rest, and is taken to press it back"
    if "friction" in summary:
        states = (f"{name} {of_state['vertices']}" for name, of_state in summary["friction"].items())
        found["friction"] = f"facet vertices: {', '.join(states)}"
    if "coulomb" in summary:
        found["Coulomb"] = _fixed_point(summary["coulomb"]["changes"])
    return found


def _forces(resultants: dict[str, list[float]], dim: int) -> str:
    """The force on each part, and the largest of what is left of all forces and moments."""
    forces = {name: ", ".join(f"{value:.5g}" for value in values[:dim]) for name, values in resultants.items()}
    del forces["sum"]
    left = max(map(abs, resultants["sum"]))
    return f"{'  '.join(f'{name} ({force})' for name, force in forces.items())}; all together {left:.1e}"


def _fixed_point(changes: list[float]) -> str:
    """How Coulomb's fixed point converged."""
    few = ", ".join(f"{change:.0e}" for change in changes[1:4])
    rate = (changes[-1] / changes[1]) ** (1 / (len(changes) - 2)) if len(changes) > 2 and changes[1] > 0 else 0.0
    return f"the bound of the shear changed by {few} … {changes[-1]:.0e} in {len(changes)} steps, rate {rate:.2f}"
