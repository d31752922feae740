"""Rigid tools under given forces: foundations whose rigid motion is an unknown.

A tool moves along some axes and turns about others; its motion is r = Σ ρ_k r_k. On its part the gap is g + r_n, and
friction is against u_t − r_t. What acts on the tool besides the body, F_k along each r_k, and what the body does to it
are in balance: ∫ σn·r_k = F_k over the part. So the energy of body and tool, ½(ℂε(u), ε(u)) − ⟨…, u⟩ − Σ F_k ρ_k, is
minimal over both.

Discretely û is r + ŵ there, with the conditions on ŵ. r is linear, so its means are exact. Under given conditions each
r_k has a response z_k of the body, and ρ is found from as many equations as there are motions (`Moving.follow`). The
matrix of the body stays as it is.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, LinearSolveFailure
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.expressions.given import number_of, parsed
from signorini_fenicsx.meshes.domain import AXES, other_side
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem


def rigid_motions(x: Array) -> Array:
    """Translations, then rotations about the origin, in points of shape (…, d): shape (…, d, motions)."""
    dim = x.shape[-1]
    motions = [np.broadcast_to(axis, x.shape) for axis in np.eye(dim)]
    if dim == 2:
        motions.append(np.stack([-x[..., 1], x[..., 0]], axis=-1))
    else:
        motions += [np.cross(axis, x) for axis in np.eye(3)]
    return np.stack(motions, axis=-1)


@dataclass(frozen=True)
class Tool:
    """A tool on a part of Γ_C, its motion and what acts on it.

    Attributes:
        part: The part.
        along: The axes along which it moves.
        about: The axes about which it turns, by a length for unit angle that is `size`.
        middle: The point about which it turns, the middle of its part.
        size: The size of the domain, by which angles and moments are scaled.
        load: The forces, and the moments about the middle over the size.
        moved: How far it has moved along each motion.
    """

    part: str
    along: tuple[str, ...]
    about: tuple[str, ...]
    middle: Array
    size: float
    load: Array
    moved: Array

    def motions(self, x: Array) -> Array:
        """The motions in points of shape (…, d): shape (…, d, motions)."""
        return rigid_motions((x - self.middle) / self.size)[..., self._numbers]

    @property
    def _numbers(self) -> list[int]:
        """The numbers of the motions among `rigid_motions`."""
        dim, turns = len(self.middle), AXES if len(self.middle) == 3 else "z"
        return [*map(AXES.index, self.along), *(dim + turns.index(axis) for axis in self.about)]

    def as_of_body(self) -> Array:
        """How it has moved as a body does: along all axes, then about all of them, in space three, in the plane one."""
        moved = np.zeros(rigid_motions(self.middle).shape[1])
        moved[self._numbers] = self.moved
        return moved

    def motion(self) -> dict[str, Any]:
        """The motion of the tool for summaries: lengths along axes, angles about axes through the middle."""
        lengths, angles = np.split(self.moved, [len(self.along)])
        motion: dict[str, Any] = {"displacement": dict(zip(self.along, lengths.tolist(), strict=True))}
        if self.about:
            motion["rotation"] = dict(zip(self.about, (angles / self.size).tolist(), strict=True))
            motion["middle"] = self.middle.tolist()
        return motion


def tools_of(spaces: ElasticSpaces, problem: ElasticProblem) -> tuple[Tool, ...]:
    """The tools of a problem (collective).

    Raises:
        InputError: If a part is not in contact with a foundation, an axis is unknown, or a force is no number.
    """
    return tuple(_tool(spaces, problem, part) for part in dict.fromkeys([*problem.force, *problem.moment]))


def _tool(spaces: ElasticSpaces, problem: ElasticProblem, part: str) -> Tool:
    dim = spaces.dim
    forces, moments = (dict(given.get(part, {})) for given in (problem.force, problem.moment))
    if part not in spaces.boundary.contact or other_side(part) in spaces.domain.parts:
        raise InputError(f"[[law]] force: part '{part}' is not in contact with a foundation, which could be a tool")
    allowed = {"force": AXES[:dim], "moment": AXES if dim == 3 else "z"}
    load = []
    for key, given in (("force", forces), ("moment", moments)):
        for axis, value in given.items():
            name = f"[[law]] {key} on part '{part}', {axis}"
            if len(axis) != 1 or axis not in allowed[key]:
                raise InputError(f"{name}: unknown axis; there are {', '.join(allowed[key])}")
            load.append(number_of(name, parsed(value, AXES[:dim], name)))
    facets = spaces.part(part)
    center = facets.measure @ facets.vertices.mean(axis=1)
    *center, measure = spaces.mesh.comm.allreduce(np.append(center, facets.measure.sum()))
    size = float(np.ptp(spaces.domain.box()[:, :dim], axis=0).max())
    scale = np.repeat([1.0, 1 / size], [len(forces), len(moments)])
    middle = np.array(center) / measure
    return Tool(part, tuple(forces), tuple(moments), middle, size, scale * np.array(load), np.zeros(len(load)))


def moves_along(spaces: ElasticSpaces, tools: Sequence[Tool], directions: Array) -> Array:
    """The motions of the tools along directions at the vertices of the facets of Γ_C, shape (facets, d, motions).

    Args:
        spaces: The spaces.
        tools: The tools.
        directions: One for each vertex, shape (facets, d, d).
    """
    columns = [np.zeros((*directions.shape[:2], 0))]
    for tool in tools:
        rows, along = spaces.rows_on(tool.part), np.zeros((*directions.shape[:2], len(tool.load)))
        along[rows] = np.einsum("nai,nair->nar", directions[rows], tool.motions(spaces.contact.vertices[rows]))
        columns.append(along)
    return np.concatenate(columns, axis=2)


def normal_and_tangential(spaces: ElasticSpaces, moves: Callable[[Array], Array]) -> tuple[Array, Array]:
    """The components of motions at the vertices of Γ_C and, with friction, their tangential ones.

    Shapes (facets, d, motions) and (facets with friction, d, d − 1, motions).

    Args:
        spaces: The spaces.
        moves: Gives the motions along directions at the vertices of Γ_C, of shape (facets, d, d).
    """
    dim, rough, normals = spaces.dim, spaces.rough_rows, spaces.contact.normals
    normal = moves(np.repeat(normals[:, None], dim, axis=1))
    along = np.empty((len(rough), dim, dim - 1, normal.shape[2]))
    for k in range(dim - 1):
        tangents = np.zeros_like(normals)
        tangents[rough] = spaces.tangents[:, k]
        along[:, :, k] = moves(np.repeat(tangents[:, None], dim, axis=1))[rough]
    return normal, along


def means_at_sites(normal: Array, along: Array) -> Array:
    """The means of motions weighted by the hats, of what `normal_and_tangential` gives, shape (sites, motions)."""
    size = normal.shape[1] + 1
    means = ((each + each.sum(axis=1, keepdims=True)) / size for each in (normal, along))
    return np.concatenate([each.reshape(math.prod(each.shape[:-1]), each.shape[-1]) for each in means])


def loads_of(tools: Sequence[Tool]) -> Array:
    """The loads on all tools, one motion after another."""
    return np.concatenate([np.empty(0), *(tool.load for tool in tools)])


def moves_at_sites(spaces: ElasticSpaces, tools: Sequence[Tool]) -> Array:
    """What û is at the sites for each motion of the tools, in means, shape (sites, motions)."""
    return means_at_sites(*normal_and_tangential(spaces, partial(moves_along, spaces, tools)))


def tools_at(tools: Sequence[Tool], moves: Array, *, anew: bool = False) -> tuple[Tool, ...]:
    """The tools after a further motion, or with this motion alone."""
    ends = np.cumsum([len(tool.load) for tool in tools])[:-1]
    parts = zip(tools, np.split(moves, ends), strict=True) if tools else ()
    return tuple(replace(tool, moved=motion if anew else tool.moved + motion) for tool, motion in parts)


def unbalanced(spaces: ElasticSpaces, tools: Sequence[Tool], tractions: Array) -> list[tuple[Tool, Array]]:
    """What is left of the forces on each tool by the tractions at the vertices of Γ_C (collective)."""
    left = []
    for tool in tools:
        rows = spaces.rows_on(tool.part)
        facets = spaces.contact.take(rows)
        done = np.einsum("nai,nair->r", facets.of_linear(tractions[rows]), tool.motions(facets.vertices))
        left.append((tool, tool.load - spaces.mesh.comm.allreduce(done)))
    return left


class Moving:
    """The motions of the tools in the solves of a backend.

    Attributes:
        moves: What û is at the sites of this rank for each motion, shape (sites, motions).
        rho: How far they have moved in the last solve.
    """

    def __init__(self, spaces: ElasticSpaces, tools: Sequence[Tool]):
        """Begin at rest."""
        self._comm, self._load = spaces.mesh.comm, loads_of(tools)
        self.moves, self.rho = moves_at_sites(spaces, tools), np.zeros(len(self._load))
        self._responses: Array | None = None
        self._stiffness, self._moved = np.empty((0, 0)), np.zeros(1)

    def __bool__(self) -> bool:
        """Whether there is a motion."""
        return len(self.rho) > 0

    @property
    def at_sites(self) -> Array:
        """The part of û at the sites that comes from the motion of the tools."""
        return np.asarray(self.moves @ self.rho)

    def respond(
        self, response: Callable[[Array, Array | None], PETSc.Vec], pulls: Callable[[PETSc.Vec], Array]
    ) -> None:
        """Find the responses of the body under new conditions (collective).

        Args:
            response: Gives x where û follows some values at the sites under the present conditions, and gets the last
                x for these values.
            pulls: The forces at the sites that belong to x, Kx.
        """
        before = [None] * len(self.rho) if self._responses is None else self._responses.T
        columns = [response(*each) for each in zip(self.moves.T, before, strict=True)]
        self._responses = np.stack([np.array(column.array_r) for column in columns], axis=1)
        forces = np.stack([pulls(column) for column in columns], axis=1)
        self._stiffness = self._comm.allreduce(self.moves.T @ forces)

    def forget(self) -> Array:
        """The part of x by the motion in the last solve, which is taken away from it."""
        moved, self._moved = self._moved, np.zeros(1)
        return moved

    def take(self, forces: Array) -> Array:
        """Take the motion under the given forces, see `follow`; the part of x by it (collective)."""
        self.rho, self._moved = self.follow(forces, loaded=True)
        return self._moved

    def follow(self, forces: Array, *, loaded: bool) -> tuple[Array, Array]:
        """The step of the tools, and that of x with them (collective).

        Args:
            forces: What holds the sites where the tools are at rest.
            loaded: Whether the forces on the tools are the given ones; otherwise they are 0.

        Raises:
            LinearSolveFailure: If nothing holds a tool.
        """
        left = self._load * loaded - self._comm.allreduce(self.moves.T @ forces)
        try:
            rho: Array = on_root(self._comm, lambda: np.linalg.solve(self._stiffness, left))
        except np.linalg.LinAlgError as error:
            raise LinearSolveFailure("nothing holds a tool") from error
        assert self._responses is not None
        return rho, self._responses @ rho
