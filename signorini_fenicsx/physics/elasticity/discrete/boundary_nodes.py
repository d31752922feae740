"""Nodes of a conforming displacement on the boundary: where it is given, and what it must not pass.

On each facet of Γ_D, Γ_C and of parts that are fixed in some components, a displacement has coefficients in Bernstein's
basis. As a polynomial is a mean of its coefficients, v_n ≤ g on a facet if the coefficients are in that relation. A
node has one such condition for each of its facets of Γ_C, each along the normal of that facet.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import basix.ufl
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import fem, la
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.base.tolerances import LINEAR
from signorini_fenicsx.discrete.facet_coefficients import NOTHING, FacetCoefficients
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, linear_from_means
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces, SplitMesh

ALONG = 1e-12
"""v is given at a node along directions on which the squares of what is given of unit directions add up to more."""
TURNED = 0.5
"""The sine of the angle by which the normal of a facet may differ from that of a curved body."""


@dataclass(frozen=True)
class GivenNodes:
    """Given displacements at the nodes of this rank, ghosts too, each node with an orthonormal frame.

    Attributes:
        frames: Directions, a column each, shape (nodes, d, d): first those in which v is given; inner nodes have the
            axes.
        given: Whether v is given along each of them, shape (nodes, d).
        values: v along these, and 0 along the others, shape (nodes, d).
        apart: How far a facet of this rank is from what its nodes have, at most, and the place, in words. It is more
            than rounding where parts meet on which different displacements are given.
    """

    frames: Array
    given: Mask
    values: Array
    apart: tuple[float, str] = (0.0, "")


def facet_coefficients(split: SplitMesh, space: fem.FunctionSpace, facets: BoundaryFacets) -> FacetCoefficients:
    """The nodes in a space on the split mesh or a part of it, on those of the facets that it has."""
    behind = split.cells[facets.cells, facets.local]
    rows = np.flatnonzero(behind >= 0)
    element = space.element.basix_element
    nodes = space.dofmap.list[behind[rows]][:, element.entity_closure_dofs[-2][-1]]
    return FacetCoefficients(facets.take(rows), rows, behind[rows], nodes, element.degree)


@dataclass(frozen=True)
class ContactCoefficients(FacetCoefficients):
    """The facets of Γ_C; where two bodies touch they are those of the named side.

    Slave facets of a pair are there piece by piece, so that all is a polynomial on each of `facets`.

    Attributes:
        touched: Which of them have another side, ascending.
        across: The nodes of these, shape (touched, coefficients).
        corners: Of each of them on its whole facet, by barycentric coordinates, shape (facets, d, d).
        extraction: Its coefficients from those of `nodes`, those of the whole facet, shape (facets, coefficients,
            coefficients).
        other: Those of the other side from those of `across`, likewise for `touched`.
        opened: The coefficients of what the gap of a pair is more than the data have, 0 on other facets.
    """

    touched: Indices
    across: npt.NDArray[np.int32]
    corners: Array
    extraction: Array
    other: Array
    opened: Array

    def jump(self, values: Array) -> Array:
        """Coefficients on the facets, less those of the other side where there is one: (facets, coefficients, …)."""
        jumps = np.einsum("fkl,fl...->fk...", self.extraction, values[self.nodes])
        jumps[self.touched] -= np.einsum("fkl,fl...->fk...", self.other, values[self.across])
        return jumps

    def at_corners(self, values: Array, rows: Indices) -> Array:
        """Values at the corners of some of the facets, of linear functions on their whole facets, (facets, d, …)."""
        return np.asarray(np.einsum("fca,fa...->fc...", self.corners[rows], values))

    def add_forces(self, sums: la.Vector, forces: Array) -> None:
        """Add forces on the coefficients of the jump, shape (facets, coefficients, d), to those of nodes."""
        add_at(sums, self.nodes, np.einsum("fkl,fki->fli", self.extraction, forces))
        add_at(sums, self.across, -np.einsum("fkl,fki->fli", self.other, forces[self.touched]))

    def openings(self, mesh: dolfinx.mesh.Mesh, data: ElasticData) -> Array:
        """The coefficients of g, less p at the references of the laws (collective)."""
        openings = self.of(mesh, data.gap)
        for law in data.laws.of_parts:
            rows = np.flatnonzero(np.isin(self.rows, law.rows))
            part = FacetCoefficients(
                self.facets.take(rows), self.rows[rows], self.cells[rows], self.nodes[rows], self.degree
            )
            openings[rows] -= part.of(mesh, law)
        return np.asarray(np.einsum("fkl,fl->fk", self.extraction, openings) + self.opened)

    def pairs(self, rows: Indices, places: Indices) -> tuple[Indices, Array]:
        """The nodes whose values make the jump at some places of facets, and their weights, shape (places, nodes) each.

        These are two nodes, on pieces more. Where there are fewer, on a foundation or at the edge of a cut, one of them
        is there several times, with the weight 0.
        """
        nodes, weights = self.of_jumps(rows)
        weights = weights[np.arange(len(rows)), places]
        weights[np.abs(weights) < NOTHING] = 0.0
        order = np.argsort(weights == 0, axis=1, kind="stable")[:, : max(2, (weights != 0).sum(axis=1).max(initial=0))]
        nodes, weights = np.take_along_axis(nodes, order, axis=1), np.take_along_axis(weights, order, axis=1)
        nodes = np.where(weights == 0, nodes[:, :1], nodes)
        weights[(nodes == nodes[:, :1]).all(axis=1) & (weights[:, 1] != 0)] = 0.0
        return nodes, weights

    @property
    def share(self) -> Array:
        """The share of its whole facet that each of them is."""
        return np.asarray(np.abs(np.linalg.det(self.corners)))

    def of_jumps(self, rows: Indices) -> tuple[Indices, Array]:
        """The nodes of both sides of some facets, and the coefficients of the jump from those of these.

        The shapes are (facets, 2 coefficients) and (facets, coefficients, 2 coefficients).
        """
        weights = np.concatenate([self.extraction[rows], np.zeros_like(self.extraction[rows])], axis=2)
        nodes = np.concatenate([self.nodes[rows], self.nodes[rows]], axis=1).astype(np.int64)
        some, number = np.isin(rows, self.touched), self.nodes.shape[1]
        places = np.searchsorted(self.touched, rows[some])
        nodes[some, number:], weights[some, :, number:] = self.across[places], -self.other[places]
        return nodes, weights


def contact_coefficients(spaces: ElasticSpaces, split: SplitMesh, space: fem.FunctionSpace) -> ContactCoefficients:
    """The nodes of Γ_C on the split mesh, or on a part of it that has both sides of a facet or none."""
    named = facet_coefficients(split, space, spaces.contact)
    other = facet_coefficients(split, space, spaces.across)
    touched = np.searchsorted(named.rows, spaces.inner.rows[other.rows])
    order, number, dim = np.argsort(touched), named.nodes.shape[1], spaces.dim
    whole = np.broadcast_to(np.eye(number), (len(named.rows), number, number))
    return ContactCoefficients(
        **vars(named),
        touched=touched[order],
        across=other.nodes[order],
        corners=np.broadcast_to(np.eye(dim), (len(named.rows), dim, dim)),
        extraction=whole,
        other=whole[: len(order)],
        opened=np.zeros((len(named.rows), number)),
    )


def in_pieces(
    contact: ContactCoefficients, spaces: ElasticSpaces, split: SplitMesh, space: fem.FunctionSpace
) -> ContactCoefficients:
    """The same with the slave facets of pairs piece by piece; both sides of a piece are on one rank, and on `split`."""
    for pair in (pair for pair in spaces.pairs if not pair.parts.tied):
        slaves, pieces = spaces.rows_of(pair), pair.pieces
        masters = facet_coefficients(split, space, spaces.boundary_facets(pair.masters))
        plain = np.flatnonzero(~np.isin(contact.rows, slaves))
        pieces = pieces.take(np.isin(slaves[pieces.slave], contact.rows))
        order = np.argsort(contact.rows, kind="stable")  # those of pairs before are at the end
        at = np.searchsorted(contact.rows, slaves[pieces.slave], sorter=order)
        picked = plain[:0] if len(pieces) == 0 else order[at]
        rows, first = np.append(plain, picked), len(plain)
        across = np.searchsorted(masters.rows, pieces.master - pair.first)
        opened = np.zeros((len(pieces), spaces.dim))
        if pair.parts.distance:
            linear = linear_from_means(pair.pieces.means(len(slaves)))
            opened = pieces.gap - np.einsum("pca,pa->pc", pieces.on_slave, linear[pieces.slave])
        on_pieces = (contact.restricted(pieces.on_slave), contact.restricted(pieces.on_master))
        corners = np.concatenate([contact.corners[plain], pieces.on_slave])
        facets, share = contact.facets.take(rows), np.append(np.ones(first), pieces.share)
        contact = ContactCoefficients(
            facets=replace(facets, vertices=corners @ facets.vertices, measure=share * facets.measure),
            rows=contact.rows[rows],
            cells=contact.cells[rows],
            nodes=contact.nodes[rows],
            degree=contact.degree,
            touched=np.append(np.searchsorted(plain, contact.touched), first + np.arange(len(pieces))),
            across=np.concatenate([contact.across, masters.nodes[across]]),
            corners=corners,
            extraction=np.concatenate([contact.extraction[plain], on_pieces[0]]),
            other=np.concatenate([contact.other, on_pieces[1]]),
            opened=np.concatenate([contact.opened[plain], opened @ contact.hats.T]),
        )
    return contact


def given_nodes(
    spaces: ElasticSpaces, data: ElasticData, split: SplitMesh, space: fem.FunctionSpace, v: fem.Function | None = None
) -> GivenNodes:
    """Collect what is given at the nodes from the facets of all ranks (collective).

    Args:
        spaces: The spaces.
        data: The data.
        split: The split mesh, or a part of it.
        space: Displacements on that.
        v: A displacement in this space; it is given in the place of u_D, and where the part ends inside the domain.
    """
    dim, index_map = spaces.dim, space.dofmap.index_map
    products, pulls = la.vector(index_map, dim**2), la.vector(index_map, dim)  # sums of d dᵀ and of (d·u_D)d
    on_facets = []
    for facets, k, axes, _ in spaces.fixed:
        coefficients = facet_coefficients(split, space, facets)
        directions = axes[coefficients.rows][:, None]
        if v is None:
            displacement = coefficients.of(spaces.mesh, data.u_D)
            in_contact = bool(np.isin(facets.facets, spaces.contact.facets).all())
            if k == 0 and spaces.mesh.comm.allreduce(in_contact, MPI.LAND):
                of_wall = coefficients.of(spaces.mesh, data.gap)  # beside friction, and u_D is what a wall moves with
                displacement = of_wall[:, :, None] * directions
            if data.material.incompressible:
                means = data.lift[spaces.unknowns(facets, k)].mean(axis=1)[coefficients.rows]
                displacement = coefficients.with_means(displacement, directions[:, 0], means)
        else:
            displacement = v.x.array.reshape(-1, dim)[coefficients.nodes]
        along = np.einsum("nai,nbi->na", displacement, directions)
        on_facets.append((coefficients, directions[:, 0], displacement))
        add_at(products, coefficients.nodes, np.einsum("nbi,nbj->nbij", directions, directions))
        add_at(pulls, coefficients.nodes, along[:, :, None] * directions)
    if v is not None:
        ends = _ends(spaces, split, space)
        products.array.reshape(-1, dim, dim)[ends] += np.eye(dim)
        pulls.array.reshape(-1, dim)[ends] += v.x.array.reshape(-1, dim)[ends]
    for sums in (products, pulls):
        sums.scatter_reverse(la.InsertMode.add)
        sums.scatter_forward()
    given = _framed(products.array.reshape(-1, dim, dim), pulls.array.reshape(-1, dim))
    return replace(given, apart=max([(0.0, ""), *_apart(given, on_facets)]))


def _apart(
    given: GivenNodes, on_facets: Sequence[tuple[FacetCoefficients, Array, Array]]
) -> Iterator[tuple[float, str]]:
    """How far the facets of each part are from what their nodes have, at most, and the place, see `GivenNodes`."""
    at_nodes = np.einsum("nij,nj->ni", given.frames, given.values)
    onto = np.einsum("nij,nj,nkj->nik", given.frames, given.given, given.frames)
    for coefficients, directions, displacement in on_facets:
        nodes = coefficients.nodes
        off = at_nodes[nodes] - np.einsum("nkij,nkj->nki", onto[nodes], displacement)
        apart = np.abs(np.einsum("nki,ni->nk", off, directions))
        if apart.size:
            facet, place = np.unravel_index(int(apart.argmax()), apart.shape)
            yield float(apart[facet, place]), place_in_words(coefficients.places()[facet, place])


def _ends(spaces: ElasticSpaces, split: SplitMesh, space: fem.FunctionSpace) -> npt.NDArray[np.int32]:
    """Nodes where a part of the split mesh ends inside the domain (collective)."""
    dim, topology = spaces.dim, split.mesh.topology
    topology.create_connectivity(dim - 1, dim)
    topology.create_connectivity(dim, dim - 1)
    boundary = [spaces.contact, spaces.across, spaces.neumann, spaces.dirichlet]
    behind = np.concatenate([facet_coefficients(split, space, facets).cells for facets in boundary])
    of_domain = topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)[behind, dim]
    ends = np.setdiff1d(dolfinx.mesh.exterior_facet_indices(topology), of_domain)
    return fem.locate_dofs_topological(space, dim - 1, ends.astype(np.int32), remote=False)


def _framed(products: Array, pulls: Array) -> GivenNodes:
    number, dim = pulls.shape
    frames = np.broadcast_to(np.eye(dim), (number, dim, dim)).copy()
    is_given, values = np.zeros((number, dim), dtype=bool), np.zeros((number, dim))
    some = np.flatnonzero(np.einsum("nii->n", products) > 0)
    sizes, vectors = np.linalg.eigh(products[some])
    sizes, frames[some] = sizes[:, ::-1], vectors[:, :, ::-1]
    is_given[some] = sizes > ALONG
    along = np.einsum("nij,ni->nj", frames[some], pulls[some])
    values[some] = np.where(is_given[some], along / np.where(is_given[some], sizes, 1.0), 0.0)
    return GivenNodes(frames, is_given, values)


def add_at(sums: la.Vector, nodes: npt.NDArray[np.int32], values: Array) -> None:
    """Add values of nodes to them; they may be the same for all nodes of a facet."""
    rows = sums.array.reshape(-1, sums.block_size)
    np.add.at(rows, nodes, values.reshape(*values.shape[: nodes.ndim], sums.block_size))


def given_along_normals(contact: ContactCoefficients, at: GivenNodes) -> tuple[Array, Array]:
    """What is given of v_n, or of its jump, at the coefficients on Γ_C, −∞ where some of it is not; the jump of v."""
    normals, jump = contact.facets.normals, contact.jump(np.einsum("nij,nj->ni", at.frames, at.values))
    left = np.einsum("nij,nj,nkj->nik", at.frames, ~at.given, at.frames)  # onto what is not given at a node
    sums = np.einsum("fkl,flij->fkij", contact.extraction, left[contact.nodes])
    sums[contact.touched] += np.einsum("fkl,flij->fkij", contact.other, left[contact.across])
    free = np.einsum("nkij,ni,nj->nk", sums, normals, normals)
    return np.where(free <= ALONG, np.einsum("nki,ni->nk", jump, normals), -np.inf), jump


def check_against_foundation(spaces: ElasticSpaces, data: ElasticData) -> None:
    """Make sure that what is given of u does not pass the foundation where parts meet (collective).

    There no displacement could satisfy both. On a curved Γ_C the facets have other normals than the body, so what is
    less than the share `TURNED` of the given displacement is let pass here; the certificate judges it.

    Raises:
        InputError: If it does; the place is told.
    """
    split, dim, comm, words = spaces.split, spaces.dim, spaces.mesh.comm, spaces.boundary.words
    element = basix.ufl.element("P", split.mesh.basix_cell(), 1, basix.LagrangeVariant.bernstein, shape=(dim,))
    space = fenicsx.function_space(split.mesh, element)
    at, contact = given_nodes(spaces, data, split, space), contact_coefficients(spaces, split, space)
    lowest = data.laws.chains.extent()[0].reshape(-1, dim).max(axis=1)[contact.rows]
    gap, (passed, jump) = contact.openings(spaces.mesh, data) - lowest[:, None], given_along_normals(contact, at)
    past = passed - gap - TURNED * np.linalg.norm(jump, axis=2)
    past[np.isin(contact.rows, spaces.slave_rows)] = -np.inf  # no foundation
    sizes = np.where(np.isfinite(gap), np.abs(gap), 0.0)
    size = comm.allreduce(float(max(np.abs(at.values).max(initial=0.0), sizes.max(initial=0.0))), MPI.MAX)
    worst = float(past.max(initial=-np.inf)), ""
    if worst[0] > LINEAR * size + spaces.displacement_rounding:
        facet, place = np.unravel_index(int(past.argmax()), past.shape)
        u_n, g, x = passed[facet, place], gap[facet, place], place_in_words(contact.places()[facet, place])
        worst = worst[0], f"u_n = {u_n:.4g} is given and {words[1]} is {g:.4g} at {x}"
    _, told = max(comm.allgather(worst))
    if told:
        raise InputError(f"[problem] u_D passes {words[0]} where parts meet, {told}: no {words[2]} satisfies both")
