"""Problems on either side of that of a solution, with data that differ by ±τ, and what they say, see `bracket`."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.tolerances import ROUNDING
from signorini_fenicsx.expressions.given import Given, combined, parsed
from signorini_fenicsx.meshes.domain import Domain, other_side
from signorini_fenicsx.quantities.bracket import UNBOUNDED, Ends, Half, Quantity, bracket, power_of_two
from signorini_fenicsx.quantities.kinds import Integral, Mean
from signorini_fenicsx.quantities.weighted import SHARPLY, Weighted
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Solver

FAILED = "a problem beside it"
"""What the reason begins with if such a problem has no solution."""
OF_SUMS = 1e-12
"""Rounding of a quantity, as a share of its size: a quantity that is known has an interval that is not shorter."""
NEVER = 2.0**40
"""The scale of τ if the solution does not change with it: the quantity is known, and its length is rounding."""
NEAR = 1e-6
"""The first τ moves u by this share at least of how far ψ, gaps and u_D are from 0: less may be rounding where u is."""
SHARE = 0.02
"""What may be wrong of integrals is aimed at to be this share of what is known besides."""


class Beside[Fields](ABC):
    """The problems beside that of a solution, for one quantity.

    `Fields` are the admissible v and y of one of these problems.

    Attributes:
        solution: The solution.
        kind: The quantity.
        of_flux: Whether it is one of y; otherwise it is one of v.
        tau: The τ whose bounds are looked for.
    """

    of_flux: ClassVar[bool]

    def __init__(self, solution: Any, kind: Any):
        self.solution, self.spaces = solution, solution.spaces
        self.kind = kind
        self.domain: Domain = solution.spaces.domain
        self.comm = self.spaces.mesh.comm
        self.tau = 1.0
        self._solver: Solver | None = None
        self._options = Options(element=solution.options.element, tuning=solution.options.tuning)

    def interval(self, near: Quantity | None = None) -> Quantity:
        """The interval (collective).

        Args:
            near: That of the step or the mesh before, with a τ near the best one. In a step on whose sets the last one
                has ended no other is tried.
        """
        size, response = self.size(), self.response()
        if near is not None and near.tau * size > 0:
            stays, tau = self.solution.step is not None and len(self.solution.outcome.history) == 1, near.tau * size
            rounded = power_of_two(tau) if stays else tau  # with which data, and what is kept of them, are the same
            quantity = self._found(rounded, size, response, before=near.width, alone=stays)
            return replace(quantity, tau=near.tau) if math.isclose(quantity.tau * size, rounded) else quantity
        moves = response * self.softness() * self.spaces.length ** (1 - self.domain.mesh.topology.dim / 2)
        first = max(size / response, NEAR * self.distance() / moves) if response > 0 else 0.0
        return self._found(power_of_two(first) if 0 < first < math.inf else 1.0, size, response)

    def _found(self, first: float, size: float, response: float, **how: Any) -> Quantity:
        """The interval from a first τ, see `bracket` (collective)."""
        quantity = bracket(lambda tau: self.ends(tau, size, response), first, self.discrete(), **how)
        quantity = replace(quantity, tau=quantity.tau / size if size > 0 else 0.0)
        self._solver = None
        PETSc.garbage_cleanup(self.comm)  # of the solver; when the mesh is freed, it is too late
        if not math.isfinite(quantity.width) and self.of_flux and not quantity.reason.startswith(FAILED):
            quantity = replace(quantity, reason=f"{UNBOUNDED}: {quantity.reason}")
        return quantity

    def ends(self, tau: float, size: float, response: float) -> Ends:
        """The bounds from one τ, with what `size` and `response` give (collective)."""
        self.tau = tau
        try:
            with np.errstate(all="ignore"):  # of data that are unbounded the bounds tell
                below, above = self.fields(-tau), self.fields(tau)
                apart, bounds = self.apart(below, above) / (2 * tau), []
                of_data = ROUNDING * tau * response if apart > 0 else 0.0  # which may be much larger than σ
                rounding = response * (OF_SUMS * size + of_data)
                for sign in (-1.0, 1.0):
                    of_v, of_y = (above, below) if (sign < 0) is not self.of_flux else (below, above)
                    half = self.half(of_v, of_y)
                    radius = half.value / tau + half.unseen + rounding
                    value, missed = self.value(of_v, of_y, SHARE * radius)
                    bounds.append((value + sign * (radius + missed), half.reason))
        except (NumericalFailure, InputError) as failure:
            return Ends(-math.inf, math.inf, 0.0, f"{FAILED}: {failure}")
        PETSc.garbage_cleanup(self.comm)
        (lower, why), (upper, why_not) = bounds
        return Ends(
            lower, upper, size / apart if apart > 0 else NEVER, why or why_not, lambda: self._shares(below, above, tau)
        )

    def _shares(self, below: Fields, above: Fields, tau: float) -> Array:
        """What each owned cell adds to the length of the interval: the gaps of both problems (collective)."""
        with np.errstate(all="ignore"):
            shares: Array = (self.half(below, below).of_cells + self.half(above, above).of_cells) / tau
        return shares

    def solved(self, tau: float) -> Any:
        """The solution of the problem with data that differ by τ (collective).

        Raises:
            InputError: If it is no problem.
            NumericalFailure: If it is not solved.
        """
        posed = self.posed(tau)
        if self._solver is None:
            self._solver = Solver.of(self.solution, posed)
        return self._solver.solve(posed, self._options, start=self.start(posed), memory=self.memory(tau))

    @abstractmethod
    def posed(self, tau: float) -> Any:
        """The problem with data that differ by τ (collective)."""

    @abstractmethod
    def memory(self, tau: float) -> Any:
        """The memory of the problem beside, see `Solver.solve`."""

    @abstractmethod
    def start(self, posed: Any) -> Any:
        """The start of the solve of the problem beside."""

    def fields(self, tau: float) -> Fields:
        """The admissible fields of the problem with data that differ by τ (collective)."""
        return self.admissible(self.solved(tau))

    @abstractmethod
    def admissible(self, solution: Any) -> Fields:
        """The admissible fields of a solution (collective)."""

    @abstractmethod
    def half(self, of_v: Fields, of_y: Fields) -> Half:
        """The right side of the theorem (collective)."""

    @abstractmethod
    def value(self, of_v: Fields, of_y: Fields, enough: float) -> Array:
        """The quantity of v, or of y, and by how much it may be wrong; `enough` as in `products` (collective)."""

    @abstractmethod
    def discrete(self) -> float:
        """The quantity of the discrete solution (collective)."""

    @abstractmethod
    def apart(self, one: Fields, other: Fields) -> float:
        """The energy norm of the difference of both fluxes (collective)."""

    @abstractmethod
    def size(self) -> float:
        """‖σ_h‖ (collective)."""

    @abstractmethod
    def distance(self) -> float:
        """The largest of what u is compared with: u_D, ψ, gaps (collective)."""

    @abstractmethod
    def response(self) -> float:
        """The size of the flux that belongs to τ = 1, about (collective)."""

    @abstractmethod
    def softness(self) -> float:
        """The root of κ⁻¹ or of 𝔸, about (collective)."""


class IntegralsBeside[Fields](Beside[Fields]):
    """The problems beside that of a solution for the integral of u with a weight, or its mean.

    Attributes:
        over: The weight, and over what it is an integral.
        weight: The weight.
    """

    of_flux = False
    kind: Integral

    def __init__(self, solution: Any, kind: Integral):
        super().__init__(solution, kind)
        self.over = Weighted.of(self.domain, kind)
        self.weight = self.over.weight

    def interval(self, near: Quantity | None = None) -> Quantity:
        """The interval (collective)."""
        quantity = super().interval(near)
        if not isinstance(self.kind, Mean):
            return quantity
        integral, most = abs(self.over.sizes[0]), max(abs(quantity.lower), abs(quantity.upper))
        enough = SHARE * quantity.width / most * integral if 0 < most < math.inf else math.inf
        if self.solution.step is None or self.weight.pieces is None:
            return quantity.divided(*self.over.total(enough))
        of = tuple(tree for tree, _ in self.weight.pieces), (*self.kind.region, "on", *self.kind.parts)
        kept, enough = self.spaces.kept_results, SHARPLY * integral
        return quantity.divided(*kept.get(self.comm, "weight", of, (), lambda: self.over.total(enough)))

    def value(self, of_v: Fields, of_y: Fields, enough: float) -> Array:
        """The integral of v (collective)."""
        return np.asarray(self.comm.allreduce(self.integral(of_v, enough)))

    def response(self) -> float:
        """The size of the flux under the weight as a load (collective)."""
        length, direction = self.spaces.length, self.kind.direction
        square = self.over.sizes[1] * (length if self.kind.parts else 1.0)
        size = 1.0 if direction is None else math.hypot(*direction)
        return math.sqrt(square) * size * length * self.softness() / 4

    def of_sums(self, sums: Array) -> float:
        """The integral, for a mean over that of the weight, from both on this rank (collective)."""
        integral, of_weight = self.comm.allreduce(sums).tolist()
        return integral / of_weight if isinstance(self.kind, Mean) and of_weight != 0 else integral

    @abstractmethod
    def integral(self, of: Fields, enough: float) -> Array:
        """The integral of v with the weight, and by how much it may be wrong, on this rank (collective)."""


def added(domain: Domain, one: Given, other: Given, factor: float) -> Given:
    """The sum of a datum and a multiple of another one.

    Raises:
        InputError: If one of them is a function of points.
    """
    names = "xyz"[: domain.mesh.geometry.dim]
    one, other = (parsed(given, names, "weight") for given in (one, other))
    return combined(one, other, factor, "data of a problem with quantities")


def in_regions(
    domain: Domain, f: Given | Mapping[str, Given], weight: Given, region: Sequence[str], factor: float
) -> Given | Mapping[str, Given]:
    """A load that is larger by a multiple of a weight in some regions, none for all of Ω.

    Raises:
        InputError: If a region is unknown.
    """
    regions = domain.regions
    for name in region:
        if name not in regions:
            there_are = f"its regions are {', '.join(regions)}" if regions else "it has none"
            raise InputError(f"unknown region '{name}' of the mesh; {there_are}")
    if not region and not isinstance(f, Mapping):
        return added(domain, f, weight, factor)
    of_region = {name: f[name] if isinstance(f, Mapping) else f for name in regions}
    return {
        name: added(domain, own, weight, factor) if not region or name in region else own
        for name, own in of_region.items()
    }


def check_part(domain: Domain, boundary: Any, part: str, other: str = "for which n has the other direction") -> None:
    """Refuse what is no part, and the other side of one inside the domain, with what is different on the named one.

    Raises:
        InputError: If it is.
    """
    if part not in domain.facets:
        raise InputError(f"unknown part '{part}'; there are {', '.join(domain.facets)}")
    across = {other_side(named): named for named in boundary.inner}
    if part in across:
        raise InputError(f"the part '{part}' has no law; take '{across[part]}', {other}")
