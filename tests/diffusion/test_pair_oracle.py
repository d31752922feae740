"""A pair of surfaces against a dense quadratic programme for the flux alone, assembled by quadrature in NumPy."""

from itertools import product

import numpy as np
import pytest
from bodies_apart import Array, box_cells, two
from mpi4py import MPI

from signorini_fenicsx.api import Diffusion, Dirichlet, Neumann, Pair, Signorini, solve

UPPER, LOWER, GAP = (2, 1), (3, 1), 0.25
SOURCE = 3.0
GAUSS = np.polynomial.legendre.leggauss(4)
"""Exact for what is integrated here, of degree 5 at most."""


def u_D(x: float) -> float:
    """What is given at the top."""
    return np.sin(4 * x) / 2


def psi(x: float) -> float:
    """The least jump."""
    return 1.5 * x - 0.5


def field(x: Array) -> Array:
    """RT1 in a point: linear fields, and x times linear ones; shape (2, 8)."""
    one, zero = np.array([1.0, *x]), np.zeros(3)
    return np.array([[*one, *zero, x[0] ** 2, x[0] * x[1]], [*zero, *one, x[0] * x[1], x[1] ** 2]])


def divergence(x: Array) -> Array:
    """Their divergence, shape (8,)."""
    return np.array([0, 1, 0, 0, 0, 1, 3 * x[0], 3 * x[1]])


def on_segment(ends: Array) -> list[tuple[float, float]]:
    """Points of a quadrature between two numbers, with weights."""
    half = (ends[1] - ends[0]) / 2
    return [(ends[0] + half * (1 + t), half * w) for t, w in zip(*GAUSS, strict=True)]


def in_cell(corners: Array) -> list[tuple[Array, float]]:
    """Points of a quadrature in a triangle, by Duffy's map, with weights."""
    edges = corners[1:] - corners[0]
    area = abs(np.linalg.det(edges))
    points = [(s, t, ws * wt) for s, ws in on_segment([0, 1]) for t, wt in on_segment([0, 1])]
    return [(corners[0] + np.array([s * (1 - t), s * t]) @ edges, w * s * area) for s, t, w in points]


