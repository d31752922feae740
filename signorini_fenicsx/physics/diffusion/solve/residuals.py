"""Residuals of the discrete Signorini problem that do not depend on units."""

from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, inverses
from signorini_fenicsx.base.owned import cell_dofs, owned_values
from signorini_fenicsx.base.tolerances import ROUNDING
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Penalty, SiteConditions
from signorini_fenicsx.contact.residuals import Residuals, relative, squares_off
from signorini_fenicsx.discrete.mesh_spaces import cells_and_dofs
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux, joined, mass_diagonal
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import CellLaws
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.sources import mean_moments
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

FAR = 1e6
"""If ψ is this many times as large as u, the rounding of u − ψ may be above the tolerance beside u."""
CONSTANT = 1e-10
"""If the energy of u is below this share of ‖√k u‖/L, u counts as constant, and its σ as an error of linear solvers."""


@dataclass(frozen=True)
class KKTResiduals(Residuals):
    """Residuals of (MLM-I)_h and (MLM-II)_h, with p and σ·n standing for p − ψ and σ·n − q_S.

    Each residual is measured twice, as a gradient and as a flux, and the larger value counts: where κ jumps, a wrong
    sign shows as a gradient where κ is small and as a flux where κ is large. L = |Ω|^(1/d) is a length; k is the mean
    eigenvalue of κ_h on a cell, and on a facet that of the cell behind it. Residuals are compared with the gradient
    G = ‖κ_h⁻¹σ‖ and the flux S = ‖σ‖. If u is constant, σ is rounding; then G = ‖u‖/L and S = ‖ku‖/L, or the same with
    the largest |u_D| or |ψ| in place of u if these are larger. u can be constant only without loads and with constant
    u_D on each body. If S = 0, residuals are 0 or infinite. The constant that u_D and ψ have in common is subtracted
    from u, u_D and ψ first.

    With laws in Ω s = f_h − c_h u + ∇·σ is on the graph of u in each cell; an obstacle has the force λ = −s. Primal,
    dual and complementarity then have parts from Ω as well, of an obstacle ‖[u − ψ]_-‖ / (L G), ‖h_T k⁻¹[λ]_-‖ / G and
    ‖min(|u − ψ|/L, h_T k⁻¹|λ|)‖ / G, and the same as fluxes.

    For other laws p and σ·n are measured from the reference. Then primal and dual are how far p is outside of what any
    σ·n allows, and σ·n outside of what any p allows. Complementarity is the rest of the distance to the graph, in the
    maximum norm of (k/L)p and σ·n: on each facet the distance to the nearest segment.

    A penalty formulation is the same system with p replaced by p + εσ·n (I) or σ·n by σ·n + εp (II). Its residuals
    primal, dual and complementarity are those of the replaced quantities.

    On a facet inside the domain p is the jump of u, and the flux of its two sides is one unknown.

    Attributes:
        primal: ‖[p]_-‖_Λ / (√L G) and ‖k [p]_-‖_Λ / (√L S), the violation of p ≥ 0.
        dual: √L ‖k⁻¹[σ·n]_-‖_Λ / G and √L ‖[σ·n]_-‖_Λ / S, the violation of σ·n ≥ 0.
        complementarity: √L ‖min(|p|/L, k⁻¹|σ·n|)‖_Λ / G and √L ‖min(k|p|/L, |σ·n|)‖_Λ / S, the smaller of p and σ·n on
            each facet. Their product is not used, since it can be as small as the square of an error.
        stationarity: √(rᵀ M⁻¹ r) / G and √(rᵀ W⁻¹ M W⁻¹ r) / S with r the residual of (9a), M the diagonal of the mass
            matrix of RT0 and W that of (κ_h⁻¹σ, τ).
        mass_balance: ‖h_T k⁻¹(∇·σ + s)/(1 + c m_T)‖ / G and ‖h_T (∇·σ + s)‖ / S with s = f_h − c_h u, (9b) cell by
            cell, unless there are laws in Ω; on Γ_N √L ‖k⁻¹(σ·n − g_N)‖ / G and √L ‖σ·n − g_N‖ / S. With the m_T of
            `sources`, and û fixed, a lack r of the balance moves u_T by m_T r/(1 + c m_T), and m_T is h_T²/k but for a
            constant; so the first says how far u_T is off, over h_T, whatever is stored.
    """

    primal: float
    dual: float
    complementarity: float
    stationarity: float
    mass_balance: float


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # what is not finite is no solution
def kkt_residuals(
    spaces: Spaces,
    data: Data,
    sigma: fem.Function,
    u: fem.Function,
    p: Array,
    penalty: Penalty | None,
    eps: float,
) -> KKTResiduals:
    """Residuals of a discrete solution, computed from its fields alone (collective).

    Args:
        spaces: The discrete spaces.
        data: The data and their means over cells and facets.
        sigma: Flux in RT0, with ghost values.
        u: Scalar in P0, with ghost values.
        p: Trace on the facets of Γ_S of this rank.
        penalty: Penalty law; None for the Signorini condition.
        eps: ε of the penalty.
    """
    constant = data.common_constant(spaces)
    data, u, p = data.less(spaces, constant), u.copy(), p.copy()
    p[spaces.outer_rows] -= constant
    u.x.array[:] -= constant
    length = spaces.length
    in_cells = CellFlux.of(spaces, sigma)
    scales = sizes_of_solution(spaces, in_cells, u, data)

    k, h, (facet, cell) = data.conductivities(spaces), spaces.cell_diameters, spaces.site_kinds
    trace, flux = p - data.psi_h, spaces.normal_flux(sigma) - data.q_Sh
    if penalty is not None:
        trace, flux = penalty.shift(trace, flux, eps)
    weights, k_e = length * facet.measure, k[spaces.cells]
    squares = squares_off(data.laws.chains, (trace, flux), k_e / length, weights, k_e, 1.0)
    if data.inside:
        *pair, unit = _pairs_of_cells(spaces, data, data.inside, in_cells, u)
        squares += squares_off(data.inside.chains, pair, unit, cell.measure * h**2, k, 1.0)
    of_cells = _stationarity(spaces, in_cells, u, p, data), _imbalance(spaces, in_cells, sigma, u, data)
    residuals = np.sqrt(spaces.mesh.comm.allreduce(np.vstack([squares, *of_cells])))
    return KKTResiduals(*(relative(each, scales) for each in residuals))


