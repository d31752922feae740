"""Conditions on elastic bodies where they meet something: contact, friction, pairs of surfaces."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import NoneType
from typing import TypeGuard

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, check_kind
from signorini_fenicsx.contact.law import Graph, Law, OnParts, Values
from signorini_fenicsx.contact.laws import LAWS, Dirichlet, Friction, Neumann
from signorini_fenicsx.discrete.pairs import Pair, Tied
from signorini_fenicsx.expressions.given import Given


@dataclass(frozen=True)
class CoulombLaw(Law):
    """Friction by Coulomb's law, |σ_t| ≤ g − μ σ_nn.

    Attributes:
        parts: Names of parts of Γ_C.
        mu: μ ≥ 0.
        g: What holds without pressure, g ≥ 0.
    """

    mu: Given
    g: Given = 0.0
    places = ("parts",)
    word = "coulomb"


@dataclass(frozen=True)
class Pressed(Law):
    """Springs across a joint that do not pull: the pressure is so many times what the gap is overcome.

    Attributes:
        parts: Names of parts of Γ_C.
        normal: The stiffness per area, ≥ 0.
    """

    normal: Given
    segments = ("pressed", "open")
    places = ("parts",)
    word = "pressed"

    def graph(self, values: Values) -> Graph:
        """The corner is the reference."""
        corner = np.zeros_like(values["normal"]), np.zeros_like(values["normal"])
        return Graph(corner, [corner], before=values["normal"])

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """Tell where the stiffness is negative."""
        yield "normal must not be negative", -values["normal"]


LAWS_OF_BODIES: Mapping[str, type[Law]] = {**LAWS, CoulombLaw.word: CoulombLaw, Pressed.word: Pressed}
"""The laws of bodies by their names."""


@dataclass(frozen=True)
class Closed(Law):
    """u_n is given: a vertical line, whatever the pressure is.

    Attributes:
        parts: Names of parts of Γ_C.
    """

    segments = ("closed",)
    places = ("parts",)

    def graph(self, values: Values) -> Graph:
        """A vertical line."""
        return Graph((0.0, 0.0), [(0.0, 0.0)], np.inf, np.inf)


@dataclass(frozen=True)
class Tresca:
    """Friction by Tresca's law, |σ_t| ≤ g.

    Attributes:
        g: g ≥ 0, as in `Contact("bottom", friction=Tresca(0.1))`.
    """

    g: Given

    def law(self, parts: Sequence[str]) -> Law:
        """The law on some parts."""
        return Friction(parts, self.g)


@dataclass(frozen=True)
class Coulomb:
    """Friction by Coulomb's law, |σ_t| ≤ g − μ σ_nn.

    Attributes:
        mu: μ ≥ 0, as in `Contact("fault", friction=Coulomb(0.6, g=1e5))`.
        g: What adhesion holds without pressure, g ≥ 0.
    """

    mu: Given
    g: Given = 0.0

    def law(self, parts: Sequence[str]) -> Law:
        """The law on some parts."""
        return CoulombLaw(parts, self.mu, self.g)


@dataclass(frozen=True)
class JointSprings(OnParts):
    """A joint that gives way: springs across it that do not pull, and springs along it, which slip.

    The pressure is `normal` times how far the gap is overcome. |σ_t| is at most the bound of the friction, and
    σ_t = −shear (u_t − w) with what has slipped, w; w grows against σ_t where |σ_t| is at its bound.

    Usage: `JointSprings("joint", normal=20, shear=8, friction=Coulomb(0.4))`, and without parts as the law of a `Pair`.

    Attributes:
        parts: Name of a part, or a list of names.
        normal: Stiffness per area across the joint.
        shear: Stiffness per area along it, positive.
        friction: `Tresca` or `Coulomb`.
        gap: The distance to the foundation along the outer normal.
    """

    normal: Given
    shear: Given
    friction: Tresca | Coulomb
    gap: Given = 0.0

    def __post_init__(self) -> None:
        """Refuse another friction."""
        super().__post_init__()
        check_kind("friction", self.friction, Tresca, Coulomb)

    @property
    def laws(self) -> list[Law]:
        """The law across the joint, and that along it but for the springs."""
        return [Pressed(self.parts, self.normal), self.friction.law(self.parts)]


@dataclass(frozen=True)
class Contact(OnParts):
    """Contact with a rigid foundation: u_n ≤ gap, σ_nn ≤ 0, one of them equal.

    Attributes:
        parts: Name of a part, or a list of names, as in `Contact("bottom", gap="0.1*x^2")`.
        gap: The distance to the foundation along the outer normal.
        surface: A file with a mesh of the surface of the foundation, such as STL, in the plane of a line. The gap is
            then the distance to it along the normal, and `gap` more.
        friction: `Tresca` or `Coulomb`; None for σ_t = 0.
        force: For a rigid tool that moves: what acts on it along each axis along which it can, such as {"y": -1}. The
            gap is that before it moves, and the part is one. Along other axes it is held.
        moment: For each axis about which it turns the moment about the middle of the part, in the plane {"z": 0}.
        behind: Whether the foundation is on the other side, like a hook that holds: u_n ≥ −gap, σ_nn ≥ 0.

    Raises:
        InputError: If the friction is something else, or several parts have one tool.
    """

    gap: Given = 0.0
    surface: str | Path | None = None
    friction: Tresca | Coulomb | None = None
    force: Mapping[str, Given] = field(default_factory=dict)
    moment: Mapping[str, Given] = field(default_factory=dict)
    behind: bool = False

    def __post_init__(self) -> None:
        """Refuse another friction, and a tool on several parts."""
        super().__post_init__()
        check_kind("friction", self.friction, Tresca, Coulomb, NoneType)
        check_kind("surface", self.surface, str, Path, NoneType)
        for name, given in (("force", self.force), ("moment", self.moment)):
            check_kind(name, given, Mapping, hint='; an example is {"y": -1}')
        if (self.force or self.moment) and len(self.parts) != 1:
            raise InputError("force: a tool is on one part; give each part a condition of its own")
        if self.behind and (self.surface or self.force or self.moment):
            raise InputError("behind: a foundation on the other side is no tool, and has no surface")


def on_slave(pair: Pair) -> Contact | JointSprings | Law | None:
    """The condition on the slave as if there were a foundation, without the distance; None if it is tied.

    Raises:
        InputError: If its law is none for bodies.
    """
    check_kind("law", pair.law, Tresca, Coulomb, JointSprings, Tied, Law, NoneType)
    if isinstance(pair.law, Tied):
        return None
    if isinstance(pair.law, JointSprings):
        return replace(pair.law, parts=pair.slave, gap=pair.added[1])
    if not isinstance(pair.law, Law):
        return Contact(pair.slave, gap=pair.added[1], friction=pair.law)
    if not is_normal(pair.law):
        raise InputError("pair: law must be one between opening and pressure without parts, as Wall((), beta=5)")
    return replace(pair.law, parts=pair.slave)


def is_normal(law: object) -> TypeGuard[Law]:
    """Whether a law is one between opening and pressure."""
    return isinstance(law, Law) and not isinstance(law, Friction | CoulombLaw | Dirichlet | Neumann)
