"""How well a stress and a contact gap satisfy the discrete elastic problem, and the forces that balance."""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import sums_at
from signorini_fenicsx.base.tolerances import LINEAR
from signorini_fenicsx.contact.residuals import Residuals, squares_off
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, facet_normals, linear_values
from signorini_fenicsx.discrete.pairing import MeshPair
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import hats_in_subcells, to_entries
from signorini_fenicsx.physics.elasticity.discrete.material import mean_compliances
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.discrete.tools import unbalanced


@dataclass(frozen=True)
class ElasticKKT(Residuals):
    """Residuals of the elastic problem, each the share that it is of the stress, so that no unit enters.

    p stands for g − u_n, in means weighted by the hats of facet vertices; L = |Ω|^(1/d); S = ‖σ‖, of an incompressible
    body ‖dev σ‖. If σ = 0, they are 0 or infinite.
    Without loads a body at rest has only rounding in σ; then S is the stress of a strain with the largest |u_D| or |g|.

    Attributes:
        primal: 2μ‖[p]_-‖/(√L S) on Γ_C, what penetrates the foundation, or is beyond what another law allows.
        dual: √L ‖[−σ_nn]_-‖/S, what pulls at it, or is beyond what another law allows; with friction also the shear
            above its bound.
        complementarity: √L ‖min(2μ|p|/L, |σ_nn|)‖/S; with friction also the distance of u_t and σ_t
            to its graph; under other laws that of p and −σ_nn to theirs.
        tractions: (Σ |e|^(1/(d − 1)) ‖r‖²_e)^½/S, where r is the jump of σn inside Ω, what is left of σn − g_N where
            the traction is given, on supports in directions that they do not hold, and the shear on Γ_C without
            friction; with what is left of the forces on tools, spread over their parts.
        equilibrium: ‖h_T (∇·σ + f_h)‖/S, by the moments of both against linear functions on each cell.
    """

    primal: float
    dual: float
    complementarity: float
    tractions: float
    equilibrium: float


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # what is not finite is no solution
def elastic_kkt(spaces: ElasticSpaces, data: ElasticData, stresses: Array, p: Array) -> ElasticKKT:
    """Residuals by the fields alone, not by what a backend says (collective).

    Args:
        spaces: The spaces.
        data: The data.
        stresses: Values of σ as in `SplitMesh.values`.
        p: g − u_n at the sites as `VertexLaws.openings` has it, then u_t at those with friction.
    """
    comm, dim = spaces.mesh.comm, spaces.dim
    volume = square = of_loads = 0.0
    stiffness = np.empty(len(spaces.order))
    missing = imbalance(spaces, data, stresses)
    for cells in spaces.blocks():
        numbers, measure = cells.numbers, cells.measure
        square += float((subcell_squares(data.material.seen(stresses[numbers])) * measure[:, None] / (dim + 1)).sum())
        stiffness[numbers] = 1 / mean_compliances(data.compliances(spaces, numbers))[0].mean(axis=1)
        volume += float(measure.sum())
        of_loads += float((measure ** (1 + 2 / dim) * (dim + 1) * (missing[numbers] ** 2).sum(axis=(1, 2))).sum())
    sums = np.array([volume, square, of_loads, _jumps(spaces, data, stresses)])
    volume, square, of_loads, jumps = comm.allreduce(sums).tolist()
    jumps += _left_on_tools(spaces, data, stresses)
    norm, length = np.sqrt(square), volume ** (1 / dim)
    norm = max(norm, _of_rounding(spaces, data, stiffness, norm, missing, volume))
    if norm == 0:
        return ElasticKKT(0.0, 0.0, 0.0, 0.0, 0.0)
    k = np.repeat(stiffness[spaces.contact.cells], dim) / length
    (normal, slip), flux = spaces.site_kinds, data.reactions(spaces, stresses, spaces.site_kinds["slip"].of(p))
    squares = squares_off(data.laws.chains, (normal.of(p), normal.of(flux)), k, normal.measure, 1.0)[:, 0]
    unit, weights = k[slip.pressing], (spaces.rough.measure / dim)[:, None]
    off = data.friction.residuals(slip.rows_of(p), slip.rows_of(flux), unit)
    squares[1:] += [(weights * each**2).sum() for each in off]
    squares = comm.allreduce(squares)
    primal, dual, complementarity = (np.sqrt(length * squares) / norm).tolist()
    return ElasticKKT(primal, dual, complementarity, float(np.sqrt(jumps) / norm), float(np.sqrt(of_loads) / norm))


