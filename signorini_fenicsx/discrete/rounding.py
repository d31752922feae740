"""Texts of data that lose too many digits where they are evaluated.

A bound is computed from the floats that the texts of its data give. Where large numbers cancel in a text, as in
1e16 + x − 1e16, these may have nothing to do with it. Enclosures by intervals contain each rounding: in a single point
their width is what rounding may have changed. These are samples, no proof everywhere; but enclosures of what is no
polynomial contain its rounding on whole cells, and that of a polynomial hardly varies within one.
"""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.expressions import TREES, Tree, interval, values
from signorini_fenicsx.expressions.intervals import enclosing
from signorini_fenicsx.expressions.tree import depends_on

LOST = "loses more than a billionth of its size by rounding where its text is evaluated"
SHARE = 1e-9
"""Rounding is small below this share of the largest value, of levels of u below that of the extent of the values; and
below this share of the extent of u_h, or of what a load has to be to make σ_h."""
LEVELS = ("u_D", "psi", "gap", "obstacle")
"""Beginnings of names of data to which a number may be added without a change of the energy."""
LOADS = ("f", "g_N", "q_S")
PLACES = 0.0, 0.1, 0.2
"""Points of each cell: from its middle by these shares towards a vertex. The least rounding of them counts, as a point
may be on a jump."""


def lost_digits(solution: Any) -> tuple[str, ...]:
    """The names of the texts in the data of a solution that lose too many digits in some cell (collective)."""
    spaces, data, u, flux = solution.spaces, solution.data, solution.u.x.array, solution.norms().get("sigma_L2", 0.0)
    vertices, comm, names = corners(spaces.mesh), spaces.mesh.comm, dict[str, None]()
    of_u = np.array([u.max(initial=-np.inf), -u.min(initial=np.inf)])
    comm.Allreduce(MPI.IN_PLACE, of_u, MPI.MAX)
    volume = comm.allreduce(float(spaces.cell_measures.sum()))
    density = flux / volume**0.5
    per_length = density / volume ** (1 / spaces.mesh.geometry.dim)
    middle = vertices.mean(axis=1)
    x = np.stack([middle + share * (vertices[:, 0] - middle) for share in PLACES], axis=1)
    for name, datum in _texts(data, "", set()):
        for given, rows in datum.pieces_in(np.arange(len(x))):
            trees = [given] if isinstance(given, TREES) else [entry for row in given for entry in row]
            for tree in trees:
                of_rank = np.array(_of(tree, x[rows]))
                comm.Allreduce(MPI.IN_PLACE, of_rank, MPI.MAX)
                lost, highest, lowest = of_rank.tolist()
                is_level = name.startswith(LEVELS) and highest + lowest > 0
                size = highest + lowest if is_level else max(highest, lowest)
                beside = of_u.sum() if name.startswith(LEVELS) else 0.0
                beside = min(density, per_length) if name.startswith(LOADS) else beside
                if lost > SHARE * max(size, beside):
                    names[name] = None
    return tuple(names)


def _of(tree: Tree, x: Array) -> tuple[float, float, float]:
    """The largest rounding in points of cells, shape (cells, points, dim), and the largest of values and of −values."""
    if not any(depends_on(tree, name) for name in "xyz"):
        x = x[:1, :1]
    coordinates = dict(zip("xyz", np.moveaxis(x, -1, 0), strict=False))
    enclosure, value = interval(tree, {name: enclosing(each) for name, each in coordinates.items()}), values(tree, x)
    width = np.nan_to_num((enclosure.hi - enclosure.lo) / 2, nan=0.0, posinf=0.0).min(axis=1)
    known = value[np.isfinite(value)]
    return float(width.max(initial=0.0)), float(known.max(initial=-np.inf)), float(-known.min(initial=np.inf))


def _texts(data: Any, name: str, seen: set[int]) -> Iterator[tuple[str, Datum]]:
    """All data by texts in an object, each once, with names; the same ones in the same order on all ranks."""
    if id(data) in seen or isinstance(data, TREES | np.ndarray | str):
        return
    seen.add(id(data))
    if isinstance(data, Datum) and data.pieces is not None:
        if data.number is None or hasattr(data, "trees"):
            yield name, data
    elif isinstance(data, Mapping):
        for key, each in data.items():
            yield from _texts(each, f"{name}.{key}".strip("."), seen)
    elif isinstance(data, list | tuple):
        for each in data:
            yield from _texts(each, name, seen)
    elif is_dataclass(data) and not isinstance(data, type):
        for field in fields(data):
            key = name if isinstance(data, Datum) else getattr(data, "name", field.name)
            yield from _texts(getattr(data, field.name), key, seen)
