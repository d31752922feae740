"""Case files of elastic contact, `physics = "elasticity"`."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.costs import Cost
from signorini_fenicsx.cases.parts import Parts, Section
from signorini_fenicsx.cases.values import Expression, ExpressionByRegion, Vector, VectorByPart, choice
from signorini_fenicsx.contact.laws import Friction
from signorini_fenicsx.physics.elasticity.problem import CoulombLaw, ElasticBoundary, ElasticLaw, ElasticProblem, Plane
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solving import RULES

COSTS = {2: Cost(4, 1e4, 6e3, 3e3), 3: Cost(9, 4.5e4, 700, 300)}
"""On 110 000 to 450 000 unknowns; an order of magnitude."""


class ElasticParts(Parts):
    """`[boundary]`: the parts in contact, with given traction, and fixed in some components; the rest is Γ_D."""

    contact: list[str] = Field(default=[])
    neumann: list[str] = Field(default=[])
    fixed: dict[str, str] = Field(default={})
    dirichlet: list[str] | None = None

    @model_validator(mode="after")
    def _components(self) -> Self:
        try:
            self.read()
        except InputError as error:
            raise ValueError(str(error)) from None
        return self

    def read(self) -> ElasticBoundary:
        """The same for the solver.

        Raises:
            InputError: If a component is unknown.
        """
        return ElasticBoundary(self.contact, self.neumann, self.fixed)


class FrictionTexts(Section):
    """`[[law]]`: friction on parts of Γ_C, with g, the bound of the shear, or with μ, Coulomb's coefficient."""

    kind: Annotated[str, choice("law of elastic contact", ("friction",))]
    parts: list[str] = Field(min_length=1)
    g: Expression | None = None
    mu: Expression | None = None

    @model_validator(mode="after")
    def _one_bound(self) -> Self:
        if (self.g is None) == (self.mu is None):
            raise ValueError("the law 'friction' must have either g, the bound of the shear, or mu, its coefficient")
        return self

    def texts(self) -> list[tuple[str, str]]:
        """Each expression with the name of its key."""
        return [(key, text) for key, text in (("g", self.g), ("mu", self.mu)) if text is not None]

    def law(self) -> ElasticLaw:
        """The law."""
        return Friction(self.parts, self.g) if self.g is not None else CoulombLaw(self.parts, self.mu or "0")


class ElasticTexts(Section):
    """`[problem]`: the data of an `ElasticProblem` as text in x, y, z; E and ν may have one for each region."""

    young: ExpressionByRegion
    poisson: ExpressionByRegion
    f: Vector | None = None
    u_D: Vector | None = None
    g_N: VectorByPart | None = None
    gap: Expression = "0"
    plane: Annotated[str, choice("plane", tuple(Plane))] = Plane.STRAIN

    def texts(self) -> list[tuple[str, str]]:
        """Each expression with the name of its key."""
        found = [("gap", self.gap)]
        vectors = {"f": self.f, "u_D": self.u_D}
        by_part = self.g_N if isinstance(self.g_N, dict) else {"": self.g_N}
        vectors |= {f"g_N.{part}".rstrip("."): each for part, each in by_part.items()}
        found += [(name, entry) for name, entries in vectors.items() for entry in entries or []]
        for name, value in (("young", self.young), ("poisson", self.poisson)):
            entries = value.items() if isinstance(value, dict) else [("", value)]
            found += [(f"{name}.{region}".rstrip("."), text) for region, text in entries]
        return found


class ElasticExact(Section):
    """`[exact]`: the displacement, where it is known, as text in x, y, z."""

    u: Vector | None = None


class ElasticCase(CaseFile):
    """One problem of elastic contact, its discretisation and its algorithm."""

    physics: Literal["elasticity"]
    boundary: ElasticParts
    problem: ElasticTexts
    law: Annotated[list[FrictionTexts], Field(default=[], exclude_if=lambda laws: not laws)]
    exact: ElasticExact = ElasticExact()
    costs = COSTS
    lacks = ElasticSolution.lacks
    held = "clamped, u = u_D"

    @property
    def states(self) -> tuple[str, str]:
        """What reports call vertices under the two conditions; with friction in the tangential component as well."""
        return ("free", "held") if self.law else ("open", "contact")

    @property
    def parts(self) -> ElasticParts:
        """The section `[boundary]`, with the parts of each `[[law]]` in contact."""
        rough = [part for law in self.law for part in law.parts if part not in self.boundary.contact]
        return self.boundary.model_copy(update={"contact": [*self.boundary.contact, *rough]})

    def condition_of(self, part: str) -> str:
        """The condition on a part, in a word."""
        rough = any(part in law.parts for law in self.law)
        return "contact with friction" if rough else super().condition_of(part)

    @property
    def approach(self) -> str:
        """What is solved and how, in words."""
        return f"elastic contact, {self.solve.algorithm}"

    def texts(self) -> list[tuple[str, str, str]]:
        """Each expression with its section and its key."""
        exact = [("exact", "u", entry) for entry in self.exact.u or []]
        laws = [("", f"law.{i}.{key}", text) for i, law in enumerate(self.law) for key, text in law.texts()]
        return [("problem", *entry) for entry in self.problem.texts()] + exact + laws

    @model_validator(mode="after")
    def _solvable(self) -> Self:
        self.parts.refuse_repetition()
        if not self.parts.named["contact"]:
            raise ValueError("[boundary] contact: lists no part, and there is no [[law]]")
        if self.solve.algorithm not in RULES:
            raise ValueError(f"[solve] algorithm: elastic contact is solved by {' or '.join(RULES)}")
        for key in ("backend", "rho", "eps"):
            if key in self.solve.model_fields_set:
                raise ValueError(f"[solve] {key}: elastic contact has no such key")
        return self

    def posed(self, dim: int) -> tuple[ElasticBoundary, ElasticProblem]:
        """The parts and the data, see `CaseFile.posed`."""
        return self.parts.read(), self.data()

    def data(self) -> ElasticProblem:
        """The data as they are given."""
        values: dict[str, Any] = {key: getattr(self.problem, key) for key in type(self.problem).model_fields}
        return ElasticProblem(**values, exact=self.exact.u, laws=[law.law() for law in self.law])
