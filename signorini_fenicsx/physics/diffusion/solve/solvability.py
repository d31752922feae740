"""Whether there is one solution where components of the domain have no Γ_D.

Let r be constant on each component and 0 on those where u = u_D or c > 0 somewhere. The energy grows along every r ≠ 0,
so that there is a solution, which is unique but for what is flat, if

    ∫ f r + ∫ g_N r  <  Σ_sites |e| (sup σ·n [r]_-  −  inf σ·n [r]_+)

with the supremum and the infimum over the graph of the site, and with the jump of r inside the domain. The right side
is a sum of functions of differences of two values of r, convex and linear on both sides of 0. So it is enough to look
at the r that are 1, or −1, on some components and 0 on the others: for each union U of components 0 has to be strictly
between the least and the largest ∫_U f + ∫ g_N + ∫_∂U σ·n. A linear programme finds one for which it is not.
"""

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import owned_values
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.contact.floating import Floating
from signorini_fenicsx.contact.laws import Seepage
from signorini_fenicsx.discrete.bodies import opposite_bodies, without
from signorini_fenicsx.discrete.mesh_spaces import cells_and_dofs
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

OF_WATER = ", such as what is under water: a seepage face lets water only out"
"""What is said besides of groundwater."""
ROUNDING = 1e-12
"""Share of the loads that is rounding in their sum."""


def floating_cells(spaces: Spaces, data: Data) -> tuple[Indices, int]:
    """The component of each owned cell among those without Γ_D and without a term cu, and their number (collective)."""
    if not spaces.several or (data.holds(spaces) and spaces.held):
        alone = 0 if data.holds(spaces) else 1
        return np.full(len(spaces.cell_measures), alone), alone
    reacting = None if data.c_h is None else owned_values(data.c_h) > 0
    return without(spaces, spaces.dirichlet_facets, reacting)


def floating_sites(spaces: Spaces, data: Data) -> Floating | None:
    """How the facets of Γ_S, and the cells with laws in Ω, hold such components; None without any (collective)."""
    of_cell, number = floating_cells(spaces, data)
    if number == 0:
        return None
    return Floating(number, *_sides(spaces, data, of_cell))


def _sides(spaces: Spaces, data: Data, of_cell: Indices) -> tuple[Indices, Indices, Array]:
    """The component behind each site, that on its other side, 0 on the boundary and of cells, and its measure."""
    named, across = of_cell[spaces.cells], np.zeros(len(spaces.facets), dtype=np.int64)
    space = spaces.crouzeix_raviart
    across[spaces.inner.rows] = of_cell[cells_and_dofs(space, spaces.inner.facets)[0]]
    for pair in spaces.pairs:
        if not pair.parts.tied:
            across[spaces.rows_of(pair)] = opposite_bodies(spaces, pair, of_cell)
    facet, cell = (math.prod(kind.shape) for kind in spaces.site_kinds)
    named, across = np.repeat(named, facet), np.repeat(across, facet)
    if data.inside:
        of_cells = np.repeat(of_cell, cell)
        named, across = np.append(named, of_cells), np.append(across, np.zeros_like(of_cells))
    return named, across, spaces.site_kinds.measure[: len(named)]


def check_solvability(spaces: Spaces, data: Data) -> None:
    """Check that there is one solution; where a component has no Γ_D and no term cu, its loads decide (collective).

    Raises:
        InputError: If there is no solution, or more than one.
    """
    of_cell, number = floating_cells(spaces, data)
    lowest, highest = data.total_load
    if not spaces.has_dirichlet and data.c_h is None and not lowest < 0 < highest:
        _refuse_all(data)
    if number == 0 or not spaces.several:
        return
    loads, sizes, pairs, low, high = _balance(spaces, data, of_cell, number)
    comm = spaces.mesh.comm
    union = on_root(comm, partial(_worst, loads, sizes, pairs, low, high))
    if union is None:
        return
    side = np.append(False, union).astype(np.int64)[pairs]
    outward = side[:, 0] - side[:, 1]
    ends = np.array([np.where(outward > 0, low, -high), np.where(outward > 0, high, -low)])[:, outward != 0]
    lowest, highest = loads[union].sum() + ends.sum(axis=1)
    some = of_cell == 1 + int(np.argmax(union))
    weights = spaces.cell_measures[some]
    centroids = spaces.mesh.geometry.x[spaces.nodes[some]].mean(axis=1)
    *place, volume = comm.allreduce(np.append(weights @ centroids, weights.sum()))
    around = ", ".join(f"{x / volume:.3g}" for x in place[: spaces.mesh.geometry.dim])
    which = f"the component of the domain around ({around}) has"
    if union.sum() > 1:
        which = f"{union.sum()} components of the domain, one of them around ({around}), have together"
    raise InputError(
        f"{which} no part where u = u_D, and ∫f + ∫g_N plus the flux that the laws allow there is between {lowest:.3g} "
        f"and {highest:.3g}: there is no solution, or u is not unique; 0 must be in between"
    )


