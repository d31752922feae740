"""Friction in space: exact states, the law at each vertex, two bodies, bounds, files, pictures."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import ufl
from elastic import box, stress, two_boxes
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx import Tresca
from signorini_fenicsx.api import load_solution
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.contact.laws import Dirichlet, Friction, Neumann, Regulator
from signorini_fenicsx.forms.elasticity import strain
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.elasticity.bound.equilibrated import admissible_stress
from signorini_fenicsx.physics.elasticity.conditions import Contact, Coulomb, CoulombLaw
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, Elasticity, ElasticProblem, InputError
from signorini_fenicsx.physics.elasticity.show.pictures import PICTURES
from signorini_fenicsx.physics.elasticity.show.tables import STATES, ContactTable
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.pictures import space
from signorini_fenicsx.pictures.panels import DrawnSteps, Panel, Where
from signorini_fenicsx.pictures.scene import gathered_scene
from signorini_fenicsx.pictures.sheet import Sheet
from signorini_fenicsx.pictures.space import Space
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
SIDES = ["x0", "x1", "y0", "y1"]


def oblique(comm: MPI.Comm, law: Law, shear: float, slip: float) -> ElasticSolution:
    """A block under a pressure of 0.1 and a uniform shear along an oblique direction, ν = 0; it slips so far."""
    way = np.array([np.cos(0.7), np.sin(0.7)])
    u = [*(f"{w}*({slip} + {2 * shear}*z)" for w in way), "-0.1*z"]
    return solve(box(comm, 2, [0.0] * 3, [1.0] * 3), ElasticProblem(1.0, 0.0, u_D=u, exact=u, laws=[law]))


@pytest.mark.parametrize(
    "law",
    [Friction(["z0"], g=0.03), CoulombLaw(["z0"], 0.3), CoulombLaw(["z0"], 0.2, 0.01)],
    ids=["tresca", "coulomb", "adhesive"],
)
@pytest.mark.parallel([1, 3])
def test_oblique_slip_is_exact(law: Law):
    """In a uniform state of slip along an oblique direction the solution is exact, and the bound is rounding."""
    solution = oblique(COMM, law, 0.03, 0.1)
    errors = solution.errors()
    assert errors is not None
    assert max(errors["energy"], errors["u_L2"]) < 1e-10
    way = np.array([np.cos(0.7), np.sin(0.7), 0.0])
    np.testing.assert_allclose(
        solution.shear_vectors, np.broadcast_to(-0.03 * way, solution.shear_vectors.shape), atol=1e-10
    )
    np.testing.assert_allclose(
        solution.slip_vectors, np.broadcast_to(0.1 * way, solution.slip_vectors.shape), atol=1e-10
    )
    in_files = {field.name: field for field in solution.fields()["contact"]}
    for name, size in (("shear", -0.03), ("slip", 0.1)):  # for arrows in ParaView
        np.testing.assert_allclose(
            in_files[name].means().values, np.tile(size * way, (len(solution.slip), 1)), atol=1e-10
        )
    assert solution.friction_states()["slip"]["measure"] == pytest.approx(1.0)
    assert certify(solution).relative < 1e-6


def twisted(law: Law, options: Options | None = None) -> ElasticSolution:
    """A block that is pressed, tilted, pushed and twisted on a plane."""
    u = ["-0.1*(y - 0.4)", "0.1*(x - 0.5) + 0.01", "-0.05 + 0.03*x"]
    problem = ElasticProblem(1.0, 0.3, u_D={"z1": u}, gap="0.01*x", laws=[law])
    return solve(
        box(COMM, 2, [0.0] * 3, [1.0, 1.0, 0.5]),
        replace(problem, boundary=ElasticBoundary([], SIDES)),
        options or Options(),
    )


@cache
def rubbing() -> ElasticSolution:
    """That block with Coulomb's friction."""
    return twisted(CoulombLaw(["z0"], 1.0))


