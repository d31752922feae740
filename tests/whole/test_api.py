"""The Python interface: its examples, data of all kinds, refusals, and a user's discretisation."""

import doctest
import gc
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, create_unit_square
from mpi4py import MPI

from signorini_fenicsx import Contact, Diffusion, Elasticity, Neumann, Signorini, api
from signorini_fenicsx.api import adapt, certify, compare, evolve
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.laws import Friction, Wall
from signorini_fenicsx.contact.set_rules import SetRule
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.methods.registry import Method
from signorini_fenicsx.methods.task import Task
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.solve.facets import FacetBackend
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend
from signorini_fenicsx.solving import evolving, solver
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Solver, solve

COMM = MPI.COMM_WORLD
OWN = SetRule(
    start=Condition.NO_FLUX,
    rule=lambda p, flux, rho: np.where(flux > rho * p, Condition.ZERO_TRACE, Condition.NO_FLUX).astype(np.int8),
)
WALLS: Mapping[str, Callable[[npt.NDArray], npt.NDArray]] = {
    "bottom": lambda x: np.isclose(x[1], 0),
    "right": lambda x: np.isclose(x[0], 1),
    "middle": lambda x: np.isclose(x[0], 0.5),
}


def square(n: int = 8, **options: object) -> tuple[dolfinx.mesh.Mesh, dict[str, npt.NDArray[np.int32]]]:
    """A mesh and its parts."""
    mesh = create_unit_square(COMM, n, n, **options)
    mesh.topology.create_connectivity(1, 2)
    return mesh, {name: dolfinx.mesh.locate_entities(mesh, 1, where) for name, where in WALLS.items()}


@pytest.mark.parametrize(("module", "least"), [(api, 11), (solver, 4), (evolving, 1)])
def test_examples(module: ModuleType, least: int):
    failed, tried = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert failed == 0
    assert tried >= least


@pytest.mark.parallel([1, 2])
def test_kinds_of_data(folder: Path):
    """Numbers, UFL, functions of points, finite element functions and values per region give the same result."""
    mesh, parts = square()
    x = ufl.SpatialCoordinate(mesh)
    quadratic = fem.Function(fem.functionspace(mesh, ("Lagrange", 2)))
    quadratic.interpolate(lambda x: 20 * (x[0] - 0.6) * (1 + x[1]))
    left = dolfinx.mesh.compute_midpoints(mesh, 2, np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32))
    cells = np.flatnonzero(left[:, 0] < 0.5).astype(np.int32), np.flatnonzero(left[:, 0] > 0.5).astype(np.int32)
    regions = {"west": cells[0], "east": cells[1]}
    by_points = lambda x: np.where(x[0] < 0.5, 1.0, 3.0) * np.eye(2)[:, :, None]  # noqa: E731
    below = [Signorini("bottom", psi=-0.01 * x[0]), Neumann("right")]
    problems = [
        Diffusion(
            quadratic, {"west": 1, "east": 3}, conditions=[Signorini("bottom", lambda x: -0.01 * x[0]), below[1]]
        ),
        Diffusion(lambda x: 20 * (x[0] - 0.6) * (1 + x[1]), by_points, conditions=below),
        Diffusion(
            20 * (x[0] - 0.6) * (1 + x[1]),
            {"east": np.diag([3, 3]), "west": np.float32(1)},
            u_D=fem.Constant(mesh, 0.0),
            conditions=below,
        ),
    ]
    domain = domain_of(mesh, parts, regions)
    one, two, three = (solve(domain, problem) for problem in problems)
    assert 0 < one.contact[0] < 8
    for other in (two, three):
        np.testing.assert_allclose(other.sigma.x.array, one.sigma.x.array, atol=1e-11)
        np.testing.assert_allclose(other.p.x.array, one.p.x.array, atol=1e-11)
    certificate = certify(one)
    assert 0 < certificate.bound < 1
    write_solution(one, folder, certificate=certificate)
    assert (folder / "facets.csv").is_file()


