"""The rigorous bound: its enclosures, its truth for any flux and trace, and its refusals."""

import dataclasses
import json
import math
from fractions import Fraction
from pathlib import Path

import basix
import flint
import numpy as np
import pytest
from commands import signorini
from made_cases import on_square, rotated
from mpi4py import MPI
from springs import Springs

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.reference_cells import EDGES
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import rough_cells
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.certificate.proof import check_size, proof_of
from signorini_fenicsx.cli.solution_report import above
from signorini_fenicsx.expressions.evaluation import values_and_gradient
from signorini_fenicsx.expressions.intervals import enclosing
from signorini_fenicsx.expressions.reader import read
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.rigorous import simplices
from signorini_fenicsx.rigorous.balance import _tree, balanced
from signorini_fenicsx.rigorous.data import Given
from signorini_fenicsx.rigorous.discrete import Discrete, gathered
from signorini_fenicsx.rigorous.elementary import FromArb
from signorini_fenicsx.rigorous.theorem import _lifts, prove
from signorini_fenicsx.solving.physics import PHYSICS

COMM = MPI.COMM_WORLD
CELLS = {1: basix.CellType.interval, 2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}


def quadrature(dim: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric coordinates, shape (points, d + 1), and weights with sum 1."""
    points, weights = basix.make_quadrature(CELLS[dim], degree)
    return np.column_stack([1 - points.sum(axis=1), points]), weights / weights.sum()


def test_elementary_functions():
    """Floats below and above the numbers that Arb finds with 200 bits, almost as near as possible."""
    rng = np.random.default_rng(3)
    some = np.concatenate([rng.normal(size=200), 10.0 ** rng.uniform(-300, 300, 50), [0.0, 1.0, -1.0, 745.2, -745.2]])
    arb = FromArb()
    for name in ("exp", "log", "sin", "cos", "tan", "tanh", "erf", "atan2", "pow"):
        first = np.abs(some) if name in ("log", "pow") else some
        arguments = [first, rng.permutation(some)] if name in ("atan2", "pow") else [first]
        if name == "tan":
            arguments = [np.clip(first, -1e6, 1e6)]
        lo, hi = arb.bounds(name, *arguments)
        assert arb.bounds(name, *arguments)[0].tolist() == pytest.approx(lo.tolist(), nan_ok=True)  # remembered
        method = getattr(flint.arb, {"pow": "__pow__"}.get(name, name))
        for row in zip(*(a.tolist() for a in arguments), lo.tolist(), hi.tolist(), strict=True):
            with flint.ctx.workprec(2500):
                value = method(*map(flint.arb, row[:-2]))
            if not value.is_finite() or value.is_nan():
                continue
            below, upper = row[-2:]
            assert math.isnan(below) or flint.arb(below) <= value
            assert math.isnan(upper) or value <= flint.arb(upper)
            if 1e-280 < abs(float(value)) < 1e280:
                assert upper - below <= (1e-10 if name == "pow" else 1e-14) * abs(float(value))
    assert arb.bounds("sin", np.zeros(1)) == (0.0, 0.0)


def grid(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Facets of the cells of a structured square, and a mask of those on its boundary."""
    numbers = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (corner.ravel() for corner in (numbers[:-1, :-1], numbers[1:, :-1], numbers[1:, 1:], numbers[:-1, 1:]))
    cells = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    pairs = np.stack([np.sort(np.delete(cells, i, axis=1), axis=1) for i in range(3)], axis=1)
    _, facets, count = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    facets = facets.reshape(-1, 3)
    return facets, count[facets] == 1


def test_balance_is_exact():
    """The correction along the tree in rational numbers is inside the enclosures, and the sums are the loads."""
    facets, outer = grid(4)
    rng = np.random.default_rng(4)
    per_facet = rng.normal(size=facets.max() + 1)
    first = np.zeros(facets.shape, dtype=bool)
    first.ravel()[np.unique(facets, return_index=True)[1]] = True
    fluxes = np.where(first, 1, -1) * per_facet[facets]
    load = rng.normal(size=len(facets))
    outlets = np.zeros_like(outer)
    outlets[tuple(np.argwhere(outer)[[0, 7]].T)] = True
    found = balanced(facets, outlets, enclosing(fluxes), enclosing(load))

    order, parents, through = _tree(facets, outlets)
    exact = [[Fraction(x) for x in row] for row in fluxes.tolist()]
    carried = [-Fraction(x) - sum(row) for x, row in zip(load.tolist(), exact, strict=True)]
    for cell in order[:0:-1]:
        exact[cell][through[cell]] += carried[cell]
        if parents[cell] < len(facets):
            parent = parents[cell]
            entry = facets[parent].tolist().index(facets[cell, through[cell]])
            exact[parent][entry] -= carried[cell]
            carried[parent] += carried[cell]
    for cell, row in enumerate(exact):
        assert sum(row) == -Fraction(load[cell])
        for i, x in enumerate(row):
            assert found.lo[cell, i] <= x <= found.hi[cell, i]
            assert found.hi[cell, i] - found.lo[cell, i] < 1e-12
    with pytest.raises(InputError, match="no facet through which"):
        balanced(facets, np.zeros_like(outlets), enclosing(fluxes), enclosing(load))


@pytest.mark.parametrize("dim", [1, 2])
def test_lifted_quadratics_are_positive(dim: int):
    """The lift is sufficient for any Bernstein coefficients and fixed vertices with values ≥ 0."""
    rng = np.random.default_rng(5)
    columns = dim + 1 + len(EDGES[dim])
    spare = rng.normal(size=(300, columns))
    fixed = rng.random((300, dim + 1)) < 0.3
    fixed[:, 0] = False
    spare[:, : dim + 1] = np.where(fixed, np.abs(spare[:, : dim + 1]), spare[:, : dim + 1])
    for number, (i, j) in enumerate(EDGES[dim]):
        both = fixed[:, i] & fixed[:, j]
        spare[both, dim + 1 + number] = np.abs(spare[both, dim + 1 + number])
    vertices = np.arange(fixed.size).reshape(fixed.shape)
    lifts = _lifts(vertices, fixed, enclosing(spare), vertices)[vertices]
    assert (lifts[fixed] == 0).all()
    lam = rng.dirichlet(np.full(dim + 1, 0.5), 500)
    as_powers = np.column_stack([lam**2, *(2 * lam[:, i] * lam[:, j] for i, j in EDGES[dim])])
    assert (spare @ as_powers.T + lifts @ lam.T >= -1e-13).all()


def discrete_of(solution: Solution) -> tuple[Discrete, Given]:
    """The input of a proof on one process."""
    discrete = gathered(solution, certify(solution).v)
    assert discrete is not None
    return discrete, Given.of(solution.data.trees, FromArb())


def true_error(discrete: Discrete, u: str) -> float:
    """‖σ − σ_h‖ for κ = 1."""
    dim = discrete.dim
    lam, weights = quadrature(dim, 12)
    points = np.einsum("pk,nkd->npd", lam, discrete.vertices)
    _, gradient = values_and_gradient(read(u, "xyz"[:dim]), points)
    cells = simplices.simplices(discrete.vertices)
    y = simplices.flux_in_vertices(cells, enclosing(discrete.fluxes)).lo
    error = gradient - np.einsum("pk,nkd->npd", lam, y)
    return math.sqrt((error**2).sum(axis=2) @ weights @ cells.measure.lo)


def shaken(discrete: Discrete, size: float, seed: int) -> Discrete:
    """Other fluxes and another v, equal for cells that share a facet, a vertex or an edge."""
    rng = np.random.default_rng(seed)
    flux = rng.normal(size=discrete.facets.max() + 1)[discrete.facets] * np.sign(discrete.fluxes)
    at_corners = rng.normal(size=discrete.corners.max() + 1)[discrete.corners]
    ends = np.array(EDGES[discrete.dim]).T
    edges = np.sort(discrete.corners[:, ends], axis=1)
    names = np.unique(edges[:, 0] * (discrete.corners.max() + 1) + edges[:, 1], return_inverse=True)[1]
    at_edges = rng.normal(size=names.max() + 1)[names.reshape(len(edges), -1)]
    v = discrete.v + size * np.column_stack([at_corners, at_edges])
    h = float(np.abs(np.diff(discrete.vertices, axis=1)).max())
    return dataclasses.replace(discrete, fluxes=discrete.fluxes + size * h ** (discrete.dim - 1) * flux, v=v)


@pytest.mark.parametrize(
    ("name", "h"), [("transition", 1 / 4), pytest.param("biactive", 1 / 4, marks=pytest.mark.slow)]
)
def test_any_flux_and_trace(name: str, h: float):
    """The bound is above the exact error: sharp for the solution, and true for any other fields."""
    case = load_case(name).with_values({"solve.h": h})
    discrete, given = discrete_of(solve_case(case, MPI.COMM_SELF))
    assert case.exact.u is not None
    error, bound = true_error(discrete, case.exact.u), prove(discrete, given).sigma_bound
    assert error <= bound * (1 + 1e-9)
    assert bound <= 1.15 * error
    for seed, size in enumerate((1e-6, 1e-2, 1e3)):
        other = shaken(discrete, size, seed)
        assert true_error(other, case.exact.u) <= prove(other, given).sigma_bound * (1 + 1e-9)


@pytest.mark.parametrize(
    "case",
    [
        load_case("cube").with_values({"solve.h": "1/3"}),
        load_case("dam"),  # κ by region
        on_square(
            8,
            ["bottom", "left"],
            boundary__neumann=["top"],
            problem__kappa=rotated(3, 30),
            problem__q_S="1 - x",
            problem__g_N="x/3",
            problem__psi="-0.1*x",
        ),
        on_square(8, ["bottom", "top", "left", "right"], problem__f="1 - 8*x"),  # no Γ_D
        on_square(
            8,
            ["bottom"],
            problem__kappa="1e3 if y < 0.5 else 1",
            problem__f="30 if x < 0.5 else -30",
            problem__q_S="1 if x < 0.5 else 0",
        ),
    ],
    ids=["cube", "dam", "general", "no Γ_D", "jumps"],
)
def test_near_the_certificate(case):
    solution = solve_case(case, MPI.COMM_SELF)
    certificate = certify(solution)
    proof = proof_of(solution, certificate.v)
    assert proof.proven is not None, proof.reason
    proven = proof.proven
    assert certificate.sigma_bound * 0.98 <= proven.sigma_bound <= 1.05 * certificate.sigma_bound
    assert proven.sigma_bound <= proven.bound <= 1.15 * certificate.bound
    assert proof.summary()["proved"]["sigma_bound"] == proven.sigma_bound


def test_load_between_the_points():
    """A disc between all quadrature points: ‖σ‖ ≥ (f, φ)/‖∇φ‖ with φ = min(ln R/r, ln R/a)⁺, a and R radii."""
    case = on_square(5, ["bottom"], problem__f="1e4 if (x - 0.515)^2 + (y - 0.54)^2 < 2.5e-5 else 0")
    solution = solve_case(case, MPI.COMM_SELF)
    certificate = certify(solution)
    proof = proof_of(solution, certificate.v)
    assert proof.proven is not None
    far = math.log(0.46 / 0.005)
    assert solution.norms()["sigma_L2"] < 1e-12
    least = 1e4 * math.pi * 2.5e-5 * far / math.sqrt(2 * math.pi * far)
    assert least <= certificate.sigma_bound < math.inf
    assert least <= proof.proven.sigma_bound <= 20 * least


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (
            {"problem__kappa": "1e-5 + (x - 0.5)^2"},
            r"kappa varies too much .* near \(0\.[3-6]",
        ),
        ({"problem__u_D": "1 if y > 0.7 else 0"}, r"u_D has no certain bounds of it and its gradient near"),
        ({"problem__f": "1/sqrt((x - 0.3)^2 + (y - 0.4)^2)"}, r"f has no certain bounds near \(0\.[23]\d*, 0\.[34]"),
    ],
)
def test_refusals(values: dict[str, object], reason: str):
    """Refused in one sentence with the place."""
    solution = solve_case(on_square(4, ["bottom"], **values), MPI.COMM_SELF)
    proof = proof_of(solution, certify(solution).v)
    assert proof.proven is None
    assert proof.summary()["proved"] is None
    with pytest.raises(InputError, match=reason):
        raise InputError(proof.reason)


