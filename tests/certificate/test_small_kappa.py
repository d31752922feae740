"""The bound where κ is nearly 0 in vertices or in cells: 1/κ is no polynomial, even where κ is one."""

import numpy as np
import pytest
from makers.bounds import Strip
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Neumann, Signorini, certify, domain_of, solve
from signorini_fenicsx.meshes.meshing import build_domain

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize(
    ("shape", "h", "strip", "sharp"),
    [
        ("square", 0.4, Strip("x + 1e-6", [0.0]), 1.2),
        ("square", 0.7, Strip("x^2 + 1e-8", [0.0]), 1.01),
        ("square", 0.4, Strip("(x - 0.3)^2 + 1e-8", [0.3], level=1000.0), 1.01),
        ("square", 0.4, Strip("1e-3 + abs(x - 0.3)", [0.3], f="-1 - x"), 1.3),
        ("square", 0.4, Strip("x^2 + 1e-4", [0.0], s="0.7"), 1.3),
        ("cube", 0.9, Strip("x^2 + 1e-3", [0.0]), 1.3),
    ],
)
def test_bounds_against_exact_fluxes(shape: str, h: float, strip: Strip, sharp: float):
    domain = build_domain(COMM, shape, h, mesh="structured")
    solution = solve(domain, strip.problem(domain.mesh.topology.dim))
    certificate = certify(solution)
    error, size = strip.norms(solution)
    assert certificate.guaranteed
    assert 0.999999 * error < certificate.sigma_bound < sharp * error
    of_size = certificate.bound / certificate.relative
    assert 0.98 * size < of_size < 1.000001 * size


def test_kappa_by_region_and_beside_data_in_v():
    """A region where κ is a number adds nothing; u_D as text enters v itself in cells where κ is nearly 0."""
    mesh = build_domain(COMM, "square", 0.4, mesh="structured").mesh
    parts = {name: lambda x, i=i, at=at: np.isclose(x[i], at) for name, i, at in (("low", 1, 0), ("left", 0, 0))}
    halves = {"left_half": lambda x: x[0] <= 0.5 + 1e-9, "right_half": lambda x: x[0] >= 0.5 - 1e-9}
    domain = domain_of(mesh, parts, halves)
    conditions = [Signorini("low", psi=-10), Neumann("left")]
    kappa = {"left_half": "x^2 + 1e-6", "right_half": 1.0}
    certificates = [
        certify(solve(domain, Diffusion(f=1, kappa=kappa, u_D=u_D, conditions=conditions)))
        for u_D in ("0.1*x*x", "0.1*x^2 + 1e-9*sin(x)")
    ]
    assert all(certificate.guaranteed for certificate in certificates)
    first, second = (certificate.bound for certificate in certificates)
    assert first < second * (1 + 1e-6) < 1.05 * first
