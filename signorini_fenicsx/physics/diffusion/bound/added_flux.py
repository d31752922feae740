"""What a given flux b adds to the gap: κ∇v + b stands for κ∇v there, and quadratics b_h near b are taken for it.

‖κ^-½(κ∇v + b − y)‖ ≤ ‖κ^-½(κ∇v + b_h − y)‖ + ‖κ^-½(b − b_h)‖ on each cell. The first term is that of y − b_h in
`mismatch`. In the second |b − b_h| of a text is enclosed, and of data in Python taken by quadrature.
"""

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.discrete.bernstein import interpolation
from signorini_fenicsx.discrete.points import cell_quadrature
from signorini_fenicsx.expressions import TREES, is_polynomial
from signorini_fenicsx.expressions.enclosures import ranges
from signorini_fenicsx.expressions.simplices import interpolated
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric
from signorini_fenicsx.physics.diffusion.bound.resolution import Resolution
from signorini_fenicsx.physics.diffusion.discrete.added_flux import DEGREE


def beside_b(resolution: Resolution, metric: CellMetric) -> Array:
    """‖κ^-½(b − b_h)‖ of each owned cell, at most; 0 without b (collective)."""
    b, volume = resolution.data.b, metric.volume
    squares = np.zeros(len(volume))
    if b is None or b.by_kappa:
        return squares
    for component in b.components:
        for tree, cells in resolution.pieces("b", component):
            assert isinstance(tree, TREES)
            if is_polynomial(tree, DEGREE):
                continue
            vertices, enough = resolution.vertices[cells], resolution.flux(metric)[cells]
            off = ranges(tree, vertices, interpolated(tree, vertices), resolution.spaces.frame, -enough, enough).sup
            unknown = ~np.isfinite(off)
            resolution.note("b", vertices[unknown].mean(axis=1), cells[unknown])
            squares[cells] += np.where(unknown, 0.0, off**2) * volume[cells]
    if any(component.pieces is None for component in b.components):
        squares = np.maximum(squares, _by_quadrature(resolution))
    squares /= metric.kappa_min
    return np.asarray(np.sqrt(squares))


def _by_quadrature(resolution: Resolution) -> Array:
    """‖b − b_h‖² of each owned cell (collective)."""
    data, mesh, b = resolution.data, resolution.spaces.mesh, resolution.data.b
    assert b is not None
    near, found = b.near(data.kappa), []
    for points in cell_quadrature(mesh, owned_cells(mesh), b.degree):
        off = b.at(points, data.kappa) - interpolation(mesh.basix_cell(), DEGREE, points.points) @ near[points.rows]
        found.append(points.integrals((off**2).sum(axis=2)))
    return np.concatenate(found)
