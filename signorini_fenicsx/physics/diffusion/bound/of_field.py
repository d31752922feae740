"""How wrong a function is: a bound of its distance to an admissible one, and of what that leaves; see `of_field`."""

import math
from dataclasses import replace

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.owned import cell_dofs
from signorini_fenicsx.certificate.certify import FieldBound, bound_by_parts
from signorini_fenicsx.discrete.bernstein import make_linear, to_bernstein
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import bernstein
from signorini_fenicsx.physics.diffusion.bound.certify import Admissible, gap_parts, summed
from signorini_fenicsx.physics.diffusion.bound.laws import Goal
from signorini_fenicsx.physics.diffusion.solution import Solution


def field_bound(solution: Solution, v: fem.Function) -> FieldBound:
    """The bounds of a scalar v (collective)."""
    goal = Goal.of(solution, for_signorini=True)
    comm = solution.spaces.mesh.comm
    with np.errstate(all="ignore"):  # of data that are unbounded the bounds tell
        solved = Admissible.of(solution, goal)
        certificate = summed(solved, gap_parts(solved, solved, goal))
        field = _in_nodes(v)
        repaired = Admissible.of(solution, goal, field)
        parts = gap_parts(repaired, repaired, goal)
        of_repaired = summed(repaired, parts)
        to_bernstein(field)
        of_field = replace(solved.trace, v=field, cells=solved.trace.cells[:0])
        squares = solved.energies.squares(solution.data.driving(solution.cell_flux), of_field)
        most = (np.sqrt(squares.most) + solved.off_b) ** 2
        least = np.maximum(np.sqrt(squares.least) - solved.off_b, 0.0) ** 2
        moved = (
            np.sqrt(solved.energies.squares(None, repaired.trace, field).most) + parts.hidden + repaired.trace.lacking
        )
    repair = math.sqrt(comm.allreduce(float((moved**2).sum())))
    return bound_by_parts(solution, certificate, (most, least), solved.size, repair, of_repaired)


def _in_nodes(v: fem.Function) -> fem.Function:
    """The function by its values in the nodes of quadratics (collective)."""
    quadratic, mesh = fem.Function(bernstein(v.function_space.mesh), name="v"), v.function_space.mesh
    nodes = cell_dofs(quadratic.function_space)
    corners = mesh.topology.dim + 1
    values = v.x.array[cell_dofs(v.function_space)]
    if values.shape[1] == corners:
        quadratic.x.array[nodes[:, :corners]] = values
        quadratic.x.scatter_forward()
        make_linear(quadratic)
    else:
        quadratic.x.array[nodes] = values
    quadratic.x.scatter_forward()
    return quadratic
