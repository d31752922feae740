"""The rigorous bound of elastic contact: its truth for any stress and displacement, and its refusals."""

import dataclasses
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import signorini
from elastic import box
from made_cases import SQUARE_BODY
from mpi4py import MPI
from test_rigorous import quadrature

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.certificate.proof import proof_of
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.contact.laws import Friction
from signorini_fenicsx.expressions import Binary, exactly, read, values
from signorini_fenicsx.expressions.evaluation import values_and_gradient
from signorini_fenicsx.physics.elasticity.bound.korn import KORN, TRACE
from signorini_fenicsx.physics.elasticity.conditions import CoulombLaw
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells, split_vertices
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.rigorous.elasticity.discrete import ElasticDiscrete, Given, gathered
from signorini_fenicsx.rigorous.elasticity.loads import PROVED, Moments, off_subcells
from signorini_fenicsx.rigorous.elasticity.theorem import prove
from signorini_fenicsx.rigorous.elementary import FromArb
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
PRESSED = {
    2: (["x^2/10", "y^2/20 - y/5"], ["-0.24", "-0.12"], {"x1": ["0.16 + 0.04*y", "0"]}),
    3: (
        ["x^2/10", "0", "z^2/20 - z/5"],
        ["-0.24", "0", "-0.12"],
        {"x1": ["0.16 + 0.04*z", "0", "0"], "y0": ["0", "0.08 - 0.08*x - 0.04*z", "0"]},
    ),
}
"""u that presses onto the plane where the last coordinate is 0, f and g_N, for λ = μ = 2/5."""


def pressed(comm: MPI.Comm, dim: int, n: int) -> ElasticSolution:
    """The solution for a quadratic u, whose stress is in the discrete space."""
    u, f, g_N = PRESSED[dim]
    boundary = ElasticBoundary(["xyz"[dim - 1] + "0"], neumann=list(g_N))
    problem = ElasticProblem(1.0, 0.25, f=f, u_D=u, g_N=g_N, gap=0.0)
    return solve(box(comm, n, [0.0] * dim, [1.0] * dim), replace(problem, boundary=boundary))


def punched(comm: MPI.Comm, n: int, dim: int = 2, **changes: object) -> ElasticSolution:
    """A block on a curved foundation, with tractions and pressures."""
    bottom, loaded, free = ("y0", "x0", "x1") if dim == 2 else ("z0", "x0", "y1")
    boundary = ElasticBoundary([bottom], neumann=[loaded, free, *(["x1", "y0"] if dim == 3 else [])])
    down = [0, -0.1] if dim == 2 else [0, 0, -0.1]
    data = {
        "f": down,
        "u_D": ["0.05*x", *down[1:]],
        "g_N": {loaded: ["0.1*y", *down[1:]]},
        "pressure": {free: "0.1 + 0.1*x"},
        "gap": "0.02*x^2",
    }
    problem = ElasticProblem(1.0, 0.3, **(data | changes))  # type: ignore[arg-type]
    return solve(box(comm, n, [0.0] * dim, [1.0] * dim), replace(problem, boundary=boundary))


def rubbed(law: Law, dim: int, n: int) -> ElasticSolution:
    """A block that is pressed onto a curved foundation and pushed along it."""
    bottom, sides = f"{'xyz'[dim - 1]}0", ["x0", "x1", *(["y0", "y1"] if dim == 3 else [])]
    u_D = ["0.05", *["0.02"] * (dim - 2), "-0.1"]
    problem = ElasticProblem(1.0, 0.3, u_D=u_D, gap="0.02*x^2", laws=(dataclasses.replace(law, parts=[bottom]),))
    return solve(
        box(MPI.COMM_SELF, n, [0.0] * dim, [1.0] * dim),
        replace(problem, boundary=ElasticBoundary([bottom], neumann=sides)),
    )


