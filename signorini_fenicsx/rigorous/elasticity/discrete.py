"""A discrete stress and displacement with the data of their problem, as arrays and trees on one process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.expressions import TREES, Tree, exactly
from signorini_fenicsx.expressions.intervals import Elementary
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.physics.elasticity.bound.hidden import loads_of
from signorini_fenicsx.physics.elasticity.problem import NORMAL
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.vector_datum import PressureDatum
from signorini_fenicsx.rigorous.discrete import Cells, alike, gathered_rows

NONE = -1


@dataclass(frozen=True)
class ElasticDiscrete(Cells):
    """A mesh with a stress, a displacement and the data.

    The vertices of cells and facets are in one order, that of `ElasticSpaces.order`. Facet i of a cell is opposite to
    its vertex i, and of the subcell i, whose last vertex is the centroid. Data are numbers of `Given.trees`, NONE where
    there is none.

    Attributes:
        stresses: σ_h at the vertices of the subcells, shape (cells, d + 1, d + 1, d, d).
        v: Coefficients of a quadratic displacement on each subcell in Bernstein's basis, vertices first, then edges as
            in `simplices.EDGES`, shape (cells, d + 1, coefficients, d).
        nodes: Their numbers, the same for the same node, shape (cells, d + 1, coefficients).
        material: E and ν, shape (cells, 2).
        force: f, shape (cells, d).
        displacement: u_D, in each component, on each facet, shape (cells, d + 1, d).
        traction: g_N likewise.
        pressure: The pressure where that is given, shape (cells, d + 1).
        gap: g on Γ_C, shape (cells, d + 1).
    """

    stresses: Array
    v: Array
    nodes: Indices
    material: Indices
    force: Indices
    displacement: Indices
    traction: Indices
    pressure: Indices
    gap: Indices


@dataclass(frozen=True)
class Given:
    """The data of a problem.

    Attributes:
        trees: All texts and numbers.
        in_strain: Whether the body is in space or in plane strain.
        elementary: Proven bounds of exp, sin, ….
    """

    trees: tuple[Tree, ...]
    in_strain: bool
    elementary: Elementary

    def each(self, numbers: Indices) -> Iterator[tuple[Tree, Mask]]:
        """The trees that occur among some numbers, each with the mask of its places."""
        for number in np.unique(numbers[numbers != NONE]).tolist():
            yield self.trees[number], numbers == number


@dataclass
class _Collected:
    """The trees of the data, the same on all ranks."""

    trees: list[Tree] = field(default_factory=lambda: [exactly(0)])
    unread: list[str] = field(default_factory=list)

    def number(self, tree: object) -> int:
        """The number of a tree."""
        assert isinstance(tree, TREES)
        if tree not in self.trees:
            self.trees.append(tree)
        return self.trees.index(tree)

    def in_cells(self, data: Iterable[Datum], name: str, cells: int) -> Indices:
        """The numbers of some data in so many cells, shape (cells, data)."""
        columns = []
        for datum in data:
            column = np.full(cells, NONE)
            if datum.pieces is None:
                self.unread.append(name)
            for tree, inside in datum.pieces or ():
                column[slice(None) if inside is None else inside[:cells]] = self.number(tree)
            columns.append(column)
        return np.stack(columns, axis=1)

    def on_facets(self, datum: Datum, name: str, facets: npt.NDArray[np.int32]) -> Indices:
        """The numbers of a datum on facets; it is 0 on those for which none is given."""
        found = np.zeros(len(facets), dtype=np.int64)
        for mask, part in datum.by_facets(facets):
            if part.pieces is None:
                self.unread.append(name)
            for tree, _ in part.pieces or ():
                found[mask] = self.number(tree)
        return found


def gathered(
    solution: ElasticSolution, v: fem.Function, elementary: Elementary
) -> tuple[ElasticDiscrete, Given] | None:
    """Gather a solution, a quadratic displacement on its split mesh and the data on rank 0 (collective).

    Args:
        solution: The solution.
        v: The displacement by its coefficients in Bernstein's basis, as in `Certificate.v`.
        elementary: Bounds of exp, sin, ….

    Returns:
        All as arrays on rank 0, with the cells in their original order; None on other ranks.

    Raises:
        InputError: If a datum is not an expression.
    """
    spaces, data = solution.spaces, solution.data
    cells, dim, collected = len(spaces.order), spaces.dim, _Collected()
    material = collected.in_cells((data.material.young[0], data.material.poisson[0]), "young or poisson", cells)
    force = collected.in_cells(data.f.scalars, "f", cells)
    on_facets = cells, dim + 1
    displacement, traction = (np.full((*on_facets, dim), NONE) for _ in range(2))
    pressure, gap = (np.full(on_facets, NONE) for _ in range(2))
    for facets, datum in loads_of(spaces, data):
        target = pressure[..., None] if isinstance(datum, PressureDatum) else traction
        for k, scalar in enumerate(datum.scalars):
            target[facets.cells, facets.local, k] = collected.on_facets(scalar, datum.name, facets.facets)
    for facets, _, letter in spaces.fixed:
        if letter == NORMAL:
            flat = np.ptp(facets.vertices, axis=1) == 0
            along = np.argmax(flat, axis=1)
            collected.unread += [] if flat.any(axis=1).all() else ["u_D along normals that are no axes"]
        else:
            along = np.full(len(facets.facets), AXES.index(letter))
        for axis, component in enumerate(data.u_D.scalars):
            mine = np.flatnonzero(along == axis)
            numbers = collected.on_facets(component, "u_D", facets.facets[mine])
            displacement[facets.cells[mine], facets.local[mine], axis] = numbers
    contact = spaces.contact
    gap[contact.cells, contact.local] = collected.on_facets(data.gap, "gap", contact.facets)
    unread = sorted({name for names in spaces.mesh.comm.allgather(collected.unread) for name in names})
    if unread:
        raise InputError(f"{', '.join(unread)} must be an expression, as in a case file")
    space = v.function_space
    local = space.dofmap.list[spaces.split.cells]
    numbers = space.dofmap.index_map.local_to_global(local.ravel().astype(np.int32)).reshape(local.shape)
    whole = gathered_rows(
        spaces,
        spaces.nodes,
        {
            "stresses": solution.stresses,
            "v": v.x.array.reshape(-1, dim)[local],
            "nodes": numbers,
            "material": material,
            "force": force,
            "displacement": displacement,
            "traction": traction,
            "pressure": pressure,
            "gap": gap,
        },
    )
    if whole is None:
        return None
    names = ("vertices", "corners", "facets", "stresses", "nodes", "material", "force", "displacement", "traction")
    same = {name: whole[name] for name in (*names, "pressure", "gap")}
    discrete = ElasticDiscrete(**same, v=alike(whole["nodes"], whole["v"]))
    return discrete, Given(tuple(collected.trees), dim == 3 or data.material.in_strain, elementary)
