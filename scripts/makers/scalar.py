"""Random scalar problems, with one law or several, against independent solvers.

Each seed draws a shape, a mesh (structured, unstructured, or stretched and sheared), boundary parts, smooth or rough
data, κ with jumps of up to 1e6, an algorithm and a backend. Algorithms 1 and 2 are compared with SNESVI, Algorithms 3
and 4 with SNES on the block system with the same ε. With several laws each part of Γ_S has Signorini, friction,
two-sided bounds, a wall, a regulator or a random monotone graph, with data that vary along the part, and some problems
have no Γ_D; there may be one to three laws in Ω as well, some in one half of it. Then the other solver is a quadratic
programme; where that fails, as where κ jumps on bad cells, it is the other algorithm with the other backend.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from mpi4py import MPI
from ufl.core.expr import Expr

from makers import Found
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import options_of
from signorini_fenicsx.contact.law import EVERYWHERE, Law
from signorini_fenicsx.contact.laws import Corners, Friction, Obstacle, Reaction, Regulator, Signorini, TwoSided, Wall
from signorini_fenicsx.meshes.domain import Boundary, Domain
from signorini_fenicsx.meshes.sampling import of_unit_size
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve

AGREE = 1e-7
"""Largest relative difference of p and σ by rounding."""
SIZES = {"square": 0.2, "lshape": 0.4, "half_disk": 0.3, "annulus": 0.4, "cube": 0.6, "lprism": 0.9, "ball": 0.9}
NOT_UNIQUE = "without a unique solution"
NO_SOLUTION = "no part of the boundary", "u_D on Γ_D", "u cannot be both"
"""What is said of problems whose solution is not unique, or whose laws contradict each other or u_D."""
REFERENCES = {"alg1": "vi", "alg2": "vi", "alg3": "snes1", "alg4": "snes2"}


@dataclass(frozen=True)
class Result:
    """The result of a seed.

    Attributes:
        problem: The problem in words.
        ending: Why the algorithm ended.
        kkt: Largest KKT residual.
        difference: Largest relative difference of p or σ from the reference; NaN if the reference failed.
    """

    problem: str
    ending: str
    kkt: float
    difference: float

    @property
    def good(self) -> bool:
        """Whether it is a solution, and equal to the reference if there is one."""
        return self.ending.startswith("the facet sets repeat") and self.kkt <= KKT and not self.difference > AGREE

    def found(self, counts: list[str], *, wrong: bool) -> Found:
        """It in words, which are shown unless it is as it should be."""
        numbers = {"KKT": self.kkt} | ({} if np.isnan(self.difference) else {"difference": self.difference})
        words = f"{self.problem}: {self.ending}; KKT {self.kkt:.1e}; {self.difference:.1e}"
        return Found(words, counts, numbers if np.isfinite(self.kkt) else {}, wrong, shown="failed" in counts)


type Drawn = tuple[Domain, Problem, Options, str]
"""A mesh, the problem, how it is solved, and a description."""


def random_problem(seed: int, *, several: bool = False, inside: bool = False) -> Drawn:
    """A problem with one law, or with several, if it is wanted also inside."""
    rng = np.random.default_rng([seed, 1] if several else seed)
    case = random_case(rng)
    domain, options, laws = mesh_case(case, MPI.COMM_SELF), options_of(case), list[Law]()
    bad = distort(rng, domain)
    contrast = 10 ** rng.uniform(0, 6) if rng.random() < (0.5 if several else 0.7) else 1.0
    signorini, neumann = case.boundary.signorini, case.boundary.neumann
    if several:
        size = float(np.ptp(domain.mesh.geometry.x, axis=0).max())
        with_law = list(domain.parts) if rng.random() < 0.2 else signorini
        signorini, neumann = [], [part for part in neumann if part not in with_law]
        laws = [random_law(rng, part, size) for part in with_law]
        domain = halved(domain) if inside else domain
        laws += random_laws_inside(rng, size) if inside else []
    problem = replace(data_on(rng, domain, "aligned", contrast)(domain), boundary=Boundary(signorini, neumann))
    if several:
        problem = replace(problem, psi=0.0, q_S=0.0, laws=laws)
        algorithm = str(rng.choice(["alg1", "alg2"]))
        options = Options(algorithm=algorithm, backend=options.backend, max_iterations=200)
    words = [case.geometry.shape or "", case.geometry.mesh, "bad cells" if bad else "", f"Γ_N {neumann}"]
    words += [f"Γ_S {signorini}"] if signorini else [f"{law.name} on {(law.parts or law.region)[0]}" for law in laws]
    words += [f"κ 1 to {contrast:.0e}", options.algorithm_name, options.backend_name]
    return domain, problem, options, ", ".join(word for word in words if word)


def random_case(rng: np.random.Generator) -> Case:
    """A shape, its mesh, its boundary parts, an algorithm and a backend."""
    shape = str(rng.choice(list(SIZES)))
    parts = [str(part) for part in rng.permutation(list(SHAPES[shape].parts))]
    signorini = parts[: rng.integers(1, len(parts))]
    others = parts[len(signorini) :]
    neumann = others[: rng.integers(0, len(others))]
    structured = SHAPES[shape].grid is not None and rng.random() < 0.5
    algorithm, backend = (str(rng.choice(names)) for names in (list(REFERENCES), ["hybrid", "mixed"]))
    return load_case("example1").with_values(
        {
            "geometry.shape": shape,
            "geometry.mesh": "structured" if structured else "unstructured",
            "boundary.signorini": signorini,
            "boundary.neumann": neumann,
            "solve.h": SIZES[shape] * rng.uniform(0.7, 1.2),
            "solve.algorithm": algorithm,
            "solve.backend": backend,
            "solve.eps": 10 ** rng.uniform(-10, 0),
        }
    )


def distort(rng: np.random.Generator, domain: Domain) -> bool:
    """Stretch and shear four of ten meshes; return whether this one was."""
    x = domain.mesh.geometry.x
    bad = bool(rng.random() < 0.4)
    if bad:
        x[:, 1] *= 10 ** rng.uniform(-2, 1)
        x[:, 0] += rng.uniform(-4, 4) * x[:, 1]
    return bad


class Wave:
    """sin(k·x + a) on any mesh; numbers are constants, so that forms are compiled once for all seeds."""

    def __init__(self, rng: np.random.Generator, size: float, amplitude: float = 1.0):
        self._k, self._a, self._amplitude = rng.uniform(1, 10, 3) / size, rng.uniform(0, 6), amplitude

    def on(self, mesh: dolfinx.mesh.Mesh) -> Expr:
        """Its expression."""
        x = ufl.SpatialCoordinate(mesh)
        k, a, amplitude = (fem.Constant(mesh, value) for value in (self._k[: len(x)], self._a, float(self._amplitude)))
        return amplitude * ufl.sin(ufl.dot(k, x) + a)


def data_on(
    rng: np.random.Generator, coarse: Domain, jumps: str, contrast: float = 1e6, *, pulled: bool = False
) -> Callable[[Domain], Problem]:
    """Data that are the same on the coarse mesh and on its refinements (collective)."""
    size = float(np.ptp(coarse.box(), axis=0).max())
    amplitudes = rng.uniform(0, 1, 4) * [1, 1, 1 / size, 1 / size]
    u_D, psi, q_S, g_N = (Wave(rng, size, amplitude) for amplitude in amplitudes)
    f, zone, noise = (Wave(rng, size, amplitude) for amplitude in (40 / size**2, 1, 1e3))
    general, rough = rng.random() < 0.7, rng.random() < 0.5
    cells = fem.functionspace(coarse.mesh, ("DG", 0))
    zones, loads = fem.Function(cells), fem.Function(cells)
    points = cells.element.interpolation_points
    zones.interpolate(fem.Expression(zone.on(coarse.mesh), points))
    loads.interpolate(fem.Expression(80 / size**2 * ufl.sin(noise.on(coarse.mesh)), points))

    def on(domain: Domain) -> Problem:
        mesh = domain.mesh
        where = in_cells(zones, coarse, domain) if jumps == "aligned" else zone.on(mesh)
        load = in_cells(loads, coarse, domain) if rough else f.on(mesh)
        kappa = 1.0 if jumps == "none" else ufl.conditional(ufl.gt(where, 0), fem.Constant(mesh, contrast), 1.0)
        problem = Problem(f=load - fem.Constant(mesh, 120 / size**2 * pulled), kappa=kappa)
        if not general:
            return problem
        bound = psi.on(mesh)
        u_D_too = bound + u_D.on(mesh) ** 2
        return replace(problem, u_D=u_D_too, psi=bound, q_S=q_S.on(mesh), g_N=g_N.on(mesh))

    return on


def in_cells(function: fem.Function, source: Domain, domain: Domain) -> fem.Function:
    """A P0 function on a refinement of its mesh (collective)."""
    if domain is source:
        return function
    mesh = domain.mesh
    fine = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    cells = owned_cells(mesh)
    with of_unit_size(source, mesh, source.mesh):
        search = fem.create_interpolation_data(fine.function_space, function.function_space, cells, padding=1e-12)
        fine.interpolate_nonmatching(function, cells, search)
    return fine


def examine(seed: int, *, several: bool = False, inside: bool = False) -> Result:
    """Solve the problem of a seed with its algorithm, and in another way."""
    domain, problem, options, words = random_problem(seed, several=several, inside=inside)
    ways = [replace(options, algorithm=REFERENCES[options.algorithm_name])]
    if several:
        algorithm = "alg2" if options.algorithm_name == "alg1" else "alg1"
        backend = "mixed" if options.backend_name == "hybrid" else "hybrid"
        ways = [replace(options, algorithm="qp"), replace(options, algorithm=algorithm, backend=backend)]
    try:
        return solved(domain, problem, options, words, ways)
    except InputError as error:
        if any(said in str(error) for said in NO_SOLUTION):
            return Result(words, NOT_UNIQUE, np.nan, np.nan)
        raise


def solved(domain: Domain, problem: Problem, options: Options, words: str, ways: Sequence[Options]) -> Result:
    """Solve a problem, and in the first of other ways that does not fail."""
    try:
        solution = solve(domain, problem, options)
    except NumericalFailure as failure:
        return Result(words, str(failure), np.inf, np.nan)
    differences = (apart(solution, domain, problem, way) for way in ways)
    difference = next((number for number in differences if number is not None), np.nan)
    return Result(words, solution.outcome.reason, max(vars(solution.kkt).values()), difference)


def apart(solution: Solution, domain: Domain, problem: Problem, way: Options) -> float | None:
    """The relative difference of σ and p from those of another way to solve; None if that way fails."""
    try:
        expected = solve(domain, problem, way)
    except (NumericalFailure, InputError):
        return None
    size = max(float(np.abs(values.x.array).max(initial=0.0)) for values in (solution.p, solution.u))
    of_trace = float(np.abs(solution.p.x.array - expected.p.x.array).max(initial=0.0))
    return max(distance(solution.sigma, expected.sigma), of_trace / size if size > 0 else 0.0)


def distance(values: fem.Function, expected: fem.Function) -> float:
    """Largest difference of degrees of freedom, relative to the largest of them."""
    a, b = values.x.array, expected.x.array
    largest = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))
    return float(np.abs(a - b).max(initial=0.0) / largest) if largest > 0 else 0.0


AGREE_OF_LAWS = 1e-6
"""Relative difference of p and σ that is left to the interior-point method where κ jumps."""


def random_level(rng: np.random.Generator, size: float, low: float, high: float, power: int = 0) -> str:
    """A number between two over a power of the size, plus a share of a wave: never negative if no number is."""
    k, a = rng.uniform(1, 10, 2) / size, rng.uniform(0, 6)
    wave = f"sin({k[0]}*x + {k[1]}*y + {a})"
    return f"({rng.uniform(low, high) / size**power}*(1 + {rng.choice([0.0, 0.5, 1.0])}*{wave}))"


def random_law(rng: np.random.Generator, part: str, size: float) -> Law:
    """A law with data of order 1 on a domain of any size."""

    def level(low: float, high: float, power: int = 0) -> str:
        return random_level(rng, size, low, high, power)

    kind = rng.integers(6)
    if kind == 0:
        return Signorini([part], psi=level(-0.5, 0.2), q_S=level(-1, 1, 1))
    if kind == 1:
        return Friction([part], g=level(0, 2, 1))
    if kind == 2:
        psi = level(-0.2, 0.2)
        return TwoSided([part], psi=psi, psi_upper=f"{psi} + {level(0, 0.5)}", q_S=level(-1, 1, 1))
    if kind == 3:
        return Wall([part], beta=level(0, 10 ** rng.uniform(-2, 4), 1), level=level(-0.5, 0.5))
    if kind == 4:
        low = level(-1, 0.5, 1)
        k = 10 ** rng.uniform(-2, 4) / size
        return Regulator([part], k=k, g_low=low, g_high=f"{low} + {level(0, 2, 1)}", a=level(-0.2, 0.2))
    return random_graph(rng, part, size)


def random_graph(rng: np.random.Generator, part: str, size: float) -> Law:
    """One to five corners, some of them on vertical or flat lines."""
    number = rng.integers(1, 6)
    steps = rng.exponential(0.2, (number, 2)) * (rng.random((number, 2)) < 0.7)
    u, flux = rng.uniform(-0.5, 0) + np.cumsum(steps[:, 0]), (rng.uniform(0, 1) - np.cumsum(steps[:, 1])) / size
    ends = [str(rng.choice(["vertical", "0", "3"])) for _ in range(2)]
    return Corners([part], list(zip(u.tolist(), flux.tolist(), strict=True)), *ends)


REGIONS = (EVERYWHERE, "west", ["east"])


def random_laws_inside(rng: np.random.Generator, size: float, regions: Sequence[Any] = REGIONS) -> list[Law]:
    """One to three laws in Ω: obstacles, reactions, graphs; on bounds of u they do not contradict one another."""
    laws: list[Law] = []
    for number in range(rng.integers(1, 4)):
        region = regions[rng.integers(len(regions))]
        kind = rng.integers(4 if number == 0 else 3)
        corners = rng.integers(1, 4)
        steps = rng.exponential(0.2, (corners, 2)) * (rng.random((corners, 2)) < 0.7)
        u, s = np.cumsum(steps, axis=0).T
        if kind == 0:
            laws.append(Reaction(region=region, c=random_level(rng, size, 0, 3, 2)))
        elif kind < 3:
            s = (s - rng.uniform(0, 1)) / size**2
            ends = rng.choice(["0", "3"], 2)
            laws.append(Corners(list(zip((u - 0.3).tolist(), s.tolist(), strict=True)), *ends, region=region))
        else:
            psi = random_level(rng, size, -0.3, -0.1)
            upper = f"{psi} + {random_level(rng, size, 0.3, 0.8)}"
            laws.append(Obstacle(region=region, **dict([("psi", psi), ("psi_upper", upper)][: rng.integers(1, 3)])))
    return laws


def halved(domain: Domain) -> Domain:
    """The domain with two regions, west and east."""
    middle = compute_midpoints(domain.mesh, domain.mesh.topology.dim, owned_cells(domain.mesh))[:, 0]
    west = middle < np.median(middle)
    cells = {name: np.flatnonzero(inside).astype(np.int32) for name, inside in (("west", west), ("east", ~west))}
    return replace(domain, regions=cells)


def random_scalar(seed: int, several: bool = False, inside: bool = False) -> list[Found]:
    """Examine a problem; with several laws it may fail, but not be wrong."""
    result = examine(seed, several=several, inside=inside)
    if result.ending == NOT_UNIQUE:
        return [Found("", [NOT_UNIQUE], shown=False)]
    repeats = "sets repeat" in result.ending
    counts = ["good" if repeats else "failed", *["no reference"] * bool(np.isnan(result.difference))]
    counts += ["by single changes"] * ("by changing single" in result.ending)
    off = result.kkt > KKT or result.difference > AGREE_OF_LAWS
    return [result.found(counts, wrong=repeats and off if several else not result.good)]
