"""RT1: order two with error bounds, the forms as an oracle, all laws on Γ_S, ranks, what is refused."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ufl
from commands import signorini
from dolfinx import fem
from made_cases import EXACT, on_grid
from makers.scalar import random_problem
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.inspection import expected
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.cli.solution_report import SolutionReport
from signorini_fenicsx.contact.laws import Dirichlet, Neumann, Signorini, TwoSided
from signorini_fenicsx.discrete.linear_traces import means_of_linear
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.forms.mixed import flux_equation, load, mass_balance, trace_term
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.memory import PROCESS_BYTES
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.output.writing import Found, write_solution
from signorini_fenicsx.physics.diffusion.problem import Diffusion
from signorini_fenicsx.physics.diffusion.rt1_solution import RT1Solution
from signorini_fenicsx.pictures.plane import Plane
from signorini_fenicsx.pictures.scene import gathered_scene
from signorini_fenicsx.quantities import Energy, Mean
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
RT1 = Options(element="RT1")
ALL_DATA = Diffusion(
    f="50*(0.5 - x)*(0.5 - y)",
    kappa="1 + x*y",
    c=1.0,
    u_D="x",
    conditions=[Signorini("bottom", psi="0.1*x", q_S="x/4"), Neumann("right", "y")],
)


def smooth(dim: int, c: str) -> Diffusion:
    """All data vary, κ within cells; in space κ is a matrix."""
    wave, z = ("sin(2*x + y)", "") if dim == 2 else ("sin(2*x + y) + z^2", "z")
    slope = "cos(2*x + y)"
    f = f"5*(1 + x)*sin(2*x + y) - 2*{slope} + ({c})*({wave})" + (" - 6*z^2 - 2" if z else "")
    kappa = "1 + x" if dim == 2 else [["1 + x", 0, 0], [0, "1 + x", 0], [0, 0, "1 + z^2"]]
    return Diffusion(f=f, kappa=kappa, c=c, u_D=wave, exact=wave, conditions=[Neumann("right", f"(1 + x)*2*{slope}")])


@pytest.mark.parametrize(
    ("dim", "c", "numbers", "bounds"), [(2, "1 + y", (8, 16), (3.9e-3, 9e-4)), (3, "0", (3, 6), (1.2e-2, 4e-3))]
)
def test_smooth_data(dim: int, c: str, numbers: tuple[int, int], bounds: tuple[float, float]):
    """Order two in σ and u, with bounds of the errors, and a potential of order four beside it."""
    errors = []
    for n in numbers:
        domain = build_domain(COMM, "square" if dim == 2 else "cube", 1.0001 * math.sqrt(dim) / n, mesh="structured")
        solution = solve(domain, smooth(dim, c), RT1)
        errors.append(solution.errors())
        assert max(vars(solution.kkt).values()) < 1e-11
    rates = {key: math.log2(errors[0][key] / errors[1][key]) for key in ("energy", "u_L2", "u_potential_L2")}
    assert min(rates["energy"], rates["u_L2"]) > 1.85, rates
    assert rates["u_potential_L2"] > 2.8, rates
    assert errors[1]["energy"] < bounds[0], errors
    assert errors[1]["u_L2"] < bounds[1], errors


@pytest.mark.parametrize("name", EXACT)
def test_all_laws(name: str):
    """Order two for every law on Γ_S, also on slopes, and pairs on the graph to rounding."""
    fine = 24 if name == "staircase" else 16
    before, after = (on_grid(name, n, solve__element="RT1") for n in (fine // 2, fine))
    rates = {key: math.log2(before.errors()[key] / after.errors()[key]) for key in ("u_L2", "p_L2", "sigma_L2")}
    assert min(rates["u_L2"], rates["p_L2"]) > 1.85, rates
    assert rates["sigma_L2"] > 1.65, rates
    assert after.errors()["sigma_L2"] < on_grid(name, fine).errors()["sigma_L2"] / 8
    assert max(vars(after.kkt).values()) < 1e-11


def transition(domain: Domain, options: Options = RT1, **how: object) -> RT1Solution:
    """A known solution with a transition at x = 0.413."""
    u = "max(x - 0.413, 0)^3 - y*max(0.413 - x, 0)^3"
    f = "-6*(max(x - 0.413, 0) - y*max(0.413 - x, 0))"
    return solve(domain, Diffusion(f=f, u_D=u, exact=u, conditions=[Signorini("bottom")]), options, **how)


def test_forms_of_the_mixed_method():
    """σ_h, u_h, p_h solve (9a) and (9b) in UFL on RT of DOLFINx's degree 2 and DG1, and (9c) at the facet vertices."""
    domain = build_domain(COMM, "square", 1 / 6, mesh="unstructured")
    solution = solve(domain, ALL_DATA, RT1)
    spaces, x = solution.spaces, ufl.SpatialCoordinate(domain.mesh)
    tau, v = ufl.TestFunction(spaces.flux_space), ufl.TestFunction(spaces.scalar_space)
    sigma, u, kappa, dx = solution.sigma, solution.u, 1 + x[0] * x[1], ufl.dx(degree=14)
    traces = trace_term(solution.p, tau, spaces.n, spaces.ds) + trace_term(x[0], tau, spaces.n, spaces.ds_dirichlet)
    equation = assembled(spaces.form(flux_equation(sigma, u, tau, dx, kappa) - traces))
    equation[fem.locate_dofs_topological(spaces.flux_space, 1, spaces.neumann_facets)] = 0.0
    assert np.abs(equation).max() < 1e-12
    f = 50 * (0.5 - x[0]) * (0.5 - x[1])
    balance = assembled(spaces.form(mass_balance(sigma, v, dx) - u * v * dx + load(f, v, dx)))
    assert np.abs(balance).max() < 1e-13
    gap = means_of_linear(solution.p_at) - 0.1 * means_of_linear(spaces.contact.vertices[:, :, 0])
    excess = solution.flux_at - spaces.contact.vertices[:, :, 0] / 4
    assert gap.min() > -1e-13
    assert excess.min() > -1e-12
    assert np.abs(gap * excess).max() < 1e-13
    assert 0 < (gap > 1e-6).sum() < gap.size
    flux = spaces.integrate(ufl.dot(sigma, spaces.n) * spaces.ds_neumann)
    assert flux == pytest.approx(0.5, abs=1e-12)


