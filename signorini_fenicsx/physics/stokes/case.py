"""Case files of viscous flow, `physics = "stokes"`."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from signorini_fenicsx.cases.case import CaseFile, Cost
from signorini_fenicsx.cases.complaints import told
from signorini_fenicsx.cases.data_section import DataSection, KindSection, data_section
from signorini_fenicsx.cases.first_case import GIVEN, HELD, SYMMETRIC
from signorini_fenicsx.cases.parts import PartLists
from signorini_fenicsx.cases.plot import OF_FLOWS
from signorini_fenicsx.cases.values import (
    Expression,
    ExpressionByPart,
    ExpressionByRegion,
    Vector,
    VectorByPart,
    choice,
)
from signorini_fenicsx.contact.law import NO_DATA, Law
from signorini_fenicsx.contact.laws import Corners
from signorini_fenicsx.physics.elasticity.case import OF_DATA, check_solve
from signorini_fenicsx.physics.stokes.problem import INSIDE, Leak, Outflow, Slip, StokesProblem, of_laws, velocities

COSTS = {2: Cost(4, 1e4, 4.8e3, 2.4e3), 3: Cost(9, 4.5e4, 390, 170)}
"""Those of bodies, and the solves that keep the volume of cells besides; an order of magnitude."""
KINDS: Mapping[str, type] = {kind.word: kind for kind in (Outflow, Slip, Leak, Corners)}


class FlowParts(PartLists):
    """`[boundary]`: the parts with a given traction, and those fixed in some components; on the rest u is given."""

    neumann: list[str] = Field(default=[])
    fixed: dict[str, str] = Field(default={})
    dirichlet: list[str] | None = None


class FlowLaw(KindSection):
    """`[[law]]`: an outlet that does not suck, a wall with slip, one that leaks, or a graph of u_n and σ_nn."""

    word = "law"
    of_kind: ClassVar[Mapping[str, type[DataSection]]] = {
        word: data_section(kind, OF_DATA, (), **dict.fromkeys(NO_DATA)) for word, kind in KINDS.items()
    }
    kind: Annotated[str, choice("law of viscous flow", tuple(KINDS))]
    parts: list[str] = Field(min_length=1)

    def made(self) -> Law | Slip:
        """The law."""
        law: Law | Slip = KINDS[self.kind](self.parts, **(self.model_extra or {}))
        return law


class FlowTexts(DataSection):
    """`[problem]`: the data as text in x, y, z; the viscosity may have a value for each region."""

    viscosity: ExpressionByRegion
    f: Vector | None = None
    u_D: VectorByPart | None = None
    g_N: VectorByPart | None = None
    pressure: ExpressionByPart = Field(default={})


class FlowExact(DataSection):
    """`[exact]`: the velocity and the pressure, where they are known, as text in x, y, z."""

    u: Vector | None = None
    p: Expression | None = None


class StokesCase(CaseFile):
    """One problem of viscous flow, its discretisation and its algorithm."""

    PHYSICS: ClassVar[str] = "stokes"
    physics: Literal["stokes"]
    boundary: FlowParts
    problem: FlowTexts
    law: Annotated[list[FlowLaw], Field(default=[], exclude_if=lambda laws: not laws)]
    exact: FlowExact = FlowExact()
    plot_keys = OF_FLOWS
    costs: ClassVar[Mapping[int, Cost]] = COSTS
    states: ClassVar[tuple[str, str]] = ("open", "held")
    unproved: ClassVar[str] = "the proof is not for viscous flow"
    first_words = (*(word for word in KINDS if word != Corners.word), SYMMETRIC)
    first_listed = ("",)
    first_data = (
        ("viscosity = 1", "the viscosity", ""),
        ("f = {zero}", "the load", ""),
        ("u_D = {zero}", "the velocity on the rest; also by part: {{left = […]}}", HELD),
        ("g_N = {zero}", "the traction σn on the parts in neumann; also a pressure by part", GIVEN),
    )
    first_laws: ClassVar[Mapping[str, tuple[str, list[str]]]] = {
        "outflow": ("u_n ≥ least and σ_nn ≥ −pressure, one of them equal.", ["least = 0", "pressure = 0"]),
        "slip": ("u_n is given, |σ_t| ≤ g + beta |u_t|, opposite to u_t.", ["g = 1", "beta = 0", "u_n = 0"]),
        "leak": ("u_t = 0, |σ_nn| ≤ g, opposite to u_n.", ["g = 1"]),
    }
    held = "u = u_D"
    inner_needs = ""
    is_vector = True

    @property
    def columns_of_step(self) -> dict[str, tuple[str, int, str]]:
        """What is printed of a step besides that of all physics, see `CaseFile.columns_of_step`."""
        return {"speed": ("speed", 11, ".5g")} | super().columns_of_step

    @property
    def lists(self) -> dict[str, list[str]]:
        """The parts of laws, but for those that are listed as fixed, see `CaseFile.lists`."""
        fixed = self.boundary.fixed
        return {key: [part for part in parts if part not in fixed] for key, parts in super().lists.items()}

    @property
    def approach(self) -> str:
        """What is solved and how, in words."""
        return f"viscous flow, {self.solve.algorithm}"

    @model_validator(mode="after")
    def _solvable(self) -> Self:
        with told():
            self.posed(3)
        given = {*self.meeting, *self.boundary.neumann, *self.boundary.fixed}
        if inside := sorted(given.intersection(self.inner)):
            raise ValueError(f"[boundary] inner: {INSIDE.format(inside[0])}")
        check_solve(self.solve, "viscous flow")
        return self

    def posed(self, dim: int) -> StokesProblem:
        """The parts and the data, see `CaseFile.posed`."""
        values: dict[str, Any] = dict(self.problem)
        made = [law.made() for law in self.law]
        laws = of_laws(made, self.boundary.neumann, self.boundary.fixed, self.inner)
        walls = velocities(made)
        if walls:
            u_D = values["u_D"]
            values["u_D"] = {**(u_D if isinstance(u_D, dict) else {"": u_D}), **walls}
        return StokesProblem(**values, **laws, exact=self.exact.u, exact_p=self.exact.p)
