"""Nodes of continuous functions on facets: those of each facet, values on which all ranks agree, jumps in the domain.

On facets inside the domain, where the mesh is cut, a function v has two nodes in one place: one of the named side and
one of the other. With the jump of v in the node of the named side, and all else as it is, a condition on the jump is
one on a node. At the edge of the cut both sides share a node, and there is no jump. On slaves of pairs the jump is that
to the function that interpolates what is opposite, see `certificate.opposite`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import owned_values, set_owned, sums_at
from signorini_fenicsx.certificate.opposite import Opposite
from signorini_fenicsx.discrete.bernstein import degree_of, nodes, nodes_of
from signorini_fenicsx.discrete.cell_shapes import nearest
from signorini_fenicsx.discrete.continuity import facet_nodes
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.facet_coefficients import FacetCoefficients, in_order
from signorini_fenicsx.discrete.linear_traces import LinearTraces
from signorini_fenicsx.discrete.matrices import identity_with
from signorini_fenicsx.discrete.mesh_spaces import extreme_around
from signorini_fenicsx.discrete.pairing import MeshPair
from signorini_fenicsx.discrete.points import (
    Entities,
    facet_type,
    from_inside,
    in_facets,
)
from signorini_fenicsx.linear.constrained_matrix import image_of
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


def largest_around(space: fem.FunctionSpace, nodes: Entities, values: Array) -> Array:
    """For values ≥ 0 per facet, the largest value of the facets around each node, or 0 without facets (collective)."""
    of_nodes = np.broadcast_to(values[:, None], nodes.shape)
    return np.maximum(extreme_around(space, nodes, of_nodes, largest=True), 0.0)


def set_means(function: fem.Function, nodes: Entities, values: Array) -> None:
    """Set the nodes of some facets to the means of what the facets say (collective)."""
    index_map = function.function_space.dofmap.index_map
    total, count = sums_at(index_map, nodes, values), sums_at(index_map, nodes)
    has_place = count > 0
    function.x.array[has_place] = total[has_place] / count[has_place]


def quadratic_on_sides(datum: Datum, space: fem.FunctionSpace, spaces: Spaces) -> fem.Function:
    """A datum by its values in the nodes of a space; on a cut in the domain by those of each side (collective)."""
    dim, inner = spaces.mesh.topology.dim, spaces.inner
    function = datum.at_nodes(space, nodes_of(space))
    if inner.present and datum.number is None:
        facets = np.concatenate([spaces.facets[inner.rows], inner.facets])
        points = in_facets(spaces.mesh, facets, nodes(facet_type(dim), degree_of(space)))
        set_means(function, facet_nodes(space, facets), from_inside(datum.values, points))
    return function


@dataclass(frozen=True)
class Jumps:
    """The change of unknowns of a continuous function to jumps at facets inside the domain and on slaves of pairs.

    Attributes:
        jump: Mask of the nodes of this rank that have the jump; no other part inside the domain has these nodes.
        tips: Nodes of this rank at the edge of the cut.
        meets: Nodes of this rank in places where inner parts meet each other or other parts of Γ_S, or Γ_D on one side
            only, and those of slaves on Γ_D alone, or of masters. They keep the values of the function.
        pairs: Nodes of the inner facets, and those in the same places of the other side, shape (facets, nodes) each.
        tied: Nodes of slaves that are tied, where the jump is to be 0.
        follows: Mask of all nodes of slaves that have the jump.
        basis: The matrix from the jumps, and the values in all other nodes, to the values in all nodes, and its
            inverse; None without jumps. At pairs it is for coefficients.
        of_values: The same for values in the nodes.
    """

    jump: Mask
    tips: npt.NDArray[np.intp]
    meets: npt.NDArray[np.intp]
    pairs: tuple[Entities, Entities]
    tied: npt.NDArray[np.intp]
    follows: Mask
    basis: tuple[PETSc.Mat, PETSc.Mat] | None = None
    of_values: tuple[PETSc.Mat, PETSc.Mat] | None = None

    @classmethod
    def of(cls, space: fem.FunctionSpace, spaces: Spaces, holding: Indices | None = None) -> Jumps:
        """The jumps of a space of linear functions, or those of a higher degree (collective).

        `holding` are the rows of Γ_S on the boundary of the domain with laws that may hold u.
        """
        if not spaces.several:
            return cls.nowhere(space)
        numbers, inner = space.dofmap.index_map, spaces.inner
        pairs = named, across = _in_pairs(space, spaces.facets[inner.rows], inner.facets)
        tip = named == across
        named, across, tips = (nodes.ravel()[:, None] for nodes in (named[~tip], across[~tip], named[tip]))
        other = largest_around(space, named, 1.0 + numbers.local_to_global(across.ravel()))
        below, at_edge, beside = (
            largest_around(space, nodes, np.ones(len(nodes))) > 0
            for nodes in (across, tips, facet_nodes(space, spaces.facets[spaces.outer_rows]))
        )
        wall = np.zeros(len(other), dtype=bool)
        wall[fem.locate_dofs_topological(space, space.mesh.topology.dim - 1, spaces.dirichlet_facets)] = True
        held = _somewhere(space, facet_nodes(space, spaces.facets[[] if holding is None else holding]).ravel())
        meets = (other > 0) & below | beside & (below | at_edge | (other > 0))
        half = wall[named] != wall[across]
        meets[named[half]] = meets[across[half]] = True
        meets = _over_places(space, pairs, meets.astype(np.float64)) > 0
        jump = (other > 0) & ~meets
        owned = np.flatnonzero(jump[: numbers.size_local])
        copied = numbers.local_range[0] + owned, other[owned].astype(np.int64) - 1, np.ones(len(owned))
        of_pairs = _Following.of(space, spaces, wall, held, (other > 0) | below | at_edge)
        bases = [
            (_identity_with(space, copied, entries), _identity_with(space, copied, entries, sign=-1.0))
            for entries in (of_pairs.of_coefficients, of_pairs.of_values)
        ]
        meets |= of_pairs.kept
        jump |= of_pairs.jump
        tied = np.flatnonzero(of_pairs.tied)
        return cls(jump, np.flatnonzero(at_edge & ~meets), np.flatnonzero(meets), pairs, tied, of_pairs.jump, *bases)

    @classmethod
    def nowhere(cls, space: fem.FunctionSpace) -> Jumps:
        """The change of unknowns on a mesh that is not cut, which is none."""
        numbers, none, pairs = space.dofmap.index_map, np.empty(0, dtype=np.intp), np.empty((0, 1), dtype=np.int32)
        nowhere = np.zeros(numbers.size_local + numbers.num_ghosts, dtype=bool)
        return cls(nowhere, none, none, (pairs, pairs), none, nowhere)

    def join(self, v: fem.Function, at: Mask, given: Entities) -> None:
        """Let v be continuous in the places of some nodes, in place: of `given` values, else the largest (collective).

        Args:
            v: A function by the values in its nodes, ghosts updated.
            at: Mask of nodes of this rank.
            given: Nodes of this rank that keep their values.
        """
        space, is_known, value = v.function_space, np.zeros(len(at)), v.x.array.copy()
        is_known[given] = 1.0
        somewhere = _over_places(space, self.pairs, is_known) > 0
        value[somewhere & (is_known == 0)] = -np.inf
        is_joined = _over_places(space, self.pairs, at.astype(np.float64)) > 0
        v.x.array[is_joined] = _over_places(space, self.pairs, value)[is_joined]

    def taken(self, v: fem.Function, *, of_values: bool = False) -> None:
        """Put the jumps of a function in the place of its coefficients, or values, ghosts updated (collective)."""
        if (basis := self.of_values if of_values else self.basis) is not None:
            _apply(basis[1], v)
            v.x.array[self.tied] = 0.0

    def undone(self, v: fem.Function, *, of_values: bool = False) -> None:
        """Put the coefficients of a function, or values, in the place of its jumps, ghosts updated (collective)."""
        if (basis := self.of_values if of_values else self.basis) is not None:
            _apply(basis[0], v)

    def transposed(self, values: Array) -> Array:
        """The transpose of `basis` times values of the owned nodes (collective)."""
        if self.basis is None:
            return values
        return image_of(self.basis[0], values, transposed=True)


type _Entries = tuple[Indices, Indices, Array]
"""Rows and columns over all ranks, and values."""


def _identity_with(space: fem.FunctionSpace, copied: _Entries, others: _Entries, sign: float = 1.0) -> PETSc.Mat:
    rows, columns, values = (np.append(*each) for each in zip(copied, others, strict=True))
    return identity_with(space.mesh.comm, space.dofmap.index_map.size_local, rows, columns, sign * values)


@dataclass(frozen=True)
class _Following:
    """Nodes of slaves whose unknown is the jump to what is opposite.

    Attributes:
        jump: Mask of these nodes of this rank.
        tied: Mask of those where it is to be 0.
        kept: Mask of nodes of slaves that keep their values.
        of_coefficients: The entries of P, see `hybrid_system.Sides`.
        of_values: Those for values in the nodes.
    """

    jump: Mask
    tied: Mask
    kept: Mask
    of_coefficients: _Entries
    of_values: _Entries

    @classmethod
    def of(cls, space: fem.FunctionSpace, spaces: Spaces, wall: Mask, held: Mask, others: Mask) -> _Following:
        """The nodes of slaves, given those on Γ_D, of laws that may hold u, and of facets in the domain (collective).

        A node of several slaves follows what is opposite to the first of these, a tied one before all others. Where v
        is given on the slave alone, a law may hold it and it is not tied, or the node is one of a master, it keeps its
        value.
        """
        jump, tied, kept = (np.zeros(len(wall), dtype=bool) for _ in range(3))
        none = np.empty(0, dtype=np.int64)
        entries = [(none, none, np.empty(0))], [(none, none, np.empty(0))]
        pairs = sorted(opposites(space, spaces), key=lambda of: not of[0].parts.tied)
        for _, sides in pairs:
            others = others | _somewhere(space, sides.masters.nodes.ravel())
        for pair, sides in pairs:
            nodes, weights = sides.conditions()
            named, rank = nodes[:, 0], float(space.mesh.comm.rank)
            free = wall[named] & ((weights[:, 1:] != 0) & ~wall[nodes[:, 1:]]).any(axis=1)
            first = extreme_around(space, named, np.full(len(named), rank), largest=False)[named] == rank
            left_out = others[named] | free | (held[named] & (not pair.parts.tied))
            chosen = first & ~left_out & ~jump[named]
            for found, of_values in zip(entries, (False, True), strict=True):
                found.append(_entries(space, *(each[chosen] for each in sides.conditions(of_values=of_values))))
            kept |= _somewhere(space, named[left_out])
            following = _somewhere(space, named[chosen])
            tied |= following & pair.parts.tied
            jump |= following
        both = ([np.concatenate(each) for each in zip(*found, strict=True)] for found in entries)
        return cls(jump, tied, kept & ~jump, *((rows, columns, values) for rows, columns, values in both))


def _entries(space: fem.FunctionSpace, nodes: Indices, weights: Array) -> _Entries:
    """The entries of P for conditions, see `Opposite.conditions`."""
    used = weights[:, 1:] != 0
    first, columns = np.broadcast_to(nodes[:, :1], used.shape)[used], nodes[:, 1:][used]
    rows, columns = (space.dofmap.index_map.local_to_global(each.astype(np.int32)) for each in (first, columns))
    return rows.astype(np.int64), columns.astype(np.int64), -weights[:, 1:][used]


def opposites(space: fem.FunctionSpace, spaces: Spaces) -> list[tuple[MeshPair, Opposite]]:
    """The pairs of surfaces by the nodes of a space; none for RT0, which has none."""
    if not isinstance(spaces, LinearTraces):
        return []

    def nodes_on(facets: Entities) -> FacetCoefficients:
        on, degree = spaces.boundary_facets(facets), degree_of(space)
        of_facets = np.take_along_axis(facet_nodes(space, facets), in_order(on.ranking, degree), axis=1)
        return FacetCoefficients(on, np.arange(len(facets)), on.cells.astype(np.int64), of_facets, degree)

    return [(pair, Opposite.of(pair, spaces, nodes_on(pair.slaves), nodes_on(pair.masters))) for pair in spaces.pairs]


def _somewhere(space: fem.FunctionSpace, nodes: Entities) -> Mask:
    """Mask of the nodes of this rank that are among these on some rank (collective)."""
    return np.asarray(largest_around(space, nodes[:, None], np.ones(len(nodes))) > 0)


def _apply(matrix: PETSc.Mat, v: fem.Function) -> None:
    set_owned(v, image_of(matrix, owned_values(v)))


def _over_places(space: fem.FunctionSpace, pairs: tuple[Entities, Entities], values: Array) -> Array:
    """In each node the largest value of the nodes in its place, which pairs connect (collective)."""
    nodes = np.vstack(pairs)
    while True:
        larger = np.maximum(*(values[side] for side in pairs))
        larger_values = np.maximum(values, extreme_around(space, nodes, np.vstack([larger, larger]), largest=True))
        if not space.mesh.comm.allreduce(bool((larger_values > values).any()), MPI.LOR):
            return larger_values
        values = larger_values


def _in_pairs(space: fem.FunctionSpace, named: Entities, across: Entities) -> tuple[Entities, Entities]:
    """The nodes of facets, and for each the node in the same place of the facet that lies on it."""
    at = nodes(facet_type(space.mesh.topology.dim), degree_of(space))
    places = [in_facets(space.mesh, facets, at).x for facets in (named, across)]
    of_named, of_across = (facet_nodes(space, facets) for facets in (named, across))
    return of_named, np.take_along_axis(of_across, nearest(*places), axis=1)
