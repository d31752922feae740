"""Random problems with several laws, against another solver: solved to KKT ≤ 1e-8, or an honest failure.

uv run python scripts/random_laws.py --seeds 300
uv run python scripts/random_laws.py --inside --seeds 300

Each seed draws what `random_problems.py` draws, and a law for each part of Γ_S: Signorini, friction, two-sided bounds,
a wall, a regulator or a random monotone graph, with data that vary along the part. Some have no Γ_D. With --inside
there are one to three laws in Ω as well, some of them in one half of it. The other solver
is a quadratic programme; where that fails, as where κ jumps on bad cells, it is the other algorithm with the other
backend.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import sys
import time
from collections import Counter
from dataclasses import replace

import numpy as np
from dolfinx.mesh import compute_midpoints
from mpi4py import MPI
from random_problems import Result, distance, distort, random_case, random_data, seeds_asked_for

from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.contact.law import EVERYWHERE, Law
from signorini_fenicsx.contact.laws import Corners, Friction, Obstacle, Reaction, Regulator, Signorini, TwoSided, Wall
from signorini_fenicsx.meshes.domain import Boundary, Domain
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve

INSIDE = "--inside"
AGREE = 1e-6
"""Relative difference of p and σ that is left to the interior-point method where κ jumps."""


def random_level(rng: np.random.Generator, size: float, low: float, high: float, power: int = 0) -> str:
    """A number between two over a power of the size, plus a share of a wave: never negative if no number is."""
    k, a = rng.uniform(1, 10, 2) / size, rng.uniform(0, 6)
    wave = f"sin({k[0]}*x + {k[1]}*y + {a})"
    return f"({rng.uniform(low, high) / size**power}*(1 + {rng.choice([0.0, 0.5, 1.0])}*{wave}))"


def random_law(rng: np.random.Generator, part: str, size: float) -> Law:
    """A law with data of order 1 on a domain of any size."""

    def level(low: float, high: float, power: int = 0) -> str:
        return random_level(rng, size, low, high, power)

    kind = rng.integers(6)
    if kind == 0:
        return Signorini([part], psi=level(-0.5, 0.2), q_S=level(-1, 1, 1))
    if kind == 1:
        return Friction([part], g=level(0, 2, 1))
    if kind == 2:
        psi = level(-0.2, 0.2)
        return TwoSided([part], psi=psi, psi_upper=f"{psi} + {level(0, 0.5)}", q_S=level(-1, 1, 1))
    if kind == 3:
        return Wall([part], beta=level(0, 10 ** rng.uniform(-2, 4), 1), level=level(-0.5, 0.5))
    if kind == 4:
        low = level(-1, 0.5, 1)
        k = 10 ** rng.uniform(-2, 4) / size
        return Regulator([part], k=k, g_low=low, g_high=f"{low} + {level(0, 2, 1)}", a=level(-0.2, 0.2))
    return random_graph(rng, part, size)


def random_graph(rng: np.random.Generator, part: str, size: float) -> Law:
    """One to five corners, some of them on vertical or flat lines."""
    number = rng.integers(1, 6)
    steps = rng.exponential(0.2, (number, 2)) * (rng.random((number, 2)) < 0.7)
    u, flux = rng.uniform(-0.5, 0) + np.cumsum(steps[:, 0]), (rng.uniform(0, 1) - np.cumsum(steps[:, 1])) / size
    ends = [str(rng.choice(["vertical", "0", "3"])) for _ in range(2)]
    return Corners([part], list(zip(u.tolist(), flux.tolist(), strict=True)), *ends)


def random_laws_inside(rng: np.random.Generator, size: float) -> list[Law]:
    """One to three laws in Ω: obstacles, reactions, graphs; on bounds of u they do not contradict one another."""
    laws: list[Law] = []
    for number in range(rng.integers(1, 4)):
        region = [EVERYWHERE, "west", ["east"]][rng.integers(3)]
        kind = rng.integers(4 if number == 0 else 3)
        corners = rng.integers(1, 4)
        steps = rng.exponential(0.2, (corners, 2)) * (rng.random((corners, 2)) < 0.7)
        u, s = np.cumsum(steps, axis=0).T
        if kind == 0:
            laws.append(Reaction(region=region, c=random_level(rng, size, 0, 3, 2)))
        elif kind < 3:
            s = (s - rng.uniform(0, 1)) / size**2
            ends = rng.choice(["0", "3"], 2)
            laws.append(Corners(list(zip((u - 0.3).tolist(), s.tolist(), strict=True)), *ends, region=region))
        else:
            psi = random_level(rng, size, -0.3, -0.1)
            upper = f"{psi} + {random_level(rng, size, 0.3, 0.8)}"
            laws.append(Obstacle(region=region, **dict([("psi", psi), ("psi_upper", upper)][: rng.integers(1, 3)])))
    return laws


def halved(domain: Domain) -> Domain:
    """The domain with two regions, west and east."""
    middle = compute_midpoints(domain.mesh, domain.mesh.topology.dim, owned_cells(domain.mesh))[:, 0]
    west = middle < np.median(middle)
    cells = {name: np.flatnonzero(inside).astype(np.int32) for name, inside in (("west", west), ("east", ~west))}
    return replace(domain, regions=cells)


def random_problem(seed: int, *, inside: bool = False) -> tuple[Domain, Boundary, Problem, Options, str]:
    """All that a solve needs, and a description."""
    rng = np.random.default_rng([seed, 1])
    case = random_case(rng)
    domain = mesh_case(case, MPI.COMM_SELF)
    bad = distort(rng, domain)
    contrast = 10 ** rng.uniform(0, 6) if rng.random() < 0.5 else 1.0
    size = float(np.ptp(domain.mesh.geometry.x, axis=0).max())
    everything = list(domain.parts)
    with_law = everything if rng.random() < 0.2 else case.boundary.signorini
    neumann = [part for part in case.boundary.neumann if part not in with_law]
    laws = [random_law(rng, part, size) for part in with_law]
    if inside:
        domain = halved(domain)
        laws += random_laws_inside(rng, size)
    problem = replace(random_data(rng, domain, contrast, rough=rng.random() < 0.5), psi=0.0, q_S=0.0, laws=laws)
    algorithm = str(rng.choice(["alg1", "alg2"]))
    words = [case.geometry.shape or "", "bad cells" if bad else "", f"Γ_N {neumann}", f"κ 1 to {contrast:.0e}"]
    words += [f"{law.name} on {(law.parts or law.region)[0]}" for law in laws] + [algorithm, case.solve.backend]
    options = Options(algorithm=algorithm, backend=case.solve.backend, max_iterations=200)
    return domain, Boundary([], neumann), problem, options, ", ".join(word for word in words if word)


def examine(seed: int, *, inside: bool = False) -> Result | None:
    """Solve the problem of a seed, and in another way; None if it has no unique solution."""
    domain, boundary, problem, options, words = random_problem(seed, inside=inside)
    try:
        solution = solve(domain, replace(problem, boundary=boundary), options)
    except InputError as error:
        if "no part of the boundary" in str(error) or "u_D on Γ_D" in str(error):
            return None
        raise
    except NumericalFailure as failure:
        return Result(words, str(failure), np.inf, np.nan)
    algorithm = "alg2" if options.algorithm_name == "alg1" else "alg1"
    backend = "mixed" if options.backend_name == "hybrid" else "hybrid"
    ways = [replace(options, algorithm="qp"), replace(options, algorithm=algorithm, backend=backend)]
    differences = (apart(solution, domain, boundary, problem, way) for way in ways)
    difference = next((number for number in differences if number is not None), np.nan)
    return Result(words, solution.outcome.reason, max(vars(solution.kkt).values()), difference)


def apart(solution: Solution, domain: Domain, boundary: Boundary, problem: Problem, way: Options) -> float | None:
    """The relative difference of σ and p from those of another way to solve; None if that way fails."""
    try:
        expected = solve(domain, replace(problem, boundary=boundary), way)
    except (NumericalFailure, InputError):
        return None
    size = max(float(np.abs(values.x.array).max(initial=0.0)) for values in (solution.p, solution.u))
    of_trace = float(np.abs(solution.p.x.array - expected.p.x.array).max(initial=0.0))
    return max(distance(solution.sigma, expected.sigma), of_trace / size if size > 0 else 0.0)


def main() -> int:
    """Examine the seeds and print each problem that is not as it should be; 1 if a solution is wrong."""
    counts: Counter[str] = Counter()
    began, worst_kkt, worst = time.monotonic(), 0.0, 0.0
    inside = INSIDE in sys.argv
    sys.argv = [word for word in sys.argv if word != INSIDE]
    for seed in seeds_asked_for(main.__doc__):
        result = examine(seed, inside=inside)
        if result is None:
            counts["without a unique solution"] += 1
            continue
        solved = "sets repeat" in result.ending
        wrong = solved and (result.kkt > KKT or result.difference > AGREE)
        counts["wrong" if wrong else "good" if solved else "failed"] += 1
        counts["by single changes"] += "by changing single" in result.ending
        counts["no reference"] += bool(np.isnan(result.difference))
        worst_kkt = max(worst_kkt, result.kkt if solved else 0.0)
        worst = max(worst, np.nan_to_num(result.difference))
        if wrong or not solved:
            print(f"seed {seed}: {result.problem}: {result.ending}; KKT {result.kkt:.1e}; {result.difference:.1e}")
    print(f"{dict(counts)}; worst KKT {worst_kkt:.1e}, difference {worst:.1e}; {time.monotonic() - began:.0f} s")
    return int(counts["wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main())
