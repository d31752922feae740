"""What elastic contact and flows cost: beside one linear solve, beside P2, with friction in space."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import contextlib
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from boxes import box
from mpi4py import MPI
from p2 import Box, solve_p2

from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.elasticity.conditions import Contact, Coulomb, Tresca
from signorini_fenicsx.physics.elasticity.discrete.data import elastic_data
from signorini_fenicsx.physics.elasticity.discrete.spaces import build_elastic_spaces
from signorini_fenicsx.physics.elasticity.problem import Dirichlet, ElasticBoundary, Elasticity, ElasticProblem, Neumann
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.backend import ElasticBackend
from signorini_fenicsx.physics.stokes.problem import Stokes
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_SELF
GAP, YOUNG, POISSON = 0.02, 1.0, 0.3
POISSONS = (0.3, 0.44, 0.45, 0.49, 0.4999)
CELLS = {2: (16, 32, 64, 128), 3: (2, 4, 8)}
FOR_ITERATIONS = {2: (16, 32, 64), 3: (4, 8)}
QUICK = {2: (8, 16, 32), 3: (2, 4)}


FRICTION = {"none": None, "tresca": Tresca(0.01), "coulomb": Coulomb(0.3)}
SIDEWAYS = 0.03


def block(dim: int, n: int, bodies: int = 1) -> Domain:
    """A box of length 2 with n cells along the other edges, cut in the middle if it is two bodies."""
    cut = 0.5 if bodies == 2 else None
    return box([0.0] * dim, [2.0] + [1.0] * (dim - 1), [2 * n] + [n] * (dim - 1), COMM, cut=cut)


def beside(dim: int) -> list[str]:
    """The sides of the block in the third direction."""
    return ["front", "back"] if dim == 3 else []


def coarser(dim: int, n: int, factor: float, bodies: int = 1) -> Domain:
    """The block with cells larger by a factor, from which the sets are predicted."""
    return block(dim, max(bodies * round(n / factor / bodies), bodies), bodies)


def timed[T](run: Callable[[], T]) -> tuple[T, float]:
    """What it returns, and its seconds: the better of two runs."""
    seconds = []
    for _ in range(2):
        began = time.process_time()
        result = run()
        seconds.append(time.process_time() - began)
    return result, min(seconds)


def with_known_set(domain: Domain, solution: ElasticSolution) -> None:
    """One linear solve with the known set."""
    spaces = build_elastic_spaces(domain, solution.boundary, solution.problem.rough)
    data = replace(elastic_data(spaces, solution.problem), friction=solution.data.friction)
    ElasticBackend(spaces, data).solve(solution.outcome.conditions)


def pressed(dim: int, poisson: float = POISSON) -> ElasticProblem:
    """The block's problem."""
    f, push = ([str(x) for x in load] for load in loads(dim))
    boundary = ElasticBoundary(["bottom"], neumann=["top", "right", *beside(dim)])
    return ElasticProblem(YOUNG, poisson, f=f, g_N={"top": push}, gap=GAP, boundary=boundary)


def rubbing(dim: int, bodies: int, friction: str) -> Elasticity:
    """The block's problem with friction, or as two bodies."""
    f, push = loads(dim)
    push[0] = 0.0 if friction == "none" else SIDEWAYS
    touching = Contact("bottom" if bodies == 1 else "fault", gap=GAP, friction=FRICTION[friction])
    held = [Dirichlet("bottom", [0] * dim)] if bodies == 2 else []
    conditions = [touching, Neumann("top", push), Neumann(["right", *beside(dim)]), *held]
    return Elasticity(YOUNG, POISSON, f=f, conditions=conditions)


def loads(dim: int) -> tuple[list[float], list[float]]:
    """The force and the traction from above."""
    return [0.0] * (dim - 1) + [-0.3], [0.0] * (dim - 1) + [-0.1]


