"""The bound of an energy error, summed from what the admissible fields of a solution leave on each cell.

Admissible fields v and y of any physics, for which the gap identity of its forms holds but for loads R(w) ≤ osc |w|,
and ‖y − σ_h‖ ≤ remainder, give

    |v − u| and ‖σ − σ_h‖ are both at most   √(2 gap) + osc + remainder = bound,

see `physics/diffusion/bound/certify.py` for the proof. If the gap identity is written with the loads of u, its right
side has the additional term R(u − v) ≤ osc |v − u|. Then Young's inequality gives √(2 gap + osc²) + remainder as a
bound of ‖σ − σ_h‖ alone.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import function_of
from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.discrete.data_values import near_first
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces

type Places = tuple[tuple[str, tuple[float, ...]], ...]
"""Data, each with a place."""

PLACES = 10
"""Largest number of unresolved places that are kept."""

API = (
    "bound",
    "gap",
    "guaranteed",
    "indicator",
    "numbers",
    "oscillation",
    "proved",
    "relative",
    "remainder",
    "sigma_bound",
    "summary",
)
"""What a notebook offers of a certificate."""


def reservation(unresolved: Places, unknown: Sequence[str], lacking: str = "by quadrature") -> str:
    """Why a bound is not guaranteed, in words; empty if nothing is to be said."""
    for name, place in unresolved[:1]:
        return f"{name} is not resolved near {place_in_words(place)}"
    return f"{', '.join(unknown)} {lacking}" if unknown else ""


def first_places(own: list[tuple[str, tuple[float, ...]]], comm: MPI.Comm) -> Places:
    """The first of the places of all ranks, the same on all ranks (collective)."""
    return tuple(sorted(each for places in comm.allgather(sorted(own)[:PLACES]) for each in places)[:PLACES])


@dataclass(frozen=True)
class Certificate:
    """A bound for |v − u| and for ‖σ − σ_h‖, see the module; infinite where no v is admissible.

    Attributes:
        coarse: Mask of the owned cells where data are not resolved.
        indicator: η_T in P0 with Σ η_T² = 2 gap + oscillation².
        v: The continuous v in P2, of RT1 in P3, with interpolated u_D and ψ; in elasticity on the split mesh.
        bound: √(2 gap) + oscillation + remainder, for either error.
        sigma_bound: √(2 gap + oscillation²) + remainder, for ‖σ − σ_h‖ alone.
        gap: ½‖κ∇v − y‖² and what the laws add to it, in elasticity ½‖ℂ(ε(v) − ε₀) − y‖².
        oscillation: osc, of loads in cells and on facets, and of their means that quadrature may have missed.
        remainder: Bound of ‖y − σ_h‖, which comes from the linear solver or a penalty, including rounding; in
            elasticity also what quadrature may have missed of linear parts of loads.
        relative: bound/‖σ_h‖, of bodies whose stiffness varies within cells with this norm by quadrature.
        proved: Whether all data are enclosed and resolved, so that the bound is proved, for the solution `of`.
        by_quadrature: The data that are not enclosed: those given in Python, and loads without Γ_D.
        unresolved: Data that are not resolved, each with a place; the same on all ranks.
        of: To which solution the error is, in words; empty if it is that of the problem.
        about: What a summary says besides.
        lacking: What is missing for the data in `by_quadrature`.
        seconds: Wall time of the certificate, the longest over all ranks.
        if_none: Why the bound is infinite; empty if it is not.
    """

    coarse: npt.NDArray[np.bool_]
    indicator: fem.Function
    v: fem.Function
    bound: float = math.inf
    sigma_bound: float = math.inf
    gap: float = math.inf
    oscillation: float = math.inf
    remainder: float = math.inf
    relative: float = math.inf
    proved: bool = False
    by_quadrature: tuple[str, ...] = ()
    unresolved: Places = ()
    of: str = ""
    about: Mapping[str, Any] = field(default_factory=dict)
    lacking: str = "by quadrature"
    seconds: float = 0.0
    if_none: str = ""

    def __repr__(self) -> str:
        if not math.isfinite(self.bound):
            return f"<{type(self).__name__}: no bound, {self.if_none}>"
        trust = "guaranteed" if self.guaranteed else "not guaranteed"
        return f"<{type(self).__name__}: {self.error} ≤ {self.bound:.4g}, relative {self.relative:.3g}, {trust}>"

    def __dir__(self) -> list[str]:
        return sorted(API)

    def summary(self) -> dict[str, Any]:
        """All numbers and words of the certificate, ready for JSON."""
        unresolved = [{"data": name, "x": list(place)} for name, place in self.unresolved]
        lists = {"by_quadrature": list(self.by_quadrature), "unresolved": unresolved}
        return self.numbers() | {"guaranteed": self.guaranteed} | lists | dict(self.about)

    @property
    def guaranteed(self) -> bool:
        """Whether the bound is proved for the solution of the problem, not only of one with its last friction bound."""
        return self.proved and bool(self.about.get("guaranteed", True))

    @property
    def error(self) -> str:
        """What is bounded, in words."""
        return f"energy error to {self.of}" if self.of else "energy error"

    @property
    def reservation(self) -> str:
        """Why it is not guaranteed, in words; empty if nothing is to be said."""
        return reservation(self.unresolved, self.by_quadrature, self.lacking)

    @property
    def smaller_than_flux(self) -> bool:
        """Whether the bound is below ‖σ_h‖; otherwise its share of ‖σ_h‖ says nothing: σ may be 0."""
        return self.relative < 1

    def numbers(self) -> dict[str, float]:
        """The bounds and their parts."""
        names = ("bound", "sigma_bound", "gap", "oscillation", "remainder", "relative")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True)
class Gap:
    """What the admissible fields of a solution leave.

    Attributes:
        squares: Twice the gap, per owned cell.
        oscillation: osc_T, per owned cell.
        remainder: Bound of ‖y − σ_h‖; infinite if y is not admissible.
        size: ‖σ_h‖.
        v: The admissible function, or one near it.
        hindrance: Why no v is admissible, in words; empty if one is.
        unbalanced: Why y is not admissible, if it is not.
        by_quadrature: The data that are not enclosed.
        account: Gives the data that are not resolved where the bound is this number, and the owned cells where they are
            not, as a mask (collective).
    """

    squares: Array
    oscillation: Array
    remainder: float
    size: float
    v: fem.Function
    hindrance: str
    unbalanced: str
    by_quadrature: tuple[str, ...]
    account: Callable[[float], tuple[Places, npt.NDArray[np.bool_]]]

    def _not_finite(self, spaces: MeshSpaces) -> str:
        """Which part of the sum is not finite, with the first place; no cause, as many are possible (collective)."""
        for words, squares in (("the gap", self.squares), ("what loads add", self.oscillation)):
            if place := near_first(spaces, ~np.isfinite(squares)):
                return f"{words} is not finite{place}"
        return "the sum of its parts is larger than all floats"

    def certificate(self, spaces: MeshSpaces) -> Certificate:
        """The bound that this gives (collective)."""
        comm, size, remainder = spaces.mesh.comm, self.size, self.remainder
        with np.errstate(invalid="ignore"):
            of_cells = np.sqrt(np.maximum(self.squares + self.oscillation**2, 0.0))
        indicator = function_of(spaces.Q, of_cells, "indicator")
        sums = np.array([self.squares.sum() / 2, (self.oscillation**2).sum()])
        gap, oscillation = comm.allreduce(sums).tolist()
        if_none = (
            self.hindrance
            or ("" if np.isfinite(remainder) else self.unbalanced)
            or ("" if np.isfinite(gap + oscillation) else self._not_finite(spaces))
        )
        bound = sigma_bound = np.inf
        if not if_none:
            gap = max(gap, 0.0)  # < 0 by rounding
            bound = np.sqrt(2 * gap) + np.sqrt(oscillation) + remainder
            sigma_bound = np.sqrt(2 * gap + oscillation) + remainder
        unresolved, coarse = self.account(float(bound))
        PETSc.garbage_cleanup(comm)
        return Certificate(
            bound=float(bound),
            sigma_bound=float(sigma_bound),
            gap=gap,
            oscillation=float(np.sqrt(oscillation)),
            remainder=remainder,
            relative=float(bound / size) if size > 0 else (0.0 if bound == 0 else np.inf),
            proved=not if_none and not unresolved and not self.by_quadrature,
            by_quadrature=self.by_quadrature,
            unresolved=unresolved,
            coarse=coarse,
            indicator=indicator,
            v=self.v,
            if_none=if_none,
        )
