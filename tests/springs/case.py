"""Case files of beds."""
# ruff: noqa: D102

from typing import ClassVar, Literal

from pydantic import Field

from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.data_section import DataSection
from signorini_fenicsx.cases.parts import PartLists
from springs.solving import Bed, Edges


class RestingParts(PartLists):
    """`[boundary]`: the parts of Γ."""

    rests: list[str] = Field(default=[])


class Stiffness(DataSection):
    """`[problem]`: k and f."""

    words = ("k", "f")
    k: float
    f: float


class BedCase(CaseFile):
    """A bed."""

    PHYSICS: ClassVar[str] = "springs"
    physics: Literal["springs"]
    boundary: RestingParts
    problem: Stiffness
    exact: DataSection = DataSection()
    costs: ClassVar = {}
    first_words = ("rests",)
    first_data = (("k = 2", "", ""), ("f = -1", "", ""))

    def posed(self, dim: int):
        return Bed(self.problem.k, self.problem.f, Edges(self.boundary.rests))

    def at_step(self, posed: Bed, step: int | None, dim: int):
        return posed
