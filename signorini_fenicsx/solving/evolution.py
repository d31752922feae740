"""Times and steps of a problem in time, and what a physics says about its steps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from ufl import Form

from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.expressions.given import Given

SCHEMES = {"implicit-euler": (1.0, (1.0,)), "bdf2": (1.5, (2.0, -0.5))}
"""aτ and w_kτ of each scheme. The first step is always one of implicit Euler, as there is only one u before it."""


@dataclass(frozen=True)
class Evolution:
    """What a problem in time has besides its data, which may have t in them.

    Attributes:
        end: The last time.
        steps: Number of steps.
        initial: u_0 of diffusion, or one for each region of the mesh.
        capacity: C ≥ 0 of diffusion, or one for each region of the mesh; or the graph of θ(u), a table with `corners`
            and, where they are not 0, `before` and `beyond`, as the law `Storage` has them. None for 1, or for 0 where
            there are laws of storage, or with memory on parts.
        scheme: "implicit-euler" or "bdf2", of diffusion.
    """

    end: float
    steps: int
    initial: Given | Mapping[str, Given] = 0.0
    capacity: Given | Mapping[str, Given] | None = None
    scheme: str = "implicit-euler"

    def __post_init__(self) -> None:
        """Refuse what is no evolution.

        Raises:
            InputError: If a value is not valid.
        """
        if not 0 < self.end < np.inf:
            raise InputError(f"[time] end: must be a time > 0, not {self.end!r}")
        if not isinstance(self.steps, int) or self.steps < 1:
            raise InputError(f"[time] steps: must be a whole number ≥ 1, not {self.steps!r}")
        if self.scheme not in SCHEMES:
            raise InputError(f"[time] scheme: unknown '{self.scheme}'; use one of {', '.join(SCHEMES)}")

    def time(self, step: int) -> float:
        """The time after so many steps."""
        return self.end * step / self.steps

    def formula(self, step: int) -> tuple[float, tuple[float, ...]]:
        """The factor a and the weights w_1, w_2, … of a step; steps are counted from 1."""
        a, weights = SCHEMES[self.scheme if step > 1 else "implicit-euler"]
        rate = self.steps / self.end
        return a * rate, tuple(w * rate for w in weights)


@dataclass(frozen=True)
class Past:
    """What the next step needs of the last one.

    Attributes:
        step: Its number.
        left: What it has left, and what the step before has, see `Steps.left_by`; none of the start.
        segments: The segments on which it ended.
    """

    step: int
    left: Sequence[Any]
    segments: Any


class Steps(Protocol):
    """The problems of the steps on a mesh.

    Attributes:
        spaces: The discrete spaces.
    """

    spaces: MeshSpaces

    def start(self) -> Any:
        """What the first step takes from before it (collective).

        Raises:
            InputError: If that is not what it has to be.
        """

    def problem(self, step: int, before: Sequence[Any] = ()) -> Any:
        """The problem of a step, but for its `memory`; without `before` after the start (collective)."""

    def touching(self, problem: Any, solution: Any) -> Any:
        """The problem of a step with laws that touch their curves at a solution; None if it is on them (collective)."""

    def memory(self, step: int, before: Sequence[Any]) -> Any:
        """What a step takes from those before, of what they have left: the last one first (collective)."""

    def left_by(self, solution: Any) -> Any:
        """What the solution of a step leaves for those after it."""

    def of_step(self, solution: Any, earlier: Mapping[str, float] | None = None) -> dict[str, float]:
        """What the table of steps has of a step besides what the solution knows (collective).

        Args:
            solution: The solution after it, or after a part of a step that was halved.
            earlier: The same of the parts before; None for none.
        """

    def halved(self, failure: NumericalFailure) -> "Steps | None":
        """The same with twice as many steps, for a step that has failed; None if that is no help."""

    def kept(self, solution: Any) -> dict[str, npt.NDArray]:
        """What is kept of a step: rows of the owned cells, or of the facets of Γ_S if the name begins with "facet_"."""

    def again(self, step: int, kept: Callable[[int, str], npt.NDArray]) -> Past:
        """What the step after this one needs (collective).

        Args:
            step: The step.
            kept: Gives the rows of this rank that were kept of a step, by their name.
        """

    def by_earlier(self, step: int, by: Mapping[str, npt.NDArray]) -> Sequence[tuple[int, npt.NDArray]]:
        """The derivatives by what earlier steps have left, with their numbers, 0 for the start.

        Args:
            step: The step.
            by: The derivatives by what the problem of the step sees of its data.
        """

    def functional(self, solution: Any, by: npt.NDArray) -> Any:
        """What the derivatives by what a step has left are for `adjoint` of its linearised problem.

        Raises:
            InputError: If there are no derivatives of what is left.
        """

    def at_start(self, by: npt.NDArray) -> Form:
        """The form whose derivative by a control is that of something by `start`, with these derivatives.

        Raises:
            InputError: If there are none.
        """
