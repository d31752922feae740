"""How elastic solutions are kept in files: by their values at vertices, in ascending order of their numbers."""

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Condition
from signorini_fenicsx.contact.laws import Friction
from signorini_fenicsx.meshes.domain import facet_vertices
from signorini_fenicsx.physics.elasticity.conditions import LAWS_OF_BODIES
from signorini_fenicsx.physics.elasticity.discrete.data import elastic_data
from signorini_fenicsx.physics.elasticity.discrete.friction import FromBefore, Slipping
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.show.tables import STATES
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.residuals import elastic_kkt
from signorini_fenicsx.solving.kept import Arrays, Keeping, Layout, Stored

LAYOUT: Layout = {
    "u": (np.float64, "cells", "corners", "dim"),
    "sigma": (np.float64, "cells", "corners", "corners", "dim", "dim"),
    "facet_p": (np.float64, "facets", "dim"),
    "facet_condition": (np.int64, "facets", "dim"),
    "facet_slip": (np.float64, "facets", "dim"),
    "facet_state": (np.int64, "facets", "dim"),
    "facet_bound": (np.float64, "facets", "dim"),
}


def _on_facets(solution: ElasticSolution) -> Arrays:
    spaces, touching = solution.spaces, solution.touching
    spread, in_space = spaces.site_kinds["slip"].spread, {}
    slip, state, bound = map(spread, (solution.slip, solution.states, solution.data.friction.bound))
    if solution.data.friction and spaces.dim == 3:
        in_space["slip_vector"] = spread(solution.slip_vectors)
        state = np.where(state == STATES.index("stick"), state, 0)
    slipped = {}
    if spaces.mesh.comm.allreduce(bool(solution.data.slipped.any()), MPI.LOR):
        by_vertex = solution.data.slipped.reshape(-1, spaces.dim, spaces.dim - 1)
        in_plane = spaces.dim == 2
        key, rows = ("slipped", by_vertex[:, :, 0]) if in_plane else ("slipped_vector", spaces.along(by_vertex))
        slipped[key] = spread(rows)
    return {
        "vertices": facet_vertices(spaces.mesh, spaces.contact.facets),
        "p": solution.outcome.iterate.p[: touching.size].reshape(touching.shape),
        "condition": solution.outcome.conditions.kind[: touching.size].reshape(touching.shape).astype(np.int64),
        "slip": slip,
        "state": state.astype(np.int64),
        "bound": bound,
        **slipped,
        **in_space,
    }


def _slipping(sticks: Mask, shear: Array, slip: Array) -> Slipping:
    """The linear law of friction in space at a solution, see `Slipping`."""
    size = np.linalg.norm(shear, axis=2)
    direction = np.divide(-shear, size[:, :, None], out=np.zeros_like(shear), where=(size > 0)[:, :, None])
    moved = np.linalg.norm(slip, axis=2)
    slips = ~sticks & (moved > 0)
    return Slipping(np.where(sticks[:, :, None], 0.0, direction), np.where(slips, moved, 1.0))


def read(
    problem: ElasticProblem, spaces: ElasticSpaces, stored: Stored, kind: type[ElasticSolution] = ElasticSolution
) -> ElasticSolution:
    """A solution of a kind from what is kept of it (collective)."""
    stresses, u = (stored.in_cells(spaces, key) for key in ("sigma", "u"))
    p, condition, slip, state, bound = stored.on_facets(spaces.mesh.comm, "p", "condition", "slip", "state", "bound")
    rough, slipped = spaces.rough_rows, None
    if "facet_slipped" in stored.arrays:
        slipped = stored.on_facets(spaces.mesh.comm, "slipped")[0][rough].ravel()
    elif "facet_slipped_vector" in stored.arrays:
        slipped = spaces.in_frames(stored.on_facets(spaces.mesh.comm, "slipped_vector")[0][rough])
    data = elastic_data(spaces, problem, FromBefore(slipped))
    data = replace(data, friction=data.friction.with_bounds(bound[rough]))
    data = data.after(spaces, np.array(stored.numbers["moved"]))
    along = slip[rough].ravel()
    segment = state[rough].ravel()
    if data.friction and spaces.dim == 3:
        if "facet_slip_vector" not in stored.arrays:
            raise InputError("not a readable solution (it holds no facet_slip_vector)")
        along = spaces.in_frames(stored.on_facets(spaces.mesh.comm, "slip_vector")[0][rough])
        segment = np.zeros(len(along))
        of_friction = data.reactions(spaces, stresses, along - data.slipped)
        shear = spaces.site_kinds["slip"].rows_of(of_friction)
        after = data.friction.left((along - data.slipped).reshape(shear.shape), shear)
        slipping = _slipping(state[rough] == STATES.index("stick"), shear, after)
        data = replace(data, friction=replace(data.friction, slipping=slipping))
    reactions = data.reactions(spaces, stresses, along - data.slipped)
    pressure = spaces.site_kinds["normal"].of(reactions)
    normal = data.laws.chains.nearest(condition.ravel().astype(np.int8), p.ravel(), pressure)
    conditions = data.chains.conditions(np.concatenate([normal, segment]).astype(np.int64))
    iterate = Iterate(
        p=np.concatenate([p.ravel(), along - data.slipped]),
        flux=reactions,
        linear_iterations=0,
        sigma=spaces.split.stress(stresses),
        u=spaces.displacement(u),
    )
    return kind(
        spaces=spaces,
        data=data,
        outcome=stored.outcome(iterate, conditions),
        kkt=elastic_kkt(spaces, data, stresses, iterate.p),
        bound_changes=tuple(stored.numbers["bound_changes"]),
        **stored.about,
    )


KEEPING = Keeping(
    boundary=ElasticBoundary,
    problem=ElasticProblem,
    laws=LAWS_OF_BODIES,
    layout=LAYOUT,
    codes={"facet_condition": len(Condition), "facet_state": len(Friction.segments)},
    in_cells=lambda solution: {"sigma": solution.stresses, "u": solution.spaces.displacement_values(solution.u)},
    on_facets=_on_facets,
    read=read,
    numbers=("bound_changes", "moved"),
    of_some={
        "facet_slipped": (np.float64, "facets", "dim"),
        "facet_slip_vector": (np.float64, "facets", "dim", "dim"),
        "facet_slipped_vector": (np.float64, "facets", "dim", "dim"),
    },
)
