"""A bound of the energy error of an elastic solution, computed from that solution alone.

In the gap identity of `forms/elasticity.py` y = σ_h is admissible for the load f_h, by its own construction: in
balance on each cell, its tractions the linear parts Π₁g_N of the data on facets, σ_nn ≤ 0 and no shear on Γ_C. v is the
best quadratic displacement on the split mesh that has the displacements given and stays off the foundation, see
`conforming`. Quadratics may be much worse than σ_h, near corners most of all. So on the cells that have most of the
gap, and their neighbours, v is then the best polynomial of a higher degree that continues it. Let ũ be the solution for
these loads. Then

    gap = ½‖ℂ(ε(v) − ε₀) − σ_h‖² + ⟨−σ_h,nn, g − v_n⟩   bounds   ½|v − ũ|² + ½‖σ_h − ℂε(ũ)‖².

f − f_h is orthogonal to the linear fields on each cell T, as f_h has its moments against them, and g_N − Π₁g_N to those
on each facet e. So |(f − f_h, w)_T| ≤ C_T ‖f − f_h‖_T |w|_T, where C_T is the constant c_T of `korn` times the root of
the largest eigenvalue of 𝔸; likewise |⟨g_N − Π₁g_N, w⟩_e| with that of a facet. With w = u − ũ this gives |u − ũ| ≤
osc, as in the proof of the scalar bound, where osc² sums the squares over the cells, and

    |v − u| and ‖σ − σ_h‖ are both at most   √(2 gap) + osc + remainder.

The bound is guaranteed if all data are numbers or texts, and

- f and g_N are polynomials that the quadrature integrates exactly, or what is given of u holds the body, see `hidden`;
- u_D and g are quadratic or, in the plane, any texts, see `lifted`.

Otherwise it is said which are not. The remainder is what the linear solver leaves of the jumps of σ_h n, and what may
be missed of linear parts of loads.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import cells_behind, sums_at
from signorini_fenicsx.certificate.certificate import Certificate, Gap
from signorini_fenicsx.discrete.vectors import PressureDatum, VectorDatum
from signorini_fenicsx.forms.elasticity import off_law, square
from signorini_fenicsx.meshes.refinement import dorfler
from signorini_fenicsx.physics.elasticity.bound import hidden
from signorini_fenicsx.physics.elasticity.bound.conforming import BestDisplacement
from signorini_fenicsx.physics.elasticity.bound.equilibrated import AdmissibleStress, admissible_stress
from signorini_fenicsx.physics.elasticity.bound.friction import moments_of
from signorini_fenicsx.physics.elasticity.bound.lifted import degree_of, lifted, lifts, of_degree
from signorini_fenicsx.physics.elasticity.bound.oscillation import compliances_above, load_oscillation
from signorini_fenicsx.physics.elasticity.bound.resolution import (
    Resolution,
    is_enclosed,
    is_own_enclosed,
    unresolved_by_quadrature,
)
from signorini_fenicsx.physics.elasticity.bound.tied import lacking
from signorini_fenicsx.physics.elasticity.discrete.data import LARGEST_DEGREE
from signorini_fenicsx.physics.elasticity.discrete.friction import is_linear
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces, SplitMesh
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

LACKING = "not in the discrete spaces"
UNBALANCED = "the linear solver leaves too much of the balance of the stress"
SURFACE = "with tools as far as their surfaces are at the vertices of the mesh"
TRESCA = "the exact solution of Tresca's problem with the last bound of the friction"
MOST = {2: 0.95, 3: 0.8}
"""v has a higher degree on the cells with the largest parts of the gap that have this share of it, by dimension,"""
HALVINGS, MANY = 4, {2: 20_000, 3: 200}
"""or half as much of it and so on, if they are more than so many, by dimension; and on their neighbours."""
HIGHEST, FEW = {2: 4, 3: 3}, 1000
"""Its degree there, by dimension, on not more cells than so many; on more it is cubic."""


def certificate_of(solution: ElasticSolution, **_: bool) -> Certificate:
    """Bound the energy error of a converged solution (collective).

    In a step in time with friction this is the distance to the exact solution of the step after the computed slip of
    the last one, as a linear function w on each facet. That w jumps between facets makes no difference to the proof, as
    only ∫ g|v_t − w| is needed of it.

    Costs some linear solves for quadratic displacements on the split mesh, and some on a part of it. The `v` of the
    certificate is quadratic also where the bound has a better one, and lacks the d of `lifted`.
    """
    spaces, data = solution.spaces, solution.data
    comm = spaces.mesh.comm
    y = admissible_stress(solution)
    resolution = Resolution(spaces, data)
    v, of_cells, slips, past = _displacement(solution, y, resolution, spaces.split, degree_of(data))
    lacking, lifted_data = lifted(resolution, of_cells, y.floors)
    of_cells = _with(of_cells, lacking)
    with_most = _with_most(spaces, of_cells)
    number = comm.allreduce(len(with_most))
    degree = HIGHEST[spaces.dim] if number <= FEW else 3
    if number > 0 and degree > degree_of(data):
        part = spaces.split.part(with_most)
        _, better, slips_there, past_there = _displacement(solution, y, resolution, part, degree, v)
        better = _with(better, of_degree(resolution, lifted_data, degree, y.floors))
        gain = comm.allreduce(float((of_cells - better)[with_most].sum()))
        if not past_there and gain > 0:
            of_cells[with_most] = better[with_most]
            slips = np.where(np.isin(spaces.rough.cells, with_most), slips_there, slips)
    oscillation, missed = load_oscillation(resolution, y.stresses, of_cells)
    of_cells, oscillation, rubbing = _with_friction(resolution, slips, of_cells, oscillation)
    gap = Gap(
        squares=of_cells,
        oscillation=oscillation,
        remainder=y.distance + missed,
        size=solution.norms()["energy"],
        v=v,
        hindrance=past,
        unbalanced=UNBALANCED,
        by_quadrature=not_in_the_spaces(resolution, also=(*lifts(spaces, data), *rubbing)),
        account=lambda bound: (resolution.unresolved(), resolution.coarse),
    )
    of_last_bound = data.friction.by_pressure
    of = with_surface(solution, TRESCA if of_last_bound else "")
    certificate = replace(gap.certificate(spaces), lacking=_lacking(resolution, gap.by_quadrature), of=of)
    about = {"guaranteed": False, "of_last_bound": True} if of_last_bound else {}
    return replace(certificate, about=about | ({"guaranteed_for": of} if of and certificate.proved else {}))


def with_surface(solution: ElasticSolution, of: str) -> str:
    """Of which solution a bound is, in words; with tools from surface meshes it says how far these are known."""
    return f"{of or 'the exact solution'}, {SURFACE}" if solution.problem.surface else of


def _loads(resolution: Resolution) -> list[VectorDatum | PressureDatum]:
    """The load and all tractions and pressures."""
    return [resolution.data.f, *(datum for _, datum in hidden.loads_of(resolution.spaces, resolution.data))]


def _lacking(resolution: Resolution, names: Sequence[str]) -> str:
    """What is missing for these data: a constant of the body, if they are loads and bounds of friction by texts."""
    data = resolution.data
    by_constant = {each.name for each in _loads(resolution) if hidden.is_enclosed(each)}
    by_constant |= {name for name, datum, _ in data.friction.texts if datum.pieces is not None}
    reason = resolution.no_constant
    return f"by quadrature, {reason}" if reason and by_constant >= set(names) else LACKING


def _displacement(
    solution: ElasticSolution,
    y: AdmissibleStress,
    resolution: Resolution,
    split: SplitMesh,
    degree: int,
    v: fem.Function | None = None,
) -> tuple[fem.Function, Array, Array, str]:
    """The best displacement on the split mesh or a part of it (collective).

    Returns:
        The displacement, what it makes of 2 gap on each owned cell, how long it slips on each facet with friction, and
        where it passes the foundation; empty if it does not.
    """
    spaces = solution.spaces
    problem = BestDisplacement(spaces, solution.data, y, split, degree, v)
    v, past = problem.minimum()
    mismatch, on_contact = gap_of_cells(solution, problem, v, resolution)
    return v, mismatch + 2 * on_contact, problem.friction.lengths(v, len(spaces.rough_rows)), past


def _with_friction(
    resolution: Resolution, slips: Array, squares: Array, oscillation: Array
) -> tuple[Array, Array, tuple[str, ...]]:
    """Twice the gap and the oscillation of cells with what texts for g add, and the names of known g.

    There has to be a constant of the body (collective).
    """
    spaces, data = resolution.spaces, resolution.data
    texts = data.friction.texts
    if not texts or resolution.no_constant or any(datum.pieces is None for _, datum, _ in texts):
        return squares, oscillation, ()
    found = hidden.friction_missed(resolution, compliances_above(spaces, data), slips, squares, oscillation)
    known = spaces.mesh.comm.allreduce(bool(np.isfinite(found[1]).all()), MPI.LAND)
    return (*found, tuple(name for name, *_ in texts)) if known else (squares, oscillation, ())


def _with(of_cells: Array, lacking: Array) -> Array:
    """Twice the gap of cells for v + d, which is at most so much farther from y there."""
    return np.where(lacking > 0, (np.sqrt(np.maximum(of_cells, 0.0)) + lacking) ** 2, of_cells)


def gap_of_cells(
    solution: ElasticSolution,
    problem: BestDisplacement,
    v: fem.Function,
    resolution: Resolution,
    *,
    half: bool = False,
) -> tuple[Array, Array]:
    """‖ℂε(v) − y‖², and the gap on Γ_C and supports, per owned cell; `half` as in `integrals` of laws (collective).

    Where a pair is tied it is that of v + d, see `tied`.
    """
    spaces, split = solution.spaces, problem.split
    weight = ufl.TestFunction(fenicsx.function_space(split.mesh, ("DG", 0)))
    material = problem.material
    off = off_law(v, problem.sigma, material.compliance, material.eigenstrain)
    gaps = square(material.stiffness, off, weight, material.dx)
    of_subcells = resolution.with_missed(problem, fem.assemble_vector(fenicsx.form(gaps)).array[: len(split.subcells)])
    mismatch, on_contact = np.zeros((2, len(spaces.order)))
    np.add.at(mismatch, split.subcells // (spaces.dim + 1), of_subcells)
    mismatch = _with(mismatch, lacked(problem, v, resolution)[:, 0])
    np.add.at(on_contact, problem.contact.facets.cells, _on_contact(problem, v, half=half))
    on_supports = problem.supports.gap(v) * (0.5 if half else 1.0)
    np.add.at(on_contact, problem.supports.on.facets.cells, on_supports)
    return mismatch, on_contact


def lacked(problem: BestDisplacement, v: fem.Function, resolution: Resolution) -> Array:
    """A bound of ‖ℂε(d)‖ and ‖d‖ of the d that v lacks, see `tied`, shape (owned cells, 2) (collective)."""
    if not problem.tied:
        return np.zeros((len(problem.spaces.order), 2))
    squares, _ = lacking(problem.tied, problem.spaces, problem.data, v)
    return np.sqrt(squares * np.column_stack([resolution.stiffest(), np.ones(len(squares))]))


def _with_most(spaces: ElasticSpaces, of_cells: Array) -> Indices:
    """Owned cells with a large share of the gap, and those that share a vertex with one (collective)."""
    comm, squares = spaces.mesh.comm, np.maximum(of_cells, 0.0)
    for share in MOST[spaces.dim] * 0.5 ** np.arange(HALVINGS):
        large = dorfler(np.sqrt(squares), share, comm)
        if comm.allreduce(len(large)) <= MANY[spaces.dim]:
            break
    else:
        large = large[:0]
    nodes = spaces.nodes
    chosen = (sums_at(spaces.mesh.geometry.index_map(), nodes[large])[nodes] > 0).any(axis=1)
    cells = spaces.contact.cells[spaces.inner.rows], spaces.across.cells
    for one, other in (cells, cells[::-1]):  # v may jump between both sides, so both are there
        chosen[other[chosen[one]]] = True
    if spaces.pairs:  # all of them or none: each piece is on two
        at_pairs = np.concatenate([cells_behind(spaces.mesh, each.slaves_and_masters) for each in spaces.pairs])
        if spaces.dim == 3 and any(
            each.parts.tied for each in spaces.pairs
        ):  # what v lacks where it is tied is also on cells around edges
            around = sums_at(spaces.mesh.geometry.index_map(), nodes[at_pairs])[nodes] > 0
            at_pairs = np.flatnonzero(around.any(axis=1))
        some, wanted = np.union1d(np.flatnonzero(chosen), at_pairs), bool(chosen[at_pairs].any())
        fits = comm.allreduce(len(some)) <= MANY[spaces.dim]
        chosen[at_pairs] = comm.allreduce(wanted, MPI.LOR) and fits
    return np.flatnonzero(chosen)


def _on_contact(problem: BestDisplacement, v: fem.Function, *, half: bool) -> Array:
    """∫ (−σ_nn)(g − v_n) over the facets of Γ_C, and what `friction` adds, or a bit more (collective)."""
    contact = problem.contact
    openings, forces = problem.openings_of(v), problem.pressure @ moments_of(contact)
    gap = contact.facets.measure * (forces * openings).sum(axis=1)
    for law in problem.laws:
        gap[law.rows] = law.integrals(openings[law.rows], problem.pressure[law.rows], half=half)
    gap[problem.friction.rows] += problem.friction.gap(v, half=half)
    return gap


def not_in_the_spaces(resolution: Resolution, *, material: bool = True, also: Sequence[str] = ()) -> tuple[str, ...]:
    """Data that are neither exact in the discrete problem nor, where this is enough, enclosed (collective).

    Args:
        resolution: Of the data.
        material: Whether enclosures of the material are enough, as those of loads are.
        also: Data of which the bound contains the rest besides: what v lacks, and what friction does.
    """
    data = resolution.data
    by_constant = not resolution.no_constant
    loads = [each for each in _loads(resolution) if not (by_constant and hidden.is_enclosed(each))]
    degrees = [(each.name, each.polynomial, LARGEST_DEGREE // 2) for each in loads]
    of_v = degree_of(data)
    degrees += [(name, getattr(data, name).polynomial, of_v) for name in ("u_D", "gap") if name not in also]
    names = [name for name, degree, most in degrees if degree is None or degree > most]
    names += sorted({name for name, *_ in data.friction.texts if name not in also})
    springs = data.friction.springs
    names += [] if springs is None else [name for name, datum, _ in springs.data if not is_linear(datum)]
    names += [law.key(name) for law in data.laws.of_parts if not law.moves_only() for name in law.varying()]
    if not (material and is_own_enclosed(data.material)):
        names += [each.name for each in data.material.strains if unresolved_by_quadrature(each)]
    is_known = data.material.uniform or (material and is_enclosed(data.material))
    return tuple(names) if is_known else (*names, " and ".join(data.material.words))
