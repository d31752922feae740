"""Meshes with ghost cells, as DOLFINx makes them on several ranks: results are on them, and equal those without."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import GhostMode, Mesh, create_unit_cube, create_unit_square
from mpi4py import MPI

from signorini_fenicsx import (
    Contact,
    Coulomb,
    Diffusion,
    Dirichlet,
    Domain,
    Elasticity,
    Evolution,
    Neumann,
    Obstacle,
    Options,
    Signorini,
    Solution,
    StepBounds,
    adapt,
    domain_of,
    evolve,
    load_solution,
    solve,
)
from signorini_fenicsx.quantities import Flux

COMM = MPI.COMM_WORLD


def domains(n: int, dim: int = 2) -> list[Domain]:
    """The unit square or cube on a mesh without ghosts, and on one with them."""
    make = create_unit_square if dim == 2 else create_unit_cube
    sides = {"bottom": (dim - 1, 0), "top": (dim - 1, 1), "left": (0, 0), "right": (0, 1)}
    walls = {name: lambda x, axis=axis, at=at: np.isclose(x[axis], at) for name, (axis, at) in sides.items()}
    regions = {"west": lambda x: x[0] < 0.5 + 1e-9, "east": lambda x: x[0] > 0.5 - 1e-9}
    made = []
    for mode in (GhostMode.none, GhostMode.shared_facet):
        mesh = make(COMM, *[n] * dim, ghost_mode=mode)
        assert has_ghosts(mesh) == (mode == GhostMode.shared_facet)
        made.append(domain_of(mesh, walls, regions))
        assert made[-1].mesh is mesh
    return made


def has_ghosts(mesh: Mesh) -> bool:
    """Whether any rank has ghost cells."""
    return COMM.allreduce(mesh.topology.index_map(mesh.topology.dim).num_ghosts) > 0


def same(results: Callable[[Domain], dict[str, Any]], n: int, dim: int = 2) -> None:
    """Numbers on both meshes are equal."""
    one, other = (results(domain) for domain in domains(n, dim))
    assert one.keys() == other.keys()
    for name, value in one.items():
        size = np.abs(np.asarray(value)).max(initial=1e-3)
        np.testing.assert_allclose(other[name], value, rtol=0, atol=1e-10 * size, err_msg=name)


def checked(domain: Domain, *functions: fem.Function) -> None:
    """Functions are on the mesh that was given, and have the values of other ranks where these own them."""
    for function in functions:
        before = function.x.array.copy()
        function.x.scatter_forward()
        np.testing.assert_array_equal(function.x.array, before)
        assert function.function_space.mesh is domain.mesh


def integral(mesh: Mesh, form: Any) -> float:
    """Integral over all ranks."""
    return float(mesh.comm.allreduce(fem.assemble_scalar(fem.form(form))))


def numbers(domain: Domain, solution: Solution) -> dict[str, Any]:
    """Norms, contact, the bound and values at points."""
    certificate = solution.certify()
    checked(domain, solution.u, certificate.indicator)
    at = solution.at(np.random.default_rng(0).random((5, domain.mesh.topology.dim)))
    return {
        "bound": certificate.bound,
        "contact": solution.contact.measure,
        "u": at.u,
        "sigma": at.sigma,
        **solution.norms(),
    }


@pytest.mark.parallel([2, 4])
def test_scalar():
    """Data in UFL and by region, laws in Ω; both backends, a penalty, P1; a quantity; an error in UFL on the mesh."""

    def results(domain: Domain) -> dict[str, Any]:
        mesh = domain.mesh
        x = ufl.SpatialCoordinate(mesh)
        unilateral = Signorini("bottom", psi="-0.02*x", q_S=0.1)
        problem = Diffusion(f=40 * (x[0] - 0.6), kappa=1 + x[1], c="x", conditions=[unilateral, Neumann("right", "y")])
        solution = solve(domain, problem)
        found = numbers(domain, solution)
        checked(domain, solution.sigma)
        found["error"] = integral(mesh, (solution.u - x[0] * x[1]) ** 2 * ufl.dx)
        if has_ghosts(mesh):
            jump = ufl.jump(solution.sigma, ufl.FacetNormal(mesh))  # σ·n is the same from both sides
            assert integral(mesh, jump**2 * ufl.dS) < 1e-20
        interval = solution.quantity(Flux(["left", "top"]))
        found["flux"] = [interval.value, interval.lower, interval.upper]
        for algorithm in ("alg4", "primal-pdas"):
            found[algorithm] = list(solve(domain, problem, Options(algorithm=algorithm)).norms().values())
        found["mixed"] = list(solve(domain, problem, Options(backend="mixed")).norms().values())
        held = [Obstacle(region="west", psi="-0.3 - 0.1*x"), Obstacle(region="east", psi=-0.4), Neumann("right")]
        membrane = solve(domain, Diffusion(f=-20, kappa={"west": 1, "east": 2}, conditions=held))
        checked(domain, membrane.force())
        facets = COMM.allreduce(len(membrane.free_boundary()))
        return found | {"free boundary": facets, "held": membrane.norms()["u_L2"], "of": membrane.certify().bound}

    same(results, 6)


@pytest.mark.parallel([2, 4])
def test_derivatives():
    """Gradients and derivatives of both physics by constants and functions."""

    def results(domain: Domain) -> dict[str, Any]:
        mesh = domain.mesh
        x, k = ufl.SpatialCoordinate(mesh), fem.Constant(mesh, 1.0)
        load = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)))
        load.interpolate(lambda x: 40 * (x[0] - 0.6))
        problem = Diffusion(f=load, kappa=k + x[1], c=0.5 * k, conditions=[Signorini("bottom"), Neumann("right")])
        solution = solve(domain, problem)
        value, (of_k, of_load) = solution.gradient(solution.u**2 * ufl.dx, [k, load])
        change = solution.derivative({k: 1.0})
        checked(domain, change.u, change.sigma)
        conditions = [Contact("bottom", gap=0.1 * k), Dirichlet("top", ["0", "-0.3"]), Neumann(["left", "right"])]
        body = solve(domain, Elasticity(young=k + x[0], poisson=0.3, conditions=conditions))
        moved = body.derivative({k: 1.0}).u
        checked(domain, moved)
        return {
            "gradient": [value, of_k, COMM.allreduce(of_load @ of_load)],
            "u": integral(mesh, change.u**2 * ufl.dx),
            "body": [*body.gradient(ufl.inner(body.u, body.u) * ufl.dx, [k])[1]],
            "moved": integral(mesh, ufl.inner(moved, moved) * ufl.dx),
        }

    same(results, 4)


@pytest.mark.parallel([2, 4])
@pytest.mark.parametrize("dim", [2, 3])
def test_elastic(dim: int):
    """A body, in the plane with friction and a bound, and in space."""

    def results(domain: Domain) -> dict[str, Any]:
        friction = Coulomb(0.3) if dim == 2 else None
        held = Dirichlet("top", [0.05, *[0] * (dim - 2), -0.2])
        conditions = [Contact("bottom", gap="0.02*x", friction=friction), Neumann(["left", "right"]), held]
        load = [0.1 * ufl.SpatialCoordinate(domain.mesh)[1], *[-0.2] * (dim - 1)]
        body = solve(domain, Elasticity(young="1 + x", poisson=0.3, f=load, conditions=conditions))
        checked(domain, body.u)
        return numbers(domain, body) if dim == 2 else body.norms() | {"contact": body.contact.measure}

    same(results, {2: 3, 3: 2}[dim], dim)


@pytest.mark.parallel([2, 4])
def test_files_refinement_and_time(folder: Path):
    """Solutions are read again, meshes refined, and steps in time bounded."""

    def results(domain: Domain) -> dict[str, Any]:
        problem = Diffusion(f="40*(x - 0.6)", conditions=[Signorini("bottom"), Neumann("right")])
        solution = solve(domain, problem)
        solution.write(folder)
        again = load_solution(folder)
        assert again.norms() == pytest.approx(solution.norms(), rel=1e-10)
        assert again.certify().bound == pytest.approx(solution.certify().bound, rel=1e-10)
        finer, certificate = adapt(domain, problem, max_cells=100)
        falling = Diffusion(f="-20*t", c=1.0, conditions=[Signorini("bottom", psi=-0.05), Neumann("right")])
        bounds, steps = StepBounds(), []
        for instant in evolve(domain, falling, Evolution(end=0.4, steps=2)):
            steps += [bounds.certify(instant).bound, *instant.solution.norms().values()]
            checked(domain, instant.solution.u, instant.solution.sigma)
        return {"finer": [certificate.bound, finer.spaces.domain.cells, *finer.norms().values()], "steps": steps}

    same(results, 4)
