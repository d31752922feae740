"""An elastic contact problem linearised at its solution: how σ and u change with what it sees of its data.

Under its sets the discrete problem is linear, with (u, σ, û) of `forms/elasticity.py`:

    (𝔸σ, τ) + (u, ∇·τ) − ⟨û, τn⟩ + (∇·σ, v) − ⟨σn, q⟩ = −(f, v) − ⟨g, q⟩   for all τ, v, and q = 0 where û is given,

where g stands for tractions and for the shear of sites that slip. The left side is symmetric. So with J on the right
side, and û = 0 where it is given, its solution (λ_σ, λ_u, λ_û) is the adjoint state, and

    dJ = −(d𝔸 σ, λ_σ) − (df, λ_u) − ⟨dg, λ_û⟩ + ⟨dû, λ_σ n⟩.

*Coulomb's friction.* The bound b = μP of the shear depends on the pressure P of the solution. With T' the derivative of
μP by b, let w be the solution of w − T'ᵀw = ∂J/∂b. Then dJ is that of J + Σ wμP with b given. A change of P is one of
the reactions, so wμ/|e| with its sign is what λ_û is at the sites in contact.
"""

from collections.abc import Iterator, Mapping
from functools import cached_property

import basix
import basix.ufl
import numpy as np
from dolfinx import fem
from petsc4py import PETSc
from ufl import Form

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.owned import cell_dofs
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions
from signorini_fenicsx.derivatives.linearised import Effect, HybridLinearised, Solved
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells
from signorini_fenicsx.discrete.seen import Seen, derivative_by, seen_in_points
from signorini_fenicsx.linear.gmres import gmres
from signorini_fenicsx.physics.elasticity.derivative.moments import of_friction, on_boundary
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells, entries, to_entries, to_matrices
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.backend import ElasticBackend
from signorini_fenicsx.physics.elasticity.solve.coulomb import newton


