"""The projection iterations for (MLM-I)_h and (MLM-II)_h: in σ·n or in p, in L²(Γ_S) or in H^{1/2}(Γ_S).

With the discrete Dirichlet-to-Neumann map S on Λ_h, σ·n = Sp + g_0 for given p and p = S⁻¹(σ·n − g_0) for given σ·n.
The spectrum of S reaches from O(1) to O(1/h), so

    mixed-uzawa1     σ·n ← max(0, σ·n − ρp)         converges for ρ < 2 λ_min(S),
    mixed-uzawa2     p ← max(0, p − ρσ·n)           converges for ρ < 2/λ_max(S),

both in O(1/h) iterations. Each iteration is a back substitution; there is one factorisation for all. mixed-uzawa-h12
projects in H^{1/2}(Γ_S) instead, and its number of iterations does not depend on h (see `half_uzawa`).

*A discrete H^{1/2}(Γ_S) inner product on Λ_h, its Riesz map and its projection onto p ≥ 0*.

The facet Laplacian K has a two-point flux between facets that share a vertex (2D) or an edge (3D), and p = 0 beyond the
end of Γ_S, as in H_00^{1/2}. With the mass matrix M = diag(|e|) and L = |Ω|^(1/d),

    H = M^{1/2} (M^{-1/2} K M^{-1/2} + L⁻²)^{1/2} M^{1/2},

where the square root is computed by eigenvectors. H, like K, has no positive entry off its diagonal, because the square
root of an M-matrix is an M-matrix. So the primal-dual active set method for the projection ends after finitely many
steps.
"""

import itertools
import math
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import scipy.linalg
import ufl

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.parallel import on_root, on_root_only
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.classical.gathered import RootRows
from signorini_fenicsx.physics.diffusion.solve.classical.projection import (
    StepLength,
    iterate_projection,
    scattered_values,
    step_length,
)
from signorini_fenicsx.physics.diffusion.solve.mixed import MixedBackend
from signorini_fenicsx.physics.diffusion.solve.recorder import Recorder
from signorini_fenicsx.physics.diffusion.solve.task import DiffusionTask


class HalfNorm:
    """(p, q)_H = pᵀHq on distributed facet arrays; dense algebra on rank 0. All methods are collective."""

    def __init__(self, spaces: Spaces):
        """Gather the facets and take the square root."""
        mesh = spaces.mesh
        dim = mesh.topology.dim
        self._rows = RootRows(mesh.comm, len(spaces.facets))
        mesh.topology.create_connectivity(dim - 1, dim)
        nodes = dolfinx.mesh.entities_to_geometry(mesh, dim - 1, spaces.facets).reshape(-1, dim)
        table = mesh.geometry.input_global_indices[nodes], mesh.geometry.x[nodes], spaces.facet_measure
        columns: list[Any] = [self._rows.gather(each) for each in table]
        self._alone = on_root_only(mesh.comm, lambda: _Dense(spaces.length, *columns))

    def inner(self, p: Array, q: Array) -> float:
        """(p, q)_H."""
        return on_root(self._rows.comm, self._action(_Dense.inner, p, q))

    def riesz(self, flux: Array) -> Array:
        """Rg, the p with (p, q)_H = (g, q) on Γ_S for all q."""
        return self._rows.scatter(on_root_only(self._rows.comm, self._action(_Dense.riesz, flux)))

    def project(self, p: Array, flux: Array) -> Array:
        """The H-projection of p − R flux onto q ≥ 0: the minimiser of ½qᵀHq − qᵀ(Hp − M flux) over q ≥ 0."""
        return self._rows.scatter(on_root_only(self._rows.comm, self._action(_Dense.project, p, flux)))

    def _action[T](self, method: Callable[..., T], *columns: Array) -> Callable[[], T]:
        """What rank 0 makes of some arrays by a method of `_Dense`."""
        rows = self._rows.gather(np.column_stack(columns))
        return lambda: method(self._alone, *([] if rows is None else rows.T))


