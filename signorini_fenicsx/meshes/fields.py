"""Continuous functions from mesh files of other programs: linear on each cell, by their values at the points."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, telling
from signorini_fenicsx.base.owned import cell_dofs, cell_nodes
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.rows import fetch_rows
from signorini_fenicsx.meshes.checks import FileMesh
from signorini_fenicsx.meshes.contents import OF_GMSH
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.files import read_mesh_file
from signorini_fenicsx.meshes.sampling import at_points
from signorini_fenicsx.meshes.whole import handed_out

SAME = 1e-5
"""Values on two meshes are the same if they differ by at most this share of all values; files may have few digits."""


def read_field(comm: MPI.Comm, path: str, name: str | None, *, vector: bool) -> tuple[Domain, fem.Function]:
    """Read a mesh and a function on it (collective; rank 0 reads).

    Args:
        comm: Communicator of the mesh.
        path: A file with values at its points.
        name: Name of the values; None if there are no others.
        vector: Whether they are vectors.

    Raises:
        InputError: If the file or its mesh cannot be used, or has no such values.
    """
    read: list[tuple[FileMesh, Array]] = []

    def values() -> None:
        if Path(path).suffix.lower() in OF_GMSH:
            raise InputError(f"field {path}: no values are read from {Path(path).suffix} files; take .vtu or .xdmf")
        mesh = read_mesh_file(path)
        with telling(f"field {path}"):
            read.append((mesh, _chosen(mesh, name, mesh.dim if vector else 1)))

    on_root(comm, values)
    whole, table = read[0] if read else (None, None)
    domain = handed_out(comm, whole, path, "file")
    mesh = domain.mesh
    rows = fetch_rows(comm, mesh.geometry.input_global_indices, table)
    field = _linear(domain, vector=vector)
    by_node = field.x.array.reshape(-1, rows.shape[1])
    by_node[cell_dofs(field.function_space)] = rows[cell_nodes(mesh)]
    field.x.scatter_forward()
    return domain, field


def _chosen(mesh: FileMesh, name: str | None, width: int) -> Array:
    """The values of this name, shape (points, width) (rank 0).

    Raises:
        InputError: If there are none, or several without a name.
    """
    fitting = {key: chosen for key, values in mesh.values.items() if (chosen := _of_width(values, width)) is not None}
    kind = "a number" if width == 1 else "a vector"
    offers = f"it has {', '.join(map(repr, fitting))}" if fitting else f"it has no values with {kind} at each point"
    if name is not None and name not in fitting:
        raise InputError(f"has no values '{name}' with {kind} at each point; {offers}")
    if name is None and len(fitting) != 1:
        raise InputError(f"{offers}" + ("; choose one by --name" if fitting else ""))
    chosen = fitting[name or next(iter(fitting))]
    if not np.isfinite(chosen).all():
        raise InputError("a value is not a number, or infinite")
    return chosen


def _of_width(values: Array, width: int) -> Array | None:
    """Values with so many components, of which more are 0; None if they are others."""
    table = values.reshape(len(values), -1)
    fits = table.shape[1] >= width and (width > 1 or table.shape[1] == 1) and not table[:, width:].any()
    return np.ascontiguousarray(table[:, :width]) if fits else None


def _linear(domain: Domain, *, vector: bool, degree: int = 1) -> fem.Function:
    """A continuous function on a mesh, linear on each cell or of another degree (collective)."""
    shape: Sequence[int] = (domain.mesh.topology.dim,) if vector else ()
    return fem.Function(fenicsx.function_space(domain.mesh, ("Lagrange", degree, tuple(shape))), name="v")


def on_mesh_of(domain: Domain, field: fem.Function, source: Domain) -> fem.Function:
    """The function on another mesh, on whose cells it is linear (collective).

    Raises:
        InputError: If it is not: the meshes are others, and the new one is no refinement of the old one.
    """
    vector, dim = len(field.ufl_shape) > 0, domain.mesh.topology.dim
    v, linear, again = (_linear(domain, vector=vector, degree=degree) for degree in (2, 1, 2))
    places = v.function_space.tabulate_dof_coordinates()[:, :dim]
    v.x.array[:] = at_points(source, field, places).ravel()
    if domain.mesh.comm.allreduce(bool(np.isnan(v.x.array).any()), MPI.LOR):
        raise InputError(f"field {source.name}: its mesh does not cover that of the case")
    linear.interpolate(v)
    again.interpolate(linear)
    apart = np.array([np.abs(v.x.array - again.x.array).max(initial=0.0), np.abs(v.x.array).max(initial=0.0)])
    domain.mesh.comm.Allreduce(MPI.IN_PLACE, apart, MPI.MAX)
    if apart[0] > SAME * apart[1]:
        raise InputError(
            f"field {source.name}: is not linear on the cells of the case, so it is on another mesh; write it on the "
            "mesh of the case, or make that mesh the one of the case"
        )
    return linear
