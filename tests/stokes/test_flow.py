"""Viscous flow: exact solutions under any pressure, laws on the boundary, ranks, CG, space, what is refused."""

from pathlib import Path

import dolfinx.mesh
import numpy as np
import pytest
from elastic import box
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import json_text
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.contact.laws import Corners, Dirichlet, Neumann
from signorini_fenicsx.expressions.simplices import barycentric_gradients
from signorini_fenicsx.meshes.bodies import domain_of_bodies
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import other_side
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.elasticity.conditions import Contact, Tresca
from signorini_fenicsx.physics.elasticity.problem import Elasticity, Pressure
from signorini_fenicsx.physics.stokes.problem import Leak, Outflow, Slip, Stokes
from signorini_fenicsx.physics.stokes.show.readings import traces, velocities
from signorini_fenicsx.physics.stokes.solution import StokesSolution
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.evolving import evolve
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Solver, solve

COMM = MPI.COMM_WORLD
MU = 0.7


def channel(conditions: list, exact: list[str], *, n: int = 4, comm: MPI.Comm = COMM, dim: int = 2, **options):
    """A flow in a square or a cube of size 1."""
    domain = box(comm, n, [0.0] * dim, [1.0] * dim)
    return solve(domain, Stokes(MU, exact=exact, conditions=conditions), Options(**options))


def straight(pressure: float, *beside: object) -> list:
    """The conditions of a flow along x between two pressures."""
    ends = [Pressure("x0", pressure + 2 * MU), Pressure("x1", pressure)]
    return [*ends, *(Dirichlet(part, 0, components="t") for part in ("x0", "x1")), *beside]


def leaving(solver: Solver, found: StokesSolution) -> float:
    """The largest flow out of a cell, as a share of the largest through a facet (collective)."""
    backend = solver._system.kept.present
    x = backend.system.everywhere(backend._x.array_r) + found.data.lift
    return backend.system.means(x, backend.system.mean.grown)[1]


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("large", [0, 10**9])
def test_a_large_pressure_changes_nothing(large: int):
    """Poiseuille's flow is exact by both solvers, in a channel that no velocity drives, and no cell loses fluid."""
    for pressure, most in ((0.0, 1e-10), (1e6, 2e-9)):
        problem = Stokes(MU, exact=["y*(1 - y)", "0"], conditions=straight(pressure))
        solver = Solver(box(COMM, 4, [0.0, 0.0], [1.0, 1.0]), problem)
        found = solver.solve(problem, Options(tuning=Tuning(direct_up_to=large)))
        assert found.converged
        assert found.errors()["energy"] < most
        assert leaving(solver, found) < 1e-13


def sheared(shear: float) -> str:
    """The flow y(a − y) in a channel between pressures that differ by 2μ, with this σ_t on the wall y = 1."""
    return f"(2 + {shear / MU!r})*y - y^2"


def navier(g: float, beta: float, w: float) -> str:
    """That with σ_t = −g − β(u − w), where u = a − 1 > w at the wall, or with g and β for −g and β where it is less."""
    return sheared(-(g + beta * (1 - w)) / (1 + beta / MU))


SLIDING = [
    ("y*(1 - y)", Slip("y1", g=1.01 * MU)),
    (sheared(-0.3), Slip("y1", g=0.3)),
    ("y*(2 - y)", Slip("y1")),
    (navier(0.3, 0.5, 0.0), Slip("y1", g=0.3, beta=0.5)),
    (navier(0.0, 0.5, 0.1), Slip("y1", beta=0.5, velocity=[0.1, 7])),
    (navier(-0.3, 0.5, 2.0), Slip("y1", g=0.3, beta=0.5, velocity=["2*x + 2*(1 - x)", 0])),
    ("1.1*y - y^2", Slip("y1", g=5, beta=0.5, velocity=[0.1, 0])),
]


@pytest.mark.parametrize(("u", "wall"), SLIDING)
def test_a_threshold_of_slip(u: str, wall: Slip):
    """The shear at the wall is μu' = μ below its bound, and the bound above; without a bound the wall is smooth.

    Where it is more than its bound, it grows with the slip on a wall that may move along itself.
    """
    found = channel(straight(0.0, wall), [u, "0"], n=2)
    assert found.errors()["energy"] < 1e-9
    assert found.certify().bound < 1e-4


