"""Bodies with meshes of their own: boxes whose facets do not match, in one mesh that shares no nodes."""

from collections.abc import Callable, Sequence
from functools import partial

import dolfinx.mesh
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import Domain, distribute

type Array = NDArray[np.float64]


def box_cells(
    numbers: Sequence[int], low: Sequence[float], high: Sequence[float], seed: int = 0
) -> tuple[Array, Array]:
    """Points and cells of a box, whose inner points are moved at random."""
    dim = len(numbers)
    axes = [np.linspace(a, b, n + 1) for n, a, b in zip(numbers, low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
    inside = ((points > np.array(low) + 1e-9) & (points < np.array(high) - 1e-9)).all(axis=1)
    step = (np.array(high) - np.array(low)) / np.array(numbers)
    points[inside] += 0.15 * step * np.random.default_rng(seed).uniform(-1, 1, (inside.sum(), dim))
    strides = np.array([int(np.prod([n + 1 for n in numbers[i + 1 :]])) for i in range(dim)])
    corner = np.stack(np.meshgrid(*[np.arange(n) for n in numbers], indexing="ij"), axis=-1).reshape(-1, dim) @ strides
    orders = {2: [(0, 1), (1, 0)], 3: [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]}[dim]
    cells = []
    for order in orders:
        vertices = [corner]
        for axis in order:
            vertices.append(vertices[-1] + strides[axis])
        cells.append(np.stack(vertices, axis=1))
    return points, np.concatenate(cells)


def apart(
    comm: MPI.Intracomm, bodies: dict[str, tuple[Array, Array]], parts: dict[str, tuple[str, Callable[[Array], Array]]]
) -> Domain:
    """A domain of bodies, each with points and cells, with parts: of which body, and where, by points (3, n)."""
    first, points, cells, region = 0, [], [], []
    for number, (x, t) in enumerate(bodies.values()):
        points.append(x)
        cells.append(t + first)
        region.append(np.full(len(x), number))
        first += len(x)
    x, t, of_node = np.concatenate(points), np.concatenate(cells), np.concatenate(region)
    none = comm.rank != 0
    mesh = distribute(comm, x[:0] if none else x, t[:0] if none else t, x.shape[1])
    owner = of_node[mesh.geometry.input_global_indices]
    names = list(bodies)

    mesh.topology.create_entities(mesh.topology.dim - 1)
    mesh.topology.create_connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    nodes = (
        dolfinx.mesh.entities_to_geometry(mesh, mesh.topology.dim - 1, facets) if len(facets) else np.zeros((0, 2), int)
    )
    chosen = {}
    for part, (body, where) in parts.items():
        on = where(mesh.geometry.x.T[: x.shape[1]])[nodes].all(axis=1) & (owner[nodes] == names.index(body)).all(axis=1)
        chosen[part] = facets[on]
    return domain_of(mesh, chosen)


def two(
    comm: MPI.Intracomm, upper: Sequence[int], lower: Sequence[int], gap: float = 0.0, shear: float = 0.0
) -> Domain:
    """Two unit boxes on one another; with shear both are slanted, x_last += shear x_0; parts u0, u1, …, l0, l1, …."""
    dim = len(upper)
    up, down = np.zeros(dim), np.zeros(dim)
    up[-1], down[-1] = gap, -1.0
    bodies = {
        "u": box_cells(upper, up, up + 1, seed=1),
        "l": box_cells(lower, down, down + 1, seed=2),
    }
    parts = {}
    for name, low in (("u", up), ("l", down)):
        for axis, end in np.ndindex(dim, 2):
            parts[f"{name}{axis}{end}"] = name, partial(_on_plane, axis=axis, place=low[axis] + end, shear=shear)
    for x, _ in bodies.values():
        x[:, -1] += shear * x[:, 0]
    return apart(comm, bodies, parts)


def joined(numbers: Sequence[int]) -> Domain:
    """The boxes of `two` in the plane with the same numbers, in one mesh; u10 is inside; the sides are x0, x1."""
    (x, t), (y, s) = box_cells(numbers, [0, 0], [1, 1], seed=1), box_cells(numbers, [0, -1], [1, 0], seed=2)
    points, number = np.unique(np.round(np.concatenate([x, y]), 12), axis=0, return_inverse=True)
    cells = number.ravel()[np.concatenate([t, s + len(x)])]
    mesh = distribute(MPI.COMM_SELF, points, cells, 2)
    parts = {"u10": (1, 0.0), "u11": (1, 1.0), "l10": (1, -1.0), "x0": (0, 0.0), "x1": (0, 1.0)}
    where = {name: partial(_on_plane, axis=axis, place=place, shear=0.0) for name, (axis, place) in parts.items()}
    return domain_of(mesh, {name: partial(_in_plane, on) for name, on in where.items()}, inner=["u10"])


def _in_plane(on: Callable[[Array], Array], x: Array) -> Array:
    return on(x[:2])


def _on_plane(x: Array, axis: int, place: float, shear: float) -> Array:
    """Whether points are on a side of a box."""
    return np.isclose(x[axis] - (shear * x[0] if axis == len(x) - 1 else 0.0), place)
