"""Tests random problems against an independent solver: all must converge, satisfy the KKT conditions and agree with it.

uv run python scripts/random_problems.py --seeds 300

Each seed draws a shape, a mesh (structured, unstructured, or stretched and sheared), boundary parts, smooth or rough
data, κ with jumps of up to 1e6, an algorithm and a backend. Algorithms 1 and 2 are compared with SNESVI, Algorithms 3
and 4 with SNES on the block system with the same ε.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import argparse
import sys
import time
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import options_of
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.solving.solver import solve

type Array = npt.NDArray[np.float64]

AGREE = 1e-7
"""Largest relative difference of p and σ by rounding."""
SIZES = {"square": 0.2, "lshape": 0.4, "half_disk": 0.3, "annulus": 0.4, "cube": 0.6, "lprism": 0.9, "ball": 0.9}
REFERENCES = {"alg1": "vi", "alg2": "vi", "alg3": "snes1", "alg4": "snes2"}


@dataclass(frozen=True)
class Result:
    """The result of a seed.

    Attributes:
        problem: The problem in words.
        ending: Why the algorithm ended.
        kkt: Largest KKT residual.
        difference: Largest relative difference of p or σ from the reference; NaN if the reference failed.
    """

    problem: str
    ending: str
    kkt: float
    difference: float

    @property
    def good(self) -> bool:
        """Whether it is a solution, and equal to the reference if there is one."""
        return self.ending.startswith("the facet sets repeat") and self.kkt <= KKT and not self.difference > AGREE


@dataclass(frozen=True)
class Wave:
    """sin(k·x + a)."""

    k: Array
    a: float

    def __call__(self, x: Array) -> Array:
        """Its values in points of shape (3, n)."""
        return np.sin(self.k @ x + self.a)


def random_problem(seed: int) -> tuple[Case, Domain, Problem, str]:
    """A case, its mesh, its data and a description."""
    rng = np.random.default_rng(seed)
    case = random_case(rng)
    domain = mesh_case(case, MPI.COMM_SELF)
    bad = distort(rng, domain)
    contrast = 10 ** rng.uniform(0, 6) if rng.random() < 0.7 else 1.0
    rough = rng.random() < 0.5
    problem = random_data(rng, domain, contrast, rough=rough)
    boundary, solving = case.boundary, case.solve
    words = [case.geometry.shape or "", case.geometry.mesh, "bad cells" if bad else ""]
    words += [f"Γ_S {boundary.signorini}", f"Γ_N {boundary.neumann}", f"κ 1 to {contrast:.0e}"]
    words += ["rough f" if rough else "smooth f", solving.algorithm, solving.backend]
    return case, domain, problem, ", ".join(word for word in words if word)


def random_case(rng: np.random.Generator) -> Case:
    """A shape, its mesh, its boundary parts, an algorithm and a backend."""
    shape = str(rng.choice(list(SIZES)))
    parts = [str(part) for part in rng.permutation(list(SHAPES[shape].parts))]
    signorini = parts[: rng.integers(1, len(parts))]
    others = parts[len(signorini) :]
    neumann = others[: rng.integers(0, len(others))]
    structured = SHAPES[shape].grid is not None and rng.random() < 0.5
    algorithm, backend = (str(rng.choice(names)) for names in (list(REFERENCES), ["hybrid", "mixed"]))
    return load_case("example1").with_values(
        {
            "geometry.shape": shape,
            "geometry.mesh": "structured" if structured else "unstructured",
            "boundary.signorini": signorini,
            "boundary.neumann": neumann,
            "solve.h": SIZES[shape] * rng.uniform(0.7, 1.2),
            "solve.algorithm": algorithm,
            "solve.backend": backend,
            "solve.eps": 10 ** rng.uniform(-10, 0),
        }
    )


def distort(rng: np.random.Generator, domain: Domain) -> bool:
    """Stretch and shear four of ten meshes; return whether this one was."""
    x = domain.mesh.geometry.x
    bad = bool(rng.random() < 0.4)
    if bad:
        x[:, 1] *= 10 ** rng.uniform(-2, 1)
        x[:, 0] += rng.uniform(-4, 4) * x[:, 1]
    return bad


def random_data(rng: np.random.Generator, domain: Domain, contrast: float, *, rough: bool) -> Problem:
    """Data of order 1 on a mesh of any size: κ jumps between 1 and its contrast, f is a wave or noise."""
    size = float(np.ptp(domain.mesh.geometry.x, axis=0).max())

    def wave() -> Wave:
        return Wave(rng.uniform(1, 10, 3) / size, rng.uniform(0, 6))

    P0 = fem.functionspace(domain.mesh, ("DG", 0))
    f, kappa = fem.Function(P0), fem.Function(P0)
    centroids = P0.tabulate_dof_coordinates().T
    f.x.array[:] = 40 / size**2 * (rng.standard_normal(len(f.x.array)) if rough else wave()(centroids))
    kappa.x.array[:] = np.where(wave()(centroids) > 0, contrast, 1.0)
    general = rng.random() < 0.5
    u_D, g_N, psi, q_S = (rng.uniform(-1, 1) * general for _ in range(4))
    u_wave, g_wave, psi_wave, q_wave = (wave() for _ in range(4))
    return Problem(
        f=f,
        kappa=kappa,
        u_D=lambda x: u_D * u_wave(x),
        g_N=lambda x: g_N / size * g_wave(x),
        psi=lambda x: psi * psi_wave(x),
        q_S=lambda x: q_S / size * q_wave(x),
    )


def examine(seed: int) -> Result:
    """Solve the problem of a seed with its algorithm and with the reference."""
    case, domain, problem, words = random_problem(seed)
    try:
        solution = solve(
            domain, replace(problem, boundary=case.posed(domain.mesh.geometry.dim).boundary), options_of(case)
        )
    except NumericalFailure as failure:
        return Result(words, str(failure), np.inf, np.nan)
    reference = case.with_values({"solve.algorithm": REFERENCES[case.solve.algorithm]})
    try:
        expected = solve(
            domain, replace(problem, boundary=case.posed(domain.mesh.geometry.dim).boundary), options_of(reference)
        )
    except NumericalFailure:
        difference = np.nan
    else:
        difference = max(distance(solution.sigma, expected.sigma), distance(solution.p, expected.p))
    return Result(words, solution.outcome.reason, max(vars(solution.kkt).values()), difference)


def distance(values: fem.Function, expected: fem.Function) -> float:
    """Largest difference of degrees of freedom, relative to the largest of them."""
    a, b = values.x.array, expected.x.array
    largest = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))
    return float(np.abs(a - b).max(initial=0.0) / largest) if largest > 0 else 0.0


def seeds_asked_for(about: str | None) -> range:
    """The seeds of the command line, 300 from 0 by default."""
    arguments = argparse.ArgumentParser(description=about)
    arguments.add_argument("--seeds", type=int, default=300)
    arguments.add_argument("--first", type=int, default=0)
    options = arguments.parse_args()
    return range(options.first, options.first + options.seeds)


def main() -> int:
    """Examine the seeds and print each problem with a wrong result; return 1 if there is one."""
    counts: Counter[str] = Counter()
    began, worst_kkt, worst = time.monotonic(), 0.0, 0.0
    for seed in seeds_asked_for(main.__doc__):
        result = examine(seed)
        counts["good" if result.good else "bad"] += 1
        counts["by single changes"] += "single facets" in result.ending
        counts["without the clip"] += "clip" in result.ending
        counts["reference failed"] += bool(np.isnan(result.difference))
        worst_kkt, worst = max(worst_kkt, result.kkt), max(worst, np.nan_to_num(result.difference))
        if not result.good or np.isnan(result.difference):
            print(f"seed {seed}: {result.problem}: {result.ending}; KKT {result.kkt:.1e}; {result.difference:.1e}")
    print(f"{dict(counts)}; worst KKT {worst_kkt:.1e}, difference {worst:.1e}; {time.monotonic() - began:.0f} s")
    return int(counts["bad"] > 0)


if __name__ == "__main__":
    sys.exit(main())
