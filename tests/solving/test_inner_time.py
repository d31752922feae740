"""Parts inside the domain in time: an exact solution whose contact moves, bounds of steps, ranks, a restart."""

from pathlib import Path

import numpy as np
import pytest
from commands import read_rows
from exact import energy_error
from in_time import run_in_two
from mpi4py import MPI

from signorini_fenicsx import StepBounds, evolve_case, load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.meshes.uniform import refined_uniformly
from signorini_fenicsx.physics.diffusion.case import Case

COMM = MPI.COMM_WORLD
OPEN, SHUT = "max(x - 0.3 - 0.4*t, 0)", "max(0.3 + 0.4*t - x, 0)"
UPPER, LOWER = f"0.7*{OPEN}^3 - y*{SHUT}^3", f"-0.3*{OPEN}^3 - y*{SHUT}^3/5"
U = f"{UPPER} if y > 0 else {LOWER}"
"""With κ = 1 above and 5 below the jump is OPEN³, and σ·n is SHUT³ on both sides."""
OF_UPPER = f"-1.2*(0.7*{OPEN}^2 + y*{SHUT}^2) - 4.2*{OPEN}"
OF_LOWER = f"-2.4*(y*{SHUT}^2/5 - 0.3*{OPEN}^2) + 9*{OPEN}"


def opening(steps: int = 4, **values: object) -> Case:
    """A fault that closes from the left; C is 1 above and 2 below."""
    return load_case("fault").with_values(
        {
            "boundary.neumann": [],
            "law": [{"parts": ["fault"], "kind": "signorini"}],
            "problem.f": f"6*y*{SHUT} + ({OF_UPPER} if y > 0 else {OF_LOWER})",
            "problem.g_N": 0,
            "problem.u_D": U,
            "exact.u": U,
            "time": {"end": 1, "steps": steps, "initial": U.replace("*t", "*0"), "capacity": {"upper": 1, "lower": 2}},
        }
        | values
    )


def test_orders():
    """Order 1 with τ halved with h, and small errors; the transition within some facets; BDF2 is as good."""
    coarse = mesh_case(opening(), MPI.COMM_SELF)
    errors = []
    for domain, steps, scheme in ((coarse, 4, "implicit-euler"), (refined_uniformly(coarse), 8, "bdf2")):
        *_, last = evolve_case(opening(steps, **{"time.scheme": scheme}), MPI.COMM_SELF, domain=domain)
        found, h = last.solution.errors(), domain.h
        assert found is not None
        assert found["contact_hausdorff"] < 2 * h
        errors.append([found[name] / h for name in ("sigma_L2", "u_L2", "p_L2")])
    assert np.all(np.array(errors) < [0.26, 0.035, 0.04])
    assert np.all(np.log2(np.divide(*errors)) > -0.05)


def test_bounds_of_steps():
    """For data that do not move, and their own solution at the start: near the error, and guaranteed."""
    case = load_case("crack").with_values({"solve.h": 0.3})
    assert case.exact is not None
    time = {"end": 1, "steps": 2, "initial": case.exact.u, "capacity": 2, "scheme": "bdf2"}
    bounds = StepBounds()
    for instant in evolve_case(case.with_values({"time": time}), MPI.COMM_SELF):
        bound = bounds.certify(instant)
        assert 1 < bound.sigma_bound / energy_error(instant.solution) < 1.05  # a singular u_0 is enclosed
        assert bound.guaranteed


@pytest.mark.parallel(2)
def test_ranks_and_a_restart(folder: Path):
    """On two ranks, after a failure, the run goes on; the files are those of a run on one rank."""
    case = opening(3)
    run_in_two(case, folder / "x", 2)
    last = None
    for instant in evolve_case(case, MPI.COMM_SELF):
        last = instant.solution
    assert last is not None
    row = read_rows(folder / "x" / "steps.csv")[-1]
    assert {name: float(row[name]) for name in last.errors()} == pytest.approx(last.errors(), rel=1e-9, abs=1e-12)
    assert int(row["contact_facets"]) == last.contact[0]
