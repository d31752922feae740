"""What a method gets: a discrete problem of any physics and the parameters of the method."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from signorini_fenicsx.base.parallel import Stopwatch
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import Backend, BackendFactory, Iterate
from signorini_fenicsx.contact.conditions import Penalty
from signorini_fenicsx.contact.floating import Floating
from signorini_fenicsx.contact.history import OnStep
from signorini_fenicsx.contact.residuals import Residuals
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces

type Coarser = Callable[[float], tuple[MeshSpaces, Callable[[bool], Backend[Iterate]]]]
"""Maps a factor > 1 to the same problem on a mesh that is coarser by this factor: its spaces, and what makes its
backend, with multigrid or not (collective). Raises InputError if there is no such mesh."""


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
        coarser: Makes coarser meshes for the prediction; None if there are none.
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
    start: Segments | None = None
    predict: bool = True
    coarser: Coarser | None = None
    tuning: Tuning = field(default_factory=Tuning)
    watch: Stopwatch = field(default_factory=Stopwatch)

    @property
    @abstractmethod
    def in_cells(self) -> bool:
        """Whether cells are sites as well."""

    @abstractmethod
    def floating(self) -> Floating | None:
        """The components in which u is known but for a constant, if no site holds it; None if there are none.

        Collective.
        """

    @abstractmethod
    def kkt(self, iterate: Iterate, penalty: Penalty | None) -> Residuals:
        """The residuals of an iterate (collective)."""
