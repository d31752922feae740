"""The bound of a solution of any physics."""

from typing import Any

from signorini_fenicsx.certificate.certify import Certificate
from signorini_fenicsx.certificate.certify import certify as certify_diffusion
from signorini_fenicsx.certificate.certify_elastic import certify_elastic
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution


def certify(solution: Any, *, for_signorini: bool = False) -> Certificate:
    """Bound the energy error of a converged solution, see `certificate.certify` and `certify_elastic` (collective).

    Args:
        solution: The solution.
        for_signorini: Of a method with a penalty, bound the error to the solution of the problem without.

    Raises:
        InputError: If the solution has not converged, or is none that can be bounded.
    """
    if isinstance(solution, ElasticSolution):
        return certify_elastic(solution)
    return certify_diffusion(solution, for_signorini=for_signorini)
