"""Reads a saved solution on any number of ranks, see `checkpoint_writing`; a damaged one is told by its residuals."""

from collections.abc import Mapping
from dataclasses import replace
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
from signorini_fenicsx.base.rows import fetch_rows, find_rows
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.cases.solving import options_of
from signorini_fenicsx.discrete.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.data import project_data
from signorini_fenicsx.discrete.kkt import KKTResiduals, kkt_residuals
from signorini_fenicsx.discrete.laws import LAWS, Law
from signorini_fenicsx.discrete.problem import Problem
from signorini_fenicsx.discrete.spaces import Spaces, build_spaces
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.domain import Marks, Part, axis_part, distribute, facet_vertices, marked_domain
from signorini_fenicsx.meshes.own import check_parts
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.methods.history import Outcome
from signorini_fenicsx.methods.registry import Method
from signorini_fenicsx.output.checkpoint_file import About, Arrays, Checkpoint, read_checkpoint
from signorini_fenicsx.output.checkpoint_writing import COSTS, OUTCOME
from signorini_fenicsx.solving.options import OWN, Options
from signorini_fenicsx.solving.solution import Solution
from signorini_fenicsx.solving.solver import gamma_s

SAME = 1e-3
"""Allowed relative difference between the KKT residuals of what is read and those that were written."""


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
        InputError: If there is no solution; if the files cannot come from this program; if `problem` or `options` are
            needed; or if the residuals of the fields are not those that were written: then the file is damaged, and
            nothing of it is used.
    """
    on_root(comm, lambda: repair(folder))
    found = read_checkpoint(comm, Path(folder))
    about, path, arrays, dim = found.about, found.path, found.arrays, found.dim
    problem, options = problem or _read_problem(found, dim), options or _read_options(found)
    try:
        spaces, rows = _spaces(found, comm, problem)
    except InputError as error:
        raise InputError(f"{path}: is damaged: its mesh: {error}") from None
    sigma, u = _fields(spaces, arrays)
    flux, p, condition = (fetch_rows(comm, rows, arrays[f"facet_{key}"]) for key in ("flux", "p", "condition"))
    sigma.x.array[spaces.flux_dofs] = flux * spaces.facet_measure / spaces.basis_flux
    sigma.x.scatter_forward()
    p = spaces.multiplier(p)
    data = project_data(spaces, problem)
    trace, flux = p.x.array[: len(spaces.facets)] - data.psi_h, spaces.normal_flux(sigma) - data.q_Sh
    law = data.laws.chains.with_penalty(options.method.penalty, options.eps)
    conditions = law.conditions(law.nearest(condition.astype(np.int8), trace, flux))
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
        boundary=gamma_s(found.boundary, problem),
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
        return SHAPES[found.shape].parts
    return {name: axis_part(label) for name, label in found.about.parts.items()}


def _spaces(found: Checkpoint, comm: MPI.Comm, problem: Problem) -> tuple[Spaces, Indices]:
    """The spaces on the mesh of the file, and for each facet of Γ_S of this rank its row in the file (collective).

    Raises:
        InputError: If the parts are not on the boundary, or the facets with values are not those of Γ_S.
    """
    about, arrays = found.about, found.arrays
    mesh = distribute(comm, arrays["points"], arrays["cells"], found.dim, together=arrays.get("together"))
    facets = {name: arrays[f"part_{index}"] for index, name in enumerate(about.parts)}
    domain = marked_domain(
        mesh,
        _parts(found),
        Marks(facets, arrays.get("inside"), tuple(about.regions)),
        curvature=about.bend,
        name=found.domain,
        is_shape=found.shape is not None,
        made=about.made,
    )
    boundary = gamma_s(found.boundary, problem)
    check_parts(domain, vars(boundary))
    for index, name in enumerate(facets):
        used = name in (*boundary.signorini, *boundary.neumann)
        if used and comm.allreduce(len(domain.facets[name])) != found.headers[f"part_{index}"].shape[0]:
            raise InputError(f"part '{name}' has facets that are not on the boundary")
    spaces = build_spaces(domain, boundary.signorini, boundary.neumann, boundary.inner)
    rows = find_rows(comm, facet_vertices(mesh, spaces.facets), [arrays["facet_vertices"]])[:, 0]
    missing, count = comm.allreduce(np.array([np.count_nonzero(rows < 0), len(rows)]))
    if missing > 0 or count != found.headers["facet_vertices"].shape[0]:
        raise InputError("its facets with values are not those of Γ_S")
    return spaces, rows


def _fields(spaces: Spaces, arrays: Arrays) -> tuple[fem.Function, fem.Function]:
    """σ_h and u_h from the cell values of the file (collective)."""
    mesh = spaces.mesh
    dim = mesh.geometry.dim
    centroid = spaces.centroids
    middle = fem.Function(centroid.function_space)
    divergence, u = fem.Function(spaces.Q), fem.Function(spaces.Q, name="u")
    for function, key in ((middle, "sigma"), (divergence, "divergence"), (u, "u")):
        values = fetch_rows(mesh.comm, mesh.topology.original_cell_index, arrays[key])
        function.x.array[:] = values.ravel()
    sigma = fem.Function(spaces.V, name="sigma")
    x = ufl.SpatialCoordinate(mesh)
    sigma.interpolate(fem.Expression(middle + divergence / dim * (x - centroid), spaces.V.element.interpolation_points))
    sigma.x.scatter_forward()
    return sigma, u
