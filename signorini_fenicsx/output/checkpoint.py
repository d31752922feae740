"""Saves a solution so that any number of ranks can read it: one NumPy file, in the original numbering of the mesh.

RT0 is stored as the values σ(x_T) and ∇·σ of each cell, σ(x) = σ(x_T) + (∇·σ/d)(x − x_T). So the file has no degrees of
freedom and does not depend on the partition.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.backends.contract import Iterate
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.exchange import repair
from signorini_fenicsx.base.parallel import collector_off, on_root
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.base.rows import fetch_rows
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.cases.solving import options_of
from signorini_fenicsx.discrete.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.data import project_data
from signorini_fenicsx.discrete.kkt import KKTResiduals, kkt_residuals
from signorini_fenicsx.discrete.laws import LAWS, Law
from signorini_fenicsx.discrete.problem import Problem
from signorini_fenicsx.discrete.spaces import Spaces, build_spaces
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.domain import Marks, Part, axis_part, distribute, facet_vertices, marked_domain
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.methods.history import Outcome
from signorini_fenicsx.methods.registry import Method
from signorini_fenicsx.output.checkpoint_file import (
    FORMAT,
    About,
    Arrays,
    Checkpoint,
    GivenInPython,
    read_checkpoint,
)
from signorini_fenicsx.output.gather import FacetTable, Fields
from signorini_fenicsx.solving.options import OWN, Options
from signorini_fenicsx.solving.solution import Solution
from signorini_fenicsx.solving.solver import gamma_s

FILE = "checkpoint.npz"


def write_checkpoint(path: Path, solution: Solution, fields: Fields, facets: FacetTable, marks: Marks) -> None:
    """Write a gathered solution (rank 0).

    Cells and points have the original numbering of the mesh, and a facet of Γ_S is identified by its vertices. The file
    alone is sufficient for pictures.

    Args:
        path: Path of the file.
        solution: The solution, for everything that is the same on all ranks.
        fields: Its mesh and cell values.
        facets: Its values on Γ_S.
        marks: Its boundary parts and regions.
    """
    about = {
        "format": FORMAT,
        "name": solution.name,
        **_problem(solution),
        "part_names": solution.spaces.part_names,
        "parts": {name: part.label for name, part in solution.spaces.domain.parts.items()},
        "regions": marks.regions,
        "bend": solution.spaces.domain.curvature,
        "history": [asdict(step) for step in solution.outcome.history],
        "beta": 1.0 if solution.method.penalty is None else solution.method.penalty.beta(solution.options.eps),
        "kkt": vars(solution.kkt),
        **{key: getattr(solution.outcome, key) for key in OUTCOME},
        **{key: getattr(solution, key) for key in COSTS},
    }
    arrays = {key: getattr(fields, key) for key in ("points", "cells", "u", "sigma", "divergence")}
    arrays |= {f"facet_{key}": values for key, values in vars(facets).items()}
    arrays |= {f"part_{index}": vertices for index, vertices in enumerate(marks.facets.values())}
    arrays |= {} if marks.cells is None else {"inside": marks.cells}
    with path.open("wb") as file:
        np.savez(file, about=np.array(json.dumps(about)), **arrays)


OUTCOME = (
    *("reason", "converged", "backend", "dofs", "linear_solver", "own_residual", "details"),
    "rough_steps",
)
"""Stored attributes of a solution's outcome, apart from fields and history."""
COSTS = ("timings", "peak_memory")
SAME = 1e-3
"""Allowed relative difference between the KKT residuals of what is read and those that were written."""