@pytest.mark.parallel(2)
def test_functions_of_points_choose_parts():
    """Parts and regions by functions of points are those by numbers, with ghosts or with those of other ranks alone."""
    mesh, parts = square()
    walls = {name: WALLS[name] for name in ("bottom", "right")}
    regions = {"west": lambda x: x[0] < 0.5 + 1e-9, "east": lambda x: x[0] > 0.5 - 1e-9}
    cells = {name: dolfinx.mesh.locate_entities(mesh, 2, where) for name, where in regions.items()}
    owned = mesh.topology.index_map(1).size_local
    one, other = domain_of(mesh, parts, cells), domain_of(mesh, walls, regions)
    for name in walls:
        np.testing.assert_array_equal(one.facets[name], other.facets[name])
        np.testing.assert_array_equal(one.facets[name], parts[name][parts[name] < owned])
    for name in regions:
        np.testing.assert_array_equal(one.regions[name], other.regions[name])
    ghosts = domain_of(mesh, {"middle": parts["middle"][parts["middle"] >= owned]})
    shared = COMM.allreduce(len(ghosts.facets["middle"]))
    assert 0 < shared <= COMM.allreduce(len(one.facets["middle"])) == 8
    assert all(number < owned for number in ghosts.facets["middle"])


class Counting(FacetBackend):
    """A user's backend: the hybrid one, which counts its solves."""

    name = "counting"
    solves = 0

    def __init__(self, spaces: Spaces, data: Data):
        super().__init__(spaces, data)
        self._inner = HybridBackend(spaces, data)
        self.dofs = self._inner.dofs

    def solver(self) -> str:
        """Its name."""
        return self._inner.solver()

    def solve(self, conditions: SiteConditions) -> Iterate:
        """Solve and count."""
        Counting.solves += 1
        return self._inner.solve(conditions)


@pytest.mark.parallel(2)
def test_own_backend():
    mesh, parts = square()
    x = ufl.SpatialCoordinate(mesh)
    options = Options(algorithm="alg4", eps=1e-3, backend=Counting)
    solution = solve(domain_of(mesh, parts), Diffusion(f=40 * (x[0] - 0.6), conditions=[Signorini("bottom")]), options)
    assert Counting.solves == len(solution.outcome.history) + 1  # the start, too
    assert solution.outcome.backend == "counting"
    kind = solution.outcome.conditions.kind
    assert np.all((kind == Condition.ZERO_TRACE) | (kind == Condition.ROBIN))


def one_step(task: Task) -> Outcome:
    """A user's method: contact everywhere, which is right for f < 0."""
    backend = task.backend(task.spaces, task.data)
    conditions = SiteConditions.everywhere(Condition.ZERO_TRACE, backend.sites)
    return Outcome(
        iterate=backend.solve(conditions),
        conditions=conditions,
        history=[],
        reason="all facets are in contact",
        converged=True,
        backend=backend.name,
        dofs=backend.dofs,
        linear_solver=backend.solver(),
    )


@pytest.mark.parallel(2)
def test_own_method():
    """A user's method is judged by the KKT residuals like any other."""
    mesh, parts = square()
    domain = domain_of(mesh, parts)
    options = Options(algorithm=Method("contact everywhere", "", one_step))
    solution, expected = (
        solve(domain, Diffusion(f=-1.0, conditions=[Signorini("bottom")]), given) for given in (options, Options())
    )
    np.testing.assert_allclose(solution.sigma.x.array, expected.sigma.x.array, atol=1e-12)
    assert solution.summary()["algorithm"] == "own"
    with pytest.raises(NumericalFailure, match="KKT residuals above"):
        solve(domain, Diffusion(f="40*(x - 0.6)", conditions=[Signorini("bottom")]), options)


