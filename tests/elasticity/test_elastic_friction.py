"""Friction of elastic bodies: exact solutions, Coulomb's fixed point, bounds, files."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ufl
from commands import read_rows, signorini
from dolfinx.mesh import DiagonalType
from elastic import box, stress
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx import Tresca
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.contact.laws import Dirichlet, Friction, Neumann
from signorini_fenicsx.forms.elasticity import strain
from signorini_fenicsx.linear import gmres, kept_factors
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.elasticity.conditions import Contact, Coulomb, CoulombLaw
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, Elasticity, ElasticProblem
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve import coulomb
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
BOTTOM = ElasticBoundary(["y0"], neumann=["x0", "x1"])


def sliding(comm: MPI.Comm, n: int, law: Friction | CoulombLaw, algorithm: str = "alg1") -> ElasticSolution:
    """A block that is pressed onto a rough plane, lifted at one end, and pushed."""
    u_D = ["0.01", "-0.05 + 0.05*x"]
    problem = ElasticProblem(1.0, 0.3, u_D=u_D, gap="0.01*x", laws=[law])
    return solve(box(comm, n, [0.0, 0.0], [2.0, 1.0]), replace(problem, boundary=BOTTOM), Options(algorithm=algorithm))


def test_exact_slip_and_stick():
    """A body that slips to the left, sticks in the middle and slips to the right: the states within two cells.

    u_x = (x − 0.8)₊³ − (0.2 − x)₊³ + g y W(x)/μ with W from −1 to 1 where the body sticks; u_y = −y.
    """
    g, nu, errors = 0.1, 0.3, []
    for n in (8, 16):
        domain = box(COMM, n, [0.0, 0.0], [1.0, 1.0])
        x, y = ufl.SpatialCoordinate(domain.mesh)
        t = ufl.max_value(0, ufl.min_value(1, (x - 0.2) / 0.6))
        step = -1 + 2 * (6 * t**5 - 15 * t**4 + 10 * t**3)
        right, left = ufl.max_value(x - 0.8, 0), ufl.max_value(0.2 - x, 0)
        u = ufl.as_vector([right**3 - left**3 + g * y * step * 2 * (1 + nu), -y])
        f = -ufl.div(stress(strain(u), 1 / (1 + nu), nu))
        problem = Elasticity(1.0, nu, f=f, u_D=u, exact=u, conditions=[Contact("y0", friction=Tresca(g=g))])
        solution = solve(domain, problem)
        assert solution.contact[1] == pytest.approx(1.0)
        states = solution.friction_states()
        assert states["stick"]["measure"] == pytest.approx(0.6, abs=2.01 / n)
        assert abs(states["slip+"]["measure"] - states["slip-"]["measure"]) < 2.01 / n
        errors.append(solution.errors())
    assert errors[1]["energy"] < 1.3e-2
    assert np.log2(errors[0]["energy"] / errors[1]["energy"]) > 1.5


def test_bound_that_jumps_between_facets():
    """Each facet has the bound of its own side."""
    solution = sliding(COMM, 2, Friction(["y0"], g="0.008 if x < 1 else 0.002 if x < 1.5 else 0.01"))
    x, bound = solution.spaces.rough.vertices[:, :, 0].mean(axis=1), solution.data.friction.bound
    expected = np.where(x < 1, 0.008, np.where(x < 1.5, 0.002, 0.01))
    np.testing.assert_allclose(bound, np.column_stack([expected, expected]), rtol=1e-14)


@pytest.mark.parametrize("slips", [True, False])
def test_coulomb_in_a_uniform_state(slips: bool):
    """Under a uniform pressure σ_t is −μ times it, less adhesion, where all slips, and less if all sticks; exact."""
    nu, mu, pressure = 0.3, 0.3, 0.2
    shear = mu * pressure * (1.0 if slips else 0.5)
    sides = 0.0 if slips else -nu / (1 - nu) * pressure
    wider = (1 - nu**2) * sides + nu * (1 + nu) * pressure
    flatter = -(1 - nu**2) * pressure - nu * (1 + nu) * sides
    u = [f"{0.1 if slips else 0.0} + {wider}*x + {2 * (1 + nu) * shear}*y", f"{flatter}*y"]
    g_N = {"x0": [str(-sides), str(-shear)], "x1": [str(sides), str(shear)]}
    problem = Elasticity(
        1.0,
        nu,
        u_D=u,
        exact=u,
        conditions=[
            Contact("y0", friction=Coulomb(mu / 2, mu / 2 * pressure)),
            *(Neumann(*each) for each in g_N.items()),
        ],
    )
    solution = solve(box(COMM, 2, [0.0, 0.0], [1.0, 1.0]), problem)
    errors = solution.errors()
    assert errors is not None
    assert max(errors["energy"], errors["u_L2"]) < 1e-10
    assert solution.friction_states()["slip-" if slips else "stick"]["measure"] == pytest.approx(1.0)
    np.testing.assert_allclose(solution.shear, -shear)


def test_coulomb_is_a_fixed_point():
    """The bound is μ times the pressure in the end; Newton's method finds it in few steps, the last ones quadratic."""
    solution = sliding(COMM, 4, CoulombLaw(["y0"], "0.2 + 0.1*x"))
    x = solution.spaces.rough.vertices[:, :, 0]
    np.testing.assert_allclose(solution.data.friction.bound, (0.2 + 0.1 * x) * solution.pressure, atol=1e-10)
    changes = np.array(solution.bound_changes)
    assert changes[-1] <= 1e-9
    assert len(changes) <= 5
    assert changes[-1] < 1e-3 * changes[-2]
    certificate = certify(solution)
    assert certificate.of == "the exact solution of Tresca's problem with the last bound of the friction"


