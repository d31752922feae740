"""A fault in any direction that reaches Γ_D on both sides, where u jumps at its ends."""

from pathlib import Path

import numpy as np
import ufl
from mpi4py import MPI

from signorini_fenicsx import certify, load_case, solve_case
from signorini_fenicsx.expressions.reader import parse_expression
from signorini_fenicsx.forms.norms import l2

COMM = MPI.COMM_WORLD
COS, SIN = 12 / 13, 5 / 13
GEO = """
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5};
Line(5) = {5, 6}; Line(6) = {6, 1}; Line(7) = {6, 3};
Curve Loop(1) = {1, 2, -7, 6}; Curve Loop(2) = {7, 3, 4, 5}; Plane Surface(1) = {1}; Plane Surface(2) = {2};
Physical Curve("fault") = {7}; Physical Curve("sides") = {1, 2, 3, 4, 5, 6};
Physical Surface("lower") = {1}; Physical Surface("upper") = {2};
"""
CASE = """
[geometry]
file = "oblique.geo"
[boundary]
inner = ["fault"]
sides = {fault = "upper"}
[[law]]
parts = ["fault"]
kind = "signorini"
[problem]
f = 0
kappa = {upper = 1, lower = 5}
u_D = "EXACT"
[exact]
u = "EXACT"
"""
ALONG, ACROSS = f"({COS}*x + {SIN}*y)", f"({COS}*y - {SIN}*x)"
FLUX = f"-({ALONG}^2 + {ACROSS}^2)^(3/4)*sin(3/2*atan2({ACROSS}, {ALONG}))"
EXACT = f"{FLUX} if {ACROSS} > 0 else {FLUX}/5"
"""Open behind (0, 0) and closed before it; κu has the same form on both sides."""


def test_jump_on_the_wall(folder: Path):
    """Order 1, and a sharp bound; u_D jumps in the ends of the fault, where rounding decides what its text says."""
    if COMM.rank == 0:
        corners = [(-1, -1), (1, -1), (1, 0), (1, 1), (-1, 1), (-1, 0)]
        turned = [(COS * x - SIN * y, SIN * x + COS * y) for x, y in corners]
        points = [f"Point({number}) = {{{x}, {y}, 0}};" for number, (x, y) in enumerate(turned, start=1)]
        (folder / "oblique.geo").write_text("\n".join(points) + GEO)
        (folder / "case.toml").write_text(CASE.replace("EXACT", EXACT))
    COMM.Barrier()
    errors = []
    for h in (0.4, 0.2):
        solution = solve_case(load_case(str(folder / "case.toml")).with_values({"solve.h": h}), COMM)
        spaces, certificate = solution.spaces, certify(solution)
        x = ufl.SpatialCoordinate(spaces.mesh)
        across = COS * x[1] - SIN * x[0]
        sigma = ufl.grad(parse_expression(FLUX, x))
        root = ufl.conditional(ufl.gt(across, 0), 1.0, 5.0) ** -0.5
        dx = ufl.Measure("dx", domain=spaces.mesh, metadata={"quadrature_degree": 6})
        errors.append(np.sqrt(spaces.integrate(l2(root * (sigma - solution.sigma), dx))))
        assert certificate.guaranteed
        assert 1 <= certificate.sigma_bound / errors[-1] < 1.1
    assert np.log2(errors[0] / errors[1]) > 0.9