@pytest.mark.parallel(2)
def test_what_is_given_in_python_is_written_and_read(folder: Path):
    """Numbers and texts are in the file; a sentence asks for UFL. Results on a user's mesh refine and compare."""
    mesh, parts = square()
    domain, conditions = domain_of(mesh, parts), [Signorini("bottom"), Neumann("right", 0)]
    given = Diffusion(f="40*(x - 0.6)", kappa=[[2, 0], [0, 1]], conditions=conditions)
    solution = solve(domain, given, Options(algorithm="alg3", eps=1e-6))
    write_solution(solution, folder, certificate=certify(solution))
    read = load_solution(folder, COMM)
    assert read.problem == solution.problem
    assert read.options == solution.options
    assert read.norms() == pytest.approx(solution.norms(), rel=1e-12)
    again = solve(domain, given, start=read)
    assert len(again.outcome.history) <= len(solution.outcome.history)
    of_ufl = replace(given, f=40 * (ufl.SpatialCoordinate(mesh)[0] - 0.6))
    ufl_given = solve(domain, of_ufl, Options(algorithm=OWN))
    write_solution(ufl_given, folder)
    with pytest.raises(InputError, match="f: given in Python, so not in the file; pass the problem to load_solution"):
        load_solution(folder, COMM)
    with pytest.raises(InputError, match="the algorithm was given in Python; pass the options to load_solution"):
        load_solution(folder, COMM, problem=solution.problem)
    read = load_solution(folder, COMM, problem=solution.problem, options=ufl_given.options)
    assert compare(read, solution).relative["sigma_V"] < 1e-5

    def solve_on(domain: Domain, start: Solution | None) -> Solution:
        f = 40 * (ufl.SpatialCoordinate(domain.mesh)[0] - 0.6)
        return solve(domain, Diffusion(f=f, conditions=conditions), start=start)

    finest, certificate = adapt(domain, solve_on, max_cells=600)
    assert finest.spaces.Q.dofmap.index_map.size_global > 300
    assert certificate.bound < certify(solve_on(domain, None)).bound
    assert compare(finest, solution).hausdorff < 0.2


def test_numbers_and_texts_are_in_the_file(folder: Path):
    """Values by part, laws, and conditions of Neumann without a value."""
    walls = {side: WALLS[side] for side in ("bottom", "right")}
    walls |= {"top": lambda x: np.isclose(x[1], 1), "left": lambda x: np.isclose(x[0], 0)}
    laws = [api.Corners("bottom", ((0, 1), (0, -1))), Friction("left", "0.1 + y"), Signorini("top", 0.01)]
    held = [api.Dirichlet("right", 0.2), api.Neumann("top", 0.3), api.Neumann("bottom", 1)]
    touching = Contact("bottom", gap="0.1*x^2", friction=api.Tresca(0.01))
    body = [touching, Neumann(["right", "left"]), api.Dirichlet("top", ["0", "-0.3"])]
    for problem in (
        Diffusion(f="20*(x - 0.6)", conditions=laws),
        Diffusion(f=1.0, conditions=held),
        Elasticity(young=1.0, poisson="0.3", conditions=body),
    ):
        solution = solve(domain_of(square()[0], walls), problem)
        write_solution(solution, folder, fields=False)
        read = load_solution(folder, COMM)
        assert read.problem == solution.problem
        assert read.norms() == pytest.approx(solution.norms(), rel=1e-12)


def test_a_problem_that_no_file_can_hold_is_passed_when_its_solution_is_read(folder: Path):
    """With its conditions, as it was given to `solve`; one of another physics is refused."""
    domain = domain_of(square()[0], {side: WALLS[side] for side in ("bottom", "right")})
    unilateral = api.Signorini("bottom", psi=lambda x: 0.1 * x[0] - 0.05)
    given = api.Diffusion(f=lambda x: 40 * (x[0] - 0.6), conditions=[unilateral, api.Neumann("right")])
    pressed = [api.Contact("bottom", gap=lambda x: 0.1 * x[0]), api.Neumann("right")]
    of_body = api.Elasticity(young=1.0, poisson=0.3, u_D=["0", "-0.3*y^2"], conditions=pressed)
    for problem, other in ((given, of_body), (of_body, given)):
        solution = solve(domain, problem)
        write_solution(solution, folder)
        with pytest.raises(InputError, match="pass the problem to load_solution"):
            load_solution(folder, COMM)
        assert load_solution(folder, COMM, problem=problem).norms() == pytest.approx(solution.norms(), rel=1e-12)
        with pytest.raises(InputError, match=f"of {type(problem).__name__}, not of {type(other).__name__}"):
            load_solution(folder, COMM, problem=other)


