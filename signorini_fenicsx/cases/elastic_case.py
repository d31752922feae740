"""Case files of elastic contact, `physics = "elasticity"`."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import Case, CaseFile, load_case, read_case_file, validated
from signorini_fenicsx.cases.parts import Parts, Section
from signorini_fenicsx.cases.values import Expression, choice
from signorini_fenicsx.discrete.elastic_problem import ElasticBoundary, ElasticProblem, Plane
from signorini_fenicsx.solving.elastic import RULES

ELASTICITY = "elasticity"


def _table(value: object) -> object:
    """One expression, or one per region."""
    if isinstance(value, dict) and not value:
        raise ValueError("the table of regions is empty")
    return value


Modulus = Annotated[Expression | dict[str, Expression], BeforeValidator(_table)]
Vector = list[Expression]


class ElasticParts(Parts):
    """`[boundary]`: the parts in contact, with given traction, and fixed in some components; the rest is Γ_D."""

    contact: list[str] = Field(min_length=1)
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


class ElasticTexts(Section):
    """`[problem]`: the data of an `ElasticProblem` as text in x, y, z; E and ν may have one for each region."""

    young: Modulus
    poisson: Modulus
    f: Vector | None = None
    u_D: Vector | None = None
    g_N: Vector | dict[str, Vector] | None = None
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
    exact: ElasticExact = ElasticExact()

    @property
    def parts(self) -> Parts:
        """The section `[boundary]`."""
        return self.boundary

    @property
    def approach(self) -> str:
        """What is solved and how, in words."""
        return f"elastic contact, {self.solve.algorithm}"

    def texts(self) -> list[tuple[str, str, str]]:
        """Each expression with its section and its key."""
        exact = [("exact", "u", entry) for entry in self.exact.u or []]
        return [("problem", *entry) for entry in self.problem.texts()] + exact

    @model_validator(mode="after")
    def _solvable(self) -> Self:
        if self.solve.algorithm not in RULES:
            raise ValueError(f"[solve] algorithm: elastic contact is solved by {' or '.join(RULES)}")
        for key in ("backend", "rho", "eps"):
            if key in self.solve.model_fields_set:
                raise ValueError(f"[solve] {key}: elastic contact has no such key")
        return self

    def data(self) -> ElasticProblem:
        """The data as they are given."""
        values: dict[str, Any] = {key: getattr(self.problem, key) for key in type(self.problem).model_fields}
        return ElasticProblem(**values, exact=self.exact.u)


type AnyCase = Case | ElasticCase


def load_any_case(name_or_path: str | Path) -> AnyCase:
    """Read a case of any physics, by name or path.

    Raises:
        InputError: If there is no such case, or it is malformed; the message names file, key and reason.
    """
    tree, path = read_case_file(name_or_path)
    if "physics" not in tree:
        return load_case(name_or_path)
    if tree["physics"] != ELASTICITY:
        raise InputError(f'{path}: physics: unknown {tree["physics"]!r}; use "{ELASTICITY}", or leave it out')
    return validated(ElasticCase, tree, path.stem, str(path))
