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

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.owned import cell_dofs
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.contact.conditions import Condition
from signorini_fenicsx.contact.loop import settled_change
from signorini_fenicsx.discrete.seen import Seen, derivative_by
from signorini_fenicsx.discrete.simplices import blocks_of_cells
from signorini_fenicsx.linear.gmres import gmres
from signorini_fenicsx.physics.elasticity.derivative.moments import Moments, of_laws, on_boundary
from signorini_fenicsx.physics.elasticity.derivative.tangent import Tangent, stiffness_times
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells, entries, to_entries, to_matrices
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.backend import ElasticBackend


class Linearised:
    """A problem linearised at its solution.

    Attributes:
        seen: What the discrete problem sees of each datum that is given in UFL: its values in the points of a
            quadrature, or moments on the boundary.
        biactive: Mask of the sites on a corner of their law.
    """

    def __init__(self, solution: ElasticSolution, backend: ElasticBackend, tolerance: float):
        """Take a solution and what solves under its conditions (collective).

        Raises:
            InputError: If a bound of friction or a datum of a law is not linear.
        """
        self._solution, self._backend = solution, backend
        self._spaces, self._data = spaces, data = solution.spaces, solution.data
        self._conditions = solution.outcome.conditions
        self._normal, self._slip = spaces.site_kinds
        self._held = self._conditions.kind == Condition.ZERO_TRACE
        self._segment = backend.chains.segments(
            self._conditions, (solution.outcome.iterate.p, solution.outcome.iterate.flux)
        )
        self._signs: Array = backend.friction.directions(self._slip.of(self._segment))  # of the bound, in σ_t
        shares = Cells(spaces.vertices).measure[:, None, None] / (spaces.dim + 1)
        weights = np.broadcast_to(data.quadrature.weights, (spaces.dim + 1, len(data.quadrature.weights)))
        self._weights = shares * weights  # of the points of the quadrature, shape (cells, d + 1, points)
        self._materials = {name: moved for name, _, moved in data.material.moved()}
        self._in_cells = dict(self._points())
        self._moments = {name: (kind, moments) for kind, name, moments in on_boundary(spaces, data, solution.problem)}
        self._moments |= self._of_laws(self._segment)
        self.seen = self._in_cells | {name: moments.seen for name, (_, moments) in self._moments.items()}
        self._beside = self._segments_beside(tolerance)
        self.biactive = self._beside != 0

    def _of_laws(self, segment: Indices) -> dict[str, tuple[str, Moments]]:
        """The moments of the data of laws, if sites are on these segments (collective)."""
        laws, opening = self._solution.data.laws, self._solution.gap.ravel()
        moments = of_laws(self._spaces, laws, self._normal.of(segment), opening)
        return {name: (kind, each) for kind, name, each in moments}

    def _segments_beside(self, tolerance: float) -> Indices:
        """Which way the other segment is of each site that is on a corner; 0 at other sites (collective).

        In space a vertex with friction is on one if it slips by little, or sticks with a shear near its bound.
        """
        solution, backend, friction = self._solution, self._backend, self._backend.friction
        sizes = np.array([np.abs(each).max(initial=0.0) for each in (solution.u.x.array, solution.stresses)])
        self._spaces.mesh.comm.Allreduce(MPI.IN_PLACE, sizes, MPI.MAX)
        u, stress = np.where(sizes > 0, sizes, 1.0)
        p, flux = solution.outcome.iterate.p, solution.outcome.iterate.flux
        scales = np.full(backend.sites, u), np.full(backend.sites, stress)
        direction = backend.chains.beside(self._segment, p, flux, scales, tolerance)
        if friction.slipping is not None:
            slip, shear = (np.linalg.norm(self._slip.of(each).reshape(-1, 2), axis=1) for each in (p, flux))
            bound, sticks = friction.bound.ravel(), friction.sticks.ravel()
            near = np.where(sticks, bound - shear <= tolerance * stress, slip <= tolerance * u)
            self._slip.of(direction)[:] = np.repeat(near & (bound > 0), 2)
        return direction

    def _points(self) -> Iterator[tuple[str, Seen]]:
        """The data that are seen by their values in the points of the quadrature (collective)."""
        mesh, rule = self._spaces.mesh, self._data.quadrature
        forces = enumerate(self._data.f.components)
        numbers = {f"f.{r}": component.ufl for r, component in forces if component.pieces is None}
        numbers |= {name: number for name, number, _ in self._data.material.moved()}
        if numbers:
            whole = basix.make_quadrature(mesh.basix_cell(), 0)[1].sum()  # the measure of the reference cell
            weights = np.tile(rule.weights, self._spaces.dim + 1) * whole / (self._spaces.dim + 1)
            element = basix.ufl.quadrature_element(mesh.basix_cell(), points=rule.points, weights=weights)
            space = fenicsx.function_space(mesh, element)
            for name, number in numbers.items():
                yield name, Seen(_in_points(number), space, cell_dofs(space).ravel(), self._weights.ravel())

    def places(self) -> Array:
        """The vertices of the biactive sites of this rank, shape (sites, dim)."""
        return self._backend.places()[self.biactive, : self._spaces.dim]

    def change(self, changes: Mapping[str, Array]) -> dict[str, fem.Function | None]:
        """The changes of σ and u with what is seen; there is no p (collective).

        A biactive site moves along one of the two segments that meet there.

        Raises:
            InputError: If vertices may begin or cease to slip in space, or leave the end of a slope.
            NumericalFailure: If the sets of biactive sites do not settle.
        """
        spaces, backend, normal = self._spaces, self._backend, self._normal
        comm, size = spaces.mesh.comm, len(backend.system.load)
        numbers = {kind: np.zeros(size) for kind in ("lift", "load")}
        numbers |= {kind: np.zeros(spaces.dim * len(spaces.rough_rows)) for kind in ("bound", "mu")}
        numbers |= {kind: np.zeros(len(normal)) for kind in ("law", "beside")}
        for name, (kind, moments) in self._moments.items():
            moments.add(numbers[kind], changes[name])
        for name, (_, moments) in self._of_laws(self._segment + self._beside).items():
            moments.add(numbers["beside"], changes[name])
        below = self._beside < 0
        pair = self._segment + np.minimum(self._beside, 0), self._segment + np.maximum(self._beside, 0)
        laws = np.where(normal.of(below), numbers["beside"], numbers["law"])
        of_laws = laws, np.where(normal.of(below), numbers["law"], numbers["beside"])

        def solve(load: Array) -> Array:
            load = load + numbers["load"]
            tangent = Tangent(backend, self._data, pair, numbers, of_laws, self._pressure, load)
            turning = self.biactive & (np.arange(backend.sites) >= len(normal)) & (spaces.dim == 3)
            number, refused = comm.allreduce(
                np.array([np.count_nonzero(self.biactive), np.count_nonzero(turning | tangent.sloped)])
            ).tolist()
            if refused > 0:
                sites = counted(refused, "site")
                raise InputError(f"derivative: {sites} may begin to turn in space, or leave a spring, so there is none")
            start = tangent.chains.conditions(below.astype(np.int64))
            settled_change(tangent, start, number, self._solution.options.max_iterations)
            return backend.system.everywhere(tangent.x)

        stresses, u, _ = backend.system.respond(*self._by_changes(changes), solve=solve)
        return {"sigma": spaces.split.stress(stresses), "u": spaces.displacement(u), "p": None}

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

    @property
    def _given(self) -> Mask:
        """Mask of the owned unknowns that are given values of û."""
        is_given = np.zeros(len(self._backend.system.load), dtype=bool)
        is_given[self._data.fixed] = True
        is_given[self._spaces.site_kinds.unknown[self._held]] = True
        return is_given

    def adjoint(self, J: Form, of_slip: Array | None = None) -> dict[str, Array]:
        """The derivatives of J by all that is seen, but for where the data stand in J itself (collective).

        Args:
            J: What is differentiated.
            of_slip: The derivative by û_t at the sites with friction of what is differentiated besides; None if nothing
                is.

        Returns:
            The derivatives, with "slipped" that by û_t of the step before.
        """
        spaces, backend, w, (normal, slip) = self._spaces, self._backend, np.zeros(0), self._spaces.site_kinds
        of_slip = np.zeros(len(slip)) if of_slip is None else of_slip
        friction = backend.friction
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
        pull, lift = normal.measure * x[normal.unknown], np.where(self._given, forces, 0.0)
        lift[normal.unknown] -= stiffness_times(self._data, normal.of(self._conditions), pull)
        of_stick, slipping = forces[slip.unknown] + of_slip, -slip.measure * friction.resisted(x[slip.unknown])
        by = {
            "lift": lift,
            "load": -x[: len(lift)],
            "bound": self._by_bound(x),
            "mu": w * self._pressure.ravel() if len(w) else np.zeros(spaces.dim * len(spaces.rough_rows)),
            "law": np.where(normal.of(self._held), -forces[normal.unknown], pull),
        }
        return (
            self._by_points(adjoint, of_u)
            | {name: moments.sensitivities(by[kind]) for name, (kind, moments) in self._moments.items()}
            | {"slipped": np.where(slip.of(self._held), of_stick, slipping)}
        )

    def _by_points(self, adjoint: Array, of_u: Array) -> dict[str, Array]:
        """The derivatives by the data in the points of the quadrature (collective)."""
        if not self._in_cells:
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
        if not self._materials:
            return
        spaces, sigma = self._spaces, self._at_points(self._solution.stresses)
        for name, moved in self._materials.items():
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
        shear = self._signs * self._slip.measure * x[self._slip.unknown]
        return -np.asarray(shear.reshape(-1, self._spaces.dim - 1).sum(axis=1))

    def _of_pressure(self, w: Array) -> PETSc.Vec:
        """λ_û for the functional Σ wμP of the pressure (collective)."""
        normal, pressing = self._normal, self._slip.pressing.ravel()
        lift = np.zeros(len(self._backend.system.load))
        slope = self._backend.friction.slope(self._pressure).ravel()
        lift[normal.unknown[pressing]] = -slope * w / normal.measure[pressing]
        return self._backend.solve_homogeneous(self._conditions, np.zeros_like(lift), lift)


def _in_points(number: Expr) -> Callable[[Expr], Form]:
    """∫ number · v, v in a quadrature element, whose points are taken."""
    return lambda v: number * v * ufl.dx


def linearised(solution: ElasticSolution, tolerance: float) -> Linearised:
    """A problem linearised at its solution, with the factors of the solver that has just solved it (collective).

    Raises:
        InputError: If a bound of friction or a datum of a law is not linear, or a tool moves under a given force.
    """
    if solution.data.tools:
        raise InputError("derivatives are not there where a tool moves under a given force")
    system = None if solution.system is None else solution.system()
    backend = None if system is None else system.kept.of(solution.outcome, ElasticBackend)
    if backend is None:
        backend = ElasticBackend(solution.spaces, solution.data, solution.options.tuning)
    if backend.friction.slipping is not None:
        backend.turn(backend.friction.turned(solution.spaces.site_kinds["slip"].rows_of(solution.outcome.iterate.p)))
    return Linearised(solution, backend, tolerance)