def test_a_wall_with_suction_and_friction():
    """What is sucked out through a wall with slip is u_n there, whatever σ_nn is, and σ_t keeps its threshold."""
    ends, domain = [Pressure("x0", 2 * MU), Pressure("x1", 0)], box(COMM, 2, [0.0, 0.0], [1.0, 1.0])
    for u, f, wall, more in (
        ([sheared(-0.3), "0.2"], None, Slip("y1", g=0.3, u_n=0.2), ends),
        ([f"{sheared(-0.38)} - 0.2*x^2", "0.4*x*y"], [2.4 * MU, 0], Slip("y1", g=0.1, u_n="0.4*x"), []),
    ):
        sides = Dirichlet(["x0", "x1"], u, components="t" if more else None)
        found = solve(domain, Stokes(MU, f=f, exact=u, u_D=u, conditions=[*more, sides, wall]))
        assert found.errors()["energy"] < 1e-9
        assert found.flows()["y1"] == pytest.approx(0.2)
        assert (found.spaces.contact.measure @ found.gap).sum() / 2 == pytest.approx(0.2)
        certificate = found.certify()
        assert certificate.guaranteed
        assert certificate.bound < 1e-7
    with pytest.raises(InputError, match="slip: u_n must be a polynomial of degree 3 at most"):
        solve(domain, Stokes(MU, conditions=[*ends, Slip("y1", u_n="exp(x)")]))


def test_slip_that_varies():
    """Navier's slip in a flow with σ_t = −βu_t on the upper wall, where u_t is sin(πx): order two."""
    c, errors = -1.0 / MU, []
    q, slope = f"(y - 1 + {c!r}*(y - 1)^2)", f"(1 + {2 * c!r}*(y - 1))"
    u = [f"sin(pi*x)*{slope}", f"-pi*cos(pi*x)*{q}"]
    f = [f"{MU}*pi^2*sin(pi*x)*{slope}", f"-{MU}*pi*cos(pi*x)*(pi^2*{q} - {2 * c!r})"]
    for n in (4, 8):
        problem = Stokes(MU, f=f, exact=u, u_D=u, conditions=[Slip("y1", beta=2.0)])
        errors.append(solve(box(COMM, n, [0.0, 0.0], [1.0, 1.0]), problem).errors()["energy"])
    assert errors[1] < 0.12
    assert errors[1] < 0.34 * errors[0]


@pytest.mark.parallel([1, 3])
def test_slip_in_space():
    """By CG, on a wall that moves obliquely, between two walls that are symmetric; σ_t is opposite to the slip."""
    wall = Slip("y1", g=0.3, beta=0.5, velocity=[0.05, 0, 0.02])
    ends = [Pressure("x0", 2 * MU), Pressure("x1", 0), Dirichlet(["x0", "x1"], 0, components="t")]
    sides = Dirichlet(["z0", "z1"], 0, components="n")
    for more, u in ((wall, None), (Slip("y1", g=0.3, beta=0.5), navier(0.3, 0.5, 0.0))):
        found = channel([*ends, sides, more], [u or "0", "0", "0"], n=2, dim=3, tuning=Tuning(direct_up_to=0))
        assert max(vars(found.kkt).values()) < 1e-9
        assert u is None or found.errors()["energy"] < 1e-9


def test_steps_in_time():
    """Pressures that grow and fall: the wall slips at t = 1 alone, as each step is a flow of its own; a run goes on."""
    ends = [Pressure("x0", f"{2 * MU}*(1 - abs(t - 1))"), Pressure("x1", 0), Slip("y1", g=0.6 * MU)]
    exact = ["(1.4*y - y^2 if t == 1 else (y - y^2)/2)", 0]
    problem = Stokes(MU, exact=exact, conditions=[*ends, Dirichlet(["x0", "x1"], 0, components="t")])
    domain, evolution = box(COMM, 2, [0.0, 0.0], [1.0, 1.0]), Evolution(end=1.5, steps=3)
    instants = list(evolve(domain, problem, evolution))
    assert [instant.solution.errors()["energy"] < 1e-9 for instant in instants] == [True] * 3
    assert [instant.solution.friction_states()["slip-"]["vertices"] for instant in instants] == [0, 4, 0]
    assert instants[1].solution.of_step()["x1_flow"] == pytest.approx(0.7 - 1 / 3)
    kept = instants[1].steps.kept(instants[1].solution)
    again = list(evolve(domain, problem, evolution, past=lambda steps: steps.again(2, lambda _, key: kept[key])))
    assert [instant.step for instant in again] == [3]
    assert again[0].solution.of_step() == pytest.approx(instants[2].solution.of_step(), abs=1e-10)
    with pytest.raises(InputError, match="steps of loads have no initial"):
        next(evolve(domain, problem, Evolution(end=1, steps=2, scheme="bdf2")))