@pytest.mark.parallel(2)
def test_refusals():
    mesh, parts = square()
    empty = {"west": np.empty(0, dtype=np.int32)}
    everywhere = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    twice = {"one": everywhere, "two": everywhere[:1]}
    domain, x = domain_of(mesh, parts), ufl.SpatialCoordinate(mesh)
    bottom, both = [Signorini("bottom")], domain_of(mesh, parts | {"bottom": parts["right"]})
    for given, data, conditions, message in [
        (domain, {}, [Signorini("top")], "unknown part 'top'; there are bottom, right, middle"),
        (domain, {}, [Signorini("middle")], "part 'middle' has 8 facets that are inside the domain or in another part"),
        (both, {}, [*bottom, Neumann("right")], "part 'right' has 8 facets that are inside"),
        (domain_of(mesh, {"none": empty["west"]}), {}, [Signorini("none")], "part 'none' has no facet"),
        (domain, {}, [Signorini("bottom", psi=x)], "psi: has shape"),
        (domain_of(mesh, parts, empty), {"kappa": {"west": 1.0}}, bottom, "8 cells have no value|no value"),
        (
            domain_of(mesh, parts, twice),
            {"kappa": {"one": 1, "two": 2}},
            bottom,
            "cells are in more than one of one, two",
        ),
        (domain, {"f": "40*(x - w)"}, bottom, "unknown name 'w'"),
        (domain, {"f": None}, bottom, r"\[problem\] f: is a NoneType; data are numbers, texts, UFL, Functions or"),
        (domain, {"kappa": [[1 + x[0], 0], [0, 1]]}, bottom, r"kappa: is a list; data are .* ufl.as_matrix"),
        (domain, {"f": lambda x: 1.0}, bottom, r"f: the function of points of shape \(3, 1\) must give one value"),
        (domain, {"f": ufl.TestFunction(fem.functionspace(mesh, ("P", 1)))}, bottom, "f: is UFL with a test or"),
    ]:
        with pytest.raises(InputError, match=message):
            solve(given, Diffusion(**{"f": 1.0} | data, conditions=conditions))
    quads, parts = square(cell_type=CellType.quadrilateral)
    with pytest.raises(InputError, match="must consist of triangles or tetrahedra"):
        domain_of(quads, parts)
    other, _ = square()
    with pytest.raises(InputError, match=r"f: is UFL on another mesh; write it on `domain.mesh`"):
        solve(domain, Diffusion(f=ufl.SpatialCoordinate(other)[0], conditions=[Signorini("bottom")]))
    for chosen, message in [
        ("bottom", r"parts\['low'\]: must be an array of facet numbers, integers, or a function of points"),
        ([0.5, 1.0], "must be an array of facet numbers"),
        ([[1], [2, 3]], "must be an array of facet numbers"),
        (np.ones(8, dtype=bool), "must be an array of facet numbers"),
        ([10**6], "there is no facet 1000000; a rank has"),
        (lambda x: True, r"the function of points of shape \(3, n\) must return n truth values"),
        ([-1] if COMM.rank == 0 else [], "there is no facet -1"),
    ]:
        with pytest.raises(InputError, match=message):
            domain_of(mesh, {"low": chosen})
    with pytest.raises(InputError, match=r"regions\['west'\]: must be an array of cell numbers"):
        domain_of(mesh, {}, {"west": None})
    with pytest.raises(InputError, match="start: must be a Solution or Segments, not str"):
        solve(domain, Diffusion(1.0, conditions=bottom), start="results")
    with pytest.raises(InputError, match="algorithm: unknown name 'alg5'; use one of alg1"):
        Options(algorithm="alg5")
    with pytest.raises(InputError, match="eps: must be greater than 0"):
        Options(eps=0.0)


