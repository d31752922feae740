"""A saved solution read on any number of ranks; a damaged one is told by its residuals.

*Saves a solution so that any number of ranks can read it*: a folder of NumPy arrays, written by all ranks together.

Cells and points have the original numbering of the mesh, and a facet of Γ_S is identified by its vertices. A physics
stores its fields by values, see `Keeping`. So there are no degrees of freedom in it, and except for the order of the
facets nothing in it depends on the partition.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.array_files import write_arrays
from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.errors import InputError, check_kind, telling
from signorini_fenicsx.base.exchange import refuse_incomplete
from signorini_fenicsx.base.owned import cell_nodes, cells_behind, original_cells
from signorini_fenicsx.base.parallel import collector_off, on_root
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.base.rows import Order, find_rows
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.solving import options_of
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.meshes.dolfinx_meshes import check_parts
from signorini_fenicsx.meshes.domain import (
    Domain,
    Part,
    axis_part,
    brought_together,
    distribute,
    facet_vertices,
    marked,
    membership,
)
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.output.checkpoint_file import (
    FOLDER,
    FORMAT,
    TEXT,
    About,
    Checkpoint,
    GivenInPython,
    read_checkpoint,
)
from signorini_fenicsx.solving.kept import Arrays, Keeping, Stored
from signorini_fenicsx.solving.options import OWN, Options
from signorini_fenicsx.solving.physics import DIFFUSION, PHYSICS
from signorini_fenicsx.solving.solved import Solved
from signorini_fenicsx.solving.solver import sorted_on, system_on

OUTCOME = ("reason", "converged", "backend", "dofs", "linear_solver", "own_residual", "details")
"""Stored attributes of a solution's outcome, apart from fields and history."""
COSTS = ("timings", "peak_memory")


def write_checkpoint(folder: Path, solution: Solved) -> None:
    """Write a checkpoint into a folder that has none (collective).

    Raises:
        OSError: On all ranks, if the disk is full.
    """
    comm: MPI.Comm = solution.spaces.mesh.comm
    place = folder / FOLDER
    on_root(comm, place.mkdir)
    write_arrays(comm, place, _arrays(solution))
    on_root(comm, lambda: (place / TEXT).write_text(json.dumps(_about(solution)), encoding="utf-8"))


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
        **{name: list(getattr(solution, name)) for name in PHYSICS[physics].keeping.numbers},
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
    inner, surfaces, original = spaces.inner, getattr(spaces, "pairs", ()), original_cells(mesh)
    if inner.present or surfaces:
        pairs = original[np.column_stack([spaces.cells[inner.rows], cells_behind(mesh, inner.facets)])]
        groups = [original[cells_behind(mesh, np.append(pair.slaves_and_masters, pair.left_out))] for pair in surfaces]
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


SAME = 1e-3
"""Allowed relative difference between the KKT residuals of what is read and those that were written."""


@collector_off()
@doing("reading the solution")
def load_solution(
    folder: Path | str,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    problem: Any = None,
    options: Options | None = None,
) -> Any:
    """Read the solution of a results folder, of any physics, on as many ranks as there are now (collective).

    Args:
        folder: The results folder.
        comm: Communicator.
        problem: A `Diffusion`, `Elasticity` or `Stokes`, needed if some data were given in Python in a form that no
            file can hold. The mesh that is read is a new one, so data are then numbers, texts or functions of points.
        options: The options, needed if the algorithm was given in Python.

    Raises:
        InputError: If there is no solution; if the files cannot come from this program; if `problem` or `options` are
            needed; or if the residuals of the fields are not those that were written: then the file is damaged, and
            nothing of it is used.
    """
    check_kind("folder", folder, str, Path)
    on_root(comm, lambda: refuse_incomplete(folder))
    checkpoint = read_checkpoint(comm, Path(folder))
    posed: Any = problem
    boundary = checkpoint.boundary
    if hasattr(problem, "on"):
        posed = sorted_on(_read_domain(checkpoint, comm, {}), problem)
    if posed is not None and not isinstance(posed, checkpoint.keeping.problem):
        name = checkpoint.about.physics.capitalize()
        raise InputError(f"problem: {folder} is the solution of a problem of {name}, not of {type(problem).__name__}")
    posed = replace(posed, boundary=boundary) if posed else _read_problem(checkpoint)
    options = options or _read_options(checkpoint)
    with telling(f"{checkpoint.path}: is damaged: its mesh"):
        system = system_on(_read_domain(checkpoint, comm, boundary.named), posed)
    rows = _rows_of_facets(checkpoint, system.spaces)
    solution = checkpoint.keeping.read(posed, system.spaces, _stored(checkpoint, posed, options, rows))
    damage = _damage_of(checkpoint.about, solution)
    if damage is not None:
        raise InputError(f"{checkpoint.path}: is damaged: {damage}")
    return solution


def _stored(checkpoint: Checkpoint, problem: Any, options: Options, rows: Indices) -> Stored:
    """What the physics makes a solution of."""
    about = checkpoint.about
    return Stored(
        options=options,
        arrays=checkpoint.arrays,
        rows=rows,
        outcome=partial(Outcome, history=about.history, **{key: getattr(about, key) for key in OUTCOME}),
        about={"problem": problem, "options": options, "step": about.step}
        | {"name": about.name, "title": checkpoint.title, "source": checkpoint.case}
        | {key: getattr(about, key) for key in COSTS},
        numbers=checkpoint.numbers,
        step=about.step,
    )


