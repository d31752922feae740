"""The bound for an elastic body is near the error where Tresca's bound of friction is a text that is not linear."""

import pytest
from elastic import box
from mpi4py import MPI

from signorini_fenicsx import Contact, Elasticity, Neumann, Tresca
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.comparing.comparison import differences
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize(
    ("g", "u_D", "sharp"),
    [
        ("0.1*sin(9*x)^2", ["0.05", "-0.1"], 2.5),  # was 28
        ("0.1 if x < 0.45 else 0.01", ["0.05", "-0.1"], 2.4),  # was 24
        ("0.1*exp(-30*(x - 0.5)^2)", ["0.3*x", "-0.1"], 1.4),  # was 14
        ("0.3*sqrt(abs(x - 0.33)) + 0.001", ["-0.02 - 0.02*x", "-0.04 - 0.08*x"], 2.4),
        ("0.3*x^6", ["0.3*x", "-0.1"], 1.25),  # was 9
    ],
    ids=["waves", "jump", "bell", "cusp", "power"],
)
def test_near_the_error(g: str, u_D: list[str], sharp: float):
    """It is above the distance to a solution on a mesh 4 times as fine; where the body slips and where it sticks."""
    given = Elasticity(1.0, 0.3, u_D=u_D, conditions=[Contact("y0", friction=Tresca(g)), Neumann(["x0", "x1"], 0)])
    coarse, fine = (solve(box(COMM, n, [0.0, 0.0], [1.0, 1.0]), given) for n in (5, 20))
    certificate, error = certify(coarse), differences(coarse, fine).energy
    assert certificate.guaranteed
    assert error < certificate.sigma_bound < sharp * error
