"""An obstacle in the domain: exact solutions with rates and error bounds, both backends, any ranks, the dam."""

from pathlib import Path

import numpy as np
import pytest
from commands import signorini
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from exact import energy_error
from mpi4py import MPI

from signorini_fenicsx import (
    Diffusion,
    Friction,
    InputError,
    Neumann,
    Options,
    Signorini,
    Solution,
    certify,
    solve,
)
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.certificate.proof import proof_of
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.meshes.sampling import sampled
from signorini_fenicsx.physics.diffusion.discrete.spaces import build_spaces
from signorini_fenicsx.physics.diffusion.show.seepage import seepage

COMM = MPI.COMM_WORLD
RADIUS = 0.697965148223374
ITERATIVE = Tuning(direct_up_to=0)


def sphere(n: int, tuning: Tuning | None = None) -> Solution:
    """The shipped case with h = 2^-n."""
    return solve_case(load_case("sphere").with_values({"solve.h": 2.0**-n}), COMM, tuning=tuning)


def on_square(problem: Diffusion, *, h: float = 0.1, **options: object) -> Solution:
    domain = build_domain(COMM, "square", h, mesh="unstructured")
    return solve(domain, problem, Options(**options))  # type: ignore[arg-type]


def test_sphere():
    """σ_h has order 1, the bound is sharp, the contact tends to the disc, by few set updates whatever h."""
    found = [sphere(n) for n in (2, 3)]
    assert max(len(solution.outcome.history) for solution in (*found, sphere(3, ITERATIVE))) <= 5
    errors = [solution.errors() for solution in found]
    sigma = np.array([error["sigma_L2"] for error in errors])
    assert np.log2(sigma[:-1] / sigma[1:]).min() > 0.95
    assert errors[-1]["missed_contact"] < 0.6 * errors[-2]["missed_contact"] < 0.1
    certificate = certify(found[1])
    assert 1 <= certificate.sigma_bound / sigma[1] <= 1.1
    assert certificate.guaranteed  # ψ is enclosed, and kinks where it does not touch do not matter
    assert found[1].on_obstacle()["contact_measure"] == pytest.approx(np.pi * RADIUS**2, rel=0.06)
    assert found[1].on_obstacle()["force"] == pytest.approx(2 * np.pi * 0.680259411891719, rel=1e-3)


# u = ψ + (x − 0.4)₊² with ψ = y²/2 − x, force 2(1 + x) + 5(0.4 − x) in contact, c = 2 and κ = 1 + x
SMOOTH = Diffusion(
    f="-3*(1 + x) - (2*max(x - 0.4, 0) - 1) + 2*(y^2/2 - x + max(x - 0.4, 0)^2) - 5*max(0.4 - x, 0)",
    kappa="1 + x",
    u_D="y^2/2 - x + max(x - 0.4, 0)^2",
    c=2,
    obstacle="y^2/2 - x",
    exact="y^2/2 - x + max(x - 0.4, 0)^2",
    conditions=[Neumann("bottom", 0)],
)


def test_exact_solution_with_reaction_and_neumann():
    coarse, fine = (on_square(SMOOTH, h=h) for h in (1 / 8, 1 / 16))
    errors = [solution.errors()["sigma_L2"] for solution in (coarse, fine)]
    assert np.log(errors[0] / errors[1]) / np.log(coarse.spaces.domain.h / fine.spaces.domain.h) > 0.95
    for solution in (coarse, fine):
        certificate, gradient = certify(solution), energy_error(solution)
        assert certificate.guaranteed
        assert 1 <= certificate.sigma_bound / gradient <= 1.15


@pytest.mark.parametrize(("element", "most"), [("RT0", 1.02), ("RT1", 7.0)])
def test_load_that_jumps_in_contact(element: str, most: float):
    """It is a part of the force, and nothing is paid for it; ψ may be any smooth function."""
    wave = "sin(2*x)*exp(y)"
    jump = " - (2 if x > 0.4 else 1) - (20 if (x - 0.15)^2 + (y - 0.5)^2 < 0.01 else 0)"
    u = f"{wave} + max(x - 0.4, 0)^2"
    problem = Diffusion(f=f"3*{wave} {jump}", u_D=u, obstacle=wave, exact=u)
    solution = on_square(problem, h=1 / 16, element=element)
    certificate = certify(solution)
    assert certificate.guaranteed
    assert 1 <= certificate.sigma_bound / solution.errors()["sigma_L2"] <= most
    assert certificate.bound <= 1.15 * most * solution.errors()["sigma_L2"]


@pytest.mark.parametrize("element", ["RT0", "RT1"])
def test_a_needle_of_the_obstacle_is_not_overlooked(element: str):
    """Between all points of quadratures, where the obstacle touches and, lower, where it does not."""
    needle = "exp(-1e6*((x - 0.4321)^2 + (y - 0.5678)^2))"
    problems = [Diffusion(f=f, obstacle=f"-0.1 + 0.05*{needle}") for f in (-10, -0.2)]
    found = [certify(on_square(problem, h=0.15, element=element)) for problem in problems]
    assert [certificate.guaranteed for certificate in found] == [False, True]
    assert found[0].unresolved[0][0] == "obstacle"


GENERAL = Diffusion(
    f="-20*x",
    kappa=[["2 + x", "y/2"], ["y/2", "1"]],
    obstacle="-0.1 - 0.2*x*y",
    c="3*y",
    conditions=[Signorini(["bottom", "right"], "0.05*x - 0.02"), Neumann("left", 0), Friction("top", g="0.1")],
)


