"""The constants of `physics/elasticity/bound/korn.py`, where the proof is that what is printed bounds them.

uv run python scripts/korn_constants.py
uv run python scripts/korn_constants.py --plane 8 --space 10
"""

from collections.abc import Callable
from itertools import combinations, product
from typing import Annotated

import numpy as np
import scipy.sparse as sp
import typer
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse.linalg import LinearOperator, eigsh

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.discrete.simplices import facet_normals, opposite
from signorini_fenicsx.physics.elasticity.bound.korn import KORN, TRACE, regular_simplex, stretch
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import (
    Cells,
    compliance_product,
    hats_in_subcells,
    reference,
)


def main(
    plane: Annotated[int, typer.Option(min=2, help="Cells along an edge of the triangle.")] = 32,
    space: Annotated[int, typer.Option(min=8, help="Cells along an edge of the tetrahedron.")] = 16,
) -> None:
    """Print c_h and t_h, their bounds, and the numbers that the program uses."""
    for dim, parts in ((2, plane), (3, space)):
        c_h, bound = korn_constant(dim, parts)
        print(f"d = {dim}, {parts} cells along an edge: c_h = {c_h:.4f}, ĉ ≤ {bound:.4f}; in use {KORN[dim]}")
        t_h, bound = trace_constant(dim, parts)
        print(f"d = {dim}, {parts} cells along an edge: t_h = {t_h:.4f}, t̂ ≤ {bound:.4f}; in use {TRACE[dim]}")


def korn_constant(dim: int, parts: int) -> tuple[float, float]:
    """c_h and the bound of ĉ."""
    vertices, cells = lattice(dim, parts)
    c_h = np.sqrt(largest_eigenvalue(vertices, cells))
    s = stretch(Cells(vertices[cells]).derivative).max()
    q = moment_error(dim)
    return c_h, bound_of(c_h, s, q)


def trace_constant(dim: int, parts: int) -> tuple[float, float]:
    """t_h and the bound of t̂."""
    t_h = np.sqrt(largest_eigenvalue_of_tractions(*lattice(dim, parts)))
    return t_h, t_h / np.sqrt(1 - 1 / parts)


def bound_of(c_h: float, s: float, q: float) -> float:
    """The bound of ĉ that `physics/elasticity/bound/korn.py` proves."""
    rest = 1 - s**2 * (1 + q**2)
    return c_h * (s * q + np.sqrt(1 - s**2)) / rest if rest > 0 else np.inf


def lattice(dim: int, parts: int) -> tuple[Array, Indices]:
    """A mesh of the regular simplex."""
    points = np.array([point for point in product(range(parts + 1), repeat=dim) if sum(point) <= parts])
    edges = regular_simplex(dim)
    corner = np.vstack([np.zeros(dim), np.eye(dim)])
    if dim == 2:
        cells = [p + corner for p in points if p.sum() < parts]
        cells += [p + 1 - corner for p in points if p.sum() < parts - 1]
    else:
        cells = [p + corner for p in points if p.sum() < parts]
        cells += [p + 1 - corner for p in points if p.sum() < parts - 2]
        axis = np.array([[1, 0, 0], [0, 1, 1]])  # the octahedron is split along its shortest diagonals, all alike
        ring = np.array([[0, 1, 0], [1, 1, 0], [1, 0, 1], [0, 0, 1]])
        cells += [
            p + np.vstack([axis, ring[i], ring[(i + 1) % 4]]) for p in points if p.sum() < parts - 1 for i in range(4)
        ]
    lookup = {tuple(point): number for number, point in enumerate(points)}
    numbers = np.sort([[lookup[tuple(vertex)] for vertex in cell] for cell in np.array(cells, dtype=int)], axis=1)
    return points @ edges.T / parts, numbers