def check_law(solution: ElasticSolution) -> None:
    """|σ_t| ≤ g everywhere, and σ_t = −g u_t/|u_t| where u_t is not 0."""
    bound, slip, shear = solution.data.friction.bound, solution.slip_vectors, solution.shear_vectors
    size = np.linalg.norm(slip, axis=2)
    assert (np.linalg.norm(shear, axis=2) <= bound + 1e-12).all()
    slips = size > 1e-10
    np.testing.assert_allclose(
        shear[slips], -(bound / np.where(slips, size, 1.0))[slips, None] * slip[slips], atol=1e-12
    )


def test_the_law_holds_at_each_vertex():
    """Some vertices stick, others slip along many directions; Coulomb's bound is μ times the pressure."""
    solution = twisted(Friction(["z0"], g="0.02 + 0.02*x"))
    states = solution.friction_states()
    assert min(states["stick"]["vertices"], states["slip"]["vertices"]) > 0
    check_law(solution)
    solution = rubbing()
    assert min(each["vertices"] for each in solution.friction_states().values()) > 0
    check_law(solution)
    np.testing.assert_allclose(solution.data.friction.bound, solution.pressure, atol=1e-9)
    assert len(solution.outcome.history) <= 10


@pytest.mark.parallel([1, 3])
def test_few_linear_iterations(monkeypatch: pytest.MonkeyPatch):
    """By CG all of Coulomb's friction takes a few times the iterations of one solve; factors find the same."""
    iterations: list[int] = []
    solve_by = FacetSolver.solve

    def counted(self: FacetSolver, b: PETSc.Vec, x: PETSc.Vec) -> None:
        solve_by(self, b, x)
        iterations.append(self.ksp.getIterationNumber())

    monkeypatch.setattr(FacetSolver, "solve", counted)
    by_cg = twisted(CoulombLaw(["z0"], 1.0), Options(tuning=Tuning(direct_up_to=100)))
    assert by_cg.outcome.linear_solver.startswith("cg")
    assert sum(iterations) <= 15 * max(iterations)
    by_factors = rubbing()
    for name, norm in by_factors.norms().items():
        assert by_cg.norms()[name] == pytest.approx(norm, rel=1e-9)
    assert by_cg.bound_changes[-1] <= 1e-9


def test_few_steps():
    """A bar that slips at its edges, from the sets of a coarser mesh: ten steps or less, by factors and by CG.

    One method inside the other, for contact, slip and the bound, took 34 steps under Coulomb's law.
    """
    given = {"f": ["0", "0", "-0.3"], "g_N": {"z1": ["0.03", "0", "-0.1"]}, "u_D": {"x0": ["0"] * 3}}
    problem = ElasticProblem(1.0, 0.3, **given, gap=0.02, laws=[CoulombLaw(["z0"], 0.3)])
    boundary = ElasticBoundary([], ["x1", "y0", "y1", "z1"])

    def bar(factor: float) -> Domain:
        return box(COMM, max(round(4 / factor), 1), [0.0] * 3, [2.0, 1.0, 1.0])

    norms = []
    for direct_up_to in (None, 100):
        options = Options(tuning=Tuning(direct_up_to=direct_up_to))
        solution = solve(bar(1), replace(problem, boundary=boundary), options, remesh=bar)
        assert solution.outcome.linear_solver.startswith("cg") == (direct_up_to is not None)
        assert len(solution.outcome.history) <= 10
        check_law(solution)
        norms.append(solution.norms())
    assert norms[0] == pytest.approx(norms[1], rel=1e-9)


def test_bound_where_slip_turns():
    """u_t = d turns around a point, u = d + 2gz d/|d|, ν = 0: the bound is above the error, and how far."""
    errors, bounds = [], []
    for n in (1, 2):
        domain = box(COMM, n, [0.0] * 3, [1.0, 1.0, 1.0])
        x, y, z = ufl.SpatialCoordinate(domain.mesh)
        d = ufl.as_vector([-(y + 0.5), x + 0.5, 0])
        u = 0.1 * d + 0.06 * z * d / ufl.sqrt(ufl.dot(d, d)) - 0.1 * z * ufl.as_vector([0, 0, 1])
        f = -ufl.div(stress(strain(u), 1.0, 0.0))
        problem = Elasticity(1.0, 0.0, f=f, u_D=u, exact=u, conditions=[Contact("z0", friction=Tresca(g=0.03))])
        solution = solve(domain, problem)
        errors.append(solution.errors()["energy"])
        bounds.append(certify(solution).sigma_bound)
    assert errors[1] < errors[0] / 2
    assert bounds[1] < bounds[0] / 1.8
    assert errors[0] < bounds[0] < 3.2 * errors[0]
    assert errors[1] < bounds[1] < 3.9 * errors[1]


