"""Gmsh on one file, as a program of its own: `python gmsh_worker.py SOURCE TARGET H MAX_CELLS`, H = 0 for none.

A malformed file can crash Gmsh, and a program cannot survive that; so the ranks of a run ask another process. It writes
a NumPy file with the points, the elements by entity, and the physical groups, or says in one line what went wrong.
"""

import itertools
import json
import sys
from typing import Any

import gmsh
import numpy as np

KINDS = {15: "vertex", 1: "line", 2: "triangle", 4: "tetra"}
"""Gmsh's numbers of first-order simplices, and meshio's names."""


def main(source: str, target: str, h: float | None, max_cells: float) -> None:
    """Read a mesh, or make one from a `.geo` file, and write it as arrays."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.open(source)
    if source.endswith(".geo"):
        generate(h, max_cells)
    arrays = model_arrays()
    gmsh.finalize()
    np.savez(target, **arrays)


def generate(h: float | None, max_cells: float) -> None:
    """Mesh the model with its own sizes, then with them scaled until the largest cell diameter is at most h."""
    dim = gmsh.model.getDimension()
    if dim < 2:
        raise ValueError("the geometry has no surface and no volume")
    factor = 1.0
    while True:
        gmsh.option.setNumber("Mesh.MeshSizeFactor", factor)
        gmsh.model.mesh.clear()
        gmsh.model.mesh.generate(dim)
        cells = gmsh.model.mesh.getElementsByType({2: 2, 3: 4}[dim])[1]
        if h is None or len(cells) == 0:
            return
        _, points, _ = gmsh.model.mesh.getNodes()
        row = node_rows(cells)
        corners = points.reshape(-1, 3)[row].reshape(-1, dim + 1, 3)
        diameter = max(
            np.linalg.norm(corners[:, a] - corners[:, b], axis=1).max()
            for a, b in itertools.combinations(range(dim + 1), 2)
        )
        if h / 2 < diameter <= h:
            return
        expected = len(corners) * (diameter / h) ** dim
        if expected > max_cells:
            raise ValueError(f"h = {h:g} asks for about {expected:.1e} cells; at most {max_cells:.0e} are made")
        if not 1e-9 < factor < 1e9:
            raise ValueError(f"no mesh of it has its largest cell diameter in ({h / 2:g}, {h:g}]")
        factor *= (0.94 if diameter > h else 0.8) * h / diameter


def node_rows(nodes: np.ndarray) -> np.ndarray:
    """Rows in the array of all nodes."""
    tags = gmsh.model.mesh.getNodes()[0]
    order = np.argsort(tags)
    place = np.minimum(np.searchsorted(tags, nodes, sorter=order), len(tags) - 1)
    if len(tags) == 0 or np.any(tags[order[place]] != nodes):
        raise ValueError("an element has a node that the file does not hold")
    return order[place]


def model_arrays() -> dict[str, Any]:
    """Points, elements by entity and kind as `block_0`, … and what they are as JSON."""
    _, points, _ = gmsh.model.mesh.getNodes()
    arrays: dict[str, Any] = {"points": points.reshape(-1, 3)}
    kinds: list[str] = []
    blocks_of: dict[tuple[int, int], list[int]] = {}
    for entity in gmsh.model.getEntities():
        for kind, _, nodes in zip(*gmsh.model.mesh.getElements(*entity), strict=True):
            name, _, _, count, _, _ = gmsh.model.mesh.getElementProperties(kind)
            blocks_of.setdefault(entity, []).append(len(kinds))
            rows = node_rows(nodes).reshape(-1, count)
            if len(gmsh.model.getPhysicalGroupsForEntity(*entity)) > 1:
                rows = np.unique(rows, axis=0)  # format 2.2 lists an element once for each of its groups
            arrays[f"block_{len(kinds)}"] = rows
            kinds.append(KINDS.get(kind) or name.lower())
    groups = []
    for dim, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dim, tag) or str(tag)
        entities = gmsh.model.getEntitiesForPhysicalGroup(dim, tag)
        groups.append([dim, name, [block for entity in entities for block in blocks_of.get((dim, int(entity)), [])]])
    return arrays | {"about": np.array(json.dumps({"kinds": kinds, "groups": groups}))}


if __name__ == "__main__":
    try:
        main(sys.argv[1], sys.argv[2], float(sys.argv[3]) or None, float(sys.argv[4]))
    except Exception as error:  # Gmsh raises plain exceptions
        sys.exit(" ".join(str(error).split()) or type(error).__name__)
