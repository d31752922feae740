"""Parts inside the domain, across which u may jump: the cut, exact solutions, bounds, ranks, what is refused."""

import math
from pathlib import Path

import dolfinx.mesh
import numpy as np
import pytest
from exact import energy_error
from makers.bounds import difference
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Signorini
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import adapt_case, solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.meshes.checks import FileMesh, faces
from signorini_fenicsx.meshes.cut import Side, opened
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import other_side
from signorini_fenicsx.meshes.grids import Share, rectangle_grid, tetrahedron_grid
from signorini_fenicsx.meshes.uniform import refined_uniformly
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.solving.solver import Solver, solve

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize(("name", "h"), [("crack", 0.3), ("fault", None)])
def test_exact_solutions(name: str, h: float | None):
    """Contact on a crack that ends inside, friction between bodies of different κ: order 1, and bounds near the error.

    The other methods and the other backend have the same solution.
    """
    case = load_case(name)
    mesh = mesh_case(case if h is None else case.with_values({"solve.h": h}), MPI.COMM_SELF)
    coarse = solve_case(case, domain=mesh)
    fine = solve_case(case, domain=refined_uniformly(mesh))
    before, after = coarse.errors(), fine.errors()
    assert before is not None
    assert after is not None
    assert min(math.log2(before[key] / after[key]) for key in ("sigma_L2", "u_L2", "p_L2")) > 0.95
    assert max(vars(fine.kkt).values()) < 1e-11
    for solution, most in ((coarse, 1.08), (fine, 1.02)):
        error, certificate = energy_error(solution), certify(solution)
        assert error < certificate.sigma_bound < most * error
    for algorithm, backend, tolerance in (("alg2", "mixed", 1e-10), ("qp", "hybrid", 1e-8), ("vi", "hybrid", 1e-10)):
        if (algorithm, name) == ("vi", "fault"):
            continue
        way = case.with_values({"solve.algorithm": algorithm, "solve.backend": backend})
        other = solve_case(way, domain=mesh)
        for key in ("sigma", "u", "p"):
            one, two = (getattr(solution, key).x.array for solution in (other, coarse))
            size = np.abs(getattr(coarse, "u" if key == "p" else key).x.array).max()
            np.testing.assert_allclose(one, two, rtol=0, atol=tolerance * size, err_msg=algorithm)


@pytest.mark.parallel([1, 2])
def test_a_part_along_the_last_axis():
    """Its condition names the side, as the larger coordinate cannot: the solution is that of the part turned round."""
    norms = []
    for axis, names in ((0, "xy"), (1, "yx")):
        mesh = dolfinx.mesh.create_unit_square(COMM, 8, 8, diagonal=dolfinx.mesh.DiagonalType.crossed)

        def slit(x: np.ndarray, axis: int = axis) -> np.ndarray:
            return np.isclose(x[axis], 0.5) & (np.abs(x[1 - axis] - 0.5) < 0.3)

        domain, load = domain_of(mesh, {"slit": slit}, inner=["slit"]), f"10*({names[0]} - 0.6)*{names[1]}"
        if axis == 0:
            with pytest.raises(InputError, match="'slit' are along the last coordinate axis, so a larger coordinate"):
                solve(domain, Diffusion(f=load, conditions=[Signorini("slit", side=None)]))
        side = tuple(float(axis == k) for k in range(2))
        norms.append(solve(domain, Diffusion(f=load, conditions=[Signorini("slit", side=side)])).norms())
    assert norms[0] == pytest.approx(norms[1], rel=1e-9)
    assert norms[0]["p_L2"] > 0


@pytest.mark.parallel([1, 3])
def test_services(folder: Path):
    """A part inside has two sides with opposite fluxes, multigrid, a file, and refinement where the error is."""
    case = load_case("crack").with_values({"solve.h": 0.4})
    solution = solve_case(case, COMM)
    expected = certify(solution)
    assert solution.flux_through(other_side("slit")) == pytest.approx(-solution.flux_through("slit"))
    large = solve_case(case, COMM, tuning=Tuning(direct_up_to=0))
    assert large.outcome.linear_solver.startswith("cg")
    assert max(step.linear_iterations for step in large.outcome.history) < 45
    assert large.norms() == pytest.approx(solution.norms(), rel=1e-8, abs=1e-9)
    write_solution(solution, folder, fields=False)
    assert load_solution(folder, COMM).norms() == pytest.approx(solution.norms(), rel=1e-9)
    adapted, certificate = adapt_case(case, COMM, max_cells=300)
    assert energy_error(adapted) < certificate.sigma_bound < 1.05 * energy_error(adapted)
    assert certificate.bound < 0.8 * expected.bound


def test_bounds_of_jumps():
    """For ψ that varies it is above the distance to a fine solution; there is none if the law forbids 0 at the tip."""
    case = load_case("crack").with_values({"solve.h": 0.5, "law.0.psi": "-0.3*cos(5*x) - 0.05"})
    mesh = mesh_case(case, MPI.COMM_SELF)
    solution = solve_case(case, domain=mesh)
    fine = solve_case(case, domain=refined_uniformly(refined_uniformly(mesh)))
    apart, certificate = difference(solution, fine), certify(solution)
    assert apart < certificate.sigma_bound < 1.3 * apart
    assert certificate.by_quadrature == ("law.0.psi",)
    forbidden = certify(solve_case(case.with_values({"law.0.psi": 0.1}), domain=mesh))
    assert forbidden.bound == math.inf
    assert forbidden.if_none == "a part inside the domain forbids the jump 0 where it ends"


