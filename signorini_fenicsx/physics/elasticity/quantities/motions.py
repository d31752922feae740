"""Elastic problems some parts of whose boundary are moved rigidly: what belongs to forces and moments.

A force F = ⟨σn, w⟩ with a rigid motion w moves what holds the body on its parts: u_D by τw, a foundation, or the jump
of two bodies, as a tool moves: by τw·n in the gap and, with friction, by τw_t in the slip. Both are linear on each
facet, also where Γ_C is curved.

*Loads that quadrature misses.* Let R(w) be the work of what y does not balance of the linear parts of loads, and ŵ any
function that is w on these parts and 0 in other places where u is given. v − u is −τw on the parts, so that R(v − u) is
no more bounded by a constant of the body: only R(v − u + τŵ) is. So τ(R(ŵ) + C|ŵ|) is added to the bound, with C|w| for
that of R(w). Where u is given on no other part ŵ is w, and |ŵ| = 0; where it is given on none of them ŵ is 0; otherwise
it is (v₊ − v₋)/2τ.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.vectors import components_of
from signorini_fenicsx.expressions.given import Given
from signorini_fenicsx.forms.elasticity import strain
from signorini_fenicsx.meshes.domain import AXES, Domain
from signorini_fenicsx.physics.elasticity.bound.resolution import Resolution
from signorini_fenicsx.physics.elasticity.discrete.tools import Tool
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.quantities.beside import added, check_part
from signorini_fenicsx.quantities.kinds import Force, Moment

OPPOSITE = "on which all is opposite"
"""What is different on the named side of a part inside the domain."""


def direction_of(given: Sequence[float] | None, dim: int) -> list[float]:
    """The direction as numbers.

    Raises:
        InputError: If there is not one for each coordinate.
    """
    if given is None or len(given) != dim:
        raise InputError(f"direction: needs {dim} numbers, such as [{', '.join(['1', *'0' * (dim - 1)])}]")
    return [float(each) for each in given]


def motion_of(kind: Force, dim: int) -> Array:
    """The rigid motion w that belongs to a force or a moment, w_i = m_i0 + m_ij x_j, shape (d, 1 + d).

    Raises:
        InputError: If the direction has not a number for each coordinate.
    """
    if not isinstance(kind, Moment):
        return np.column_stack([direction_of(kind.direction, dim), np.zeros((dim, dim))])
    if dim == 2:
        return np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    a, b, c = direction_of(kind.direction, dim)
    return np.array([[0.0, 0.0, -c, b], [0.0, c, 0.0, -a], [0.0, -b, a, 0.0]])


def components(given: Any, dim: int) -> list[Given]:
    """A vector as a list.

    Raises:
        InputError: If it is a function of points.
    """
    if given is None:
        return [0.0] * dim
    if callable(given) and not hasattr(given, "ufl_shape"):
        raise InputError("quantities need data that are numbers, texts or UFL, not functions of points")
    return components_of(dim, "f", given)


def check_parts(domain: Domain, boundary: ElasticBoundary, kind: Force) -> None:
    """Refuse parts that hold no body.

    Raises:
        InputError: If a part is unknown, a traction is given on it, it is the other side of one inside the domain, a
            master, or tied.
    """
    for part in kind.parts:
        check_part(domain, boundary, part, OPPOSITE)
        for pair in boundary.pairs:
            if pair.tied and part in (*pair.slave, *pair.master):
                raise InputError(f"'{part}' is tied; there are forces on what else holds its body")
            if part in pair.master:
                slaves = ", ".join(pair.slave)
                raise InputError(f"'{part}' is a master; the force on it is opposite to that on {slaves}")
        if part in boundary.neumann and part not in boundary.contact:
            raise InputError(f"the traction on the part '{part}' is given")


def moved(domain: Domain, problem: ElasticProblem, kind: Force, tau: float) -> ElasticProblem:
    """The problem whose u_D on the parts of a force is moved by τw.

    Raises:
        InputError: If the direction has not a number for each coordinate, or u_D is a function of points.
    """
    dim = domain.mesh.geometry.dim
    held = [part for part in kind.parts if part not in problem.boundary.contact]
    motion = motion_of(kind, dim)
    given = dict(problem.u_D) if isinstance(problem.u_D, Mapping) else {"": problem.u_D}
    of_parts = {part: _moved_vector(domain, given.get(part, given.get("")), motion, tau) for part in held}
    return replace(problem, u_D=given | of_parts) if held else problem


def foundations(domain: Domain, problem: ElasticProblem, kind: Force, tau: float) -> tuple[Tool, ...]:
    """What is in contact on the parts of a force, moved by τw."""
    dim, turns = domain.mesh.geometry.dim, isinstance(kind, Moment)
    axes = tuple(AXES[:dim])
    along, about = ((), axes if dim == 3 else ("z",)) if turns else (axes, ())
    moves = tau * (np.ones(1) if turns and dim == 2 else np.array(direction_of(kind.direction, dim)))
    motion = along, about, np.zeros(dim), 1.0, np.zeros(len(moves)), moves
    return tuple(Tool(part, *motion) for part in kind.parts if part in problem.boundary.contact)


def _moved_vector(domain: Domain, given: Any, motion: Array, amount: float) -> list[Given]:
    """A vector and a multiple of the motion."""
    entries = components(given, domain.mesh.geometry.dim)
    return [added(domain, each, _affine(row), amount) for each, row in zip(entries, motion, strict=True)]


def _affine(row: Array) -> Given:
    """The number, or the text of the function, with these coefficients of 1, x, y and z."""
    if not row[1:].any():
        return float(row[0])
    terms = [repr(float(row[0])), *(f"{float(factor)!r}*{x}" for factor, x in zip(row[1:], "xyz", strict=False))]
    return " + ".join(terms)


def unseen_work(resolution: Resolution, together: float, kind: Force, apart: fem.Function, tau: float) -> float:
    """Bound of R(ŵ) + C|ŵ| (collective).

    Args:
        resolution: Has R, after what is missed of loads is known.
        together: C.
        kind: The force.
        apart: The difference of the displacements with data that are moved by ±τw.
        tau: τ.
    """
    spaces, comm, linear = resolution.spaces, resolution.spaces.mesh.comm, resolution.linear
    if not comm.allreduce(float(linear.sum())) > 0:
        return 0.0
    moved = np.concatenate([spaces.domain.facets[part] for part in kind.parts])
    given = np.concatenate([facets.facets for facets, *_ in spaces.fixed])
    held, others = comm.allreduce(np.array([np.isin(given, moved).sum(), (~np.isin(given, moved)).sum()])).tolist()
    if held == 0:
        return 0.0  # ŵ = 0
    if others == 0:
        motion = motion_of(kind, spaces.dim)
        at_vertices = motion[:, 0] + spaces.vertices @ motion[:, 1:].T
        return float(comm.allreduce(linear @ np.linalg.norm(at_vertices, axis=2).max(axis=1, initial=0.0)))
    space, split = apart.function_space, spaces.split
    weight = ufl.TestFunction(fenicsx.function_space(space.mesh, ("DG", 0)))
    strains = ufl.inner(strain(apart), strain(apart)) * weight * ufl.dx
    cells, squares, largest = split.subcells // (spaces.dim + 1), *np.zeros((2, len(linear)))
    np.add.at(squares, cells, fem.assemble_vector(fenicsx.form(strains)).array[: len(cells)])
    coefficients = apart.x.array.reshape(-1, spaces.dim)[space.dofmap.list[: len(cells)]]
    np.maximum.at(largest, cells, np.linalg.norm(coefficients, axis=2).max(axis=1))
    sums = comm.allreduce(np.array([linear @ largest, resolution.stiffest() @ squares]))
    return float(sums[0] + together * np.sqrt(sums[1])) / (2 * tau)
