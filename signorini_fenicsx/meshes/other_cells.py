"""Quadrilaterals, hexahedra, wedges and pyramids cut into simplices, by the numbers of their vertices alone.

The vertex with the smallest number is joined to the simplices of all faces that it is not on, which are cut in the
same way. So two cells cut a common face alike, whatever they are.
"""

from dataclasses import replace

import numpy as np

from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.meshes.contents import DIMENSION, Contents

FACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "hexahedron": ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "wedge": ((0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "pyramid": ((0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
}
"""The faces of each kind, with meshio's names and order of vertices; those of a face go around it."""
PLURALS = {"quad": "quadrilaterals", "hexahedron": "hexahedra", "wedge": "wedges", "pyramid": "pyramids"}
INTO = {"quad": "triangle", "hexahedron": "tetra", "wedge": "tetra", "pyramid": "tetra"}


def in_simplices(contents: Contents) -> tuple[Contents, str]:
    """The contents of a file with simplices in the place of other cells, and which these are, in words.

    Groups have all simplices of the elements that they had.
    """
    blocks, shares, counts = [], [], dict[str, int]()
    for kind, elements in contents.blocks:
        cut = simplices_of(kind, elements) if kind in FACES and elements.size else None
        shares.append(1 if cut is None else cut.shape[1])
        blocks.append((kind, elements) if cut is None else (INTO[kind], cut.reshape(-1, cut.shape[2])))
        if cut is not None:
            counts[kind] = counts.get(kind, 0) + len(elements)
    groups = [
        (name, dim, [(block, _each(rows, shares[block])) for block, rows in members])
        for name, dim, members in contents.groups
    ]
    top = max((DIMENSION[kind] for kind in counts), default=0)
    words = ", ".join(f"{n} {PLURALS[kind]}" for kind, n in counts.items() if DIMENSION[kind] == top)
    return replace(contents, blocks=blocks, groups=groups), words


def _each(rows: Indices, share: int) -> Indices:
    """The rows of all simplices of some elements."""
    return (rows[:, None] * share + np.arange(share)).ravel()


def simplices_of(kind: str, elements: Indices) -> Indices:
    """The simplices of elements of one kind, shape (elements, simplices of each, vertices)."""
    lowest, cut = elements.argmin(axis=1), None
    for vertex in range(elements.shape[1]):
        of = np.flatnonzero(lowest == vertex)
        parts = list[Indices]()
        for face in FACES[kind]:
            if vertex not in face:
                corners = elements[of][:, list(face)]
                parts.append(simplices_of("quad", corners) if len(face) == 4 else corners[:, None])
        simplices = np.concatenate(parts, axis=1)
        tops = np.broadcast_to(elements[of, vertex][:, None, None], (*simplices.shape[:2], 1))
        cut = np.empty((len(elements), simplices.shape[1], simplices.shape[2] + 1), np.int64) if cut is None else cut
        cut[of] = np.concatenate([tops, simplices], axis=2)
    assert cut is not None
    return cut
