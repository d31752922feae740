"""Conforming displacements on the split mesh without the nodes inside the cells.

What a displacement is inside a cell follows from what it is on the facets of the cell, as its energy is least there. So
the nodes inside are eliminated cell by cell, as the stresses are in `physics.elasticity.solve.system`. Of the unknowns
of quadratic displacements a third is left in the plane, a fifth in space.

*Incompressible bodies.* Cubics on a split simplex that are 0 around it have for divergences all discontinuous
quadratics with mean 0 (Scott and Vogelius). So ∇·v is made constant in each cell, by a large bulk modulus whose
pressures are then taken as given, as in `solve.mean_pressure`. The constant is the flow out of the cell, which the
nodes around it have. A moderate bulk modulus is against this flow, and the same method takes it away.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from math import factorial
from typing import Any

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import common, fem, la
from petsc4py import PETSc

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import cell_dofs, cell_nodes, sums_at, with_ghosts
from signorini_fenicsx.discrete.bernstein import exponents
from signorini_fenicsx.discrete.linear_traces import BLOCK, facet_normals, opposite
from signorini_fenicsx.discrete.trace_multigrid import DEFAULTS, TraceCoarse
from signorini_fenicsx.forms.elasticity import pairs as entries
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.physics.elasticity.discrete.data import OnSplit
from signorini_fenicsx.physics.elasticity.discrete.material import STIFF_VOLUME
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces, SplitMesh
from signorini_fenicsx.physics.elasticity.solve.mean_pressure import BETTER, BULK, ENOUGH, STALLS, MeansOfCells
from signorini_fenicsx.physics.elasticity.solve.mean_pressure import MOST as MOST_SOLVES

TOLERANCE = 1e-5
"""Relative residual of a solve by CG, which may stop before; the next solve also removes what the last one left."""
MOST = 200
"""If CG needs more iterations, it gives way to a factorisation."""
INSIDE = 3
"""So often pressures inside cells are taken as given."""


@dataclass(frozen=True)
class Nodes:
    """The nodes that are left, those on the facets of cells.

    Attributes:
        dim: d, the number of unknowns of each.
        numbers: Which ranks have them.
        of_space: Which node of the space each of them is, ghosts too.
        number_of: Which of them a node of the space is; −1 for one inside a cell.
    """

    dim: int
    numbers: common.IndexMap
    of_space: npt.NDArray[np.int32]
    number_of: npt.NDArray[np.int32]

    @classmethod
    def of(cls, split: SplitMesh, space: fem.FunctionSpace) -> "Nodes":
        """The nodes on the outer facets of the subcells, opposite to the last vertex (collective)."""
        everywhere = space.dofmap.index_map
        left = np.zeros(everywhere.size_local + everywhere.num_ghosts, dtype=bool)
        left[space.dofmap.list[:, space.element.basix_element.entity_closure_dofs[-2][-1]]] = True
        numbers, of_space = fenicsx.sub_index_map(everywhere, np.flatnonzero(left).astype(np.int32))
        number_of = np.full(len(left), -1, dtype=np.int32)
        number_of[of_space] = np.arange(len(of_space), dtype=np.int32)
        return cls(split.mesh.geometry.dim, numbers, of_space, number_of)


@dataclass(frozen=True)
class Condensed:
    """Displacements of least energy inside the cells, as functions of the coefficients at the nodes that are left.

    Attributes:
        nodes: The nodes that are left.
        matrices: The stiffness of each cell, shape (cells, outer, outer).
        load: The forces on the owned nodes that are left.
        energy: What the forces inside the cells add to the least energy, of this rank.
        softened: By how much the diagonal of the stiffness is less without the nodes inside, for owned unknowns.
        around: The nodes that are left of each cell, shape (cells, outer).
        inside: Those inside it, as nodes of the space, shape (cells, inner).
        share: The coefficients inside for each of those around, negative, shape (cells, d inner, d outer).
        particular: Those inside where the others are 0, shape (cells, d inner).
        flows: ∫ v·n over the boundary of each cell for unit coefficients around it, shape (cells, d outer).
        stiffness: Of the cells against these flows; 0 where they may be compressed.
        grown: What these flows have to be.
    """

    nodes: Nodes
    matrices: Array
    load: Array
    energy: float
    softened: Array
    around: npt.NDArray[np.int32]
    inside: Indices
    share: Array
    particular: Array
    flows: Array
    stiffness: Array
    grown: Array

    def without_flows(
        self, x: Array, lift: Array, solve: Callable[[Array], Array], pushed: Callable[[Array], Array]
    ) -> tuple[Array, float]:
        """The x near this one with which nothing is lost or won in cells, and what still is as a share (collective).

        See `solve.mean_pressure`.

        Args:
            x: Of the owned unknowns.
            lift: What is given besides.
            solve: What forces change.
            pushed: Gives an x near another one that is admissible.
        """
        numbers, dim, before, stalled = self.nodes.numbers, self.nodes.dim, np.inf, 0
        mean = MeansOfCells(numbers.comm, self.flows, self.stiffness)
        search = mean.search()

        def lost(x: Array) -> tuple[Array, float]:
            everywhere = with_ghosts(numbers, (x + lift).reshape(-1, dim))
            return mean.of(everywhere[self.around].reshape(self.flows.shape), self.grown)

        means, share = lost(x)
        for _ in range(MOST_SOLVES):
            stalled = stalled + 1 if share > before / 2 else 0
            if share <= ENOUGH or stalled == STALLS:
                break
            way = mean.pulls(search.direction(means, again=stalled > 0)).reshape(*self.around.shape, dim)
            change = solve(-sums_at(numbers, self.around, way)[: numbers.size_local].ravel())
            last, x, before = x, pushed(x + change), share
            means, share = lost(x)
            if share > before / 2 and (length := search.length(means)) != 1.0:
                tried = pushed(last + length * change)
                if (then := lost(tried))[1] < BETTER * share:
                    x, (means, share) = tried, then
        return x, share

    def coefficients(self, x: Array) -> Array:
        """The coefficients at the nodes inside, shape (cells, inner, d), from those of the others, ghosts too."""
        around = x[self.around].reshape(self.share.shape[::2])
        inner = self.particular - np.einsum("nio,no->ni", self.share, around)
        return inner.reshape(*self.inside.shape, self.nodes.dim)


def condensed(
    split: SplitMesh, space: fem.FunctionSpace, nodes: Nodes, material: OnSplit, frames: Array, forces: Array
) -> Condensed:
    """Eliminate the nodes inside the cells (collective).

    Args:
        split: The split mesh, or a part of it.
        space: The displacements on it.
        nodes: The nodes that are left.
        material: The material on it.
        frames: Directions of the coefficients at all nodes of this rank, see `GivenNodes`.
        forces: Forces along these, complete for owned nodes, shape (nodes, d).
    """
    dim, size = split.mesh.geometry.dim, nodes.numbers.size_local
    load, softened, energy = la.vector(nodes.numbers, dim), la.vector(nodes.numbers, dim), 0.0
    load.array.reshape(-1, dim)[:size] = forces[nodes.of_space[:size]]
    cells, parts = split.cells[split.cells[:, 0] >= 0], list[tuple[Any, ...]]()
    growth = material.growth() if material.incompressible else np.zeros(split.cells.max(initial=-1) + 1)
    for block in np.array_split(cells, -(-len(cells) // BLOCK[dim])) if len(cells) > 0 else []:
        which, places, number = _layout(space.dofmap.list[block[0]], nodes)
        of_cells, first = space.dofmap.list[block].reshape(len(block), -1)[:, places], dim * number
        outer, inside = np.split(of_cells, [number], axis=1)
        around, pull = nodes.number_of[outer], forces[inside].reshape(len(block), -1, 1)
        flows, bulk, grown = np.zeros((len(block), first)), np.zeros(len(block)), growth[block].sum(axis=1)
        law, degree = material.in_points(block.ravel(), 2 * space.element.basix_element.degree - 2)
        of_law = partial(_stiffness, split, space, block, which, frames[of_cells])
        if material.incompressible:
            law, volume, modulus = _apart(law, block.shape)
            stiffness = of_law(law, degree)
            share, alone, left, of_load = _incompressible(stiffness, of_law(volume, degree), first, pull)
            flows, bulk = _flows(split, space, block, which, frames[outer], modulus)
            left = left + bulk[:, None, None] * flows[:, :, None] * flows[:, None]
            of_load, energy = of_load + (bulk * grown)[:, None] * flows, energy + float(bulk @ grown**2) / 2
        else:
            stiffness = of_law(law, degree)
            share, alone, left, of_load = _eliminated(stiffness, first, pull)
        for sums, values in (
            (load, of_load),
            (softened, np.einsum("nii->ni", stiffness[:, :first, :first] - left)),
        ):
            np.add.at(sums.array.reshape(-1, dim), around, values.reshape(*around.shape, dim))
        energy -= float((pull[:, :, 0] * alone).sum()) / 2
        parts.append(((left + left.swapaxes(1, 2)) / 2, around, inside, share, alone, flows, bulk, grown))
    for sums in (load, softened):
        sums.scatter_reverse(la.InsertMode.add)
    none = np.empty((0, 0), dtype=np.int32)
    matrices, numbers = np.empty((0, 0, 0)), np.empty((0, 0))
    without_cells = [(matrices, none, none, matrices, numbers, numbers, np.empty(0), np.empty(0))]
    matrices, *others = (np.concatenate(each) for each in zip(*(parts or without_cells), strict=True))
    of_nodes = (each.array[: dim * size].copy() for each in (load, softened))
    return Condensed(nodes, matrices, next(of_nodes), energy, next(of_nodes), *others)


def _eliminated(stiffness: Array, first: int, pull: Array) -> tuple[Array, ...]:
    """`share`, `particular`, the stiffness that is left and the load, without unknowns from the first one inside."""
    coupling = stiffness[:, :first, first:]
    right = np.concatenate([stiffness[:, first:, :first], pull], axis=2)
    both = np.linalg.solve(stiffness[:, first:, first:], right)
    share, alone = both[:, :, :-1], both[:, :, -1]
    return share, alone, stiffness[:, :first, :first] - coupling @ share, -np.einsum("noi,ni->no", coupling, alone)


def _incompressible(stiffness: Array, volume: Array, first: int, pull: Array) -> tuple[Array, ...]:
    """The same where `volume` is the stiffness of a bulk modulus that stands for none that is finite inside cells."""
    inner, coupled = slice(first, None), (stiffness + volume)[:, first:, :first]
    inverse = np.linalg.inv((stiffness + volume)[:, inner, inner])
    both = inverse @ np.concatenate([coupled, pull], axis=2)
    given = np.concatenate([volume[:, inner, :first], 0 * pull], axis=2)
    for _ in range(INSIDE):
        both += inverse @ (given - volume[:, inner, inner] @ both)
    share, alone = both[:, :, :-1], both[:, :, -1]
    moved, of_own = stiffness[:, :, inner] @ share, stiffness[:, :, inner] @ alone[:, :, None]
    across = share.swapaxes(1, 2)
    left = stiffness[:, :first, :first] - moved[:, :first] - moved[:, :first].swapaxes(1, 2) + across @ moved[:, inner]
    return share, alone, left, (across @ (of_own[:, inner] - pull) - of_own[:, :first])[:, :, 0]


def _apart(law: Array, cells: tuple[int, ...]) -> tuple[Array, Array, Array]:
    """ℂ without what changes of volume meet, this by its mean on each cell, and the bulk modulus of that.

    Args:
        law: ℂ in points of subcells, shape (subcells, points, entries, entries).
        cells: The shape of the subcells by their cells.
    """
    dim = cells[1] - 1
    modulus, alone, of_volume = law[..., :dim, :dim].mean(axis=(2, 3)), law.copy(), np.zeros_like(law[:, :1])
    alone[..., :dim, :dim] -= modulus[..., None, None]
    means = modulus.reshape(cells[0], -1).mean(axis=1)
    of_volume[..., :dim, :dim] = np.repeat(means, dim + 1)[:, None, None, None]
    return alone, of_volume, means


def _flows(
    split: SplitMesh, space: fem.FunctionSpace, block: Indices, which: Indices, frames: Array, modulus: Array
) -> tuple[Array, Array]:
    """∫ v·n over the boundary of cells for unit coefficients around them, and what stands against it, over |T|.

    Args:
        split: The split mesh.
        space: The displacements on it.
        block: Its subcells by their cells.
        which: Which node of a cell each node of its subcells is.
        frames: Directions of the coefficients around cells.
        modulus: The bulk modulus inside of them.
    """
    dim = block.shape[1] - 1
    around = space.element.basix_element.entity_closure_dofs[-2][-1]  # the last vertex is inside
    vertices = split.mesh.geometry.x[cell_nodes(split.mesh)[block.ravel()], :dim]
    normals = facet_normals(vertices)[:, -1].reshape(*block.shape, dim)
    flows = np.zeros((*frames.shape[:2], dim))
    for subcell, places in enumerate(which):
        flows[:, places[around]] += normals[:, subcell, None] / len(around)
    measure = np.abs(np.linalg.det(vertices[:, 1:] - vertices[:, :1])).reshape(block.shape).sum(axis=1)
    flows = np.einsum("nai,naij->naj", flows, frames).reshape(len(block), -1)
    return flows, BULK / STIFF_VOLUME * modulus * factorial(dim) / measure


def _layout(of_subcells: Indices, nodes: Nodes) -> tuple[Indices, Indices, int]:
    """Which node of a cell each node of its subcells is, those around it first; where each is; how many are around.

    All cells have that of one cell, as their vertices are in the same order.
    """
    inside = nodes.number_of[of_subcells] < 0
    key = of_subcells + len(nodes.number_of) * inside
    _, first, which = np.unique(key, return_index=True, return_inverse=True)
    return which.reshape(key.shape), first, len(first) - int(np.count_nonzero(inside.ravel()[first]))


def _stiffness(
    split: SplitMesh, space: fem.FunctionSpace, block: Indices, which: Indices, frames: Array, law: Array, degree: int
) -> Array:
    """The stiffness of cells whose nodes have these frames, shape (cells, unknowns, unknowns).

    The law is ℂ in points of a quadrature of this degree, or one matrix for each subcell.

    ∫ ∂_kφ ∂_lφ' over the subcells of the reference cell, for all pairs of nodes, is the same for all cells.
    """
    dim, mesh, numbers, pairs = split.mesh.geometry.dim, split.mesh, block.ravel(), entries(split.mesh.geometry.dim)
    element = space.element.basix_element
    points, weights = basix.make_quadrature(element.cell_type, degree)
    gradients = element.tabulate(1, points)[1:, :, :, 0]
    products = np.einsum("q,kqa,lqb->qklab", weights, gradients, gradients)
    if law.shape[1] == 1:
        products = products.sum(axis=0, keepdims=True)
    of_reference = np.zeros((len(which), *products.shape[:3], which.max() + 1, which.max() + 1))
    for each, places in zip(of_reference, which, strict=True):
        each[..., places[:, None], places] = products
    x = mesh.geometry.x[cell_nodes(mesh)[numbers], :dim]
    edges = x[:, 1:] - x[:, :1]
    inverse, strains = np.linalg.inv(edges), np.zeros((len(numbers), 1, dim, dim, len(pairs)))
    for entry, (i, j) in enumerate(pairs):  # of the strain, by component and derivative on the reference cell
        for component, along in {(i, j), (j, i)}:
            strains[:, 0, component, :, entry] = inverse[:, along] * (1 if i == j else np.sqrt(0.5))
    strains = strains.reshape(len(numbers), 1, dim * dim, -1)
    on_subcells = strains @ (np.abs(np.linalg.det(edges))[:, None, None, None] * law) @ strains.swapaxes(2, 3)
    on_subcells = on_subcells.reshape(*block.shape, len(products), dim, dim, dim, dim)
    by_components = on_subcells.transpose(0, 3, 5, 1, 2, 4, 6).reshape(len(block), dim, dim, -1)
    matrices = np.tensordot(by_components, of_reference.reshape(-1, *of_reference.shape[4:]), 1)
    matrices = matrices.transpose(0, 3, 1, 4, 2).copy()
    some = np.flatnonzero((frames != np.eye(dim)).any(axis=(1, 2, 3)))
    matrices[some] = np.einsum("nacbd,naci,nbdj->naibj", matrices[some], frames[some], frames[some], optimize=True)
    return matrices.reshape(len(block), matrices.shape[1] * dim, -1)


def displacement_solver(
    spaces: ElasticSpaces,
    split: SplitMesh,
    space: fem.FunctionSpace,
    nodes: Nodes,
    frames: Array,
    matrix: PETSc.Mat,
    *,
    iterate: bool,
) -> FacetSolver[TraceCoarse]:
    """A solver for displacements at the nodes that are left: a factorisation, or CG with multigrid (collective).

    Args:
        spaces: The spaces.
        split: The split mesh.
        space: The displacements on it.
        nodes: The nodes that are left.
        frames: Directions of the coefficients at all nodes.
        matrix: Its operator.
        iterate: Whether it iterates.

    Raises:
        InputError: If PETSc refuses an option.
    """

    def levels(pc: PETSc.PC) -> TraceCoarse:
        linear = fenicsx.function_space(spaces.mesh, ("Lagrange", 1, (spaces.dim,)))
        interpolation = _from_linear(spaces, split, space, linear, nodes, frames)
        return TraceCoarse(matrix, spaces.dim, linear, interpolation, pc)

    solver = FacetSolver(matrix, "facet_", DEFAULTS[spaces.dim], levels if iterate else None, MOST, tolerance=TOLERANCE)
    if solver.iterates:
        solver.ksp.setNormType(PETSc.KSP.NormType.NATURAL)  # the energy norm of the error, nearly
    return solver


def _from_linear(
    spaces: ElasticSpaces,
    split: SplitMesh,
    space: fem.FunctionSpace,
    linear: fem.FunctionSpace,
    nodes: Nodes,
    frames: Array,
) -> PETSc.Mat:
    """Interpolation of linear displacements at the nodes that are left (collective)."""
    dim, owned = spaces.dim, nodes.numbers.size_local
    ends, shares = np.zeros((len(nodes.of_space), dim), dtype=np.int32), np.zeros((len(nodes.of_space), dim))
    vertices = np.take_along_axis(cell_dofs(linear), spaces.order, axis=1)
    for some, corners, weights in _between_vertices(split, space, nodes):
        ends[some], shares[some] = vertices[:, None, corners], weights
    made = PETSc.Mat().create(spaces.mesh.comm)
    of_linear = linear.dofmap.index_map
    sizes = [(dim * each.size_local, dim * each.size_global) for each in (nodes.numbers, of_linear)]
    made.setSizes(sizes, bsize=dim)
    made.setType("aij")
    rows = (dim * nodes.numbers.local_range[0] + np.arange(dim * owned)).reshape(owned, 1, dim, 1)
    columns = of_linear.local_to_global(ends[:owned].ravel()).reshape(owned, dim, 1, 1) * dim + np.arange(dim)
    values = frames[nodes.of_space[:owned]].swapaxes(1, 2)[:, None] * shares[:owned, :, None, None]
    places = (np.broadcast_to(each, values.shape).ravel().astype(PETSc.IntType) for each in (rows, columns))
    made.setPreallocationCOO(*places)
    made.setValuesCOO(values.ravel(), PETSc.InsertMode.ADD_VALUES)
    return made


def _between_vertices(
    split: SplitMesh, space: fem.FunctionSpace, nodes: Nodes
) -> Iterator[tuple[npt.NDArray[np.int32], Indices, Array]]:
    """For each facet of cells its nodes in all of these, its vertices, and the places of the nodes between them.

    The shapes are (cells, nodes), (d,) and (nodes, d).
    """
    element = space.element.basix_element
    places = exponents(element.cell_type, element.degree) / element.degree
    around = element.entity_closure_dofs[-2][-1]  # the last vertex is inside
    for subcell, facet in enumerate(opposite(split.mesh.geometry.dim)):
        yield nodes.number_of[space.dofmap.list[split.cells[:, subcell]][:, around]], facet, places[around, :-1]


def means_at_nodes(split: SplitMesh, space: fem.FunctionSpace, nodes: Nodes, u: Array) -> Array:
    """Means over cells of displacements linear on each cell, at the owned nodes that are left (collective).

    Args:
        split: The split mesh.
        space: Displacements on it, by Bernstein coefficients.
        nodes: The nodes that are left.
        u: Values at the vertices of the cells, as in `ElasticSpaces.order`, shape (cells, d + 1, d).
    """
    between = [(rows, weights @ u[:, corners]) for rows, corners, weights in _between_vertices(split, space, nodes)]
    numbers, values = (np.concatenate(each) for each in zip(*between, strict=True))
    sums, count = sums_at(nodes.numbers, numbers, values), sums_at(nodes.numbers, numbers)
    return (sums / count[:, None])[: nodes.numbers.size_local]
