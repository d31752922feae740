"""Compares contact sets and fields of two solutions on one domain; their meshes need not match."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.cases.solving import AnySolution
from signorini_fenicsx.comparing.differences import Differences, ElasticDifferences, differences
from signorini_fenicsx.discrete.contact_sets import hausdorff, jaccard
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.solving.system import same_domain


@dataclass(frozen=True)
class Comparison:
    """A comparison of two solutions.

    Attributes:
        contact: Measures of the two contact sets.
        jaccard: |A ∩ B| / |A ∪ B|, computed on the facets of the finer mesh.
        hausdorff: Hausdorff distance of the contact sets.
        norms: Norms of the differences, see `differences`, by quadrature on the finer mesh.
        relative: The norms for σ, u and p, in elasticity for σ and u, divided by those of the finer solution; infinite
            if these are 0.
    """

    contact: tuple[float, float]
    jaccard: float
    hausdorff: float
    norms: Differences | ElasticDifferences
    relative: Mapping[str, float]

    def summary(self) -> dict[str, Any]:
        """All numbers, ready for JSON."""
        return asdict(self)


@collector_off()
@doing("comparing")
def compare(one: AnySolution, other: AnySolution) -> Comparison:
    """Compare two solutions on one communicator (collective; symmetric except for the order of `contact`).

    Raises:
        InputError: If their domains or contact boundaries differ, or only one of them is elastic.
    """
    for solution in (one, other):
        check_kind("solution", solution, Solution, ElasticSolution)
    here, there = (
        f"{solution.spaces.domain.name} with contact on {', '.join(sorted(solution.contact_parts)) or 'no part'}"
        for solution in (one, other)
    )
    domains = same_domain(one.spaces.domain, other.spaces.domain)
    if not domains or set(one.contact_parts) != set(other.contact_parts):
        raise InputError(f"only solutions with the same domain and Γ_S can be compared, not {here} and {there}")
    coarse, fine = sorted((one, other), key=lambda solution: solution.spaces.domain.cells)
    norms = differences(coarse, fine)
    sizes = _sizes(fine)
    return Comparison(
        contact=(one.contact.measure, other.contact.measure),
        jaccard=jaccard(coarse.contact_set(), fine.contact_set()),
        hausdorff=hausdorff(one.contact_set(), other.contact_set()),
        norms=norms,
        relative={name: _ratio(getattr(norms, name), size) for name, size in sizes.items()},
    )


def _sizes(solution: AnySolution) -> dict[str, float]:
    """Norms of the solution itself, by the names of those of differences."""
    norms = solution.norms()
    if isinstance(solution, Solution):
        sigma = math.hypot(norms["sigma_L2"], norms["div_sigma_L2"])
        return {"sigma_V": sigma, "u_Q": norms["u_L2"], "p_Lambda": norms["p_L2"]}
    return {name: norms[name] for name in ("energy", "u_L2")}


def _ratio(value: float, size: float) -> float:
    return value / size if size > 0 else (0.0 if value == 0 else math.inf)
