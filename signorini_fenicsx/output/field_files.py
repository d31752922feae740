"""Files of fields for ParaView, made of what a physics declares: VTX, XDMF, and the room that they take."""

import ctypes
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
    try:
        for t, fields in times:
            give_back_memory()  # the files take more than the fields
            for name, of_file in fields.items():
                if name not in vtx:
                    vtx[name] = Vtx(folder / f"{name}.bp", spaces, number, in_cells=name == IN_CELLS)
                vtx[name].write(t or 0.0, of_file)
            xdmf.write(t, fields)
        for file in vtx.values():
            file.close()
        xdmf.close()
    except BaseException:
        for file in vtx.values():
            file.leave_open()
        raise


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

    def __init__(self, path: Path, spaces: MeshSpaces, times: int, *, in_cells: bool):
        """Keep what the file is; nothing on disk changes.

        Args:
            path: The file.
            spaces: The spaces.
            times: How many times there will be.
            in_cells: Whether the fields are in the cells, not on the facets of Γ_S.
        """
        self._path, self._times, self._in_cells = path, times, in_cells
        self._spaces: Any = spaces  # those with linear fields on subcells have their mesh
        self._functions: list[fem.Function] = []
        self._file: Any = None

    def write(self, t: float, fields: Sequence[Field]) -> None:
        """Write the fields of a time.

        Raises:
            OSError: On all ranks, if there is no room for the file with all times.
            WriteFailure: If the library cannot write, on this rank at least.
        """
        if not self._functions:
            self._nodes = max(field.nodes for field in fields)
            self._functions = list(map(self._function, fields))
            self._open()
        for function, field in zip(self._functions, fields, strict=True):
            self._set(function, field)
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
        with _told(), _with_home():
            self._file = io.VTXWriter(comm, self._path, self._functions, engine="BP4")

    def close(self) -> None:
        """Write what is left."""
        with _told():
            self._file.close()

    def leave_open(self) -> None:
        """Never close the file, even when it is freed: that would wait for other ranks, or abort the process."""
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._file))

    def _function(self, field: Field) -> fem.Function:
        mesh = self._spaces.mesh if self._in_cells else self._spaces.Lambda.mesh
        if self._nodes == 2:
            mesh = self._spaces.split.mesh
        shape = field.values.shape[1 + field.nodes :]
        return fem.Function(fenicsx.function_space(mesh, ("DG", min(self._nodes, 1), shape)), name=field.name)

    def _set(self, function: fem.Function, field: Field) -> None:
        spaces, nodes, values = self._spaces, self._nodes, np.asarray(field.values, dtype=np.float64)
        dim, shape = spaces.mesh.topology.dim, values.shape[1 + field.nodes :]
        if field.nodes == 0 < nodes:
            values = np.repeat(values[:, None], dim + 1 if self._in_cells else dim, axis=1)
        if nodes == 2:
            spaces.split.set_values(function, _on_subcells(values) if field.nodes < 2 else values)
        elif nodes == 1 and not self._in_cells:
            spaces.set_linear(function, values)
        else:
            rows = function.function_space.dofmap.list[: len(values)] if nodes else slice(len(values))
            function.x.array.reshape(-1, *shape)[rows] = values
            function.x.scatter_forward()


def _on_subcells(values: Array) -> Array:
    """Values at the vertices of the subcells of linear fields in cells, shape (cells, d + 1, d + 1, …)."""
    size = values.shape[1]
    corners = np.array([[k for k in range(size) if k != i] for i in range(size)])
    centroids = np.broadcast_to(values.mean(axis=1)[:, None, None], (len(values), size, 1, *values.shape[2:]))
    return np.concatenate([values[:, corners], centroids], axis=2)


@contextmanager
def _told() -> Iterator[None]:
    """Tell if ADIOS2 fails."""
    try:
        yield
    except RuntimeError as error:
        raise WriteFailure("the fields for ParaView cannot be written") from error


@contextmanager
def _with_home() -> Iterator[None]:
    """Set HOME in this context if it is not set: ADIOS2 looks for its settings there, and ends the process without."""
    key, is_set = "HOME", "HOME" in os.environ
    os.environ.setdefault(key, os.devnull)
    try:
        yield
    finally:
        if not is_set:
            del os.environ[key]
