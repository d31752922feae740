"""Data from texts, numbers, UFL and functions: the same values in points, and no new text compiles anything."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from made_cases import make_case
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Neumann, Signorini, certify, solve, solve_case
from signorini_fenicsx.base.fenicsx import LOADED
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.discrete import points
from signorini_fenicsx.discrete.datum import Datum, conductivity_of, datum_of, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.discrete.points import Points, cell_quadrature, facet_quadrature
from signorini_fenicsx.expressions.reader import read
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.discrete.data import project_data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces, build_spaces
from signorini_fenicsx.physics.diffusion.problem import Problem

COMM = MPI.COMM_WORLD

FIRST = {
    "problem.f": "8*sin(5*x)",
    "problem.psi": "0.02*sin(9*x) - 0.1",
    "problem.q_S": "-0.3*cos(7*x)",
    "problem.g_N": "x - y",
    "problem.u_D": "x*y",
    "exact.u": "x*y",
    "boundary.neumann": ["right"],
}
SECOND = FIRST | {
    "problem.f": "(x - 0.3)^11*7",
    "problem.psi": "-0.1 - x^9",
    "problem.q_S": "-sin(200*x)^2",  # which no quadrature resolves
    "problem.g_N": "tanh(y)",
    "problem.u_D": "abs(x - 0.1) + x^14",
    "exact.u": "x*x*sin(y)",
}
THIRD = FIRST | {"problem.u_D": "2 + x", "problem.psi": "1 + x/10"}  # which have a constant in common
CONDUCTIVITIES: dict[str, list[Any]] = {
    "scalar": ["1 + x*y", "exp(9*x)", "2 - x"],
    "number": ["3", "5/2", "1"],
    "matrix": [[["2 + x", "1/2"], ["1/2", "1 + y"]], [["exp(x)", "0"], ["0", "2"]], [["1", "0"], ["0", "1"]]],
}


def spaces_of(folder: Path, shape: str = "square") -> Spaces:
    domain = mesh_case(make_case(folder, shape=shape, parts=["bottom"], f="0", h=0.5), COMM)
    half = np.arange(0, domain.mesh.topology.index_map(domain.mesh.topology.dim).size_local, 2, dtype=np.int32)
    rest = np.setdiff1d(owned_cells(domain.mesh), half).astype(np.int32)
    domain.regions.update(even=half, odd=rest)
    return build_spaces(domain, ["bottom"], ["right"])


def everywhere(spaces: Spaces) -> list[Points]:
    """Points in all cells, and on Γ_S."""
    blocks = list(cell_quadrature(spaces.mesh, owned_cells(spaces.mesh), 3))
    return [*blocks, facet_quadrature(spaces.mesh, spaces.facets, 3)]


@pytest.mark.parallel([1, 3])
def test_texts_are_what_ufl_makes_of_them(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """Values and gradients, in cells in some blocks and on facets; ranks may have different numbers of them."""
    monkeypatch.setattr(points, "AT_ONCE", 50)
    texts = ["0*x + 1", "abs(x - 0.31)*max(x, y - 0.03, 0.2)", "sin(3*x)*exp(y) if x > 0.4 else x^5/(1 + y)"]
    for shape, some_texts in (("square", texts), ("cube", texts[-1:])):
        spaces = spaces_of(folder, shape)
        for text in some_texts:
            one = datum_of(spaces, "f", read(text, "xyz"[: spaces.mesh.geometry.dim])).less(0.5)
            two = Datum(one.ufl)
            assert one.number == two.number
            for some in everywhere(spaces):
                np.testing.assert_allclose(one.jet(some, gradient=True), two.jet(some, gradient=True), atol=1e-13)
        rows = Problem(f=0, kappa=[["2", "x"], ["x", "3 + y"]]).parsed(2).kappa
        if shape == "square":
            matrix, table = (conductivity_of(spaces, given) for given in (rows, {"even": rows, "odd": 4.0}))
            for some in everywhere(spaces)[:-1]:
                for datum in (matrix, table):
                    np.testing.assert_allclose(datum.values(some), some.of_ufl(datum.ufl), atol=1e-13)


@pytest.mark.parallel(2)
def test_means_do_not_depend_on_what_data_are_given_as(folder: Path):
    """A quadratic function as text, UFL and function of points has the same means, and those of a fine quadrature."""
    spaces = spaces_of(folder)
    x = ufl.SpatialCoordinate(spaces.mesh)
    ways = ["x*x - y", x[0] ** 2 - x[1], lambda x: x[0] ** 2 - x[1]]
    text, symbolic, function = (project_data(spaces, Problem(f=way, u_D=way, psi=way, q_S=way)) for way in ways)
    for name in ("psi_h", "q_Sh", "total_load"):
        for other in (symbolic, function):
            np.testing.assert_allclose(getattr(other, name), getattr(text, name), atol=1e-14)
    for name in ("f_h", "u_lift", "sigma_lift"):
        for other in (symbolic, function):
            np.testing.assert_allclose(getattr(other, name).x.array, getattr(text, name).x.array, atol=1e-14)
    assert quadrature_degree(text.f) == 8
    assert quadrature_degree(datum_of(spaces, "f", read("x^11", "xy"))) == 11
    assert quadrature_degree(datum_of(spaces, "f", read("x^11", "xy")), power=2) == 22


def of_f(spaces: Spaces, f: ufl.core.expr.Expr) -> ufl.Form:
    """∫ fv."""
    return f * ufl.TestFunction(spaces.Q) * ufl.dx


def test_vectors_of_one_form_are_apart(folder: Path):
    """What a form that is kept gave is not overwritten when it is assembled again."""
    spaces = solve_case(make_case(folder, parts=["bottom"], f="0", h=0.4)).spaces
    one, other = (fem.Function(spaces.Q) for _ in range(2))
    one.x.array[:], other.x.array[:] = 1.0, 2.0
    first = assembled(spaces.kept(of_f, one))
    before = first.copy()
    second = assembled(spaces.kept(of_f, other))
    np.testing.assert_array_equal(first, before)
    np.testing.assert_allclose(second, 2 * before)


def test_the_normal_in_ufl():
    """g_N = κ∇u·n in UFL is what it is on the right side, where n is (1, 0), for the certificate too."""
    domain = build_domain(COMM, "square", 0.4, mesh="unstructured")
    x, n = ufl.SpatialCoordinate(domain.mesh), ufl.FacetNormal(domain.mesh)
    u = ufl.sin(x[0]) * x[1]
    bounds = []
    for g_N in (ufl.dot(ufl.grad(u), n), ufl.grad(u)[0], "cos(x)*y"):
        conditions = [Signorini("bottom", psi=-1), Neumann("right", g_N)]
        bounds.append(certify(solve(domain, Diffusion(f="sin(x)*y", u_D="sin(x)*y", conditions=conditions))).bound)
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-12)
    assert math.isclose(bounds[0], bounds[2], rel_tol=1e-6)


@pytest.mark.parametrize(("kind", "algorithm"), [("scalar", "alg1"), ("number", "alg3"), ("matrix", "primal-pdas")])
def test_new_texts_compile_nothing(folder: Path, kind: str, algorithm: str):
    """Solve, certify, compare with the exact u: no form is looked for that the first run has not."""
    case = make_case(folder, parts=["bottom"], f="0", h=0.4).with_values({"solve.algorithm": algorithm})
    kept = []
    for values, kappa, h in zip((FIRST, SECOND, THIRD), CONDUCTIVITIES[kind], (0.4, 0.3, 0.2), strict=True):
        solution = solve_case(case.with_values(values | {"problem.kappa": kappa, "solve.h": h, "solve.eps": h}))
        assert solution.summary()["errors"]
        certify(solution)
        kept.append(set(LOADED))
    assert kept[0] == kept[1] == kept[2]


def _mass(spaces: Spaces, factor: fem.Function) -> ufl.Form:
    return factor * ufl.dx(spaces.mesh)


def _twice(spaces: Spaces, factor: fem.Function) -> ufl.Form:
    return 2 * factor * ufl.dx(spaces.mesh)


def test_kept_forms_have_their_coefficients(folder: Path):
    """A form that is asked for before another, and assembled after it."""
    spaces = spaces_of(folder)
    one, two = (fem.Function(spaces.Q) for _ in range(2))
    one.x.array[:], two.x.array[:] = 1.0, 2.0
    first, second = spaces.kept(_mass, one), spaces.kept(_twice, two)
    assert [spaces.integrate(first), spaces.integrate(second)] == pytest.approx([1.0, 4.0])
