"""Methods of a solution: values at points, fluxes through parts, its trace in UFL, output in notebooks."""

import doctest
import re
from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import LinearProblem
from mpi4py import MPI

from signorini_fenicsx import (
    Diffusion,
    InputError,
    Neumann,
    NumericalFailure,
    Signorini,
    Solution,
    domain_of,
    load_solution,
    solve,
)
from signorini_fenicsx.extend import write_solution
from signorini_fenicsx.physics.diffusion import solution as module

COMM = MPI.COMM_WORLD
WALLS = {
    "bottom": lambda x: np.isclose(x[1], 0),
    "low": lambda x: (x[1] < 0.5) & (np.isclose(x[0], 0) | np.isclose(x[1], 0)),
    "right": lambda x: np.isclose(x[0], 1),
}


def solved(f: str = "40*(x - 0.6)", n: int = 8, g_N: float = 0.0, comm: MPI.Intracomm = COMM) -> Solution:
    """On a square with Γ_S below and Γ_N on the right."""
    square = mesh.create_unit_square(comm, n, n)
    return solve(
        domain_of(square, WALLS),
        Diffusion(f=f, conditions=[Signorini("bottom", "0.1*x - 0.05"), Neumann("right", g_N)]),
    )


def test_examples():
    failed, tried = doctest.testmod(module, extraglobs={"solution": solved()}, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert tried > 7
    assert failed == 0


@pytest.mark.parallel(2)
def test_values_at_points_of_any_rank():
    """Each rank asks for its own points, some outside; u has in each cell the mean u_h and the gradient σ_h of RT0."""
    solution = solved()
    spaces = solution.spaces
    cells = np.arange(len(solution.u.x.array), dtype=np.int32)
    centres = mesh.compute_midpoints(spaces.mesh, 2, cells)
    everywhere = np.concatenate(COMM.allgather(centres))[:, :2]
    values, step = solution.at(everywhere[COMM.rank :]), 1e-3
    f = 40 * (everywhere[COMM.rank :, 0] - 0.6)  # its mean on a cell: it is linear
    ahead, behind = ([solution.at(everywhere[COMM.rank :] + s * e) for e in np.eye(2)] for s in (step, -step))
    divergence = sum((there.sigma - values.sigma)[:, i] / step for i, there in enumerate(ahead))
    np.testing.assert_allclose(divergence, -f, atol=1e-8)
    gradient = [(right.u - left.u) / (2 * step) for right, left in zip(ahead, behind, strict=True)]
    np.testing.assert_allclose(np.transpose(gradient), values.sigma, atol=1e-10)
    in_midpoints = solution.potential.x.array.reshape(-1, 6)[:, 3:]  # a quadrature of degree 2
    np.testing.assert_allclose(in_midpoints.mean(axis=1), solution.u.x.array, atol=1e-13)
    outside = [[0.3, 0.4], [1.001, 0.5], [np.nan, 0.5], [0.5, -3], [1.0, 1.0]] if COMM.rank == 0 else []
    found = np.isfinite(solution.at(outside).u)
    assert found.tolist() == ([True, False, False, False, True] if COMM.rank == 0 else [])
    lines = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, 9)]), axis=-1).reshape(-1, 2)  # each in several cells
    np.testing.assert_allclose(solution.at(lines).u, solved(comm=MPI.COMM_SELF).at(lines).u, atol=1e-12)
    for wrong in ([0.5, 0.5], [[1, 2, 3]], [["a", "b"]], [[1], [2, 3]]):
        with pytest.raises(InputError, match=r"points: must be an array of shape \(n, 2\), a row for each point"):
            solution.at(wrong if COMM.rank == 0 else [[0.5, 0.5]])


