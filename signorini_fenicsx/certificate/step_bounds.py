"""The certificates of the steps of a problem in time, one after another."""

from typing import Any

from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.certificate.certify import Bounds, certified
from signorini_fenicsx.solving.evolving import Instant


class StepBounds:
    """Certificates of one step after another; what a step takes from those before is as its physics says."""

    def __init__(self) -> None:
        """Begin; then the first step is to be bounded."""
        self._of: Any = None

    @collector_off()
    def certify(self, instant: Instant) -> Certificate:
        """Bound the error of a step after those before it (collective)."""

        def of_step(bounds: Bounds) -> Certificate:
            if bounds.of_steps is None:
                return bounds.of_solution(instant.solution)
            self._of = self._of or bounds.of_steps()
            return self._of.certify(instant)

        return certified(instant.solution, of_step)