def held_by_contact(dim: int = 2) -> ElasticSolution:
    """A block on rollers that is pressed onto a curved foundation, which alone holds it along the last coordinate."""
    fixed = {f"{axis}0": axis for axis in "xyz"[: dim - 1]}
    bottom, top = ("xyz"[dim - 1] + end for end in "01")
    others = ["x1"] if dim == 2 else ["x1", "y1"]
    problem = ElasticProblem(1.0, 0.3, g_N={top: [*["0"] * (dim - 1), "-0.1"]}, gap="0.02*x^2")
    boundary = ElasticBoundary([bottom], neumann=[top, *others], fixed=fixed)
    return solve(
        box(MPI.COMM_SELF, 4 if dim == 2 else 2, [0.0] * dim, [1.0] * dim), replace(problem, boundary=boundary)
    )


def discrete_of(solution: ElasticSolution) -> tuple[ElasticDiscrete, Given]:
    """The input of a proof on one process."""
    found = gathered(solution, certify(solution).v, FromArb())
    assert found is not None
    return found


def true_error(discrete: ElasticDiscrete, u: list[str]) -> float:
    """‖σ − σ_h‖ for λ = μ = 2/5."""
    dim = discrete.dim
    lam, weights = quadrature(dim, 6)
    corners = split_vertices(discrete.vertices)
    points = np.einsum("pk,nskd->nspd", lam, corners)
    gradient = np.stack([values_and_gradient(read(each, "xyz"[:dim]), points)[1] for each in u], axis=3)
    strain = (gradient + gradient.swapaxes(3, 4)) / 2
    sigma = 0.4 * np.trace(strain, axis1=3, axis2=4)[..., None, None] * np.eye(dim) + 0.8 * strain
    off = sigma - np.einsum("pk,nskij->nspij", lam, discrete.stresses)
    trace = np.trace(off, axis1=3, axis2=4)
    energy = (off**2).sum(axis=(3, 4)) / 0.8 - trace**2 * 0.4 / (0.8 * (0.4 * dim + 0.8))
    return math.sqrt(((energy @ weights) * Cells(discrete.vertices).measure[:, None]).sum() / (dim + 1))


