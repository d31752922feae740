"""Laws in Ω while the function v of a bound is relaxed: the springs of sloped segments, and the ends of steep ones.

On a cell on a segment s = βu − q the density of `inside` is about ½β(v − t)², with t where s_T is on the segment. A
rigid segment, one that is very steep and long, holds v at t; as on Γ_S v is then near the segment beside it. On other
cells v is kept off the nearest rigid segments. It may cross vertical ones: where they are as short as a jump of a
content usually is, that costs less than to bend v.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_dofs, function_of, sums_at
from signorini_fenicsx.certificate.laws import LawPoints
from signorini_fenicsx.discrete.bernstein import basis, coefficients_of, degree_of, nodes_of
from signorini_fenicsx.discrete.datum import quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import extreme_around
from signorini_fenicsx.discrete.points import CellPoints, cell_quadrature, in_cells
from signorini_fenicsx.physics.diffusion.bound.inside import Inside
from signorini_fenicsx.physics.diffusion.bound.laws import ends_beside, pieces_beside, trace_on
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric
from signorini_fenicsx.physics.diffusion.bound.on_gamma_s import RIGID
from signorini_fenicsx.physics.diffusion.bound.relaxation import SpringsInCells
from signorini_fenicsx.physics.diffusion.discrete.nodes import Jumps, set_means

LARGE = 2.0
"""A segment is rigid if s changes along it by more than so many times the largest |s|: others v may well cross."""


@dataclass(frozen=True)
class LawPieces:
    """The pieces of laws in Ω near which v is to be. Arrays have one entry per owned cell.

    Attributes:
        inside: The laws.
        piece: The segment near which v is: that of the cell, or the one beside it where that is rigid.
        held: Mask of the cells on rigid segments.
        springy: Mask of the cells on sloped segments that are less steep.
        rigid: The segments that are, shape (cells, segments).
    """

    inside: Inside
    piece: Indices
    held: Mask
    springy: Mask
    rigid: Mask

    @classmethod
    def of(cls, inside: Inside, metric: CellMetric, comm: MPI.Comm) -> "LawPieces":
        """Choose them (collective)."""
        chains, segment, rows = inside.chains, inside.segment, np.arange(len(inside.s))
        largest = LARGE * comm.allreduce(float(np.abs(inside.s).max(initial=0.0)), MPI.MAX)
        sloped, stiff = np.isfinite(chains.slope), chains.slope * metric.diameter[:, None] ** 2 > RIGID
        rigid = stiff & sloped & (-np.diff(chains.ends[1], axis=1) > largest)
        held, springy = rigid[rows, segment], (sloped & ~stiff & (chains.slope > 0))[rows, segment]
        piece = pieces_beside(chains, segment, -inside.s, rigid)
        return cls(inside, piece, held, springy, rigid)

    def rest(self, at: CellPoints, slope: Array, value: Array) -> Array:
        """The t of segments in points of cells; value itself of vertical ones."""
        return trace_on(slope, value, -self.inside.s_at(at))

    def hold(self, v: fem.Function, kept: npt.NDArray[np.integer]) -> Mask:
        """Set v by its values to t in the nodes of held cells, but not where it is kept; their mask (collective)."""
        before, nodes = v.x.array[kept], cell_dofs(v.function_space)
        values = np.zeros(nodes.shape)
        for at, law in self._nodes(v.function_space):
            values[at.cells] = self.rest(at, *law.on(self.inside.segment[at.cells]))
        set_means(v, nodes[self.held], values[self.held])
        v.x.array[kept] = before
        return sums_at(v.function_space.dofmap.index_map, nodes[self.held]) > 0

    def springs(self, space: fem.FunctionSpace) -> SpringsInCells | None:
        """What pulls v; None if nothing does (collective)."""
        inside, comm, nodes = self.inside, space.mesh.comm, cell_dofs(space)
        stiffness, loads, constant = np.zeros(len(inside.s)), np.zeros(nodes.shape), 0.0
        degree = quadrature_degree(*(datum for part in inside.parts for datum in part.data.values()), power=2)
        for parts, cells in inside.groups():
            some = cells[(self.held | self.springy)[cells]].astype(np.int32)
            for at in cell_quadrature(space.mesh, some, degree):
                law, numbers, piece = inside.law_at(parts, at), at.cells, self.piece[at.cells]
                slope, value = law.on(piece)
                finite = np.isfinite(slope)
                line = np.where(finite, slope, 0.0)
                stiffness[numbers] = at.means(line)
                turned = (line - stiffness[numbers, None]) * np.clip(self.rest(at, line, value), *law.traces(piece))
                density = np.where(finite, value + inside.s_at(at) - turned, 0.0)
                t = self.rest(at, *law.on(inside.segment[numbers]))
                hats = basis(space.mesh.basix_cell(), degree_of(space), at.points)
                loads[numbers] = at.scale[:, None] * ((density * at.weights) @ hats)
                constant += float(at.integrals(density * t - stiffness[numbers, None] * t**2 / 2).sum())
        if not comm.allreduce(bool(loads.any() or stiffness.any()), MPI.LOR):
            return None
        load = sums_at(space.dofmap.index_map, nodes, loads)
        return SpringsInCells(function_of(inside.spaces.Q, stiffness), load, comm.allreduce(constant))

    def ends(self, space: fem.FunctionSpace, jumps: Jumps) -> tuple[Array, Array]:
        """Between which coefficients v should be for the sake of its pieces, infinite where it is free (collective)."""
        nodes, rows, segment = cell_dofs(space), np.arange(len(self.piece)), self.inside.segment
        low, high = np.full(nodes.shape, -np.inf), np.full(nodes.shape, np.inf)
        only = self.held & self.rigid[rows, self.piece]
        for at, law in self._nodes(space):
            cells, t = at.cells, self.rest(at, *law.on(segment[at.cells]))
            of_pieces = segment[cells], self.piece[cells], self.rigid[cells], self.held[cells], only[cells]
            for limit, end in zip((low, high), ends_beside(law, *of_pieces, t), strict=True):
                limit[cells] = coefficients_of(end, space.mesh.basix_cell())
        floor, ceiling = (
            extreme_around(space, nodes, limit, largest=largest) for limit, largest in ((low, True), (high, False))
        )
        floor[jumps.jump], ceiling[jumps.jump] = -np.inf, np.inf
        return floor, ceiling

    def _nodes(self, space: fem.FunctionSpace) -> Iterator[tuple[CellPoints, LawPoints[CellPoints]]]:
        """The nodes of a space in all cells with laws that may pull, and the law in each (collective)."""
        for parts, cells in self.inside.groups():
            for at in in_cells(space.mesh, cells.astype(np.int32), nodes_of(space)):
                yield at, self.inside.law_at(parts, at)
