"""What elastic contact costs."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import contextlib
from typing import Annotated

import dolfinx.mesh
import numpy as np
import typer
from mpi4py import MPI

from signorini_fenicsx.api import Contact, Coulomb, Dirichlet, Elasticity, Neumann, Tresca, domain_of, solve
from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.meshes.domain import Domain

TOP = ("-0.1*(y - 0.4)", "0.1*(x - 0.5) + 0.01", "-0.05 + 0.03*x")


def block(n: int) -> Domain:
    """The block with so many cells along its height."""
    mesh = dolfinx.mesh.create_box(MPI.COMM_WORLD, [[0.0, 0.0, 0.0], [1.0, 1.0, 0.5]], [2 * n, 2 * n, n])
    places = {"bottom": (2, 0.0), "top": (2, 0.5), "left": (0, 0.0), "right": (0, 1.0)}
    places |= {"front": (1, 0.0), "back": (1, 1.0)}
    return domain_of(mesh, {name: lambda x, i=i, at=at: np.isclose(x[i], at) for name, (i, at) in places.items()})


def problem(law: Tresca | Coulomb, top: tuple[str, str, str] = TOP) -> Elasticity:
    """The block under this law whose top is moved."""
    sides = Neumann(["left", "right", "front", "back"])
    conditions = [Contact("bottom", gap="0.01*x", friction=law), Dirichlet("top", top), sides]
    return Elasticity(young=1.0, poisson=0.3, conditions=conditions)


def survey(n: int, blocks: int, values: list[float]) -> None:
    """Print the table of blocks with random motions."""
    domain, numbers = block(n), np.random.default_rng(3)
    print("mu    solved  median  most")
    for mu in values:
        solves = []
        for a, b, c, d, e in numbers.uniform(-0.2, 0.2, (blocks, 5)):
            top = f"{a}*(y - 0.4) + {b}", f"{c}*(x - 0.5) + {d}", f"-0.05 + {e / 4}*x + {e / 6}*y"
            with contextlib.suppress(NumericalFailure):
                solves.append(len(solve(domain, problem(Coulomb(mu), top)).outcome.history))
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
        domain = block(n)
        for law in (Tresca(0.03), *map(Coulomb, mu)):
            solution = solve(domain, problem(law))
            states = [solution.friction_states()[name]["vertices"] for name in ("stick", "slip", "open")]
            bound, name = solution.certify().relative, f"mu {law.mu:g}" if isinstance(law, Coulomb) else "Tresca"
            solves = len(solution.outcome.history)
            if MPI.COMM_WORLD.rank == 0:
                print(f"{n:5} {name:7} {states[0]:5} {states[1]:5} {states[2]:5} {solves:7} {bound:6.1%}")
