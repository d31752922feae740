"""Parts inside the domain that are circles, data by region, loads of a high degree in space, `qp` beside an edge."""

from pathlib import Path

import numpy as np
import pytest
from exact import energy_error
from mpi4py import MPI

from signorini_fenicsx import InputError, certify, load_case, solve_case

COMM = MPI.COMM_WORLD
GEO = """
Point(1) = {-1, -1, 0}; Point(2) = {1, -1, 0}; Point(3) = {1, 1, 0}; Point(4) = {-1, 1, 0};
Point(5) = {0.5, 0, 0}; Point(6) = {0, 0.5, 0}; Point(7) = {-0.5, 0, 0}; Point(8) = {0, -0.5, 0};
Point(9) = {0, 0, 0}; Point(10) = {0.2, -0.1, 0}; Point(11) = {0, 0.2, 0}; Point(12) = {-0.2, -0.1, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Circle(5) = {5, 9, 6}; Circle(6) = {6, 9, 7}; Circle(7) = {7, 9, 8}; Circle(8) = {8, 9, 5};
Line(9) = {10, 11}; Line(10) = {11, 12}; Line(11) = {12, 10};
Curve Loop(1) = {1, 2, 3, 4}; Curve Loop(2) = {5, 6, 7, 8}; Curve Loop(3) = {9, 10, 11};
Plane Surface(1) = {1, 2}; Plane Surface(2) = {2, 3};
Physical Curve("ring") = {5, 6, 7, 8}; Physical Curve("hole") = {9, 10, 11}; Physical Curve("wall") = {1, 2, 3, 4};
Physical Surface("outside") = {1}; Physical Surface("inside") = {2};
"""
SQUARE = "(x^2 + y^2)"
OUTSIDE, INSIDE = f"({SQUARE}^2 + x)/5 + 0.2", f"{SQUARE}^2 + x + ({SQUARE} - 1/4)^2"
CASE = f"""
[geometry]
file = "ring.geo"
[boundary]
inner = ["ring"]
sides = {{ring = "outside"}}
[[law]]
parts = ["ring"]
kind = "regulator"
k = 2
a = "-0.1 - 1.8*x"
g_low = -9
g_high = 9
[problem]
f = {{outside = "-16*{SQUARE}", inside = "2 - 32*{SQUARE}"}}
kappa = {{outside = 5, inside = 1}}
u_D = "{OUTSIDE} if {SQUARE} > 1/4 else {INSIDE}"
[exact]
u = {{outside = "{OUTSIDE}", inside = "{INSIDE}"}}
"""
"""On the circle the jump is 0.15 − 0.8x and σ·n = −0.5 − 2x."""


def test_circle(folder: Path):
    """Order 1 though polygons take its place, and a sharp bound that is guaranteed."""
    if COMM.rank == 0:
        (folder / "ring.geo").write_text(GEO)
        (folder / "case.toml").write_text(CASE)
    COMM.Barrier()
    case, errors = load_case(str(folder / "case.toml")), []
    for h in (0.3, 0.15):
        solution = solve_case(case.with_values({"solve.h": h}), COMM)
        found = solution.errors()
        assert found is not None
        errors.append([found[name] / solution.spaces.domain.h for name in ("sigma_L2", "div_sigma_L2", "u_L2", "p_L2")])
    certificate = certify(solution)
    assert certificate.guaranteed
    assert 1 <= certificate.sigma_bound / energy_error(solution) < 1.03
    assert np.all(np.array(errors) < [2.2, 9.8, 0.29, 0.31])
    assert np.all(np.log2(np.divide(*errors)) > -0.05)
    with pytest.raises(InputError, match="exact\\] u: unknown region 'middle'"):
        solve_case(case.with_values({"solve.h": 0.3, "exact.u": {"middle": 0}}), COMM)


def test_loads_of_regions_are_enclosed(tmp_path: Path):
    """A load that is no polynomial has the same bound as a whole and by region, but for what enclosures leave open."""
    (tmp_path / "ring.geo").write_text(GEO)
    (tmp_path / "case.toml").write_text(CASE)
    case, f = load_case(str(tmp_path / "case.toml")).with_values({"solve.h": 0.3}), "exp(3*x)*y"
    solutions = [
        solve_case(case.with_values({"problem.f": given}), MPI.COMM_SELF) for given in (f, {"outside": f, "inside": f})
    ]
    whole, parts = (certify(solution) for solution in solutions)
    assert parts.numbers() == pytest.approx(whole.numbers(), rel=5e-3)
    assert parts.guaranteed


def test_load_of_a_high_degree_in_space():
    """Its square has a degree that basix's smaller quadratures do not have."""
    solution = solve_case(load_case("cube").with_values({"solve.h": 0.9, "problem.f": "x^8"}), MPI.COMM_SELF)
    assert certify(solution).guaranteed


def test_quadratic_programme_near_the_edge_of_contact():
    """An interior-point method solves it to its KKT residual also where jump and flux are both nearly 0."""
    past, before = "max(x - 0.302442, 0)", "max(0.302442 - x, 0)"
    upper = f"0.785352*{past}^3 + -0.00873253*x + -0.0663438*x^2 - y*0.825339*{before}^3/0.12784"
    lower = f"-0.214648*{past}^3 - y*0.825339*{before}^3/5.13189"
    loads = {
        "upper": f"-0.602398*{past} - -0.0169628 + 6*y*0.825339*{before} + 10.0*({upper})",
        "lower": f"6.60931*{past} + 6*y*0.825339*{before} + 10.0*({lower})",
    }
    case = load_case("fault").with_values(
        {
            "boundary.neumann": [],
            "law": [{"parts": ["fault"], "kind": "signorini", "psi": "-0.00873253*x + -0.0663438*x^2"}],
            "problem.f": loads,
            "problem.kappa": {"upper": 0.12784, "lower": 5.13189},
            "problem.c": 10.0,
            "problem.g_N": 0,
            "problem.u_D": f"{upper} if y > 0 else {lower}",
            "exact.u": {"upper": upper, "lower": lower},
        }
    )
    solution, other = (
        solve_case(case.with_values({"solve.algorithm": name}), MPI.COMM_SELF) for name in ("alg1", "qp")
    )
    np.testing.assert_allclose(
        other.p.x.array, solution.p.x.array, rtol=0, atol=1e-8 * np.abs(solution.u.x.array).max()
    )
    assert 1 <= certify(solution).sigma_bound / energy_error(solution) < 1.1
