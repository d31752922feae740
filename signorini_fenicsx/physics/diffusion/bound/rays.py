"""The bounds of u that laws in Ω set, such as obstacles: vertical ends of their graphs, and what they ask of v.

v is between the bounds. There it is a function that is quadratic on each cell, with RT1 cubic, by Bernstein
coefficients between those of I_hψ, and then cut off by ψ itself. In vertices off Γ_D all of whose cells touch it is
moved beyond ψ by as much as I_hψ may be on the other side, so that v is ψ itself there.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_dofs, sums_at
from signorini_fenicsx.discrete.bernstein import make_linear, nodes_of, to_bernstein
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import extreme_around
from signorini_fenicsx.discrete.points import cell_quadrature
from signorini_fenicsx.expressions.cutting import Frame
from signorini_fenicsx.physics.diffusion.bound.law_bounds import Bound
from signorini_fenicsx.physics.diffusion.bound.limits import Simplices
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import CellLaws
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

ROOM = 2.0
"""Factor of the largest I_hψ − ψ in the points of a quadrature."""


@dataclass(frozen=True)
class Ray:
    """A bound of u in some cells.

    Attributes:
        name: Its name in messages and results.
        datum: The bound.
        sign: 1 for a lower bound, −1 for an upper one.
        cells: The owned cells where it holds.
        touched: Mask of the owned cells on it.
        pressed: Mask of these and, with RT1, of the cells that only touch it and are pressed by it.
        everywhere: Whether it holds in all cells of all ranks.
    """

    name: str
    datum: Datum
    sign: float
    cells: Indices
    touched: Mask
    pressed: Mask
    everywhere: bool

    @property
    def is_quadratic(self) -> bool:
        """Whether the bound is its own quadratic interpolant."""
        return self.datum.polynomial is not None and self.datum.polynomial <= 2

    def limits(self, v: fem.Function, frame: Frame) -> tuple[Array, Mask]:
        """What it asks of the coefficients of v, infinite in nodes off its cells, and the rough cells (collective)."""
        space, rough = v.function_space, np.zeros(len(self.touched), dtype=bool)
        if self.datum.number is None and self.datum.pieces is not None:
            nodes = cell_dofs(space)[self.cells]
            simplices = Simplices(
                corners(space.mesh)[self.cells], self.cells, nodes, v.x.array[nodes], self.touched[self.cells]
            )
            asked, rough[self.cells], _ = simplices.asked(self.datum, self.sign, space, frame)
            return extreme_around(space, nodes, asked, largest=self.sign > 0), rough
        bound = coefficients(self.datum, space)
        return bound if self.everywhere else np.where(_around(space, self.cells), bound, -self.sign * np.inf), rough

    def bound(self, linear: fem.FunctionSpace) -> Bound:
        """The bound, as it is known to `conforming`, with the depth 0 (collective)."""
        near = fem.Function(linear)
        near.x.array[:] = 1.0 if self.everywhere else _around(linear, self.cells)
        return Bound(self.datum, self.sign, near, 0.0)

    def touch(self, v: fem.Function, limit: Array, on_dirichlet: Indices) -> None:
        """Let v be I_hψ in the nodes of all cells on the bound, but not on Γ_D (collective)."""
        touched = _around(v.function_space, np.flatnonzero(self.touched))
        touched[on_dirichlet] = False
        v.x.array[:] = np.where(touched, limit, v.x.array)

    def move_inside(self, v: fem.Function, limits: tuple[Array, Mask], given: Indices) -> None:
        """Move v in the vertices all of whose cells touch, so that v cut off by ψ is ψ there (collective).

        In nodes where v is given, as on Γ_D, and in those of rough cells, it stays.
        """
        if self.is_quadratic:
            return
        space, mesh, (limit, rough) = v.function_space, v.function_space.mesh, limits
        above, interpolant = np.zeros(len(self.touched)), fem.Function(space)
        interpolant.x.array[:] = np.where(np.isfinite(limit), limit, 0.0)
        for points in cell_quadrature(mesh, self.cells.astype(np.int32), quadrature_degree(self.datum)):
            missed = self.sign * (points.bernstein(interpolant)[:, :, 0] - self.datum.values(points))
            above[points.cells] = missed.max(axis=1, initial=0.0)
        cells = cell_dofs(space)
        vertices = cells[:, : mesh.topology.dim + 1]
        apart = rough | (self.sign * v.x.array[cells] > self.sign * limit[cells]).any(axis=1)
        depth, free = fem.Function(space), fem.Function(space)
        for function, values in ((depth, ROOM * above), (free, 1.0 * apart)):
            np.maximum.at(function.x.array, vertices.ravel(), np.repeat(values, vertices.shape[1]))
            function.x.petsc_vec.ghostUpdate(addv=PETSc.InsertMode.MAX_VALUES, mode=PETSc.ScatterMode.REVERSE)
            function.x.scatter_forward()
        depth.x.array[free.x.array > 0] = 0.0
        depth.x.array[given] = 0.0
        make_linear(depth)
        v.x.array[:] -= self.sign * depth.x.array


def coefficients(datum: Datum, space: fem.FunctionSpace) -> Array:
    """Bernstein coefficients of the interpolant of a datum (collective)."""
    interpolant = datum.at_nodes(space, nodes_of(space))
    to_bernstein(interpolant)
    return np.asarray(interpolant.x.array, dtype=np.float64)


def _around(space: fem.FunctionSpace, cells: Indices) -> Mask:
    """Mask of the nodes of this rank that some owned cells of any rank have (collective)."""
    return sums_at(space.dofmap.index_map, space.dofmap.list[cells]) > 0


def rays_of(spaces: Spaces, laws: CellLaws, segment: Indices, s: Array, blurred: Mask) -> Iterator[Ray]:
    """All bounds of u (collective).

    Args:
        spaces: The discrete spaces.
        laws: The laws.
        segment: The segment of each owned cell.
        s: Its s_T.
        blurred: Mask of the cells whose segment is not that of all of the cell.
    """
    number = len(segment)
    for part in laws.of_regions:
        everywhere = spaces.mesh.comm.allreduce(number - len(part.rows)) == 0
        for sign, datum in zip((1.0, -1.0), part.bounds, strict=True):
            if datum is None:
                continue
            key = next((name for name, each in part.data.items() if each is datum), "bound")
            touched = np.zeros(number, dtype=bool)
            end = np.zeros(number, dtype=np.int64) if sign > 0 else laws.chains.count
            touched[part.rows] = True
            touched &= np.isinf(laws.chains.slope[np.arange(number), end])
            pressed = touched & np.where(blurred, sign * s < 0, segment == end)
            touched &= ~blurred & (segment == end)
            yield Ray(part.key(key), datum, sign, part.rows, touched, pressed, everywhere)
