"""What a method gets: a discrete problem of any physics and the parameters of the method."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.parallel import Stopwatch
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import BackendFactory, Iterate, SitePairs
from signorini_fenicsx.contact.chains import Penalty, SiteConditions
from signorini_fenicsx.contact.floating import Floating
from signorini_fenicsx.contact.history import FoundSets, OnStep, Outcome
from signorini_fenicsx.contact.residuals import Residuals


class Loop(Protocol):
    """The loop over the sets, from those of the last time under the present laws of the backend."""

    def __call__(self, segment: Indices | None = None, follow: Callable[[SitePairs], bool] = ...) -> Outcome:
        """Run it (collective).

        Args:
            segment: The segment of each site, in the place of that of the last time.
            follow: See `contact.loop.iterate_sets`.
        """


@dataclass(frozen=True)
class Task(ABC):
    """A discrete problem and the parameters of its method.

    Attributes:
        spaces: The discrete spaces of the physics.
        data: The data on them.
        rho: ρ or step length; None for the default of the method.
        eps: ε of the penalty and of the stabilisation.
        max_iterations: Iterations allowed.
        on_step: Called on all ranks after each iteration.
        backend: Makes the backend of the set rules.
        start: Segments to start from, on any mesh of the domain, or None.
        predict: Whether the sets of large problems are predicted.
        coarser: Maps a factor > 1 to the same problem on a mesh that is coarser by this factor (collective; raises
            InputError if there is no such mesh); None if there are none.
        whole: Whether a coarser problem is solved to its end for a prediction; otherwise its sets are only settled.
        tuning: Sizes from which the program works differently.
        watch: Measures the phases of the method.
    """

    spaces: Any
    data: Any
    rho: float | None
    eps: float
    max_iterations: int
    on_step: OnStep
    backend: BackendFactory
    start: Any = None
    predict: bool = True
    coarser: Callable[[float], Self] | None = None
    whole: bool = False
    tuning: Tuning = field(default_factory=Tuning)
    watch: Stopwatch = field(default_factory=Stopwatch)

    @abstractmethod
    def is_large(self, backend: Any) -> bool:
        """Whether a prediction saves more than it costs."""

    @abstractmethod
    def coarsening(self, backend: Any) -> float | None:
        """How much coarser a mesh is on which the sets are predicted first; None if that costs more than it saves."""

    @abstractmethod
    def begin(self, backend: Any, start: Any) -> Indices:
        """The segment of each site to begin with, from a start; the laws may begin with it as well (collective)."""

    @abstractmethod
    def own_start(self, backend: Any) -> SiteConditions | None:
        """The conditions to begin with if there is no start; None for those of the algorithm (collective)."""

    @abstractmethod
    def found(self, backend: Any, segment: Indices) -> Any:
        """What was found as a start for another mesh, from the segment of each site (collective)."""

    def settled[F: FoundSets](self, _backend: Any, settle: Callable[[], F]) -> F:
        """Settle the sets: once, or with an outer method around it again and again (collective)."""
        return settle()

    def solved(self, _backend: Any, loop: Loop) -> Outcome:
        """Run the loop: once, or with an outer method around it again and again (collective)."""
        return loop()

    @abstractmethod
    def floating(self) -> Floating | None:
        """The components in which u is known but for a constant, if no site holds it; None if there are none.

        Collective.
        """

    @abstractmethod
    def kkt(self, iterate: Iterate, penalty: Penalty | None) -> Residuals:
        """The residuals of the last iterate (collective)."""
