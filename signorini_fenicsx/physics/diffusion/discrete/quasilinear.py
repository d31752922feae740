"""κ(x, u) on a mesh: the κ of each cell from û on its facets, and how it changes with û.

The κ of a cell with RT0 is the mean of κ(x, û) over its facets, with x the midpoint of each, in time where the slope
of κ asks for it one nearer to what is upstream; with RT1 it is linear on a cell, at a vertex the mean over the facets
there. From u_T instead fewer soils would have a solution that is found.
"""

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tolerances import ROUNDING
from signorini_fenicsx.contact.law import EVERYWHERE
from signorini_fenicsx.discrete.cell_shapes import Entities, corners
from signorini_fenicsx.discrete.datum import Datum, conductivity_of
from signorini_fenicsx.discrete.linear_traces import opposite
from signorini_fenicsx.discrete.points import Points
from signorini_fenicsx.expressions import TREES, Tree, depends_on, values_and_gradient
from signorini_fenicsx.expressions.evaluation import interval
from signorini_fenicsx.expressions.intervals import Interval
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces
from signorini_fenicsx.physics.diffusion.discrete.storing import Storing, hats_in_places
from signorini_fenicsx.physics.diffusion.soils import FLOOR, FORMS, Soil

type Curve = Callable[[Array, Array], tuple[Array, Array]]
"""κ and its derivative by u in points, whose coordinates are the last axis, for u there."""
CLOSE = 1e-9
"""A step of this share of û is too short for a difference of κ."""
RANGES = 64
"""Parts of the range of u on a cell, on each of which κ is enclosed."""
NUDGE = 6e-6
"""The share of u, or of 1, by which u is moved for the derivative of a function of the user."""


@dataclass(frozen=True)
class OnCells(Datum):
    """A scalar that is constant or linear on each cell.

    Attributes:
        ufl: It as a function.
        on_cells: Its value, or its values at the vertices, on each owned cell.
    """

    ufl: fem.Function
    on_cells: Array

    @property
    def polynomial(self) -> int:
        """0 or 1."""
        return int(self.on_cells.shape[1] > 1)

    def _look(self, points: Points, *, slope: bool) -> Array:
        if self.polynomial:
            jet = points.linear(self.ufl, gradient=slope)
            return jet[:, :, 1:] if slope else jet[:, :, 0]
        if slope:
            return np.zeros((*points.shape, points.mesh.geometry.dim))
        return np.repeat(self.on_cells[points.rows], points.shape[1], axis=1)


