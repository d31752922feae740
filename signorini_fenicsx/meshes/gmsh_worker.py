"""The reader of one file by Gmsh. A malformed file can crash Gmsh, so it is a separate process (`file_worker`)."""

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import gmsh
import numpy as np

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.contents import DRAWINGS, Contents

KINDS = {15: "vertex", 1: "line", 2: "triangle", 4: "tetra", 8: "line3", 9: "triangle6", 11: "tetra10"}
KINDS |= {3: "quad", 5: "hexahedron", 6: "wedge", 7: "pyramid"}
"""Gmsh's numbers of elements that are read, and meshio's names."""
FARTHEST = 3e7
"""Gmsh adds points in a surface only if coordinates are at most about so many times as large as the cells."""
STRAIGHT = ("Point", "Line", "Plane", "Volume")
"""Types of entities without curvature."""


def read_with_gmsh(
    source: Path, h: float | None, refined: int, max_cells: float, sizes: Sequence[tuple[str, float]] = ()
) -> Contents:
    """Read a mesh, or make one from a geometry, in a sealed process.

    Args:
        source: The file, in a folder without other files that Gmsh would read too.
        h: Largest cell diameter of a mesh that is made; None for the file's own sizes.
        refined: How often a coarser mesh is refined for that.
        max_cells: Largest number of cells of a mesh that is made.
        sizes: Sizes of cells at entities, by the names of these or of physical groups.

    Raises:
        InputError: If Gmsh cannot do it.
    """
    try:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        gmsh.open(str(source))
        if source.suffix.lower() in DRAWINGS:
            for name, size in sizes:
                gmsh.model.mesh.setSize(_points_of(name), size)
            generate(h, refined, max_cells)
        return model_contents(without_groups=source.suffix.lower() not in (".geo", ".msh"))
    except Exception as error:  # Gmsh raises plain exceptions
        words = " ".join((str(error) or gmsh.logger.getLastError()).split()) or "it does not say why"
        raise InputError(f"Gmsh cannot use it: {re.sub(re.escape(str(source)), source.name, words)}") from error


def generate(h: float | None, refined: int, max_cells: float) -> None:
    """Mesh the model with its own sizes; for an h, scale the sizes until the largest cell diameter is at most h.

    Meshes after the first one are refined so many times; their new points are on the geometry.
    """
    dim = gmsh.model.getDimension()
    if dim < 2:
        raise ValueError("the geometry has no surface and no volume")
    box = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
    largest, size = np.abs(box).max(), h or np.ptp(box, axis=0).max()
    if largest > FARTHEST * size:
        raise ValueError(
            f"its coordinates are up to {largest:.4g}, too far from 0 for a size of {size:.3g}: measure them from a "
            "point of the domain"
        )
    factor, levels = 1.0, 0
    while True:
        gmsh.option.setNumber("Mesh.MeshSizeFactor", factor)
        gmsh.model.mesh.clear()
        gmsh.model.mesh.generate(dim)
        for _ in range(levels):
            gmsh.model.mesh.refine()
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
        factor *= (0.94 if diameter > h else 0.8) * h / diameter * 2 ** (refined - levels)
        levels = refined


def node_rows(nodes: np.ndarray) -> np.ndarray:
    """Rows of these nodes in the array of all nodes."""
    tags = gmsh.model.mesh.getNodes()[0]
    order = np.argsort(tags)
    place = np.minimum(np.searchsorted(tags, nodes, sorter=order), len(tags) - 1)
    if len(tags) == 0 or np.any(tags[order[place]] != nodes):
        raise ValueError("an element has a node that is not in the file")
    return order[place]


def model_contents(*, without_groups: bool = False) -> Contents:
    """Points, elements by entity and kind, and the physical groups.

    Args:
        without_groups: Whether the file's format knows no physical groups. If there are none, each solid, face and edge
            is a group, with its label in the file or a number, such as "face3".
    """
    _, points, _ = gmsh.model.mesh.getNodes()
    blocks: list[tuple[str, np.ndarray]] = []
    blocks_of: dict[tuple[int, int], list[int]] = {}
    for entity in gmsh.model.getEntities():
        for kind, _, nodes in zip(*gmsh.model.mesh.getElements(*entity), strict=True):
            name, _, _, count, _, _ = gmsh.model.mesh.getElementProperties(kind)
            blocks_of.setdefault(entity, []).append(len(blocks))
            rows = node_rows(nodes).reshape(-1, count).astype(np.int64)
            if len(gmsh.model.getPhysicalGroupsForEntity(*entity)) > 1:
                rows = np.unique(rows, axis=0)  # format 2.2 lists an element once for each of its groups
            blocks.append((KINDS.get(kind) or name.lower(), rows))
    groups = []
    for dim, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dim, tag) or str(tag)
        entities = gmsh.model.getEntitiesForPhysicalGroup(dim, tag)
        members = [block for entity in entities for block in blocks_of.get((dim, int(entity)), [])]
        groups.append((name, dim, [(block, np.arange(len(blocks[block][1]))) for block in members]))
    if not groups and without_groups:
        groups = [
            (_label(dim, tag), dim, [(block, np.arange(len(blocks[block][1]))) for block in members])
            for (dim, tag), members in blocks_of.items()
            if dim > 0
        ]
    straight = all(gmsh.model.getType(*entity) in STRAIGHT for entity in gmsh.model.getEntities())
    return Contents(points.reshape(-1, 3), blocks, groups, straight)


def _label(dim: int, tag: int) -> str:
    """The name of an entity: the last part of its label in the file, or its kind and number."""
    return gmsh.model.getEntityName(dim, tag).rpartition("/")[2] or f"{('edge', 'face', 'solid')[dim - 1]}{tag}"


def _points_of(name: str) -> list[tuple[int, int]]:
    """The points of the entities with this name, or in physical groups with it."""
    physical = gmsh.model.getPhysicalGroups()
    groups = [group for group in physical if name in (gmsh.model.getPhysicalName(*group), str(group[1]))]
    found = [(dim, tag) for dim, number in groups for tag in gmsh.model.getEntitiesForPhysicalGroup(dim, number)]
    found += [entity for entity in gmsh.model.getEntities() if entity[0] > 0 and _label(*entity) == name]
    if not found:
        raise ValueError(f"sizes: there is no part or region '{name}'")
    return gmsh.model.getBoundary(found, combined=False, oriented=False, recursive=True)
