"""An obstacle in Ω, u ≥ ψ, as a condition on each cell.

The mean u_T of u is at least that of ψ, and the force λ_T = −∇·σ − f_h of the obstacle is ≥ 0; one of u_T − ψ_T and λ_T
is 0. So a cell is a site like a facet of Γ_S, with the pair (u_T − ψ_T, λ_T) in the place of (p, σ·n).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.data_values import check_finite, check_means
from signorini_fenicsx.discrete.datum import Datum, datum_of, quadrature_degree
from signorini_fenicsx.discrete.points import (
    cell_quadrature,
    facet_type,
    in_facets,
    owned_cells,
    quadratic_nodes,
)
from signorini_fenicsx.expressions.given import Given
from signorini_fenicsx.physics.diffusion.spaces import Spaces

ROUNDING = 1e-12
"""Relative size by which u_D may be below ψ."""


@dataclass(frozen=True)
class Obstacle:
    """The obstacle of a problem.

    Attributes:
        psi: ψ as given.
        means: ψ_T, per owned cell.
    """

    psi: Datum
    means: Array

    def less(self, constant: float) -> Obstacle:
        """That of the problem for u − constant."""
        return replace(self, psi=self.psi.less(constant), means=self.means - constant)


def obstacle_of(spaces: Spaces, given: Given | None, u_D: Datum) -> Obstacle | None:
    """The obstacle, None if there is none (collective).

    Raises:
        InputError: If ψ or its gradient is not finite, or ψ > u_D somewhere on Γ_D.
    """
    if given is None:
        return None
    psi = datum_of(spaces, "obstacle", given)
    mesh, cells = spaces.mesh, owned_cells(spaces.mesh)
    check_finite(spaces, "[problem] obstacle", "in the domain", psi, cells)
    if psi.number is not None:
        means = np.full(len(cells), psi.number)
    else:
        blocks = cell_quadrature(mesh, cells, quadrature_degree(psi))
        means = np.concatenate([points.means(psi.values(points)) for points in blocks])
    check_means("obstacle", "in the domain", means, spaces)
    _check_below(spaces, psi, u_D)
    return Obstacle(psi, means)


def _check_below(spaces: Spaces, psi: Datum, u_D: Datum) -> None:
    """Make sure that ψ ≤ u_D in the vertices and edge midpoints on Γ_D (collective).

    Raises:
        InputError: On all ranks, with the place where it is worst.
    """
    mesh = spaces.mesh
    points = in_facets(mesh, spaces.dirichlet_facets, quadratic_nodes(facet_type(mesh.topology.dim)))
    above, given = (datum.values(points).ravel() for datum in (psi, u_D))
    excess = above - given
    worst: tuple[float, tuple[float, ...]] = (0.0, ())
    if len(excess) > 0:
        place = int(np.argmax(excess))
        worst = float(excess[place]), tuple(points.x.reshape(-1, mesh.geometry.dim)[place].tolist())
    size = max(mesh.comm.allgather(float(np.abs(given).max(initial=0.0)) + float(np.abs(above).max(initial=0.0))))
    most, x = max(mesh.comm.allgather(worst))
    if most > ROUNDING * size:
        at = ", ".join(f"{coordinate:.4g}" for coordinate in x)
        raise InputError(
            f"[problem] obstacle: is above u_D on Γ_D, as at ({at}) by {most:.3g}; u cannot be both u_D and above it"
        )