def _refuse_all(data: Data) -> None:
    """Refuse a load of the whole domain that nothing balances."""
    lowest, highest = data.total_load
    verdict = "u is not unique" if 0 in data.total_load else "there is no solution"
    if data.laws.listed:
        raise InputError(
            "no part of the boundary is left for u = u_D, and ∫f + ∫g_N plus the flux that the laws allow is between "
            f"{lowest:.3g} and {highest:.3g}: {verdict}; 0 must be in between, or leave part of the boundary to Γ_D"
            f"{OF_WATER if any(isinstance(part.law, Seepage) for part in data.laws.of_parts) else ''}"
        )
    raise InputError(
        "no part of the boundary is left for u = u_D, and the total load ∫f + ∫g_N + ∫q_S is "
        f"{lowest:.3g}: {verdict}; make it negative, or leave part of the boundary to Γ_D"
    )


def _balance(spaces: Spaces, data: Data, of_cell: Indices, number: int) -> tuple[Array, Array, Indices, Array, Array]:
    """Loads of the components and their sizes; pairs of components with the fluxes that sites allow (collective)."""
    comm = spaces.mesh.comm
    loads, sizes = np.zeros(number + 1), np.zeros(number + 1)
    fluxes = data.sigma_lift.x.array[spaces.neumann_dofs] * spaces.neumann_basis_flux
    behind = of_cell[cells_and_dofs(spaces.crouzeix_raviart, spaces.neumann_facets)[0]]
    for of, load in ((of_cell, spaces.cell_measures * owned_values(data.f_h)), (behind, fluxes)):
        loads += np.bincount(of, load, number + 1)
        sizes += np.bincount(of, np.abs(load), number + 1)
    named, across, measure = _sides(spaces, data, of_cell)
    link, size = named * (number + 1) + across, (number + 1) ** 2
    reference = np.pad(data.q_Sh, (0, len(named) - len(data.q_Sh)))
    low, high = (np.bincount(link, measure * (reference + flux), size) for flux in data.chains.extent()[2:])
    links = np.bincount(link, minlength=size).astype(np.float64)
    loads, sizes, low, high, links = (comm.allreduce(each) for each in (loads, sizes, low, high, links))
    pairs = np.flatnonzero((links > 0) | np.isinf(high))
    places = np.column_stack(np.divmod(pairs, number + 1))
    apart = places[:, 0] != places[:, 1]
    return loads[1:], sizes[1:], places[apart], low[pairs][apart], high[pairs][apart]


def _worst(loads: Array, sizes: Array, pairs: Indices, low: Array, high: Array) -> Array | None:
    """The components of a union whose loads are not balanced strictly; None if there is none."""
    from scipy.optimize import linprog  # takes a second to load

    number, count = len(loads), len(pairs)
    jump = np.zeros((count, number + 1))
    np.add.at(jump, (np.arange(count), pairs[:, 0]), 1.0)
    np.add.at(jump, (np.arange(count), pairs[:, 1]), -1.0)
    equal = np.hstack([jump[:, 1:], -np.eye(count), np.eye(count)])  # r⁺ − r⁻ = a − b with a, b ≥ 0
    finite = [np.where(np.isfinite(end), end, 0.0) for end in (low, high)]
    cost = np.concatenate([-loads, -finite[0], finite[1]])
    most = np.where(np.isfinite(np.concatenate([low, high])), np.inf, 0.0)
    enough = ROUNDING * max(sizes.sum(), np.abs(finite).sum())
    for fixed, sign in _ends(number):
        bounds = [(-1.0, 1.0)] * number + [(0.0, end) for end in most]
        bounds[fixed] = sign, sign
        optimum = linprog(cost, A_eq=equal, b_eq=np.zeros(count), bounds=bounds)
        if optimum.success and optimum.fun <= enough:
            return np.asarray(sign * optimum.x[:number] > 0.5)
    return None


def _ends(number: int) -> Iterator[tuple[int, float]]:
    for fixed in range(number):
        yield from ((fixed, 1.0), (fixed, -1.0))