def same_by_both(solved: Callable[[str], RT1Solution]) -> None:
    """Both backends have the same steps and the same solution."""
    hybrid, mixed = solved("hybrid"), solved("mixed")
    assert mixed.outcome.backend == "mixed RT1"
    assert [step.changed for step in mixed.outcome.history] == [step.changed for step in hybrid.outcome.history]
    for name in ("sigma", "u", "p"):
        pair = getattr(mixed, name).x.array, getattr(hybrid, name).x.array
        np.testing.assert_allclose(*pair, atol=1e-10 * max(1.0, np.abs(pair[1]).max(initial=0.0)))


@pytest.mark.parallel(2)
@pytest.mark.parametrize("algorithm", ["alg1", "alg2", "alg3", "alg4"])
def test_mixed_backend(algorithm: str):
    """The forms in UFL, assembled as a saddle point, have the iterates of what is eliminated in NumPy."""
    domain = build_domain(COMM, "square", 1 / 6, mesh="unstructured")
    options = Options(algorithm, element="RT1", eps=0.02)
    same_by_both(lambda backend: solve(domain, ALL_DATA, replace(options, backend=backend)))


@pytest.mark.parametrize(
    ("name", "values"), [("regulator", {"solve.h": 1 / 6}), ("fault", {}), ("transition3d", {"solve.h": 0.5})]
)
def test_mixed_backend_of_cases(name: str, values: dict[str, float]):
    """Slopes that are coupled on facets, a part inside the domain, and space."""
    case = load_case(name).with_values(values | {"solve.element": "RT1"})
    same_by_both(lambda backend: solve_case(case.with_values({"solve.backend": backend})))


