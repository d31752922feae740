"""Saves a solution so that any number of ranks can read it: a folder of NumPy arrays, written by all ranks together.

Cells and points have the original numbering of the mesh, and a facet of Γ_S is identified by its vertices. A physics
stores its fields by values, see `Keeping`. So there are no degrees of freedom in it, and except for the order of the
facets nothing in it depends on the partition.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.array_files import write_arrays
from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.exchange import delete
from signorini_fenicsx.base.owned import cell_nodes, cells_behind, original_cells
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.rows import Order
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.meshes.domain import brought_together, facet_vertices, membership
from signorini_fenicsx.output.checkpoint_file import FOLDER, FORMAT, TEXT, GivenInPython
from signorini_fenicsx.solving.kept import Arrays, Keeping
from signorini_fenicsx.solving.physics import DIFFUSION, PHYSICS
from signorini_fenicsx.solving.solved import Solved

OUTCOME = ("reason", "converged", "backend", "dofs", "linear_solver", "own_residual", "details")
"""Stored attributes of a solution's outcome, apart from fields and history."""
COSTS = ("timings", "peak_memory")


def write_checkpoint(folder: Path, solution: Solved) -> None:
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


def _about(solution: Solved) -> dict[str, Any]:
    """Everything that is the same on all ranks, see `checkpoint_file.About`."""
    domain, physics = solution.spaces.domain, solution.physics
    in_time = solution.step is not None and isinstance(solution.source, CaseFile)
    return {
        "format": FORMAT,
        "name": solution.name,
        **_problem(solution),
        "part_names": solution.spaces.part_names,
        "parts": {name: part.label for name, part in domain.parts.items()},
        "regions": list(domain.regions),
        "bend": domain.curvature,
        "made": domain.origin(),
        "history": [asdict(step) for step in solution.outcome.history],
        "beta": 1.0 if solution.method.penalty is None else solution.method.penalty.beta(solution.options.eps),
        "kkt": vars(solution.kkt),
        **{key: getattr(solution.outcome, key) for key in OUTCOME},
        **{key: getattr(solution, key) for key in COSTS},
        **({} if physics == DIFFUSION else {"physics": physics}),
        **{name: list(getattr(solution, name)) for name in PHYSICS[physics].keeping.own},
        **({"step": solution.step} if in_time else {}),
    }


def _arrays(solution: Solved) -> Arrays:
    """The rows of all arrays that this rank writes (collective)."""
    spaces, domain, mesh = solution.spaces, solution.spaces.domain, solution.spaces.mesh
    comm, geometry, dim = mesh.comm, mesh.geometry, mesh.geometry.dim
    points = Order(comm, geometry.input_global_indices[: geometry.index_map().size_local])
    places = points.places(geometry.input_global_indices)
    keeping: Keeping = PHYSICS[solution.physics].keeping
    order = Order(comm, original_cells(mesh))

    def renumbered(vertices: Indices) -> Indices:
        return points.places(vertices.ravel()).reshape(-1, dim)

    arrays = {
        "points": points.sorted(geometry.x[: geometry.index_map().size_local, :dim]),
        "cells": order.sorted(places[cell_nodes(mesh)]),
        **{key: order.sorted(rows) for key, rows in keeping.in_cells(solution).items()},
        **{f"facet_{key}": rows for key, rows in keeping.on_facets(solution).items()},
    }
    arrays["facet_vertices"] = renumbered(arrays["facet_vertices"])
    for index, facets in enumerate(domain.facets.values()):
        arrays[f"part_{index}"] = renumbered(facet_vertices(mesh, facets))
    inner, joints, original = spaces.inner, getattr(spaces, "joints", ()), original_cells(mesh)
    if inner.present or joints:
        pairs = original[np.column_stack([spaces.cells[inner.rows], cells_behind(mesh, inner.facets)])]
        groups = [original[cells_behind(mesh, np.append(joint.slaves_and_masters, joint.left_out))] for joint in joints]
        arrays["together"] = order.places(np.vstack([pairs, brought_together(comm, groups)]).ravel()).reshape(-1, 2)
    return arrays | ({"inside": order.sorted(membership(domain))} if domain.regions else {})


def _problem(solution: Solved) -> dict[str, Any]:
    """The case; or, for a problem given in Python, the data that a file can hold."""
    if isinstance(solution.source, CaseFile):
        return {"case": solution.source.model_dump(mode="json", exclude_unset=True)}
    boundary, options = solution.boundary, solution.options
    laws, laws_of_files = getattr(solution.problem, "laws", ()), PHYSICS[boundary.physics].keeping.laws
    given_data = {name: value for name, value in vars(solution.problem).items() if name not in ("laws", "boundary")}
    problem = {name: value for name, value in given_data.items() if value is not None}
    stored = {name: value for name, value in problem.items() if _storable(value)}
    missing = [name for name in problem if name not in stored]
    if not all(law.name in laws_of_files and _storable(vars(law)) for law in laws):
        laws, missing = (), [*missing, "laws"]
    kinds = {each.name: getattr(boundary, each.name) for each in fields(boundary)[1:]}
    others: dict[str, Any] = {
        name: dict(parts) if isinstance(parts, Mapping) else list(parts) for name, parts in kinds.items()
    }
    given = GivenInPython(
        title=solution.title,
        domain=solution.spaces.domain.name,
        signorini=list(solution.contact_parts),
        **others,
        problem=stored,
        laws=[{"kind": law.name, **vars(law)} for law in laws],
        missing=missing,
        options={
            "algorithm": options.algorithm_name,
            **{key: getattr(options, key) for key in ("element", "rho", "eps", "max_iterations", "predict")},
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
