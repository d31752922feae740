"""Files of fields for ParaView, made of what a physics declares: VTX, XDMF, and the room that they take."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem, io

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import WriteFailure
from signorini_fenicsx.base.parallel import give_back_memory, on_root
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.output.xdmf import Xdmf
from signorini_fenicsx.solving.fields import IN_CELLS, Field, Fields

NUMBER, PLACE, VTX = 8, 24, 9
"""Bytes of a number, of a point, and of what VTX adds to a point."""


def write_fields(folder: Path, spaces: MeshSpaces, times: Iterable[tuple[float | None, Fields]], number: int) -> None:
    """Write `<name>.bp` and `<name>.xdmf` for each name of fields, if there is room for them (collective).

    Args:
        folder: The folder.
        spaces: The spaces.
        times: The fields at each time; without a time there is one entry.
        number: How many times there are.

    Raises:
        OSError: On all ranks, if the disk is full.
        WriteFailure: If the library cannot write, on this rank at least.
    """
    vtx: dict[str, Vtx] = {}
    xdmf = Xdmf(folder, spaces)
    for t, fields in times:
        give_back_memory()  # the files take more than the fields
        for name, of_file in fields.items():
            all_of_file = [each for field in of_file for each in field.with_derived()]
            if name not in vtx:
                vtx[name] = Vtx(folder / f"{name}.bp", spaces, number, in_cells=name == IN_CELLS)
            vtx[name].write(t or 0.0, all_of_file)
        xdmf.write(t, fields)
    for file in vtx.values():
        file.close()
    xdmf.close()


def check_room(folder: Path, sizes: Mapping[str, int]) -> None:
    """Make sure that there is disk space for the files, because ADIOS2 aborts on a full disk (rank 0).

    The space is allocated and freed again.

    Raises:
        OSError: If the disk is full.
    """
    places = {folder / f"{name}.room": size for name, size in sizes.items()}
    try:
        for place, size in places.items():
            with place.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, size)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from None
    finally:
        for place in places:
            place.unlink(missing_ok=True)


class Vtx:
    """A file `.bp` of functions of one element, in which all fields are exact. Its methods are collective.

    The format is BP4: with ADIOS2's newer BP5, several ranks wait for each other forever if the disk is full.
    """

    _file: io.VTXWriter

    def __init__(self, path: Path, spaces: MeshSpaces, times: int, *, in_cells: bool):
        """Keep what the file is; nothing on disk changes.

        Args:
            path: The file.
            spaces: The spaces.
            times: How many times there will be.
            in_cells: Whether the fields are in the cells, not on the facets of Γ_S.
        """
        self._path, self._spaces, self._times, self._in_cells = path, spaces, times, in_cells
        self._functions: list[fem.Function] = []

    def write(self, t: float, fields: Sequence[Field]) -> None:
        """Write the fields of a time.

        Raises:
            OSError: On all ranks, if there is no room for the file with all times.
            WriteFailure: If the library cannot write, on this rank at least.
        """
        nodes = max(field.nodes for field in fields)
        functions = [self._function(field, nodes) for field in fields]
        if self._functions:
            for function, now in zip(self._functions, functions, strict=True):
                function.x.array[:] = now.x.array
        else:
            self._functions = functions
            self._open()
        with _told():
            self._file.write(t)

    def _open(self) -> None:
        space = self._functions[0].function_space
        comm, layout, topology = space.mesh.comm, space.dofmap.dof_layout, space.mesh.topology
        points = max(layout.num_dofs, topology.dim + 1)
        numbers = NUMBER * self._times * sum(3 ** len(function.ufl_shape) for function in self._functions)  # in space
        of_cell = points * (PLACE + VTX + numbers) + (points + 1) * NUMBER
        heads = 12_000 + 3_000 * comm.size + 7_000 * self._times
        size = topology.index_map(topology.dim).size_global * of_cell + heads
        on_root(comm, lambda: check_room(self._path.parent, {self._path.name: size}))
        with _told():
            self._file = io.VTXWriter(comm, self._path, self._functions, engine="BP4")

    def close(self) -> None:
        """Write what is left."""
        with _told():
            self._file.close()

    def _function(self, field: Field, nodes: int) -> fem.Function:
        spaces, values = self._spaces, np.asarray(field.values, dtype=np.float64)
        if nodes == 2:
            return _on_subcells(spaces, field, values)
        if field.nodes < nodes:
            dim = spaces.mesh.topology.dim
            values = np.repeat(values[:, None], dim + 1 if self._in_cells else dim, axis=1)
        if not self._in_cells:
            return (spaces.linear_multiplier if nodes else spaces.multiplier)(values, field.name)
        shape = values.shape[1 + nodes :]
        function = fem.Function(fenicsx.function_space(spaces.mesh, ("DG", nodes, shape)), name=field.name)
        rows = function.function_space.dofmap.list
        function.x.array.reshape(-1, *shape)[rows if nodes else rows[:, 0]] = values
        return function


def _on_subcells(spaces: Any, field: Field, values: Array) -> fem.Function:
    """A field as a function on the mesh of the subcells, of spaces that have one (collective)."""
    split, size = spaces.split, spaces.mesh.topology.dim + 1
    if field.nodes == 0:
        values = np.broadcast_to(values[:, None, None], (len(values), size, size, *values.shape[1:]))
    if field.nodes == 1:
        corners = np.array([[k for k in range(size) if k != i] for i in range(size)])
        centroids = np.broadcast_to(values.mean(axis=1)[:, None, None], (len(values), size, 1, *values.shape[2:]))
        values = np.concatenate([values[:, corners], centroids], axis=2)
    space = fenicsx.function_space(split.mesh, ("DG", 1, values.shape[3:]))
    return split.function(space, values, field.name)


@contextmanager
def _told() -> Iterator[None]:
    """Tell if ADIOS2 fails. The file then stays open: closing would wait for other ranks, or abort."""
    try:
        yield
    except RuntimeError as error:  # kept as the cause: it holds the open file
        raise WriteFailure("the fields for ParaView cannot be written") from error
