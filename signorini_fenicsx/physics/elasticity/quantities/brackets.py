"""Intervals for quantities of elastic contact, see `bracket` for the theorem.

With ε(v), 𝔸 and g − v_n in the places of ∇v, κ⁻¹ and v − ψ, and the work of the friction as one more law, it is the
same. For forces see `motions`. Under Coulomb's friction it is Tresca's problem with the last bound of the shear.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.certificate.certificate import reservation
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.discrete.datum import quadrature_degree
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, opposite
from signorini_fenicsx.discrete.points import Points, facet_quadrature
from signorini_fenicsx.expressions import TREES
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.expressions.products import products
from signorini_fenicsx.meshes.domain import Domain, other_side
from signorini_fenicsx.physics.elasticity.bound.certify import (
    LACKING,
    TRESCA,
    UNBALANCED,
    gap_of_cells,
    lacked,
    not_in_the_spaces,
    with_surface,
)
from signorini_fenicsx.physics.elasticity.bound.conforming import BestDisplacement
from signorini_fenicsx.physics.elasticity.bound.equilibrated import AdmissibleStress, admissible_stress
from signorini_fenicsx.physics.elasticity.bound.oscillation import load_oscillation
from signorini_fenicsx.physics.elasticity.bound.resolution import Resolution
from signorini_fenicsx.physics.elasticity.discrete.friction import FromBefore
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.quantities.energy import Along, degree_of_v, energy
from signorini_fenicsx.physics.elasticity.quantities.motions import (
    OPPOSITE,
    check_parts,
    components,
    direction_of,
    foundations,
    moved,
    unseen_work,
)
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.residuals import energy_squares, resultants
from signorini_fenicsx.quantities import beside
from signorini_fenicsx.quantities.beside import Beside, added, check_part, in_regions
from signorini_fenicsx.quantities.bracket import Half
from signorini_fenicsx.quantities.kinds import Energy, Force, Integral, Kind, Moment
from signorini_fenicsx.quantities.of_solution import Quantities

STEP = "the exact solution of the step after the computed slip of the last one"
"""Of what the quantities of a step in time with friction are."""


def named_for(solution: ElasticSolution) -> str:
    """Of which solution the quantities are, in words; empty if it is that of the problem itself."""
    friction, of = solution.data.friction, []
    if friction:
        of = [STEP] * (solution.step is not None) + [TRESCA] * friction.by_pressure
    return with_surface(solution, " and ".join(of))


def check(domain: Domain, problem: ElasticProblem, kind: Kind) -> None:
    """Refuse what is no quantity of a problem (collective).

    Raises:
        InputError: If a name is unknown, or the quantity is not one of elastic contact.
    """
    if isinstance(kind, Energy):
        return
    if isinstance(kind, Force):
        check_parts(domain, problem.boundary, kind)
        moved(domain, problem, kind, 0.0)
    elif isinstance(kind, Integral):
        _loaded(domain, problem, kind, 0.0)
        _pulls(domain, problem.boundary, kind, 0.0)
    else:
        raise InputError(f"{type(kind).__name__}: elastic contact has Integral, Mean, Force, Moment and Energy")


def _loaded(domain: Domain, problem: ElasticProblem, kind: Integral, tau: float) -> ElasticProblem:
    """The problem whose force per volume is larger by τ weight·direction; for parts see `_pulls` (collective).

    Raises:
        InputError: If a name is unknown, or the weight no number or text.
    """
    dim = domain.mesh.geometry.dim
    if not isinstance(parsed(kind.weight, "xyz"[:dim], "weight"), TREES):
        raise InputError("weight: must be a number or a text")
    if kind.parts:
        return problem
    load, along = components(problem.f, dim), direction_of(kind.direction, dim)
    f = [
        in_regions(domain, each, kind.weight, kind.region, tau * share) for each, share in zip(load, along, strict=True)
    ]
    return replace(problem, f=f)


def _pulls(domain: Domain, boundary: ElasticBoundary, kind: Integral, tau: float) -> dict[str, Any]:
    """The tractions τ weight·direction on parts, or the pressures −τ weight for the normal direction.

    Where two bodies touch they act on both, against each other.

    Raises:
        InputError: If a part is unknown, or u is given on it.
    """
    pulls: dict[str, Any] = {}
    for part in kind.parts:
        check_part(domain, boundary, part, OPPOSITE)
        if any(part in pair.slave for pair in boundary.pairs):
            raise InputError(f"integrals of displacements are not over slaves such as '{part}'; take the master")
        if part not in (*boundary.contact, *boundary.neumann, *boundary.fixed):
            raise InputError(f"integrals of displacements are over parts in contact or loaded; on '{part}' u is given")
        sides = [(part, tau), *([(other_side(part), -tau)] if part in boundary.inner else [])]
        if kind.direction is None:
            pulls |= {side: added(domain, 0.0, kind.weight, -tau) for side, _ in sides}
            continue
        along = direction_of(kind.direction, domain.mesh.geometry.dim)
        pulls |= {side: [added(domain, 0.0, kind.weight, amount * share) for share in along] for side, amount in sides}
    return pulls


@dataclass(frozen=True)
class _Side:
    """A problem with data that differ, solved.

    Attributes:
        solution: Its solution.
        y: Its stress.
        v: The displacement nearest to it.
        past: Why v is not admissible; empty if it is.
        lacked: ‖d‖ on owned cells for the d that v lacks where pairs are tied.
    """

    solution: ElasticSolution
    y: AdmissibleStress
    v: fem.Function
    past: str
    lacked: Array

    @classmethod
    def of(cls, solution: ElasticSolution) -> "_Side":
        """The admissible fields of a solution (collective)."""
        y = admissible_stress(solution)
        spaces, data = solution.spaces, solution.data
        problem = BestDisplacement(spaces, data, y, spaces.split, degree_of_v(data))
        v, past = problem.minimum()
        return cls(solution, y, v, past, lacked(problem, v, Resolution(spaces, data))[:, 1])


class _Beside(Beside[_Side]):
    """Elastic problems beside that of a solution."""

    def memory(self, tau: float) -> FromBefore:
        """The slip of the last step in time, and Coulomb's bounds of the shear."""
        friction = self.solution.data.friction
        fixed = friction.fixed() if friction.by_pressure else None
        return FromBefore(self.solution.data.slipped, fixed)

    def start(self, posed: ElasticProblem) -> Segments | None:
        """The segments of the solution; in space none with friction, as directions of slip are no segments."""
        in_space = self.spaces.dim == 3 and bool(self.solution.data.friction)
        return None if in_space else self.solution.segments()

    def admissible(self, solution: ElasticSolution) -> _Side:
        """The admissible fields of a solution (collective)."""
        return _Side.of(solution)

    def half(self, of_v: _Side, of_y: _Side) -> Half:
        """The right side of the theorem, with the laws that v obeys (collective).

        What the linear solver leaves of the jumps of y counts like a load. Springs have the tractions that y balances.
        """
        solution, y = of_v.solution, of_y.y
        if of_v.past or not math.isfinite(y.distance):
            return Half(math.inf, of_v.past or UNBALANCED, np.zeros(len(self.spaces.order)))
        balanced = of_y.solution.data
        data = replace(solution.data, tractions=balanced.tractions, pulled=balanced.pulled)
        problem = BestDisplacement(solution.spaces, data, y, solution.spaces.split, degree_of_v(data))
        resolution = Resolution(self.spaces, of_y.solution.data)
        mismatch, contact = gap_of_cells(solution, problem, of_v.v, resolution, half=True)
        oscillation, missed = load_oscillation(resolution, y.stresses, mismatch)
        squares = (np.sqrt(np.maximum(mismatch, 0.0)) + oscillation) ** 2
        total, at_sites = self.comm.allreduce(np.array([squares.sum(), contact.sum()])).tolist()
        both = Resolution(self.spaces, solution.data), resolution
        missing = sorted({name for each in both for name in not_in_the_spaces(each)})
        reason = reservation(resolution.unresolved(), missing, LACKING)
        value = (math.sqrt(total) + y.distance + missed) ** 2 / 4 + max(at_sites, 0.0)
        unseen = self.unseen(resolution, missed, oscillation, of_v, of_y)
        return Half(value, reason, squares / 4 + np.maximum(contact, 0.0), unseen)

    def unseen(self, resolution: Resolution, missed: float, oscillation: Array, of_v: _Side, of_y: _Side) -> float:
        """What loads that y does not balance add to the bound, whatever τ is (collective)."""
        return 0.0

    def apart(self, one: _Side, other: _Side) -> float:
        """The energy norm of the difference of both stresses (collective)."""
        difference = one.solution.stresses - other.solution.stresses
        return math.sqrt(self.comm.allreduce(float(energy_squares(self.spaces, self.solution.data, difference).sum())))

    def size(self) -> float:
        """‖σ_h‖ (collective)."""
        norms: dict[str, float] = self.solution.norms()
        return norms["energy"]

    def distance(self) -> float:
        """The largest |u_D| and |g| (collective)."""
        return float(self.comm.allreduce(np.abs(self.solution.data.lift).max(initial=0.0), MPI.MAX))

    def softness(self) -> float:
        """The root of 𝔸, about: the energy of σ_h by its norm (collective)."""
        norms = self.solution.norms()
        return float(norms["energy"] / norms["sigma_L2"]) if norms["sigma_L2"] > 0 else 1.0