@pytest.mark.parallel([1, 3])
def test_two_bodies():
    """A body that is pushed over another one: the law holds between both, and forces balance."""
    u = ["0.08", "0.06", "-0.05"]
    problem = Elasticity(
        1.0,
        0.3,
        conditions=[
            Contact("fault", friction=Coulomb(0.3)),
            Dirichlet("top", u),
            Dirichlet("bottom", ["0"] * 3),
            Neumann(["left", "right", "front", "back"], 0),
        ],
    )
    solution = solve(two_boxes(COMM, 2, 3), problem)
    check_law(solution)
    assert COMM.allreduce(solution.slip.max(initial=0.0), MPI.MAX) > 1e-3
    assert solution.quantities()["balance"] < 1e-12
    assert np.isfinite(certify(solution).bound)


def test_pushed_away():
    """A block that friction alone holds rests under a small push; under a large one it slides, and that is told."""

    def pushed(push: float) -> ElasticSolution:
        load = [str(0.8 * push), str(0.6 * push), "-0.1"]
        problem = Elasticity(
            1.0, 0.3, conditions=[Contact("z0", friction=Coulomb(0.5)), Neumann("z1", load), Neumann(SIDES, 0)]
        )
        return solve(box(COMM, 1, [0.0] * 3, [1.0, 1.0, 0.25]), problem)

    solution = pushed(0.03)
    force = solution.resultants()["z0"][:3]
    assert force == pytest.approx([-0.024, -0.018, 0.1])
    with pytest.raises(InputError, match=r"the body slides away, .* no pressure with friction"):
        pushed(0.06)


def test_file(tmp_path: Path):
    """A solution that is written and read is the same, the directions of slip too."""
    solution = rubbing()
    solution.write(tmp_path / "out")
    again = load_solution(tmp_path / "out")
    assert again.friction_states() == solution.friction_states()
    np.testing.assert_allclose(np.sort(again.slip_vectors, axis=None), np.sort(solution.slip_vectors, axis=None))
    assert again.kkt.complementarity < 1e-10
    assert certify(again).bound == pytest.approx(certify(solution).bound, rel=1e-6)


def test_derivatives():
    """By the bound of a vertex that slips: the differences of two solutions."""
    solution, *sides = (oblique(COMM, Friction(["z0"], g=g), 0.03, 0.1) for g in (0.03, 0.03 + 1e-5, 0.03 - 1e-5))

    def work(of: ElasticSolution) -> ufl.Form:
        return ufl.inner(of.sigma, of.sigma) * ufl.dx(of.sigma.function_space.mesh)

    _, (gradient,) = solution.gradient(work(solution), ["law.0.g"])
    above, below = (each.spaces.integrate(work(each)) for each in sides)
    assert (above - below) / 2e-5 == pytest.approx(gradient, rel=1e-5)


def test_friction_beside_a_law_with_more_corners():
    """The bound takes the shear that the stress has; it took 0 where the law on another part has more corners."""
    laws = [CoulombLaw(["z0"], 0.3), Regulator(["x0"], k=1.0, g_low=-0.01, g_high=0.01)]
    problem = ElasticProblem(1.0, 0.3, u_D={"z1": ["0.05", "0.02", "-0.05"]}, gap={"z0": 0.0}, laws=laws)
    solution = solve(box(COMM, 2, [0.0] * 3, [1.0] * 3), replace(problem, boundary=ElasticBoundary([], SIDES[1:])))
    shear = solution.spaces.shear(solution.stresses)
    assert np.abs(shear).max() > 0.01
    np.testing.assert_allclose(admissible_stress(solution).shear.ravel(), shear, atol=1e-10)


