"""Soils above the water table: how their conductivity and their water content fall with the pressure head ψ.

With the head h and the height z as the last coordinate, ψ = h − z, κ = K k_r(ψ) and the water in a unit volume is
θ(ψ) + S_s ψ. For ψ ≥ 0 a soil is saturated, k_r = 1 and θ = θ_s; S = (θ − θ_r)/(θ_s − θ_r) is the saturation. Sources:
van Genuchten, Soil Sci. Soc. Am. J. 44, 1980, with Mualem's k_r; Gardner, Soil Science 85, 1958; Brooks and Corey,
1964, with Burdine's k_r. The `air_entry` is that of Vogel, van Genuchten and Cislerova, Adv. Water Resour. 24, 2000.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Any, ClassVar, Self

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError

FORMS = ("head", "pressure")
"""What u may be where there are soils: the head h, or the pressure head ψ, with gravity as a given flux κe_z."""
FLOOR = 1e-12
"""k_r is not smaller, so that the equations keep a solution in dry soil."""
TINY = 1e-14
"""The least α|ψ| at which slopes are taken: at 0 that of van Genuchten's k_r is infinite for n < 2."""

STEEP = 1.3
"""Below this n of van Genuchten k_r falls below 0.7 within α|ψ| = 0.003, if there is no air entry."""
STEEPEST = 1.2
"""Below this n κ of a cell is taken upstream in time: for 1.09 Newton's method finds no solution with the mean."""
BISECTIONS = 30
"""How often a step of Newton's method is halved to find how far it goes."""
FARTHEST = 3.0
"""So many times 1 + α|ψ| of dry soil may fall in a step at least, as far as to `NEAR`."""
NEAR = 1.0
"""α|ψ| from which on k_r alone says how far a step goes towards saturation."""
WETTEST, DRIEST, DECADES = -14.0, 3.0, 50
"""The decades of α|ψ| between which that of drained soil is sought, and how often they are halved."""


@dataclass(frozen=True)
class Soil(ABC):
    """κ and the water content of a soil as functions of the head u. `Diffusion(kappa=soil)` takes it as κ.

    Its numbers may be Constants of DOLFINx, by which derivatives are taken; `plain` has the numbers.

    >>> Gardner(K=2.0, alpha=1.0)(np.array([[0.0, 1.0]]), np.array([0.0]))[0].round(4)
    array([0.7358])

    Attributes:
        K: The saturated conductivity, > 0.
        alpha: α > 0, one over a length.
        n: n > 1 of van Genuchten, λ > 0 of Brooks and Corey; Gardner has none.
        theta_r: The residual water content, ≥ 0.
        theta_s: That of the saturated soil.
        specific_storage: S_s ≥ 0: the water that a unit volume takes up for a rise of the head by 1.
        air_entry: The soil stays saturated down to ψ = −air_entry; 0 is the model as published.

    Raises:
        InputError: If a number is out of its range.
    """

    K: float
    alpha: float
    n: float | None = None
    theta_r: float = 0.0
    theta_s: float = 1.0
    specific_storage: float = 0.0
    air_entry: float = 0.0
    model: ClassVar[str] = ""
    least_n: ClassVar[float | None] = None

    def __post_init__(self) -> None:
        """Refuse numbers out of their ranges."""
        if self.constants:
            self.plain  # noqa: B018 whose numbers are checked
            return
        for each in fields(self):
            value = getattr(self, each.name)
            if each.name == "n" and value is None and self.least_n is None:
                continue
            if isinstance(value, bool) or not isinstance(value, Real) or not np.isfinite(float(value)):
                raise InputError(f"{each.name}: must be a number for a {self.model} soil, not {value!r}")
        for name, least in (("K", 0.0), ("alpha", 0.0), ("n", self.least_n)):
            if least is not None and not getattr(self, name) > least:
                raise InputError(f"{name}: must be above {least:g}, not {getattr(self, name):g}")
        if self.n is not None and self.least_n is None:
            raise InputError(f"n: a {self.model} soil has none")
        for name in ("theta_r", "specific_storage", "air_entry"):
            if getattr(self, name) < 0:
                raise InputError(f"{name}: must not be negative, it is {getattr(self, name):g}")
        if not self.theta_r < self.theta_s <= 1:
            raise InputError(
                f"theta_s: must be above theta_r and at most 1; it is {self.theta_s:g}, theta_r {self.theta_r:g}"
            )

    @property
    def constants(self) -> dict[str, Any]:
        """The Constants of the soil, by the names of the numbers."""
        return {each.name: value for each in fields(self) if hasattr(value := getattr(self, each.name), "value")}

    @property
    def plain(self) -> Self:
        """The soil with the present values of its Constants."""
        return replace(self, **{name: float(constant.value) for name, constant in self.constants.items()})

    @property
    def is_steep(self) -> bool:
        """Whether k_r falls by tenths within a hair of saturation."""
        return False

    @property
    def goes_upstream(self) -> bool:
        """Whether it is so steep that κ of a cell in time has to be taken upstream, as far as gravity asks for it."""
        return self.is_steep and self.n is not None and self.n < STEEPEST

    @abstractmethod
    def curves(self, suction: Array) -> tuple[Array, Array, Array, Array]:
        """k_r, its derivative, S and its derivative by α|ψ| > 0, without an air entry."""

    def _relative(self, psi: Array) -> tuple[Array, Array, Array, Array]:
        """k_r, its derivative by ψ, S and its derivative."""
        entry, suction = self.alpha * self.air_entry, np.maximum(-self.alpha * psi, TINY)
        with np.errstate(all="ignore"):
            found = self.curves(suction)
            at_entry = self.curves(np.array(max(entry, TINY)))
        dry = suction > max(entry, TINY)
        k, dk, s, ds = (
            np.where(dry, each / unit, wet)
            for each, unit, wet in zip(found, np.repeat(at_entry[::2], 2), (1.0, 0.0, 1.0, 0.0), strict=True)
        )
        on_floor = k <= FLOOR
        return np.where(on_floor, FLOOR, k), np.where(on_floor, 0.0, -self.alpha * dk), s, -self.alpha * ds

    def __call__(self, x: Array, u: Array) -> tuple[Array, Array]:
        """κ and its derivative by u, in points whose coordinates are the last axis."""
        k, slope, _, _ = self._relative(u - x[..., -1])
        return self.K * k, self.K * slope

    def slope_below(self, psi: Array) -> Array:
        """The derivative of κ by ψ; of saturated soil that just below saturation, so that it does not jump there."""
        return np.asarray(self.K * self._relative(np.minimum(psi, -self.air_entry - 2 * TINY / self.alpha))[1])

    def content(self, x: Array, u: Array) -> tuple[Array, Array]:
        """The water in a unit volume, θ + S_s ψ, and its derivative by u."""
        psi = u - x[..., -1]
        _, _, s, slope = self._relative(psi)
        span = self.theta_s - self.theta_r
        return self.theta_r + span * s + self.specific_storage * psi, span * slope + self.specific_storage

    def drained(self, rate: Array) -> Array:
        """The pressure head at which soil has given up what gravity takes from it in a step.

        Water that falls by gravity alone flows at K k_r(ψ). Below so much soil as has the height d, which is at this ψ
        as well, it is what that has lost: d (θ_s − θ)/τ. This is one equation for ψ, and θ and k_r grow with ψ.

        Args:
            rate: d/τ of each point, > 0.
        """
        low, high = np.full(rate.shape, WETTEST), np.full(rate.shape, DRIEST)
        given = rate * (self.theta_s - self.theta_r) / self.K
        for _ in range(DECADES):
            middle = (low + high) / 2
            k, _, s, _ = self._relative(-(10**middle) / self.alpha)
            wet = given * (1 - s) < k
            low, high = np.where(wet, middle, low), np.where(wet, high, middle)
        return -(10**high) / self.alpha

    def nearer(self, psi: Array, wanted: Array, lowest: Array) -> Array:
        """Pressure heads on the way from some to those that a linear problem wants.

        k_r and θ have a corner at saturation, and k_r is convex below it. So soil that gets wetter goes as far as k_r
        is as large as the linear problem takes it for, and not beyond saturation; from far below it may be more. Soil
        that is saturated goes to `lowest` at most, as the linear problem does not know what it stores below saturation.
        """
        k, slope, _, _ = self._relative(psi)
        aim, size = k + slope * (wanted - psi), 1 + self.alpha * np.abs(psi)
        found, rises = wanted.copy(), (psi < 0) & (wanted > psi)
        low, high = psi[rises], np.minimum(wanted[rises], 0.0)
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            above = self._relative(middle)[0] > aim[rises]
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        by_size = (1 - np.maximum(size[rises] / FARTHEST, 1 + NEAR)) / self.alpha
        far = np.where(size[rises] > 1 + NEAR, by_size, -np.inf)
        found[rises] = np.minimum(wanted[rises], np.maximum(high, far))
        return np.where(psi >= 0, np.maximum(found, lowest), found)

    def saturation(self, x: Array, u: Array) -> Array:
        """S, from 0 to 1."""
        return self._relative(u - x[..., -1])[2]