def test_an_outlet_lets_poiseuille_out():
    """Under the pressure outside, whatever it is; a least velocity that is larger than that is refused by no one."""
    u = "y*(1 - y)"
    for pressure in (0.0, 1e6):
        found = channel([Dirichlet("x0", [u, 0]), Outflow("x1", pressure=pressure, tangential="held")], [u, "0"])
        assert found.errors()["energy"] < 2e-9


def test_flows_balance_and_their_field_has_no_divergence():
    """Past the cylinders of an array goes what Sangani and Acrivos have, and nothing is lost on the way."""
    found = solve_case(load_case("cylinders"))
    flows, at_facets = found.flows(), traces(found)
    assert flows["right"] == pytest.approx(1 / 24.83, rel=5e-3)
    assert sum(flows.values()) == pytest.approx(0.0, abs=1e-13)
    spaces = found.spaces
    least, most = np.full((2, spaces.dofs.max() + 1, 2, 2), [[[[np.inf]]], [[[-np.inf]]]])
    np.minimum.at(least, spaces.dofs, at_facets)
    np.maximum.at(most, spaces.dofs, at_facets)
    assert (most - least).max() < 1e-11  # both sides of a facet have one û
    v = velocities(found, at_facets)
    assert np.abs(np.einsum("nvi,nvi->n", v, barycentric_gradients(spaces.vertices))).max() < 1e-10
    part = spaces.part("cylinder")
    assert np.abs(at_facets[part.cells, part.local]).max() < 1e-13
    told = found.lines(found.summary())
    assert told["flow"].startswith("out of ")
    assert "largest" not in told


def test_the_drag_of_a_cylinder_between_walls():
    """A quarter of it is that of the benchmark of confined cylinders, less what the polygon leaves out."""
    drag = -4 * solve_case(load_case("confined_cylinder")).resultants()["cylinder"][0]
    assert drag == pytest.approx(132.36, rel=1e-3)


def test_a_report_has_the_words_of_flow():
    """Nothing is said of a contact pressure; the wall is closed where u_n = 0, and the numbers are those of its law."""
    found = channel([Dirichlet("x0", ["y*(1 - y)", 0]), Leak("y1", g=1.0)], ["0", "0"])
    summary = found.summary()
    law = summary["quantities"]["laws"]["y1"]
    assert law["sigma_nn"]["least"] == pytest.approx(-1)
    assert law["u_n"]["largest"] > 0
    assert summary["contact_measure"] == pytest.approx(summary["segments"]["y1"]["closed"]["measure"])
    text = " ".join([*found.lines(summary), *found.lines(summary).values(), json_text(summary)])
    assert "pressure at most" not in text
    assert "contact_force" not in text
    assert set(found.columns(found.table())["condition"]) <= {"open", "closed"}


def test_an_outlet_that_would_suck_is_closed_there():
    """A force that turns flow back at the plain outlet: there u_n = 0 and the fluid pulls, elsewhere σ_nn = 0."""
    domain, f = box(COMM, 8, [0.0, 0.0], [1.0, 1.0]), ["32*(0.5 - y)*x", "0"]
    inlet = Dirichlet("x0", ["y*(1 - y)", 0])
    plain = solve(domain, Stokes(MU, f=f, conditions=[inlet, Neumann("x1", 0)]))
    found = solve(domain, Stokes(MU, f=f, conditions=[inlet, Outflow("x1")]))
    spaces = plain.spaces
    u = spaces.displacement_values(plain.u)[:, :, 0]
    assert u.min() < -0.05
    assert found.converged
    assert found.gap.min() >= 0
    assert found.pressure.min() > -1e-12
    assert 0 < found.touching.sum() < found.touching.size
    flows = found.spaces.site_kinds["normal"].measure @ found.gap.ravel()
    assert flows == pytest.approx(1 / 6, rel=1e-12)  # what came in


@pytest.mark.parallel(2)
def test_a_wall_leaks_where_it_is_pressed_enough():
    """Fluid from the left leaves by the top, with −σ_nn at most g there, all that comes in."""
    conditions = [Dirichlet("x0", ["y*(1 - y)", 0]), Leak("y1", g=1.0)]
    found = channel(conditions, ["0", "0"])
    pressed, out, flows = found.pressure, found.gap, found.flows()
    assert found.converged
    assert flows["y1"] == pytest.approx(1 / 6)
    assert sum(flows.values()) == pytest.approx(0.0, abs=1e-12)
    assert COMM.allreduce(pressed.min(initial=0.0), MPI.MIN) == pytest.approx(-1.0)
    assert COMM.allreduce(float(found.spaces.site_kinds["normal"].measure @ out.ravel())) == pytest.approx(1 / 6)


