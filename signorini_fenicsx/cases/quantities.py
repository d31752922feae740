"""`[[quantity]]`: a number that `solve` proves from both sides."""

from collections.abc import Mapping, Sequence
from typing import Annotated

from pydantic import Field

from signorini_fenicsx.cases.data_section import READERS, KindSection, data_section
from signorini_fenicsx.cases.values import choice
from signorini_fenicsx.quantities import Dissipation, Energy, Flow, Flux, Force, Integral, Kind, Mean, Moment

KINDS: Mapping[str, type[Kind]] = {
    "integral": Integral,
    "mean": Mean,
    "flux": Flux,
    "energy": Energy,
    "force": Force,
    "moment": Moment,
    "flow": Flow,
    "dissipation": Dissipation,
}
"""The quantities by the names that case files have for them."""
OF_QUANTITIES = READERS | {str | Sequence[str]: str | list[str], Sequence[float]: list[float]}
NO_TEXTS = ("region", "parts", "direction")
OF_KIND = {name: data_section(kind, OF_QUANTITIES, NO_TEXTS) for name, kind in KINDS.items()}


class QuantityTexts(KindSection):
    """A quantity: its name in results, its kind, and where and with which weight it is measured."""

    word = "quantity"
    of_kind = OF_KIND
    kind: Annotated[str, choice("quantity", tuple(KINDS))]
    name: Annotated[str, Field(pattern=r"^\w[\w -]*$", max_length=60)]

    def made(self) -> Kind:
        """The quantity that the section describes."""
        return KINDS[self.kind](**(self.model_extra or {}))
