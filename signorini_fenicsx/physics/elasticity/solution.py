"""An elastic contact solution: its fields, sets and residuals, and the numbers that sum them up."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.base.tolerances import EXACT_CONTACT
from signorini_fenicsx.contact.chains import Condition
from signorini_fenicsx.discrete.contact_sets import FacetSet, Segments, by_part, by_state, hausdorff
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells, linear_from_means
from signorini_fenicsx.discrete.points import CellPoints
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData, elastic_data
from signorini_fenicsx.physics.elasticity.discrete.friction import FromBefore
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells, SplitQuadrature, to_entries
from signorini_fenicsx.physics.elasticity.discrete.material import regular
from signorini_fenicsx.physics.elasticity.discrete.on_facets import facet_moments
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem
from signorini_fenicsx.physics.elasticity.show import shown, tables
from signorini_fenicsx.physics.elasticity.show.differences import differences
from signorini_fenicsx.physics.elasticity.show.notes import far_slides, large_deformation, notes_of
from signorini_fenicsx.physics.elasticity.show.readings import quantities
from signorini_fenicsx.physics.elasticity.show.tables import STATES
from signorini_fenicsx.physics.elasticity.solve.residuals import (
    ElasticKKT,
    balance,
    energy_squares,
    resultants,
    subcell_squares,
)
from signorini_fenicsx.solution import Solution

ERROR_DEGREE = 8
"""Of the quadrature on subcells that measures errors."""


@dataclass(frozen=True, repr=False, kw_only=True)
class ElasticSolution(Solution):
    """A discrete elastic solution and how it was found.

    Attributes:
        name: What results are called.
        title: The same in more words.
        boundary: Which parts are in contact, loaded or fixed.
        problem: The data as given.
        options: Algorithm and its parameters.
        spaces: The discrete spaces; `spaces.mesh` is the mesh, `spaces.split.mesh` that of the subcells.
        data: The data on the mesh.
        outcome: How the method ended, with σ_h and u_h; it has converged if the residuals are small as well.
        kkt: Residuals of the discrete problem.
        bound_changes: With Coulomb's friction, in the plane by how much the bound of the shear changed in each step of
            the fixed point, relative to itself; in space how far the shear was off the law, relative to the largest
            bound.
        step: Number of the step of a problem in time, from 1; None for others.
        source: What the problem was read from; None if it was given in Python.
        system: What has solved it, as long as that is alive; its factors serve derivatives. None if it is not known.
        timings: Seconds per phase, the longest over all ranks.
        peak_memory: Bytes that the processes have held at most so far, summed over ranks.
    """

    problem: ElasticProblem
    spaces: ElasticSpaces
    data: ElasticData
    kkt: ElasticKKT
    bound_changes: tuple[float, ...] = ()
    order = 2
    unit_keys = ("length_unit", "stress_unit")
    _own = ("friction_states", "gap", "pressure", "quantities", "resultants", "shear", "slip", "stresses")
    offers = (*Solution.offers, *_own)
    fields, lines = shown.fields, shown.lines
    table, columns, other_tables = tables.table, tables.columns, tables.other_tables
    opposite = cached_property(tables.opposite_surfaces)
    differences = differences

    def of_problem(self, problem: ElasticProblem) -> Self:
        """The solution as one of a problem whose data have the same values but are given otherwise (collective)."""
        data = elastic_data(self.spaces, problem, FromBefore(self.data.slipped))
        return replace(self, problem=problem, data=replace(data, friction=self.data.friction))

    def linearised(self, tolerance: float) -> Any:
        """The problem linearised at this solution, see `linearised.Linearised` (collective).

        Raises:
            InputError: If a bound of friction or a datum of a law is in UFL and not linear.
        """
        from signorini_fenicsx.physics.elasticity.derivative.linearised import linearised  # which knows solutions

        return linearised(self, tolerance)

    @property
    def approach(self) -> str:
        """The problem and its method, in words."""
        return f"{'elastic contact' if self.contact_parts else 'elasticity'}, {self.options.algorithm_name}"

    @property
    def after(self) -> str:
        """Friction alone remembers earlier steps."""
        return super().after if self.data.friction else ""

    @cached_property
    def stresses(self) -> Array:
        """Values of σ_h at the vertices of the subcells, shape (cells, d + 1, d + 1, d, d)."""
        return self.spaces.split.values(self.sigma)

    @property
    def pressure(self) -> Array:
        """−σ_nn at the vertices of each facet of Γ_C of this rank, shape (facets, d)."""
        contact = self.spaces.contact
        return -np.einsum("nai,ni->na", self.spaces.tractions(contact, self.stresses), contact.normals)

    @property
    def gap(self) -> Array:
        """The gap g − u_n, in means weighted by the hats of these vertices: not negative, and 0 in contact.

        Under other laws it is what they allow.
        """
        laws, normal = self.data.laws, self.spaces.site_kinds["normal"]
        opening, pressure = map(normal.of, (self.outcome.iterate.p, self.data.reactions(self.spaces, self.stresses)))
        return normal.rows_of(laws.means(self.segment, opening, pressure) + laws.p_h)

    @cached_property
    def segment(self) -> Indices:
        """The segment of its law in the normal direction on which each facet vertex is, shape (sites,)."""
        return self.data.laws.chains.segments(self.spaces.site_kinds["normal"].of(self.outcome.conditions))

    @property
    def linear_gap(self) -> Array:
        """The gap there as a linear function on each facet: where contact ends it may be a little below 0."""
        return linear_from_means(self.gap)

    @property
    def touching(self) -> Mask:
        """Mask of the facet vertices in contact, under other laws held or on a spring, shape (facets, d)."""
        return self.spaces.site_kinds["normal"].rows_of(self.outcome.conditions.kind != Condition.NO_FLUX)

    @property
    def moved(self) -> list[float]:
        """How far tools under given forces have moved, one motion after another."""
        return [distance for tool in self.data.tools for distance in tool.moved.tolist()]

    @property
    def slip(self) -> Array:
        """u_t on the facets with friction, in means weighted by the hats of their vertices, shape (facets, d).

        In space it is |u_t|.
        """
        return self._scalar(self.slips)

    @property
    def slips(self) -> Array:
        """u_t at the sites with friction, in the frames of the facets."""
        return self._after + self.data.slipped

    @property
    def slipped(self) -> Array:
        """The slip that is left of u_t when σ_t is taken away, of joints on springs less than u_t."""
        along, pairs = self.spaces.site_kinds["slip"], self.outcome.iterate
        left: Array = self.data.friction.left(along.rows_of(pairs.p), along.rows_of(pairs.flux))
        return left.ravel() + self.data.slipped

    @property
    def _after(self) -> Array:
        """The part of u_t at the sites that is of this step in time, all of it without steps."""
        return self.spaces.site_kinds["slip"].of(self.outcome.iterate.p)

    def _scalar(self, values: Array) -> Array:
        """Tangential values at the sites as one number for each vertex: in space the length."""
        by_vertex = values.reshape(-1, self.spaces.dim, self.spaces.dim - 1)
        numbers: Array = by_vertex[:, :, 0] if self.spaces.dim == 2 else np.linalg.norm(by_vertex, axis=2)
        return numbers

    @property
    def slip_vectors(self) -> Array:
        """u_t as vectors, shape (facets, d, d)."""
        return self.spaces.along(self.slips)

    @property
    def shear_vectors(self) -> Array:
        """σ_t as vectors, shape (facets, d, d)."""
        return self.spaces.along(self.spaces.shear(self.stresses))

    @property
    def shear(self) -> Array:
        """σ_t at these vertices, in space |σ_t|."""
        return self._scalar(self.spaces.shear(self.stresses))

    @property
    def states(self) -> Indices:
        """The state of these vertices, an index into `STATES`; without shear by the sign of u_t."""
        if self.data.friction.in_space:
            return np.where(self.data.friction.sticks, STATES.index("stick"), STATES.index("slip"))
        tangential = self.spaces.site_kinds["slip"].of(self.outcome.conditions)
        segments = self.data.friction.chains.segments(tangential).reshape(self.data.friction.bound.shape)
        return np.where(self.data.friction.bound > 0, segments, np.where(self._scalar(self._after) < 0, 0, 2))

    def segments(self) -> Segments:
        """The segments from which the next step in time starts, with the bounds of the shear."""
        bound = self.spaces.site_kinds["slip"].spread(self.data.friction.bound)
        return Segments(self.spaces, self.data.chains.segments(self.outcome.conditions), {"bound": bound})

    @property
    def _states_or_open(self) -> Indices:
        """Index into `STATES`: open is what has no contact where pressure alone gives a bound, as in Coulomb's law."""
        is_open = ~self.touching[self.spaces.rough_rows] & (self.data.friction.given == 0)
        return np.where(is_open, STATES.index("open"), self.states)

    def on_all_contact(self) -> tuple[Array, Array, Array]:
        """σ_t, linear u_t and the index into `STATES` at the vertices on Γ_C; NaN where there is no friction."""
        vectors = self.slips.reshape(-1, self.spaces.dim, self.spaces.dim - 1)
        rough = self.shear, self._scalar(linear_from_means(vectors)), self._states_or_open
        shear, slip, state = (self.spaces.site_kinds["slip"].spread(values, np.nan) for values in rough)
        return shear, slip, state

    def contact_set(self) -> FacetSet:
        """The facets of Γ_C with a vertex in contact."""
        return FacetSet(self.spaces, self.touching.any(axis=1))

    @property
    def touching_vertices(self) -> int:
        """Number of facet vertices in contact (collective when first used)."""
        return self.sites_in_contact()[0]

    @collector_off()
    def friction_states(self) -> dict[str, dict[str, float]]:
        """Number of facet vertices with friction in each state, and their measure (collective)."""
        states = self._states_or_open.ravel()
        measure = np.repeat(self.spaces.rough.measure / self.spaces.dim, self.spaces.dim)
        counts = by_state(self.spaces.mesh.comm, STATES, states, measure, "vertices")
        names = STATES[:-1] if self.spaces.dim == 2 else ("stick", "slip", "open")
        return {name: counts[name] for name in names}

    @collector_off()
    def segments_of_parts(self) -> dict[str, dict[str, dict[str, float]]]:
        """Number and measure of the facet vertices on each segment of a law, by part and segment (collective)."""
        return by_part(self.spaces, self.data.laws.of_parts, self.segment)

    @cached_property
    def balance(self) -> tuple[Array, float]:
        """What is left of all forces and moments, and its share of the forces, see `balance` (collective at first)."""
        return balance(self.spaces, self.data, self.stresses)

    @collector_off()
    def resultants(self) -> dict[str, list[float]]:
        """Forces and then moments about the origin on each part; and what is left of all and f, "sum" (collective)."""
        forces = resultants(self.spaces, self.stresses) | {"sum": self.balance[0]}
        return {name: values.tolist() for name, values in forces.items()}

    @collector_off()
    def quantities(self) -> dict[str, Any]:
        """Largest stress and displacement, contact by part, and the balance, see `quantities` (collective)."""
        return quantities(self)

    @collector_off()
    def norms(self) -> dict[str, float]:
        """‖σ‖ in the energy norm and in L², ‖u‖, and the resulting contact force (collective)."""
        return dict(self._norms)

    @cached_property
    def _norms(self) -> dict[str, float]:
        spaces, data = self.spaces, self.data
        u, squares = spaces.displacement_values(self.u), np.zeros(3)
        size = spaces.dim + 1
        squares[0] = energy_squares(spaces, data, self.stresses).sum()
        for cells in spaces.blocks():
            measure, stresses, values = cells.measure, self.stresses[cells.numbers], u[cells.numbers]
            of_values, of_sum = (values**2).sum(axis=(1, 2)), (values.sum(axis=1) ** 2).sum(axis=1)
            squares[1] += (subcell_squares(stresses) * measure[:, None] / size).sum()
            squares[2] += (measure * (of_values + of_sum)).sum() / (size * (size + 1))
        energy, sigma, displacement = np.sqrt(spaces.mesh.comm.allreduce(squares)).tolist()
        force = spaces.mesh.comm.allreduce(float(spaces.site_kinds["normal"].measure @ self.pressure.ravel()))
        return {"energy": energy, "sigma_L2": sigma, "u_L2": displacement, "contact_force": force}

    @collector_off()
    def errors(self) -> dict[str, float] | None:
        """‖σ − σ_h‖ in the energy norm and ‖u − u_h‖, if u is known, and the contact set's distance (collective)."""
        if self.data.exact is None:
            return None
        spaces, dim = self.spaces, self.spaces.dim
        quadrature = SplitQuadrature.of_degree(dim, ERROR_DEGREE)
        exact = self.data.exact
        u_h, squares = spaces.displacement_values(self.u), np.zeros(2)
        for cells in blocks_of_cells(spaces.mesh):
            points = CellPoints(spaces.mesh, cells, quadrature.points, quadrature.weights)
            where, subcell, vertex = spaces.as_dolfinx(cells)
            at_vertices = np.empty_like(self.stresses[cells])
            at_vertices[where, subcell, vertex] = self.stresses[cells]
            nodes = np.empty_like(u_h[cells])
            nodes[np.arange(len(cells))[:, None], spaces.order[cells]] = u_h[cells]
            shape = (len(cells), dim + 1, len(quadrature.weights))
            compliance = self.data.material.compliance(points)
            strain = to_entries(exact.gradients(points)) - self.data.material.strain(points)
            sigma = to_entries(np.einsum("qa,nsaij->nsqij", quadrature.local, at_vertices)).reshape(strain.shape)
            off = strain - np.einsum("nqef,nqf->nqe", compliance, sigma)
            product = (off * np.linalg.solve(regular(compliance), off[..., None])[..., 0]).sum(axis=2).reshape(shape)
            displaced = self.data.exact.values(points).reshape(*shape, dim) - np.einsum(
                "sqv,nvi->nsqi", quadrature.hats, nodes
            )
            weights = Cells(spaces.vertices[cells]).measure[:, None, None] / (dim + 1) * quadrature.weights
            squares += (weights * product).sum(), (weights * (displaced**2).sum(axis=3)).sum()
        energy, u = np.sqrt(spaces.mesh.comm.allreduce(squares)).tolist()
        distance = hausdorff(self.contact_set(), self._exact_contact_set())
        return {"energy": energy, "u_L2": u, "contact_hausdorff": distance}

    def _exact_contact_set(self) -> FacetSet:
        """The facets of Γ_C on whose mean the exact gap is 0 (collective)."""
        spaces, facets = self.spaces, self.spaces.contact
        assert self.data.exact is not None
        u = facet_moments(spaces, "exact", self.data.exact, facets, "on Γ_C")
        gap = facet_moments(spaces, "gap", self.data.gap, facets, "on Γ_C").sum(axis=1)
        open_by = (gap - np.einsum("nai,ni->n", u, facets.normals)) / facets.measure
        largest = np.abs(u).max(initial=0.0) / max(facets.measure.max(initial=0.0), 1e-300)
        largest = max(spaces.mesh.comm.allgather(float(largest)))
        if not self.data.laws.of_parts:
            return FacetSet(spaces, open_by <= EXACT_CONTACT * largest)
        chains = self.data.laws.chains[:: spaces.dim]  # of the first vertex of each facet
        opening, rounding = open_by - self.data.laws.p_h.reshape(-1, spaces.dim).mean(axis=1), EXACT_CONTACT * largest
        behind = [(chains.p < (opening + side)[:, None]).sum(axis=1) for side in (-rounding, rounding)]
        number = np.arange(chains.slope.shape[1])
        near = (number >= behind[0][:, None]) & (number <= behind[1][:, None])
        return FacetSet(spaces, (near & (chains.slope > 0)).any(axis=1))

    def of_step(self) -> dict[str, float]:
        """The row of `steps.csv`: peak stresses, motions of tools, force and mean u of each part (collective)."""
        about = self.quantities()
        numbers = {"contact_force": self.norms()["contact_force"], "von_mises": about["von_mises"]["largest"]}
        numbers |= {
            f"{name}_peak_pressure": part["peak_pressure"]["largest"] for name, part in about["contact"].items()
        }
        for name, motion in about.get("tools", {}).items():
            numbers |= {f"{name}_tool_{axis}": length for axis, length in motion["displacement"].items()}
            numbers |= {f"{name}_tool_about_{axis}": angle for axis, angle in motion.get("rotation", {}).items()}
        return numbers | self._on_parts()

    def _on_parts(self) -> dict[str, float]:
        """The force and the mean u of each part (collective)."""
        spaces, axes, numbers = self.spaces, AXES[: self.spaces.dim], dict[str, float]()
        forces, u = self.resultants(), spaces.displacement_values(self.u)
        for name in spaces.domain.parts:
            part = spaces.part(name)
            opposite = np.arange(spaces.dim + 1) != part.local[:, None]
            means = u[part.cells][opposite].reshape(-1, spaces.dim, spaces.dim).mean(axis=1)
            sums = np.append(part.measure @ means, part.measure.sum())
            *moved, measure = spaces.mesh.comm.allreduce(sums)
            numbers |= {f"{name}_force_{axis}": force for axis, force in zip(axes, forces[name], strict=False)}
            numbers |= {f"{name}_u_{axis}": x / measure for axis, x in zip(axes, moved, strict=True)}
        return numbers

    def sizes(self) -> dict[str, float]:
        """The energy norm of σ, and ‖u‖ (collective)."""
        return {name: size for name, size in self.norms().items() if name in ("energy", "u_L2")}

    def _sets(self) -> dict[str, Any]:
        return {
            "physics": self.physics,
            "contact_facets": self.spaces.Lambda.dofmap.index_map.size_global,
            "dofs": self.outcome.dofs,
            "touching_vertices": self.touching_vertices,
            "contact_measure": self.contact.measure,
            **({"segments": self.segments_of_parts()} if self.data.laws.of_parts else {}),
            **({"friction": self.friction_states()} if self.data.friction else {}),
            **({"coulomb": self._fixed_point()} if self.bound_changes else {}),
        }

    def _fixed_point(self) -> dict[str, Any]:
        """How the bound of Coulomb's friction was found, and whether this is the only one (collective)."""
        rubs = self.spaces.mesh.comm.allreduce(bool((self.data.friction.bound > 0).any()), MPI.LOR)
        return {"changes": list(self.bound_changes), "other_solutions": "not excluded" if rubs else "none"}

    def notes(self) -> list[str]:
        """See `Solved.notes`."""
        return [*notes_of(self.spaces, self.data), *super().notes(), *self.own_notes(), *far_slides(self)]

    def own_notes(self) -> list[str]:
        """What the size of u says (collective)."""
        return large_deformation(self)

    def _particular(self) -> dict[str, Any]:
        normal = self.spaces.site_kinds["normal"]  # of g, before tools move
        means = normal.rows_of(self.data.lift[normal.unknown] - normal.of(self.data.moved))
        with_laws = np.concatenate([np.empty(0, dtype=np.int64), *(law.rows for law in self.data.laws.of_parts)])
        least_mean = np.delete(means, with_laws, axis=0).min(initial=np.inf)
        least = min(self.spaces.mesh.comm.allgather(float(least_mean)))
        numbers = {"resultants": self.resultants(), "quantities": self.quantities()}
        return numbers | ({"least_gap": least} if least < 0 else {})
