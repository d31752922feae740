"""`[dam]`: a rectangular dam, which stands for the sections of Baiocchi's obstacle problem."""

from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from signorini_fenicsx.cases.complaints import complaint
from signorini_fenicsx.cases.parts import Section
from signorini_fenicsx.cases.values import Positive, number
from signorini_fenicsx.meshes.shapes import full_name


class Dam(Section):
    """`[dam]`: a rectangular dam of length L between water levels H upstream and h downstream, by Baiocchi's problem.

    It stands for the shape, for [boundary] and for [problem]: w ≥ 0, −Δw ≥ −1, with equality in one of them, and on the
    boundary the integrals of the pressure over the height.
    """

    L: Positive
    h: Annotated[float, BeforeValidator(number), Field(ge=0, allow_inf_nan=False)]
    H: Positive

    @model_validator(mode="after")
    def _falls(self) -> Self:
        if self.h >= self.H:
            raise ValueError(f"h: the level downstream, {self.h:g}, must be below H = {self.H:g}")
        if not 1e-6 <= self.L / self.H <= 1e6:
            raise ValueError(f"L: must be between 1e-6 and 1e6 times H = {self.H:g}, not {self.L:g}")
        return self

    @property
    def sections(self) -> dict[str, dict[str, Any]]:
        """The sections that it stands for."""
        L, h, H = (repr(value) for value in (self.L, self.h, self.H))
        u_D = f"(1 - x/{L})*({H} - y)^2/2 + x/{L}*max({h} - y, 0)^2/2"
        return {"boundary": {}, "problem": {"f": "-1", "obstacle": "0", "u_D": u_D}}

    @property
    def shape(self) -> str:
        """The name of its shape."""
        return full_name(f"[0, {self.L!r}] x [0, {self.H!r}]")


def with_dam(tree: dict[str, Any]) -> dict[str, Any]:
    """The keys of a case, with [dam] also those of the sections that it stands for.

    Raises:
        ValueError: If these are given as well.
    """
    geometry = tree.get("geometry", {})
    if not isinstance(tree.get("dam"), dict) or not isinstance(geometry, dict):
        return tree
    try:
        dam = Dam.model_validate(tree["dam"])
    except ValidationError as error:
        raise ValueError(complaint(error, Dam, "dam")) from None
    repeated = [f"[{key}]" for key in (*dam.sections, "law") if key in tree]
    repeated += [f"[geometry] {key}" for key in ("shape", "file") if key in geometry]
    if repeated:
        raise ValueError(f"[dam] stands for {repeated[0]}; leave that out")
    return tree | dam.sections | {"geometry": geometry | {"shape": dam.shape}}


def without_sections(dam: Dam, tree: dict[str, Any]) -> dict[str, Any]:
    """The keys of a case without those that [dam] stands for."""
    kept = {key: value for key, value in tree.items() if key not in (*dam.sections, "geometry")}
    geometry = {key: value for key, value in tree.get("geometry", {}).items() if key != "shape"}
    return kept | ({"geometry": geometry} if geometry else {})
