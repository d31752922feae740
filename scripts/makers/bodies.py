"""Random elastic bodies and flows: what all solvers must find alike, and bounds that must be sharp and never too low.

`mixture` mixes all that elastic problems take. A seed chooses plane or space, one body or two that touch, a
parallelepiped of any size and slant, units, an isotropic or orthotropic material, strains and stresses of its own,
loads, supports, and on each part contact, with friction or a tool that moves, or another law. There need not be a
solution; then it must be said in a sentence. Otherwise Algorithms 1 and 2 find the same, loads and reactions are in
balance, and a stress on a mesh half as fine is within the two bounds, but for Coulomb's friction, whose bounds are to
another problem on each mesh.

`body_bound` has bounds against solutions on adaptive meshes. A seed chooses the square, the L-shape or the cube, its
mesh, the parts in contact, loaded, or fixed in a component, a constant f, linear tractions, a curved gap, ν from 0 to
0.49 and, in the plane, sometimes Tresca's friction: all of them are in the discrete spaces, so that the bound is
guaranteed. A row has ‖σ_f − σ_h‖ with σ_f from a mesh that is refined where its bound says so, the ratio of the bound
of σ_h to it, and that of the bound of σ_f. If the first is below 1, the second decides whether σ_f is not exact enough
or the bound is too low. Two bodies touch along a slanted side, with an opening between them, different E and, in half
of the plane problems, Tresca's friction. Pairs are boxes with meshes of their own, whose facets do not match; the upper
one may end inside a facet of the lower one. Rough loads, pressures, gaps and bounds of Tresca are texts with jumps,
kinks, roots and waves off the mesh: then only guaranteed bounds count. A flow has an outlet, a wall that leaks or one
with slip, an inlet, forces and pressures.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
from collections.abc import Iterator
from dataclasses import dataclass

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
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.certificate.adaptive import adapt
from signorini_fenicsx.contact.laws import Friction
from signorini_fenicsx.discrete.linear_traces import opposite
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import (
    Cells,
    SplitQuadrature,
    split_vertices,
    to_entries,
)
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

AGREE = 1e-8
"""Largest relative difference of two algorithms, and what may be left of the balance."""
NO_SOLUTION = ("move rigidly", "slides away", "passes the foundation where parts meet", "must not grow from corner")
"""What is said of problems without a solution."""


CELLS = {2: 1500, 3: 3000}
"""The finer mesh has at most so many, by dimension;"""
OF_ROUGH = 0.4
"""of problems with rough data this share of them."""


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


def random_problem(seed: int) -> tuple[str, list[Domain], Elasticity]:
    """The problem of a seed in words, two meshes, the second half as fine, and the problem (collective)."""
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

    low = -float(rng.choice([0.5, 1.0])) if touching else 0.0
    turn = size * (np.eye(dim) + (rng.random() < 0.7) * rng.uniform(-0.25, 0.25, (dim, dim)))
    chosen, domains = list(conditions()), [slanted(dim, low, turn, n * cells, MPI.COMM_WORLD) for n in (1, 2)]
    posed = Elasticity(f=vector(stress / size), conditions=chosen, **materials(rng, dim, young))  # type: ignore[arg-type]
    about = ", ".join(f"{type(each).__name__.lower()} on {'/'.join(each.parts)}" for each in posed.conditions)
    return f"{dim}D, E = {posed.young}, ν = {posed.poisson}, size {size:g}: {about}", domains, posed


def examine(domains: list[Domain], posed: Elasticity) -> str:
    """What comes of a problem: "good", "no solution", or what is wrong (collective)."""
    try:
        coarse, fine = (solve(domain, posed) for domain in domains)
        other = solve(domains[0], posed, Options(algorithm="alg2"))
    except (InputError, NumericalFailure) as error:
        return "no solution" if any(words in str(error) for words in NO_SOLUTION) else str(error)
    norms = coarse.norms()
    off = max(abs(other.norms()[key] - norms[key]) / norms[key] for key in ("energy", "sigma_L2", "u_L2"))
    if off > AGREE:
        return f"Algorithms 1 and 2 differ by {off:.1e}"
    if coarse.quantities()["balance"] > AGREE:
        return f"the balance lacks {coarse.quantities()['balance']:.1e}"
    one, two = certify(coarse), certify(fine)
    if any(isinstance(each, Contact) and isinstance(each.friction, Coulomb) for each in posed.conditions):
        return "good"
    difference, most = energy_difference(coarse, fine), one.sigma_bound + two.sigma_bound
    if one.guaranteed and two.guaranteed and difference > (1 + 1e-9) * most:
        return f"the stresses differ by {difference:.3g}, their bounds add up to {most:.3g}"
    return "good"


def mixture(seed: int) -> list[Found]:
    """Examine a problem (collective)."""
    about, *problem = random_problem(seed)
    ending = examine(*problem)
    good = ending in ("good", "no solution")
    return [Found(f"{about}: {ending}", [ending] * good, {}, not good, shown=False)]


@dataclass(frozen=True)
class ElasticRow(Row):
    """The result of a seed.

    Attributes:
        poisson: ν.
        dim: Dimension.
        finer: The bound of the solution on the finer mesh.
    """

    poisson: float
    dim: int
    finer: float


def problem_of(rng: np.random.Generator, shape: str) -> ElasticProblem:
    """A random problem whose data are in the discrete spaces."""
    dim = SHAPES[shape].dim
    parts = [str(part) for part in rng.permutation(list(SHAPES[shape].parts))]
    contact, loaded, held = parts[:1], parts[1 : 1 + rng.integers(0, dim + 1)], parts[-1]
    fixed = {parts[-2]: "n"} if parts[-2] not in loaded and rng.random() < 0.4 else {}
    boundary = ElasticBoundary(contact, [part for part in loaded if part != held], fixed)

    def linear(size: float) -> str:
        a = rng.uniform(-size, size, dim + 1)
        return " + ".join([str(a[0]), *(f"({slope})*{x}" for slope, x in zip(a[1:], "xyz", strict=False))])

    middle = rng.uniform(0, 1, dim)
    bowl = " + ".join(f"({x} - {m})^2" for x, m in zip("xyz", middle, strict=False))
    laws = [Friction(contact, g=rng.uniform(0, 0.1))] if dim == 2 and rng.random() < 0.4 else []
    return ElasticProblem(
        young=1.0,
        poisson=float(rng.choice([0.0, 0.3, 0.45, 0.49])),
        f=[str(x) for x in rng.uniform(-1, 1, dim)],
        g_N=[linear(0.5) for _ in range(dim)] if loaded else None,
        gap=f"{rng.uniform(0, 0.1)} + {rng.uniform(0, 0.2)}*({bowl})",
        laws=laws,
        boundary=boundary,
    )


def slanted(dim: int, low: float, turn: Array, cells: int, comm: MPI.Comm) -> Domain:
    """A parallelepiped; if low < 0, two on top of each other, cut along their common side, the part `fault`."""
    corner, numbers = [0.0] * (dim - 1) + [low], [cells] * (dim - 1) + [round(cells * (1 - low))]
    return box(corner, [1.0] * dim, numbers, comm, cut=0.0 if low < 0 else None, turn=turn)


def problem_of_bodies(rng: np.random.Generator, dim: int) -> Elasticity:
    """A random problem of two bodies whose data are in the discrete spaces; each body is held on one side."""
    opening = f"{rng.uniform(0, 0.05)} + {rng.uniform(0, 0.1)}*(x - {rng.uniform(0, 1)})^2"
    friction = Tresca(float(rng.uniform(0, 0.1))) if dim == 2 and rng.random() < 0.5 else None
    load = [str(x) for x in rng.uniform(-0.5, 0.5, dim)]
    return Elasticity(
        young={"upper": 1.0, "lower": float(rng.choice([0.2, 1.0, 5.0]))},
        poisson=float(rng.choice([0.0, 0.3, 0.45, 0.49])),
        f=[str(x) for x in rng.uniform(-1, 1, dim)],
        conditions=[
            Dirichlet([str(rng.choice(["top", "right"]))], ["0"] * dim),
            Dirichlet(["bottom"], ["0"] * dim),
            Neumann(["left"], load),
            Contact(["fault"], gap=opening, friction=friction),
        ],
    )


def energy_difference(coarse: ElasticSolution, fine: ElasticSolution) -> float:
    """‖σ − σ'‖ in the energy norm, by quadrature on the finer mesh, each point searched in all cells."""
    dim, cells = fine.spaces.dim, np.arange(len(fine.spaces.vertices), dtype=np.int32)
    compliance = fine.data.material.compliance(fine.data.points(fine.spaces, cells))[:, 0]
    rule = SplitQuadrature.of_degree(dim, 2)
    corners = split_vertices(fine.spaces.vertices)
    points = np.einsum("qa,nsai->nsqi", rule.local, corners)
    off = np.einsum("qa,nsaij->nsqij", rule.local, fine.stresses)
    off -= stress_at(coarse, points.reshape(-1, dim)).reshape(off.shape)
    off = to_entries(off)
    product = np.einsum("nsqe,nef,nsqf->nsq", off, compliance, off)
    weights = Cells(fine.spaces.vertices).measure[:, None, None] / (dim + 1) * rule.weights
    return float(np.sqrt((weights * product).sum()))


