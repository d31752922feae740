"""The Python interface: its examples, data of all kinds, refusals, and a discretisation of one's own."""

import doctest
from collections.abc import Callable, Mapping
from pathlib import Path

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, GhostMode, create_unit_square
from mpi4py import MPI

from signorini_fenicsx import api
from signorini_fenicsx.api import Condition, Data, FacetConditions, Iterate, Problem, Solve, Spaces, solve_on
from signorini_fenicsx.backends.hybrid import HybridBackend
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.output.writing import write_solution

COMM = MPI.COMM_WORLD
WALLS: Mapping[str, Callable[[npt.NDArray], npt.NDArray]] = {
    "bottom": lambda x: np.isclose(x[1], 0),
    "right": lambda x: np.isclose(x[0], 1),
    "middle": lambda x: np.isclose(x[0], 0.5),
}


def square(n: int = 8, **options: object) -> tuple[dolfinx.mesh.Mesh, dict[str, npt.NDArray[np.int32]]]:
    """A mesh and its parts."""
    mesh = create_unit_square(COMM, n, n, **({"ghost_mode": GhostMode.none} | options))
    mesh.topology.create_connectivity(1, 2)
    return mesh, {name: dolfinx.mesh.locate_entities(mesh, 1, where) for name, where in WALLS.items()}


def test_examples():
    failed, tried = doctest.testmod(api, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert tried > 10
    assert failed == 0


@pytest.mark.parallel([1, 2])
def test_kinds_of_data(folder: Path):
    """Numbers, UFL, functions of points, finite element functions and values per region say the same."""
    mesh, parts = square()
    x = ufl.SpatialCoordinate(mesh)
    quadratic = fem.Function(fem.functionspace(mesh, ("Lagrange", 2)))
    quadratic.interpolate(lambda x: 20 * (x[0] - 0.6) * (1 + x[1]))
    left = dolfinx.mesh.compute_midpoints(mesh, 2, np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32))
    cells = np.flatnonzero(left[:, 0] < 0.5).astype(np.int32), np.flatnonzero(left[:, 0] > 0.5).astype(np.int32)
    regions = {"west": cells[0], "east": cells[1]}
    problems = [
        Problem(f=quadratic, kappa={"west": 1, "east": 3}, psi=lambda x: -0.01 * x[0]),
        Problem(
            f=lambda x: 20 * (x[0] - 0.6) * (1 + x[1]),
            kappa=lambda x: np.where(x[0] < 0.5, 1.0, 3.0) * np.eye(2)[:, :, None],
            psi=-0.01 * x[0],
        ),
        Problem(
            f=20 * (x[0] - 0.6) * (1 + x[1]),
            kappa={"east": ufl.as_matrix([[3, 0], [0, 3]]), "west": 1.0},
            psi=-0.01 * x[0],
            u_D=0,
        ),
    ]
    one, two, three = (
        solve_on(mesh, problem, parts=parts, signorini=["bottom"], neumann=["right"], regions=regions)
        for problem in problems
    )
    assert 0 < one.contact()[0] < 8
    for other in (two, three):
        np.testing.assert_allclose(other.sigma.x.array, one.sigma.x.array, atol=1e-11)
        np.testing.assert_allclose(other.p.x.array, one.p.x.array, atol=1e-11)
    certificate = certify(one)
    assert 0 < certificate.bound < 1
    write_solution(one, folder, certificate=certificate)
    assert (folder / "facets.csv").is_file()


class Counting:
    """A backend of one's own: the hybrid one, counting its solves."""

    name = "counting"
    solves = 0

    def __init__(self, spaces: Spaces, data: Data):
        self.spaces, self.data = spaces, data
        self._inner = HybridBackend(spaces, data)
        self.dofs = self._inner.dofs

    def solver(self) -> str:
        """Its name."""
        return self._inner.solver()

    def solve(self, conditions: FacetConditions) -> Iterate:
        """Solve and count."""
        Counting.solves += 1
        return self._inner.solve(conditions)


@pytest.mark.parallel(2)
def test_own_backend():
    mesh, parts = square()
    x = ufl.SpatialCoordinate(mesh)
    options = Solve(algorithm="alg4", eps=1e-3)
    solution = solve_on(
        mesh, Problem(f=40 * (x[0] - 0.6)), parts=parts, signorini=["bottom"], options=options, backend=Counting
    )
    assert Counting.solves == len(solution.history) + 1  # the start, too
    assert solution.backend == "counting"
    assert np.all((solution.conditions.kind == Condition.ZERO_TRACE) | (solution.conditions.kind == Condition.ROBIN))


@pytest.mark.parallel(2)
def test_refusals():
    mesh, parts = square()
    f = Problem(f=1.0)
    with pytest.raises(InputError, match="signorini: unknown part 'top'; there are bottom, right, middle"):
        solve_on(mesh, f, parts=parts, signorini=["top"])
    with pytest.raises(InputError, match="part 'middle' has 8 facets that are inside the domain or in another part"):
        solve_on(mesh, f, parts=parts, signorini=["middle"])
    with pytest.raises(InputError, match="part 'right' has 8 facets that are inside"):
        solve_on(mesh, f, parts=parts | {"bottom": parts["right"]}, signorini=["bottom"], neumann=["right"])
    with pytest.raises(InputError, match="part 'none' has no facet"):
        solve_on(mesh, f, parts={"none": np.empty(0, dtype=np.int32)}, signorini=["none"])
    with pytest.raises(InputError, match="psi: has shape"):
        solve_on(mesh, Problem(f=1.0, psi=ufl.SpatialCoordinate(mesh)), parts=parts, signorini=["bottom"])
    with pytest.raises(InputError, match=r"8 cells have no value|no value"):
        solve_on(
            mesh,
            Problem(f=1.0, kappa={"west": 1.0}),
            parts=parts,
            signorini=["bottom"],
            regions={"west": np.empty(0, dtype=np.int32)},
        )
    everywhere = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    with pytest.raises(InputError, match="cells are in more than one of one, two"):
        solve_on(
            mesh,
            Problem(f=1.0, kappa={"one": 1.0, "two": 2.0}),
            parts=parts,
            signorini=["bottom"],
            regions={"one": everywhere, "two": everywhere[:1]},
        )
    quads, parts = square(cell_type=CellType.quadrilateral)
    with pytest.raises(InputError, match="must consist of triangles or tetrahedra"):
        solve_on(quads, f, parts=parts, signorini=["bottom"])
    ghosted, parts = square(ghost_mode=GhostMode.shared_facet)
    with pytest.raises(InputError, match="has ghost cells"):
        solve_on(ghosted, f, parts=parts, signorini=["bottom"])