def test_a_duct_in_space():
    """Couette's flow in a cube, its sides symmetric, is exact by CG."""
    sides = [Dirichlet(side, 0, components="n") for side in ("y0", "y1")]
    ends = [Dirichlet(end, ["z", 0, 0]) for end in ("x0", "x1")]
    lids = [Dirichlet("z1", [1, 0, 0]), Dirichlet("z0", 0)]
    for last in (Outflow("x1", tangential="held"), ends[1]):
        found = channel([*sides, *lids, ends[0], last], ["z", "0", "0"], n=2, dim=3, tuning=Tuning(direct_up_to=0))
        assert found.errors()["energy"] < 1e-9
        assert found.outcome.linear_solver == "cg+mg"
        assert any("up to a constant" in note for note in found.spaces.notices) == (last is ends[1])


@pytest.mark.parallel([1, 3])
def test_what_comes_in_has_to_go_out():
    """Into a closed box, out of one by a wall that closes, and below the least that has to leave."""
    inlet = Dirichlet("x0", ["y*(1 - y)", 0])
    for beside, told in ((Slip("x1"), "nothing lets"), (Outflow("x1", least=0.2), "0.2 to inf can leave")):
        with pytest.raises(InputError, match=f"0.166667 more comes in than goes out, and .*{told}"):
            channel([inlet, beside, Slip(["y0", "y1"])], ["0", "0"])


def test_walls_that_move():
    """Beside a law u_t may be given; of a wall with slip it is linear, and β a number that is not negative."""
    moved = [*straight(0.0), Dirichlet("y1", [1, 0], components="t"), Leak("y1", g=5)]
    found = channel(moved, ["y*(2 - y)", "0"], n=2)
    assert found.errors()["energy"] < 1e-9
    assert found.certify().bound < 1e-6
    for wall, told in (
        (Slip("y1", velocity=["x^2", 0]), "u_D.y1: the velocity of a wall with slip must be linear"),
        (Slip("y1", beta=-1), "slip on 'y1', beta: must not be negative"),
        (Slip("y1", beta="x"), "slip on 'y1', beta: must be a number"),
    ):
        with pytest.raises(InputError, match=told):
            channel(straight(0.0, wall), ["0", "0"], n=2)


def test_a_thin_plate_in_the_fluid():
    """On both sides u is what is given there, at rest or moving; the fluid pulls at both."""
    domain = build_domain(COMM, "slit", 0.5, mesh="unstructured")
    ends = [Dirichlet(["top", "bottom"], 0), Neumann(["left", "right"], 0)]
    for given in ([], [Dirichlet("slit", [0.5, 0])]):
        found = solve(domain, Stokes(MU, f=[1, 0], conditions=[*ends, *given]))
        for side in ("slit", other_side("slit")):
            part = found.spaces.part(side)
            u = traces(found)[part.cells, part.local]
            assert u == pytest.approx(np.broadcast_to([0.5 if given else 0.0, 0], u.shape), abs=1e-10)
        assert found.certify().guaranteed
    pulls = [found.resultants()[side][0] for side in ("slit", other_side("slit"))]
    assert pulls[0] == pytest.approx(pulls[1], rel=0.1)
    with pytest.raises(InputError, match="'slit' is inside the fluid, where it is a thin plate"):
        solve(domain, Stokes(MU, conditions=[Leak("slit", g=1)]))


@pytest.mark.parallel([1, 2])
def test_a_thin_plate_in_space():
    """It moves as the exact flow does there, so that the flow is exact, and its bound guaranteed."""
    u = ["z*(1 - z) + 0.3*y", "0.2*x", "0"]
    sides = [(f"{name}{end}", k, end) for k, name in enumerate("xyz") for end in (0, 1)]
    parts = {name: lambda x, k=k, end=end: np.isclose(x[k], end) for name, k, end in sides}
    parts["plate"] = lambda x: np.isclose(x[2], 0.5) & (x[0] < 0.6)
    domain = domain_of(dolfinx.mesh.create_unit_cube(COMM, 2, 2, 2), parts, inner=["plate"])
    found = solve(domain, Stokes(MU, f=[2 * MU, 0, 0], u_D=u, exact=u, conditions=[Dirichlet("plate", u)]))
    assert found.errors()["energy"] < 1e-9
    certificate = found.certify()
    assert certificate.guaranteed
    assert certificate.relative < 1e-7


