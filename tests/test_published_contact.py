"""Bodies that touch against numbers of others: cylinders of Hertz, Cattaneo and Mindlin."""

import numpy as np
import pytest

from signorini_fenicsx import evolve_case, load_case
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

RADIUS, YOUNG, MU = 8.0, 200.0, 0.3


def hertz(force: float, modulus: float) -> tuple[float, float]:
    """Half of the width and the largest pressure of the contact of two cylinders of radius 8, from P and E*."""
    width = np.sqrt(4 * force * (RADIUS / 2) / (np.pi * modulus))
    return width, 2 * force / (np.pi * width)


def ellipse(x: Array, width: float) -> Array:
    """√(1 − x²/a²) for |x| < a, 0 beyond."""
    return np.sqrt(np.maximum(1 - (x / width) ** 2, 0))


def on_contact(solution: ElasticSolution) -> tuple[Array, Array]:
    """x and the measure at the vertices of Γ_C."""
    return solution.spaces.contact.vertices[:, :, 0], solution.spaces.site_measure.reshape(-1, 2)


def test_cattaneo_and_mindlin():
    """Pressure, shear and what sticks, on the way there and back, are those of half-planes within some per cent."""
    pushed = 0.0
    for instant in evolve_case(load_case("mindlin")):
        solution = instant.solution
        x, measure = on_contact(solution)
        (push, _, *_), force = solution.resultants()["top"], solution.norms()["contact_force"]
        a, p0 = hertz(force, YOUNG / (2 * (1 - 0.3**2)))
        assert (measure * np.abs(solution.pressure - p0 * ellipse(x, a))).sum() < 0.02 * force
        pushed = max(pushed, push)
        c, b = a * np.sqrt(1 - pushed / (MU * force)), a * np.sqrt(1 - (pushed - push) / (2 * MU * force))
        shear = ellipse(x, a) - c / a * ellipse(x, c) - 2 * (ellipse(x, a) - b / a * ellipse(x, b))
        shear = -MU * p0 * (shear if push < pushed else ellipse(x, a) - c / a * ellipse(x, c))
        assert (measure * np.abs(solution.shear - shear)).sum() < 0.03 * MU * force
        sticking = (measure * (solution.touching & (solution.states == 1))).sum() / 2
        assert sticking == pytest.approx(c if push == pushed else b, abs=0.03)  # facets are 0.05 long
    assert force == pytest.approx(10, rel=1e-3)
    assert pushed == pytest.approx(2.0, rel=0.02)
    assert abs(push) < 0.1 < np.abs(solution.shear).max()
