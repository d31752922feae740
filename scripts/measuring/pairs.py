"""What pairs of surfaces cost: processor seconds and iterations, beside a part inside the domain on a matching mesh.

`cost` solves for two blocks on one another, in the plane and in space, with contact on a half of their faces, first on
one mesh that is cut along both faces, then on two meshes with as many cells, whose facets do not match. The seconds of
all ranks are those of the overlay alone, of spaces and overlay, of the solution, and of the bound. `iterations` prints
the iterations of CG with multigrid on meshes of very different size. `large` solves for a pair with many facets in
space, of bodies or with `--scalar` for a scalar u.

    uv run python scripts/measure.py pairs cost [--size 24] [--dim 2]
    uv run python scripts/measure.py pairs iterations [--dim 2]
    uv run mpirun -n 2 python scripts/measure.py pairs large --size 71 --scalar
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
import resource
from collections.abc import Sequence
from typing import Annotated, Any

import typer
from boxes import box, grid
from boxes import sides as sides_of

from measuring import COMM, say, timed
from signorini_fenicsx.api import (
    Contact,
    Diffusion,
    Dirichlet,
    Elasticity,
    Neumann,
    Options,
    Pair,
    Solver,
    Tied,
    certify,
    domain_of,
    domain_of_bodies,
)
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.discrete.pairing import joints
from signorini_fenicsx.meshes.domain import Domain

LAYERS = {2: None, 3: 2}
"""Layers of cells of each block in space; in the plane as many as beside each other."""
SIZES = {2: ((16, 16), (16, 64), (64, 16), (8, 96), (96, 8)), 3: ((4, 4), (4, 8), (8, 4), (3, 11))}
"""Cells beside each other of the upper and the lower block in `iterations`."""


def height(numbers: Sequence[int]) -> float:
    """That of a block as wide as 1 whose cells are as high as wide."""
    return numbers[-1] / numbers[0]


def inner(numbers: Sequence[int]) -> Domain:
    """Both blocks in one mesh, which is cut along their faces."""
    (*beside, last), high = numbers, height(numbers)
    return box([0.0] * len(beside) + [-high], [1.0] * len(beside) + [high], [*beside, 2 * last], cut=0.0)


def paired(upper: Sequence[int], lower: Sequence[int], bend: float = 1.0) -> Domain:
    """Two blocks with meshes of their own; the vertices of the lower one are moved by x → x^bend."""
    flat, bodies = [0.0] * (len(upper) - 1), {}
    for name, numbers, bottom, top in (("up", upper, 0.0, height(upper)), ("low", lower, -height(lower), 0.0)):
        low, high = [*flat, bottom], [*(x + 1 for x in flat), top]
        mesh = grid(low, high, numbers)
        mesh.geometry.x[:, 0] **= bend if name == "low" else 1.0
        bodies[name] = domain_of(mesh, sides_of(low, high))
    return domain_of_bodies(bodies, pairs=[["up.bottom", "low.top"]])


def problem(dim: int, meeting: Any, names: Sequence[str], high: float = 1.0, *, scalar: bool = False) -> Any:
    """Blocks that are pressed on one another; the top is tilted, so that half of the faces part."""
    top, bottom = ("up.top", "low.bottom") if isinstance(meeting, Pair) else ("top", "bottom")
    sides = [name for name in names if name.rpartition(".")[2] in ("left", "right", "front", "back")]
    if scalar:
        return Diffusion(f=1, conditions=[Neumann(sides), Dirichlet(bottom, 0), Dirichlet(top, "sin(3*x)"), meeting])
    tilted = [*["0"] * (dim - 1), f"{high}*(-0.02 + 0.08*x)"]
    held = [Dirichlet(bottom, 0), Dirichlet(top, tilted)]
    return Elasticity(young=1, poisson=0.3, conditions=[Neumann(sides), *held, meeting])


def phases(domain: Domain, posed: Any, *, bound: bool) -> None:
    """Print seconds of the overlay, of spaces with it, of the solution, and of the bound, and the memory."""
    pairs = [each.on_boundary for each in posed.conditions if isinstance(each, Pair)]
    found = {"overlay": timed(lambda: joints(domain, pairs, cut=False))[1]}
    solver, found["spaces"] = timed(lambda: Solver(domain, posed))
    solution, found["solution"] = timed(lambda: solver.solve(posed))
    found["bound"] = timed(lambda: certify(solution))[1] if bound else 0.0
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    words = ", ".join(f"{name} {each:.2f}" for name, each in found.items())
    say(f"{domain.cells} cells, {COMM.size} ranks: {words} s, {memory:.1f} GiB on rank 0")


def cost(size: int, dims: Sequence[int]) -> None:
    """Print the lines of `cost`, after those of small problems for which forms are compiled."""
    for dim in dims:
        for numbers in ([2] * dim, [*[size] * (dim - 1), LAYERS[dim] or size]):
            for domain, meeting in (
                (inner(numbers), Contact("fault")),
                (paired(numbers, numbers, bend=1.2), Pair("up.bottom", "low.top")),
            ):
                phases(domain, problem(dim, meeting, [*domain.parts], height(numbers)), bound=True)


def iterations(dim: int) -> None:
    """Print the table of `iterations`."""
    say("upper : lower  unknowns  contact  tied")
    for n, m in SIZES[dim]:
        domain, line = paired([n] * dim, [m] * dim), ""
        for law in (None, Tied()):
            posed = problem(dim, Pair("up.bottom", "low.top", law), [*domain.parts])
            solution = Solver(domain, posed).solve(posed, Options(tuning=Tuning(direct_up_to=0), predict=False))
            counts = [step.linear_iterations for step in solution.outcome.history]
            line += f"{min(counts)}-{max(counts)}  "
        say(f"{n}^{dim} : {m}^{dim}  {solution.outcome.dofs:9d}  {line}")


def large(size: int, *, scalar: bool) -> None:
    """Print the line of a pair with 2 size² slave facets, after a small one for which forms are compiled."""
    meeting = Pair("up.bottom", "low.top", Tied() if scalar else None)
    for number in (2, size):
        domain = paired([number, number, 1], [number, number, 1], bend=1.2)
        phases(domain, problem(3, meeting, [*domain.parts], 1 / number, scalar=scalar), bound=False)


def pairs(
    what: Annotated[str, typer.Argument(help="cost, iterations or large: see `measuring/pairs.py`")],
    size: Annotated[int, typer.Option(help="Cells beside each other.")] = 12,
    dim: Annotated[int | None, typer.Option(help="Dimension; `cost` has both without it.")] = None,
    scalar: Annotated[bool, typer.Option("--scalar", help="A scalar u in `large`.")] = False,
) -> None:
    """What pairs of surfaces cost."""
    {
        "cost": lambda: cost(size, [dim] if dim else [2, 3]),
        "iterations": lambda: iterations(dim or 3),
        "large": lambda: large(size, scalar=scalar),
    }[what]()
