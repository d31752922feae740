"""Problems with jumps and kinks in loads and weights whose quantities are known, for `random_quantities.py --exact`.

u depends on x alone: −(κu')' = f on the unit square, u given on the right, and on the left u given, a flux, or an
obstacle; elastic bars without Poisson's effect in the same way. Between known places f, κ and weights are analytic.
There they are polynomials of Chebyshev, by which integrals are exact but for rounding. The force on all that holds a
body is known by balance, whatever its loads are.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import Chebyshev

from signorini_fenicsx import Contact, Diffusion, Dirichlet, Elasticity, Neumann, Signorini
from signorini_fenicsx.expressions import read, values
from signorini_fenicsx.quantities import Energy, Flux, Force, Integral, Kind, Mean, Moment

DEGREE = 64
"""Of the polynomials between two places."""

type Function = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Text:
    """A text in one coordinate, and the places where it jumps or has a kink."""

    text: str
    places: tuple[float, ...] = ()

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Values where this coordinate is x."""
        return values(read(self.text, "xy"), np.stack([x, x], axis=-1)) * np.ones_like(x)


@dataclass(frozen=True)
class Antiderivative:
    """That of a function which is analytic between places, 0 at 0."""

    ends: np.ndarray
    pieces: list[Chebyshev]

    @classmethod
    def of(cls, function: Function, places: tuple[float, ...]) -> "Antiderivative":
        """The antiderivative."""
        ends, pieces, total = np.unique([0.0, *places, 1.0]), [], 0.0
        for a, b in pairwise(ends):
            pieces.append(Chebyshev.interpolate(function, DEGREE, domain=[a, b]).integ(lbnd=a) + total)
            total = float(pieces[-1](b))
        return cls(ends, pieces)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Values."""
        which = np.clip(np.searchsorted(self.ends, x) - 1, 0, len(self.pieces) - 1)
        return np.select([which == i for i in range(len(self.pieces))], [piece(x) for piece in self.pieces])


def total(function: Function, places: tuple[float, ...]) -> float:
    """The integral over [0, 1]."""
    return float(Antiderivative.of(function, places)(np.ones(1))[0])


def draw(rng: np.random.Generator, size: float = 1.0, name: str = "x") -> Text:
    """A random text, with jumps or kinks or smooth."""
    a, b, c = np.round(rng.uniform(-size, size, 3), 3).tolist()
    s, t = np.round(np.sort(rng.uniform(0.05, 0.95, 2)), 3).tolist()
    texts = [
        Text(f"{a} if {name} < {t} else {b}", (t,)),
        Text(f"{a}*abs({name} - {t}) + {b}", (t,)),
        Text(f"{a}*max(0, {name} - {s}) + {b}*min({name}, {t})", (s, t)),
        Text(f"{a} if {s} < {name} and {name} < {t} else {b}*{name}", (s, t)),
        Text(f"{a} + {b}*{name} + {c}*{name}^2"),
        Text(f"{a}*sin(5*{name}) + {b}*exp({name})"),
        Text(f"{a}*sqrt(abs({name} - {t}) + 0.05)", (t,)),
        Text(f"{a}*sin(25*{name})"),
    ]
    return texts[rng.integers(len(texts))]


@dataclass(frozen=True)
class Line:
    """U and κu' = s − F on [0, 1], with F = ∫f, u = u(0) + s∫1/κ − ∫F/κ.

    Attributes:
        f: The load.
        kappa: κ.
        s: κu' at 0.
        start: u at 0.
    """

    f: Text
    kappa: Text
    s: float
    start: float

    @classmethod
    def of(cls, f: Text, kappa: Text, right: float, start: float | None, flux: float = 0.0) -> "Line":
        """It with these values of u at the right end and at the left one, or with κu' there."""
        line = cls(f, kappa, 0.0, 0.0)
        resistance, lag = (float(each(np.ones(1))[0]) for each in line.parts())
        if start is not None:
            return cls(f, kappa, (right - start + lag) / resistance, start)
        return cls(f, kappa, flux, right - flux * resistance + lag)

    @property
    def places(self) -> tuple[float, ...]:
        """Where it is not analytic."""
        return (*self.f.places, *self.kappa.places)

    def parts(self) -> tuple[Antiderivative, Antiderivative]:
        """∫1/κ and ∫F/κ."""
        of_f = Antiderivative.of(self.f, self.f.places)
        return (
            Antiderivative.of(lambda x: 1 / self.kappa(x), self.places),
            Antiderivative.of(lambda x: of_f(x) / self.kappa(x), self.places),
        )

    @property
    def end(self) -> float:
        """κu' at 1."""
        return self.s - total(self.f, self.f.places)

    def u(self) -> Function:
        """U."""
        resistance, lag = self.parts()
        return lambda x: self.start + self.s * resistance(x) - lag(x)

    def times(self, weight: Function, places: tuple[float, ...]) -> float:
        """∫ weight·u."""
        u = self.u()
        return total(lambda x: weight(x) * u(x), (*self.places, *places))

    def energy(self) -> float:
        """½∫κu'² − ∫fu."""
        of_f = Antiderivative.of(self.f, self.f.places)
        return total(lambda x: (self.s - of_f(x)) ** 2 / self.kappa(x) / 2, self.places) - self.times(
            self.f, self.f.places
        )


