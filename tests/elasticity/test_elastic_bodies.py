"""Elastic bodies that touch: patch tests, a crack, a stack, sides, wrong files."""

import json
from pathlib import Path
from typing import Any

import dolfinx.mesh
import numpy as np
import pytest
from commands import signorini
from elastic import two_boxes
from in_time import ending_after
from made_cases import blocks
from mpi4py import MPI

from signorini_fenicsx import (
    Contact,
    Diffusion,
    Dirichlet,
    Elasticity,
    Friction,
    Neumann,
    Signorini,
    Solution,
    Solver,
    Tresca,
    TwoSided,
    domain_of,
    load_case,
    load_solution,
    solve_case,
)
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD


def compare_with(solution: ElasticSolution, other: ElasticSolution) -> None:
    """Norms, sets and bounds are the same."""
    assert solution.norms() == pytest.approx(other.norms(), rel=1e-9, abs=1e-12)
    assert solution.contact == pytest.approx(other.contact, abs=1e-9)
    assert solution.certify().bound == pytest.approx(other.certify().bound, rel=1e-5, abs=1e-9)


@pytest.mark.parallel([1, 3])
def test_patch(folder: Path):
    """Uniform pressure is exact across a fault between two materials, and the bound says so."""
    solution = solve_case(load_case(blocks(folder)))
    np.testing.assert_allclose(solution.pressure, 0.1, rtol=1e-12)
    np.testing.assert_allclose(solution.gap, 0.0, atol=1e-14)
    certificate = solution.certify()
    assert certificate.guaranteed
    assert certificate.bound < 1e-8
    assert solution.norms()["contact_force"] == pytest.approx(0.1)  # the fault counts once
    np.testing.assert_allclose(solution.resultants()["fault"][:2], [0.0, 0.1], atol=1e-12)


@pytest.mark.parallel([1, 2])
def test_files_and_starts(folder: Path):
    """With gap and friction the results are read again and started from."""
    law = 'kind = "friction", mu = 0.3, gap = "0.2*(x - 0.5)^2"'
    moved = ("g_N = {top = [0, -0.1]}", "u_D = {top = [0.02, -0.04], bottom = [0, 0]}")
    free = ('neumann = ["top"]\nfixed = {left = "x", right = "x", bottom = "y"}', 'neumann = ["left", "right"]')
    case = load_case(blocks(folder, moved, free, law=law))
    solution = solve_case(case)
    assert solution.touching.sum() > 0 or COMM.size > 1
    assert solution.certify().relative < 0.05
    solution.write(folder / "out")
    read = load_solution(folder / "out")
    compare_with(read, solution)
    assert solve_case(case, start=read).norms() == pytest.approx(solution.norms(), rel=1e-9)


def test_a_crack_in_rock():
    """In a large plane pressure and largest slip are those of an infinite one, within what the boundary changes."""
    solution = solve_case(load_case("rock"))
    assert np.median(solution.pressure) == pytest.approx(100 * np.sin(np.pi / 9) ** 2, rel=5e-3)
    assert np.abs(solution.slip).max() == pytest.approx(3.8077e-3, rel=2e-2)
    assert solution.friction_states()["slip-"]["vertices"] == solution.touching.size
    assert solution.certify().relative < 0.01


def test_a_stack():
    """Three bodies that nothing but friction holds; with less of it the uppermost slides away, which is said."""
    case = load_case("stack")
    solution = solve_case(case)
    forces = {part: force[:2] for part, force in solution.resultants().items()}
    weights = {"high": 0.12 + 0.6 * 0.02, "low": 0.12 + 1.6 * 0.02, "floor": 0.12 + 2.6 * 0.02}
    for part, weight in weights.items():
        np.testing.assert_allclose(forces[part], [-0.03, weight], atol=1e-9)
    assert solution.certify().relative < 0.06
    slippery = case.with_values({"law": [{"parts": ["floor", "low", "high"], "kind": "friction", "mu": 0.2}]})
    with pytest.raises(InputError, match=r"slides away, along \(1, .*body around \(0\.6, 1\.25\)"):
        solve_case(slippery, domain=solution.spaces.domain)