def _of_rounding(
    spaces: ElasticSpaces, data: ElasticData, stiffness: Array, norm: float, missing: Array, volume: float
) -> float:
    """‖σ‖ for a strain of the largest |u_D| or |g|, if only these are given and σ is rounding; else 0 (collective).

    Then what is missing of the balance is f.
    """
    loads, length = np.append(data.tractions, data.pulled), volume ** (1 / spaces.dim)
    largest = np.array([np.abs(x).max(initial=0.0) for x in (stiffness, data.lift, loads, missing)])
    spaces.mesh.comm.Allreduce(MPI.IN_PLACE, largest, MPI.MAX)
    stiff, displacement, load, force = largest.tolist()
    size = stiff * displacement * np.sqrt(volume) / length
    at_rest = load == 0 and max(norm, force * length * np.sqrt(volume)) <= LINEAR * size
    return size if at_rest else 0.0


def subcell_squares(stresses: Array) -> Array:
    """Means of |σ|² over the subcells, from values at their vertices, shape (cells, d + 1, d + 1, d, d)."""
    size = stresses.shape[1]
    of_each = (stresses**2).sum(axis=(2, 3, 4))
    of_sum = (stresses.sum(axis=2) ** 2).sum(axis=(2, 3))
    return (of_each + of_sum) / (size * (size + 1))


def energy_squares(spaces: ElasticSpaces, data: ElasticData, stresses: Array) -> Array:
    """(𝔸σ, σ) of each owned cell, from values as in `SplitMesh.values` (collective)."""
    squares = np.empty(len(spaces.order))
    for cells in spaces.blocks():
        masses = data.masses(spaces, cells)
        stress = to_entries(stresses[cells.numbers]).reshape(*masses.shape[:3], 1)
        squares[cells.numbers] = (stress * (masses @ stress)).sum(axis=(1, 2, 3))
    return squares


def imbalance(spaces: ElasticSpaces, data: ElasticData, stresses: Array) -> Array:
    """Moments of ∇·σ + f against the hats of the cells' vertices, over |T|, shape (cells, d + 1, d)."""
    dim = spaces.dim
    left = np.empty((len(spaces.order), dim + 1, dim))
    for cells in spaces.blocks():
        volume = cells.measure / (dim + 1)
        divergence = np.einsum("nsvij,nsvj->nsi", stresses[cells.numbers], cells.hat_gradients)
        moments = np.einsum("vs,nsi->nvi", hats_in_subcells(dim), divergence)
        moments += data.moments_of_f(spaces, cells)
        left[cells.numbers] = moments / (volume * (dim + 1))[:, None, None]
    return left


def _jumps(spaces: ElasticSpaces, data: ElasticData, stresses: Array) -> float:
    """Σ |e|^(1/(d − 1)) ‖r‖²_e over the facets that this rank owns, see `ElasticKKT.tractions` (collective)."""
    dim, index_map = spaces.dim, spaces.traces.dofmap.index_map
    normals = facet_normals(spaces.vertices)
    measures = np.linalg.norm(normals, axis=2)
    pulls = np.einsum("nsaij,nsj->nsai", stresses[:, :, :dim], normals / measures[:, :, None])
    left = sums_at(index_map, spaces.dofs, pulls)
    left[spaces.neumann.blocks] -= linear_values(data.tractions, spaces.neumann.measure)
    held = data.supports.facets.blocks
    left[held] = data.supports.let_go(left[held])
    left[spaces.across.blocks] += left[spaces.contact.blocks[spaces.inner.rows]]
    for pair in spaces.pairs:
        _pass_on(spaces, pair, left)
    left[spaces.contact.blocks] -= data.pulled
    for facets, _, axes, _ in spaces.fixed:
        _drop(left, facets, axes)
    _drop(left, spaces.contact, spaces.contact.normals)
    left[spaces.rough.blocks] = 0.0
    size = np.zeros(len(left))
    size[spaces.dofs] = measures
    squares = (left**2).sum(axis=(1, 2)) + (left.sum(axis=1) ** 2).sum(axis=1)
    weighted = size ** (1 + 1 / (dim - 1)) * squares / (dim * (dim + 1))
    return float(weighted[: index_map.size_local].sum())


