"""`[[quantity]]`: a number that `solve` proves from both sides."""

from typing import Annotated, Any, Literal

from pydantic import Field

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.data_section import KindSection, data_section
from signorini_fenicsx.cases.plot import Word, with_unit
from signorini_fenicsx.cases.values import choice
from signorini_fenicsx.expressions.given import negative
from signorini_fenicsx.quantities.kinds import KINDS, Kind

SIGNED = ("integral", "flux")
"""Those with a sign: the physical flux may be −κ∇u, and u minus what is meant."""
AT_ONCE = ("energy", "dissipation")
"""Those whose interval follows from the solution and its bound; others take problems beside it."""
OF_KIND = {name: data_section(kind) for name, kind in KINDS.items()}


class QuantityTexts(KindSection):
    """A quantity: its name in results, its symbol, unit and sign, its kind, where and with which weight it is taken."""

    word = "quantity"
    of_kind = OF_KIND
    kind: Annotated[str, choice("quantity", tuple(KINDS))]
    name: Annotated[str, Field(pattern=r"^\w[\w -]*$", max_length=60)]

    symbol: Word = ""
    unit: Word = ""
    sign: Literal[1, -1] = 1

    @property
    def label(self) -> str:
        """What pictures call it."""
        return with_unit(self.symbol or self.name, self.unit)

    def made(self) -> Kind:
        """The quantity that the section describes; of a sign −1 its weight is the negative one."""
        data: dict[str, Any] = dict(self.model_extra or {})
        if self.sign < 0:
            if self.kind not in SIGNED:
                raise InputError(f"sign: is of {' and '.join(SIGNED)}; a {self.kind} has none")
            data["weight"] = negative(data.get("weight", 1), "weight")
        return KINDS[self.kind](**data)
