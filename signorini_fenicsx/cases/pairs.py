"""`[[pair]]`: two surfaces that share no nodes, of bodies with meshes of their own."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import Field

from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.data_section import DataSection, KindSection
from signorini_fenicsx.cases.laws import OF_KIND
from signorini_fenicsx.cases.values import Direction, PartNames, Positive
from signorini_fenicsx.contact.law import Film
from signorini_fenicsx.contact.laws import LAWS, River, Seepage
from signorini_fenicsx.discrete.pairs import Pair, Tied

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

    def law(self) -> Any:
        """The law, without parts; None for that which the physics has."""
        return Tied() if self.kind == "tied" else LAWS[self.kind]((), **(self.model_extra or {}))

    def made(self) -> Pair:
        """The pair."""
        return Pair(self.slave, self.master, self.law(), self.direction, self.within)


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
