"""Quantities of viscous flow from both sides: those of bodies, what flows out through parts, and the dissipation.

*Dissipation.* D = (2με(u), ε(u)) is the square of ‖dev σ‖, and so it is between (‖dev σ_h‖ ± bound)². That is of first
order. Where all that drives the flow is of one kind it follows from the least energy J, whose interval is of second
order. A flow that is multiplied by t > 0 has D and J multiplied by t² if loads, given velocities and the bounds of laws
are multiplied by t. Testing the equations with u gives:

- D + ∫g|u_t| + ∫g|u_n| = W(u), the work of the loads, if all given velocities are 0. Then J = ½D + ∫g|u_t| + ∫g|u_n| −
  W(u) = −½D.
- J = ½D if there are no loads and no bounds g.

`least` of an outlet is a given velocity, its `pressure` is a load.

*The mean of p.* The integral of p over cells is a functional of the stress, −(σ, qI/d) with q = 1 there and 0
elsewhere. It belongs to ∇·u = τq: a fluid that grows by the strain ε₀ = τqI/d. Let v have ∇·v = τq, and obey what is
given of u; let y' be admissible for the problem itself. Then e = ε(v) − ε₀ has no trace, and as for other fluxes, see
`bracket`,

    τ(∫q p(y') − ∫q p(σ)) = (σ − y', e − 𝔸σ) − (σ − y', ε(v − u)) ≤ ¼‖2μe − y'‖² + ∫ sup (t − η')(v − u),

where 𝔸 sees deviators alone: no constant of inf-sup is in it. Where u_n is known on the whole boundary no such v
exists, and p is known up to a constant only.

*Forces on walls with springs.* There σ_t = −β(u_t − w) with the velocity w of the wall, for y' with some w'. v obeys
u_t = τm there, m the rigid motion that the force belongs to. The springs add −∫β(w' − u_t)(v_t − τm − u_t), which is at
most ¼∫β(v_t − τm − w')².
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, names_of
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.contact.laws import Friction
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.elasticity.bound.hidden import loads_of
from signorini_fenicsx.physics.elasticity.bound.resolution import Resolution
from signorini_fenicsx.physics.elasticity.quantities import brackets as of_bodies
from signorini_fenicsx.physics.stokes.problem import IN_EXCESS, Leak, Outflow, StokesProblem
from signorini_fenicsx.physics.stokes.show.readings import pressure_of
from signorini_fenicsx.physics.stokes.solution import StokesSolution
from signorini_fenicsx.quantities.beside import in_regions
from signorini_fenicsx.quantities.bracket import Quantity
from signorini_fenicsx.quantities.kinds import Dissipation, Flow, Flux, Integral, Kind, Mean, MeanPressure


def check(domain: Domain, problem: StokesProblem, kind: Kind) -> None:
    """Refuse what is no quantity of a flow (collective).

    Raises:
        InputError: If a name is unknown, or the quantity is not one of flow.
    """
    if isinstance(kind, Flux):
        kinds = "Flow, Integral, Mean, MeanPressure, Force, Moment, Dissipation and Energy"
        raise InputError(f"Flux: viscous flow has {kinds}")
    if isinstance(kind, MeanPressure):
        _growing(domain, problem, kind, 0.0)
    elif not isinstance(kind, Dissipation):
        of_bodies.check(domain, problem, _outwards(kind) if isinstance(kind, Flow) else kind)


def _outwards(kind: Flow) -> Integral:
    """The integral of u_n that a flow is."""
    return Integral(parts=kind.parts)


def _growing(domain: Domain, problem: StokesProblem, kind: MeanPressure | Integral, tau: float) -> StokesProblem:
    """The problem of a fluid with ∇·u = τ in the regions (collective).

    Raises:
        InputError: If a region is unknown.
    """
    region, share = names_of("region", kind.region), tau / domain.mesh.geometry.dim
    return replace(problem, eigenstrain=in_regions(domain, 0.0, 1.0, region, share))


UNKNOWN = "u_n is known on the whole boundary of the fluid, and p up to a constant only, or to one side of it"
"""Why a mean of p has no interval."""


class _Flows(of_bodies.Integrals):
    """What flows out."""

    def discrete(self) -> float:
        """The flow of û, whose sum over the whole boundary is 0 (collective)."""
        flows = self.solution.flows()
        return float(sum(flows[part] for part in self.kind.parts))


class _Pressures(of_bodies.Integrals):
    """The mean of p."""

    of_flux = True

    def __init__(self, solution: StokesSolution, kind: MeanPressure):
        super().__init__(solution, Mean(region=kind.region))

    def interval(self, near: Quantity | None = None) -> Quantity:
        """The interval; none where no flow exists of a fluid that grows (collective)."""
        found = super().interval(near)
        return replace(found, reason=UNKNOWN) if IN_EXCESS in found.reason else found

    def posed(self, tau: float) -> StokesProblem:
        """The problem of a fluid that grows (collective)."""
        return _growing(self.domain, self.solution.problem, self.kind, tau)

    def value(self, of_v: Any, of_y: Any, enough: float) -> Array:
        """The integral of p of y (collective)."""
        return np.array([self._integral(of_y.y.stresses), 0.0])

    def discrete(self) -> float:
        """The mean of p_h (collective)."""
        measure = self.comm.allreduce(float(self.spaces.cell_measures[self.over.cells].sum()))
        return self._integral(self.solution.stresses) / measure

    def _integral(self, stresses: Array) -> float:
        of_cells = pressure_of(stresses).mean(axis=(1, 2)) * self.spaces.cell_measures
        return float(self.comm.allreduce(float(of_cells[self.over.cells].sum())))

    def response(self) -> float:
        """The size of dev σ where volumes grow by 1, about (collective)."""
        return float(math.sqrt(self.over.sizes[1]) / self.softness())

    def unseen(self, resolution: Resolution, missed: float, oscillation: Array, of_v: Any, of_y: Any) -> float:
        """What loads do on the growth, which is no part of e (collective)."""
        of_cells = np.sqrt(resolution.stiffest() * self.spaces.cell_measures / self.spaces.dim)[self.over.cells]
        sums = self.comm.allreduce(np.array([oscillation[self.over.cells] @ of_cells, of_cells @ of_cells]))
        return float(sums[0] + (missed + of_y.y.distance) * math.sqrt(sums[1]))


class _Power:
    """The dissipation."""

    def __init__(self, solution: StokesSolution):
        self._solution = solution

    def interval(self, near: Quantity | None = None) -> Quantity:
        """The interval: the narrower one where there are two (collective)."""
        solution = self._solution
        certificate, size = certify(solution), solution.norms()["energy"]
        lower, upper = (max(size + sign * certificate.sigma_bound, 0.0) ** 2 for sign in (-1.0, 1.0))
        found = Quantity(size**2, lower, upper, certificate.proved, certificate.reservation or certificate.if_none)
        if factor := _of_energy(solution):
            energy = of_bodies.QUANTITIES.energy(solution)
            lower, upper = sorted(factor * end for end in (energy.lower, energy.upper))
            if upper - lower < found.width:
                found = replace(found, lower=lower, upper=upper, proved=energy.proved, reason=energy.reason)
        return found


def _of_energy(solution: StokesSolution) -> float:
    """D/J if that is known, else 0 (collective)."""
    data, spaces, laws = solution.data, solution.spaces, solution.problem.laws
    outlets = [law for law in laws if isinstance(law, Outflow)]
    others = [law for law in laws if not isinstance(law, Outflow | Leak | Friction)]
    bounds = [law.g for law in laws if isinstance(law, Leak | Friction)]
    loads = [data.f, *(datum for _, datum in loads_of(spaces, data))]
    at_rest = all(datum.number == 0 for datum in data.u_D.components) and all(law.least == 0 for law in outlets)
    at_rest &= data.gap.number == 0
    free = all(scalar.number == 0 for datum in loads for scalar in datum.scalars)
    free &= all(each == 0 for each in (*bounds, *(law.pressure for law in outlets)))
    known = not others and not data.supports.slip.any() and (at_rest or free)
    return (-2.0 if at_rest else 2.0) if spaces.mesh.comm.allreduce(bool(known), MPI.LAND) else 0.0


def _of_fluxes(solution: StokesSolution, kind: Any) -> Any:
    """What gives the interval of a quantity that is no integral."""
    if isinstance(kind, Dissipation):
        return _Power(solution)
    if isinstance(kind, Flow):
        return _Flows(solution, _outwards(kind))
    if isinstance(kind, MeanPressure):
        return _Pressures(solution, kind)
    return of_bodies.Fluxes(solution, kind)


QUANTITIES = replace(of_bodies.QUANTITIES, check=check, fluxes=_of_fluxes, named_for=lambda _: "")
"""The quantities that there are."""
