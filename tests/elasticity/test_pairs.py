"""Bodies with meshes of their own: exact patch tests, any ranks, a matching mesh as a limit, refusals."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from bodies_apart import two
from mpi4py import MPI

from signorini_fenicsx.api import (
    Coulomb,
    Dirichlet,
    Elasticity,
    InputError,
    Neumann,
    Pair,
    Pressure,
    Solution,
    Tied,
    Tresca,
    Wall,
    solve,
)

LAWS = [None, Tresca(0.2), Coulomb(0.3), Tied(), Wall((), beta=5.0)]


def pressed(domain: Any, dim: int, pair: Pair, load: Sequence[Any] = ()) -> Solution:
    """The upper of two boxes is pressed by 1 on the lower one."""
    last, axes = dim - 1, "xyz"
    sides = [Dirichlet([f"u{k}0", f"l{k}0"], 0, components=axes[k]) for k in range(last)]
    free = [Neumann([f"u{k}1", f"l{k}1"]) for k in range(last)]
    held = Dirichlet(f"l{last}0", 0, components=axes[last])
    return solve(
        domain,
        Elasticity(
            young=1, poisson=0.3, conditions=[*sides, *free, held, pair, *(load or [Pressure(f"u{last}1", 1.0)])]
        ),
    )


def largest(solution: Solution, values: np.ndarray) -> float:
    """The largest |values| over all ranks."""
    return float(solution.spaces.mesh.comm.allreduce(float(np.abs(values).max(initial=0.0)), MPI.MAX))


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("upper", "lower"), [((3, 2), (2, 3)), ((5, 3), (7, 2)), ((2, 2, 2), (3, 2, 2))])
def test_uniform_pressure(upper: tuple[int, ...], lower: tuple[int, ...], law: Any) -> None:
    """A uniform stress passes from one body to the other, apart or not, under any law."""
    dim = len(upper)
    gap = 0.25 if law is None or isinstance(law, Wall) else 0.0
    domain = two(MPI.COMM_WORLD, upper, lower, gap=gap)
    solution = pressed(domain, dim, Pair(f"u{dim - 1}0", f"l{dim - 1}1", law))
    exact = np.zeros((dim, dim))
    exact[-1, -1] = -1.0
    assert largest(solution, solution.stresses - exact) < 1e-12


@pytest.mark.parametrize("gap", [0.1, "0.1", "distance - 0.15"])
def test_a_given_gap(gap: Any) -> None:
    """A gap in the place of the distance, or more than it."""
    domain = two(MPI.COMM_WORLD, (3, 2), (4, 2), gap=0.25)
    solution = pressed(domain, 2, Pair("u10", "l11", None, gap=gap))
    u = solution.spaces.displacement_values(solution.u)
    assert abs(u[..., 1].min() - (-0.1 - 2 * 0.91)) < 1e-12


def test_no_pair_of_parts_without_a_facet_opposite() -> None:
    """Bodies too far from each other, a part on both sides, and laws that there are not."""
    domain = two(MPI.COMM_WORLD, (3, 2), (2, 3), gap=0.25)
    with pytest.raises(InputError, match="no facet of the slave is covered"):
        pressed(domain, 2, Pair("u10", "l11", within=0.2))
    with pytest.raises(InputError, match="is slave and master"):
        Pair("u10", ["u10", "l11"])
    with pytest.raises(InputError, match="distance"):
        Pair("u10", "l11", gap="2*distance")
