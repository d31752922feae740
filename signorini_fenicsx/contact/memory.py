"""Laws with memory: what has happened at a site, its state, changes its law from step to step of a problem in time.

A law of one's own with memory is a small class: it names its state, says its graph in a step from the state at the
beginning of the step, and the state at the end. Here a membrane is fouled by all that flows through it:

>>> from dataclasses import dataclass
>>> @dataclass(frozen=True)
... class Membrane(LawWithMemory):
...     conductance: Given
...     fouling: Given
...     deposit: Given = 0.0
...     segments, state = ("through",), ("deposit",)
...     def graph(self, values):
...         slope = values["conductance"] / (1 + values["fouling"] * values["deposit"])
...         return Graph((0.0, 0.0), [(0.0 * slope, 0.0 * slope)], slope, slope)
...     def after(self, values, u, flux):
...         return {"deposit": values["deposit"] + values["tau"] * abs(flux)}
>>> Membrane("top", conductance=2, fouling=5).data()
{'conductance': 2, 'fouling': 5, 'deposit': 0.0}
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.contact.law import Given, Graph, Law, Values


@dataclass(frozen=True)
class LawWithMemory(Law):
    """A law on parts that depends on a state of each site, in a problem in time.

    `graph` is that of one step. It gets in `values`, besides the data, the state at the beginning of the step under the
    names that `state` lists, the length of the step as "tau", and "flux": κ∇u·n of the last solution. A law that is no
    chain of segments gives one that touches its curve at this flux. Then a step is solved again until its solution
    is on the curve, which is Newton's method.

    Attributes:
        state: The names of the data that are the state: what is given for them is the state at t = 0.
        titles: What pictures call the states, by their names.
        now: What a step knows besides the data, by the names in `values`; empty outside of steps.
    """

    now: Mapping[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)
    state: ClassVar[Sequence[str]] = ()
    titles: ClassVar[Mapping[str, str]] = {}
    places = ("parts",)

    def after(self, values: Values, u: Array, flux: Array) -> Mapping[str, Array]:
        """The state at the end of a step, from `values` as for `graph`, and from u and κ∇u·n then."""
        raise NotImplementedError

    def data(self) -> dict[str, Given]:
        """The data by their names, in a step with what the step knows."""
        return {**super().data(), **self.now}

    def in_step(self, now: Mapping[str, Any]) -> Self:
        """The law of a step that knows this."""
        law = replace(self)
        object.__setattr__(law, "now", now)
        return law


@dataclass(frozen=True)
class Film(LawWithMemory):
    """u = −r h κ∇u·n across a film whose thickness grows: ∂h/∂t = k (−κ∇u·n − j)₊; electropainting, or a deposit.

    n is the outer normal of the domain, so q = −κ∇u·n is the current that leaves it into the film, and u the potential
    on the film when the metal below is at 0. A step is one of implicit Euler, u = r q (h + τk (q − j)₊) with the h
    before: a line up to q = j, vertical on bare metal, then a parabola.

    Attributes:
        parts: Name of a part, or a list of names.
        r: Resistance of the film per thickness, > 0.
        k: What the thickness grows by per charge, ≥ 0.
        j: The current below which nothing is deposited, ≥ 0.
        h: The thickness at t = 0, ≥ 0.
    """

    r: Given
    k: Given
    j: Given = 0.0
    h: Given = 0.0
    segments = ("resting", "growing")
    state = ("h",)
    titles: ClassVar[Mapping[str, str]] = {"h": "thickness $h$ of the film"}
    word = "film"

    def graph(self, values: Values) -> Graph:
        """The line, and the tangent of the parabola at the last current; they meet in the reference."""
        r, k, j, h, tau = (values[name] for name in ("r", "k", "j", "h", "tau"))
        q = np.maximum(-values["flux"], j)
        steep = 2 * q - j  # of q (q − j)
        meeting = np.divide(q**2, steep, out=np.zeros_like(q), where=steep > 0)
        corner = r * h * meeting, -meeting
        with np.errstate(divide="ignore"):
            return Graph(corner, [corner], before=1 / (r * h), beyond=1 / (r * (h + tau * k * steep)))

    def after(self, values: Values, u: Array, flux: Array) -> Mapping[str, Array]:
        """The thickness: it never falls."""
        return {"h": values["h"] + values["tau"] * values["k"] * np.maximum(-flux - values["j"], 0.0)}

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """An r that is not positive, negative k, j and h."""
        yield "r must be positive", np.where(values["r"] > 0, 0.0, 1.0)
        for name in ("k", "j", "h"):
            yield f"{name} must not be negative", -values[name]