class Fluxes(_Beside):
    """A force, or a moment."""

    of_flux = True

    def posed(self, tau: float) -> ElasticProblem:
        """The problem with data that differ by τ (collective)."""
        return moved(self.domain, self.solution.problem, self.kind, tau)

    def memory(self, tau: float) -> FromBefore:
        """The memory of the solution, with the motion of foundations on the parts."""
        return replace(super().memory(tau), moved=foundations(self.domain, self.solution.problem, self.kind, tau))

    def value(self, of_v: _Side, of_y: _Side, enough: float) -> Array:
        """⟨yn, w⟩ (collective)."""
        return np.array([self._of(of_y.solution, of_y.y.stresses), 0.0])

    def unseen(self, resolution: Resolution, missed: float, oscillation: Array, of_v: _Side, of_y: _Side) -> float:
        """What loads that quadrature misses add to the bound, see `motions` (collective)."""
        apart = fem.Function(of_v.v.function_space)
        apart.x.array[:] = of_v.v.x.array - of_y.v.x.array
        return unseen_work(resolution, missed, self.kind, apart, self.tau)

    def discrete(self) -> float:
        """⟨σ_h n, w⟩ (collective)."""
        return self._of(self.solution, self.solution.stresses)

    def response(self) -> float:
        """The size of the stress for a support that is moved by w (collective)."""
        length, dim = self.spaces.length, self.spaces.dim
        arm = length if isinstance(self.kind, Moment) else 1.0
        return float(length ** (dim / 2 - 1) * arm / self.softness())

    def _of(self, solution: ElasticSolution, stresses: Array) -> float:
        of_parts = resultants(solution.spaces, stresses)
        total = np.sum([of_parts[part] for part in self.kind.parts], axis=0)
        dim = self.spaces.dim
        if not isinstance(self.kind, Moment):
            return float(total[:dim] @ direction_of(self.kind.direction, dim))
        return float(total[2] if dim == 2 else total[3:] @ direction_of(self.kind.direction, dim))


