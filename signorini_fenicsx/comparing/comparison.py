"""Compares contact sets and fields of two solutions on one domain; their meshes need not match."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from signorini_fenicsx.base.errors import InputError, check_kind
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.discrete.contact_sets import hausdorff, jaccard
from signorini_fenicsx.solving.solved import Solved
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
    """

    contact: tuple[float, float]
    jaccard: float
    hausdorff: float
    norms: Any
    relative: Mapping[str, float]

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
    return Comparison(
        contact=(one.contact.measure, other.contact.measure),
        jaccard=jaccard(coarse.contact_set(), fine.contact_set()),
        hausdorff=hausdorff(one.contact_set(), other.contact_set()),
        norms=norms,
        relative={name: _ratio(getattr(norms, name), size) for name, size in sizes.items()},
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


def _ratio(value: float, size: float) -> float:
    return value / size if size > 0 else (0.0 if value == 0 else math.inf)
