"""The term cu: exact solutions with rates and bounds, equal backends and methods, no Γ_D, bad data."""

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import ufl
from made_cases import make_case
from mpi4py import MPI

from signorini_fenicsx import Diffusion, InputError, Signorini, certify, load_case, solve, solve_case
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.expressions.reader import parse_expression
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.case import Case

COMM = MPI.COMM_WORLD
U = "max(x - 0.413, 0)^3 - y*max(0.413 - x, 0)^3"
C = "30*max(x - 0.6, 0)*(2 + y)"
EXACT = {
    "problem.f": f"-6*(max(x - 0.413, 0) - y*max(0.413 - x, 0)) + ({C})*({U})",
    "problem.c": C,
    "problem.u_D": U,
    "exact.u": U,
}
"""c = 0 where x < 0.6; contact for x < 0.413 on the bottom."""


def exact_case(folder: Path, h: float, *, mesh: str = "unstructured") -> Case:
    return make_case(folder, mesh=mesh, parts=["bottom"], f="0", h=h).with_values(EXACT)


def assert_same(one, other, tolerance: float) -> None:
    for a, b in ((one.sigma, other.sigma), (one.u, other.u), (one.p, other.p)):
        size = COMM.allreduce(np.abs(b.x.array).max(initial=0.0), MPI.MAX)
        np.testing.assert_allclose(a.x.array, b.x.array, atol=tolerance * size, rtol=0)


def test_orders_and_bounds(folder: Path):
    """Order 1 in σ, u and p, and in ∇·σ = cu − f; the contact set within a facet; a bound that is true and sharp."""
    names = ("sigma_L2", "div_sigma_L2", "u_L2", "p_L2")
    errors = []
    for h in (1 / 8, 1 / 16):
        solution = solve_case(exact_case(folder, h))
        found = solution.errors()
        assert found["contact_hausdorff"] < h
        certificate = certify(solution)
        assert certificate.guaranteed
        assert 1 < certificate.sigma_bound / found["sigma_L2"] < 1.03
        errors.append([found[name] / h for name in names])
    errors = np.array(errors)
    assert np.all(errors < [0.25, 0.78, 0.054, 0.075])
    assert np.all(np.log2(errors[:-1] / errors[1:]) > [-0.055, -0.055, -0.08, -0.07])


@pytest.mark.parallel([1, 2])
def test_backends_and_methods_agree(folder: Path):
    """κ and c that jump by regions or are large, by factorisation and by multigrid; every method finds the same."""
    case = make_case(folder, shape="lshape", parts=["bottom", "left"], f="9*sin(5*x) - 12", h=0.25)
    for c in ("1e4 if x < 0.5 else 0", "3")[: 3 - COMM.size]:
        case = case.with_values({"problem.c": c, "problem.kappa": "40 if x > 0.4 else 1/3", "problem.u_D": "2 + y"})
        case = case.with_values({"problem.psi": "0.02*sin(9*x) + 1.9"})
        domain = mesh_case(case, COMM)
        mixed = solve_case(case.with_values({"solve.backend": "mixed"}), COMM, domain=domain)
        assert 0 < mixed.contact[0] < mixed.spaces.Lambda.dofmap.index_map.size_global
        for direct_up_to in (0, 10**6):
            assert_same(solve_case(case, COMM, domain=domain, tuning=Tuning(direct_up_to=direct_up_to)), mixed, 1e-10)
        names = ("alg2", "alg3", "alg4", "snes1", "snes2", "vi", "qp", "mixed-uzawa-wang")
        for name in names if COMM.size == 1 and c != "3" else ("alg4",):
            eps = {"solve.eps": 1e-10, "solve.algorithm": name}
            assert_same(solve_case(case.with_values(eps), COMM, domain=domain), mixed, 1e-7)