@dataclass(frozen=True)
class Known:
    """A problem on the unit square whose quantities are known.

    Attributes:
        problem: The problem.
        kinds: Quantities with their values.
    """

    problem: Diffusion | Elasticity
    kinds: list[tuple[Kind, float]]


def integrals(rng: np.random.Generator, line: Line, **along: list[float]) -> list[tuple[Kind, float]]:
    """Integrals of u, with their values."""
    w, s, t = draw(rng), round(float(rng.uniform(0.1, 0.9)), 3), round(float(rng.uniform(-1.5, 1.5)), 3)
    ends = tuple(x for x in (-s / t, (1 - s) / t) if 0 < x < 1)
    kinds: list[tuple[Kind, float]] = [
        (Integral(weight=w.text, **along), line.times(w, w.places)),
        (
            Integral(weight=f"1 if y < {s} + {t}*x else 0", **along),
            line.times(lambda x: np.clip(s + t * x, 0, 1), (*ends,)),
        ),
        (Integral(weight=w.text, parts="top", **along), line.times(w, w.places)),
    ]
    whole = total(w, w.places)
    if abs(whole) > 0.05:
        kinds.append((Mean(weight=w.text, **along), line.times(w, w.places) / whole))
    return kinds


def membrane(rng: np.random.Generator) -> Known:
    """A random scalar problem."""
    f, on_side, t = draw(rng, 8), draw(rng, name="y"), round(float(rng.uniform(0.1, 0.9)), 3)
    kappa = [Text("1"), Text("1 + x^2"), Text(f"1 + {t}*abs(x - {t})", (t,))][rng.integers(3)]
    right, apart = (float(x) for x in np.round(rng.uniform(-1, 1, 2), 3))
    right += float(rng.choice([0, 0, 100, -1000]))
    held, level = str(rng.choice(["given", "flux", "obstacle"])), right + apart
    line = Line.of(f, kappa, right, level if held == "given" else None, -apart if held == "flux" else 0.0)
    if held == "obstacle" and line.start < level:
        line = Line.of(f, kappa, right, level)
    condition = {"given": Dirichlet, "flux": Neumann, "obstacle": Signorini}[held]
    conditions = [
        condition("left", apart if held == "flux" else level),
        Dirichlet("right", right),
        Neumann(["top", "bottom"]),
    ]
    side = total(on_side, on_side.places)
    kinds = [
        *integrals(rng, line),
        (Energy(), line.energy() - (apart * line.start if held == "flux" else 0.0)),
        (Flux("right"), line.end),
        (Flux("right", weight=on_side.text), line.end * side),
    ]
    if held != "given":
        kinds.append((Integral(parts="left", weight=on_side.text), line.start * side))
    if held != "flux":
        kinds += [(Flux("left"), -line.s), (Flux(["left", "right"]), line.end - line.s)]
    return Known(Diffusion(f=f.text, kappa=kappa.text, conditions=conditions), kinds)


def bar(rng: np.random.Generator) -> Known:
    """A random elastic bar, clamped on the left and in contact, or free, on the right."""
    f, on_side, gap = draw(rng), draw(rng, name="y"), round(float(rng.uniform(-0.3, 0.3)), 3)
    scale = float(rng.choice([1, 1, 1000]))
    young = Text("2")
    free = Line.of(f, young, 0.0, None)  # moved such that u(0) = 0
    resistance, lag = (float(each(np.ones(1))[0]) for each in free.parts())
    s = total(f, f.places)
    end = s * resistance - lag
    held = end > gap
    line = Line.of(f, young, gap if held else end, 0.0)
    start = scale if scale > 1 else 0.0
    line = Line(line.f, line.kappa, line.s, start)
    conditions = [Dirichlet("left", [start, 0]), Contact("right", gap=gap + start), Neumann(["top", "bottom"])]
    kinds = [
        *integrals(rng, line, direction=[1, 0]),
        (Energy(), line.energy()),
        (Force("left", [1, 0]), -line.s),
        (Force("right", [1, 0]), line.end),
        (Force(["left", "right"], [1, 0]), line.end - line.s),
        (Moment("left"), line.s / 2),
        (
            Integral(parts="right", weight=on_side.text),
            (start + (gap if held else end)) * total(on_side, on_side.places),
        ),
    ]
    return Known(Elasticity(2.0, 0.0, f=[f.text, 0], conditions=conditions), kinds)


def balanced(rng: np.random.Generator) -> Known:
    """A random body whose force on all that holds it is known."""
    f_x, f_y, g_x, g_y = draw(rng), draw(rng, name="y"), draw(rng), draw(rng)
    f, top = [total(each, each.places) for each in (f_x, f_y)], [total(each, each.places) for each in (g_x, g_y)]
    arm = total(lambda x: x * g_y(x), g_y.places)
    parts = [["left", "bottom"], "left"][touches := int(rng.integers(2))]
    conditions = [Dirichlet("left", [0, "0.01*y"]), Neumann("top", [g_x.text, g_y.text]), Neumann("right")]
    conditions.append(Contact("bottom", gap=0.01) if touches == 0 else Neumann("bottom"))
    kinds: list[tuple[Kind, float]] = [
        (Force(parts, [1, 0]), -f[0] - top[0]),
        (Force(parts, [0, 1]), -f[1] - top[1]),
        (Moment(parts), -(f[1] - f[0]) / 2 - arm + top[0]),
    ]
    return Known(Elasticity(1.0, 0.3, f=[f_x.text, f_y.text], conditions=conditions), kinds)