def largest_eigenvalue(vertices: Array, numbers: Indices) -> float:
    """c_h² of a mesh.

    With unknowns x of the traces, as in `physics/elasticity/solve/system.py`, and moments m of the load, the stress has
    the norm ½‖τ‖² = max over x of ½ m·Cm + x·Rm − ½ x·Kx.
    """
    cells = Cells(vertices[numbers])
    dim, count, element = cells.dim, len(numbers), reference(cells.dim)
    size = (dim + 1) * dim
    products, tractions = _products(cells), cells.tractions(element.tractions)
    free, rest = slice(None, element.free), slice(element.free, None)
    balance = -np.kron(np.eye(dim + 1), np.linalg.inv(cells.derivative))
    of_free, of_rest = tractions[:, :, free], tractions[:, :, rest] @ balance
    coupled = products[:, free, rest] @ balance
    both = np.linalg.solve(products[:, free, free], np.concatenate([of_free.transpose(0, 2, 1), coupled], axis=2))
    of_traces, of_loads = np.split(both, [of_free.shape[1]], axis=2)
    alone = balance.transpose(0, 2, 1) @ products[:, rest, rest] @ balance - coupled.transpose(0, 2, 1) @ of_loads

    _, _, unknowns, solve = _system_of_traces(vertices, numbers, of_free @ of_traces)
    right = _assembled(of_free @ of_loads - of_rest, unknowns, np.arange(count * size).reshape(count, size))

    def response(m: Array) -> Array:
        mine = np.einsum("nij,nj->ni", alone, m)
        moved: Array = mine + (right.T @ solve(right @ m.ravel())).reshape(count, size)
        return moved

    return _largest(cells.vertices, cells.measure, response)


def largest_eigenvalue_of_tractions(vertices: Array, numbers: Indices) -> float:
    """t_h² of a mesh, for the facet of the simplex on which the last coordinate is 0."""
    cells = Cells(vertices[numbers])
    dim, free = cells.dim, slice(None, reference(cells.dim).free)
    of_free = cells.tractions(reference(dim).tractions)[:, :, free]
    matrices = of_free @ np.linalg.solve(_products(cells)[:, free, free], of_free.transpose(0, 2, 1))
    facets, blocks, _, solve = _system_of_traces(vertices, numbers, matrices)
    on = np.flatnonzero((np.abs(vertices[facets][:, :, -1]) < 1e-12).all(axis=1))
    cell, local = np.divmod([int(np.argmax(blocks == facet)) for facet in on], dim + 1)
    measures = np.linalg.norm(facet_normals(cells.vertices)[cell, local], axis=1)

    def response(m: Array) -> Array:
        load = np.zeros((len(facets), dim**2))
        load[on] = m
        moved: Array = solve(load.ravel()).reshape(load.shape)[on]
        return moved

    return _largest(vertices[facets[on]], measures, response)


