"""κ as it was given, on whole cells and on parts of them: its bounds, and how far it is from polynomials."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.expressions import TREES, Tree, is_polynomial, values
from signorini_fenicsx.expressions.cutting import in_parts
from signorini_fenicsx.expressions.enclosures import BESIDE, distances, ranges
from signorini_fenicsx.expressions.quadratics import bernstein, interpolated
from signorini_fenicsx.expressions.series import DEGREE, Remainder
from signorini_fenicsx.expressions.simplices import Parts
from signorini_fenicsx.physics.diffusion.bound.metric import CellMetric
from signorini_fenicsx.physics.diffusion.bound.resolution import SHARE, SMALLEST, Resolution, of_all_cells
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import OnCells

ROUGH, SMALL = 4.0, 1e-3
"""A lower bound of κ on a part of a cell may be smaller than κ by this factor, on parts of this share by any."""
RESOLVED = 1 / 16
"""ρ need not be smaller than this share of what may be missed of κ itself."""


@dataclass(frozen=True)
class Conductivity:
    """κ on some owned cells: a text, or a matrix of them by rows.

    Attributes:
        trees: The entries.
        cells: The cells, ascending.
        is_matrix: Whether it is a matrix.
    """

    trees: list[Tree]
    cells: Indices
    is_matrix: bool

    def at(self, x: Array) -> Array:
        """Values in points, shape (n, points), of a matrix (n, points, dim, dim)."""
        return self._joined([np.broadcast_to(values(tree, x), x.shape[:-1]) for tree in self.trees])

    def smallest(self, x: Array) -> Array:
        """The smallest eigenvalues in points, shape (n, points)."""
        return _eigenvalues(self.at(x))[0]

    def distance(self, remainders: Sequence[Remainder], degree: int) -> Array:
        """The distance on parts of cells to polynomials of a degree, in the norm of matrices."""
        known = zip(self.trees, remainders, strict=True)
        return self.norm([rho.distance(degree) * (not is_polynomial(tree, degree)) for tree, rho in known])

    def norm(self, of_entries: Sequence[Array] | Array) -> Array:
        """The norm of a matrix with such entries at most."""
        return np.asarray(np.sqrt(np.sum(np.square(of_entries), axis=0)))

    def least(self, parts: Array, remainders: Sequence[Remainder]) -> Array:
        """Lower bounds on parts of cells, given by their vertices."""
        least = _eigenvalues(self.quadratic(parts))[0].min(axis=1) - BESIDE * self.distance(remainders, 2)
        return least if self.is_matrix else np.fmax(least, remainders[0].value.lo)

    def quadratic(self, vertices: Array) -> Array:
        """The Bernstein coefficients of quadratics near it on simplices, shape (n, nodes), or of matrices."""
        return self._joined([bernstein(interpolated(tree, vertices), vertices) for tree in self.trees])

    def _joined(self, entries: list[Array]) -> Array:
        """One array of the entries."""
        dim = round(len(entries) ** 0.5)
        return np.stack(entries, axis=-1).reshape(*entries[0].shape, dim, dim) if self.is_matrix else entries[0]


def _eigenvalues(matrices: Array) -> tuple[Array, Array]:
    """The smallest and the largest eigenvalues of numbers, shape (n, points), or matrices; NaN where there are none."""
    if matrices.ndim == 2:
        return matrices, matrices
    known = np.isfinite(matrices).all(axis=(2, 3))
    eigenvalues = np.linalg.eigvalsh(np.where(known[..., None, None], matrices, 0.0))
    least, most = (np.where(known, eigenvalues[..., end], np.nan) for end in (0, -1))
    return least, most


def conductivities(resolution: Resolution, kappa: Datum) -> list[Conductivity]:
    """The pieces of κ; none if it was given in Python, which is recorded."""
    pieces = []
    for given, cells in resolution.pieces("kappa", kappa):
        trees = [given] if isinstance(given, TREES) else [entry for row in given for entry in row]
        pieces.append(Conductivity(trees, cells, is_matrix=not isinstance(given, TREES)))
    return pieces


def enclosed(resolution: Resolution, metric: CellMetric, kappa: Datum, size: float) -> CellMetric:
    """The metric with low κ_h ≤ κ ≤ high κ_h on whole cells, and ρ (collective).

    With κ = κ̃ + δ and a quadratic κ̃, κ_h^-½κ̃κ_h^-½ is in each point a weighted mean of κ_h^-½κ_iκ_h^-½ for the
    Bernstein coefficients κ_i of κ̃.

    Args:
        resolution: Encloses data.
        metric: The metric, with `low` and `high` from the nodes of P2 only.
        kappa: κ.
        size: ‖σ_h‖.
    """
    if kappa.number is not None or isinstance(kappa, OnCells):  # constant or linear: its ends are at vertices
        return metric
    number, frame = len(metric.volume), resolution.spaces.frame
    low, high, kappa_min = metric.low.copy(), metric.high.copy(), metric.kappa_min.copy()
    rho = np.zeros(number)
    inverse = of_all_cells(metric.inverse, number)
    for piece in conductivities(resolution, kappa):
        cells = piece.cells
        vertices, tolerance = resolution.vertices[cells], SHARE * np.maximum(metric.kappa_min[cells], SMALLEST)
        beyond = np.zeros((2, len(piece.trees), len(cells)))
        for row, tree in enumerate(piece.trees):
            if not is_polynomial(tree, 2):
                p = interpolated(tree, vertices)
                beyond[0, row] = ranges(tree, vertices, p, frame, -tolerance, tolerance).sup
            if not is_polynomial(tree, DEGREE):
                enough = RESOLVED * tolerance * resolution.error / max(size, SMALLEST)
                beyond[1, row] = distances(tree, vertices, frame, enough)
        beside, rho[cells] = (piece.norm(each) for each in beyond)
        root, coefficients = np.linalg.cholesky(inverse[cells])[:, None], piece.quadratic(vertices)
        if piece.is_matrix:
            coefficients = root.transpose(0, 1, 3, 2) @ coefficients @ root
        else:
            coefficients = coefficients * inverse[cells, 0, 0][:, None]
        least, most = _eigenvalues(coefficients)
        beside = beside * np.linalg.norm(inverse[cells], ord=2, axis=(1, 2))
        least, most = least.min(axis=1, initial=1.0) - beside, most.max(axis=1, initial=1.0) + beside
        lost = ~(least > 0)
        lowest = _lowest(resolution, piece, vertices[lost])
        least[lost] = lowest * np.linalg.eigvalsh(inverse[cells[lost]])[:, 0]
        known = (least > 0) & np.isfinite(most)
        resolution.note("kappa", vertices[~known].mean(axis=1), cells[~known])
        low[cells[known]], high[cells[known]] = least[known], most[known]
        kappa_min[cells[known]] *= (least / metric.low[cells])[known]
        kappa_min[cells[lost & known]] = lowest[known[lost]]
    return replace(metric, low=low, high=high, kappa_min=kappa_min, rho=rho)


def _lowest(resolution: Resolution, piece: Conductivity, vertices: Array) -> Array:
    """Lower bounds of eigenvalues of κ on cells by their parts, ≤ 0 where none is found (collective)."""

    def look(parts: Parts, *remainders: Remainder) -> Array:
        seen = piece.smallest(parts.vertices).min(axis=1)
        return np.stack([piece.least(parts.vertices, remainders), seen], axis=1)

    def need(parts: Parts, of_parts: Array) -> Array:
        least, seen = of_parts.T
        return np.where((least < seen / ROUGH) & (parts.share > SMALL), 1.0, 0.0)

    parts, of_parts = in_parts(piece.trees, vertices, resolution.spaces.frame, look, need, piece.smallest)
    lowest = np.full(len(vertices), np.inf)
    np.minimum.at(lowest, parts.own, np.nan_to_num(of_parts[:, 0], nan=-np.inf))
    return lowest
