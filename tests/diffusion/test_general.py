"""General data κ, u_D, g_N, ψ, q_S: affine solutions up to rounding, others with order 1, equal backends."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem
from made_cases import make_case
from mpi4py import MPI
from ufl.core.expr import Expr

from signorini_fenicsx import Diffusion, InputError, Neumann, Signorini, certify, solve, solve_case
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.solution import Solution

COMM = MPI.COMM_WORLD
METHODS = ("alg1", "alg2", "alg3", "alg4", "snes1", "snes2", "vi")
MIXED_CLASSICS = ("mixed-uzawa1", "mixed-uzawa2", "mixed-uzawa-h12", "mixed-uzawa-wang", "slimane", "qp")
P1_CLASSICS = ("uzawa", "psor", "primal-pdas", "primal-penalty")
MATRIX = [["2", "1/2"], ["1/2", "1"]]

# κ∇u = (7/4, 0) for u = 1 + x − y/2: contact with σ·n = q_S + 1 on the left, none on top, a given flux on the right
AFFINE = {
    "problem.kappa": MATRIX,
    "problem.u_D": "1 + x - y/2",
    "problem.psi": "1 - x - y/2",
    "problem.q_S": "-11/4 if x < 1e-13 else 0",  # so near the corner that the enclosure of the mean has no jump
    "problem.g_N": "7/4",
    "boundary.neumann": ["right"],
}


def affine_errors(solution: Solution) -> list[float]:
    """‖∇u − κ⁻¹σ_h‖ and the largest errors of means over cells and facets."""
    spaces = solution.spaces
    x = ufl.SpatialCoordinate(spaces.mesh)
    u = 1 + x[0] - x[1] / 2
    means = [(u - solution.u) * ufl.TestFunction(spaces.Q) * ufl.dx]
    means += [(u - solution.p) * ufl.TestFunction(spaces.Lambda) * spaces.ds]
    largest = [np.abs(fem.assemble_vector(spaces.form(form)).array).max(initial=0.0) for form in means]
    return [math.sqrt(spaces.integrate(l2(ufl.as_vector([1.75, 0]) - solution.sigma, ufl.dx))), *largest]


@pytest.mark.parallel([1, 2])
def test_affine_solutions(folder: Path):
    """Every method reproduces an affine solution with a matrix κ and all kinds of conditions, up to its ε."""
    case = make_case(folder, parts=["left", "top"], f="0", h=0.3).with_values(AFFINE | {"solve.eps": 1e-12})
    domain = mesh_case(case, COMM)
    ways = [(0, "alg1", "hybrid"), (0, "alg3", "hybrid")]
    if COMM.size == 1:
        ways += [(10**6, name, "hybrid") for name in (*METHODS, *MIXED_CLASSICS, *P1_CLASSICS)]
        ways += [(10**6, name, "mixed") for name in METHODS[:4]]
    for direct_up_to, algorithm, backend in ways:
        tuning = Tuning(direct_up_to=direct_up_to)
        values = {"solve.algorithm": algorithm, "solve.backend": backend}
        solution = solve_case(case.with_values(values), COMM, domain=domain, tuning=tuning)
        assert max(affine_errors(solution)) < 1e-8, algorithm
        assert solution.contact[1] == pytest.approx(1.0), algorithm
        if direct_up_to == 0 or backend == "mixed":
            assert certify(solution).bound < 1e-5, algorithm  # a trace of 1e-12 counts linearly


def manufactured(x: Expr) -> Diffusion:
    """The solution u = s₊³ − y s₋³ + ψ, s = x − 0.413,: contact for s < 0 on the bottom, Γ_N on the right."""
    kappa = (1 + x[0] / 2) * ufl.as_matrix([[2, 0.5], [0.5, 1]])
    s = x[0] - 0.413
    psi = 0.3 * ufl.sin(2 * x[0]) + 0.2 * x[0] * x[1]
    plus, minus = ufl.max_value(s, 0), ufl.max_value(-s, 0)
    u = plus**3 - x[1] * minus**3 + psi
    flux = kappa * ufl.grad(u)
    conditions = [Signorini("bottom", psi, -flux[1] - minus**3), Neumann("right", flux[0])]
    return Diffusion(f=-ufl.div(flux), kappa=kappa, u_D=u, exact=u, conditions=conditions)


def energy_error(solution: Solution, u: Expr) -> float:
    """‖σ − σ_h‖ in (κ⁻¹·, ·)."""
    kappa = solution.data.kappa.ufl
    difference = kappa * ufl.grad(u) - solution.sigma
    dx = ufl.Measure("dx", domain=solution.spaces.mesh, metadata={"quadrature_degree": 8})
    return math.sqrt(solution.spaces.integrate(ufl.inner(ufl.inv(kappa) * difference, difference) * dx))


def test_manufactured_solutions():
    """Order 1 in σ, u and p, a certified bound that is true and sharp, and the free boundary within a facet."""
    errors = []
    for h in (1 / 8, 1 / 16):
        domain = build_domain(COMM, "square", h, mesh="structured")
        problem = manufactured(ufl.SpatialCoordinate(domain.mesh))
        u, solution = problem.exact, solve(domain, problem)
        certificate, spaces = certify(solution), solution.spaces
        error = energy_error(solution, u)
        assert error < certificate.sigma_bound < 1.25 * error
        assert solution.errors()["energy"] == pytest.approx(error, rel=1e-3)
        assert abs(solution.contact.measure - 0.413) < domain.h ** (2 / 3)  # the flux errs by O(h²) where it is s³
        dx, ds = (measure(metadata={"quadrature_degree": 8}) for measure in (ufl.dx, spaces.ds))
        others = [spaces.integrate(form) for form in (l2(u - solution.u, dx), l2(u - solution.p, ds))]
        errors.append([error, *np.sqrt(others)])
    orders = np.log2(np.array(errors)[:-1] / np.array(errors)[1:])
    assert np.all(orders > 0.93)
    assert np.all(np.array(errors[-1]) < [0.06, 0.02, 0.04])


@pytest.mark.parallel([1, 2])
def test_backends_agree(folder: Path):
    """Sets and fields of both backends are those of SNES and SNESVI, with κ that jumps and data of all kinds."""
    values = {
        "problem.kappa": "1000 if x > 0.6 else 1/50",
        "problem.psi": "0.02*sin(9*x) - 0.01",
        "problem.q_S": "-0.3*cos(7*x)",
        "problem.g_N": "x - y",
        "problem.u_D": "(sin(3*x)*y + abs(x - 0.7))/99",
        "boundary.neumann": ["right", "top"],
    }
    for shape, algorithm in (
        [*itertools.product(["lshape"], METHODS[:4]), ("cube", "alg1"), ("cube", "alg4")]
        if COMM.size == 1
        else [("lshape", "alg3"), ("cube", "alg3")]
    ):
        case = make_case(folder, shape=shape, parts=["bottom"], f="8*sin(5*x)", h=0.4).with_values(values)
        case = case.with_values({"solve.algorithm": algorithm, "solve.eps": 1e-3})
        one = solve_case(case, COMM)
        independent = {"alg3": "snes1", "alg4": "snes2"}.get(algorithm, "vi")
        others = [{"solve.backend": "mixed"}, {"solve.algorithm": independent}]
        two, three = (solve_case(case.with_values(other), COMM, domain=one.spaces.domain) for other in others)
        assert 0 < one.contact[0] < one.spaces.Lambda.dofmap.index_map.size_global
        assert [step.changed for step in one.outcome.history] == [step.changed for step in two.outcome.history]
        for a, b, c in [(one.sigma, two.sigma, three.sigma), (one.u, two.u, three.u), (one.p, two.p, three.p)]:
            size = COMM.allreduce(np.abs(a.x.array).max(initial=0.0), MPI.MAX)
            np.testing.assert_allclose(a.x.array, b.x.array, atol=1e-9 * size)
            np.testing.assert_allclose(a.x.array, c.x.array, atol=1e-8 * size)


@pytest.mark.parallel([1, 2])
def test_without_dirichlet_part(folder: Path):
    """With a negative total load all methods agree; without one there is no solution, or more than one."""
    case = make_case(folder, parts=["bottom"], f="3*x - 2", h=0.2)
    case = case.with_values({"boundary.neumann": ["left", "right", "top"], "problem.psi": "0.1*sin(20*x)"})
    domain = mesh_case(case, COMM)
    reference = solve_case(case, COMM, domain=domain)
    assert 0 < reference.contact[0] < reference.spaces.Lambda.dofmap.index_map.size_global
    size = COMM.allreduce(np.abs(reference.p.x.array).max(initial=0.0), MPI.MAX)
    certified = certify(reference).bound
    for algorithm, backend in [*((name, "hybrid") for name in METHODS), ("alg2", "mixed"), ("alg4", "mixed")]:
        values = {"solve.algorithm": algorithm, "solve.backend": backend, "solve.eps": 1e-11}
        solution = solve_case(case.with_values(values), COMM, domain=domain)
        np.testing.assert_allclose(solution.p.x.array, reference.p.x.array, atol=1e-7 * size)
        assert certify(solution).bound < 1.01 * certified
    solution = solve_case(case, COMM, domain=domain, tuning=Tuning(direct_up_to=0))
    np.testing.assert_allclose(solution.p.x.array, reference.p.x.array, atol=1e-9 * size)
    for f, verdict in [("x - 1/4", "there is no solution"), ("x - 1/2", "u is not unique")]:
        with pytest.raises(InputError, match=verdict):
            solve_case(case.with_values({"problem.f": f}), COMM, domain=domain)
    with pytest.raises(InputError, match="uzawa needs a part of the boundary"):
        solve_case(case.with_values({"solve.algorithm": "uzawa"}), COMM, domain=domain)


@pytest.mark.parallel(2)
def test_bad_data(folder: Path):
    case = make_case(folder, parts=["bottom"], f="1", h=0.4)
    for key, value, message in [
        ("kappa", "x - 0.5", "must be positive; a mean over a cell is -0"),
        ("kappa", [["1", "2"], ["2", "1"]], "must be positive; a mean over a cell has the eigenvalue -1"),
        ("kappa", "1 - 1.001*exp(-1e6*((x - 0.31)^2 + (y - 0.37)^2))", r"its value is -0.000.* near \(0\.31, 0\.37\)"),
        ("kappa", [["2", "1"], ["0", "2"]], "is not symmetric"),
        ("kappa", "1/(x - x)", "cannot be evaluated|not finite"),
        ("f", "log(x - 0.9)", r"f: not finite everywhere in the domain near \(0\.\d+, 0\.\d+\)"),
        ("kappa", {"rock": "1"}, "unknown region 'rock' of the mesh; it has none"),
        ("psi", "log(-1 - x)", "psi: not finite everywhere on Γ_S"),
        ("u_D", "1e-9*log((x - 1)**2 + y**2)", "u_D: not finite everywhere on Γ_D"),  # in a corner, which is no
        ("psi", "log(x)", "psi: not finite everywhere on Γ_S"),  # quadrature point
        ("q_S", "1e200", "q_S: its largest value"),
    ]:
        with pytest.raises(InputError, match=message):
            solve_case(case.with_values({f"problem.{key}": value}), COMM)
    nowhere = "sqrt(x - 2)"
    for name, value in [
        ("f", f"0*{nowhere}"),
        ("kappa", f"{nowhere}^0"),
        ("c", f"1 if {nowhere} > 0 else 2"),
        ("psi", "0*exp(1e5*(x + 1))"),
        ("psi", f"abs(0*{nowhere})"),
    ]:
        with pytest.raises(InputError, match=f"{name}: not finite everywhere"):
            solve_case(case.with_values({f"problem.{name}": value}), COMM)
    assert solve_case(case.with_values({"problem.f": f"1 if x > 2 and {nowhere} > 0 else 0*x"}), COMM).converged
    for key, where in (("problem.u_D", "in the cells at Γ_D"), ("exact.u", "in the domain")):
        with pytest.raises(InputError, match=f"its gradient is not finite everywhere {where}"):
            solve_case(case.with_values({key: "sqrt(max(0, x - 0.5))"}), COMM)
    for key, value, message in [
        ("problem.kappa", [["1", "2"]], "2 rows of 2 expressions"),
        ("problem.kappa", [["1", True], ["1", "1"]], "must be an expression, a matrix"),
        ("problem.kappa", [["1", "q"], ["1", "1"]], r"\[problem\] kappa: expression 'q': unknown name 'q'"),
        ("problem.psi", "w", r"\[problem\] psi: expression 'w'"),
        ("boundary.neumann", ["bottom"], "'bottom' is listed twice"),
        ("boundary.neumann", ["side"], "unknown part 'side' of square"),
        ("boundary.dirichlet", ["left", "top"], "'right' is in none of signorini, neumann and dirichlet"),
    ]:
        with pytest.raises(InputError, match=message):
            case.with_values({key: value})