def test_other_tractions_have_no_bound():
    """A stress whose tractions are not those of the sets is not admissible, whatever its residuals are."""
    solution = oblique(COMM, CoulombLaw(["z0"], 0.3), 0.03, 0.1)
    other = replace(solution.outcome.conditions, value=0.0)
    wrong = replace(solution, outcome=replace(solution.outcome, conditions=other))
    assert certify(solution).proved
    assert certify(wrong).bound == np.inf


BLOCKS = {
    4.0: (0.183, -0.086, 0.059, 0.078, -0.083),
    12.0: (-0.077, -0.051, 0.106, -0.002, 0.114),
}


@pytest.mark.parametrize("mu", BLOCKS)
def test_much_friction(mu: float):
    """Blocks that are twisted, pushed and tilted; Newton's method alone goes round and round."""
    a, b, c, d, e = BLOCKS[mu]
    u = [f"{a}*(y - 0.4) + {b}", f"{c}*(x - 0.5) + {d}", f"-0.05 + {e / 4}*x + {e / 6}*y"]
    problem = ElasticProblem(1.0, 0.3, u_D={"z1": u}, gap="0.01*x", laws=[CoulombLaw(["z0"], mu)])
    solution = solve(box(COMM, 2, [0.0] * 3, [1.0, 1.0, 0.5]), replace(problem, boundary=ElasticBoundary([], SIDES)))
    assert solution.bound_changes[-1] < 1e-9
    assert len(solution.outcome.history) < 40


def test_a_tool_that_nothing_holds_is_told():
    """A pushed tool that friction alone holds, and too little of it: one sentence, where a matrix is singular."""
    conditions = [
        Contact("y0", friction=Coulomb(0.05), force={"z": 0.3, "y": 0.02}),
        Contact("z0", friction=Coulomb(0.3)),
        Dirichlet("y1", ["0", "0", "0"]),
        Neumann(["x0", "x1", "z1"]),
    ]
    with pytest.raises(InputError, match=r"slides away, along .*, that is the tool on 'y0': .* no pressure with"):
        solve(box(COMM, 2, [0.0] * 3, [1.0] * 3), Elasticity(1.0, 0.3, conditions=conditions))


@cache
def turned_cube() -> ElasticSolution:
    """A cube that is turned on its foundation; beside it there is a wall without friction, which it does not touch."""
    top = Dirichlet("z1", ["-0.1*(y - 0.4)", "0.1*(x - 0.5) + 0.01", "-0.05 + 0.03*x"])
    conditions = [Contact("z0", friction=Coulomb(1.0)), Contact("y0", gap=0.2), Neumann(["x0", "x1", "y1"]), top]
    return solve(box(COMM, 2, [0.0] * 3, [1.0] * 3), Elasticity(1.0, 0.3, conditions=conditions))


@pytest.mark.parallel([1, 3])
def test_table_of_facets():
    """The rows of a facet have its number and area, so that the table gives the force; sticking is of means."""
    solution = turned_cube()
    table = solution.table().gathered(COMM)
    force, facets = solution.norms()["contact_force"], COMM.allreduce(len(solution.spaces.contact.facets))
    stick = STATES.index("stick")
    means = [float(size.max(initial=0.0)) for size in COMM.allgather(np.abs(solution.slip[solution.states == stick]))]
    if table is None:
        return
    columns = solution.columns(table)
    numbers, first = np.unique(columns["facet"], return_index=True)
    np.testing.assert_array_equal(numbers, np.arange(facets))
    assert np.all(np.diff(first) > 0)  # they are counted in the order of the rows, which is the same on any ranks
    rows = np.argsort(columns["facet"], kind="stable").reshape(-1, 3)
    corners = np.column_stack([columns[axis] for axis in "xyz"])[rows]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    np.testing.assert_allclose(columns["measure"][rows], areas[:, None] * [1, 1, 1])
    assert areas @ columns["pressure"][rows].mean(axis=1) == pytest.approx(force, rel=1e-12)
    assert max(means) < 1e-12 < 1e-4 < np.abs(table.slip[table.state == stick]).max()