@dataclass(frozen=True)
class Quasilinear:
    """κ as a function of x and u on the owned cells.

    Attributes:
        spaces: The discrete spaces, of RT0 or of RT1.
        parts: Masks of owned cells, and κ there.
        ends: The smallest and the largest given u, with which it begins.
        constant: What is taken from u, see `Data.less`.
        power: s of κ^s κ_0^(1 − s), with κ_0 that of the beginning; 1 is κ.
        form: What u is in soils, see `soils.FORMS`.
        storing: What soils store in a step in time; None if that is nothing.
        controls: Masks of owned cells, and the soils there whose numbers are Constants.
    """

    spaces: Spaces
    parts: list[tuple[Mask, Curve]]
    ends: tuple[float, float] = (0.0, 0.0)
    constant: float = 0.0
    power: float = 1.0
    form: str = FORMS[0]
    storing: Storing | None = None
    controls: Sequence[tuple[Mask, Soil]] = ()

    @cached_property
    def _places(self) -> tuple[Array, Array]:
        """The points of each cell where û is looked at, shape (cells, n, dim), and their shares in κ."""
        spaces, hats = self.spaces, self._hats
        if isinstance(spaces, RT1Spaces):
            return hats @ spaces.vertices, hats.T / spaces.dim
        return hats @ corners(spaces.mesh), np.full((1, len(hats)), 1 / len(hats))

    @property
    def _hats(self) -> Array:
        """The barycentric coordinates of these points."""
        dim = self.spaces.mesh.topology.dim
        vertices = np.eye(dim + 1)
        return vertices[opposite(dim).ravel()] if self.spaces.degree else (1 - vertices) / dim

    def of_traces(self, traces: Array) -> tuple[Array, Array]:
        """κ of each cell and its derivatives by û, shapes (cells, values) and (cells, values, n).

        Args:
            traces: The values of û less the constant on the facets of the owned cells, shape (cells, n).
        """
        value, slope = self._at(traces)
        shares = self._shares(traces, value)
        return np.einsum("cvn,cn->cv", shares, value), shares * slope[:, None]

    def _shares(self, traces: Array, value: Array) -> Array:
        """The shares in κ of the values of κ where û is looked at, shape (1 or cells, values, n).

        In time cells of soils that are steepest at saturation have them from `_upstream`.
        """
        (x, shares), steep = self._places, [each for each in self.soils if each[1].goes_upstream]
        if self.storing is None or self.spaces.degree or not steep:
            return shares[None]
        found, heads = np.repeat(shares[None], len(value), axis=0), self.head(x, traces + self.constant)
        for inside, soil in steep:
            slope = soil.slope_below(heads[inside] - x[inside][..., -1])
            found[inside, 0] = _upstream(self._gradients[inside], heads[inside], value[inside], slope)
        return found

    @cached_property
    def _gradients(self) -> Array:
        """∇φ_i of the functions φ_i on each cell that are 1 on a facet, and have the mean 0 on the others."""
        vertices = corners(self.spaces.mesh)
        inner = np.linalg.inv(vertices[:, 1:] - vertices[:, :1]).transpose(0, 2, 1)
        dim = self.spaces.mesh.topology.dim
        return dim * np.concatenate([inner.sum(axis=1, keepdims=True), -inner], axis=1)

    def by_controls(self, traces: Array) -> Iterator[tuple[Any, Array]]:
        """Each Constant in a soil, and the derivative of κ of the owned cells by it; of RT0 (collective)."""
        x, shares = self._places
        head = self.head(x, traces + self.constant)
        for inside, soil in self.controls:
            for name, constant in soil.constants.items():
                step = NUDGE * abs(float(constant.value))
                moved = [replace(soil.plain, **{name: float(constant.value) + by}) for by in (step, -step)]
                of_points = [each(x[inside], head[inside])[0] for each in moved]
                derivative = np.zeros(len(x))
                derivative[inside] = (of_points[0] - of_points[1]) @ shares[0] / (2 * step)
                yield constant, derivative

    def traces_of(self, u: Array) -> Array:
        """Where û is looked at, a u that is linear on the owned cells, by its values at vertices, less the constant."""
        if isinstance(self.spaces, RT1Spaces):
            u = np.take_along_axis(u, self.spaces.order, axis=1)
        return self.traces_of_values(u)

    def traces_of_values(self, u: Array) -> Array:
        """The same of a u on the owned cells as `Spaces.scalar` takes it."""
        vertices = np.broadcast_to(u.reshape(len(u), -1), (len(u), self._hats.shape[1]))
        return np.asarray(vertices @ self._hats.T - self.constant)

    def content(self, u: Array) -> tuple[Array, Array]:
        """The water in a unit volume of soil and its derivative, with these u in `places` of cells; 0 elsewhere."""
        spaces, content, slope = self.spaces, np.zeros_like(u), np.zeros_like(u)
        x = hats_in_places(spaces) @ (spaces.vertices if isinstance(spaces, RT1Spaces) else corners(spaces.mesh))
        head = self.head(x, u)
        for inside, soil in self.soils:
            content[inside], slope[inside] = soil.content(x[inside], head[inside])
        return content, slope

    def nearer(self, traces: Array, wanted: Array) -> Array:
        """These û on the facets of the owned cells, less the constant, or nearer ones to others (collective).

        See `Soil.nearer`. A pressure head that is rounding is 0: else saturation, to which steps go at most, would be
        ahead for ever. The soil that loses its water is that below the highest facet that falls below saturation.
        """
        assert self.storing is not None
        spaces, (x, _), found = self.spaces, self._places, wanted.copy()
        heights, halves = x[..., -1], np.ptp(corners(spaces.mesh)[..., -1], axis=1) / 2
        height = heights if self.form == FORMS[0] else np.zeros_like(heights)
        before, after = (each + self.constant - height for each in (traces, wanted))
        before[np.abs(before) <= ROUNDING * (np.abs(traces) + abs(self.constant) + np.abs(height))] = 0.0
        falls = (before >= 0) & (after < 0)
        top = spaces.mesh.comm.allreduce(heights[falls].max(initial=-np.inf), MPI.MAX)
        for inside, soil in self.soils:
            lowest, falling = np.full(heights.shape, -np.inf), falls & inside[:, None]
            depths = top - heights + halves[:, None]
            lowest[falling] = soil.drained(self.storing.rate * depths[falling])
            found[inside] += soil.nearer(before[inside], after[inside], lowest[inside]) - after[inside]
        return found

    @property
    def soils(self) -> list[tuple[Mask, Soil]]:
        """The soils, with masks of owned cells."""
        return [(inside, curve) for inside, curve in self.parts if isinstance(curve, Soil)]

    def unsure(self, traces: Array) -> Mask:
        """The owned cells on which κ is not enclosed above 0 for all u in the range of û there.

        Soils are positive by their formulas; a text is enclosed, and a function in Python cannot be.

        Args:
            traces: As of `of_traces`.
        """
        x, u, unsure = corners(self.spaces.mesh), traces + self.constant, np.ones(len(traces), dtype=bool)
        ends = [np.stack([of.min(axis=1), of.max(axis=1)]) for of in (*np.moveaxis(x, 2, 0), u)]
        for inside, curve in self.parts:
            unsure[inside] = not isinstance(curve, Soil)
            if isinstance(curve, _OfTree):
                unsure[inside] = ~(curve.least([end[:, inside] for end in ends]) > 0)
        return unsure

    def on_floor(self, kappa: Array) -> Mask:
        """The owned cells, with these values of κ, where soil is so dry that k_r cannot fall further."""
        least = np.zeros(len(kappa))
        for inside, curve in self.parts:
            least[inside] = 2 * FLOOR * curve.K if isinstance(curve, Soil) else 0.0
        return kappa.min(axis=1, initial=np.inf) <= least

    @property
    def has_soils(self) -> bool:
        """Whether there is a soil somewhere."""
        return bool(self.soils)

    def saturation(self, x: Array, u: Array, cells: Entities | slice = slice(None)) -> Array:
        """The saturation for u in points, each in an owned cell; 1 where there is no soil."""
        saturation, head = np.ones(len(u)), self.head(x, u)
        for inside, soil in self.soils:
            rows = inside[cells]
            saturation[rows] = soil.saturation(x[rows], head[rows])
        return saturation

    def head(self, x: Array, u: Array) -> Array:
        """The head in points with these u, where there are soils."""
        return u if self.form == FORMS[0] else u + x[..., -1]

    def along(self, traces: Array, step: Array) -> Array:
        """Slopes in the place of the derivatives: what κ changes along a step of û, divided by that."""
        (value, slope), (moved, _) = self._at(traces), self._at(traces + step)
        far = np.abs(step) > CLOSE * np.abs(traces + self.constant)
        shares = self._shares(traces, value)
        return shares * np.where(far, (moved - value) / np.where(far, step, 1.0), slope)[:, None]

    def _at(self, traces: Array) -> tuple[Array, Array]:
        """κ and its derivative where û is looked at."""
        (value, slope), power = self._of_u(traces + self.constant), self.power
        if power < 1:
            with np.errstate(all="ignore"):  # a κ of no use is refused
                moved = self._first ** (1 - power) * value**power
                value, slope = moved, power * moved / value * slope
        return value, slope

    def _of_u(self, u: Array) -> tuple[Array, Array]:
        """κ and its derivative by u there."""
        x, _ = self._places
        value, slope = np.ones(x.shape[:2]), np.zeros(x.shape[:2])
        for inside, curve in self.parts:
            known = self.head(x[inside], u[inside]) if isinstance(curve, Soil) else u[inside]
            value[inside], slope[inside] = curve(x[inside], known)
        return value, slope

    @cached_property
    def _middle(self) -> Array:
        u = sum(self.ends) / 2 if np.isfinite(self.ends).all() else 0.0
        return self._of_u(np.full(self._places[0].shape[:2], u))[0]

    @property
    def at_rest(self) -> Array:
        """κ for u in the middle of its ends: of soil without flow."""
        return np.asarray(self._middle @ self._places[1].T)

    @cached_property
    def _first(self) -> Array:
        value = self._middle.copy()
        for inside, soil in self.soils:
            value[inside] = soil.K
        return value

    @property
    def first(self) -> Array:
        """κ to begin with: of saturated soil, elsewhere that for u in the middle of its ends."""
        return np.asarray(self._first @ self._places[1].T)


