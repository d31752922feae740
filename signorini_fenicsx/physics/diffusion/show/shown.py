"""What is shown of a solution of a diffusion problem: fields, tables, pictures, lines of a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, make_dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import dolfinx.mesh
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import cells_behind
from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.base.rows import in_digits
from signorini_fenicsx.base.text import named
from signorini_fenicsx.cases.plot import in_unit, plot_of
from signorini_fenicsx.contact.chains import Condition
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.mesh_spaces import cells_and_dofs
from signorini_fenicsx.discrete.site_table import FacetTable, along_parts
from signorini_fenicsx.meshes.domain import facet_vertices
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import cell_values
from signorini_fenicsx.physics.diffusion.show.states import states
from signorini_fenicsx.pictures.gather import Known, whole_boundary
from signorini_fenicsx.solving.fields import IN_CELLS, Field, Fields
from signorini_fenicsx.solving.solved import Columns

if TYPE_CHECKING:  # it shows this
    from signorini_fenicsx.physics.diffusion.solution import Solution


CONDITIONS = [condition.name.lower() for condition in Condition]


def fields(solution: Solution) -> Fields:
    """The fields, see `Solved.fields`: `potential`, σ_h, on Γ_S p_h, σ_h·n and the state of the law."""
    spaces, laws, facet = solution.spaces, solution.data.laws, solution.spaces.site_kinds["facet"]
    u = Field("u", solution.u_vertices, at_points=True, cell_means=solution.u_means)
    sigma = Field("sigma", solution.cell_flux.in_vertices(), order=1)
    on_cells = [u, sigma, *of_kappa(solution), *of_water(solution)]
    if not spaces.part_names:
        return {IN_CELLS: [*on_cells, *_inside(solution)]}
    on_facets = [
        Field("p", solution.p_at),
        Field("flux", solution.flux_at),
        Field("condition", facet.rows_of(solution.outcome.conditions.kind), names=CONDITIONS),
    ]
    if laws.listed:
        segments = laws.labels(facet.rows_of(solution.segments().segment))
        on_facets.append(Field("segment", segments, names=laws.names()))
    on_facets += [Field(name, values) for name, values in states(solution).items()]
    return {IN_CELLS: [*on_cells, *_inside(solution)], "multiplier": on_facets}


def of_kappa(solution: Solution) -> list[Field]:
    """κ where it depends on u, and the saturation of soils, by means over cells."""
    of_u = solution.data.quasilinear
    if of_u is None:
        return []
    kappa, x = Field("kappa", solution.data.kappa_values.mean(axis=1)), corners(solution.spaces.mesh).mean(axis=1)
    return [kappa, *([Field("saturation", of_u.saturation(x, solution.u_means))] if of_u.has_soils else [])]


def of_water(solution: Solution) -> list[Field]:
    """The pressure head of water at the vertices of the cells."""
    water, x = solution.water_kind, corners(solution.spaces.mesh)
    if water is None:
        return []
    flux, means = solution.cell_flux, water.pressure(x.mean(axis=1), solution.u_means, solution.cell_flux.centroid)
    at_vertices = water.pressure(x, solution.u_vertices, flux.in_vertices())
    return [Field("pressure", at_vertices, at_points=True, cell_means=means)]


def _inside(solution: Solution) -> list[Field]:
    """Fields of laws in Ω: of an obstacle the contact and its force, else segments and s (collective)."""
    laws = solution.data.inside
    if not laws:
        return []
    force = cell_values(solution.force())
    if laws.is_obstacle:
        return [Field("contact", solution.held_cells, names=("free", "contact")), Field("force", force)]
    return [Field("segment", solution.cell_segments), Field("s", -force)]


@dataclass(frozen=True)
class GammaTable(FacetTable):
    """One row per facet of Γ_S, with what the laws say of it.

    Attributes:
        u: u_h in the cell behind the facet; for a facet inside the domain the jump of u_h.
        psi: Mean of ψ.
        q_S: Mean of q_S.
    """

    u: Array
    psi: Array
    q_S: Array


STATE = "state_"


@cache
def _table_with(states: tuple[str, ...]) -> type[GammaTable]:
    """The class of tables that have states of laws with memory as well."""
    columns = [(STATE + name, Array) for name in states]
    return make_dataclass("StateTable", columns, bases=(GammaTable,), frozen=True) if states else GammaTable


def table(solution: Solution) -> GammaTable:
    """The Γ_S facets of this rank, in their order; vertices have the original numbers of the mesh (collective)."""
    spaces, of_laws = solution.spaces, states(solution)
    u = solution.u.x.array[spaces.cells]
    u[spaces.inner.rows] -= solution.u.x.array[cells_behind(spaces.mesh, spaces.inner.facets)]
    kind: Any = _table_with(tuple(of_laws))
    return kind(
        **of_facets(solution),
        **{STATE + name: values for name, values in of_laws.items()},
        u=u,
        p=solution.p.x.array[: len(spaces.facets)],
        flux=spaces.normal_flux(solution.sigma),
        condition=spaces.site_kinds["facet"].of(solution.outcome.conditions.kind).astype(np.int64),
        segment=solution.data.laws.labels(solution.segments().of("facet")),
    )


def of_facets(solution: Any) -> dict[str, Any]:
    """The columns of a `GammaTable` that are the same for all elements: places, sizes, ψ and q_S."""
    spaces = solution.spaces
    part, mesh = spaces.part_of_facet.astype(np.int64), spaces.mesh
    x = dolfinx.mesh.compute_midpoints(mesh, mesh.topology.dim - 1, spaces.facets).reshape(-1, 3)
    places = {"part": part, "along": along_parts(spaces, part, x), "x": x, "measure": spaces.facet_measure}
    bounds = {"psi": solution.data.psi_h, "q_S": solution.data.q_Sh}
    return {**places, **bounds, "vertices": facet_vertices(mesh, spaces.facets)}


def columns(solution: Solution, table: GammaTable) -> Columns:
    """The columns of `facets.csv`; `segment` is among them if there are other laws than Signorini's."""
    laws = solution.data.laws
    return {
        "part": np.array(solution.spaces.part_names)[table.part],
        **dict(zip("xyz", table.x.T, strict=True)),
        **{key: getattr(table, key) for key in ("measure", "p", "flux")},
        "condition": np.array(CONDITIONS)[table.condition],
        **({"segment": np.array(laws.names())[table.segment]} if laws.listed else {}),
        **{key.removeprefix(STATE): values for key, values in vars(table).items() if key.startswith(STATE)},
    }