def test_seam():
    """If u_D < ψ where Γ_D meets Γ_S, there is no admissible function."""
    solution = solve_case(on_square(4, ["bottom"], problem__u_D="1", problem__psi="0.5"), MPI.COMM_SELF)
    discrete, given = discrete_of(solution)
    assert math.isfinite(prove(discrete, given).bound)
    with pytest.raises(InputError, match=r"u_D ≥ psi is not certain near \(0\.[18]\d*, 0\)"):
        prove(discrete, dataclasses.replace(given, psi=read("1.5", "xy")))


@pytest.mark.parametrize("above", ["0", "0.2*sin(x*(1 - x))^2"])
def test_seam_where_u_D_is_psi(above: str):
    """Equal data meet without rounding: summands that both have are left out."""
    psi = "0.05*sin(3*x)*cos(2*y) - 0.1"
    solution = solve_case(on_square(4, ["bottom"], problem__u_D=f"{psi} + {above}", problem__psi=psi), MPI.COMM_SELF)
    assert math.isfinite(prove(*discrete_of(solution)).bound)


def test_data_from_python_and_large_meshes(monkeypatch: pytest.MonkeyPatch):
    solution = solve_case(on_square(4, ["bottom"]), MPI.COMM_SELF)
    with pytest.raises(InputError, match="f must be an expression"):
        Given.of({name: tree for name, tree in solution.data.trees.items() if name != "f"}, FromArb())
    check_size(rough_cells(load_case("example1")), "diffusion")
    with pytest.raises(InputError, match="has room for 500000 cells"):
        check_size(rough_cells(load_case("example1").with_values({"solve.h": "2^-10"})), "diffusion")
    with pytest.raises(InputError, match="has room for 50000 cells, not 6e"):
        check_size(60_000, "elasticity")
    monkeypatch.setitem(PHYSICS, "springs", Springs())
    with pytest.raises(InputError, match="there is no proof for springs"):
        check_size(10, "springs")


