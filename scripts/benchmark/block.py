"""Contact problems as general finite element libraries assemble them, by P1 or P2, and a primal-dual active set.

With P2 the conditions are on coefficients of Bernstein's basis on Γ_S, so that they hold everywhere, not only in nodes.
In space nodes would not do: the integral of the function of a vertex over a facet is 0, so that its force has no sign.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import ngsolve
import numpy as np
import scipy.sparse as sp
from pdas import Result, kkt_residual, primal_dual_active_set

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
            chosen = ngsolve.BitArray(np.bincount(free, minlength=len(b)).astype(bool).tolist())
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
    facets = [element for element in mesh.Elements(ngsolve.BND) if element.mat == name]
    vertices = sorted({vertex.nr for element in facets for vertex in element.vertices})
    edges = [] if space.globalorder < 2 else sorted({edge.nr for element in facets for edge in element.edges})
    of_edge = [space.GetDofNrs(ngsolve.NodeId(ngsolve.EDGE, edge))[0] for edge in edges]
    ends = [[vertex.nr for vertex in mesh[ngsolve.NodeId(ngsolve.EDGE, edge)].vertices] for edge in edges]
    numbers = np.array(vertices), np.array(of_edge, dtype=np.int64)
    return numbers, np.array(ends, dtype=np.int64).reshape(-1, 2)
