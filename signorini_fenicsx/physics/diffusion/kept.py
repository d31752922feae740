"""How solutions of diffusion problems are kept in files.

RT1 is stored by values at vertices, in ascending order of their numbers; RT0 as the values σ(x_T) and ∇·σ of each
cell, σ(x) = σ(x_T) + (∇·σ/d)(x − x_T).
"""

from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import function_of
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Condition
from signorini_fenicsx.contact.laws import LAWS, LAWS_INSIDE, Dirichlet, Neumann
from signorini_fenicsx.discrete.linear_traces import linear_from_means
from signorini_fenicsx.discrete.remembered import Remembered
from signorini_fenicsx.meshes.domain import Boundary
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.discrete.data import project_data
from signorini_fenicsx.physics.diffusion.discrete.rt1_data import rt1_data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces, rt1_spaces
from signorini_fenicsx.physics.diffusion.discrete.storing import WaterBefore, in_places
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.rt1_solution import RT1Solution
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.solve.residuals import kkt_residuals, with_cells
from signorini_fenicsx.physics.diffusion.solve.rt1_residuals import RT1Iterate, rt1_kkt
from signorini_fenicsx.solving.kept import Arrays, Keeping, Layout, Stored

LAYOUT: Layout = {
    "u": (np.float64, "cells"),
    "sigma": (np.float64, "cells", "dim"),
    "divergence": (np.float64, "cells"),
    "facet_part": (np.int64, "facets"),
    "facet_x": (np.float64, "facets", "space"),
    "facet_along": (np.float64, "facets"),
    "facet_measure": (np.float64, "facets"),
    "facet_u": (np.float64, "facets"),
    "facet_p": (np.float64, "facets"),
    "facet_flux": (np.float64, "facets"),
    "facet_condition": (np.int64, "facets"),
}


OF_LINEAR: Layout = {
    "u_at": (np.float64, "cells", "corners"),
    "sigma_at": (np.float64, "cells", "nodes", "dim"),
    "facet_means_at": (np.float64, "facets", "dim"),
    "facet_condition_at": (np.int64, "facets", "dim"),
    "segment_at": (np.int64, "cells", "corners"),
}
"""Beside the means what RT1 has: values at vertices, of σ at the midpoints of edges too, of facets
means by the hats of theirs; with laws in Ω the segment at each vertex of a cell."""
OF_KAPPA: Layout = {"kappa": (np.float64, "cells"), "kappa_at": (np.float64, "cells", "corners")}
"""And where κ depends on u the one that was found, on cells or at their vertices."""
OF_SOIL: Layout = {"storing": (np.float64, "cells")}
"""And in time what soils store for a change of u."""
OF_STEP: Layout = {"memory_at": (np.float64, "cells", "corners")}
"""And in time."""
OF_MEMORY: Layout = {"facet_remembered": (np.float64, "facets", "remembered")}
"""And with laws with memory, see `discrete/remembered.py`."""


def _in_cells(solution: Solution) -> Arrays:
    memory, flux = solution.data.memory, solution.cell_flux
    rows = {"u": solution.u_means, "sigma": flux.centroid, "divergence": solution.divergences}
    if isinstance(solution, RT1Solution):
        rows |= _at_vertices(solution)
    if solution.data.quasilinear is not None:
        kappa = solution.data.kappa_values
        rows |= {"kappa_at": kappa} if solution.spaces.degree else {"kappa": kappa[:, 0]}
        rows |= {} if solution.data.stored is None else {"storing": solution.data.stored[0][:, 0]}
    return rows | ({} if memory is None else {"memory": solution.data.means_of_memory})


def _on_facets(solution: Solution) -> Arrays:
    """The table, and what laws with memory know in the step (collective)."""
    remembered = Remembered.among(solution.spaces, solution.problem.laws)
    known = {"remembered": remembered.known(solution.problem.laws)} if remembered.laws else {}
    return {**vars(solution.table()), **known}


def _at_vertices(solution: RT1Solution) -> Arrays:
    """What a solution of RT1 has in cells beside its means."""
    memory = solution.data.memory
    rows = {"u_at": solution.u_values, "sigma_at": solution.sigma_values}
    rows |= {} if memory is None else {"memory_at": solution.spaces.scalar_values(memory)}
    if not solution.data.inside:
        return rows
    return rows | {"segment_at": solution.spaces.site_kinds["cell"].rows_of(solution.segments().segment)}


