"""What the backends have in common whose sites are the facets of Γ_S and, with laws in Ω, the cells behind them."""

from dataclasses import replace
from functools import cached_property

import numpy as np
import ufl
from mpi4py import MPI
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.owned import cell_nodes, function_at, owned_values
from signorini_fenicsx.contact.backend import DataBackend, Iterate
from signorini_fenicsx.discrete.field_change import FieldChange
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.forms.mixed import flux_product
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.sources import mean_moments
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


class FacetBackend(DataBackend):
    """A `Backend` for RT0/P0 with a condition per facet of Γ_S; subclasses add `name`, `dofs`, `solver` and `solve`.

    With laws in Ω there is a condition per owned cell as well, behind those of the facets.

    Attributes:
        facets: The sites that are facets.
        cells: The sites that are cells.
    """

    name: str
    noun = ("facet", "facets")
    dofs: int

    def __init__(self, spaces: Spaces, data: Data):
        """Keep the problem.

        Args:
            spaces: The discrete spaces.
            data: The data and their means over cells and facets.
        """
        self.spaces, self.data = spaces, data
        self.comm: MPI.Comm = spaces.mesh.comm
        self.facets, self.cells = spaces.site_kinds
        self.sites = len(spaces.facets)
        if data.inside:
            self.sites = len(spaces.site_kinds)
            self.noun = ("site", "sites") if spaces.part_names else ("cell", "cells")

    @cached_property
    def change(self) -> FieldChange:
        """Norms of what changed, see `Backend.change`."""
        return FieldChange(self.spaces.V, self.spaces.Q)

    def without_flux(self, iterate: Iterate, where: Mask) -> Iterate:
        """The iterate with σ·n = q_S on some facets, and the trace that belongs to it by (37) (collective).

        If the flux changes by δσ on a facet, p changes on every Γ_S facet of the same cell: by (κ_h⁻¹δσ, τ_h), where
        τ_h is the basis function of that Γ_S facet.
        """
        spaces, sigma = self.spaces, iterate.sigma.copy()
        added = -iterate.flux * spaces.facet_measure / spaces.basis_flux
        change = function_at(spaces.V, spaces.flux_dofs[where], added[where])
        sigma.x.array[:] += change.x.array
        moved = assembled(spaces.kept(_trace_of_flux, self.data.kappa_h, change))
        p = iterate.p + moved[spaces.flux_dofs] / spaces.basis_flux
        return replace(iterate, sigma=sigma, p=p, flux=np.where(where, 0.0, iterate.flux))

    def scales(self, iterate: Iterate) -> tuple[Array, Array]:
        """Sizes of p and σ·n per site (collective).

        These are the sizes of the terms that add up to p and to σ·n. For p it is the largest |u| in Ω or |p| on Γ_S.
        For σ·n it is the largest flux, per |e|, through any facet of a cell behind Γ_S. Where κ jumps, rounding has the
        same size everywhere in the energy. So the scale of p is also at most the largest √κ|u| or √κ|p|, divided by √κ
        of the facet's cell, and that of σ·n at most the largest flux/√κ, times this √κ. In a cell the scale of u_T is
        that of p, and that of −s_T = (u_T − ū_T)/m_T − f_T is this divided by m_T.
        """
        spaces = self.spaces
        roots = np.sqrt(self.data.conductivities(spaces))
        root, of_facets = roots[spaces.cells], self.facets.of(iterate.p)
        through = np.abs(iterate.sigma.x.array[spaces.V.dofmap.list[spaces.cells]]).max(axis=1, initial=0.0)
        flux = through * np.abs(spaces.basis_flux) / spaces.facet_measure
        if self.data.b is not None:
            flux = flux + self.data.b.sizes(self.data.matrices(spaces))[spaces.cells]
        u, p = np.abs(owned_values(iterate.u)), np.abs(of_facets)
        terms = (np.append(u, p), np.append(roots * u, root * p), flux, flux / root)
        largest = np.array([values.max(initial=0.0) for values in terms])
        self.comm.Allreduce(MPI.IN_PLACE, largest, MPI.MAX)
        scales = np.minimum(largest[0], largest[1] / root), np.minimum(largest[2], largest[3] * root)
        if not self.data.inside:
            return scales
        of_u = np.minimum(largest[0], largest[1] / roots)
        return np.append(scales[0], of_u), np.append(scales[1], of_u / mean_moments(spaces, self.data))

    def places(self) -> Array:
        """The sum of each site's vertices, and before it whether it is a cell, shape (sites, 4)."""
        gamma, dofmap = self.spaces.Lambda.mesh, self.spaces.Lambda.dofmap.list[:, 0]
        corners = np.empty((len(dofmap), gamma.geometry.dofmaps[0].shape[1], 3))
        corners[dofmap] = gamma.geometry.x[gamma.geometry.dofmaps[0]]
        mesh = self.spaces.mesh
        cells = mesh.geometry.x[cell_nodes(mesh)[: self.sites - len(self.spaces.facets)]]
        sums = [np.sort(x, axis=1).sum(axis=1) for x in (self.facets.of(corners), cells)]  # the same bits on any rank
        return np.vstack([np.insert(rows, 0, kind, axis=1) for kind, rows in enumerate(sums)])


def _trace_of_flux(spaces: Spaces, kappa: Expr, sigma: Expr) -> Form:
    return flux_product(sigma, ufl.TestFunction(spaces.V), ufl.dx, kappa)
