"""Errors of a discrete solution where u is known."""

from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.tolerances import EXACT_CONTACT
from signorini_fenicsx.discrete.contact_sets import FacetSet, hausdorff
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.points import (
    ROUNDINGS,
    BesideFacets,
    FacetPoints,
    beside,
    cell_quadrature,
    facet_quadrature,
)
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import CellLaws
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

if TYPE_CHECKING:  # it has these
    from signorini_fenicsx.physics.diffusion.solution import Solution


def exact_errors(solution: "Solution", exact: Datum) -> dict[str, float]:
    """The error of σ in the energy norm, and L² norms of those of σ, ∇·σ, u, ũ over Ω and of p over Γ_S (collective).

    Also the Hausdorff distance of the contact set. In time, and with laws in Ω, ∇·σ is not known from u and the data,
    and left out; so are the slaves of pairs in the error of p, which is a jump there, and with them the contact set.
    """
    spaces, data, flux = solution.spaces, solution.data, solution.cell_flux
    mesh, degree = spaces.mesh, quadrature_degree(exact)
    squares = np.zeros(6)
    for points in cell_quadrature(mesh, owned_cells(mesh), degree):
        jet, kappa = exact.jet(points, gradient=True), data.kappa.values(points)
        slope = jet[:, :, 1:, None]
        exact_flux = kappa[..., None] * slope[..., 0] if kappa.ndim == 2 else (kappa @ slope)[..., 0]
        if data.b is not None:
            exact_flux = exact_flux + data.b.at(points, data.kappa)
        off = exact_flux - flux.at(points)
        inverse = off / kappa[..., None] if kappa.ndim == 2 else np.linalg.solve(kappa, off[..., None])[..., 0]
        balance = data.f.values(points) - data.c.values(points) * jet[:, :, 0] + flux.divergence_at(points)
        errors = [
            (off * inverse).sum(axis=2),
            (off**2).sum(axis=2),
            balance**2,
            (jet[:, :, 0] - solution.u_at(points)) ** 2,
            (jet[:, :, 0] - solution.potential_at(points)) ** 2,
        ]
        squares[:5] += [points.integrals(error).sum() for error in errors]
    on_signorini = facet_quadrature(mesh, spaces.facets, degree)
    off = exact_trace(spaces, exact, on_signorini) - solution.trace_at(on_signorini)
    off[spaces.slave_rows] = 0.0
    squares[5] = on_signorini.integrals(off**2).sum()
    norms = np.sqrt(mesh.comm.allreduce(squares)).tolist()
    names = ("energy", "sigma_L2", "div_sigma_L2", "u_L2", "u_potential_L2", "p_L2")
    by_name = dict(zip(names, norms, strict=True))
    if data.memory is not None or data.inside:
        del by_name["div_sigma_L2"]
    if not spaces.pairs:
        by_name["contact_hausdorff"] = hausdorff(solution.contact_set(), exact_contact(spaces, data, exact))
    return by_name


def missed_contact(spaces: Spaces, laws: CellLaws, exact: Datum, contact: Mask) -> float:
    """Measure of the cells where one of u_h and u only, in the centroid, is held by a law in Ω (collective)."""
    held = np.zeros(len(contact), dtype=bool)
    for part in laws.of_regions:
        for points in part.quadrature(spaces, 1):
            u, law = exact.values(points), part.chains(points)
            near = np.abs(u - law.value) <= EXACT_CONTACT * np.maximum(np.abs(u), np.abs(law.value))
            held[points.cells] |= (near & np.isinf(law.slope)).any(axis=1)
    return float(spaces.mesh.comm.allreduce(spaces.cell_measures[held != contact].sum()))


def exact_trace(spaces: Spaces, exact: Datum, points: FacetPoints) -> Array:
    """The exact u, or its jump, in points of all facets of Γ_S, shape (facets, points) (collective)."""
    trace, inner = exact.values(points), spaces.inner
    if inner.present:
        opposite, order = points.across(inner.rows, inner.facets)
        named, across = (exact.values(BesideFacets.of(side, beside(spaces.mesh))) for side in (points, opposite))
        trace[inner.rows] = named[inner.rows] - np.take_along_axis(across, order, axis=1)
    return trace


def exact_contact(spaces: Spaces, data: Data, exact: Datum) -> FacetSet:
    """The facets of Γ_S in whose midpoints the exact u is ψ, or a value at which another law holds it (collective)."""
    trace = exact_trace(spaces, exact, facet_quadrature(spaces.mesh, spaces.facets, 1))[:, 0]
    apart = ROUNDINGS * np.spacing(np.abs(spaces.domain.box()).max()) / spaces.length  # of points of the domain
    share = beside(spaces.mesh) if spaces.inner.present else max(EXACT_CONTACT, apart)
    error = share * spaces.mesh.comm.allreduce(np.abs(trace).max(initial=0.0), MPI.MAX)
    held = np.zeros(len(trace), dtype=bool)
    for part in data.laws.of_parts:
        law = part.chains(facet_quadrature(spaces.mesh, spaces.facets[part.rows], 1))
        near = np.abs(trace[part.rows, None] - law.value) <= error
        held[part.rows] = (near & np.isinf(law.slope)).any(axis=1)
    return FacetSet(spaces, held)