class VanGenuchten(Soil):
    """S = (1 + (α|ψ|)ⁿ)^−m with m = 1 − 1/n, k_r = √S (1 − (1 − S^1/m)^m)²."""

    model = "van Genuchten"
    least_n = 1.0

    @property
    def is_steep(self) -> bool:
        """See `Soil.is_steep`."""
        return self.n is not None and self.n < STEEP and self.air_entry == 0

    def curves(self, suction: Array) -> tuple[Array, Array, Array, Array]:
        """See `Soil.curves`; 1 − S^1/m without loss of digits."""
        n = float(self.n or 0.0)
        m, w = 1 - 1 / n, 1 + suction**n
        e = np.exp(-m * np.log1p(suction**-n))
        rest, root = -np.expm1(-m * np.log1p(suction**-n)), w ** (-m / 2)
        slope = -2 * rest * e * m * n / (suction * w) * root
        slope = slope - rest**2 * (m / 2) * root / w * n * suction ** (n - 1)
        return rest**2 * root, slope, w**-m, -m * n * suction ** (n - 1) * w ** (-m - 1)


class Gardner(Soil):
    """S = k_r = e^{αψ}."""

    model = "Gardner"

    def curves(self, suction: Array) -> tuple[Array, Array, Array, Array]:
        """See `Soil.curves`."""
        k = np.exp(-suction)
        return k, -k, k, -k


class BrooksCorey(Soil):
    """S = (α|ψ|)^−λ where α|ψ| > 1, k_r = S^(3 + 2/λ), with λ = n."""

    model = "Brooks-Corey"
    least_n = 0.0

    def curves(self, suction: Array) -> tuple[Array, Array, Array, Array]:
        """See `Soil.curves`."""
        n, dry = float(self.n or 0.0), suction > 1
        k, s = suction ** -(2 + 3 * n), suction**-n
        found = k, -(2 + 3 * n) * k / suction, s, -n * s / suction
        k, slope, s, of_s = (np.where(dry, each, wet) for each, wet in zip(found, (1.0, 0.0, 1.0, 0.0), strict=True))
        return k, slope, s, of_s


SOILS: dict[str, type[Soil]] = {kind.model: kind for kind in (VanGenuchten, Gardner, BrooksCorey)}
"""The models by their names in a case file."""