def test_a_slit_that_is_closed_over_its_whole_length():
    """There all jumps are 0, but for the rounding of v, which is no reason against a bound."""
    closed = {"problem.f": "-y", "problem.u_D": 0, "problem.g_N": 0, "boundary.neumann": ["left", "right"]}
    solution = solve_case(load_case("crack").with_values({"solve.h": 0.3} | closed))
    assert solution.contact[1] == pytest.approx(1)
    certificate = certify(solution)
    assert certificate.guaranteed
    assert certificate.relative < 0.2


def in_square(sides: dict[str, Side], **lines: tuple[int, float, float]) -> FileMesh:
    """A square of 4 × 4 cells cut in halves, with inner parts: lines x_i = 1/2 from one end to another."""
    points, cells = rectangle_grid(np.zeros(2), np.ones(2), math.sqrt(2) / 4, "right", Share())
    everything = np.unique(faces(cells), axis=0)
    parts = {}
    for name, (axis, begin, end) in lines.items():
        x = points[everything]
        on = np.isclose(x[:, :, axis], 0.5) & (x[:, :, 1 - axis] > begin - 0.1) & (x[:, :, 1 - axis] < end + 0.1)
        parts[name] = everything[on.all(axis=1)]
    right = {"right": np.flatnonzero(points[cells].mean(axis=1)[:, 0] > 0.5)}
    return opened(FileMesh(points, cells, parts, right), list(lines), sides)


def test_cut():
    """Vertices get as many copies as there are sides, and none at the edge; both sides have the same places."""
    mesh = in_square({}, slit=(1, 0, 0.5))
    assert len(mesh.points) == 25 + 2
    mesh = in_square({"cross": "right"}, fault=(1, 0, 1), cross=(0, 0, 1))
    assert len(mesh.points) == 25 + 8 + 3
    assert len(mesh.parts["fault"]) == len(mesh.parts[other_side("fault")]) == 4
    for name in ("fault", "cross"):
        named, other = (
            np.sort(mesh.points[mesh.parts[part]].mean(axis=1), axis=0) for part in (name, other_side(name))
        )
        np.testing.assert_array_equal(named, other)
        assert not np.isin(mesh.parts[name], mesh.parts[other_side(name)]).any()
    assert mesh.together is not None
    heights = mesh.points[mesh.cells[mesh.together[:4]]].mean(axis=2)[:, :, 1]
    assert np.all((heights > 0.5).sum(axis=1) == 1)
    above = np.isin(mesh.cells, mesh.parts["fault"]).sum(axis=1) == 2
    assert np.all(mesh.points[mesh.cells[above]].mean(axis=1)[:, 1] > 0.5)


def test_cut_in_space():
    """A facet with all vertices at the edge of the cut stays closed; the others open."""
    points, cells = tetrahedron_grid(math.sqrt(3) / 4, "right", Share())
    everything = np.unique(faces(cells), axis=0)
    x = points[everything]
    inside = np.isclose(x[:, :, 2], 0.5) & (np.abs(x[:, :, :2] - 0.5).max(axis=2) < 0.3)
    mesh = opened(FileMesh(points, cells, {"fault": everything[inside.all(axis=1)]}, {}), ["fault"], {})
    assert len(mesh.points) == len(points) + 1
    assert len(mesh.parts["fault"]) == 6
    assert inside.all(axis=1).sum() == 8


@pytest.mark.parametrize(
    ("sides", "lines", "message"),
    [
        ({}, {"fault": (0, 0, 1)}, r"sides\.fault: 4 facets are parallel to the direction \(0\.0, 1\.0\), the first"),
        ({"fault": "left"}, {"fault": (0, 0, 1)}, "unknown region 'left'; the mesh has right"),
        ({"fault": ""}, {"fault": (1, 0, 1)}, "unknown region ''; the mesh has right"),
        ({"fault": "right"}, {"fault": (1, 0, 1)}, "4 facets are not between 'right' and another region"),
        ({"fault": [0, 0, 1]}, {"fault": (1, 0, 1)}, "must be a region, or a direction of 2 numbers"),
        ({}, {"fault": (1, 0.25, 0.5)}, "part 'fault' opens nowhere, all its vertices are at its edge"),
    ],
)
def test_sides_that_are_refused(sides: dict[str, Side], lines: dict[str, tuple[int, float, float]], message: str):
    with pytest.raises(InputError, match=message):
        in_square(sides, **lines)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"boundary.inner": []}, r"inner: part 'slit' of slit is inside the domain, and needs a \[\[law\]\]"),
        ({"boundary.inner": ["slit"], "law": []}, r"'slit' needs a \[\[law\]\] between the jump of u and σ·n"),
        ({"boundary.inner": ["slit"], "law.0.parts": ["slit", "top"]}, ""),
        ({"boundary.inner": ["slit", "top"], "law.0.parts": ["slit", "top"]}, "'top' of slit is not inside the domain"),
        ({"boundary.sides": {"slit": "upper"}}, "sides.slit: 'slit' is not an inner part of a mesh file"),
        ({"boundary.neumann": ["slit"]}, "'slit' is listed twice"),
    ],
)
def test_cases_that_are_refused(values: dict[str, object], message: str):
    case = load_case("crack")
    if not message:
        assert isinstance(case.with_values(values), Case)
        return
    with pytest.raises(InputError, match=message):
        case.with_values(values)


def test_solvers_that_are_refused():
    case = load_case("crack").with_values({"solve.h": 0.5})
    mesh = mesh_case(case, MPI.COMM_SELF)
    with pytest.raises(InputError, match="alg3 does not take parts inside the domain; alg1, alg2, vi and qp do"):
        solve_case(case.with_values({"solve.algorithm": "alg3"}), domain=mesh)
    with pytest.raises(InputError, match="'slit' is inside the domain: it belongs to inner, with a law"):
        Solver(mesh, Diffusion(0, conditions=[Signorini("top")]))
