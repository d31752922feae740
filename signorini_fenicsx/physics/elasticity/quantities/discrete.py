"""Quantities of a discrete solution itself, beside which their intervals stand: of u_h."""

from __future__ import annotations

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.points import Points, facet_quadrature
from signorini_fenicsx.meshes.domain import other_side
from signorini_fenicsx.physics.elasticity.quantities.motions import direction_of
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.quantities.discrete import mean_of, where
from signorini_fenicsx.quantities.kinds import Integral


def of_displacement(solution: ElasticSolution, kind: Integral, weight: Datum) -> float:
    """The integral of weight·u_h·direction, on parts without one of weight·u_h·n, or its mean (collective).

    Where two bodies touch it is that of the jump.
    """
    spaces, sums, inner = solution.spaces, np.zeros(2), solution.boundary.inner
    dim, along = spaces.dim, kind.direction
    nodes, of_cells = solution.u.x.array.reshape(-1, dim), solution.u.function_space.dofmap.list

    def add(points: Points, ways: Array, share: float) -> None:
        u = np.einsum("npv,nvi,ni->np", points.barycentric, nodes[of_cells[points.cells]], ways)
        values = weight.values(points)
        sums[:] += points.integrals(values * u).sum(), share * points.integrals(values).sum()

    for points in where(spaces, kind, weight) if not kind.parts else ():
        add(points, np.tile(direction_of(along, dim), (len(points.cells), 1)), 1.0)
    for part in (*kind.parts, *(other_side(part) for part in kind.parts if part in inner)):
        facets, named = spaces.part(part), part in kind.parts
        ways = facets.normals  # n has the sign of its side by itself
        if along is not None:
            ways = np.tile(direction_of(along, dim), (len(ways), 1)) * (1.0 if named else -1.0)
        add(facet_quadrature(spaces.mesh, facets.facets, quadrature_degree(weight)), ways, float(named))
    return mean_of(kind, spaces.mesh.comm.allreduce(sums))
