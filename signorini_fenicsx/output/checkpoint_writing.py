"""Saves a solution so that any number of ranks can read it: a folder of NumPy arrays, written by all ranks together.

Cells and points have the original numbering of the mesh, and a facet of Γ_S is identified by its vertices. RT0 is
stored as the values σ(x_T) and ∇·σ of each cell, σ(x) = σ(x_T) + (∇·σ/d)(x − x_T). So there are no degrees of
freedom in it, and except for the order of the facets nothing in it depends on the partition. Elastic stresses are
stored at the vertices of the subcells, displacements at those of the cells.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.array_files import write_arrays
from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.exchange import delete
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.rows import Order
from signorini_fenicsx.cases.case import Case, CaseFile
from signorini_fenicsx.cases.solving import AnySolution
from signorini_fenicsx.contact.laws import LAWS, Law
from signorini_fenicsx.meshes.domain import Boundary, cells_behind, facet_vertices, membership
from signorini_fenicsx.output.checkpoint_file import FOLDER, FORMAT, TEXT, Arrays, GivenInPython
from signorini_fenicsx.output.checkpoint_npz import OLD_FILE
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.elasticity.problem import CoulombLaw
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

OUTCOME = ("reason", "converged", "backend", "dofs", "linear_solver", "own_residual", "details")
"""Stored attributes of a solution's outcome, apart from fields and history."""
COSTS = ("timings", "peak_memory")


def write_checkpoint(folder: Path, solution: Any) -> None:
    """Write a checkpoint into an existing folder (collective).

    If the program is killed at any moment, the folder holds the checkpoint from before, or the new one.

    Args:
        folder: The folder; an earlier checkpoint in it is replaced.
        solution: The solution.

    Raises:
        OSError: On all ranks, if the disk is full, or a rank cannot write.
    """
    comm: MPI.Comm = solution.spaces.mesh.comm
    part = folder / f"{FOLDER}.part"

    def begin() -> None:
        _finish(folder)
        if part.exists():
            delete(part)
        part.mkdir()

    def end() -> None:
        text = part / f"{TEXT}.part"
        text.write_text(json.dumps(_about(solution)), encoding="utf-8")
        text.rename(part / TEXT)
        _finish(folder)

    on_root(comm, begin)
    write_arrays(comm, part, _arrays(solution))
    on_root(comm, end)


def _finish(folder: Path) -> None:
    """Give a complete new checkpoint its name, in the place of the one before (rank 0)."""
    part, place = folder / f"{FOLDER}.part", folder / FOLDER
    if (part / TEXT).exists():
        if place.exists():
            (place / TEXT).unlink(missing_ok=True)  # from here on the new one counts
            delete(place)
        part.rename(place)
        (folder / OLD_FILE).unlink(missing_ok=True)


def _about(solution: AnySolution) -> dict[str, Any]:
    """Everything that is the same on all ranks, see `checkpoint_file.About`."""
    domain = solution.spaces.domain
    of_kind: dict[str, Any] = {}
    if isinstance(solution, ElasticSolution):
        part_names = solution.spaces.part_names
        of_kind = {"physics": solution.boundary.physics, "bound_changes": list(solution.bound_changes)}
    else:
        part_names = solution.spaces.part_names
    if isinstance(solution, Solution) and solution.step is not None and isinstance(solution.source, Case):
        of_kind = {"step": solution.step}
    return {
        "format": FORMAT,
        "name": solution.name,
        **_problem(solution),
        "part_names": part_names,
        "parts": {name: part.label for name, part in domain.parts.items()},
        "regions": list(domain.regions),
        "bend": domain.curvature,
        "made": domain.origin(),
        "history": [asdict(step) for step in solution.outcome.history],
        "beta": 1.0 if solution.method.penalty is None else solution.method.penalty.beta(solution.options.eps),
        "kkt": vars(solution.kkt),
        **{key: getattr(solution.outcome, key) for key in OUTCOME},
        **{key: getattr(solution, key) for key in COSTS},
        **of_kind,
    }


