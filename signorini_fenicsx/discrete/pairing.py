"""Pairs of surfaces on a mesh: which facets carry pressure, and the overlay with the surfaces opposite to them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import cell_nodes, cells_of_facets, number_of_cells
from signorini_fenicsx.discrete.bodies import bodies
from signorini_fenicsx.discrete.linear_traces import node_ranks
from signorini_fenicsx.discrete.mesh_spaces import Facets
from signorini_fenicsx.discrete.overlay import WHOLE, Pieces, Surface, overlay
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.paired_parts import PairedParts
from signorini_fenicsx.meshes.seams import unit_normals

COARSER = 1.4
"""Facets of a slave that are coarser than the master's by this factor see u of the master as it is."""


@dataclass(frozen=True)
class MeshPair:
    """A pair of surfaces on a mesh.

    Attributes:
        parts: Their names, and what is said of them.
        slaves: The covered slave facets of this rank, all owned.
        left_out: Its slave facets that are not covered; they are free.
        slave: Vertices and normals of `slaves`, in the order of `LinearTraces`.
        directions: d of each.
        masters: The master facets that this rank owns.
        master: Vertices and normals of the master facets of all ranks, one rank after the other.
        first: How many of these are before those of this rank.
        pieces: The overlay; slave facets are rows of `slaves`, master facets rows of `master`.
        covered: The shares of all slave facets of this rank, in the order of their numbers.
    """

    parts: PairedParts
    slaves: Facets
    left_out: Facets
    slave: Surface
    directions: Array
    masters: Facets
    master: Surface
    first: int
    pieces: Pieces
    covered: Array = field(default_factory=lambda: np.empty(0))

    @property
    def slaves_and_masters(self) -> Facets:
        """The facets of both sides of this rank."""
        return np.append(self.slaves, self.masters)

    @property
    def without_law(self) -> Facets:
        """The facets of this rank with no law on them: the masters, and slaves that are tied."""
        return self.slaves_and_masters if self.parts.tied else self.masters

    def of_masters(self, comm: MPI.Intracomm, rows: npt.NDArray) -> npt.NDArray:
        """Rows of this rank's master facets as those of all ranks (collective)."""
        return np.concatenate(comm.allgather(rows))

    def coarse_masters(self, mesh: dolfinx.mesh.Mesh, cells: Indices) -> Facets:
        """Master facets of this rank that are coarse for the slaves opposite once some cells are halved (collective).

        Args:
            mesh: The mesh.
            cells: Owned cells that will be halved, of this rank.
        """
        halved = np.isin(cells_of_facets(mesh, self.slaves)[0], cells)[self.pieces.slave]
        slaves, masters = self.pieces.slave[halved], self.pieces.master[halved]
        coarse = 2 * COARSER * self.master.balls[1][masters] > self.slave.balls[1][slaves]
        rows = np.unique(np.concatenate(mesh.comm.allgather(masters[coarse]))) - self.first
        return self.masters[rows[(rows >= 0) & (rows < len(self.masters))]]

    def opposite(self, comm: MPI.Intracomm, values: Array) -> Array:
        """Means by the hats of the slave facets of what is opposite to them, shape (slaves, d, …) (collective).

        Args:
            comm: Communicator.
            values: At the vertices of this rank's master facets, between which they are linear, shape (masters, d, …).
        """
        pieces, means = self.pieces, np.zeros((len(self.slaves), *values.shape[1:]))
        opposite = self.of_masters(comm, values)[pieces.master]
        np.add.at(means, pieces.slave, np.einsum("nab,nb...->na...", pieces.weights, opposite))
        return means

    def onto_masters(self, comm: MPI.Intracomm, values: Array) -> Array:
        """∫ χ_*(t) Φ_b on this rank's master facets, shape (masters, d, components) (collective).

        Args:
            comm: Communicator.
            values: t at the vertices of the slave facets, between which it is linear, shape (slaves, d, components).
        """
        pieces, shares = self.pieces, self.slave.measure / values.shape[1]
        sums = np.zeros((len(self.master.corners), *values.shape[1:]))
        passed = np.einsum("n,nab,nai->nbi", shares[pieces.slave], pieces.weights, values[pieces.slave])
        np.add.at(sums, pieces.master, passed)
        return np.asarray(comm.allreduce(sums)[self.first : self.first + len(self.masters)])


def pairs_on(domain: Domain, pairs: Sequence[PairedParts], *, cut: bool) -> tuple[MeshPair, ...]:
    """The pairs on a mesh (collective).

    Args:
        domain: The domain.
        pairs: Their parts.
        cut: Whether the mesh is cut inside the domain, see `node_ranks`.

    Raises:
        InputError: If a part is unknown, a direction has not as many components as the mesh, or no facet of a pair is
            covered.
    """
    if not pairs:
        return ()
    mesh = domain.mesh
    ranks, extents = node_ranks(mesh, cut=cut), _Extents(mesh)
    return tuple(_pair_on(domain, parts, ranks, extents) for parts in pairs)


