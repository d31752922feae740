"""Elastic contact: exact solutions with rates, also of the half-plane, materials up to ν = ½, what is refused."""

from dataclasses import replace

import dolfinx.mesh
import numpy as np
import pytest
from elastic import box, half_plane_contact, smooth
from mpi4py import MPI

from signorini_fenicsx import Contact, Dirichlet, Elasticity, Neumann
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.contact.chains import Condition, Penalty
from signorini_fenicsx.contact.laws import Corners
from signorini_fenicsx.contact.set_rules import SetRule
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
UNIT = {2: ([0.0, 0.0], [1.0, 1.0]), 3: ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0])}


def linear_problem(dim: int, nu: float) -> tuple[np.ndarray, list[str], list[str]]:
    """A constant stress that presses on y = 0 without shear, its displacement there and its traction on y = 1."""
    stress = np.diag([3.0, -2.0, 1.0][:dim])
    if dim == 3:
        stress[0, 2] = stress[2, 0] = 0.7
    theta = nu if dim == 2 else nu / (1 + nu)
    strains = (1 + nu) / 200 * (stress - theta * np.trace(stress) * np.eye(dim))
    u = ["+".join(f"{float(c)!r}*{x}" for c, x in zip(row, "xyz", strict=False)) for row in strains]
    return stress, u, [f"{float(c)!r} if y > 1 - 1e-9 else 0" for c in stress[:, 1]]


@pytest.mark.parallel(2)
@pytest.mark.parametrize("dim", [2, 3])
def test_patch(dim: int):
    """Linear displacements are found exactly, with parts that are fixed in some components, by axis and by normal."""
    stress, u, g_N = linear_problem(dim, 0.3)
    domain = box(COMM, 2, *UNIT[dim])
    held = Dirichlet("x0", u, components="n" if dim == 2 else "xyz")  # in space there is shear on x = 0
    conditions = [Contact("y0"), held, Neumann("y1", g_N)]
    solution = solve(domain, Elasticity(200.0, 0.3, u_D=u, exact=u, conditions=conditions))
    np.testing.assert_allclose(solution.stresses, np.broadcast_to(stress, solution.stresses.shape), atol=1e-11)
    errors = solution.errors()
    assert errors is not None
    assert errors["u_L2"] < 1e-13
    assert np.abs(solution.resultants()["sum"]).max() < 1e-11


@pytest.mark.parametrize(("dim", "nu"), [(2, 0.3), (2, 0.4999), (3, 0.3)])
def test_smooth_solution_has_full_order(dim: int, nu: float):
    """With E that varies the stress has order 2, for almost incompressible bodies as well."""
    found = []
    for n in (8, 16) if dim == 2 else (2, 4):
        domain = box(COMM, n, *UNIT[dim])
        young, u, f = smooth(domain, nu)
        solution = solve(domain, Elasticity(young, nu, f=f, u_D=u, exact=u, conditions=[Contact(f"{'xyz'[dim - 1]}0")]))
        assert solution.touching.all()
        found.append(solution.errors())
    orders = {name: np.log2(found[0][name] / found[1][name]) for name in ("energy", "u_L2")}
    assert orders["energy"] > {2: 1.75, 3: 1.7}[dim]
    assert orders["u_L2"] > 1.8


@pytest.mark.parametrize("nu", [0.3, pytest.param(0.4999, marks=pytest.mark.slow)])
def test_contact_with_a_singular_solution(nu: float):
    """σ ~ r^½ at the end of the contact set: order 3/2, few updates, the set within a cell, a bound near the error."""
    errors, u = [], half_plane_contact(nu)
    for n in (8, 16):
        domain = box(COMM, n, [-1.0, 0.0], [1.0, 1.0])
        solution = solve(domain, Elasticity(1.0, nu, u_D=u, exact=u, conditions=[Contact("y0")]))
        assert len(solution.outcome.history) <= 7
        assert solution.pressure.min(initial=0.0) > -1e-10
        errors.append(solution.errors())
        if n == 8:  # by quadratics alone the bound is 1.63 times the error
            certificate = certify(solution)
            assert errors[0]["energy"] <= certificate.sigma_bound < 1.27 * errors[0]["energy"]
            assert not certificate.guaranteed  # enclosures do not see that (r − x)/2 has a root
            assert certificate.unresolved[0][0] == "u_D"
    assert errors[1]["energy"] < 3e-3
    assert np.log2(errors[0]["energy"] / errors[1]["energy"]) > 1.4
    assert errors[1]["contact_hausdorff"] <= 1 / 16


