"""Dirichlet data: every algorithm and both backends reproduce affine solutions up to rounding."""

import itertools
from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem
from made_cases import make_case
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.expressions.reader import parse_expression
from signorini_fenicsx.forms.norms import l2

COMM = MPI.COMM_WORLD

# u_D = u, Γ_S: apart from it, in contact with σ·n = 1, and constant, where σ is rounding
AFFINE = [("2 + x", (1, 0), ["bottom", "top"]), ("-y", (0, -1), ["bottom"]), ("5", (0, 0), ["left", "top"])]


@pytest.mark.parallel([1, 2])
def test_affine_solutions(folder: Path):
    """σ_h = ∇u, the cell means u_h and the facet means p_h are exact, except for the ε of a penalty."""
    ways = [(0, "alg1", "hybrid"), (0, "alg4", "hybrid")]
    if COMM.size == 1:
        ways += [(10**6, name, "hybrid") for name in ("alg1", "alg2", "alg3", "alg4", "snes1", "snes2", "vi")]
        ways += [(10**6, "alg1", "mixed")]
    for u_D, gradient, parts in AFFINE:
        base = make_case(folder, parts=parts, f="0", h=0.3).with_values({"problem.u_D": u_D, "solve.eps": 1e-12})
        domain = None
        for direct_up_to, algorithm, backend in ways:
            tuning = Tuning(direct_up_to=direct_up_to)
            case = base.with_values({"solve.algorithm": algorithm, "solve.backend": backend})
            solution = solve_case(case, COMM, domain=domain, tuning=tuning)
            spaces, domain = solution.spaces, solution.spaces.domain
            u = parse_expression(u_D, ufl.SpatialCoordinate(spaces.mesh))
            assert spaces.integrate(l2(ufl.as_vector(gradient) - solution.sigma, ufl.dx)) < 1e-18
            means = [(u - solution.u) * ufl.TestFunction(spaces.Q) * ufl.dx]
            means += [(u - solution.p) * ufl.TestFunction(spaces.Lambda) * spaces.ds]
            for form in means:
                assert np.abs(fem.assemble_vector(spaces.form(form)).array).max(initial=0.0) < 1e-10


@pytest.mark.parallel([1, 2])
def test_backends_agree(folder: Path):
    """Iterates of both backends are the same to rounding with u_D ≠ 0, in 2D and 3D."""
    algorithms = ("alg1", "alg3", "alg4") if COMM.size == 1 else ("alg3",)
    for shape, algorithm in itertools.product(("lshape", "cube"), algorithms):
        case = make_case(folder, shape=shape, parts=["bottom", "left"], f="20*(x - 0.6)", h=0.4)
        case = case.with_values({"problem.u_D": "sin(3*x)*y + abs(x - 0.7)", "solve.algorithm": algorithm})
        one = solve_case(case, COMM)
        two = solve_case(case.with_values({"solve.backend": "mixed"}), COMM, domain=one.spaces.domain)
        assert 0 < one.contact[0] < one.spaces.Lambda.dofmap.index_map.size_global
        assert [step.changed for step in one.outcome.history] == [step.changed for step in two.outcome.history]
        for a, b in [(one.sigma, two.sigma), (one.u, two.u), (one.p, two.p)]:
            np.testing.assert_allclose(a.x.array, b.x.array, atol=1e-11)


@pytest.mark.parallel(2)
def test_bad_data(folder: Path):
    case = make_case(folder, parts=["bottom"], f="0", h=0.4)
    for name, value, message in [
        ("u_D", "1/(x - x)", "u_D: not finite everywhere on Γ_D"),
        ("u_D", "1e200*x", "u_D: its largest value"),
        ("u_D", "1e-9*log((x - 1)**2 + y**2)", "u_D: not finite everywhere on Γ_D"),  # in a corner, which is no
        ("psi", "log(x)", "psi: not finite everywhere on Γ_S"),  # quadrature point
    ]:
        with pytest.raises(InputError, match=message):
            solve_case(case.with_values({f"problem.{name}": value}), COMM)
    nowhere = "sqrt(x - 2)"
    choice = f"1 if {nowhere} > 0 else 2"
    for value in (f"0*{nowhere}", f"{nowhere}^0", choice, "0*exp(1e5*(x + 1))", f"abs(0*{nowhere})"):
        for name in ("f", "kappa", "c", "psi"):
            with pytest.raises(InputError, match=f"{name}: not finite everywhere"):
                solve_case(case.with_values({f"problem.{name}": value}), COMM)
    assert solve_case(case.with_values({"problem.f": f"1 if x > 2 and {nowhere} > 0 else 0*x"}), COMM).converged
    with pytest.raises(InputError, match=r"\[problem\] u_D: expression 'q': unknown name 'q'"):
        case.with_values({"problem.u_D": "q"})
