"""What the solutions of all physics have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

from dolfinx import fem

from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.residuals import Residuals
from signorini_fenicsx.methods.registry import Method
from signorini_fenicsx.physics.diffusion.spaces import Spaces
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces
from signorini_fenicsx.solving.options import Options

if TYPE_CHECKING:
    from signorini_fenicsx.certificate.certify import Certificate


class Solved(ABC):
    """A problem with the way it was solved and what came out; the fields are those of its subclasses."""

    name: str
    title: str
    options: Options
    spaces: Spaces | ElasticSpaces
    outcome: Outcome
    kkt: Residuals
    timings: dict[str, float]
    peak_memory: int

    order: ClassVar[int]
    """Order in h of ‖σ − σ_h‖ for a smooth u."""

    @property
    def best_rate(self) -> float:
        """The best possible slope of the error against the number of unknowns."""
        return -self.order / self.u.function_space.mesh.topology.dim

    @property
    def sigma(self) -> fem.Function:
        """σ_h: the flux in RT0, or the symmetric stress, linear on each subcell."""
        return self.outcome.iterate.sigma

    @property
    def u(self) -> fem.Function:
        """u_h: a constant per cell, or a linear displacement."""
        return self.outcome.iterate.u

    @property
    def converged(self) -> bool:
        """Whether the sets repeated and all residuals are small."""
        return self.outcome.converged

    @property
    def method(self) -> Method:
        """The method that solved it."""
        return self.options.method

    @property
    def approach(self) -> str:
        """What was solved and how, in words."""
        return self.method.title

    @abstractmethod
    def norms(self) -> dict[str, float]:
        """Norms of the fields (collective)."""

    @abstractmethod
    def errors(self) -> dict[str, float] | None:
        """Errors if the exact solution is known, otherwise None (collective)."""

    @collector_off()
    def write(
        self, folder: Path | str, *, certificate: Certificate | None = None, plot: bool = False, html: bool = False
    ) -> None:
        """Write the files of the command line into a folder, where they replace an earlier result (collective).

        Args:
            folder: The folder; it is created if it does not exist.
            certificate: Its error bound, which is written as well.
            plot: Also draw PNGs.
            html: Also write `solution.html`, pictures that the mouse can turn; elastic solutions have none.

        Raises:
            InputError: If the folder cannot be written or contains other files.
        """
        from signorini_fenicsx.output.writing import write_results

        write_results(cast(Any, self), folder, certificate=certificate, plot=plot, html=html)

    @collector_off()
    def summary(self) -> dict[str, Any]:
        """All numbers of the run, ready for JSON (collective)."""
        domain, outcome, errors = self.spaces.domain, self.outcome, self.errors()
        return {
            "case": self.name,
            "title": self.title,
            "algorithm": self.options.algorithm_name,
            "backend": outcome.backend,
            "linear_solver": outcome.linear_solver,
            "mesh": domain.origin(),
            "h": domain.h,
            "cells": domain.cells,
            **self._sets(),
            "iterations": len(outcome.history),
            "rough_steps": outcome.rough_steps,
            "converged": outcome.converged,
            "reason": outcome.reason,
            "norms": self.norms(),
            **({} if errors is None else {"errors": errors}),
            "kkt": vars(self.kkt),
            **self._particular(),
            "timings": self.timings,
            "peak_memory": self.peak_memory,
            "ranks": domain.mesh.comm.size,
        }

    @abstractmethod
    def _sets(self) -> dict[str, Any]:
        """Numbers of facets and unknowns, and the contact set, for the summary (collective)."""

    @abstractmethod
    def _particular(self) -> dict[str, Any]:
        """What the summary of these solutions alone has (collective)."""

    def __repr__(self) -> str:
        ended = "converged" if self.converged else "failed"
        iterations = counted(len(self.outcome.history), "iteration")
        about = f"{self.options.algorithm_name}, {self.spaces.domain.cells} cells, {ended} after {iterations}"
        return f"<{type(self).__name__} of {self.name}: {about}>"
