"""What surfaces pass on within facets: the bound of its work beside that of displacements and one by constants."""

import basix.ufl
import dolfinx.mesh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.certificate.passed_on import Passed, hats_on_facet, kuhn_lattice, oscillation
from signorini_fenicsx.meshes.domain import distribute
from signorini_fenicsx.physics.elasticity.bound.korn import trace_constants
from signorini_fenicsx.physics.elasticity.bound.passed_on import response

COMM = MPI.COMM_SELF
CELLS = {
    "right triangle": [[1.0, 0.0], [0.0, 0.8]],
    "flat triangle": [[1.0, 0.4], [0.1, 0.3]],
    "of a box": [[0.5, 0.0, 0.0], [0.0, 0.7, 0.0], [0.0, 0.0, 0.6]],
    "slanted": [[0.9, -0.2, 0.1], [0.3, 0.6, -0.2], [0.0, 0.1, 0.8]],
}
"""The edges of the path over some cells, by columns."""
PARTS = {2: 11, 3: 5}
"""The facet consists of lattices with so many parts of an edge, some of which are loaded."""
PULL = np.array([0.3, -0.4, 1.0])


def loaded(x: np.ndarray) -> np.ndarray:
    """Whether a pull acts on the small facet with this middle on Kuhn's simplex."""
    return np.asarray(x[..., 0] + 0.4 * x[..., 1] > 0.55)


def work(edges: np.ndarray, fitted: np.ndarray) -> float:
    """The largest ⟨r, w⟩/‖ε(w)‖ of quadratic w on a lattice, r being the pull less the linear traction `fitted`."""
    dim, to_kuhn = len(edges), np.linalg.inv(edges)
    places = kuhn_lattice(dim, PARTS[dim])
    points, cells = np.unique(places.reshape(-1, dim), axis=0, return_inverse=True)
    mesh = distribute(COMM, points / PARTS[dim] @ edges.T, cells.reshape(-1, dim + 1), dim)
    on = dolfinx.mesh.locate_entities_boundary(mesh, dim - 1, lambda x: np.abs(to_kuhn[-1] @ x[:dim]) < 1e-9)
    chosen = loaded(dolfinx.mesh.compute_midpoints(mesh, dim - 1, on)[:, :dim] @ to_kuhn.T)
    ds = ufl.Measure("ds", mesh, subdomain_data=dolfinx.mesh.meshtags(mesh, dim - 1, on, 1 + chosen.astype(np.int32)))
    space = fem.functionspace(mesh, basix.ufl.element("P", mesh.basix_cell(), 2, shape=(dim,)))
    w, q = ufl.TrialFunction(space), ufl.TestFunction(space)
    x = ufl.dot(ufl.as_matrix(to_kuhn.tolist()), ufl.SpatialCoordinate(mesh))
    hats = [1 - x[0], *(x[k] - x[k + 1] for k in range(dim - 1))]
    linear = ufl.dot(ufl.as_matrix(fitted.T.tolist()), ufl.as_vector(hats))
    pulling = ufl.inner(ufl.as_vector(PULL[:dim].tolist()), q) * ds(2) - ufl.inner(linear, q) * ds((1, 2))
    matrix = fem.assemble_matrix(fem.form(ufl.inner(ufl.sym(ufl.grad(w)), ufl.sym(ufl.grad(q))) * ufl.dx)).to_dense()
    load = fem.assemble_vector(fem.form(pulling)).array
    moved = np.linalg.solve(matrix + 1e-9 * np.eye(len(load)), load)
    return float(load @ moved / np.sqrt(moved @ matrix @ moved))


@pytest.mark.parametrize("name", CELLS)
def test_between_displacements_and_constants(name: str) -> None:
    """The bound is above the work on displacements, less than twice that, and far below that by the constant."""
    edges = np.array(CELLS[name])
    dim = len(edges)
    facets = kuhn_lattice(dim, PARTS[dim])[:, :dim]
    facets = facets[(facets[:, :, -1] == 0).all(axis=1)] / PARTS[dim]
    corners = hats_on_facet(facets[loaded(facets.mean(axis=1))])
    passed = Passed(np.zeros(len(corners), dtype=int), corners, np.tile(PULL[:dim], (len(corners), dim, 1)))
    moments, squares = passed.moments(1)[0], passed.squares(1)[0]
    fitted = dim * ((dim + 1) * np.eye(dim) - 1) @ moments
    bound = oscillation(COMM, passed, edges[None], np.eye(dim * (dim + 1) // 2)[None], response(dim))[0]
    size = np.sqrt(np.linalg.det(edges[:, :-1].T @ edges[:, :-1])) / (dim - 1)
    constant = trace_constants(edges.cumsum(axis=1)[None], np.array([size]))[0]
    least = work(edges, fitted)
    assert least < bound < 1.8 * least
    assert bound < constant * np.sqrt(size * (squares - (fitted * moments).sum())) / 2


def test_what_stresses_balance() -> None:
    """Nothing is left of a linear traction; pieces that overlap act together."""
    edges = np.array(CELLS["of a box"])[None]
    values = np.random.default_rng(1).uniform(-1, 1, (3, 3))
    whole = Passed(np.zeros(2, dtype=int), np.tile(np.eye(3), (2, 1, 1)), np.stack([values, -0.3 * values]))
    assert oscillation(COMM, whole, edges, np.eye(6)[None], response(3))[0] < 1e-6
    assert whole.squares(1)[0] == pytest.approx(
        0.49 * Passed(*(each[:1] for each in (whole.place, whole.corners, whole.values))).squares(1)[0]
    )