@pytest.mark.parametrize(("mu", "push", "nu"), [(1.0, 0.3, 0.0), (20.0, 0.6, 0.45)])
def test_coulomb_with_a_large_number(mu: float, push: float, nu: float):
    """With any μ there is a solution with the whole law: g = μ × pressure, and the shear is −g where it slips."""
    problem = Elasticity(
        1.0, nu, u_D=[push, -0.05], conditions=[Contact("y0", friction=Coulomb(mu)), Neumann(["x0", "x1"], 0)]
    )
    solution = solve(box(COMM, 8, [0.0, 0.0], [2.0, 1.0]), problem)
    pressure, shear, slip = solution.pressure, solution.shear, solution.slip
    largest = COMM.allreduce(float(pressure.max(initial=0.0)), MPI.MAX)
    np.testing.assert_allclose(solution.data.friction.bound, mu * np.maximum(pressure, 0), atol=1e-8 * mu * largest)
    assert np.all(np.abs(shear) <= mu * np.maximum(pressure, 0) + 1e-8 * mu * largest)
    moves = np.abs(slip) > 1e-9
    np.testing.assert_allclose((shear + np.sign(slip) * mu * pressure)[moves], 0.0, atol=1e-8 * mu * largest)
    assert COMM.allreduce(int(moves.sum())) > 5


def test_slip_to_the_left_and_to_the_right():
    """Newton's steps are those of the mirror image, also where a vertex that was open is pressed and slips."""
    domain, changes = box(COMM, 8, [0.0, 0.0], [2.0, 1.0], diagonal=DiagonalType.crossed), []
    for push in (0.3, -0.3):
        rough = [Contact("y0", friction=Coulomb(2.0)), Neumann(["x0", "x1"], 0)]
        changes.append(solve(domain, Elasticity(1.0, 0.3, u_D=[push, -0.05], conditions=rough)).bound_changes)
    assert len(changes[0]) <= 5
    np.testing.assert_allclose(*changes, rtol=1e-6, atol=1e-9)


def test_the_path_and_newton_find_the_same(monkeypatch: pytest.MonkeyPatch):
    """For small μ, where there is one solution, the path leads to that of Newton's method."""
    problem = Elasticity(
        1.0,
        0.3,
        u_D=[0.3, -0.05],
        conditions=[Contact("y0", friction=Coulomb("0.2 + 0.1*x", "0.002*x")), Neumann(["x0", "x1"], 0)],
    )
    place = box(COMM, 4, [0.0, 0.0], [2.0, 1.0]), problem
    newton = solve(*place)
    monkeypatch.setattr(coulomb, "MOST", 2)
    path = solve(*place)
    assert len(path.bound_changes) == 3 < len(newton.bound_changes)
    assert path.friction_states() == newton.friction_states()
    np.testing.assert_allclose(path.stresses, newton.stresses, atol=1e-10)


