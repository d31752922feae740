"""The data of an elastic contact problem as the user gives them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import ClassVar

import numpy.typing as npt
from ufl.core.expr import Expr

from signorini_fenicsx.base.arguments import check_kind, check_names
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.laws import Friction
from signorini_fenicsx.expressions.given import Given
from signorini_fenicsx.meshes.domain import AXES

type GivenVector = Sequence[Given] | Expr | Callable[[Array], npt.ArrayLike]
"""A number, text or UFL expression for each component; a UFL vector on the mesh; or a function of points of shape
(3, n) with values of shape (d, n)."""

NORMAL = "n"


class Plane(StrEnum):
    """What a problem in the plane is a section of."""

    STRAIN = "strain"
    STRESS = "stress"


@dataclass(frozen=True)
class Coulomb:
    """Friction by Coulomb's law, |σ_t| ≤ −μ σ_nn, in two dimensions.

    Attributes:
        parts: Names of parts of Γ_C.
        mu: μ ≥ 0.
    """

    parts: Sequence[str]
    mu: Given
    name: ClassVar[str] = "coulomb"

    def __post_init__(self) -> None:
        """Refuse a string in the place of a list."""
        check_names("parts", self.parts)


type ElasticLaw = Friction | Coulomb
"""Friction with a given bound of the shear (Tresca), or with one by the pressure."""


@dataclass(frozen=True)
class ElasticProblem:
    """−∇·σ = f, σ = ℂε(u), u = u_D on Γ_D, σn = g_N on Γ_N; u_n ≤ g, σ_nn ≤ 0, one of them equal, σ_t = 0 on Γ_C.

    Attributes:
        f: Force per volume; None for none.
        young: E, or one for each region of the mesh.
        poisson: ν likewise.
        u_D: Displacement on Γ_D and, in the fixed components, on parts that are fixed in some; None for 0.
        g_N: Traction on Γ_N and, in the free components, on parts that are fixed in some; or one for each of these
            parts, 0 on the others; None for 0.
        gap: g, the distance to the foundation along the outer normal.
        plane: Plane strain or plane stress, in two dimensions.
        exact: u itself, where it is known.
        laws: Friction on parts of Γ_C, in two dimensions; elsewhere Γ_C is without friction.
    """

    young: Given | Mapping[str, Given]
    poisson: Given | Mapping[str, Given]
    f: GivenVector | None = None
    u_D: GivenVector | None = None
    g_N: GivenVector | Mapping[str, GivenVector] | None = None
    gap: Given = 0.0
    plane: str = Plane.STRAIN
    exact: GivenVector | None = None
    laws: Sequence[ElasticLaw] = ()

    def __post_init__(self) -> None:
        """Refuse what is neither strain nor stress, other laws, and parts with two laws."""
        if self.plane not in list(Plane):
            raise InputError(f"plane: unknown '{self.plane}'; use strain or stress")
        if not isinstance(self.laws, Sequence) or not all(isinstance(law, Coulomb | Friction) for law in self.laws):
            raise InputError('laws: must be a list of laws Friction and Coulomb, such as [Coulomb(["bottom"], 0.3)]')
        twice = [part for part in self.rough if self.rough.count(part) > 1]
        if twice:
            raise InputError(f"laws: part '{twice[0]}' has two laws")

    @property
    def rough(self) -> list[str]:
        """The parts with friction."""
        return [part for law in self.laws for part in law.parts]


@dataclass(frozen=True)
class ElasticBoundary:
    """Which parts of the boundary are Γ_C and Γ_N, and which are fixed in some components; the rest is Γ_D.

    Attributes:
        contact: Names of the parts of Γ_C; those with friction need not be among them.
        neumann: Names of the parts of Γ_N.
        fixed: For a part the components of u that are given there, letters of "xyz", or "n" for the normal one: a plane
            of symmetry is fixed in "n". In the others σn is given.
    """

    contact: Sequence[str]
    neumann: Sequence[str] = ()
    fixed: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse strings in the place of lists, and unknown components."""
        check_names("contact", self.contact)
        check_names("neumann", self.neumann)
        check_kind("fixed", self.fixed, Mapping, hint='; an example is {"left": "x"}')
        for part, components in self.fixed.items():
            check_kind(f"fixed: part '{part}'", components, str)
            known = components == NORMAL or (set(components) <= set(AXES) and len(set(components)) == len(components))
            if not known or not components:
                raise InputError(f"fixed: part '{part}' has '{components}'; use letters of {AXES}, or {NORMAL}")

    def touching_on(self, parts: Sequence[str]) -> ElasticBoundary:
        """The same with these parts in Γ_C as well; they may be there already."""
        return replace(self, contact=[*self.contact, *(part for part in parts if part not in self.contact)])

    @property
    def named(self) -> dict[str, Sequence[str]]:
        """The parts of each kind."""
        return {"contact": self.contact, "neumann": self.neumann, "fixed": list(self.fixed)}
