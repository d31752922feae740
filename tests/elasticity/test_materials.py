"""Orthotropic bodies, eigenstrain and initial stress: exact solutions, bounds, each other, refusals."""

from collections.abc import Sequence

import dolfinx.mesh
import numpy as np
import pytest
import ufl
from elastic import box
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.physics.elasticity.conditions import Contact
from signorini_fenicsx.physics.elasticity.problem import Dirichlet, Elasticity, Neumann
from signorini_fenicsx.physics.elasticity.show.readings import von_mises
from signorini_fenicsx.physics.elasticity.show.shown import in_space
from signorini_fenicsx.quantities import Mean
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
E, NU, G = [3.0, 1.0, 2.0], [0.3, 0.2, 0.25], [0.7, 0.9, 0.4]
TURN = {2: np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]]), 3: np.array([[1, 2, 2], [2, 1, -2], [2, -2, 1]]) / 3}


def local_stiffness() -> np.ndarray:
    """The matrix from ε₁₁, ε₂₂, ε₃₃, ε₁₂, ε₁₃, ε₂₃ to stresses along the axes."""
    normal = np.diag([1 / e for e in E])
    for k, (i, j) in enumerate([(0, 1), (0, 2), (1, 2)]):
        normal[i, j] = normal[j, i] = -NU[k] / E[i]
    found = np.zeros((6, 6))
    found[:3, :3], found[3:, 3:] = np.linalg.inv(normal), 2 * np.diag(G)
    return found


