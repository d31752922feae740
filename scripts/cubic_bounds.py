"""Compares bounds of elastic bodies in the plane by the v of the program with quadratics alone, and with cubics alone.

uv run python scripts/cubic_bounds.py

A row has the cells, the bound of ‖σ − σ_h‖ and the seconds of the processor for it, by each v; and the error if it is
known. The meshes are uniform or adapted; see `physics.elasticity.bound.certify`.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import time
from collections.abc import Iterator

from mpi4py import MPI

from signorini_fenicsx import Elasticity, certify, load_case
from signorini_fenicsx.cases.solving import adapt_case, solve_case
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.elasticity.bound import certify as bound
from signorini_fenicsx.physics.elasticity.bound import lifted
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_SELF
KINDS = {"as it is": (2, bound.MANY), "quadratics": (2, {2: 0}), "cubics": (3, {2: 0})}
"""Degree of v on all cells, and on how many it may be higher."""


def solutions() -> Iterator[tuple[str, ElasticSolution]]:
    """The solutions with their names."""
    load = ["2*y*(1 - y) + x*(1 - x)", "-(1 - 2*x)*(1 - 2*y)/2"]
    smooth = Elasticity(1.0, 0.0, f=load, exact=["x*(1 - x)*y*(1 - y)", "0"])
    for h in (2**-3, 2**-5):
        domain = build_domain(COMM, "square", h, mesh="structured")
        yield "smooth", solve(domain, smooth.on(domain))
    case = load_case("hertz")
    for h in ("2^-4", "2^-6"):
        yield "hertz", solve_case(case.with_values({"solve.h": h}), COMM)
    for name, target in (("hertz", 2e-3), ("two_cylinders", 8e-3)):
        yield f"{name}, adapted", adapt_case(load_case(name).with_values({"solve.h": 0.125}), COMM, target=target)[0]


def main() -> None:
    """Print the rows."""
    print(f"{'':24s}{'cells':>6s}", *(f"{kind:>20s}" for kind in KINDS), f"{'error':>10s}")
    for name, solution in solutions():
        row, errors = f"{name:24s}{solution.spaces.domain.cells:6d}", solution.errors()
        for bound.DEGREE, bound.MANY in KINDS.values():
            lifted.QUADRATIC = bound.DEGREE
            certify(solution)
            began = time.process_time()
            row += f" {certify(solution).sigma_bound:11.3e} {time.process_time() - began:6.2f} s"
        print(row, f"{errors['energy']:10.3e}" if errors else "", flush=True)


if __name__ == "__main__":
    main()
