"""A bound of the energy error of an elastic solution, computed from that solution alone.

In the gap identity of `forms/elasticity.py` y = σ_h is admissible for the load f_h, by its own construction: in
balance on each cell, its tractions those of the data as far as these are linear on facets, σ_nn ≤ 0 and no shear on
Γ_C. v is the best quadratic displacement on the split mesh that has the displacements given and stays off the
foundation, see `best_displacement`. Let ũ be the solution for the load f_h. Then

    gap = ½‖ℂε(v) − σ_h‖² + ⟨−σ_h,nn, g − v_n⟩   bounds   ½|v − ũ|² + ½‖σ_h − ℂε(ũ)‖².

f − f_h is orthogonal to the linear fields on each cell T, as f_h has its moments against them. So |(f − f_h, w)_T| ≤
C_T ‖f − f_h‖_T |w|_T, where C_T = c_T/√min(2μ, 2μ + dλ) and c_T is the constant of `korn`. With w = u − ũ this gives
|u − ũ| ≤ osc = (Σ C_T² ‖f − f_h‖²_T)^½, as in `certify`, and

    |v − u| and ‖σ − σ_h‖ are both at most   √(2 gap) + osc + remainder.

The bound is guaranteed if f is a polynomial that the quadrature integrates exactly, E and ν are numbers, perhaps for
each region, g_N is linear, u_D and g are quadratic, and these are given as numbers or texts; otherwise it is said which
are not. The remainder is what the linear solver leaves of the jumps of σ_h n.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.parallel import Stopwatch
from signorini_fenicsx.certificate.best_displacement import BestDisplacement
from signorini_fenicsx.certificate.certify import Certificate
from signorini_fenicsx.certificate.korn import korn_constants
from signorini_fenicsx.discrete.elastic_data import MOST, ElasticData, blocks_of_cells, facet_moments
from signorini_fenicsx.discrete.johnson_mercier import Cells, SplitQuadrature, facet_normals, split_vertices
from signorini_fenicsx.discrete.points import CellPoints
from signorini_fenicsx.forms.elasticity import stress_gap
from signorini_fenicsx.methods.loop import Parameters, iterate_sets
from signorini_fenicsx.methods.set_rules import ALGORITHM_1
from signorini_fenicsx.solving.elastic_solution import ElasticSolution

UPDATES = 30
"""Set updates of v at most; each v is admissible."""


@dataclass(frozen=True)
class ElasticCertificate(Certificate):
    """The bound of an elastic solution.

    Attributes:
        of_last_bound: Whether u is the solution with the last bound of the shear, not that of Coulomb's law.
    """

    of_last_bound: bool = False
    if_none: str = "what is given of u passes the foundation"
    if_by_quadrature = "not in the discrete spaces"

    @property
    def of(self) -> str:
        """To which solution the error is, in words; empty if it is that of the problem."""
        return " to the exact solution with the last bound of the friction" if self.of_last_bound else ""

    def summary(self) -> dict[str, Any]:
        """All but the fields, ready for JSON."""
        return super().summary() | ({"of_last_bound": True} if self.of_last_bound else {})


def certify_elastic(solution: ElasticSolution) -> Certificate:
    """Bound the energy error of a converged solution (collective).

    Costs some linear solves for quadratic displacements on the split mesh.
    """
    check_kind("solution", solution, ElasticSolution, hint="; certify is for a Solution")
    watch = Stopwatch()
    with watch.phase("certificate"):
        certificate = _certificate(solution)
    return replace(certificate, seconds=watch.longest(solution.spaces.mesh.comm)["certificate"])


def _certificate(solution: ElasticSolution) -> Certificate:
    spaces, data = solution.spaces, solution.data
    comm = spaces.mesh.comm
    problem = BestDisplacement(spaces, data, solution.sigma)
    start = problem.near(solution.touching)
    outcome = iterate_sets(problem, ALGORITHM_1, Parameters(max_iterations=UPDATES), start=start)
    v = outcome.iterate.u
    feasible = problem.admissible(v)

    weight = ufl.TestFunction(fem.functionspace(spaces.split.mesh, ("DG", 0)))
    mismatch = fem.assemble_vector(fem.form(stress_gap(v, solution.sigma, *problem.moduli, weight, problem.dx))).array
    of_cells = mismatch[spaces.split.cells].sum(axis=1)
    pressure, shear = _tractions(solution)
    np.add.at(of_cells, spaces.contact.cells, 2 * _contact_term(solution, pressure, problem, v))
    if data.friction is not None:
        np.add.at(of_cells, spaces.rough.cells, 2 * _friction_term(solution, shear, problem, v))
    oscillation = _oscillation(solution)
    sums = comm.allreduce(np.array([of_cells.sum() / 2, (oscillation**2).sum()]))
    gap, osc = max(float(sums[0]), 0.0), float(np.sqrt(sums[1]))
    energy = solution.norms()["energy"]
    remainder = solution.kkt.tractions * energy
    bound = np.sqrt(2 * gap) + osc + remainder if feasible else np.inf
    sigma_bound = np.sqrt(2 * gap + osc**2) + remainder if feasible else np.inf
    indicator = fem.Function(spaces.scalar.Q, name="indicator")
    indicator.x.array[:] = np.sqrt(np.maximum(of_cells + oscillation**2, 0.0))  # no ghost cells
    missing = _not_in_the_spaces(data)
    return ElasticCertificate(
        bound=float(bound),
        sigma_bound=float(sigma_bound),
        gap=gap,
        oscillation=osc,
        remainder=remainder,
        relative=float(bound / energy) if energy > 0 else (0.0 if bound == 0 else np.inf),
        guaranteed=feasible and not missing,
        by_quadrature=missing,
        unresolved=(),
        coarse=np.zeros(len(spaces.order), dtype=bool),
        indicator=indicator,
        v=v,
        of_last_bound=data.friction is not None and data.friction.by_pressure,
    )


def _tractions(solution: ElasticSolution) -> tuple[Array, Array]:
    """−σ_nn and σ_t at the vertices on Γ_C, without what the linear solver leaves where they are given."""
    dim, conditions = solution.spaces.dim, solution.outcome.conditions
    found = np.concatenate([solution.pressure.ravel(), solution.shear.ravel()])
    _, found = conditions.clean(solution.outcome.iterate.p, found, 1.0)
    pressure, shear = np.split(found, [len(solution.spaces.sites)])
    return pressure.reshape(-1, dim), shear.reshape(-1, dim)


def _contact_term(solution: ElasticSolution, pressure: Array, problem: BestDisplacement, v: fem.Function) -> Array:
    """∫ (−σ_nn)(g − v_n) per facet of Γ_C (collective)."""
    spaces = solution.spaces
    facets = spaces.contact
    moments = facet_moments(spaces, "gap", solution.data.gap, facets, "on Γ_C")
    moments = moments - np.einsum("nai,ni->na", problem.moments_on_contact(v), facets.normals)
    return np.einsum("na,na->n", pressure, moments)


def _friction_term(solution: ElasticSolution, shear: Array, problem: BestDisplacement, v: fem.Function) -> Array:
    """∫ g|v_t| + σ_t v_t per facet with friction, or a little more."""
    spaces = solution.spaces
    along = np.einsum("nai,ni->na", problem.moments_on_contact(v)[spaces.rough_rows], spaces.tangents)
    return problem.rubbed(v) + np.einsum("na,na->n", shear, along)


def _oscillation(solution: ElasticSolution) -> Array:
    """C_T ‖f − f_h‖_T of the owned cells."""
    spaces, data, dim = solution.spaces, solution.data, solution.spaces.dim
    found = np.zeros(len(spaces.order))
    if data.f.polynomial == 0:
        return found
    rule = _exact_for_square(data)
    for numbers in blocks_of_cells(spaces):
        cells = Cells(spaces.vertices[numbers])
        volume = cells.measure / (dim + 1)
        inward = -facet_normals(split_vertices(cells.vertices).reshape(-1, dim + 1, dim)) / dim
        inward = inward.reshape(len(numbers), dim + 1, dim + 1, dim) / volume[:, None, None, None]
        divergence = np.einsum("nsvij,nsvj->nsi", solution.stresses[numbers], inward)
        points = CellPoints(spaces.mesh, numbers, rule.points, rule.weights)
        load = data.f.values(points).reshape(len(numbers), dim + 1, len(rule.weights), dim)
        load = np.take_along_axis(load, spaces.order[numbers][:, :, None, None], axis=1)
        left = np.einsum("q,nsqi->n", rule.weights, (load + divergence[:, :, None]) ** 2) * volume
        inverse, theta = data.moduli(points)
        soft = np.minimum(1.0, 1 / np.maximum(1 - dim * theta, 1e-300)).min(axis=1) / inverse.max(axis=1)
        found[numbers] = korn_constants(cells.derivative) * np.sqrt(left / soft)
    return found


def _exact_for_square(data: ElasticData) -> SplitQuadrature:
    """A quadrature that is exact for the square of f, if there is one."""
    degree = data.quadrature.degree if data.f.polynomial is None else min(2 * data.f.polynomial, MOST)
    return SplitQuadrature.of_degree(data.quadrature.points.shape[1], max(degree, data.quadrature.degree))


def _not_in_the_spaces(data: ElasticData) -> tuple[str, ...]:
    """Data that the discrete problem does not hold exactly."""
    found = [("f", data.f.polynomial, MOST // 2), ("u_D", data.u_D.polynomial, 2), ("gap", data.gap.polynomial, 2)]
    found += [(each.name, each.polynomial, 1) for each in data.g_N.values()]
    names = [name for name, degree, most in found if degree is None or degree > most]
    names += [] if data.friction is None else data.friction.inexact
    return tuple(names) if data.uniform else (*names, "young and poisson")
