"""Tests the statements of the slides on the penalty formulations numerically: the bounds (27), (28) and "I ⇔ II".

Usage: python scripts/penalty_theory.py [LEVEL]

For examples 4 to 6 on meshes h ≤ 2^-2 … 2^-LEVEL (default 5) and ε = 1 … 1e-12 it prints

- bound I:  (‖σ‖_V + ‖u‖_Q + ‖[p]_-‖_Λ/√ε + ‖p‖_Λ) / ‖f_h‖_Q, which (27) says is bounded in h and ε,
- bound II: (‖σ‖_V + ‖u‖_Q + ‖[σ·n]_-‖_Λ/√ε) / ‖f_h‖_Q, which (28) says is bounded,
- I − II:   ‖σ_I − σ_II‖_V / ‖σ_I‖_V, the distance between the two formulations,
- sign I, sign II: ‖[p]_-‖_Λ/ε and ‖[σ·n]_-‖_Λ/ε, bounded if the signs of proposition 3 hold up to O(ε).
"""

import sys

import numpy as np
from mpi4py import MPI
from rich.console import Console
from rich.table import Table

from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.comparing.comparison import differences
from signorini_fenicsx.physics.diffusion.solution import Solution


def bound(solution: Solution, violation: float, *, with_trace: bool) -> float:
    """Left side of (27) or (28) divided by ‖f_h‖."""
    norms = solution.norms()
    left = np.hypot(norms["sigma_L2"], norms["div_sigma_L2"]) + norms["u_L2"]
    left += violation / np.sqrt(solution.options.eps) + with_trace * norms["p_L2"]
    return left / norms["div_sigma_L2"]  # ∇·σ_h = −f_h


def main() -> None:
    """Print one table over all examples, meshes and ε."""
    finest = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    table = Table("example", "h", "ε", "bound I", "bound II", "I − II", "sign I", "sign II")
    for example in (4, 5, 6):
        for level in range(2, finest + 1):
            base = load_case(f"example{example}").with_values({"solve.h": 2.0**-level})
            domain = mesh_case(base, comm=MPI.COMM_WORLD)
            for eps in (1.0, 1e-2, 1e-4, 1e-8, 1e-12):
                one, two = (
                    solve_case(base.with_values({"solve.algorithm": name, "solve.eps": eps}), domain=domain)
                    for name in ("alg3", "alg4")
                )
                p_minus, flux_minus = one.violation()["trace"], two.violation()["flux"]
                sigma_norm = np.hypot(one.norms()["sigma_L2"], one.norms()["div_sigma_L2"])
                row = (
                    bound(one, p_minus, with_trace=True),
                    bound(two, flux_minus, with_trace=False),
                    differences(one, two).sigma_V / sigma_norm,
                    p_minus / eps,
                    flux_minus / eps,
                )
                table.add_row(str(example), f"2^-{level}", f"{eps:g}", *(f"{value:.3g}" for value in row))
    if MPI.COMM_WORLD.rank == 0:
        Console().print(table)


if __name__ == "__main__":
    main()
