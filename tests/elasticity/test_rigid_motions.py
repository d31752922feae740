"""Which rigid motions nothing prevents: one linear programme with all rows, limits of loads by hand, sentences."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest
from elastic import box, two_boxes
from mpi4py import MPI
from scipy.optimize import linprog

from signorini_fenicsx.api import Contact, Dirichlet, Elasticity, Neumann, Pressure, Support, Tresca, solve
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.laws import Regulator
from signorini_fenicsx.physics.elasticity.solve.motion_limits import Limits
from signorini_fenicsx.physics.elasticity.solve.rigid_motions import _in_words

COMM = MPI.COMM_WORLD


def is_prevented(work: np.ndarray, into: np.ndarray, slips: np.ndarray, shears: np.ndarray) -> bool:
    """Whether no r ≠ 0 has into·r ≤ 0 and Σ shears |slips·r| ≤ work·r, with the |…| as variables."""
    size, own = len(work), np.eye(len(shears))
    rows = np.block(
        [[into, np.zeros((len(into), len(own)))], [slips, -own], [-slips, -own], [-work[None], shears[None]]]
    )
    for objective in np.concatenate([np.eye(size), -np.eye(size)]):
        cost = np.append(-objective, np.zeros(len(own)))
        bounds = [(-1, 1)] * size + [(0, None)] * len(own)
        if -linprog(cost, A_ub=rows, b_ub=np.zeros(len(rows)), bounds=bounds).fun > 0.5:
            return False
    return True


def work_at_most(work: Array, into: Array, slips: Array, shears: Array) -> float:
    """The largest work·r of r with into·r ≤ 0, entries up to 1, and Σ shears |slips·r| ≤ work·r."""
    own = np.eye(len(shears))
    rows = np.block(
        [[into, np.zeros((len(into), len(own)))], [slips, -own], [-slips, -own], [-work[None], shears[None]]]
    )
    bounds = [(-1, 1)] * len(work) + [(0, None)] * len(own)
    cost = np.append(-work, np.zeros(len(own)))
    return float(-linprog(cost, A_ub=rows, b_ub=np.zeros(len(rows)), bounds=bounds).fun)


@pytest.mark.parallel(2)
def test_cutting_planes_find_what_one_programme_finds():
    """For random rows of 1 to 6 motions, spread over the ranks, some with none; and the motion is one of those."""
    rng, held, slides = np.random.default_rng(3), 0, 0
    for number in range(12):
        size = 1 + number % 6
        into, slips = rng.normal(size=(rng.integers(1, 30), size)), rng.normal(size=(rng.integers(0, 9), size))
        work = -rng.uniform(0, 1, len(into)) @ into if number % 2 else rng.normal(size=size)
        shears = rng.uniform(0, 0.1, len(slips))
        mine = [np.arange(len(rows)) % min(COMM.size, 2) == COMM.rank for rows in (into, slips)]
        cones = rng.normal(size=(rng.integers(1, 9), 2, size)) * np.array([1.0, 0.1])[:, None]
        of_rank = cones[np.arange(len(cones)) % min(COMM.size, 2) == COMM.rank]
        limits = Limits(COMM, work, into[mine[0]], slips[mine[1]][:, None], shears[mine[1]], of_rank)
        few = into[:2][mine[0][:2]]
        slides += (sliding := replace(limits, into=few).sliding()) is not None
        both = np.concatenate([into[:2], cones[:, 0] + cones[:, 1], cones[:, 0] - cones[:, 1]])
        assert (sliding is None) == (work_at_most(work, both, slips, shears) < 1e-9)
        motion = limits.unprevented()
        assert (motion is None) == is_prevented(work, into, slips, shears)
        held += motion is None
        if motion is not None:
            assert np.abs(motion).max() == pytest.approx(1.0)
            assert (into @ motion).max() < 1e-8
            assert shears @ np.abs(slips @ motion) <= work @ motion + 1e-8
    assert 1 < held < 11
    assert 1 < slides < 11


def test_motions_are_told_without_rounding():
    """What is rounding beside the motion, or beside the size of the body, is told as 0."""
    assert _in_words(np.array([0, 7e-17, 1, 0, 0, 3e-16]), np.zeros(3), 1.0)[0] == "along (0, 0, 1)"
    turn = _in_words(np.array([1e-15, 0.5, 0, -2e-17, 3e-15, 1]), np.array([0.5, 0, 0]), 1.0)[0]
    assert turn == "about an axis along (0, 0, 1) through (0, 0, 0)"


ON_MESH = "prevent that on this mesh; a finer one may"
NEAR = 2e-3
"""How near to its limit a load is, as a share."""


def is_held(n: int, dim: int, conditions: list) -> bool:
    """Whether a unit square or cube with n cells along its edges has a solution; if not it is refused."""
    with contextlib.suppress(InputError):
        return solve(box(COMM, n, [0.0] * dim, [1.0] * dim), Elasticity(1.0, 0.3, conditions=conditions)).converged
    return False


@pytest.mark.parametrize("n", [1, 3])
def test_a_tool_tips_over_the_last_facet(n: int):
    """A linear pressure ≥ 0 on facets has its centre at most h/3 from the edge: there a tool begins to tip over."""
    sides = [Dirichlet("y0", 0), Neumann(["x0", "x1"])]
    most = 0.1 * (0.5 - 1 / (3 * n))
    for share in (1 - NEAR, 1 + NEAR):
        tool = Contact("y1", force={"y": -0.1}, moment={"z": share * most})
        assert is_held(n, 2, [*sides, tool]) == (share < 1)
    for moment, finer in ((1.01 * most, True), (0.051, False)):
        tool = Contact("y1", force={"y": -0.1}, moment={"z": moment})
        with pytest.raises(InputError, match=r"about the point .*, that is the tool on 'y1'") as refused:
            solve(box(COMM, n, [0.0, 0.0], [1.0, 1.0]), Elasticity(1.0, 0.3, conditions=[*sides, tool]))
        assert (ON_MESH in str(refused.value)) == finer


def test_a_tool_that_friction_alone_holds():
    """Under Tresca's law a tool turns when the moment is above Σ w g |r_t|, r_t in means, and shifts above g."""
    corners = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [0, 1], [1, 1]]]) - 0.5
    means = (corners + corners.sum(axis=1, keepdims=True)) / 4
    most = 0.1 / 6 * np.linalg.norm(means, axis=2).sum()
    sides = [Dirichlet("z0", 0), Neumann(["x0", "x1", "y0", "y1"])]
    for share in (1 - NEAR, 1 + NEAR):
        moved = {"force": {"z": -0.1, "x": 0.0, "y": 0.0}, "moment": {"z": share * most}}
        assert is_held(1, 3, [*sides, Contact("z1", friction=Tresca(0.1), **moved)]) == (share < 1)
    tool = Contact("z1", friction=Tresca(0.1), force={"z": -0.1, "x": 0.12})
    told = r"along \(1, 0, 0\), that is the tool on 'z1': .* the loads do the work 0\.12 on it, and friction .* 0\.1$"
    with pytest.raises(InputError, match=told):
        solve(box(COMM, 1, [0.0] * 3, [1.0] * 3), Elasticity(1.0, 0.3, conditions=[*sides, tool]))