def stress_of(strain: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """The stress of a strain in space, both matrices in coordinates; the rows of `turn` are the axes."""
    own = turn @ strain @ turn.T
    values = local_stiffness() @ own[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    rows = values[[0, 3, 4]], values[[3, 1, 5]], values[[4, 5, 2]]
    return np.array(turn.T @ np.array(rows) @ turn)


def strain_of(stress: np.ndarray, plane: str, turn: np.ndarray) -> np.ndarray:
    """The strain in space of a stress; in plane strain with the σ_zz that ε_zz = 0 needs."""
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    units = [np.array([[float({i, j} == {a, b}) for b in range(3)] for a in range(3)]) for i, j in pairs]
    matrix = np.array([[stress_of(unit, turn)[pair] for unit in units] for pair in pairs])
    keep = [k for k in range(6) if plane != "strain" or k != 2]
    values = np.zeros(6)
    values[keep] = np.linalg.solve(matrix[np.ix_(keep, keep)], [stress[pairs[k]] for k in keep])
    return sum((value * unit for value, unit in zip(values, units, strict=True)), np.zeros((3, 3)))


def linear(matrix: np.ndarray) -> list[str]:
    """The displacement with this gradient."""
    return ["+".join(f"({float(c)!r})*{x}" for c, x in zip(row, "xyz", strict=False)) for row in matrix]


@pytest.mark.parametrize(("dim", "plane"), [(2, "strain"), (2, "stress"), (3, "")])
def test_patch(dim: int, plane: str):
    """A constant stress in an orthotropic body with ε₀ and σ₀ is found exactly, and so is its bound."""
    stress = np.diag([3.0, -2.0, 1.0 if dim == 3 else 0.0])
    own, at_rest = np.diag([0.2, -0.1, 0.3 if dim == 3 else 0.0]), np.diag([0.5, 0.4, 0.0])
    own[0, 1] = own[1, 0] = 0.1
    others = [part for part in ("x0", "x1", "y1", "z0", "z1") if part[0] in "xyz"[:dim]]
    u = linear((strain_of(stress - at_rest, plane, TURN[dim]) + own)[:dim, :dim])
    problem = Elasticity(
        young=E,
        poisson=NU,
        shear=G,
        axes=(2 * TURN[dim][: dim - 1, :dim]).tolist(),
        eigenstrain=own[:dim, :dim].tolist(),
        initial_stress=at_rest[:dim, :dim].tolist(),
        plane=plane or "strain",
        u_D=u,
        exact=u,
        conditions=[Contact("y0", gap=f"-({u[1]})"), Dirichlet(others, u)],
    )
    solution = solve(box(COMM, 2 if dim == 2 else 1, [0.0] * dim, [1.0] * dim), problem)
    assert solution.touching.all()
    np.testing.assert_allclose(
        solution.stresses, np.broadcast_to(stress[:dim, :dim], solution.stresses.shape), atol=1e-11
    )
    certificate = solution.certify()
    assert certificate.guaranteed
    assert certificate.bound < 1e-6 * solution.norms()["energy"]
    assert solution.errors()["energy"] < 1e-11


@pytest.mark.parametrize("plane", ["strain", "stress"])
def test_orders_and_bounds(plane: str):
    """A quadratic stress and the ε₀ that it needs: order 2, and a guaranteed bound near the error."""
    units = [[(1, 0), (0, 0)], [(0, 0), (0, 1)], [(0, 1), (1, 0)]]
    sigma = "(x^2 - y)", "(-2 - x + y^2)", "(y*(1 + x))"
    strains = [strain_of(np.pad(np.array(unit, dtype=float), (0, 1)), plane, TURN[2]) for unit in units]

    def own(i: int, j: int, of_u: str) -> str:
        return of_u + "".join(f" - ({float(e[i, j])!r})*{s}" for e, s in zip(strains, sigma, strict=True))

    off = own(0, 1, "0.4*x*y")
    errors, bounds = [], []
    for n in (4, 8):
        problem = Elasticity(
            young=E,
            poisson=NU,
            shear=G,
            axes=[[4, 3]],
            plane=plane,
            eigenstrain=[[own(0, 0, "0.4*x + 0.1*y^2"), off], [off, own(1, 1, "0.3*x^2 - 0.5")]],
            f=["-(3*x + 1)", "-3*y"],
            exact=["0.2*x^2 + 0.1*x*y^2", "0.3*y*x^2 - 0.5*y"],
            conditions=[
                Contact("y0"),
                Neumann("y1", ["1 + x", "-1 - x"]),
                Dirichlet("x0", ["0", "-0.5*y"]),
                Dirichlet("x1", ["0.2 + 0.1*y^2", "-0.2*y"]),
            ],
        )
        solution = solve(box(COMM, n, [0.0, 0.0], [1.0, 1.0]), problem)
        certificate = solution.certify()
        assert certificate.guaranteed
        errors.append(solution.errors()["energy"])
        bounds.append(certificate.sigma_bound)
    assert np.log2(errors[0] / errors[1]) > 1.9
    assert all(error <= bound <= 2 * error for error, bound in zip(errors, bounds, strict=True))


def pressed(**data: object) -> tuple[np.ndarray, float, float]:
    """A block that is pressed onto a plane: its stress, its bound, and its largest von Mises stress."""
    given = {"young": 2.0, "poisson": 0.3, "u_D": ["0.02*y", "-0.1*y"]} | data
    conditions = [Contact("y0", gap="0.02*x^2"), Neumann("x1")]
    solution = solve(box(COMM, 4, [0.0, 0.0], [1.0, 1.0]), Elasticity(**given, conditions=conditions))
    equivalent = von_mises(in_space(solution.spaces, solution.data, solution.stresses)).max()
    return solution.stresses, solution.certify().bound, float(equivalent)


def test_all_constants_are_expressions():
    """E, ν and the axes as texts, E as UFL: f of a known u, order 2, and a bound above the error and near it."""
    errors, ratios = [], []
    for n in (4, 8):
        domain = box(COMM, n, [0.0, 0.0], [1.0, 1.0])
        x = ufl.SpatialCoordinate(domain.mesh)
        young, nu = 1 + x[0] / 2, 0.2 + x[1] / 10
        u = ufl.as_vector([0.1 * x[0] * x[1], 0.05 * x[0] ** 2 - 0.3 * x[1]])
        lame, mu = young * nu / ((1 + nu) * (1 - 2 * nu)), young / (2 * (1 + nu))
        sigma = 2 * mu * ufl.sym(ufl.grad(u)) + lame * ufl.div(u) * ufl.Identity(2)
        given = "1 + x/2", "0.2 + y/10"
        materials = [
            {"young": given[0], "poisson": given[1]},
            {"young": 3 * [given[0]], "poisson": 3 * [given[1]], "shear": [0, 0, 0], "axes": [["cos(x)", "sin(x)"]]},
            {"young": young, "poisson": given[1]},
        ]
        solutions = [solve(domain, Elasticity(**each, f=-ufl.div(sigma), u_D=u, exact=u)) for each in materials]
        for other in solutions[1:]:
            np.testing.assert_allclose(other.stresses, solutions[0].stresses, atol=1e-10)
        errors.append(solutions[0].errors()["energy"])
        ratios.append([each.certify().bound / errors[-1] for each in (solutions[0], solutions[-1])])
    assert errors[1] < 0.3 * errors[0]
    assert np.min(ratios) > 1
    assert np.max(ratios) < 5


def test_the_same_in_other_words():
    """Isotropic by three constants, σ₀ as the ε₀ of −𝔸σ₀, and values by region or everywhere: the same results."""
    plain = pressed()
    isotropic = {"young": [2.0] * 3, "poisson": [0.3] * 3, "shear": [2 / 2.6] * 3, "axes": [["1", "x"]]}
    for found, wanted in zip(pressed(**isotropic), plain, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-11)
    squeezed = pressed(initial_stress=[["0.1*x", 0.02], [0.02, -0.2]])
    strain = [["-(0.05*x + 0.03)", -0.013], [-0.013, "0.1 + 0.015*x"]]
    in_stress = pressed(initial_stress=[["0.1*x", 0.02], [0.02, -0.2]], plane="stress")
    by_strain = pressed(eigenstrain=strain, plane="stress")
    np.testing.assert_allclose(by_strain[0], in_stress[0], atol=1e-12)
    assert by_strain[1] == pytest.approx(in_stress[1], rel=1e-8)
    assert abs(squeezed[0] - in_stress[0]).max() > 1e-3


@pytest.mark.parametrize(("plane", "factor"), [("strain", 1 / 0.4), ("stress", 1 / 0.7)])
def test_heat_between_walls(plane: str, factor: float):
    """A block that cannot expand: σ = −EαΔT/(1 − 2ν) in plane strain, also along z; −EαΔT/(1 − ν) in plane stress."""
    problem = Elasticity(
        young=5.0,
        poisson=0.3,
        eigenstrain=0.01,
        plane=plane,
        conditions=[Contact("y0"), *(Dirichlet(part, components="n") for part in ("x0", "x1", "y1"))],
    )
    solution = solve(box(COMM, 2, [0.0, 0.0], [1.0, 1.0]), problem)
    stresses = in_space(solution.spaces, solution.data, solution.stresses)
    wanted = -0.05 * factor * np.diag([1, 1, 1 if plane == "strain" else 0])
    np.testing.assert_allclose(stresses, np.broadcast_to(wanted, stresses.shape), atol=1e-13)


def test_ground_at_rest():
    """A stress that carries the weight already leaves nothing to move."""
    problem = Elasticity(
        young=3.0,
        poisson=0.3,
        f=["0", "-2"],
        initial_stress=[["-0.5*2*(1 - y)", 0], [0, "-2*(1 - y)"]],
        conditions=[Contact("y0"), Neumann("y1"), Dirichlet(["x0", "x1"], components="n")],
    )
    solution = solve(box(COMM, 2, [0.0, 0.0], [1.0, 1.0]), problem)
    assert np.abs(solution.u.x.array).max() < 1e-14
    np.testing.assert_allclose(solution.pressure, 2.0, rtol=1e-12)


def complaint(**data: object) -> str:
    """What is said of a body that cannot be."""
    with pytest.raises(InputError) as error:
        pressed(**data)
    return str(error.value)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"young": [1, 1]}, "[problem] young: has 2 values along axes, not 3"),
        ({"young": [1, 1, 2]}, "shear: where young has three values it is [G12, G13, G23]"),
        ({"young": [1, 1, -1], "shear": 1}, "young: must be positive and finite everywhere; its smallest value is -1"),
        (
            {"young": [1, 9, 1], "shear": 1, "poisson": [0.5, 0.2, 0.2]},
            "poisson: with these three and young there would be strains",
        ),
        ({"shear": [1, "x - 1/2", 1]}, "shear: must be positive and finite everywhere; its smallest value is -0."),
        ({"axes": [[0, 0]], "shear": 1}, "axes: must be finite directions"),
        ({"axes": [[1, 2]]}, "axes: do nothing for an isotropic material"),
        ({"axes": [1, 0]}, "axes: has 2 directions, not 1"),
        ({"axes": [[1, 0, 0]]}, "axes: has 3 components, not 2"),
        ({"eigenstrain": [[1, 0], [0.1, 1]]}, "eigenstrain: must be a number or a symmetric matrix"),
        ({"initial_stress": "1/(x - x)"}, "initial_stress: not finite everywhere"),
        ({"eigenstrain": {"core": 1}}, "eigenstrain: unknown region 'core'"),
    ],
)
def test_bad_materials(data: dict[str, Sequence[object]], said: str):
    """Each is one sentence with the place."""
    assert said in complaint(**data)


def test_force_by_region():
    """One force for each region is that of a text with cases, also in quantities; one for some regions is refused."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 2, 2)
    ends = {"top": lambda x: np.isclose(x[1], 1), "bottom": lambda x: np.isclose(x[1], 0)}
    halves = {"left": lambda x: x[0] <= 0.5, "right": lambda x: x[0] >= 0.5}
    domain = domain_of(mesh, {**ends, "sides": lambda x: np.isclose(x[0] * (1 - x[0]), 0)}, halves)
    forces = {"left": [0, -1], "right": ["0.5*y", "-2"]}, ["0 if x < 0.5 else 0.5*y", "-1 if x < 0.5 else -2"]
    rest = [Contact("bottom"), Neumann("sides")]
    found = [solve(domain, Elasticity(young=1, poisson=0.3, f=f, conditions=rest)) for f in forces]
    assert abs(found[0].stresses - found[1].stresses).max() < 1e-12
    means = [solution.quantity(Mean(direction=[0, 1], region="left")) for solution in found]
    assert means[0].lower == pytest.approx(means[1].lower, abs=1e-9)
    with pytest.raises(InputError, match="regions without one: right"):
        solve(domain, Elasticity(young=1, poisson=0.3, f={"left": [0, -1]}, conditions=rest))
