"""Random elastic problems that mix everything the program takes: two algorithms, the balance, and the bound.

A seed chooses plane or space, one body or two that touch, a parallelepiped of any size and slant, units, an isotropic
or orthotropic material, strains and stresses of its own, loads, supports, and on each part contact, with friction or a
tool that moves, or another law. There need not be a solution; then it must be said in a sentence. Otherwise

- Algorithms 1 and 2 find the same,
- loads and reactions are in balance,
- a stress on a mesh half as fine is within the two bounds, but for Coulomb's friction, whose bounds are to another
  problem on each mesh.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from makers import Found
from makers.body_bounds import energy_difference, slanted
from signorini_fenicsx import (
    Contact,
    Corners,
    Coulomb,
    Dirichlet,
    Domain,
    Elasticity,
    InputError,
    Neumann,
    NumericalFailure,
    Options,
    Pressure,
    Regulator,
    Support,
    Tresca,
    TwoSided,
    Wall,
    certify,
    solve,
)
from signorini_fenicsx.meshes.domain import AXES

AGREE = 1e-8
"""Largest relative difference of two algorithms, and what may be left of the balance."""
NO_SOLUTION = ("move rigidly", "slides away", "passes the foundation where parts meet", "must not grow from corner")
"""What is said of problems without a solution."""


@dataclass(frozen=True)
class Problem:
    """A random problem.

    Attributes:
        about: It in words.
        on: Its mesh with so many cells along each side of a body.
        cells: So many on the coarse mesh.
        posed: The problem.
    """

    about: str
    on: Callable[[int], Domain]
    cells: int
    posed: Elasticity


@dataclass(frozen=True)
class Result:
    """The result of a seed.

    Attributes:
        about: The problem in words.
        ending: "good", "no solution", or what is wrong.
    """

    about: str
    ending: str

    @property
    def good(self) -> bool:
        """Whether nothing is wrong."""
        return self.ending in ("good", "no solution")


def bodies(rng: np.random.Generator, dim: int, *, touching: bool, size: float) -> Callable[[int], Domain]:
    """The meshes of a random parallelepiped, or of two, one on the other, cut along the part `fault`."""
    low = -float(rng.choice([0.5, 1.0])) if touching else 0.0
    stretch = size * (np.eye(dim) + (rng.random() < 0.7) * rng.uniform(-0.25, 0.25, (dim, dim)))
    return lambda cells: slanted(dim, low, stretch, cells, MPI.COMM_WORLD)


def materials(rng: np.random.Generator, dim: int, young: float) -> dict[str, object]:
    """A random material with E of this size, with strains and stresses of up to a hundredth of it."""
    material: dict[str, object] = {"young": young, "poisson": float(rng.choice([0.0, 0.3, 0.45, 0.4999]))}
    if rng.random() < 0.25:
        material |= {"young": (young * np.array([1.0, *rng.uniform(0.3, 2, 2)])).tolist(), "poisson": [0.2, 0.1, 0.15]}
        material |= {"shear": [0.4 * young, 0.3 * young, 0.5 * young]}
        material |= {"axes": [[1, 0.5]] if dim == 2 else [[1, 0.5, 0.2], [0, 1, -0.3]]}
    if rng.random() < 0.2:
        material["eigenstrain"] = float(rng.uniform(-0.01, 0.01))
    if rng.random() < 0.15:
        material["initial_stress"] = float(rng.uniform(-0.01, 0.01)) * young
    if dim == 2 and rng.random() < 0.3:
        material["plane"] = "stress"
    return material


def random_problem(seed: int) -> Problem:
    """The problem of a seed (collective)."""
    rng = np.random.default_rng(seed)
    dim, touching = int(rng.choice([2, 2, 3])), bool(rng.random() < 0.5)
    size, young = float(rng.choice([1.0, 1.0, 1e-3, 1e3])), float(rng.choice([1.0, 210e3, 1e9]))
    cells = 2 * int(rng.integers(2, 5)) if dim == 2 else 2
    stress, walls = young / 100, ["left", "right", "bottom", "top", *(["front", "back"] if dim == 3 else [])]
    order = [str(part) for part in rng.permutation(walls)]

    def vector(most: float) -> list[float]:
        values: list[float] = rng.uniform(-most, most, dim).tolist()
        return values

    def contact(part: str, *, tool: bool) -> Contact:
        friction = [None, Tresca(float(rng.uniform(0, 0.5)) * stress), Coulomb(float(rng.choice([0.05, 0.3, 0.6])))]
        bowl = f"{rng.uniform(0, 0.01) * size} + {rng.uniform(0, 0.05) / size}*(x - {rng.uniform(0, size)})^2"
        force = dict(zip(AXES[:dim][::-1], vector(stress * size ** (dim - 1)), strict=True)) if tool else {}
        moment = {"z": 0.0} if tool and rng.random() < 0.3 else {}
        some = dict(list(force.items())[: int(rng.integers(1, dim + 1))])
        return Contact(
            part, bowl if rng.random() < 0.7 else 0.0, None, friction[int(rng.integers(3))], force=some, moment=moment
        )

    def law(part: str) -> Wall | TwoSided | Regulator | Corners:
        beta, a = float(rng.uniform(1, 10)) * young / size, 0.01 * size
        corners = [(-a, -stress), (0.0, -stress), (2 * a, -2 * stress)]
        return [
            Wall(part, beta=beta, level=-a),
            TwoSided(part, psi=-a, psi_upper=2 * a),
            Regulator(part, k=beta, g_low=-stress, g_high=stress / 2),
            Corners(part, corners, before="vertical", beyond=young / size),
        ][int(rng.integers(4))]

    def conditions() -> Iterator[object]:
        if touching:
            yield contact("fault", tool=False)
        for part in [order.pop() for _ in range(int(rng.integers(1 - touching, 3)))]:
            yield contact(part, tool=rng.random() < 0.3) if rng.random() < 0.6 else law(part)
        u_D = vector(0.02 * size)
        yield Dirichlet(order.pop(), u_D) if rng.random() < 0.7 else Dirichlet(order.pop(), 0, components="n")
        if touching or rng.random() < 0.3:
            yield Dirichlet(order.pop(), 0 if rng.random() < 0.5 else u_D)
        if order:
            part, pressure = order.pop(), float(rng.uniform(-stress, stress))
            yield Pressure(part, pressure) if rng.random() < 0.5 else Neumann(part, vector(stress))
        if order and rng.random() < 0.4:
            yield Support(order.pop(), float(rng.uniform(0.1, 10)) * young / size)
        if order:
            yield Neumann(list(order), [0.0] * dim)

    on, chosen = bodies(rng, dim, touching=touching, size=size), list(conditions())
    posed = Elasticity(f=vector(stress / size), conditions=chosen, **materials(rng, dim, young))  # type: ignore[arg-type]
    about = ", ".join(f"{type(each).__name__.lower()} on {'/'.join(each.parts)}" for each in posed.conditions)
    return Problem(f"{dim}D, E = {posed.young}, ν = {posed.poisson}, size {size:g}: {about}", on, cells, posed)


def examine(seed: int) -> Result:
    """Solve the problem of a seed and look for what is wrong (collective)."""
    problem = random_problem(seed)
    try:
        coarse, fine = (solve(problem.on(factor * problem.cells), problem.posed) for factor in (1, 2))
        other = solve(problem.on(problem.cells), problem.posed, Options(algorithm="alg2"))
    except (InputError, NumericalFailure) as error:
        is_told = any(words in str(error) for words in NO_SOLUTION)
        return Result(problem.about, "no solution" if is_told else str(error))
    norms = coarse.norms()
    off = max(abs(other.norms()[key] - norms[key]) / norms[key] for key in ("energy", "sigma_L2", "u_L2"))
    if off > AGREE:
        return Result(problem.about, f"Algorithms 1 and 2 differ by {off:.1e}")
    if coarse.quantities()["balance"] > AGREE:
        return Result(problem.about, f"the balance lacks {coarse.quantities()['balance']:.1e}")
    one, two = certify(coarse), certify(fine)
    if any(isinstance(each, Contact) and isinstance(each.friction, Coulomb) for each in problem.posed.conditions):
        return Result(problem.about, "good")
    difference, most = energy_difference(coarse, fine), one.sigma_bound + two.sigma_bound
    if one.guaranteed and two.guaranteed and difference > (1 + 1e-9) * most:
        return Result(problem.about, f"the stresses differ by {difference:.3g}, their bounds add up to {most:.3g}")
    return Result(problem.about, "good")


def mixture(seed: int) -> list[Found]:
    """Examine a problem (collective)."""
    result = examine(seed)
    return [Found(f"{result.about}: {result.ending}", [result.ending] * result.good, {}, not result.good, shown=False)]
