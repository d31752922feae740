"""κ that depends on u, as an outer method around the loop over the sets.

Each problem under a fixed κ is linear but for its sets. That its u gives this κ again is found by Newton's method with
a line search, one change of sets a step, after some steps of Anderson's acceleration for log κ. The last problem is one
under a fixed κ again, so that its balance is exact; it is the solution if its u gives this κ. Where that fails, more of
Anderson's steps follow, and then κ to powers from 0 to 1, each from the last ones. A u that is known from another mesh
comes first, and the u at rest last.

In a step in time Newton's method begins at once with û of the last step, and what soils store is linear around its u
as κ is fixed. Where that fails `evolve` halves the step.

What is judged is the largest change of κ, and the energy norm of (κ(x, u) − κ)∇u; a flux may repeat long before.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, LinearSolveFailure
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.loop import LINEAR
from signorini_fenicsx.methods.task import Loop
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import Quasilinear

CHANGE = 1e-9
"""κ is found when it changes by this share of itself,"""
ENOUGH, BY_ROUNDING = 1e-6, 0.1
"""or by the first share, if Newton's method has left nothing but rounding; or else, in time, κ∇u by the second one in
the energy norm, if κ is that of a u which differs from the solution by `CHANGE`, beside its size: at saturation the
slope of κ is infinite, and for an n of van Genuchten that is near 1 the rounding of u changes κ by percents."""
FIRST = 10
"""Anderson's steps before Newton's method."""
DEPTH, RELAXED = 10, 0.5
"""How many steps Anderson's acceleration remembers, and what share of a change it takes."""
RANK = 1e-12
"""Combinations of changes whose squares are below this share of the largest are left out."""
NEWTON = 40
"""Newton's steps at most."""
EXACT = 1e-13
"""Newton's method ends where no residual is above this share of u, in time above `CHANGE` of it, or where they do not
fall below `CHANGE` of it."""
ADVICE = "; soil of van Genuchten with an n near 1 needs an air_entry, such as 0.02 m"
KEPT, NEAR = "u gives the κ of its problem", "a u that differs by rounding gives the κ of this problem"
"""Why it ends."""
POWERS, SHORTEST, GROWS = 5, 1e-3, 1.5
"""How many powers of κ are tried at first, the shortest step from one to another, and how steps grow."""
ROUGH = 1e-3
"""What Newton's method may leave for a power that is not 1, as a share of u."""


@dataclass(frozen=True)
class KappaChange:
    """How κ changed with a solution.

    Attributes:
        largest: The largest share of κ by which it differs from κ(x, u).
        energy: The energy norm of (κ(x, u) − κ)∇u beside that of κ∇u.
        content: The largest amount by which the water of the balance in a unit volume differs from that of u.
    """

    largest: float
    energy: float
    content: float = 0.0


