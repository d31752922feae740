"""What the loop over the sets needs from a discretisation: one linear solve under given conditions on its sites.

`Backend` lists what every backend gives. `FacetBackend` of `physics/diffusion/solve/facets.py` implements most of it
for backends whose sites are the facets of Γ_S: a new one adds its name, its number of unknowns, `solver` and `solve`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.chains import Chains, SiteConditions


@dataclass(frozen=True)
class SitePairs:
    """The pairs (p, σ·n) at the sites in the solution of one linear problem: what the rules see of it.

    Attributes:
        p: Trace above its bound, p − ψ, per owned site; for other laws, measured from its reference.
        flux: Flux above its bound, σ·n − q_S, per owned site; for other laws, measured from its reference.
        linear_iterations: Iterations of the Krylov solver; 1 for a direct one.
    """

    p: Array
    flux: Array
    linear_iterations: int


@dataclass(frozen=True)
class Iterate(SitePairs):
    """Solution of one linear mixed problem. Functions have up-to-date ghost values.

    Attributes:
        sigma: Flux in RT0; of a body the stress.
        u: Scalar in P0; of a body the displacement.
    """

    sigma: fem.Function
    u: fem.Function


class Inexact(Protocol):
    """What a backend may give beyond `Backend`: solves for p and σ·n alone that cost less, to predict the sets."""

    @property
    def cheap(self) -> bool:
        """Whether they cost so little that a prediction is worth it at any size."""

    def solve_until(self, conditions: SiteConditions, enough: Callable[[Array, Array], bool]) -> tuple[Array, Array]:
        """Solve from the last solution, to the tolerance or until `enough` returns True (collective).

        `Backend.solve` under the same conditions goes on from the result if it iterates.

        Args:
            conditions: Conditions on the sites.
            enough: Called on all ranks after each iteration, with p and the flux at the sites of the current iterate.

        Returns:
            `SitePairs.p` and `SitePairs.flux` of the last iterate.

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """

    def reached(self, conditions: SiteConditions) -> Iterate | None:
        """The iterate that the last `solve_until` has reached (collective).

        Args:
            conditions: Its conditions.

        Returns:
            The iterate as `Backend.solve` gives it; None if it would cost more than the solve.
        """

    def solve_near(
        self, sites: Mask, layers: int, share: float
    ) -> Callable[[SiteConditions], tuple[Array, Array]] | None:
        """Prepare exact solves near some sites, which leave the last solution unchanged elsewhere (collective).

        Args:
            sites: Mask of these sites on this rank.
            layers: How many layers of cells around them take part.
            share: Such solves are worth their cost up to this share of all unknowns.

        Returns:
            A function from conditions to `SitePairs.p` and `SitePairs.flux` (collective; raises LinearSolveFailure if a
            factorisation fails); None if it would have more unknowns than `share` allows.
        """


class Anchored[I: SitePairs](Protocol):
    """What a backend gives beyond `Backend` if under some sets its problem has no solution, or many: weak springs.

    Attributes:
        comm: Communicator.
        measure: |e| of each site.
    """

    comm: MPI.Comm
    measure: Array

    def anchor(self) -> bool:
        """Let weak springs pull each site to where the last solution has it, under all conditions (collective).

        Returns:
            Whether those that there were pulled.
        """

    def release(self) -> None:
        """Take these springs away."""

    def solve(self, conditions: SiteConditions) -> I:
        """Solve as `Backend.solve`, with any p on ZERO_TRACE sites (collective)."""


class Backend[I: SitePairs](Protocol):
    """A linear problem with conditions on sites, set up once. Each rank numbers the sites that it owns, possibly none.

    Attributes:
        name: Name of the discrete system in results.
        noun: What a site is called, in the singular and in the plural.
        comm: Communicator.
        sites: Number of sites of this rank.
        dofs: Unknowns of the linear system, over all ranks.
    """

    name: str
    noun: tuple[str, str]
    comm: MPI.Comm
    sites: int
    dofs: int

    @property
    def chains(self) -> Chains:
        """The law of each site."""

    @property
    def inexact(self) -> Inexact | None:
        """The solves that predict the sets; None if the backend has none that are cheaper than `solve`."""

    @property
    def anchored(self) -> Anchored[I] | None:
        """The weak springs of the backend; None if its problem has one solution under all conditions."""

    @property
    def precise(self) -> "Callable[[], Backend[I]] | None":
        """Makes a backend for the same problem with a precise flux even if κ jumps by many orders on bad cells.

        None if the flux of this backend is as precise, or if such a backend would cost too much.
        """

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""

    def solve(self, conditions: SiteConditions) -> I:
        """Solve with these conditions on Γ_S, u = u_D on Γ_D, σ·n = g_N on Γ_N (collective).

        Raises:
            InputError: If it cannot take one of the conditions.
            LinearSolveFailure: If the linear solver does not converge.
        """

    def without_flux(self, iterate: I, where: Mask) -> I:
        """The iterate with σ·n = q_S on these sites, and the p that belongs to it (collective).

        Raises:
            InputError: If the backend cannot do this.
        """

    def scales(self, iterate: I) -> tuple[Array, Array]:
        """Per site, the size of the terms that add up to p and to σ·n; values far below are rounding (collective)."""

    def change(self, iterate: I, before: I) -> tuple[float, float]:
        """Norms of what changed, ‖σ − σ'‖ and ‖u − u'‖ (collective)."""

    def places(self) -> Array:
        """One row per owned site that identifies it: no two are equal, and the bits do not depend on the ranks."""

    def in_mixed_spaces(self, iterate: I, conditions: SiteConditions) -> tuple[Iterate, SiteConditions]:
        """σ_h, u_h, p_h and conditions of facets and cells that belong to an iterate (collective)."""


class PlainBackend:
    """What a `Backend` has unless it says otherwise: all is solved by `solve`, nothing is clipped.

    Attributes:
        precise: None, see `Backend.precise`.
    """

    precise: Callable[[], Backend[Any]] | None = None

    @property
    def inexact(self) -> Inexact | None:
        """None, see `Backend.inexact`."""
        return None

    @property
    def anchored(self) -> Anchored[Any] | None:
        """None, see `Backend.anchored`."""
        return None

    def without_flux(self, iterate: Any, where: Mask) -> Any:
        """Refused.

        Raises:
            InputError: Always.
        """
        raise InputError("a rule that clips fluxes needs a backend whose unknown is the flux")

    def in_mixed_spaces(self, iterate: Any, conditions: SiteConditions) -> tuple[Any, SiteConditions]:
        """The iterate and its conditions as they are."""
        return iterate, conditions


class DataBackend(PlainBackend):
    """A `PlainBackend` whose data have the laws of its sites.

    Attributes:
        data: The present data.
        spaces: The discrete spaces, which have the places of the sites.
    """

    data: Any
    spaces: Any
    _solver: Any

    @property
    def chains(self) -> Chains:
        """The law of each site."""
        chains: Chains = self.data.chains
        return chains

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return str(self._solver.name())

    def places(self) -> Array:
        """The places of the sites, see `Backend.places`."""
        places: Array = self.spaces.places
        return places


@runtime_checkable
class Renewable[I: SitePairs](Backend[I], Protocol):
    """A backend that is set up once and then takes the data of one problem after another on its mesh."""

    def renew(self, data: Any) -> bool:
        """Go on with other data, with the results of a new backend; False if a new one is needed (collective)."""


class BackendFactory(Protocol):
    """What makes a backend: a class of backends, or a function (collective)."""

    def __call__(self, spaces: Any, data: Any) -> Backend[Iterate]:
        """Assemble.

        Args:
            spaces: The discrete spaces of a physics.
            data: Its data on them.
        """