def test_arguments_of_the_wrong_kind():
    """One sentence each, for scalar and elastic problems."""
    domain = domain_of(*square())
    pressed = Elasticity(1.0, 0.3, u_D=["0", "-0.1"], conditions=[Contact("bottom", gap=0.1)])
    scalar = Diffusion(f=1.0, conditions=[Signorini("bottom")])
    body, membrane = solve(domain, pressed), solve(domain, scalar)
    for call, message in [
        (lambda: certify(domain), "solution: must be a Solution, not Domain"),
        (lambda: compare(body, None), "solution: must be a Solution, not None"),
        (lambda: Options(algorithm=None), "algorithm: must be a string or Method or SetRule, not None"),
        (lambda: Options(backend=3), "backend: must be a string, not whole number; a function that makes"),
        (lambda: Options(eps=None), "eps: must be a number, not None"),
        (lambda: Options(max_iterations="3"), "max_iterations: must be a number, not string"),
        (lambda: solve(None, scalar), "domain: must be a Domain, not None"),
        (lambda: solve(domain, scalar, {"algorithm": "alg1"}), "options: must be an Options, not dict"),
        (lambda: solve(domain.mesh, pressed), "domain: must be a Domain, not Mesh"),
        (lambda: solve(domain, Wall("bottom", beta=1)), "must be a Diffusion, an Elasticity or a Stokes, not Wall"),
        (lambda: Solver(domain, scalar).solve(pressed), "problem: is of another physics"),
        (lambda: solve(domain, pressed, "alg1"), "options: must be an Options, not string"),
        (lambda: solve(domain, pressed, start=membrane), "start: problem is of another physics"),
        (lambda: domain_of(None, {}), "mesh: must be a Mesh, not None"),
        (lambda: domain_of(domain.mesh, ["bottom"]), "parts: must be a dict, not list; an example is"),
        (lambda: solve_case("hertz"), "case: must be a Case, not string; load_case reads one"),
        (lambda: write_solution(body, 3), "folder: must be a string or Path, not whole number"),
        (lambda: adapt(domain, lambda domain, start: None), "what `problem` returns: must be a Solution, not None"),
        (lambda: adapt(domain, lambda domain, start: body, theta=2), "theta: must be greater than 0 and at most 1"),
        (lambda: next(evolve(domain, scalar, None)), "evolution: must be an Evolution, not None"),
    ]:
        with pytest.raises(InputError, match=message):
            call()


def test_the_collector_is_off_in_all_that_is_collective(folder: Path):
    """Python's collector, which may free a mesh at a wrong moment, never runs in a call that ranks make together."""
    wrong: set[str] = set()

    def note(phase: str, info: Mapping[str, int]) -> None:
        names, frame = [], sys._getframe()
        while frame is not None:
            if frame.f_globals.get("__name__", "").startswith("signorini_fenicsx."):
                names.append(frame.f_code.co_qualname)
            frame = frame.f_back
        wrong.update(names[-1:])

    body = Elasticity(
        young=1.0, poisson=0.3, u_D=["0", "-0.3*y^2"], conditions=[Contact("bottom", 0.1), Neumann("right", 0)]
    )
    problem = Diffusion(f="-t", conditions=[Signorini("bottom"), Neumann("right", 0)])
    case, in_time = api.load_case("example1").with_values({"solve.h": 0.5}), Evolution(end=1.0, steps=2)
    mesh, parts = square(4)
    before, was_on = gc.get_threshold(), gc.isenabled()
    gc.set_threshold(5, 10**6, 10**6)
    gc.enable()
    gc.callbacks.append(note)
    try:
        domain = domain_of(mesh, parts)
        *_, instant = evolve(domain, problem, in_time)
        api.StepBounds().certify(instant)
        elastic = solve(domain, body)
        certify(elastic)
        solution, _ = api.adapt_case(case, max_cells=40)
        certify(solution)
        for each in (solution, elastic):
            write_solution(each, folder)
            load_solution(folder, COMM)
            compare(each, each)
            for call in (each.summary, each.norms, each.errors):
                call()
        for call in (solution.flux_through, solution.force, solution.free_boundary, solution.violation, solution.plot):
            call()
        solution.at([[0.5, 0.5]])
        solution.spaces.integrate(solution.u * ufl.dx)
        elastic.spaces.linear_multiplier(elastic.pressure)
    finally:
        gc.callbacks.remove(note)
        gc.set_threshold(*before)
        if not was_on:
            gc.disable()
    assert not wrong - {"collector_off", "collector_off_in_steps.<locals>.wrapped"}
