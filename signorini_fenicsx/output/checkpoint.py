"""Reads a saved solution on any number of ranks, see `checkpoint_writing`; a damaged one is told by its residuals."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.exchange import refuse_incomplete
from signorini_fenicsx.base.parallel import collector_off, on_root
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.base.rows import fetch_rows
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.cases.elastic_case import ElasticCase
from signorini_fenicsx.cases.solving import options_of
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.contact.laws import LAWS, Friction, Law
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.domain import Boundary
from signorini_fenicsx.output.checkpoint_elastic import read_elastic_solution
from signorini_fenicsx.output.checkpoint_file import Arrays, Checkpoint, GivenInPython, read_checkpoint
from signorini_fenicsx.output.checkpoint_parts import damage_of, made, outcome_of, read_domain, rows_of_facets
from signorini_fenicsx.output.checkpoint_writing import COSTS
from signorini_fenicsx.physics.diffusion.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.data import project_data
from signorini_fenicsx.physics.diffusion.evolution import problem_of_step
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.residuals import kkt_residuals, touching
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.solving import gamma_s
from signorini_fenicsx.physics.diffusion.spaces import Spaces, build_spaces
from signorini_fenicsx.physics.elasticity.problem import CoulombLaw, ElasticLaw, ElasticProblem
from signorini_fenicsx.solving.options import OWN, Options
from signorini_fenicsx.solving.system import sorted_on


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
    found = read_checkpoint(comm, Path(folder))
    given, name = problem, "Diffusion" if found.about.physics is None else "Elasticity"
    if hasattr(problem, "on"):
        _, problem = sorted_on(read_domain(found, comm, {}), problem)
    fits = problem is None or isinstance(problem, Problem if found.about.physics is None else ElasticProblem)
    if not fits:
        raise InputError(f"problem: {folder} is the solution of a problem of {name}, not of {type(given).__name__}")
    if found.about.physics is None:
        scalar = problem or _read_problem(found, found.dim)
        return _read_solution(found, comm, scalar, options or _read_options(found))
    elastic = problem or _read_elastic_problem(found)
    return read_elastic_solution(found, comm, elastic, options or _read_options(found))


def _read_solution(found: Checkpoint, comm: MPI.Comm, problem: Problem, options: Options) -> Solution:
    """The scalar solution of a checkpoint (collective)."""
    about, path, arrays = found.about, found.path, found.arrays
    assert isinstance(found.boundary, Boundary)
    boundary = gamma_s(found.boundary, problem)
    try:
        domain = read_domain(found, comm, vars(boundary))
        spaces = build_spaces(domain, boundary.signorini, boundary.neumann, boundary.inner)
        rows = rows_of_facets(found, spaces)
    except InputError as error:
        raise InputError(f"{path}: is damaged: its mesh: {error}") from None
    sigma, u = _fields(spaces, arrays)
    flux, p, condition = (fetch_rows(comm, rows, arrays[f"facet_{key}"]) for key in ("flux", "p", "condition"))
    sigma.x.array[spaces.flux_dofs] = flux * spaces.facet_measure / spaces.basis_flux
    sigma.x.scatter_forward()
    p = spaces.multiplier(p)
    data = project_data(spaces, problem)
    if about.step is not None:
        memory = fem.Function(spaces.Q, name="memory")
        memory.x.array[:] = fetch_rows(comm, spaces.mesh.topology.original_cell_index, arrays["memory"])
        data = data.after(memory)
    trace, flux = p.x.array[: len(spaces.facets)] - data.psi_h, spaces.normal_flux(sigma) - data.q_Sh
    law = data.laws.chains.with_penalty(options.method.penalty, options.eps)
    conditions = law.conditions(law.nearest(condition.astype(np.int8), trace, flux))
    kkt = kkt_residuals(spaces, data, sigma, u, p, options.method.penalty, options.eps)
    damage = damage_of(about, options.method, kkt)
    by_sets = about.converged and options.method.starts_from_sets
    if damage is None and by_sets and not _hold(conditions, sigma, u, trace, flux, spaces):
        damage = "its facet conditions are not those of its values"
    if damage is not None:
        raise InputError(f"{path}: is damaged: {damage}")
    contact = touching(spaces, data, sigma, u)
    iterate = Iterate(p=trace, flux=flux, linear_iterations=0, sigma=sigma, u=u, contact=contact)
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
        outcome=outcome_of(about, iterate, conditions),
        kkt=kkt,
        step=about.step,
        **{key: getattr(about, key) for key in COSTS},
    )


def _read_problem(found: Checkpoint, dim: int) -> Problem:
    """The data of the file.

    Raises:
        InputError: If the file does not have all data.
    """
    if isinstance(found.case, Case):
        problem, time = found.case.data(dim), found.case.time
        if found.about.step is None or time is None:
            return problem
        return problem_of_step(problem.in_time(dim), time.evolution(), found.about.step, dim)
    given = _given(found)
    return replace(made(Problem, given.problem), laws=tuple(_law(table) for table in given.laws))


def _read_elastic_problem(found: Checkpoint) -> ElasticProblem:
    """The same for an elastic problem."""
    if isinstance(found.case, ElasticCase):
        return found.case.data()
    given = _given(found)
    laws: list[ElasticLaw] = []
    for table in given.laws:
        values = {name: value for name, value in table.items() if name != "kind"}
        laws.append(made(CoulombLaw, values) if table.get("kind") == CoulombLaw.name else made(Friction, values))
    return replace(made(ElasticProblem, given.problem), laws=laws)


def _given(found: Checkpoint) -> GivenInPython:
    """The problem that was given in Python.

    Raises:
        InputError: If the file does not have all data.
    """
    given = found.about.given
    assert given is not None
    if given.missing:
        missing = ", ".join(given.missing)
        raise InputError(f"{missing}: given in Python, so not in the file; pass the problem to load_solution")
    return given


def _law(table: dict[str, Any]) -> Law:
    """A law of the file.

    Raises:
        InputError: If there is none like it.
    """
    kind = LAWS.get(table.get("kind", ""))
    if kind is None:
        raise InputError("not a readable solution (its law is not of this version)")
    return made(kind, {name: value for name, value in table.items() if name != "kind"})


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
    return made(Options, values)


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


def _fields(spaces: Spaces, arrays: Arrays) -> tuple[fem.Function, fem.Function]:
    """σ_h and u_h from the cell values of the file (collective)."""
    mesh, u = spaces.mesh, fem.Function(spaces.Q, name="u")
    centroid, divergence, u.x.array[:] = (
        fetch_rows(mesh.comm, mesh.topology.original_cell_index, arrays[key]) for key in ("sigma", "divergence", "u")
    )
    return CellFlux(spaces, centroid, divergence / mesh.geometry.dim).function(), u
