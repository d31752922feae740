"""Other unknowns on facets inside the domain: the jump of u there, and one flux for both sides.

Across such a facet the mesh is cut. In the Crouzeix-Raviart system its unknowns u⁺ and u⁻, on the named side and on the
other one, become the jump u⁺ − u⁻ and u⁻. The equation of the jump is then that of u⁺ before, which says what σ·n is,
and the equation of u⁻ says that both sides have the same flux. So a law between the jump and σ·n is imposed like one
between u and σ·n on the boundary, and the matrix stays symmetric positive definite.

In the mixed system the two fluxes are equal, so one of them goes; p, from the equation of the flux that stays, is the
jump.
"""

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from signorini_fenicsx.discrete.matrices import identity_with
from signorini_fenicsx.discrete.spaces import Spaces


def with_jumps(
    spaces: Spaces, size: int, named: npt.NDArray[np.int32], across: npt.NDArray[np.int32]
) -> PETSc.Mat | None:
    """The matrix from (jump, u⁻) to (u⁺, u⁻); None without inner facets (collective).

    Args:
        spaces: The discrete spaces.
        size: Number of owned unknowns.
        named: Owned unknowns of the named sides.
        across: Those of the other sides.
    """
    if not spaces.inner.present:
        return None
    comm = spaces.mesh.comm
    first = int(comm.exscan(size) or 0)
    return identity_with(comm, size, first + named, first + across, np.ones(len(named)))


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
