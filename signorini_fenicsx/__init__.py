"""Fully mixed methods for the Signorini problem and its kin on FEniCSx, in parallel, with certified bounds.

A problem:

- `domain_of(mesh, parts)` makes a `Domain` of your own mesh, `domain_of_bodies({name: domain})` one of several;
- `Diffusion` and `Elasticity` hold the data and the conditions on the parts of the boundary: `Dirichlet`, `Neumann`,
  `Pressure`, `Support`, `Contact` with `Tresca` or `Coulomb`, `Pair`, also `Tied`, and the laws `Signorini`,
  `Friction`, `TwoSided`, `Wall`, `Regulator`, `Seepage`, `River`, `Corners` and, in time, `Film`; in regions
  `Obstacle`, `Reaction`, `Corners` and, in time, `Storage`;
  κ may be a soil, `VanGenuchten`, `Gardner` or `BrooksCorey`;
- `Stokes` holds those of a viscous flow, with `Outflow`, `Slip` and `Leak`;
- `load_case` reads a case file, or a shipped case by its name.

Solving it:

- `solve(domain, problem, options)` and `solve_case(case)` give a `Solution`: u, σ, its contact set, norms, values at
  points, `certify`, `plot`, `write`; `Options` names the algorithm and its parameters;
- `Solver(domain, problem)` is set up once and solves one problem after another on its mesh, several times faster;
- `evolve(domain, problem, evolution)`, with an `Evolution`, and `evolve_case(case)` solve problems in time, one step
  after another; `StepBounds` bounds the error of each step;
- `certify(solution)` bounds its error; `adapt` and `adapt_case` refine the mesh where that bound is large;
- `Solution.gradient` and `Solution.derivative` give derivatives by the data; `signorini_fenicsx.derivatives` has that
  through steps in time, and `signorini_fenicsx.quantities` proves quantities from both sides;
- `compare` compares two solutions;
- `load_solution` reads what `Solution.write` or the command line has written;
- `collect_garbage` is for programs on several ranks that solve often.

`signorini_fenicsx.extend` has what your own algorithms, discretisations and laws need.

Impossible input raises `InputError`; a run without a solution raises `NumericalFailure`, and one whose solution is kept
`extend.LaterFailure`, which is one too, if something failed that came after. For examples see
`help(signorini_fenicsx.api)`; the command line is `signorini`.
"""

import importlib

from signorini_fenicsx import registry as registry
from signorini_fenicsx.base.mpi_first import keep_order
from signorini_fenicsx.base.version import __version__ as __version__

TYPE_CHECKING = False  # type checkers take it as True; importing it from typing would take longer than this module
if TYPE_CHECKING:
    from signorini_fenicsx.api import *  # noqa: F403 - what is exported is listed there

keep_order()


def __getattr__(name: str) -> object:
    """Load the names of `signorini_fenicsx.api` when one is used, because DOLFINx takes a second to import."""
    if name == "__all__" or not name.startswith("_"):
        api = importlib.import_module("signorini_fenicsx.api")
        if name == "__all__" or name in api.__all__:
            return getattr(api, name)
    hint = "; CHANGELOG.md translates the names of 0.4" if name[:1].isalpha() else ""
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")


def __dir__() -> list[str]:
    return sorted({"__doc__", "__version__", "extend", *importlib.import_module("signorini_fenicsx.api").__all__})
