"""Norms of the difference of two solutions of one problem; their meshes need not match."""

import math
from dataclasses import dataclass
from typing import overload

import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import passed_on
from signorini_fenicsx.cases.solving import AnySolution
from signorini_fenicsx.certificate.best_displacement import moduli_on_split
from signorini_fenicsx.forms.elasticity import stress_product
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.sampling import sampled, squares_degree
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution


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


@overload
def differences(coarse: Solution, fine: Solution) -> Differences: ...


@overload
def differences(coarse: AnySolution, fine: AnySolution) -> Differences | ElasticDifferences: ...


def differences(coarse: AnySolution, fine: AnySolution) -> Differences | ElasticDifferences:
    """Norms of the difference of two solutions, by quadrature on the mesh of the second (collective).

    The coarse fields are evaluated at the quadrature points. Near a curved boundary a point may be outside the coarse
    mesh; then the nearest coarse cell is used.

    Raises:
        InputError: If one of them is elastic and the other is not.
    """
    if isinstance(coarse, Solution) and isinstance(fine, Solution):
        return _scalar_differences(coarse, fine)
    if isinstance(coarse, ElasticSolution) and isinstance(fine, ElasticSolution):
        return _elastic_differences(coarse, fine)
    raise InputError(f"{coarse.name} and {fine.name} are of different physics; only solutions of one can be compared")


def _scalar_differences(coarse: Solution, fine: Solution) -> Differences:
    source = coarse.spaces.domain
    mesh, gamma = fine.spaces.mesh, fine.spaces.Lambda.mesh
    inside, on_gamma = squares_degree(mesh), squares_degree(gamma)
    sigma, u, div_sigma = sampled([coarse.sigma, coarse.u, _divergence(coarse)], mesh, source, degree=inside)
    flux_n = coarse.spaces.multiplier(coarse.spaces.normal_flux(coarse.sigma))
    p, flux = sampled([coarse.p, flux_n], gamma, source, degree=on_gamma)
    (p_middle,) = sampled([coarse.p], gamma, source, degree=0)

    dx, ds = measure(mesh, inside), measure(gamma, on_gamma)
    squares = [
        l2(fine.sigma - sigma, dx) + l2(ufl.div(fine.sigma) - div_sigma, dx),
        l2(fine.u - u, dx),
        l2(fine.p - p, ds),
        l2(fine.spaces.multiplier(fine.spaces.normal_flux(fine.sigma)) - flux, ds),
    ]
    local = np.array([fem.assemble_scalar(fenicsx.form(square)) for square in squares])
    sigma_V, u_Q, p_Lambda, flux_Lambda = np.sqrt(mesh.comm.allreduce(local)).tolist()
    size = len(fine.spaces.facets)
    return Differences(
        sigma_V, u_Q, p_Lambda, slobodeckij_norm(fine, fine.p.x.array[:size] - p_middle.x.array[:size]), flux_Lambda
    )


def _elastic_differences(coarse: ElasticSolution, fine: ElasticSolution) -> ElasticDifferences:
    spaces, source = fine.spaces, coarse.spaces.domain
    gamma = spaces.Lambda.mesh
    on_subcells = max(fine.data.quadrature.degree, squares_degree(spaces.split.mesh))
    inside, on_gamma = squares_degree(spaces.mesh), squares_degree(gamma)
    moduli, dx = moduli_on_split(spaces, fine.data, spaces.split, on_subcells)

    (sigma,) = sampled([coarse.sigma], spaces.split.mesh, source, degree=on_subcells)
    (u,) = sampled([coarse.u], spaces.mesh, source, degree=inside)
    on_contact = [coarse.on_contact(values) for values in (coarse.pressure, coarse.linear_gap)]
    pressure, gap = sampled(on_contact, gamma, source, degree=on_gamma)
    ds = measure(gamma, on_gamma)
    off = fine.sigma - sigma
    squares = [
        stress_product(off, off, *moduli, dx),
        l2(fine.u - u, measure(spaces.mesh, inside)),
        l2(fine.on_contact(fine.pressure) - pressure, ds),
        l2(fine.on_contact(fine.linear_gap) - gap, ds),
    ]
    local = np.array([fem.assemble_scalar(fenicsx.form(square)) for square in squares])
    return ElasticDifferences(*np.sqrt(spaces.mesh.comm.allreduce(local)).tolist())


def measure(mesh: dolfinx.mesh.Mesh, degree: int) -> ufl.Measure:
    """The measure of a mesh, by quadrature of a degree."""
    return ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": degree, "quadrature_scheme": "default"})


def slobodeckij_norm(solution: Solution, values: Array) -> float:
    """Discrete H^{1/2}(Γ_S) norm of one value per Γ_S facet (collective; quadratic in the number of facets).

    It is the Sobolev-Slobodeckij double integral, by midpoints for each pair of different facets:
    ‖p‖² + Σ_{e≠e'} |e||e'| (p_e − p_e')² / |x_e − x_e'|^d.
    """
    spaces = solution.spaces
    dim = spaces.mesh.topology.dim
    x = dolfinx.mesh.compute_midpoints(spaces.mesh, dim - 1, spaces.facets)
    comm, mine = spaces.mesh.comm, (x.reshape(-1, 3), spaces.facet_measure, values)
    square = float(mine[1] @ values**2)
    others = mine
    for turn in range(comm.size):
        for i, (place, e, p) in enumerate(zip(*mine, strict=True)):
            x, measure, q = (rows[i + 1 :] for rows in others) if turn == 0 else others  # on this rank each pair once
            distance = np.linalg.norm(x - place, axis=1)
            square += (2 if turn == 0 else 1) * e * float(measure @ ((q - p) ** 2 / distance**dim))
        others = passed_on(comm, others)
    return math.sqrt(comm.allreduce(square))


def _divergence(solution: Solution) -> fem.Function:
    """∇·σ_h in P0."""
    Q = solution.spaces.Q
    divergence = fem.Function(Q)
    divergence.interpolate(fenicsx.expression(ufl.div(solution.sigma), Q.element.interpolation_points))
    return divergence
