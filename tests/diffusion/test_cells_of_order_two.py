"""Laws in Ω with RT1: orders, bounds, signs at vertices of cells, a programme of the UFL forms, ranks, files."""

import math
from pathlib import Path

import numpy as np
import piqp
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx import Corners, Diffusion, Obstacle, Options, Signorini, load_solution, solve
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import adapt_case, solve_case
from signorini_fenicsx.discrete.hybrid_system import HybridSystem
from signorini_fenicsx.extend import write_solution
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.rt1_solution import RT1Solution

COMM = MPI.COMM_WORLD
RT1 = Options(element="RT1")
LAWS = [
    Corners([[-0.05, -4], ["-0.05 + y/20", "4 + x"]], 3, region="all"),
    Obstacle(region="all", psi_upper="0.2 + x/9"),
]


def of_case(name: str, h: float, comm: MPI.Comm = COMM, element: str = "RT1", **about: object) -> RT1Solution:
    values = {"solve.h": h, "solve.element": element}
    return solve_case(load_case(name).with_values(values), comm, **about)  # type: ignore[arg-type, return-value]


@pytest.mark.parametrize(
    ("name", "order", "better", "most"),
    [
        pytest.param("sphere", 1.45, 4, 1.9, marks=pytest.mark.slow),
        ("two_obstacles", 1.4, 7, 1.8),
        ("saturation", 1.9, 40, 3.3),
        ("dead_core", 1.3, 7, 2.3),
        pytest.param("phases", 1.6, 40, 3.3, marks=pytest.mark.slow),
    ],
)
def test_exact_solutions(name: str, order: float, better: float, most: float):
    """Order 3/2 where a free boundary crosses cells, 2 where u is smooth, by few sets; far less error than RT0.

    The bound is above the error; on uniform meshes by what s is wrong in the cells that the free boundary crosses.
    """
    h = 1 / 8 if name == "sphere" else 1 / 16
    found = [of_case(name, each) for each in (2 * h, h)]
    errors = [solution.errors()["sigma_L2"] for solution in found]
    assert math.log2(errors[0] / errors[1]) > order
    assert better * errors[1] < of_case(name, h, element="RT0").errors()["sigma_L2"]
    assert max(len(solution.outcome.history) for solution in found) <= 5
    certificate, error = found[0].certify(), found[0].errors()["energy"]
    assert error < certificate.sigma_bound < most * error
    assert certificate.guaranteed == (name not in ("phases", "sphere"))  # their data are coarse


def test_adaptive_bound():
    """On adapted meshes the bound is near the error."""
    case = load_case("two_obstacles").with_values({"solve.h": 1 / 8})
    solution, certificate = adapt_case(case, max_cells=1200)
    assert solution.options.element == "RT1"
    assert 1 < certificate.sigma_bound / solution.errors()["energy"] < 1.4


def test_nothing_is_corrected_where_no_flux_leaves(monkeypatch: pytest.MonkeyPatch):
    """Fluxes whose jumps are rounding beside those inside need no correction, though σ·n is 0 on the boundary."""
    corrections, recover = [], HybridSystem.recover

    def noted(self: HybridSystem, x: np.ndarray, **how: bool) -> tuple[np.ndarray, np.ndarray]:
        corrections.extend([1] * (not how.get("with_f", True)))
        return recover(self, x, **how)

    monkeypatch.setattr(HybridSystem, "recover", noted)
    assert np.abs(of_case("two_obstacles", 1 / 8).sigma.x.array).max() > 0.04
    assert not corrections


