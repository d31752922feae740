"""What elastic contact, flows and pairs of surfaces cost: beside one linear solve, P2, and a matching mesh."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import contextlib
import resource
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from boxes import box, grid
from boxes import sides as sides_of
from mpi4py import MPI

from measuring import COMM, say, timed
from measuring.benchmark import by_other
from measuring.problem import GAP, POISSON, PRESS, WEIGHT, YOUNG
from signorini_fenicsx.api import (
    Contact,
    Coulomb,
    Diffusion,
    Dirichlet,
    Domain,
    Elasticity,
    Neumann,
    NumericalFailure,
    Options,
    Pair,
    Solver,
    Stokes,
    Tied,
    Tresca,
    certify,
    domain_of,
    domain_of_bodies,
    solve,
)
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.discrete.pairing import pairs_on
from signorini_fenicsx.physics.elasticity.discrete.data import elastic_data
from signorini_fenicsx.physics.elasticity.discrete.spaces import build_elastic_spaces
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.backend import ElasticBackend

CELLS = {2: (16, 32, 64, 128), 3: (2, 4, 8)}
QUICK = {2: (8, 16, 32), 3: (2, 4)}
POISSONS = (0.3, 0.44, 0.45, 0.49, 0.4999)
FRICTION = {"none": None, "tresca": Tresca(0.01), "coulomb": Coulomb(0.3)}
SIDEWAYS = 0.03
SOLVERS = {"factors": Tuning(direct_up_to=10**9), "CG": Tuning(direct_up_to=0)}


def block(dim: int, n: int, bodies: int = 1) -> Domain:
    """A box of length 2 with n cells along the other edges, cut in the middle if it is two bodies."""
    cut = 0.5 if bodies == 2 else None
    return box([0.0] * dim, [2.0] + [1.0] * (dim - 1), [2 * n] + [n] * (dim - 1), MPI.COMM_SELF, cut=cut)


def coarser(dim: int, n: int, bodies: int, factor: float) -> Domain:
    """The block with cells larger by a factor, from which the sets are predicted."""
    return block(dim, max(bodies * round(n / factor / bodies), bodies), bodies)


def with_known_set(solution: ElasticSolution, tuning: Tuning) -> int:
    """One linear solve with the known set, from the mesh on; its iterations."""
    spaces = build_elastic_spaces(solution.spaces.domain, solution.boundary, solution.problem.rough)
    data = replace(elastic_data(spaces, solution.problem), friction=solution.data.friction)
    return ElasticBackend(spaces, data, tuning).solve(solution.outcome.conditions).linear_iterations


def pressed(dim: int, poisson: float = POISSON, bodies: int = 1, friction: str = "none") -> Elasticity:
    """The block's problem: pressed onto a foundation, pushed along it with friction, as one body or two."""
    push = [SIDEWAYS if friction != "none" else 0.0, *[0.0] * (dim - 2), PRESS]
    touching = Contact("bottom" if bodies == 1 else "fault", gap=GAP, friction=FRICTION[friction])
    held = [Dirichlet("bottom", [0] * dim)] if bodies == 2 else []
    conditions = [touching, Neumann("top", push), Neumann(["right", *beside(dim)]), *held]
    return Elasticity(YOUNG, poisson, f=[0.0] * (dim - 1) + [WEIGHT], conditions=conditions)


def beside(dim: int) -> list[str]:
    """The sides of the block in the third direction."""
    return ["front", "back"] if dim == 3 else []


def flowing(dim: int, problem: Callable[..., Any], *material: float) -> Any:
    """A problem in the block with Poiseuille's profile on one side, an open side opposite to it, and walls between."""
    profile = "*".join(f"4*{axis}*(1 - {axis})" for axis in "xyz"[1:dim])
    inlet, walls = Dirichlet("left", [profile, *[0] * (dim - 1)]), Dirichlet(["bottom", "top", *beside(dim)], [0] * dim)
    return problem(*material, conditions=[inlet, walls, Neumann("right")])


def measured(name: str, dim: int, n: int, problem: Any, bodies: int = 1, by: str = "") -> ElasticSolution:
    """Solve and print a line."""
    tuning = SOLVERS[by] if by else Tuning()
    options = Options(tuning=tuning, predict=not by)
    remesh = None if by else partial(coarser, dim, n, bodies)
    solution, ours = timed(partial(solve, block(dim, n, bodies), problem, options, remesh=remesh), 2)
    _, bound = timed(solution.certify, 2)
    iterations, known = timed(partial(with_known_set, solution, tuning), 2)
    steps, most = solution.outcome.history, max(step.linear_iterations for step in solution.outcome.history)
    rough = sum(step.rough for step in steps)
    line = f"{name:10s} {dim}D {n:4d} {solution.outcome.dofs:8d} {ours:8.2f} {bound:8.2f} {known:8.2f}"
    say(f"{line}   {ours / known:5.2f}   {rough:3d} + {len(steps) - rough:2d} {most:4d} {iterations:4d}")
    return solution


