"""A problem of elastic contact as the user gives it, and sorted by the kinds of its boundary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy.typing as npt
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, check_kind, check_names
from signorini_fenicsx.contact.law import Law, OnParts
from signorini_fenicsx.contact.laws import Dirichlet, Friction, Neumann
from signorini_fenicsx.discrete.on_parts import OnBoundary, by_part, check_conditions, check_laws, names_all, one_value
from signorini_fenicsx.discrete.pairs import Pair, Tied
from signorini_fenicsx.expressions.given import Given, GivenMatrix, GivenVectorByRegion
from signorini_fenicsx.meshes.domain import AXES, Domain, other_side
from signorini_fenicsx.meshes.paired_parts import PairedParts, paired_parts, without_law
from signorini_fenicsx.physics.elasticity.conditions import (
    Closed,
    Contact,
    CoulombLaw,
    JointSprings,
    is_normal,
    on_slave,
)

if TYPE_CHECKING:
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

type GivenVector = Sequence[Given] | Expr | Callable[[Array], npt.ArrayLike]
"""A number, text or UFL expression for each component; a UFL vector on the mesh; or a function of points of shape
(3, n) with values of shape (d, n)."""
type GivenVectorByPart = GivenVector | Mapping[str, GivenVector | None]
"""A vector, or one for each part of the boundary."""
type GivenByPart = Mapping[str, Given]
"""A scalar for each part of the boundary."""
type GivenModulus = Given | Sequence[Given] | Mapping[str, Given | Sequence[Given]]
"""A modulus, or three along the axes of the material; or one of these for each region of the mesh."""
type GivenViscosity = Given | Mapping[str, Given]
"""A viscosity, or one for each region of the mesh."""
type GivenStiffness = Given | Sequence[Given] | Sequence[Sequence[Given]]
"""Of springs per area: one in all directions, two along the normal and across it, or a symmetric matrix; numbers."""
type GivenSupports = Mapping[str, GivenStiffness]
"""A stiffness for each of some parts of the boundary."""
type Meeting = Contact | JointSprings | Law
"""What holds where a body meets something."""
type GivenAxes = Sequence[Sequence[Given]] | Mapping[str, Sequence[Sequence[Given]]]
"""Directions of the axes of the material, one in the plane and two in space; or these for each region of the mesh."""

NORMAL, TANGENTIAL = "n", "t"


class PlaneState(StrEnum):
    """What a problem in the plane is a section of."""

    STRAIN = "strain"
    STRESS = "stress"


@dataclass(frozen=True)
class Pressure(OnParts):
    """A pressure is given, the traction σn = −value n.

    Attributes:
        parts: Name of a part, or a list of names, as in `Pressure("inside", "1 - y")`.
        value: The pressure.
    """

    value: Given


@dataclass(frozen=True)
class Support(OnParts):
    """Springs hold the body, the traction σn = −Ku. With a load on the same part it is what acts besides.

    Attributes:
        parts: Name of a part, or a list of names, as in `Support("foot", [10, 5])`.
        stiffness: K per area: a number, [along n, across n], or a symmetric matrix.
    """

    stiffness: GivenStiffness


@dataclass(frozen=True)
class ElasticBody:
    """What a problem of elasticity has wherever its conditions are, see `Elasticity`."""

    young: GivenModulus
    poisson: GivenModulus
    f: GivenVectorByRegion | None = None
    u_D: GivenVectorByPart | None = None
    plane: str = PlaneState.STRAIN
    exact: GivenVector | None = None
    _: KW_ONLY
    shear: GivenModulus | None = None
    axes: GivenAxes | None = None
    eigenstrain: GivenMatrix | None = None
    initial_stress: GivenMatrix | None = None


@dataclass(frozen=True)
class Elasticity(ElasticBody):
    """−∇·σ = f, σ = ℂε(u), with a condition on each part of the boundary; u = u_D where there is none.

    The conditions are `Dirichlet`, also in some components, `Neumann`, `Pressure`, `Support`, `Contact`, and other laws
    between the opening p = −u_n and the pressure −σ_nn without friction, such as `Wall` or `TwoSided`, with p for u and
    −σ_nn for κ∇u·n; where two bodies touch, p = −[u_n]. A part that is fixed in some components may have a `Neumann` or
    a `Pressure` condition for the others, and so may one with a `Support`.

    The law of the material is σ = ℂ(ε(u) − ε₀) + σ₀. It is orthotropic where `young` is [E₁, E₂, E₃] and `poisson`
    [ν₁₂, ν₁₃, ν₂₃]: a stress along the first axis alone gives ε₂ = −ν₁₂ε₁.

    Attributes:
        young: E, or three; or one of these for each region of the mesh.
        poisson: ν likewise.
        shear: [G₁₂, G₁₃, G₂₃] where the material is orthotropic; None or 0 for E/(2 + 2ν).
        axes: Directions of its axes, in the plane [[x, y]] and in space two of them, of any length; None for those of
            the coordinates.
        eigenstrain: ε₀, such as the expansion of heat: a number times the unit matrix of space, or a matrix.
        initial_stress: σ₀ likewise.
        f: Force per volume, or one for each region of the mesh; None for none.
        u_D: Displacement on the parts that no condition names; None for 0.
        plane: Plane "strain" or plane "stress", in two dimensions.
        exact: u itself, where it is known.
        conditions: The conditions, each on its parts.

    Raises:
        InputError: If `conditions` is not a list of them, or a part has two.
    """

    u_D: GivenVector | None = None
    conditions: Sequence[OnParts | Pair] = ()

    def __post_init__(self) -> None:
        """Refuse other conditions, and parts with two."""
        example = '[Contact("bottom", gap=0.1), Dirichlet("left", 0, components="x")]'
        check_kind("conditions", self.conditions, Sequence, hint=f"; an example is {example}")
        object.__setattr__(self, "conditions", tuple(self.conditions))
        loads_held = [condition for condition in self.conditions if self._loads_held(condition)]
        others = [condition for condition in self.conditions if not self._loads_held(condition)]
        if any(isinstance(condition, Friction) for condition in others):
            raise InputError('conditions: friction is part of contact: Contact("bottom", friction=Tresca(0.1))')
        check_conditions(others, Law, Contact, JointSprings, Pair, Pressure, Support, example=example)
        check_conditions(loads_held, Law, Contact, Pressure, example=example)
        for pair in [each for each in others if isinstance(each, Pair)]:
            on_slave(pair)

    def _loads_held(self, condition: object) -> bool:
        """Whether a condition is a load or a law on parts that are fixed in some components, or a load on springs."""
        fixed = set(fixed_in(self.conditions))
        if isinstance(condition, Neumann | Pressure):
            return set(condition.parts) <= fixed | set(by_part(self.conditions, Support))
        return (isinstance(condition, Contact) or is_normal(condition)) and set(condition.parts) <= fixed

    @property
    def solution_type(self) -> type[ElasticSolution]:
        """The class of its solutions."""
        from signorini_fenicsx.physics.elasticity.solution import ElasticSolution  # which knows problems

        return ElasticSolution

    def on(self, domain: Domain) -> ElasticProblem:
        """The problem on a domain, sorted by the kinds of its boundary (collective)."""
        springs, fixed = by_part(self.conditions, Support), fixed_in(self.conditions)
        meeting: list[Meeting] = [
            each for each in self.conditions if isinstance(each, Contact | JointSprings) or is_normal(each)
        ]
        pairs = [condition for condition in self.conditions if isinstance(condition, Pair)]
        gaps = {part: getattr(each, "gap", 0.0) for each in meeting for part in each.parts}
        gaps |= {part: pair.added[1] for pair in pairs if not isinstance(pair.law, Tied) for part in pair.slave}
        inner = [part for each in meeting for part in each.parts if other_side(part) in domain.parts]
        meeting += [law for pair in pairs if (law := on_slave(pair)) is not None]
        beside = without_law([pair.on_boundary for pair in pairs])
        pulled = by_part(self.conditions, Neumann, Pressure) | springs
        boundary = ElasticBoundary(
            contact=[part for each in meeting for part in each.parts],
            neumann=[*(part for part in pulled if part not in fixed), *beside],
            fixed=fixed,
            inner=inner,
            pairs=[pair.on_boundary for pair in pairs],
            turned=[part for each in meeting if getattr(each, "behind", False) for part in each.parts],
        )
        same = {each.name: getattr(self, each.name) for each in fields(ElasticBody)}
        given = given_on_parts(domain, self)
        return ElasticProblem(
            **same | given | {"u_D": one_value(given["u_D"], None)},
            boundary=boundary,
            support={part: each.stiffness for part, each in springs.items()},
            gap=one_value(gaps, 0.0),
            **of_meeting(meeting),
        )


def fixed_in(conditions: Sequence[Any]) -> dict[str, str]:
    """The parts on which some components are given, and which."""
    held = by_part(conditions, Dirichlet)
    return {part: each.components for part, each in held.items() if each.components is not None}


def given_on_parts(domain: Domain, problem: Any) -> dict[str, Any]:
    """What is given on parts by the conditions of a problem: `u_D`, `g_N` and `pressure` (collective)."""
    held, pulled, pressed = (by_part(problem.conditions, kind) for kind in (Dirichlet, Neumann, Pressure))
    elsewhere = {} if names_all(domain, problem.conditions) else {"": problem.u_D}
    return {
        "u_D": {part: nothing_for_0(each.value) for part, each in held.items()} | elsewhere,
        "g_N": {part: nothing_for_0(each.value) for part, each in pulled.items()},
        "pressure": {part: each.value for part, each in pressed.items()},
    }


def of_meeting(meeting: Sequence[Meeting]) -> dict[str, Any]:
    """The fields of an `ElasticProblem` for parts in contact and for those with other laws, but for the gap."""
    touching = [condition for condition in meeting if isinstance(condition, Contact)]
    laws = [(number, law) for number, each in enumerate(meeting) for law in _laws_of(each)]
    return {
        "surface": {part: each.surface for each in touching if each.surface is not None for part in each.parts},
        "force": {part: each.force for each in touching if each.force for part in each.parts},
        "moment": {part: each.moment for each in touching if each.moment for part in each.parts},
        "laws": tuple(law for _, law in laws),
        "numbers": tuple(number for number, _ in laws),
        "joint": {part: each.shear for each in meeting if isinstance(each, JointSprings) for part in each.parts},
    }


def _laws_of(condition: Meeting) -> list[Law]:
    """The laws of a condition; none for contact without friction."""
    if isinstance(condition, JointSprings):
        return condition.laws
    if not isinstance(condition, Contact):
        return [condition]
    return [] if condition.friction is None else [condition.friction.law(condition.parts)]


@dataclass(frozen=True)
class ElasticBoundary:
    """The parts of the boundary that are Γ_C, Γ_N, and fixed in some components; the rest is Γ_D.

    Attributes:
        contact: Names of the parts of Γ_C; those of laws are added.
        neumann: Names of the parts of Γ_N.
        fixed: For a part the components of u that are given there, letters of "xyz", or "n" for the normal one and "t"
            for the tangential ones: a plane of symmetry is fixed in "n". In the others σn is given, or what a law says:
            on parts of Γ_C with friction u_n may be fixed, on those without it u_t, each as 0.
        inner: Names of the parts of Γ_C inside the domain, where two bodies touch: u_n is then the jump of u along n,
            which is outward from the named side.
        pairs: Pairs of surfaces; the slaves are in `contact` unless they are tied, and all others in `neumann`.
        turned: Names of the parts of Γ_C whose law is from the other side: its p is g + u_n, its flux σ_nn.
    """

    contact: Sequence[str] = ()
    neumann: Sequence[str] = ()
    fixed: Mapping[str, str] = field(default_factory=dict)
    inner: Sequence[str] = ()
    pairs: Sequence[PairedParts] = ()
    turned: Sequence[str] = ()
    physics: ClassVar[str] = "elasticity"
    words: ClassVar[tuple[str, str, str]] = ("the foundation", "the gap", "displacement")

    def __post_init__(self) -> None:
        """Refuse strings in the place of lists, and unknown components."""
        for key in ("contact", "neumann", "inner", "turned"):
            check_names(key, getattr(self, key))
            object.__setattr__(self, key, list(getattr(self, key)))  # as they are read from files
        object.__setattr__(self, "pairs", paired_parts(self.pairs, self.contact))
        check_kind("fixed", self.fixed, Mapping, hint='; an example is {"left": "x"}')
        for part, components in self.fixed.items():
            check_kind(f"fixed: part '{part}'", components, str)
            is_known = components in (NORMAL, TANGENTIAL) or (
                set(components) <= set(AXES) and len(set(components)) == len(components)
            )
            if not is_known or not components:
                raise InputError(
                    f"fixed: part '{part}' has '{components}'; use letters of {AXES}, {NORMAL} or {TANGENTIAL}"
                )

    @property
    def named(self) -> dict[str, Sequence[str]]:
        """The parts of each kind."""
        alone = [part for part in self.fixed if part not in self.contact]
        return {"contact": self.contact, "neumann": self.neumann, "fixed": alone, "inner": self.inner}


@dataclass(frozen=True)
class ElasticProblem(ElasticBody, OnBoundary):
    """−∇·σ = f, σ = ℂε(u), u = u_D on Γ_D, σn = g_N on Γ_N; u_n ≤ g, σ_nn ≤ 0, one of them equal, σ_t = 0 on Γ_C.

    Attributes:
        f: Force per volume, or one for each region of the mesh; None for none.
        young: E, or three; or one of these for each region of the mesh.
        poisson: ν likewise.
        u_D: Displacement on Γ_D and, in the fixed components, on parts that are fixed in some; or one for each of these
            parts, and by "" one on the others; None for 0.
        g_N: Traction on Γ_N and, in the free components, on parts that are fixed in some; or one for each of these
            parts, 0 on the others; None for 0.
        pressure: The pressure −g_N·n on parts of Γ_N on which no g_N is given, with no shear.
        support: The stiffness K per area of springs on parts of Γ_N, whose traction is g_N − Ku.
        gap: g, the distance to the foundation along the outer normal, or one for each part of Γ_C.
        surface: Files with the surfaces of foundations, for parts of Γ_C; g is more than the distance to them.
        plane: Plane strain or plane stress, in two dimensions.
        exact: u itself, where it is known.
        laws: Friction on parts of Γ_C; elsewhere Γ_C is without friction. Or other laws, between the
            opening p = gap − u_n and the pressure −σ_nn, in the place of contact on parts of Γ_C.
        numbers: For each law that of its condition, by which messages call it; () if each has one.
        shear: Moduli of shear, see `Elasticity`; likewise the next three.
        axes: Directions of the axes of the material.
        eigenstrain: ε₀.
        initial_stress: σ₀.
        force: For parts of Γ_C whose foundation is a tool that moves: what acts on it along each axis along which it
            can.
        moment: Likewise about each axis about which it turns.
        joint: For parts with friction the stiffness of springs along them, which give way before they slip.
        boundary: The parts of Γ_C, of Γ_N, and fixed in some components; those of laws are added to Γ_C.
        viscosity: That of a fluid in the place of the moduli, with u for its velocity; None for a body.
    """

    g_N: GivenVectorByPart | None = None
    pressure: GivenByPart = field(default_factory=dict)
    support: GivenSupports = field(default_factory=dict)
    gap: Given | Mapping[str, Given] = 0.0
    surface: Mapping[str, str | Path] = field(default_factory=dict)
    laws: Sequence[Law] = ()
    numbers: Sequence[int] = ()
    force: Mapping[str, Mapping[str, Given]] = field(default_factory=dict)
    moment: Mapping[str, Mapping[str, Given]] = field(default_factory=dict)
    joint: GivenByPart = field(default_factory=dict)
    boundary: ElasticBoundary = field(default_factory=ElasticBoundary)
    viscosity: GivenViscosity | None = None
    no_data = ("plane", "laws", "numbers", "surface", "boundary")

    def __post_init__(self) -> None:
        """Refuse what is neither strain nor stress, other laws, and parts with two; add the parts of laws to Γ_C."""
        if self.plane not in list(PlaneState):
            raise InputError(f"plane: unknown '{self.plane}'; use strain or stress")
        check_laws(self.laws, 'CoulombLaw("bottom", 0.3)')
        if any(law.region for law in self.laws):
            raise InputError("laws: those of an elastic body hold on parts, not in regions")
        parts = [(part, is_normal(law)) for law in self.laws for part in law.parts]
        if twice := [part for (part, _), times in Counter(parts).items() if times > 1]:
            raise InputError(f"laws: part '{twice[0]}' has two laws in one direction")
        check_kind("boundary", self.boundary, ElasticBoundary)
        contact = list(dict.fromkeys([*self.boundary.contact, *(part for part, _ in parts)]))
        object.__setattr__(self, "boundary", replace(self.boundary, contact=contact))
        object.__setattr__(self, "numbers", tuple(self.numbers))  # as they are read from files

    def check_fixed(self) -> None:
        """Refuse parts of Γ_C on which what is fixed leaves nothing to a law, or leaves it in other directions.

        Raises:
            InputError: If there is one.
        """
        normal = [part for law in self.laws if is_normal(law) for part in law.parts]
        paired = [part for pair in self.boundary.pairs for part in (*pair.slave, *pair.master)]
        for part in [part for part in self.boundary.contact if part in self.boundary.fixed]:
            wanted = TANGENTIAL if part not in self.rough else NORMAL if part not in normal else ""
            if self.boundary.fixed[part] != wanted:
                told = f"fixed there is '{wanted}'" if wanted else "nothing is fixed there"
                raise InputError(
                    f"fixed: part '{part}' has laws; beside them {told}, not '{self.boundary.fixed[part]}'"
                )
            moves = isinstance(self.u_D, Mapping) and self.u_D.get(part) is not None
            if moves and part not in self.boundary.turned:
                raise InputError(f"u_D.{part}: beside a law u is fixed as 0")
            if part in self.boundary.inner or part in paired:
                raise InputError(f"fixed: '{part}' is where two bodies meet, and has laws alone")
        by_pressure = [part for law in self.laws if isinstance(law, CoulombLaw) for part in law.parts]
        for part in by_pressure:
            if (part in normal and part not in self.joint) or part in self.boundary.turned:
                raise InputError(f"laws: Coulomb's friction on '{part}' needs contact there, and no other normal law")

    @property
    def rough(self) -> list[str]:
        """The parts with friction."""
        return [part for law in self.laws if not is_normal(law) for part in law.parts]

    @property
    def normal(self) -> list[tuple[str, Law]]:
        """The laws between opening and pressure with their names in messages, and that of closed parts."""
        laws = [(name, law) for name, law in self.named_laws if is_normal(law)]
        closed = [part for part in self.boundary.contact if self.boundary.fixed.get(part) == NORMAL]
        return [*laws, *([("fixed", Closed(closed))] if closed else [])]


def nothing_for_0(value: Any) -> Any:
    """The value itself, and None for the number 0, which stands for a vector of zeros."""
    return None if isinstance(value, int | float) and value == 0 else value