def _problem(solution: Solution) -> dict[str, Any]:
    """The case; or, for a problem given in Python, the data that a file can hold."""
    if isinstance(solution.source, Case):
        return {"case": solution.source.model_dump(mode="json", exclude_unset=True)}
    boundary, options = solution.boundary, solution.options
    laws = solution.problem.laws
    problem = {name: value for name, value in vars(solution.problem).items() if value is not None and name != "laws"}
    stored = {name: value for name, value in problem.items() if _storable(value)}
    missing = [name for name in problem if name not in stored]
    if not all(law.name in LAWS and _storable(vars(law)) for law in laws):
        laws, missing = (), [*missing, "laws"]
    given = GivenInPython(
        title=solution.title,
        domain=solution.spaces.domain.name,
        signorini=list(boundary.signorini),
        neumann=list(boundary.neumann),
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
    """Whether a datum consists of numbers and texts."""
    if isinstance(given, Mapping):
        return all(map(_storable, given.values()))
    return all(map(_storable, given)) if isinstance(given, tuple | list) else isinstance(given, str | int | float)


@collector_off()
@doing("reading the solution")
def load_solution(
    folder: Path | str, comm: MPI.Comm, *, problem: Problem | None = None, options: Options | None = None
) -> Solution:
    """Read the solution of a results folder, on as many ranks as there are now (collective).

    Args:
        folder: The results folder.
        comm: Communicator.
        problem: The data, needed if some were given in Python in a form that no file can hold.
        options: The options, needed if the algorithm was given in Python.

    Raises:
        InputError: If there is no solution; if the file cannot come from this program; if `problem` or `options` are
            needed; or if the residuals of the fields are not those that were written: then the file is damaged, and
            nothing of it is used.
    """
    path = Path(folder) / FILE
    everything: list[Arrays] = []

    def read() -> tuple[Checkpoint, int]:
        repair(folder)
        found = read_checkpoint(path)
        everything.append(found.arrays)
        facets = {key: array for key, array in found.arrays.items() if key.startswith("facet_")}
        return replace(found, arrays=facets), found.dim

    found, dim = on_root(comm, read)
    about, boundary, facets = found.about, found.boundary, found.arrays
    problem, options = problem or _read_problem(found, dim), options or _read_options(found)
    arrays = everything[0] if everything else {}
    points = arrays.get("points", np.empty((0, dim)))
    cells = arrays.get("cells", np.empty((0, dim + 1), dtype=np.int64))
    mesh = distribute(comm, points, cells, dim)
    marks, is_shape = _marks(about, arrays, dim), found.shape is not None
    domain = marked_domain(mesh, _parts(found), marks, curvature=about.bend, name=found.domain, is_shape=is_shape)
    boundary = gamma_s(boundary, problem)
    spaces = build_spaces(domain, boundary.signorini, boundary.neumann)
    rows = _rows(facets["facet_vertices"], facet_vertices(spaces.mesh, spaces.facets))
    sigma, u = _fields(spaces, arrays)
    sigma.x.array[spaces.flux_dofs] = facets["facet_flux"][rows] * spaces.facet_measure / spaces.basis_flux
    sigma.x.scatter_forward()
    p = spaces.multiplier(facets["facet_p"][rows])
    data = project_data(spaces, problem)
    trace, flux = p.x.array[: len(spaces.facets)] - data.psi_h, spaces.normal_flux(sigma) - data.q_Sh
    law = data.laws.chains.with_penalty(options.method.penalty, options.eps)
    conditions = law.conditions(law.nearest(facets["facet_condition"][rows].astype(np.int8), trace, flux))
    kkt = kkt_residuals(spaces, data, sigma, u, p, options.method.penalty, options.eps)
    damage = _damage(about, options.method, kkt)
    by_sets = about.converged and options.method.starts_from_sets
    if damage is None and by_sets and not _hold(conditions, sigma, u, trace, flux, spaces):
        damage = "its facet conditions are not those of its values"
    if damage is not None:
        raise InputError(f"{path}: is damaged: {damage}")
    outcome = Outcome(
        iterate=Iterate(p=trace, flux=flux, linear_iterations=0, sigma=sigma, u=u),
        conditions=conditions,
        history=about.history,
        **{key: getattr(about, key) for key in OUTCOME},
    )
    return Solution(
        name=about.name,
        title=found.title,
        source=found.case,
        boundary=boundary,
        problem=problem,
        options=options,
        spaces=spaces,
        data=data,
        p=p,
        outcome=outcome,
        kkt=kkt,
        **{key: getattr(about, key) for key in COSTS},
    )


def _read_problem(found: Checkpoint, dim: int) -> Problem:
    """The data of the file.

    Raises:
        InputError: If the file does not have all data.
    """
    if found.case is not None:
        return found.case.data(dim)
    assert found.about.given is not None
    given = found.about.given
    if given.missing:
        missing = ", ".join(given.missing)
        raise InputError(f"{missing}: given in Python, so not in the file; pass the problem to load_solution")
    return replace(_made(Problem, given.problem), laws=tuple(_law(table) for table in given.laws))


def _law(table: dict[str, Any]) -> Law:
    """A law of the file.

    Raises:
        InputError: If there is none like it.
    """
    kind = LAWS.get(table.get("kind", ""))
    if kind is None:
        raise InputError("not a readable solution (its law is not of this version)")
    return _made(kind, {name: value for name, value in table.items() if name != "kind"})


def _read_options(found: Checkpoint) -> Options:
    """The options of the file.

    Raises:
        InputError: If the algorithm was given in Python.
    """
    if found.case is not None:
        return options_of(found.case)
    assert found.about.given is not None
    values = found.about.given.options
    if values.get("algorithm") == OWN:
        raise InputError("the algorithm was given in Python; pass the options to load_solution")
    return _made(Options, values)


def _made[T](kind: type[T], values: dict[str, Any]) -> T:
    try:
        return kind(**values)
    except TypeError:
        raise InputError(f"not a readable solution (its {kind.__name__.lower()} is not of this version)") from None


def _damage(about: About, method: Method, kkt: KKTResiduals) -> str | None:
    """Why the residuals of what was read are not those that were written, or None if they are."""
    for name, value in vars(kkt).items():
        before = (about.kkt or {}).get(name, value)
        if np.isfinite(before) and not abs(value - before) <= KKT + SAME * before:
            return f"its KKT residual {name} is {value:.1e}, and was {before:.1e} when it was written"
    known = about.kkt is not None or method.starts_from_sets
    judged = about.converged and known and about.own_residual is None  # own_residual judges the others
    violation = kkt.violation() if judged else None
    return None if violation is None else f"it claims to be a solution, but has {violation}"


def _hold(
    conditions: SiteConditions, sigma: fem.Function, u: fem.Function, trace: Array, flux: Array, spaces: Spaces
) -> bool:
    """Whether σ·n and p have the values that the conditions prescribe (collective)."""
    e, kind = spaces.facet_measure, conditions.kind
    squares = [
        e @ np.where(kind == given, values - conditions.value, 0.0) ** 2
        for values, given in ((flux, Condition.NO_FLUX), (trace, Condition.ZERO_TRACE))
    ]
    left = spaces.length * spaces.mesh.comm.allreduce(np.array(squares))
    sizes = [spaces.integrate(l2(field, ufl.dx)) for field in (sigma, u)]
    return bool(np.all(np.sqrt(left) <= KKT * np.sqrt(sizes)))


def _parts(found: Checkpoint) -> Mapping[str, Part]:
    if found.shape is not None:
        return shape_of(found.shape).parts
    return {name: axis_part(label) for name, label in found.about.parts.items()}


def _marks(about: About, arrays: Arrays, dim: int) -> Marks:
    """Parts and regions on rank 0; empty on other ranks."""
    empty = np.empty((0, dim), dtype=np.int64)
    facets = {name: arrays.get(f"part_{index}", empty) for index, name in enumerate(about.parts)}
    return Marks(facets, arrays.get("inside"), tuple(about.regions))


def _fields(spaces: Spaces, arrays: Arrays) -> tuple[fem.Function, fem.Function]:
    """σ_h and u_h from cell values on rank 0 in the original order of the mesh (collective)."""
    mesh = spaces.mesh
    dim = mesh.geometry.dim
    centroid = spaces.centroids
    middle = fem.Function(centroid.function_space)
    divergence, u = fem.Function(spaces.Q), fem.Function(spaces.Q, name="u")
    for function, key in ((middle, "sigma"), (divergence, "divergence"), (u, "u")):
        values = fetch_rows(mesh.comm, mesh.topology.original_cell_index, arrays.get(key))
        function.x.array[:] = values.ravel()
    sigma = fem.Function(spaces.V, name="sigma")
    x = ufl.SpatialCoordinate(mesh)
    sigma.interpolate(fem.Expression(middle + divergence / dim * (x - centroid), spaces.V.element.interpolation_points))
    sigma.x.scatter_forward()
    return sigma, u


def _rows(known: Indices, wanted: Indices) -> Indices:
    """Row of each facet in the file, found by its vertices."""
    row = {tuple(vertices): index for index, vertices in enumerate(known.tolist())}
    return np.array([row[tuple(vertices)] for vertices in wanted.tolist()], dtype=np.int64)
