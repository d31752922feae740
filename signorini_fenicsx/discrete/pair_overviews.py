"""What is worth knowing of pairs of surfaces on a mesh: how well they cover each other, distances, sizes of facets."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.text import counted
from signorini_fenicsx.discrete.overlay import Surface
from signorini_fenicsx.discrete.pairing import MeshPair

FINER = 1.5
"""The slave should have no facets that are smaller than the master's by this factor."""
FLAT = 1e-6
"""A surface is flat if its sagitta is at most this share of the size of its facets."""
SAGITTA = 0.5
"""A sagitta matters if it is this share of the distances."""


@dataclass(frozen=True)
class Overview:
    """What there is of a pair on all ranks.

    Attributes:
        words: Both sides in words.
        facets: Number of slave and of master facets.
        pieces: Number of pieces.
        covered: Number of slave facets that are covered; the others are free.
        distances: The least and the largest distance along the direction in the corners of the pieces.
        sizes: The mean diameter of slave and of master facets.
        sagittas: How far the facets of both sides are from surfaces that are as curved as they are.
        takes_distance: Whether the distance is the gap.
    """

    words: str
    facets: tuple[int, int]
    pieces: int
    covered: int
    distances: tuple[float, float]
    sizes: tuple[float, float]
    sagittas: tuple[float, float]
    takes_distance: bool

    def line(self) -> str:
        """The overview in a line."""
        slaves, masters = self.facets
        free = f", {slaves - self.covered} of them free, without a master" if slaves > self.covered else ""
        return (
            f"{self.words}: {counted(slaves, 'slave facet')}{free}; {counted(masters, 'master facet')}; "
            f"{counted(self.pieces, 'piece')}; distance {self.distances[0]:.4g} to {self.distances[1]:.4g}; "
            f"facets of {self.sizes[0]:.3g} and {self.sizes[1]:.3g}"
        )

    def advice(self) -> list[str]:
        """What would be better, in sentences."""
        advice = []
        slave, master = self.sizes
        if FINER * slave < master:
            advice.append(
                f"pair {self.words}: the facets of the slave, {slave:.3g}, are finer than those of the master, "
                f"{master:.3g}; swap slave and master: with the coarser surface as the slave the pressure is more exact"
            )
        if self.sagittas[1] <= FLAT * master < self.sagittas[0]:
            advice.append(
                f"pair {self.words}: the slave is curved and the master flat; swap slave and master: the law holds "
                "along the normals of the slave, and those of chords of a curved surface jump"
            )
        sagitta = sum(self.sagittas)
        if self.takes_distance and sagitta > SAGITTA * max(map(abs, self.distances)):
            advice.append(
                f"pair {self.words}: the facets are chords of curved ones, up to {sagitta:.2g} away from them, "
                f"where distances are at most {max(map(abs, self.distances)):.2g}; give the gap of the true surfaces "
                "in the place of the distance, gap = ..."
            )
        return advice


def overviews(pairs: Sequence[MeshPair], comm: MPI.Comm) -> list[Overview]:
    """An overview of each pair (collective)."""
    return [_overview(pair, comm) for pair in pairs]


def _overview(pair: MeshPair, comm: MPI.Comm) -> Overview:
    gaps = pair.pieces.gap / np.einsum("ni,ni->n", pair.directions, pair.slave.normals)[pair.pieces.slave, None]
    slaves = Surface(*(np.concatenate(comm.allgather(each)) for each in (pair.slave.corners, pair.slave.normals)))
    counts = comm.allreduce(np.array([len(pair.covered), len(pair.pieces), len(pair.slaves)])).tolist()
    least = comm.allreduce(float(gaps.min(initial=np.inf)), MPI.MIN)
    largest = comm.allreduce(float(gaps.max(initial=-np.inf)), MPI.MAX)
    sagittas = _sagitta(slaves), _sagitta(pair.master)
    sizes = _diameter(slaves), _diameter(pair.master)
    facets = counts[0], len(pair.master.corners)
    words, takes = pair.parts.words, pair.parts.distance
    return Overview(words, facets, counts[1], counts[2], (least, largest), sizes, sagittas, takes)


def _diameter(surface: Surface) -> float:
    """The mean diameter of facets."""
    return float(2 * surface.balls[1].mean()) if len(surface.corners) > 0 else 0.0


def _sagitta(surface: Surface) -> float:
    """How far chords are from a surface: h²/8 times the curvature, by the normals of facets that share a vertex.

    Facets that meet at more than a half right angle are at an edge of the body.
    """
    corners, count = surface.corners, len(surface.corners)
    if count == 0:
        return 0.0
    _, vertex = np.unique(corners.reshape(-1, corners.shape[2]), axis=0, return_inverse=True)
    facet, vertex = np.repeat(np.arange(count), corners.shape[1]), vertex.ravel()
    order = np.argsort(vertex, kind="stable")
    same = vertex[order][1:] == vertex[order][:-1]
    one, other = facet[order][:-1][same], facet[order][1:][same]
    cosine = np.clip(np.einsum("ni,ni->n", surface.normals[one], surface.normals[other]), -1, 1)
    angle = np.where(cosine > np.sqrt(0.5), np.arccos(cosine), 0.0)
    return float((angle * surface.balls[1][one] / 4).max(initial=0.0))