class Integrals(beside.IntegralsBeside[_Side], _Beside):
    """The integral of a component of the displacement with a weight, or its mean.

    Raises:
        InputError: In space, if it is over facets at edges of slaves that are tied (collective).
    """

    def __init__(self, solution: ElasticSolution, kind: Integral):
        super().__init__(solution, kind)
        spaces, of_slaves = self.spaces, np.zeros(len(self.spaces.mesh.geometry.x), dtype=bool)
        of_slaves[_ends(spaces, spaces.boundary_facets(spaces.tied))] = True
        for part in kind.parts if spaces.dim == 3 else ():
            on_edges = of_slaves[_ends(spaces, spaces.part(part))].sum(axis=1) > 1
            if self.comm.allreduce(bool(on_edges.any()), MPI.LOR):
                raise InputError(f"{type(kind).__name__}: none is there over '{part}', which meets a tied slave")

    def discrete(self) -> float:
        """The integral of u_h along the direction, or of its normal component, or its mean (collective).

        Where two bodies touch it is that of the jump.
        """
        spaces, sums, inner = self.spaces, np.zeros(2), self.solution.boundary.inner
        u, dim, along, parts = self.solution.u, spaces.dim, self.kind.direction, self.kind.parts

        def add(points: Points, ways: Array, share: float) -> None:
            of_cells = u.x.array.reshape(-1, dim)[u.function_space.dofmap.list[points.cells]]
            along_ways = np.einsum("npv,nvi,ni->np", points.barycentric, of_cells, ways)
            values = self.weight.values(points)
            sums[:] += points.integrals(values * along_ways).sum(), share * points.integrals(values).sum()

        for points in self.over.points() if not parts else ():
            add(points, np.tile(direction_of(along, dim), (len(points.cells), 1)), 1.0)
        for part in (*parts, *(other_side(part) for part in parts if part in inner)):
            facets, named = spaces.part(part), part in parts
            ways = facets.normals  # n has the sign of its side by itself
            if along is not None:
                ways = np.tile(direction_of(along, dim), (len(ways), 1)) * (1.0 if named else -1.0)
            add(facet_quadrature(spaces.mesh, facets.facets, quadrature_degree(self.weight)), ways, float(named))
        return self.of_sums(sums)

    def posed(self, tau: float) -> ElasticProblem:
        """The problem with data that differ by τ (collective)."""
        return _loaded(self.domain, self.solution.problem, self.kind, tau)

    def memory(self, tau: float) -> FromBefore:
        """The memory of the solution, with more tractions on the parts."""
        return replace(super().memory(tau), pulls=_pulls(self.domain, self.solution.boundary, self.kind, tau))

    def integral(self, of: _Side, enough: float) -> Array:
        """The integral of v along the direction, and by how much it may be wrong, on this rank (collective).

        Where two bodies touch it is that of the jump of v.
        """
        dim, spaces, total = self.spaces.dim, self.spaces, np.zeros(2)
        direction, degree = self.kind.direction, degree_of_v(self.solution.data)
        along = None if direction is None else np.array(direction_of(direction, dim))
        tree = parsed(self.kind.weight, "xyz"[:dim], "weight")
        if not self.kind.parts:
            assert along is not None
            subcells = spaces.split.cells[self.over.cells].ravel()
            measure = np.repeat(spaces.cell_measures[self.over.cells] / (dim + 1), dim + 1)
            v = Along.of(of.v, subcells, along)
            total[1] = self._lacked(of, float(np.linalg.norm(along)))
            return total + products(tree, v.vertices, measure, v.at, degree, spaces.frame, enough).total
        inner = [other_side(part) for part in self.kind.parts if part in self.solution.boundary.inner]
        for part in (*self.kind.parts, *inner):
            facets, sign = spaces.part(part), -1.0 if part in inner else 1.0
            ways = facets.normals if along is None else sign * along  # n has the sign of its side by itself
            v = Along.of(of.v, spaces.split.cells[facets.cells, facets.local], ways)
            total += products(tree, facets.vertices, facets.measure, v.at, degree, spaces.frame, enough).total
        return total

    def _lacked(self, of: _Side, size: float) -> float:
        """∫ |wd| in cells for a direction of this size, at most ‖w‖ ‖d‖ on each, on this rank (collective)."""
        missed = 0.0
        for points in self.over.points(power=2) if self.spaces.pairs else ():
            missed += float(np.sqrt(points.integrals(self.weight.values(points) ** 2)) @ of.lacked[points.cells])
        return size * missed


def _ends(spaces: ElasticSpaces, facets: BoundaryFacets) -> Indices:
    """The nodes at the vertices of facets, shape (facets, d)."""
    return np.asarray(spaces.nodes[facets.cells[:, None], opposite(spaces.dim)[facets.local]])


QUANTITIES = Quantities(check, energy, Integrals, Fluxes, named_for)
