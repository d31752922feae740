"""A continuous function near u that is admissible in the gap identity, and the average of u_h and σ_h it begins with.

How it is made admissible under the laws on Γ_S is in `conforming`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import basix
import basix.ufl
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import cell_dofs, sums_at
from signorini_fenicsx.discrete.bernstein import nodes
from signorini_fenicsx.discrete.points import FacetPoints, Points
from signorini_fenicsx.physics.diffusion.solution import Solution

if TYPE_CHECKING:
    from signorini_fenicsx.physics.diffusion.bound.law_bounds import LawTrace

type Indices = npt.NDArray[np.int32]

BEYOND = "u_D is beyond a bound of u where Γ_D meets Γ_S"
SAMPLES = 12
"""Parts of the edges of facets, for the points in which v is compared with its bounds."""
ROOM = 1.001, 2.0
"""v is moved by its sampled distance beyond a bound times the first factor, or the second if the facet touches Γ_D:
there one vertex cannot move."""


@dataclass(frozen=True)
class Trace:
    """A continuous function near u.

    Attributes:
        v: Quadratic on cells, for RT1 cubic, with the values of u_D in its nodes on Γ_D.
        on_gamma_s: Gives the admissible function, inside the domain its jump, in points of all facets of Γ_S.
        cells: Owned cells on which the admissible function may not be v: there it is u_D itself on Γ_D, and within the
            bounds on Γ_S.
        at_dirichlet: Those of these cells where u_D itself enters.
        touching: Those of these cells where data that hold u on Γ_S enter themselves.
        altered: Those of these cells where not only a bound in Ω may make a difference.
        hindrance: Why no continuous function is admissible, in words; empty if one is. The same on all ranks.
        degree: Degree of a quadrature in `cells`.
        parts: What the admissible function is made of.
        lacking: ‖κ^½∇d‖ on the owned cells, at most, for the d that slaves of pairs need besides, see
            `certificate.opposite`.
        lacked: ‖d‖ there.
    """

    v: fem.Function
    on_gamma_s: Callable[[FacetPoints], Array]
    cells: Indices
    at_dirichlet: Indices
    touching: Indices
    altered: Indices
    hindrance: str
    degree: int
    parts: "LawTrace"
    lacking: Array
    lacked: Array

    def jet(self, points: Points, *, near: bool, gradient: bool = False) -> Array:
        """The jet of the admissible function in points of `cells` (near) or of others (collective)."""
        return self.parts.jet(points, gradient=gradient) if near else points.bernstein(self.v, gradient=gradient)


def bernstein(mesh: dolfinx.mesh.Mesh, degree: int = 2) -> fem.FunctionSpace:
    """The space of continuous functions that are polynomials on each cell, by Bernstein coefficients (collective)."""
    element = basix.ufl.element("P", mesh.basix_cell(), degree, basix.LagrangeVariant.bernstein)
    return fenicsx.function_space(mesh, element)


def averaged(solution: Solution) -> fem.Function:
    """The potential of one order more, averaged over the cells around each node with weights κ_h (collective).

    The result has values in the nodes, not yet Bernstein coefficients.
    """
    mesh, degree = solution.spaces.mesh, solution.spaces.degree + 2
    v = fem.Function(bernstein(mesh, degree), name="v")
    dofs, of_cells = cell_dofs(v.function_space), solution.data.conductivities(solution.spaces)
    values = solution.cell_potential.in_nodes(nodes(mesh.basix_cell(), degree))
    index_map = v.function_space.dofmap.index_map
    v.x.array[:] = sums_at(index_map, dofs, values * of_cells[:, None]) / sums_at(index_map, dofs, of_cells[:, None])
    return v