def _arrays(solution: AnySolution) -> Arrays:
    """The rows of all arrays that this rank writes (collective)."""
    domain, mesh = solution.spaces.domain, solution.spaces.mesh
    comm, geometry, dim = mesh.comm, mesh.geometry, mesh.geometry.dim
    points = Order(comm, geometry.input_global_indices[: geometry.index_map().size_local])
    places = points.places(geometry.input_global_indices)
    if isinstance(solution, ElasticSolution):
        values, of_facets = _elastic_values(solution)
    else:
        values, of_facets = solution.in_cells(), vars(solution.table())
    size = len(values["u"])
    order = Order(comm, mesh.topology.original_cell_index[:size])

    def renumbered(vertices: Indices) -> Indices:
        return points.places(vertices.ravel()).reshape(-1, dim)

    arrays = {
        "points": points.sorted(geometry.x[: geometry.index_map().size_local, :dim]),
        "cells": order.sorted(places[geometry.dofmaps[0][:size]]),
        **{key: order.sorted(rows) for key, rows in values.items()},
        **{f"facet_{key}": rows for key, rows in of_facets.items()},
    }
    arrays["facet_vertices"] = renumbered(arrays["facet_vertices"])
    for index, facets in enumerate(domain.facets.values()):
        arrays[f"part_{index}"] = renumbered(facet_vertices(mesh, facets))
    if isinstance(solution, Solution) and solution.spaces.inner.present:
        inner, original = solution.spaces.inner, mesh.topology.original_cell_index
        pairs = np.column_stack([solution.spaces.cells[inner.rows], cells_behind(mesh, inner.facets)])
        arrays["together"] = order.places(original[pairs].ravel()).reshape(-1, 2)
    if isinstance(solution, Solution) and solution.data.memory is not None:
        arrays["memory"] = order.sorted(solution.data.memory.x.array)
    return arrays | ({"inside": order.sorted(membership(domain))} if domain.regions else {})


def _elastic_values(solution: ElasticSolution) -> tuple[Arrays, Arrays]:
    """σ_h and u_h at vertices in ascending order, per cell; what is known at the vertices of the facets of Γ_C."""
    spaces = solution.spaces
    friction = np.zeros((3, *solution.gap.shape))
    if solution.data.friction is not None:
        for values, rough in zip(friction, (solution.slip, solution.states, solution.data.friction.bound), strict=True):
            values[spaces.rough_rows] = rough
    slip, state, bound = friction
    of_facets = {
        "vertices": facet_vertices(spaces.mesh, spaces.contact.facets),
        "p": solution.gap,
        "condition": solution.touching.astype(np.int64),
        "slip": slip,
        "state": state.astype(np.int64),
        "bound": bound,
    }
    return {"sigma": solution.stresses, "u": spaces.displacement_values(solution.u)}, of_facets


def _problem(solution: AnySolution) -> dict[str, Any]:
    """The case; or, for a problem given in Python, the data that a file can hold."""
    if isinstance(solution.source, CaseFile):
        return {"case": solution.source.model_dump(mode="json", exclude_unset=True)}
    boundary, options = solution.boundary, solution.options
    laws: Sequence[Law | CoulombLaw] = solution.problem.laws
    problem = {name: value for name, value in vars(solution.problem).items() if value is not None and name != "laws"}
    stored = {name: value for name, value in problem.items() if _storable(value)}
    missing = [name for name in problem if name not in stored]
    if not all((law.name in LAWS or isinstance(law, CoulombLaw)) and _storable(vars(law)) for law in laws):
        laws, missing = (), [*missing, "laws"]
    given = GivenInPython(
        title=solution.title,
        domain=solution.spaces.domain.name,
        signorini=list(solution.contact_parts),
        neumann=list(boundary.neumann),
        **({"inner": list(boundary.inner)} if isinstance(boundary, Boundary) else {"fixed": dict(boundary.fixed)}),
        problem=stored,
        laws=[{"kind": law.name, **vars(law)} for law in laws],
        missing=missing,
        options={
            "algorithm": options.algorithm_name,
            **{key: getattr(options, key) for key in ("rho", "eps", "max_iterations", "predict")},
        },
    )
    return {"case": None, "given": given.model_dump(mode="json")}


def _storable(given: object) -> bool:
    """Whether a datum consists of numbers, texts, and None for none."""
    if isinstance(given, Mapping):
        return all(map(_storable, given.values()))
    return (
        all(map(_storable, given)) if isinstance(given, tuple | list) else isinstance(given, str | int | float | None)
    )
