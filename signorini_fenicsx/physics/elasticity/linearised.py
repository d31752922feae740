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
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.contact.conditions import Condition
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.seen import Seen, derivative_by
from signorini_fenicsx.linear.gmres import gmres
from signorini_fenicsx.physics.elasticity.backend import ElasticBackend
from signorini_fenicsx.physics.elasticity.coulomb import newton, pressure_of
from signorini_fenicsx.physics.elasticity.johnson_mercier import Cells
from signorini_fenicsx.physics.elasticity.moments import on_boundary
from signorini_fenicsx.physics.elasticity.rigid_motions import check_rigid_motions
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution


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
            InputError: If there are laws beside contact and friction, friction in space, or a bound that is not linear.
        """
        self._solution, self._backend = solution, backend
        self._spaces, self._data = spaces, data = solution.spaces, solution.data
        if data.laws.of_parts:
            raise InputError("elastic solutions have no derivatives with laws other than contact and friction")
        if not data.material.plain:
            raise InputError("elastic solutions have derivatives only if they are isotropic, without stress at rest")
        if data.friction is not None and spaces.dim == 3:
            raise InputError("elastic solutions in space have no derivatives with friction")  # slip may turn
        self._conditions = solution.outcome.conditions
        normal = len(spaces.sites)
        self._held = self._conditions.kind == Condition.ZERO_TRACE
        self._signs: Array = np.zeros(len(spaces.slip_sites))  # of the bound, in σ_t
        if data.friction is not None:
            segments = data.friction.chains.segments(self._conditions.take(slice(normal, None)))
            self._signs = data.friction.directions(segments)
        shares = Cells(spaces.vertices).measure[:, None, None] / (spaces.dim + 1)
        weights = np.broadcast_to(data.quadrature.weights, (spaces.dim + 1, len(data.quadrature.weights)))
        self._weights = shares * weights  # of the points of the quadrature, shape (cells, d + 1, points)
        self._in_cells = dict(self._points())
        self._moments = {name: (kind, moments) for kind, name, moments in on_boundary(spaces, data, solution.problem)}
        self.seen = self._in_cells | {name: moments.seen for name, (_, moments) in self._moments.items()}
        sizes = [float(np.abs(each).max(initial=0.0)) for each in (solution.u.x.array, solution.stresses)]
        largest = np.array(sizes)
        spaces.mesh.comm.Allreduce(MPI.IN_PLACE, largest, MPI.MAX)
        law, iterate = backend.chains, solution.outcome.iterate
        of_p, of_flux = (np.full(backend.sites, size if size > 0 else 1.0) for size in largest)
        present = law.segments(self._conditions)
        self.biactive = law.beside(present, iterate.p, iterate.flux, (of_p, of_flux), tolerance) != 0

    def _points(self) -> Iterator[tuple[str, Seen]]:
        """The data that are seen by their values in the points of the quadrature (collective)."""
        mesh, rule = self._spaces.mesh, self._data.quadrature
        forces = {f"f.{r}": component for r, component in enumerate(self._data.f.components)}
        given = {"young": self._data.material.young[0], "poisson": self._data.material.poisson[0], **forces}
        if any(datum.pieces is None for datum in given.values()):
            whole = basix.make_quadrature(mesh.basix_cell(), 0)[1].sum()  # the measure of the reference cell
            weights = np.tile(rule.weights, self._spaces.dim + 1) * whole / (self._spaces.dim + 1)
            element = basix.ufl.quadrature_element(mesh.basix_cell(), points=rule.points, weights=weights)
            space = fenicsx.function_space(mesh, element)
            for name, datum in given.items():
                if datum.pieces is None:
                    yield name, Seen(_in_points(datum), space, space.dofmap.list.ravel(), self._weights.ravel())

    def places(self) -> Array:
        """The vertices of the biactive sites of this rank, shape (sites, dim)."""
        dim = self._spaces.dim
        vertices = [each.vertices.reshape(-1, dim) for each in (self._spaces.contact, self._spaces.rough)]
        return np.concatenate(vertices)[self.biactive]

    def change(self, changes: Mapping[str, Array]) -> dict[str, fem.Function | None]:
        """The changes of σ and u with what is seen; there is no p (collective).

        Raises:
            InputError: If there are biactive sites.
        """
        spaces, data, size = self._spaces, self._data, len(self._backend.system.load)
        number = spaces.mesh.comm.allreduce(int(np.count_nonzero(self.biactive)))
        if number > 0:
            sites = counted(number, "site")
            raise InputError(f"derivative: {sites} may leave a corner of contact or friction, so there is none")
        numbers = {"lift": np.zeros_like(data.lift), "load": np.zeros_like(data.lift)}
        numbers |= {kind: np.zeros(len(spaces.slip_sites)) for kind in ("bound", "mu")}
        for name, (kind, moments) in self._moments.items():
            moments.add(numbers[kind], changes[name])
        lift = fem.Function(spaces.traces).x
        lift.array[:size][self._given] = numbers["lift"][:size][self._given]
        lift.scatter_forward()

        given = *self._by_changes(changes), lift.array.astype(np.float64)

        def responded(bound: Array) -> tuple[Array, Array, Array]:
            forces = numbers["load"][:size].copy()
            forces[spaces.slip_sites] += self._signs * spaces.slip_measure * bound

            def solve(load: Array) -> Array:
                return self._backend.solve_homogeneous(self._conditions, load + forces)

            return self._backend.system.respond(*given, solve)

        stresses, u, _ = responded(numbers["bound"])
        if data.friction is not None and data.friction.by_pressure:
            moved = pressure_of(spaces, -spaces.normal_stress(stresses)).ravel()
            left = numbers["mu"] * self._pressure + self._slope * moved
            of_pressure = newton(self._backend, self._solution.outcome, left.reshape(-1, 2)).ravel()
            stresses, u, _ = responded(numbers["bound"] + of_pressure)
        return {"sigma": spaces.split.stress(stresses), "u": spaces.displacement(u), "p": None}

    def _by_changes(self, changes: Mapping[str, Array]) -> tuple[Array, Array]:
        """The functional of τ and the moments of f that the changes of data in cells give (collective)."""
        spaces, rule, shape = self._spaces, self._data.quadrature, self._weights.shape
        sigma = self._at_points(self._solution.stresses)
        by_inverse, by_both = np.zeros(shape), np.zeros(shape)
        for name, (inverse, both) in zip(("young", "poisson"), self._by_moduli(), strict=True):
            if name in changes:
                by_inverse += inverse.reshape(shape) * changes[name].reshape(shape)
                by_both += both.reshape(shape) * changes[name].reshape(shape)
        strain = by_inverse[..., None, None] * sigma
        strain -= (by_both * np.einsum("nsqii->nsq", sigma))[..., None, None] * np.eye(spaces.dim)
        stresses = -np.einsum("nsq,qa,nsqij->nsaij", self._weights, rule.local, strain, optimize=True)
        none = np.zeros(shape)
        f = np.stack([changes.get(f"f.{r}", none).reshape(shape) for r in range(spaces.dim)], axis=-1)
        moments = np.einsum("nsq,sqv,nsqr->nvr", self._weights, rule.hats, f, optimize=True)
        cells = np.arange(len(spaces.order), dtype=np.int32)
        return stresses[spaces.as_dolfinx(cells)], np.take_along_axis(moments, spaces.order[:, :, None], axis=1)

    @property
    def _given(self) -> Mask:
        """Where û is given, of the owned unknowns."""
        found = np.zeros(len(self._backend.system.load), dtype=bool)
        found[self._data.fixed] = found[self._sites[self._held]] = True
        return found

    def adjoint(self, J: Form, _more: float = 0.0) -> dict[str, Array]:
        """The derivatives of J by all that is seen, but for where the data stand in J itself (collective)."""
        spaces, data, size = self._spaces, self._data, len(self._backend.system.load)
        by_sigma, by_u = (derivative_by(each, J, ()) for each in (self._solution.sigma, self._solution.u))
        stresses, moments = spaces.split.values(by_sigma), -spaces.displacement_values(by_u)
        state = self._responded(stresses, moments)
        w = np.zeros(0)
        if data.friction is not None and data.friction.by_pressure:
            w = self._of_pressure(self._by_bound(state[2]))
            state = self._responded(stresses, moments, w)
        adjoint, of_u, x = state
        forces = self._backend.system.forces(adjoint)
        by = {
            "lift": np.where(self._given, forces, 0.0),
            "load": -x[:size],
            "bound": self._by_bound(x),
            "mu": w * self._pressure if len(w) else np.zeros(len(spaces.slip_sites)),
        }
        return self._by_points(adjoint, of_u) | {
            name: moments.sensitivities(by[kind]) for name, (kind, moments) in self._moments.items()
        }

    def _by_points(self, adjoint: Array, of_u: Array) -> dict[str, Array]:
        """The derivatives by the data in the points of the quadrature (collective)."""
        if not self._in_cells:
            return {}
        spaces, rule = self._spaces, self._data.quadrature
        sigma, lam = (self._at_points(values) for values in (self._solution.stresses, adjoint))
        inner = np.einsum("nsqij,nsqij->nsq", sigma, lam)
        traces = np.einsum("nsqii->nsq", sigma) * np.einsum("nsqii->nsq", lam)
        found = {
            name: -self._weights * (by_inverse.reshape(inner.shape) * inner - by_both.reshape(inner.shape) * traces)
            for name, (by_inverse, by_both) in zip(("young", "poisson"), self._by_moduli(), strict=True)
        }
        u = spaces.displacement(of_u)
        values = u.x.array.reshape(-1, spaces.dim)[u.function_space.dofmap.list]
        at_points = np.einsum("sqv,nvr->nsqr", rule.hats, values)
        found |= {f"f.{r}": -self._weights * at_points[..., r] for r in range(spaces.dim)}
        return {name: values.ravel() for name, values in found.items()}

    def _by_moduli(self) -> list[tuple[Array, Array]]:
        """The derivatives of 1/2μ and θ/2μ by E and by ν in the points, shape (cells, points) (collective)."""
        cells = np.arange(len(self._spaces.order), dtype=np.int32)
        points = self._data.points(self._spaces, cells)
        material = self._data.material
        young, poisson = material.young[0].values(points), material.poisson[0].values(points)
        share = poisson if material.in_strain else np.zeros_like(poisson)  # θ/2μ = ν(1 + share)/E
        of_young = [-(1 + poisson) / young**2, -poisson * (1 + share) / young**2]
        return [(of_young[0], of_young[1]), (1 / young, (1 + 2 * share) / young)]

    def _at_points(self, values: Array) -> Array:
        """A stress in the points of the quadrature, shape (cells, d + 1, points, d, d), from its values at vertices."""
        there = np.empty_like(values)
        there[self._spaces.as_dolfinx(np.arange(len(values), dtype=np.int32))] = values
        return np.einsum("qa,nsaij->nsqij", self._data.quadrature.local, there)

    @property
    def _sites(self) -> Array:
        """The unknown of each site."""
        return np.concatenate([self._spaces.sites, self._spaces.slip_sites])

    @property
    def _pressure(self) -> Array:
        """The pressure at the sites with friction, 0 where there is none."""
        return np.maximum(pressure_of(self._spaces, self._solution.outcome.iterate.flux).ravel(), 0.0)

    def _by_bound(self, x: Array) -> Array:
        """The derivatives by the bounds at the sites with friction, from λ_û."""
        return -self._signs * self._spaces.slip_measure * x[self._spaces.slip_sites]

    def _responded(self, stresses: Array, moments: Array, w: Array | None = None) -> tuple[Array, Array, Array]:
        """Σ, u and x for a functional of σ, moments of f and a functional of the pressure (collective)."""
        spaces, x = self._spaces, fem.Function(self._spaces.traces, dtype=np.float64).x
        if w is not None and len(w):
            rows = np.arange(len(spaces.sites)).reshape(-1, spaces.dim)[spaces.rough_rows].ravel()
            x.array[spaces.sites[rows]] = -self._slope * w / spaces.site_measure[rows]
        x.scatter_forward()
        return self._backend.system.respond(
            stresses,
            moments,
            x.array.astype(np.float64),
            lambda load: self._backend.solve_homogeneous(self._conditions, load),
        )

    @property
    def _slope(self) -> Array:
        """The slope of the bounds by the pressure at the sites with friction."""
        friction = self._data.friction
        assert friction is not None
        return friction.slope(self._pressure.reshape(friction.mu.shape)).ravel()

    def _of_pressure(self, right: Array) -> Array:
        """W with w − T'ᵀw = ∂J/∂b (collective)."""
        shape = self._solution.stresses.shape
        none = np.zeros(shape), np.zeros((*shape[:2], shape[-1]))
        return gmres(self._backend.comm, lambda w: w - self._by_bound(self._responded(*none, w)[2]), right)


def _in_points(datum: Datum) -> Callable[[Expr], Form]:
    """∫ datum · v, v in a quadrature element, whose points are taken."""
    return lambda v: datum.ufl * v * ufl.dx


def linearised(solution: ElasticSolution, tolerance: float) -> Linearised:
    """A problem linearised at its solution, with the factors of the solver that has just solved it (collective).

    Raises:
        InputError: If there are laws beside contact and friction, friction in space, or a bound that is not linear.
    """
    system = None if solution.system is None else solution.system()
    backend = None if system is None else system.backend_of(solution.outcome)
    if backend is None:
        motions = check_rigid_motions(solution.spaces, solution.data)
        backend = ElasticBackend(solution.spaces, solution.data, solution.options.tuning, motions)
    return Linearised(solution, backend, tolerance)
