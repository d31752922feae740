"""Bodies that touch against numbers of others: Hertz, Mindlin, also in space, and a plate of Code_Aster."""

import numpy as np
import pytest
from measuring.published import plate_values, steps

from signorini_fenicsx import evolve_case, load_case, solve_case
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
    """X and the measure at the vertices of Γ_C."""
    return solution.spaces.contact.vertices[:, :, 0], solution.spaces.site_kinds["normal"].measure.reshape(-1, 2)


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


def test_cylinders_of_unequal_materials():
    """Without friction the moduli of both count, as E*: 1/E* is the sum of (1 − ν²)/E."""
    laws = [{"parts": ["contact"], "kind": "contact", "gap": "x^2/8"}]
    given = {"young": {"upper": 50, "lower": 800}, "poisson": {"upper": 0.1, "lower": 0.45}}
    pressed = {"u_D": {"top": [0, -0.3], "bottom": [0, 0]}}
    case = load_case("mindlin").with_values({"law": laws, "problem": given | pressed, "time": None})
    solution = solve_case(case)
    x, measure = on_contact(solution)
    a, p0 = hertz(solution.norms()["contact_force"], 1 / ((1 - 0.1**2) / 50 + (1 - 0.45**2) / 800))
    assert 0.5 < a < 1
    assert (
        measure * np.abs(solution.pressure - p0 * ellipse(x, a))
    ).sum() < 0.02 * measure.ravel() @ solution.pressure.ravel()
    assert solution.pressure.max() == pytest.approx(p0, rel=0.01)


@pytest.mark.slow
def test_mindlin_in_space():
    """A sphere that is pressed and pushed: pressure, shear, what sticks and how far it goes, within some per cent."""
    law = {"kind": "friction", "parts": ["contact"], "mu": MU, "gap": "(x^2 + y^2)/16"}
    law["force"] = {"z": -0.109666, "x": f"{MU}*0.109666*max(t - 1, 0)*3/4"}
    case = load_case("mindlin3d").with_values({"law": [law], "time": {"end": 2, "steps": 2}})
    pressed, pushed = steps(case)
    assert pressed["peak"] == pytest.approx(1, rel=0.02)
    assert max(abs(pressed[name] - 1) for name in ("radius", "depth")) < 0.03
    assert pressed["off_pressure"] < 0.08
    assert pushed["push"] == pytest.approx(0.75, rel=1e-6)
    assert pushed["sticks"] == pytest.approx(pushed["c"], abs=0.03)  # facets are 0.2 long
    assert pushed["off_shear"] < 0.17
    assert pushed["moved"] == pytest.approx(pushed["way"], rel=0.05)


PLATE = {0.0: 2.86e-5, 1.25e-3: 2.72e-5, 5e-3: 2.28e-5, 7.5e-3: 1.98e-5}
"""Published u_x on the plane; the fifth, 1.50e-5 at 11.25 mm, is wrong by 2.7 percent, see scripts/measure.py."""


def test_a_plate_of_code_aster():
    """u_x is the published one to half a percent, but for a value that the bound excludes."""
    solution = solve_case(load_case("plate").with_values({"solve.h": 0.0025}))
    u = solution.at(np.array([[x, 0.0] for x in (*PLATE, 11.25e-3)])).u[:, 0]
    np.testing.assert_allclose(u[:-1], list(PLATE.values()), rtol=5e-3)
    assert u[-1] == pytest.approx(1.541e-5, rel=5e-3)


@pytest.mark.slow
def test_bounds_of_published_values(capsys: pytest.CaptureFixture[str]):
    """On a coarse mesh the interval of a mean holds what a fine one gives, and is narrow."""
    _, _, mean = next(plate_values(2560))
    assert mean.lower < 2.7226e-5 < mean.upper < mean.lower * 1.02
    assert "bound" in capsys.readouterr().out