class _Extents:
    """The bodies of a mesh, and how long the diagonal of the box around each is (collective)."""

    def __init__(self, mesh: dolfinx.mesh.Mesh):
        self.of_cell = bodies(fenicsx.function_space(mesh, ("CR", 1)))
        number = mesh.comm.allreduce(int(self.of_cell.max(initial=-1)), MPI.MAX) + 1
        x = mesh.geometry.x[cell_nodes(mesh)[: number_of_cells(mesh)]]
        ends = np.full((2, number, 3), -np.inf)
        np.maximum.at(ends[0], self.of_cell, x.max(axis=1))
        np.maximum.at(ends[1], self.of_cell, -x.min(axis=1))
        mesh.comm.Allreduce(MPI.IN_PLACE, ends, MPI.MAX)
        self.diameters = np.linalg.norm(ends.sum(axis=0), axis=1)

    def least(self, mesh: dolfinx.mesh.Mesh, *sides: Facets) -> float:
        """The diameter of the smallest body that one of these facets belongs to (collective)."""
        size = [self.diameters[self.of_cell[cells_of_facets(mesh, facets)[0]]].min(initial=np.inf) for facets in sides]
        return float(mesh.comm.allreduce(min(size), MPI.MIN))


def _pair_on(domain: Domain, parts: PairedParts, ranks: Indices, extents: _Extents) -> MeshPair:
    mesh, comm = domain.mesh, domain.mesh.comm
    if unknown := [part for part in (*parts.slave, *parts.master) if part not in domain.facets]:
        raise InputError(f"pair {parts.words}: unknown part '{unknown[0]}'; there are {', '.join(domain.facets)}")
    slaves, masters = (
        np.unique(np.concatenate([domain.facets[part] for part in names])) for names in (parts.slave, parts.master)
    )
    slave, side = _surface(mesh, slaves, ranks), _surface(mesh, masters, ranks)
    master = Surface(*(np.concatenate(comm.allgather(each)) for each in (side.corners, side.normals)))
    shift = np.zeros(mesh.geometry.dim) if parts.shift is None else np.array(parts.shift)
    if len(shift) != mesh.geometry.dim:
        raise InputError(f"pair {parts.words}: shift has {len(shift)} components")
    directions = slave.normals
    if parts.direction != "normal":
        if len(parts.direction) != slave.normals.shape[1]:
            raise InputError(f"pair {parts.words}: direction has {len(parts.direction)} components")
        directions = np.tile(np.array(parts.direction) / np.linalg.norm(parts.direction), (len(slaves), 1))
    within = extents.least(mesh, slaves, masters) / 2 if parts.within is None else parts.within
    pieces = overlay(slave, replace(master, corners=master.corners + shift), directions, within)
    shares = pieces.covered(len(slaves))
    whole = np.abs(shares - 1) <= WHOLE
    if not comm.allreduce(bool(whole.any()), MPI.LOR):
        raise InputError(
            f"pair {parts.words}: no facet of the slave is covered by the master within {within:.4g} along direction; "
            "check which side is which, the direction, or give a larger within"
        )
    pieces = pieces.take(whole[pieces.slave])
    rows = np.flatnonzero(whole)
    pieces.slave[:] = np.searchsorted(rows, pieces.slave)
    return MeshPair(
        parts=parts,
        slaves=slaves[rows],
        left_out=slaves[~whole],
        slave=Surface(slave.corners[rows], slave.normals[rows]),
        directions=directions[rows],
        masters=masters,
        master=master,
        first=comm.scan(len(masters)) - len(masters),
        pieces=pieces,
        covered=shares,
    )


def _surface(mesh: dolfinx.mesh.Mesh, facets: Facets, ranks: Indices) -> Surface:
    """Facets with their vertices in the order of the ranks of nodes."""
    dim = mesh.topology.dim
    nodes = np.empty((0, dim), dtype=np.int32)
    if len(facets) > 0:
        nodes = dolfinx.mesh.entities_to_geometry(mesh, dim - 1, facets)
    nodes = np.take_along_axis(nodes, np.argsort(ranks[nodes], axis=1), axis=1)
    cells, local = cells_of_facets(mesh, facets)
    corners = mesh.geometry.x[nodes, :dim]
    normals = unit_normals(corners[:, 1:] - corners[:, :1])
    apart = corners[:, 0] - mesh.geometry.x[cell_nodes(mesh)[cells, local], :dim]
    normals *= np.sign(np.einsum("ni,ni->n", apart, normals))[:, None]
    return Surface(corners, normals)
