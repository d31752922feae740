"""What bounds the errors of a physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from dolfinx import fem

from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.certificate.of_field import FieldBound
from signorini_fenicsx.solving.evolving import Instant


class OfSteps(Protocol):
    """Certificates of one step of a problem in time after another."""

    def certify(self, instant: Instant) -> Certificate:
        """Bound the error of a step after those before it (collective)."""


@dataclass(frozen=True)
class Bounds:
    """What bounds the errors of a physics; all of it is collective.

    Attributes:
        of_solution: Gives the certificate of a solution, with `for_signorini` of that to the problem without penalty.
        of_field: Gives the bound of a function, from a solution on its mesh.
        of_steps: Begins with the certificates of the steps of a problem in time.
    """

    of_solution: Callable[..., Certificate]
    of_field: Callable[[Any, fem.Function], FieldBound]
    of_steps: Callable[[], OfSteps]