@pytest.mark.parallel(2)
def test_bounds_by_snesvi():
    """Without set rules SNESVI finds the same solution of both laws that it takes."""
    domain = build_domain(COMM, "square", 1 / 6, mesh="unstructured")
    laws = [TwoSided("bottom", psi="0.1*x", psi_upper="0.2*x + 0.01"), Signorini("top", psi=0.4)]
    for problem in (ALL_DATA, Diffusion(f="50*(0.5 - x)*(0.5 - y)", u_D="x", conditions=laws)):
        found, expected = (solve(domain, problem, Options(name, element="RT1")) for name in ("vi", "alg1"))
        np.testing.assert_allclose(found.p_at, expected.p_at, atol=1e-10)
        np.testing.assert_allclose(found.sigma.x.array, expected.sigma.x.array, atol=1e-9)
        assert max(vars(found.kkt).values()) < 1e-10
        assert 0 < COMM.allreduce(int(found.touching.sum())) < COMM.allreduce(found.touching.size)


def test_algorithms_and_starts():
    """All four algorithms, by factors and by multigrid, from near sets and from those of RT0, have one solution."""
    domain = build_domain(COMM, "square", 1 / 12, mesh="unstructured")
    expected = transition(domain)
    for algorithm in ("alg2", "alg3", "alg4"):
        found = transition(domain, Options(algorithm, element="RT1", eps=1e-12))
        np.testing.assert_allclose(found.p_at, expected.p_at, atol=1e-9)
    found = transition(domain, Options(element="RT1", tuning=Tuning(direct_up_to=0)))
    assert found.outcome.linear_solver == "cg+mg"
    assert max(step.linear_iterations for step in found.outcome.history) < 20
    np.testing.assert_allclose(found.p_at, expected.p_at, atol=1e-10)
    for start in (transition(build_domain(COMM, "square", 1 / 6, mesh="unstructured")), transition(domain, Options())):
        found = transition(domain, start=start)
        assert len(found.outcome.history) < len(expected.outcome.history)
        np.testing.assert_allclose(found.p_at, expected.p_at, atol=1e-12)


def test_far_values(tmp_path: Path):
    """A constant in u costs no digits of σ, and neither does a ψ far below u, also in a solution that is read again."""
    domain = build_domain(COMM, "square", 1 / 6, mesh="unstructured")

    def solved(constant: float, psi: float) -> RT1Solution:
        laws = [Signorini("bottom", psi=constant), Signorini("top", psi=psi + constant)]
        f = f"50*(0.5 - x)*(0.2 - y) + {constant}"
        return solve(domain, Diffusion(f=f, c=1.0, u_D=constant, conditions=laws), RT1)

    near = solved(0.0, -1.0)
    for constant, psi in ((1e5, -1.0), (0.0, -1e12)):
        far = solved(constant, psi)
        np.testing.assert_allclose(far.sigma.x.array, near.sigma.x.array, atol=1e-15 * constant + 1e-12)
        np.testing.assert_allclose(far.p_at - constant, near.p_at, atol=1e-15 * constant + 1e-12)
        write_solution(far, tmp_path / f"{constant:g}")
        read = load_solution(tmp_path / f"{constant:g}", COMM)
        assert max(vars(read.kkt).values()) < 1e-14 * constant + 1e-11
    np.save(tmp_path / "0" / "checkpoint" / "facet_condition_at.npy", 99 + 0 * near.touching)
    with pytest.raises(InputError, match="facet_condition_at has a value that is no condition"):
        load_solution(tmp_path / "0", COMM)


def test_rounding_in_the_facet_system():
    """κ that jumps, on bad cells: more corrections where those by a size beside the largest flux are too few."""
    domain, problem, _, _ = random_problem(104, several=True)
    solution = solve(domain, problem, RT1)
    assert "with more corrections, because the facet system left" in solution.outcome.reason
    assert max(vars(solution.kkt).values()) < 1e-11


def test_inside_the_domain():
    """Across a part inside the domain u jumps, by 3/2 of the order of RT0 at its end: exact solution of the crack."""
    errors = {
        element: solve_case(load_case("fault").with_values({"solve.element": element})).errors()
        for element in ("RT0", "RT1")
    }
    assert errors["RT1"]["energy"] < errors["RT0"]["energy"] / 10, errors
    assert errors["RT1"]["p_L2"] < errors["RT0"]["p_L2"] / 8, errors


