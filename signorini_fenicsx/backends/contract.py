"""What the loop over the sets needs from a discretisation: one linear solve under given conditions on its sites.

`Backend` is all that every backend gives; `facets.FacetBackend` has what those share whose sites are the facets of Γ_S,
so that a new one is a name, a solver and a solve.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.discrete.chains import Chains
from signorini_fenicsx.discrete.conditions import SiteConditions
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.spaces import Spaces


@dataclass(frozen=True)
class Pairs:
    """The solution of one linear problem, as the rules see it.

    Attributes:
        p: Trace above its bound, p − ψ, per site of this rank; under another law, from its reference.
        flux: Flux above its bound, σ·n − q_S, per site of this rank; under another law, from its reference.
        linear_iterations: Iterations of the Krylov solver; 1 for a direct one.
    """

    p: Array
    flux: Array
    linear_iterations: int


@dataclass(frozen=True)
class Iterate(Pairs):
    """Solution of one linear mixed problem, its sites being facets. Functions have up-to-date ghost values.

    Attributes:
        sigma: Flux in RT0.
        u: Scalar in P0.
    """

    sigma: fem.Function
    u: fem.Function


class Inexact(Protocol):
    """What an iterative backend gives beyond `Backend`: solves that stop as soon as the next sets are known."""

    def solve_until(self, conditions: SiteConditions, enough: Callable[[Array, Array], bool]) -> tuple[Array, Array]:
        """Solve from the last solution, to the tolerance or until enough is said (collective).

        `Backend.solve` under the same conditions goes on from there.

        Args:
            conditions: Conditions on the sites.
            enough: Called on all ranks after each iteration with what would be `Pairs.p` and `Pairs.flux`.

        Returns:
            `Pairs.p` and `Pairs.flux` in the end.

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        ...

    def solve_near(
        self, sites: Mask, layers: int, share: float
    ) -> Callable[[SiteConditions], tuple[Array, Array]] | None:
        """Exact solves near some sites that leave the last solution elsewhere as it is (collective).

        Args:
            sites: Tells which sites of this rank.
            layers: Cells in each direction.
            share: Part of all unknowns up to which such solves are worth it.

        Returns:
            From conditions to `Pairs.p` and `Pairs.flux` (collective; raises LinearSolveFailure if a factorisation
            fails); None if there would be more unknowns than that.
        """
        ...


class Backend[I: Pairs](Protocol):
    """A linear problem with conditions on sites, set up once. Sites are numbered per rank and owned; there may be none.

    Attributes:
        name: Of the discrete system, as results call it.
        noun: What a site is, in the singular and in the plural.
        comm: Communicator.
        sites: Number of sites of this rank.
        chains: The law of each site.
        dofs: Unknowns of the linear system, over all ranks.
    """

    name: str
    noun: tuple[str, str]
    comm: MPI.Comm
    sites: int
    chains: Chains
    dofs: int

    @property
    def inexact(self) -> Inexact | None:
        """Its early stops, if its linear solver iterates."""
        ...

    @property
    def precise(self) -> "Callable[[], Backend[I]] | None":
        """Makes a backend for the same problem whose flux stays precise where κ jumps by many orders on bad cells.

        None if that of this one does, or if such a one would cost too much.
        """
        ...

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        ...

    def solve(self, conditions: SiteConditions) -> I:
        """Solve with these conditions on Γ_S, u = u_D on Γ_D, σ·n = g_N on Γ_N (collective).

        Raises:
            InputError: If it cannot take one of the conditions.
            LinearSolveFailure: If the linear solver does not converge.
        """
        ...

    def without_flux(self, iterate: I, where: Mask) -> I:
        """The iterate with σ·n = q_S on these sites, and p that belongs to it (collective); refused by some."""
        ...

    def scales(self, iterate: I) -> tuple[Array, Array]:
        """Sizes per site of the terms whose sums p and σ·n are: what is small beside them is rounding (collective)."""
        ...

    def change(self, iterate: I, before: I) -> tuple[float, float]:
        """Norms of what changed, ‖σ − σ'‖ and ‖u − u'‖ (collective)."""
        ...

    def places(self) -> Array:
        """A row per site that no other site has, the same bits on any number of ranks."""
        ...

    def in_mixed_spaces(self, iterate: I, conditions: SiteConditions) -> tuple[Iterate, SiteConditions]:
        """σ_h, u_h, p_h and facet conditions that belong to an iterate and its conditions (collective)."""
        ...


class BackendFactory(Protocol):
    """Makes a backend: a class of them, or a function (collective)."""

    def __call__(self, spaces: Spaces, data: Data) -> Backend[Iterate]:
        """Assemble.

        Args:
            spaces: The discrete spaces.
            data: The data and their means over cells and facets.
        """
        ...