def stress_at(solution: ElasticSolution, points: Array) -> Array:
    """σ_h at points, shape (points, d, d)."""
    vertices, dim = solution.spaces.vertices, solution.spaces.dim
    edges = np.linalg.inv((vertices[:, 1:] - vertices[:, :1]).transpose(0, 2, 1))
    nearest = np.full(len(points), -np.inf)
    shares, cells = np.empty((len(points), dim + 1)), np.zeros(len(points), dtype=np.int64)
    for cell, (inverse, corner) in enumerate(zip(edges, vertices[:, 0], strict=True)):
        rest = (points - corner) @ inverse.T
        share = np.column_stack([1 - rest.sum(axis=1), rest])
        better = share.min(axis=1) > nearest
        nearest[better], shares[better], cells[better] = share.min(axis=1)[better], share[better], cell
    subcells = shares.argmin(axis=1)  # the centroid and the vertices but one
    others = np.take_along_axis(shares, opposite(dim)[subcells], axis=1) - nearest[:, None]
    local = np.column_stack([others, (dim + 1) * nearest])
    return np.einsum("pa,paij->pij", local, solution.stresses[cells, subcells])


def one_body(seed: int) -> tuple[str, Domain, ElasticProblem]:
    """What the problem of a seed is, its mesh, and the problem."""
    rng = np.random.default_rng(seed)
    shape = str(rng.choice(["square", "lshape", "square", "cube"]))
    size, mesh = (rng.uniform(0.3, 0.6), "unstructured") if SHAPES[shape].dim == 2 else (1.7, "structured")
    coarse = build_domain(MPI.COMM_SELF, shape, size, mesh=mesh)
    problem = problem_of(rng, shape)
    friction = ", friction" if problem.laws else ""
    return (
        f"{shape}, contact on {', '.join(problem.boundary.contact)}, ν = {problem.poisson}{friction}",
        coarse,
        problem,
    )


