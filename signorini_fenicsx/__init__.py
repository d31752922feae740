"""Fully mixed RT0/P0 methods for the Signorini problem on FEniCSx, in parallel.

A problem:

- `domain_of(mesh, parts)` makes a `Domain` of your own mesh; `Boundary` names its parts that are Γ_S and Γ_N;
- `Problem` holds the data f, κ, u_D, g_N, ψ, q_S;
- `Signorini`, `Friction`, `TwoSided`, `Wall`, `Regulator` and `Corners` are laws on Γ_S for `Problem.laws`; with `Law`
  and `Graph` you write your own;
- `load_case` reads a case file, or a shipped case by its name.

Solving it:

- `solve(domain, boundary, problem, options)` and `solve_case(case)` give a `Solution`: u, σ, p, its contact set, norms,
  values at points, fluxes through parts, `plot`, `write`;
- `Solver(domain, boundary)` is set up once and solves one problem after another on its mesh, several times faster;
- `evolve(domain, boundary, problem, evolution)`, with an `Evolution`, and `evolve_case(case)` solve problems in time,
  one `Instant` after another; `StepBounds` bounds the error of each step;
- `certify(solution)` bounds its error; `adapt` and `adapt_case` refine the mesh where that bound is large;
- `compare` compares two solutions;
- `load_solution` reads what `Solution.write` or the command line has written; `write_solution` does so file by file;
- `collect_garbage` is for programs on several ranks that solve often.

Elastic contact:

- `ElasticBoundary` and `ElasticProblem` say what is given, `Friction` and `Coulomb` are laws of friction;
- `solve_elastic` gives an `ElasticSolution`;
- `certify_elastic` bounds its error; `write_solution`, `compare` and `solve_case` take its solutions and cases, too;
- `load_any_case` and `load_any_solution` read those of any physics.

Algorithms and backends, and how to replace them:

- `Options` names the algorithm, one of `METHODS`, the backend and their parameters;
- `SetRule`, `Method` with `Task`, `Outcome` and `Step`: your own algorithm;
- `Backend` or `FacetBackend` with `Iterate`, `Spaces`, `Data`, `SiteConditions`, `Condition`, `Penalty`: your
  own discretisation.

Impossible input raises `InputError`; a run without a solution raises `NumericalFailure`. For examples see
`help(signorini_fenicsx.api)`; the command line is `signorini`.
"""

import importlib

from signorini_fenicsx.base.mpi_first import keep_order

TYPE_CHECKING = False  # type checkers take it as True; importing it from typing would take longer than this module
if TYPE_CHECKING:
    from signorini_fenicsx.api import *  # noqa: F403 - what is exported is listed there

__version__ = "0.4.0"

keep_order()


def __getattr__(name: str) -> object:
    """Load the names of `signorini_fenicsx.api` when one is used, because DOLFINx takes a second to import."""
    if name == "__all__" or not name.startswith("_"):
        api = importlib.import_module("signorini_fenicsx.api")
        if name == "__all__" or name in api.__all__:
            return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *importlib.import_module("signorini_fenicsx.api").__all__})
