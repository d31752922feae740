"""The bound of elastic contact against true errors, exact and by energies."""

import itertools
from dataclasses import replace
from typing import Any

import dolfinx.mesh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from elastic import box, half
from measuring.korn import bound_of, korn_constant, moment_error, trace_constant
from mpi4py import MPI

from signorini_fenicsx import Contact, Dirichlet, Elasticity, Neumann, Tresca
from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.certificate.adaptive import AdaptRow, adapt
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.comparing.comparison import differences
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.elasticity.bound import certify as bound
from signorini_fenicsx.physics.elasticity.bound.certify import gap_of_cells
from signorini_fenicsx.physics.elasticity.bound.conforming import BestDisplacement
from signorini_fenicsx.physics.elasticity.bound.equilibrated import admissible_stress
from signorini_fenicsx.physics.elasticity.bound.korn import KORN, MOMENTS, TRACE
from signorini_fenicsx.physics.elasticity.bound.resolution import Resolution
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.residuals import elastic_kkt
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD


POLYNOMIALS = {
    "load": (
        {
            "young": 1.0,
            "f": ["2*y*(1 - y) + x*(1 - x)", "-(1 - 2*x)*(1 - 2*y)/2"],
            "exact": ["x*(1 - x)*y*(1 - y)", "0"],
        },
        (1.25, 1.13),
    ),
    "stiffness": (
        {
            "young": "1 + y",
            "f": [
                "2*(1 + y)*y*(1 - y) + (1 + y)*x*(1 - x) - x*(1 - x)*(1 - 2*y)/2",
                "-(1 + y)*(1 - 2*x)*(1 - 2*y)/2",
            ],
            "exact": ["x*(1 - x)*y*(1 - y)", "0"],
        },
        (3.5, 3.5),
    ),
    "tractions": ({"young": 1.0, "f": ["-8*x*y", "-7*x^2/2 - y^2"], "exact": ["x^3*y", "x^2*y^2"]}, (4, 4)),
}
SHEAR = "(x^3 + 2*x*y^2)/2"
TRACTIONS = {"x1": ["3*x^2*y", SHEAR], "y1": [SHEAR, "2*x^2*y"], "x0": ["99*y^3", "0"]}
"""Those of components that are fixed do not count."""


@pytest.mark.parametrize("name", POLYNOMIALS)
def test_data_that_are_polynomials(name: str):
    """The error on two meshes is at most the bound, which is guaranteed, and not far below it."""
    given, sharp = POLYNOMIALS[name]
    held = [Dirichlet("x0", 0, components="n"), *(Neumann(*each) for each in TRACTIONS.items())]
    problem = Elasticity(poisson=0.0, **given, conditions=held if name == "tractions" else [])
    for n, most in zip((2, 8), sharp, strict=True):
        solution = solve(box(COMM, n, [0.0, 0.0], [1.0, 1.0]), problem)
        errors, certificate = solution.errors(), certify(solution)
        assert errors is not None
        assert certificate.guaranteed
        assert errors["energy"] <= certificate.sigma_bound < most * errors["energy"]


def test_as_many_cells_of_a_higher_degree_as_are_allowed(monkeypatch: pytest.MonkeyPatch):
    """If those with most of the gap are too many, the largest of them still make the bound smaller."""
    conditions = [Contact("y0", "0.1"), Neumann("x1", 0)]
    problem = Elasticity(1.0, 0.3, u_D=["0", "-0.1*x"], f=["0.1", "0.1"], conditions=conditions)
    solution, bounds = solve(box(COMM, 6, [0.0, 0.0], [1.0, 1.0]), problem), []
    for many in (0, 4, 1000):
        monkeypatch.setattr(bound, "MANY", {2: many})
        bounds.append(certify(solution).bound)
    assert bounds[2] < 0.99 * bounds[1] < 0.99**2 * bounds[0]


