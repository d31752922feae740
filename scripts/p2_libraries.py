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
from pathlib import Path

import ngsolve as ng
import numpy as np
import scipy.sparse as sp
import skfem
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh
from skfem.models.elasticity import lame_parameters, linear_elasticity

sys.path.append(str(Path(__file__).parent / "benchmark"))
from block import OF_NGSOLVE, Block, Solve, edges_of_ngsolve, of_ngsolve, solved

YOUNG, POISSON, GAP, WEIGHT, PRESS = 1.0, 0.3, 0.02, -0.3, -0.1


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

    def solver(matrix: sp.csr_array) -> Solve:
        return lambda b, free, _: np.asarray(skfem.solve(*skfem.condense(matrix, b, I=free)))[free]

    return Block(
        matrix,
        weight.assemble(basis) + press.assemble(top),
        basis.get_dofs(lambda x: np.isclose(x[0], 0)).all(),
        np.zeros(matrix.shape[0]),
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
    matrix, solver = of_ngsolve(form)
    first = space.Range(dim - 1).start
    (vertices, edges), ends = edges_of_ngsolve(mesh, space.components[dim - 1], below)
    return Block(
        matrix,
        load.vec.FV().NumPy().copy(),
        np.flatnonzero(~np.array(list(space.FreeDofs()))),
        np.zeros(matrix.shape[0]),
        (first + vertices, first + edges),
        first + ends,
        OF_NGSOLVE,
        solver,
    )


def _side(mesh: ng.Mesh, axis: int, place: float) -> str:
    """The name of the boundary where a coordinate has a value."""
    coordinate = (ng.x, ng.y, ng.z)[axis]
    off = {name: ng.Integrate((coordinate - place) ** 2, mesh.Boundaries(name)) for name in set(mesh.GetBoundaries())}
    return min(off, key=off.__getitem__)


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
                found = solved(block, -GAP)
                seconds.append(time.process_time() - began)
            unknowns = len(block.load) - len(block.held)
            about = {"library": name, "cells": n, "unknowns": unknowns, "steps": found.steps, "energy": found.energy}
            print(json.dumps(about | {"seconds": round(min(seconds), 2)}), flush=True)


if __name__ == "__main__":
    main()