P = 0.2


def by_pressure(nu: float, plane: str, a: float, *, flat: bool) -> tuple[list[str], float]:
    """Westergaard's u in y > 0 for a pressure on |x| < a, E = 1, and the curvature of the gap.

    With S = (a² − z²)^½ the pressure is P/S under a rigid flat punch, and P S/a under Hertz' parabola. As in
    `half_plane_contact`, u is made of Z, which is −pressure on y = 0, and of its integral Ẑ.
    """
    mu2, kappa = 1 / (1 + nu), 3 - 4 * nu if plane == "strain" else (3 - nu) / (1 + nu)
    square = f"({a**2} - x^2 + y^2)"
    r = f"sqrt({square}^2 + 4*x^2*y^2)"
    re, im = f"sqrt(max(({r} + {square})/2, 0))", f"((1 if x < 0 else -1)*sqrt(max(({r} - {square})/2, 0)))"  # of S
    angle = f"atan2(x + {im}, {re} - y)"  # of arcsin(z/a) the real part
    depth = f"(-log(((x + {im})^2 + ({re} - y)^2)/{a**2})/2)"  # and the imaginary one
    if flat:
        Z = f"{-P}*{re}/{r}", f"{P}*{im}/{r}"
        of_Z = f"{-P}*{angle}", f"{-P}*{depth}"
    else:
        Z = f"{-P / a}*({re} - y)", f"{-P / a}*({im} + x)"
        of_Z = (
            f"{-P / (2 * a)}*(x*{re} - y*{im} + {a**2}*{angle} - 2*x*y)",
            f"{-P / (2 * a)}*(x*{im} + y*{re} + {a**2}*{depth} + x^2 - y^2)",
        )
    ux = f"({(kappa - 1) / 2}*{of_Z[0]} - y*{Z[1]})/{mu2}"
    uy = f"({(kappa + 1) / 2}*{of_Z[1]} - y*{Z[0]})/{mu2}"
    return [ux, uy], (kappa + 1) / 2 * P / a / mu2


def under_pressure(comm: MPI.Comm, n: int, nu: float, plane: str, a: float, *, flat: bool) -> ElasticSolution:
    """The half of [−1, 1]² above y = 0, with u given on the rest of its boundary."""
    domain = box(comm, n, [-1.0, 0.0], [1.0, 1.0])
    u, curvature = by_pressure(nu, plane, a, flat=flat)
    gap = f"0 if abs(x) < {a} else 2" if flat else f"{curvature / 2}*x^2"
    problem = Elasticity(1.0, nu, u_D=u, exact=u, plane=plane, conditions=[Contact("y0", gap)])
    return solve(domain, problem)


def test_hertz_without_an_effect_of_the_domain():
    """With the displacement of the half-plane around it a small body has the exact pressure; contact ends twice."""
    errors, a = [], 0.43
    for n in (8, 16):
        solution = under_pressure(COMM, n, 0.49, "stress", a, flat=False)
        errors.append(found := solution.errors())
        assert n == 16 or found["energy"] <= certify(solution).sigma_bound < 1.7 * found["energy"]
        assert found["contact_hausdorff"] <= 1 / n
    assert errors[1]["energy"] < 1.8e-3
    assert np.log2(errors[0]["energy"] / errors[1]["energy"]) > 1.35
    assert np.log2(errors[0]["u_L2"] / errors[1]["u_L2"]) > 1.9
    assert solution.pressure.max() == pytest.approx(P, rel=0.02)
    assert solution.norms()["contact_force"] == pytest.approx(np.pi / 2 * P * a, rel=2e-3)


def test_rigid_punch():
    """The gap jumps where the punch ends and the pressure is infinite: order 1/2, and the bound is near the error."""
    errors = []
    for n in (4, 8):
        solution = under_pressure(COMM, n, 0.49, "strain", 0.5, flat=True)
        errors.append((found := solution.errors())["energy"])
        assert n == 8 or errors[-1] <= certify(solution).sigma_bound < 1.6 * errors[-1]
        assert solution.contact[1] == pytest.approx(1.0)
        assert found["contact_hausdorff"] == 0.0
    assert errors[1] < 0.07
    assert np.log2(errors[0] / errors[1]) > 0.4
    assert solution.norms()["contact_force"] == pytest.approx(np.pi * P, rel=0.06)


