"""The error bound is true: for random data, penalties and unfinished linear solves, and where Γ_D meets Γ_S."""

import math
from pathlib import Path

import numpy as np
import pytest
from made_cases import case_of, make_case
from makers.bounds import difference
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.physics.diffusion.case import Case

COMM = MPI.COMM_WORLD
ALGORITHMS = ("alg1", "alg2", "vi", "alg3", "alg4", "snes1", "snes2")


def random_case(rng: np.random.Generator) -> Case:
    """Random domain, mesh, Γ_S, f, u_D ≥ 0, algorithm and ε."""
    shape = str(rng.choice(["square", "lshape", "cube"], p=[0.45, 0.35, 0.2]))
    parts = rng.permutation(list(SHAPES[shape].parts))[: rng.integers(1, len(SHAPES[shape].parts))].tolist()
    a, b, c, d, e = np.round(rng.uniform(-8, 8, 5), 3)
    loads = [
        f"{5 * a}*sin({b}*x + {c}*y)",
        f"{4 * a} + {5 * b}*x + {5 * c}*y",
        f"{20 * a}*exp(-5*((x - 0.4)^2 + (y - 0.6)^2)) + {5 * c}",
        f"{10 * a} if x > {abs(b) / 8} else {5 * c}",
    ]
    traces = [
        "0",
        f"0.5*sin({d}*x + {e}*y)^2",
        f"{abs(d) / 8} + {abs(e) / 20}*abs(x - y)",
        f"({d}*x*y + {e}*x^2)^2/20",
    ]
    return Case.model_validate(
        {
            "geometry": {"shape": shape, "mesh": str(rng.choice(["structured", "unstructured"]))},
            "boundary": {"signorini": parts},
            "problem": {"f": str(rng.choice(loads)), "u_D": str(rng.choice(traces))},
            "solve": {
                "algorithm": str(rng.choice(ALGORITHMS)),
                "eps": float(10 ** rng.uniform(-8, -1)),
                "h": float(rng.uniform(0.35, 0.6) if shape == "cube" else rng.uniform(0.15, 0.4)),
            },
        }
    )


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(2, 50), marks=pytest.mark.slow)], ids=["2", "48"])
def test_random_data(seeds: range):
    """The bound exceeds the distance to a solution by Algorithm 1 on a mesh 8 times (3D: 3 times) as fine."""
    for seed in seeds:
        case = random_case(np.random.default_rng(seed))
        solution = solve_case(case)
        finer = {"solve.h": case.solve.h / (3 if case.geometry.shape == "cube" else 8), "solve.algorithm": "alg1"}
        assert 0 < difference(solution, solve_case(case.with_values(finer))) < certify(solution).bound, seed


def test_sharp_at_corners():
    """At corners, where v is least accurate, the bound exceeds the error by less than 9 %."""
    values = {"solve.h": 1 / 8, "solve.algorithm": "alg1", "geometry.mesh": "structured"}
    solution = solve_case(load_case("example5").with_values(values))
    fine = solve_case(case_of(solution).with_values({"solve.h": 1 / 64}))
    certificate = certify(solution)
    error = difference(solution, fine)
    assert error < certificate.sigma_bound < 1.09 * error


@pytest.mark.parametrize(
    ("algorithm", "eps"), [("alg3", 1.0), ("alg3", 1e-6), ("alg4", 1.0), ("snes1", 1e-2), ("snes2", 1.0), ("vi", 1e-2)]
)
def test_penalty_solutions(algorithm: str, eps: float):
    """The bound is for the solution of the Signorini problem, so it includes the error of the penalty."""
    given = {"solve.h": 1 / 8, "solve.algorithm": algorithm, "solve.eps": eps, "solve.backend": "mixed"}
    solution = solve_case(load_case("transition").with_values(given))
    certificate, errors = certify(solution, for_signorini=True), solution.errors()
    assert errors is not None
    assert errors["sigma_L2"] < certificate.sigma_bound < (1.1 if eps < 1e-4 else 3) * errors["sigma_L2"]


@pytest.mark.parallel(2)
def test_unfinished_linear_solve():
    """If CG is stopped early, its error is part of the error and of the bound."""
    options = PETSc.Options()
    chosen = {"ksp_type": "cg", "pc_type": "jacobi", "ksp_norm_type": "unpreconditioned", "ksp_rtol": "1e-2"}
    for name, value in chosen.items():
        options[name] = value
    try:
        with pytest.raises(NumericalFailure, match="KKT residuals above") as caught:
            solve_case(load_case("singular").with_values({"solve.h": 1 / 8}), COMM)
    finally:
        for name in chosen:
            options.delValue(name)
    solution = caught.value.solution
    assert solution is not None
    errors, certificate = solution.errors(), certify(solution)
    assert errors is not None
    assert certificate.remainder > 1e-4
    assert errors["sigma_L2"] < certificate.sigma_bound


def test_where_dirichlet_meets_signorini(folder: Path):
    """Convex data that vanish at Γ_S make the correction of their interpolant negative there; v must still be ≥ 0."""
    case = make_case(folder, parts=["bottom"], f="-4", h=0.3)
    for u_D in ("abs(x - 0.45)^3", "sin(9*x)^2*y + x^4"):
        case = case.with_values({"problem.u_D": u_D})
        coarse = solve_case(case, COMM)
        fine = solve_case(case.with_values({"solve.h": 0.04, "geometry.mesh": "structured"}), COMM)
        assert difference(coarse, fine) < certify(coarse).bound < 1.6 * difference(coarse, fine)


def test_no_bound_without_a_solution(folder: Path):
    """U = u_D < 0 next to u ≥ 0 has no finite energy."""
    case = make_case(folder, parts=["bottom"], f="0", h=0.3).with_values({"problem.u_D": "x - 0.5"})
    assert certify(solve_case(case, COMM)).bound == math.inf
    assert math.isfinite(certify(solve_case(case.with_values({"problem.u_D": "x - y"}), COMM)).bound)