def _upstream(gradients: Array, heads: Array, kappa: Array, slope: Array) -> Array:
    """The shares of facets in the κ of cells, so that what enters a cell does not grow where its outflow gets wetter.

    σ = κ∇h would do so if κ were the mean and grew faster with h downstream than ∇h falls: next to saturation, where
    gravity moves the water. Then κ goes up and down from facet to facet. So the mean of all facets has a share of at
    most d + 1 by d of κ_m F/(κ' |∇h|²) with the mean κ_m, the flux F = Σ (∇φ_i·∇h)_+ and the mean slope κ' downstream;
    the facets through which water enters, as much as does, have the rest. In 1D that is 2 by the Péclet number of the
    cell, and the derivative of its flux by what is downstream vanishes.

    Args:
        gradients: ∇φ_i, shape (cells, n, dim).
        heads: The head on the facets, shape (cells, n).
        kappa: κ there.
        slope: Its derivative by the head.
    """
    n, driving = kappa.shape[1], np.einsum("cn,cnd->cd", heads, gradients)
    flow = np.einsum("cnd,cd->cn", gradients, driving)
    enters, leaves = np.maximum(flow, 0.0), np.maximum(-flow, 0.0)
    whole = enters.sum(axis=1)
    unit = np.where(whole > 0, whole, 1.0)
    steep = (leaves * slope).sum(axis=1) / unit * (driving**2).sum(axis=1)
    mean = n / (n - 1) * kappa.mean(axis=1) * whole
    mean = np.where(steep > mean, mean / np.where(steep > 0, steep, 1.0), 1.0)[:, None]
    return np.asarray(mean / n + (1 - mean) * enters / unit[:, None])


