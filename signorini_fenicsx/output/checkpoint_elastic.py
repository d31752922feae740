"""Reads a saved elastic solution on any number of ranks."""

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.rows import fetch_rows
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.conditions import Condition
from signorini_fenicsx.output.checkpoint_file import Checkpoint
from signorini_fenicsx.output.checkpoint_parts import damage_of, outcome_of, read_domain, rows_of_facets
from signorini_fenicsx.output.checkpoint_writing import COSTS
from signorini_fenicsx.physics.elasticity.data import elastic_data
from signorini_fenicsx.physics.elasticity.friction import law_of_sites
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.residuals import elastic_kkt
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.spaces import build_elastic_spaces
from signorini_fenicsx.solving.options import Options


def read_elastic_solution(
    found: Checkpoint, comm: MPI.Comm, problem: ElasticProblem, options: Options
) -> ElasticSolution:
    """The elastic solution of a checkpoint (collective).

    Raises:
        InputError: If it is damaged.
    """
    about, path, arrays = found.about, found.path, found.arrays
    assert isinstance(found.boundary, ElasticBoundary)
    boundary = found.boundary.touching_on(problem.rough)
    try:
        domain = read_domain(found, comm, boundary.named)
        spaces = build_elastic_spaces(domain, boundary, problem.rough)
        rows = rows_of_facets(found, spaces)
    except InputError as error:
        raise InputError(f"{path}: is damaged: its mesh: {error}") from None
    cells = spaces.mesh.topology.original_cell_index
    stresses, u = (fetch_rows(comm, cells, arrays[key]) for key in ("sigma", "u"))
    p, condition, slip, state, bound = (
        fetch_rows(comm, rows, arrays[f"facet_{key}"]) for key in ("p", "condition", "slip", "state", "bound")
    )
    data, rough = elastic_data(spaces, problem), spaces.rough_rows
    if data.friction is not None:
        by_pressure = np.where(data.friction.coulomb[:, None], bound[rough], data.friction.bound)
        data = replace(data, friction=replace(data.friction, bound=by_pressure))
    chains = law_of_sites(spaces, data.friction)
    opened = (condition != Condition.ZERO_TRACE).ravel()
    conditions = chains.conditions(np.concatenate([opened, state[rough].ravel()]).astype(np.int8))
    iterate = Iterate(
        p=np.concatenate([p.ravel(), slip[rough].ravel()]),
        flux=np.concatenate([-spaces.normal_stress(stresses), spaces.shear(stresses)]),
        linear_iterations=0,
        sigma=spaces.split.stress(stresses),
        u=spaces.displacement(u),
    )
    kkt = elastic_kkt(spaces, data, stresses, iterate.p)
    damage = damage_of(about, options.method, kkt)
    if damage is not None:
        raise InputError(f"{path}: is damaged: {damage}")
    return ElasticSolution(
        name=about.name,
        title=found.title,
        source=found.case,
        boundary=boundary,
        problem=problem,
        options=options,
        spaces=spaces,
        data=data,
        outcome=outcome_of(about, iterate, conditions),
        kkt=kkt,
        bound_changes=tuple(about.bound_changes),
        **{key: getattr(about, key) for key in COSTS},
    )