def used() -> tuple[float, float]:
    """Seconds of the processor so far, and the most memory in GB."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e6


def print_alone(dim: int, n: int) -> None:
    """The solve and the bound of one mesh."""
    domain, began = block(dim, n), used()
    solution = solve(domain, pressed(dim), remesh=partial(coarser, dim, n))
    solved = used()
    certificate = solution.certify()
    bounded = used()
    print(f"{dim}D, {n} cells, {solution.outcome.dofs} unknowns, relative bound {certificate.relative:.2e}")
    print(f"  solve {solved[0] - began[0]:7.1f} s  {solved[1]:5.2f} GB")
    print(f"  bound {bounded[0] - solved[0]:7.1f} s  {bounded[1]:5.2f} GB", flush=True)


def print_rubbing(cells: dict[int, tuple[int, ...]], bodies: int, friction: str) -> None:
    """Ours and the known set, with friction or two bodies."""
    print(f"{bodies} bodies, friction {friction}: cells, unknowns, seconds, of the bound; over the known set; solves")
    for dim, sizes in cells.items():
        for n in sizes:
            domain, problem = block(dim, n, bodies), rubbing(dim, bodies, friction)
            remesh = partial(coarser, dim, n, bodies=bodies)
            solution, ours = timed(partial(solve, domain, problem, remesh=remesh))
            _, bound = timed(solution.certify)
            _, seconds_known = timed(partial(with_known_set, domain, solution))
            line = f"{dim}D {n:4d} {solution.outcome.dofs:8d} {ours:8.2f} {bound:8.2f}   {ours / seconds_known:.2f}"
            steps = solution.outcome.history
            counts = f"{sum(step.rough for step in steps)} rough + {sum(not step.rough for step in steps)}"
            print(f"{line}   {counts}, {len(solution.bound_changes)} bounds of the friction", flush=True)


def flowing(dim: int, problem: Callable[..., Any], *material: float) -> Any:
    """A problem in the block with Poiseuille's profile on one side, an open side opposite to it, and walls between."""
    profile = "*".join(f"4*{axis}*(1 - {axis})" for axis in "xyz"[1:dim])
    inlet, walls = Dirichlet("left", [profile, *[0] * (dim - 1)]), Dirichlet(["bottom", "top", *beside(dim)], [0] * dim)
    return problem(*material, conditions=[inlet, walls, Neumann("right")])


def solved_once(domain: Domain, solution: ElasticSolution, tuning: Tuning) -> tuple[float, int]:
    """Seconds of one linear solve with its fields, after assembly: the better of two; and its iterations."""
    spaces = build_elastic_spaces(domain, solution.boundary, solution.problem.rough)
    seconds = []
    for _ in range(2):
        backend = ElasticBackend(spaces, elastic_data(spaces, solution.problem), tuning)
        began = time.process_time()
        iterate = backend.solve(solution.outcome.conditions)
        seconds.append(time.process_time() - began)
    return min(seconds), iterate.linear_iterations


def print_flow(cells: dict[int, tuple[int, ...]]) -> None:
    """Flow over an elastic body, by both solvers."""
    print("cells, unknowns: seconds (iterations) of a solve, of the body and of the flow, their ratio; that of all")
    for dim, sizes in cells.items():
        for n, by, large in ((n, *by) for n in sizes for by in (("factors", 10**9), ("CG", 0))):
            domain, tuning = block(dim, n), Tuning(direct_up_to=large)
            line, once, whole = f"{dim}D {n:4d}", [], []
            for problem in (flowing(dim, Elasticity, YOUNG, POISSON), flowing(dim, Stokes, 1.0)):
                solution, seconds = timed(partial(solve, domain, problem, Options(tuning=tuning)))
                whole.append(seconds)
                once.append(solved_once(domain, solution, tuning))
            both = "  ".join(f"{seconds:8.3f} ({iterations:3d})" for seconds, iterations in once)
            line += f" {solution.outcome.dofs:8d} by {by:7s}: {both}   {once[1][0] / once[0][0]:.2f}"
            print(f"{line}   {whole[1] / whole[0]:.2f}", flush=True)


def by_libraries(dim: int, sizes: tuple[int, ...]) -> list[dict]:
    """What `measure.py libraries` prints."""
    script = str(Path(__file__).parents[1] / "measure.py")
    command = [sys.executable, script, "libraries", "--dim", str(dim), *map(str, sizes)]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    return [json.loads(line) for line in lines if line.startswith("{")]


