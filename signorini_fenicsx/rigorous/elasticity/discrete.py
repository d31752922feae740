"""A discrete stress and displacement with the data of their problem, as arrays and trees on one process."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.datum import Datum, datum_of
from signorini_fenicsx.discrete.linear_traces import opposite
from signorini_fenicsx.discrete.vectors import PressureDatum
from signorini_fenicsx.expressions import TREES, Tree, exactly
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.expressions.intervals import Elementary
from signorini_fenicsx.forms.elasticity import pairs
from signorini_fenicsx.physics.elasticity.bound.hidden import loads_of
from signorini_fenicsx.physics.elasticity.conditions import CoulombLaw
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.rigorous.discrete import MeshCells, alike, gathered_rows

NONE = -1


@dataclass(frozen=True)
class ElasticDiscrete(MeshCells):
    """A mesh with a stress, a displacement and the data.

    The vertices of cells and facets are in one order, that of `ElasticSpaces.order`. Facet i of a cell is opposite to
    its vertex i, and of the subcell i, whose last vertex is the centroid. Data are numbers of `Given.trees`, NONE where
    there is none.

    Attributes:
        stresses: σ_h at the vertices of the subcells, shape (cells, d + 1, d + 1, d, d).
        v: Coefficients of a quadratic displacement on each subcell in Bernstein's basis, vertices first, then edges as
            in `EDGES` of `base.reference_cells`, shape (cells, d + 1, coefficients, d).
        nodes: Their numbers, the same for the same node, shape (cells, d + 1, coefficients).
        material: E and ν, shape (cells, 2).
        own: The entries of the eigenstrain, as in `forms.elasticity.pairs` without weights, and in the plane its zz.
        force: f, shape (cells, d).
        displacement: u_D, in each component, on each facet, shape (cells, d + 1, d).
        traction: g_N likewise.
        pressure: The pressure where that is given, shape (cells, d + 1).
        gap: g on Γ_C, shape (cells, d + 1).
        rubbing: The bound of the shear where that is given, shape (cells, d + 1).
        bound: Its values at the vertices of facets where it is by the pressure, 0 elsewhere, shape (cells, d + 1, d).
        pair: Where two bodies touch a number of the two facets, of which the named one has a gap, shape (cells, d + 1).
    """

    stresses: Array
    v: Array
    nodes: Indices
    material: Indices
    own: Indices
    force: Indices
    displacement: Indices
    traction: Indices
    pressure: Indices
    gap: Indices
    rubbing: Indices
    bound: Array
    pair: Indices

    @property
    def pairs(self) -> tuple[Mask, tuple[Indices, Indices]]:
        """Which of the facets with a gap touch another body, and the facets of that: their cells and local numbers."""
        named = self.gap != NONE
        touching = self.pair[named] != NONE
        other = np.nonzero((self.pair != NONE) & ~named)
        order = np.argsort(self.pair[other])[np.argsort(np.argsort(self.pair[named][touching]))]
        return touching, (other[0][order], other[1][order])

    def facet_vertices(self, mask: Mask) -> Array:
        """Vertices of the facets at which a mask of the facets of all cells is True, shape (facets, d, d)."""
        return self.facet_vertices_of(np.nonzero(mask))

    def facet_vertices_of(self, places: tuple[Indices, ...]) -> Array:
        """Vertices of facets given by their cells and local numbers, shape (facets, d, d)."""
        cells, local = places
        return np.asarray(self.vertices[cells[:, None], opposite(self.dim)[local]])


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
            for tree, rows in datum.trees_in(np.arange(cells)):
                column[rows] = self.number(tree)
            columns.append(column)
        return np.stack(columns, axis=1)

    def on_facets(self, datum: Datum, name: str, facets: npt.NDArray[np.int32]) -> Indices:
        """The numbers of a datum on facets; it is 0 on those for which none is given."""
        numbers = np.zeros(len(facets), dtype=np.int64)
        for mask, part in datum.by_facets(facets):
            if part.pieces is None:
                self.unread.append(name)
            for tree, _ in part.pieces or ():
                numbers[mask] = self.number(tree)
        return numbers


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
    spaces, data, collected = solution.spaces, solution.data, _Collected()
    cells, dim = len(spaces.order), spaces.dim
    arrays: dict[str, npt.NDArray[Any]] = {
        "material": collected.in_cells((data.material.young[0], data.material.poisson[0]), "young or poisson", cells),
        "own": _own(solution, collected),
        "force": collected.in_cells(data.f.scalars, "f", cells),
        **_loads(solution, collected),
        **_given(solution, collected),
        **_contact(solution, collected),
    }
    unread = sorted({name for names in spaces.mesh.comm.allgather(collected.unread) for name in names})
    if unread:
        raise InputError(f"{', '.join(unread)} must be an expression, as in a case file")
    space = v.function_space
    local = space.dofmap.list[spaces.split.cells]
    arrays["nodes"] = space.dofmap.index_map.local_to_global(local.ravel().astype(np.int32)).reshape(local.shape)
    arrays["v"] = v.x.array.reshape(-1, dim)[local]
    arrays["stresses"] = solution.stresses
    whole = gathered_rows(spaces, spaces.nodes, arrays)
    if whole is None:
        return None
    whole["v"] = alike(whole["nodes"], whole["v"])
    discrete = ElasticDiscrete(**{each.name: whole[each.name] for each in fields(ElasticDiscrete)})
    return discrete, Given(tuple(collected.trees), dim == 3 or data.material.in_strain, elementary)


def _nowhere(spaces: ElasticSpaces, *shape: int) -> Indices:
    """No datum on any facet."""
    return np.full((len(spaces.order), spaces.dim + 1, *shape), NONE)


def _loads(solution: ElasticSolution, collected: _Collected) -> dict[str, npt.NDArray[Any]]:
    """Tractions and pressures (collective)."""
    spaces = solution.spaces
    traction, pressure = _nowhere(spaces, spaces.dim), _nowhere(spaces)
    for facets, datum in loads_of(spaces, solution.data):
        target = pressure[..., None] if isinstance(datum, PressureDatum) else traction
        for k, scalar in enumerate(datum.scalars):
            target[facets.cells, facets.local, k] = collected.on_facets(scalar, datum.name, facets.facets)
    return {"traction": traction, "pressure": pressure}


def _own(solution: ElasticSolution, collected: _Collected) -> Indices:
    """The eigenstrain in cells."""
    dim, cells = solution.spaces.dim, len(solution.spaces.order)
    entries = pairs(dim)
    found = np.full((cells, len(entries) + 1), NONE)
    for strain in solution.data.material.strains:
        if strain.datum.pieces is None or strain.beyond.pieces is None:
            collected.unread.append(strain.name)
            continue
        for given, rows in strain.datum.pieces_in(np.arange(cells)):
            for k, (i, j) in enumerate(entries):
                if not isinstance(given, TREES):
                    found[rows, k] = collected.number(given[i][j])
                elif i == j:
                    found[rows, k] = collected.number(given)
        if dim == 2:
            found[:, -1:] = collected.in_cells([strain.beyond], strain.name, cells)
    return found


def _given(solution: ElasticSolution, collected: _Collected) -> dict[str, npt.NDArray[Any]]:
    """What is given of u (collective)."""
    spaces = solution.spaces
    displacement = _nowhere(spaces, spaces.dim)
    for facets, k, _, of in spaces.fixed:
        if len(of) > 1:
            flat = np.ptp(facets.vertices, axis=1) == 0
            along = np.argmax(flat, axis=1)
            collected.unread += [] if flat.any(axis=1).all() else ["u_D along normals that are no axes"]
        else:
            along = np.full(len(facets.facets), k)
        for axis, component in enumerate(solution.data.u_D.scalars):
            mine = np.flatnonzero(along == axis)
            numbers = collected.on_facets(component, "u_D", facets.facets[mine])
            displacement[facets.cells[mine], facets.local[mine], axis] = numbers
    return {"displacement": displacement}


def _contact(solution: ElasticSolution, collected: _Collected) -> dict[str, npt.NDArray[Any]]:
    """The gap, the bounds of friction, and which facets touch (collective)."""
    spaces, data, dim = solution.spaces, solution.data, solution.spaces.dim
    gap, rubbing, pair = (_nowhere(spaces) for _ in range(3))
    contact, rough, coulomb = spaces.contact, spaces.rough, data.friction.coulomb
    gap[contact.cells, contact.local] = collected.on_facets(data.gap, "gap", contact.facets)
    for of_law, law in solution.problem.named_laws:
        for part in [] if isinstance(law, CoulombLaw) else law.parts:
            facets, name = spaces.part(part), f"{of_law}.g"
            most = datum_of(spaces, name, parsed(getattr(law, "g"), "xyz"[:dim], name))  # noqa: B009
            rubbing[facets.cells, facets.local] = collected.on_facets(most, name, facets.facets)
    bound = np.zeros((*gap.shape, dim))
    bound[rough.cells[coulomb], rough.local[coulomb]] = data.friction.bound[coulomb]
    named, comm = contact.take(spaces.inner.rows), spaces.mesh.comm
    first = sum(comm.allgather(len(spaces.inner.rows))[: comm.rank])
    for side in (named, spaces.across):
        pair[side.cells, side.local] = first + np.arange(len(side.facets))
    return {"gap": gap, "rubbing": rubbing, "bound": bound, "pair": pair}
