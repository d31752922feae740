"""Checks of what a mesh file contains, and the mesh for computations; each error is one sentence.

Checks compare lengths only with lengths, so they do not depend on the unit of length. All functions run on rank 0.
"""

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, rows_of
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.rows import joined
from signorini_fenicsx.base.text import counted, place_in_words
from signorini_fenicsx.meshes.contents import SIMPLICES, Contents, check_widths, faces, straightened
from signorini_fenicsx.meshes.domain import other_side
from signorini_fenicsx.meshes.other_cells import in_simplices

FLAT = 1e-14
"""A cell whose volume is below this share of diameter^dim is degenerate."""
PLANAR = 1e-10
"""Largest distance of a planar mesh from its plane, relative to its size."""


@dataclass(frozen=True)
class FileMesh:
    """A mesh of triangles or tetrahedra that has passed `checked`.

    Attributes:
        points: Shape (points, dim); every point is used.
        cells: Shape (cells, dim + 1).
        parts: For each group of facets its facets as ascending vertices, shape (facets, dim).
        regions: For each group of cells the numbers of its cells.
        straight: Whether uniform refinement of the mesh keeps the geometry.
        together: Pairs of cells at the two sides of a cut, which have to be on one rank; None if there is no cut.
        values: Values of the file at the points by their names.
        changed: What has become of other cells than simplices of first order, in words.
    """

    points: Array
    cells: Indices
    parts: Mapping[str, Indices]
    regions: Mapping[str, Indices]
    straight: bool = False
    together: Indices | None = None
    values: Mapping[str, Array] = field(default_factory=dict)
    changed: str = ""

    @property
    def dim(self) -> int:
        """Dimension, 2 or 3."""
        return self.points.shape[1]


def checked(contents: Contents) -> FileMesh:
    """Make the mesh from the contents of a file.

    Raises:
        InputError: If it is not a conforming mesh of straight triangles in a plane or straight tetrahedra.
    """
    contents, others = in_simplices(contents)
    cut = [f"the {others} of the mesh file are cut into simplices"] if others else []
    blocks = [straightened(contents.points, *block) for block in contents.blocks]
    second = [
        len(rows) for (kind, rows), (now, _) in zip(contents.blocks, blocks, strict=True) if kind != now != "line"
    ]
    straight = ["the elements of second order of the mesh file have straight edges, and are taken as linear ones"]
    straight = straight if sum(second) else []
    contents = replace(contents, blocks=blocks)
    for kind, elements in blocks:
        if kind not in SIMPLICES and len(elements) > 0:
            raise InputError(_refusal(kind, len(elements)))
    check_widths(contents.points, contents.blocks)
    dim = max((SIMPLICES[kind] for kind, elements in contents.blocks if len(elements) > 0), default=0)
    if dim < 2:
        raise InputError(
            "holds neither triangles nor tetrahedra; in Gmsh, give the surface or volume a physical group too"
        )
    cell_blocks = [i for i, (kind, elements) in enumerate(contents.blocks) if SIMPLICES.get(kind) == dim]
    cells = np.concatenate([contents.blocks[i][1] for i in cell_blocks])
    everything = [elements for kind, elements in contents.blocks if SIMPLICES.get(kind) in (dim - 1, dim)]
    if any(np.any((elements < 0) | (elements >= len(contents.points))) for elements in everything):
        raise InputError("an element has a point that is not in the file")
    used, numbered = np.unique(cells, return_inverse=True)
    points = _in_its_space(contents.points[used], dim)
    new_number = np.full(len(contents.points), -1)
    new_number[used] = np.arange(len(used))

    offsets = dict(
        zip(cell_blocks, np.cumsum([0] + [len(contents.blocks[i][1]) for i in cell_blocks]).tolist()[:-1], strict=True)
    )
    regions: dict[str, list[Indices]] = {}
    parts: dict[str, list[Indices]] = {}
    for name, group_dim, members in contents.groups:
        if group_dim == dim:
            regions.setdefault(name, []).extend(offsets[block] + rows for block, rows in members)
        elif group_dim == dim - 1:
            parts.setdefault(name, []).extend(new_number[contents.blocks[block][1][rows]] for block, rows in members)
    mesh = FileMesh(
        points,
        numbered.reshape(-1, dim + 1),
        {name: np.unique(np.sort(_joined(rows, dim), axis=1), axis=0) for name, rows in parts.items()},
        {name: np.unique(_joined(rows)) for name, rows in regions.items()},
        contents.straight,
        values={name: values[used] for name, values in contents.values.items() if len(values) == len(contents.points)},
        changed="; ".join([*cut, *straight]),
    )
    _check_cells(mesh)
    return mesh


