"""The quantities that there are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from signorini_fenicsx.base.errors import InputError, names_of
from signorini_fenicsx.expressions.given import Given


@dataclass(frozen=True)
class Kind:
    """A quantity of a solution."""


@dataclass(frozen=True)
class Integral(Kind):
    """∫ weight·u over regions, or over parts of the boundary; over parts inside the domain of the jump of u.

    Attributes:
        weight: The weight.
        region: Name of a region of the mesh, or a list of names; none for all of Ω.
        parts: Name of a part of the boundary, or a list of names, in the place of regions.
        direction: Of a displacement, the vector with which it is multiplied; None for scalar problems, and over parts
            for the normal component of a displacement.

    Raises:
        InputError: If there are regions and parts.
    """

    weight: Given = 1.0
    region: str | Sequence[str] = ()
    parts: str | Sequence[str] = ()
    direction: Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Make lists of single names."""
        for key in ("region", "parts"):
            object.__setattr__(self, key, names_of(key, getattr(self, key)))
        if self.region and self.parts:
            raise InputError("region: is in the place of parts; leave out one of them")


@dataclass(frozen=True)
class Mean(Integral):
    """∫ weight·u divided by ∫ weight, over regions, or over parts of the boundary."""


@dataclass(frozen=True)
class QuantityOnParts(Kind):
    """A quantity of what acts on parts of the boundary.

    Attributes:
        parts: Name of a part, or a list of names.

    Raises:
        InputError: If there is no part.
    """

    parts: str | Sequence[str]

    def __post_init__(self) -> None:
        """Make a list of one name."""
        object.__setattr__(self, "parts", names_of("parts", self.parts))
        if not self.parts:
            raise InputError(f"parts: a {type(self).__name__.lower()} needs the parts where it is measured")


@dataclass(frozen=True)
class Flux(QuantityOnParts):
    """∫ weight·κ∇u·n over parts of the boundary, or inside the domain, where u or a law is given.

    Attributes:
        parts: Name of a part, or a list of names.
        weight: The weight. One that is 0 where the parts end makes a flux bounded that is not.

    Raises:
        InputError: If there is no part.
    """

    weight: Given = 1.0


@dataclass(frozen=True)
class Flow(QuantityOnParts):
    """∫u·n over parts of the boundary of a fluid: what flows out through them."""


@dataclass(frozen=True)
class MeanPressure(Kind):
    """The mean of the pressure p of a fluid over regions.

    Attributes:
        region: Name of a region of the mesh, or a list of names; none for all of Ω.
    """

    region: str | Sequence[str] = ()


@dataclass(frozen=True)
class Dissipation(Kind):
    """∫2μ|ε(u)|²: the power that friction inside a fluid takes."""


@dataclass(frozen=True)
class Force(QuantityOnParts):
    """∫ σn·direction over parts of the boundary where an elastic body is held, or in contact: the force on it there.

    Attributes:
        parts: Name of a part, or a list of names.
        direction: The vector with which the force is multiplied.

    Raises:
        InputError: If there is no part.
    """

    direction: Sequence[float] | None = None


@dataclass(frozen=True)
class Moment(Force):
    """The moment of σn about the origin on such parts; in space about an axis through it, the direction."""


@dataclass(frozen=True)
class Energy(Kind):
    """The least energy: ½(κ∇u, ∇u) + ½(cu, u) − (f, u) − ⟨g_N, u⟩ on Γ_N, and those of the laws.

    Under the law of Signorini this is −⟨q_S, u⟩, under others see `laws.energies`. Of elastic bodies it is ½(ℂε, ε)
    with ε = ε(u) − ε₀, less the work of the loads, and g|u_t| of friction.
    """


KINDS: Mapping[str, type[Kind]] = {
    "integral": Integral,
    "mean": Mean,
    "flux": Flux,
    "energy": Energy,
    "force": Force,
    "moment": Moment,
    "flow": Flow,
    "dissipation": Dissipation,
    "pressure": MeanPressure,
}
"""The quantities by the names that case files have for them."""
