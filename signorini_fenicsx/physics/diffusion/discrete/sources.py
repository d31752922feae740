"""The source of each cell as a function of u_CR, see `forms/crouzeix_raviart.py`."""

from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, inverses
from signorini_fenicsx.base.owned import function_of, owned_values
from signorini_fenicsx.contact.chains import SiteConditions
from signorini_fenicsx.discrete import cell_shapes
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


@dataclass(frozen=True)
class Sources:
    """y_T = b_T − s_T ū_T on each owned cell, with ū_T the mean of a Crouzeix-Raviart function.

    Attributes:
        s: s_T ≥ 0 in P0; None if it is 0 everywhere.
        b: b_T in P0.
        moments: m_T.
        jumps: What is added to ū_T for a given flux b, the mean of `Data.jumps`.
    """

    s: fem.Function | None
    b: fem.Function
    moments: Array
    jumps: Array | float = 0.0

    def renewed(self, data: Data) -> "Sources":
        """The sources for another f_h, with the same κ_h and c_h."""
        if self.s is None or data.c_h is None:
            return replace(self, b=data.f_h)
        b = fem.Function(self.b.function_space)
        c = data.c_h.x.array
        b.x.array[:] = data.f_h.x.array * np.divide(self.s.x.array, c, out=np.ones_like(c), where=c > 0)
        return replace(self, b=b)

    def values(self, traces: Array) -> tuple[Array, Array]:
        """u_T = ū_T + m_T y_T and y_T per owned cell, from u_CR on their facets."""
        means, y = np.einsum("cf->c", traces) / traces.shape[1] + self.jumps, owned_values(self.b)
        if self.s is not None:
            y = y - owned_values(self.s) * means
        return means + self.moments * y, y


def sources(spaces: Spaces, data: Data, conditions: SiteConditions | None = None) -> Sources:
    """The sources of −∇·σ + c_h u + s = f_h, with the laws in Ω under conditions on the cells; without these s = 0."""
    moments, z = mean_moments(spaces, data), data.jumps(spaces)
    jumps = 0.0 if z is None else z.mean(axis=1)
    if data.c_h is None and not data.inside:
        return Sources(None, data.f_h, moments, jumps)
    if data.inside and conditions is not None:
        beta, load = data.inside.as_linear(conditions)
        held = np.isinf(beta)
        c = np.where(held, 0.0, beta) + (0.0 if data.c_h is None else owned_values(data.c_h))
        s = function_of(spaces.Q, np.where(held, 1 / moments, c / (1 + c * moments)))
        b = np.where(held, load / moments, (owned_values(data.f_h) + load) / (1 + c * moments))
        return Sources(s, function_of(spaces.Q, b), moments, jumps)
    c = np.zeros(1) if data.c_h is None else owned_values(data.c_h)
    return Sources(function_of(spaces.Q, c / (1 + c * moments)), data.f_h, moments, jumps).renewed(data)


def mean_moments(spaces: Spaces, data: Data) -> Array:
    """m_T = mean of (x − x_T)·κ_h⁻¹(x − x_T) over T, divided by d², for each owned cell."""
    if data.kappa.number is not None:
        squared = spaces.squared_arms / data.kappa.number
    else:
        squared = cell_shapes.squared_arms(spaces.mesh, inverses(data.matrices(spaces)))
    return cell_shapes.mean_moments(squared) / spaces.mesh.geometry.dim**2
