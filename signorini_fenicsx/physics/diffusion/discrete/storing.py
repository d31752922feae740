"""What soil stores in a step in time: aθ(u) on each cell, as a part of the sources.

On a cell y = −∇·σ and u = ū + My with ū and M from û and κ alone, where u and y are given by their values in *places*:
for RT0 the centroid, for RT1 the points of the rule that is exact for quadratics, as many as the vertices. There θ is
taken, so that for RT1 aθ is linear on a cell. The balance y = f + Σ_k w_k θ_(n−k) − aθ(u) is an equation for u alone,
with one solution as M is symmetric and θ grows. So θ needs no unknown of its own. Around that u it is linear,
aθ ≈ cu − load, and what the step leaves is the θ that its balance has.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete import cell_shapes
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces

STEPS, HALVINGS = 100, 50
"""Newton's steps for u, and how often each is halved until what is left of the balance falls,"""
FALLS = 1e-4
"""by this share of the step."""
CLOSE = 4e-16
"""A step of this share of u, or of what would change the balance by its load, is none."""


@dataclass(frozen=True)
class WaterBefore:
    """What a step with soils takes from those before.

    Attributes:
        content: Σ_k w_k θ_(n−k).
        traces: û where `Quasilinear` looks at it, from which the step begins.
        rate: a.
    """

    content: fem.Function
    traces: Array
    rate: float = 0.0


def hats_in_places(spaces: Spaces) -> Array:
    """The hats of the vertices of a cell in its places, shape (places, d + 1)."""
    size = spaces.mesh.topology.dim + 1
    share = 1 / np.sqrt(size + 1) if spaces.degree else 0.0
    return np.asarray(share * np.eye(size)[: size if spaces.degree else 1] + (1 - share) / size)


def in_places(spaces: Spaces, values: Array) -> Array:
    """A function in the places of the owned cells, from what `Spaces.scalar` takes of it."""
    if isinstance(spaces, RT1Spaces):
        return np.asarray(values @ hats_in_places(spaces).T)
    return values.reshape(-1, 1)


def from_places(spaces: Spaces, values: Array) -> Array:
    """What `Spaces.scalar` takes of a function, from its values in the places."""
    if isinstance(spaces, RT1Spaces):
        return np.asarray(values @ np.linalg.inv(hats_in_places(spaces)).T)
    return values


@dataclass(frozen=True)
class Storing:
    """aθ(u) of soils on the owned cells. All arrays have values in places, shape (cells, places).

    Attributes:
        spaces: The discrete spaces.
        content: θ and its derivative for u in the places of these cells, see `Quasilinear.content`.
        rate: a.
        f: Π f.
        before: Σ_k w_k θ_(n−k).
        traces: û of the last solution where `Quasilinear` looks at it.
        slopes: c.
    """

    spaces: Spaces
    content: Callable[[Array], tuple[Array, Array]]
    rate: float
    f: Array
    before: Array
    traces: Array
    slopes: Array | None = None

    @cached_property
    def moments(self) -> Array:
        """M of RT0 for κ = 1, shape (cells, 1, 1), see `sources.mean_moments`."""
        moments = cell_shapes.mean_moments(self.spaces.squared_arms) / self.spaces.mesh.topology.dim**2
        return np.asarray(moments[:, None, None])

    def linear(self, means: Array, moments: Array) -> tuple[Array, Array]:
        """C and load with aθ = cu − load around the u of each cell.

        Args:
            means: ū.
            moments: M, shape (cells, places, places).
        """
        inverse, given = np.linalg.inv(moments), self.f + self.before

        def left(u: Array) -> tuple[Array, Array]:
            theta, slope = self.content(u)
            value = np.einsum("npq,nq->np", inverse, u - means) + self.rate * theta - given
            return value, inverse + self.rate * slope[:, :, None] * np.eye(u.shape[1])

        u = means.copy()
        value, slope = left(u)
        for _ in range(STEPS):
            step, of_given = np.moveaxis(np.linalg.solve(slope, np.stack([-value, np.abs(given)], axis=2)), 2, 0)
            share, size = np.ones((len(u), 1)), np.linalg.norm(value, axis=1)
            rounding = CLOSE * (np.abs(u) + np.abs(means) + np.abs(of_given))
            for _ in range(HALVINGS):
                found = left(u + share * step)
                rises = np.linalg.norm(found[0], axis=1) > (1 - FALLS * share[:, 0]) * size
                rises &= (np.abs(share * step) > rounding).any(axis=1)
                if not rises.any():
                    break
                share[rises] /= 2
            share[rises] = 0.0
            moved, u = np.abs(share * step), u + share * step
            value, slope = left(u) if rises.any() else found
            if (moved <= rounding).all():
                break
        theta, rise = self.content(u)
        return self.rate * rise, self.rate * (rise * u - theta)

    def products(self, numbers: npt.NDArray[np.int32]) -> Array:
        """(cφ_v, φ_w) for the hats of the vertices of cells with RT1, by the rule of the places."""
        hats, (_, places) = hats_in_places(self.spaces), self.f.shape
        assert self.slopes is not None
        share = self.spaces.cell_measures[numbers] / places
        return np.asarray(np.einsum("n,nq,qv,qw->nvw", share, self.slopes[numbers], hats, hats))

    def left(self, u: Array, c: Array, load: Array) -> Array:
        """The θ that a balance has, with u on the owned cells as `Spaces.scalar` takes it."""
        return (c * in_places(self.spaces, u) - load) / self.rate

    def change(self, u: Array, c: Array, load: Array) -> float:
        """The largest amount by which it differs from θ(u), over all cells (collective)."""
        off = np.abs(self.left(u, c, load) - self.content(in_places(self.spaces, u))[0])
        return float(self.spaces.mesh.comm.allreduce(float(off.max(initial=0.0)), MPI.MAX))

    def with_one_slope(self, u: Array, c: Array, load: Array) -> tuple[Array, Array]:
        """C and load with the same θ at the u of a solution, and one c on each cell."""
        mean = np.broadcast_to(c.mean(axis=1, keepdims=True), c.shape)
        return mean, mean * in_places(self.spaces, u) - self.rate * self.left(u, c, load)
