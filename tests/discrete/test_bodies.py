"""Several bodies that an open part inside the domain holds apart: each may be at rest at a level of its own."""

from pathlib import Path

import numpy as np
import pytest
from meeting_parts import crossed_square
from mpi4py import MPI

from signorini_fenicsx import certify, evolve_case, solve_case
from signorini_fenicsx.discrete.bodies import bodies, spread
from signorini_fenicsx.physics.diffusion.case import Case

COMM = MPI.COMM_WORLD
APART = """
[boundary]
inner = [PARTS]
SIDES
[[law]]
parts = [PARTS]
kind = "signorini"
[problem]
f = 0
u_D = "LEVELS"
"""
TWO, FOUR = "1 if y > 0.5 else 0", "(2 if y > 0.5 else 0) + (1 if x > 0.5 else 0)"


def bodies_apart(folder: Path, levels: str = TWO) -> Case:
    """A square in two or four pieces, each with one level of u on its boundary."""
    parts = '"fault"' if levels == TWO else '"fault", "cross"'
    lines = {"fault": (1, 0.0, 1.0)} | ({} if levels == TWO else {"cross": (0, 0.0, 1.0)})
    return crossed_square(folder, 4, APART.replace("PARTS", parts).replace("LEVELS", levels), lines)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(("levels", "number"), [(TWO, 2), (FOUR, 4)])
def test_at_rest(folder: Path, levels: str, number: int):
    """σ = 0 is the solution, u the level of each body, and the bound is rounding."""
    solution = solve_case(bodies_apart(folder, levels))
    spaces, u = solution.spaces, solution.u.x.array
    body = bodies(spaces.crouzeix_raviart)
    assert len(set().union(*COMM.allgather(set(body.tolist())))) == number
    for own in set(body.tolist()):
        assert np.ptp(u[body == own]) < 1e-12
    assert spread(spaces, spaces.dirichlet_facets, np.ones(len(spaces.dirichlet_facets))) == 0
    assert solution.norms()["sigma_L2"] < 1e-12
    assert certify(solution).bound < 1e-12


def test_at_rest_with_a_reaction(folder: Path):
    """Where f = cu, what is left of the balance is the rounding of this difference."""
    case = bodies_apart(folder).with_values({"problem.c": 1, "problem.f": TWO})
    assert certify(solve_case(case)).bound < 1e-12


def test_at_rest_in_time(folder: Path):
    """Each step keeps the levels."""
    case = bodies_apart(folder, FOUR).with_values({"time": {"end": 1, "steps": 2, "initial": FOUR, "capacity": 1e3}})
    for instant in evolve_case(case, COMM):
        assert instant.solution.norms()["sigma_L2"] < 1e-10


def test_a_far_bound_hides_nothing(folder: Path):
    """A u_D that varies on one body makes u vary, also beside a huge bound of the jump, which a nearer one replaces."""
    case = bodies_apart(folder).with_values({"problem.u_D": "1 + x if y > 0.5 else 0", "law.0.psi": -1e20})
    near = solve_case(case.with_values({"law.0.psi": -9})).norms()
    assert near["sigma_L2"] > 0.1
    assert solve_case(case).norms() == pytest.approx(near, rel=1e-7, abs=1e-9)
