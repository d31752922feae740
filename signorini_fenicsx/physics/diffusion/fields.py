"""The fields of a solution of a diffusion problem for ParaView."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.cell_shapes import arms, some_at_a_time
from signorini_fenicsx.physics.diffusion.spaces import Spaces

if TYPE_CHECKING:  # a solution has these fields
    from signorini_fenicsx.physics.diffusion.solution import Solution


def fields_of(solution: Solution) -> Iterator[tuple[str, list[fem.Function]]]:
    """The functions of each file, see `Solved.fields`; `solution.bp` has DG1, in which u_h and σ_h are exact."""
    spaces, on_obstacle = solution.spaces, _on_obstacle(solution)
    yield "solution.bp", _linear(solution, on_obstacle)
    if spaces.part_names:
        flux = spaces.multiplier(spaces.normal_flux(solution.sigma), "flux")
        condition = spaces.multiplier(solution.outcome.conditions.kind, "condition")
        segments = []
        if solution.data.laws.listed:
            segments = [spaces.multiplier(solution.data.laws.labels(solution.segments().segment), "segment")]
        yield "multiplier.bp", [solution.p, flux, condition, *segments]
    centroid = solution.cell_flux.centroid
    sigma = fem.Function(fenicsx.function_space(spaces.mesh, ("DG", 0, centroid.shape[1:])), name="sigma")
    sigma.x.array[:] = centroid.ravel()  # no ghost cells
    magnitude = fem.Function(spaces.Q, name="sigma_norm")
    magnitude.x.array[:] = np.linalg.norm(centroid, axis=1)
    yield "solution.xdmf", [solution.u, sigma, magnitude, *on_obstacle]


def _linear(solution: Solution, on_obstacle: list[fem.Function]) -> list[fem.Function]:
    """σ_h, u_h, |σ_h| and what there is on the obstacle, in DG1 (collective)."""
    mesh, dim = solution.spaces.mesh, solution.spaces.mesh.geometry.dim
    linear = fenicsx.function_space(mesh, ("DG", 1))
    sigma = fem.Function(fenicsx.function_space(mesh, ("DG", 1, (dim,))), name="sigma")
    u, magnitude = fem.Function(linear, name="u"), fem.Function(linear, name="sigma_norm")
    nodes, vectors = linear.dofmap.list, sigma.x.array.reshape(-1, dim)
    for some in some_at_a_time(mesh):
        values = solution.cell_flux.in_vertices(some)
        vectors[nodes[some]] = values
        magnitude.x.array[nodes[some]] = np.sqrt(np.einsum("cvi,cvi->cv", values, values))
        u.x.array[nodes[some]] = solution.u.x.array[some, None]
    larger = [fem.Function(linear, name=function.name) for function in on_obstacle]
    for function, constant in zip(larger, on_obstacle, strict=True):
        function.interpolate(constant)
    return [sigma, u, magnitude, *larger]


def _on_obstacle(solution: Solution) -> list[fem.Function]:
    """1 in the cells in contact with the obstacle, and its force, in P0; none without one (collective)."""
    inside = solution.outcome.iterate.contact
    if inside is None:
        return []
    contact = fem.Function(solution.spaces.Q, name="contact")
    contact.x.array[:] = inside
    return [contact, solution.force()]


class FluxSeries:
    """u_h and σ_h over time, see `Series`."""

    names = ("u", "sigma", "divergence")

    def __init__(self, spaces: Spaces):
        """Make the functions (collective)."""
        mesh, dim = spaces.mesh, spaces.mesh.geometry.dim
        self._arms, self._dim = arms(mesh), dim
        shapes = {"sigma": ((dim,),), "u": ()}
        self.exact, self.means = (
            [
                fem.Function(fenicsx.function_space(mesh, ("DG", degree, *shape)), name=name)
                for name, shape in shapes.items()
            ]
            for degree in (1, 0)
        )

    def take(self, values: Mapping[str, Array]) -> None:
        """Set all functions, see `Series.take`."""
        sigma, u = self.exact
        u.x.array[u.function_space.dofmap.list] = values["u"].reshape(-1, 1)
        slope = values["divergence"].reshape(-1, 1, 1) / self._dim
        linear = values["sigma"][:, None] + slope * self._arms
        sigma.x.array.reshape(-1, self._dim)[sigma.function_space.dofmap.list] = linear
        for mean in self.means:
            mean.x.array[:] = values[mean.name].ravel()  # no ghost cells, one value per cell in their order
