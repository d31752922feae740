"""`[soil.NAME]`: the soil of a region, or of "all", which stands for κ and, in time, for the storage of water."""

from collections.abc import Mapping
from typing import Annotated

from pydantic import BeforeValidator, Field

from signorini_fenicsx.cases.parts import Description
from signorini_fenicsx.cases.values import Positive, choice, number
from signorini_fenicsx.contact.law import EVERYWHERE
from signorini_fenicsx.physics.diffusion.soils import SOILS, Soil

type NotNegative = Annotated[float, BeforeValidator(number), Field(ge=0, allow_inf_nan=False)]


class SoilTexts(Description):
    """One soil, see `soils.Soil`."""

    model: Annotated[str, choice("model", tuple(SOILS))]
    K: Positive
    alpha: Positive
    n: Positive | None = None
    theta_r: NotNegative = 0.0
    theta_s: Positive = 1.0
    specific_storage: NotNegative = 0.0
    air_entry: NotNegative = 0.0

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
