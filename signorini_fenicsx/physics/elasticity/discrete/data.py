"""The data of an elastic contact problem as the discrete problem sees them: values in points, moments on facets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from mpi4py import MPI
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.discrete.cell_shapes import nearest
from signorini_fenicsx.discrete.data_values import check_cells, check_nodes
from signorini_fenicsx.discrete.datum import DEGREES, Datum, datum_on_parts
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells, linear_from_means, linear_values
from signorini_fenicsx.discrete.points import CellPoints
from signorini_fenicsx.discrete.seen import Values, values_in
from signorini_fenicsx.discrete.vectors import PressureDatum, VectorDatum, vector_datum_of, vector_on_parts
from signorini_fenicsx.discrete.vertex_laws import VertexLaws
from signorini_fenicsx.physics.elasticity.discrete.friction import FrictionBounds, FromBefore, friction_bounds
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells, SplitQuadrature, split_vertices
from signorini_fenicsx.physics.elasticity.discrete.material import (
    STIFF_VOLUME,
    Material,
    check_material,
    material_of,
    mean_compliances,
    regular,
)
from signorini_fenicsx.physics.elasticity.discrete.normal_laws import normal_laws
from signorini_fenicsx.physics.elasticity.discrete.on_facets import (
    Pull,
    RaisedGap,
    add_pulls,
    add_tractions,
    beyond_surfaces,
    facet_moments,
    pulls_of,
    traction_moments,
    tractions_given,
)
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces, SplitMesh
from signorini_fenicsx.physics.elasticity.discrete.supports import Supports, supports_of
from signorini_fenicsx.physics.elasticity.discrete.tools import Tool, moves_at_sites, tools_at, tools_of
from signorini_fenicsx.physics.elasticity.discrete.viscous import Viscous, velocity_of_walls
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem

DEGREE, LARGEST_DEGREE = DEGREES


@dataclass(frozen=True)
class ElasticData:
    """The data on a mesh.

    Attributes:
        f: Force.
        u_D: Displacement where it is given.
        g_N: Tractions and pressures, by the part where they are given; "" is everywhere.
        tractions: ∫ g_N φ_a over the facets of `spaces.neumann`, shape (facets, d, d).
        pulls: Tractions besides those of the problem; on Γ_N they are in `tractions`.
        pulled: Those on Γ_C, linear on each facet: values at the vertices, shape (facets, d, d).
        supports: Elastic supports on some of these facets, whose traction is g_N − Ku.
        gap: g.
        laws: Contact, or other laws between the opening p = g − u_n and the pressure −σ_nn, on Γ_C.
        exact: u, where it is known.
        material: 𝔸 and ε₀.
        quadrature: What the discrete problem takes f and the material by.
        lift: û where it is given, g less p at the reference of its law in the normal component on Γ_C, `slipped` in
            the tangential one where there is friction, and 0 elsewhere: unknowns of this rank, ghosts too.
        load: ⟨g_N, q⟩ for each owned unknown, and the pressures at the references of the laws.
        fixed: Owned unknowns that are given.
        friction: Bounds of the shear.
        slipped: u_t at the sites with friction at the end of the last step in time, 0 without one; the slip is what
            comes after it.
        tools: Foundations that move under given forces; in the end with their motions, by which gap and lift are
            changed, too.
        moved: The means of these motions at the sites.
        given: The constants and functions in the data, with the values that they had.
        motions: The rigid motions that only contact prevents, see `check_rigid_motions`; None if they are not known.
    """

    f: VectorDatum
    u_D: VectorDatum
    g_N: Mapping[str, VectorDatum | PressureDatum]
    tractions: Array
    pulls: tuple[Pull, ...]
    pulled: Array
    supports: Supports
    gap: Datum
    laws: VertexLaws
    exact: VectorDatum | None
    material: Material
    quadrature: SplitQuadrature
    lift: Array
    load: Array
    fixed: npt.NDArray[np.int32]
    friction: FrictionBounds
    slipped: Array
    tools: tuple[Tool, ...]
    moved: Array
    given: Values = ()
    motions: Array | None = None

    @cached_property
    def chains(self) -> Chains:
        """The law of each site: in the normal direction, then friction by its bounds."""
        normal = self.laws.chains
        return normal.followed_by(self.friction.chains) if self.friction else normal

    @property
    def slip_before(self) -> Array:
        """What of û_t at the sites with friction is no slip: that of the last step, and of tools."""
        return self.slipped + self.moved[len(self.laws.p_h) :]

    def reactions(self, spaces: ElasticSpaces, stresses: Array, slip: Array | None = None) -> Array:
        """What foundations, or other bodies, do: −σ_nn at the sites from the references of the laws, then σ_t.

        With the means of u_t − w at the sites with friction σ_t is the part of it that friction has.
        """
        pulls = spaces.tractions(spaces.contact, stresses) - self.pulled
        normal = -np.einsum("nai,ni->na", pulls, spaces.contact.normals).ravel() - self.laws.flux_h
        shear = spaces.in_frames(pulls[spaces.rough_rows])
        return np.append(normal, shear if slip is None else shear + self.supports.of_slip(slip))

    def after(self, spaces: ElasticSpaces, rho: Array) -> ElasticData:
        """The data after a further motion of the tools (collective)."""
        moved = self.moved_by(spaces, tools_at(self.tools, rho, anew=True))
        return replace(moved, tools=tools_at(self.tools, rho))

    def moved_by(self, spaces: ElasticSpaces, tools: Sequence[Tool]) -> ElasticData:
        """The data after motions of some foundations (collective)."""
        if not tools:
            return self
        moves, gap = la.vector(spaces.traces.dofmap.index_map, spaces.dim**2), self.gap
        at_sites = moves_at_sites(spaces, tools) @ np.concatenate([tool.moved for tool in tools])
        moves.array[spaces.site_kinds.unknown] = at_sites
        moves.scatter_forward()
        for tool in tools:
            facets = spaces.part(tool.part)
            moved = np.einsum("nair,r,ni->na", tool.motions(facets.vertices), tool.moved, facets.normals)
            gap = RaisedGap.of(gap, facets, moved)
        return replace(self, gap=gap, lift=self.lift + moves.array, moved=self.moved + at_sites)

    def points(self, spaces: ElasticSpaces, cells: npt.NDArray[np.int32]) -> CellPoints:
        """The points of the quadrature."""
        return CellPoints(spaces.mesh, cells, self.quadrature.points, self.quadrature.weights)

    def compliances(self, spaces: ElasticSpaces, cells: npt.NDArray[np.int32]) -> Array:
        """𝔸 in the points of the quadrature, or in one of each cell where all have the same (collective)."""
        points = self.points(spaces, cells)
        return self.material.compliance(points.first if self.material.uniform else points)

    def stiffness_of_volume(self, spaces: ElasticSpaces) -> float:
        """The largest λ/μ, without limit as ν → ½; in plane stress λ is that in the plane (collective)."""
        largest = 0.0
        for cells in blocks_of_cells(spaces.mesh):
            of_shape, of_volume = mean_compliances(self.compliances(spaces, cells))
            of_volume = np.maximum(of_volume, of_shape / (spaces.dim * STIFF_VOLUME))
            largest = max(largest, float((2 * (of_shape / of_volume - 1) / spaces.dim).max(initial=0.0)))
        return float(spaces.mesh.comm.allreduce(largest, MPI.MAX))

    def moments_of_f(self, spaces: ElasticSpaces, cells: Cells) -> Array:
        """(f, φ_v) for the hats of the vertices of cells, shape (cells, d + 1, d) (collective)."""
        subcells, number, _ = self.quadrature.hats.shape
        values = self.f.values(self.points(spaces, cells.numbers)).reshape(-1, subcells, number, spaces.dim)
        sums = np.einsum("nsqr,sqv,q->nvr", values, self.quadrature.hats, self.quadrature.weights, optimize=True)
        in_order = np.take_along_axis(sums, spaces.order[cells.numbers][:, :, None], axis=1)
        return cells.measure[:, None, None] / subcells * in_order

    def masses(self, spaces: ElasticSpaces, cells: Cells, values: Array | None = None) -> Array:
        """𝔸 times φ_a φ_b over the subcells of cells, see `compliance_product` (collective).

        Args:
            spaces: The spaces.
            cells: The cells.
            values: Their `compliances`, if these are known.
        """
        local, weights = self.quadrature.local, self.quadrature.weights
        size = local.shape[1]
        values = self.compliances(spaces, cells.numbers) if values is None else values
        number, count = values.shape[-1], len(cells.numbers)
        values = np.broadcast_to(values, (count, size * len(weights), number, number))
        products = np.einsum("q,qa,qb->qab", weights, local, local)
        sums = np.tensordot(values.reshape(count, size, len(weights), number, number), products, (2, 0))
        cell, subcell, vertex = (place[..., None] for place in spaces.as_dolfinx(cells.numbers))
        ordered = np.moveaxis(sums, (4, 5), (2, 3))[cell, subcell, vertex, vertex.swapaxes(2, 3)]
        ordered *= cells.measure[:, None, None, None, None, None] / size
        return ordered.transpose(0, 1, 2, 4, 3, 5).reshape(count, size, size * number, size * number)

    def strains(self, spaces: ElasticSpaces, cells: Cells) -> Array:
        """∫ φ_a ε₀ over the subcells of cells, shape (cells, d + 1, d + 1, entries) (collective)."""
        local, weights = self.quadrature.local, self.quadrature.weights
        values = self.material.strain(self.points(spaces, cells.numbers))
        values = values.reshape(len(cells.numbers), local.shape[1], len(weights), values.shape[-1])
        sums = np.einsum("q,qa,nsqe->nsae", weights, local, values, optimize=True)[spaces.as_dolfinx(cells.numbers)]
        strains: Array = cells.measure[:, None, None, None] / local.shape[1] * sums
        return strains

    def growth(self, spaces: ElasticSpaces, cells: Cells) -> Array:
        """∫ tr ε₀ over cells (collective)."""
        if not self.material.strains:
            return np.zeros(len(cells.numbers))
        return np.asarray(self.strains(spaces, cells)[..., : spaces.dim].sum(axis=(1, 2, 3)))


def elastic_data(spaces: ElasticSpaces, problem: ElasticProblem, before: FromBefore | None = None) -> ElasticData:
    """Read the data and check them; in a step in time with the slip of the last step (collective).

    Raises:
        InputError: If something is not finite where it is needed, E ≤ 0 or ν not between −1 and ½ somewhere, or a
            region has no value; if plane stress is asked for in space.
    """
    dim, material = spaces.dim, (material_of if problem.viscosity is None else Viscous.of)(spaces, problem)
    f = vector_datum_of(spaces, "f", problem.f, continuous=False)
    _check_where_given(spaces, problem.u_D)
    u_D = vector_on_parts(spaces, "u_D", problem.u_D)
    g_N, before = tractions_given(spaces, problem), before or FromBefore()
    pulls, friction = pulls_of(spaces, before.pulls), before.friction
    gap = beyond_surfaces(spaces, datum_on_parts(spaces, "gap", problem.gap), problem.surface)
    for pair in spaces.pairs:
        if pair.parts.distance and not pair.parts.tied:
            opened = linear_from_means(pair.pieces.means(len(pair.slaves)))
            gap = RaisedGap.of(gap, spaces.boundary_facets(pair.slaves), opened)
    most = max(DEGREE if degree is None else degree for degree in (f.polynomial, material.degree))
    quadrature = SplitQuadrature.of_degree(dim, min(max(2 if material.uniform else DEGREE, most + 1), LARGEST_DEGREE))
    lift, load = fem.Function(spaces.traces), la.vector(spaces.traces.dofmap.index_map, dim**2)
    laws, (normal, slip) = normal_laws(spaces, problem.normal), spaces.site_kinds
    fixed = _set_given(spaces, u_D, gap, lift)
    lift.x.array[normal.unknown] -= laws.p_h
    tractions = traction_moments(spaces, g_N)
    pulled = add_pulls(spaces, pulls, tractions)
    add_tractions(spaces, tractions, pulled, load)
    load.array[normal.unknown] -= normal.measure * laws.flux_h
    slipped = velocity_of_walls(spaces, problem, u_D) if before.slipped is None else before.slipped
    lift.x.array[slip.unknown] = slipped
    lift.x.scatter_forward()
    data = ElasticData(
        f=f,
        u_D=u_D,
        g_N=g_N,
        tractions=tractions,
        pulls=pulls,
        pulled=pulled,
        supports=supports_of(spaces, problem.support),
        gap=gap,
        laws=laws,
        exact=None if problem.exact is None else vector_datum_of(spaces, "exact", problem.exact),
        material=material,
        quadrature=quadrature,
        lift=lift.x.array.astype(np.float64),
        load=load.array,
        fixed=fixed,
        friction=friction_bounds(spaces, problem.named_laws, problem.joint) if friction is None else friction,
        slipped=slipped,
        tools=tools_of(spaces, problem),
        moved=np.zeros(len(spaces.site_kinds)),
        given=values_in(problem),
    )
    _check_cells(spaces, data)
    return data.moved_by(spaces, before.moved)


def _check_where_given(spaces: ElasticSpaces, u_D: Any) -> None:
    """Refuse a displacement for a part on which none is given.

    Raises:
        InputError: If there is one.
    """
    boundary = spaces.boundary
    free = {part for part in (*boundary.contact, *boundary.neumann) if part not in boundary.fixed}
    for part in [part for part in u_D if part in free] if isinstance(u_D, Mapping) else []:
        what = "in contact" if part in boundary.contact else "in neumann"
        raise InputError(f"[problem] u_D.{part}: no displacement is given on this part, it is {what}")


def _check_cells(spaces: ElasticSpaces, data: ElasticData) -> None:
    """Make sure of f and of the material in the points of the quadrature (collective)."""
    forces = [abs(data.f.values(data.points(spaces, cells))).max(axis=(1, 2)) for cells in blocks_of_cells(spaces.mesh)]
    check_cells("f", np.concatenate(forces), spaces)
    check_material(spaces, data.material, (data.points(spaces, cells) for cells in blocks_of_cells(spaces.mesh)))


@dataclass(frozen=True)
class OnSplit:
    """The material on the split mesh, for forms; see `forms.elasticity`.

    Attributes:
        compliance: 𝔸.
        stiffness: ℂ.
        eigenstrain: The entries of ε₀.
        degree: For which the points in which they are are exact.
        incompressible: Whether ℂ has a large bulk modulus in the place of none that is finite.
    """

    compliance: fem.Function
    stiffness: fem.Function
    eigenstrain: Expr
    degree: int
    incompressible: bool

    def growth(self) -> Array:
        """∫ tr ε₀ over the owned cells of the split mesh (collective)."""
        space = fenicsx.function_space(self.stiffness.function_space.mesh, ("DG", 0))
        if not isinstance(self.eigenstrain, fem.Function):
            return np.zeros(len(fem.Function(space).x.array))
        trace = sum(self.eigenstrain[k] for k in range(space.mesh.geometry.dim))
        return np.asarray(fem.assemble_vector(fenicsx.form(trace * ufl.TestFunction(space) * self.dx)).array)

    @property
    def dx(self) -> ufl.Measure:
        """The measure with these points."""
        rule = {"quadrature_degree": self.degree, "quadrature_scheme": "default"}
        return ufl.Measure("dx", domain=self.stiffness.function_space.mesh, metadata=rule)

    def in_points(self, cells: Indices, least: int) -> tuple[Array, int]:
        """ℂ in points of cells of the split mesh, one if it is constant, and their degree, then the least one."""
        space = self.stiffness.function_space
        lower = self.stiffness.x.array.reshape(-1, space.dofmap.index_map_bs)[space.dofmap.list[cells]]
        at = np.tril_indices(self.stiffness.ufl_shape[0])
        place = np.zeros(self.stiffness.ufl_shape, dtype=np.int64)
        place[at] = place[at[::-1]] = np.arange(len(at[0]))
        return lower[:, :, place], least if lower.shape[1] == 1 else self.degree


def material_on_split(spaces: ElasticSpaces, data: ElasticData, split: SplitMesh, degree: int) -> OnSplit:
    """The material in the points of a quadrature, where it varies (collective).

    Args:
        spaces: The spaces.
        data: The data.
        split: The split mesh, or a part of it.
        degree: For which the quadrature is exact; at least that of the data.
    """
    material, number = data.material, spaces.dim * (spaces.dim + 1) // 2
    square = 2 * min(material.degree or 0, LARGEST_DEGREE // 2)
    rule = SplitQuadrature.of_degree(spaces.dim, max(degree, data.quadrature.degree, square))
    lower = np.tril_indices(number)

    def compliance(points: CellPoints) -> Array:
        return material.compliance(points)[..., lower[0], lower[1]]

    def stiffness(points: CellPoints) -> Array:
        return np.linalg.inv(regular(material.compliance(points)))[..., lower[0], lower[1]]

    def on_split(of_points: Callable[[CellPoints], Array], *shape: int, constant: bool) -> fem.Function:
        return _on_split(spaces, split, rule, of_points, shape, constant=constant)

    constant = material.uniform
    return OnSplit(
        compliance=on_split(compliance, number, number, constant=constant),
        stiffness=on_split(stiffness, number, number, constant=constant),
        eigenstrain=on_split(material.strain, number, constant=constant and material.degree == 0)
        if material.strains
        else ufl.zero(number),
        degree=rule.degree,
        incompressible=material.incompressible,
    )


def _on_split(
    spaces: ElasticSpaces,
    split: SplitMesh,
    rule: SplitQuadrature,
    of_points: Callable[[CellPoints], Array],
    shape: tuple[int, ...],
    *,
    constant: bool,
) -> fem.Function:
    """A function on the split mesh in the points of a rule, or constant on each cell (collective).

    Args:
        spaces: The spaces.
        split: The split mesh, or a part of it.
        rule: The rule.
        of_points: Its values, shape (cells, points, numbers); of a matrix those on and below the diagonal.
        shape: Its shape.
        constant: Whether it is constant.
    """
    cell, symmetry = split.mesh.basix_cell(), len(shape) == 2 or None
    if constant:
        element = basix.ufl.element("DG", cell, 0, shape=shape, symmetry=symmetry)
    else:
        element = basix.ufl.quadrature_element(cell, value_shape=shape, degree=rule.degree, symmetry=symmetry)
    function = fem.Function(fenicsx.function_space(split.mesh, element))
    by_point = function.x.array.reshape(-1, function.function_space.dofmap.index_map_bs)
    for block in blocks_of_cells(spaces.mesh):
        cells = block[split.cells[block, 0] >= 0]
        size = len(cells), spaces.dim + 1, len(rule.weights)
        points, order = CellPoints(spaces.mesh, cells, rule.points, rule.weights), spaces.order[cells]
        dofs = function.function_space.dofmap.list[split.cells[cells]]
        if constant:
            by_point[dofs] = of_points(points.first)[:, None]
            continue
        values = of_points(points).reshape(*size, by_point.shape[1])
        values = np.take_along_axis(values, order[:, :, None, None], axis=1)
        places = np.take_along_axis(points.x.reshape(*size, spaces.dim), order[:, :, None, None], axis=1)
        own_places = np.einsum("qa,nsai->nsqi", rule.local, split_vertices(spaces.vertices[cells]))
        by_point[dofs] = np.take_along_axis(values, nearest(own_places, places)[..., None], axis=2)
    return function


def _set_given(spaces: ElasticSpaces, u_D: VectorDatum, gap: Datum, lift: fem.Function) -> npt.NDArray[np.int32]:
    """Write what û is where it is given, or g on Γ_C; returns the unknowns that are given (collective)."""
    tied = spaces.boundary_facets(spaces.tied)
    unknowns = [spaces.unknowns(tied, k).ravel() for k in range(spaces.dim)]
    for facets, k, axes, _ in spaces.fixed:
        moments = facet_moments(spaces, "u_D", u_D, facets, "where the displacement is given")
        places = spaces.unknowns(facets, k)
        lift.x.array[places] = np.einsum("nar,nr->na", linear_values(moments, facets.measure), axes)
        unknowns.append(places.ravel())
    for index, part in enumerate(spaces.part_names):
        check_nodes(spaces, "gap", gap, spaces.contact.facets[spaces.part_of_facet == index], f"on part '{part}'")
    moments = facet_moments(spaces, "gap", gap, spaces.contact, "on Γ_C")
    normal = spaces.site_kinds["normal"]
    lift.x.array[normal.unknown] = moments.ravel() / normal.measure
    given = np.concatenate(unknowns)
    return given[~np.isin(given, normal.unknown)]  # a site that is closed is held by its law
