"""Pressures on parts of an elastic body: exact states, Lamé's tube, the bound, what is refused."""

from dataclasses import replace

import dolfinx.mesh
import numpy as np
import pytest
from elastic import box
from mpi4py import MPI

from signorini_fenicsx.api import Contact, Diffusion, Dirichlet, Elasticity, Neumann, Pressure, domain_of
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD


@pytest.mark.parallel([1, 3])
def test_fluid_around_a_body():
    """Under the same pressure from all sides the stress is minus this pressure, and the foundation carries it."""
    domain = box(COMM, 2, [0.0, 0.0, 0.0], [1.0, 1.0, 1.0])
    conditions = [
        Contact("z0"),
        Pressure(["z1", "x1", "y1"], 0.2),
        Dirichlet("x0", 0, components="x"),
        Dirichlet("y0", 0, components="y"),
    ]
    solution = solve(domain, Elasticity(1.0, 0.3, conditions=conditions))
    np.testing.assert_allclose(
        solution.stresses, np.broadcast_to(-0.2 * np.eye(3), solution.stresses.shape), atol=1e-12
    )
    np.testing.assert_allclose(solution.pressure, 0.2)


def test_tube_under_inner_pressure():
    """Lamé's tube: u = x/|x|², and the pressure is 2μ/|x|² at the inner side."""
    u, errors = ["x/(x^2 + y^2)", "y/(x^2 + y^2)"], []
    for h in (0.25, 0.125):
        domain = build_domain(COMM, "annulus", h, mesh="gmsh")
        problem = ElasticProblem(1.0, 0.3, u_D=u, exact=u, pressure={"inner": 4 / 1.3})
        solution = solve(domain, replace(problem, boundary=ElasticBoundary([], ["inner"])))
        errors.append(solution.errors()["energy"] / solution.norms()["energy"])
    assert errors[1] < 0.04
    assert np.log2(errors[0] / errors[1]) > 1


def test_pressure_that_varies():
    """A pressure is the traction along the normal that it stands for, in the bound too."""
    domain, found = box(COMM, 4, [0.0, 0.0], [1.0, 1.0]), []
    boundary = ElasticBoundary(["y0"], ["x1", "y1"], {"x0": "x"})
    for loads in ({"g_N": {"y1": ["0", "-x^4"], "x1": ["-y", "0"]}}, {"pressure": {"y1": "x^4", "x1": "y"}}):
        solution = solve(domain, ElasticProblem(1.0, 0.3, **loads, boundary=boundary))
        found.append((solution.stresses, certify(solution)))
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-13)
    assert found[0][1].bound == pytest.approx(found[1][1].bound, rel=1e-10)
    assert found[1][1].oscillation > 0
    assert found[1][1].guaranteed


@pytest.mark.parametrize(
    ("more", "complaint"),
    [
        ({"g_N": ["0", "-1"]}, "a traction g_N is given there"),
        ({"g_N": {"y1": ["0", "-1"]}}, "a traction g_N is given there"),
        ({}, ""),
    ],
)
def test_pressure_where_it_cannot_be(more: dict, complaint: str):
    """A part has a traction or a pressure, and is in Γ_N."""
    domain, boundary = box(COMM, 1, [0.0, 0.0], [1.0, 1.0]), ElasticBoundary(["y0"], ["y1"])
    part = "y1" if complaint else "x0"
    with pytest.raises(InputError, match=complaint or "part 'x0' takes no traction, .* fixed; y1 are"):
        solve(domain, ElasticProblem(1.0, 0.3, pressure={part: 1.0}, **more, boundary=boundary))


def test_two_loads_on_a_part():
    """In Python a part has one condition."""
    with pytest.raises(InputError, match="part 'y1' has two conditions"):
        Elasticity(1.0, 0.3, conditions=[Contact("y0"), Pressure("y1", 1.0), Neumann("y1", ["0", "-1"])])
    held, load = Dirichlet("y1", ["0", "0"], components="x"), Neumann("y1", ["0", "-1"])
    assert Elasticity(1.0, 0.3, conditions=[held, load])
    with pytest.raises(InputError, match="part 'y1' has two conditions"):
        Elasticity(1.0, 0.3, conditions=[held, load, Neumann("y1", ["0", "-2"])])
    with pytest.raises(InputError, match="an example is"):
        Elasticity(1.0, 0.3, conditions=held)  # type: ignore[arg-type]


def test_parts_that_overlap():
    """A facet in two parts has no two conditions: u given on one of them was passed over."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 4, 4)
    parts = {"low": lambda x: np.isclose(x[1], 0), "some": lambda x: np.isclose(x[1] * (1 - x[0]), 0)}
    domain = domain_of(mesh, parts)
    message = "parts 'low' and 'some' have 4 facets in common"
    with pytest.raises(InputError, match=message):
        solve(domain, Elasticity(1.0, 0.3, conditions=[Dirichlet("low", ["0", "0.1"]), Neumann("some")]))
    with pytest.raises(InputError, match=message):
        solve(domain, Diffusion(1.0, conditions=[Dirichlet("low"), Neumann("some")]))
