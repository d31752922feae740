"""Fields as XDMF, a text of XML beside the numbers in HDF5, which ParaView, VTK, PyVista and meshio read alone.

The mesh is joined: fields have their means over cells, those that say so also at the points. A facet of Γ_S has points
of its own, at which linear fields are exact. The files of all names and `boundary.xdmf` share `solution.h5`.
"""

from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import dolfinx.mesh
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.array_files import Header, add_to_hdf5
from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_nodes
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.rows import first_row
from signorini_fenicsx.base.shipped import data_folder
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.meshes.domain import Domain, membership
from signorini_fenicsx.pictures.sample import MeansAround
from signorini_fenicsx.solving.fields import IN_CELLS, Field, Fields

XINCLUDE = "http://www.w3.org/2001/XInclude"
BOUNDARY, VIEW = "boundary", "show.py"
KINDS = ("Scalar", "Vector", "Tensor")
SHAPES = {2: "Polyline", 3: "Triangle", 4: "Tetrahedron"}
"""Names of the cells with so many vertices."""

type Element = ElementTree.Element


class Xdmf:
    """The files `<name>.xdmf` of all names of fields. Its methods are collective.

    `region` is the number of a cell's region, `part` that of a facet's part, in the order of the domain; −1 is none.
    """

    def __init__(self, folder: Path, spaces: MeshSpaces):
        """Keep what the files are of; nothing on disk changes."""
        self._folder, self._spaces = folder, spaces
        self._path = folder / f"{IN_CELLS}.h5"
        self._around = MeansAround(spaces.mesh, spaces.nodes)
        self._meshes: dict[str, list[Element]] = {}
        self._times: dict[str, list[tuple[float | None, list[Element]]]] = {}
        self._names: dict[str, dict[str, list[str]]] = {}

    def write(self, t: float | None, fields: Fields) -> None:
        """Write the fields of a time.

        Raises:
            OSError: On all ranks, if the disk is full.
        """
        if not self._meshes:
            self._begin(fields)
        for name, of_file in fields.items():
            shown = [each for field in of_file for each in self._shown(name, field)]
            times = self._times.setdefault(name, [])
            times.append((t, self._attributes(f"{name}/{len(times)}", shown)))

    def _begin(self, fields: Fields) -> None:
        """Write the meshes into a new file, also where an earlier result has left one."""
        on_root(self._spaces.mesh.comm, lambda: self._path.unlink(missing_ok=True))
        spaces, domain = self._spaces, self._spaces.domain
        mesh, dim = spaces.mesh, spaces.mesh.topology.dim
        nodes, corners = mesh.geometry.index_map(), spaces.corners
        points = mesh.geometry.x[: nodes.size_local, :dim]
        facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
        local = dolfinx.mesh.entities_to_geometry(mesh, dim - 1, facets).reshape(-1, dim)
        cells, on_boundary = (
            nodes.local_to_global(each.ravel()).reshape(each.shape) for each in (cell_nodes(mesh), local)
        )
        own = first_row(mesh.comm, corners[..., 0].size) + np.arange(corners[..., 0].size).reshape(-1, dim)
        regions = [Field("region", _first_of(membership(domain)), names=list(domain.regions))] if domain.regions else []
        self._mesh(IN_CELLS, points, cells, regions)
        self._mesh(BOUNDARY, points, on_boundary, [Field("part", _parts(domain, facets), names=list(domain.parts))])
        self._times[BOUNDARY] = [(None, [])]
        for name in set(fields) - {IN_CELLS}:
            of_gamma = np.array([list(domain.parts).index(part) for part in spaces.part_names], dtype=np.int64)
            part = Field("part", of_gamma[spaces.part_of_facet], names=list(domain.parts))
            self._mesh(name, corners.reshape(-1, dim), own, [part])
        for name, of_file in fields.items():
            self._names[name] |= _names(of_file)

    def _mesh(self, name: str, points: Array, cells: Indices, fields: list[Field]) -> None:
        heads = add_to_hdf5(self._spaces.mesh.comm, self._path, {f"{name}/points": points, f"{name}/cells": cells})
        size, dim = cells.shape[1], points.shape[1]
        number = str(heads[1].shape[0])
        kind = {"TopologyType": SHAPES[size], "NumberOfElements": number, "NodesPerElement": str(size)}
        geometry, topology = (
            ElementTree.Element("Geometry", GeometryType="XYZ"[:dim]),
            ElementTree.Element("Topology", kind),
        )
        for element, key, head in zip((geometry, topology), ("points", "cells"), heads, strict=True):
            element.append(_item(f"{name}/{key}", head))
        self._names[name] = _names(fields)
        self._meshes[name] = [topology, geometry, *self._attributes(name, [(field, "Cell") for field in fields])]

    def _shown(self, name: str, field: Field) -> list[tuple[Field, str]]:
        """A field as the file has it, with what follows from it, and whether its rows are of cells or points."""
        if name != IN_CELLS and field.nodes == 1:
            values = field.values.reshape(-1, *field.values.shape[2:])
            return [(each, "Node") for each in Field(field.name, values, field.order).with_derived()]
        fields = [(each, "Cell") for each in field.means().with_derived()]
        if field.at_points:
            values = (
                field.values if field.nodes else np.repeat(field.values[:, None], self._spaces.nodes.shape[1], axis=1)
            )
            size = self._spaces.mesh.geometry.index_map().size_local
            rows = self._around(values.reshape(*values.shape[:2], -1))[:size].reshape(size, *values.shape[2:])
            fields += [(each, "Node") for each in Field(field.name, rows, field.order).with_derived()]
        return fields

    def _attributes(self, place: str, fields: list[tuple[Field, str]]) -> list[Element]:
        """Write fields, and say where they are."""
        arrays = {f"{place}/{center}/{field.name}": _in_space(field) for field, center in fields}
        heads = add_to_hdf5(self._spaces.mesh.comm, self._path, arrays)
        attributes = []
        for (field, center), key, head in zip(fields, arrays, heads, strict=True):
            about = {"Name": field.name, "AttributeType": KINDS[field.order], "Center": center}
            attributes.append(ElementTree.Element("Attribute", about))
            attributes[-1].append(_item(key, head))
        return attributes

    def close(self) -> None:
        """Write the texts, and a script that shows them in ParaView."""

        def write() -> None:
            for name in self._meshes:
                self._tree(name).write(self._folder / f"{name}.xdmf", encoding="utf-8", xml_declaration=True)
            view = (data_folder("paraview") / VIEW).read_text(encoding="utf-8")
            (self._folder / VIEW).write_text(view.replace("NAMES = {}", f"NAMES = {self._names!r}"), encoding="utf-8")

        on_root(self._spaces.mesh.comm, write)

    def _tree(self, name: str) -> ElementTree.ElementTree:
        root = ElementTree.Element("Xdmf", Version="3.0")
        domain, (first, *_) = ElementTree.SubElement(root, "Domain"), self._times[name]
        mesh = {"Name": "mesh", "GridType": "Uniform"}
        if first[0] is None:
            grid = ElementTree.SubElement(domain, "Grid", mesh)
            grid.extend([*self._meshes[name], *first[1]])
            _refer_to_time(grid)
        else:
            about = {"Name": "fields", "GridType": "Collection", "CollectionType": "Temporal"}
            series = ElementTree.SubElement(domain, "Grid", about)
            for t, attributes in self._times[name]:
                time = ElementTree.Element("Time", Value=repr(t))
                ElementTree.SubElement(series, "Grid", mesh).extend([*self._meshes[name], time, *attributes])
        ElementTree.indent(root)
        return ElementTree.ElementTree(root)


