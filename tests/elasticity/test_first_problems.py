"""First problems of engineers: at rest, held by friction alone, slow sets, flat cells; and random ones."""

import dolfinx.mesh
import numpy as np
import pytest
from makers.bodies import examine
from makers.first import first_problem
from mpi4py import MPI

from signorini_fenicsx import (
    Contact,
    Coulomb,
    Dirichlet,
    Elasticity,
    Neumann,
    NumericalFailure,
    Options,
    Tresca,
    domain_of,
    solve,
)
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

COMM = MPI.COMM_WORLD
FRICTION = [None, Tresca(0.1), Coulomb(0.4)]


@pytest.mark.parametrize("friction", FRICTION, ids=["none", "Tresca", "Coulomb"])
@pytest.mark.parametrize("held", [True, False], ids=["held", "free"])
@pytest.mark.parallel([1, 3])
def test_at_rest(friction: Tresca | Coulomb | None, held: bool):
    """A body that touches its foundation on one half, without any load: σ = 0, found at once."""
    if not held and friction is None:
        pytest.skip("it can move rigidly")
    domain = build_domain(COMM, "square", 0.25, mesh="structured")
    clamp = [Dirichlet("left", ["0", "0"])] if held else [Dirichlet("top", ["0", "0"])]
    free = Neumann(["right", *(["top"] if held else ["left"])], ["0", "0"])
    conditions = [Contact("bottom", "max(0, x - 0.5)", friction=friction), *clamp, free]
    solution = solve(domain, Elasticity(1.0, 0.3, conditions=conditions))
    assert solution.norms()["sigma_L2"] < 1e-12
    assert len(solution.outcome.history) < 20


@pytest.mark.parametrize("friction", [Coulomb(0.1), Tresca(1e-5)], ids=["Coulomb", "Tresca"])
@pytest.mark.parallel([1, 3])
def test_a_block_that_rests_on_friction(friction: Tresca | Coulomb):
    """Half of the foundation falls away; sets on the way hold the block in no way, and cycle: descent ends that."""
    domain = build_domain(COMM, "[0, 40] x [0, 10]", 40 / 6, mesh="structured")
    below = Contact("bottom", "max(0, 0.0001*(x - 20))", friction=friction)
    load, free = Neumann("top", ["0", "-5e-5"]), Neumann(["left", "right"], ["0", "0"])
    solution = solve(domain, Elasticity(5.0, 0.2, f=["0", "-5e-8"], conditions=[below, load, free]))
    assert solution.resultants()["bottom"][:2] == pytest.approx([0, 40 * 5e-5 + 400 * 5e-8], abs=1e-12)
    assert "by descent on weak springs from iteration" in solution.outcome.reason


@pytest.mark.parametrize("tilt", [0, 30, -9])
@pytest.mark.parametrize("friction", FRICTION[:2], ids=["none", "Tresca"])
def test_a_start_without_contact(tilt: float, friction: Tresca | None):
    """Contact alone holds a body that its start has lifted: the stress is that of a cold start."""
    domain = build_domain(COMM, "square", 0.2, mesh="structured")
    lifted = [Neumann(["left", "right"], ["0", "0"]), Dirichlet("top", ["0", "0.1"])]
    below = Contact("bottom", "0.002*(1 - cos(20*x))", friction=friction)
    start = solve(domain, Elasticity(1.0, 0.3, conditions=[below, *lifted]))
    assert start.norms()["sigma_L2"] < 1e-12
    held = [Dirichlet("left", 0, components="x"), Neumann(["top", "right"], ["0", "0"])]
    pressed = Elasticity(1.0, 0.3, f=["0", f"-0.01*(1 + {tilt}*(x - 0.5))"], conditions=[below, *held])
    found, cold = solve(domain, pressed, start=start), solve(domain, pressed, Options(predict=False))
    np.testing.assert_allclose(found.sigma.x.array, cold.sigma.x.array, atol=1e-10)
    assert found.resultants()["bottom"][1] == pytest.approx(0.01, rel=1e-9)


