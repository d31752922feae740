"""The bound where surfaces share no nodes: exact states, laws, finer solutions, quantities, tied, refusals, ranks."""

from collections.abc import Sequence
from pathlib import Path

import basix.ufl
import numpy as np
import pytest
from bodies_apart import two
from dolfinx import fem
from made_cases import refined
from mpi4py import MPI

from signorini_fenicsx.api import (
    Dirichlet,
    Domain,
    Elasticity,
    InputError,
    Neumann,
    Pair,
    Solution,
    Tied,
    Tresca,
    compare,
    domain_of_bodies,
    load_solution,
    solve,
)
from signorini_fenicsx.certificate.certify import bound_field
from signorini_fenicsx.discrete.linear_traces import opposite
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.physics.elasticity.bound.tied import lacking, pulled_open, tied_pairs
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.solve.residuals import energy_squares
from signorini_fenicsx.quantities.kinds import Energy, Force, Integral

COMM = MPI.COMM_SELF


def boxes(
    upper: float,
    lower: float,
    left: float = 0.0,
    height: float = 0.05,
    comm: MPI.Intracomm = COMM,
    pairs: Sequence[Sequence[str]] = (),
) -> Domain:
    """Two boxes with meshes of these sizes, the upper one from `left` on."""
    low = build_domain(comm, "[0, 1] x [-0.8, 0]", lower, mesh="structured")
    up = build_domain(comm, f"[{left}, 1] x [{height}, {height + 0.8}]", upper, mesh="structured")
    return domain_of_bodies({"up": up, "low": low}, pairs=pairs)


def pressed(domain: Domain, pair: Pair, young: float = 2.0) -> Solution:
    """The upper box is moved down and aside onto the lower one."""
    free = [f"{body}.{side}" for body in ("up", "low") for side in ("left", "right")]
    held = [Dirichlet("up.top", (0.01, -0.1)), Dirichlet("low.bottom", (0, 0))]
    return solve(domain, Elasticity({"up": 1.0, "low": young}, 0.3, conditions=[*held, Neumann(free), pair]))


@pytest.mark.parametrize(
    ("upper", "lower", "left", "law", "most"),
    [
        (0.27, 0.4, 0.0, Tresca(0.02), 1.5),
        (0.3, 0.4, 0.17, None, 4.0),
        (0.3, 0.4, 0.17, Tied(), 1.6),
    ],
)
def test_finer_solutions(upper: float, lower: float, left: float, law: Tresca | Tied | None, most: float) -> None:
    """The bound is above the distance to a finer solution, also where an edge is inside a master facet; not far."""
    pair = Pair("up.bottom", "low.top", law)
    domain = boxes(upper, lower, left)
    coarse, fine = (pressed(each, pair) for each in (domain, refined(domain, 1)))
    certificate = coarse.certify()
    assert certificate.guaranteed
    distance = compare(coarse, fine).norms.energy
    assert distance < certificate.sigma_bound < most * distance
    if isinstance(law, Tied):
        x = (np.arange(400) + 0.5) / 400
        held, top = fine.resultants()["low.bottom"][1], fine.at(np.column_stack([x, 0 * x])).u[:, 1].mean()
        for kind, known in ((Force("low.bottom", (0, 1)), held), (Integral(parts="low.top", direction=(0, 1)), top)):
            found = coarse.quantity(kind)
            assert found.guaranteed
            assert found.lower < known < found.upper
            assert found.width < 0.1 * abs(known)
        energy = coarse.quantity(Energy())
        assert energy.lower < fine.quantity(Energy()).middle < energy.upper
    elif left > 0:  # what is passed on counts where the edge is
        at = certificate.indicator.x.array.argmax()
        place = coarse.spaces.vertices[at].mean(axis=0)
        assert abs(place[0] - left) < lower


def test_exchange_of_slave_and_master() -> None:
    """Both solutions are in the sum of their bounds, and the intervals of quantities meet those on finer meshes."""
    domain = boxes(0.8, 0.5, height=0.0)
    sides = ("up.bottom", "low.top"), ("low.top", "up.bottom")
    one, other = (pressed(domain, Pair(*names)) for names in sides)
    assert compare_stresses(one, other) < one.certify().sigma_bound + other.certify().sigma_bound
    kinds = (Energy(), Force("up.bottom", (0, 1)), Integral(parts="low.top", direction=(0, 1)))
    fine = pressed(refined(domain, 1), Pair(*sides[0]))
    for kind in kinds:
        known = fine.quantity(kind)
        for solution in (one, other) if isinstance(kind, Energy) else (one,):
            found = solution.quantity(kind)
            assert found.guaranteed
            assert max(known.lower, found.lower) <= min(known.upper, found.upper)
            assert found.width < 0.05 * abs(known.value)
            assert known.width < found.width / 1.5