class _Dense:
    """H of all facets, and what `HalfNorm` does, on one rank."""

    def __init__(self, length: float, vertices: npt.NDArray[np.int64], corners: Array, measure: Array):
        laplacian = _facet_laplacian(vertices, corners)
        root, self._measure = np.sqrt(measure), measure
        values, vectors = np.linalg.eigh(laplacian / np.outer(root, root) + np.eye(len(root)) / length**2)
        self._matrix = root[:, None] * ((vectors * np.sqrt(values)) @ vectors.T) * root
        self._factor = scipy.linalg.cho_factor(self._matrix)
        self._free = np.ones(len(root), dtype=bool)

    def inner(self, p: Array, q: Array) -> float:
        return float(p @ self._matrix @ q)

    def riesz(self, flux: Array) -> Array:
        return scipy.linalg.cho_solve(self._factor, self._measure * flux)

    def project(self, p: Array, flux: Array) -> Array:
        """The projection, by a primal-dual active set that starts from the last free set.

        There q = 0 or Hq = b, until both q and Hq − b are ≥ 0.
        """
        matrix, b = self._matrix, self._matrix @ p - self._measure * flux
        q = np.zeros_like(b)
        for _ in range(len(b) + 1):
            free = self._free
            q = np.zeros_like(b)
            q[free] = scipy.linalg.solve(matrix[np.ix_(free, free)], b[free], assume_a="pos")
            reaction = np.where(free, 0.0, matrix @ q - b)
            self._free = q - reaction > 0
            if np.array_equal(self._free, free):
                break
        return np.maximum(q, 0.0)


def _facet_laplacian(vertices: npt.NDArray[np.int64], corners: Array) -> Array:
    """K, from the vertex numbers, shape (facets, d), and the corners of each facet, shape (facets, d, 3)."""
    size, dim = vertices.shape
    middle = corners.mean(axis=1)
    ridges = defaultdict(list)  # facets around each vertex (2D) or edge (3D), with its place and measure
    for facet, local in itertools.product(range(size), itertools.combinations(range(dim), dim - 1)):
        points = corners[facet, list(local)]
        measure = float(np.linalg.norm(points[-1] - points[0])) if dim == 3 else 1.0
        ridges[tuple(sorted(vertices[facet, list(local)].tolist()))].append((facet, points.mean(axis=0), measure))
    laplacian = np.zeros((size, size))
    for around in ridges.values():
        distance = sum(float(np.linalg.norm(middle[facet] - place)) for facet, place, _ in around)
        conductance = around[0][2] / distance
        for facet, _, _ in around:
            laplacian[facet, facet] += conductance
        for (one, _, _), (two, _, _) in itertools.permutations(around, 2):
            laplacian[one, two] -= conductance
    return laplacian


class _Response:
    """The iterate that belongs to facet values x: σ·n = x or p = x on Γ_S."""

    def __init__(self, task: DiffusionTask, *, by_flux: bool):
        self._system = MixedBackend(task.spaces, task.data)
        self._by_flux = by_flux
        kind = Condition.NO_FLUX if by_flux else Condition.ZERO_TRACE
        self._given = SiteConditions.everywhere(kind, len(task.spaces.facets))
        self.start = np.zeros(len(task.spaces.facets))
        self.gradient(self.start)
        self.scale = _scale(task.spaces, self.iterate)
        self._recorder = Recorder(task.spaces, self.iterate, self._conditions(self.start), task.on_step)

    def gradient(self, x: Array) -> Array:
        """The trace p for given σ·n, or σ·n for given p; the iterate is kept (collective)."""
        self.iterate: Iterate = self._system.respond(self._given, flux=x, trace=x)
        return self.iterate.p if self._by_flux else self.iterate.flux

    def slope(self, x: Array) -> Array:
        """The linear part of `gradient`, S⁻¹ or S, applied to x (collective)."""
        response = self._system.respond(self._given, flux=x, trace=x, loaded=False)
        return response.p if self._by_flux else response.flux

    def record(self, x: Array) -> None:
        """Add the current iterate to the history (collective)."""
        self._recorder.add(self.iterate, self._conditions(x))

    def outcome(self, x: Array, step: StepLength, failure: str | None) -> Outcome:
        """The outcome of the iteration."""
        state, reason = (self.iterate, self._conditions(x)), failure or "the last step is below the tolerance"
        system = self._system.name, self._system.dofs, self._system.solver()
        return self._recorder.outcome(state, reason, system, converged=failure is None, details=step.details())

    def _conditions(self, x: Array) -> SiteConditions:
        at_bound, free = (
            (Condition.NO_FLUX, Condition.ZERO_TRACE) if self._by_flux else (Condition.ZERO_TRACE, Condition.NO_FLUX)
        )
        return SiteConditions(np.where(x > 0, free, at_bound).astype(np.int8))


