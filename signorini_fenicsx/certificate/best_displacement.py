"""The conforming displacement nearest to a stress: polynomials on the split mesh that stay off the foundation.

It minimises the gap of `forms/elasticity.py` for given y, which is a problem of its own with one condition per node of
Γ_C: contact or free. So the loop over the sets solves it, as it solves the problem itself. With friction, |v_t| is
bounded by its coefficients in Bernstein's basis, and each of these is a site with three states.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.fem.petsc import assemble_matrix
from petsc4py import PETSc

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.certificate.boundary_nodes import (
    boundary_nodes,
    direction_of_contact,
    excess,
    facet_coefficients,
)
from signorini_fenicsx.contact.backend import Backend, Inexact, Iterate
from signorini_fenicsx.contact.chains import Chains, joined
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.field_change import FieldChange
from signorini_fenicsx.discrete.points import CellPoints
from signorini_fenicsx.forms.elasticity import strain, strain_energy
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.linear.kept_factors import KeptFactors
from signorini_fenicsx.linear.petsc import direct_solver
from signorini_fenicsx.physics.elasticity.data import ElasticData, blocks_of_cells, facet_rule
from signorini_fenicsx.physics.elasticity.friction import friction_chains
from signorini_fenicsx.physics.elasticity.johnson_mercier import SplitQuadrature, split_vertices
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.split_mesh import SplitMesh


class BestDisplacement:
    """A backend whose sites are the nodes of Γ_C, then those with friction.

    Attributes:
        split: The split mesh, or the part of it on which the displacement is.
        sigma: y.
        contact: The facets of Γ_C on it.
        moduli: 2μ and θ on it.
        dx: The measure that goes with them.
    """

    name = "conforming"
    noun = ("node", "nodes")
    inexact: Inexact | None = None
    precise: Callable[[], Backend[Iterate]] | None = None

    def __init__(
        self,
        spaces: ElasticSpaces,
        data: ElasticData,
        stresses: Array,
        split: SplitMesh,
        degree: int,
        v: fem.Function | None = None,
    ):
        """Assemble (collective).

        Args:
            spaces: The spaces.
            data: The data.
            stresses: y on all cells, as in `SplitMesh.values`.
            split: The split mesh, or a part of it.
            degree: Of the polynomials.
            v: For a part, the displacement on the whole mesh that the one on the part has to continue.

        Raises:
            InputError: If PETSc refuses an option.
        """
        self.spaces, self._data, self.split, self.sigma = spaces, data, split, split.stress(stresses)
        self.comm, mesh, dim = spaces.mesh.comm, split.mesh, spaces.dim
        element = basix.ufl.element("P", mesh.basix_cell(), degree, basix.LagrangeVariant.bernstein, shape=(dim,))
        self.space = fenicsx.function_space(mesh, element)
        self.contact = facet_coefficients(split, self.space, spaces.contact)
        self.moduli, self.dx = moduli_on_split(spaces, data, split, 2 * degree - 2)
        entities = np.column_stack([self.contact.cells, np.full(len(self.contact.cells), dim)])
        domain = entities[np.argsort(entities[:, 0])].astype(np.int32).ravel()
        ds = ufl.Measure("ds", domain=mesh, subdomain_data=[(1, domain)])(1)
        u, w = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        n = ufl.FacetNormal(mesh)
        pull = ufl.inner(self.sigma, strain(w)) * self.dx - ufl.dot(self.sigma * n, w) * ds
        load = fem.assemble_vector(fenicsx.form(pull))
        load.scatter_reverse(la.InsertMode.add)
        natural = assemble_matrix(fenicsx.form(strain_energy(u, w, *self.moduli, self.dx)))
        natural.assemble()

        known = None if v is None else self._continued(v)
        self.nodes = boundary_nodes(spaces, data, split, self.space, known)
        self._size = self.space.dofmap.index_map.size_local
        turn = self._turn(natural)
        self._operator = ConstrainedMatrix(natural.ptap(turn), PETSc.Mat.Option.SPD)
        self._lift, self._x = self._operator.matrix.createVecs()
        lift = self.nodes.values.copy()
        touching = np.flatnonzero(self.nodes.touching)
        lift[touching, self.nodes.given[touching]] = self.nodes.bound[touching]
        self._lift.array_w[:] = lift[: self._size].ravel()
        self._load = self._lift.duplicate()
        self._operator.natural.mult(self._lift, self._load)
        turned = np.einsum("nij,ni->nj", self.nodes.frames, load.array.reshape(-1, dim))
        self._load.array_w[:] = turned[: self._size].ravel() - self._load.array_r
        self._given = np.flatnonzero(np.arange(dim) < self.nodes.given[: self._size, None]).astype(np.int32)
        self._touching = np.flatnonzero(self.nodes.touching[: self._size])
        self._rubbing, column, bound = self._friction()
        self._sites = np.concatenate(
            [self._touching * dim + self.nodes.given[self._touching], self._rubbing * dim + column]
        ).astype(np.int32)
        self.sites, self.dofs = len(self._sites), self._operator.matrix.getSize()[0]
        self.chains = Chains.at_corner(len(self._touching))
        if data.friction is not None:
            rows = np.split(np.arange(self.sites), [len(self._touching)])
            self.chains = joined([(rows[0], self.chains), (rows[1], friction_chains(bound))], self.sites)
        self._diagonal = float(self._operator.natural.getDiagonal().norm(PETSc.NormType.INFINITY))
        self._solver = direct_solver(self._operator.matrix, "cholesky", "facet_")
        self._factors = KeptFactors(self._solver, self._operator.natural, self._sites, dim)

    @cached_property
    def rough(self) -> tuple[Indices, Indices]:
        """The facets with friction: where they are in `contact`, and in `ElasticSpaces.rough`."""
        here, everywhere = self.contact.rows, self.spaces.rough_rows
        return np.flatnonzero(np.isin(here, everywhere)), np.flatnonzero(np.isin(everywhere, here))

    def _friction(self) -> tuple[Indices, Indices, Array]:
        """Owned nodes with friction, which of their directions is the tangent, and ∫ g B for the B of each node."""
        size, dim = self._size, self.spaces.dim
        sums = la.vector(self.space.dofmap.index_map)
        np.add.at(sums.array, self.contact.nodes[self.rough[0]], self._rubbing_weights())
        sums.scatter_reverse(la.InsertMode.add)
        column = self.nodes.given[:size] + self.nodes.touching[:size]
        rubbing = np.flatnonzero((sums.array[:size] > 0) & (column < dim))
        return rubbing, column[rubbing], sums.array[rubbing]

    def _rubbing_weights(self) -> Array:
        """∫ g B over the facets with friction for the B of each of their nodes, shape (facets, nodes)."""
        if self._data.friction is None:
            return np.zeros((0, self.contact.nodes.shape[1]))
        measure = self.contact.facets.measure[self.rough[0]]
        return np.einsum("n,na,ak->nk", measure, self._data.friction.bound[self.rough[1]], self._moments())

    def _continued(self, v: fem.Function) -> fem.Function:
        """The displacement on the whole split mesh as one of this space."""
        found = fem.Function(self.space)
        cells = np.arange(len(self.split.subcells), dtype=np.int32)
        found.interpolate(v, self.spaces.split.cells.ravel()[self.split.subcells].astype(np.int32), cells)
        found.x.scatter_forward()
        return found

    def _turn(self, natural: PETSc.Mat) -> PETSc.Mat:
        """From coefficients in the frames of the nodes to those in coordinates."""
        dim, frames = self.spaces.dim, self.nodes.frames[: self._size]
        turn = PETSc.Mat().create(self.comm)
        turn.setSizes(natural.getSizes(), bsize=dim)
        turn.setType("aij")
        begin = natural.getOwnershipRange()[0]
        number = begin + np.arange(self._size * dim, dtype=PETSc.IntType).reshape(-1, dim)
        shape = frames.shape
        rows, columns = np.broadcast_to(number[:, :, None], shape), np.broadcast_to(number[:, None, :], shape)
        turn.setPreallocationCOO(rows.ravel(), columns.ravel())
        turn.setValuesCOO(frames.ravel(), PETSc.InsertMode.INSERT_VALUES)
        return turn

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return self._solver.name()

    def solve(self, conditions: SiteConditions) -> Iterate:
        """Solve as `Backend.solve` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        held = conditions.kind == Condition.ZERO_TRACE
        b, reaction = self._load.copy(), self._load.duplicate()
        if conditions.has_values:
            b.array_w[self._sites] -= np.where(conditions.kind == Condition.NO_FLUX, conditions.value, 0.0)
        if not self._factors.solve(b.array_r, self._x, held):
            essential = np.concatenate([self._given, self._sites[held]])
            none = np.empty(0, dtype=np.int32)
            self._operator.impose(essential, none, none)
            b.array_w[essential] = 0.0
            self._solver.solve(b, self._x)
            self._factors.keep(essential, held)
        self._operator.natural.mult(self._x, reaction)
        reaction.aypx(-1.0, self._load)
        p, flux = conditions.clean(-self._x.array_r[self._sites], reaction.array_r[self._sites], 1.0)
        u = self._conforming(self._x.array_r + self._lift.array_r)
        iterations = self._solver.ksp.getIterationNumber()
        return Iterate(p=p, flux=flux, linear_iterations=iterations, sigma=self.sigma, u=u)

    def _conforming(self, turned: Array) -> fem.Function:
        dim = self.spaces.dim
        v = fem.Function(self.space, name="v")
        v.x.array[: len(turned)] = np.einsum(
            "nij,nj->ni", self.nodes.frames[: self._size], turned.reshape(-1, dim)
        ).ravel()
        v.x.scatter_forward()
        return v

    def admissible(self, v: fem.Function) -> bool:
        """Push v back where it passes the foundation; whether it then stays off it everywhere (collective)."""
        back, helps = excess(self.spaces, self._data, self.nodes, self.contact, v)
        v.x.array.reshape(-1, self.spaces.dim)[:] -= back[:, None] * direction_of_contact(self.nodes)
        return helps

    def moments_on_contact(self, v: fem.Function) -> Array:
        """∫ v φ_a over the facets `contact`, shape (facets, d, d)."""
        coefficients = v.x.array.reshape(-1, self.spaces.dim)[self.contact.nodes]
        return np.einsum("n,ak,nki->nai", self.contact.facets.measure, self._moments(), coefficients)

    def _moments(self) -> Array:
        """∫ φ_a B over the facet of measure 1 for the B of each of its nodes, shape (d, nodes)."""
        points, weights = facet_rule(self.spaces.dim, self.contact.degree)
        hats = np.column_stack([1 - points.sum(axis=1), points])
        return np.einsum("q,qa,qk->ak", weights / weights.sum(), hats, self.contact.basis(points))

    def rubbed(self, v: fem.Function) -> Array:
        """A bound of ∫ g|v_t| over the facets with friction: |v_t| is at most the mean of its |coefficients|."""
        nodes, tangents = self.contact.nodes[self.rough[0]], self.spaces.tangents[self.rough[1]]
        along = np.einsum("nki,ni->nk", v.x.array.reshape(-1, self.spaces.dim)[nodes], tangents)
        return (self._rubbing_weights() * np.abs(along)).sum(axis=1)

    def near(self, touching: Mask) -> SiteConditions:
        """Contact at the nodes all of whose facets, or all but their ends, are in contact; nothing slips (collective).

        Args:
            touching: Vertices of the facets of Γ_C in contact, shape (facets, d).
        """
        sums = la.vector(self.space.dofmap.index_map, 2)
        inside = touching[self.contact.rows].all(axis=1).astype(np.float64)
        values = np.stack([inside, np.ones_like(inside)], axis=1)[:, None]
        np.add.at(sums.array.reshape(-1, 2), self.contact.nodes, values)
        sums.scatter_reverse(la.InsertMode.add)
        share = sums.array.reshape(-1, 2)[self._touching]
        kind = np.where(share[:, 0] >= share[:, 1] - 0.5, Condition.ZERO_TRACE, Condition.NO_FLUX)
        sticking = np.full(len(self._rubbing), Condition.ZERO_TRACE)
        conditions = SiteConditions(np.concatenate([kind, sticking]).astype(np.int8))
        return self.chains.conditions(self.chains.segments(conditions))

    def without_flux(self, iterate: Iterate, where: Mask) -> Iterate:
        """Refused: there is no clip without a penalty.

        Raises:
            InputError: Always.
        """
        raise InputError("there is no penalty here")

    def scales(self, iterate: Iterate) -> tuple[Array, Array]:
        """The largest coefficient, and that times the largest of the matrix, see `Backend.scales`."""
        largest = max(self.comm.allgather(float(np.abs(iterate.u.x.array).max(initial=0.0))))
        return np.full(self.sites, largest), np.full(self.sites, largest * self._diagonal)

    @cached_property
    def change(self) -> FieldChange:
        """Norms of what changed, see `Backend.change`."""
        return FieldChange(self.split.stresses, self.space)

    def places(self) -> Array:
        """Where the nodes are, rounded; coefficients of Bernstein's basis have the places of Lagrange's."""
        lagrange = fenicsx.function_space(self.space.mesh, ("P", self.contact.degree))
        places = lagrange.tabulate_dof_coordinates()
        mine = np.empty((self._size + self.space.dofmap.index_map.num_ghosts, 3))
        mine[self.space.dofmap.list] = places[lagrange.dofmap.list]
        nodes = np.concatenate([self._touching, self._rubbing])
        return np.column_stack([mine[nodes], np.arange(self.sites) >= len(self._touching)])

    def in_mixed_spaces(self, iterate: Iterate, conditions: SiteConditions) -> tuple[Iterate, SiteConditions]:
        """As they are."""
        return iterate, conditions