@pytest.mark.parametrize("dim", [2, 3])
def test_tractions_that_the_mesh_does_not_see(dim: int):
    """Where g_N is orthogonal to linear fields on all facets σ_h is 0, and only the constant bounds the error."""
    ends = [0.0] * dim, [1.0] * dim
    legendre = "20*x^3 - 30*x^2 + 12*x - 1" if dim == 2 else "20*y^3 - 30*y^2 + 12*y - 1"
    problem = Elasticity(1.0, 0.3, conditions=[Neumann("yz"[dim - 2] + "1", ["0"] * (dim - 1) + [legendre])])
    solution, fine = (solve(box(COMM, n, *ends), problem) for n in (1, {2: 8, 3: 4}[dim]))
    certificate = certify(solution)
    assert certificate.guaranteed
    assert fine.norms()["energy"] <= certificate.sigma_bound


def test_a_body_of_two_materials():
    """With numbers for each region the bound is guaranteed, and here it is 0 up to rounding, as the error is."""
    domain = box(COMM, 4, [0.0, 0.0], [1.0, 1.0])
    middle = dolfinx.mesh.compute_midpoints(domain.mesh, 2, np.arange(domain.mesh.topology.index_map(2).size_local))
    domain = replace(
        domain, regions={"soft": np.flatnonzero(middle[:, 1] < 0.5), "hard": np.flatnonzero(middle[:, 1] > 0.5)}
    )
    problem = Elasticity(
        {"soft": 1.0, "hard": 3.0}, 0.0, u_D=["0", "-0.1"], conditions=[Contact("y0"), Neumann(["x0", "x1"], 0)]
    )
    solution = solve(domain, problem)
    certificate = certify(solution)
    assert certificate.guaranteed
    assert solution.norms()["contact_force"] == pytest.approx(0.15)
    assert certificate.bound < 1e-8