def _products(cells: Cells) -> Array:
    """(τ, τ') of the basis on each cell."""
    dim = cells.dim
    hats = (1 + np.eye(dim + 1)) / ((dim + 1) * (dim + 2))
    share = cells.measure[:, None, None, None] / (dim + 1)
    masses = share * np.kron(hats, np.eye(dim * (dim + 1) // 2))
    masses = np.broadcast_to(masses, (len(masses), dim + 1, *masses.shape[2:]))
    return compliance_product(cells.stresses(reference(dim).stresses), masses)


def _system_of_traces(
    vertices: Array, numbers: Indices, matrices: Array
) -> tuple[Indices, Indices, Indices, Callable[[Array], Array]]:
    """Assemble and factorise; springs on one facet hold the body, and loads in equilibrium leave them alone.

    Returns:
        The vertices of each facet; the facets and the unknowns of each cell; the solver.
    """
    count, dim = len(numbers), numbers.shape[1] - 1
    facets, blocks = np.unique(numbers[:, opposite(dim)].reshape(-1, dim), axis=0, return_inverse=True)
    unknowns = (blocks.reshape(count, dim + 1, 1) * dim**2 + np.arange(dim**2)).reshape(count, -1)
    held = _rigid(vertices[facets[:1]])
    cell, local = divmod(int(np.argmin(blocks)), dim + 1)  # where the first facet is
    block = slice(local * dim**2, (local + 1) * dim**2)
    matrices[cell, block, block] += held @ held.T
    return facets, blocks.ravel(), unknowns, _solver(_assembled(matrices, unknowns, unknowns))


def _largest(vertices: Array, measures: Array, response: Callable[[Array], Array]) -> float:
    """The largest ⟨v, response to v⟩/‖v‖² of v that are linear on simplices and orthogonal to what is linear on all.

    Args:
        vertices: Of the simplices, shape (n, k, d).
        measures: Their measures.
        response: From moments of loads against the hats of the vertices, shape (n, k d), to displacements there.
    """
    count, corners, dim = vertices.shape
    hats = (1 + np.eye(corners)) / (corners * (corners + 1))
    root = np.kron(np.linalg.cholesky(hats), np.eye(dim))
    scale = np.sqrt(measures)[:, None]
    linear = np.concatenate([vertices, np.ones((count, corners, 1))], axis=2)
    linear = np.einsum("nvk,ij->nvikj", linear, np.eye(dim)).reshape(count, corners * dim, -1)
    linear = (root.T @ linear * scale[:, :, None]).reshape(count * corners * dim, -1)
    motions, sizes, _ = np.linalg.svd(linear, full_matrices=False)
    motions = motions[:, sizes > 1e-10 * sizes[0]]

    def apply(z: Array) -> Array:
        z = z - motions @ (motions.T @ z)
        image = (scale * (response(scale * (z.reshape(count, -1) @ root.T)) @ root)).ravel()
        return image - motions @ (motions.T @ image)

    operator = LinearOperator((len(motions), len(motions)), matvec=apply, dtype=np.float64)
    return float(eigsh(operator, k=1, which="LA", return_eigenvectors=False, tol=1e-6)[0])


def _assembled(blocks: Array, rows: Indices, columns: Indices) -> sp.csr_array:
    shape = blocks.shape
    places = np.broadcast_to(rows[:, :, None], shape).ravel(), np.broadcast_to(columns[:, None, :], shape).ravel()
    return sp.coo_array((blocks.ravel(), places)).tocsr()


def _solver(matrix: sp.csr_array) -> Callable[[Array], Array]:
    """By a factorisation of an SPD matrix."""
    rows = matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType), matrix.data
    petsc = PETSc.Mat().createAIJ(matrix.shape, csr=rows, comm=MPI.COMM_SELF)
    solver = PETSc.KSP().create(MPI.COMM_SELF)
    solver.setOperators(petsc)
    solver.setType(PETSc.KSP.Type.PREONLY)
    solver.pc.setType(PETSc.PC.Type.CHOLESKY)
    solver.pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    x, right = petsc.createVecs()

    def solve(values: Array) -> Array:
        right.array[:] = values
        solver.solve(right, x)
        return x.array.copy()

    return solve


def _rigid(points: Array) -> Array:
    """Rigid motions in points of shape (n, k, d), shape (n k d, motions)."""
    dim = points.shape[2]
    moved = [np.broadcast_to(direction, points.shape) for direction in np.eye(dim)]
    for i, j in combinations(range(dim), 2):
        turned = np.zeros(points.shape)
        turned[..., i], turned[..., j] = points[..., j], -points[..., i]
        moved.append(turned)
    return np.stack(moved, axis=-1).reshape(-1, len(moved))


def moment_error(dim: int) -> float:
    """The largest ‖p − Qp‖/‖p‖ of linear p; Qp is constant on each subcell and has the moments of p."""
    hats = (1 + np.eye(dim + 1)) / ((dim + 1) * (dim + 2))  # (φ_v, φ_w) for |T| = 1
    means = hats_in_subcells(dim)
    values = np.linalg.solve(means / (dim + 1), hats)  # of Qφ_w on the subcells
    difference = values.T @ values / (dim + 1) - hats  # p − Qp is orthogonal to p
    return float(np.sqrt(np.linalg.eigvals(np.linalg.solve(hats, difference)).real.max()))


if __name__ == "__main__":
    typer.run(main)
