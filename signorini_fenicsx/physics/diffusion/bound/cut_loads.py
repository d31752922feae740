"""Loads with factors that the mesh does not resolve, such as c or a capacity that jumps: integrated part by part.

Let a load on a cell T be L = s + Σ_i e_i q_i with a number s, expressions e_i and polynomials q_i, and on each part P
of T let e_i be within ρ_i of a polynomial. With the quadrature Q of the parts, which is exact for squares of these
polynomials times q_i, and an orthonormal basis φ of polynomials on T, the load is Σ_a Q(Lφ_a)φ_a + R with
‖R‖ ≤ Q((L − Σ_a Q(Lφ_a)φ_a)²)^½ + E, E = 2 Σ_i (Σ_P ρ_i²‖q_i‖²_P)^½, and its mean is Q(L) ± E|T|^-½.

Proof. With the polynomials in the place of e_i all of this is exact without E. The change of L has at most half of E as
its norm, in L² and by Q.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.reference_cells import orthonormal, positive_quadrature
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.points import PartPoints, Points
from signorini_fenicsx.expressions.cutting import CHUNK, in_parts
from signorini_fenicsx.expressions.series import DEGREE, Remainder
from signorini_fenicsx.expressions.simplices import Parts
from signorini_fenicsx.physics.diffusion.bound.local_fields import HIGH, Projection
from signorini_fenicsx.physics.diffusion.bound.metric import CellMetric
from signorini_fenicsx.physics.diffusion.bound.resolution import SMALLEST, Resolution

ROUNDING = 1e-14
"""Rounding of means of squares, as a share of the sizes."""


@dataclass(frozen=True)
class Term:
    """A term e q of a load.

    Attributes:
        name: Name of e.
        e: A text, or texts by regions.
        q: Gives q in points, of a degree ≤ dim + 1 on each cell, for RT1 one more.
        size: Rough size of q on each owned cell.
    """

    name: str
    e: Datum
    q: Callable[[Points], Array]
    size: Array


@dataclass(frozen=True)
class CutLoads:
    """Loads L − δe_1 with mean 0 but for what is unsure, per cell.

    Attributes:
        load: Their projections, and bounds of the rest.
        delta: δ; 0 where the mean of e_1 is not positive, then the mean of L is in `mean`.
        mean: The mean by quadrature.
        unsure: E|T|^-½.
        of_first: Upper bound of the mean of e_1.
    """

    load: Projection
    delta: Array
    mean: Array
    unsure: Array
    of_first: Array

    def of(self, rows: Mask) -> "CutLoads":
        """A selection of the cells."""
        return CutLoads(self.load.of(rows), self.delta[rows], self.mean[rows], self.unsure[rows], self.of_first[rows])


def cut_loads(
    terms: list[Term], numbers: Array, resolution: Resolution, cells: Indices, fine: Array, metric: CellMetric
) -> CutLoads:
    """Integrate loads on some owned cells, about as sharply as `fine` (collective).

    Args:
        terms: The terms.
        numbers: s of each owned cell.
        resolution: Has the data.
        cells: The cells, ascending.
        fine: A load size per owned cell that need not be seen.
        metric: Metric of the owned cells.
    """
    mesh = resolution.spaces.mesh
    cell, dim = mesh.basix_cell(), mesh.topology.dim
    basis = orthonormal(cell, HIGH[dim])
    points, weights = positive_quadrature(cell, 2 * (DEGREE + dim + 1 + resolution.spaces.degree))
    volume, columns = weights.sum(), 2 * basis.dim + 3
    weight = np.stack([(term.size / np.maximum(fine, SMALLEST))[cells] ** 2 for term in terms])
    weight *= metric.volume[cells] / resolution.volume
    sums, unsure = np.zeros((len(cells), columns)), np.full((len(cells), len(terms) + 1), np.inf)

    def look(parts: Parts, *remainders: Remainder) -> Array:
        return np.stack([remainder.distance() for remainder in remainders], axis=1)

    def integrate(parts: Parts, rho: Array) -> None:
        of_parts = PartPoints(mesh, cells[parts.own].astype(np.int32), points, weights, parts.vertices)
        e, q = [term.e.values(of_parts) for term in terms], [term.q(of_parts) for term in terms]
        load = numbers[of_parts.cells, None] + sum(a * b for a, b in zip(e, q, strict=True))
        x = of_parts.barycentric[:, :, 1:]
        phi = basis.tabulate(0, x.reshape(-1, dim))[0][:, :, 0].reshape(*x.shape[:2], -1)
        moments = [np.einsum("nq,q,nqa->na", each, weights, phi) for each in (load, e[0])]
        squares = [(one * other) @ weights for one, other in ((load, load), (load, e[0]), (e[0], e[0]))]
        share = parts.share[:, None]
        np.add.at(sums, parts.own, share * np.column_stack([*moments, *squares]))
        of_q = [rho[:, i] ** 2 * (each**2 @ weights) for i, each in enumerate(q)]
        np.add.at(unsure, parts.own, share * np.column_stack([*of_q, rho[:, 0] ** 2 * volume]))

    groups: list[tuple[tuple, Indices]] = [((), np.arange(len(cells)))]
    for term in terms:
        pieces = resolution.pieces(term.name, term.e)
        groups = [((*trees, tree), rows[np.isin(cells[rows], own)]) for trees, rows in groups for tree, own in pieces]
    for trees, rows in groups:
        unsure[rows] = 0.0

        def need(parts: Parts, rho: Array, rows: Indices = rows) -> Array:
            wanted = parts.share * (weight[:, rows[parts.own]].T * rho**2).sum(axis=1)
            return np.where(np.isnan(wanted), np.inf, wanted)

        parts, rho = in_parts(trees, resolution.vertices[cells[rows]], resolution.spaces.frame, look, need)
        parts = Parts(parts.vertices, rows[parts.own], parts.share)
        for begin in range(0, len(parts.own), CHUNK):
            some = slice(begin, begin + CHUNK)
            integrate(parts.take(some), rho[some])
    return _balanced(sums, unsure, basis.dim, volume)


def _balanced(sums: Array, unsure: Array, number: int, volume: float) -> CutLoads:
    """Loads less the multiple of e_1 that has their mean, from sums over the parts."""
    of_load, of_first = sums[:, :number], sums[:, number : 2 * number]
    positive = of_first[:, 0] > 0
    delta = np.divide(of_load[:, 0], of_first[:, 0], out=np.zeros(len(sums)), where=positive)
    coefficients = of_load - delta[:, None] * of_first
    squares = sums[:, 2 * number] - 2 * delta * sums[:, -2] + delta**2 * sums[:, -1]
    rounding = ROUNDING * (sums[:, 2 * number] + delta**2 * sums[:, -1])
    rest = np.maximum(squares - (coefficients**2).sum(axis=1), 0.0) + rounding
    missed = 2 * (np.sqrt(unsure[:, :-1]).sum(axis=1) + np.abs(delta) * np.sqrt(unsure[:, -1]))
    load = Projection(coefficients[:, 1:], (np.sqrt(rest) + missed) ** 2)
    most = of_first[:, 0] / np.sqrt(volume) + 2 * np.sqrt(unsure[:, -1] / volume)
    return CutLoads(load, delta, coefficients[:, 0] / np.sqrt(volume), missed / np.sqrt(volume), most)
