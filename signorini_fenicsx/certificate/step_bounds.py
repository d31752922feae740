"""The certificates of the steps of a problem in time, one after another."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from signorini_fenicsx.base.parallel import Stopwatch, collector_off
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.solving.evolving import Instant
from signorini_fenicsx.solving.system import bound_of


class StepBounds:
    """Certificates of one step after another; what a step takes from those before is as its physics says."""

    def __init__(self) -> None:
        """Begin; then the first step is to be bounded."""
        self._of: Any = None

    @collector_off()
    def certify(self, instant: Instant) -> Certificate:
        """Bound the error of a step after those before it (collective)."""
        solution, watch = instant.solution, Stopwatch()
        if self._of is None:
            self._of = bound_of(solution.physics, "steps").StepBounds()
        with watch.phase("certificate"):
            certificate: Certificate = self._of.certify(instant)
        return replace(certificate, seconds=watch.longest(solution.spaces.mesh.comm)["certificate"])