def _names(fields: Iterable[Field]) -> dict[str, list[str]]:
    """What the numbers of states are called, by field."""
    return {field.name: list(field.names) for field in fields if field.names}


def _refer_to_time(grid: Element) -> None:
    """Give a grid a time for PyVista, which needs one, where meshio refuses it.

    The grid refers VTK to a copy with a time, inside an element whose children meshio skips.
    """
    grid.set("Reference", "/Xdmf/Domain/Grid/Information/Grid")
    parts = " or ".join(f"self::{kind}" for kind in ("Topology", "Geometry", "Attribute"))
    information = ElementTree.SubElement(grid, "Information", Name="with a time", Value="0")
    information.text = "<none/>"  # meshio needs XML here
    timed = ElementTree.SubElement(information, "Grid", Name="mesh", GridType="Uniform")
    ElementTree.SubElement(timed, f"{{{XINCLUDE}}}include", xpointer=f"xpointer(/Xdmf/Domain/Grid/*[{parts}])")
    ElementTree.SubElement(timed, "Time", Value="0")


def _item(place: str, head: Header) -> Element:
    """The element of XDMF that says where an array is."""
    kind = {"f": "Float", "i": "Int"}[head.kind.kind]
    size = {"Dimensions": " ".join(map(str, head.shape)), "Precision": str(head.kind.itemsize)}
    item = ElementTree.Element("DataItem", {**size, "NumberType": kind, "Format": "HDF"})
    item.text = f"{IN_CELLS}.h5:/{place}"
    return item


def _in_space(field: Field) -> Array:
    """The values of a field with one value per row: vectors with three components, matrices with nine."""
    values = np.asarray(field.values, dtype=np.float64)
    if field.order == 1:
        return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))
    return values.reshape(len(values), 9) if field.order == 2 else values


def _first_of(masks: Mask) -> Indices:
    """The first column of each row that holds, or −1."""
    return np.column_stack([~masks.any(axis=1), masks]).argmax(axis=1) - 1


def _parts(domain: Domain, facets: npt.NDArray[np.int32]) -> Indices:
    """For each facet the number of the first part that has it, or −1."""
    none = np.zeros((len(facets), 0), dtype=bool)
    return _first_of(np.column_stack([none, *(np.isin(facets, of_part) for of_part in domain.facets.values())]))
