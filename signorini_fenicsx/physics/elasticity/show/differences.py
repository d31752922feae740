"""Norms of the difference of two elastic solutions; their meshes need not match."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.forms.elasticity import product
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.sampling import measure, sampled, squares_degree
from signorini_fenicsx.physics.elasticity.discrete.data import material_on_split

if TYPE_CHECKING:  # a solution can be compared
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution


@dataclass(frozen=True)
class ElasticDifferences:
    """Norms of the difference of two elastic solutions of one problem.

    Attributes:
        energy: ‖σ − σ'‖ in the energy norm.
        u_L2: ‖u − u'‖.
        pressure_L2: ‖σ_nn − σ'_nn‖ on Γ_C.
        gap_L2: The same of the gap g − u_n.
    """

    energy: float
    u_L2: float
    pressure_L2: float
    gap_L2: float


def differences(fine: ElasticSolution, coarse: ElasticSolution) -> ElasticDifferences:
    """Norms of the difference of two solutions, see `Solved.differences` (collective)."""
    spaces, source = fine.spaces, coarse.spaces.domain
    gamma = spaces.Lambda.mesh
    on_subcells = max(fine.data.quadrature.degree, squares_degree(spaces.split.mesh))
    inside, on_gamma = squares_degree(spaces.mesh), squares_degree(gamma)
    material = material_on_split(spaces, fine.data, spaces.split, on_subcells)

    (sigma,) = sampled([coarse.sigma], spaces.split.mesh, source, degree=on_subcells)
    (u,) = sampled([coarse.u], spaces.mesh, source, degree=inside)
    on_contact = [coarse.spaces.linear_multiplier(values) for values in (coarse.pressure, coarse.linear_gap)]
    pressure, gap = sampled(on_contact, gamma, source, degree=on_gamma)
    ds = measure(gamma, on_gamma)
    off = fine.sigma - sigma
    squares = [
        product(material.compliance, off, off, material.dx),
        l2(fine.u - u, measure(spaces.mesh, inside)),
        l2(fine.spaces.linear_multiplier(fine.pressure) - pressure, ds),
        l2(fine.spaces.linear_multiplier(fine.linear_gap) - gap, ds),
    ]
    local = np.array([fem.assemble_scalar(fenicsx.form(square)) for square in squares])
    return ElasticDifferences(*np.sqrt(spaces.mesh.comm.allreduce(local)).tolist())