def test_second_algorithm_and_regions():
    """Algorithm 2 and a rule of one's own find the same; E by region is E by an expression."""
    domain = box(COMM, 4, [-1.0, 0.0], [1.0, 1.0])
    mesh = domain.mesh
    halves = {"left": lambda x: x[0] <= 1e-9, "right": lambda x: x[0] >= -1e-9}
    cells = {name: dolfinx.mesh.locate_entities(mesh, 2, where) for name, where in halves.items()}
    parts = {"y0": lambda x: np.isclose(x[1], 0)}
    domain = domain_of(mesh, parts, regions=cells)
    data = {"f": ["0", "-1"], "gap": "0.1*(x - 0.2)^2"}
    one = solve(domain, ElasticProblem({"left": 1.0, "right": 2.0}, 0.3, **data, boundary=ElasticBoundary(["y0"])))
    other = ElasticProblem("1 if x < 0 else 2", 0.3, **data)
    two = solve(domain, replace(other, boundary=ElasticBoundary(["y0"])), Options(algorithm="alg2"))
    np.testing.assert_allclose(one.stresses, two.stresses, atol=1e-11)
    options = Options(algorithm=SetRule(Condition.NO_FLUX, pressed_more))
    own = solve(domain, replace(other, boundary=ElasticBoundary(["y0"])), options)
    np.testing.assert_allclose(own.stresses, two.stresses, atol=1e-11)
    assert own.summary()["algorithm"] == "own"


def pressed_more(p: np.ndarray, flux: np.ndarray, rho: float) -> np.ndarray:
    """The rule of a user."""
    return np.where(flux > rho * p, Condition.ZERO_TRACE, Condition.NO_FLUX).astype(np.int8)


def test_a_small_compression_behind_a_large_motion():
    """The stress of a small compression is right, and without any it is 0 up to rounding."""
    domain, sides = box(COMM, 2, *UNIT[2]), Neumann(["x1", "y1"], 0)
    moved = Elasticity(2.0, 0.3, u_D=["0.1", "0"], conditions=[Contact("y0"), sides])
    assert solve(domain, moved).norms()["sigma_L2"] < 1e-13
    far, near = (
        solve(domain, Elasticity(2.0, 0.3, u_D=["0", top], conditions=[Contact("y0", gap), sides]))
        for top, gap in (("1 - 1e-9*y", -1), ("-1e-9*y", 0))
    )
    assert far.norms()["contact_force"] == pytest.approx(near.norms()["contact_force"], rel=1e-5)


def complaint(boundary: ElasticBoundary, **data: object) -> str:
    """What is said of a problem on the unit square that cannot be."""
    given = {"young": 1.0, "poisson": 0.3} | data
    with pytest.raises(InputError) as error:
        solve(box(COMM, 2, *UNIT[2]), ElasticProblem(**given, boundary=boundary))
    return str(error.value)


