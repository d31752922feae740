"""Elastic contact against exact solutions of the half-plane: Hertz' cylinder, and a rigid flat punch."""

import numpy as np
import pytest
from elastic import box
from mpi4py import MPI

from signorini_fenicsx import Contact, Elasticity
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
P = 0.2


def pressed(nu: float, plane: str, a: float, *, flat: bool) -> tuple[list[str], float]:
    """Westergaard's u in y > 0 for a pressure on |x| < a, E = 1, and the curvature of the gap.

    With S = (a² − z²)^½ the pressure is P/S under a rigid flat punch, and P S/a under Hertz' parabola. As in
    `half_plane_contact`, u is made of Z, which is −pressure on y = 0, and of its integral Ẑ.
    """
    mu2, kappa = 1 / (1 + nu), 3 - 4 * nu if plane == "strain" else (3 - nu) / (1 + nu)
    square = f"({a**2} - x^2 + y^2)"
    r = f"sqrt({square}^2 + 4*x^2*y^2)"
    re, im = f"sqrt(max(({r} + {square})/2, 0))", f"((1 if x < 0 else -1)*sqrt(max(({r} - {square})/2, 0)))"  # of S
    angle = f"atan2(x + {im}, {re} - y)"  # of arcsin(z/a) the real part
    depth = f"(-log(((x + {im})^2 + ({re} - y)^2)/{a**2})/2)"  # and the imaginary one
    if flat:
        Z = f"{-P}*{re}/{r}", f"{P}*{im}/{r}"
        of_Z = f"{-P}*{angle}", f"{-P}*{depth}"
    else:
        Z = f"{-P / a}*({re} - y)", f"{-P / a}*({im} + x)"
        of_Z = (
            f"{-P / (2 * a)}*(x*{re} - y*{im} + {a**2}*{angle} - 2*x*y)",
            f"{-P / (2 * a)}*(x*{im} + y*{re} + {a**2}*{depth} + x^2 - y^2)",
        )
    ux = f"({(kappa - 1) / 2}*{of_Z[0]} - y*{Z[1]})/{mu2}"
    uy = f"({(kappa + 1) / 2}*{of_Z[1]} - y*{Z[0]})/{mu2}"
    return [ux, uy], (kappa + 1) / 2 * P / a / mu2


def solved(comm: MPI.Comm, n: int, nu: float, plane: str, a: float, *, flat: bool) -> ElasticSolution:
    """The half of [−1, 1]² above y = 0, with u given on the rest of its boundary."""
    domain = box(comm, n, [-1.0, 0.0], [1.0, 1.0])
    u, curvature = pressed(nu, plane, a, flat=flat)
    gap = f"0 if abs(x) < {a} else 2" if flat else f"{curvature / 2}*x^2"
    problem = Elasticity(1.0, nu, u_D=u, exact=u, plane=plane, conditions=[Contact("y0", gap)])
    return solve(domain, problem)


def test_hertz_without_an_effect_of_the_domain():
    """With the displacement of the half-plane around it a small body has the exact pressure; contact ends twice."""
    errors, a = [], 0.43
    for n in (8, 16):
        solution = solved(COMM, n, 0.49, "stress", a, flat=False)
        errors.append(found := solution.errors())
        assert n == 16 or found["energy"] <= certify(solution).sigma_bound < 1.7 * found["energy"]
        assert found["contact_hausdorff"] <= 1 / n
    assert errors[1]["energy"] < 1.8e-3
    assert np.log2(errors[0]["energy"] / errors[1]["energy"]) > 1.35
    assert np.log2(errors[0]["u_L2"] / errors[1]["u_L2"]) > 1.9
    assert solution.pressure.max() == pytest.approx(P, rel=0.02)
    assert solution.norms()["contact_force"] == pytest.approx(np.pi / 2 * P * a, rel=2e-3)


def test_rigid_punch():
    """The gap jumps where the punch ends and the pressure is infinite: order 1/2, and the bound is near the error."""
    errors = []
    for n in (4, 8):
        solution = solved(COMM, n, 0.49, "strain", 0.5, flat=True)
        errors.append((found := solution.errors())["energy"])
        assert n == 8 or errors[-1] <= certify(solution).sigma_bound < 1.6 * errors[-1]
        assert solution.contact[1] == pytest.approx(1.0)
        assert found["contact_hausdorff"] == 0.0
    assert errors[1] < 0.07
    assert np.log2(errors[0] / errors[1]) > 0.4
    assert solution.norms()["contact_force"] == pytest.approx(np.pi * P, rel=0.06)