def test_command_line(tmp_path: Path):
    """Bounds in the output and the summary; without a proof status 3 with results, or 2 if that is known before."""
    done = signorini(tmp_path, "solve", "example1", "--h", "1/4", "--rigorous")
    assert done.returncode == 0, done.stderr
    certificate = json.loads((tmp_path / "results/example1/summary.json").read_text())["certificate"]
    assert set(certificate["proved"]) == {"bound", "sigma_bound", "gap", "oscillation", "remainder", "seconds"}
    assert f"proved     energy error ≤ {above(certificate['proved']['bound'], 5)}; of σ_h alone ≤ " in done.stdout
    jump = "problem.u_D=1 if y > 0.7 else 0"
    done = signorini(tmp_path, "solve", "example1", "--h", "1/4", "--set", jump, "--rigorous", "--output", "jump")
    assert done.returncode == 3
    assert "the bound is not proved: u_D has no certain bounds of it and its gradient near (" in done.stderr
    certificate = json.loads((tmp_path / "jump/summary.json").read_text())["certificate"]
    assert certificate["proved"] is None
    assert certificate["not_proved"].startswith("u_D has no certain bounds")
    done = signorini(tmp_path, "solve", "example1", "--h", "2^-10", "--rigorous", "--output", "large")
    assert done.returncode == 2
    assert "one process has room for 500000 cells" in done.stderr
    assert not (tmp_path / "large").exists()


def test_printed_digits_are_rounded_up():
    assert above(0.1, 3) == "1.01e-01"  # the float is above 0.1
    assert above(0.125, 3) == "1.25e-01"
    assert above(9.99999, 2) == "1.0e+01"
    assert above(0.0, 2) == "0.0e+00"
