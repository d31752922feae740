"""Elastic problems some parts of whose boundary are moved rigidly: what belongs to forces and moments.

A force F = ⟨σn, w⟩ with a rigid motion w moves what holds the body on its parts: u_D by τw, a foundation, or the jump
of two bodies, by τw·n in the gap and, with friction, by τw_t in the slip. If a part cannot be moved, such as a curved
foundation, along which w·n is no polynomial, all others are moved by −τw: both are the same but for a rigid motion of
everything.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import dolfinx.mesh
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.points import in_facets
from signorini_fenicsx.expressions.given import Given
from signorini_fenicsx.meshes.domain import Domain, other_side
from signorini_fenicsx.meshes.seams import unit_normals
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces
from signorini_fenicsx.quantities.kinds import Force, Moment
from signorini_fenicsx.quantities.shifts import added

type Posed = tuple[ElasticBoundary, ElasticProblem]
"""A problem with the parts of each kind of its boundary."""
FLAT = 1e-10
"""Distance between unit normals that are equal but for rounding."""


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
    return [given[i] for i in range(dim)]


def moved_parts(domain: Domain, posed: Posed, kind: Force) -> tuple[list[str], float]:
    """The parts that are moved, with 1 if they are those of the force, and −1 if they are all others (collective).

    Raises:
        InputError: If a part is unknown, a traction is given on it, or neither can be moved.
    """
    boundary, problem = posed
    contact = boundary.touching_on(problem.touching).contact
    across = {other_side(part): part for part in boundary.inner}
    for part in kind.parts:
        if part not in domain.facets:
            raise InputError(f"unknown part '{part}'; there are {', '.join(domain.facets)}")
        if part in boundary.neumann and part not in contact:
            raise InputError(f"the traction on the part '{part}' is given")
        if part in across:
            raise InputError(f"the part '{part}' has no law; take '{across[part]}', on which the force is opposite")

    def can_move(part: str) -> bool:
        return part not in contact or _normal(domain, part) is not None

    stuck = [part for part in kind.parts if not can_move(part)]
    if not stuck:
        return list(kind.parts), 1.0
    held = [part for part in domain.parts if part in contact or part not in boundary.neumann]
    rest = [part for part in held if part not in (*kind.parts, *boundary.inner, *across)]
    if set(kind.parts) & set(boundary.inner) or not all(can_move(part) for part in rest):
        raise InputError(
            f"the force on the part '{stuck[0]}' has no bounds: this foundation is not flat, and so is another one"
        )
    return rest, -1.0


def moved(domain: Domain, posed: Posed, kind: Force, tau: float) -> Posed:
    """The problem whose supports and foundations on the parts of a force are moved by τw, or all others by −τw.

    Raises:
        InputError: As `moved_parts` (collective).
    """
    boundary, problem = posed
    parts, sign = moved_parts(domain, posed, kind)
    motion = motion_of(kind, domain.mesh.geometry.dim)
    contact = boundary.touching_on(problem.touching).contact
    given = dict(problem.u_D) if isinstance(problem.u_D, Mapping) else {"": problem.u_D}
    u_D, gaps = dict(given), _gaps(problem, contact)
    for part in parts:
        if part in contact:
            n = _normal(domain, part)
            assert n is not None
            gaps[part] = added(domain, gaps[part], _affine(n @ motion), sign * tau)
        else:
            u_D[part] = _moved_vector(domain, given.get(part, given.get("")), motion, sign * tau)
    if sign < 0:
        u_D |= {part: given.get(part, given.get("")) for part in kind.parts if part not in contact}
        u_D[""] = _moved_vector(domain, given.get(""), motion, sign * tau)
    return boundary, replace(problem, u_D=u_D, gap=gaps if set(parts) & set(contact) else problem.gap)


def moved_slip(spaces: ElasticSpaces, posed: Posed, kind: Force, tau: float) -> Array:
    """By how much the slip at the sites with friction moves, in means weighted by hats (collective)."""
    parts, sign = moved_parts(spaces.domain, posed, kind)
    numbers = [spaces.part_names.index(part) for part in parts if part in spaces.part_names]
    on_parts = np.isin(spaces.part_of_facet[spaces.rough_rows], numbers)
    motion, x = motion_of(kind, spaces.dim), spaces.rough.vertices
    along = np.einsum("nvi,nki->nvk", motion[:, 0] + x @ motion[:, 1:].T, spaces.tangents)
    means = (along + along.sum(axis=1, keepdims=True)) / (spaces.dim + 1)
    return np.where(on_parts[:, None, None], sign * tau * means, 0.0).ravel()


def _gaps(problem: ElasticProblem, contact: Sequence[str]) -> dict[str, Given]:
    """The gap of each part of Γ_C."""
    gap = problem.gap
    return {part: gap.get(part, gap.get("", 0.0)) if isinstance(gap, Mapping) else gap for part in contact}


def _moved_vector(domain: Domain, given: Any, motion: Array, amount: float) -> list[Given]:
    """A vector and a multiple of the motion."""
    own = components(given, domain.mesh.geometry.dim)
    return [added(domain, each, _affine(row), amount) for each, row in zip(own, motion, strict=True)]


def _affine(row: Array) -> Given:
    """The number, or the text of the function, with these coefficients of 1, x, y and z."""
    if not row[1:].any():
        return float(row[0])
    terms = [repr(float(row[0])), *(f"{float(factor)!r}*{x}" for factor, x in zip(row[1:], "xyz", strict=False))]
    return " + ".join(terms)


def _normal(domain: Domain, part: str) -> Array | None:
    """The outer normal of a part; None if it is not the same everywhere (collective)."""
    mesh, dim = domain.mesh, domain.mesh.geometry.dim
    facets = domain.facets[part]
    corners = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, dim - 1, facets)][..., :dim].reshape(-1, dim, dim)
    normals = unit_normals(corners[:, 1:] - corners[:, :1])
    cells = in_facets(mesh, facets, np.full((1, dim - 1), 1 / dim)).cells
    inside = mesh.geometry.x[mesh.geometry.dofmaps[0][cells], :dim].mean(axis=1)
    normals *= -np.sign(np.einsum("ni,ni->n", inside - corners[:, 0], normals))[:, None]
    mean = mesh.comm.allreduce(normals.sum(axis=0))
    mean = mean / np.linalg.norm(mean) if mean.any() else mean
    apart = mesh.comm.allgather(float(np.abs(normals - mean).max(initial=0.0)))
    return mean if max(apart) <= FLAT else None