def depends_on_u(kappa: Any) -> bool:
    """Whether κ, or κ in one region, is a function of u as well."""
    if isinstance(kappa, Mapping):
        return any(depends_on_u(each) for each in kappa.values())
    if isinstance(kappa, tuple | list):
        return any(map(depends_on_u, kappa))
    return _takes_u(kappa) or (isinstance(kappa, TREES) and depends_on(kappa, "u"))


def has_soils(kappa: Any, *, everywhere: bool = False) -> bool:
    """Whether κ is that of a soil somewhere, or everywhere."""
    are_soils = [isinstance(each, Soil) for each in (kappa.values() if isinstance(kappa, Mapping) else [kappa])]
    return all(are_soils) if everywhere else any(are_soils)


def _takes_u(given: object) -> bool:
    """Whether it is a function of x and u."""
    if isinstance(given, Soil):
        return True
    if not inspect.isfunction(given):
        return False
    return len(inspect.signature(given).parameters) == 2


def quasilinear_of(spaces: Spaces, kappa: Any, form: str = FORMS[0]) -> Quasilinear:
    """κ(x, u) of a problem (collective).

    Raises:
        InputError: If κ is a matrix that depends on u, or has not one value on each cell.
    """
    of_regions = kappa if isinstance(kappa, Mapping) else {"": kappa}
    fixed = {name: 1.0 if depends_on_u(each) else each for name, each in of_regions.items()}
    try:
        held = conductivity_of(spaces, fixed if isinstance(kappa, Mapping) else fixed[""])
    except InputError as error:
        if not has_soils(kappa):
            raise
        told = str(error).replace("[problem] kappa", "[soil]")
        raise InputError(f"{told}; [soil.{EVERYWHERE}] is the soil everywhere") from None
    parts: list[tuple[Mask, Curve]] = []
    for name, each in of_regions.items():
        if isinstance(each, list | tuple) or held.shape:
            raise InputError("[problem] kappa: a matrix that depends on u is not supported; give a scalar")
        inside = np.zeros(len(spaces.cell_measures), dtype=bool)
        inside[spaces.domain.regions[name] if name else slice(None)] = True
        parts.append((inside, _curve(each, spaces.mesh.geometry.dim)))
    given = zip(parts, of_regions.values(), strict=True)
    controls = [(inside, each) for (inside, _), each in given if isinstance(each, Soil) and each.constants]
    return Quasilinear(spaces, parts, form=form, controls=controls)


