"""Bounds of how wrong functions of others are: true for known errors, sharp enough, and refused in a sentence."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest
import ufl
from commands import signorini
from dolfinx import fem
from made_cases import case_of
from mpi4py import MPI

from signorini_fenicsx import Contact, Diffusion, Dirichlet, Elasticity, Neumann, Signorini, certify, solve
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.certificate.certify import bound_field
from signorini_fenicsx.expressions import read, to_ufl
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain

COMM = MPI.COMM_WORLD
SQUARE = {"geometry.mesh": "structured", "solve.h": 1.001 * math.sqrt(2) / 8}


def lagrange(domain: Domain, degree: int = 1, shape: tuple[int, ...] = ()) -> fem.Function:
    """A function on a mesh."""
    return fem.Function(fem.functionspace(domain.mesh, ("Lagrange", degree, shape)))


def distance(v: fem.Function, exact: ufl.core.expr.Expr, kappa: float = 1.0) -> float:
    """|v − u| in the energy norm."""
    slope = ufl.grad(v - exact)
    form = fem.form(kappa * ufl.inner(slope, slope) * ufl.dx(degree=12))
    return math.sqrt(COMM.allreduce(fem.assemble_scalar(form)))


@pytest.mark.parametrize(("name", "degree"), [("transition", 1), ("transition", 2), ("dead_core", 1), ("two_sided", 1)])
def test_known_errors(name: str, degree: int):
    """Interpolants of known solutions, also with a mistake that lifts them off and presses them through the bound."""
    solution = solve_case(load_case(name).with_values(SQUARE))
    domain, text = solution.spaces.domain, case_of(solution).exact.u
    assert isinstance(text, str)
    x = ufl.SpatialCoordinate(domain.mesh)
    exact, best = to_ufl(read(text, "xy"), x), lagrange(domain, degree)
    best.interpolate(fem.Expression(exact, best.function_space.element.interpolation_points))
    for mistake in (0.0, 0.2, -0.2):
        v = best.copy()
        wrong = lagrange(domain, degree)
        wrong.interpolate(lambda x: np.sin(np.pi * x[0]) * np.cos(np.pi * x[1]))
        v.x.array[:] += mistake * wrong.x.array
        found, error = bound_field(solution, v), distance(v, exact)
        assert found.guaranteed, found.reason
        assert found.lower <= error <= found.bound <= found.by_flux
        assert found.bound < 2 * error + 1.1 * found.certificate.sigma_bound
        if mistake == 0:
            assert found.repaired is not None
            assert found.repaired < found.by_flux


def test_varying_kappa_without_repair():
    """κ = e^x and u = x²: a function far from u_D is enclosed, and its repair is as long as it is wrong there."""
    domain = build_domain(COMM, "square", 1 / 8, mesh="structured")
    sides = Neumann(["top", "bottom"])
    problem = Diffusion(f="-(2 + 2*x)*exp(x)", kappa="exp(x)", u_D="x^2", conditions=[sides, Signorini("right", psi=1)])
    x = ufl.SpatialCoordinate(domain.mesh)
    v = lagrange(domain)
    v.interpolate(lambda x: 0.5 * x[0])
    found = certify(domain, problem, v)
    slope = ufl.grad(v - x[0] ** 2)
    error = math.sqrt(COMM.allreduce(fem.assemble_scalar(fem.form(ufl.exp(x[0]) * slope**2 * ufl.dx(degree=10)))))
    assert found.guaranteed, found.reason
    assert found.lower <= error <= found.bound
    assert found.repair is not None
    assert found.repair > 0.1
    assert found.bound == found.by_flux < 1.5 * error


@pytest.mark.parametrize("degree", [1, 2])
def test_displacements(degree: int):
    """A block that is pressed onto a foundation has a known strain: the stress is exact, and bounds meet the error."""
    domain = build_domain(COMM, "square", 1 / 4, mesh="structured")
    top = Dirichlet("top", ["0.03/0.7*(x - 0.5)", "-0.1"])  # ν/(1 − ν) in plane strain
    conditions = [Contact("bottom", gap=0), top, Neumann(["left", "right"])]
    problem = Elasticity(young=1.0, poisson=0.3, conditions=conditions)
    v = lagrange(domain, degree, (2,))
    v.interpolate(lambda x: np.stack([0 * x[0], -0.1 * x[1] ** degree]))
    found = certify(domain, problem, v)
    mu, lam, x = 1 / 2.6, 0.3 / (1.3 * 0.4), ufl.SpatialCoordinate(domain.mesh)
    strain = ufl.sym(ufl.grad(v - ufl.as_vector([0.03 / 0.7 * (x[0] - 0.5), -0.1 * x[1]])))
    density = 2 * mu * ufl.inner(strain, strain) + lam * ufl.tr(strain) ** 2
    error = math.sqrt(COMM.allreduce(fem.assemble_scalar(fem.form(density * ufl.dx))))
    assert found.guaranteed
    assert found.lower <= error * (1 + 1e-6)
    assert error <= found.bound * (1 + 1e-6)
    assert found.bound < 1.001 * error


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda domain: 1.0, "v: must be a Function"),
        (lambda domain: lagrange(domain, 3), "degree 1 or 2"),
        (lambda domain: fem.Function(fem.functionspace(domain.mesh, ("CR", 1))), "continuous Lagrange"),
        (lambda domain: fem.Function(fem.functionspace(domain.mesh, ("DG", 1))), "continuous Lagrange"),
        (lambda domain: lagrange(domain, 1, (2,)), "must be a scalar"),
        (lambda domain: lagrange(build_domain(COMM, "square", 0.5, mesh="structured")), "on the mesh of the domain"),
    ],
)
def test_refused_functions(made: Callable[[Domain], object], words: str):
    """What is no continuous function on the mesh is refused in a sentence."""
    domain = build_domain(COMM, "square", 0.5, mesh="structured")
    solution = solve(domain, Diffusion(f=-10, conditions=[Signorini("bottom")]))
    with pytest.raises(InputError, match=words):
        certify(solution, v=made(domain))  # type: ignore[call-overload]


def write_field(folder: Path, name: str = "field.vtu", n: int = 8, width: float = 1.0) -> None:
    """A file with the interpolant of the solution of `transition` on a mesh of its own (rank 0)."""
    if COMM.rank == 0:
        x, y = (each.ravel() for each in np.meshgrid(*2 * [np.linspace(0, 1, n + 1)], indexing="ij"))
        corner = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
        a, b, c, d = (each.ravel() for each in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
        cells = np.concatenate([np.column_stack([a, b, d]), np.column_stack([b, c, d])])
        t = x - 0.413
        u = np.maximum(t, 0) ** 3 - y * np.maximum(-t, 0) ** 3
        points, bottom = np.column_stack([width * x, y, 0 * x]), np.column_stack([corner[:-1, 0], corner[1:, 0]])
        values = {"u": u, "nodes": np.column_stack([x, y, y])}
        part = {"part": [np.zeros(len(cells), dtype=int), np.ones(n, dtype=int)]}
        meshio.Mesh(points, [("triangle", cells), ("line", bottom)], values, part).write(folder / name)
    COMM.Barrier()


def certified(folder: Path, *options: str) -> dict[str, float]:
    """How wrong the field of a file is."""
    write_field(folder)
    ended = signorini(folder, "certify", "transition", "--field", "field.vtu", "--json", *options)
    assert ended.returncode == 0, ended.stderr
    found: dict[str, float] = json.loads(ended.stdout)["field"]
    return found


def test_finer_flux(folder: Path):
    """A flux on a finer mesh encloses the known error of the field of a file better."""
    coarse, fine = (certified(folder, "--h", "1/8", "--refine", level) for level in "01")
    assert coarse["guaranteed"]
    assert fine["guaranteed"]
    assert coarse["lower"] < fine["lower"] < 0.0613650 < fine["bound"] < coarse["bound"]


@pytest.mark.parallel(2)
def test_any_ranks(folder: Path):
    """Bounds and repair of a field of a file are the same on any number of ranks."""
    found = certified(folder)
    assert found["bound"] == pytest.approx(0.10392646312781431, rel=1e-9)
    assert found["repair"] == pytest.approx(0.014544975202312519, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--field", "none.vtu"], "no such file"),
        (["--field", "field.msh"], "no values are read from .msh files"),
        (["--field", "field.vtu", "--name", "w"], "has no values 'w' with a number at each point; it has 'u'"),
        (["--field", "half.vtu"], "not that of the shape 'square'"),
        (["--field", "field.vtu", "--refine", "9"], "must be between 0 and 5"),
    ],
)
def test_refused_files(folder: Path, arguments: list[str], words: str):
    """Files without such values, and meshes of another domain."""
    write_field(folder)
    write_field(folder, "half.vtu", width=0.5)
    ended = signorini(folder, "certify", "transition", *arguments)
    assert ended.returncode == 2
    assert words in " ".join(ended.stderr.split())
    assert not (folder / "results").exists()


def test_cases_on_files(folder: Path):
    """A case on a mesh file takes fields on that mesh, and refuses those on others, which it would only interpolate."""
    write_field(folder, "mesh.vtu")
    write_field(folder, "other.vtu", n=7)
    text = '[geometry]\nfile = "mesh.vtu"\n[boundary]\nsignorini = ["1"]\n[problem]\nf = "0"\n'
    (folder / "own.toml").write_text(text)
    for name, words in (("other.vtu", "is on another mesh"), ("mesh.vtu", "")):
        ended = signorini(folder, "certify", "own.toml", "--field", name)
        assert ended.returncode == (2 if words else 0), ended.stderr
        assert words in " ".join(ended.stderr.split())