def _joined(rows: Sequence[Indices], width: int | None = None) -> Indices:
    empty = np.empty(0 if width is None else (0, width), dtype=np.int64)
    return np.concatenate([empty, *rows])


def _refusal(kind: str, count: int) -> str:
    if kind.startswith(("line", "triangle", "tetra")):
        elements = counted(count, "curved element")
        return f"holds {elements} ('{kind}'); make a first-order mesh (in Gmsh, Mesh.ElementOrder = 1)"
    elements = counted(count, "element")
    others = "quadrilaterals, hexahedra, wedges and pyramids"
    return f"holds {elements} of kind '{kind}'; only triangles, tetrahedra, {others} are read, with their corners alone"


def _in_its_space(points: Array, dim: int) -> Array:
    if not np.isfinite(points).all():
        raise InputError("a point has a coordinate that is not a number, or infinite")
    size = np.ptp(points, axis=0)
    if points.shape[1] > dim and size[dim:].max() > PLANAR * size.max():
        raise InputError("its triangles do not lie in a plane z = const; a surface in space is not a domain")
    if not 1e-60 < size[:dim].max() < 1e60:
        raise InputError(f"its size is {size.max():.3g}, outside 1e-60 … 1e60; choose another unit of length")
    return points[:, :dim]


def neighbours(everything: Indices) -> tuple[Indices, Indices]:
    """Pairs of equal rows of an array of facets; three equal rows give two pairs, with one row in common."""
    order = np.lexsort(everything.T)
    same = np.all(everything[order[1:]] == everything[order[:-1]], axis=1)
    return order[:-1][same], order[1:][same]


def diameters(points: Array, cells: Indices) -> Array:
    """Longest edge of each cell."""
    pairs = itertools.combinations(range(cells.shape[1]), 2)
    edges = [np.linalg.norm(points[cells[:, a]] - points[cells[:, b]], axis=1) for a, b in pairs]
    return np.max(edges, axis=0)


def _check_cells(mesh: FileMesh) -> None:
    """Refuse cells that are flat, listed twice or folded, and more than two cells at a facet."""
    points, cells = mesh.points, mesh.cells
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    longest = diameters(points, cells)
    scale = np.where(longest > 0, longest, 1.0)
    volumes = np.linalg.det(edges / scale[:, None, None])
    flat = np.flatnonzero((np.abs(volumes) <= FLAT) | (longest == 0))
    if len(flat) > 0:
        raise InputError(
            f"{counted(len(flat), 'cell')} without volume, the first with vertices {_places(points[cells[flat[0]]])}"
        )
    distinct, times = np.unique(np.sort(cells, axis=1), axis=0, return_counts=True)
    if len(distinct) < len(cells):
        raise InputError(f"{counted(int(np.sum(times > 1)), 'cell')} listed more than once")
    everything = faces(cells)
    one, other = neighbours(everything)
    third = np.flatnonzero(np.isin(one, other))
    if len(third) > 0:
        place = points[everything[one[third[0]]]]
        raise InputError(f"more than two cells meet at the facet with vertices {_places(place)}")
    folded = np.flatnonzero(_side(points, cells, everything, one) * _side(points, cells, everything, other) > 0)
    if len(folded) > 0:
        place = points[everything[one[folded[0]]]]
        raise InputError(
            f"{counted(len(folded), 'pair')} of neighbouring cells overlap (inverted or folded cells), the first at "
            f"the facet with vertices {_places(place)}"
        )


def _side(points: Array, cells: Indices, everything: Indices, chosen: Indices) -> Array:
    """The side of a facet on which its cell is, as a sign; the order of the facet's vertices defines the sides."""
    opposite, cell = np.divmod(chosen, len(cells))
    corners = points[everything[chosen]]
    apex = points[cells[cell, opposite]]
    spans = np.concatenate([corners[:, 1:] - corners[:, :1], (apex - corners[:, 0])[:, None]], axis=1)
    return np.sign(np.linalg.det(spans / np.abs(spans).max(axis=(1, 2), keepdims=True)))


def _places(points: Array) -> str:
    return ", ".join(place_in_words(point, 6) for point in points)


