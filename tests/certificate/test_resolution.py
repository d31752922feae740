"""Data that quadrature may miss: unresolved data are reported, and the bound includes them."""

import warnings

import numpy as np
import pytest
import ufl
from makers.bounds import difference
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Friction, Signorini
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import adapt_case, solve_case
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.cli.solution_report import bound
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
DISC = "1e4 if (x-0.515)^2+(y-0.54)^2 < 2.5e-5 else 0"


def problem(h: float, **data: object) -> Case:
    values = {f"problem.{name}": value for name, value in ({"f": "40*(x - 0.6)"} | data).items()}
    shape = {"geometry.shape": "square", "geometry.mesh": "structured", "boundary.signorini": ["bottom"], "solve.h": h}
    return load_case("example1").with_values(shape | values)


def certified(h: float, **data: object) -> tuple[Solution, Certificate]:
    solution = solve_case(problem(h, **data), COMM)
    return solution, certify(solution)


@pytest.mark.parametrize(
    ("h", "data", "name"),
    [
        (0.2, {"f": DISC}, "f"),
        (0.2, {"f": "1e5*exp(-2e5*((x-.515)^2+(y-.54)^2))"}, "f"),
        (0.3, {"f": "3000*sin(40*pi*x)*sin(40*pi*y)"}, "f"),
        (0.2, {"kappa": "1 - .99*exp(-((x-.515)/.01)^2)"}, "kappa"),
        (0.2, {"u_D": "0.1 + 5*exp(-1e5*((x-1)^2+(y-.54)^2))"}, "u_D"),
        (0.36, {"u_D": "max(0, 1 - ((x - 0.4)/0.05)^2)*y", "c": "1e6", "f": "1"}, "u_D"),  # missed in the load of cu
        (0.2, {"q_S": "1000 if (x-.515)^2 < 1e-5 else 0"}, "q_S"),
        (0.2, {"psi": "1/(x - 0.3)"}, "psi"),
    ],
)
def test_what_is_not_resolved_is_never_guaranteed(h: float, data: dict[str, object], name: str):
    _, certificate = certified(h, **data)
    assert not certificate.guaranteed
    assert name in certificate.unresolved[0][0]
    assert certificate.summary()["unresolved"][0]["data"] == certificate.unresolved[0][0]
    assert f"not guaranteed: {certificate.unresolved[0][0]} is not resolved near (" in bound(certificate)


@pytest.mark.parametrize(("q_S", "resolved"), [("cos(5*x)", True), ("1000 if (x-.515)^2 < 1e-5 else 0", False)])
def test_data_are_enclosed_beside_other_laws(q_S: str, resolved: bool):
    """Those of the law of Signorini, where the data of the others are polynomials."""
    conditions = [Signorini("bottom", psi="0.1*sin(9*x) - 0.2", q_S=q_S), Friction("left", "0.1*y")]
    solutions = [
        solve(build_domain(COMM, "square", h, mesh="structured"), Diffusion(f="40*(x - 0.6)", conditions=conditions))
        for h in (0.2, 0.05)
    ]
    certificate = certify(solutions[0])
    assert certificate.guaranteed == resolved
    assert not certificate.by_quadrature
    assert {name for name, _ in certificate.unresolved} == (set() if resolved else {"q_S"})
    if resolved:
        assert difference(*solutions) < certificate.bound < 2 * difference(*solutions)


@pytest.mark.parametrize(
    ("name", "value", "place"),
    [
        ("f", "1/((x - 0.3)^2 + (y - 0.41)^2)", [0.3, 0.41]),
        ("g_N", "1/(y - 0.3)", [1, 0.3]),
    ],
)
def test_where_data_are_not_bounded_is_said(name: str, value: str, place: list[float]):
    case = problem(0.2, **{name: value}).with_values({"boundary.neumann": ["right"]})
    with np.errstate(all="ignore"):
        solution = solve_case(case, COMM)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        certificate = certify(solution)
    assert certificate.bound == np.inf
    assert not certificate.guaranteed
    assert {data for data, _ in certificate.unresolved} == {name}
    assert min(np.linalg.norm(np.array(x) - place) for _, x in certificate.unresolved) < 0.1
    assert bound(certificate).startswith("no error bound: ")
    assert f"{name} is not resolved near (" in bound(certificate)


@pytest.mark.parametrize(
    "data",
    [
        {},
        {"f": "40*(x - 0.6) + sin(5*x)*exp(y)", "kappa": "1 + 0.5*sin(3*x)*y", "u_D": "exp(x)*y"},
        {"f": "50 if x < 0.5 else 0"},
        {"kappa": "1e-3 if x < 0.5 else 1"},
        {"u_D": "abs(y - 0.5123)"},
    ],
)
def test_what_is_resolved_is_guaranteed_and_sharp(data: dict[str, object]):
    coarse, certificate = certified(2**0.5 / 16, **data)
    assert certificate.guaranteed
    assert "not guaranteed" not in bound(certificate)
    if not data.get("kappa"):
        fine = solve_case(problem(2**0.5 / 64, **data), COMM)
        assert difference(coarse, fine) < certificate.sigma_bound < 1.6 * difference(coarse, fine)


def test_data_from_python_are_by_quadrature():
    domain = solve_case(problem(0.2), COMM).spaces.domain
    x = ufl.SpatialCoordinate(domain.mesh)
    given = Diffusion(f=ufl.sin(x[0]), kappa=1 + x[1] ** 2, conditions=[Signorini("bottom")])
    certificate = certify(solve(domain, given))
    assert certificate.by_quadrature == ("f", "kappa")
    assert not certificate.guaranteed
    assert bound(certificate).endswith("not guaranteed: f, kappa by quadrature")


def test_without_dirichlet_the_means_of_loads_are_by_quadrature():
    sides = {"boundary.neumann": ["left", "right", "top"]}
    for f, by_quadrature in (("-1 + x/2", ()), ("-1 + x*sin(9*x)/2", ("f",))):
        certificate = certify(solve_case(problem(0.2, f=f).with_values(sides), COMM))
        assert certificate.by_quadrature == by_quadrature
        assert np.isfinite(certificate.bound)


def test_unresolved_places_are_refined_first():
    solution, certificate = adapt_case(problem(0.3, f=DISC), COMM, max_cells=200)
    diameters = solution.spaces.mesh.h(2, np.arange(len(certificate.coarse), dtype=np.int32))
    middles = solution.spaces.mesh.geometry.x[solution.spaces.mesh.geometry.dofmaps[0]].mean(axis=1)
    near = np.linalg.norm(middles[:, :2] - [0.515, 0.54], axis=1) < 0.05
    assert diameters[near].max() < 0.2 * diameters.max()