def beside_p2(dim: int, sizes: tuple[int, ...]) -> None:
    """The block by this program and by P2 of both libraries on the same meshes, with errors by energies."""
    energies, others = [], {}
    with tempfile.TemporaryDirectory() as folder:
        meshes = [Path(folder, f"{n}.npz") for n in sizes]
        for n, path in zip(sizes, meshes, strict=True):
            solution = measured("ours", dim, n, pressed(dim))
            norms, mesh = solution.norms(), solution.spaces.mesh
            energies.append(norms["energy"] ** 2 / 2 + GAP * norms["contact_force"])
            np.savez(path, points=mesh.geometry.x[:, :dim], cells=mesh.geometry.dofmaps[0])
        for program in ("NGSolve P2", "scikit-fem P2"):
            others[program] = by_other(program, f"block{dim}d", meshes)
    exact = (energies[-1] - others["NGSolve P2"][-1]["energy"]) / 2
    say(f"errors: {', '.join(f'{(2 * (energy - exact)) ** 0.5:.2e}' for energy in energies)}")
    for program, lines in others.items():
        for n, line in zip(sizes, lines, strict=True):
            error = (2 * (line["energy"] + exact)) ** 0.5
            say(
                f"{program:13s} {n:4d} {line['unknowns']:8d} {line['processor']:8.2f} {line['steps']} steps {error:.2e}"
            )


def elastic(
    quick: Annotated[bool, typer.Option("--quick", help="Coarse meshes only.")] = False,
    iterations: Annotated[bool, typer.Option("--iterations", help="By CG, from ν = 0.3 to ν = 0.4999.")] = False,
    dims: Annotated[list[int], typer.Option("--dim", help="Some of the dimensions.")] = [2, 3],  # noqa: B006
    friction: Annotated[str, typer.Option(help="none, tresca or coulomb: with it, and pushed along.")] = "none",
    flow: Annotated[bool, typer.Option("--flow", help="A viscous flow after an elastic body.")] = False,
    bodies: Annotated[int, typer.Option(min=1, max=2)] = 1,
) -> None:
    """Elastic contact against one linear solve with the known set, and against P2 displacements at the same error.

    A block that is fixed on one side is pressed onto a foundation that is 0.02 away. Seconds are those of the
    processor, on one core, from the mesh to the fields, the better of two runs each, as the first one also pays for
    fresh memory: of ours, of its bound, and of one linear solve with the known set; then come the first over the last,
    rough and other solves, and the most iterations in one, and those with the known set. P2 is that of NGSolve and
    scikit-fem (`uv run --group bench`). The energy error of a stress is (2(C(σ_h) − C))^½, that of a displacement
    (2(J(v) + C))^½: the exact C is between C(σ_h) and −J(v), and is taken as the middle of the two on the finest mesh.

    With --friction the block is pushed along the foundation too, and with --bodies 2 the lower half is a body of its
    own that is fixed below; bounds of the friction and directions of slip are then known as well. With --flow a viscous
    flow comes after an elastic body on the same mesh with the same conditions, u given on all sides but the last, by a
    factorisation and by CG.
    """
    say("problem, dim, cells, unknowns; seconds: ours, bound, known set; ours/known; solves; iterations")
    for dim in dims:
        sizes = (QUICK if quick else CELLS)[dim]
        if not (iterations or flow or friction != "none" or bodies > 1):
            beside_p2(dim, sizes)
            continue
        for n in sizes:
            if iterations:
                for poisson in POISSONS:
                    measured(f"ν {poisson}", dim, n, pressed(dim, poisson), by="CG")
            elif flow:
                for by in SOLVERS:
                    measured(f"body {by}", dim, n, flowing(dim, Elasticity, YOUNG, POISSON), by=by)
                    measured(f"flow {by}", dim, n, flowing(dim, Stokes, 1.0), by=by)
            else:
                measured(friction, dim, n, pressed(dim, POISSON, bodies, friction), bodies)


TOP = ("-0.1*(y - 0.4)", "0.1*(x - 0.5) + 0.01", "-0.05 + 0.03*x")


def twisted_problem(law: Tresca | Coulomb, top: tuple[str, str, str] = TOP) -> Elasticity:
    """The low block under this law whose top is moved."""
    sides = Neumann(["left", "right", "front", "back"])
    conditions = [Contact("bottom", gap="0.01*x", friction=law), Dirichlet("top", top), sides]
    return Elasticity(young=1.0, poisson=0.3, conditions=conditions)