def test_bounds_of_random_friction():
    """A bound is never below the error in energy; on the whole it is not far above it."""
    rng, ratios = np.random.default_rng(7), []
    for number in range(4):
        nu, gap, g = float(rng.choice([0.0, 0.3])), rng.uniform(0, 0.02), rng.uniform(0.002, 0.02, 2)
        laws = [Friction(["y0"], g=f"{g[0]} + {g[1]}*x")]
        f = [str(rng.uniform(-0.1, 0.1)), str(rng.uniform(-0.2, 0.0))]
        problem = ElasticProblem(1.0, nu, f=f, gap=gap, laws=laws)
        boundary = ElasticBoundary([], neumann=["x1"] if number % 2 else ["x0", "x1"])
        coarse, fine = (
            solve(box(COMM, n, [0.0, 0.0], [2.0, 1.0]), replace(problem, boundary=boundary)) for n in (3, 12)
        )
        certificate = certify(coarse)
        assert certificate.guaranteed
        one, other = (
            solution.norms()["energy"] ** 2 / 2 + gap * solution.norms()["contact_force"] for solution in (coarse, fine)
        )
        assert certificate.gap >= one - other - 1e-12
        ratios.append(np.sqrt(certificate.gap / (one - other)))
    assert np.median(ratios) < 1.7
    assert max(ratios) < 2.5


def test_algorithms_agree():
    """Algorithm 2 finds the states, norms and steps of the fixed point of Algorithm 1."""
    for law in (Friction(["y0"], g=0.005), CoulombLaw(["y0"], 0.3)):
        one, other = sliding(COMM, 4, law), sliding(COMM, 4, law, "alg2")
        for state, sites in other.friction_states().items():
            assert sites == pytest.approx(one.friction_states()[state])
        assert other.norms() == pytest.approx(one.norms(), rel=1e-8)
        assert other.bound_changes == pytest.approx(one.bound_changes, rel=1e-5, abs=1e-10)


