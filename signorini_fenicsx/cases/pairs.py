"""`[[pair]]`: two surfaces that share no nodes, of bodies with meshes of their own.

*`[[law]]`*: a law on some parts of the boundary, or in some regions, as text.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.data_section import READERS, DataSection, KindSection, data_section
from signorini_fenicsx.cases.values import Direction, Entries, Expression, PartNames, Positive, choice
from signorini_fenicsx.contact.law import NO_DATA, Film, Given, Law
from signorini_fenicsx.contact.laws import LAWS, LAWS_INSIDE, River, Seepage
from signorini_fenicsx.discrete.pairs import Pair, Tied

KINDS = {**LAWS, **LAWS_INSIDE}
OF_LAWS = READERS | {
    Given: Expression,
    Given | Literal["vertical"]: Expression,
    Sequence[tuple[Given, Given]]: Entries,
}
OF_KIND = {name: data_section(kind, OF_LAWS, (), **dict.fromkeys(NO_DATA)) for name, kind in KINDS.items()}
"""The data of each kind of law as text in x, y, z."""


class LawTexts(KindSection):
    """A `Law`: its kind, its parts or its regions, and its data as text in x, y, z under the law's names for them."""

    word = "law"
    of_kind = OF_KIND
    kind: Annotated[str, choice("law", tuple(KINDS))]
    parts: Annotated[list[str], Field(default=[], exclude_if=lambda parts: not parts)]
    region: Annotated[str | list[str] | None, Field(default=None, exclude_if=lambda region: region is None)]

    @model_validator(mode="after")
    def _has_its_place(self) -> Self:
        if bool(self.parts) == bool(self.region):
            raise ValueError(
                f"the law '{self.kind}' needs parts, a list of parts of the boundary, or region, \"all\" or names of "
                "regions; not both"
            )
        kinds, place, key = (LAWS_INSIDE, "regions", "parts") if self.region else (LAWS, "parts", "region")
        if self.kind not in kinds:
            raise ValueError(f"the law '{self.kind}' has {key}; the laws with {place} are {', '.join(kinds)}")
        return self

    def made(self) -> Law:
        """The law that the section describes."""
        place: dict[str, Any] = {"region": self.region} if self.region else {"parts": self.parts}
        return KINDS[self.kind](**place, **(self.model_extra or {}))


SIDES = ("slave", "master")
BETWEEN = tuple(name for name, kind in LAWS.items() if kind not in (Film, River, Seepage))
"""The laws that may be between two surfaces."""


class PairTexts(KindSection):
    """`[[pair]]`: two surfaces that share no nodes, which touch or are apart, with a law between them.

    The keys of laws are those of `[[law]]`; `tied` has none.
    """

    word = "pair"
    of_kind: ClassVar[Mapping[str, type[DataSection]]] = {
        "tied": DataSection,
        **{name: OF_KIND[name] for name in BETWEEN},
    }
    slave: PartNames
    master: PartNames
    direction: Direction = "normal"
    within: Positive | None = None
    shift: list[float] | None = None

    def law(self) -> Any:
        """The law, without parts; None for that which the physics has."""
        return Tied() if self.kind == "tied" else LAWS[self.kind]((), **(self.model_extra or {}))

    def made(self) -> Pair:
        """The pair."""
        return Pair(self.slave, self.master, self.law(), self.direction, self.within, shift=self.shift)


class WithPairs(CaseFile):
    """A case of a physics that has pairs."""

    pair: Annotated[list[Any], Field(default=[], exclude_if=lambda pairs: not pairs)]

    @property
    def in_pairs(self) -> dict[str, list[str]]:
        """The parts of pairs by their keys; a master of several pairs is in the first one."""
        parts = {f"pair.{i}.{side}": getattr(each, side) for i, each in enumerate(self.pair) for side in SIDES}
        for i, pair in enumerate(self.pair):
            before = [part for other in self.pair[:i] for part in other.master]
            parts[f"pair.{i}.master"] = [part for part in pair.master if part not in before]
        return parts

    @property
    def lists(self) -> dict[str, list[str]]:
        """The parts of laws and of pairs, see `CaseFile.lists`."""
        return super().lists | self.in_pairs

    def texts(self) -> list[tuple[str, str, bool]]:
        """Each expression, also those of pairs, see `CaseFile.texts`."""
        of_pairs = [(f"pair.{i}.{key}", text, True) for i, pair in enumerate(self.pair) for key, text in pair.texts()]
        return [*super().texts(), *of_pairs]

    def condition_of(self, part: str) -> str:
        """The condition on a part, in a word."""
        for pair in self.pair:
            for side, other in (SIDES, SIDES[::-1]):
                if part in getattr(pair, side):
                    return f"{side} of {', '.join(getattr(pair, other))}, {pair.kind}"
        return super().condition_of(part)
