"""What pictures show of a solution of a diffusion problem."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from signorini_fenicsx.discrete.mesh_spaces import cells_and_dofs
from signorini_fenicsx.physics.diffusion.tables import facet_table
from signorini_fenicsx.solving.drawn import Drawn, whole_boundary

if TYPE_CHECKING:  # a solution has these pictures
    from signorini_fenicsx.physics.diffusion.solution import Solution


def drawn(solution: Solution) -> Drawn:
    """The solution for pictures (collective)."""
    spaces, lift, laws = solution.spaces, solution.data.u_lift, solution.data.laws
    p = solution.p.x.array[: len(spaces.facets)].copy()
    p[spaces.inner.rows] = np.nan
    u_D = lift.x.array[cells_and_dofs(lift.function_space, spaces.dirichlet_facets)[1]]
    u = solution.u.x.array
    return Drawn(
        u=np.broadcast_to(u[:, None, None], (len(u), spaces.mesh.topology.dim + 1, 1)),
        sigma=solution.cell_flux.centroid,
        facets=facet_table(solution),
        boundary=whole_boundary(spaces, signorini=p, dirichlet=u_D),
        divergence=solution.cell_flux.divergence,
        contact=solution.outcome.iterate.contact,
        segments=laws.names() if laws.listed else (),
        inside=solution.boundary.inner,
    )