@pytest.mark.parallel([1, 2])
def test_backends_and_algorithms_agree():
    """With laws on Γ_S and cu; the iterative backend too."""
    first, *others = (
        on_square(GENERAL, **options)
        for options in ({}, {"backend": "mixed"}, {"algorithm": "alg2"}, {"tuning": ITERATIVE})
    )
    assert np.isfinite(certify(first).bound)
    for other in others:
        for name in ("u", "sigma"):
            np.testing.assert_allclose(getattr(other, name).x.array, getattr(first, name).x.array, rtol=0, atol=1e-10)
        assert other.on_obstacle() == pytest.approx(first.on_obstacle(), rel=1e-9)


@pytest.mark.parallel([1, 2])
def test_no_dirichlet():
    """The obstacle alone holds u: its force is the whole load."""
    impervious = [Neumann(["left", "right", "bottom", "top"], 0)]
    for options in ({}, {"backend": "mixed"}, {"tuning": ITERATIVE}):
        solution = on_square(Diffusion(f="3*x - 3", obstacle="x*y - 1", conditions=impervious), **options)
        assert solution.on_obstacle()["force"] == pytest.approx(1.5, rel=1e-9)
        assert certify(solution).relative < 0.2
    with pytest.raises(InputError, match="there is no solution"):
        on_square(Diffusion(f="3*x", obstacle="x*y - 1", conditions=impervious))


def test_refusals():
    with pytest.raises(InputError, match=r"obstacle: is above u_D on Γ_D, as at \(1, .* by 0.5"):
        on_square(Diffusion(f=1, obstacle="x - 0.5"))
    with pytest.raises(InputError, match="alg3 does not take an obstacle; alg1, alg2 and qp do"):
        on_square(Diffusion(f=1, obstacle=-1), algorithm="alg3")
    with pytest.raises(InputError, match="not finite everywhere in the domain"):
        on_square(Diffusion(f=1, obstacle="log(x - 0.5)"))


def test_precise_backend_of_thin_cells():
    """The saddle point goes on from the cells in contact where the facet system is not precise enough."""
    values = {"geometry.shape": "[0, 1] x [0, 1e-9]", "problem.f": "-10", "problem.obstacle": "-0.1"}
    values |= {"problem.u_D": "0", "exact.u": "0", "solve.h": 0.2}
    assert "by the saddle point" in solve_case(load_case("sphere").with_values(values), COMM).outcome.reason


def test_no_proof():
    solution = on_square(Diffusion(f=-10, obstacle=-0.1), h=0.4)
    proof = proof_of(solution, certify(solution).v)
    assert proof.proven is None
    assert "without an obstacle" in proof.reason


@pytest.mark.parametrize(
    ("L", "h", "H", "height"),
    [pytest.param(16, 4, 24, 12.7059138062, marks=pytest.mark.slow), (5, 2, 10, 6.3445505002)],
)
def test_dam(L: float, h: float, H: float, height: float):
    """The phreatic line meets the downstream face where it should, and falls towards it."""
    with pytest.raises(InputError, match=r"missing key 'L' in \[dam\]"):
        load_case("dam_baiocchi").with_values({"dam": {"h": h, "H": H}})
    with pytest.raises(InputError, match=r"\[dam\] L: must be between 1e-6 and 1e6 times H"):
        load_case("dam_baiocchi").with_values({"dam.L": 1e-300})
    case = load_case("dam_baiocchi").with_values({"dam.L": L, "dam.h": h, "dam.H": H, "solve.h": L / 32})
    solution = solve_case(case, COMM)
    found = seepage(solution)
    assert found is not None
    assert found.separation_height == pytest.approx(height, rel=0.01)
    assert found.discharge == (H**2 - h**2) / (2 * L)
    assert found.outflow == pytest.approx(found.discharge, rel=0.005)
    _, y = found.phreatic_line.T
    assert (np.diff(y) < 0.02 * H).all()
    assert y[0] == pytest.approx(H, rel=0.01)
    assert certify(solution).guaranteed


@pytest.mark.parallel(2)
def test_contact_on_another_mesh():
    """Cells are searched only around the contact, and found as if all were; without contact none are."""
    coarse, fine = (build_spaces(build_domain(COMM, "square", h, mesh="unstructured"), []) for h in (0.2, 0.07))
    cells = np.arange(len(coarse.cell_measures), dtype=np.int32)
    middles = compute_midpoints(coarse.mesh, 2, cells)
    for radius in (0.3, 0.0, 2.0):
        segment = (np.hypot(middles[:, 0] - 0.3, middles[:, 1] - 0.6) >= radius).astype(np.int8)
        numbers = fem.Function(coarse.Q)
        numbers.x.array[:] = segment
        (everywhere,) = sampled([numbers], fine.mesh, coarse.domain, degree=0)
        found = Segments(coarse, segment).on(fine).segment
        assert np.array_equal(found, np.rint(everywhere.x.array))


def test_no_contact_is_told_where_there_is_no_contact_boundary(tmp_path: Path):
    done = signorini(tmp_path, "solve", "sphere", "--h", "1", "--set", "problem.obstacle=-1", "--output", "x")
    assert done.returncode == 0
    names = [line.split()[0] for line in done.stdout.splitlines() if line]
    assert "obstacle" in names
    assert "contact" not in names
