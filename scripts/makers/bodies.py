"""Random elastic bodies and flows: what all solvers must find alike, and bounds that must be sharp and never too low.

`elasticity` mixes all that elastic problems take. A seed chooses plane or space, one body or two that touch, a
parallelepiped of any size and slant, units, an isotropic or orthotropic material, strains and stresses of its own,
loads, supports, and on each part contact, with friction or a tool that moves, or another law. `pairs` are boxes with
meshes of their own, whose facets do not match; the upper one may end inside a facet of the lower one. `rough` loads,
pressures, gaps and bounds of Tresca are texts with jumps, kinks, roots and waves off the mesh. `flows` have an outlet,
a wall that leaks or one with slip, an inlet, forces and pressures.

There need not be a solution; then it must be said in a sentence. Otherwise Algorithms 1 and 2 find the same, loads and
reactions are in balance, and the bound is compared with ‖σ_f − σ_h‖, with σ_f from a mesh that is refined where its
bound says so. A row has this distance, the ratio of the bound of σ_h to it, and that of the bound of σ_f. If the first
is below 1, the second decides whether σ_f is not exact enough or the bound is too low. Only guaranteed bounds count,
and none with Coulomb's friction, whose bounds are to another problem on each mesh.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from boxes import box
from mpi4py import MPI

from makers import Found
from makers.bounds import Row
from signorini_fenicsx.api import (
    Contact,
    Corners,
    Coulomb,
    Dirichlet,
    Domain,
    Elasticity,
    InputError,
    Leak,
    Neumann,
    NumericalFailure,
    Options,
    Outflow,
    Pair,
    Pressure,
    Regulator,
    Slip,
    Stokes,
    Support,
    Tresca,
    TwoSided,
    Wall,
    certify,
    domain_of_bodies,
    solve,
)
from signorini_fenicsx.certificate.adaptive import adapt
from signorini_fenicsx.comparing.comparison import differences
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

AGREE = 1e-8
"""Largest relative difference of two algorithms, and what may be left of the balance."""
SAME = 1e-9
"""A solution that is nearer to that on a finer mesh, as a share of it, is the exact one."""
NO_SOLUTION = ("move rigidly", "slides away", "passes the foundation where parts meet", "must not grow from corner")
NO_SOLUTION += ("more comes in",)
"""What is said of problems without a solution."""

type Made = tuple[str, Domain, Any]
"""A problem in words, its mesh, and the problem."""

CELLS = {2: 1500, 3: 3000}
"""The finer mesh has at most so many, by dimension."""


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


def elasticity(rng: np.random.Generator) -> Made:
    """All that elastic problems take (collective)."""
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

    low = -float(rng.choice([0.5, 1.0])) if touching else 0.0
    turn = size * (np.eye(dim) + (rng.random() < 0.7) * rng.uniform(-0.25, 0.25, (dim, dim)))
    numbers, cut = [cells] * (dim - 1) + [round(cells * (1 - low))], 0.0 if touching else None
    chosen = list(conditions())
    domain = box([0.0] * (dim - 1) + [low], [1.0] * dim, numbers, MPI.COMM_WORLD, cut=cut, turn=turn)
    posed = Elasticity(f=vector(stress / size), conditions=chosen, **materials(rng, dim, young))  # type: ignore[arg-type]
    about = ", ".join(f"{type(each).__name__.lower()} on {'/'.join(each.parts)}" for each in posed.conditions)
    return f"{dim}D, E = {posed.young}, ν = {posed.poisson}, size {size:g}: {about}", domain, posed


def pairs(rng: np.random.Generator) -> Made:
    """Two boxes with meshes of their own."""
    dim = int(rng.choice([2, 2, 2, 3]))
    narrow = rng.uniform(0, 0.2, 2) * rng.integers(0, 2)
    sizes, height = rng.integers(3, 7, 2) if dim == 2 else rng.permutation([2, 3]), rng.choice([0.0, 0.05])
    low, high = np.array([[0.0] * (dim - 1) + [-0.8], [1.0] * (dim - 1) + [0.0]])
    up, zeros = height + 0.8, [0.0] * (dim - 2)
    over, under = low + np.array([narrow[0], *zeros, up]), high + np.array([-narrow[1], *zeros, up])
    ends = {"up": (over, under), "low": (low, high)}
    bodies = {name: box(*ends[name], [int(n)] * dim, MPI.COMM_SELF) for name, n in zip(ends, sizes, strict=True)}
    domain = domain_of_bodies(bodies)
    faces = [part for part in domain.parts if part not in ("up.top", "up.bottom", "low.top", "low.bottom")]
    stiff, law = float(rng.choice([0.2, 1.0, 5.0])), Tresca(float(rng.uniform(0, 0.05))) if rng.random() < 0.4 else None
    push = [*rng.uniform(-0.02, 0.02, dim - 1).tolist(), -height - rng.uniform(0.02, 0.06)]
    poisson = float(rng.choice([0.0, 0.3, 0.45, 0.49]))
    body = Elasticity(
        {"up": 1.0, "low": stiff},
        poisson,
        conditions=[
            Dirichlet("up.top", push),
            Dirichlet("low.bottom", [0] * dim),
            Neumann(faces),
            Pair("up.bottom", "low.top", law),
        ],
    )
    words = "ends inside facets" if narrow.any() else "as wide"
    return f"pair in {dim}D, {words}, {sizes}, E = {stiff}, ν = {poisson}, {law}", domain, body


def rough(rng: np.random.Generator) -> Made:
    """A body with rough data."""
    shape = str(rng.choice(["square", "square", "lshape", "square", "square", "cube"]))
    dim = SHAPES[shape].dim
    mesh = str(rng.choice(["structured", "unstructured"])) if dim == 2 else "structured"
    coarse = build_domain(MPI.COMM_SELF, shape, rng.uniform(0.3, 0.6) if dim == 2 else 1.7, mesh=mesh)
    parts = [str(part) for part in rng.permutation(list(SHAPES[shape].parts))]
    along = " + ".join(f"{a:.3f}*{x}" for a, x in zip(rng.uniform(0.3, 1, dim), "xyz", strict=False))

    def text(size: float, *, positive: bool = False) -> str:
        a, b = np.round(size * rng.uniform(0 if positive else -1, 1, 2), 4)
        s, k, c = f"({along} - {rng.uniform(0.1, 0.9):.3f})", rng.uniform(3, 20), abs(a)
        texts = [f"{a} if {s} < 0 else {b}", f"{c}*abs{s}", f"{c}*max(0, {s})", f"{c}*sqrt(abs{s})"]
        texts += [f"{c}*sin({k:.2f}*{s})^2", f"{c}*exp(-{k:.2f}*{s}^2)", f"{c} + {abs(b)}*{s}^6"]
        return str(rng.choice(texts))

    friction = Tresca(text(0.1, positive=True)) if rng.random() < 0.6 else None
    touching = Contact(parts[0], gap=text(0.05, positive=True), friction=friction)
    pressed = (
        Pressure(parts[1], text(0.5)) if rng.random() < 0.5 else Neumann(parts[1], [text(0.5) for _ in range(dim)])
    )
    young = "1 + x^2" if rng.random() < 0.2 else 1.0
    load = [text(1.0) if rng.random() < 0.5 else 0 for _ in range(dim)]
    body = Elasticity(young, float(rng.choice([0.0, 0.3, 0.45])), f=load, conditions=[touching, pressed])
    return f"{shape}, {touching}, {pressed}, f = {load}, E = {young}", coarse, body


def flows(rng: np.random.Generator) -> Made:
    """A flow."""
    shape = str(rng.choice(["square", "square", "lshape", "square", "cube"]))
    dim = SHAPES[shape].dim
    size, mesh = (rng.uniform(0.2, 0.5), "unstructured") if dim == 2 else (1.7, "structured")
    coarse = build_domain(MPI.COMM_SELF, shape, size, mesh=mesh)
    parts = [str(part) for part in rng.permutation(list(SHAPES[shape].parts))]
    inlet, (first, second) = "left", [part for part in parts if part != "left"][:2]
    low, held, g = -rng.uniform(0, 0.1), str(rng.choice(["free", "held"])), float(rng.uniform(0, 0.5))
    laws = [Outflow(first, least=low, pressure=rng.uniform(-1, 1), tangential=held), Leak(first, g=g), Slip(first, g=g)]
    law = laws[rng.integers(0, 3)]
    pressed = Pressure(second, f"{rng.uniform(-1, 1)} + {rng.uniform(-2, 2)}*y") if rng.random() < 0.5 else Slip(second)
    speed = f"{rng.uniform(-1, 1)}*y*(1 - y)" if shape == "square" and rng.random() < 0.6 else 0
    load = [f"{a} + {b}*x" for a, b in rng.uniform(-2, 2, (dim, 2))]
    given = Dirichlet(inlet, [speed, *[0] * (dim - 1)])
    flow = Stokes(float(rng.choice([0.1, 1.0, 7.0])), f=load, conditions=[given, law, pressed])
    return f"{shape}, μ = {flow.viscosity}, u = {speed} left, {law}, {pressed}", coarse, flow


MAKERS = {"elasticity": elasticity, "pairs": pairs, "rough": rough, "flows": flows}


@dataclass(frozen=True)
class ElasticRow(Row):
    """The result of a seed.

    Attributes:
        ending: "good", "no solution", or what is wrong.
        dim: Dimension.
        finer: The bound of the solution on the finer mesh.
    """

    ending: str = "good"
    dim: int = 2
    finer: float = np.nan


def examine(kind: str, seed: int, cells: Mapping[int, int] = CELLS) -> ElasticRow:
    """Solve the problem of a seed by two algorithms, and bound it (collective).

    Args:
        kind: One of `MAKERS`.
        seed: The seed.
        cells: The finer mesh has at most so many, by dimension.
    """
    about, domain, posed = MAKERS[kind](np.random.default_rng(seed))
    try:
        solution = solve(domain, posed)
        other = solve(domain, posed, Options(algorithm="alg2")).norms()
    except (InputError, NumericalFailure) as error:
        ending = "no solution" if any(words in str(error) for words in NO_SOLUTION) else str(error)
        return ElasticRow(about, np.nan, np.nan, wrong=ending != "no solution", ending=ending)
    norms, dim, certificate = solution.norms(), domain.mesh.topology.dim, certify(solution)
    off = max(abs(other[key] - norms[key]) / norms[key] for key in ("energy", "sigma_L2", "u_L2") if norms[key])
    balance = solution.quantities()["balance"]
    if max(off, balance) > AGREE:
        ending = f"Algorithms 1 and 2 differ by {off:.1e}, the balance lacks {balance:.1e}"
        return ElasticRow(about, np.nan, np.nan, wrong=True, ending=ending)
    of_coulomb = any(isinstance(getattr(each, "friction", None), Coulomb) for each in posed.conditions)
    if of_coulomb or not certificate.guaranteed:
        return ElasticRow(about, np.nan, certificate.sigma_bound, wrong=False, dim=dim)

    def solve_on(finer: Domain, start: ElasticSolution | None) -> ElasticSolution:
        return solve(finer, posed, start=start)

    finer, of_finer = adapt(domain, solve_on, max_cells=cells[dim])
    difference = differences(solution, finer).energy
    difference = difference if difference > SAME * norms["energy"] else np.nan
    wrong = certificate.sigma_bound < (1 - 1e-9) * (difference - of_finer.sigma_bound)
    return ElasticRow(about, difference, certificate.sigma_bound, wrong, dim=dim, finer=of_finer.sigma_bound)


def random_body(seed: int, kind: str) -> list[Found]:
    """Examine a problem; nothing if it has no solution (collective)."""
    row = examine(kind, seed)
    if row.ending == "no solution":
        return []
    if np.isnan(row.difference):
        return [Found(f"{row.problem}: {row.ending}", [row.ending] * (not row.wrong), {}, row.wrong, shown=False)]
    words = f"{row.difference:10.3e} {row.ratio:6.3f} {row.finer / row.difference:6.3f} {row.problem}"
    return [Found(words, ["good", *["below 1"] * (row.ratio < 1)], {f"{row.dim}D: ratio": row.ratio}, row.wrong)]
