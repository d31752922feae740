"""Contact problems as users of scikit-fem and NGSolve assemble them, by P1 or P2 and a primal-dual active set.

With P2 the conditions are on coefficients of Bernstein's basis on Γ_S, so that they hold everywhere, not only in nodes.
In space nodes would not do: the integral of the function of a vertex over a facet is 0, so that its force has no sign.
For scalar problems scikit-fem solves by conjugate gradients with PyAMG's smoothed aggregation, for bodies by SciPy's
LU; NGSolve always by its sparse Cholesky factorisation.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import netgen.meshing
import ngsolve as ng
import numpy as np
import pyamg
import scipy.sparse as sp
import skfem
import typer
from measuring.problem import PROBLEMS, Arithmetic, Problem, Result, kkt_residual, primal_dual_active_set
from ngsolve import dx, grad
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh
from scipy.sparse.linalg import cg
from skfem.helpers import dot
from skfem.models.elasticity import lame_parameters, linear_elasticity

type Array = np.ndarray
type Solve = Callable[[Array, Array, Array], Array]
"""Solves for a right side in all unknowns with those that are free, from a first guess; gives the values of these."""
KKT = 1e-6
"""Larger residuals are none of a solution."""
OF_NGSOLVE = 4.0, -4.0
"""The shares of NGSolve's functions of edges, of which each is half of −λ₁λ₂."""


@dataclass(frozen=True)
class Block:
    """The assembled problem.

    Attributes:
        matrix: The stiffness.
        load: The right side.
        held: Unknowns that are given.
        start: Their values, and 0.
        normal: Unknowns on Γ_S: those of vertices, those of edges.
        ends: The unknowns of the vertices of each of these edges, shape (edges, 2).
        shares: The value at an edge's unknown is so much of the mean of its vertices and so much of Bernstein's
            coefficient.
        solver: Makes of a matrix what solves with its rows and columns that are free.
    """

    matrix: sp.csr_array
    load: Array
    held: Array
    start: Array
    normal: tuple[Array, Array]
    ends: Array
    shares: tuple[float, float]
    solver: Callable[[sp.csr_array], Solve]


@dataclass(frozen=True)
class Solved:
    """The values of the unknowns, set updates, and ½(Au, u) − (b, u)."""

    u: Array
    steps: int
    energy: float


def solved(block: Block, least: float = 0.0) -> Solved:
    """The solution with u ≥ least on Γ_S.

    Raises:
        RuntimeError: If the sets do not settle, or that is no solution.
    """
    size, (vertices, edges) = len(block.load), block.normal
    share, inside = np.ones(size), ~np.isin(edges, block.held)
    share[edges[inside]] = block.shares[1]
    ends = (np.repeat(edges[inside], 2), block.ends[inside].ravel())
    of_ends = sp.coo_array((np.full(len(ends[0]), block.shares[0] / 2), ends), (size, size))
    basis = (sp.diags_array(share) + of_ends).tocsr()
    matrix, load = (basis.T @ block.matrix @ basis).tocsr(), basis.T @ block.load
    contact = np.setdiff1d(np.concatenate([vertices, edges]), block.held)
    solve = block.solver(matrix)

    def under(active: Array, before: Array) -> Array:
        u, free = np.where(active, least, block.start), np.setdiff1d(np.flatnonzero(~active), block.held)
        u[free] = solve(load - matrix @ u, free, before[free])
        return u

    def residual(u: Array) -> Array:
        return np.asarray(matrix @ u - load)

    found = primal_dual_active_set(under, residual, contact, block.start, least)
    above = Result(found.u - least, found.force, found.active, found.steps)
    left = kkt_residual(above, residual(found.u), np.setdiff1d(np.arange(size), block.held), contact)
    if left > KKT:
        raise RuntimeError(f"a residual of {left:.1e}")
    return Solved(basis @ found.u, found.steps, float(found.u @ (matrix @ found.u) / 2 - load @ found.u))


