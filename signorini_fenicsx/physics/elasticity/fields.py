"""The fields of an elastic solution for ParaView."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.physics.elasticity.data import ElasticData, blocks_of_cells
from signorini_fenicsx.physics.elasticity.residuals import imbalance
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces

if TYPE_CHECKING:  # a solution has these fields
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution


def fields_of(solution: ElasticSolution) -> Iterator[tuple[str, list[fem.Function]]]:
    """The functions of each file, see `Solved.fields`; `solution.bp` is on the mesh of the subcells."""
    series = StressSeries(solution.spaces, solution.data)
    series.take(solution.in_cells())
    yield "solution.bp", series.exact
    values = {"pressure": solution.pressure, "gap": solution.linear_gap, "contact": solution.touching}
    if solution.data.friction is not None:
        values |= dict(zip(("shear", "slip", "friction"), solution.on_all_contact(), strict=True))
    yield "contact.bp", [solution.on_contact(each, name) for name, each in values.items()]
    left = imbalance(solution.spaces, solution.data, solution.stresses)
    equilibrium = fem.Function(solution.spaces.Q, name="equilibrium")
    equilibrium.x.array[:] = np.linalg.norm(left, axis=2).max(axis=1)
    yield "solution.xdmf", [*series.means, equilibrium]


class StressSeries:
    """σ_h, u_h and the von Mises stress, at one time or after each step, see `Series`; `exact` is on the subcells."""

    names = ("u", "sigma")

    def __init__(self, spaces: ElasticSpaces, data: ElasticData):
        """Make the functions (collective)."""
        self._spaces, self._data = spaces, data
        dim = spaces.dim
        self.exact = [
            fem.Function(fenicsx.function_space(spaces.split.mesh, ("DG", 1, shape)), name=name)
            for name, shape in (("sigma", (3, 3)), ("u", (dim,)), ("von_mises", ()))
        ]
        self.means = [
            fem.Function(fenicsx.function_space(spaces.mesh, ("DG", 0, shape)), name=name)
            for name, shape in (("u", (dim,)), ("sigma", (3, 3)), ("von_mises", ()))
        ]

    def take(self, values: Mapping[str, Array]) -> None:
        """Set all functions, see `Series.take`."""
        spaces, dim = self._spaces, self._spaces.dim
        stresses, at_vertices = in_space(spaces, self._data, values["sigma"]), values["u"]
        corners = np.array([[k for k in range(dim + 1) if k != i] for i in range(dim + 1)])
        centroids = np.broadcast_to(at_vertices.mean(axis=1)[:, None, None], (len(at_vertices), dim + 1, 1, dim))
        linear = {
            "sigma": stresses,  # VTX takes no others than matrices in space
            "u": np.concatenate([at_vertices[:, corners], centroids], axis=2),
            "von_mises": von_mises(stresses),
        }
        for function in self.exact:
            spaces.split.set_values(function, linear[function.name])
        mean = stresses.mean(axis=(1, 2))
        means = {"u": at_vertices.mean(axis=1), "sigma": mean, "von_mises": von_mises(mean)}
        for function in self.means:
            function.x.array[:] = means[function.name].ravel()  # no ghost cells, a value per cell in their order


def in_space(spaces: ElasticSpaces, data: ElasticData, stresses: Array) -> Array:
    """The stress at the vertices of the subcells as a matrix in space, shape (cells, d + 1, d + 1, 3, 3).

    In plane strain σ_zz = ν tr σ, with the mean of ν over the cell.
    """
    missing = 3 - spaces.dim
    found = np.pad(stresses, (*[(0, 0)] * 3, (0, missing), (0, missing)))
    if missing and not data.in_space:
        for cells in blocks_of_cells(spaces):
            poisson = data.poisson.values(data.points(spaces, cells)).mean(axis=1)
            found[cells, :, :, 2, 2] = poisson[:, None, None] * np.einsum("nsaii->nsa", stresses[cells])
    return found


def von_mises(stresses: Array) -> Array:
    """Equivalent stress of matrices in space, shape (…, 3, 3)."""
    deviator = stresses - np.einsum("...ii->...", stresses)[..., None, None] / 3 * np.eye(3)
    found: Array = np.sqrt(1.5 * (deviator**2).sum(axis=(-1, -2)))
    return found
