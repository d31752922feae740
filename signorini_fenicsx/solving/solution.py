"""A discrete solution: its fields, sets and residuals, and the numbers that sum them up."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.discrete.conditions import FacetConditions
from signorini_fenicsx.discrete.contact_sets import FacetSet, hausdorff
from signorini_fenicsx.discrete.data import Data, quadrature
from signorini_fenicsx.discrete.kkt import KKTResiduals
from signorini_fenicsx.discrete.spaces import Spaces, assembled
from signorini_fenicsx.expressions import parse_expression
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.methods.loop import Step
from signorini_fenicsx.methods.registry import Algorithm

EXACT_CONTACT = 1e-12
"""An exact u − ψ of less than this on Γ_S, relative to the largest |u| there, is contact."""


@dataclass(frozen=True)
class Solution:
    """A discrete solution and how it was found. Functions hold owned and up-to-date ghost values.

    Attributes:
        case: What was solved.
        algorithm: Its algorithm.
        spaces: The discrete spaces; `spaces.mesh` is the mesh.
        data: f and u_D, and their means.
        sigma: Flux σ_h in RT0.
        u: u_h in P0.
        p: Trace p_h in P0(Γ_S), on the facet submesh.
        conditions: Final conditions of the Γ_S facets of this rank.
        history: One step per iteration of the algorithm.
        kkt: Residuals of the discrete Signorini problem.
        reason: Why it ended, in words.
        converged: Whether the facet sets repeated and all residuals are small.
        backend: Name of the discrete system it was solved with; SNES always takes the mixed one, SNESVI the hybrid one.
        dofs: Unknowns of the linear system.
        linear_solver: Name of the linear solver.
        own_residual: Residual of the discrete problem that a classical method solves instead of (9), None for others.
        details: Numbers that the algorithm chose or found, such as ρ.
        rough_steps: Set updates that went before the history, by solves that stopped early.
        timings: Seconds per phase, the longest over all ranks.
        peak_memory: Bytes that the processes have held at most so far, summed over ranks.
    """

    case: Case
    algorithm: Algorithm
    spaces: Spaces
    data: Data
    sigma: fem.Function
    u: fem.Function
    p: fem.Function
    conditions: FacetConditions
    history: list[Step]
    kkt: KKTResiduals
    reason: str
    converged: bool
    backend: str
    dofs: int
    linear_solver: str
    own_residual: float | None = None
    details: dict[str, float] = field(default_factory=dict)
    rough_steps: int = 0
    timings: dict[str, float] = field(default_factory=dict)
    peak_memory: int = 0

    def norms(self) -> dict[str, float]:
        """L² norms of σ, ∇·σ, u over Ω and of p, σ·n over Γ_S (collective)."""
        spaces = self.spaces
        squares = {
            "sigma_L2": l2(self.sigma, ufl.dx),
            "div_sigma_L2": l2(ufl.div(self.sigma), ufl.dx),
            "u_L2": l2(self.u, ufl.dx),
            "p_L2": l2(self.p, spaces.ds),
            "flux_L2": l2(ufl.dot(self.sigma, spaces.n), spaces.ds),
        }
        return {name: float(np.sqrt(spaces.integrate(square))) for name, square in squares.items()}

    def errors(self) -> dict[str, float] | None:
        """Errors where the solution is known, else None (collective).

        L² norms of those of σ, ∇·σ, u over Ω and of p over Γ_S, and the Hausdorff distance of the contact set to the
        facets in whose midpoints the exact u is ψ.
        """
        if self.case.exact.u is None:
            return None
        spaces = self.spaces
        zero = fem.Constant(spaces.mesh, 0.0)  # a plain number knows no mesh
        u = parse_expression(self.case.exact.u, ufl.SpatialCoordinate(spaces.mesh)) + zero
        metadata = quadrature(u)
        dx = ufl.Measure("dx", domain=spaces.mesh, metadata=metadata)
        squares = {
            "sigma_L2": l2(self.data.kappa * ufl.grad(u) - self.sigma, dx),
            "div_sigma_L2": l2(self.data.f + ufl.div(self.sigma), dx),
            "u_L2": l2(u - self.u, dx),
            "p_L2": l2(u - self.p, spaces.ds(metadata=metadata)),
        }
        norms = {name: float(np.sqrt(spaces.integrate(square))) for name, square in squares.items()}
        return norms | {"contact_hausdorff": hausdorff(self.contact_set(), self._exact_contact_set(u))}

    def _exact_contact_set(self, u: Expr) -> FacetSet:
        spaces = self.spaces
        q, midpoints = ufl.TestFunction(spaces.Lambda), spaces.ds(metadata={"quadrature_degree": 1})
        trace, gap = (
            assembled(value * q * midpoints, [spaces.entity_map])[: len(spaces.facets)] / spaces.facet_measure
            for value in (u, u - self.data.psi)
        )
        largest = spaces.mesh.comm.allreduce(np.abs(trace).max(initial=0.0), MPI.MAX)
        return FacetSet(spaces, gap <= EXACT_CONTACT * largest)

    def contact_set(self) -> FacetSet:
        """The Γ_S facets in contact, by their final condition."""
        return FacetSet(self.spaces, self.conditions.kind == self.algorithm.contact)

    def contact(self) -> tuple[int, float]:
        """Number and measure of the Γ_S facets in contact (collective)."""
        touching = self.contact_set().inside
        comm = self.spaces.mesh.comm
        count = comm.allreduce(int(np.count_nonzero(touching)))
        return count, float(comm.allreduce(self.spaces.facet_measure[touching].sum()))

    def violation(self) -> dict[str, float]:
        """What ε leaves of the Signorini condition, ‖[p − ψ]_-‖_Λ and ‖[σ·n − q_S]_-‖_Λ, or of (9b) (collective)."""
        spaces, data = self.spaces, self.data
        gap = self.p.x.array[: len(spaces.facets)] - data.psi_h
        excess = spaces.normal_flux(self.sigma) - data.q_Sh
        negative = [spaces.facet_measure @ np.minimum(values, 0) ** 2 for values in (gap, excess)]
        trace, flux = np.sqrt(spaces.mesh.comm.allreduce(np.array(negative))).tolist()
        left = {"trace": trace, "flux": flux}
        if self.algorithm.stabilised:
            left["mass_balance"] = float(np.sqrt(spaces.integrate(l2(ufl.div(self.sigma) + self.data.f_h, ufl.dx))))
        return left

    def summary(self) -> dict[str, Any]:
        """Everything about the run that fits into numbers, ready for JSON (collective)."""
        spaces, solve = self.spaces, self.case.solve
        contact_facets, contact_measure = self.contact()
        own = {} if self.own_residual is None else {"own_residual": self.own_residual}
        errors = self.errors()
        return {
            "case": self.case.name,
            "title": self.case.title,
            "algorithm": solve.algorithm,
            "backend": self.backend,
            "linear_solver": self.linear_solver,
            "h": spaces.domain.h,
            "cells": spaces.mesh.topology.index_map(spaces.mesh.topology.dim).size_global,
            "signorini_facets": spaces.Lambda.dofmap.index_map.size_global,
            "dofs": self.dofs,
            "contact_facets": contact_facets,
            "contact_measure": contact_measure,
            "iterations": len(self.history),
            "rough_steps": self.rough_steps,
            "converged": self.converged,
            "reason": self.reason,
            "norms": self.norms(),
            **({} if errors is None else {"errors": errors}),
            "kkt": vars(self.kkt),
            **own,
            **({"eps": solve.eps, "violation": self.violation()} if self.algorithm.has_eps else {}),
            "details": self.details,
            "timings": self.timings,
            "peak_memory": self.peak_memory,
            "ranks": spaces.mesh.comm.size,
        }
