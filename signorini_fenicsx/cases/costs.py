"""What problems cost, as measured."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Cost:
    """What a facet costs, as measured; certificate and output included.

    Attributes:
        unknowns: Unknowns of the linear system.
        memory: Bytes.
        solver_rate: Facets per second and core from the assembled problem to the solution.
        run_rate: Facets per second and core of a whole run, with a structured mesh.
    """

    unknowns: int
    memory: float
    solver_rate: float
    run_rate: float
