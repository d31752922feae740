"""Data from Python that are no real numbers are refused in one sentence, on all ranks together."""

import dolfinx.mesh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_square
from mpi4py import MPI

from signorini_fenicsx import Contact, Diffusion, Domain, Elasticity, InputError, Signorini, Solver, domain_of, solve

COMM = MPI.COMM_WORLD


def unit_square() -> tuple[dolfinx.mesh.Mesh, Domain]:
    mesh = create_unit_square(COMM, 4, 4)
    return mesh, domain_of(mesh, {"bottom": lambda x: np.isclose(x[1], 0)})


def only_on_the_last_rank(x):
    if COMM.rank == COMM.size - 1:
        raise RuntimeError("no values here")
    return x[0]


@pytest.mark.parallel([1, 2])
def test_functions_and_ufl():
    """Also where only the points of one rank show that a function is not real, or fails."""
    mesh, domain = unit_square()
    x, space = ufl.SpatialCoordinate(mesh), fem.functionspace(mesh, ("P", 1))
    of_points = r"f: the function of points of shape \(3, \d+\) "
    for given, message in [
        (lambda x: 1j * x[0], of_points + "must give real numbers, not complex128"),
        (lambda x: np.emath.sqrt(x[0] - 0.5), of_points + "must give real numbers, not complex128"),
        (lambda x: np.full(x.shape[1], "1"), of_points + "must give real numbers, not <U1"),
        (lambda x: np.full(x.shape[1], None), of_points + "must give real numbers, not object"),
        (lambda x: [x[0], [1.0, 2.0]], of_points + "fails: ValueError"),
        (lambda x, y: x, of_points + "fails: TypeError: .* missing 1 required positional argument: 'y'"),
        (only_on_the_last_rank, of_points + "fails: RuntimeError: no values here"),
        (ufl.as_ufl(1j) * x[0], "f: is UFL with a complex number; data are real"),
        (ufl.lt(x[0], 0.5), r"f: is a condition in UFL; data are numbers, such as ufl.conditional"),
        (fem.Function(space, dtype=np.complex128), "f: is UFL with a Function or Constant of type complex128"),
        (x[0] * fem.Constant(mesh, np.float32(1)), "f: is UFL with a Function or Constant of type float32"),
        (10**400, r"^\[problem\] f: is an integer too large"),
        (
            "2*(x + 1",
            r"^\[problem\] f: expression '2\*\(x \+ 1' is not arithmetic in pi, x, y: the '\(' at character 3",
        ),
    ]:
        with pytest.raises(InputError, match=message):
            solve(domain, Diffusion(f=given, conditions=[Signorini("bottom")]))
    for given, message in [
        (lambda x: x[:2] * 1j, of_points + "must give real numbers, not complex128"),
        (lambda x: x, of_points + "fails: ValueError: it must give 2 rows, not an array of shape"),
        (lambda x: 1.0, of_points + "fails: ValueError: it must give 2 rows"),
        (["x", "1)"], r"^\[problem\] f: expression '1\)' is not .* the '\)' at character 2 closes nothing"),
    ]:
        with pytest.raises(InputError, match=message):
            solve(domain, Elasticity(1.0, 0.3, f=given, conditions=[Contact("bottom")]))


def test_functions_are_asked_in_the_mesh_alone():
    """A function may be known there only, for example as a table."""

    def table(x):
        if np.any((x[:2] < 1) | (x[:2] > 2)):
            raise ValueError("outside")
        return x[0] > 1.5

    mesh = dolfinx.mesh.create_rectangle(COMM, [[1.0, 1.0], [2.0, 2.0]], [2, 2])
    domain = domain_of(mesh, {"bottom": lambda x: np.isclose(x[1], 1)})
    assert solve(domain, Diffusion(f=table, conditions=[Signorini("bottom")])).converged


@pytest.mark.parallel(2)
def test_data_that_differ_between_ranks_do_not_part_them():
    """What is kept of earlier data is taken by all ranks or by none; else one would wait for the others for ever."""
    _, domain = unit_square()
    solver = Solver(domain, Diffusion(0, conditions=[Signorini("bottom")]))
    for psi, f in ((-0.1, 1.0), (-0.1, 1.0 + 1e-15 * COMM.rank), (-0.1 - 1e-15 * COMM.rank, 1.0)):
        assert solver.solve(Diffusion(f=f, kappa=2.0, conditions=[Signorini("bottom", psi)])).converged