def bodies(seed: int) -> tuple[str, Domain, ElasticProblem]:
    """What the problem of two bodies of a seed is, its mesh, and the problem."""
    rng = np.random.default_rng(seed)
    dim = int(rng.choice([2, 2, 2, 3]))
    low, stretch = -float(rng.choice([0.5, 1.0])), np.eye(dim) + rng.uniform(-0.25, 0.25, (dim, dim))
    coarse, conditions = slanted(dim, low, stretch, 4 if dim == 2 else 2, MPI.COMM_SELF), problem_of_bodies(rng, dim)
    problem = conditions.on(coarse)
    friction = ", friction" if problem.laws else ""
    return f"two bodies in {dim}D, E = {problem.young}, ν = {problem.poisson}{friction}", coarse, problem


def pairs(seed: int) -> tuple[str, Domain, ElasticProblem]:
    """What the problem of two boxes with meshes of their own is, their mesh, and the problem."""
    rng = np.random.default_rng(seed)
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
    return f"pair in {dim}D, {words}, {sizes}, E = {stiff}, ν = {poisson}, {law}", domain, body.on(domain)


def rough_body(seed: int) -> tuple[str, Domain, ElasticProblem]:
    """What the problem of a seed with rough data is, its mesh, and the problem."""
    rng = np.random.default_rng(seed)
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
    return f"{shape}, {touching}, {pressed}, f = {load}, E = {young}", coarse, body.on(coarse)


def flows(seed: int) -> tuple[str, Domain, ElasticProblem]:
    """What the flow of a seed is, its mesh, and the problem."""
    rng = np.random.default_rng(seed)
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
    return f"{shape}, μ = {flow.viscosity}, u = {speed} left, {law}, {pressed}", coarse, flow.on(coarse)


KINDS = {"flows": flows, "one": one_body, "bodies": bodies, "pairs": pairs, "rough": rough_body}
"""What a seed makes a problem of."""


def measured(seed: int, kind: str) -> ElasticRow:
    """Solve and bound the problem of a seed, of two bodies that touch or of one.

    Raises:
        InputError: If there is no such problem, as the body can move.
    """
    about, coarse, asked = KINDS[kind](seed)
    solution = solve(coarse, asked)

    def solve_on(domain: Domain, start: ElasticSolution | None) -> ElasticSolution:
        return solve(domain, asked, start=start)

    dim, rough = coarse.mesh.topology.dim, kind == "rough"
    finer, of_finer = adapt(coarse, solve_on, max_cells=round(CELLS[dim] * (OF_ROUGH if rough else 1.0)))
    certificate, difference = certify(solution), energy_difference(solution, finer)
    wrong = certificate.sigma_bound < (1 - 1e-9) * (difference - of_finer.sigma_bound)
    assert certificate.guaranteed or rough
    about, wrong = f"{certificate.reservation or 'guaranteed'} {about}", wrong and certificate.guaranteed
    poisson = 0.5 if asked.poisson is None else float(str(asked.poisson))
    return ElasticRow(about, difference, certificate.sigma_bound, wrong, poisson, dim, of_finer.sigma_bound)


def body_bound(seed: int, kind: str) -> list[Found]:
    """Compare a bound with a finer solution; nothing if there is no problem, as the body can move."""
    try:
        row = measured(seed, kind)
    except InputError as error:
        if not any(words in str(error) for words in ("move rigidly", "more comes in")):
            raise
        return []
    if row.difference <= 1e-12:
        return []
    words = f"{row.difference:10.3e} {row.ratio:6.3f} {row.finer / row.difference:6.3f} {row.problem}"
    group = f"{row.dim}D, {'ν ≤ 0.3' if row.poisson <= 0.3 else '0.3 < ν ≤ 0.5'}: ratio"
    return [Found(words, ["below 1"] * (row.ratio < 1), {group: row.ratio}, row.wrong)]