def shaken(discrete: ElasticDiscrete, size: float, seed: int) -> ElasticDiscrete:
    """Another stress, with jumps and not in balance, and another displacement."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=discrete.stresses.shape)
    at_nodes = rng.normal(size=(discrete.nodes.max() + 1, discrete.dim))[discrete.nodes]
    stresses = discrete.stresses + size * (noise + noise.swapaxes(3, 4))
    return dataclasses.replace(discrete, stresses=stresses, v=discrete.v + size * at_nodes)


@pytest.mark.parametrize(("dim", "n"), [(2, 3), (3, 2)])
def test_any_stress_and_displacement(dim: int, n: int):
    """The bound is rounding for an exact stress, above the exact error for any other, and near it for small ones."""
    u = PRESSED[dim][0]
    discrete, given = discrete_of(pressed(MPI.COMM_SELF, dim, n))
    assert true_error(discrete, u) <= prove(discrete, given).sigma_bound <= 1e-9
    for seed, size in enumerate((1e-6, 1e-2, 1e3)):
        other = shaken(discrete, size, seed)
        error, proven = true_error(other, u), prove(other, given)
        assert error <= proven.sigma_bound <= 30 * (error + math.sqrt(size))  # v is off the foundation by the size
        assert proven.remainder > 0.3 * error
    softer = tuple(read("0.9", "x") if tree == exactly(1.0) else tree for tree in given.trees)
    assert softer != given.trees
    assert prove(discrete, dataclasses.replace(given, trees=softer)).sigma_bound > 1e-3


def test_near_the_certificate():
    """The gap is that of the certificate, which has a better displacement on a few cells, or a bit larger."""
    for solution in (
        punched(MPI.COMM_SELF, 4),
        punched(MPI.COMM_SELF, 2, dim=3),
        held_by_contact(),
        held_by_contact(3),
    ):
        certificate = certify(solution)
        proof = proof_of(solution, certificate.v)
        assert proof.proven is not None, proof.reason
        assert certificate.gap * (1 - 1e-8) <= proof.proven.gap <= 1.6 * certificate.gap
        assert proof.proven.remainder <= 1e-9


def test_loads_that_vary():
    """Above the error, and near it where loads are quadratic; with the pulse between all points it is large."""
    u = ["x^2*y/10", "x*y^2/10 - y/5"]
    loads = {"f": ["-2*y/5", "-2*x/5"], "g_N": {"x1": ["8*y/25 - 2/25", "(1 + y^2)/25"], "y0": ["-x^2/25", "6/25"]}}
    problem = ElasticProblem(1.0, 0.25, u_D=["x^2/10", "x*y/10 - y/5"], exact=u, **loads)  # type: ignore[arg-type]
    boundary = ElasticBoundary([], neumann=["x1", "y0"])
    domain = box(MPI.COMM_SELF, 4, [0.0, 0.0], [1.0, 1.0])
    solution = solve(domain, replace(problem, boundary=boundary))
    errors, certificate = solution.errors(), certify(solution)
    proof = proof_of(solution, certificate.v)
    assert errors is not None
    assert proof.proven is not None, proof.reason
    assert errors["energy"] <= proof.proven.sigma_bound <= 2.5 * errors["energy"]
    assert certificate.oscillation <= proof.proven.oscillation

    pulse = "1e4*exp(-1e5*((x - 0.313)^2 + (y - 0.417)^2))"
    pulsed = dataclasses.replace(problem, f=["-2*y/5", f"-2*x/5 - {pulse}"], exact=None)
    solution = solve(domain, replace(pulsed, boundary=boundary))
    proof = proof_of(solution, certify(solution).v)
    assert proof.proven is not None, proof.reason
    assert proof.proven.bound > 0.01


def test_moments_and_constants():
    """What is off Q and Π₁ against quadrature; the constants are not below those of the certificate."""
    rng, given = np.random.default_rng(0), Given((), True, FromArb())
    for dim, text in ((2, "1 + 2*x - y^2 + x*y"), (3, "1 + 2*x - y^2 + x*z")):
        vertices, tree = np.eye(dim + 1, dim) + 0.1 * rng.normal(size=(5, dim + 1, dim)), read(text, "xyz"[:dim])
        moments, (lam, weights) = Moments.of(tree, vertices, given, "f"), quadrature(dim, 6)
        corners = vertices, split_vertices(vertices)
        whole, parts = (values(tree, np.einsum("pk,...kd->...pd", lam, x)) for x in corners)
        hats = np.einsum("np,pk,p->nk", whole, lam, weights)
        constant = (dim + 2) * hats.sum(axis=1, keepdims=True) - (dim + 1) ** 2 * hats
        off = ((parts - constant[:, :, None]) ** 2 @ weights).mean(axis=1)
        np.testing.assert_allclose(off_subcells(moments, dim).hi, off, rtol=1e-9)
        off = np.sqrt((whole - moments.linear().lo @ lam.T) ** 2 @ weights)
        np.testing.assert_allclose(moments.off_linear().hi, off, rtol=1e-9)
    assert PROVED[2][0] >= KORN[2]
    assert PROVED[2][1] >= TRACE[2]


@pytest.mark.parametrize(("dim", "n"), [(2, 4), (3, 2)])
def test_with_friction(dim: int, n: int, monkeypatch: pytest.MonkeyPatch):
    """With the same displacement the gap is that of the certificate; a larger bound of the shear makes it larger."""
    monkeypatch.setattr("signorini_fenicsx.physics.elasticity.bound.certify._with_most", lambda *_: np.empty(0, int))
    for law in (Friction([], "0.01 + 0.02*x"), CoulombLaw([], 0.3)):
        solution = rubbed(law, dim, n)
        certificate = certify(solution)
        found = gathered(solution, certificate.v, FromArb())
        assert found is not None
        assert prove(*found).gap == pytest.approx(certificate.gap, rel=1e-8)
        discrete, given = found
        larger = dataclasses.replace(discrete, bound=2 * discrete.bound)
        doubled = tuple(read("0.02 + 0.04*x", "x") if t == read("0.01 + 0.02*x", "x") else t for t in given.trees)
        assert prove(larger, dataclasses.replace(given, trees=doubled)).gap > 1.01 * certificate.gap


@pytest.mark.parametrize(("dim", "plane"), [(2, "strain"), (2, "stress"), (3, "strain")])
def test_eigenstrain(dim: int, plane: str, monkeypatch: pytest.MonkeyPatch):
    """With the same displacement the gap is that of the certificate where the strain is linear, else a bit larger."""
    monkeypatch.setattr("signorini_fenicsx.physics.elasticity.bound.certify._with_most", lambda *_: np.empty(0, int))
    sides = [f"{axis}{end}" for axis in "xyz"[: dim - 1] for end in (0, 1)]
    bottom, top = (f"{'xyz'[dim - 1]}{end}" for end in (0, 1))
    boundary = ElasticBoundary([bottom], neumann=sides)
    matrix = [["x/10", "y/20", "0.01"], ["y/20", "-0.1 + y", "x/30"], ["0.01", "x/30", "x + y"]]
    domain = box(COMM, 4 if dim == 2 else 2, [0.0] * dim, [1.0] * dim)
    gaps = []
    for own in ("(x - y)/10", [row[:dim] for row in matrix[:dim]], "exp(x*y)/10"):
        given = {"u_D": {top: [0.0] * (dim - 1) + [-0.02]}, "eigenstrain": own, "plane": plane}
        solution = solve(domain, ElasticProblem(1.0, 0.25, **given, boundary=boundary))  # type: ignore[arg-type]
        certificate = certify(solution)
        assert certificate.guaranteed
        proof = proof_of(solution, certificate.v)
        assert proof.proven is not None, proof.reason
        gaps.append((proof.proven.gap, certificate.gap))
    for proven, certified in gaps[:2]:
        assert proven == pytest.approx(certified, rel=1e-7)
    assert gaps[2][1] < gaps[2][0] < 3 * gaps[2][1]


@pytest.mark.parametrize("name", ["two_cylinders", "plate"])
def test_bodies_that_touch(name: str, monkeypatch: pytest.MonkeyPatch):
    """With the same displacement the gap is that of the certificate for several bodies and with friction, too."""
    monkeypatch.setattr("signorini_fenicsx.physics.elasticity.bound.certify._with_most", lambda *_: np.empty(0, int))
    case = load_case(name)
    solution = solve_case(case.with_values({"solve.h": 0.01}) if name == "plate" else case, MPI.COMM_SELF)
    certificate = certify(solution)
    proof = proof_of(solution, certificate.v)
    assert proof.proven is not None, proof.reason
    assert proof.proven.gap == pytest.approx(certificate.gap, rel=1e-6)


EQUAL: dict[str, tuple[object, list[object], list[str], float]] = {
    "number": (0.1, [0, -0.1], ["x1", "y1"], 0.0),
    "text": ("0.1 + 0.02*x^2", ["0", "-0.1 - 0.2*y"], ["x1", "y1"], 0.0),
    "both ends": ("0.1 + 0.2*x^2", ["0", "-0.1 - 0.2*x"], ["y1"], 0.0),
    "slope": ("x^2/10", ["0.05", "0.05"], ["x1", "y1"], 1.0),
    "in space": ("0.1 + 0.05*y^2 + 0.1*x", ["0", "0", "-0.1 - 0.05*y^2"], ["x1", "z1"], 0.0),
}
"""Gaps that are u_n at a vertex or an edge, u_D, the free parts, and the slope of the foundation."""


@pytest.mark.parametrize(("gap", "u_D", "free", "slope"), EQUAL.values(), ids=list(EQUAL))
def test_where_u_meets_the_gap(gap: object, u_D: list[object], free: list[str], slope: float):
    """Where u_n is given and equal to the gap there is a proof; where it is above it by 1e-19 there is none."""
    dim = len(u_D)
    domain, down = box(MPI.COMM_SELF, 4 - dim, [0.0] * dim, [1.0] * dim), [0.0] * (dim - 1) + [-0.1]
    x = domain.mesh.geometry.x
    x[:, :2] += slope * x[:, 1::-1] * [-1, 1]
    problem = ElasticProblem(1.0, 0.3, f=down, u_D=u_D, gap=gap)  # type: ignore[arg-type]
    solution = solve(domain, replace(problem, boundary=ElasticBoundary(["xyz"[dim - 1] + "0"], neumann=free)))
    certificate = certify(solution)
    proof = proof_of(solution, certificate.v)
    assert proof.proven is not None, proof.reason
    assert certificate.gap * (1 - 1e-8) <= proof.proven.gap <= 1.6 * certificate.gap
    discrete, given = discrete_of(solution)
    (number,) = np.unique(discrete.gap[discrete.gap >= 0])
    lower = (Binary("-", tree, read("1e-19", "x")) if k == number else tree for k, tree in enumerate(given.trees))
    with pytest.raises(InputError, match=r"u_n ≤ gap is not certain near .*: u_n − gap is up to .* Right is u_n below"):
        prove(discrete, dataclasses.replace(given, trees=tuple(lower)))


def test_where_given_jumps_meet_the_gap():
    """Two bodies whose sides move as one: the jump is exactly the gap, 0, where they end."""
    u_D = ["0.03*y + 0.01", "0.03*x + 0.01"]
    changes = {"boundary.neumann": ["top"], "problem.u_D": u_D, "solve.h": 0.5}
    solution = solve_case(load_case("stack").with_values(changes), MPI.COMM_SELF)
    proof = proof_of(solution, certify(solution).v)
    assert proof.proven is not None, proof.reason


@pytest.mark.parallel(2)
def test_on_ranks():
    """The bound of several ranks is that of one."""
    bounds = []
    for comm in (COMM, MPI.COMM_SELF):
        solution = punched(comm, 4)
        proof = proof_of(solution, certify(solution).v)
        assert proof.proven is not None
        bounds.append(proof.proven)
    assert bounds[0].bound == pytest.approx(bounds[1].bound, rel=1e-9)
    assert bounds[0].gap == pytest.approx(bounds[1].gap, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"u_D": ["sin(x)", "-0.1"]}, "quadratic u_D"),
        ({"gap": "0.02*x^4"}, "quadratic gap"),
        ({"dim": 3, "f": ["0", "0", "-x"]}, "in space is for f that is constant"),
        ({"dim": 3, "g_N": {"x0": ["y^2", "0", "0"]}}, "in space is for f that is constant"),
        ({"young": "1 + 1e4*exp(-1000*((x - 0.5)^2 + (y - 0.5)^2))"}, r"varies too much .* near \(0\.[3-6]"),
    ],
)
def test_refusals(changes: dict[str, object], reason: str):
    """Data for which there is no theorem."""
    changes = dict(changes)
    young = changes.pop("young", None)
    solution = punched(MPI.COMM_SELF, 2 if "dim" in changes else 4, **changes)  # type: ignore[arg-type]
    if young is not None:
        problem = dataclasses.replace(solution.problem, young=young)
        solution = solve(solution.spaces.domain, replace(problem, boundary=solution.boundary))
    proof = proof_of(solution, certify(solution).v)
    assert proof.proven is None
    with pytest.raises(InputError, match=reason):
        raise InputError(proof.reason)


def test_command_line(tmp_path: Path):
    """The bound in the output and the summary; what is refused is refused before the solve."""
    case = tmp_path / "block.toml"
    case.write_text(
        f"""
title = "A block on a curved foundation"
{SQUARE_BODY}contact = ["bottom"]

[problem]
young = "1"
poisson = "0.3"
gap = "0.02*x^2"
u_D = ["0", "-0.1"]

[solve]
h = "1/4"
"""
    )
    done = signorini(tmp_path, "solve", str(case), "--rigorous", "--output", "done")
    assert done.returncode == 0, done.stderr
    assert "proved     energy error ≤ " in done.stdout
    certificate = json.loads((tmp_path / "done/summary.json").read_text())["certificate"]
    assert certificate["gap"] * (1 - 1e-8) <= certificate["proved"]["gap"] <= 1.6 * certificate["gap"]
    done = signorini(tmp_path, "solve", "joint", "--rigorous", "--output", "rough")
    assert done.returncode == 2
    assert "--rigorous: the proof is not for elastic problems with rigid tools" in done.stderr
    assert not (tmp_path / "rough").exists()
