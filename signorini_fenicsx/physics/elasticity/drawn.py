"""What pictures show of an elastic solution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import dolfinx.mesh
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.mesh_spaces import NEUMANN
from signorini_fenicsx.discrete.site_table import FacetTable, along_parts
from signorini_fenicsx.physics.elasticity.fields import in_space, von_mises
from signorini_fenicsx.physics.elasticity.spaces import linear_from_means
from signorini_fenicsx.solving.drawn import PARTLY_FIXED, Drawn, whole_boundary

if TYPE_CHECKING:  # a solution has these pictures
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution


@dataclass(frozen=True)
class BodyFacets(FacetTable):
    """Γ_C: for p the mean gap, for σ·n the mean pressure.

    Attributes:
        normals: The outer unit normals, shape (facets, d).
        gaps: The gap at the vertices of each facet, linear on it, shape (facets, d).
        apart: The gap before any displacement there, 0 but for parts inside the domain.
    """

    normals: Array
    gaps: Array
    apart: Array


def drawn(solution: ElasticSolution) -> Drawn:
    """The solution for pictures: for σ the largest von Mises stress of each cell (collective)."""
    spaces, nothing = solution.spaces, np.empty(0, dtype=np.int32)
    by_geometry = np.argsort(spaces.order, axis=1)[:, :, None]
    fixed = np.concatenate([nothing, *(spaces.domain.facets[part] for part in solution.boundary.fixed)])
    free = np.setdiff1d(spaces.neumann_facets, fixed)
    kinds = {NEUMANN: free, PARTLY_FIXED: fixed}
    return Drawn(
        u=np.take_along_axis(spaces.displacement_values(solution.u), by_geometry, axis=1),
        sigma=von_mises(in_space(spaces, solution.data, solution.stresses)).max(axis=(1, 2))[:, None],
        facets=_facets(solution),
        boundary=whole_boundary(spaces)
        | {kind: (facets, np.full(len(facets), np.nan)) for kind, facets in kinds.items()},
        strength="von Mises stress",
        gamma=r"$\Gamma_C$",
        inside=solution.boundary.inner,
    )


def _facets(solution: ElasticSolution) -> BodyFacets:
    spaces, contact = solution.spaces, solution.spaces.contact
    part = spaces.part_of_facet.astype(np.int64)
    middle = np.pad(contact.vertices.mean(axis=1), ((0, 0), (0, 3 - spaces.dim)))
    none = np.zeros(len(middle))
    apart = np.zeros((len(middle), spaces.dim))
    means = solution.data.lift[spaces.sites].reshape(apart.shape)
    apart[spaces.inner.rows] = linear_from_means(means)[spaces.inner.rows]
    nodes = dolfinx.mesh.entities_to_geometry(spaces.mesh, spaces.dim - 1, contact.facets)
    numbers = np.take_along_axis(spaces.mesh.geometry.input_global_indices[nodes], contact.ranking, axis=1)
    ascending = np.argsort(numbers, axis=1)
    return BodyFacets(
        part=part,
        along=along_parts(spaces, part, middle),
        x=middle,
        measure=contact.measure,
        u=none,
        p=solution.gap.mean(axis=1),
        flux=solution.pressure.mean(axis=1),
        psi=none,
        q_S=none,
        condition=solution.contact_set().inside.astype(np.int64),
        segment=none.astype(np.int64),
        vertices=np.take_along_axis(numbers, ascending, axis=1),
        normals=contact.normals,
        gaps=np.take_along_axis(solution.linear_gap, ascending, axis=1),
        apart=np.take_along_axis(apart, ascending, axis=1),
    )
