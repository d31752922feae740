"""Which u is what of water: a head, minus a head, a pressure head or, of Baiocchi, the integral of the pressure.

With the height z, the last coordinate, the pressure head is h − z. What flows in through a part of the boundary is
∫κ∇u·n with the head or the pressure head as u, and minus that with minus the head.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.cases.plot import Plot
from signorini_fenicsx.contact.laws import River, Seepage, Signorini
from signorini_fenicsx.discrete.data_values import extent
from signorini_fenicsx.discrete.sections import Spots
from signorini_fenicsx.physics.diffusion.soils import FORMS

if TYPE_CHECKING:  # it has these
    from signorini_fenicsx.physics.diffusion.solution import Solution

HEAD, MINUS_HEAD, PRESSURE, INTEGRAL = "head", "minus head", "pressure head", "integral of the pressure"
SAME = 1e-6
"""Heights that differ by this share of that of the domain are the same."""
STEEP = 0.05
"""A ψ is minus the height if it is so on facets that have at least this share of the heights of the domain."""


@dataclass(frozen=True)
class Water:
    """What u is.

    Attributes:
        u: One of the words above.
    """

    u: str

    @property
    def inflow(self) -> float:
        """What flows in through the boundary is ∫σ·n times this."""
        return -1.0 if self.u == MINUS_HEAD else 1.0

    def pressure(self, x: Array, u: Array, sigma: Array | None = None) -> Array:
        """The pressure head in points.

        Args:
            x: The points, whose coordinates are the last axis.
            u: u there.
            sigma: κ∇u there, components last, if u is Baiocchi's.
        """
        if self.u == INTEGRAL:
            assert sigma is not None
            return np.asarray(-sigma[..., -1])
        if self.u == PRESSURE:
            return u
        return np.asarray((-u if self.u == MINUS_HEAD else u) - x[..., -1])

    def head(self, x: Array, u: Array, sigma: Array | None = None) -> Array:
        """The head in points, see `pressure`."""
        return np.asarray(self.pressure(x, u, sigma) + x[..., -1])


def water_of(solution: Solution) -> Water | None:
    """What u is: as `[plot] water` says, else as soils and laws tell; None if it is nothing of water (collective)."""
    plot: Plot | None = getattr(solution.source, "plot", None)
    given = None if plot is None else plot.water
    if given is False:
        return None
    if getattr(solution.source, "dam", None) is not None:
        return Water(INTEGRAL)
    if isinstance(given, str):
        return Water(given)
    found = _by_laws(solution)
    return Water(HEAD) if found is None and given else found


def _by_laws(solution: Solution) -> Water | None:
    """What soils and the laws on Γ_S tell (collective)."""
    of_u, laws, spaces = solution.data.quasilinear, solution.data.laws.of_parts, solution.spaces
    if of_u is not None and of_u.has_soils:
        return Water(HEAD if of_u.form == FORMS[0] else PRESSURE)
    mesh = spaces.mesh
    low, high = spaces.domain.box()[:, mesh.geometry.dim - 1]
    z = dolfinx.mesh.compute_midpoints(mesh, mesh.topology.dim - 1, spaces.facets)[:, mesh.geometry.dim - 1]
    psi, near = solution.data.psi_h, SAME * (high - low)

    def all_at(kind: type, wanted: Array) -> bool:
        rows = np.concatenate([part.rows for part in laws if isinstance(part.law, kind)] + [np.empty(0, dtype=int)])
        off = np.abs(psi[rows] - wanted[rows]).max(initial=0.0)
        return bool(mesh.comm.allreduce(float(off), MPI.MAX) <= near)

    if any(isinstance(part.law, Seepage) for part in laws):
        if all(part.data["level"].number == 0 for part in laws if isinstance(part.law, Seepage)):
            return Water(PRESSURE)
        return Water(HEAD) if all_at(Seepage, z) else None
    if any(isinstance(part.law, River) for part in laws):
        return Water(HEAD)
    if not any(isinstance(part.law, Signorini) and part.law.parts for part in laws) or not all_at(Signorini, -z):
        return None
    lowest, highest = extent(z, mesh.comm)
    return Water(MINUS_HEAD) if highest - lowest >= STEEP * (high - low) else None


def at_points(solution: Solution, points: Array, u: Array, sigma: Array) -> dict[str, Array]:
    """What a probe reads off of water besides u and σ: the pressure head and, of soils, the saturation (collective)."""
    water, of_u = solution.water_kind, solution.data.quasilinear
    if water is None:
        return {}
    found = {"pressure": water.pressure(points, u, sigma)}
    if of_u is None or not of_u.has_soils:
        return found
    places = Spots.of(solution.spaces.domain, points)
    of_pairs = of_u.saturation(places.points[places.rows], u[places.rows], places.cells)
    return found | {"saturation": places.means(of_pairs)[:, 0]}