@pytest.mark.parallel([1])
def test_pictures_over_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Pressure, shear and slip at three times, each on the facets of its step, on one scale."""
    drawn = []
    monkeypatch.setattr(Sheet, "save", lambda sheet, path: drawn.append((path.name, sheet)))
    monkeypatch.setattr(space, "PIXELS", 300)
    body = gathered_scene(turned_cube())
    assert body is not None
    whole = body.sites
    assert isinstance(whole, ContactTable)
    sliding = body.on_facets("sliding_vector")
    np.testing.assert_allclose(sliding[body.touching], body.on_facets("slip_vector")[body.touching], atol=1e-14)
    assert np.isnan(sliding[~body.touching]).all()
    shares = (0.1, 0.25, 0.5, 1.0)
    scaled = ("pressure", "shear", "slip", "shear_vector", "slip_vector")
    tables = [replace(whole, **{key: share * getattr(whole, key) for key in scaled}) for share in shares]
    rows = [{"t": share, "contact_force": share} for share in shares]
    PICTURES.in_time(tmp_path, body, DrawnSteps(shares, tables, rows, {}))
    assert [name for name, _ in drawn] == ["forces.png", "contact.png"]
    sheet = drawn[1][1]
    views = [axes for axes in sheet.axes if axes.get_title()]
    assert [axes.get_title().split(",")[1] for axes in views[:3]] == [" $t = 0.1$", " $t = 0.25$", " $t = 1$"]
    assert [axes.get_title().split()[0].strip(",") for axes in views[::3]] == ["pressure", "shear", "slip"]
    bars = [axes for axes in sheet.axes if axes not in views]
    limits = [axes.get_ylim() for axes in bars]
    assert len(bars) == 9
    assert all(limits[3 * row] == limits[3 * row + 1] == limits[3 * row + 2] for row in range(3))
    images = [axes.images[0].get_array() for axes in views]
    assert all(np.any(images[k] != images[k + 2]) for k in (0, 3, 6))


@pytest.mark.parallel([1])
def test_picture_of_shear_and_slip(monkeypatch: pytest.MonkeyPatch):
    """Shear and slip have panels with arrows, though there is another part without friction."""
    monkeypatch.setattr(space, "PIXELS", 300)
    body = gathered_scene(turned_cube())
    assert body is not None
    views_of = Space(body)
    sheet = views_of.sheet(PICTURES.files(body)["pressure"][1])
    views = {axes.get_title()[4:]: axes.images[0].get_array() for axes in sheet.axes if axes.get_title()}
    assert [title.split()[0] for title in views] == ["pressure", "pressure", "gap", "contact", "shear", "slip"]
    lengths = body.with_surface(table=replace(body.sites, gap=np.linalg.norm(body.sites.shear_vector, axis=1)))
    Space(lengths).draw(Panel("gap", Where.GAMMA), sheet, (0, 0), "lengths", views_of.views[0])
    axes = next(each for each in sheet.axes if each.get_title().startswith("lengths"))
    white = [
        np.mean(np.min(image, axis=2) == 255)
        for image in (axes.images[-1].get_array(), views[r"shear $|\sigma_t|$ on z0"])
    ]
    assert 0.001 < white[1] - white[0] < 0.1  # arrows


@pytest.mark.parallel([1])
def test_small_part_is_enlarged(monkeypatch: pytest.MonkeyPatch):
    """What is called small fills its panel, and the title tells."""
    body = gathered_scene(turned_cube())
    assert body is not None
    first = {name: rows[body.rows[0]] for name, rows in vars(body.sites).items()}
    facets = replace(body.facets, **{name: rows[:1] for name, rows in vars(body.facets).items()})
    few = body.with_surface(facets=facets, table=replace(body.sites, **first))
    shares = []
    for near in (0.25, 2.0):
        monkeypatch.setattr(space, "NEAR", near)
        sheet = Sheet([2.5], [2.5])
        Space(few).draw(Panel("pressure", Where.GAMMA), sheet, (0, 0), "pressure", Space(few).views[0])
        axes = sheet.axes[0]
        assert axes.get_title() == r"pressure on $\Gamma_C$" + ("" if near < 1 else ", enlarged")
        shares.append(np.mean(np.ptp(np.asarray(axes.images[0].get_array(), dtype=int), axis=2) > 50))
    assert shares[1] > 3 * shares[0] > 0