class Programme:
    """min ½(σ, σ) − ⟨u_D, σ·n⟩ − ⟨ψ, λ⟩ for σ in broken RT1 with rows of equations, λ = σ·n ≥ 0 at slave vertices."""

    def __init__(self) -> None:
        """Assemble: unknowns are 8 coefficients of each cell."""
        boxes = [box_cells(UPPER, [0, GAP], [1, GAP + 1], seed=1), box_cells(LOWER, [0, -1], [1, 0], seed=2)]
        self.cells = [x[t] for x, cells in boxes for t in cells]
        size = 8 * len(self.cells)
        self.A, self.linear, self.rows, self.right = (
            np.zeros((size, size)),
            np.zeros(size),
            list[Array](),
            list[float](),
        )
        for number, corners in enumerate(self.cells):
            own = slice(8 * number, 8 * number + 8)
            hats = np.linalg.inv(np.column_stack([np.ones(3), corners]))
            balance = np.zeros((3, size))
            for x, w in in_cell(corners):
                self.A[own, own] += w * field(x).T @ field(x)
                balance[:, own] += w * np.outer(np.array([1, *x]) @ hats, divergence(x))
            self.equations(balance, np.full(3, -SOURCE * abs(np.linalg.det(corners[1:] - corners[0])) / 6))
        self.facets()

    def equations(self, rows: Array, right: Array) -> None:
        """Add some."""
        self.rows += [*rows]
        self.right += [*right]

    def through(self, number: int, x: Array, n: Array) -> Array:
        """The row of σ·n in a point of a cell."""
        row = np.zeros(8 * len(self.cells))
        row[8 * number : 8 * number + 8] = n @ field(x)
        return row

    def facets(self) -> None:
        """What holds on them: continuity, no flux at the sides, u_D at the top, and the pair."""
        sides: dict[tuple[float, ...], list[tuple[int, Array, Array]]] = {}
        for number, corners in enumerate(self.cells):
            for opposite in range(3):
                ends = np.delete(corners, opposite, axis=0)
                tangent = ends[1] - ends[0]
                n = np.array([tangent[1], -tangent[0]])
                n *= np.sign(n @ (ends[0] - corners[opposite])) / np.linalg.norm(n)
                sides.setdefault(tuple(np.round(np.sort(ends, axis=0).ravel(), 9)), []).append((number, ends, n))
        slaves = [each[0] for each in sides.values() if len(each) == 1 and np.allclose(each[0][1][:, 1], GAP)]
        masters = [each[0] for each in sides.values() if len(each) == 1 and np.allclose(each[0][1][:, 1], 0)]
        self.slaves = [self.through(number, x, n) for number, ends, n in slaves for x in ends]
        for each in sides.values():
            (number, ends, n), length = each[0], np.linalg.norm(each[0][1][1] - each[0][1][0])
            moments = np.zeros((2, 8 * len(self.cells)))
            for t, w in on_segment([0, 1]):
                x = ends[0] + t * (ends[1] - ends[0])
                moments += length * w * np.outer([1 - t, t], sum(self.through(k, x, m) for k, _, m in each))
                if np.allclose(ends[:, 1], GAP + 1) or np.allclose(ends[:, 1], GAP):
                    given = u_D(x[0]) if x[1] > 1 else psi(x[0])
                    self.linear -= length * w * given * self.through(number, x, n)
            if len(each) == 2 or abs(n[0]) > 0.5:
                self.equations(moments, np.zeros(2))
        for master, ends, n in masters:
            self.take(master, ends, n, slaves)

    def take(self, master: int, ends: Array, n: Array, slaves: list[tuple[int, Array, Array]]) -> None:
        """A master facet takes what goes through the slaves above it."""
        (a, b), moments = ends[:, 0], np.zeros((2, 8 * len(self.cells)))
        for t, w in on_segment([a, b]):
            moments += abs(w) * np.outer([b - t, t - a], self.through(master, np.array([t, 0.0]), n)) / (b - a)
        for slave, others, m in slaves:
            low, high = max(min(a, b), others[:, 0].min()), min(max(a, b), others[:, 0].max())
            for t, w in on_segment([low, high]) if high > low else []:
                moments += w * np.outer([b - t, t - a], self.through(slave, np.array([t, GAP]), m)) / (b - a)
        self.equations(moments, np.zeros(2))

    def solved(self) -> tuple[Array, Array]:
        """σ, and λ at the slave vertices, by trying all sets."""
        for held in product([False, True], repeat=len(self.slaves)):
            rows = np.array([*self.rows, *(row for row, free in zip(self.slaves, held, strict=True) if not free)])
            right = np.pad(self.right, (0, len(rows) - len(self.right)))
            zero = np.zeros((len(rows), len(rows)))
            matrix = np.block([[self.A, rows.T], [rows, zero]])
            found, *_ = np.linalg.lstsq(matrix, np.concatenate([-self.linear, right]), rcond=1e-12)
            sigma, forces = found[: len(self.A)], found[len(self.A) + len(self.right) :]
            pressure = np.array(self.slaves) @ sigma
            if (pressure > -1e-10).all() and (forces < 1e-10).all():
                return sigma, pressure
        raise AssertionError("no set is right")


def test_the_flux_of_a_dense_programme() -> None:
    """The energy, and the flux at the slave vertices, of which some are open."""
    programme = Programme()
    sigma, pressure = programme.solved()
    free, held = Neumann(["u00", "u01", "l00", "l01"]), [Dirichlet("u11", "sin(4*x)/2"), Dirichlet("l10", 0)]
    pair = Pair("u10", "l11", Signorini((), psi="1.5*x - 0.5"))
    solution = solve(two(MPI.COMM_SELF, UPPER, LOWER, gap=GAP), Diffusion(f=SOURCE, conditions=[free, *held, pair]))
    assert 0 < np.count_nonzero(pressure < 1e-10) < len(pressure)
    norms = solution.norms()
    assert norms["sigma_L2"] == pytest.approx(np.sqrt(sigma @ programme.A @ sigma), rel=1e-6)
    found = solution.flux_at[solution.spaces.rows_of(solution.spaces.pairs[0])]
    np.testing.assert_allclose(np.sort(found.ravel()), np.sort(pressure), atol=1e-6)
