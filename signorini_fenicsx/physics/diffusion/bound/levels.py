"""Data with which v varies where laws hold it: the levels of `conforming`, on Γ_S, in cells and in jumps."""

from collections.abc import Iterator

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.owned import cell_dofs, sums_at
from signorini_fenicsx.contact.laws import Corners
from signorini_fenicsx.discrete.continuity import facet_nodes
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.physics.diffusion.bound.cell_springs import LawPieces
from signorini_fenicsx.physics.diffusion.bound.law_bounds import ROUNDING, level_of
from signorini_fenicsx.physics.diffusion.bound.on_gamma_s import OnGammaS
from signorini_fenicsx.physics.diffusion.bound.rays import coefficients
from signorini_fenicsx.physics.diffusion.discrete.nodes import Jumps, largest_around


def levels(
    on: OnGammaS, pieces: LawPieces | None, v: fem.Function, linear: fem.FunctionSpace
) -> list[tuple[Datum, fem.Function, fem.Function]]:
    """The data b that hold u or its jump and are no numbers, their I_hb, and the χ of each (collective)."""
    found, in_cells = [], () if pieces is None else _held_in_cells(pieces, v.function_space, linear)
    of_facets = *_held_values(on, v, linear), *_held_jumps(on, v.function_space, linear)
    for datum, interpolant, held in (*of_facets, *in_cells):
        near, quadratic = fem.Function(linear), fem.Function(v.function_space)
        near.x.array[:], quadratic.x.array[:] = held, interpolant
        found.append((datum, quadratic, near))
    return found


def _held_values(on: OnGammaS, v: fem.Function, linear: fem.FunctionSpace) -> Iterator[tuple[Datum, Array, Array]]:
    """The data b that hold u on steep segments, with I_hb and χ (collective).

    χ is 1 in vertices of Γ_S all of whose facets they hold. That of a bound is 1 in vertices of all facets where v is
    I_hb, but for those of other parts: v is b on these facets then, and large forces there cost nothing.
    """
    spaces, space = on.spaces, v.function_space
    corners, nodes = (facet_nodes(each, spaces.facets) for each in (linear, space))
    steep = on.steep[np.arange(len(on.segment)), on.segment]
    for part in on.goal.parts:
        rows = np.intersect1d(part.rows, spaces.outer_rows)
        for first, last in _runs(on.steep[rows], spaces.mesh.comm):
            datum = level_of(part, first, last)
            if datum is not None and datum.number is None:
                interpolant = coefficients(datum, space)
                held = steep & (first <= on.segment) & (on.segment <= last)
                bounds = any(datum is bound for bound in part.bounds)
                if bounds:
                    apart = np.abs(v.x.array - interpolant) > ROUNDING * np.abs(interpolant).max(initial=0.0)
                    held = ~apart[nodes].any(axis=1)
                inside, outside = np.zeros(len(steep)), np.ones(len(steep))
                inside[rows], outside[rows] = held[rows], 0.0 if bounds else ~held[rows]
                touched, left = (largest_around(linear, corners, where) for where in (inside, outside))
                yield datum, interpolant, np.where(left > 0, 0.0, touched)


def _held_in_cells(
    pieces: LawPieces, space: fem.FunctionSpace, linear: fem.FunctionSpace
) -> Iterator[tuple[Datum, Array, Array]]:
    """The data b that hold u on rigid segments of laws in Ω, with I_hb and χ (collective).

    χ is 1 in vertices of the cells that they hold, where no other ones hold a cell: elsewhere b − I_hb costs little.
    """
    inside, held = pieces.inside, []
    several = np.zeros(len(inside.s), dtype=np.int64)
    for part in inside.parts:
        several[part.rows] += 1
    for part in inside.parts:
        if isinstance(part.law, Corners) and not part.law.has_numbers:
            continue  # quotients, which no quadrature integrates
        rows = part.rows[several[part.rows] == 1]
        for first, last in _runs(pieces.rigid[rows], space.mesh.comm):
            on_them = pieces.held[rows] & (first <= inside.segment[rows]) & (inside.segment[rows] <= last)
            vertices = cell_dofs(linear)[rows[on_them]]
            held.append((level_of(part, first, last), sums_at(linear.dofmap.index_map, vertices) > 0))
    once = np.sum([near for _, near in held], axis=0) == 1
    for datum, near in held:
        if datum is not None and datum.number is None:
            yield datum, coefficients(datum, space), np.where(once & near, 1.0, 0.0)


def _runs(steep: Mask, comm: MPI.Comm) -> Iterator[tuple[int, int]]:
    """The first and the last of all segments in a row that are steep on some facet (collective)."""
    column = np.zeros(steep.shape[1] + 2, dtype=np.int64)
    column[1:-1] = comm.allreduce(steep.sum(axis=0)) > 0
    begins, ends = (np.flatnonzero(np.diff(column) == step) for step in (1, -1))
    yield from zip(begins.tolist(), (ends - 1).tolist(), strict=True)


def _held_jumps(
    on: OnGammaS, space: fem.FunctionSpace, linear: fem.FunctionSpace
) -> Iterator[tuple[Datum, Array, Array]]:
    """The only bounds b of jumps inside the domain, with I_hb; χ is 1 in all nodes with a jump (collective)."""
    jumps = Jumps.of(linear, on.spaces)
    for part in on.goal.parts if jumps.basis is not None else ():
        bounds = [bound for bound in part.bounds if bound is not None]
        if len(bounds) == 1 and bounds[0].number is None:
            rows = np.intersect1d(part.rows, on.spaces.inner.rows)
            is_held = largest_around(linear, facet_nodes(linear, on.spaces.facets[rows]), np.ones(len(rows)))
            interpolant = coefficients(bounds[0], space)
            yield bounds[0], interpolant, np.where((is_held > 0) & jumps.jump, 1.0, 0.0)
