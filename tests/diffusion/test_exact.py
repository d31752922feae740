"""Cases with known solutions: rates and bounds of the errors, and their certificates."""

import functools
from dataclasses import dataclass

import numpy as np
import pytest
import ufl
from made_cases import case_of
from mpi4py import MPI

from signorini_fenicsx import certify, load_case, solve_case
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.expressions.reader import parse_expression
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.physics.diffusion.solution import Solution

COMM = MPI.COMM_WORLD


@dataclass(frozen=True)
class Expected:
    """Expected results of a case on its meshes.

    Attributes:
        u: Solution; None for that of the case.
        f: Load; None for that of the case.
        constants: Bounds of ‖σ−σ_h‖_V/h, ‖u−u_h‖/h, ‖p−p_h‖_Λ/h and ‖Π_h u−u_h‖/h².
        contact: Measure of the exact contact set, or None where it is degenerate or so flat that h is no scale for it.
        levels: Mesh sizes.
        mesh: Kind of mesh.
    """

    constants: tuple[float, float, float, float]
    contact: float | None = None
    u: str | None = None
    f: str | None = None
    levels: tuple[float, float] = (1 / 8, 1 / 16)
    mesh: str = "unstructured"


SINGULAR = "-((x - 1/2)^2 + y^2)^({a}/2)*sin({a}*atan2(abs(y), x - 1/2))"
EXPECTED = {
    "singular": Expected((0.38, 0.19, 0.12, 0.021), contact=0.5),
    "singular, a = 7/2": Expected((1.6, 0.27, 0.041, 0.12), u=SINGULAR.format(a="7/2")),
    "transition": Expected((0.88, 0.058, 0.08, 0.036), contact=0.413),
    "transition, k = 4": Expected(
        (1.1, 0.038, 0.053, 0.041),
        u="max(x - 0.413, 0)^4 - y*max(0.413 - x, 0)^4",
        f="-12*(max(x - 0.413, 0)^2 - y*max(0.413 - x, 0)^2)",
    ),
    "biactive": Expected((1.25, 0.058, 0.083, 0.055)),
    "singular3d": Expected((0.26, 0.14, 0.058, 0.011), contact=0.5, levels=(1 / 2, 1 / 4)),
    "transition3d": Expected(
        (12.4, 0.4, 0.48, 0.23), contact=np.pi * 0.49 / 4, levels=(1 / 4, 0.15), mesh="structured"
    ),
}


@functools.cache
def solutions(name: str) -> list[Solution]:
    expected = EXPECTED[name]
    values = {} if expected.u is None else {"problem.u_D": expected.u, "exact.u": expected.u}
    values |= {} if expected.f is None else {"problem.f": expected.f}
    case = load_case(name.split(",")[0]).with_values(values)
    return [
        solve_case(case.with_values({"solve.h": h, "geometry.mesh": expected.mesh}), MPI.COMM_SELF)
        for h in expected.levels
    ]


def all_errors(solution: Solution) -> dict[str, float]:
    """‖σ−σ_h‖_V, ‖u−u_h‖, ‖p−p_h‖_Λ and ‖Π_h u−u_h‖, which superconverges."""
    errors = solution.errors()
    assert errors is not None
    Q = solution.spaces.Q
    u = parse_expression(case_of(solution).exact.u, ufl.SpatialCoordinate(Q.mesh))
    measures = solution.spaces.cell_measures
    means = assembled(u * ufl.TestFunction(Q) * ufl.dx(metadata={"quadrature_degree": 10})) / measures
    return {
        "sigma_V": np.hypot(errors["sigma_L2"], errors["div_sigma_L2"]),
        "u": errors["u_L2"],
        "p": errors["p_L2"],
        "super-close u": np.sqrt(measures @ (means - solution.u.x.array) ** 2),
    }


@pytest.mark.parametrize("name", EXPECTED)
def test_orders_and_bounds(name: str):
    """Order 1, order 2 for the means, and the contact set to within about a facet."""
    rows = []
    for solution in solutions(name):
        mesh, h = solution.spaces.mesh, solution.spaces.domain.h
        size = mesh.topology.index_map(mesh.topology.dim).size_global ** (-1 / mesh.topology.dim)
        rows.append((size, all_errors(solution)))
        for (error, value), constant in zip(rows[-1][1].items(), EXPECTED[name].constants, strict=True):
            assert value < constant * h ** (2 if error == "super-close u" else 1), error
        if EXPECTED[name].contact is not None:
            assert solution.contact[1] == pytest.approx(EXPECTED[name].contact, abs=0.8 * h)
    (coarse, larger), (fine, smaller) = rows
    for error in larger:
        order = np.log(larger[error] / smaller[error]) / np.log(coarse / fine)
        assert order > (1.8 if error == "super-close u" else 0.9), error


@pytest.mark.parametrize("name", [name for name in EXPECTED if name != "singular3d"])
def test_certificate(name: str):
    """The bound is true on meshes of two sizes, in space of one, and sharp; both squared errors are the gap."""
    for solution in solutions(name)[: 1 if "3d" in name else 2]:
        spaces = solution.spaces
        certificate = certify(solution)
        u = parse_expression(case_of(solution).exact.u, ufl.SpatialCoordinate(spaces.mesh))
        dx = ufl.Measure("dx", domain=spaces.mesh, metadata={"quadrature_degree": 8})
        sigma, v = (
            np.sqrt(spaces.integrate(l2(ufl.grad(u) - approximation, dx)))
            for approximation in (solution.sigma, ufl.grad(certificate.v))
        )
        assert max(sigma, v) <= certificate.bound
        assert sigma <= certificate.sigma_bound <= certificate.bound <= 1.5 * sigma
        assert certificate.sigma_bound <= 1.12 * sigma
        both, slack = sigma**2 + v**2, 2 * certificate.oscillation * v
        assert 0.99 * both - slack <= 2 * certificate.gap <= 1.04 * both + slack  # what of u_D is not in P2 is in it
        squares = certificate.indicator.x.array**2
        assert squares.sum() == pytest.approx(2 * certificate.gap + certificate.oscillation**2, rel=1e-10)
        assert certificate.remainder < 1e-6 * sigma  # ROUNDING ‖σ_h‖


@pytest.mark.parametrize("u", ["-x*x", "-2"])
def test_contact_with_a_curved_obstacle(u: str):
    """Contact everywhere, with a ψ whose facet means are not its values at midpoints."""
    values = {"boundary.signorini": ["bottom"], "solve.h": 0.5, "exact.u": u, "problem.f": "-10"}
    solution = solve_case(load_case("example1").with_values(values | {"problem.u_D": u, "problem.psi": u}))
    errors = solution.errors()
    assert errors is not None
    assert solution.contact[1] == pytest.approx(1.0)
    assert errors["contact_hausdorff"] == pytest.approx(0.0, abs=1e-12)
