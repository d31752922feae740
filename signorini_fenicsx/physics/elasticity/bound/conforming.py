"""The conforming displacement nearest to a stress: polynomials on the split mesh that stay off the foundation.

It minimises the gap of `forms/elasticity.py` for given y over the displacements whose coefficients in Bernstein's basis
stay off: at each node of Γ_C there is a condition for each facet, between two nodes where two bodies touch. With
friction, |v_t| is bounded by its coefficients, and there is one more term for each. `active_terms` is for the minimum.
"""

from collections.abc import Iterator
from functools import cached_property

import basix.ufl
import numpy as np
import ufl
from dolfinx import common, fem, la
from mpi4py import MPI
from petsc4py import PETSc
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import sums_at, with_ghosts
from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.base.tolerances import KKT, LINEAR, ROUNDING
from signorini_fenicsx.discrete.matrices import OfCells, add_of_cells, of_cells
from signorini_fenicsx.discrete.trace_multigrid import STIFF
from signorini_fenicsx.forms.elasticity import square, strain, vector
from signorini_fenicsx.linear.constrained_matrix import image_of
from signorini_fenicsx.physics.elasticity.bound.active_terms import nearly_minimal
from signorini_fenicsx.physics.elasticity.bound.collected import Collected
from signorini_fenicsx.physics.elasticity.bound.condensed import Nodes, condensed, displacement_solver, means_at_nodes
from signorini_fenicsx.physics.elasticity.bound.equilibrated import AdmissibleStress
from signorini_fenicsx.physics.elasticity.bound.friction import FrictionOfDisplacement, moments_of
from signorini_fenicsx.physics.elasticity.bound.laws import LawOnFacets, kinks_on
from signorini_fenicsx.physics.elasticity.bound.supports import SupportsOfDisplacement
from signorini_fenicsx.physics.elasticity.bound.tied import lacking, tied_pairs, with_tied
from signorini_fenicsx.physics.elasticity.discrete.boundary_nodes import (
    add_at,
    contact_coefficients,
    given_nodes,
    in_pieces,
)
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData, material_on_split
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces, SplitMesh

SHIFT = 1e-13
"""Share of the diagonal that is added in factorisations: no motion is free, and nothing else is changed."""
MANY = {2: 300_000, 3: 20_000}
"""For each dimension, with more unknowns the solves are by CG."""
OUT = 1e-11
"""What v lets out of a cell of a fluid is rounding if it is at most this share of what flows through one."""
PUSHES = 20
"""Rounds in which nodes are pushed off foundations by what rounding leaves."""


