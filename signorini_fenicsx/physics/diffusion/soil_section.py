"""`[soil.NAME]`: the soil of a region, or of "all", which stands for κ and, in time, for the storage of water."""

from collections.abc import Mapping
from typing import Annotated

from pydantic import BeforeValidator, ConfigDict, Field

from signorini_fenicsx.cases.data_section import data_section
from signorini_fenicsx.cases.parts import Description
from signorini_fenicsx.cases.values import choice, number
from signorini_fenicsx.contact.law import EVERYWHERE
from signorini_fenicsx.physics.diffusion.soils import SOILS, Soil

NUMBERS = data_section(Soil, {float: Annotated[float, BeforeValidator(number), Field(allow_inf_nan=False)]})


class SoilTexts(NUMBERS, Description):  # type: ignore[misc, valid-type]
    """One soil, see `soils.Soil`."""

    model_config = ConfigDict(validate_default=True)
    model: Annotated[str, choice("model", tuple(SOILS))]

    def made(self) -> Soil:
        """The soil.

        Raises:
            InputError: If a number is out of its range.
        """
        return SOILS[self.model](**{name: value for name, value in self if name != "model"})


def kappa_of(soils: Mapping[str, SoilTexts]) -> Soil | dict[str, Soil]:
    """κ by these soils."""
    made = {name: texts.made() for name, texts in soils.items()}
    return made.get(EVERYWHERE, made)
