"""Other unknowns on facets inside the domain: the jump of u there, and one flux for both sides.

Across such a facet the mesh is cut. In the Crouzeix-Raviart system its unknowns u⁺ and u⁻, on the named side and on the
other one, become the jump u⁺ − u⁻ and u⁻. The equation of the jump is then that of u⁺ before, which says what σ·n is,
and the equation of u⁻ says that both sides have the same flux. So a law between the jump and σ·n is imposed like one
between u and σ·n on the boundary, and the matrix stays symmetric positive definite.

In the mixed system the two fluxes are equal, so one of them goes; p, from the equation of the flux that stays, is the
jump.
"""

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.discrete.matrices import identity_with
from signorini_fenicsx.discrete.mesh_spaces import cells_and_dofs
from signorini_fenicsx.physics.diffusion.spaces import Spaces


def jumps_of_facets(spaces: Spaces, *, back: bool = False) -> PETSc.Mat | None:
    """The matrix from (jump, u⁻) to (u⁺, u⁻) in Crouzeix-Raviart functions, or its inverse (collective).

    None without inner facets.

    Args:
        spaces: The discrete spaces.
        back: Whether it is the inverse.
    """
    if not spaces.inner.present:
        return None
    space, comm, inner = spaces.crouzeix_raviart, spaces.mesh.comm, spaces.inner
    numbers = space.dofmap.index_map
    facets = spaces.facets[inner.rows], inner.facets
    named, across = (numbers.local_range[0] + cells_and_dofs(space, some)[1] for some in facets)
    return identity_with(comm, numbers.size_local, named, across, np.full(len(named), -1.0 if back else 1.0))


def with_one_flux(spaces: Spaces, size: int) -> PETSc.Mat | None:
    """The matrix from fluxes, those of the other sides being ignored, to fluxes with equal ones (collective).

    None without inner facets.

    Args:
        spaces: The discrete spaces.
        size: Number of owned unknowns, of which the first are those of RT0.
    """
    if not spaces.inner.present:
        return None
    comm, (across, opposite) = spaces.mesh.comm, spaces.across
    first = int(comm.exscan(size) or 0)
    return identity_with(
        comm, size, first + across, first + spaces.flux_dofs[spaces.inner.rows], opposite, ignored=across
    )