class BestDisplacement:
    """The gap as a function of v's coefficients, in the frames of the nodes; see `active_terms.Terms`.

    Attributes:
        data: The data.
        split: The split mesh, or the part of it on which the displacement is.
        sigma: y.
        contact: The facets of Γ_C on it.
        tied: The tied pairs on it.
        laws: The laws on them, but for contact.
        friction: The friction on them.
        supports: The supports on it.
        openings: The coefficients of g on them, or of what stands for it, less p at the references of the laws.
        material: 𝔸, ℂ and ε₀ on it.
    """

    def __init__(
        self,
        spaces: ElasticSpaces,
        data: ElasticData,
        y: AdmissibleStress,
        split: SplitMesh,
        degree: int,
        v: fem.Function | None = None,
    ):
        """Collect the facets of Γ_C, and what is given (collective).

        Args:
            spaces: The spaces.
            data: The data.
            y: The stress.
            split: The split mesh, or a part of it.
            degree: Of the polynomials.
            v: For a part, the displacement on the whole mesh that the one on the part has to continue.
        """
        self.spaces, self.data, self._y, self.split = spaces, data, y, split
        self.comm, mesh, dim = spaces.mesh.comm, split.mesh, spaces.dim
        self.sigma = split.stress(y.stresses)
        element = basix.ufl.element("P", mesh.basix_cell(), degree, basix.LagrangeVariant.bernstein, shape=(dim,))
        self.space = fenicsx.function_space(mesh, element)
        self.tied = tuple(tied_pairs(spaces, split, self.space))
        self.contact = in_pieces(contact_coefficients(spaces, split, self.space), spaces, split, self.space)
        self.laws = [
            LawOnFacets.of(spaces, self.contact, law, data.laws.chains, y.segment) for law in data.laws.of_parts
        ]
        self.material = material_on_split(spaces, data, split, 2 * degree - 2)
        self.friction = FrictionOfDisplacement.of(spaces, data, self.contact, y.shear)
        self._v = None if v is None else self._continued(v)
        self._given = given_nodes(spaces, data, split, self.space, self._v)
        floors = y.floors[self.contact.rows, None]
        self.openings = np.where(np.isfinite(floors), floors, self.contact.openings(spaces.mesh, data))
        self.supports = SupportsOfDisplacement.of(spaces, data, split, self.space, y.stresses, y.shear)

    def _continued(self, v: fem.Function) -> fem.Function:
        """The displacement on the whole split mesh as one of this space."""
        continued = fem.Function(self.space)
        cells = np.arange(len(self.split.subcells), dtype=np.int32)
        continued.interpolate(v, self.spaces.split.cells.ravel()[self.split.subcells].astype(np.int32), cells)
        continued.x.scatter_forward()
        return continued

    @cached_property
    def pressure(self) -> Array:
        """−y_nn at the corners of the facets `contact`."""
        contact = self.contact
        return contact.at_corners(self._y.pressure[contact.rows], np.arange(len(contact.rows)))

    @property
    def _without_v(self) -> Expr:
        """The entries of −ε₀ − 𝔸y; the ε₀ of a fluid, which has no deviator, is in the flows out of cells."""
        given = -ufl.dot(self.material.compliance, vector(self.sigma))
        return given if self.material.incompressible else given - self.material.eigenstrain

    def _collect_terms(self) -> None:
        """The conditions on Γ_C, then the terms of friction, one for each coefficient of each facet (collective).

        Bounds of the friction that are rounding are left out.
        """
        contact, friction, dim = self.contact, self.friction, self.spaces.dim
        rough, weights, rubbing = friction.rows, friction.weights, friction.forces
        rubs = weights > ROUNDING * self.comm.allreduce(weights.max(initial=0.0), MPI.MAX)
        on, at, sides, corners, most = kinks_on(self.laws, self.openings)
        touching, of_rough = len(on), np.nonzero(rubs)
        rows, places = np.append(on, rough[of_rough[0]]), np.append(at, of_rough[1])
        tangents, known = friction.tangents[of_rough[0]], slice(touching, len(rows))
        nodes, signs, ways = with_tied(self.tied, *contact.pairs(rows, places))
        directions, bound, of_y = (np.zeros((len(nodes), dim - 1, *shape)) for shape in ((dim,), (), ()))
        directions[:touching, 0], directions[known] = sides[:, None] * contact.facets.normals[on], tangents
        directions[len(rows) :, 0] = ways
        bound[:touching, 0] = sides * (self.openings[on, at] - corners)
        bound[known] = np.einsum("kmi,ki->km", tangents, friction.before[rubs]) + friction.springs.shift[rubs]
        forces, apart = self._pressing()
        of_y[:touching, 0] = sides * forces[on, at]
        of_y[known] = np.einsum("kmi,ki->km", tangents, rubbing[rubs])
        axes = signs[:, None, :, None] * np.einsum("ksij,kmi->kmsj", self._given.frames[nodes], directions)
        bound -= np.einsum("kmsj,ksj->km", axes, self._given.values[nodes])
        axes = np.where(self._given.given[nodes][:, None], 0.0, axes)
        hard = np.full(len(ways), np.inf)
        most = np.concatenate([most, weights[rubs], hard])
        stiffness = np.concatenate([np.full(touching, np.inf), friction.springs.stiffness[rubs], hard])
        kinds, one_sided = np.zeros((len(nodes), 2)), np.arange(len(nodes)) < touching
        kinds[:touching], share = np.column_stack([sides, corners]), np.append(contact.share[rows], np.ones(len(ways)))
        terms = Collected(self._left.number_of[nodes], axes, bound, of_y, most, one_sided, stiffness, share).once(kinds)
        self._nodes, self._axes, self.bound, self._forces = terms.nodes, terms.axes, terms.bound, terms.forces
        self.most, self.one_sided, self.on_pieces = terms.most, terms.one_sided, terms.on_pieces
        self._shares, self.gives = terms.share, 1 / terms.stiffness

        pulling = vector(strain(ufl.TestFunction(self.space))), ufl.dot(self.material.stiffness, self._without_v)
        pull = fem.assemble_vector(fenicsx.form(-ufl.inner(*pulling) * self.material.dx))
        on_facets = forces[:, :, None] * contact.facets.normals[:, None]
        on_facets[rough] += rubbing
        contact.add_forces(pull, on_facets)
        add_at(pull, self.supports.on.nodes, self.supports.forces)
        pull.scatter_reverse(la.InsertMode.add)
        self._pull = pull
        without_v = self.supports.gap().sum() + friction.springs.apart.sum() + (rubbing * friction.before).sum()
        self._apart = apart + float(without_v)

    def _pressing(self) -> tuple[Array, float]:
        """What presses on the coefficients of v_n, beside kinks and springs, and the part of the gap without v."""
        contact, of_y = self.contact, self.pressure
        forces = contact.facets.measure[:, None] * (of_y @ moments_of(contact))
        apart = 0.0
        for law in self.laws:
            (slope, value), opening = law.line(), self.openings[law.rows]
            at = np.einsum("fqk,fk->fq", law.basis, opening)
            pressure = np.einsum("fqa,fa->fq", law.hats, of_y[law.rows])
            rest = pressure - value
            forces[law.rows] -= np.einsum("fq,fqk->fk", law.weights * value, law.basis)
            sprung = np.divide(rest**2, 2 * slope, out=np.zeros_like(rest), where=slope > 0) - slope * at**2 / 2
            apart += float((law.weights * sprung).sum())
            forces[law.rows] += np.einsum("fq,fqk->fk", law.weights * slope * at, law.basis)
            for corner, jump, side in law.kinks():
                held = np.where((jump > 0)[:, None] & (slope == 0), side[:, None] * rest > 0, False)
                apart -= float((law.weights * np.where(held, rest, 0.0) * corner[:, None]).sum())
        return forces, apart + float((forces * self.openings).sum())

    def _springs(self) -> Iterator[OfCells]:
        """∫ β v_n w_n on each facet under the laws, β that of the line of v, and what supports add."""
        yield self.supports.matrices(self._left, self._given.frames)
        for law in self.laws:
            nodes, weights = self.contact.of_jumps(law.rows)
            basis = law.basis @ weights
            mass = np.einsum("fq,fqk,fql->fkl", law.weights * law.line()[0], basis, basis)
            normals = np.einsum("fkij,fi->fkj", self._given.frames[nodes], self.contact.facets.normals[law.rows])
            values = np.einsum("fkl,fki,flj->fkilj", mass, normals, normals)
            size = nodes.shape[1] * self.spaces.dim
            yield self._left.number_of[nodes], values.reshape(len(nodes), size, size)

    def _assemble(self) -> None:
        """K, b and the constant in the frames of the nodes, about what is given of v (collective)."""
        dim, size, material, left = self.spaces.dim, self._numbers.size_local, self.material, self._left
        forces = np.einsum("nij,ni->nj", self._given.frames, self._pull.array.reshape(-1, dim))
        inside = self._condensed = condensed(self.split, self.space, left, material, self._given.frames, forces)
        wide = dim * self._nodes.shape[1]
        coupling = self._nodes, np.zeros((len(self._nodes), wide, wide))
        parts = ((inside.around, inside.matrices), *(springs := list(self._springs())), coupling)
        self._natural = of_cells(self.comm, self._numbers, dim, [nodes for nodes, _ in parts], parts)
        values = left.of_space[:size]
        self._lift, load = self._given.values[values].ravel(), inside.load
        image = self.times(self._lift)
        energy = fem.assemble_scalar(fenicsx.form(square(material.stiffness, self._without_v, 1.0, material.dx)))
        constants = energy / 2 + self._apart + inside.energy
        sums = self.comm.allreduce(np.array([constants, self._lift @ (image / 2 - load)]))
        self.constant, self.scale = float(sums.sum()), float(np.abs(sums).sum())
        essential = np.flatnonzero(self._given.given[values]).astype(np.int32)
        self.load = load - image
        self.load[essential] = 0.0
        diagonal = self._natural.getDiagonal()
        self._natural.zeroRowsColumns(essential + self._natural.getOwnershipRange()[0])
        self._matrix = self._natural.duplicate(copy=True)
        for option in (PETSc.Mat.Option.KEEP_NONZERO_PATTERN, PETSc.Mat.Option.SPD):
            self._matrix.setOption(option, True)
        everywhere = with_ghosts(self._numbers, (diagonal.array_r + inside.softened).reshape(-1, dim))
        of_laws = np.zeros_like(everywhere)  # across, where friction is along
        for nodes, matrices in springs[1:]:
            of_laws += sums_at(self._numbers, nodes, np.einsum("nii->ni", matrices).reshape(*nodes.shape, dim))
        of_sides = np.where(self.one_sided[:, None, None], everywhere[self._nodes], (everywhere - of_laws)[self._nodes])
        self.unit = of_sides.max(axis=(1, 2), initial=0.0) * self._shares
        self.locks = 1.0 if material.incompressible else 1 + self.data.stiffness_of_volume(self.spaces) / 2
        self._share()
        self._shift = (1 + SHIFT) * self._natural.getDiagonal()
        self._essential = essential
        self._solver = displacement_solver(
            self.spaces, self.split, self.space, left, self._given.frames, self._matrix, iterate=self._iterates
        )

    def _share(self) -> None:
        """Let all terms of friction at the same nodes have their share of what they carry together (collective)."""
        alone, sides = self.one_sided | np.isinf(self.most), self._axes.any(axis=(1, 3))
        weights = np.where(alone, 0.0, self.most)
        at_nodes = sums_at(self._numbers, self._nodes, weights[:, None] * sides)
        share = weights / np.where(alone, 1.0, at_nodes[self._nodes].max(axis=1, initial=0.0))
        together = self.along(self.spread(np.where(alone[:, None], 0.0, self._forces)))
        shares = together * (share / sides.sum(axis=1))[:, None]
        self._forces = np.where(alone[:, None], self._forces, shares)
        self.unit = np.where(alone, self.unit, share * self.unit)

    @property
    def _iterates(self) -> bool:
        """Whether CG with multigrid is faster than factorisations: for many unknowns, unless they lock (collective)."""
        many = self.split is self.spaces.split and self.spaces.dim * self._numbers.size_global > MANY[self.spaces.dim]
        return many and self.data.stiffness_of_volume(self.spaces) < STIFF

    @property
    def _numbers(self) -> common.IndexMap:
        """Numbers of the nodes that are left, over all ranks."""
        return self._left.numbers

    def times(self, x: Array) -> Array:
        """Kx (collective)."""
        return image_of(self._natural, x)

    def along(self, x: Array) -> Array:
        """Ax of each term (collective)."""
        everywhere = with_ghosts(self._numbers, x.reshape(-1, self.spaces.dim))
        return np.asarray(np.einsum("kmsj,ksj->km", self._axes, everywhere[self._nodes]))

    def spread(self, forces: Array) -> Array:
        """Σ Aᵀτ (collective)."""
        return self._summed(np.einsum("km,kmsj->ksj", forces, self._axes))

    def _summed(self, values: Array) -> Array:
        """Sums over the terms of each owned node, from values of shape (terms, 2, …) (collective)."""
        return sums_at(self._numbers, self._nodes, values)[: self._numbers.size_local].ravel()

    def factorise(self, stiffness: Array) -> None:
        """Get ready to solve with K + Σ AᵀDA (collective)."""
        axes = self._axes.reshape(*stiffness.shape[:2], self.spaces.dim * self._nodes.shape[1])
        values = axes.swapaxes(1, 2) @ stiffness @ axes
        self._natural.copy(self._matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self._matrix.setDiagonal(self._shift)
        add_of_cells(self._matrix, self._numbers, self._nodes, values)
        self._matrix.assemble()
        if self._solver.levels is not None:
            with self._solver.options():
                self._solver.levels.update(self._essential, self._essential)

    def solve(self, load: Array, left: float = 0.0) -> Array:
        """Solve with the matrix that was factorised last; in the energy norm so much may be left (collective)."""
        self._solver.ksp.setTolerances(atol=left)
        x, b = self._matrix.createVecs()
        x.set(0.0)
        b.array_w[:] = load
        b.array_w[self._essential] = 0.0
        self._solver.solve(b, x)
        return np.array(x.array_r)

    def pushed(self, x: Array) -> Array:
        """The x off all foundations that is near this one; nodes of slaves are where they are tied (collective)."""
        lengths = (self._axes**2).sum(axis=(1, 2, 3))[:, None]
        for _ in range(PUSHES):
            past = np.where(
                (np.isinf(self.most) & self.one_sided)[:, None], np.maximum(self.along(x) - self.bound, 0.0), 0.0
            )
            if not self.comm.allreduce(bool((past > 0).any()), MPI.LOR):
                break
            x = x - self.spread(past / lengths)
        off = np.where((np.isinf(self.most) & ~self.one_sided)[:, None], self.along(x) - self.bound, 0.0)
        of_slaves = np.arange(self._nodes.shape[1]) == 0
        return x - self._summed(np.einsum("km,kmsj->ksj", off, self._axes * of_slaves[:, None]))

    def _beginning(self) -> Array:
        """The means of u at the nodes, or the v that is continued, less what is given of v (collective)."""
        known = self._left.of_space[: self._numbers.size_local]
        if self._v is None:
            values = means_at_nodes(self.split, self.space, self._left, self._y.displacement)
        else:
            values = self._v.x.array.reshape(-1, self.spaces.dim)[known]
        x: Array = np.einsum("nij,ni->nj", self._given.frames[known], values).ravel() - self._lift
        x[self._essential] = 0.0
        return x

    def minimum(self) -> tuple[fem.Function, str]:
        """The best v, and why it is not admissible; empty if it is (collective).

        Raises:
            InputError: If PETSc refuses an option.
        """
        self._left = Nodes.of(self.split, self.space)
        self._collect_terms()
        self._assemble()
        x = nearly_minimal(self, self._forces, self._beginning())
        out = 0.0
        if self.material.incompressible:
            x, out = self._condensed.without_flows(x, self._lift, self.solve, self.pushed)
        turned = with_ghosts(self._numbers, (x + self._lift).reshape(-1, self.spaces.dim))
        v = fem.Function(self.space, name="v")
        coefficients = v.x.array.reshape(-1, self.spaces.dim)
        coefficients[self._left.of_space] = turned
        coefficients[self._condensed.inside] = self._condensed.coefficients(turned)
        coefficients[:] = np.einsum("nij,nj->ni", self._given.frames, coefficients)
        return v, self._not_admissible(v) or ("v lets fluid out of cells" if out > OUT else "")

    def _not_admissible(self, v: fem.Function) -> str:
        """The place where v is not u_D, or passes the foundation farthest; empty up to rounding (collective)."""
        contact, coefficients = self.contact, v.x.array.reshape(-1, self.spaces.dim)
        opening = self.openings_of(v)
        least, most, *_ = (each.reshape(-1, self.spaces.dim) for each in self.data.laws.chains.extent())
        least, most = least.max(axis=1)[contact.rows, None], most.min(axis=1)[contact.rows, None]
        past = np.maximum(least - opening, opening - most)
        largest = np.array([np.abs(each).max(initial=0.0) for each in (coefficients, self.openings)])
        self.comm.Allreduce(MPI.IN_PLACE, largest, MPI.MAX)
        apart, place = max(self.comm.allgather(self._given.apart))
        apart -= self.spaces.displacement_rounding
        if apart > (KKT if self.data.u_D.polynomial is None else LINEAR) * largest[0]:
            return f"at {place} parts meet on which different displacements are given"
        worst = float(past.max(initial=0.0)), ""
        rounding = ROUNDING * largest.max() + self.spaces.displacement_rounding
        if self.tied and self.comm.allreduce(lacking(self.tied, self.spaces, self.data, v)[1], MPI.MAX) > rounding:
            return "a slave that is tied cannot follow: u is given, its facets turn, or its masters are several bodies"
        if worst[0] > rounding:
            facet, place = np.unravel_index(int(past.argmax()), past.shape)
            worst = worst[0], self._told(int(facet), int(place))
        past_by, where = max(self.comm.allgather(worst))
        if not where:
            return ""
        return f"what is given of u passes the quadratics for the gap by {past_by:.2g} {where}: use a finer mesh there"

    def _told(self, facet: int, place: int) -> str:
        """The place of a coefficient of a facet, and the normal along which it counts, in words."""
        x, n = self.contact.places()[facet, place], self.contact.facets.normals[facet]
        return f"at {place_in_words(x)}, along the normal {place_in_words(n)} of the facet of the mesh"

    def openings_of(self, v: fem.Function) -> Array:
        """The coefficients of g − v_n on the facets `contact`, less p at the references of the laws."""
        coefficients = self.contact.jump(v.x.array.reshape(-1, self.spaces.dim))
        return self.openings - np.einsum("nki,ni->nk", coefficients, self.contact.facets.normals)

    def moments_on_contact(self, v: fem.Function) -> Array:
        """∫ v φ_a over the facets `contact`, of the jump where two bodies touch, shape (facets, d, d)."""
        coefficients = self.contact.jump(v.x.array.reshape(-1, self.spaces.dim))
        return np.einsum("n,ak,nki->nai", self.contact.facets.measure, moments_of(self.contact), coefficients)