def of_ngsolve(form: Any) -> tuple[sp.csr_array, Callable[[sp.csr_array], Solve]]:
    """The matrix of a form, and NGSolve's sparse Cholesky factorisation for matrices with the same entries."""
    values, columns, rows = (np.array(each) for each in form.mat.CSR())
    whole = sp.csr_array((values, columns, rows))

    def solver(matrix: sp.csr_array) -> Solve:
        vector = form.mat.AsVector().FV().NumPy()
        vector[:] = 0.0  # an edge has both vertices in all cells: no entry is new
        vector[np.searchsorted(*map(_numbers, (whole, matrix)))] = matrix.data
        right = form.mat.CreateColVector()

        def solve(b: Array, free: Array, _: Array) -> Array:
            right.FV().NumPy()[:] = b
            chosen = ng.BitArray(np.bincount(free, minlength=len(b)).astype(bool).tolist())
            inverse = form.mat.Inverse(chosen, inverse="sparsecholesky")
            return np.array((inverse * right).Evaluate().FV().NumPy())[free]

        return solve

    return whole, solver


def _numbers(matrix: sp.csr_array) -> Array:
    """The places of the entries of a matrix, row by row."""
    matrix.sort_indices()
    return np.asarray(matrix.indices + matrix.shape[1] * np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)))


def edges_of_ngsolve(mesh: Any, space: Any, name: str) -> tuple[tuple[Array, Array], Array]:
    """The unknowns of the vertices and edges of a part of the boundary, and of the ends of these edges."""
    facets = [element for element in mesh.Elements(ng.BND) if element.mat == name]
    vertices = sorted({vertex.nr for element in facets for vertex in element.vertices})
    edges = [] if space.globalorder < 2 else sorted({edge.nr for element in facets for edge in element.edges})
    of_edge = [space.GetDofNrs(ng.NodeId(ng.EDGE, edge))[0] for edge in edges]
    ends = [[vertex.nr for vertex in mesh[ng.NodeId(ng.EDGE, edge)].vertices] for edge in edges]
    numbers = np.array(vertices), np.array(of_edge, dtype=np.int64)
    return numbers, np.array(ends, dtype=np.int64).reshape(-1, 2)


NUMPY = Arithmetic(lambda value: np.maximum(value, 0.0), np.sqrt)
NGSOLVE = Arithmetic(lambda value: ng.IfPos(value, value, 0.0), ng.sqrt)
TOLERANCE = 1e-10
ENOUGH = 5.0
"""Seconds after which a mesh is not solved again."""
OF_ERRORS = 6
"""Degree of the quadrature of errors."""

type Assembled = tuple[Block, Callable[[Array], float]]
"""The problem, and the error of the flux for given values of the unknowns."""