def bent(options: Options | None = None) -> ElasticSolution:
    """A bimetal strip that heat lifts off a plane."""
    domain = build_domain(COMM, "[0, 50] x [0, 2]", 1.0, mesh="structured")
    strip = Elasticity(
        "210e3 if y < 1 else 70e3", 0.3, f=["0", "-0.01"], eigenstrain="12e-4 if y < 1 else 24e-4", plane="stress",
        conditions=[Contact("bottom"), Neumann(["top", "right"], ["0", "0"]), Dirichlet("left", 0, components="x")],
    )  # fmt: skip
    return solve(domain, strip, options)


def test_steady_progress_is_no_failure():
    """The set shrinks by few vertices in each of more than 50 iterations; a limit of the user is told with its key."""
    assert len(bent().outcome.history) > 60
    with pytest.raises(NumericalFailure, match=r"change after 9 iterations; solve\.max_iterations allows more"):
        bent(Options(max_iterations=9))


@pytest.mark.slow
def test_steady_progress_with_friction_in_space():
    """Heat bends a bar up; the edge of its contact moves by a cell in a step: more than 50 steps are allowed."""
    mesh = dolfinx.mesh.create_box(MPI.COMM_SELF, [(0, 0, 0), (40, 1, 1)], (40, 1, 1))
    parts = {
        "bottom": lambda x: np.isclose(x[2], 0),
        "left": lambda x: np.isclose(x[0], 0),
        "front": lambda x: np.isclose(x[1], 0),
        "free": lambda x: np.isclose(x[1:], 1).any(axis=0) | np.isclose(x[0], 40),
    }
    held = [Dirichlet("left", 0, components="x"), Dirichlet("front", 0, components="y")]
    conditions = [Contact("bottom", friction=Coulomb(0.2)), *held, Neumann("free", ["0", "0", "0"])]
    bar = Elasticity(1.0, 0.3, f=["0", "0", "-3e-8"], eigenstrain="12e-4*z", conditions=conditions)
    solution = solve(domain_of(mesh, parts), bar, Options(predict=False))
    assert len(solution.outcome.history) > 60


def test_a_flat_cell():
    """A tetrahedron with 1.5e-4 of its volume: the stress is corrected until its tractions are in balance."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 2, 2, 2)
    x, cells = mesh.geometry.x, mesh.geometry.dofmaps[0]
    middle = int(np.argmin(np.linalg.norm(x - 0.5, axis=1)))
    around = cells[(cells == middle).any(axis=1)]
    corners = np.array([cell[cell != middle] for cell in around])
    normals = np.cross(x[corners[:, 1]] - x[corners[:, 0]], x[corners[:, 2]] - x[corners[:, 0]])
    way = np.array([0.8, 0.5, 0.31])
    until = ((x[corners[:, 0]] - x[middle]) * normals).sum(axis=1) / (normals @ way)
    x[middle] += (1 - 1.5e-4) * until[until > 0].min() * way
    domain = domain_of(mesh, {"bottom": lambda y: np.isclose(y[2], 0), "left": lambda y: np.isclose(y[0], 0),
                              "rest": lambda y: ~(np.isclose(y[2], 0) | np.isclose(y[0], 0))})  # fmt: skip
    below = Contact("bottom")
    conditions = [below, Dirichlet("left", ["0", "0", "0"]), Neumann("rest", ["0", "0", "-1"])]
    assert solve(domain, Elasticity(7e4, 0.3, conditions=conditions)).kkt.tractions < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_random_first_problem(seed: int):
    """A few seeds of `scripts/random_runs.py first`, by default options: solved, or it is said why not."""
    (found,) = first_problem(seed)
    assert not found.wrong, found


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, *range(2, 150)))])
def test_random_problem(seed: int):
    """A few seeds of `scripts/random_runs.py elasticity`, which mixes all that elastic problems take."""
    row = examine("elasticity", seed, cells={2: 500, 3: 500})
    assert not row.wrong, row
    assert not row.ratio > 3, row
