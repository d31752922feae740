"""The bodies of a domain: cells that are joined by facets. A cut through the domain may part it into several."""

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import cell_dofs, cells_behind
from signorini_fenicsx.base.rows import joined
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces, cells_and_dofs, extreme_around

if TYPE_CHECKING:  # it needs the bodies
    from signorini_fenicsx.discrete.pairing import MeshPair


def bodies(space: fem.FunctionSpace) -> Indices:
    """A number of its body for each owned cell, from 0 without gaps over all ranks (collective).

    Args:
        space: Functions with one unknown per facet.
    """
    comm = space.mesh.comm
    facets = cell_dofs(space)
    piece = np.unique(joined(int(facets.max(initial=-1)) + 1, facets)[facets[:, 0]], return_inverse=True)[1]
    number = int(piece.max(initial=-1)) + 1
    body = (comm.scan(number) - number + piece).astype(np.float64)
    while True:  # pieces of several ranks that share a facet get the larger number
        around = extreme_around(space, facets, np.repeat(body[:, None], facets.shape[1], axis=1), largest=True)
        largest = np.zeros(number)
        np.maximum.at(largest, piece, around[facets].max(axis=1, initial=0.0))
        if not comm.allreduce(bool((largest[piece] > body).any()), MPI.LOR):
            of_all = np.unique(np.concatenate(comm.allgather(np.unique(body))))
            return np.searchsorted(of_all, body)
        body = largest[piece]


def spread(spaces: MeshSpaces, facets: npt.NDArray[np.int32], values: Array) -> float:
    """The largest difference of values on facets of the boundary of the same body (collective)."""
    body = spaces.bodies
    number = spaces.mesh.comm.allreduce(int(body.max(initial=-1)), MPI.MAX) + 1
    ends = np.full((2, number), -np.inf)
    of_facet = body[cells_and_dofs(spaces.crouzeix_raviart, facets)[0]]
    for end, each in zip(ends, (values, -values), strict=True):
        np.maximum.at(end, of_facet, each)
    spaces.mesh.comm.Allreduce(MPI.IN_PLACE, ends, MPI.MAX)
    return float(ends.sum(axis=0).max(initial=0.0))


def without(
    spaces: MeshSpaces, facets: npt.NDArray[np.int32], cells: npt.NDArray[np.bool_] | None = None
) -> tuple[Indices, int]:
    """The bodies that have none of some facets of the boundary and none of some owned cells (collective).

    Bodies that are tied to one another are one.

    Returns:
        For each owned cell the number of its body among these, from 1, or 0 for all others; and their number.
    """
    body = _tied_together(spaces)
    number = spaces.mesh.comm.allreduce(int(body.max(initial=-1)), MPI.MAX) + 1
    has_some = np.zeros(number, dtype=bool)
    has_some[body[cells_and_dofs(spaces.crouzeix_raviart, facets)[0]]] = True
    if cells is not None:
        has_some[body[cells]] = True
    spaces.mesh.comm.Allreduce(MPI.IN_PLACE, has_some, MPI.LOR)
    among = np.where(has_some, 0, np.cumsum(~has_some))
    return among[body], int((~has_some).sum())


def opposite_bodies(spaces: MeshSpaces, pair: "MeshPair", of_cell: Indices) -> Indices:
    """The number of what most of each slave facet is opposite to, from a number for each owned cell (collective)."""
    masters, pieces = cells_behind(spaces.mesh, pair.masters), pair.pieces
    number = pair.of_masters(spaces.mesh.comm, of_cell[masters])[pieces.master]
    shares = np.zeros((len(pair.slaves), int(number.max(initial=-1)) + 1))
    np.add.at(shares, (pieces.slave, number), pieces.share)
    return shares.argmax(axis=1) if shares.size else np.zeros(len(pair.slaves), dtype=np.int64)


def _tied_together(spaces: MeshSpaces) -> Indices:
    """The number of its body for each owned cell, where bodies that are tied to one another are one (collective)."""
    body, comm = spaces.bodies, spaces.mesh.comm
    links = [np.empty((0, 2), dtype=np.int64)]
    for pair in spaces.pairs:
        if pair.parts.tied:
            masters = pair.of_masters(comm, body[cells_behind(spaces.mesh, pair.masters)])
            of_pieces = body[cells_behind(spaces.mesh, pair.slaves)][pair.pieces.slave], masters[pair.pieces.master]
            links.append(np.unique(np.column_stack(of_pieces), axis=0))
    several = np.concatenate(comm.allgather(np.concatenate(links)))
    number = comm.allreduce(int(body.max(initial=-1)), MPI.MAX) + 1
    return np.unique(joined(number, several), return_inverse=True)[1][body]
