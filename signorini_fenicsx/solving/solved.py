"""What the solutions of all physics have in common."""

from typing import ClassVar

from dolfinx import fem

from signorini_fenicsx.base.text import counted
from signorini_fenicsx.methods.history import Outcome
from signorini_fenicsx.methods.registry import Method
from signorini_fenicsx.solving.options import Options


class Solved:
    """A problem with the way it was solved and what came out; the fields are those of its subclasses."""

    name: str
    title: str
    options: Options
    outcome: Outcome

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

    def __repr__(self) -> str:
        mesh = self.u.function_space.mesh
        cells = mesh.topology.index_map(mesh.topology.dim).size_global
        ended = "converged" if self.converged else "failed"
        iterations = counted(len(self.outcome.history), "iteration")
        about = f"{self.options.algorithm_name}, {cells} cells, {ended} after {iterations}"
        return f"<{type(self).__name__} of {self.name}: {about}>"
