"""Rigid motions that nothing prevents: then an elastic contact problem has no solution, or many."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tolerances import ROUNDING
from signorini_fenicsx.discrete.linear_traces import linear_from_means, means_of_linear
from signorini_fenicsx.discrete.pairing import MeshPair
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.discrete.supports import Supports
from signorini_fenicsx.physics.elasticity.discrete.tools import (
    Tool,
    loads_of,
    means_at_sites,
    moves_along,
    normal_and_tangential,
    rigid_motions,
    tools_at,
)
from signorini_fenicsx.physics.elasticity.solve.motion_limits import FREE, SLACK, Limits

HELD = 1e-12
"""Sites hold a motion of size 1 if the squares of its means add up to more."""
TURNS = 1e-6
"""A motion that turns the body by less than this share of what it shifts it is told as a shift, and less of it as 0."""


@dataclass(frozen=True)
class Unprevented:
    """A rigid motion that nothing prevents.

    Attributes:
        words: The motion in words.
        loads: What the loads do on it, if it is a unit translation or the rotation by a unit angle.
        holds: What friction and laws take of it at most.
        on_mesh: Whether it is prevented on finer meshes, as far as values at vertices tell.
        balanced: Whether the loads do nothing on it.
    """

    words: str
    loads: float
    holds: float
    on_mesh: bool
    balanced: bool

    def why(self) -> str:
        """What is missing, in words."""
        finer = " on this mesh; a finer one may" if self.on_mesh else ""
        works = f"; the loads do the work {self.loads:.4g} on it, and friction and laws take at most {self.holds:.4g}"
        return f"{self.words}: {HELD_BY}{finer}{works if self.holds > 0 else ''}{WEAK if self.balanced else ''}"


def check_rigid_motions(spaces: ElasticSpaces, data: ElasticData) -> Array:
    """Make sure that each rigid motion is prevented, by what is given of u or by contact under the loads (collective).

    Each body has motions of its own, and each tool under a given force. For a motion r that what is given of u lets
    free, and that does not go into the foundation, r_n ≤ 0 on Γ_C, the work of the loads must be negative, with
    friction less than ∫ g|r_t|: then contact holds the bodies against it. Where two bodies touch, r is the jump of both
    motions. Coulomb's g is not known, and counts as ∞ before the first solve; if it is too small, see `slides`.

    It is the means of r_n and r_t at the sites that count, as in the discrete problem, which has a solution exactly
    then. More motions have r_n ≤ 0 in means, and ∫ g|r_t| is more than its sum of means: where the resultant of the
    loads is within a facet of the edge of contact, or a moment is near the limit, the exact problem may have a solution
    and the discrete one none.

    Returns:
        The motions that contact has to prevent, a basis: means of r_n at the sites, and of r_t at those with friction,
        shape (sites, motions).

    Raises:
        InputError: If a motion is not prevented; it is told.
    """
    means, motion = _motions_of_contact(spaces, data)
    if motion is not None:
        raise InputError(f"the body can move rigidly, {motion.why()}")
    _, motion = _motions_of_contact(spaces, data, any_pressure=True)
    if motion is not None:
        raise InputError(
            f"the body slides away, {motion.words}: on this motion the loads do the work {motion.loads:.4g}, and no "
            "pressure with friction of at most μ times it balances them; with less load, or more friction, it rests"
        )
    return means


def slides(spaces: ElasticSpaces, data: ElasticData) -> str:
    """The motion that the bounds of the friction do not prevent, and by how much, in words; or empty (collective)."""
    _, motion = _motions_of_contact(spaces, data)
    if motion is None:
        return ""
    return (
        f"the body slides away, {motion.words}: on this motion the loads do the work {motion.loads:.4g}, and friction "
        f"under the last pressure takes at most {motion.holds:.4g}; with less load, or more friction, it rests"
    )


def _motions_of_contact(
    spaces: ElasticSpaces, data: ElasticData, *, any_pressure: bool = False
) -> tuple[Array, Unprevented | None]:
    """What `check_rigid_motions` returns, and a motion that is not prevented, see `Limits.unprevented` (collective)."""
    bodies = RigidBodies.of(spaces, data.tools)
    free = bodies.not_given(data.supports)
    if free.shape[1] == 0:
        return np.zeros((len(spaces.site_kinds), 0)), None
    work, most = bodies.work(data)
    work = work @ free / most
    moves = normal_and_tangential(spaces, lambda directions: bodies.relative(directions) @ free)
    means = means_at_sites(*moves)
    limits = _limits(spaces, data, work, means, most, data.friction.given if any_pressure else data.friction.bound)
    motion = limits.sliding() if any_pressure else limits.unprevented()
    if motion is None:
        return means, None
    motion = motion if any_pressure else limits.plainer(motion, bodies.plain(free))
    at_vertices = np.concatenate([each.reshape(-1, free.shape[1]) for each in moves])
    on_mesh = _limits(spaces, data, work, at_vertices, most, data.friction.bound).unprevented() is None
    words, unit = bodies.in_words(free @ motion)
    loads = float(work @ motion)
    holds = loads - float(limits.work @ motion) + limits.rubbed(motion)
    balanced = abs(loads) <= SLACK and holds <= 0
    return means, Unprevented(words, loads * most / unit, holds * most / unit, on_mesh, balanced)


def _limits(spaces: ElasticSpaces, data: ElasticData, work: Array, moves: Array, most: float, bound: Array) -> Limits:
    """The limits of motions that have these values at the sites, shape (sites, motions), under bounds (collective).

    A law whose pressure is between two numbers is overcome by more; it does not keep a motion from going on. What it
    takes is ∫ λ r_n with the largest pressure λ where the motion closes and with the least one where it opens: as
    friction, their mean with r_n and half their difference with |r_n|.
    """
    normal, slip = spaces.site_kinds
    into, slips = normal.of(moves), slip.of(moves).reshape(-1, spaces.dim - 1, moves.shape[1])
    shears = ((spaces.rough.measure / spaces.dim)[:, None] * bound / most).ravel()
    low, high = (end + data.laws.flux_h for end in data.laws.chains.extent()[2:])
    shuts, opens = np.isfinite(high), np.isfinite(low)
    constant = np.where(shuts & opens, np.where(shuts, high, 0.0) + np.where(opens, low, 0.0), 0.0) / 2
    constant = np.where(shuts & ~opens, high, np.where(opens & ~shuts, low, constant)) * normal.measure / most
    between = shuts & opens
    half = np.where(between, high - low, 0.0)[between] / 2 * normal.measure[between] / most
    work = work - spaces.mesh.comm.allreduce(np.where(shuts | opens, constant, 0.0) @ into)
    rows = np.concatenate([into[~shuts], -into[~opens]])
    rubbing = np.zeros((np.count_nonzero(between), spaces.dim - 1, into.shape[1]))
    rubbing[:, 0] = into[between]
    pressing = np.repeat(data.friction.coulomb, spaces.dim)
    onto = into[slip.pressing].reshape(-1, 1, into.shape[1])[pressing]
    cones = np.concatenate([onto, data.friction.mu.ravel()[pressing][:, None, None] * slips[pressing]], axis=1)
    slips, shears = np.concatenate([slips[: len(shears)], rubbing]), np.append(shears, half)
    return Limits(spaces.mesh.comm, work, rows, slips, shears, cones)


WEAK = (
    "; the loads do not push it, so weak springs on a part (support) hold it and hardly change anything else: per area "
    "far below E/L with the size L of the body"
)
HELD_BY = "neither the parts where u is given nor springs nor contact under these loads prevent that"


def is_free(comm: MPI.Comm, means: Array) -> bool:
    """Whether a combination of motions has no means at the sites that hold, shape (sites, motions) (collective)."""
    sizes = np.linalg.eigvalsh(comm.allreduce(means.T @ means)) if means.shape[1] > 0 else np.ones(1)
    return bool(sizes[0] <= max(HELD, ROUNDING * sizes[-1]))


@dataclass(frozen=True)
class RigidBodies:
    """The rigid motions of all bodies: for each body the translations, then the rotations about the middle.

    Attributes:
        spaces: The spaces.
        of_cell: Number of its body for each owned cell.
        number: Number of bodies.
        middle: The middle of the domain.
        size: Its size, by which rotations are scaled.
        tools: Tools that move freely; their motions come after those of the bodies.
    """

    spaces: ElasticSpaces
    of_cell: Indices
    number: int
    middle: Array
    size: float
    tools: Sequence[Tool]

    @classmethod
    def of(cls, spaces: ElasticSpaces, tools: Sequence[Tool]) -> Self:
        """The bodies of a mesh (collective)."""
        of_cell, comm = spaces.bodies, spaces.mesh.comm
        low, high = spaces.domain.box()[:, : spaces.dim]
        number = comm.allreduce(int(of_cell.max(initial=-1)), MPI.MAX) + 1
        return cls(spaces, of_cell, number, (low + high) / 2, float((high - low).max()), tools)

    def _moved(self, x: Array) -> Array:
        """The basis of the motions of one body in points of shape (…, d): shape (…, d, motions)."""
        return rigid_motions((x - self.middle) / self.size)

    def _summed(self, of: Indices, rows: Array) -> Array:
        """The sums of rows over each body, shape (bodies, …) (collective)."""
        sums = np.zeros((self.number, *rows.shape[1:]))
        np.add.at(sums, of, rows)
        return np.asarray(self.spaces.mesh.comm.allreduce(sums))

    def not_given(self, supports: Supports) -> Array:
        """A basis of the motions that are 0 where u is given or springs hold it (collective).

        Its shape is (motions of all bodies, free ones).
        """
        spaces, dim = self.spaces, self.spaces.dim
        size = dim * (dim + 1) // 2
        grams, totals = np.zeros((self.number, size, size)), np.zeros(self.number)
        for facets, _, axes, _ in spaces.fixed:
            motions, of = self._moved(facets.vertices), self.of_cell[facets.cells]
            along = np.einsum("ni,nair->nar", axes, motions)
            grams += self._summed(of, np.einsum("nar,nas,n->nrs", along, along, facets.measure))
            totals += self._summed(of, facets.measure)
        facets = supports.facets
        motions, of = self._moved(facets.vertices), self.of_cell[facets.cells]
        held = np.einsum("nij,nair,najs,n->nrs", supports.share, motions, motions, facets.measure)
        grams += self._summed(of, held)
        totals += self._summed(of, facets.measure)
        free = []
        for body, (gram, total) in enumerate(zip(grams, totals, strict=True)):
            sizes, vectors = np.linalg.eigh(gram)
            kept = vectors[:, sizes <= FREE**2 * max(float(total), 1e-300)]
            free.append(np.zeros((self.number, size, kept.shape[1])))
            free[-1][body] = kept
        of_bodies = self._tied_together(np.concatenate(free, axis=2).reshape(self.number * size, -1))
        tools = len(loads_of(self.tools))
        rows = np.zeros((len(of_bodies) + tools, of_bodies.shape[1] + tools))
        rows[: len(of_bodies), : of_bodies.shape[1]] = of_bodies
        rows[len(of_bodies) :, of_bodies.shape[1] :] = np.eye(tools)
        return rows

    def _tied_together(self, free: Array) -> Array:
        """The combinations of free motions under which no two surfaces that are tied move apart (collective)."""
        tied = [pair for pair in self.spaces.pairs if pair.parts.tied]
        if not tied or free.shape[1] == 0:
            return free
        gram, total = np.zeros((free.shape[1], free.shape[1])), 0.0
        for pair in tied:
            jumps = self._jumps(pair).reshape(len(pair.slaves), self.spaces.dim**2, len(free)) @ free
            gram += np.einsum("njr,njs,n->rs", jumps, jumps, pair.slave.measure)
            total += float(pair.slave.measure.sum())
        gram, total = self.spaces.mesh.comm.allreduce(gram), self.spaces.mesh.comm.allreduce(total)
        sizes, vectors = np.linalg.eigh(gram)
        return np.asarray(free @ vectors[:, sizes <= FREE**2 * total])

    def _jumps(self, pair: MeshPair) -> Array:
        """The means of the motions on the slaves of a pair less those opposite, shape (slaves, d, d, bodies, motions).

        Collective.
        """
        spaces, pieces = self.spaces, pair.pieces
        slave_of = self.of_cell[spaces.boundary_facets(pair.slaves).cells]
        master_of = pair.of_masters(spaces.mesh.comm, self.of_cell[spaces.boundary_facets(pair.masters).cells])
        moved = self._moved(pair.slave.corners)
        jumps = np.zeros((*moved.shape[:3], self.number, moved.shape[3]))
        jumps[np.arange(len(moved)), :, :, slave_of] = means_of_linear(moved)
        opposite = np.einsum("nab,nbir->nair", pieces.weights, self._moved(pair.master.corners[pieces.master]))
        np.subtract.at(np.moveaxis(jumps, 3, 1), (pieces.slave, master_of[pieces.master]), opposite)
        return jumps

    def relative(self, directions: Array) -> Array:
        """The motions along directions at the vertices of the facets of Γ_C, shape (facets, d, all motions).

        On a part inside the domain they are those of the named side less those of the other one, and less those of the
        tool on the part of one.

        Args:
            directions: One for each vertex, shape (facets, d, d).
        """
        spaces, rows = self.spaces, self.spaces.inner.rows
        along = np.einsum("nai,nair->nar", directions, self._moved(spaces.contact.vertices))
        of_each = np.zeros((*along.shape[:2], self.number, along.shape[2]))
        facets = np.arange(len(along))
        of_each[facets, :, self.of_cell[spaces.contact.cells]] = along
        of_each[rows, :, self.of_cell[spaces.across.cells]] -= along[rows]
        for pair in spaces.pairs:
            if not pair.parts.tied:
                slaves, jumps = spaces.rows_of(pair), linear_from_means(self._jumps(pair))
                of_each[slaves] = np.einsum("nai,naibr->nabr", directions[slaves], jumps)
        of_bodies = of_each.reshape(*along.shape[:2], self.number * along.shape[2])
        return np.concatenate([of_bodies, -moves_along(spaces, self.tools, directions)], axis=2)

    def work(self, data: ElasticData) -> tuple[Array, float]:
        """What all loads do on the motions, and what they could do, 1 if they are 0 (collective)."""
        spaces, neumann = self.spaces, self.spaces.neumann
        pairs = [(self.of_cell[neumann.cells], neumann.vertices, data.tractions)]
        beside = (pull for pull in data.pulls if not np.isin(pull.facets.facets, neumann.facets).any())
        pairs += [(self.of_cell[pull.facets.cells], pull.facets.vertices, pull.moments) for pull in beside]
        pairs += [
            (self.of_cell[cells.numbers], cells.vertices, data.moments_of_f(spaces, cells)) for cells in spaces.blocks()
        ]
        rows = [np.einsum("nvi,nvir->nr", moments, self._moved(x)) for _, x, moments in pairs]
        work = self._summed(np.concatenate([of for of, _, _ in pairs]), np.concatenate(rows)).ravel()
        most = spaces.mesh.comm.allreduce(sum(float(np.abs(moments).sum()) for _, _, moments in pairs))
        on_tools = loads_of(self.tools)
        most += float(np.abs(on_tools).sum())
        return np.append(work, on_tools), most if most > 0 else 1.0

    def in_words(self, motion: Array) -> tuple[str, float]:
        """The motion of the body that moves most, in words, and its length or its angle (collective)."""
        motion, of_tools = np.split(motion, [len(motion) - len(loads_of(self.tools))])
        if np.abs(of_tools).max(initial=0.0) > np.abs(motion).max(initial=0.0):
            tool = max(tools_at(self.tools, of_tools, anew=True), key=lambda tool: np.abs(tool.moved).max())
            words, unit = _in_words(tool.as_of_body(), tool.middle, tool.size)
            return f"{words}, that is the tool on '{tool.part}'", unit
        by_body = motion.reshape(self.number, -1)
        body = int(np.abs(by_body).max(axis=1).argmax())
        words, unit = _in_words(by_body[body], self.middle, self.size)
        if self.number == 1:
            return words, unit
        if np.abs(by_body - by_body[0]).max() <= TURNS:
            return f"{words}, that is all bodies together", unit
        return f"{words}, that is the body around ({_without_rounding(self._centers()[body], self.size)})", unit

    def _centers(self) -> Array:
        """The centroids of the bodies, and that of all (collective)."""
        vertices = self.spaces.vertices
        measure = Cells(vertices).measure
        sums = self._summed(self.of_cell, np.column_stack([measure[:, None] * vertices.mean(axis=1), measure]))
        sums = np.vstack([sums, sums.sum(axis=0)])
        return np.asarray(sums[:, :-1] / sums[:, -1:])

    def plain(self, free: Array) -> Array:
        """Motions that are easy to tell, by their shares of free ones (collective).

        They are translations along the axes and rotations about the centroid, one way and the other, of all bodies
        together and then of each; only those that are free.

        Args:
            free: The basis of the free motions.
        """
        dim, *centers = self.spaces.dim, *self._centers()
        motions = []
        for moved, center in zip([slice(None), *range(self.number)], [centers[-1], *centers[:-1]], strict=True):
            at_center = self._moved(center)
            of_one = np.eye(at_center.shape[1])
            of_one[dim:, :dim] = -at_center[:, dim:].T
            of_all = np.zeros((len(of_one), self.number, len(of_one)))
            of_all[:, moved] = of_one if isinstance(moved, int) else of_one[:, None]
            motions.append(of_all.reshape(len(of_one), -1))
        plain = np.concatenate(motions)
        plain = np.pad(plain, ((0, 0), (0, len(free) - plain.shape[1])))
        shares = plain @ free
        shares = shares[np.abs(shares @ free.T - plain).max(axis=1) <= FREE]
        return np.concatenate([shares, -shares])


def _without_rounding(vector: Array, size: float) -> str:
    """A vector in words, with 0 for what is rounding beside a size."""
    return ", ".join(f"{x:.3g}" for x in np.where(np.abs(vector) > TURNS * size, vector, 0.0))


def _in_words(motion: Array, middle: Array, size: float) -> tuple[str, float]:
    """A motion as a translation or a rotation, and its length or its angle."""
    dim = len(middle)
    shift, turn = motion[:dim], motion[dim:] / size
    along = _without_rounding(shift / max(np.abs(shift).max(), 1e-300), 1.0)
    if np.abs(turn).max() * size < TURNS * np.abs(shift).max():
        return f"along ({along})", float(np.linalg.norm(shift))
    if dim == 2:
        center = middle + np.array([-shift[1], shift[0]]) / turn[0]
    else:
        center = middle + np.cross(turn, shift) / (turn @ turn)
    place = _without_rounding(center, size)
    if dim == 2:
        return f"about the point ({place})", float(np.abs(turn[0]))
    axis = _without_rounding(turn / np.abs(turn).max(), 1.0)
    return f"about an axis along ({axis}) through ({place})", float(np.linalg.norm(turn))