def far_bound(spaces: Spaces, data: Data, u: fem.Function) -> str:
    """What to do about residuals that come from a ψ far from u, as the end of a sentence; empty if it is near.

    Collective. The data and u are those without the constant that u_D and ψ have in common.
    """
    far = max(*np.abs(data.extent(spaces)), np.abs(data.psi_h).max(initial=0.0))
    furthest, largest = (
        spaces.mesh.comm.allreduce(float(each), MPI.MAX) for each in (far, np.abs(u.x.array).max(initial=0.0))
    )
    if furthest <= FAR * largest:
        return ""
    return (
        f"; u is at most {largest:.1e} and ψ is up to {furthest:.1e} away, so too few digits of u are left in u − ψ: "
        "where there is no contact, give a ψ that is nearer to u"
    )


def with_cells(
    spaces: Spaces, data: Data, iterate: Iterate, segment: Indices, penalty: Penalty | None = None, eps: float = 1.0
) -> tuple[Iterate, SiteConditions]:
    """An iterate of facets, and their segments, with those of cells to which its fields are nearest (collective)."""
    if data.inside:
        sigma, law = CellFlux.of(spaces, iterate.sigma), data.inside.chains
        above, force, unit = _pairs_of_cells(spaces, data, data.inside, sigma, iterate.u)
        segment = np.append(segment, np.argmin(law.off_segments((above, force), (above, force), unit), axis=1))
        iterate = replace(iterate, p=np.append(iterate.p, above), flux=np.append(iterate.flux, force))
    return iterate, data.chains.with_penalty(penalty, eps).conditions(segment)


def _pairs_of_cells(
    spaces: Spaces, data: Data, laws: CellLaws, sigma: CellFlux, u: fem.Function
) -> tuple[Array, Array, Array]:
    """The value of u less its reference and −s per owned cell, and how many units of s one of u is: k/(L h_T)."""
    force = -sigma.divergence - owned_values(data.source(u))
    return owned_values(u) - laws.means, force, data.conductivities(spaces) / (spaces.length * spaces.cell_diameters)


def sizes_of_solution(spaces: Spaces, sigma: CellFlux, u: fem.Function, data: Data) -> Array:
    """The sizes G and S of gradient and flux, from σ_h and u in P0 (collective).

    With a given flux b they are those of κ∇u if these are larger.
    """
    sizes = _sizes(spaces, sigma, u, data)
    return sizes if data.b is None else np.maximum(sizes, _sizes(spaces, data.driving(sigma), u, data))


def _sizes(spaces: Spaces, sigma: CellFlux, u: fem.Function, data: Data) -> Array:
    """See `sizes_of_solution`, from σ_h or κ∇u (collective)."""
    comm = spaces.mesh.comm
    if data.kappa.number is not None:
        flux = np.sqrt(comm.allreduce(sigma.squares(1.0).sum()))
        energy, gradient = flux / np.sqrt(data.kappa.number), flux / data.kappa.number
    else:
        inverse = inverses(data.matrices(spaces))
        of_flux = np.array([sigma.squares(weight).sum() for weight in (1.0, inverse, inverse @ inverse)])
        flux, energy, gradient = np.sqrt(comm.allreduce(of_flux))
    k, measures = data.conductivities(spaces), spaces.cell_measures
    values = owned_values(u), np.full(len(k), np.abs(data.extent(spaces)).max())
    squares = np.array([[measures @ (weight * value) ** 2 for weight in (np.sqrt(k), 1.0, k)] for value in values])
    of_u, of_given = np.sqrt(comm.allreduce(squares)) / spaces.length
    if energy <= max(CONSTANT * of_u[0], ROUNDING * of_given[0]) and not _is_driven(spaces, u, data):
        return np.maximum(of_u, of_given)[1:]
    return np.array([gradient, flux])