def print_iterations(cells: dict[int, tuple[int, ...]]) -> None:
    """The most iterations that a set takes, for each mesh and ν."""
    for dim, sizes in cells.items():
        print(f"{dim}D: cells, unknowns; the most iterations of a set, and the seconds of all, for ν = {POISSONS}")
        for n in sizes:
            domain, iterations, dofs = block(dim, n), [], 0
            for poisson in POISSONS:
                problem = pressed(dim, poisson)
                options = Options(predict=False, tuning=Tuning(direct_up_to=0))
                solution = solve(domain, problem, options)
                most = max(step.linear_iterations for step in solution.outcome.history)
                iterations.append(f"{most:3d} ({solution.timings['solve']:.1f} s)")
                dofs = solution.outcome.dofs
            print(f"  {n:4d} {dofs:8d}  {'  '.join(iterations)}", flush=True)


def elastic(
    quick: Annotated[bool, typer.Option("--quick", help="Coarse meshes only.")] = False,
    iterations: Annotated[bool, typer.Option("--iterations", help="Iterations of CG only.")] = False,
    dims: Annotated[list[int], typer.Option("--dim", help="Some of the dimensions.")] = [2, 3],  # noqa: B006
    alone: Annotated[int, typer.Option(help="Ours and its bound on one mesh with so many cells across.")] = 0,
    libraries: Annotated[bool, typer.Option("--libraries", help="P2 by scikit-fem and NGSolve too.")] = False,
    friction: Annotated[str, typer.Option(help="none, tresca or coulomb: with it, and pushed along.")] = "none",
    flow: Annotated[bool, typer.Option("--flow", help="A viscous flow against an elastic body.")] = False,
    bodies: Annotated[int, typer.Option(min=1, max=2)] = 1,
) -> None:
    """Elastic contact against one linear solve with the known set, and against P2 displacements at the same error.

    A block that is fixed on one side is pressed onto a foundation that is 0.02 away. Seconds are those of the
    processor, on one core, from the mesh to the fields; of ours and of the known set the better of two runs each, as
    the first one also pays for fresh memory. The energy error of a stress is (2(C(σ_h) − C))^½, that of a
    displacement (2(J(v) + C))^½: the exact C is between C(σ_h) and −J(v), and is taken as the middle of the two on
    the finest mesh.

    With --alone it solves one mesh by ours and bounds the error, once each, and prints the seconds and the most
    memory of the process after the solve and after the bound. With --iterations it prints instead how many iterations
    CG with multigrid takes from ν = 0.3 to ν = 0.4999.

    With --libraries, P2 is also that of scikit-fem and of NGSolve, see `measure.py libraries`; `uv run --group bench`
    has both.

    With --friction, `tresca` or `coulomb`, the block is pushed along the foundation too, and with --bodies 2 the
    lower half is a body of its own that is fixed below. Then the table has ours and the known set alone, with the
    bounds of the friction and the directions of slip known too, and how many solves ours took.

    With --flow it compares a viscous flow with an elastic body (ν = 0.3) on the same mesh with the same conditions, u
    given on all sides but the last, by a factorisation and by CG: one linear solve each, with the fields, and all
    from the mesh to the solution.
    """
    if alone:
        for dim in dims:
            print_alone(dim, alone)
        return
    if iterations:
        print_iterations({dim: (QUICK if quick else FOR_ITERATIONS)[dim] for dim in dims})
        return
    cells = {dim: (QUICK if quick else CELLS)[dim] for dim in dims}
    if flow:
        print_flow({dim: sizes[:-1] or sizes for dim, sizes in cells.items()})
        return
    if friction != "none" or bodies > 1:
        print_rubbing(cells, bodies, friction)
        return
    for dim, sizes in cells.items():
        f, push = loads(dim)
        problem = pressed(dim)
        rows = []
        for n in sizes:
            domain = block(dim, n)
            coarser_mesh = partial(coarser, dim, n)
            solution, ours = timed(partial(solve, domain, problem, remesh=coarser_mesh))
            _, bound = timed(solution.certify)
            _, known = timed(partial(with_known_set, domain, solution))
            other = solve_p2(Box(domain.mesh, YOUNG, POISSON, {(dim - 1, 1.0): push}, {(0, 0.0): range(dim)}, GAP, f))
            norms = solution.norms()
            energy = norms["energy"] ** 2 / 2 + GAP * norms["contact_force"]
            rows.append((n, solution.outcome.dofs, ours, bound, known, energy, other))
        exact = (rows[-1][5] - rows[-1][6].energy) / 2
        print(f"{dim}D: cells, unknowns, energy error, seconds, those of the bound; over one solve with the known set")
        for n, dofs, ours, bound, known, energy, other in rows:
            error, of_other = np.sqrt(2 * (energy - exact)), np.sqrt(2 * (other.energy + exact))
            print(f"  ours {n:4d} {dofs:8d} {error:9.2e} {ours:8.2f} {bound:8.2f}   {ours / known:.2f}", flush=True)
            print(f"  P2   {n:4d} {other.unknowns:8d} {of_other:9.2e} {other.seconds:8.2f}   {other.steps} steps")
        for one in by_libraries(dim, sizes) if libraries else []:
            error = np.sqrt(2 * (one["energy"] + exact))
            print(f"  P2   {one['cells']:4d} {one['unknowns']:8d} {error:9.2e} {one['seconds']:8.2f}", end="   ")
            print(f"{one['steps']} steps by {one['library']}")


