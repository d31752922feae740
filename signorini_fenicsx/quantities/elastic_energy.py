"""The interval for the energy of an elastic body: J(v) − gap − Σ osc_T‖ℂ(ε(v) − ε₀) − y‖_T − ½osc² ≤ J(u) ≤ J(v).

J(v) = ½(ℂe, e) − (f, v) − ⟨g_N, v⟩ + ∫ g|v_t − w| + ∫ φ(g − v_n), less the work of forces on tools, with e =
ε(v) − ε₀, and φ of the laws between opening and pressure, which is −λp at the reference (p, λ) of the law and nowhere
less than −λp. What is taken for the work of friction and for φ may be a bit more than these; the gap has the same in
it, so that the lower bound is true.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.certificate.certificate import reservation
from signorini_fenicsx.discrete.datum import DEGREES
from signorini_fenicsx.expressions import TREES, to_ufl
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.forms.elasticity import square, strain, vector
from signorini_fenicsx.physics.elasticity.bound.certify import LACKING, UNBALANCED, gap_of_cells, not_in_the_spaces
from signorini_fenicsx.physics.elasticity.bound.conforming import BestDisplacement
from signorini_fenicsx.physics.elasticity.bound.equilibrated import admissible_stress
from signorini_fenicsx.physics.elasticity.bound.oscillation import load_oscillation
from signorini_fenicsx.physics.elasticity.bound.resolution import Resolution
from signorini_fenicsx.physics.elasticity.on_facets import facet_moments
from signorini_fenicsx.physics.elasticity.problem import NORMAL
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces
from signorini_fenicsx.quantities.bracket import Quantity

QUADRATIC = 2
"""Degree of v."""


def energy(solution: ElasticSolution) -> Quantity:
    """The interval for J(u) (collective)."""
    spaces, data, comm = solution.spaces, solution.data, solution.spaces.mesh.comm
    y = admissible_stress(solution)
    problem = BestDisplacement(spaces, data, y, spaces.split, QUADRATIC)
    v, past = problem.minimum()
    resolution = Resolution(spaces, data)
    mismatch, contact = gap_of_cells(solution, y, problem, v, resolution)
    mismatch = np.maximum(mismatch, 0.0)
    oscillation, missed = load_oscillation(resolution, y.stresses, mismatch)
    distance = y.distance + missed
    local = mismatch / 2 + contact + oscillation * (np.sqrt(mismatch) + oscillation / 2)
    sums = comm.allreduce(np.array([local.sum(), ((np.sqrt(mismatch) + oscillation) ** 2).sum()]))
    upper = _of_v(solution, problem, v)
    if past or not math.isfinite(y.distance):
        return Quantity(upper, -math.inf, math.inf, False, past or UNBALANCED)
    lower = upper - max(float(sums[0]), 0.0) - distance * (math.sqrt(sums[1]) + distance / 2)
    missing = not_in_the_spaces(resolution, enclosed=False)  # J(v) is by quadrature
    return Quantity((lower + upper) / 2, lower, upper, not missing, reservation((), missing, LACKING))


def indicator(
    spaces: ElasticSpaces, mesh: dolfinx.mesh.Mesh, parts: Sequence[str] = (), region: Sequence[str] = ()
) -> fem.Function | float:
    """What is 1 on the subcells behind some parts, or in some regions, and 0 on others; 1 for neither (collective)."""
    if not parts and not region:
        return 1.0
    function = fem.Function(fenicsx.function_space(mesh, ("DG", 0)))
    subcells = spaces.split.cells
    chosen = [subcells[facets.cells, facets.local] for facets in map(spaces.part, parts)]
    chosen += [subcells[spaces.domain.regions[name]].ravel() for name in region]
    function.x.array[function.function_space.dofmap.list[np.concatenate(chosen)]] = 1.0
    return function


def _of_v(solution: ElasticSolution, problem: BestDisplacement, v: fem.Function) -> float:
    """J(v), or a bit more (collective).

    Raises:
        InputError: If a load was given in Python.
    """
    spaces, data, given = solution.spaces, solution.data, solution.problem
    material, mesh, contact = problem.material, v.function_space.mesh, problem.contact
    form = square(material.stiffness, vector(strain(v)) - material.eigenstrain, 0.5, material.dx)
    dx, ds = (each(domain=mesh, metadata={"quadrature_degree": DEGREES[1]}) for each in (ufl.dx, ufl.ds))
    if given.f is not None:
        form -= ufl.dot(_vector(solution, given.f), v) * dx
    n = ufl.FacetNormal(mesh)
    of_parts = given.g_N if isinstance(given.g_N, Mapping) else dict.fromkeys(data.g_N, given.g_N)
    loads = {name: _vector(solution, of_parts[name]) for name in data.g_N if name not in given.pressure}
    loads |= {name: -_scalar(solution, pressure) * n for name, pressure in given.pressure.items()}
    for name, load in loads.items():
        for part in [name] if name else [*spaces.boundary.neumann, *spaces.boundary.fixed]:
            where = indicator(spaces, mesh, [part])
            form -= where * ufl.dot(_without_given(spaces, part, load, n), v) * ds
    total = fem.assemble_scalar(fenicsx.form(form))
    reference = data.laws.pressure.reshape(-1, spaces.dim)[contact.rows]
    apart = facet_moments(spaces, "gap", data.gap, contact.facets, "on Γ_C")
    apart = apart - np.einsum("nai,ni->na", problem.moments_on_contact(v), contact.facets.normals)
    total -= float((reference * apart).sum())
    for law in problem.laws:
        total += float(law.energies(problem.openings_of(v)[law.rows]).sum())
    total += float(problem.rubbed(v).sum())
    on_tools = sum(float(tool.load @ tool.moved) for tool in data.tools)
    return float(spaces.mesh.comm.allreduce(total)) - on_tools


def _scalar(solution: ElasticSolution, given: Any) -> Expr:
    """A number or a text on the split mesh.

    Raises:
        InputError: If it is something else.
    """
    tree = parsed(given, "xyz"[: solution.spaces.dim], "energy")
    if not isinstance(tree, TREES):
        raise InputError("the energy of a body needs loads that are numbers or texts")
    return to_ufl(tree, ufl.SpatialCoordinate(solution.spaces.split.mesh))


def _vector(solution: ElasticSolution, given: Any) -> Expr:
    """A vector on the split mesh.

    Raises:
        InputError: If a component is neither a number nor a text.
    """
    if given is None:
        return ufl.as_vector([0.0] * solution.spaces.dim)
    if callable(given):
        raise InputError("the energy of a body needs loads that are numbers or texts")
    return ufl.as_vector([_scalar(solution, given[i]) for i in range(solution.spaces.dim)])


def _without_given(spaces: ElasticSpaces, part: str, load: Expr, n: Expr) -> Expr:
    """A traction without its components along which u is given on a part."""
    fixed = spaces.boundary.fixed.get(part, "")
    if fixed == NORMAL:
        return load - ufl.dot(load, n) * n
    return ufl.as_vector([0.0 * load[i] if "xyz"[i] in fixed else load[i] for i in range(spaces.dim)])