@pytest.mark.parallel([1, 3])
def test_fluxes_balance_the_load():
    solution = solved(g_N=-0.3)
    spaces = solution.spaces
    assert solution.flux_through() == pytest.approx(-40 * (0.5 - 0.6), abs=1e-11)
    assert solution.flux_through("right") == pytest.approx(-0.3, abs=1e-12)
    flux = COMM.allreduce(spaces.facet_measure @ spaces.normal_flux(solution.sigma))
    assert solution.flux_through("bottom") == pytest.approx(flux, abs=1e-12)
    both = solution.flux_through(["low", "bottom"])  # they overlap
    assert both == pytest.approx(solution.flux_through(["bottom", "low", "low"]), abs=1e-14)
    assert both != pytest.approx(solution.flux_through("low") + flux, abs=1e-3)
    with pytest.raises(InputError, match=r"unknown part 'bottm'; there are .* \(did you mean 'bottom'\?\)"):
        solution.flux_through("bottm")
    square = mesh.create_unit_square(COMM, 4, 4)
    middle = {"bottom": WALLS["bottom"], "middle": lambda x: np.isclose(x[0], 0.5)}
    facets = {name: mesh.locate_entities(square, 1, where) for name, where in middle.items()}
    inner = solve(domain_of(square, facets), Diffusion(f=1.0, conditions=[Signorini("bottom")]))
    with pytest.raises(InputError, match="part 'middle' has facets inside the domain"):
        inner.flux_through("middle")


@pytest.mark.parallel([1, 2])
def test_trace_in_ones_own_ufl():
    """A conforming solution with p_h as Dirichlet data, by Nitsche's method, is near u_h; two refinements by 4."""
    distances = []
    for n in (6, 24):
        solution = solved(n=n)
        spaces, p = solution.spaces, solution.p
        space = fem.functionspace(spaces.mesh, ("P", 1))
        w, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        x, normal, ds = ufl.SpatialCoordinate(spaces.mesh), spaces.n, spaces.ds
        a = ufl.inner(ufl.grad(w), ufl.grad(v)) * ufl.dx
        a += (10 * n * w * v - ufl.inner(ufl.grad(w), normal) * v - ufl.inner(ufl.grad(v), normal) * w) * ds
        L = 40 * (x[0] - 0.6) * v * ufl.dx + (10 * n * v - ufl.inner(ufl.grad(v), normal)) * p * ds
        dofs = fem.locate_dofs_geometrical(space, lambda x: np.isclose(x[0], 0) | np.isclose(x[1], 1))
        problem = LinearProblem(
            a,
            L,
            bcs=[fem.dirichletbc(0.0, dofs, space)],
            entity_maps=[spaces.entity_map],
            petsc_options_prefix="own_",
            petsc_options={"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"},
        )
        difference = problem.solve() - solution.u
        distances.append(np.sqrt(spaces.integrate(difference**2 * ufl.dx)))
    assert distances[1] < distances[0] / 3
    assert distances[1] < 0.02


def test_errors_are_one_line_in_a_notebook():
    """IPython shows what `_render_traceback_` gives in the place of a traceback."""
    for error in (InputError("no mesh"), NumericalFailure("no solution")):
        assert error._render_traceback_() == [f"{type(error).__name__}: {error}"]


@pytest.mark.parallel(2)
def test_it_shows_and_writes_itself(folder: Path):
    solution = solved(n=4)
    certificate = solution.certify()
    assert len(repr(solution)) < 100
    assert repr(solution.spaces.domain) == "<Domain mesh: 32 cells, h = 0.3536, parts bottom, low, right>"
    assert re.fullmatch(r"<Certificate: energy error ≤ \S+, relative \S+, guaranteed>", repr(certificate))
    for shown in (solution, certificate, solution.spaces.domain):
        assert {name for name in dir(shown) if not hasattr(shown, name)} == set()
        assert not [name for name in dir(shown) if name.startswith("_")]
    figure, page = solution.plot(), solution._repr_html_()
    if COMM.rank == 0:
        assert figure.axes[0].get_title() == "(a) $u_h$"
        assert figure._repr_png_()[1:4] == b"PNG"
        assert "algorithm" in page
        assert "src='data:image/png;base64,iVBOR" in page
        assert len(page) < 400_000
    else:
        assert figure is None
        assert page is None
    solution.write(folder / "new" / "run")
    names = {path.name for path in (folder / "new" / "run").iterdir()}
    assert {"summary.json", "facets.csv", "solution.xdmf"} <= names
    assert load_solution(folder / "new" / "run", COMM).norms() == pytest.approx(solution.norms())
    write_solution(solution, folder / "other" / "run", fields=False)
    assert load_solution(folder / "other" / "run", COMM).contact == solution.contact
    with pytest.raises(InputError, match=r"output .*summary\.json: is a file, not a folder"):
        write_solution(solution, folder / "other" / "run" / "summary.json")
