"""Laws between the opening and the pressure of elastic bodies: springs, walls, two-sided joints, graphs."""

from pathlib import Path

import numpy as np
import pytest
from agreement import on_one_rank
from elastic import box
from made_cases import Spring, blocks
from mpi4py import MPI

from signorini_fenicsx import (
    Dirichlet,
    Elasticity,
    Neumann,
    Options,
    Regulator,
    Wall,
    load_case,
    load_solution,
    solve_case,
)
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.contact.laws import Corners
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD


@pytest.fixture(scope="module")
def fault(tmp_path_factory: pytest.TempPathFactory) -> Domain:
    """The mesh of two blocks."""
    return mesh_case(load_case(blocks(tmp_path_factory.mktemp("fault"))), COMM)


SMOOTH = ["0.1*x*y", "-0.1 - 0.05*x^2 - 0.2*y - 0.15*y^2 - 0.1*x^2*y"]
"""On springs of stiffness 2 at y = 0, for E = 1 and ν = 0: the pressure there is 0.2 + 0.1x²."""


def on(law: Law, n: int, comm: MPI.Comm = COMM, tuning: Tuning | None = None) -> ElasticSolution:
    """A square that a sloping displacement presses onto something with this law, and tears off it."""
    pressed = Dirichlet("y1", ["0.05*x", "-0.3 + 0.35*x"])
    problem = Elasticity(young=1.0, poisson=0.3, conditions=[law, pressed, Neumann(["x0", "x1"])])
    return solve(box(comm, n, [0.0, 0.0], [1.0, 1.0]), problem, Options(tuning=tuning or Tuning()))


@pytest.mark.parametrize(
    ("law", "load", "opening", "state"),
    [
        ('kind = "wall", beta = 2, gap = 0.1, level = 0.02', -0.1, -0.03, "inflow"),
        ('kind = "two-sided", psi_upper = 0.05, psi = -0.02, q_S = 0.03', 0.1, 0.05, "upper"),
        (
            'kind = "graph", corners = [[0, 0.2], [0.1, 0.05]], before = "vertical", beyond = 1',
            -0.1,
            1 / 15,
            "segment 1",
        ),
        ('kind = "regulator", k = 4, g_low = -0.2, g_high = 0.2, a = 0.01', 0.1, 0.035, "regulated"),
    ],
)
def test_patch(fault: Domain, folder: Path, law: str, load: float, opening: float, state: str):
    """A uniform pressure is exact, the bound says so, and files keep it."""
    solution = solve_case(load_case(blocks(folder, law=law, load=load)), COMM, domain=fault)
    np.testing.assert_allclose(solution.pressure, -load, rtol=1e-10)
    np.testing.assert_allclose(solution.gap, opening, rtol=1e-10)
    certificate = solution.certify()
    assert certificate.guaranteed
    assert certificate.bound < 1e-8
    (on_part,) = solution.segments_of_parts().values()
    assert on_part[state]["measure"] == pytest.approx(1.0)
    solution.write(folder / "out")
    read = load_solution(folder / "out")
    assert read.segments_of_parts() == solution.segments_of_parts()
    assert read.kkt.complementarity == pytest.approx(solution.kkt.complementarity, abs=1e-12)


def test_smooth():
    """Where the pressure varies σ_h has order 2, and so has the bound."""
    conditions, errors = [Wall("y0", beta=2.0), Dirichlet(["x0", "x1", "y1"], SMOOTH)], []
    problem = Elasticity(young=1.0, poisson=0.0, f=["0.1*x", "0.3 + 0.1*y"], exact=SMOOTH, conditions=conditions)
    for n in (4, 8):
        solution = solve(box(MPI.COMM_SELF, n, [0.0, 0.0], [1.0, 1.0]), problem)
        errors.append(solution.errors()["energy"])
        assert errors[-1] <= solution.certify().bound <= 1.5 * errors[-1]
    assert errors[1] < 0.32 * errors[0]


LAWS = {
    "varying wall": Wall("y0", beta="3 + 2*x", level="0.05*x"),
    "regulator": Regulator("y0", k=2.0, g_low=-0.02, g_high=0.15),
    "layer": Corners("y0", corners=[(0.0, 0.2), (0.1, 0.05), (0.15, 0.0)], before="vertical"),
}


@pytest.mark.parametrize("law", ["varying wall", "layer"])
def test_bound(law: str):
    """With several states along the part the bound is above the distance to a finer solution, and near it."""
    coarse, fine = (on(LAWS[law], n, MPI.COMM_SELF) for n in (4, 8))
    certificate, distance = coarse.certify(), fine.differences(coarse).energy
    assert len(np.unique(coarse.segment)) > 1
    assert certificate.guaranteed == (law != "varying wall")
    assert distance - fine.certify().bound <= certificate.bound <= 1.5 * distance + fine.certify().bound


@pytest.mark.parallel(2)
def test_multigrid_on_ranks():
    """On several ranks CG with multigrid finds what a factorisation finds on one."""

    def results(comm: MPI.Comm, tuning: Tuning) -> tuple[dict[str, float], int, float]:
        solution = on(LAWS["regulator"], 8, comm, tuning=tuning)
        regulated = solution.segments_of_parts()["y0"]["regulated"]["vertices"]
        return solution.norms(), regulated, solution.certify().bound

    norms, regulated, bound = on_one_rank(lambda comm: results(comm, Tuning()))
    together = results(COMM, Tuning(direct_up_to=0))
    assert together[0] == pytest.approx(norms, rel=1e-10)
    assert together[1:] == (regulated, pytest.approx(bound, rel=1e-5))


def test_a_law_of_ones_own():
    """It needs its class alone: the solution, its bound and its states are those of the graph with the same line."""
    own = on(Spring("y0", stiffness="2"), 4, MPI.COMM_SELF)
    line = on(Corners("y0", corners=[(0, 0)], before=2, beyond=2), 4, MPI.COMM_SELF)
    np.testing.assert_allclose(own.stresses, line.stresses, atol=1e-12)
    assert own.certify().bound == pytest.approx(line.certify().bound, rel=1e-6)
    assert list(own.segments_of_parts()["y0"]) == ["spring"]


def test_a_body_that_only_laws_hold(folder: Path):
    """Springs hold it; a law with a largest pressure does so up to that, and more is refused."""
    law = 'kind = "regulator", k = 4, g_low = -0.2, g_high = 0.2'
    np.testing.assert_allclose(solve_case(load_case(blocks(folder, law=law))).gap, -0.025, rtol=1e-10)
    for load in (-0.21, 0.21):
        with pytest.raises(InputError, match=r"the body can move rigidly, along \(0, -?1\)"):
            solve_case(load_case(blocks(folder, law=law, load=load)))


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ('kind = "wall"', "missing key 'beta' of the law 'wall'"),
        ('kind = "wall", beta = 2, mu = 0.3', "unknown key 'mu' of the law 'wall'; .* a law with it is friction"),
        ('kind = "wall", beta = 2, psi = 0', "unknown key 'psi' of the law 'wall'"),
        ('kind = "contact", psi = 0', "unknown key 'psi' of the law 'contact'"),
        ('kind = "wall", beta = -1', "beta must not be negative"),
        ('kind = "graph", corners = [[0, 0], [0.1, 0.2]]', "must not grow from corner 0 to 1"),
    ],
)
def test_wrong_laws(folder: Path, law: str, message: str):
    """They are refused with the key; a graph that is not monotone, such as of an adhesive, among them."""
    with pytest.raises(InputError, match=message):
        solve_case(load_case(blocks(folder, law=law)))
