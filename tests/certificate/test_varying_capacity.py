"""The bound of a step is near its error where a capacity jumps, oscillates or bends within cells."""

import dolfinx
import numpy as np
import pytest
from made_cases import refined
from makers.bounds import difference
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Evolution, Signorini, StepBounds, evolve
from signorini_fenicsx.base.owned import function_of
from signorini_fenicsx.base.reference_cells import positive_quadrature
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.points import PartPoints
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
CONTACT = [Signorini("bottom", psi=-1)]


@pytest.mark.parametrize(
    ("capacity", "u_0", "sharp"),
    [
        ("1 if x < 0.37 else 10", "sin(3*x)", 1.6),  # was 6.4
        ("1 if x < 0.37 else 100", "sin(3*x)", 3),  # was 30
        ("1 if x < 0.37 else 100", 0, 3),  # was 18
        ("100 if x + y < 0.77 else 1", "sin(3*x)", 1.5),  # was 167
        ("100*sin(20*x)^2", "sin(3*x)", 3),  # was 139
        ("1 + 99*x^2", "sin(3*x)", 2),  # was 2.2
    ],
)
def test_first_step(capacity: str, u_0: float | str, sharp: float):
    """Against a finer solution of the same step, which starts from u_0 as given, too."""
    coarse = build_domain(COMM, "square", 0.25, mesh="structured")
    evolution, problem = Evolution(0.05, 1, u_0, capacity), Diffusion(f=10, conditions=CONTACT)
    one, other = (next(iter(evolve(domain, problem, evolution))) for domain in (coarse, refined(coarse, 2)))
    certificate, error = StepBounds().certify(one), difference(one.solution, other.solution)
    assert certificate.proved
    assert error < certificate.sigma_bound < sharp * error


def test_second_step():
    """Against a finer solution with the content of the first step: the capacity times its continuous function."""
    capacity, bounds = "1 if x < 0.375 else 100", StepBounds()  # the finer mesh has the jump
    coarse = build_domain(COMM, "square", 0.25, mesh="structured")
    fine = refined(coarse, 2)
    first, second = evolve(coarse, Diffusion(f=10, conditions=CONTACT), Evolution(0.1, 2, 0, capacity))
    v = bounds.certify(first).v
    certificate, vertices = bounds.certify(second), corners(fine.mesh)
    middles = np.column_stack([vertices.mean(axis=1), np.zeros(len(vertices))])
    tree = dolfinx.geometry.bb_tree(coarse.mesh, 2)
    inside = dolfinx.geometry.compute_collisions_points(tree, middles)
    links = dolfinx.geometry.compute_colliding_cells(coarse.mesh, inside, middles)
    cells = np.array([links.links(row)[0] for row in range(len(middles))], dtype=np.int32)
    points = PartPoints(coarse.mesh, cells, *positive_quadrature(coarse.mesh.basix_cell(), 4), vertices)
    means, area = points.means(points.bernstein(v)[:, :, 0]), points.scale
    u_h, of_cells = first.solution.u.x.array, np.bincount(cells, area)
    bubbles = 60 * (u_h - np.bincount(cells, area * means) / of_cells)  # 60 is one over the mean of λ_1 λ_2 λ_3
    content = means + bubbles[cells] * points.means(points.barycentric.prod(axis=2))
    content *= np.where(middles[:, 0] < 0.375, 1, 100)
    f = 10 + 20 * function_of(dolfinx.fem.functionspace(fine.mesh, ("DG", 0)), content, "content")
    error = difference(
        second.solution, solve(fine, Diffusion(f, c=f"20*({capacity})", conditions=[Signorini("bottom", -1)]))
    )
    assert certificate.proved
    assert error < certificate.sigma_bound < 2.5 * error