TOP = ("-0.1*(y - 0.4)", "0.1*(x - 0.5) + 0.01", "-0.05 + 0.03*x")


def low_block(n: int) -> Domain:
    """The block with so many cells along its height."""
    return box([0.0, 0.0, 0.0], [1.0, 1.0, 0.5], [2 * n, 2 * n, n])


def twisted_problem(law: Tresca | Coulomb, top: tuple[str, str, str] = TOP) -> Elasticity:
    """The block under this law whose top is moved."""
    sides = Neumann(["left", "right", "front", "back"])
    conditions = [Contact("bottom", gap="0.01*x", friction=law), Dirichlet("top", top), sides]
    return Elasticity(young=1.0, poisson=0.3, conditions=conditions)


def survey(n: int, blocks: int, values: list[float]) -> None:
    """Print the table of blocks with random motions."""
    domain, numbers = low_block(n), np.random.default_rng(3)
    print("mu    solved  median  most")
    for mu in values:
        solves = []
        for a, b, c, d, e in numbers.uniform(-0.2, 0.2, (blocks, 5)):
            top = f"{a}*(y - 0.4) + {b}", f"{c}*(x - 0.5) + {d}", f"-0.05 + {e / 4}*x + {e / 6}*y"
            with contextlib.suppress(NumericalFailure):
                solves.append(len(solve(domain, twisted_problem(Coulomb(mu), top)).outcome.history))
        if MPI.COMM_WORLD.rank == 0:
            print(
                f"{mu:<5g} {len(solves)} of {blocks} {np.median(solves or 0):6g} {max(solves, default=0):6}", flush=True
            )


def friction(
    cells: Annotated[list[int], typer.Option(help="Cells along the height.")] = [1, 2, 4],  # noqa: B006
    mu: Annotated[list[float], typer.Option()] = [0.1, 0.3, 1.0],  # noqa: B006
    twisted: Annotated[int, typer.Option(help="Number of blocks with random motions.")] = 0,
) -> None:
    """How many linear problems friction in space takes: a block pressed, tilted, pushed and twisted on a plane.

    For each mesh and each μ: facet vertices that stick, slip and are open, linear problems, and the bound of the error
    as a share of the stress. The first line for a mesh is Tresca's law with g = 0.03. With --twisted so many blocks
    with random motions of their tops are solved for each μ on the first mesh: how many have a solution, and how many
    linear problems they took.
    """
    if twisted:
        survey(cells[0], twisted, mu)
        return
    print("cells  law    stick  slip  open  solves  bound")
    for n in cells:
        domain = low_block(n)
        for law in (Tresca(0.03), *map(Coulomb, mu)):
            solution = solve(domain, twisted_problem(law))
            states = [solution.friction_states()[name]["vertices"] for name in ("stick", "slip", "open")]
            bound, name = solution.certify().relative, f"mu {law.mu:g}" if isinstance(law, Coulomb) else "Tresca"
            solves = len(solution.outcome.history)
            if MPI.COMM_WORLD.rank == 0:
                print(f"{n:5} {name:7} {states[0]:5} {states[1]:5} {states[2]:5} {solves:7} {bound:6.1%}")
