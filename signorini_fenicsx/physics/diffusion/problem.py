"""A diffusion problem as the user gives it, and sorted by the kinds of its boundary."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING

from signorini_fenicsx.base.errors import InputError, check_kind
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.contact.laws import Dirichlet, Neumann, Reaction, River, Seepage, Signorini
from signorini_fenicsx.discrete.on_parts import OnBoundary, check_conditions, check_laws, names_all, same_value
from signorini_fenicsx.discrete.pairs import Pair, Tied
from signorini_fenicsx.expressions.given import (
    Given,
    GivenByRegion,
    GivenMatrix,
    GivenVectorByRegion,
    parsed,
    with_data,
)
from signorini_fenicsx.meshes.domain import Boundary, Domain, other_side
from signorini_fenicsx.physics.diffusion.soils import FORMS

NO_RT0 = (
    "element: pairs of surfaces take RT1, as RT0 is constant on facets and would not be exact for a u that is linear; "
    "take RT1, or leave out the element"
)

if TYPE_CHECKING:
    from signorini_fenicsx.physics.diffusion.solution import Solution


@dataclass(frozen=True)
class Scalar:
    """What a problem of diffusion has wherever its conditions are, see `Diffusion`."""

    f: GivenByRegion
    kappa: GivenMatrix = 1.0
    c: GivenByRegion = 0.0
    u_D: Given = 0.0
    obstacle: Given | None = None
    exact: GivenByRegion | None = None
    b: GivenVectorByRegion | None = None
    form: str = FORMS[0]


@dataclass(frozen=True)
class Diffusion(Scalar):
    """−∇·(κ∇u + b) + cu + s = f, with a condition on each part of the boundary; u = u_D where there is none.

    With an obstacle u ≥ obstacle and −∇·(κ∇u) + cu ≥ f in Ω, with equality in one of them. The conditions are
    `Dirichlet`, `Neumann` and laws: `Signorini`, `Friction`, `TwoSided`, `Wall`, `Regulator`, `Seepage`, `River`,
    `Corners`, in time `Film`, or your own. Laws in regions of Ω, `Obstacle`, `Reaction`, `Corners` or your own, are
    made with `region=` and give s, a monotone graph of u; without any s = 0.

    Attributes:
        f: Load, or one for each region of the mesh.
        kappa: κ: a scalar, a symmetric positive definite matrix, or one of these for each region of the mesh. A scalar
            may depend on u: a text in x, y, z and u, a function of points and u, or a soil, `VanGenuchten`, `Gardner`
            or `BrooksCorey`, with the head or the pressure head as u, see `form`.
        c: c ≥ 0, or one for each region of the mesh. Where it is positive somewhere, no part needs a given u.
        u_D: Trace on the parts that no condition names, continuous.
        obstacle: Lower bound of u in Ω, continuous; None for none. A short form of `Obstacle(region="all", psi=…)`.
        exact: The exact u, where it is known, or one for each region.
        b: A given flux, a vector or one for each region; None for none. With it κ∇u + b stands for κ∇u everywhere.
        form: What u is where κ is that of soils: "head", or "pressure" for the pressure head, with gravity as b.
        conditions: The conditions, each on its parts. That of a part inside the domain is one between the jump of u and
            κ∇u·n, with n outward from the named side. A `Pair` is one between surfaces of two meshes, with RT1.

    Raises:
        InputError: If `conditions` is not a list of them, or a part has two.
    """

    conditions: Sequence[Law | Pair] = ()

    def __post_init__(self) -> None:
        """Refuse other conditions, and parts with two."""
        check_conditions(self.conditions, Law, Pair, example='[Signorini("bottom"), Neumann("left", 1)]')
        object.__setattr__(self, "conditions", tuple(self.conditions))
        for pair in [each for each in self.conditions if isinstance(each, Pair)]:
            laws_of(pair)

    @property
    def solution_type(self) -> "type[Solution]":
        """The class of its solutions."""
        from signorini_fenicsx.physics.diffusion.solution import Solution  # which knows problems

        return Solution

    def on(self, domain: Domain) -> "Problem":
        """The problem on a domain, sorted by the kinds of its boundary (collective).

        A given u that is not u_D is a law with a vertical graph, and a flux that is not that of the first Neumann
        condition one with a horizontal graph. If all parts are named, the first Dirichlet condition has u_D.

        Raises:
            InputError: If a part is unknown.
        """
        u_D = self.u_D
        dirichlet = [condition for condition in self.conditions if isinstance(condition, Dirichlet)]
        if dirichlet and names_all(domain, self.conditions):
            u_D = dirichlet[0].value
        flux = next((condition.value for condition in self.conditions if isinstance(condition, Neumann)), 0.0)
        neumann: list[str] = []
        laws: list[Law] = []
        pairs = [condition for condition in self.conditions if isinstance(condition, Pair)]
        for condition in [each for each in self.conditions if isinstance(each, Law)]:
            if isinstance(condition, Neumann) and same_value(condition.value, flux):
                neumann += condition.parts
            elif not isinstance(condition, Dirichlet) or not same_value(condition.value, u_D):
                laws.append(condition)
        plain = [law for law in laws if type(law) is Signorini and not law.region]
        only = plain[0] if len(plain) == 1 else Signorini(())
        laws = [law for law in laws if law is not only]
        laws += [law for pair in pairs for law in laws_of(pair)]
        parts = [*only.parts, *(part for law in laws for part in law.parts)]
        inner, paired = [part for part in parts if other_side(part) in domain.parts], [p.on_boundary for p in pairs]
        boundary = Boundary(parts, neumann, inner, paired)
        data = {each.name: getattr(self, each.name) for each in fields(Scalar)}
        return Problem(**data | {"u_D": u_D}, g_N=flux, psi=only.psi, q_S=only.q_S, laws=tuple(laws), boundary=boundary)


def laws_of(pair: Pair) -> list[Law]:
    """The law of a pair on its slave; none if it is tied.

    Raises:
        InputError: If it is none for a jump of u.
    """
    if pair.gap != "distance":
        raise InputError("pair: gap is of bodies; u jumps whatever the distance is")
    if isinstance(pair.law, Tied):
        return []
    if not isinstance(pair.law, Law) or isinstance(pair.law, Dirichlet | Neumann | River | Seepage):
        raise InputError(
            "pair: law must be Tied() for perfect contact, or one between the jump of u and κ∇u·n without parts, as "
            "Wall((), beta=5)"
        )
    return [replace(pair.law, parts=pair.slave)]


@dataclass(frozen=True)
class Problem(Scalar, OnBoundary):
    """−∇·(κ∇u) + cu = f, u = u_D on Γ_D, κ∇u·n = g_N on Γ_N; on Γ_S u ≥ ψ and κ∇u·n ≥ q_S, with equality in one.

    On the parts of `laws` these hold instead of ψ and q_S. With an obstacle u ≥ obstacle and −∇·(κ∇u) + cu ≥ f in Ω,
    with equality in one of them; laws in regions add their s to cu.

    Attributes:
        f: Load, or one for each region of the mesh.
        kappa: κ: a scalar, a symmetric positive definite matrix, or one of these for each region of the mesh.
        u_D: Trace on Γ_D, continuous.
        g_N: Flux κ∇u·n on Γ_N, with the outer normal n.
        psi: Lower bound of the trace on Γ_S, continuous.
        q_S: Lower bound of the flux on Γ_S.
        c: c ≥ 0, or one for each region of the mesh. Where it is positive somewhere, no Γ_D is needed.
        obstacle: Lower bound of u in Ω, continuous, at most u_D on Γ_D; None for none.
        exact: The exact u, where it is known, or one for each region.
        b: A given flux in σ = κ∇u + b, a vector or one for each region; None for none.
        form: What u is where κ is that of soils: "head" or "pressure".
        laws: Other laws on Γ_S, and laws in Ω.
        boundary: The parts of Γ_S and Γ_N; those of laws are added to Γ_S.

    Raises:
        InputError: If `laws` is not a list of laws, or `boundary` is something else.
    """

    g_N: Given = 0.0
    psi: Given = 0.0
    q_S: Given = 0.0
    laws: Sequence[Law] = ()
    boundary: Boundary = field(default_factory=Boundary)
    no_data = ("laws", "boundary", "form")

    def __post_init__(self) -> None:
        """Refuse a law that is not in a list, and add the parts of laws to Γ_S."""
        check_laws(self.laws, 'Friction(["left"], g=1)')
        check_kind("boundary", self.boundary, Boundary)
        parts = [*self.boundary.signorini, *(part for law in self.laws for part in law.parts)]
        object.__setattr__(self, "boundary", replace(self.boundary, signorini=list(dict.fromkeys(parts))))

    @property
    def has_laws_inside(self) -> bool:
        """Whether there are laws in Ω other than reactions."""
        return self.obstacle is not None or any(law.region and not isinstance(law, Reaction) for law in self.laws)

    def parsed(self, dim: int) -> "Problem":
        """The problem, with numbers and texts read as trees, but not those of the laws.

        Raises:
            InputError: If a text cannot be read.
        """
        return with_data(self, lambda key, given: parsed(given, "xyz"[:dim] + self.of_u(key), key), but=self.no_data)

    @staticmethod
    def of_u(key: str) -> str:
        """The name u for κ, which may depend on it; empty for the others."""
        return "u" if key == "[problem] kappa" else ""
