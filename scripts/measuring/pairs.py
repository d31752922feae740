"""What pairs of surfaces cost: processor seconds and iterations, beside a part inside the domain on a matching mesh.

`cost` solves for two blocks on one another, in the plane and in space, with contact on a half of their faces, first on
one mesh that is cut along both faces, then on two meshes with as many cells, whose facets do not match. The seconds of
all ranks are those of the overlay alone, of spaces and overlay, of the solution, and of the bound; then come quotients.
`iterations` prints the iterations of CG with multigrid on meshes of very different size. `large` solves for a pair with
many facets in space, of bodies or with `--scalar` for a scalar u. `sides` solves `roller` with either surface as the
slave, on two meshes of its block, and prints how far the pressure is off Hertz at vertices and in means over facets.

    uv run python scripts/measure.py pairs cost [--size 24] [--dim 2]
    uv run python scripts/measure.py pairs iterations [--dim 2]
    uv run python scripts/measure.py pairs sides
    uv run mpirun -n 2 python scripts/measure.py pairs large --size 71 --scalar
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import resource
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any

import numpy as np
import typer
from boxes import box, grid
from boxes import sides as sides_of
from mpi4py import MPI

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
    load_case,
    solve_case,
)
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.discrete.pair_overviews import overviews
from signorini_fenicsx.discrete.pairing import joints
from signorini_fenicsx.meshes.domain import Domain

COMM = MPI.COMM_WORLD
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


def seconds(run: Callable[[], Any]) -> tuple[float, Any]:
    """The processor seconds of all ranks, and what comes back (collective)."""
    COMM.Barrier()
    began = time.process_time()
    found = run()
    return COMM.allreduce(time.process_time() - began), found


def say(line: str) -> None:
    """Print a line once."""
    if COMM.rank == 0:
        sys.stdout.write(line + "\n")
        sys.stdout.flush()


def phases(domain: Domain, posed: Any, *, bound: bool) -> list[float]:
    """Seconds of the overlay, of spaces with it, of the solution, and of the bound."""
    pairs = [each.on_boundary for each in posed.conditions if isinstance(each, Pair)]
    of_overlay, _joints = seconds(lambda: joints(domain, pairs, cut=False))
    of_spaces, solver = seconds(lambda: Solver(domain, posed))
    of_solution, solution = seconds(lambda: solver.solve(posed))
    of_bound = seconds(lambda: certify(solution))[0] if bound else 0.0
    return [of_overlay, of_spaces, of_solution, of_bound]


def cost(size: int, dims: Sequence[int]) -> None:
    """Print the table of `cost`, after small problems for which forms are compiled."""
    say("dim  cells    overlay  spaces  solution  bound    in all    pair/inner: solution  bound")
    for dim in dims:
        for_forms(dim)
        numbers, found = [*[size] * (dim - 1), LAYERS[dim] or size], []
        for domain, meeting in both(numbers):
            row = phases(domain, problem(dim, meeting, [*domain.parts], height(numbers)), bound=True)
            found.append(row)
            line = f"{dim}    {domain.cells:7d}  " + "  ".join(f"{each:7.2f}" for each in [*row, sum(row[1:])])
            if len(found) == 2:
                (_, *one), (_, *two) = found
                line += f"    {sum(two[:2]) / sum(one[:2]):.2f}  {two[2] / one[2]:.2f}"
            say(line)


def both(numbers: Sequence[int]) -> Iterator[tuple[Domain, Any]]:
    """The two domains of `cost`, with what is between the blocks."""
    yield inner(numbers), Contact("fault")
    yield paired(numbers, numbers, bend=1.2), Pair("up.bottom", "low.top")


def for_forms(dim: int) -> None:
    """Let forms be compiled."""
    for domain, meeting in both([2] * dim):
        phases(domain, problem(dim, meeting, [*domain.parts]), bound=True)


def iterations(dim: int) -> None:
    """Print the table of `iterations`."""
    say("upper : lower  unknowns  contact  tied")
    for n, m in SIZES[dim]:
        domain, line = paired([n] * dim, [m] * dim), ""
        for law in (None, Tied()):
            counts = list[int]()
            posed = problem(dim, Pair("up.bottom", "low.top", law), [*domain.parts])
            options = Options(tuning=Tuning(direct_up_to=0), predict=False)
            solution = Solver(domain, posed).solve(
                posed, options, on_step=lambda step, counts=counts: counts.append(step.linear_iterations)
            )
            line += f"{min(counts)}-{max(counts)}  "
        say(f"{n}^{dim} : {m}^{dim}  {solution.outcome.dofs:9d}  {line}")


def large(size: int, *, scalar: bool) -> None:
    """Print seconds and memory of a pair with 2 size² slave facets, after a small one for which forms are compiled."""
    meeting = Pair("up.bottom", "low.top", Tied() if scalar else None)
    for number in (2, size):
        domain = paired([number, number, 1], [number, number, 1], bend=1.2)
        say(f"{2 * number**2} slave facets, {domain.cells} cells, {COMM.size} ranks")
        row = phases(domain, problem(3, meeting, [*domain.parts], 1 / number, scalar=scalar), bound=False)
        say(", ".join(f"{name} {each:.2f}" for name, each in zip(("overlay", "spaces", "solution"), row, strict=False)))
        say(f"memory of rank 0: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB")


def sides() -> None:
    """Print the table of `sides`."""
    say("slave       facets of slave, master   off the peak of Hertz in %: at vertices  in means")
    of_block = {"slave": "block.face", "master": "roller.face", "direction": [0, 1]}
    of_roller = {"slave": "roller.face", "master": "block.face", "direction": [0, -1]}
    for name, sizes in (("block", (12, 25)), ("roller", (12, 25)), ("roller", (12, 12))):
        case = load_case("roller")
        meshes = (case.geometry.bodies[body].file for body in ("roller", "block"))
        bodies = {
            body: {"file": file, "h": h} for body, file, h in zip(("roller", "block"), meshes, sizes, strict=True)
        }
        pair = {"kind": "contact", "gap": "x^2/100"} | (of_block if name == "block" else of_roller)
        solution = solve_case(case.with_values({"geometry.bodies": bodies, "pair": [pair]}))
        (about,), table = overviews(solution.spaces.joints, COMM), solution.table()
        off = table.pressure / 3585 - np.sqrt(np.maximum(1 - (table.x[:, 0] / 6.21) ** 2, 0.0))
        number, inside = table.number, table.facet[:, 0] < 4.2
        means = np.bincount(number, off * inside) / np.bincount(number)
        numbers = (100 * np.abs(each).max() for each in (off[inside], means))
        say(f"{name:12s}{about.sizes[0]:.2f}, {about.sizes[1]:.2f}   " + "  ".join(f"{each:5.1f}" for each in numbers))


def pairs(
    what: Annotated[str, typer.Argument(help="cost, iterations, large or sides: see `measuring/pairs.py`")],
    size: Annotated[int, typer.Option(help="Cells beside each other.")] = 12,
    dim: Annotated[int | None, typer.Option(help="Dimension; `cost` has both without it.")] = None,
    scalar: Annotated[bool, typer.Option("--scalar", help="A scalar u in `large`.")] = False,
) -> None:
    """What pairs of surfaces cost."""
    {
        "cost": lambda: cost(size, [dim] if dim else [2, 3]),
        "iterations": lambda: iterations(dim or 3),
        "sides": sides,
        "large": lambda: large(size, scalar=scalar),
    }[what]()
