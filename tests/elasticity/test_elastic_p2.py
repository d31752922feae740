"""Elastic contact, also with friction in space, against a second program: P2, whose energy is on the other side."""

from dataclasses import replace

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from elastic import box, two_boxes
from mpi4py import MPI
from p2 import GAP as OBLIQUE_GAP
from p2 import LAWS, Box, oblique, solve_p2, stress, stress_norm

from signorini_fenicsx import Contact, Coulomb, Dirichlet, Elasticity, Neumann, Tresca
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.solving.solver import solve

GAP = 0.02


@pytest.mark.parametrize(("dim", "nu"), [(2, 0.3), (2, 0.49), pytest.param(3, 0.3, marks=pytest.mark.slow)])
def test_energies_bracket_the_exact_one(dim: int, nu: float):
    """−J(v) ≤ the exact energy ≤ that of the stress; what is between them bounds both errors, and falls with h."""
    between = []
    f, push = [0.0] * (dim - 1) + [-0.3], [0.0] * (dim - 1) + [-0.1]
    last = "xyz"[dim - 1]
    boundary = ElasticBoundary([f"{last}0"], neumann=["x1", f"{last}1"] + (["y1", "y0"] if dim == 3 else []))
    problem = ElasticProblem(1.0, nu, f=[str(x) for x in f], g_N={f"{last}1": [str(x) for x in push]}, gap=GAP)
    for n in (2, 4) if dim == 3 else (4, 8):
        domain = box(MPI.COMM_SELF, n, [0.0] * dim, [2.0] + [1.0] * (dim - 1))
        solution = solve(domain, replace(problem, boundary=boundary))
        mesh = domain.mesh
        other = solve_p2(Box(mesh, 1.0, nu, {(dim - 1, 1.0): push}, {(0, 0.0): list(range(dim))}, GAP, f))
        assert 0 < solution.contact[0] < solution.touching.size
        assert other.touching > 0
        norms = solution.norms()
        complementary = norms["energy"] ** 2 / 2 + GAP * norms["contact_force"]
        between.append(complementary + other.energy)
        assert between[-1] > 0
        assert abs(stress_norm(mesh, stress(other.v, 1.0, nu), 1.0, nu) - norms["energy"]) < np.sqrt(2 * between[-1])
        assert certify(solution).gap < between[-1]  # on the split mesh there are more displacements
        assert between[-1] < 0.02 * complementary if n > 2 else True
    assert between[1] < 0.5 * between[0]


def test_energies_of_two_bodies():
    """The same for two bodies of different stiffness that are pressed together and tilted, so that one edge opens."""
    between, f, push, lift = [], [0.01, 0.0], [0.0, -0.1], [0.0, 0.15]
    held = [Dirichlet("left", 0, components="x"), Dirichlet("bottom", 0)]
    loads = [Neumann("top", [str(x) for x in push]), Neumann("right", [str(x) for x in lift])]
    problem = Elasticity(
        {"upper": 1.0, "lower": 3.0}, 0.3, f=["0.01", "0"], conditions=[Contact("fault", gap=GAP), *held, *loads]
    )
    for n in (4, 8):
        domain = two_boxes(MPI.COMM_SELF, n, 2)
        young = fem.Function(fem.functionspace(domain.mesh, ("DG", 0)))
        middles = compute_midpoints(domain.mesh, 2, np.arange(len(young.x.array), dtype=np.int32))
        young.x.array[:] = np.where(middles[:, 1] > 0, 1.0, 3.0)
        solution = solve(domain, problem)
        of_p2 = Box(
            domain.mesh, young, 0.3, {(1, 0.5): push, (0, 1.0): lift}, {(1, -0.5): [0, 1], (0, 0.0): [0]}, GAP, f
        )
        norms, certificate = solution.norms(), solution.certify()
        assert certificate.guaranteed
        complementary = norms["energy"] ** 2 / 2 + GAP * norms["contact_force"]
        between.append(complementary + solve_p2(of_p2, between=True).energy)
        assert 0 < certificate.gap < between[-1]
    assert between[-1] < 0.1 * complementary
    assert solution.contact.facets > 0
    assert solution.touching.sum() < solution.touching.size
    assert between[-1] < 0.5 * between[-2]


@pytest.mark.parametrize("law", [LAWS[0], pytest.param(LAWS[3], marks=pytest.mark.slow)], ids=str)
def test_oblique_friction_in_space(law: Tresca | Coulomb):
    """Forces on the plane, and the energy of Tresca's problem, agree with those of P2 better and better."""
    between, off = [], []
    for n in (2, 3):
        solution, other = oblique(n, law)
        force = solution.resultants()["bottom"][:3]
        off.append(np.linalg.norm(other.forces.sum(axis=0) - force) / np.linalg.norm(force))
        norms = solution.norms()
        complementary = norms["energy"] ** 2 / 2 + OBLIQUE_GAP * norms["contact_force"]
        between.append(complementary + other.energy)
        size = stress_norm(solution.spaces.mesh, stress(other.v, 1.0, 0.3), 1.0, 0.3)
        assert abs(size - norms["energy"]) < np.sqrt(2 * between[-1])
    assert off[1] < 0.6 * off[0] < 0.04
    slips = solution.friction_states()["slip"]["vertices"]
    assert slips > (25 if law == Coulomb(1.0) else 60)
    assert 0 < between[1] < 0.6 * between[0]
    if isinstance(law, Tresca):  # Coulomb's k is each program's own
        assert certify(solution).gap < between[1]


def test_a_body_that_nothing_holds_is_refused_by_the_second_program():
    mesh = box(MPI.COMM_SELF, 2, [0.0, 0.0], [2.0, 1.0]).mesh
    with pytest.raises(RuntimeError, match="the matrix is singular: a body moves freely"):
        solve_p2(Box(mesh, 1.0, 0.3, {(1, 1.0): [0.0, -0.1]}, {(0, 0.0): [0]}, GAP))