def test_a_body_that_nothing_holds(folder: Path):
    """A body on a slippery one, and this one on a slippery plane: it is told that and how both move."""
    free = ('["top"]\nfixed = {left = "x", right = "x", bottom = "y"}', '["top", "right"]\nfixed = {bottom = "y"}')
    case = load_case(blocks(folder, free, ('"right"]', '"right", "left"]')))
    with pytest.raises(InputError, match=r"the body can move rigidly, along \(1, 0\), that is all bodies"):
        solve_case(case)


@pytest.mark.parallel([1, 2])
def test_bodies_from_python():
    """A mesh of DOLFINx, with ghosts on several ranks, is cut along a part inside; both physics have laws there."""
    apart = Contact("fault", gap="0.2*(x - 0.5)^2", friction=Tresca(0.005), side="upper")
    held = [Dirichlet("top", ["0.02", "-0.04"]), Dirichlet("bottom", 0), Neumann(["left", "right"])]
    body = Elasticity(young={"upper": 1.0, "lower": 2.0}, poisson=0.3, conditions=[apart, *held])
    domain, of_one_rank = two_boxes(COMM, 4, 2), two_boxes(MPI.COMM_SELF, 4, 2)
    compare_with(solve(domain, body), solve(of_one_rank, body))
    heat = Diffusion(f=1.0, conditions=[Friction("fault", g=0.1), Neumann(["left", "right"])])
    together, alone = (solve(each, heat) for each in (domain, of_one_rank))
    assert together.norms() == pytest.approx(alone.norms(), rel=1e-9, abs=1e-12)
    assert together.certify().bound == pytest.approx(alone.certify().bound, rel=1e-9)


def test_wrong_sides_from_python():
    """A side is told of parts inside the domain only, and must be clear."""
    mesh = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 4, 4)
    parts = {"bottom": lambda x: np.isclose(x[1], 0), "fault": lambda x: np.isclose(x[1], 0.5)}
    with pytest.raises(InputError, match="part 'bottom' has 4 facets that are not between two cells"):
        domain_of(mesh, parts, inner=["bottom"])
    with pytest.raises(InputError, match="unknown part 'slit'"):
        domain_of(mesh, parts, inner=["slit"])
    domain = domain_of(mesh, parts, inner=["fault"])
    solver = Solver(domain, Diffusion(1.0, conditions=[Signorini("fault")]))
    for condition, message in (
        (Signorini("bottom", side=(0, 1)), "side: 'bottom' is not a part inside the domain"),
        (Signorini("fault", side="upper"), "side of 'fault': unknown region 'upper'"),
        (Signorini("fault", side=(1, 0)), "side of 'fault': 4 facets may be on both sides, parallel to the direction"),
        (Signorini("fault", side=(0, 0)), "side of 'fault': must be a region, or a direction of 2 numbers"),
    ):
        with pytest.raises(InputError, match=message):
            solve(domain, Diffusion(1.0, conditions=[condition]))
    with pytest.raises(InputError, match="side: the named side of a part is not the one"):
        solver.solve(Diffusion(1.0, conditions=[Signorini("fault", side=(0, -1))]))


