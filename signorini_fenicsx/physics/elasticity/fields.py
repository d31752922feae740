"""The fields of an elastic solution for ParaView."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.physics.elasticity.data import blocks_of_cells
from signorini_fenicsx.physics.elasticity.residuals import imbalance

if TYPE_CHECKING:  # a solution has these fields
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution


def fields_of(solution: ElasticSolution) -> Iterator[tuple[str, list[fem.Function]]]:
    """The functions of each file, see `Solved.fields`; `solution.bp` is on the mesh of the subcells."""
    spaces, split, dim = solution.spaces, solution.spaces.split, solution.spaces.dim
    stresses = in_space(solution)  # VTX takes no others
    at_vertices = spaces.displacement_values(solution.u)
    corners = np.array([[k for k in range(dim + 1) if k != i] for i in range(dim + 1)])
    centroids = np.broadcast_to(at_vertices.mean(axis=1)[:, None, None], (len(at_vertices), dim + 1, 1, dim))
    in_subcells = np.concatenate([at_vertices[:, corners], centroids], axis=2)
    linear = {"sigma": stresses, "u": in_subcells, "von_mises": von_mises(stresses)}
    yield (
        "solution.bp",
        [
            split.function(fenicsx.function_space(split.mesh, ("DG", 1, values.shape[3:])), values, name)
            for name, values in linear.items()
        ],
    )
    values = {"pressure": solution.pressure, "gap": solution.linear_gap, "contact": solution.touching}
    if solution.data.friction is not None:
        values |= dict(zip(("shear", "slip", "friction"), solution.on_all_contact(), strict=True))
    yield "contact.bp", [solution.on_contact(each, name) for name, each in values.items()]
    means = {
        "u": at_vertices.mean(axis=1),
        "sigma": stresses.mean(axis=(1, 2)),
        "von_mises": von_mises(stresses.mean(axis=(1, 2))),
        "equilibrium": np.linalg.norm(imbalance(spaces, solution.data, solution.stresses), axis=2).max(axis=1),
    }
    functions = []
    for name, each in means.items():
        functions.append(fem.Function(fenicsx.function_space(spaces.mesh, ("DG", 0, each.shape[1:])), name=name))
        functions[-1].x.array[:] = each.ravel()  # no ghost cells, and a degree of freedom per cell in their order
    yield "solution.xdmf", functions


def in_space(solution: ElasticSolution) -> Array:
    """The stress at the vertices of the subcells as a matrix in space, shape (cells, d + 1, d + 1, 3, 3).

    In plane strain σ_zz = ν tr σ, with the mean of ν over the cell.
    """
    spaces, data = solution.spaces, solution.data
    missing = 3 - spaces.dim
    found = np.pad(solution.stresses, (*[(0, 0)] * 3, (0, missing), (0, missing)))
    if missing and not data.in_space:
        for cells in blocks_of_cells(spaces):
            poisson = data.poisson.values(data.points(spaces, cells)).mean(axis=1)
            found[cells, :, :, 2, 2] = poisson[:, None, None] * np.einsum("nsaii->nsa", solution.stresses[cells])
    return found


def von_mises(stresses: Array) -> Array:
    """Equivalent stress of matrices in space, shape (…, 3, 3)."""
    deviator = stresses - np.einsum("...ii->...", stresses)[..., None, None] / 3 * np.eye(3)
    found: Array = np.sqrt(1.5 * (deviator**2).sum(axis=(-1, -2)))
    return found