def test_quantities():
    """Intervals that contain what finer meshes and exact solutions say, and are far shorter than those of RT0."""
    kinds = {"on top": Mean(parts="top"), "energy": Energy()}
    values = {"on top": 0.059185, "energy": -0.089936}
    lengths = {}
    for element in ("RT0", "RT1"):
        solution = on_grid("example1", 8, solve__element=element)
        found = {name: solution.quantity(kind) for name, kind in kinds.items()}
        lengths[element] = {name: quantity.width for name, quantity in found.items()}
        assert all(
            quantity.lower < values[name] < quantity.upper and quantity.proved for name, quantity in found.items()
        )
    assert all(lengths["RT1"][name] < lengths["RT0"][name] / 10 for name in kinds), lengths


@pytest.mark.parallel(3)
@pytest.mark.parametrize("algorithm", [pytest.param("alg1", marks=pytest.mark.slow), "alg3"])
def test_ranks_without_cells(algorithm: str):
    """Two cells on three ranks, with a kappa that varies within them."""
    problem = Diffusion(f="-1 - x", kappa="1 + x*y", c="y", conditions=[Signorini("bottom", psi="-x/10")])
    together, alone = (
        solve(build_domain(comm, "square", 1.5, mesh="structured"), problem, Options(algorithm, element="RT1"))
        for comm in (COMM, MPI.COMM_SELF)
    )
    assert together.norms() == pytest.approx(alone.norms(), rel=1e-10)
    assert together.certify().bound == pytest.approx(alone.certify().bound, rel=1e-8)


def test_command_line(tmp_path: Path):
    """The option and the key, comparisons of elements, and one sentence where RT1 is not there."""
    small = ["--h", "1/4", "--quiet"]
    for element in ("RT0", "RT1"):
        assert (
            signorini(tmp_path, "solve", "example1", *small, "--element", element, "--output", element).returncode == 0
        )
    summary = json.loads((tmp_path / "RT1" / "summary.json").read_text())
    assert summary["element"] == "RT1"
    compared = signorini(tmp_path, "compare", "RT1", "RT0")
    assert compared.returncode == 0, compared.stderr
    for given, told in (
        (["example1", "--element", "RT2"], "element"),
        (["soil", "--element", "RT1"], "there is no RT1 for storage; take RT0"),
        (["example1", "--element", "RT1", "--rigorous"], "--rigorous: the proof is for RT0 alone"),
        (["example1", "--element", "RT1", "--algorithm", "qp"], "--element: qp has no such option"),
        (["hertz", "--element", "RT1"], "elastic contact has no such key"),
    ):
        ended = signorini(tmp_path, "solve", *given, *small, "--output", "refused")
        assert ended.returncode == 2
        assert told in ended.stderr, ended.stderr
        assert not (tmp_path / "refused").exists()


def test_forecast():
    """Of RT1 more is expected than of RT0: an unknown for each vertex of a facet, and their memory."""
    for name, dim in (("example1", 2), ("transition3d", 3)):
        case = load_case(name)
        before, after = (expected(case.with_values({"solve.element": element}), 1) for element in ("RT0", "RT1"))
        assert after.unknowns == dim * before.unknowns == dim * before.facets
        assert after.memory > 3 * before.memory - 2 * PROCESS_BYTES
        assert after.solver_seconds > before.solver_seconds


def test_given_traces():
    """A given u may be the law of a part."""
    held = Diffusion(f=-1.0, conditions=[Dirichlet("bottom", "x"), Signorini("top")])
    assert solve(build_domain(COMM, "square", 1 / 4, mesh="unstructured"), held, RT1).converged


@pytest.mark.parallel([1])
def test_a_law_is_reported_and_drawn(capsys: pytest.CaptureFixture[str]):
    """Vertices on each segment are counted, and traces are linear on each facet."""
    solution = solve_case(load_case("wall").with_values({"solve.h": 0.25, "solve.element": "RT1"}))
    SolutionReport().solution(solution, Found())
    assert "vertices on each segment: inflow" in capsys.readouterr().out
    scene = gathered_scene(solution)
    assert scene is not None
    flux = Plane(scene).sheet(scene.pictures.files(scene)["signorini"][1]).axes[1].lines[0]
    x = scene.sites.x_at[..., 0]
    np.testing.assert_array_equal(flux.get_xdata(), np.sort(x, axis=1).ravel())
    assert sorted(flux.get_ydata()) == sorted(scene.sites.flux_at.ravel())