def other_tables(solution: Solution) -> dict[str, Columns]:
    """`free_boundary.csv` of laws in Ω, see `Solved.other_tables` (collective)."""
    return {"free_boundary": free_boundary(solution)} if solution.data.inside else {}


def free_boundary(solution: Solution) -> Columns:
    """Midpoint and measure of each facet between cells on different segments of laws in Ω, on rank 0."""
    spaces, space = solution.spaces, solution.spaces.crouzeix_raviart
    mesh, dofs, dim = spaces.mesh, solution.free_boundary(), spaces.mesh.topology.dim
    mesh.topology.create_connectivity(dim, dim - 1)
    of_dof = np.empty(space.dofmap.index_map.size_local + space.dofmap.index_map.num_ghosts, dtype=np.int32)
    of_dof[space.dofmap.list.ravel()] = mesh.topology.connectivity(dim, dim - 1).array
    corners = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, dim - 1, of_dof[dofs])].reshape(-1, dim, 3)
    edges = corners[:, 1:] - corners[:, :1]
    measure = np.sqrt(np.linalg.det(edges @ edges.transpose(0, 2, 1))) / (dim - 1)
    rows = gather_rows(mesh.comm, np.column_stack([corners.mean(axis=1), measure]))
    if rows is None:
        return {}
    in_order = rows[np.lexsort(in_digits(rows[:, :3]).T[::-1])]
    return dict(zip(("x", "y", "z", "measure"), in_order.T, strict=True))


