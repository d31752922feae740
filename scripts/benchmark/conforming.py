"""P1 or P2 of a general library with primal-dual active sets: prints a line of JSON for each mesh.

python conforming.py LIBRARY DEGREE PROBLEM AGAIN MESH…

scikit-fem solves by conjugate gradients with PyAMG's smoothed aggregation, NGSolve by its sparse Cholesky
factorisation. Of several solves of one mesh the fastest counts.
"""

import json
import sys
import time
from collections.abc import Callable, Sequence

import netgen.meshing
import ngsolve
import numpy as np
import pyamg
import scipy.sparse as sp
import skfem
from block import OF_NGSOLVE, Array, Block, Solve, edges_of_ngsolve, of_ngsolve, solved
from ngsolve import dx, grad
from problem import PROBLEMS, Arithmetic, Problem
from scipy.sparse.linalg import cg
from skfem.helpers import dot

NUMPY = Arithmetic(lambda value: np.maximum(value, 0.0), np.sqrt)
NGSOLVE = Arithmetic(lambda value: ngsolve.IfPos(value, value, 0.0), ngsolve.sqrt)
TOLERANCE = 1e-10
ENOUGH = 5.0
"""Seconds after which a mesh is not solved again."""
OF_ERRORS = 6
"""Degree of the quadrature of errors."""

type Assembled = tuple[Block, Callable[[Array], float]]
"""The problem, and the error of the flux for given values of the unknowns."""


@skfem.BilinearForm
def stiffness(u, v, w):
    """(∇u, ∇v)."""
    return dot(u.grad, v.grad)


def on_gamma_s(heights: Sequence[float], x: Array) -> Array:
    """Which points of the boundary are on Γ_S, by their last coordinates."""
    return np.asarray(np.min([np.abs(x - height) for height in heights], axis=0) < 1e-12)


