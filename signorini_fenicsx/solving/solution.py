"""A discrete solution: its fields, sets and residuals, and the numbers that sum them up."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from signorini_fenicsx.discrete.chains import Chains
from signorini_fenicsx.discrete.contact_sets import FacetSegments, FacetSet, hausdorff
from signorini_fenicsx.discrete.data import Data, quadrature
from signorini_fenicsx.discrete.kkt import KKTResiduals
from signorini_fenicsx.discrete.problem import Problem
from signorini_fenicsx.discrete.spaces import Spaces, assembled
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.domain import Boundary
from signorini_fenicsx.methods.history import Outcome
from signorini_fenicsx.methods.registry import Method
from signorini_fenicsx.solving.options import Options

EXACT_CONTACT = 1e-12
"""An exact u − ψ of less than this on Γ_S, relative to the largest |u| there, is contact."""


@dataclass(frozen=True)
class Solution:
    """A discrete solution and how it was found. Functions hold owned and up-to-date ghost values.

    Attributes:
        name: What results are called.
        title: The same in more words.
        boundary: Which parts are Γ_S and Γ_N.
        problem: The data as given.
        options: Algorithm, backend and their parameters.
        spaces: The discrete spaces; `spaces.mesh` is the mesh.
        data: The data on the mesh, and their means.
        p: Trace p_h in P0(Γ_S), on the facet submesh.
        outcome: How the method ended, with σ_h and u_h; it has converged if the residuals are small as well.
        kkt: Residuals of the discrete Signorini problem.
        source: What the problem was read from, a `cases.case.Case`; None if it was given in Python.
        timings: Seconds per phase, the longest over all ranks.
        peak_memory: Bytes that the processes have held at most so far, summed over ranks.
    """

    name: str
    title: str
    boundary: Boundary
    problem: Problem
    options: Options
    spaces: Spaces
    data: Data
    p: fem.Function
    outcome: Outcome
    kkt: KKTResiduals
    source: object = None
    timings: dict[str, float] = field(default_factory=dict)
    peak_memory: int = 0

    @property
    def sigma(self) -> fem.Function:
        """Flux σ_h in RT0."""
        return self.outcome.iterate.sigma

    @property
    def u(self) -> fem.Function:
        """u_h in P0."""
        return self.outcome.iterate.u

    @property
    def converged(self) -> bool:
        """Whether the facet sets repeated and all residuals are small."""
        return self.outcome.converged

    @property
    def method(self) -> Method:
        """What it was solved with."""
        return self.options.method

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
        if self.data.exact is None:
            return None
        spaces = self.spaces
        u = self.data.exact + fem.Constant(spaces.mesh, 0.0)  # a plain number knows no mesh
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
        """The Γ_S facets in contact, by their final condition; under another law, those on which it holds u."""
        return FacetSet(self.spaces, self.outcome.conditions.kind == self.method.contact)

    @property
    def law(self) -> Chains:
        """The law that each Γ_S facet has in the end: with a penalty, that of the penalty."""
        return self.data.laws.chains.with_penalty(self.method.penalty, self.options.eps)

    def segments(self) -> FacetSegments:
        """The segment of its law that each Γ_S facet is on, by its final condition."""
        return FacetSegments(self.spaces, self.law.segments(self.outcome.conditions))

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
        if self.method.stabilised:
            left["mass_balance"] = float(np.sqrt(spaces.integrate(l2(ufl.div(self.sigma) + self.data.f_h, ufl.dx))))
        return left

    def summary(self) -> dict[str, Any]:
        """Everything about the run that fits into numbers, ready for JSON (collective)."""
        spaces, options, outcome = self.spaces, self.options, self.outcome
        contact_facets, contact_measure = self.contact()
        own = {} if outcome.own_residual is None else {"own_residual": outcome.own_residual}
        errors = self.errors()
        return {
            "case": self.name,
            "title": self.title,
            "algorithm": options.algorithm_name,
            "backend": outcome.backend,
            "linear_solver": outcome.linear_solver,
            "h": spaces.domain.h,
            "cells": spaces.mesh.topology.index_map(spaces.mesh.topology.dim).size_global,
            "signorini_facets": spaces.Lambda.dofmap.index_map.size_global,
            "dofs": outcome.dofs,
            "contact_facets": contact_facets,
            "contact_measure": contact_measure,
            "iterations": len(outcome.history),
            "rough_steps": outcome.rough_steps,
            "converged": outcome.converged,
            "reason": outcome.reason,
            "norms": self.norms(),
            **({} if errors is None else {"errors": errors}),
            "kkt": vars(self.kkt),
            **own,
            **({"eps": options.eps, "violation": self.violation()} if self.method.has_eps else {}),
            "details": outcome.details,
            "timings": self.timings,
            "peak_memory": self.peak_memory,
            "ranks": spaces.mesh.comm.size,
        }