def left_over(mesh: FileMesh, listed: Collection[str]) -> dict[str, int]:
    """The number of facets of the boundary outside the listed parts, by the part that has them, "" for none."""
    rows, times = np.unique(faces(mesh.cells), axis=0, return_counts=True)
    left, named = times == 1, np.zeros(len(rows), dtype=bool)
    of_parts = {name: rows_of_part[rows_of_part >= 0] for name, rows_of_part in _rows_of_parts(mesh, rows).items()}
    for name, rows_of_part in of_parts.items():
        named[rows_of_part] = True
        if name in listed:
            left[rows_of_part] = False
    others = {name: int(left[rows_of_part].sum()) for name, rows_of_part in of_parts.items() if name not in listed}
    return others | {"": int((left & ~named).sum())}


def check_boundary(mesh: FileMesh, conditions: Mapping[str, Sequence[str]]) -> None:
    """Refuse boundary parts that do not define a problem.

    Args:
        mesh: The mesh.
        conditions: Parts of each kind of condition: "signorini", "neumann", "dirichlet", "inner" or "law.0.parts".
            Without "dirichlet", all other facets are Γ_D. An inner part has two sides, and may be in a law too.

    Raises:
        InputError: If a part is unknown, empty or not on the boundary; if two parts overlap or a facet is in no part
            although Γ_D is listed; if one of several components of the domain has no facet of Γ_D, unless there are
            parts inside: their laws may hold it.
    """
    known_names = ", ".join(map(repr, mesh.parts)) or "none: the file has no groups of facets"
    everything = faces(mesh.cells)
    rows, first, times = np.unique(everything, axis=0, return_index=True, return_counts=True)
    of_parts, owner = _rows_of_parts(mesh, rows), np.full(len(rows), -1)
    used: list[str] = []
    for section, names in conditions.items():
        key = key_of(section)
        for name in [other_side(name) for name in names] if section == "inner" else names:
            place = f"{key}: part '{name}'"
            if name not in mesh.parts:
                raise InputError(f"{key}: unknown part '{name}'; the mesh has {known_names}")
            facets = of_parts[name]
            if len(facets) == 0:
                raise InputError(f"{place} is empty")
            if np.any(facets < 0):
                raise InputError(f"{place} has {counted(int(np.sum(facets < 0)), 'facet')} without a cell")
            if np.any(times[facets] > 1):
                raise InputError(f"{place} has {counted(int(np.sum(times[facets] > 1)), 'facet')} inside the domain")
            taken = owner[facets]
            if np.any(taken >= 0):
                other = used[taken[taken >= 0][0]]
                raise InputError(f"{place} and '{other}' share {counted(int(np.sum(taken >= 0)), 'facet')}")
            owner[facets] = len(used)
            used.append(name)
    boundary = times == 1
    left = boundary & (owner < 0)
    given = conditions.get("dirichlet")
    if given is not None and np.any(left):
        where = _places(mesh.points[rows[np.flatnonzero(left)[:1]]].mean(axis=1))
        raise InputError(f"[boundary]: {counted(int(left.sum()), 'facet')} in no part, the first around {where}")
    between = conditions.get("inner") or any(key.startswith("pair.") for key in conditions)
    if "contact" not in conditions and not between:  # otherwise laws may hold a component
        held = [used.index(name) for name in given or conditions.get("problem.u_D", ())]
        fixed = np.isin(owner, held) | (left & (given is None))
        _check_components(mesh, everything, first[fixed])


def _rows_of_parts(mesh: FileMesh, rows: Indices) -> dict[str, Indices]:
    """The number of each facet of each part among these rows, −1 if it is not there."""
    places = rows_of(_joined(list(mesh.parts.values()), mesh.dim), rows)
    return dict(zip(mesh.parts, np.split(places, np.cumsum([len(part) for part in mesh.parts.values()])), strict=False))


def key_of(section: str) -> str:
    """How a case file names the list of the parts with one kind of condition."""
    place, _, key = section.rpartition(".")
    return section if place.startswith(("law.", "pair.")) else f"[{place or 'boundary'}] {key}"


def _check_components(mesh: FileMesh, everything: Indices, fixed: Indices) -> None:
    """Refuse a component of several without a facet of Γ_D; `fixed` are the rows of Γ_D in the facets of all cells."""
    size = len(mesh.cells)
    component = joined(size, np.stack(neighbours(everything), axis=1) % size)
    count = int(component.max(initial=-1)) + 1
    free = np.setdiff1d(np.arange(count), component[fixed % size])
    if count > 1 and len(free) > 0:
        centre = mesh.points[mesh.cells[np.flatnonzero(component == free[0])[:1]]].mean(axis=1)
        raise InputError(
            f"the domain has {count} components that do not meet in facets, and the one around {_places(centre)} has "
            "no Dirichlet facet"
        )