def _is_driven(spaces: Spaces, u: fem.Function, data: Data) -> bool:
    """Whether a load makes u vary, or a u_D that varies on a body; then a tiny σ beside a huge ψ is wrong (collective).

    Where c > 0 a load cu of a constant u drives nothing, nor does cu alone, without any other load; neither does a load
    that laws in Ω carry where they are. In time neither does an earlier u that is only rounding. How exactly cu
    balances a load depends on the linear solver and the processor, as u does.
    """
    comm, source = spaces.mesh.comm, np.abs(_not_carried(spaces, u, data))
    if data.c_h is not None:
        source -= CONSTANT * np.abs(owned_values(data.c_h) * owned_values(u))
    source, f_h, flux = (
        comm.allreduce(values.max(initial=0.0), MPI.MAX)
        for values in (source, np.abs(data.f_h.x.array), np.abs(data.sigma_lift.x.array))
    )
    loaded = source > ROUNDING * f_h and not _is_at_rest(spaces, data)
    return bool(loaded or flux > 0 or data.dirichlet_varies(spaces, ROUNDING))


def _not_carried(spaces: Spaces, u: fem.Function, data: Data) -> Array:
    """The load of each owned cell less what laws in Ω take of it: what makes u vary."""
    source = owned_values(data.source(u))
    if not data.inside:
        return source
    unit = data.conductivities(spaces) / (spaces.length * spaces.cell_diameters)
    low, *off = data.inside.chains.distances(owned_values(u) - data.inside.means, -source, unit)
    return np.abs([unit * low, *off]).max(axis=0)


def _is_at_rest(spaces: Spaces, data: Data) -> bool:
    """Whether f is 0 and u was 0 in the steps before, if there are any, up to the rounding of data (collective)."""
    if data.f.number != 0:
        return False
    f_h, c_h = data.f_h.x.array, np.zeros(1) if data.c_h is None else data.c_h.x.array
    before = np.divide(np.abs(f_h), c_h, where=c_h > 0, out=np.zeros(len(f_h)))
    largest = spaces.mesh.comm.allreduce(before.max(initial=0.0), MPI.MAX)
    return bool(largest <= ROUNDING * np.abs(data.extent(spaces)).max())


def by_gradient(spaces: Spaces, data: Data) -> Array:
    """K(1 + c m_T) of each owned cell: with û fixed a lack r moves u_T by r m_T/(1 + c m_T), see `sources`."""
    k = data.conductivities(spaces)
    return k if data.c_h is None else k * (1 + owned_values(data.c_h) * mean_moments(spaces, data))


def _imbalance(spaces: Spaces, in_cells: CellFlux, sigma: fem.Function, u: fem.Function, data: Data) -> Array:
    """The square of the norm of the residual of the mass balance on this rank, as a gradient and as a flux."""
    k, n = data.conductivities(spaces), spaces.neumann_cells
    missing, taken = np.zeros(len(k)), by_gradient(spaces, data)
    if not data.inside:
        missing = spaces.cell_diameters * (in_cells.divergence + owned_values(data.source(u)))
    difference = (sigma.x.array - data.sigma_lift.x.array)[spaces.neumann_dofs]
    lacking = difference * spaces.neumann_basis_flux / spaces.neumann_measure
    squares = [
        spaces.cell_measures @ (missing / w) ** 2 + spaces.length * (spaces.neumann_measure @ (lacking / v) ** 2)
        for w, v in ((taken, k[n]), (1.0, 1.0))
    ]
    return np.array(squares)


def _stationarity(spaces: Spaces, sigma: CellFlux, u: fem.Function, p: Array, data: Data) -> Array:
    """The square of the norm of the residual of (9a) on this rank, as a gradient and as a flux (collective)."""
    kappa = data.kappa.number
    inverse = inverses(data.matrices(spaces)) if kappa is None else 1 / kappa
    trace = data.u_lift.copy()  # p on Γ_S, u_D on Γ_D, 0 on all other facets
    trace.x.array[cells_and_dofs(trace.function_space, spaces.facets)[1]] = p
    jump = owned_values(u)[:, None] - trace.x.array[cell_dofs(trace.function_space)]
    if (of_b := data.jumps(spaces)) is not None:
        jump = jump - of_b
    residual = joined(spaces, spaces.outflow * (sigma.tested(inverse) + jump))
    residual[spaces.neumann_dofs] = 0.0  # where σ·n is given there is no equation
    spaces.join_across(residual)
    size = spaces.V.dofmap.index_map.size_local
    owned, M = residual[:size], mass_diagonal(spaces, 1.0)[:size]
    W = mass_diagonal(spaces, inverse)[:size] if kappa is None else M / kappa
    return np.array([owned @ (owned / M), (owned / W) @ (M * owned / W)])
