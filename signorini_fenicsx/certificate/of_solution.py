"""The bound of any solution, scalar or elastic."""

from signorini_fenicsx.certificate.certify import Certificate, certify
from signorini_fenicsx.certificate.certify_elastic import certify_elastic
from signorini_fenicsx.solving.elastic_solution import ElasticSolution
from signorini_fenicsx.solving.solution import Solution


def certificate_of(solution: Solution | ElasticSolution, *, for_signorini: bool = False) -> Certificate:
    """Bound the energy error of a converged solution, see `certify` and `certify_elastic` (collective)."""
    if isinstance(solution, ElasticSolution):
        return certify_elastic(solution)
    return certify(solution, for_signorini=for_signorini)