def compare_stresses(one: Solution, other: Solution) -> float:
    """‖σ − σ'‖ of two solutions on one mesh, E being 1 and 2."""
    difference = other.stresses - one.stresses
    return float(np.sqrt(energy_squares(one.spaces, one.data, difference).sum()))


def test_what_there_is() -> None:
    """A displacement of another program has bounds; refused are integrals over slaves, forces on masters and more."""
    domain = boxes(0.5, 0.5, height=0.0)
    tied, touching = (pressed(domain, Pair("up.bottom", "low.top", law)) for law in (Tied(), None))
    nothing = fem.Function(fem.functionspace(touching.spaces.mesh, ("P", 1, (2,))))
    found = bound_field(touching, nothing)  # as far from u as u is large
    assert found.lower < touching.norms()["energy"] < found.bound < 1.2 * found.lower
    with pytest.raises(InputError, match=r"not over slaves such as 'up.bottom'; take the master"):
        touching.quantity(Integral(parts="up.bottom", direction=(0, 1)))
    with pytest.raises(InputError, match=r"'low.top' is a master; the force on it is opposite to that on up.bottom"):
        touching.quantity(Force("low.top", direction=(0, 1)))
    with pytest.raises(InputError, match=r"'low.top' is tied"):
        tied.quantity(Force("low.top", direction=(0, 1)))


@pytest.mark.parametrize("end", [0.5, 0.3])
def test_tied_on_two_bodies(end: float) -> None:
    """Where two masters meet below a slave v cannot be the same on both sides, and there is no bound."""
    shapes = {"up": "[0, 1] x [0, 0.8]", "one": f"[0, {end}] x [-0.8, 0]", "other": f"[{end}, 1] x [-0.8, 0]"}
    bodies = {name: build_domain(COMM, shape, 0.7, mesh="structured") for name, shape in shapes.items()}
    free = ["up.left", "up.right", "one.left", "one.right", "other.left", "other.right"]
    held = [Dirichlet("up.top", (0, -0.1)), Dirichlet("one.bottom", 0), Dirichlet("other.bottom", (0.1, 0))]
    pair = Pair("up.bottom", ["one.top", "other.top"], Tied())
    certificate = solve(
        domain_of_bodies(bodies), Elasticity(1.0, 0.3, conditions=[*held, Neumann(free), pair])
    ).certify()
    assert not certificate.guaranteed
    assert "its masters are several bodies" in certificate.reservation + certificate.if_none


@pytest.mark.parallel(2)
def test_several_ranks(folder: Path) -> None:
    """The bound is that of one rank, also of a solution that is read; refinement keeps both sides on one rank."""
    pair, parts, world = Pair("up.bottom", "low.top", Tresca(0.02)), ("up.bottom", "low.top"), MPI.COMM_WORLD

    def solved(left: float, comm: MPI.Intracomm, pairs: Sequence[Sequence[str]] = (parts,)) -> Solution:
        return pressed(boxes(0.4, 0.27, left=left, comm=comm, pairs=pairs), pair)

    alone = world.bcast([solved(left, COMM).certify().bound for left in (0.17, 0.0)] if world.rank == 0 else [])
    solution = solved(0.17, world)
    write_solution(solution, folder, fields=False)
    read = load_solution(folder, world)
    for one, bound in zip((solution, read, solved(0.0, world)), (alone[0], *alone), strict=True):
        certificate = one.certify()
        assert certificate.guaranteed
        assert certificate.bound == pytest.approx(bound, rel=1e-10)
    for domain in (solution.spaces.domain, read.spaces.domain):
        halved = refined(domain, 1)
        assert halved.together == (parts,)
        sides = np.array([len(halved.facets[part]) for part in parts])
        assert any((world.allreduce(sides) == each).all() for each in world.allgather(sides))
    with pytest.raises(InputError, match=r"pairs: unknown part 'low.up'; there are up.left, "):
        boxes(0.5, 0.5, comm=world, pairs=[["up.bottom", "low.up"]])
    assert "give these parts as `pairs` where the domain is made" in solved(0.0, world, ()).certify().if_none