def by_scikit_fem(problem: Problem, degree: int, points: Array, cells: Array) -> Callable[[], Assembled]:
    """What assembles the problem by scikit-fem, on a mesh that is made before."""
    kind, *elements = {
        2: (skfem.MeshTri, skfem.ElementTriP1, skfem.ElementTriP2),
        3: (skfem.MeshTet, skfem.ElementTetP1, skfem.ElementTetP2),
    }[problem.dim]
    mesh = kind(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
    element = elements[degree - 1]()

    def error(u: Array) -> float:
        fine = skfem.Basis(mesh, element, intorder=OF_ERRORS)
        exact = np.stack(np.broadcast_arrays(*problem.gradient(fine.global_coordinates(), NUMPY)))
        difference = fine.interpolate(u).grad - exact
        return float(np.sqrt((difference**2).sum(axis=0).ravel() @ fine.dx.ravel()))

    def assemble() -> Assembled:
        basis = skfem.Basis(mesh, element)
        load = skfem.LinearForm(lambda v, w: (problem.load(w.x, NUMPY) if problem.load else 0.0) * v)
        below, rest = (
            mesh.facets_satisfying(lambda x, on=on: on_gamma_s(problem.heights, x[-1]) == on, boundaries_only=True)
            for on in (True, False)
        )
        edges = below if problem.dim == 2 else np.unique(mesh.f2e[:, below])
        of_edges = basis.facet_dofs if problem.dim == 2 else basis.edge_dofs
        if degree == 1:
            edges, of_edges = edges[:0], np.empty((1, 0), dtype=int)
        held = basis.get_dofs(rest).all()
        start = np.zeros(basis.N)
        start[held] = problem.solution(basis.doflocs[:, held], NUMPY)
        block = Block(
            stiffness.assemble(basis).tocsr(),
            load.assemble(skfem.Basis(mesh, element, intorder=3 + degree)),
            held,
            start,
            (basis.nodal_dofs[0, np.unique(mesh.facets[:, below])], of_edges[0, edges]),
            basis.nodal_dofs[0, (mesh.facets if problem.dim == 2 else mesh.edges)[:, edges].T],
            (0.5, 0.5),
            by_pyamg,
        )
        return block, error

    return assemble


def by_pyamg(matrix: sp.csr_array) -> Solve:
    """Conjugate gradients with smoothed aggregation."""

    def solve(b: Array, free: Array, first: Array) -> Array:
        inner = matrix[free][:, free]
        preconditioner = pyamg.smoothed_aggregation_solver(sp.csr_matrix(inner)).aspreconditioner()
        u, failed = cg(inner, b[free], x0=first, rtol=TOLERANCE, M=preconditioner, maxiter=500)
        if failed:
            raise RuntimeError("conjugate gradients failed")
        return np.asarray(u)

    return solve


def by_ngsolve(problem: Problem, degree: int, points: Array, cells: Array) -> Callable[[], Assembled]:
    """What assembles the problem by NGSolve, on a mesh that is made before."""
    ngsolve.SetNumThreads(1)
    mesh = netgen_mesh(points, cells, problem.heights)
    x = (ngsolve.x, ngsolve.y, ngsolve.z)[: problem.dim]

    def assemble() -> Assembled:
        space = ngsolve.H1(mesh, order=degree, dirichlet="dirichlet")
        u, v = space.TnT()
        form = ngsolve.BilinearForm(grad(u) * grad(v) * dx).Assemble()
        load = ngsolve.LinearForm((problem.load(x, NGSOLVE) if problem.load else 1e-99) * v * dx(bonus_intorder=3))
        load.Assemble()
        field = ngsolve.GridFunction(space)
        field.Set(problem.solution(x, NGSOLVE), definedon=mesh.Boundaries("dirichlet"))
        matrix, solver = of_ngsolve(form)
        held = np.flatnonzero(~np.array(list(space.FreeDofs())))
        start = np.zeros(space.ndof)
        start[held] = field.vec.FV().NumPy()[held]
        normal, ends = edges_of_ngsolve(mesh, space, "contact")

        def error(values: Array) -> float:
            field.vec.FV().NumPy()[:] = values
            off = grad(field) - ngsolve.CF(problem.gradient(x, NGSOLVE))
            return float(np.sqrt(ngsolve.Integrate(off * off, mesh, order=OF_ERRORS)))

        return Block(matrix, load.vec.FV().NumPy().copy(), held, start, normal, ends, OF_NGSOLVE, solver), error

    return assemble


def netgen_mesh(points: Array, cells: Array, heights: Sequence[float] = (0.0,)) -> ngsolve.Mesh:
    """A Netgen mesh with boundary parts `contact`, where the last coordinate is one of the heights, and `dirichlet`."""
    dim = points.shape[1]
    facets = np.concatenate([np.delete(cells, corner, axis=1) for corner in range(dim + 1)])
    _, first, count = np.unique(np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True)
    facets = facets[first[count == 1]]
    on_contact = on_gamma_s(heights, points[facets, -1]).all(axis=1)
    mesh = netgen.meshing.Mesh(dim=dim)
    mesh.AddPoints(np.pad(points, ((0, 0), (0, 3 - dim))))
    if dim == 2:
        mesh.Add(netgen.meshing.FaceDescriptor(surfnr=1, domin=1, bc=1))
    for number, (name, mask) in enumerate((("contact", on_contact), ("dirichlet", ~on_contact)), start=1):
        if dim == 3:
            mesh.Add(netgen.meshing.FaceDescriptor(surfnr=number, domin=1, domout=0, bc=number))
        mesh.AddElements(dim=dim - 1, index=number, data=facets[mask].astype(np.int32), base=0)
        mesh.SetBCName(number - 1, name)
    mesh.AddElements(dim=dim, index=1, data=cells.astype(np.int32), base=0)
    return ngsolve.Mesh(mesh)


LIBRARIES = {"scikit-fem": by_scikit_fem, "NGSolve": by_ngsolve}


def main() -> None:
    """Solve on each mesh and report."""
    library, degree, name, again, *meshes = sys.argv[1:]
    problem = PROBLEMS[name]
    for path in meshes:
        with np.load(path) as file:
            assemble = LIBRARIES[library](problem, int(degree), file["points"], file["cells"])
        seconds: list[float] = []
        while len(seconds) < int(again) and sum(seconds) < ENOUGH:
            began = time.perf_counter()
            block, error = assemble()
            found = solved(block)
            seconds.append(time.perf_counter() - began)
        off = error(found.u) if problem.gradient else (2 * (found.energy - problem.energy)) ** 0.5
        about = {"unknowns": len(block.load), "steps": found.steps, "seconds": min(seconds), "error": off}
        print(json.dumps(about), flush=True)


if __name__ == "__main__":
    main()
