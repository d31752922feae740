"""Tables of what was read off of a solution; lines of the plane and surfaces in space as XDMF, too: text alone."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.cases.units import TABLES, with_units
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.output.tables import write_columns
from signorini_fenicsx.solving.solved import Columns

KINDS = {"line": ("Polyline", 2), "triangle": ("Triangle", 3)}
"""The first column of a table of points, how XDMF calls the pieces, and how many points one has."""


def write_readings(
    folder: Path, name: str, times: Sequence[tuple[float | None, Columns]], units: Mapping[str, str]
) -> None:
    """Write a table at each time below each other, those of probes and sections with units (rank 0).

    One that has the points of lines or of triangles is written as XDMF, too.
    """
    tables = [table for _, table in times]
    write_columns(folder / f"{name}.csv", [with_units(each, units) for each in tables] if name in TABLES else tables)
    if tables[0].keys() & KINDS.keys():
        _write_outlines(folder / f"{name}.xdmf", times)


def _write_outlines(path: Path, times: Sequence[tuple[float | None, Columns]]) -> None:
    """Write the lines or triangles at each time that has some, if one has; without a time there is one (rank 0)."""
    root = ElementTree.Element("Xdmf", Version="3.0")
    domain = ElementTree.SubElement(root, "Domain")
    about = {"Name": path.stem, "GridType": "Collection", "CollectionType": "Temporal"}
    series = ElementTree.SubElement(domain, "Grid", about)
    for t, table in times:
        (word,) = table.keys() & KINDS.keys()
        kind, size = KINDS[word]
        points = np.column_stack([table[axis] for axis in AXES if axis in table])
        number = table[word]
        first = np.flatnonzero(number[:-1] == number[1:]) if size == 2 else np.arange(0, len(number), size)
        if not len(first):
            continue
        grid = ElementTree.SubElement(series, "Grid", Name=path.stem, GridType="Uniform")
        ElementTree.SubElement(grid, "Time", Value=repr(t or 0.0))
        look = {"TopologyType": kind, "NumberOfElements": str(len(first)), "NodesPerElement": str(size)}
        topology = ElementTree.SubElement(grid, "Topology", look)
        topology.append(_item(first[:, None] + np.arange(size), "Int"))
        geometry = ElementTree.SubElement(grid, "Geometry", GeometryType="XYZ"[: points.shape[1]])
        geometry.append(_item(points, "Float"))
    if not len(series):  # readers need something
        return
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _item(values: Array | Indices, kind: str) -> ElementTree.Element:
    """An array as text."""
    about = {"Dimensions": " ".join(map(str, values.shape)), "NumberType": kind, "Precision": "8", "Format": "XML"}
    item = ElementTree.Element("DataItem", about)
    item.text = "\n".join(" ".join(map(repr, row)) for row in values.tolist())
    return item
