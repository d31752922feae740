"""The energy of elastic bodies from both sides, and integrals of texts times displacements."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.certificate.certificate import reservation
from signorini_fenicsx.discrete.bernstein import jet
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.vectors import PressureDatum, VectorDatum
from signorini_fenicsx.expressions import Tree
from signorini_fenicsx.expressions.products import products
from signorini_fenicsx.expressions.simplices import barycentric
from signorini_fenicsx.forms.elasticity import square, strain, vector
from signorini_fenicsx.physics.elasticity.bound.certify import (
    LACKING,
    UNBALANCED,
    gap_of_cells,
    lacked,
    not_in_the_spaces,
)
from signorini_fenicsx.physics.elasticity.bound.conforming import BestDisplacement
from signorini_fenicsx.physics.elasticity.bound.equilibrated import admissible_stress
from signorini_fenicsx.physics.elasticity.bound.hidden import loads_of, without_given
from signorini_fenicsx.physics.elasticity.bound.lifted import degree_of
from signorini_fenicsx.physics.elasticity.bound.oscillation import load_oscillation
from signorini_fenicsx.physics.elasticity.bound.resolution import Resolution
from signorini_fenicsx.physics.elasticity.bound.tied import pulled_open
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.on_facets import facet_moments
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.quantities.beside import SHARE
from signorini_fenicsx.quantities.bracket import Quantity

OF_V = {2: 3, 3: 2}
"""Degree of v, by dimension; of a fluid it is at least that of the certificate."""


def degree_of_v(data: ElasticData) -> int:
    """The degree of v for these data."""
    return max(OF_V[data.material.dim], degree_of(data))


@dataclass(frozen=True)
class Along:
    """The components of a displacement along vectors on some cells of the split mesh.

    Attributes:
        vertices: Those of the cells.
        coefficients: Those of the components in Bernstein's basis, shape (cells, coefficients).
    """

    vertices: Array
    coefficients: Array

    @classmethod
    def of(cls, v: fem.Function, subcells: AnyIndices, ways: Array) -> "Along":
        """The components along a vector for each of some subcells, or one for all."""
        space = v.function_space
        coefficients = v.x.array.reshape(-1, ways.shape[-1])[space.dofmap.list[subcells]]
        vertices = corners(space.mesh, subcells.astype(np.int32))
        ways = np.broadcast_to(ways, (len(subcells), ways.shape[-1]))
        return cls(vertices, np.einsum("nai,ni->na", coefficients, ways))

    def at(self, rows: Indices, x: Array) -> Array:
        """The components in points of the subcells with these positions, shape (n, points, d)."""
        return jet(self.coefficients[rows], barycentric(self.vertices[rows], x))[:, :, 0]


def energy(solution: ElasticSolution) -> Quantity:
    """The interval for the energy: J(v) − gap − Σ osc_T‖ℂ(ε(v) − ε₀) − y‖_T − ½osc² ≤ J(u) ≤ J(v) (collective).

    J(v) = ½(ℂe, e) − (f, v) − ⟨g_N, v⟩ + ∫ g|v_t − w| + ∫ φ(g − v_n) + ½∫ Kv·v of springs, less the work of forces on
    tools, with e = ε(v) − ε₀, and φ of the laws between opening and pressure, which is −λp at the reference (p, λ) of
    the law and nowhere less than −λp. What is taken for the work of friction and for φ may be a bit more than these;
    the gap has the same in it, so that the lower bound is true.

    Where pairs are tied v + d is admissible, see `tied`. With s = ℂ(ε(v) − ε₀) − y, as y balances the loads,

        J(v + d) = J(v) + ∫ yn·d + (s, ε(d)) + ½‖ℂε(d)‖²,   |(s, ε(d))| ≤ Σ ‖s‖_T ‖ℂε(d)‖_T,   up to Σ osc_T ‖ℂε(d)‖_T,

    with the integral over the slaves. The last two terms are in its gap, too: so the lower bound has that of v.
    """
    spaces, data, comm = solution.spaces, solution.data, solution.spaces.mesh.comm
    if spaces.pairs and data.laws.of_parts:
        raise InputError("Energy: of pairs there is none with other laws than contact and friction")
    y = admissible_stress(solution)
    problem = BestDisplacement(spaces, data, y, spaces.split, degree_of_v(data))
    v, past = problem.minimum()
    resolution = Resolution(spaces, data)
    mismatch, contact = gap_of_cells(solution, problem, v, resolution)
    mismatch = np.maximum(mismatch, 0.0)
    oscillation, missed = load_oscillation(resolution, y.stresses, mismatch)
    distance, strain_of_d = y.distance + missed, lacked(problem, v, resolution)[:, 0]
    of_v = np.sqrt(mismatch) - strain_of_d
    local = of_v**2 / 2 + contact + oscillation * (np.sqrt(mismatch) + oscillation / 2 + strain_of_d)
    squares = (np.sqrt(mismatch) + oscillation) ** 2, strain_of_d**2, strain_of_d * (of_v + oscillation)
    opened = pulled_open(problem.tied, spaces, y.stresses, v)
    sums = comm.allreduce(np.array([local.sum(), *(each.sum() for each in squares), opened]))
    of_d = distance * math.sqrt(sums[2])
    below = max(float(sums[0]), 0.0) + distance * (math.sqrt(sums[1]) + distance / 2) + of_d
    value, wrong = _of_v(solution, problem, v, SHARE * below)
    value += float(sums[4])
    if past or not math.isfinite(y.distance):
        return Quantity(value, -math.inf, math.inf, False, past or UNBALANCED)
    lower, upper = value - below - wrong, value + float(sums[2] / 2 + sums[3]) + of_d + wrong
    missing = not_in_the_spaces(resolution, material=False)  # the work of strains is by quadrature
    reason = reservation(resolution.unresolved(), missing, LACKING)
    return Quantity(value, lower, upper, not reason, reason)


def _of_v(solution: ElasticSolution, problem: BestDisplacement, v: fem.Function, enough: float) -> list[float]:
    """J(v), or a bit more, and by how much it may be wrong; `enough` as in `products` (collective).

    Raises:
        InputError: If a load was given in Python.
    """
    spaces, data, material, contact = solution.spaces, solution.data, problem.material, problem.contact
    form = square(material.stiffness, vector(strain(v)) - material.eigenstrain, 0.5, material.dx)
    total = np.array([-1.0, 1.0]) * _work(solution, v, enough)
    total[0] += fem.assemble_scalar(fenicsx.form(form))
    reference = data.laws.flux_h.reshape(-1, spaces.dim)[contact.rows]
    apart = facet_moments(spaces, "gap", data.gap, contact.facets, "on Γ_C")
    apart = apart - np.einsum("nai,ni->na", problem.moments_on_contact(v), contact.facets.normals)
    total[0] -= float((reference * apart).sum())
    for law in problem.laws:
        total[0] += float(law.energies(problem.openings_of(v)[law.rows]).sum())
    total[0] += float(problem.friction.rubbed(problem.friction.slips(v)).sum() + problem.supports.energy(v).sum())
    value, wrong = spaces.mesh.comm.allreduce(total).tolist()
    return [value - sum(float(tool.load @ tool.moved) for tool in data.tools), wrong]


def _work(solution: ElasticSolution, v: fem.Function, enough: float) -> Array:
    """The work of all loads and by how much it may be wrong, of this rank (collective).

    Raises:
        InputError: If a load was given in Python.
    """
    spaces, dim, total = solution.spaces, solution.spaces.dim, np.zeros(2)
    subcells, volume = spaces.split.cells, np.repeat(spaces.cell_measures / (dim + 1), dim + 1)
    for k, tree, cells in _pieces(solution.data.f, np.arange(len(subcells))):
        along = Along.of(v, subcells[cells].ravel(), np.eye(dim)[k])
        measure = volume.reshape(subcells.shape)[cells].ravel()
        total += products(
            tree, along.vertices, measure, along.at, degree_of_v(solution.data), spaces.frame, enough
        ).total
    for facets, datum in loads_of(spaces, solution.data):
        sign = -1.0 if isinstance(datum, PressureDatum) else 1.0
        directions = np.broadcast_to(datum.directions, (len(facets.facets), len(datum.scalars), dim))
        ways = sign * without_given(spaces, facets, directions)
        for k, tree, rows in _pieces(datum, facets.cells):
            along = Along.of(v, subcells[facets.cells[rows], facets.local[rows]], ways[rows, k])
            some = facets.vertices[rows], facets.measure[rows]
            total += products(tree, *some, along.at, degree_of_v(solution.data), spaces.frame, enough).total
    return total


def _pieces(datum: VectorDatum | PressureDatum, cells: AnyIndices) -> Iterator[tuple[int, Tree, Indices]]:
    """The scalars of a load that are not 0 by their numbers, as trees, with the positions of their cells among some.

    Raises:
        InputError: If one was given in Python.
    """
    for k, scalar in enumerate(datum.scalars):
        if scalar.pieces is None:
            raise InputError("the energy of a body needs loads that are numbers or texts")
        for tree, rows in scalar.trees_in(cells) if scalar.number != 0 else ():
            yield k, tree, rows
