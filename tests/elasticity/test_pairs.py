"""Bodies with meshes of their own: exact patch tests, any ranks, a matching mesh as a limit, refusals."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest
from bodies_apart import apart, box_cells, joined, two
from mpi4py import MPI

from signorini_fenicsx.api import (
    Contact,
    Coulomb,
    Dirichlet,
    Elasticity,
    Evolution,
    InputError,
    Neumann,
    Options,
    Pair,
    Pressure,
    Solution,
    Support,
    Tied,
    Tresca,
    Wall,
    certify,
    evolve,
    solve,
)
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import distribute
from signorini_fenicsx.physics.elasticity.solve.residuals import energy_squares

LAWS = [None, Tresca(0.2), Coulomb(0.3), Tied(), Wall((), beta=5.0)]


def pressed(domain: Any, dim: int, pair: Pair, load: Sequence[Any] = ()) -> Solution:
    """The upper of two boxes is pressed by 1 on the lower one."""
    last, axes = dim - 1, "xyz"
    sides = [Dirichlet([f"u{k}0", f"l{k}0"], 0, components=axes[k]) for k in range(last)]
    free = [Neumann([f"u{k}1", f"l{k}1"]) for k in range(last)]
    held = Dirichlet(f"l{last}0", 0, components=axes[last])
    return solve(
        domain,
        Elasticity(
            young=1, poisson=0.3, conditions=[*sides, *free, held, pair, *(load or [Pressure(f"u{last}1", 1.0)])]
        ),
    )


def largest(solution: Solution, values: np.ndarray) -> float:
    """The largest |values| over all ranks."""
    return float(solution.spaces.mesh.comm.allreduce(float(np.abs(values).max(initial=0.0)), MPI.MAX))


@pytest.mark.parametrize(
    ("upper", "lower", "law"),
    [
        *(((3, 2), (2, 3), law) for law in LAWS),
        ((1, 1, 1), (2, 1, 1), Coulomb(0.3)),
        ((1, 1, 1), (2, 1, 1), Tied()),
    ],
)
def test_uniform_pressure(upper: tuple[int, ...], lower: tuple[int, ...], law: Any) -> None:
    """A uniform stress passes from one body to the other, apart or not, under any law; so says the bound."""
    dim = len(upper)
    gap = 0.25 if law is None or isinstance(law, Wall) else 0.0
    domain = two(MPI.COMM_SELF, upper, lower, gap=gap)
    solution = pressed(domain, dim, Pair(f"u{dim - 1}0", f"l{dim - 1}1", law))
    exact = np.zeros((dim, dim))
    exact[-1, -1] = -1.0
    assert largest(solution, solution.stresses - exact) < 1e-12
    certificate = certify(solution)
    assert certificate.proved
    assert certificate.relative < 1e-6


@pytest.mark.parametrize("gap", [0.1, "0.1", "distance - 0.15"])
def test_a_given_gap(gap: Any) -> None:
    """A gap in the place of the distance, or more than it."""
    domain = two(MPI.COMM_WORLD, (3, 2), (4, 2), gap=0.25)
    solution = pressed(domain, 2, Pair("u10", "l11", None, gap=gap))
    u = solution.spaces.displacement_values(solution.u)
    assert abs(u[..., 1].min() - (-0.1 - 2 * 0.91)) < 1e-12


def test_no_pair_of_parts_without_a_facet_opposite() -> None:
    """Bodies too far from each other, a part on both sides, and laws that there are not."""
    domain = two(MPI.COMM_WORLD, (3, 2), (2, 3), gap=0.25)
    with pytest.raises(InputError, match="no facet of the slave is covered"):
        pressed(domain, 2, Pair("u10", "l11", within=0.2))
    with pytest.raises(InputError, match="is slave and master"):
        Pair("u10", ["u10", "l11"])
    with pytest.raises(InputError, match="distance"):
        Pair("u10", "l11", gap="2*distance")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"slave": []}, "slave must not be empty"),
        ({"master": [1]}, "unknown part '1'"),
        ({"within": float("nan")}, "within is nan"),
        ({"direction": [0, -1j]}, "use normal or a vector"),
        ({"law": Coulomb}, "law: must be a Tresca"),
        ({"law": Coulomb("x - 5")}, "pair.0.mu: must be finite and not negative"),
    ],
)
def test_wrong_pairs_of_python(given: dict[str, Any], words: str) -> None:
    """One sentence each; numbers of NumPy are numbers, and the length of a direction does not matter."""
    domain = two(MPI.COMM_SELF, (3, 2), (2, 3))
    with pytest.raises(InputError, match=words):
        pressed(domain, 2, Pair(**({"slave": "u10", "master": "l11"} | given)))
    pair = Pair("u10", "l11", within=np.float32(1), direction=np.array([0.0, -1e-300]))
    assert pair.on_boundary.within == 1.0
    assert pair.on_boundary.direction == [0.0, -1.0]


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(
    ("law", "upper", "lower"),
    [
        (None, (6, 4), (9, 5)),
        (Tied(), (6, 4), (9, 5)),
        (Coulomb(0.3), (3, 2, 2), (4, 3, 2)),
        pytest.param(Coulomb(0.3), (6, 4), (9, 5), marks=pytest.mark.slow),
        pytest.param(Tied(), (3, 2, 2), (4, 3, 2), marks=pytest.mark.slow),
    ],
)
def test_multigrid_as_a_factorisation(law: Any, upper: tuple[int, ...], lower: tuple[int, ...]) -> None:
    """Shear and an uneven pressure: CG with multigrid finds what a factorisation does, and forces balance."""
    dim, found = len(upper), []
    domain = two(MPI.COMM_WORLD, upper, lower, gap=0.05)
    last = dim - 1
    sides = [f"{body}{axis}{end}" for body in "ul" for axis in range(last) for end in (0, 1)]
    moved = Dirichlet(f"u{last}1", [*["0.02"] * last, "-0.1 - 0.05*x"])
    conditions = [Neumann(sides), Dirichlet(f"l{last}0", 0), moved, Pair(f"u{last}0", f"l{last}1", law)]
    for size in (10**9, 0):
        problem = Elasticity(young=1, poisson=0.3, conditions=conditions)
        found.append(solve(domain, problem, Options(tuning=Tuning(direct_up_to=size))))
    assert (found[0].outcome.linear_solver, found[1].outcome.linear_solver) == ("preonly+cholesky+mumps", "cg+mg")
    assert found[1].norms() == pytest.approx(found[0].norms(), rel=1e-9)
    resultants = found[1].resultants()
    sums = np.array(resultants[f"u{last}0"]) + np.array(resultants[f"l{last}1"])
    np.testing.assert_allclose(sums[:dim], 0.0, atol=1e-9)


@pytest.mark.parametrize("law", [None, Tresca(0.01)])
def test_a_matching_mesh_as_one_cut_inside(law: Any) -> None:
    """Where both surfaces have the same facets a pair is what a part inside the domain is, to rounding."""
    pair = two(MPI.COMM_SELF, (4, 3), (4, 3))
    sides = [Neumann([f"{body}0{end}" for body in "ul" for end in (0, 1)]), Neumann(["x0", "x1"])]
    others = [Dirichlet("l10", 0), Dirichlet("u11", ["0.02", "-0.1 + 0.15*x"])]
    cases = [(pair, sides[0], Pair("u10", "l11", law)), (joined((4, 3)), sides[1], Contact("u10", friction=law))]
    found = []
    for domain, free, meeting in cases:
        found.append(solve(domain, Elasticity(young=1, poisson=0.3, conditions=[*others, free, meeting])))
    assert 0 < found[0].contact[0] < 4
    assert found[0].norms() == pytest.approx(found[1].norms(), rel=1e-12)
    assert found[0].contact == pytest.approx(found[1].contact, rel=1e-12)
    assert certify(found[0]).bound == pytest.approx(certify(found[1]).bound, rel=1e-3)


@pytest.mark.parametrize("direction", ["normal", [0.0, -1.0]])
@pytest.mark.parametrize("shear", [0.0, 0.4])
def test_hydrostatic_pressure_on_a_slanted_interface(shear: float, direction: Any) -> None:
    """A hydrostatic stress passes a slanted interface along any direction: the law is one along the normal."""
    domain = two(MPI.COMM_SELF, (5, 3), (7, 2), shear=shear)
    strain = 1.3 * 0.4  # (1 + ν)(1 − 2ν)/E
    names = [
        f"{body}{part}" for body, parts in (("u", ("00", "01", "11")), ("l", ("00", "01", "10"))) for part in parts
    ]
    given = Dirichlet(names, [f"-{strain}*x", f"-{strain}*y"])
    pair = Pair("u10", "l11", direction=direction, within=0.3)
    solution = solve(domain, Elasticity(young=1, poisson=0.3, conditions=[given, pair]))
    covered = np.concatenate([pair.covered for pair in solution.spaces.pairs])
    np.testing.assert_allclose(covered, 1.0, atol=1e-12)
    np.testing.assert_allclose(solution.stresses, np.broadcast_to(-np.eye(2), solution.stresses.shape), atol=1e-12)


def test_what_is_in_no_pair_stays_refused() -> None:
    """Bodies that lie on one another, or overlap, unless they are paired."""
    held = [Dirichlet(["u00", "u01", "u11", "l00", "l01", "l10"], 0)]
    others = [Neumann("l11"), Contact("u10")]
    for gap, words in ((0.0, "lie on one another.*Pair"), (-0.05, "two bodies overlap.*Pair")):
        domain = two(MPI.COMM_SELF, (3, 2), (2, 3), gap=gap)
        with pytest.raises(InputError, match=words):
            solve(domain, Elasticity(young=1, poisson=0.3, conditions=[*held, *others]))
        pair = Pair("u10", "l11")
        solution = solve(domain, Elasticity(young=1, poisson=0.3, conditions=[*held, pair]))
        assert solution.contact[0] == 3 or gap == 0


def test_steps_a_tool_and_springs_beside_a_pair() -> None:
    """A body that only a pair, springs and a tool under a force hold, in steps: what slips is carried on."""
    domain = two(MPI.COMM_SELF, (5, 3), (4, 3))
    conditions = [
        Dirichlet("l10", 0),
        Neumann(["l00", "l01", "u01"]),
        Support("u00", [0.01, 0.0]),
        Contact("u11", force={"y": "-0.1*t"}),
        Pair("u10", "l11", Coulomb(0.2)),
    ]
    problem = Elasticity(young=1, poisson=0.3, conditions=conditions)
    *_, last = evolve(domain, problem, Evolution(1.0, 2))
    forces = last.solution.resultants()
    assert forces["u11"][1] == pytest.approx(-0.1, rel=1e-9)
    assert forces["u10"][1] == pytest.approx(0.1, rel=1e-9)
    assert forces["l11"][1] == pytest.approx(-0.1, rel=1e-9)


def test_errors_of_stresses_are_those_of_matching_meshes() -> None:
    """Random loads, ratios and laws: the error to a fine mesh is that of matching meshes, each body with its own."""
    rng = np.random.default_rng(3)
    points = rng.uniform([0.02, -0.98], [0.98, 0.98], (1000, 2))
    free = [Neumann([f"{body}0{end}" for body in "ul" for end in (0, 1)]), Neumann(["x0", "x1"])]
    for _ in range(2):
        (n, m), below, tilt, push = rng.integers(3, 9, 2), *rng.uniform([-0.2, -0.2, 0], [-0.02, 0.2, 0.05])
        law = Tresca(rng.uniform(0.002, 0.05))
        held = [Dirichlet("l10", 0), Dirichlet("u11", [f"{push}", f"{below} + {tilt}*x"])]

        def stress(domain: Any, sides: Neumann, meeting: Any, held: Sequence[Dirichlet] = held) -> np.ndarray:
            conditions = [sides, *held, meeting]
            return np.asarray(solve(domain, Elasticity(young=1, poisson=0.3, conditions=conditions)).at(points).sigma)

        fine = stress(joined((20, 20)), free[1], Contact("u10", friction=law))
        found, of_upper, of_lower = (
            ((stress(two(MPI.COMM_SELF, (i, i), (j, j)), free[0], Pair("u10", "l11", law)) - fine) ** 2).sum(
                axis=(1, 2)
            )
            for i, j in ((n, m), (n, n), (m, m))
        )
        matching = np.where(points[:, 1] > 0, of_upper, of_lower)
        assert np.sqrt(found.sum() / matching.sum()) < 1.05


def test_a_body_against_itself() -> None:
    """A block whose slot closes, with other facets on both edges; exchanged, they differ by less than both bounds."""
    boxes = [((0, 0), (2, 0.4), (4, 2)), ((0, 0.6), (2, 1), (4, 2)), ((0, 0.4), (0.5, 0.6), (1, 1))]
    bodies = [box_cells(numbers, low, high, seed=1) for low, high, numbers in boxes]
    x = bodies[1][0][:, 0]
    x[x > 0.5] = 0.5 + 1.5 * ((x[x > 0.5] - 0.5) / 1.5) ** 1.3
    points, number = np.unique(np.round(np.concatenate([x for x, _ in bodies]), 12), axis=0, return_inverse=True)
    firsts = np.cumsum([0, *(len(x) for x, _ in bodies)])
    cells = number.ravel()[np.concatenate([t + first for (_, t), first in zip(bodies, firsts, strict=False)])]
    parts = {"bottom": 0.0, "below": 0.4, "above": 0.6, "top": 1.0}
    chosen = {
        name: partial(on_edge, place, 0.5 if name in ("below", "above") else 0.0) for name, place in parts.items()
    }
    ends = {f"x{k}": partial(on_plane, 0, 2.0 * k) for k in (0, 1)}
    domain, found = domain_of(distribute(MPI.COMM_SELF, points, cells, 2), {**chosen, **ends}), []
    given = [Dirichlet("bottom", 0), Dirichlet("top", ["0", "-0.1 - 0.12*x"]), Neumann("x1")]
    for slave, master in (("below", "above"), ("above", "below")):
        problem = Elasticity(young=1, poisson=0.3, conditions=[*given, Neumann("x0"), Pair(slave, master)])
        found.append(solve(domain, problem))
        below, above = (np.array(found[-1].resultants()[part]) for part in ("below", "above"))
        np.testing.assert_allclose(below[:2] + above[:2], 0, atol=1e-12)
        assert below[1] < -1e-3
    off = np.sqrt(energy_squares(found[0].spaces, found[0].data, found[0].stresses - found[1].stresses).sum())
    assert 0 < off <= sum(certify(solution).bound for solution in found) < np.inf


def on_edge(place: float, begin: float, x: np.ndarray) -> np.ndarray:
    """Whether points have this height, from some x on."""
    return np.isclose(x[1], place) & (x[0] > begin - 1e-9)


def test_two_pairs_on_one_master() -> None:
    """Two blocks press on one side of a third one: two pairs are what one pair with two slaves is.

    The bound of two is a little larger: what the master facet lacks counts for each pair alone.
    """
    places = {"a": ([0.0, 0.0], [0.45, 0.5]), "b": ([0.55, 0.0], [1.0, 0.5]), "c": ([0.0, -1.0], [1.0, 0.0])}
    numbers = {"a": (2, 2), "b": (3, 2), "c": (3, 3)}
    bodies = {name: box_cells(numbers[name], *ends, seed=1) for name, ends in places.items()}
    parts = {
        f"{name}{axis}{end}": (name, partial(on_plane, axis, ends[end][axis]))
        for name, ends in places.items()
        for axis in (0, 1)
        for end in (0, 1)
    }
    domain, found = apart(MPI.COMM_SELF, bodies, parts), []
    sides = Neumann([f"{name}0{end}" for name in "abc" for end in (0, 1)])
    others = [sides, Dirichlet("c10", 0), Dirichlet("a11", [0.01, -0.1]), Dirichlet("b11", [0.02, -0.05])]
    for pairs in ([("a10", "c11"), ("b10", "c11")], [(["a10", "b10"], "c11")]):
        conditions = [*others, *(Pair(slave, master, Tresca(0.05)) for slave, master in pairs)]
        found.append(solve(domain, Elasticity(young=1, poisson=0.3, conditions=conditions)))
    assert found[0].norms() == pytest.approx(found[1].norms(), rel=1e-12)
    assert 1 <= certify(found[0]).bound / certify(found[1]).bound < 1.05
    with pytest.raises(InputError, match="two conditions"):
        Elasticity(young=1, poisson=0.3, conditions=[Pair("a10", "c11"), Pair("c11", "b10")])


@pytest.mark.parametrize(
    ("dim", "numbers", "slope", "friction", "way"),
    [(2, 4, 0.35, (0.2, 0.4), 1), (2, 3, 0.35, (0.2, 0.4), -1), (3, 2, 0.2, (0.3, 0.15), 1)],
)
def test_a_wedge(dim: int, numbers: int, slope: float, friction: tuple[float, float], way: int) -> None:
    """A wedge is driven below a block, or out again: the force of statics, W (tan(φ ± α) + μ), both pairs sliding."""
    beside, height = [0.0] * (dim - 2), lambda x: 0.5 + slope * x[0]
    boxes = {
        "floor": box_cells([numbers + 2, *[1] * (dim - 1)], [-0.5, *beside, -1.0], [1.5, *[1.0] * (dim - 2), 0.0], 3),
        "wedge": box_cells([numbers + 1, *[2] * (dim - 2), 1], [0.0] * dim, [1.0] * dim, 4),
        "block": box_cells([numbers, *[1] * (dim - 2), 2], [0.1, *beside, 0.0], [0.9] + [1.0] * (dim - 1), 5),
    }
    for name in ("wedge", "block"):
        x = boxes[name][0]
        x[:, -1] = height(x.T) * x[:, -1] if name == "wedge" else height(x.T) + (2 - height(x.T)) * x[:, -1]
    places = {"ground": ("floor", -1, -1.0), "table": ("floor", -1, 0.0), "foot": ("wedge", -1, 0.0)}
    places |= {"back": ("wedge", 0, 1.0), "lid": ("block", -1, 2.0)}
    places |= {"west": ("block", 0, 0.1), "east": ("block", 0, 0.9)}
    free = {"a": ("floor", 0, -0.5), "b": ("floor", 0, 1.5), "c": ("wedge", 0, 0.0)}
    sides = {f"{name}{end}": (name, 1, float(end)) for name in boxes for end in (0, 1)} if dim == 3 else {}
    parts: dict[str, Any] = {
        name: (body, lambda x, axis=axis, at=at: np.isclose(x[:dim][axis], at))
        for name, (body, axis, at) in (places | free | sides).items()
    }
    parts |= {name: (name, lambda x: np.isclose(x[dim - 1], height(x))) for name in ("wedge", "block")}
    held = [Dirichlet("ground", 0), Dirichlet("back", [-0.5 * way, *[0] * (dim - 1)], components="x")]
    held += [Dirichlet(["west", "east"], 0, components="x"), *([Dirichlet([*sides], 0, components="y")] * (dim - 2))]
    above, below = Pair("block", "wedge", Coulomb(friction[0])), Pair("foot", "table", Coulomb(friction[1]))
    conditions = [*held, Neumann([*free]), Pressure("lid", 0.01), above, below]
    solution = solve(apart(MPI.COMM_SELF, boxes, parts), Elasticity(young=1, poisson=0.3, conditions=conditions))
    force = -way * solution.resultants()["back"][0]
    statics = 0.008 * (np.tan(np.arctan(friction[0]) + way * np.arctan(slope)) + friction[1])
    assert force == pytest.approx(statics, rel=1e-11 if dim == 2 else 1e-5)
    assert solution.friction_states()["stick"]["vertices"] == 0


def on_plane(axis: int, place: float, x: np.ndarray) -> np.ndarray:
    """Whether a coordinate of points has a value."""
    return np.isclose(x[axis], place)