def traces(solution: Solution) -> dict[int, Known]:
    """The facets of each kind of boundary, with p_h on Γ_S but for jumps, and the means of u_D."""
    spaces, lift = solution.spaces, solution.data.u_lift
    p = solution.p.x.array[: len(spaces.facets)].copy()
    p[spaces.inner.rows] = np.nan
    u_D = lift.x.array[cells_and_dofs(lift.function_space, spaces.dirichlet_facets)[1]]
    return whole_boundary(spaces, signorini=p, dirichlet=u_D)


VIOLATIONS = {"trace": "‖[p]_-‖", "flux": "‖[σ·n]_-‖", "mass_balance": "‖∇·σ + f_h‖"}
DETAILS = {
    "rho": "ρ",
    "rho_limit": "converges for ρ <",
    "omega": "ω",
    "colours": "colours",
    "kappa_problems": "problems with a fixed κ",
    "kappa_change": "last change of κ",
    "kappa_energy_change": "of κ∇u in energy",
    "unsure_cells": "cells where κ > 0 is not enclosed",
    "dry_cells": "cells with the least k_r that there is",
    "linear_solves": "linear problems",
    "content_change": "last change of the content",
}


def lines(solution: Solution, summary: Mapping[str, Any]) -> dict[str, str]:
    """The lines of a report, see `Solved.lines`."""
    lines, plot = {}, plot_of(solution.source)
    if solution.spaces.part_names:
        measure = in_unit(f"{summary['contact_measure']:.6g}", plot.length_unit, solution.spaces.mesh.topology.dim - 1)
        lines["contact"] = f"{summary['contact_facets']} facets, measure {measure}"
    if "obstacle" in summary:
        on = summary["obstacle"]
        size = f"measure {on['contact_measure']:.6g}, force {on['force']:.6g}"
        lines["obstacle"] = f"{on['contact_cells']} cells in contact, {size}"
    for law, segments in summary.get("regions", {}).items():
        sites = "cells" if "cells" in next(iter(segments.values())) else "vertices"  # of RT1
        counts = ", ".join(f"{name} {count[sites]}" for name, count in segments.items())
        lines[f"in Ω, {law}"] = f"{sites if sites == 'cells' else 'vertices of cells'} on each segment: {counts}"
    for part, segments in summary.get("segments", {}).items():
        sites = "facets" if "facets" in next(iter(segments.values())) else "vertices"  # of RT1
        counts = ", ".join(f"{name} {count[sites]}" for name, count in segments.items())
        lines[f"on {part}"] = f"{sites} on each segment: {counts}"
    for law, size in summary.get("states", {}).items():
        lines[law] = f"mean {size['mean']:.6g}, at most {size['largest']:.6g}"
    if "violation" in summary:
        left = named({VIOLATIONS[name]: value for name, value in summary["violation"].items()}, ".3e")
        lines["ε"] = f"{summary['eps']:g} leaves {left}"
    if "own_residual" in summary:
        lines["own"] = f"residual of its own discrete problem {summary['own_residual']:.1e}"
    if summary["details"]:
        lines["chosen"] = named({DETAILS[name]: value for name, value in summary["details"].items()}, ".6g")
    if solution.water:
        inflows = {part: about["inflow"] for part, about in solution.water.items()}
        left = summary["water_balance"]["left"]
        unit = plot.over_facets(plot.flux_unit, solution.spaces.mesh.geometry.dim)
        lines["flows in"] = f"{named(inflows, '.6g')}{f' {unit}' if unit else ''}; left of the balance {left:.1e}"
    if solution.seepage is not None:
        lines["seepage"] = solution.seepage.in_words()
    return lines