@pytest.mark.parametrize("n", [1, 3])
def test_at_the_end_of_regulators(n: int):
    """Two regulators that push and pull by at most 0.2 hold a moment up to what a linear programme tells."""
    ends = np.linspace(0, 1, n + 1)
    x = np.stack([2 * ends[:-1] + ends[1:], ends[:-1] + 2 * ends[1:]], axis=1).ravel() / 3  # the means at the sites
    zero, one = np.zeros_like(x), np.ones_like(x)
    motions = np.concatenate([np.stack([zero, one, x], axis=1), np.stack([one, zero, -x], axis=1)])
    own = np.eye(len(motions))
    rows = np.block([[motions, -own], [-motions, -own]])
    cost, turns = np.append(np.zeros(3), np.full(len(own), 0.2 / (2 * n))), np.append([0, 0, 1], np.zeros(len(own)))
    bounds = [(None, None)] * 3 + [(0, None)] * len(own)
    most = linprog(cost, A_ub=rows, b_ub=np.zeros(len(rows)), A_eq=turns[None], b_eq=[1], bounds=bounds).fun
    laws = [Regulator([part], k=4, g_low=-0.2, g_high=0.2) for part in ("x0", "y0")]
    for share in (1 - NEAR, 1 + NEAR):
        load = Neumann("y1", ["0", f"{12 * share * most}*(x - 0.5)"])
        assert is_held(n, 2, [*laws, Neumann("x1"), load]) == (share < 1)


def test_weak_springs_hold_what_is_in_balance():
    """A body under pressure from all sides: motions are told along the axes, and what is advised is right."""
    domain, p = box(MPI.COMM_SELF, 2, [1.0, 2.0], [3.0, 3.0]), 0.1
    ends = ("x0", "x1", "y0", "y1")

    def told(*held: Dirichlet) -> str:
        free = [Pressure(end, p) for end in ends if end not in [part for each in held for part in each.parts]]
        with pytest.raises(InputError) as caught:
            solve(domain, Elasticity(1.0, 0.3, conditions=[*free, *held]))
        return str(caught.value)

    for way, held in (("(1, 0)", []), ("(0, 1)", [Dirichlet("x0", 0, components="x")])):
        message = told(*held)
        assert f"can move rigidly, along {way}: " in message
        assert "weak springs on a part (support) hold it" in message
    pushed = [Neumann("y1", ["0.2", "-0.1"]), *(Neumann(end) for end in ends[:3])]
    with pytest.raises(InputError, match=r"along \(1, 0\)|along \(0, -1\)") as caught:
        solve(domain, Elasticity(1.0, 0.3, conditions=pushed))
    assert "weak springs" not in str(caught.value)
    springs = [Pressure(end, p) for end in ends]
    solution = solve(domain, Elasticity(1.0, 0.3, conditions=[*springs, Support("y0", [1e-4, 1e-4])]))
    assert np.abs(solution.stresses + p * np.eye(2)).max() < 2e-4 * p
    free = [Neumann(["left", "right", "bottom", "top"])]
    with pytest.raises(InputError, match=r"along \(1, 0\), that is all bodies together: "):
        solve(two_boxes(MPI.COMM_SELF, 2, 2), Elasticity(1.0, 0.3, conditions=[Contact("fault"), *free]))