class LinearisedElasticity(HybridLinearised):
    """An elastic problem linearised at its solution; biactive sites are vertices of facets."""

    refusal = "site", "may begin to turn in space, or leave a spring, so there is none"

    def scales(self) -> tuple[Array, Array]:
        """The largest u and the largest stress, for all sites (collective)."""
        return self.largest(self._solution.u.x.array, self._solution.stresses)

    def _sides(self, tolerance: float) -> Indices:
        """See `Linearised`; in space a vertex that slips by little, or sticks with a shear near its bound, is biactive.

        Collective.
        """
        direction, friction, kind = super()._sides(tolerance), self._backend.friction, self._spaces.site_kinds["slip"]
        if friction.in_space:
            iterate, bound = self._solution.outcome.iterate, friction.bound.ravel()
            slip, shear = (np.linalg.norm(kind.of(each).reshape(-1, 2), axis=1) for each in (iterate.p, iterate.flux))
            of_u, of_stress = (tolerance * kind.of(scale)[::2] for scale in self.scales())
            near = np.where(friction.sticks.ravel(), bound - shear <= of_stress, slip <= of_u)
            kind.of(direction)[:] = np.repeat(near & (bound > 0), 2)
        return direction

    @cached_property
    def _weights(self) -> Array:
        """The weights of the points of the quadrature, shape (cells, d + 1, points)."""
        spaces, weights = self._spaces, self._data.quadrature.weights
        shares = Cells(spaces.vertices).measure[:, None, None] / (spaces.dim + 1)
        return np.asarray(shares * np.broadcast_to(weights, (spaces.dim + 1, len(weights))))

    def plain(self) -> Iterator[tuple[str, Seen]]:
        """The data that are seen by their values in the points of the quadrature (collective)."""
        mesh, rule = self._spaces.mesh, self._data.quadrature
        forces = enumerate(self._data.f.components)
        numbers = {f"f.{r}": component.ufl for r, component in forces if component.pieces is None}
        numbers |= {name: number for name, number, _ in self._data.material.moved()}
        if numbers:
            whole = basix.make_quadrature(mesh.basix_cell(), 0)[1].sum()  # the measure of the reference cell
            weights = np.tile(rule.weights, self._spaces.dim + 1) * whole / (self._spaces.dim + 1)
            for name, number in numbers.items():
                yield name, seen_in_points(mesh, number, (rule.points, weights), self._weights)

    def effects(self) -> Iterator[tuple[str, Effect]]:
        """See `on_boundary` (collective)."""
        return on_boundary(self._spaces, self._data)

    def lines(self, segment: Indices) -> Iterator[tuple[str, Effect]]:
        """See `Linearised.lines`; μ is among them (collective)."""
        normal, slip = self._spaces.site_kinds
        directions = self._backend.friction.directions(slip.of(segment))
        yield from self._lines(self._data.laws, (normal.of(segment), self._solution.gap.ravel()))
        yield from of_friction(self._spaces, self._solution.problem, directions)

    def refused(self, chains: Chains) -> Mask:
        """The biactive sites that turn in space, or at the end of a slope, where neighbours change the rays."""
        refused = self.biactive & (chains.kinds == Condition.ROBIN).any(axis=1)
        if self._spaces.dim == 3:
            slip = self._spaces.site_kinds["slip"]
            slip.of(refused)[:] = slip.of(self.biactive)
        return refused

    def change(self, changes: Mapping[str, Array]) -> dict[str, fem.Function | None]:
        """The changes of σ and u with what is seen; there is no p (collective).

        A biactive site moves along one of the two segments that meet there.

        Raises:
            InputError: If vertices may begin or cease to slip in space, or leave the end of a slope.
            NumericalFailure: If the sets of biactive sites do not settle.
        """
        spaces, system = self._spaces, self._backend.system
        numbers = {kind: np.zeros(len(system.load)) for kind in ("lift", "load")}
        numbers |= {kind: np.zeros(spaces.dim * len(spaces.rough_rows)) for kind in ("mu", "g")}
        stresses, u, _ = self._responded(numbers, changes)
        return {"sigma": spaces.split.stress(stresses), "u": spaces.displacement(u), "p": None}

    def _solved(self, numbers: Mapping[str, Array], conditions: SiteConditions, segment: Indices) -> Solved:
        """The traces of the change on these segments (collective).

        With Coulomb's law the bounds change with the pressures. The flux is measured from where a bound has gone.
        """
        backend, spaces, (normal, slip) = self._backend, self._spaces, self._spaces.site_kinds
        friction, values, actual = backend.friction, conditions.value, backend.chains.conditions(segment)
        held, gap, added = actual.kind == Condition.ZERO_TRACE, numbers["lift"][normal.unknown], np.zeros(len(slip))
        lift, load = numbers["lift"].copy(), numbers["load"].copy()
        lift[normal.unknown] = np.where(normal.of(held), gap - normal.of(values), 0.0)
        lift[slip.unknown] *= slip.of(held)
        pull = stiffness_times(self._data, normal.of(actual), gap) - normal.of(values)
        load[normal.unknown] += normal.measure * np.where(normal.of(held), 0.0, pull)
        load[slip.unknown] += slip.measure * slip.of(values)
        x = backend.solve_homogeneous(actual, load, lift)
        if friction.by_pressure:
            sides = friction.directions(slip.of(segment))
            slope = friction.slope(np.where(self.biactive[slip.pressing], 1.0, self._pressure))
            moved = slope * spaces.pressure_of(backend.flux(x, numbers["load"]))
            added_to_bound = numbers["mu"] * self._pressure.ravel() + numbers["g"]
            left = added_to_bound.reshape(slope.shape) + moved
            added = np.repeat(newton(backend, actual, (sides, slope), left).ravel(), spaces.dim - 1)
            load[:] = 0.0
            load[slip.unknown] = sides * slip.measure * added
            x.axpy(1.0, backend.solve_homogeneous(actual, load))
        flux, x = backend.flux(x, numbers["load"] - backend.pulled), np.array(x.array_r)
        slip.of(flux)[:] -= added * np.subtract(1.0, 2 * slip.of(self._segment + np.minimum(self._beside, 0)))
        p = np.append(gap - x[normal.unknown], x[slip.unknown] - numbers["lift"][slip.unknown])
        return *conditions.clean(p, flux, np.inf), x

    def _by_changes(self, changes: Mapping[str, Array]) -> tuple[Array, Array]:
        """The functional of τ and the moments of f that the changes of data in cells give (collective)."""
        spaces, rule, shape = self._spaces, self._data.quadrature, self._weights.shape
        strain = np.zeros((*shape, len(entries(spaces.dim))))
        for name, by_number in self._changes_of_strain():
            strain += changes[name].reshape(shape)[..., None] * by_number
        stresses = -np.einsum("nsq,qa,nsqij->nsaij", self._weights, rule.local, to_matrices(strain), optimize=True)
        none = np.zeros(shape)
        f = np.stack([changes.get(f"f.{r}", none).reshape(shape) for r in range(spaces.dim)], axis=-1)
        moments = np.einsum("nsq,sqv,nsqr->nvr", self._weights, rule.hats, f, optimize=True)
        cells = np.arange(len(spaces.order), dtype=np.int32)
        return stresses[spaces.as_dolfinx(cells)], np.take_along_axis(moments, spaces.order[:, :, None], axis=1)

    def by(self, J: Form, besides: Array | None) -> dict[str, Array]:
        """See `Linearised.by`; besides J there is a derivative by û_t at the sites with friction.

        "slipped" is the derivative by û_t of the step before.
        """
        spaces, backend, (normal, slip) = self._spaces, self._backend, self._spaces.site_kinds
        w = np.zeros(self._pressure.size)
        friction, of_slip = backend.friction, np.zeros(len(slip)) if besides is None else besides
        by_sigma, by_u = (derivative_by(each, J, ()) for each in (self._solution.sigma, self._solution.u))
        stresses, moments = spaces.split.values(by_sigma), -spaces.displacement_values(by_u)

        def solve(load: Array) -> Array:
            nonlocal w
            load = load.copy()
            load[slip.unknown] -= of_slip
            x = backend.solve_homogeneous(self._conditions, load)
            if friction.by_pressure:
                # w − T'ᵀw = ∂J/∂b
                w, steps, reached = gmres(
                    backend.comm, lambda w: w - self._by_bound(self._of_pressure(w).array_r), self._by_bound(x.array_r)
                )
                if not reached:
                    raise NumericalFailure(f"derivative: GMRES has not found it after {steps} steps")
                x.axpy(1.0, self._of_pressure(w))
            return backend.system.everywhere(x.array_r)

        adjoint, of_u, x = backend.system.respond(stresses, moments, solve=solve)
        forces = backend.system.forces(adjoint)
        given = np.union1d(self._data.fixed, spaces.site_kinds.unknown[self._held])
        pull, lift = normal.measure * x[normal.unknown], np.zeros_like(forces)
        lift[given] = forces[given]
        lift[normal.unknown] -= stiffness_times(self._data, normal.of(self._conditions), pull)
        of_stick, slipping = forces[slip.unknown] + of_slip, -slip.measure * friction.resisted(x[slip.unknown])
        on_normal = np.where(normal.of(self._held), -forces[normal.unknown], pull)
        return self._by_points(adjoint, of_u) | {
            "lift": lift,
            "load": -x[: len(lift)],
            "mu": w * self._pressure.ravel(),
            "g": w,
            "line": np.append(on_normal, -slip.measure * x[slip.unknown]),
            "slipped": np.where(slip.of(self._held), of_stick, slipping),
        }

    def _by_points(self, adjoint: Array, of_u: Array) -> dict[str, Array]:
        """The derivatives by the data in the points of the quadrature (collective)."""
        if len(self.seen) == len(self._effects):
            return {}
        spaces, rule = self._spaces, self._data.quadrature
        lam = self._at_points(adjoint)
        derivatives = {
            name: -self._weights * np.einsum("nsqe,nsqe->nsq", by_number, lam)
            for name, by_number in self._changes_of_strain()
        }
        u = spaces.displacement(of_u)
        values = u.x.array.reshape(-1, spaces.dim)[cell_dofs(u.function_space)]
        at_points = np.einsum("sqv,nvr->nsqr", rule.hats, values)
        derivatives |= {f"f.{r}": -self._weights * at_points[..., r] for r in range(spaces.dim)}
        return {name: values.ravel() for name, values in derivatives.items()}

    def _changes_of_strain(self) -> Iterator[tuple[str, Array]]:
        """How the strain changes with each number of the material, shape (cells, d + 1, points, entries)."""
        spaces, sigma = self._spaces, self._at_points(self._solution.stresses)
        for name, _, moved in self._data.material.moved():
            changes = np.empty_like(sigma)
            for cells in blocks_of_cells(spaces.mesh):
                points, stress = self._data.points(spaces, cells), sigma[cells]
                changed = moved.change_of_strain(points, stress.reshape(*points.shape, -1))
                changes[cells] = changed.reshape(stress.shape)
            yield name, changes

    def _at_points(self, values: Array) -> Array:
        """The entries of a stress in the points, shape (cells, d + 1, points, entries), from its values at vertices."""
        at_vertices = np.empty_like(values)
        at_vertices[self._spaces.as_dolfinx(np.arange(len(values), dtype=np.int32))] = values
        return np.einsum("qa,nsae->nsqe", self._data.quadrature.local, to_entries(at_vertices))

    @property
    def _pressure(self) -> Array:
        """The pressure at the vertices with friction, 0 where there is none, shape (facets, d)."""
        return np.maximum(self._spaces.pressure_of(self._solution.outcome.iterate.flux), 0.0)

    def _by_bound(self, x: Array) -> Array:
        """The derivatives by the bounds at the vertices with friction, from λ_û."""
        slip = self._spaces.site_kinds["slip"]
        sides = self._backend.friction.directions(slip.of(self._segment))
        shear = sides * slip.measure * x[slip.unknown]
        return -np.asarray(shear.reshape(-1, self._spaces.dim - 1).sum(axis=1))

    def _of_pressure(self, w: Array) -> PETSc.Vec:
        """λ_û for the functional Σ wμP of the pressure (collective)."""
        normal, slip = self._spaces.site_kinds
        pressing = slip.pressing.ravel()
        lift = np.zeros(len(self._backend.system.load))
        slope = self._backend.friction.slope(self._pressure).ravel()
        lift[normal.unknown[pressing]] = -slope * w / normal.measure[pressing]
        return self._backend.solve_homogeneous(self._conditions, np.zeros_like(lift), lift)


def stiffness_times(data: ElasticData, conditions: SiteConditions, p: Array) -> Array:
    """What springs take from the pressures at facet vertices under conditions and means p; 0 where there are none."""
    if not data.laws.of_parts:
        return np.zeros_like(p)
    springs = data.laws.springs(conditions)
    return np.asarray(np.einsum("nij,nj->ni", springs.stiffness, p.reshape(springs.rest.shape)).ravel())


def linearised(solution: ElasticSolution, tolerance: float) -> LinearisedElasticity:
    """A problem linearised at its solution, with the factors of the solver that has just solved it (collective).

    Raises:
        InputError: If a bound of friction or a datum of a law is not linear, or a tool moves under a given force.
    """
    if solution.data.tools:
        raise InputError("derivatives are not there where a tool moves under a given force")
    if solution.problem.joint:
        raise InputError("derivatives are not there with springs along a joint")
    backend = solution.backend_of(ElasticBackend)
    if backend.friction.in_space:
        backend.turn(backend.friction.turned(solution.spaces.site_kinds["slip"].rows_of(solution.outcome.iterate.p)))
    return LinearisedElasticity(solution, backend, backend.chains, tolerance)