def moduli_on_split(
    spaces: ElasticSpaces, data: ElasticData, split: SplitMesh, degree: int
) -> tuple[tuple[fem.Function, fem.Function], ufl.Measure]:
    """2μ and θ in the points of a quadrature, and the measure that takes them there (collective).

    Args:
        spaces: The spaces.
        data: The data.
        split: The split mesh, or a part of it.
        degree: For which the quadrature is exact; at least that of the data.
    """
    mesh, dim = split.mesh, spaces.dim
    rule = SplitQuadrature.of_degree(dim, max(degree, data.quadrature.degree))
    element = basix.ufl.quadrature_element(mesh.basix_cell(), degree=rule.degree, scheme="default")
    space = fenicsx.function_space(mesh, element)
    mu2, theta = fem.Function(space), fem.Function(space)
    for block in blocks_of_cells(spaces):
        cells = block[split.cells[block, 0] >= 0]
        shape = len(cells), dim + 1, len(rule.weights)
        order = spaces.order[cells]
        points = CellPoints(spaces.mesh, cells, rule.points, rule.weights)
        there = points.x.reshape(*shape, dim)
        there = np.take_along_axis(there, order[:, :, None, None], axis=1)
        here = np.einsum("qa,nsai->nsqi", rule.local, split_vertices(spaces.vertices[cells]))
        nearest = np.square(here[:, :, :, None] - there[:, :, None]).sum(axis=4).argmin(axis=3)
        dofs = space.dofmap.list[split.cells[cells]]
        for function, values in zip((mu2, theta), data.moduli(points), strict=True):
            by_subcell = np.take_along_axis(values.reshape(shape), order[:, :, None], axis=1)
            function.x.array[dofs] = np.take_along_axis(by_subcell, nearest, axis=2)
    mu2.x.array[:] = 1 / mu2.x.array
    metadata = {"quadrature_degree": rule.degree, "quadrature_scheme": "default"}
    return (mu2, theta), ufl.Measure("dx", domain=mesh, metadata=metadata)