@dataclass
class QuasiLinear:
    """The outer method.

    Attributes:
        backend: Solves with its κ; with its `tangent` it makes Newton's steps.
        loop: The loop over the sets.
        near: A u to begin with, at the vertices of the owned cells; None for saturated soil.
        changes: How κ changed with the solution of each problem under a fixed κ.
    """

    backend: Any
    loop: Loop
    near: Array | None = None
    changes: list[KappaChange] = field(default_factory=list)
    _tried: list[tuple[Array, Array]] = field(default_factory=list)
    _solves: int = 0
    _by_newton: bool = False
    _near: bool = False

    def solved(self) -> Outcome:
        """The solution whose u gives its κ (collective)."""
        self._solves, outcome = -self.backend.solves, None
        for way in self._ways():
            with contextlib.suppress(LinearSolveFailure):  # as where κ differs by too many orders
                for outcome in way:
                    if self._found or not outcome.converged:
                        return self._told(outcome)
        if outcome is None:
            raise LinearSolveFailure("no problem with a fixed κ can be solved")
        last, of_u = self.changes[-1], self.backend.data.quasilinear
        return self._told(outcome).ended(
            f"after {len(self.changes)} problems with a fixed κ the last u still changes κ by {last.largest:.1e} of "
            f"itself, and κ∇u by {last.energy:.1e} in the energy norm"
            + (ADVICE if any(soil.is_steep for _, soil in of_u.soils) else "")
        )

    def _ways(self) -> list[Iterator[Outcome]]:
        """How it is sought, one way after another (collective)."""
        of_u: Quasilinear = self.backend.data.quasilinear
        if of_u.storing is not None:
            traces = of_u.storing.traces - of_u.constant
            self.backend.x.array_w[:] = self.backend.system.unknowns_of(traces)
            return [self._newton(), self._again(traces)]
        ways = [self._under(of_u.first), self._anderson(), self._newton(), self._anderson(), self._newton()]
        ways += [self._by_powers(), self._under(of_u.at_rest), self._newton()]
        return ways if self.near is None else [self._again(of_u.traces_of(self.near)), self._newton(), *ways]

    def _told(self, outcome: Outcome) -> Outcome:
        """The outcome with what there is to tell of κ (collective)."""
        data, last = self.backend.data, self.changes[-1]
        dry = int(np.count_nonzero(data.quasilinear.on_floor(data.kappa_values)))
        about = {"kappa_problems": len(self.changes), "kappa_change": last.largest, "kappa_energy_change": last.energy}
        about["dry_cells"] = self.backend.comm.allreduce(dry)
        unsure = data.quasilinear.unsure(self.backend.system.on_cells(self.backend.x))
        about["unsure_cells"] = self.backend.comm.allreduce(int(unsure.sum()))
        about["linear_solves"] = self._solves + self.backend.solves
        if data.quasilinear.storing is not None:
            about["content_change"] = last.content
            traces = self.backend.system.on_cells(self.backend.x) + data.quasilinear.constant
            u = self.backend.spaces.scalar_values(outcome.iterate.u) + data.quasilinear.constant
            self.backend.data = data.left(self.backend.spaces, u, traces)
        kept = NEAR if self._near and last.largest > ENOUGH else KEPT
        reason = kept if outcome.reason == LINEAR else f"{outcome.reason}, and {kept}"
        return replace(outcome, details=outcome.details | about, reason=reason if outcome.converged else outcome.reason)

    @property
    def _found(self) -> bool:
        """Whether the last u gives its κ."""
        last = max(self.changes[-1].largest, self.changes[-1].content)
        return (last <= (ENOUGH if self._by_newton else CHANGE) or self._near) and self._power == 1

    @property
    def _power(self) -> float:
        power: float = self.backend.data.quasilinear.power
        return power

    def _frozen(self) -> Outcome:
        """Solve with the present κ, and see how it changes (collective)."""
        outcome, backend = self.loop(), self.backend
        system, of_u = backend.system, backend.data.quasilinear
        traces, kappa = system.on_cells(backend.x), backend.data.kappa_values
        following = of_u.of_traces(traces)[0]
        around = traces - traces.mean(axis=1, keepdims=True)
        energy = np.einsum("cn,cnv->cv", around, system.by_kappa(backend.x))
        squares = np.array([((following - kappa) ** 2 / kappa * energy).sum(), (kappa * energy).sum()])
        change, whole = np.maximum(backend.comm.allreduce(squares), 0.0).tolist()
        largest = float(np.abs(following / kappa - 1).max(initial=0.0))
        largest, energy = backend.comm.allreduce(largest, MPI.MAX), float(np.sqrt(change / whole)) if whole > 0 else 0.0
        content, stored = 0.0, backend.data.stored
        if stored is not None:
            u = backend.spaces.scalar_values(outcome.iterate.u)
            content = of_u.storing.change(u + of_u.constant, *stored)
        self.changes.append(KappaChange(largest, energy, content))
        with np.errstate(all="ignore"):
            self._tried = [*self._tried, (np.log(kappa), np.log(following))][-DEPTH - 1 :]
        return outcome

    def _under(self, kappa: Array) -> Iterator[Outcome]:
        """The problem under a κ, by its values on each cell (collective)."""
        self.backend.take_kappa(self.backend.data.with_kappa(self.backend.spaces, kappa))
        yield self._frozen()

    def _again(self, traces: Array) -> Iterator[Outcome]:
        """The problem under the κ and with what is stored for û on the facets of the owned cells (collective)."""
        self.backend.take_kappa(self.backend.data.at_traces(self.backend.spaces, traces))
        yield self._frozen()

    def _anderson(self) -> Iterator[Outcome]:
        """Anderson's acceleration for log κ (collective)."""
        backend = self.backend
        self._tried = self._tried[-1:]
        for _ in range(FIRST):
            x = np.array([each[0].ravel() for each in self._tried])
            left = np.array([(each[1] - each[0]).ravel() for each in self._tried])
            step = RELAXED * left[-1]
            if len(x) > 1:
                moved, fallen = np.diff(x, axis=0), np.diff(left, axis=0)
                squares = backend.comm.allreduce(fallen @ np.column_stack([fallen.T, left[-1]]))
                if not np.isfinite(squares).all():
                    return
                shares = np.linalg.lstsq(squares[:, :-1], squares[:, -1], rcond=RANK)[0]
                step = step - shares @ (moved + RELAXED * fallen)
            with np.errstate(over="ignore"):
                kappa = np.exp(x[-1] + step).reshape(backend.data.kappa_values.shape)
            try:
                traces = backend.system.on_cells(backend.x)
                backend.take_kappa(backend.data.with_stored(backend.spaces, kappa, traces))
            except InputError:
                return
            yield self._frozen()

    def _newton(self) -> Iterator[Outcome]:
        """Newton's method from the last solution, and the problem under the κ that it finds (collective)."""
        backend, stores = self.backend, self.backend.data.stored is not None
        for enough in [CHANGE, EXACT] if stores else [EXACT]:  # the second of two is seldom needed
            if not self._settled(enough):
                return
            self._by_newton, x = True, backend.x.array_r.copy()
            outcome = self._frozen()
            largest = [float(np.abs(each).max(initial=0.0)) for each in (backend.x.array_r - x, x)]
            moved, size = (backend.comm.allreduce(each, MPI.MAX) for each in largest)
            near = stores and enough == EXACT and moved <= CHANGE * size
            self._near = near and self.changes[-1].energy <= BY_ROUNDING
            yield outcome
            self._by_newton = self._near = False

    def _settled(self, enough: float) -> bool:
        """Newton's method from the last solution; whether it leaves so little, or all it can (collective)."""
        backend = self.backend
        tangent = backend.tangent = backend.new_tangent()
        try:
            for _ in range(NEWTON):
                self.loop(None, lambda iterate: True)
                size = backend.comm.allreduce(float(np.abs(backend.x.array_r).max(initial=0.0)), MPI.MAX)
                if tangent.left <= enough * size or (tangent.since > 0 and tangent.left <= CHANGE * size):
                    return True
        except LinearSolveFailure:  # also where the residual does not fall
            return False
        finally:
            backend.tangent = None
        return False

    def _by_powers(self) -> Iterator[Outcome]:
        """Newton's method for κ to one power after another, from the first κ (collective).

        Each begins on the line through the two before.
        """
        backend, step = self.backend, 1 / POWERS

        def with_power(power: float) -> None:
            data, of_u = backend.data, replace(backend.data.quasilinear, power=power)
            backend.take_kappa(replace(data, quasilinear=of_u))

        with_power(0.0)
        traces = np.zeros(backend.system.on_cells(backend.x).shape)
        backend.take_kappa(backend.data.with_kappa(backend.spaces, backend.data.quasilinear.of_traces(traces)[0]))
        yield self._frozen()
        done = [(0.0, backend.x.array_r.copy(), backend.data.kappa_values)]
        while done[-1][0] < 1 and step > SHORTEST:
            at, x, kappa = done[-1]
            power = min(at + step, 1.0)
            with_power(power)
            if len(done) > 1:
                before = done[-2]
                backend.x.array_w[:] = x + (power - at) / (at - before[0]) * (x - before[1])
            if self._settled(EXACT if power == 1 else ROUGH):
                done, step = [*done[-1:], (power, backend.x.array_r.copy(), backend.data.kappa_values)], GROWS * step
                continue
            step /= 2
            backend.x.array_w[:] = x
            backend.take_kappa(backend.data.with_kappa(backend.spaces, kappa))
        with_power(1.0)
        self._by_newton = done[-1][0] == 1
        yield self._frozen()
        self._by_newton = False