def _curve(given: Any, dim: int) -> Curve:
    if isinstance(given, Soil):
        return given.plain
    if isinstance(given, TREES):
        return _OfTree(given, dim)
    if _takes_u(given):
        return _OfFunction(given)
    raise InputError("[problem] kappa: beside a κ that depends on u the others are numbers, texts or soils")


@dataclass(frozen=True)
class _OfTree:
    """κ as a text in x, y, z and u."""

    tree: Tree
    dim: int

    def least(self, ends: list[Array]) -> Array:
        """Lower bounds for x, y, z and u between two ends each."""
        *box, (low, high) = ends
        names, steps = "xyz"[: self.dim], np.linspace(0, 1, RANGES + 1)[:, None]
        of_u = low + steps * (high - low)
        of_u[-1] = high
        in_box = {name: Interval(*of) for name, of in zip(names, box, strict=True)}
        with np.errstate(all="ignore"):
            parts = [interval(self.tree, in_box | {"u": Interval(*of_u[k : k + 2])}).lo for k in range(RANGES)]
        return np.asarray(np.min([np.broadcast_to(part, low.shape) for part in parts], axis=0))

    def __call__(self, x: Array, u: Array) -> tuple[Array, Array]:
        """See `Curve`."""
        at = np.concatenate([x, u[..., None]], axis=-1)
        value, gradient = values_and_gradient(self.tree, at, "xyz"[: self.dim] + "u")
        return value, gradient[..., -1]


@dataclass(frozen=True)
class _OfFunction:
    """κ as a function of points of shape (3, n) and u there, in Python."""

    given: Callable[[Array, Array], Any]

    def __call__(self, x: Array, u: Array) -> tuple[Array, Array]:
        """See `Curve`; the derivative by central differences."""
        points, at = np.zeros((3, u.size)), u.ravel()
        points[: x.shape[-1]] = x.reshape(-1, x.shape[-1]).T
        step = NUDGE * np.maximum(np.abs(at), 1.0)
        of_u = [self._values(points, at + each) for each in (0 * step, step, -step)]
        return of_u[0].reshape(u.shape), ((of_u[1] - of_u[2]) / (2 * step)).reshape(u.shape)

    def _values(self, points: Array, u: Array) -> Array:
        found = np.asarray(self.given(points, u), dtype=np.float64)
        if found.shape not in ((), u.shape):
            raise InputError(
                f"[problem] kappa: the function of x and u must give a number for each point, not {found.shape}"
            )
        return np.broadcast_to(found, u.shape)