STEP = 1e-5
STRESS = np.array([[1.0, 0.5, -2.0], [0.5, 3.0, 0.7], [-2.0, 0.7, 5.0]])


def opened(x: np.ndarray) -> np.ndarray:
    """A displacement of the lower body that is quadratic, and 0 at the corners of its top."""
    a, b = x[..., 0] * (1 - x[..., 0]), x[..., 1] * (1 - x[..., 1])
    return np.stack([a + 0.3 * b, b - 0.5 * a, a + 2 * b], axis=-1)


def mean_square(corners: np.ndarray, ends: int, seed: int) -> float:
    """The mean of |ε(d)|² over a subcell, d(x) = s opened(x_e) where s is the sum of the first hats, by differences."""
    to_hats = np.linalg.inv(np.vstack([corners.T, np.ones(4)]))

    def d(x: np.ndarray) -> np.ndarray:
        hats = np.concatenate([x, np.ones((*x.shape[:-1], 1))], axis=-1) @ to_hats.T
        s = hats[..., :ends].sum(axis=-1, keepdims=True)
        return s * opened(hats[..., :ends] / s @ corners[:ends])

    shares = np.random.default_rng(seed).dirichlet(np.ones(4), 40_000)
    x = shares @ corners
    slopes = np.stack([(d(x + STEP * e) - d(x - STEP * e)) / (2 * STEP) for e in np.eye(3)], axis=-1)
    return float((((slopes + slopes.swapaxes(1, 2)) / 2) ** 2).sum(axis=(1, 2)).mean())


def lift_of(held: str = "") -> tuple[ElasticSpaces, np.ndarray, float, float]:
    """Two cubes that are tied, where the lower one is opened.

    Returns:
        Their spaces, ‖ε(d)‖² on cells, the largest jump left, and ∫ yn·d for a constant y.
    """
    domain = two(MPI.COMM_SELF, (1, 1, 1), (2, 2, 1), gap=0.05)
    free = [f"{body}{axis}{end}" for body in "ul" for axis in (0, 1) for end in (0, 1)]
    fixed = [Dirichlet(part, 0) for part in ("u21", "l20", held) if part]
    loose = Neumann([part for part in free if part != held])
    solution = solve(domain, Elasticity(1.0, 0.3, conditions=[*fixed, loose, Pair("u20", "l21", Tied())]))
    spaces, split = solution.spaces, solution.spaces.split
    element = basix.ufl.element("P", split.mesh.basix_cell(), 2, basix.LagrangeVariant.bernstein, shape=(3,))
    v = fem.Function(fem.functionspace(split.mesh, element))
    v.interpolate(lambda x: np.where(x[2] < 0.02, opened(x.T).T, 0.0))
    pairs = list(tied_pairs(spaces, split, v.function_space))
    squares, past = lacking(pairs, spaces, solution.data, v)
    with pytest.raises(InputError, match="none is there over 'u10', which meets a tied slave"):
        solution.quantity(Integral(parts="u10", direction=(0, 0, 1)))
    stresses = np.tile(STRESS, (len(spaces.order), 4, 4, 1, 1))
    return spaces, squares[:, 0], past, pulled_open(pairs, spaces, stresses, v)


def test_strain_of_the_lift() -> None:
    """‖ε(d)‖ on each cell is that of d by differences at random points; on what is given nothing may be lacking."""
    spaces, found, past, pulled = lift_of()
    assert past < 1e-12
    assert pulled == pytest.approx(-STRESS[2] @ [1.3, 0.5, 3.0] / 6)
    expected = np.zeros(len(found))
    for cell, vertices in enumerate(spaces.vertices):
        for facet in vertices[opposite(3)]:
            low, total, middle = np.abs(facet[:, 2] - 0.05) < 1e-9, 0.0, vertices.mean(axis=0)
            if low.sum() > 1:  # the facet of a slave, or an edge of one
                total = mean_square(np.vstack([facet[low], facet[~low], middle]), low.sum(), cell)
            expected[cell] += total * spaces.cell_measures[cell] / 4
    np.testing.assert_allclose(found, expected, rtol=0.03, atol=1e-12)
    assert np.count_nonzero(found) == 4
    assert lift_of("u00")[2] > 0.1
