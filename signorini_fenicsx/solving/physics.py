"""What there is of each physics, and what shows solutions: tables that layers above fill, in `registry.py`.

They are looked up by name where an import would point upwards.
"""

from collections.abc import Callable
from typing import Any

DIFFUSION = "diffusion"
"""The physics of files that name none."""


class Physics:
    """A physics; its attributes are found, by `late`, when they are first used, so that little is imported.

    Attributes:
        problem: The class of its problems, which are `PosedProblem`.
        system: The class of its systems, a `System`.
        keeping: How its solutions are kept in files, a `Keeping`.
        case: The class of its case files, a `CaseFile`; None if there are none.
        bound: What bounds errors, `Bounds`; None if nothing does.
        quantities: Its quantities from both sides, `Quantities`; None if there are none.
        pictures: What is drawn of its solutions, `Pictures`; None if nothing is.
        proofs: Its bounds as theorems, `Proofs`; None if there are none.
        refining: Gives options with the element that suits adaptive refinement of a sorted problem, and if that is not
            the one of order two, why; None if there is one element alone.
    """

    problem: Any
    system: Any
    keeping: Any
    case: Any
    bound: Any
    quantities: Any
    pictures: Any
    proofs: Any
    refining: Any

    def __getattr__(self, what: str) -> Any:
        if what not in Physics.__annotations__:
            raise AttributeError(what)
        found = self.late(what)
        setattr(self, what, found)
        return found

    def late(self, _what: str) -> Any:
        """Import an attribute; None if there is none."""
        return None


PHYSICS: dict[str, Physics] = {}
"""All physics by their names."""

OUTPUT: dict[str, Callable[..., Any]] = {}
"""What writes a solution and draws it, by the names of the methods of `Solution` that ask for it."""