def _pass_on(spaces: ElasticSpaces, pair: MeshPair, left: Array) -> None:
    """Add the tractions on a slave, where a law holds along them, to those on its master (collective)."""
    slaves, masters = spaces.boundary_facets(pair.slaves), spaces.boundary_facets(pair.masters)
    passed = left[slaves.blocks]
    smooth = ~np.isin(slaves.facets, np.append(spaces.rough.facets, spaces.tied))
    along = np.einsum("nai,ni->na", passed, slaves.normals)[:, :, None] * slaves.normals[:, None]
    passed[smooth] = along[smooth]
    moments = pair.onto_masters(spaces.mesh.comm, passed)
    left[masters.blocks] += linear_values(moments, masters.measure)
    if pair.parts.tied:
        left[slaves.blocks] = 0.0


def _left_on_tools(spaces: ElasticSpaces, data: ElasticData, stresses: Array) -> float:
    """What tools add to the sum of `_jumps` (collective)."""
    total = 0.0
    tractions = spaces.tractions(spaces.contact, stresses) - data.pulled
    for tool, left in unbalanced(spaces, data.tools, tractions):
        area = spaces.mesh.comm.allreduce(float(spaces.part(tool.part).measure.sum()))
        total += area ** (1 / (spaces.dim - 1) - 1) * float(left @ left)
    return total


def _drop(values: Array, facets: BoundaryFacets, axes: Array) -> None:
    """Take the components of values along axes of facets away, in place."""
    along = np.einsum("nai,ni->na", values[facets.blocks], axes)
    values[facets.blocks] -= along[:, :, None] * axes[:, None]


def resultants(spaces: ElasticSpaces, stresses: Array) -> dict[str, Array]:
    """Forces and, after them, moments about the origin on each part (collective)."""
    forces = {}
    for name in spaces.domain.parts:
        part = spaces.part(name)
        pulls = part.of_linear(spaces.tractions(part, stresses))
        forces[name] = spaces.mesh.comm.allreduce(_wrench(part.vertices, pulls))
    return forces


def balance(spaces: ElasticSpaces, data: ElasticData, stresses: Array) -> tuple[Array, float]:
    """What is left of all forces and moments, those of f among them, and its share of the forces (collective).

    The moments are about the middle of the domain: about a far origin rounding would be most of them. Their share is
    that of the forces times the size of the domain.
    """
    box = spaces.domain.box()[:, : spaces.dim]
    everything = [spaces.contact, spaces.across, spaces.neumann, spaces.dirichlet]
    pairs = [(facets.vertices, facets.of_linear(spaces.tractions(facets, stresses))) for facets in everything]
    pairs += [(cells.vertices, data.moments_of_f(spaces, cells)) for cells in spaces.blocks()]
    total = np.sum([_wrench(x - box.mean(axis=0), forces) for x, forces in pairs], axis=0)
    size = sum(float(np.abs(forces).sum()) for _, forces in pairs)
    *left, size = spaces.mesh.comm.allreduce(np.append(total, size))
    lengths = np.where(np.arange(len(left)) < spaces.dim, 1.0, np.ptp(box, axis=0).max())
    return np.array(left), float(np.abs(left / lengths).max() / size) if size > 0 else 0.0


def _wrench(vertices: Array, moments: Array) -> Array:
    """Force and moment of what has these moments against the hats of vertices."""
    force = moments.sum(axis=(0, 1))
    if vertices.shape[2] == 2:
        turning = vertices[..., 0] * moments[..., 1] - vertices[..., 1] * moments[..., 0]
        return np.append(force, turning.sum())
    return np.append(force, np.cross(vertices, moments).sum(axis=(0, 1)))
