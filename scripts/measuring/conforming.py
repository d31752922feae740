"""Contact problems as users of scikit-fem and NGSolve assemble them, by P1 or P2 and a primal-dual active set.

With P2 the conditions are on coefficients of Bernstein's basis on Γ_S, so that they hold everywhere, not only in nodes.
In space nodes would not do: the integral of the function of a vertex over a facet is 0, so that its force has no sign.
For scalar problems scikit-fem solves by conjugate gradients with PyAMG's smoothed aggregation, for bodies by SciPy's
LU; NGSolve always by its sparse Cholesky factorisation.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import netgen.meshing
import ngsolve as ng
import numpy as np
import pyamg
import scipy.sparse as sp
import skfem
from ngsolve import ds, dx, grad
from scipy.sparse.linalg import cg
from skfem.helpers import dot
from skfem.models.elasticity import lame_parameters, linear_elasticity

from measuring.problem import (
    BLOCKS,
    POISSON,
    PROBLEMS,
    YOUNG,
    Arithmetic,
    Problem,
    Result,
    kkt_residual,
    primal_dual_active_set,
)

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


def solved(block: Block, least: float) -> Solved:
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


NUMPY = Arithmetic(lambda value: np.maximum(value, 0.0), np.sqrt)
NGSOLVE = Arithmetic(lambda value: ng.IfPos(value, value, 0.0), ng.sqrt)
TOLERANCE = 1e-10
ENOUGH = 5.0
"""Seconds after which a mesh is not solved again."""
OF_ERRORS = 6
"""Degree of the quadrature of errors."""
ELEMENTS = {
    2: (skfem.MeshTri, skfem.ElementTriP1, skfem.ElementTriP2),
    3: (skfem.MeshTet, skfem.ElementTetP1, skfem.ElementTetP2),
}

type Assembled = tuple[Block, Callable[[Array], float]]
"""The problem, and the error of the flux for given values of the unknowns."""


def edges_of_scikit_fem(basis: Any, below: Array, component: int) -> tuple[tuple[Array, Array], Array]:
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


def by_scikit_fem(problem: Problem, degree: int, points: Array, cells: Array) -> Callable[[], Assembled]:
    """What assembles the problem by scikit-fem, on a mesh that is made before."""
    kind, *elements = ELEMENTS[problem.dim]
    mesh = kind(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
    element, is_body, last = elements[degree - 1](), problem.press != 0, problem.dim - 1
    element = skfem.ElementVector(element) if is_body else element
    form = linear_elasticity(*lame_parameters(YOUNG, POISSON)) if is_body else stiffness

    def error(u: Array) -> float:
        fine = skfem.Basis(mesh, element, intorder=OF_ERRORS)
        exact = np.stack(np.broadcast_arrays(*problem.gradient(fine.global_coordinates(), NUMPY)))
        difference = fine.interpolate(u).grad - exact
        return float(np.sqrt((difference**2).sum(axis=0).ravel() @ fine.dx.ravel()))

    def load(basis: Any, of: Callable[[Any], Any]) -> Array:
        return np.asarray(skfem.LinearForm(lambda v, w: of(w.x) * (v[last] if is_body else v)).assemble(basis))

    def assemble() -> Assembled:
        basis, outside = skfem.Basis(mesh, element), mesh.boundary_facets()
        names = problem.parts(mesh.p[:, mesh.facets[:, outside]].mean(axis=1))
        below, rest, top = (outside[names == name] for name in ("contact", "held", "pressed"))
        held, start = basis.get_dofs(rest).all(), np.zeros(basis.N)
        start[held] = problem.solution(basis.doflocs[:, held], NUMPY)
        right = np.zeros(basis.N)
        if problem.load:
            right += load(skfem.Basis(mesh, element, intorder=3 + degree), lambda x: problem.load(x, NUMPY))
        if is_body:
            right += load(skfem.FacetBasis(mesh, element, facets=top), lambda _: problem.press)
        ends, solver = edges_of_scikit_fem(basis, below, last if is_body else 0), by_lu if is_body else by_pyamg
        return Block(form.assemble(basis).tocsr(), right, held, start, *ends, (0.5, 0.5), solver), error

    return assemble


def by_lu(matrix: sp.csr_array) -> Solve:
    """SciPy's LU."""
    return lambda b, free, _: np.asarray(skfem.solve(*skfem.condense(matrix, b, I=free)))[free]


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
    mesh, is_body, last = netgen_mesh(problem, points, cells), problem.press != 0, problem.dim - 1
    x = (ng.x, ng.y, ng.z)[: problem.dim]

    def assemble() -> Assembled:
        space = (ng.VectorH1 if is_body else ng.H1)(mesh, order=degree, dirichlet="held")
        u, v = space.TnT()
        if is_body:
            mu, lame = YOUNG / (2 * (1 + POISSON)), YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
            strain, test = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
            product, first, along = 2 * mu * ng.InnerProduct(strain, test) + lame * ng.div(u) * ng.div(v), last, v[last]
        else:
            product, first, along = grad(u) * grad(v), None, v
        form = ng.BilinearForm(product * dx).Assemble()
        load = ng.LinearForm((problem.load(x, NGSOLVE) if problem.load else 1e-99) * along * dx(bonus_intorder=3))
        if is_body:
            load += problem.press * along * ds("pressed")
        load.Assemble()
        field, start = ng.GridFunction(space), np.zeros(space.ndof)
        held = np.flatnonzero(~np.array(list(space.FreeDofs())))
        if not is_body:
            field.Set(problem.solution(x, NGSOLVE), definedon=mesh.Boundaries("held"))
            start[held] = field.vec.FV().NumPy()[held]
        matrix, solver = of_ngsolve(form)
        normal, ends = edges_of_ngsolve(mesh, space, first)

        def error(values: Array) -> float:
            field.vec.FV().NumPy()[:] = values
            off = grad(field) - ng.CF(problem.gradient(x, NGSOLVE))
            return float(np.sqrt(ng.Integrate(off * off, mesh, order=OF_ERRORS)))

        return Block(matrix, load.vec.FV().NumPy().copy(), held, start, normal, ends, OF_NGSOLVE, solver), error

    return assemble