def _read_linear(problem: Problem, on_mesh: Spaces, stored: Stored) -> RT1Solution:
    spaces, options = rt1_spaces(on_mesh), replace(stored.options, element="RT1")
    in_time = stored.step is not None
    with_laws = {"segment_at"} if problem.has_laws_inside else set()
    needed = {*OF_LINEAR} - {"segment_at"} | with_laws | ({*OF_STEP} if in_time else set())
    missing = [name for name in needed if name not in stored.arrays]
    if missing:
        raise InputError(f"not a readable solution (it holds no {missing[0]})")
    sigma, u = spaces.flux(stored.in_cells(spaces, "sigma_at")), spaces.scalar(stored.in_cells(spaces, "u_at"))
    p_means, condition = stored.on_facets(spaces.mesh.comm, "means_at", "condition_at")
    memory = spaces.scalar(stored.in_cells(spaces, "memory_at")) if in_time else None
    data = _as_left(rt1_data(spaces, project_data(on_mesh, problem)), spaces, memory, stored)
    means = p_means.ravel()
    flux = spaces.through(spaces.contact, spaces.flux_values(sigma)).ravel() - data.laws_at.flux_h
    law = data.laws_at.chains.with_penalty(options.method.penalty, options.eps)
    segment = law.nearest(condition.ravel().astype(np.int8), means - data.laws_at.p_h, flux)
    above = data.laws_at.openings(data.laws_at.chains.segments(law.conditions(segment)), means - data.laws_at.p_h, flux)
    if data.inside:
        in_cells = data.in_cells(spaces, spaces.flux_values(sigma), spaces.scalar_values(u))
        at_cells = np.clip(stored.in_cells(spaces, "segment_at").ravel(), 0, data.cells_at.chains.count)
        pair = data.cells_at.openings(at_cells, *in_cells), in_cells[1]
        in_cells = data.cells_at.chains.conditions(at_cells).clean(*pair, data.conductance)
        segment, law = np.append(segment, at_cells), law.followed_by(data.cells_at.chains)
        above, flux = np.append(above, in_cells[0]), np.append(flux, in_cells[1])
    iterate = RT1Iterate(p=above, flux=flux, linear_iterations=0, sigma=sigma, u=u, means=means)
    return RT1Solution(
        spaces=spaces,
        data=data,
        p=spaces.linear_multiplier(linear_from_means(p_means)),
        outcome=stored.outcome(iterate, law.conditions(segment)),
        kkt=rt1_kkt(spaces, data, iterate, options.method.penalty, options.eps),
        **dict(stored.about) | {"options": options},
    )


def _as_left(data: Any, spaces: Any, memory: fem.Function | None, stored: Stored) -> Any:
    """The data as a solution has left them: with what a step took from those before, and the κ found (collective)."""
    soils = None
    if memory is not None and "storing" in stored.arrays:
        taken = in_places(spaces, spaces.scalar_values(memory))
        soils = np.broadcast_to(stored.in_cells(spaces, "storing")[:, None], taken.shape), taken
        u = stored.in_cells(spaces, "u_at" if spaces.degree else "u")
        data = data.after(WaterBefore(spaces.scalar(0 * u), data.quasilinear.traces_of_values(u)))
    else:
        data = data.after(memory)
    if data.quasilinear is None:
        return data
    name = "kappa_at" if spaces.degree else "kappa"
    return data.with_kappa(spaces, stored.in_cells(spaces, name).reshape(data.kappa_values.shape), soils)


def _read(problem: Problem, spaces: Spaces, stored: Stored) -> Solution:
    options, mesh = stored.options, spaces.mesh
    if options.element == "RT1" or spaces.pairs:
        return _read_linear(problem, spaces, stored)
    centroid, divergence, means = (stored.in_cells(spaces, key) for key in ("sigma", "divergence", "u"))
    u = function_of(spaces.Q, means, "u")
    sigma = CellFlux(spaces, centroid, divergence / mesh.geometry.dim).function()
    flux, trace, condition = stored.on_facets(mesh.comm, "flux", "p", "condition")
    sigma.x.array[spaces.flux_dofs] = flux * spaces.facet_measure / spaces.basis_flux
    sigma.x.scatter_forward()
    remembered = Remembered.among(spaces, problem.laws)
    if remembered.laws:
        if "facet_remembered" not in stored.arrays:
            raise InputError("not a readable solution (it holds no facet_remembered)")
        problem = replace(problem, laws=remembered.in_step(problem.laws, *stored.on_facets(mesh.comm, "remembered")))
    memory = None if stored.step is None else spaces.scalar(stored.in_cells(spaces, "memory"))
    data = _as_left(project_data(spaces, problem), spaces, memory, stored)
    above, flux = trace - data.psi_h, spaces.normal_flux(sigma) - data.q_Sh
    law = data.laws.chains.with_penalty(options.method.penalty, options.eps)
    iterate = Iterate(p=above, flux=flux, linear_iterations=0, sigma=sigma, u=u)
    segment = law.nearest(condition.astype(np.int8), above, flux)
    iterate, conditions = with_cells(spaces, data, iterate, segment, options.method.penalty, options.eps)
    return Solution(
        spaces=spaces,
        data=data,
        p=spaces.multiplier(trace),
        outcome=stored.outcome(iterate, conditions),
        kkt=kkt_residuals(spaces, data, sigma, u, trace, options.method.penalty, options.eps),
        **{**stored.about, "problem": problem},
    )


KEEPING = Keeping(
    boundary=Boundary,
    problem=Problem,
    laws={**LAWS, **LAWS_INSIDE, **{kind.__name__: kind for kind in (Dirichlet, Neumann)}},
    layout=LAYOUT,
    codes=dict.fromkeys(("facet_condition", "facet_condition_at"), len(Condition)),
    in_cells=_in_cells,
    on_facets=_on_facets,
    read=_read,
    of_some={**OF_LINEAR, **OF_KAPPA, **OF_SOIL, **OF_STEP, **OF_MEMORY},
    of_step={"memory": (np.float64, "cells")},  # a load
)