def flux_uzawa(task: DiffusionTask) -> Outcome:
    """σ·n^(n) = max(0, σ·n^(n−1) − ρp^(n−1)), from σ·n^(0) = 0 (collective).

    The step divided by ρ is a trace; it is measured like the KKT residual of p ≥ 0.
    """
    return _pointwise(task, by_flux=True)


def trace_uzawa(task: DiffusionTask) -> Outcome:
    """p^(n) = max(0, p^(n−1) − ρσ·n^(n−1)), from p^(0) = 0 (collective).

    The step divided by ρ is a flux; it is measured like the KKT residual of σ·n ≥ 0.
    """
    return _pointwise(task, by_flux=False)


def _pointwise(task: DiffusionTask, *, by_flux: bool) -> Outcome:
    response, length = _Response(task, by_flux=by_flux), task.spaces.length
    unit = 1 / length if by_flux else length

    def inner(x: Array, y: Array) -> float:
        return float(task.spaces.mesh.comm.allreduce(float(task.spaces.facet_measure @ (x * y))))

    return _projected(task, response, response.slope, inner, lambda x, change: np.maximum(0, x - change), unit)


def half_uzawa(task: DiffusionTask) -> Outcome:
    """p^(n) = P(p^(n−1) − ρ R σ·n^(n−1)) in H^{1/2}(Γ_S), from p^(0) = 0 (collective).

    R is the Riesz map of the discrete H^{1/2} inner product (p, q)_H = pᵀHq (see `HalfNorm`), R = H⁻¹M with M the mass
    matrix of Λ_h. The projection is that of this inner product,

        P(z) = argmin over q ≥ 0 of ½(q − z)ᵀH(q − z),

    a small bound-constrained quadratic programme, which is solved exactly. Its fixed points solve (10c) because
    (z − P(z), q − P(z))_H ≤ 0 for all q ≥ 0; max(0, z), facet by facet, would have other fixed points. H is spectrally
    equivalent to S, so the number of iterations is bounded as h → 0. The algebra is dense and on rank 0, so this is for
    up to a few thousand Γ_S facets.
    """
    response, half = _Response(task, by_flux=False), HalfNorm(task.spaces)
    return _projected(task, response, lambda x: half.riesz(response.slope(x)), half.inner, half.project)


def _projected(
    task: DiffusionTask,
    response: _Response,
    slope: Callable[[Array], Array],
    inner: Callable[[Array, Array], float],
    project: Callable[[Array, Array], Array],
    unit: float = 1.0,
) -> Outcome:
    """The outcome of the iteration with these operators, in whose inner product steps of size 1/√unit are 1."""
    step = step_length(task.rho, slope, inner, scattered_values(task.spaces))
    x, failure = iterate_projection(
        response.start,
        response.gradient,
        project,
        lambda change: math.sqrt(unit * max(inner(change, change), 0.0)) / response.scale,
        step=step,
        max_iterations=task.max_iterations,
        record=response.record,
    )
    return response.outcome(x, step, failure)


def _scale(spaces: Spaces, iterate: Iterate) -> float:
    """‖σ‖ of the start, or 1 if it is 0 (collective)."""
    return math.sqrt(spaces.integrate(l2(iterate.sigma, ufl.dx))) or 1.0
