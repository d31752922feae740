"""Comparison of contact sets and fields of two solutions on one domain; their meshes need not match."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, check_kind
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.discrete.contact_sets import hausdorff, jaccard
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.solving.solved import Columns, Solved
from signorini_fenicsx.solving.solver import same_domain


@dataclass(frozen=True)
class Comparison:
    """A comparison of two solutions.

    Attributes:
        contact: Measures of the two contact sets.
        jaccard: |A ∩ B| / |A ∪ B|, computed on the facets of the finer mesh.
        hausdorff: Hausdorff distance of the contact sets.
        norms: Norms of the differences, see `Solved.differences`, by quadrature on the finer mesh.
        relative: Some of these norms divided by those of the finer solution, see `Solved.sizes`; infinite if these
            are 0.
        read_off: What is read off of both under the same name, see `Solved.read_off`.
        phreatic: The largest distance of a point of one phreatic line from the points of the other; None without both.
    """

    contact: tuple[float, float]
    jaccard: float
    hausdorff: float
    norms: Any
    relative: Mapping[str, float]
    read_off: Mapping[str, tuple[float, float]]
    phreatic: float | None = None

    def summary(self) -> dict[str, Any]:
        """All numbers, ready for JSON."""
        return asdict(self)


@collector_off()
@doing("comparing")
def compare(one: Solved, other: Solved) -> Comparison:
    """Compare two solutions on one communicator (collective; symmetric except for the order of `contact`).

    Raises:
        InputError: If their domains or contact boundaries differ, or they are of different physics.
    """
    for solution in (one, other):
        check_kind("solution", solution, Solved)
    first, second = (
        f"{solution.spaces.domain.name} with contact on {', '.join(sorted(solution.contact_parts)) or 'no part'}"
        for solution in (one, other)
    )
    domains = same_domain(one.spaces.domain, other.spaces.domain)
    if not domains or set(one.contact_parts) != set(other.contact_parts):
        raise InputError(f"only solutions with the same domain and Γ_S can be compared, not {first} and {second}")
    coarse, fine = sorted((one, other), key=lambda solution: solution.spaces.domain.cells)
    norms, sizes = differences(coarse, fine), fine.sizes()
    first_off, second_off = one.read_off(), other.read_off()
    return Comparison(
        contact=(one.contact.measure, other.contact.measure),
        jaccard=jaccard(coarse.contact_set(), fine.contact_set()),
        hausdorff=hausdorff(one.contact_set(), other.contact_set()),
        norms=norms,
        relative={name: _ratio(getattr(norms, name), size) for name, size in sizes.items()},
        read_off={name: (value, second_off[name]) for name, value in first_off.items() if name in second_off},
        phreatic=_apart(one.readings.get("phreatic"), other.readings.get("phreatic"), one.spaces.mesh.comm),
    )


def differences(coarse: Solved, fine: Solved) -> Any:
    """Norms of the difference of two solutions, see `Solved.differences` (collective).

    Raises:
        InputError: If they are of different physics.
    """
    if coarse.physics != fine.physics:
        raise InputError(
            f"{coarse.name} and {fine.name} are of different physics; only solutions of one can be compared"
        )
    return fine.differences(coarse)


def _apart(one: Columns | None, other: Columns | None, comm: MPI.Comm) -> float | None:
    """How far the points of two tables on rank 0 are from one another at most, None without any (collective)."""
    if one is None or other is None:
        return None
    points = [np.column_stack([table[axis] for axis in AXES if axis in table]) for table in (one, other)]
    found = None
    if all(map(len, points)):
        from scipy.spatial import cKDTree  # slow to import

        pairs = (points, points[::-1])
        found = max(float(cKDTree(of).query(x)[0].max()) for x, of in pairs)
    return comm.bcast(found)


def _ratio(value: float, size: float) -> float:
    return value / size if size > 0 else (0.0 if value == 0 else math.inf)
