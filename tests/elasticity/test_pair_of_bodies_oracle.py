"""A pair of bodies against a dense quadratic programme for the stress alone, assembled by quadrature in NumPy."""

from collections.abc import Callable

import numpy as np
import pytest
from bodies_apart import Array, box_cells, two
from mpi4py import MPI

from signorini_fenicsx.api import Coulomb, Dirichlet, Elasticity, Neumann, Pair, Tresca, solve

UPPER, LOWER, GAP, SLOPE = (3, 1), (4, 1), 0.02, 0.3
POISSON, SHEAR = 0.3, 0.012
GAUSS = np.polynomial.legendre.leggauss(3)
"""Exact for what is integrated here, of degree 3 at most."""
COMPLIANCE = (1 + POISSON) * (np.diag([1.0, 2.0, 1.0]) - POISSON * np.outer([1, 0, 1], [1, 0, 1]))
"""Of plane strain with E = 1 for σ_xx, σ_xy, σ_yy."""


def u_D(x: float) -> Array:
    """What is given at the top."""
    return np.array([0.03, -0.1 + 0.13 * x])


class Programme:
    """min ½(𝔸σ, σ) − ⟨u_D, σn⟩ − ⟨g, σ_nn⟩ for σ linear on thirds of cells, σ_nn ≤ 0, |σ_t| ≤ `SHEAR` on slaves."""

    def __init__(self) -> None:
        """Assemble: unknowns are the three stresses at the three vertices of the three thirds of each cell."""
        boxes = [box_cells(UPPER, [0, GAP], [1, GAP + 1], seed=1), box_cells(LOWER, [0, -1], [1, 0], seed=2)]
        for x, _ in boxes:
            x[:, 1] += SLOPE * x[:, 0]
        self.cells = [x[t] for x, cells in boxes for t in cells]
        self.size = 27 * len(self.cells)
        self.A, self.linear, self.equations = np.zeros((self.size, self.size)), np.zeros(self.size), list[Array]()
        for number, corners in enumerate(self.cells):
            self.inside(number, corners)
        self.facets()

    def at(self, cell: int, third: int, vertex: int, n: Array) -> Array:
        """The rows of σn in a vertex of a third of a cell; vertex 2 is the centroid."""
        rows, first = np.zeros((2, self.size)), 27 * cell + 9 * third + 3 * vertex
        rows[:, first : first + 3] = [[n[0], n[1], 0], [0, n[0], n[1]]]
        return rows

    def inside(self, number: int, corners: Array) -> None:
        """(𝔸σ, σ), ∇·σ = 0 on each third, and σn on the edges between them."""
        middle = corners.mean(axis=0)
        for third in range(3):
            triangle = np.array([*np.delete(corners, third, axis=0), middle])
            hats = np.linalg.inv(np.column_stack([np.ones(3), triangle]))[1:]
            area, own = abs(np.linalg.det(triangle[1:] - triangle[0])) / 2, 27 * number + 9 * third
            mass = area / 12 * (1 + np.eye(3))
            self.A[own : own + 9, own : own + 9] += np.kron(mass, COMPLIANCE)
            self.equations += [*sum(self.at(number, third, vertex, hats[:, vertex]) for vertex in range(3))]
        for vertex in range(3):
            one, other = (third for third in range(3) if third != vertex)
            n = np.array([[0, 1], [-1, 0]]) @ (corners[vertex] - middle)
            places = [(third, vertex - (vertex > third)) for third in (one, other)]  # in the third
            for ends in (places, [(one, 2), (other, 2)]):
                self.equations += [*(self.at(number, *ends[0], n) - self.at(number, *ends[1], n))]

    def facets(self) -> None:
        """What holds on them: continuity, no traction at the sides, u_D at the top, and the pair."""
        sides: dict[tuple[float, ...], list[tuple[Array, Array, list[Array]]]] = {}
        for number, corners in enumerate(self.cells):
            for third in range(3):
                ends = np.delete(corners, third, axis=0)
                n = np.array([[0, 1], [-1, 0]]) @ (ends[1] - ends[0])
                n *= np.sign(n @ (ends[0] - corners[third])) / np.linalg.norm(n)
                pulls = [self.at(number, third, vertex, n) for vertex in (0, 1)]
                order = np.argsort(ends[:, 0] + 1e-3 * ends[:, 1])
                key = tuple(np.round(ends[order].ravel(), 9))
                sides.setdefault(key, []).append((ends[order], n, [pulls[k] for k in order]))
        slaves, masters = list[tuple[Array, Array, list[Array]]](), list[tuple[Array, Array, list[Array]]]()
        for each in sides.values():
            ends, n, pulls = each[0]
            height = ends[:, 1] - SLOPE * ends[:, 0]
            if len(each) == 2:
                self.equations += [row for k in (0, 1) for row in pulls[k] + each[1][2][k]]
            elif abs(n[0]) > 0.9:
                self.equations += [row for pull in pulls for row in pull]
            elif np.allclose(height, GAP + 1):
                self.given(ends, pulls, u_D)
            elif np.allclose(height, GAP):
                slaves.append(each[0])
                self.given(ends, pulls, lambda x, n=n: -GAP * n[1] * n)  # g = γ d·ν along d = (0, −1)
            elif np.allclose(height, 0):
                masters.append(each[0])
        self.sites = [(pull.T @ n, pull.T @ np.array([-n[1], n[0]])) for _, n, pulls in slaves for pull in pulls]
        for ends, _, pulls in masters:
            self.take(ends, pulls, slaves)

    def given(self, ends: Array, pulls: list[Array], value: Callable[[float], Array]) -> None:
        """−∫ value·σn over a facet."""
        length = np.linalg.norm(ends[1] - ends[0])
        for t, w in zip((1 + GAUSS[0]) / 2, GAUSS[1] / 2, strict=True):
            self.linear -= length * w * value(ends[0, 0] + t * np.ptp(ends[:, 0])) @ ((1 - t) * pulls[0] + t * pulls[1])

    def take(self, ends: Array, pulls: list[Array], slaves: list[tuple[Array, Array, list[Array]]]) -> None:
        """A master facet takes what is pulled at the slaves above it, in the moments by its two hats."""
        (a, b), moments = ends[:, 0], np.zeros((2, 2, self.size))
        for others, of in [(ends, pulls), *((other, of) for other, _, of in slaves)]:
            (c, d), low, high = others[:, 0], max(a, others[0, 0]), min(b, others[1, 0])
            for t, w in zip(GAUSS[0], GAUSS[1], strict=True) if high > low else []:
                x = (low + high + t * (high - low)) / 2
                pull = ((d - x) * of[0] + (x - c) * of[1]) / (d - c)
                moments += w * (high - low) / 2 * np.multiply.outer([b - x, x - a], pull) / (b - a)
        self.equations += [*moments.reshape(4, -1)]

    def solved(self, mu: float) -> tuple[Array, Array, Array]:
        """σ, and −σ_nn, σ_t at the sites, by sets that repeat; with μ > 0 the bounds are μ times the pressure."""
        _, sizes, basis = np.linalg.svd(np.array(self.equations))
        basis = basis[np.count_nonzero(sizes > 1e-10) :].T
        A, linear = basis.T @ self.A @ basis, basis.T @ self.linear
        normal, along = (np.array([site[k] for site in self.sites]) @ basis for k in (0, 1))
        number = len(normal)
        closed, slides, bound = np.ones(number, dtype=bool), np.zeros(number), np.full(number, SHEAR)
        for _ in range(200):
            slipping, before = slides != 0, (closed, slides, bound)
            rows = np.concatenate([normal[~closed], along[slipping]])
            right = np.append(np.zeros(np.count_nonzero(~closed)), (slides * bound)[slipping])
            matrix = np.block([[A, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
            x, forces = np.split(np.linalg.solve(matrix, np.concatenate([-linear, right])), [len(A)])
            opening, slip = np.zeros(number), np.zeros(number)
            opening[~closed], slip[slipping] = np.split(forces, [np.count_nonzero(~closed)])
            pressure, shear = -normal @ x, along @ x
            closed = np.where(closed, pressure > -1e-12, opening < -1e-12)
            starts = np.sign(shear) * (np.abs(shear) > bound + 1e-12)
            slides = np.where(slipping, slides * (slides * slip > 0), starts)
            bound = mu * np.maximum(pressure, 0) if mu else bound
            if all(np.allclose(new, old, atol=1e-13) for new, old in zip((closed, slides, bound), before, strict=True)):
                return basis @ x, pressure, shear
        raise AssertionError("the sets do not repeat")


@pytest.mark.parametrize(("mu", "tolerance"), [(0.0, 1e-10), (0.4, 1e-7)])
def test_the_stress_of_a_dense_programme(mu: float, tolerance: float) -> None:
    """The energy, and pressure and shear at the slave vertices, some of which are open and some slide."""
    programme = Programme()
    sigma, pressure, shear = programme.solved(mu)
    free = Neumann(["u00", "u01", "l00", "l01"])
    held = [Dirichlet("u11", ["0.03", "-0.1 + 0.13*x"]), Dirichlet("l10", 0)]
    pair = Pair("u10", "l11", Coulomb(mu) if mu else Tresca(SHEAR), direction=[0, -1])
    domain = two(MPI.COMM_SELF, UPPER, LOWER, gap=GAP, shear=SLOPE)
    solution = solve(domain, Elasticity(young=1, poisson=POISSON, conditions=[free, *held, pair]))
    assert solution.norms()["energy"] == pytest.approx(np.sqrt(sigma @ programme.A @ sigma), rel=tolerance)
    rows, bound = solution.spaces.rows_of(solution.spaces.pairs[0]), mu * pressure if mu else SHEAR
    slides = np.abs(shear) > bound - 1e-9
    assert 0 < np.count_nonzero(pressure < 1e-12) < len(pressure)
    assert 1 < np.count_nonzero(slides) < len(slides)
    for found, known in ((solution.pressure[rows], pressure), (np.abs(solution.shear[rows]), np.abs(shear))):
        np.testing.assert_allclose(np.sort(found.ravel()), np.sort(known), atol=tolerance)
