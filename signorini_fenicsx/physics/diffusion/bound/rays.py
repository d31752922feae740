"""The bounds of u that laws in Ω set, such as obstacles: vertical ends of their graphs, and what they ask of v.

v is between the bounds. There it is a function that is quadratic on each cell, with RT1 cubic, by Bernstein
coefficients between those of I_hψ, and then cut off by ψ itself. In vertices off Γ_D all of whose cells touch it is
moved beyond ψ by as much as I_hψ may be on the other side, so that v is ψ itself there.

*What a bound of u asks of the Bernstein coefficients of v, on each cell or facet*.

Let b be a lower bound; of an upper one all is the other way round. As a rule v is at least I_hb, by the coefficients of
both, and what b is beyond I_hb cuts v off. Two sorts of simplices ask for one number instead.

- *Clear* ones: v is not on the bound there, and b is proved to be below a number c that is less than all coefficients
  of v. So b, which may be steep or far away, changes nothing.
- *Rough* ones, in which or in whose nodes b jumps: v is at least sup b there. So b does not cut v off, and v stays
  continuous where b is not.

A node has the largest number that its simplices ask for. So where b jumps along lines of the mesh its larger side holds
v, as it holds u.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_dofs, sums_at
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.discrete.bernstein import (
    coefficients_of,
    degree_of,
    in_nodes,
    make_linear,
    nodes_of,
    to_bernstein,
)
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.continuity import jumps_inside
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import extreme_around
from signorini_fenicsx.discrete.points import cell_quadrature
from signorini_fenicsx.expressions import Tree, is_polynomial
from signorini_fenicsx.expressions.cutting import Frame
from signorini_fenicsx.expressions.enclosures import ranges, slopes, surely_above
from signorini_fenicsx.expressions.tree import Negative
from signorini_fenicsx.physics.diffusion.bound.law_bounds import Bound
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import CellLaws
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

BESIDE = 1e-4, 1e-8
"""A datum jumps if it is as far from its value in a node at the second share of the way to the centroid as at the
first; r^α would be 10^-4α times as far."""
ROUNDING = 1e-12
"""Relative size of what is no jump."""
BLUR = 16 * np.finfo(np.float64).eps
"""Rounding of coordinates, as a share of their size."""
SHARP = 0.1
"""sup b is known up to this share of what b varies by between nodes."""


def jumps_in_nodes(tree: Tree, vertices: Array, degree: int, nodes: Array | None = None) -> Mask:
    """Where the values of a tree in the nodes of simplices are not the limits from inside, shape (n, nodes).

    Args:
        tree: The tree.
        vertices: Of the simplices.
        degree: The degree of v.
        nodes: Values that are looked at in the place of those of the tree, NaN where any will do.
    """
    inside = vertices.mean(axis=1, keepdims=True) - vertices
    at, near, nearer = (in_nodes(tree, vertices + share * inside, degree) for share in (0.0, *BESIDE))
    if nodes is not None:
        at = np.where(np.isnan(nodes), nearer, nodes)
    far, close = np.abs(near - at), np.abs(nearer - at)
    return np.asarray((close > far / 2) & (close > _rounding(vertices, at)[:, None]))


def _rounding(vertices: Array, at: Array) -> Array:
    """What rounding of values and of coordinates makes of values in the nodes of each simplex, at most."""
    blur = BLUR * np.abs(vertices).max(axis=(1, 2), initial=0.0) / np.ptp(vertices, axis=1).max(axis=1, initial=0.0)
    return np.asarray(ROUNDING * np.abs(at).max(initial=0.0) + blur * np.ptp(at, axis=1))


@dataclass(frozen=True)
class BoundedSimplices:
    """Owned cells or facets, as v has them.

    Attributes:
        vertices: Shape (n, vertices, dim).
        cells: The owned cell of each.
        nodes: Their nodes in the space of v, as Basix orders them, shape (n, nodes).
        v: The coefficients of v there.
        touched: Mask of those where v is on the bound.
    """

    vertices: Array
    cells: AnyIndices
    nodes: AnyIndices
    v: Array
    touched: Mask

    def asked(self, datum: Datum, sign: float, space: fem.FunctionSpace, frame: Frame) -> tuple[Array, Mask, Mask]:
        """The least coefficients (sign 1), or the largest ones (−1), and masks of rough and clear ones (collective).

        Args:
            datum: The bound, by texts.
            sign: Whether it is a lower or an upper one.
            space: That of v.
            frame: The domain.
        """
        number, cell, degree = len(self.vertices), SIMPLEX[self.vertices.shape[1] - 1], degree_of(space)
        wanted, in_node = np.empty(self.nodes.shape), np.zeros(self.nodes.shape, dtype=bool)
        torn, pieces = np.zeros(number, dtype=bool), []
        for tree, rows in datum.trees_in(self.cells):
            pieces.append((Negative(tree) if sign > 0 else tree, rows))
            x = self.vertices[rows]
            wanted[rows] = sign * coefficients_of(in_nodes(tree, x, degree), cell)
            if not is_polynomial(tree, degree):
                in_node[rows] = jumps_in_nodes(tree, x, degree)
                some = rows[~np.isfinite(sum(slopes(tree, x, frame, np.full(len(rows), np.inf))))]
                sizes = jumps_inside(tree, self.vertices[some])[0].max(axis=1, initial=0.0)
                torn[some] = sizes > _rounding(self.vertices[some], wanted[some])
        around = extreme_around(space, self.nodes, 1.0 * in_node, largest=True)
        rough, clear = torn | (around[self.nodes] > 0).any(axis=1), np.zeros(number, dtype=bool)
        for below, rows in pieces:
            number_on = self._numbers(below, rows, sign, frame)
            far = np.isfinite(number_on)
            wanted[rows[far]], clear[rows[far]] = number_on[far, None], True
            some = rows[rough[rows] & ~far]
            high, low = wanted[some].max(axis=1, initial=-np.inf), wanted[some].min(axis=1, initial=np.inf)
            slack = SHARP * (high - low) + ROUNDING * np.abs(high)
            most = -ranges(below, self.vertices[some], None, frame, -high - slack, np.inf).lo
            rough[some[~np.isfinite(most)]] = False
            wanted[some] = np.where(np.isfinite(most), most + ROUNDING * np.abs(most), wanted[some].T).T
        return sign * wanted, rough & ~clear, clear

    def _numbers(self, below: Tree, rows: AnyIndices, sign: float, frame: Frame) -> Array:
        """The number that clear ones of some rows ask for, −∞ on others; `below` is −b, or b of an upper bound."""
        least = (sign * self.v[rows]).min(axis=1, initial=np.inf)
        number = (least + in_nodes(Negative(below), self.vertices[rows]).max(axis=1, initial=-np.inf)) / 2
        far = np.flatnonzero(~self.touched[rows] & (number < least))
        sure = far[surely_above(below, self.vertices[rows[far]], frame, -number[far])]
        return np.where(np.isin(np.arange(len(rows)), sure), number, -np.inf)


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
            simplices = BoundedSimplices(
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