@pytest.mark.parallel([1, 2])
def test_sides_of_conditions():
    """From the other side a law with two signs is its mirror; a region and a direction name the same side."""
    domain = two_boxes(COMM, 4, 2)
    rest = [Dirichlet("top", "0.1*x"), Neumann(["left", "right"])]

    def with_law(psi: float, upper: float, side: Any) -> Solution:
        law = TwoSided("fault", psi=psi, psi_upper=upper, side=side)
        return solve(domain, Diffusion("3*(x - 0.4)", kappa={"upper": 1, "lower": 2}, conditions=[law, *rest]))

    plain, mirrored = with_law(-0.01, 0.03, None), with_law(-0.03, 0.01, "lower")
    assert mirrored.u.x.array == pytest.approx(plain.u.x.array, abs=1e-12)
    assert with_law(-0.03, 0.01, (0.2, -1)).u.x.array == pytest.approx(plain.u.x.array, abs=1e-12)
    assert with_law(-0.01, 0.03, "upper").spaces.domain is domain
    assert COMM.allreduce(np.abs(with_law(-0.03, 0.01, None).u.x.array - plain.u.x.array).max()) > 1e-3
    assert mirrored.certify().bound == pytest.approx(plain.certify().bound, rel=0.01)


LAW = 'law = [{parts = ["fault"], kind = "contact"}]'
WRONG = {
    "inner": (('kind = "contact"', 'kind = "contact", mu = 0.3'), "unknown key 'mu' of the law 'contact'"),
    "law": ((LAW, ""), "inner: 'fault' needs contact: list it there as well, or in a [[law]]"),
    "sides": (("sides = {fault", "sides = {crack"), "sides.crack: 'crack' is not an inner part of a mesh file"),
    "twice": (
        ("contact", 'contact"}, {parts = ["fault"], kind = "contact'),
        "'fault' is listed twice: in law.0.parts and",
    ),
    "listed": (('inner = ["fault"]', 'inner = ["fault", "fault"]'), "[boundary] inner: 'fault' is listed twice"),
    "given": (("g_N = {top", "u_D = {fault"), "u_D.fault: no displacement is given on this part, it is in contact"),
    "closed": (('inner = ["fault"]\nsides = {fault = "upper"}', ""), "part 'fault' has 12 facets inside the domain"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_files(tmp_path: Path, name: str):
    """Each is refused in one sentence, and nothing is written."""
    change, message = WRONG[name]
    blocks(tmp_path, change)
    done = signorini(tmp_path, "solve", "blocks.toml", "--output", "out")
    assert (done.returncode, message in done.stderr, (tmp_path / "out").exists()) == (2, True, False), done.stderr


def test_command_line(tmp_path: Path):
    """The summary, the table with the states of a law, and the picture of two bodies."""
    blocks(tmp_path, law='kind = "wall", beta = 2')
    done = signorini(tmp_path, "solve", "blocks.toml", "--output", "out", "--plot")
    assert done.returncode == 0, done.stderr
    assert "on fault" in done.stdout
    assert "inflow" in done.stdout
    assert "segment" in (tmp_path / "out" / "contact.csv").read_text(encoding="utf-8").splitlines()[0]
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["norms"]["contact_force"] == pytest.approx(0.1)
    assert (tmp_path / "out" / "deformed.png").stat().st_size > 10_000


@pytest.mark.parallel([1, 3])
def test_patch_in_space():
    """Uniform pressure is exact across a face between two boxes, to rounding, and the pictures are drawn."""
    held = [Dirichlet("bottom", 0, components="z"), Dirichlet("left", 0, components="x")]
    held += [Dirichlet("front", 0, components="y"), Neumann(["right", "back"]), Neumann("top", ["0", "0", "-0.1"])]
    problem = Elasticity({"upper": 1.0, "lower": 2.0}, 0.3, conditions=[Contact("fault", gap=0.01), *held])
    solution = solve(two_boxes(COMM, 2, 3), problem)
    np.testing.assert_allclose(solution.pressure, 0.1, rtol=1e-10)
    assert solution.norms()["contact_force"] == pytest.approx(0.1)
    certificate = solution.certify()
    assert certificate.guaranteed
    assert certificate.bound < 1e-8
    upper, lower = (solution.at([[0.3, 0.4, z]]).u[0, 2] for z in (0.5, -0.1))
    if COMM.rank == 0:
        assert (upper, lower) == pytest.approx((-0.01 - 0.1 * 0.5 - 0.05 * 0.5, -0.05 * 0.4))


def test_three_bodies_at_a_vertex(folder: Path):
    """A square of three bodies whose borders meet in its middle, with other normals: exact, and the bound says so."""
    rows = ["Point(1) = {0, 0, 0}; Point(2) = {1, 0, 0}; Point(3) = {1, 1, 0}; Point(4) = {0, 1, 0};"]
    rows += ["Point(5) = {0.5, 0.5, 0}; Point(6) = {0.5, 0, 0}; Point(7) = {1, 0.8, 0}; Point(8) = {0, 0.7, 0};"]
    rows += ["Line(1) = {1, 6}; Line(2) = {6, 2}; Line(3) = {2, 7}; Line(4) = {7, 3}; Line(5) = {3, 4};"]
    rows += ["Line(6) = {4, 8}; Line(7) = {8, 1}; Line(8) = {6, 5}; Line(9) = {5, 7}; Line(10) = {5, 8};"]
    rows += ["Curve Loop(1) = {1, 8, 10, 7}; Plane Surface(1) = {1}; Curve Loop(2) = {2, 3, -9, -8};"]
    rows += ["Plane Surface(2) = {2}; Curve Loop(3) = {9, 4, 5, 6, -10}; Plane Surface(3) = {3};"]
    rows += ['Physical Curve("bottom") = {1, 2}; Physical Curve("right") = {3, 4}; Physical Curve("top") = {5};']
    rows += ['Physical Curve("left") = {6, 7}; Physical Curve("one") = {8}; Physical Curve("two") = {9};']
    rows += ['Physical Curve("three") = {10}; Physical Surface("a") = {1}; Physical Surface("b") = {2};']
    rows += ['Physical Surface("c") = {3}; MeshSize {:} = 0.2;']
    (folder / "three.geo").write_text("\n".join(rows), encoding="utf-8")
    text = """physics = "elasticity"
geometry = {file = "three.geo"}
law = [{parts = ["one", "two", "three"], kind = "KIND"}]
problem = {young = 1, poisson = 0.3, g_N = {top = [0, -0.1], right = [-0.1, 0]}}
[boundary]
inner = ["one", "two", "three"]
sides = {one = "b", two = "c", three = "c"}
neumann = ["top", "right"]
fixed = {left = "x", bottom = "y"}
"""
    for kind in ("contact", 'friction", g = "0.01'):
        (folder / "three.toml").write_text(text.replace("KIND", kind), encoding="utf-8")
        solution = solve_case(load_case(folder / "three.toml"))
        np.testing.assert_allclose(solution.pressure, 0.1, rtol=1e-9)
        assert solution.certify().bound < 1e-7


def test_a_killed_run_of_two_bodies(tmp_path: Path):
    """After an end in step 2 a run goes on with the slip that was computed: all numbers are those of a whole run."""
    blocks(
        tmp_path,
        ("g_N = {top = [0, -0.1]}", 'u_D = {top = ["0.03*sin(4*t)", "-0.04"], bottom = [0, 0]}'),
        ('neumann = ["top"]\nfixed = {left = "x", right = "x", bottom = "y"}', 'neumann = ["left", "right"]'),
        ("[boundary]", "[time]\nend = 1\nsteps = 3\n[boundary]"),
        law='kind = "friction", mu = 0.3, gap = "0.05*(x - 0.5)^2"',
    )
    with ending_after(2):
        assert signorini(tmp_path, "solve", "blocks.toml", "--output", "x").returncode == 1
    assert signorini(tmp_path, "solve", "blocks.toml", "--output", "x", "--restart").returncode == 0
    assert signorini(tmp_path, "solve", "blocks.toml", "--output", "whole").returncode == 0
    one, other = ((tmp_path / name / "summary.json").read_text(encoding="utf-8") for name in ("x", "whole"))
    assert json.loads(one)["norms"] == pytest.approx(json.loads(other)["norms"], rel=1e-10)
