"""A problem of viscous flow as the user gives it, and sorted by the kinds of its boundary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from signorini_fenicsx.base.errors import InputError, check_kind
from signorini_fenicsx.contact.law import Graph, Law, OnParts, Values
from signorini_fenicsx.contact.laws import Dirichlet, Friction, Neumann
from signorini_fenicsx.discrete.on_parts import by_part, check_conditions, one_value
from signorini_fenicsx.expressions.given import Given, GivenVectorByRegion, negative
from signorini_fenicsx.meshes.domain import Domain, other_side
from signorini_fenicsx.physics.elasticity.conditions import is_normal
from signorini_fenicsx.physics.elasticity.problem import (
    NORMAL,
    TANGENTIAL,
    ElasticBoundary,
    ElasticProblem,
    GivenVector,
    GivenViscosity,
    Pressure,
    fixed_in,
    given_on_parts,
)

if TYPE_CHECKING:
    from signorini_fenicsx.physics.stokes.solution import StokesSolution

FREE, HELD = "free", "held"
INSIDE = "'{}' is inside the fluid, where it is a thin plate: u is given there, 0 by default, and nothing else"
"""What is said of other conditions on such a part."""
IN_EXCESS = "[problem] u_D: where u_n is given"
"""How the sentence begins about a flow that does not exist."""


@dataclass(frozen=True)
class Outflow(Law):
    """u_n ≥ least and σ_nn ≥ −pressure, one of them equal: an outlet through which nothing is sucked in.

    Attributes:
        parts: Name of a part, or a list of names, as in `Outflow("right", pressure=0.1)`.
        least: The least velocity out of the domain.
        pressure: That outside.
        tangential: "free" for σ_t = 0, "held" for u_t = 0.
    """

    least: Given = 0.0
    pressure: Given = 0.0
    tangential: str = FREE
    segments = ("closed", "open")
    levels = ("least", None)
    places = ("parts",)
    word = "outflow"

    def __post_init__(self) -> None:
        """Refuse what is neither free nor held."""
        super().__post_init__()
        if self.tangential not in (FREE, HELD):
            raise InputError(f"tangential: unknown '{self.tangential}'; use {FREE} or {HELD}")

    def _data_names(self) -> list[str]:
        return ["least", "pressure"]

    def graph(self, values: Values) -> Graph:
        """The corner is the reference."""
        corner = values["least"], -values["pressure"]
        return Graph(corner, [corner], before=float("inf"))


@dataclass(frozen=True)
class Leak(Law):
    """u_t = 0 and |σ_nn| ≤ g; u_n = 0 where it is less, σ_nn = −g where u_n > 0, g where u_n < 0: a wall that leaks.

    Attributes:
        parts: Name of a part, or a list of names, as in `Leak("wall", g=0.5)`.
        g: g ≥ 0.
    """

    g: Given = 0.0
    segments = ("inwards", "closed", "outwards")
    places = ("parts",)
    word = "leak"

    graph, refused = Friction.graph, Friction.refused


@dataclass(frozen=True)
class Slip(OnParts):
    """u_n is given, and |σ_t| ≤ g + β|u_t − w|; u_t = w where it is less than g, else σ_t is opposite to u_t − w.

    A wall on which fluid may slip, which moves along itself with w.

    Attributes:
        parts: Name of a part, or a list of names, as in `Slip("bottom", g=0.1)`.
        g: g ≥ 0; with 0 and β = 0 the wall is smooth.
        beta: β ≥ 0, a number: Navier's slip, with g = 0.
        velocity: w, linear, of which the part along the wall counts; None for 0.
        u_n: The velocity out through the wall, as of suction, a polynomial of degree 3 at most.
    """

    g: Given = 0.0
    beta: Given = 0.0
    velocity: GivenVector | None = None
    u_n: Given = 0.0
    word: ClassVar[str] = "slip"


@dataclass(frozen=True)
class ViscousFlow:
    """What a problem of flow has wherever its conditions are, see `Stokes`."""

    viscosity: GivenViscosity
    f: GivenVectorByRegion | None = None
    u_D: GivenVector | None = None


@dataclass(frozen=True)
class Stokes(ViscousFlow):
    """−∇·σ = f, σ = 2με(u) − pI, ∇·u = 0, with a condition on each part of the boundary; u = u_D where there is none.

    The conditions are `Dirichlet`, also of components "n" or "t" or of letters of "xyz", `Neumann` for a traction σn,
    `Pressure`, `Outflow`, `Slip`, `Leak`, and other laws, with u_n for u and σ_nn for κ∇u·n. A part that is fixed in
    some components may have a `Neumann` or a `Pressure` condition for the others, one that is fixed in "t" a law for
    u_n.

    Attributes:
        viscosity: μ, a number or a text; or one of these for each region of the mesh.
        f: Force per volume; None for none.
        u_D: Velocity on the parts that no condition names; None for 0.
        exact: u itself, where it is known.
        exact_p: p itself, where it is known.
        conditions: The conditions, each on its parts.

    Raises:
        InputError: If `conditions` is not a list of them, or a part has two.
    """

    exact: GivenVector | None = None
    exact_p: Given | None = None
    conditions: Sequence[OnParts] = ()

    def __post_init__(self) -> None:
        """Refuse other conditions, and parts with two."""
        example = '[Outflow("right"), Dirichlet("left", [1, 0])]'
        check_kind("conditions", self.conditions, Sequence, hint=f"; an example is {example}")
        object.__setattr__(self, "conditions", tuple(self.conditions))
        some = [each for each in self.conditions if isinstance(each, Dirichlet) and each.components is not None]
        fixed = {part for each in some for part in each.parts}
        beside = [each for each in self.conditions if set(getattr(each, "parts", ())) <= fixed and each not in some]
        others = [each for each in self.conditions if each not in beside]
        check_conditions(others, Law, Pressure, Slip, example=example)
        check_conditions(beside, Law, Pressure, example=example)
        if any(isinstance(each, Friction) for each in self.conditions):
            raise InputError('conditions: friction of a flow is Slip("wall", g=0.1), and of what leaks Leak')

    @property
    def solution_type(self) -> type[StokesSolution]:
        """The class of its solutions."""
        from signorini_fenicsx.physics.stokes.solution import StokesSolution  # which knows problems

        return StokesSolution

    def on(self, domain: Domain) -> StokesProblem:
        """The problem on a domain, sorted by the kinds of its boundary (collective)."""
        laws = [each for each in self.conditions if isinstance(each, Slip) or is_normal(each)]
        plates = [part for part in domain.parts if other_side(part) in domain.parts]
        others = [each for each in self.conditions if not isinstance(each, Dirichlet) or each.components is not None]
        if inside := [part for each in others for part in each.parts if part in plates]:
            raise InputError(f"conditions: {INSIDE.format(inside[0])}")
        fixed, given = fixed_in(self.conditions), given_on_parts(domain, self)
        loaded = by_part(self.conditions, Neumann, Pressure)
        sorted_laws = of_laws(laws, [part for part in loaded if part not in fixed], fixed, plates)
        of_walls = dict.fromkeys(sorted(set(sorted_laws["boundary"].fixed) - set(fixed)))
        same = {name: getattr(self, name) for name in ("viscosity", "f", "exact", "exact_p")}
        u_D = one_value(of_walls | given["u_D"] | velocities(laws), None)
        return StokesProblem(**same | given | {"u_D": u_D}, **sorted_laws)


def velocities(laws: Sequence[Slip | Law]) -> dict[str, GivenVector]:
    """The velocities of walls with slip that move, by part."""
    slips = [law for law in laws if isinstance(law, Slip) and law.velocity is not None]
    return {part: law.velocity for law in slips for part in law.parts if law.velocity is not None}


def of_laws(
    laws: Sequence[Slip | Law], neumann: Sequence[str], fixed: Mapping[str, str], plates: Sequence[str]
) -> dict[str, Any]:
    """The fields of a `StokesProblem` for laws, and its boundary with parts that are loaded, fixed, or plates."""
    slips = [law for law in laws if isinstance(law, Slip)]
    normal = [law for law in laws if isinstance(law, Law)]
    held = [law for law in normal if isinstance(law, Leak) or getattr(law, "tangential", FREE) == HELD]
    only = {part: NORMAL for law in slips for part in law.parts}
    only |= {part: TANGENTIAL for law in held for part in law.parts}
    for part in only:
        if fixed.get(part, only[part]) != only[part]:
            raise InputError(f"fixed: part '{part}' has a law, by which '{only[part]}' is fixed, not '{fixed[part]}'")
    parts = [part for law in laws for part in law.parts]
    through = {part: negative(law.u_n, "slip: u_n") for law in slips if law.u_n != 0 for part in law.parts}
    return {
        "gap": dict.fromkeys(parts, 0.0) | through if through else 0.0,
        "support": {part: [0, law.beta] for law in slips if law.beta != 0 for part in law.parts},
        "laws": tuple(law if isinstance(law, Law) else Friction(law.parts, law.g) for law in laws),
        "boundary": StokesBoundary(
            contact=parts,
            neumann=neumann,
            fixed={**fixed, **only},
            turned=parts,
            plates=plates,
        ),
    }


@dataclass(frozen=True)
class StokesBoundary(ElasticBoundary):
    """The parts of the boundary as those of an elastic body: Γ_C has the laws, all from the other side.

    Attributes:
        plates: Names of parts inside the domain, on both sides of which u is given.
    """

    plates: Sequence[str] = ()
    physics: ClassVar[str] = "stokes"
    words: ClassVar[tuple[str, str, str]] = ("what a law allows", "its −least", "velocity")

    @property
    def named(self) -> dict[str, Sequence[str]]:
        """The parts of each kind."""
        return {**super().named, "inner": self.plates, "dirichlet": self.plates}


@dataclass(frozen=True)
class StokesProblem(ElasticProblem):
    """The problem of an incompressible body with u for its velocity, see `ElasticProblem`.

    Attributes:
        exact_p: p itself, where it is known.
    """

    young: None = None
    poisson: None = None
    boundary: ElasticBoundary = field(default_factory=StokesBoundary)
    exact_p: Given | None = None

    def __post_init__(self) -> None:
        """Refuse what is missing, and see `ElasticProblem`."""
        super().__post_init__()
        if isinstance(self.u_D, Mapping):
            plates = [part for part in getattr(self.boundary, "plates", ()) if part in self.u_D]
            object.__setattr__(self, "u_D", {**self.u_D, **{other_side(part): self.u_D[part] for part in plates}})
        if self.viscosity is None:
            raise InputError("viscosity: is missing")
