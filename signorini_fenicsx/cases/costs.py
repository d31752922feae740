"""What problems cost, as measured."""

from dataclasses import dataclass

from signorini_fenicsx.meshes.memory import BYTES_PER_FACET


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


COSTS = {2: Cost(1, BYTES_PER_FACET[2], 177e3, 5e4), 3: Cost(1, BYTES_PER_FACET[3], 196e3, 5e4)}
"""Of diffusion by alg1 to alg4 with the hybrid backend, on at least 395 000 facets; see docs/measured/speed.md."""