def test_case_file(folder: Path):
    """The report names the states and the problem of the bound; wrong coefficients are refused."""
    text = """physics = "elasticity"
geometry = {shape = "square", mesh = "structured"}
boundary = {neumann = ["left", "right"]}
law = [{kind = "friction", parts = ["bottom"], mu = 0.3}]
problem = {young = 1, poisson = 0.3, u_D = [0.05, -0.05], gap = "0.1*x^2"}
solve = {h = "1/4"}
"""
    (folder / "slide.toml").write_text(text, encoding="utf-8")
    done = signorini(folder, "solve", "slide.toml", "--output", "out")
    assert done.returncode == 0, done.stderr
    for words in (
        "at last off the law by",
        "solutions are not excluded",
        "error to the exact solution of Tresca's problem",
    ):
        assert words in done.stdout
    summary = json.loads((folder / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["coulomb"]["changes"][-1] < 1e-9
    assert (summary["certificate"]["of_last_bound"], summary["certificate"]["guaranteed"]) == (True, False)
    states = summary["friction"]
    assert sum(each["vertices"] for name, each in states.items() if name != "open") == summary["touching_vertices"]
    assert states["open"]["vertices"] == 2 * summary["contact_facets"] - summary["touching_vertices"] > 0
    for row in read_rows(folder / "out" / "contact.csv"):
        bound = 0.3 * float(row["pressure"])
        assert row["friction"] != "slip-" or float(row["shear"]) == pytest.approx(-bound, rel=1e-7)
        assert row["friction"] != "stick" or abs(float(row["shear"])) < bound
    for change, message in (
        ("}", "the law 'friction' must have g, a bound of the shear, or mu"),
        (', mu = "x - 0.5"}', "law.0.mu: must be finite and not negative everywhere on its parts; its smallest"),
    ):
        (folder / "wrong.toml").write_text(text.replace(", mu = 0.3}", change), encoding="utf-8")
        done = signorini(folder, "check", "wrong.toml")
        assert (done.returncode, message in done.stderr) == (2, True), done.stderr


def test_a_body_that_friction_alone_holds():
    """A push below ∫ g is held; above it the body slides away, which is said; so it is with Coulomb's law."""
    domain = box(COMM, 4, [0.0, 0.0], [1.0, 1.0])
    boundary = ElasticBoundary(["y0"], neumann=["x0", "x1", "y1"])

    def solved(push: float, law: Friction | CoulombLaw) -> ElasticSolution:
        problem = ElasticProblem(1.0, 0.3, f=[str(push), "-0.1"], laws=[law])
        return solve(domain, replace(problem, boundary=boundary))

    for push, law in ((0.019, Friction(["y0"], g=0.02)), (0.034, CoulombLaw(["y0"], 0.3, 0.005))):
        solution = solved(push, law)
        assert solution.resultants()["y0"][:2] == pytest.approx([-push, 0.1])
    with pytest.raises(InputError, match=r"the body can move rigidly, along \(1, "):
        solved(0.021, Friction(["y0"], g=0.02))
    for push, adhesion in ((0.0301, 0.0), (0.0351, 0.005), (0.04, 0.005)):
        with pytest.raises(InputError, match=r"the body slides away, along \(1, .* no pressure with friction"):
            solved(push, CoulombLaw(["y0"], 0.3, adhesion))


@pytest.mark.parametrize("gap", [2.0, 1e9])
def test_nothing_rubs_where_nothing_touches(gap: float):
    """Above a foundation that it does not reach a body with Coulomb's friction is free, and so is it in its bound."""
    domain = build_domain(COMM, "square", 0.5, mesh="structured")
    given = [Dirichlet("left", 0, components="x"), Neumann("top", ["0", "-x"])]
    rough, smooth = (
        solve(
            domain, Elasticity(2.0, 0.3, f=["0", "-x"], conditions=[Contact("bottom", gap, friction=friction), *given])
        )
        for friction in (Coulomb(0.3), None)
    )
    assert rough.norms() == pytest.approx(smooth.norms(), rel=1e-9, abs=1e-9)
    assert np.all(rough.data.friction.bound == 0)
    bounds = [certify(solution) for solution in (rough, smooth)]
    assert bounds[0].bound == pytest.approx(bounds[1].bound, rel=1e-3)
    assert bounds[0].relative < 0.5


def test_bounds_of_friction_that_are_rounding():
    """The error bound takes a g of 1e-30 on half of Γ_C for 0."""
    tiny, none = (sliding(COMM, 4, Friction(["y0"], f"0.01*max(0, x - 1) + {least}")) for least in (1e-30, 0))
    assert certify(tiny).bound == pytest.approx(certify(none).bound, rel=1e-8)


@pytest.mark.parallel([1, 3])
def test_few_linear_iterations(monkeypatch: pytest.MonkeyPatch):
    """By CG, from a coarser mesh, all changes of Coulomb's bounds cost at most five solves; factors agree."""
    solves: list[tuple[int, int]] = []
    products: list[int] = []
    solve_by, gmres_by = FacetSolver.solve, gmres.gmres

    def counted(self: FacetSolver, b: PETSc.Vec, x: PETSc.Vec) -> None:
        solve_by(self, b, x)
        solves.append((b.getSize(), self.ksp.getIterationNumber()))

    def product_counted(comm, product, right, *others):
        def counting(values: np.ndarray) -> np.ndarray:
            products.append(len(solves))
            return product(values)

        return gmres_by(comm, counting, right, *others)

    monkeypatch.setattr(FacetSolver, "solve", counted)
    monkeypatch.setattr(kept_factors, "gmres", product_counted)
    problem = Elasticity(
        1.0,
        0.3,
        conditions=[
            Contact("y0", friction=Coulomb(0.4)),
            Dirichlet("y1", ["0.03 + 0.02*x", "-0.05 - 0.02*x"]),
            Neumann(["x0", "x1"]),
        ],
    )

    def on(cells: int) -> Domain:
        return box(COMM, cells, [0.0, 0.0], [2.0, 1.0])

    by_factors = solve(on(8), problem)
    solves.clear()
    products.clear()
    tuning = Tuning(direct_up_to=1000, predict_from=1000)
    by_cg = solve(on(8), problem, Options(tuning=tuning), remesh=lambda factor: on(round(8 / factor)))
    assert by_cg.outcome.linear_solver.startswith("cg")
    np.testing.assert_allclose(by_cg.norms()["energy"], by_factors.norms()["energy"], rtol=1e-9)
    np.testing.assert_array_equal(by_cg.touching, by_factors.touching)
    largest = max(size for size, _ in solves)
    longest = max(iterations for size, iterations in solves if size == largest)
    after = [iterations for _, iterations in solves[products[0] :]]
    assert sum(after) + len(products) <= 5 * longest