@pytest.mark.parametrize(("plane", "own"), [("strain", ""), ("stress", "eigenstrain"), ("strain", "initial_stress")])
def test_what_quadrature_misses_of_the_gap(plane: str, own: str):
    """The gap of each cell is at least that by a quadrature of degree 30, which is more than that of the program."""
    boundary = ElasticBoundary(["y0"], neumann=["x1"], fixed={"x0": "n"})
    young, poisson = ("1", "0.2") if own else ("exp(x*y)", "0.1 + 0.2*x*y")
    texts = {"eigenstrain": "exp(-6*x*y)", "initial_stress": [["sin(5*x*y)", "cos(4*y)"], ["cos(4*y)", "x"]]}
    given: dict[str, Any] = {own: texts[own]} if own else {}
    problem = ElasticProblem(young, poisson, u_D=["0", "-0.1"], plane=plane, **given)
    solution = solve(box(COMM, 8, [0.0, 0.0], [1.0, 1.0]), replace(problem, boundary=boundary))
    spaces, y = solution.spaces, admissible_stress(solution)
    best = BestDisplacement(spaces, solution.data, y, spaces.split, 2)
    v, _ = best.minimum()
    resolution = Resolution(spaces, solution.data)
    with_missed, _ = gap_of_cells(solution, best, v, resolution)
    x = ufl.SpatialCoordinate(spaces.split.mesh)
    E, nu = (1.0, 0.2) if own else (ufl.exp(x[0] * x[1]), 0.1 + 0.2 * x[0] * x[1])
    e, identity = ufl.sym(ufl.grad(v)), ufl.Identity(2)
    lame = E * nu / ((1 + nu) * (1 - 2 * nu if plane == "strain" else 1 - nu))
    of_trace = nu / E * (1 + nu if plane == "strain" else 1)
    stress = best.sigma
    if own == "initial_stress":
        beside = ufl.cos(4 * x[1])
        stress -= ufl.as_matrix([[ufl.sin(5 * x[0] * x[1]), beside], [beside, x[0]]])
    elif own:
        e -= (1 + nu if plane == "strain" else 1) * ufl.exp(-6 * x[0] * x[1]) * identity
    off = e - ((1 + nu) / E * stress - of_trace * ufl.tr(stress) * identity)
    square = ufl.inner(E / (1 + nu) * off + lame * ufl.tr(off) * identity, off)
    weight = ufl.TestFunction(fenicsx.function_space(spaces.split.mesh, ("DG", 0)))

    def by_quadrature(degree: int) -> np.ndarray:
        form = weight * square * ufl.dx(metadata={"quadrature_degree": degree})
        found = fem.assemble_vector(fenicsx.form(form)).array
        return np.bincount(spaces.split.subcells // 3, found[: len(spaces.split.subcells)], len(with_missed))

    assert resolution.unresolved() == ()
    fine, rough = by_quadrature(30), by_quadrature(best.material.degree)
    assert (fine <= with_missed).all()
    assert (fine > rough).any()
    assert with_missed.sum() < 1.3 * fine.sum()


def test_a_stiffness_that_the_mesh_does_not_see():
    """A pulse of E between the points of the quadrature is told."""
    pulse = "1 + 1000*exp(-1e6*((x - 0.313)^2 + (y - 0.417)^2))"
    problem = Elasticity(pulse, 0.3, u_D=["0", "-0.1"], conditions=[Contact("y0"), Neumann(["x0", "x1"], 0)])
    solution = solve(box(COMM, 8, [0.0, 0.0], [1.0, 1.0]), problem)
    certificate = certify(solution)
    assert not certificate.guaranteed
    assert certificate.reservation.startswith("young or poisson is not resolved near (0.")
    (near, *_) = [np.linalg.norm(np.subtract(place, [0.313, 0.417])) for _, place in certificate.unresolved]
    assert near < 0.2


def test_constants_of_korn():
    """Those in use are the bounds that the script finds; in space c_h of a coarser mesh, larger than the script's."""
    c_h, bound = korn_constant(2, 32)
    assert c_h < bound <= KORN[2] < bound + 1e-3
    c_h, _ = korn_constant(3, 10)
    assert c_h == pytest.approx(0.3105, abs=1e-3)
    assert c_h < bound_of(c_h, np.sqrt(8) / 16, moment_error(3)) < KORN[3] + 1e-3
    for dim, q in MOMENTS.items():
        assert moment_error(dim) <= q < moment_error(dim) + 1e-3
    t_h, bound = trace_constant(2, 32)
    assert t_h < bound <= TRACE[2] < bound + 1e-3
    t_h, bound = trace_constant(3, 8)
    assert 1.19 < t_h < TRACE[3] < bound


def complementary_energy(solution: ElasticSolution, gap: str) -> float:
    """½(𝔸σ, σ) − ⟨g, σ_nn⟩ for u_D = 0 and a gap that is a number; least at the exact stress."""
    norms = solution.norms()
    return norms["energy"] ** 2 / 2 + float(gap) * norms["contact_force"]


def test_bounds_of_random_problems():
    """A bound is never below the error in energy, and near it; with quadratics alone up to 1.31 times."""
    rng, ratios = np.random.default_rng(5), []
    for number in range(8):
        gap, nu = str(rng.uniform(0, 0.2)), float(rng.choice([0.0, 0.3, 0.45]))
        f, g = (rng.uniform(-1, 1, 2) for _ in range(2))
        g_N = [f"{a}*x + {b}*y" for a, b in zip(g, g[::-1], strict=True)]
        problem = ElasticProblem(1.0, nu, f=[str(f[0]), str(f[1] - 0.5)], g_N=g_N, gap=gap)
        boundary = ElasticBoundary(["y0"], neumann=["x1"], fixed={"y1": "y"} if number % 2 else {})
        coarse, fine = (
            solve(box(COMM, n, [0.0, 0.0], [2.0, 1.0]), replace(problem, boundary=boundary)) for n in (3, 12)
        )
        certificate = certify(coarse)
        assert certificate.guaranteed
        error = complementary_energy(coarse, gap) - complementary_energy(fine, gap)  # at least this
        assert certificate.gap >= error - 1e-12
        ratios.append(np.sqrt(certificate.gap / error))
    assert np.median(ratios) < 1.1
    assert max(ratios) < 1.2


@pytest.mark.parametrize(
    ("f", "g_N", "gap", "g"),
    [
        (
            ["-0.0586", "-0.1696"],
            ["-0.15 - 0.44*x - 0.045*y", "-0.2 - 0.11*x + 0.04*y"],
            "0.07 + 0.125*((x - 0.85)^2 + (y - 0.2)^2)",
            0.07,
        ),
        pytest.param(
            ["0.4613", "-0.7755"],
            None,
            "0.011 + 0.127*((x - 0.92)^2 + (y - 0.48)^2)",
            0.06,
            marks=pytest.mark.slow,
        ),
    ],
)
def test_corners_that_quadratics_miss(f: list[str], g_N: list[str] | None, gap: str, g: float):
    """Where parts meet and where contact ends within a facet the bound is near; by quadratics 1.72 and 1.66 times."""
    domain = build_domain(MPI.COMM_SELF, "square", 0.416133, mesh="unstructured")
    loads = [Neumann("bottom", g_N)] if g_N else []
    problem = Elasticity(1.0, 0.0, f=f, conditions=[Contact("right", gap, friction=Tresca(g)), *loads])

    def solve_on(domain: Domain, start: ElasticSolution | None) -> ElasticSolution:
        return solve(domain, problem, start=start)

    solution = solve_on(domain, None)
    fine, _ = adapt(domain, solve_on, max_cells=600)
    difference = differences(solution, fine).energy
    assert difference < certify(solution).sigma_bound < 1.4 * difference


def test_indicators_are_the_bound():
    """A symmetric half with a normal that is fixed, a gap that is curved, tractions: cells add up to the gap."""
    pushed = Neumann(["x1", "y1"], ["0", "-0.05 if y > 0.999999 else 0"])
    conditions = [Contact("y0", "0.1*x^2"), Dirichlet("x0", 0, components="n"), pushed]
    certificate = certify(solve(box(COMM, 4, [0.0, 0.0], [1.0, 1.0]), Elasticity(1.0, 0.3, conditions=conditions)))
    assert float((certificate.indicator.x.array**2).sum()) == pytest.approx(2 * certificate.gap, rel=1e-9)
    assert certificate.relative < 0.3


@pytest.mark.parallel([1, 2])
def test_adaptive_meshes_start_from_the_sets_before():
    """Refinement where the bound says so halves it with fewer unknowns than uniformly, from the contact set before."""
    problem = half("x^2/2", -0.02)

    def solve_on(domain: Domain, start: ElasticSolution | None) -> ElasticSolution:
        return solve(domain, problem, start=start)

    rows: dict[float, list[AdaptRow]] = {0.5: [], 1.0: []}
    for theta, found in rows.items():
        adapt(box(COMM, 4, [0.0, 0.0], [1.0, 1.0]), solve_on, max_cells=1000, theta=theta, on_row=found.append)
    for found in rows.values():
        assert all(row.iterations < 8 for row in found[1:])
        assert all(one.bound > other.bound for one, other in itertools.pairwise(found))
    best = min(row.bound for row in rows[1.0])
    assert min(row.unknowns for row in rows[0.5] if row.bound < best) < 0.5 * max(row.unknowns for row in rows[1.0])


def test_contact_with_two_normals_at_a_corner():
    """The stress is exact, and v is found exactly though its vertex has two conditions; the bound was 12 %."""
    problem = Elasticity(
        1.0, 0.3, conditions=[Contact(["x0", "y0"]), Neumann("y1", ["0", "-0.02"]), Neumann("x1", ["-0.01", "0"])]
    )
    certificate = certify(solve(box(COMM, 4, [0.0, 0.0], [1.0, 1.0]), problem))
    assert certificate.guaranteed
    assert certificate.relative < 1e-7


def test_a_body_that_one_vertex_holds():
    """Contact at one vertex of a facet holds v against a rigid motion; without that the bound was 1e9 %."""
    problem = half("2*x^2", -0.005)
    solution, fine = (solve(box(COMM, n, [0.0, 0.0], [1.0, 1.0]), problem) for n in (4, 12))
    assert solution.contact.facets == 1
    difference = differences(solution, fine).energy
    assert difference < certify(solution).bound < 3 * difference


def test_grooves():
    """On a polygon each vertex of Γ_C has two normals: the bound is near the error in energy, and does not grow."""
    problem = Elasticity(1.0, 0.3, u_D=["0", "-0.05"], conditions=[Contact("arc", "0.01")])
    domain = build_domain(COMM, "half_disk", 0.6, mesh="unstructured")
    parts = {name: replace(part, nearest=None) for name, part in domain.parts.items()}  # no finer polygons
    found: list[float] = []
    rows: list[AdaptRow] = []

    def solve_on(domain: Domain, start: ElasticSolution | None) -> ElasticSolution:
        solution = solve(domain, problem, start=start)
        found.append(complementary_energy(solution, "0.01") + 0.05 * solution.resultants()["diameter"][1])
        return solution

    adapt(replace(domain, is_shape=False, coarser=None, parts=parts), solve_on, max_cells=900, on_row=rows.append)
    for row, energy in list(zip(rows, found, strict=True))[:3]:
        assert 1 < np.sqrt(row.gap / (energy - found[-1])) < 2
    assert rows[-1].bound < 0.3 * rows[0].bound


@pytest.mark.parametrize("nu", [0.0, 0.4999])
def test_flat_cells(nu: float):
    """In cells of 1 : 20 local stresses bound what a load does within them; by constants of Korn it was 4.4 times."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [[0.0, 0.0], [1.0, 1.0]], [2, 40])
    mu, lame = 1 / (2 * (1 + nu)), nu / ((1 + nu) * (1 - 2 * nu))
    f = [f"{2 * (2 * mu + lame)}*y*(1 - y) + {2 * mu}*x*(1 - x)", f"-{lame + mu}*(1 - 2*x)*(1 - 2*y)"]
    problem = Elasticity(1.0, nu, f=f, exact=["x*(1 - x)*y*(1 - y)", "0"])
    solution = solve(domain_of(mesh, {"y0": lambda x: np.isclose(x[1], 0)}), problem)
    errors, certificate = solution.errors(), certify(solution)
    assert errors is not None
    assert certificate.guaranteed
    assert errors["energy"] <= certificate.sigma_bound <= certificate.bound < 3 * errors["energy"]


def test_what_a_solver_leaves():
    """A stress that does not balance its load is replaced, and its distance from the new one is in the bound."""
    problem = Elasticity(1.0, 0.3, f=["0.1", "-0.2"], conditions=[Contact("y0"), Neumann("x1", 0)])
    solution = solve(box(COMM, 3, [0.0, 0.0], [1.0, 1.0]), problem)
    exact, iterate = certify(solution), solution.outcome.iterate
    sigma = iterate.sigma.copy()
    sigma.x.array[:] *= 1 + 1e-4
    kkt = elastic_kkt(solution.spaces, solution.data, solution.spaces.split.values(sigma), iterate.p)
    left = replace(solution, outcome=replace(solution.outcome, iterate=replace(iterate, sigma=sigma)), kkt=kkt)
    certificate = certify(left)
    assert certificate.remainder == pytest.approx(1e-4 * solution.norms()["energy"], rel=1e-3)
    assert certificate.gap == pytest.approx(exact.gap, rel=1e-6)
