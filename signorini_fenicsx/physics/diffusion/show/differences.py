"""Norms of the difference of two solutions of a diffusion problem; their meshes need not match."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.parallel import passed_on
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.sampling import measure, sampled, squares_degree

if TYPE_CHECKING:  # a solution can be compared
    from signorini_fenicsx.physics.diffusion.solution import Solution


@dataclass(frozen=True)
class Differences:
    """Norms of the difference of two solutions of one problem.

    Attributes:
        sigma_V: ‖σ − σ'‖_V.
        u_Q: ‖u − u'‖_Q.
        p_Lambda: ‖p − p'‖_Λ.
        p_half: ‖p − p'‖ in a discrete H^{1/2}(Γ_S), see `slobodeckij_norm`.
        flux_Lambda: ‖σ·n − σ'·n‖_Λ.
    """

    sigma_V: float
    u_Q: float
    p_Lambda: float
    p_half: float
    flux_Lambda: float


def differences(fine: Solution, coarse: Solution) -> Differences:
    """Norms of the difference of two solutions, see `Solved.differences` (collective)."""
    source = coarse.spaces.domain
    mesh, gamma = fine.spaces.mesh, fine.spaces.Lambda.mesh
    inside, on_gamma = squares_degree(mesh), squares_degree(gamma)
    sigma, u, div_sigma = sampled([coarse.sigma, coarse.u, _divergence(coarse)], mesh, source, degree=inside)
    p, flux = sampled([coarse.p, coarse.flux_on_signorini()], gamma, source, degree=on_gamma)
    (p_middle,) = sampled([coarse.p], gamma, source, degree=0)

    dx, ds = measure(mesh, inside), measure(gamma, on_gamma)
    squares = [
        l2(fine.sigma - sigma, dx) + l2(ufl.div(fine.sigma) - div_sigma, dx),
        l2(fine.u - u, dx),
        l2(fine.p - p, ds),
        l2(fine.flux_on_signorini() - flux, ds),
    ]
    local = np.array([fem.assemble_scalar(fenicsx.form(square)) for square in squares])
    sigma_V, u_Q, p_Lambda, flux_Lambda = np.sqrt(mesh.comm.allreduce(local)).tolist()
    size = len(fine.spaces.facets)
    return Differences(
        sigma_V, u_Q, p_Lambda, slobodeckij_norm(fine, fine.p_means - p_middle.x.array[:size]), flux_Lambda
    )


def slobodeckij_norm(solution: Solution, values: Array) -> float:
    """Discrete H^{1/2}(Γ_S) norm of one value per Γ_S facet (collective; quadratic in the number of facets).

    It is the Sobolev-Slobodeckij double integral, by midpoints for each pair of different facets:
    ‖p‖² + Σ_{e≠e'} |e||e'| (p_e − p_e')² / |x_e − x_e'|^d.
    """
    spaces = solution.spaces
    dim = spaces.mesh.topology.dim
    x = dolfinx.mesh.compute_midpoints(spaces.mesh, dim - 1, spaces.facets)
    comm, columns = spaces.mesh.comm, (x.reshape(-1, 3), spaces.facet_measure, values)
    square = float(columns[1] @ values**2)
    others = columns
    for turn in range(comm.size):
        for i, (place, e, p) in enumerate(zip(*columns, strict=True)):
            x, measure, q = (rows[i + 1 :] for rows in others) if turn == 0 else others  # on this rank each pair once
            distance = np.linalg.norm(x - place, axis=1)
            square += (2 if turn == 0 else 1) * e * float(measure @ ((q - p) ** 2 / distance**dim))
        others = passed_on(comm, others)
    return math.sqrt(comm.allreduce(square))


def _divergence(solution: Solution) -> fem.Function:
    """∇·σ_h in the space of u_h."""
    Q = solution.u.function_space
    divergence = fem.Function(Q)
    divergence.interpolate(fenicsx.expression(ufl.div(solution.sigma), Q.element.interpolation_points))
    return divergence