ONE_WAY = [(Outflow("x1"), "lower"), (Corners("x1", [[0, 0]], 0, "vertical"), "higher")]


@pytest.mark.parametrize(("law", "told"), ONE_WAY)
def test_a_pressure_on_a_half_line(law: Law, told: str):
    """Nothing comes in, and nothing goes out by what only lets out, or by what only lets in."""
    found = channel([law], ["0", "0"], n=2)
    assert found.errors()["u_L2"] < 1e-12
    assert [told in note for note in found.spaces.notices] == [True]


@pytest.mark.parametrize("large", [0, 10**9])
def test_a_viscosity_that_jumps(large: int):
    """A thin fluid pushes a thick one: its pressure is far above its viscosity, and nothing is lost all the same."""
    problem = Stokes("1 if x < 0.5 else 1e6", conditions=[Dirichlet("x0", ["y*(1 - y)", 0]), Outflow("x1")])
    solver = Solver(box(COMM, 4, [0.0, 0.0], [1.0, 1.0]), problem)
    found = solver.solve(problem, Options(tuning=Tuning(direct_up_to=large)))
    assert found.converged
    assert leaving(solver, found) < 1e-10
    assert found.flows()["x1"] == pytest.approx(1 / 6, rel=1e-9)
    assert found.certify().guaranteed


def test_several_bodies_of_fluid():
    """Each has its own balance, and words for where it is."""
    boxes = {name: box(COMM, 2, [x, 0.0], [x + 1.0, 1.0]) for name, x in (("left", 0.0), ("right", 3.0))}
    domain = domain_of_bodies(boxes)
    inlet = Dirichlet("right.x0", ["y*(1 - y)", 0])
    with pytest.raises(InputError, match=r"goes out of the fluid around \(3.5, 0.5\), and nothing"):
        solve(domain, Stokes(MU, conditions=[inlet]))
    found = solve(domain, Stokes(MU, conditions=[inlet, Outflow("right.x1")]))
    assert [note.partition(":")[0] for note in found.spaces.notices if "u_n" in note] == [
        "u_n is known on the whole boundary of the fluid around (0.5, 0.5)"
    ]


def test_the_order_at_a_transition():
    """Where a wall begins to leak u is like r^(3/2): errors are 0.12 to 0.14 n^(-3/2), wherever in a facet that is.

    The bound is near the error, and guaranteed, as no root in u_D is of 0.
    """
    for n in (6, 12):
        case = load_case("filter").with_values({"geometry.mesh": "structured", "solve.h": 1.0001 * 2**0.5 / n})
        found = solve_case(case)
        errors = found.errors()
        if n == 6:
            certificate = certify(found)
            assert certificate.guaranteed
            assert 1 < certificate.bound / errors["energy"] < 1.35
        assert 0.12 < errors["energy"] * n**1.5 < 0.14
        assert 0.12 < errors["p_L2"] * n**1.5 < 0.14


def test_sections_of_other_physics_are_refused(tmp_path: Path):
    """The sentence says which ones have them."""
    text = 'physics = "stokes"\n[geometry]\nshape = "square"\n[problem]\nviscosity = 1\n'
    for section, others in (("[[pair]]", "diffusion and elasticity"), ("[dam]", "diffusion")):
        (tmp_path / "case.toml").write_text(f"{text}{section}\n")
        with pytest.raises(InputError, match=f"is of {others}; stokes has none"):
            load_case(tmp_path / "case.toml")


def test_bodies_have_them_as_well():
    """A block that is pulled off a hook, and one that slides along a wall with friction."""
    domain = box(COMM, 4, [0.0, 0.0], [1.0, 1.0])
    sides = [Dirichlet("x0", 0, components="n"), Dirichlet("x1", 0, components="n")]
    hook = Contact("y0", gap=0.01, behind=True)
    pulled = solve(domain, Elasticity(1, 0.3, conditions=[*sides, hook, Neumann("y1", [0, 0.2])]))
    assert pulled.converged
    assert pulled.gap == pytest.approx(0.0, abs=1e-12)
    assert pulled.pressure == pytest.approx(0.2)
    assert pulled.u.x.array[1::2].min() == pytest.approx(0.01)
    wall = [Contact("y0", friction=Tresca(0.005)), Dirichlet("y0", 0, components="n"), Dirichlet("x0", 0)]
    found = solve(domain, Elasticity(1, 0.3, conditions=[*wall, Neumann("y1", [0.3, 0.1])]))
    assert found.converged
    assert (found.pressure < 0).any()  # the wall holds the block
    assert np.abs(found.shear).max() == pytest.approx(0.005)