@pytest.mark.parametrize(
    ("c", "sharp", "resolved"),
    [
        ("100", 1.06, True),
        ("10*exp(sin(3*x))", 1.01, True),
        ("1e6", 12.0, True),  # on cells with c h² far above κ, u and not σ has the error
        ("100 if x > 0.51 else 0", 1.05, True),
        (lambda x: 10 + x[0], 1.01, False),
    ],
)
def test_bounds_for_other_coefficients(c: str | Callable[[Array], Array], sharp: float, resolved: bool):
    """The bound is true, and sharp where cells resolve c; jumps inside of cells and c from Python are told."""
    domain = build_domain(COMM, "square", 1 / 16, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    u = parse_expression(U, x)
    of_c = 10 + x[0] if callable(c) else parse_expression(c, x)
    f = -6 * (ufl.max_value(x[0] - 0.413, 0) - x[1] * ufl.max_value(0.413 - x[0], 0)) + of_c * u
    text = None if callable(c) else f"-6*(max(x - 0.413, 0) - y*max(0.413 - x, 0)) + ({c})*({U})"
    solution = solve(domain, Diffusion(f=text or f, c=c, u_D=U, exact=U, conditions=[Signorini("bottom")]))
    certificate = certify(solution)
    assert 1 < certificate.sigma_bound / solution.errors()["sigma_L2"] < sharp
    assert certificate.guaranteed == resolved
    assert ("c" in certificate.by_quadrature) == callable(c)
    assert [name for name, _ in certificate.unresolved[:1]] == ([] if resolved or callable(c) else ["c"])


def test_primal_methods(folder: Path):
    """Methods in P1 agree with each other, and with the mixed method up to the order of the discretisation."""
    case = exact_case(folder, 1 / 16)
    domain = mesh_case(case, COMM)
    for name in ("primal-pdas", "uzawa", "psor", "primal-penalty"):
        found = solve_case(case.with_values({"solve.algorithm": name}), domain=domain)
        assert found.errors()["u_L2"] < 0.005, name


@pytest.mark.parallel([1, 2])
def test_without_dirichlet_part(folder: Path):
    """Where c > 0 somewhere u is unique, whatever the loads; a constant u is found as such."""
    values = {"boundary.neumann": ["left", "right", "top"], "problem.c": "1 if x > 0.5 else 0", "problem.psi": "-9"}
    case = make_case(folder, parts=["bottom"], f="x - 1/4", h=0.2).with_values(values)
    domain = mesh_case(case, COMM)
    mixed = solve_case(case.with_values({"solve.backend": "mixed"}), COMM, domain=domain)
    for direct_up_to, name in itertools.product((0, 10**6), ("alg2", "vi", "snes1")[: 4 - COMM.size]):
        options = case.with_values({"solve.algorithm": name, "solve.eps": 1e-11})
        assert_same(solve_case(options, COMM, domain=domain, tuning=Tuning(direct_up_to=direct_up_to)), mixed, 1e-6)
    bound = certify(mixed).sigma_bound
    alone = case.with_values({"boundary.signorini": [], "boundary.neumann": ["left", "right", "top", "bottom"]})
    alone = solve_case(alone, COMM, domain=domain)
    np.testing.assert_allclose(alone.u.x.array, mixed.u.x.array, atol=1e-10)
    assert certify(alone).sigma_bound == pytest.approx(bound, rel=1e-6)
    iterative = solve_case(case, COMM, domain=domain, tuning=Tuning(direct_up_to=0))
    assert certify(iterative).sigma_bound == pytest.approx(bound, rel=1e-6)
    balanced = case.with_values({"problem.f": "3*(1 if x > 0.5 else 0)"})
    np.testing.assert_allclose(solve_case(balanced, COMM, domain=domain).u.x.array, 3, atol=1e-12)
    for h in (0.15, 0.1):  # rounding decides how exactly cu is f
        constant = solve_case(balanced.with_values({"solve.h": h, "geometry.mesh": "structured"}), COMM)
        np.testing.assert_allclose(constant.u.x.array, 3, atol=1e-10)


@pytest.mark.parallel(2)
def test_bad_data(folder: Path):
    case = make_case(folder, parts=["bottom"], f="1", h=0.4)
    for c, message in [
        ("x - 0.9", r"\[problem\] c: must not be negative; it is -0\.8"),
        ("1/(x - x)", r"\[problem\] c: not finite everywhere"),
        ({"clay": "1"}, r"\[problem\] c: unknown region 'clay' of the mesh; it has none"),
    ]:
        with pytest.raises(InputError, match=message):
            solve_case(case.with_values({"problem.c": c}), COMM)
    for c in ([["1", "0"], ["0", "1"]], {}):
        with pytest.raises(InputError, match=r"\[problem\] c: must be an expression, or a table with one per region"):
            case.with_values({"problem.c": c})


def test_no_reaction_is_bit_for_bit_no_term():
    """A c of 0 as a number or as text makes no other matrix, form or result."""
    case = load_case("example1").with_values({"solve.h": 1 / 8})
    plain, zero = solve_case(case), solve_case(case.with_values({"problem.c": "0*x"}))
    assert zero.data.c_h is None
    assert np.array_equal(plain.sigma.x.array, zero.sigma.x.array)
