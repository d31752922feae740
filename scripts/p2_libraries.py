"""The pressed block of `elastic_benchmark` by P2 displacements of scikit-fem and of NGSolve, each with its own solver.

uv run --group bench python scripts/p2_libraries.py [--dim 2|3] CELLS…

Each library assembles and factorises: scikit-fem by SciPy's LU, NGSolve by its sparse Cholesky. The sets are found by a
primal-dual active set, on the coefficients of Bernstein's basis on Γ_C as in `p2_contact`, so that the energy is above
the exact one. For each library and mesh a line of JSON has the unknowns, the set updates, the energy and the seconds of
the processor from the mesh to the displacement, the better of two runs.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import ngsolve as ng
import numpy as np
import scipy.sparse as sp
import skfem
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh
from skfem.models.elasticity import lame_parameters, linear_elasticity

sys.path.append(str(Path(__file__).parent / "benchmark"))
from pdas import primal_dual_active_set

YOUNG, POISSON, GAP, WEIGHT, PRESS = 1.0, 0.3, 0.02, -0.3, -0.1


@dataclass(frozen=True)
class Block:
    """The assembled problem.

    Attributes:
        matrix: The stiffness.
        load: The right side.
        held: Unknowns that are 0.
        normal: Unknowns of u_n on Γ_C: those of vertices, those of edges.
        ends: The unknowns of the vertices of each of these edges.
        shares: The value at an edge's unknown is so much of the mean of its vertices and so much of Bernstein's
            coefficient.
        solver: Makes of a matrix what solves with its rows and columns that are free.
    """

    matrix: sp.csr_array
    load: np.ndarray
    held: np.ndarray
    normal: tuple[np.ndarray, np.ndarray]
    ends: np.ndarray
    shares: tuple[float, float]
    solver: Callable[[sp.csr_array], Callable[[np.ndarray, np.ndarray], np.ndarray]]


def by_scikit_fem(dim: int, n: int) -> Block:
    """The block by scikit-fem."""
    ticks = [np.linspace(0, 2, 2 * n + 1)] + [np.linspace(0, 1, n + 1)] * (dim - 1)
    mesh = {2: skfem.MeshTri, 3: skfem.MeshTet}[dim].init_tensor(*ticks)
    element = skfem.ElementVector({2: skfem.ElementTriP2, 3: skfem.ElementTetP2}[dim]())
    basis = skfem.Basis(mesh, element)
    top = skfem.FacetBasis(mesh, element, facets=mesh.facets_satisfying(lambda x: np.isclose(x[dim - 1], 1)))
    weight = skfem.LinearForm(lambda v, _: WEIGHT * v[dim - 1])
    press = skfem.LinearForm(lambda v, _: PRESS * v[dim - 1])
    matrix = linear_elasticity(*lame_parameters(YOUNG, POISSON)).assemble(basis).tocsr()
    below = mesh.facets_satisfying(lambda x: np.isclose(x[dim - 1], 0))
    edges = below if dim == 2 else np.unique(mesh.f2e[:, below])
    pairs = (mesh.facets if dim == 2 else mesh.edges)[:, edges]
    of_edges = basis.facet_dofs if dim == 2 else basis.edge_dofs

    def solver(matrix: sp.csr_array) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        return lambda b, free: np.asarray(skfem.solve(*skfem.condense(matrix, b, I=free)))

    return Block(
        matrix,
        weight.assemble(basis) + press.assemble(top),
        basis.get_dofs(lambda x: np.isclose(x[0], 0)).all(),
        (basis.nodal_dofs[dim - 1, np.unique(mesh.facets[:, below])], of_edges[dim - 1, edges]),
        basis.nodal_dofs[dim - 1, pairs.T],
        (0.5, 0.5),
        solver,
    )


def by_ngsolve(dim: int, n: int) -> Block:
    """The block by NGSolve."""
    ng.SetNumThreads(1)
    if dim == 2:
        mesh = MakeStructured2DMesh(quads=False, nx=2 * n, ny=n, flip_triangles=True, mapping=lambda x, y: (2 * x, y))
    else:
        mesh = MakeStructured3DMesh(hexes=False, nx=2 * n, ny=n, nz=n, mapping=lambda x, y, z: (2 * x, y, z))
    left, below, top = (_side(mesh, *side) for side in ((0, 0.0), (dim - 1, 0.0), (dim - 1, 1.0)))
    space = ng.VectorH1(mesh, order=2, dirichlet=left)
    u, v = space.TnT()
    mu, lame = YOUNG / (2 * (1 + POISSON)), YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    strain, test = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    form = ng.BilinearForm(2 * mu * ng.InnerProduct(strain, test) * ng.dx + lame * ng.div(u) * ng.div(v) * ng.dx)
    load = ng.LinearForm(WEIGHT * v[dim - 1] * ng.dx + PRESS * v[dim - 1] * ng.ds(top))
    form.Assemble()
    load.Assemble()
    values, columns, rows = (np.array(each) for each in form.mat.CSR())
    normal, first = space.components[dim - 1], space.Range(dim - 1).start
    facets = [element for element in mesh.Elements(ng.BND) if element.mat == below]
    vertices = sorted({vertex.nr for element in facets for vertex in element.vertices})
    edges = sorted({edge.nr for element in facets for edge in element.edges})
    of_edge = [normal.GetDofNrs(ng.NodeId(ng.EDGE, edge))[0] for edge in edges]
    ends = [[vertex.nr for vertex in mesh[ng.NodeId(ng.EDGE, edge)].vertices] for edge in edges]

    def solver(matrix: sp.csr_array) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        numbers = [_numbers(each) for each in (sp.csr_array((values, columns, rows)), matrix)]
        form.mat.AsVector().FV().NumPy()[:] = 0.0  # an edge has both vertices in all cells: no entry is new
        form.mat.AsVector().FV().NumPy()[np.searchsorted(*numbers)] = matrix.data
        right = form.mat.CreateColVector()

        def solve(b: np.ndarray, free: np.ndarray) -> np.ndarray:
            right.FV().NumPy()[:] = b
            chosen = ng.BitArray(np.bincount(free, minlength=len(b)).astype(bool).tolist())
            return np.array((form.mat.Inverse(chosen, inverse="sparsecholesky") * right).Evaluate().FV().NumPy())

        return solve

    return Block(
        sp.csr_array((values, columns, rows)),
        load.vec.FV().NumPy().copy(),
        np.flatnonzero(~np.array(list(space.FreeDofs()))),
        (first + np.array(vertices), first + np.array(of_edge)),
        first + np.array(ends),
        (4.0, -4.0),  # an edge's function is half of −λ₁λ₂
        solver,
    )


def _numbers(matrix: sp.csr_array) -> np.ndarray:
    """The places of the entries of a matrix, row by row."""
    matrix.sort_indices()
    return matrix.indices + matrix.shape[1] * np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))


def _side(mesh: ng.Mesh, axis: int, place: float) -> str:
    """The name of the boundary where a coordinate has a value."""
    coordinate = (ng.x, ng.y, ng.z)[axis]
    off = {name: ng.Integrate((coordinate - place) ** 2, mesh.Boundaries(name)) for name in set(mesh.GetBoundaries())}
    return min(off, key=off.__getitem__)


def solved(block: Block) -> tuple[int, float]:
    """The set updates and the energy.

    Raises:
        RuntimeError: If the sets do not settle.
    """
    size, (vertices, edges) = len(block.load), block.normal
    share = np.ones(size)
    share[edges] = block.shares[1]
    ends = (np.tile(edges, block.ends.shape[1]), block.ends.T.ravel())
    of_ends = sp.coo_array((np.full(len(ends[0]), block.shares[0] / 2), ends), (size, size))
    basis = (sp.diags_array(share) + of_ends).tocsr()
    matrix, load = (basis.T @ block.matrix @ basis).tocsr(), basis.T @ block.load
    contact = np.setdiff1d(np.concatenate([vertices, edges]), block.held)
    solve = block.solver(matrix)

    def under(active: np.ndarray, _before: np.ndarray) -> np.ndarray:
        u = np.where(active, -GAP, 0.0)
        return u + solve(load - matrix @ u, np.setdiff1d(np.flatnonzero(~active), block.held))

    settled = primal_dual_active_set(under, lambda u: matrix @ u - load, contact, np.zeros(size), -GAP)
    return settled.steps, float(settled.u @ (matrix @ settled.u) / 2 - load @ settled.u)


def main() -> None:
    """Print a line for each library and mesh."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("cells", type=int, nargs="+", help="cells across")
    options.add_argument("--dim", type=int, choices=(2, 3), default=2)
    asked = options.parse_args()
    for n in asked.cells:
        for name, make in (("NGSolve", by_ngsolve), ("scikit-fem", by_scikit_fem)):
            seconds = []
            for _ in range(2):
                began = time.process_time()
                block = make(asked.dim, n)
                steps, energy = solved(block)
                seconds.append(time.process_time() - began)
            unknowns = len(block.load) - len(block.held)
            about = {"library": name, "cells": n, "unknowns": unknowns, "steps": steps, "energy": energy}
            print(json.dumps(about | {"seconds": round(min(seconds), 2)}), flush=True)


if __name__ == "__main__":
    main()
