"""A continuous function near u that is admissible under the laws on Γ_S: v = u_D on Γ_D, and within what they allow.

v is quadratic on each cell, except near Γ_D and near parts of Γ_S with bounds of u, the vertical ends of a graph. There

    v = min(max(v_2 + χ_a(a − I_ha) + χ_D(u_D − I_hu_D − χ_a(a − I_ha)) + v_1, b − ℓ), b' + ℓ)

for each lower bound b and each upper bound b'. v_2 is quadratic, by Bernstein coefficients between those of I_hb and
I_hb' on facets with bounds. χ_a, χ_D and v_1 are linear on each cell. χ_D is 1 on Γ_D. χ_a is 1 in vertices of Γ_S
where u is about a: those of facets that a bound holds, and those all of whose facets are on another steep segment, such
as with the level outside of a wall or of a river. v_1 moves v by as much as it is beyond a bound in sampled points. ℓ
is 0 on the facets with the bound and grows from there, so that the bound changes v only next to them.

v_2 is relaxed like the trace of the Signorini problem. On Γ_S the gap is not smooth at vertical segments of a graph; v
stays on that side of them where the piece of the graph is that `pieces_beside` of `laws` chooses. On this piece it is
quadratic. A rigid segment is one that is vertical where it has y·n: up to its end the gap is then taken to be larger
than it is. In Ω it is the same, see `cell_springs`.

On parts inside the domain all this is about the jump of v: while v_2 is relaxed, its nodes of the named side have the
jump, see `physics.diffusion.discrete.nodes`. The only bound b of a jump enters by χ_b(b − I_hb) too, with χ_b = 1 in
all these nodes. u_D is taken from each side there, and v_1 moves the named side where χ_D(u_D − I_hu_D) puts the jump
beyond a bound. On slaves of pairs it is about the jump of v + d, with the d of `certificate.opposite` that v leaves
out.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from mpi4py import MPI
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.owned import cell_dofs, owned_cells, sums_at
from signorini_fenicsx.discrete.bernstein import coefficients_of, degree_of, exponents, to_bernstein
from signorini_fenicsx.discrete.bernstein import nodes as lattice
from signorini_fenicsx.discrete.continuity import facet_nodes
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import extreme_around
from signorini_fenicsx.discrete.part_laws import PartLaw
from signorini_fenicsx.discrete.points import facet_lattice, facet_type, in_cells
from signorini_fenicsx.expressions.products import EXACT
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import BEYOND, ROOM, SAMPLES, Indices, Trace, averaged
from signorini_fenicsx.physics.diffusion.bound.cell_springs import LawPieces
from signorini_fenicsx.physics.diffusion.bound.inside import Inside, add_load
from signorini_fenicsx.physics.diffusion.bound.law_bounds import (
    ROUNDING,
    Bound,
    LawTrace,
    bounds_of_jumps,
    depth,
    jumps_obey,
    level_of,
)
from signorini_fenicsx.physics.diffusion.bound.levels import levels
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric
from signorini_fenicsx.physics.diffusion.bound.on_gamma_s import OnGammaS
from signorini_fenicsx.physics.diffusion.bound.rays import BoundedSimplices, Ray
from signorini_fenicsx.physics.diffusion.bound.relaxation import TIE, Box, Stiffness, Weight, relax
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.nodes import (
    Jumps,
    largest_around,
    opposites,
    quadratic_on_sides,
    set_means,
)
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solution import Solution

OF_KAPPA = 6
"""Degree of the quadrature with a κ that varies, while v is relaxed."""
HINDRANCES = (
    "the bounds of u leave no room where parts of Γ_S meet",
    BEYOND,
    "a part inside the domain forbids the jump 0 where it ends",
)
OF_LAWS = "a law in Ω holds in cells at the slave of a pair"
OF_JUMPS = "a jump of u_D, or of u where parts inside the domain end or meet others, is beyond a bound"


def law_trace(
    solution: Solution,
    metric: CellMetric,
    y: fem.Function,
    on: OnGammaS,
    inside: Inside,
    field: fem.Function | None = None,
) -> Trace:
    """A continuous function that is admissible under the laws (collective).

    Args:
        solution: The solution.
        metric: Metric of the owned cells.
        y: The flux to which the function has a small gap.
        on: Γ_S with the pieces of the laws.
        inside: The laws in Ω.
        field: A quadratic function to which an admissible one near in energy is wanted, by its values in the nodes of
            `bernstein`; None for the reconstruction with a small gap to y.
    """
    spaces, data, mesh, rays = solution.spaces, solution.data, solution.spaces.mesh, inside.rays
    v, near = (averaged(solution), y) if field is None else (field.copy(), field.copy())
    space = v.function_space
    nodes, facet = facet_nodes(space, spaces.facets), facet_type(mesh.topology.dim)
    on_dirichlet, at_nodes = _given(space, spaces, data.u_D), on.goal.at(spaces, lattice(facet, degree_of(space)))
    u_D, jumps = quadratic_on_sides(data.u_D, space, spaces), Jumps.of(space, spaces, on.holding)
    v.x.array[on_dirichlet] = u_D.x.array[on_dirichlet]
    on_cuts, known = ~np.isin(np.arange(len(nodes)), spaces.outer_rows), np.union1d(on_dirichlet, jumps.tied)
    # at meetings there are no jumps that could be held or bounded
    fixed, at_meeting = np.union1d(known, jumps.tips), on_cuts[:, None] & np.isin(nodes, jumps.meets)
    jumps.taken(v, of_values=True)
    held, ends = on.held(at_nodes), on.ends(at_nodes)
    pieces = LawPieces.of(inside, metric, mesh.comm) if field is None and inside.parts else None
    still = largest_around(space, nodes, np.where(held[1], 1.0, 0.0)) > 0
    if pieces is not None:
        still |= pieces.hold(v, fixed)
    if field is None:
        _hold(v, nodes, held, fixed, (on_cuts, jumps.meets), (~on_cuts, np.flatnonzero(jumps.follows)))
    else:  # it need not be near a piece of the law
        ends[2:] = ends[:2]
    limits, bounds = ends[:2], _asked(on, v, nodes, [coefficients_of(end, facet) for end in ends])
    bounds, ends = (_without(each, at_meeting | (jumps.follows[nodes] & ~on_cuts[:, None])) for each in (bounds, ends))
    hindrance = _hindrance(v, nodes, ends[:2], (np.setdiff1d(on_dirichlet, jumps.tips), jumps.tips))
    low, high, soft_low, soft_high = (
        extreme_around(space, nodes, end, largest=number % 2 == 0) for number, end in enumerate(bounds)
    )
    jumps.undone(v, of_values=True)
    for function in (v, u_D) if field is None else (v, u_D, near):
        to_bernstein(function)
    limits_of_rays = [ray.limits(v, spaces.frame) for ray in rays]
    for ray, (limit, _) in zip(rays, limits_of_rays, strict=True) if field is None else ():
        ray.touch(v, limit, on_dirichlet)
    jumps.taken(v)
    wide = _ends_inside(rays, [limit for limit, _ in limits_of_rays], jumps, len(v.x.array))
    of_pieces = wide if pieces is None else pieces.ends(space, jumps)
    hard, soft = _within((low, high), wide), _within((soft_low, soft_high), wide, of_pieces)
    box = Box.of(hard, soft, fixed, v.x.array, still)
    box.project(v.x.array, TIE * mesh.comm.allreduce(float(np.abs(v.x.array).max(initial=0.0)), MPI.MAX))
    if jumps.basis is not None:
        _join_at_meetings(v, jumps, spaces.inner.rows, at_meeting, limits, on_dirichlet)
    given, without = np.union1d(known, jumps.meets), (np.zeros(len(v.x.array)), None)
    load, beta = _on_gamma_s(on, v, nodes, at_meeting, jumps, inside) if field is None else without
    stiffness = Stiffness(spaces, _weight(solution), beta, None if pieces is None else pieces.springs(space))
    flux, by_nodes = (_driving(data, y), on.by_nodes) if field is None else (stiffness.kappa[0] * ufl.grad(near), False)
    relax(v, stiffness, flux, load, given, box, jumps, by_nodes=by_nodes)
    jumps.undone(v)
    v.x.array[on_dirichlet] = u_D.x.array[on_dirichlet]  # where a slave is tied to what is given otherwise
    for ray, limits_of_ray in zip(rays, limits_of_rays, strict=True):
        ray.move_inside(v, limits_of_ray, on_dirichlet)
    return _with_exact_data(on, data, _with_levels(on, data, v, u_D, pieces), inside, metric, hindrance=hindrance)


def _driving(data: Data, y: fem.Function) -> Expr:
    """The flux y less a given flux (collective)."""
    return y if data.b is None else y - data.b.function(data.kappa)


def _weight(solution: Solution) -> Weight:
    """κ_h, or where κ varies within cells of RT1, κ in points of cells; with its measure (collective)."""
    spaces, data, kappa = solution.spaces, solution.data, solution.data.kappa
    if spaces.degree == 0 or kappa.polynomial == 0:
        return data.kappa_h, ufl.dx
    cell, rule = spaces.mesh.basix_cell(), {"quadrature_degree": OF_KAPPA, "quadrature_scheme": "default"}
    element = basix.ufl.quadrature_element(cell, kappa.shape, degree=OF_KAPPA)
    weight = fem.Function(fenicsx.function_space(spaces.mesh, element))
    values, dofs = weight.x.array.reshape(-1, *kappa.shape), cell_dofs(weight.function_space)
    for points in in_cells(spaces.mesh, owned_cells(spaces.mesh), basix.make_quadrature(cell, OF_KAPPA)[0]):
        values[dofs[points.rows]] = kappa.values(points)
    weight.x.scatter_forward()
    return weight, ufl.dx(metadata=rule)


def _hold(
    v: fem.Function,
    nodes: Indices,
    held: tuple[Array, Mask, Mask],
    fixed: npt.NDArray[Any],
    *groups: tuple[Mask, npt.NDArray[Any]],
) -> None:
    """Set v where laws hold it, but not in fixed nodes, nor on groups of facets in some nodes (collective)."""
    values, fully, nearly = held
    for facets, left in groups:
        kept = np.union1d(fixed, left)
        before = v.x.array[kept]
        for some in (nearly & facets, fully & facets):
            set_means(v, nodes[some], values[some])
        v.x.array[kept] = before


def _asked(on: OnGammaS, v: fem.Function, nodes: Indices, bounds: list[Array]) -> list[Array]:
    """The coefficients of bounds on Γ_S as `BoundedSimplices` has them, from those of their interpolants (collective).

    `v` has values in nodes, not yet coefficients. Bounds of jumps inside the domain stay as they are.
    """
    spaces, space = on.spaces, v.function_space
    facet = facet_type(spaces.mesh.topology.dim)
    for part in on.goal.parts:
        rows = np.intersect1d(part.rows, spaces.outer_rows)
        for end, (sign, datum) in enumerate(zip((1.0, -1.0), part.bounds, strict=True)):
            if datum is None or datum.number is not None or datum.pieces is None:
                continue
            touched = on.segment[rows] == (0 if sign > 0 else on.goal.chains.count[rows])
            of_v = coefficients_of(v.x.array[nodes[rows]], facet)
            simplices = BoundedSimplices(spaces.corners[rows], spaces.cells[rows], nodes[rows], of_v, touched)
            bounds[end][rows], *others = simplices.asked(datum, sign, space, spaces.frame)
            changed = rows[np.any(others, axis=0)]
            bounds[end + 2][changed] = bounds[end][changed]
    return bounds


def _ends_inside(rays: Sequence[Ray], limits: Sequence[Array], jumps: Jumps, number: int) -> tuple[Array, Array]:
    """The least and the largest coefficient of so many nodes that bounds in Ω allow, but for nodes with a jump.

    There cutting off takes care of the named side, and `limits` are changed in place.
    """
    floor, ceiling = (np.full(number, end) for end in (-np.inf, np.inf))
    for ray, limit in zip(rays, limits, strict=True):
        limit[jumps.jump] = -ray.sign * np.inf
        if ray.sign > 0:
            floor = np.maximum(floor, limit)
        else:
            ceiling = np.minimum(ceiling, limit)
    return floor, ceiling


def _join_at_meetings(
    v: fem.Function,
    jumps: Jumps,
    rows: npt.NDArray[Any],
    at_meeting: Mask,
    limits: Sequence[Array],
    on_dirichlet: npt.NDArray[Any],
) -> None:
    """Let v have no jump in nodes where parts inside the domain meet, if it is beyond its bounds (collective)."""
    named, across = jumps.pairs
    jump, beyond = v.x.array[named] - v.x.array[across], np.zeros(len(v.x.array), dtype=bool)
    slack = ROUNDING * v.function_space.mesh.comm.allreduce(float(np.abs(v.x.array).max(initial=0.0)), MPI.MAX)
    low, high = (limit[rows] for limit in limits)
    beyond[named[at_meeting[rows] & ((jump < low - slack) | (jump > high + slack))]] = True
    jumps.join(v, beyond, on_dirichlet)


def _given(space: fem.FunctionSpace, spaces: Spaces, u_D: Datum) -> npt.NDArray[Any]:
    """Nodes of this rank where v_2 is I_hu_D: those of Γ_D, and inside edges of cuts with both ends there (collective).

    On these edges χ_D is 1, so v is u_D there, and v_1 could not move it.
    """
    dim = space.mesh.topology.dim
    on_dirichlet = fem.locate_dofs_topological(space, dim - 1, spaces.dirichlet_facets)
    if not spaces.inner.present or u_D.number is not None:
        return on_dirichlet
    is_given = np.zeros(space.dofmap.index_map.size_local + space.dofmap.index_map.num_ghosts, dtype=bool)
    is_given[on_dirichlet] = True
    nodes = facet_nodes(space, np.concatenate([spaces.facets[spaces.inner.rows], spaces.inner.facets]))
    between = exponents(facet_type(dim), degree_of(space)) > 0  # these vertices of the facet
    is_given[nodes[(is_given[nodes[:, None, :dim]] | ~between).all(axis=2)]] = True
    return np.flatnonzero(sums_at(space.dofmap.index_map, np.flatnonzero(is_given)))


def _without(ends: list[Array], where: Mask) -> list[Array]:
    """Lower and upper bounds in turn, none in some nodes of facets."""
    return [np.where(where, np.inf if number % 2 else -np.inf, end) for number, end in enumerate(ends)]


def _within(*ends: tuple[Array, Array]) -> tuple[Array, Array]:
    """The largest of the lower and the least of the upper ones of some ends."""
    lower, upper = zip(*ends, strict=True)
    return np.maximum.reduce(lower), np.minimum.reduce(upper)


def _on_gamma_s(
    on: OnGammaS, v: fem.Function, nodes: Indices, at_meeting: Mask, jumps: Jumps, inside: Inside
) -> tuple[Array, fem.Function | None]:
    """The slope of the gap on Γ_S and on bounds in Ω per node of this rank, and β of springs on Γ_S (collective).

    On facets inside the domain it is for the jumps.
    """
    spaces, comm, apart = on.spaces, on.spaces.mesh.comm, ~at_meeting.any(axis=1)
    at_points = on.goal.at(spaces, *basix.make_quadrature(facet_type(spaces.mesh.topology.dim), on.goal.degree()))
    numbers, of_facets = v.function_space.dofmap.index_map, on.loads(at_points)
    outer = np.isin(np.arange(len(apart)), spaces.outer_rows)
    load = sums_at(numbers, nodes[apart & ~outer], of_facets[apart & ~outer])
    load[jumps.tips] = 0.0
    on_v = sums_at(numbers, nodes[outer], of_facets[outer])[: numbers.size_local]
    if inside.rays:
        in_cells = fem.Function(v.function_space)
        add_load(in_cells, inside.spaces, inside.forces)
        in_cells.x.scatter_reverse(la.InsertMode.add)
        on_v += in_cells.x.array[: numbers.size_local]
    load[: numbers.size_local] += jumps.transposed(on_v)
    slope = spaces.multiplier(np.where(apart, on.slope(at_points).mean(axis=1), 0.0), "beta")
    return load, slope if comm.allreduce(bool(slope.x.array.any()), MPI.LOR) else None


def _hindrance(v: fem.Function, nodes: Indices, ends: list[Array], fixed: Sequence[npt.NDArray[Any]]) -> str:
    """Why the laws leave no room for a continuous v, or for its jump, in words; empty if they do (collective).

    `fixed` are the nodes where v is given, and those where its jump is 0.
    """
    comm = v.function_space.mesh.comm
    low, high = (extreme_around(v.function_space, nodes, end, largest=end is ends[0]) for end in ends)
    rounding = 1e-12 * comm.allreduce(np.abs(v.x.array).max(initial=0.0), MPI.MAX)
    v_given = v.x.array.copy()
    v_given[fixed[1]] = 0.0
    beyond = (low > v_given + rounding) | (v_given > high + rounding)
    hindered = np.array([(low > high + rounding).any(), *(beyond[some].any() for some in fixed)])
    comm.Allreduce(MPI.IN_PLACE, hindered, MPI.LOR)
    return next((words for words, is_hindered in zip(HINDRANCES, hindered, strict=True) if is_hindered), "")


def _with_levels(on: OnGammaS, data: Data, v: fem.Function, u_D: fem.Function, pieces: LawPieces | None) -> LawTrace:
    """The trace with u_D and levels themselves instead of their interpolants (collective)."""
    mesh, linear = on.spaces.mesh, fenicsx.function_space(on.spaces.mesh, ("Lagrange", 1))
    near_dirichlet, moved = fem.Function(linear), fem.Function(linear)
    facets = on.spaces.dirichlet_facets
    near_dirichlet.x.array[fem.locate_dofs_topological(linear, mesh.topology.dim - 1, facets)] = 1.0
    of_pairs = opposites(v.function_space, on.spaces)
    return LawTrace((data.u_D, u_D), v, near_dirichlet, moved, levels(on, pieces, v, linear), [], of_pairs)


def _with_exact_data(
    on: OnGammaS, data: Data, trace: LawTrace, inside: Inside, metric: CellMetric, *, hindrance: str
) -> Trace:
    """The trace with bounds themselves instead of their interpolants (collective)."""
    spaces, mesh, near_dirichlet = on.spaces, on.spaces.mesh, trace.near_dirichlet
    linear, facet_dim = near_dirichlet.function_space, mesh.topology.dim - 1
    on_dirichlet, changed = np.flatnonzero(near_dirichlet.x.array), [near for _, _, near in trace.levels]
    touching = _cells_with(changed, linear)
    if data.u_D.number is None or trace.levels:
        changed.append(near_dirichlet)
    corners, used = facet_nodes(linear, spaces.facets), [data.u_D, *(datum for datum, _, _ in trace.levels)]
    for part in on.goal.parts:
        for sign, datum in zip((1.0, -1.0), _bounds(on, part), strict=True):
            if datum is None or (datum.number is not None and not changed):
                continue
            rows = np.intersect1d(part.rows, spaces.outer_rows)  # inside, coefficients and levels are enough
            facets, is_bounded = spaces.facets[rows], fem.Function(linear)
            is_bounded.x.array[fem.locate_dofs_topological(linear, facet_dim, facets)] = 1.0
            lattice = facet_lattice(mesh, facets, SAMPLES)
            short = sign * (datum.values(lattice) - trace.jet(lattice)[:, :, 0])
            fixed = np.isin(corners[rows], on_dirichlet).any(axis=1)
            lacking = np.where(fixed, *ROOM[::-1]) * np.maximum(short.max(axis=1, initial=0.0), 0.0)
            _move(trace, corners[rows], sign, lacking)
            trace.bounds.append(Bound(datum, sign, is_bounded, depth(trace, datum, sign, is_bounded, spaces)))
            changed.append(is_bounded)
            used.append(datum)
    altered = _cells_with(changed, linear)
    for ray in inside.rays:
        bound = ray.bound(linear)
        if not ray.everywhere:
            bound = replace(bound, depth=depth(trace, ray.datum, ray.sign, bound.near, spaces))
        trace.bounds.append(bound)
        if not ray.is_quadratic or not ray.everywhere:
            changed.append(bound.near)
            used.append(ray.datum)
    if spaces.several and changed:
        _move_jumps(trace, on)
    lacking, hindrance = _jumps_judged(trace, on, inside, hindrance)
    return Trace(
        v=trace.v,
        on_gamma_s=partial(trace.on_gamma_s, spaces),
        cells=_cells_with(changed, linear),
        at_dirichlet=_cells_with([each for each in changed if each is near_dirichlet], linear),
        touching=touching,
        altered=altered,
        hindrance=hindrance,
        degree=max(
            quadrature_degree(*used, data.kappa), *(2 * min(datum.polynomial or 0, EXACT) + 2 for datum in used)
        ),
        parts=trace,
        lacking=np.sqrt(metric.kappa_max * lacking[:, 0]),
        lacked=np.sqrt(lacking[:, 1]),
    )


def _jumps_judged(trace: LawTrace, on: OnGammaS, inside: Inside, hindrance: str) -> tuple[Array, str]:
    """What v lacks at pairs, see `LawTrace.lacking`, and why the jumps are not admissible, in words (collective)."""
    spaces, lacking = on.spaces, np.zeros((len(on.spaces.cell_measures), 2))
    if spaces.pairs:
        lacking, of_pairs = trace.lacking(spaces)
        of_laws = OF_LAWS if inside.meets(lacking[:, 0] > 0) else ""
        hindrance = hindrance or of_pairs or of_laws or on.beyond()
    if spaces.several:
        hindrance = hindrance or ("" if jumps_obey(trace, on.goal.parts, spaces) else OF_JUMPS)
    return lacking, hindrance


def _move_jumps(trace: LawTrace, on: OnGammaS) -> None:
    """Change v_1 on the named side of cuts where the jump of v is beyond a bound in sampled points (collective).

    It is 0 on Γ_D, and its jump at tips, so it has to grow from there as fast as what is lacking does.
    """
    spaces, linear = on.spaces, trace.moved.function_space
    lattice = facet_lattice(spaces.mesh, spaces.facets, SAMPLES)
    corners, still = facet_nodes(linear, spaces.facets), trace.near_dirichlet.copy()
    still.x.array[Jumps.of(linear, spaces).tips] = 1.0
    room = 1 - lattice.linear(still)[:, :, 0]
    for rows, sign, limit in bounds_of_jumps(on.goal.parts, spaces):
        short, free = sign * (limit - trace.on_gamma_s(spaces, lattice)[rows]), room[rows] > 0
        steep = np.where(free, short, 0.0) / np.where(free, room[rows], 1.0)
        _move(trace, corners[rows], sign, ROOM[1] * steep.max(axis=1, initial=0.0))


def _move(trace: LawTrace, corners: Indices, sign: float, lacking: Array) -> None:
    """Raise v_1 (sign 1) or lower it (−1) in the corners of facets by what is lacking, but not on Γ_D (collective)."""
    moved = trace.moved
    moved.x.array[:] += sign * largest_around(moved.function_space, corners, lacking)
    moved.x.array[trace.near_dirichlet.x.array > 0] = 0.0


def _cells_with(functions: list[fem.Function], space: fem.FunctionSpace) -> Indices:
    """The owned cells where the sum of linear functions ≥ 0 is not 0."""
    if not functions:
        return np.empty(0, dtype=np.int32)
    total = np.sum([each.x.array for each in functions], axis=0)
    return np.flatnonzero(total[cell_dofs(space)].any(axis=1)).astype(np.int32)


def _bounds(on: OnGammaS, part: PartLaw) -> list[Datum | None]:
    """The data that bound u below and above, at vertical ends of the graph or at rigid ones (collective)."""
    ends = 0, len(part.law.segments) - 1
    yielding = np.array([np.count_nonzero(~on.rigid[part.rows, end]) for end in ends])
    counts = on.spaces.mesh.comm.allreduce(yielding).tolist()
    levels = [None if count > 0 else level_of(part, end, end) for end, count in zip(ends, counts, strict=True)]
    return [bound or level for bound, level in zip(part.bounds, levels, strict=True)]