def test_bad_input():
    """Each is one sentence with the place."""
    held, loaded = ElasticBoundary(["y0"]), ElasticBoundary(["y0"], neumann=["x0", "x1", "y1"])
    assert "young: must be positive" in complaint(held, young="x - 0.5")
    for nu in (0.5, -1.0, "x"):
        assert "poisson: must be above -1 and below 1/2; it is" in complaint(held, poisson=nu)
    assert "f: not finite" in complaint(held, f=["1/(x - x)", "0"])
    assert "f: has 3 components, not 2" in complaint(held, f=np.array([1, 0, 0]))
    assert "part 'y1' takes no traction, as it is not in neumann or fixed; no" in complaint(
        held, g_N={"y1": ["0", "1"]}
    )
    assert "gap: not finite everywhere on part 'y0'" in complaint(held, gap="1/x")
    assert "unknown part 'lid'" in complaint(ElasticBoundary(["y0"], fixed={"lid": "x"}))
    assert "beside them fixed there is 't', not 'x'" in complaint(ElasticBoundary(["y0"], fixed={"y0": "x"}))
    assert "unknown region 'core'" in complaint(held, young={"core": 1.0})
    assert "rigidly, along (1, 0)" in complaint(loaded, f=["0", "-1"]).replace("(-1,", "(1,").replace("-0)", "0)")
    sliding = ElasticBoundary(["y0"], neumann=["x1", "y1"], fixed={"x0": "x"})
    assert "rigidly, along (0, 1)" in complaint(sliding, f=["0", "1"])
    assert "rigidly, about the point (0.5" in complaint(
        ElasticBoundary(["y0"], neumann=["x1", "y1"], fixed={"x0": "x"}), f=["0", "0"], gap="0"
    ).replace("along (0, 1)", "about the point (0.5")
    penalised = SetRule(Condition.NO_FLUX, pressed_more, penalty=Penalty.TRACE)
    for told, *given in (
        (
            "algorithm: elastic contact is solved by alg1 or alg2",
            *map(Options, ("alg3", "qp", penalised)),
        ),
        ("backend: elastic contact has no such option", Options(backend="mixed")),
        ("rho: elastic contact has no such option", Options(rho=2.0)),
        ("eps: elastic contact has no such option", Options(eps=1e-3)),
    ):
        for options in given:
            with pytest.raises(InputError, match=told):
                solve(box(COMM, 2, *UNIT[2]), Elasticity(1.0, 0.3, conditions=[Contact("y0")]), options)
    with pytest.raises(InputError, match="fixed: part 'x0' has 'xx'"):
        ElasticBoundary(["y0"], fixed={"x0": "xx"})
    with pytest.raises(InputError, match="unknown 'thin'"):
        ElasticProblem(1.0, 0.3, plane="thin")
    with pytest.raises(InputError, match="plane: a body in space is not in plane stress; leave it out"):
        solve(box(COMM, 1, *UNIT[3]), Elasticity(1.0, 0.3, plane="stress", conditions=[Contact("y0")]))
    with pytest.raises(InputError, match="laws: must be a list of laws, such as"):
        ElasticProblem(1.0, 0.3, laws=["wall"])  # type: ignore[list-item]
    with pytest.raises(InputError, match="laws: those of an elastic body hold on parts, not in regions"):
        ElasticProblem(1.0, 0.3, laws=[Corners([[0, 0]], region="all")])


def test_what_is_given_must_not_pass_the_foundation():
    """Where Γ_D meets Γ_C neither u_D nor a negative gap may have the body in the foundation; elsewhere both may."""
    for given in ({"u_D": ["0", "-0.1"]}, {"u_D": ["0", "0"], "gap": -0.1}):
        told = complaint(ElasticBoundary(["y0"], neumann=["x1"]), **given)
        assert "u_D passes the foundation where parts meet" in told
        assert "at (0, 0): no displacement satisfies both" in told
    pressed = Elasticity(1.0, 0.3, conditions=[Contact("y0", -0.1), Neumann(["x0", "x1"], 0)])
    solution = solve(box(COMM, 2, *UNIT[2]), pressed)
    assert solution.summary()["least_gap"] == pytest.approx(-0.1)


def test_nearly_incompressible():
    """The stress of a compression is right for each ν below ½; at 0.4999999 the run failed."""
    for nu in (0.4999999, 0.499999999):
        problem = Elasticity(1.0, nu, u_D=["0", "-0.05"], conditions=[Contact("y0"), Neumann(["x0", "x1"], 0)])
        solution = solve(box(COMM, 4, *UNIT[2]), problem)
        assert solution.norms()["contact_force"] == pytest.approx(0.0752, abs=0.003)
        assert certify(solution).relative < 0.2


def test_displacements_that_differ_where_parts_meet_have_no_bound():
    """No displacement of finite energy has both, so there is no exact solution; its bound was called guaranteed."""
    for shift, told in (("0", ""), ("0.01", "at (0, 1) parts meet on which different displacements are given")):
        problem = Elasticity(
            1.0,
            0.3,
            u_D=[f"0.1*x + {shift}", "-0.1"],
            conditions=[Contact("y0", 0.02), Dirichlet("x0", ["0", "0"], components="n"), Neumann("x1", 0)],
        )
        certificate = certify(solve(box(COMM, 2, *UNIT[2]), problem))
        assert certificate.guaranteed == (not told)
        assert told in str(certificate)
