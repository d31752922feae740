"""Boxes with named sides, of one body or of two, for scripts and tests."""

from collections.abc import Callable, Sequence

import dolfinx.mesh
import numpy as np
from dolfinx.mesh import DiagonalType
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import Domain

type Corner = Sequence[float] | Array

NAMES = {2: (("left", "right"), ("bottom", "top")), 3: (("left", "right"), ("front", "back"), ("bottom", "top"))}
"""The sides along each axis, by dimension."""


def grid(
    low: Corner,
    high: Corner,
    cells: Sequence[int],
    comm: MPI.Comm = MPI.COMM_WORLD,
    diagonal: DiagonalType = DiagonalType.right,
) -> dolfinx.mesh.Mesh:
    """A box between two corners with so many squares or cubes along each axis, cut into simplices (collective)."""
    corners = [list(map(float, corner)) for corner in (low, high)]
    if len(cells) == 3:
        return dolfinx.mesh.create_box(comm, corners, list(cells))
    return dolfinx.mesh.create_rectangle(comm, corners, list(cells), diagonal=diagonal)


def sides(low: Corner, high: Corner) -> dict[str, Callable[[Array], Mask]]:
    """Functions that choose the points of each side of a box."""
    places = {}
    for axis, names in enumerate(NAMES[len(low)]):
        places |= {name: (axis, corner[axis]) for name, corner in zip(names, (low, high), strict=True)}
    return {name: lambda x, axis=axis, at=at: np.isclose(x[axis], at) for name, (axis, at) in places.items()}


def box(
    low: Corner,
    high: Corner,
    cells: Sequence[int],
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    cut: float | None = None,
    turn: Array | None = None,
    diagonal: DiagonalType = DiagonalType.right,
) -> Domain:
    """A box whose parts are its sides (collective).

    Args:
        low: Its first corner.
        high: Its last corner.
        cells: Squares or cubes along each axis.
        comm: The ranks.
        cut: The height along which it is cut into the bodies `lower` and `upper`, with the part `fault` between them.
        turn: A matrix by which all points are multiplied.
        diagonal: How squares are cut.
    """
    mesh, dim, turn = grid(low, high, cells, comm, diagonal), len(cells), np.eye(len(cells)) if turn is None else turn
    mesh.geometry.x[:, :dim] = mesh.geometry.x[:, :dim] @ turn.T
    back, chosen, regions = np.linalg.inv(turn), sides(low, high), {}
    if cut is not None:
        chosen["fault"] = lambda x: np.isclose(x[dim - 1], cut)
        regions = {"upper": lambda x: x[dim - 1] > cut - 1e-9, "lower": lambda x: x[dim - 1] < cut + 1e-9}
    parts, regions = (
        {name: lambda x, on=on: on(back @ x[:dim]) for name, on in named.items()} for named in (chosen, regions)
    )
    return domain_of(mesh, parts, regions, inner=["fault"] if regions else [])
