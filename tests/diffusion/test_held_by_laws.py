"""Scalar components of the domain that only laws hold, across parts inside it: solved, or refused in a sentence."""

from pathlib import Path

import dolfinx.mesh
import numpy as np
import pytest
from elastic import two_boxes
from mpi4py import MPI

from signorini_fenicsx import (
    Diffusion,
    Dirichlet,
    Friction,
    Neumann,
    Options,
    Regulator,
    Signorini,
    Solver,
    TwoSided,
    Wall,
    load_case,
    solve,
    solve_case,
)
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.law import Law

COMM = MPI.COMM_WORLD
MESHES = Path(__file__).parents[2] / "data" / "meshes"
TWO = """geometry = {file = "FILE/fault.msh"}
law = [{parts = ["fault"], LAW}]
problem = {f = {upper = LOAD, lower = 0}}
[boundary]
inner = ["fault"]
sides = {fault = "upper"}
neumann = ["left", "right", "top"]
"""
THREE = """geometry = {file = "FILE/stack.geo"}
law = [{parts = ["low", "high"], LAW}]
problem = {f = {one = 0, two = TWO, three = LOAD}}
[boundary]
inner = ["low", "high"]
sides = {low = "two", high = "three"}
neumann = ["free", "top"]
"""
REGULATOR = 'kind = "regulator", k = 4, g_low = -1, g_high = 1'


def case_file(folder: Path, text: str, **words: object) -> Path:
    """A case file with words replaced."""
    for word, value in {"FILE": MESHES, **words}.items():
        text = text.replace(word, str(value))
    path = folder / "held.toml"
    if COMM.rank == 0:
        path.write_text(text, encoding="utf-8")
    COMM.Barrier()
    return path


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(
    ("law", "load", "jump", "method"),
    [
        (Regulator("fault", k=4, g_low=-1, g_high=1), 0.5, 0.125, "alg1"),
        (Regulator("fault", k=4, g_low=-1, g_high=1), -0.5, -0.125, "alg2"),
        (Wall("fault", beta=2, level=0.1), -0.5, -0.15, "alg1"),
        (Signorini("fault"), -0.5, 0.0, "alg2"),
        (TwoSided("fault", psi_upper=0.3), 0.5, 0.3, "alg1"),
        (Friction("fault", g=0.6), 0.5, 0.0, "alg2"),
    ],
)
def test_two_components(law: Law, load: float, jump: float, method: str):
    """The exact solution is in the discrete spaces, and the bound says so."""
    conditions = [law, Dirichlet("bottom"), Neumann("top", load), Neumann(["left", "right"])]
    solution = solve(two_boxes(COMM, 4, 2), Diffusion(f=0, conditions=conditions), Options(algorithm=method))
    assert solution.converged
    np.testing.assert_allclose(solution.p.x.array[solution.spaces.inner.rows], jump, atol=1e-10)
    u, centroids = (
        solution.u.x.array,
        dolfinx.mesh.compute_midpoints(solution.spaces.mesh, 2, np.arange(len(solution.u.x.array), dtype=np.int32)),
    )
    np.testing.assert_allclose(u, load * (centroids[:, 1] + 0.5) + np.where(centroids[:, 1] > 0, jump, 0), atol=1e-10)
    certificate = solution.certify()
    assert certificate.guaranteed
    assert certificate.bound < 1e-7


@pytest.mark.parametrize(
    ("law", "load"),
    [
        ('kind = "signorini"', 1.0),
        ('kind = "signorini"', 0.0),
        ('kind = "friction", g = 0.4', 1.0),
        ('kind = "friction", g = 0.5', -1.0),
        ('kind = "wall", beta = 2, level = 0.1', 1.0),
    ],
)
def test_one_that_nothing_balances(folder: Path, law: str, load: float):
    """A load beyond, or at the end of, what the law can carry is refused."""
    with pytest.raises(InputError, match=r"component of the domain around \(0\.5, 0\.25\) has no part where u = u_D"):
        solve_case(load_case(case_file(folder, TWO, LAW=law, LOAD=load)))


@pytest.mark.parallel(2)
def test_three_components(folder: Path):
    """Laws in a row carry the load of both; two components are refused together where each alone is balanced."""
    law = 'kind = "regulator", k = 4, g_low = -1, g_high = 1'
    solution = solve_case(load_case(case_file(folder, THREE, LAW=law, LOAD=0.5, TWO=0.1)))
    assert solution.converged
    certificate = solution.certify()
    assert certificate.guaranteed
    assert certificate.relative < 0.5
    friction = 'kind = "friction", g = 0.3'
    with pytest.raises(InputError, match=r"2 components of the domain, one of them around .*, have together no part"):
        solve_case(load_case(case_file(folder, THREE, LAW=friction, LOAD=0.45, TWO=0.45)))


def test_solved_again_and_again():
    """A solver that has solved often enough to condense its matrix does not where a body is held by laws alone."""
    domain, free = two_boxes(COMM, 6, 2), [Signorini("bottom", psi=-0.01), Neumann(["left", "right"], 0.03)]
    problems = [
        Diffusion(f="15*(x - 0.5)", conditions=[TwoSided("fault", psi=-0.05, psi_upper=upper), *free])
        for upper in np.linspace(0.02, 0.03, 8).tolist()
    ]
    solver = Solver(domain, problems[0])
    for problem in problems:
        kept, fresh = solver.solve(problem), solve(domain, problem)
        assert kept.u.x.array == pytest.approx(fresh.u.x.array, abs=1e-10)