def friction(
    cells: Annotated[list[int], typer.Option(help="Cells along the height.")] = [1, 2, 4],  # noqa: B006
    mu: Annotated[list[float], typer.Option()] = [0.1, 0.3, 1.0],  # noqa: B006
    twisted: Annotated[int, typer.Option(help="Number of blocks with random motions.")] = 0,
) -> None:
    """How many linear problems friction in space takes: a block pressed, tilted, pushed and twisted on a plane.

    For each mesh and each μ: facet vertices that stick, slip and are open, linear problems, and the bound of the error
    as a share of the stress. The first line for a mesh is Tresca's law with g = 0.03. With --twisted so many blocks
    with random motions of their tops are solved for each μ on each mesh: how many have a solution, and the median and
    the largest number of linear problems.
    """
    for n in cells:
        domain, numbers = box([0.0, 0.0, 0.0], [1.0, 1.0, 0.5], [2 * n, 2 * n, n]), np.random.default_rng(3)
        motions = numbers.uniform(-0.2, 0.2, (twisted, 5))
        for law in map(Coulomb, mu) if twisted else (Tresca(0.03), *map(Coulomb, mu)):
            solves = []
            for a, b, c, d, e in motions:
                top = f"{a}*(y - 0.4) + {b}", f"{c}*(x - 0.5) + {d}", f"-0.05 + {e / 4}*x + {e / 6}*y"
                with contextlib.suppress(NumericalFailure):
                    solves.append(len(solve(domain, twisted_problem(law, top)).outcome.history))
            if twisted:
                about = (
                    f"{len(solves)} of {twisted} solved, {np.median(solves or 0):g}, {max(solves, default=0)} solves"
                )
            else:
                solution = solve(domain, twisted_problem(law))
                states = {name: each["vertices"] for name, each in solution.friction_states().items()}
                about = f"{states}, {len(solution.outcome.history)} solves, bound {solution.certify().relative:.1%}"
            say(f"{n} cells, {law}: {about}")


LAYERS = {2: None, 3: 2}
"""Layers of cells of each block in space; in the plane as many as beside each other."""
OF_PAIRS = {2: ((16, 16), (16, 64), (64, 16), (8, 96), (96, 8)), 3: ((4, 4), (4, 8), (8, 4), (3, 11))}
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


def meeting_blocks(dim: int, meeting: Any, names: Sequence[str], high: float = 1.0, *, scalar: bool = False) -> Any:
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
    found = {"overlay": timed(lambda: pairs_on(domain, pairs, cut=False))[1]}
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
                phases(domain, meeting_blocks(dim, meeting, [*domain.parts], height(numbers)), bound=True)


def iterations(dim: int) -> None:
    """Print the table of `iterations`."""
    say("upper : lower  unknowns  contact  tied")
    for n, m in OF_PAIRS[dim]:
        domain, line = paired([n] * dim, [m] * dim), ""
        for law in (None, Tied()):
            posed = meeting_blocks(dim, Pair("up.bottom", "low.top", law), [*domain.parts])
            solution = Solver(domain, posed).solve(posed, Options(tuning=Tuning(direct_up_to=0), predict=False))
            counts = [step.linear_iterations for step in solution.outcome.history]
            line += f"{min(counts)}-{max(counts)}  "
        say(f"{n}^{dim} : {m}^{dim}  {solution.outcome.dofs:9d}  {line}")


def large(size: int, *, scalar: bool) -> None:
    """Print the line of a pair with 2 size² slave facets, after a small one for which forms are compiled."""
    meeting = Pair("up.bottom", "low.top", Tied() if scalar else None)
    for number in (2, size):
        domain = paired([number, number, 1], [number, number, 1], bend=1.2)
        phases(domain, meeting_blocks(3, meeting, [*domain.parts], 1 / number, scalar=scalar), bound=False)


def pairs(
    what: Annotated[str, typer.Argument(help="cost, iterations or large")],
    size: Annotated[int, typer.Option(help="Cells beside each other.")] = 12,
    dim: Annotated[int | None, typer.Option(help="Dimension; `cost` has both without it.")] = None,
    scalar: Annotated[bool, typer.Option("--scalar", help="A scalar u in `large`.")] = False,
) -> None:
    """What pairs of surfaces cost: processor seconds and iterations, beside a part inside the domain.

    `cost` solves for two blocks on one another, in the plane and in space, with contact on a half of their faces, first
    on one mesh that is cut along both faces, then on two meshes with as many cells, whose facets do not match. The
    seconds of all ranks are those of the overlay alone, of spaces and overlay, of the solution, and of the bound.
    `iterations` prints the iterations of CG with multigrid on meshes of very different size. `large` solves for a pair
    with many facets in space, of bodies or with --scalar for a scalar u.
    """
    {
        "cost": lambda: cost(size, [dim] if dim else [2, 3]),
        "iterations": lambda: iterations(dim or 3),
        "large": lambda: large(size, scalar=scalar),
    }[what]()
