"""Edges joined to polylines."""

import numpy as np

from signorini_fenicsx.base.arrays import Indices


def chains(edges: Indices) -> list[tuple[Indices, Indices]]:
    """Edges joined end to end.

    Args:
        edges: Vertices of each, shape (edges, 2).

    Returns:
        For each chain the rows of its edges, and its vertices in order, one more than edges. The last vertex of a
        closed chain is its first one.
    """
    around: dict[int, list[int]] = {}
    for row, ends in enumerate(edges.tolist()):
        for vertex in ends:
            around.setdefault(vertex, []).append(row)
    left = set(range(len(edges)))
    ends_of = edges.tolist()
    starts = [row for row, (a, b) in enumerate(ends_of) if len(around[a]) == 1 or len(around[b]) == 1]
    chains = []
    for row in [*starts, *range(len(edges))]:
        if row not in left:
            continue
        a, b = ends_of[row]
        vertices, rows = ([b, a] if len(around[b]) == 1 else [a, b]), [row]
        left.discard(row)
        while (following := next((r for r in around[vertices[-1]] if r in left), None)) is not None:
            left.discard(following)
            rows.append(following)
            a, b = ends_of[following]
            vertices.append(a if b == vertices[-1] else b)
        chains.append((np.array(rows), np.array(vertices)))
    return chains
