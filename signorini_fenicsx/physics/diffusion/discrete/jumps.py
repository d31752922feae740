"""One flux for both sides of facets inside the domain, across which the mesh is cut, in the mixed system.

There the two fluxes are equal, so one of them goes; p, from the equation of the flux that stays, is the jump of u. In
the facet system the jump is an unknown, see `discrete.hybrid_system.Sides`.
"""

from petsc4py import PETSc

from signorini_fenicsx.discrete.matrices import identity_with
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


def with_one_flux(spaces: Spaces, size: int) -> PETSc.Mat | None:
    """The matrix from fluxes, those of the other sides being ignored, to fluxes with equal ones (collective).

    None without inner facets.

    Args:
        spaces: The discrete spaces.
        size: Number of owned unknowns, of which the first are those of RT0.
    """
    if not spaces.inner.present:
        return None
    comm, (across, opposite) = spaces.mesh.comm, spaces.fluxes_across
    first = int(comm.exscan(size) or 0)
    return identity_with(
        comm, size, first + across, first + spaces.flux_dofs[spaces.inner.rows], opposite, ignored=across
    )