def _read_domain(checkpoint: Checkpoint, comm: MPI.Comm, used: Mapping[str, Sequence[str]]) -> Domain:
    """The mesh of a checkpoint with its parts (collective).

    Args:
        checkpoint: The checkpoint.
        comm: Communicator.
        used: The parts of each kind of condition; those of "inner" are inside.

    Raises:
        InputError: If these parts are not on the boundary.
    """
    about, arrays = checkpoint.about, checkpoint.arrays
    pairs = tuple((*each.slave, *each.master) for each in getattr(checkpoint.boundary, "pairs", ()))
    mesh = distribute(comm, arrays["points"], arrays["cells"], checkpoint.dim, together=arrays.get("together"))
    facets = {name: arrays[f"part_{index}"] for index, name in enumerate(about.parts)}
    domain = Domain(
        parts=_parts(checkpoint),
        curvature=about.bend,
        name=checkpoint.domain,
        is_shape=checkpoint.shape is not None,
        made=about.made,
        together=pairs,
        **marked(mesh, facets, arrays.get("inside"), about.regions),
    )
    check_parts(domain, used)
    for index, name in enumerate(facets):
        on_boundary = any(name in parts for kind, parts in used.items() if kind != "inner")
        if on_boundary and comm.allreduce(len(domain.facets[name])) != checkpoint.headers[f"part_{index}"].shape[0]:
            raise InputError(f"part '{name}' has facets that are not on the boundary")
    return domain


def _parts(checkpoint: Checkpoint) -> Mapping[str, Part]:
    if checkpoint.shape is not None:
        return shape_of(checkpoint.shape).parts
    return {name: axis_part(label) for name, label in checkpoint.about.parts.items()}


def _rows_of_facets(checkpoint: Checkpoint, spaces: MeshSpaces) -> Indices:
    """For each facet of Γ_S of this rank its row in the checkpoint (collective).

    Raises:
        InputError: If the facets with values are not those of Γ_S.
    """
    comm = spaces.mesh.comm
    rows = find_rows(comm, facet_vertices(spaces.mesh, spaces.facets), [checkpoint.arrays["facet_vertices"]])[:, 0]
    missing, count = comm.allreduce(np.array([np.count_nonzero(rows < 0), len(rows)]))
    if missing > 0 or count != checkpoint.headers["facet_vertices"].shape[0]:
        of_pairs = " that are covered in pairs now: it is damaged, or of another version; solve the case again"
        paired = getattr(checkpoint.boundary, "pairs", ())
        raise InputError(
            f"{checkpoint.path}: its facets with values are not those{of_pairs if paired else ' of Γ_S: it is damaged'}"
        )
    return rows


def _damage_of(about: About, solution: Solved) -> str | None:
    """Why what was read is not what was written, or None if it is (collective)."""
    for name, value in vars(solution.kkt).items():
        before = about.kkt.get(name, value)
        if np.isfinite(before) and not abs(value - before) <= KKT + SAME * before:
            return f"its KKT residual {name} is {value:.1e}, and was {before:.1e} when it was written"
    by_sets = solution.method.starts_from_sets
    judged = about.converged and about.own_residual is None  # else that judges
    violation = solution.kkt.violation() if judged else None
    if violation is not None:
        return f"it claims to be a solution, but has {violation}"
    return solution.contradiction() if about.converged and by_sets else None


def _read_problem(checkpoint: Checkpoint) -> Any:
    """The data of the file.

    Raises:
        InputError: If the file does not have all data.
    """
    if (case := checkpoint.case) is not None:
        return case.at_step(case.posed(checkpoint.dim), checkpoint.about.step, checkpoint.dim)
    given = _given(checkpoint)
    laws = tuple(_law(checkpoint.keeping, table) for table in given.laws)
    data = given.problem | {"boundary": checkpoint.boundary} | ({"laws": laws} if laws else {})
    return _made(checkpoint.keeping.problem, data)


def _given(checkpoint: Checkpoint) -> GivenInPython:
    """The problem that was given in Python.

    Raises:
        InputError: If the file does not have all data.
    """
    given = checkpoint.about.given
    assert given is not None
    if given.missing:
        missing = ", ".join(given.missing)
        raise InputError(f"{missing}: given in Python, so not in the file; pass the problem to load_solution")
    return given


def _law(keeping: Keeping, table: dict[str, Any]) -> Any:
    """A law of the file.

    Raises:
        InputError: If there is none like it.
    """
    kind = keeping.laws.get(table.get("kind", ""))
    if kind is None:
        raise InputError("not a readable solution (its law is not of this version)")
    left_out = "kind", "parts" if table.get("region") else "region"
    return _made(kind, {name: value for name, value in table.items() if name not in left_out})


def _read_options(checkpoint: Checkpoint) -> Options:
    """The options of the file.

    Raises:
        InputError: If the algorithm was given in Python.
    """
    if checkpoint.case is not None:
        return options_of(checkpoint.case)
    assert checkpoint.about.given is not None
    values = checkpoint.about.given.options
    if values.get("algorithm") == OWN:
        raise InputError("the algorithm was given in Python; pass the options to load_solution")
    return _made(Options, values)


def _made[T](kind: type[T], values: dict[str, Any]) -> T:
    """An object of the package from values of a file.

    Raises:
        InputError: If it does not have these attributes.
    """
    try:
        return kind(**values)
    except TypeError:
        raise InputError(f"not a readable solution (its {kind.__name__.lower()} is not of this version)") from None
