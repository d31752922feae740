"""Reads a saved solution on any number of ranks, see `checkpoint_writing`; a damaged one is told by its residuals."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.exchange import refuse_incomplete
from signorini_fenicsx.base.parallel import collector_off, on_root
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.base.rows import find_rows
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.cases.solving import options_of
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.meshes.domain import Domain, Marks, Part, axis_part, distribute, facet_vertices, marked_domain
from signorini_fenicsx.meshes.own import check_parts
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.output.checkpoint_file import About, Checkpoint, GivenInPython, read_checkpoint
from signorini_fenicsx.output.checkpoint_writing import COSTS, OUTCOME
from signorini_fenicsx.solving.kept import Keeping, Stored
from signorini_fenicsx.solving.options import OWN, Options
from signorini_fenicsx.solving.solved import Solved
from signorini_fenicsx.solving.system import sorted_on, system_on

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
        problem: A `Diffusion` or `Elasticity`, needed if some data were given in Python in a form that no file can
            hold. The mesh that is read is a new one, so data are then numbers, texts or functions of points.
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
    try:
        system = system_on(_read_domain(checkpoint, comm, boundary.named), posed)
    except InputError as error:
        raise InputError(f"{checkpoint.path}: is damaged: its mesh: {error}") from None
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
        own=checkpoint.own,
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
    domain = marked_domain(
        mesh,
        _parts(checkpoint),
        Marks(facets, arrays.get("inside"), tuple(about.regions), pairs),
        curvature=about.bend,
        name=checkpoint.domain,
        is_shape=checkpoint.shape is not None,
        made=about.made,
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
    if checkpoint.case is not None:
        return checkpoint.case.posed(checkpoint.dim, checkpoint.about.step)
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