def test_signs_at_vertices():
    """On the obstacle the force is nowhere negative, off it 0, and no mean of u by a hat is below that of ψ."""
    solution = of_case("sphere", 1 / 4)
    force, cell = solution.force_at, solution.spaces.site_kinds["cell"]
    held = cell.rows_of(solution.outcome.conditions.kind) == 1
    assert (force[held] >= 0).all()
    assert (force[~held] == 0).all()
    assert held.any(axis=1).sum() > held.all(axis=1).sum() > 0  # a cell may be held at some of its vertices
    assert (cell.of(solution.iterate.p) >= 0).all()
    assert solution.on_obstacle()["contact_measure"] == pytest.approx(np.pi * 0.697965148223374**2, rel=0.02)
    assert solution.on_obstacle()["force"] == pytest.approx(2 * np.pi * 0.680259411891719, rel=2e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_quadratic_programme(dim: int):
    """σ minimises the complementary energy under the signs of the force at all vertices of cells."""
    domain = build_domain(
        COMM, "square" if dim == 2 else "cube", 1.001 * math.sqrt(dim) / (5 if dim == 2 else 2), mesh="structured"
    )
    wave = "x^2 - y/3"
    problem = Diffusion(f="-9 - 20*x*y", kappa=2, u_D=wave, conditions=[Obstacle(region="all", psi=f"{wave} - x/9")])
    solution = solve(domain, problem, RT1)
    mesh, n, x = domain.mesh, ufl.FacetNormal(domain.mesh), ufl.SpatialCoordinate(domain.mesh)
    fluxes, scalars = fem.functionspace(mesh, ("RT", 2)), fem.functionspace(mesh, ("DG", 1))
    sigma, tau, v, u = (
        *(make(fluxes) for make in (ufl.TrialFunction, ufl.TestFunction)),
        *(make(scalars) for make in (ufl.TestFunction, ufl.TrialFunction)),
    )
    dx, u_D = ufl.dx(metadata={"quadrature_degree": 8}), x[0] ** 2 - x[1] / 3

    def matrix(form: ufl.Form) -> np.ndarray:
        return np.asarray(fem.assemble_matrix(fem.form(form)).to_dense())

    def vector(form: ufl.Form) -> np.ndarray:
        return np.asarray(fem.assemble_vector(fem.form(form)).array)

    energy = matrix(ufl.inner(sigma, tau) / 2 * dx)
    force = np.linalg.solve(
        matrix(u * v * dx), np.column_stack([matrix(v * ufl.div(sigma) * dx), vector(v * (-9 - 20 * x[0] * x[1]) * dx)])
    )
    linear = -vector(u_D * ufl.inner(tau, n) * ufl.ds)
    linear += vector((u_D - x[0] / 9) * v * dx) @ force[:, :-1]
    solver = piqp.DenseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = 1e-11
    solver.setup(energy, linear, None, None, force[:, :-1], np.full(len(force), -np.inf), -force[:, -1])
    assert solver.solve() == piqp.PIQP_SOLVED
    held = solution.held_cells.mean()
    assert 0.05 < held < 0.95
    np.testing.assert_allclose(
        solver.result.x, solution.sigma.x.array, atol=1e-7 * np.abs(solution.sigma.x.array).max()
    )


def test_laws_are_alike():
    """A key and a law are the same, an upper bound is a lower one turned, and a line in the law is a term cu."""
    domain = build_domain(COMM, "square", 0.2, mesh="structured")

    def on_square(*laws: object, **data: object) -> RT1Solution:
        return solve(domain, Diffusion(conditions=laws, **data), RT1)  # type: ignore[arg-type, return-value]

    short, long = on_square(f=-8, obstacle=-0.1), on_square(Obstacle(region="all", psi=-0.1), f=-8)
    np.testing.assert_array_equal(short.u.x.array, long.u.x.array)
    upside = on_square(Obstacle(region="all", psi_upper=0.1), f=8)
    np.testing.assert_allclose(upside.u.x.array, -short.u.x.array, atol=1e-13)
    line, term = on_square(Corners([[-9, -27], [9, 27]], region="all"), f=8), on_square(f=8, c=3)
    np.testing.assert_allclose(line.sigma.x.array, term.sigma.x.array, atol=1e-12)


@pytest.mark.parallel(2)
@pytest.mark.parametrize("dim", [2, 3])
def test_ranks(dim: int):
    """Two laws at a time and one on Γ_S give the same numbers on any ranks, by a factorisation or by CG."""
    problem = Diffusion(
        f="30*sin(3*x + 4*y)", kappa="2 + x", c="y", conditions=[*LAWS, Signorini("bottom", psi="-x/50")]
    )
    found = [
        solve(
            build_domain(comm, "square" if dim == 2 else "cube", 1 if dim == 3 else 0.2, mesh="structured"),
            problem,
            options,
        )
        for comm, options in (
            (COMM, RT1),
            (MPI.COMM_SELF, RT1),
            (COMM, Options(element="RT1", tuning=Tuning(direct_up_to=0))),
        )
    ]
    for solution in found[::2]:
        assert solution.norms() == pytest.approx(found[1].norms(), rel=1e-10 if solution is found[0] else 1e-7)
        for name, segments in found[1].in_regions().items():
            for segment, numbers in segments.items():
                assert solution.in_regions()[name][segment] == pytest.approx(numbers)


@pytest.mark.parallel(2)
def test_files(tmp_path: Path):
    """A solution with laws in Ω is read as it was written; its fields and tables are those of cells."""
    folder = COMM.bcast(tmp_path) / "out"
    domain = build_domain(COMM, "square", 0.2, mesh="structured")
    solution = solve(domain, Diffusion(f="30*sin(3*x + 4*y)", conditions=LAWS), RT1)
    write_solution(solution, folder)
    read = load_solution(folder, COMM)
    assert read.norms() == pytest.approx(solution.norms(), rel=1e-12)
    assert read.in_regions() == solution.in_regions()
    assert vars(read.kkt) == pytest.approx(vars(solution.kkt), abs=1e-12)
    assert len((folder / "free_boundary.csv").read_text().splitlines()) > 5
    again = solve(domain, Diffusion(f="30*sin(3*x + 4*y)", conditions=LAWS), RT1, start=read)
    assert len(again.outcome.history) <= 2
