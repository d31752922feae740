"""What is shown of an elastic solution: fields, tables, pictures, lines of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.text import counted, place_in_words
from signorini_fenicsx.cases.plot import Plot, in_unit, plot_of
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells, opposite
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import to_entries
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.show.tables import STATES, friction_vectors, labels, segment_names
from signorini_fenicsx.physics.elasticity.solve.residuals import imbalance
from signorini_fenicsx.solving.fields import IN_CELLS, Field, Fields

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
        segment = labels(solution).reshape(solution.touching.shape)
        on_facets.append(Field("segment", segment, names=segment_names(solution)))
    if data.friction:
        shear, slip, state = solution.on_all_contact()
        order = spaces.dim - 2  # in space they are vectors
        if order:
            shear, slip = friction_vectors(solution)
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


def lines(solution: ElasticSolution, summary: Mapping[str, Any]) -> dict[str, str]:
    """The lines of a report, see `Solved.lines`."""
    plot, dim = plot_of(solution.source), solution.spaces.dim
    measure = in_unit(f"{summary['contact_measure']:.6g}", plot.length_unit, dim - 1)
    touching = f"{summary['touching_vertices']} facet vertices, measure {measure}"
    texts = {
        **({"contact": touching} if solution.spaces.part_names else {}),
        "forces": forces_in_words(summary["resultants"], dim, plot),
        "largest": _largest(summary["quantities"], plot),
    }
    for part, about in summary["quantities"]["contact"].items():
        texts[f"on {part}"] = _pressed(about, plot, dim)
    for part, about in summary["quantities"].get("tools", {}).items():
        texts[f"on {part}"] += f"; the tool has moved by {_moved(about, plot)}"
    if "least_gap" in summary:
        least = f"negative, down to {in_unit(f'{summary["least_gap"]:.4g}', plot.length_unit)}"
        other = "another body" if solution.boundary.inner or solution.boundary.pairs else "the foundation"
        texts["gap"] = f"{least}: there {other} reaches into the body at rest, and is taken to press it back"
    for part, segments in summary.get("segments", {}).items():
        texts[f"on {part}"] += f"; facet vertices on each segment: {segments_in_words(segments)}"
    if "friction" in summary:
        texts["friction"] = f"facet vertices: {segments_in_words(summary['friction'])}"
    if "coulomb" in summary:
        texts["Coulomb"] = _fixed_point(summary["coulomb"])
    return texts


def segments_in_words(counts: Mapping[str, Mapping[str, float]]) -> str:
    """How many facet vertices there are on each segment, or in each state."""
    return ", ".join(f"{name} {count['vertices']}" for name, count in counts.items())


def forces_in_words(resultants: dict[str, list[float]], dim: int, plot: Plot) -> str:
    """The force on each part, and the largest of what is left of all forces and moments."""
    unit = plot.over_facets(plot.stress_unit, dim)
    forces = {name: ", ".join(f"{value:.5g}" for value in values[:dim]) for name, values in resultants.items()}
    del forces["sum"]
    left = max(map(abs, resultants["sum"]))
    words = f"{'  '.join(f'{name} ({force})' for name, force in forces.items())}; all together {left:.1e}"
    return f"{words}; in {unit}" if unit else words


def _largest(about: Mapping[str, Any], plot: Plot) -> str:
    """The largest stress and displacement with their places."""
    names = {"von_mises": ("von Mises", plot.stress_unit), "displacement": ("|u|", plot.length_unit)}
    return ", ".join(f"{word} {value_at(about[key], unit, plot.length_unit)}" for key, (word, unit) in names.items())


def _pressed(about: Mapping[str, Any], plot: Plot, dim: int) -> str:
    """How a part is pressed."""
    length = plot.length_unit
    words = [f"pressure at most {value_at(about['peak_pressure'], plot.stress_unit, length)}"]
    words.append(f"area {in_unit(f'{about["area"]:.5g}', length, dim - 1)}")
    words += [f"width {in_unit(f'{about["width"]:.5g}', length)}"] if "width" in about else []
    if "center_of_pressure" in about:
        words.append(f"center {place(about['center_of_pressure'], length)}")
    return ", ".join(words)


def _moved(about: Mapping[str, Any], plot: Plot) -> str:
    """The motion of a tool."""
    moved = about["displacement"].items()
    words = [f"{in_unit(f'{length:.5g}', plot.length_unit)} along {axis}" for axis, length in moved]
    words += [f"the angle {angle:.5g} about {axis}" for axis, angle in about.get("rotation", {}).items()]
    return " and ".join(words)


def value_at(largest: Mapping[str, Any], unit: str, length: str) -> str:
    """A value and its place, in units of values and lengths."""
    return f"{in_unit(f'{largest["largest"]:.5g}', unit)} at {place(largest['at'], length)}"


def place(x: Sequence[float], length: str) -> str:
    """A point in a unit of lengths."""
    return in_unit(place_in_words(x), length)


def _fixed_point(about: Mapping[str, Any]) -> str:
    """How the bound of Coulomb's friction was found, and whether there may be others."""
    changes = about["changes"]
    few = ", ".join(f"{change:.0e}" for change in changes[-3:])
    others = "" if about["other_solutions"] == "none" else "; other solutions are not excluded"
    return f"the bound of the shear, in {counted(len(changes), 'step')}, at last off the law by {few}{others}"
