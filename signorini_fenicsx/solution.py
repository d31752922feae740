"""What can be asked of a solution of any physics: its bounds, derivatives and quantities, files and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ufl import Form

from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.discrete.seen import Control
from signorini_fenicsx.quantities.bracket import Quantity
from signorini_fenicsx.quantities.kinds import Kind
from signorini_fenicsx.solving.physics import OUTPUT
from signorini_fenicsx.solving.solved import Solved

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from signorini_fenicsx.derivatives.gradient import Change, Gradient


class Solution(Solved):
    """A problem with the way it was solved and what came out, see `Solved`; what it is asked for is imported then."""

    @collector_off()
    def certify(self, *, for_signorini: bool = False) -> Certificate:
        """Bound the energy error, see `certify` (collective)."""
        from signorini_fenicsx.certificate.certify import certify

        return certify(self, for_signorini=for_signorini)

    @collector_off()
    def gradient(self, J: Form, controls: Sequence[Control | str], **tolerance: float) -> Gradient:
        """A functional of this solution and its derivatives by controls, see `derivatives.gradient` (collective).

        Args:
            J: Integrals, in UFL, in `sigma`, `u` and `p` of this solution, and in controls.
            controls: Scalar constants and functions in the data of the problem, with the values of when it was solved;
                or paths to numbers in it, such as "problem.kappa.rock".
            **tolerance: By this name, which sites are biactive.

        Raises:
            InputError: If a control is none, or in neither; if there are no derivatives.
        """
        from signorini_fenicsx.derivatives.gradient import gradient

        return gradient(self, J, controls, **tolerance)

    @collector_off()
    def derivative(self, direction: Mapping[Control | str, Any], **tolerance: float) -> Change:
        """The change of this solution with controls, see `derivatives.gradient.derivative` (collective).

        Args:
            direction: For each control, or path, its change: for a function one of its space, else a number.
            **tolerance: By this name, which sites are biactive.

        Raises:
            InputError: If a control is none, or in no datum; if there are no derivatives.
        """
        from signorini_fenicsx.derivatives.gradient import derivative

        return derivative(self, direction, **tolerance)

    @collector_off()
    def quantity(self, kind: Kind, near: Quantity | None = None) -> Quantity:
        """Prove a quantity of the exact solution from both sides (collective).

        Args:
            kind: What quantity, of `signorini_fenicsx.quantities`.
            near: That of the step or on the mesh before, from which fewer problems are solved.

        Raises:
            InputError: If it is not one of this problem.
        """
        from signorini_fenicsx.quantities.of_solution import quantity

        return quantity(self, kind, near)

    @collector_off()
    def _repr_html_(self) -> str | None:
        """A small table and a picture, for notebooks (collective; None on all ranks but 0)."""
        return OUTPUT["html"](self)

    @collector_off()
    def plot(self, certificate: Certificate | None = None) -> Figure | None:
        """Draw the overview: the fields and the contact, or the deformed body (collective).

        Args:
            certificate: Its error bound; if given, the contributions of the cells are drawn as well.

        Returns:
            The figure, which a notebook shows and `savefig` writes; None on all ranks but 0.
        """
        return OUTPUT["plot"](self, certificate)

    @collector_off()
    def write(
        self, folder: Path | str, *, certificate: Certificate | None = None, plot: bool = False, html: bool = False
    ) -> None:
        """Write the files of the command line into a folder, where they replace an earlier result (collective).

        The solution itself is there first, whatever fails afterwards.

        Args:
            folder: The folder; it is created if it does not exist.
            certificate: Its error bound, which is written as well.
            plot: Also draw PNGs.
            html: Also write `solution.html`, pictures that the mouse can turn.

        Raises:
            InputError: If the folder cannot be written or contains other files.
            LaterFailure: If the solution is written, but not all of the others.
        """
        OUTPUT["write"](self, folder, certificate=certificate, plot=plot, html=html)