def edges_of_ngsolve(mesh: Any, space: Any, component: int | None) -> tuple[tuple[Array, Array], Array]:
    """The unknowns of the vertices and edges of Γ_S, and of the ends of these edges."""
    begin, space = (0, space) if component is None else (space.Range(component).start, space.components[component])
    facets = [element for element in mesh.Elements(ng.BND) if element.mat == "contact"]
    vertices = sorted({vertex.nr for element in facets for vertex in element.vertices})
    edges = [] if space.globalorder < 2 else sorted({edge.nr for element in facets for edge in element.edges})
    of_edge = [space.GetDofNrs(ng.NodeId(ng.EDGE, edge))[0] for edge in edges]
    ends = [[vertex.nr for vertex in mesh[ng.NodeId(ng.EDGE, edge)].vertices] for edge in edges]
    numbers = begin + np.array(vertices), begin + np.array(of_edge, dtype=np.int64)
    return numbers, begin + np.array(ends, dtype=np.int64).reshape(-1, 2)


def netgen_mesh(problem: Problem, points: Array, cells: Array) -> ng.Mesh:
    """A Netgen mesh with the boundary parts of the problem."""
    dim = problem.dim
    facets = np.concatenate([np.delete(cells, corner, axis=1) for corner in range(dim + 1)])
    _, first, count = np.unique(np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True)
    facets = facets[first[count == 1]]
    names = problem.parts(points[facets].mean(axis=1).T)
    mesh = netgen.meshing.Mesh(dim=dim)
    mesh.AddPoints(np.pad(points, ((0, 0), (0, 3 - dim))))
    if dim == 2:
        mesh.Add(netgen.meshing.FaceDescriptor(surfnr=1, domin=1, bc=1))
    for number, name in enumerate(np.unique(names), start=1):
        if dim == 3:
            mesh.Add(netgen.meshing.FaceDescriptor(surfnr=number, domin=1, domout=0, bc=number))
        mesh.AddElements(dim=dim - 1, index=number, data=facets[names == name].astype(np.int32), base=0)
        mesh.SetBCName(number - 1, str(name))
    mesh.AddElements(dim=dim, index=1, data=cells.astype(np.int32), base=0)
    return ng.Mesh(mesh)


LIBRARIES = {"scikit-fem": by_scikit_fem, "NGSolve": by_ngsolve}


def conforming(library: str, degree: int, name: str, again: int, meshes: list[str]) -> None:
    """Solve on each mesh and print a line of JSON, with the fastest of several solves of one mesh.

    Where the gradient is not known the error is that of energies.
    """
    problem = (PROBLEMS | BLOCKS)[name]
    for path in meshes:
        with np.load(path) as file:
            assemble = LIBRARIES[library](problem, degree, file["points"], file["cells"])
        seconds, of_processor = list[float](), list[float]()
        while len(seconds) < again and sum(seconds) < ENOUGH:
            began, before = time.perf_counter(), time.process_time()
            block, error = assemble()
            found = solved(block, problem.least)
            seconds.append(time.perf_counter() - began)
            of_processor.append(time.process_time() - before)
        off = error(found.u) if problem.gradient else max(2 * (found.energy - problem.energy), 0.0) ** 0.5
        about = {"unknowns": len(block.load) - len(block.held), "steps": found.steps, "seconds": min(seconds)}
        about |= {"processor": min(of_processor)}
        print(json.dumps(about | {"error": off, "energy": found.energy}), flush=True)