def edges_of_scikit_fem(basis: Any, below: Array, component: int = 0) -> tuple[tuple[Array, Array], Array]:
    """The unknowns of the vertices and edges of some facets, and of the ends of these edges."""
    mesh, plane = basis.mesh, basis.mesh.dim() == 2
    edges, numbers = (below, basis.facet_dofs) if plane else (np.unique(mesh.f2e[:, below]), basis.edge_dofs)
    if not numbers.size:  # P1
        edges, numbers = edges[:0], np.empty((1, 0), dtype=int)
    ends = (mesh.facets if plane else mesh.edges)[:, edges].T
    vertices = basis.nodal_dofs[component, np.unique(mesh.facets[:, below])]
    return (vertices, numbers[component, edges]), basis.nodal_dofs[component, ends]


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
        held = basis.get_dofs(rest).all()
        start = np.zeros(basis.N)
        start[held] = problem.solution(basis.doflocs[:, held], NUMPY)
        block = Block(
            stiffness.assemble(basis).tocsr(),
            load.assemble(skfem.Basis(mesh, element, intorder=3 + degree)),
            held,
            start,
            *edges_of_scikit_fem(basis, below),
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
    ng.SetNumThreads(1)
    mesh = netgen_mesh(points, cells, problem.heights)
    x = (ng.x, ng.y, ng.z)[: problem.dim]

    def assemble() -> Assembled:
        space = ng.H1(mesh, order=degree, dirichlet="dirichlet")
        u, v = space.TnT()
        form = ng.BilinearForm(grad(u) * grad(v) * dx).Assemble()
        load = ng.LinearForm((problem.load(x, NGSOLVE) if problem.load else 1e-99) * v * dx(bonus_intorder=3))
        load.Assemble()
        field = ng.GridFunction(space)
        field.Set(problem.solution(x, NGSOLVE), definedon=mesh.Boundaries("dirichlet"))
        matrix, solver = of_ngsolve(form)
        held = np.flatnonzero(~np.array(list(space.FreeDofs())))
        start = np.zeros(space.ndof)
        start[held] = field.vec.FV().NumPy()[held]
        normal, ends = edges_of_ngsolve(mesh, space, "contact")

        def error(values: Array) -> float:
            field.vec.FV().NumPy()[:] = values
            off = grad(field) - ng.CF(problem.gradient(x, NGSOLVE))
            return float(np.sqrt(ng.Integrate(off * off, mesh, order=OF_ERRORS)))

        return Block(matrix, load.vec.FV().NumPy().copy(), held, start, normal, ends, OF_NGSOLVE, solver), error

    return assemble


def netgen_mesh(points: Array, cells: Array, heights: Sequence[float] = (0.0,)) -> ng.Mesh:
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
    return ng.Mesh(mesh)


LIBRARIES = {"scikit-fem": by_scikit_fem, "NGSolve": by_ngsolve}


def conforming(library: str, degree: int, name: str, again: int, meshes: list[str]) -> None:
    """Solve on each mesh and print a line of JSON, with the fastest of several solves of one mesh."""
    problem = PROBLEMS[name]
    for path in meshes:
        with np.load(path) as file:
            assemble = LIBRARIES[library](problem, degree, file["points"], file["cells"])
        seconds: list[float] = []
        while len(seconds) < again and sum(seconds) < ENOUGH:
            began = time.perf_counter()
            block, error = assemble()
            found = solved(block)
            seconds.append(time.perf_counter() - began)
        off = error(found.u) if problem.gradient else (2 * (found.energy - problem.energy)) ** 0.5
        about = {"unknowns": len(block.load), "steps": found.steps, "seconds": min(seconds), "error": off}
        print(json.dumps(about), flush=True)


YOUNG, POISSON, GAP, WEIGHT, PRESS = 1.0, 0.3, 0.02, -0.3, -0.1


def pressed_by_scikit_fem(dim: int, n: int) -> Block:
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

    def solver(matrix: sp.csr_array) -> Solve:
        return lambda b, free, _: np.asarray(skfem.solve(*skfem.condense(matrix, b, I=free)))[free]

    return Block(
        matrix,
        weight.assemble(basis) + press.assemble(top),
        basis.get_dofs(lambda x: np.isclose(x[0], 0)).all(),
        np.zeros(matrix.shape[0]),
        *edges_of_scikit_fem(basis, below, dim - 1),
        (0.5, 0.5),
        solver,
    )


def pressed_by_ngsolve(dim: int, n: int) -> Block:
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


def libraries(
    cells: Annotated[list[int], typer.Argument(help="Cells across.")],
    dim: Annotated[int, typer.Option(min=2, max=3)] = 2,
) -> None:
    """The pressed block of `elastic`, by both: for each mesh a line of JSON with the better of two runs.

    It has the unknowns, the set updates, the energy and the seconds of the processor from the mesh to the displacement.
    The energy is above the exact one.
    """
    for n in cells:
        for name, make in (("NGSolve", pressed_by_ngsolve), ("scikit-fem", pressed_by_scikit_fem)):
            seconds = []
            for _ in range(2):
                began = time.process_time()
                block = make(dim, n)
                found = solved(block, -GAP)
                seconds.append(time.process_time() - began)
            unknowns = len(block.load) - len(block.held)
            about = {"library": name, "cells": n, "unknowns": unknowns, "steps": found.steps, "energy": found.energy}
            print(json.dumps(about | {"seconds": round(min(seconds), 2)}), flush=True)
