"""Derivatives through steps in time: initial values, both schemes, what melts."""

from typing import Any

import numpy as np
import pytest
import ufl
from controlled import constants, directions_of, function, move, pairing
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Evolution, InputError, Signorini, Storage, evolve
from signorini_fenicsx.derivatives import gradient_in_time
from signorini_fenicsx.extend import Instant
from signorini_fenicsx.meshes.meshing import build_domain

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("scheme", ["implicit-euler", "bdf2"])
def test_in_time(scheme: str):
    """Backwards through the steps, with the sets of each; a step alone is refused."""
    domain = build_domain(COMM, "square", 0.15, mesh="structured")
    k, psi, u_D = given = constants(domain, 0.8, -0.4, 0.1)
    m = function(domain, lambda x: -20 + 10 * x[0])
    x = ufl.SpatialCoordinate(domain.mesh)
    problem = Diffusion(
        f=m, kappa=k, c=k * x[1], u_D=u_D * x[0], conditions=[Signorini("bottom", psi=psi * (1 + x[0]))]
    )
    first = function(domain, lambda x: 0.1 * x[0])
    evolution = Evolution(end=0.2, steps=4, scheme=scheme, capacity="1 + y", initial=(1 + k) * first)
    controls = [*given, m, first]

    def J(instant: Instant) -> Any:
        solution = instant.solution
        return instant.t * solution.u**2 * ufl.dx + k * solution.p**2 * solution.spaces.ds

    def value() -> float:
        return sum(each.solution.spaces.integrate(J(each)) for each in evolve(domain, problem, evolution))

    instants = list(evolve(domain, problem, evolution))
    assert len({instant.solution.contact.facets for instant in instants}) > 1
    at, gradients = gradient_in_time(instants, J, controls)
    assert at == pytest.approx(value(), rel=1e-12)
    remainders, directions = [], directions_of(controls)
    for step in (4e-3, 2e-3):
        move(controls, directions, step)
        remainders.append(value() - at - step * pairing(gradients, directions))
        move(controls, directions, -step)
    assert np.log2(remainders[0] / remainders[1]) == pytest.approx(2, abs=0.1)
    with pytest.raises(InputError, match="use gradient_in_time"):
        instants[0].solution.gradient(J(instants[0]), [k])


def test_storage():
    """What melts keeps its temperature: backwards through the contents that the balances have selected."""
    domain = build_domain(COMM, "square", 0.15, mesh="structured")
    k, load = given = constants(domain, 0.8, -3.0)
    x = ufl.SpatialCoordinate(domain.mesh)
    melting = Storage(region="all", corners=[(-1, -1), (0, 0), (0, 1)], before=1.0, beyond=1.0)
    conditions = [Signorini("bottom", psi=-0.4), melting]
    problem = Diffusion(f=load * (1 + x[0]), kappa=k, u_D="0.6*x - 0.2", conditions=conditions)
    evolution = Evolution(end=0.4, steps=4, initial=0.3)

    def value() -> tuple[float, Any]:
        instants = list(evolve(domain, problem, evolution))
        return sum(each.solution.spaces.integrate(each.solution.u**2 * ufl.dx) for each in instants), instants

    at, instants = value()
    assert any((each.solution.u.x.array == 0).sum() > 3 for each in instants)
    _, gradients = gradient_in_time(instants, lambda each: each.solution.u**2 * ufl.dx, given)
    remainders, directions = [], directions_of(given)
    for step in (2e-4, 1e-4):
        move(given, directions, step)
        remainders.append(value()[0] - at - step * pairing(gradients, directions))
        move(given, directions, -step)
    assert abs(remainders[1]) < 1e-3 * 1e-4 * abs(pairing(gradients, directions))
