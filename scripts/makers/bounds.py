"""Random certified bounds against solutions on the mesh refined twice, or exact fluxes: sharp, and never too low.

A seed chooses shape, mesh and boundary parts as `scalar` does, sometimes without Γ_D, a smooth or rough f, and waves
for u_D ≥ ψ, ψ, q_S and g_N. κ is 1 (`none`), or jumps between 1 and 1e6: between coarse cells (`aligned`), or also
within them (`across`). A row has ‖σ_f − σ_h‖ with σ_f from the finer mesh, and the ratio of the bound to it. If this
ratio is below 1, the bound of the finer mesh decides whether σ_f is not accurate enough or the bound is too low.

Strips are problems on the unit square or cube that depend on x alone, whose κ is nearly 0 in vertices or in cells. With
κ = a e eᵀ + r (I − e_x e_xᵀ), e = (1, s, 0), the flux is σ = (C − F)(1, s, 0), F = ∫f: u = U at both ends makes
∫ (C − F)/a = 0. The left side is in contact, and on the other sides σ·n is given.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import ufl
from mpi4py import MPI

from makers import Found
from makers.scalar import data_on, distort, random_case
from signorini_fenicsx import Diffusion, Neumann, Signorini
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import options_of
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.expressions import read, values
from signorini_fenicsx.forms.mixed import flux_product
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.meshes.refinement import refine
from signorini_fenicsx.meshes.sampling import sampled
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve


@dataclass(frozen=True)
class Row:
    """The result of a seed.

    Attributes:
        problem: The problem in words.
        difference: ‖σ_f − σ_h‖ in the energy norm.
        bound: The bound of ‖σ − σ_h‖.
        wrong: Whether the bound of the finer mesh proves that the bound is too low.
    """

    problem: str
    difference: float
    bound: float
    wrong: bool

    @property
    def ratio(self) -> float:
        """The bound divided by the error."""
        return self.bound / self.difference


def random_pair(seed: int, jumps: str, comm: MPI.Comm) -> tuple[Case, Domain, Domain, Callable[[Domain], Problem]]:
    """A case, its mesh, the mesh refined twice, and the data on both (collective)."""
    rng = np.random.default_rng(seed)
    case = random_case(rng)
    if shape_of(str(case.geometry.shape)).dim == 3:
        case = case.with_values({"solve.h": 1.5 * case.solve.h})  # refinement makes 64 times the cells
    pulled = bool(rng.random() < 0.2)
    coarse = mesh_case(case, comm)
    if pulled:
        case = case.with_values({"boundary.signorini": list(coarse.parts), "boundary.neumann": []})
    distort(rng, coarse)
    coarse = replace(coarse, parts={name: replace(part, nearest=None) for name, part in coarse.parts.items()})
    fine = coarse
    for _ in range(2):
        fine = refine(fine, owned_cells(fine.mesh))
    return case, coarse, fine, data_on(rng, coarse, jumps, pulled=pulled)


def _options(case: Case, element: str) -> Options:
    options = replace(options_of(case), element=element)
    return options if element == "RT0" else replace(options, backend="hybrid")


def examine(seed: int, jumps: str, comm: MPI.Comm, element: str = "RT0") -> Row:
    """Certify a solution and compare it with one on the finer mesh (collective).

    Raises:
        InputError: If the data of the seed have no solution.
        NumericalFailure: If a solve fails.
    """
    case, coarse, fine, problem = random_pair(seed, jumps, comm)
    boundary = case.posed(coarse.mesh.geometry.dim).boundary
    solution = solve(coarse, replace(problem(coarse), boundary=boundary), _options(case, element))
    finer = solve(fine, replace(problem(fine), boundary=boundary), Options(element=element))
    words = f"{case.geometry.shape} {case.geometry.mesh} {case.solve.algorithm} Γ_S {boundary.signorini}"
    bound, distance = certify(solution, for_signorini=True).sigma_bound, difference(solution, finer)
    wrong = bound < distance and bound < (1 - 1e-9) * (distance - certify(finer).sigma_bound)
    return Row(f"{words} Γ_N {boundary.neumann}", distance, bound, wrong)


def of_small(seed: int, comm: MPI.Comm) -> Row:
    """Certify a solution with a small κ and compare it with the exact flux (collective)."""
    rng = np.random.default_rng(seed)
    strip, shape = drawn(rng), str(rng.choice(["square", "square", "square", "cube"]))
    h = math.sqrt(2) / rng.integers(2, 9) if shape == "square" else math.sqrt(3) / rng.integers(1, 4)
    domain = build_domain(comm, shape, float(h), mesh=str(rng.choice(["structured", "unstructured"])))
    solution = solve(domain, strip.problem(domain.mesh.topology.dim))
    certificate, (error, size) = certify(solution), strip.norms(solution)
    low = min(certificate.sigma_bound / error, certificate.relative * size / certificate.bound)
    words = f"{shape} {h:.3g} {'guaranteed' if certificate.guaranteed else certificate.reservation} {strip}"
    return Row(words, error, certificate.sigma_bound, certificate.guaranteed and low < 1 - 1e-6)


def difference(coarse: Solution, fine: Solution) -> float:
    """‖σ_h − σ_f‖ on the finer mesh, in the energy norm (collective)."""
    degree = 6 if fine.spaces.degree else 2  # those of 4 and 5 have points on edges of tetrahedra, where σ_h jumps
    (sigma,) = sampled([coarse.sigma], fine.spaces.mesh, coarse.spaces.domain, degree=degree)
    form = flux_product(fine.sigma - sigma, fine.sigma - sigma, ufl.dx, fine.data.kappa_h)
    (integral,) = form.integrals()
    metadata = {"quadrature_degree": degree, "quadrature_scheme": "default"}
    return math.sqrt(fine.spaces.integrate(integral.integrand() * ufl.dx(metadata=metadata)))


ACROSS = 0.5
"""r."""
LOADS = {"-1": "-x", "-1 - x": "-x - x^2/2", "-2 - sin(3*x)": "-2*x + (cos(3*x) - 1)/3", "-x*x": "-x^3/3"}
"""F for each f."""
HALVINGS = 48
"""Intervals are halved so often towards the places where κ is small."""
GAUSS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True)
class Strip:
    """A problem in x alone.

    Attributes:
        a: The text a.
        small: Places where a is small, or not smooth.
        f: The text f ≤ 0.
        s: The text s; empty if κ is a number times the identity.
        level: U.
    """

    a: str
    small: Sequence[float]
    f: str = "-1"
    s: str = ""
    level: float = 0.0

    def problem(self, dim: int) -> Diffusion:
        """The problem on the square or the cube."""
        sides = [Neumann(["bottom", "top", *(["front", "back"] if dim == 3 else [])])]
        if self.s:
            across = {2: ("bottom", "top"), 3: ("front", "back")}[dim]
            flux = f"({self.s})*({self._constant!r} - ({LOADS[self.f]}))"
            sides = [Neumann(part, f"{sign}{flux}") for part, sign in zip(across, "-+", strict=True)]
            sides += [Neumann(["bottom", "top"])] if dim == 3 else []
        conditions = [Signorini("left", psi=self.level), *sides]
        return Diffusion(f=self.f, u_D=self.level, kappa=self._kappa(dim) if self.s else self.a, conditions=conditions)

    def _kappa(self, dim: int) -> list[list[str]]:
        a, s = f"({self.a})", f"({self.s})"
        rows = [[a, f"{a}*{s}"], [f"{a}*{s}", f"{a}*{s}^2 + {ACROSS}"]]
        return rows if dim == 2 else [[*rows[0], "0"], [*rows[1], "0"], ["0", "0", f"{ACROSS}"]]

    def at(self, text: str, x: Array) -> Array:
        """Values of a text at x."""
        return np.broadcast_to(values(read(text, "x"), np.asarray(x)[..., None]), np.shape(x))

    def flux(self, x: Array) -> Array:
        """C − F at x."""
        return np.asarray(self._constant - self.at(LOADS[self.f], x))

    @cached_property
    def _constant(self) -> float:
        """C."""
        nodes, weights = self.nodes(0.0, 1.0)
        resistance = weights / self.at(self.a, nodes)
        return float(resistance @ self.at(LOADS[self.f], nodes) / resistance.sum())

    def nodes(self, low: float, high: float) -> tuple[Array, Array]:
        """Points and weights of a quadrature between two x for functions of the kind 1/a."""
        width = 0.5 ** np.arange(HALVINGS)
        near = [place + sign * width for place in (*self.small, low, high) for sign in (-1, 1)]
        ends = np.unique(np.concatenate([*near, [low, high], self.small]))
        ends = ends[(ends >= low) & (ends <= high)]
        middle, half = (ends[1:] + ends[:-1]) / 2, (ends[1:] - ends[:-1]) / 2
        return (middle[:, None] + half[:, None] * GAUSS[0]).ravel(), (half[:, None] * GAUSS[1]).ravel()

    def norms(self, solution: Solution) -> tuple[float, float]:
        """‖σ − σ_h‖ and ‖σ_h‖ (collective)."""
        flux, squares = solution.cell_flux, np.zeros(2)
        for vertices, centroid, slope in zip(corners(solution.spaces.mesh), flux.centroid, flux.slope, strict=True):
            middle = vertices.mean(axis=0)
            for low, high in itertools.pairwise(np.unique(vertices[:, 0].round(12))):
                x, weights = self.nodes(low, high)
                for points, of_points in _slices(vertices, x):
                    sigma_h = centroid + slope * (points - middle)
                    sigma = np.zeros_like(sigma_h)
                    sigma[:, 0] = self.flux(x)
                    sigma[:, 1] = sigma[:, 0] * (self.at(self.s, x) if self.s else 0.0)
                    squares += [(weights * of_points) @ self._square(x, tau) for tau in (sigma - sigma_h, sigma_h)]
        total = solution.spaces.mesh.comm.allreduce(squares)
        return math.sqrt(total[0]), math.sqrt(total[1])

    def _square(self, x: Array, tau: Array) -> Array:
        """τ·κ⁻¹τ."""
        a = self.at(self.a, x)
        if not self.s:
            return np.asarray((tau**2).sum(axis=1) / a)
        across = tau[:, 1] - self.at(self.s, x) * tau[:, 0]
        return np.asarray(tau[:, 0] ** 2 / a + (across**2 + (tau[:, 2:] ** 2).sum(axis=1)) / ACROSS)


def _slices(vertices: Array, x: Array) -> Iterator[tuple[Array, Array]]:
    """Points of a quadrature of degree 2 in the sections of a simplex at these x, one for each, and their weights."""
    cut = []
    for one, other in itertools.combinations(vertices, 2):
        if (one[0] < x[len(x) // 2]) != (other[0] < x[len(x) // 2]):
            share = (x - one[0]) / (other[0] - one[0])
            cut.append(one + share[:, None] * (other - one))
    if len(vertices) == 3:
        first, second = cut
        for t, weight in zip(*np.polynomial.legendre.leggauss(2), strict=True):
            yield (first + second) / 2 + t * (second - first) / 2, weight * np.linalg.norm(second - first, axis=1) / 2
        return
    middle = np.mean(cut, axis=0)
    angle = [math.atan2(*(each[len(x) // 2] - middle[len(x) // 2])[1:]) for each in cut]
    ring = [cut[i] for i in np.argsort(angle)]
    for second, third in itertools.pairwise(ring[1:]):
        area = np.linalg.norm(np.cross(second - ring[0], third - ring[0]), axis=1) / 2
        for one, other in itertools.combinations((ring[0], second, third), 2):
            yield (one + other) / 2, area / 3


def drawn(rng: np.random.Generator) -> Strip:
    """A problem whose κ is nearly 0 at an end, in a vertex or in cells, is steep, or is a matrix."""
    place = float(rng.choice([0.0, 1.0, 0.25, 0.5, rng.uniform(0.05, 0.95)]))
    e = f"{10 ** rng.uniform(-8, -1):.3e}"
    other = float(rng.uniform(0, 1))
    kinds = [
        (f"abs(x - {place!r}) + {e}", [place]),
        (f"(x - {place!r})^2 + {e}", [place]),
        (f"(x - {place!r})^4 + {e}", [place]),
        (f"(x - {place!r})^2*(x - {other!r})^2 + {e}", [place, other]),
        (f"sqrt(abs(x - {place!r})) + {e}", [place]),
        (f"1.00001 - exp(-(x - {place!r})^2/0.01)", [place]),
        (f"sin(3*x)^2 + {e}", [0.0, math.pi / 3]),
        (f"x + {e}" if place < 0.5 else f"1 - x + {e}", [0.0, 1.0]),
        (f"exp({rng.uniform(-12, 12):.3f}*x)", []),
        (f"1/(1 + 1000*(x - {place!r})^2)", [place]),
        (f"{e} if x < {place!r} else 1", [place]),
    ]
    a, small = kinds[rng.integers(len(kinds))]
    f = str(rng.choice(list(LOADS)))
    s = str(rng.choice(["", "", "0.7", "1 - 2*x"] if "sin" not in f else [""]))
    return Strip(a, small, f, s, float(rng.choice([0.0, 0.0, 1000.0, -1000.0])))


def bound(seed: int, jumps: str, element: str = "RT0") -> list[Found]:
    """Compare with a finer solution (collective)."""
    return _found(lambda: examine(seed, jumps, MPI.COMM_WORLD, element))


def small(seed: int) -> list[Found]:
    """Compare with exact fluxes for small κ (collective)."""
    return _found(lambda: of_small(seed, MPI.COMM_WORLD))


def _found(examine: Callable[[], Row]) -> list[Found]:
    try:
        row = examine()
    except (InputError, NumericalFailure) as error:
        return [Found(str(error), ["not solved"])]
    counts = ["below 1"] * (row.ratio < 1)
    words = f"error {row.difference:.3e} ratio {row.ratio:.3f} {row.problem}"
    return [Found(words, counts, {"ratio": row.ratio}, row.wrong)]
