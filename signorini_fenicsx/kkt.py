"""How well a solution satisfies the discrete Signorini problem, free of scale."""

from dataclasses import dataclass, fields

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.fem.petsc import assemble_matrix

from forms.mixed import multiplier_residual, trace_term
from forms.norms import l2
from signorini_fenicsx.algorithms import Penalty
from signorini_fenicsx.data import Data, mean_conductivity
from signorini_fenicsx.spaces import Spaces

TOLERANCE = 1e-8
"""A solution with a larger residual is not one."""
CONSTANT_PART = 1e-2
"""How small ∇u must be, beside u, for the scale of a residual to be that of u."""


@dataclass(frozen=True)
class KKTResiduals:
    """Residuals of (MLM-I)_h and (MLM-II)_h, with p and σ·n standing for p − ψ and σ·n − q_S.

    L = |Ω|^(1/d) is a length, G = max(‖κ_h⁻¹σ‖, 1e-2 ‖u‖/L) a gradient and S = max(‖σ‖, 1e-2 k‖u‖/L) a flux, with k the
    mean of κ_h; all residuals are 0 if S = 0. The second terms matter for a constant u ≠ 0 only, whose σ is rounding.

    A penalty formulation is the same system with p replaced by p + εσ·n (I) or σ·n by σ·n + εp (II), and that is what
    its primal and dual residuals and its complementarity refer to.

    Attributes:
        primal: ‖[p]_-‖_Λ / (√L G), the violation of p ≥ 0.
        dual: √L ‖[σ·n]_-‖_Λ / S, the violation of σ·n ≥ 0.
        complementarity: Σ_e |e| |p σ·n| / (G S).
        stationarity: √(rᵀ diag(M)⁻¹ r) / G with r the residual of (9a) and M the mass matrix of RT0.
        mass_balance: ‖h_T (∇·σ + f_h)‖ / S, (9b) cell by cell, and √L ‖σ·n − g_N‖ / S on Γ_N.
    """

    primal: float
    dual: float
    complementarity: float
    stationarity: float
    mass_balance: float

    def violation(self) -> str | None:
        """The residuals above the tolerance in words, or None."""
        bad = [
            f"{field.name} {value:.1e}"
            for field in fields(self)
            if not (value := getattr(self, field.name)) <= TOLERANCE
        ]
        return f"KKT residuals above {TOLERANCE:g}: {', '.join(bad)}" if bad else None


def kkt_residuals(
    spaces: Spaces,
    sigma: fem.Function,
    u: fem.Function,
    p: fem.Function,
    data: Data,
    penalty: Penalty | None = None,
    eps: float = 0.0,
) -> KKTResiduals:
    """Residuals of a discrete solution, from its fields alone and not from what a backend says (collective)."""
    comm = spaces.mesh.comm
    length = spaces.length()
    gradient, size = _scales(spaces, sigma, u, data)
    if size == 0:
        return KKTResiduals(0.0, 0.0, 0.0, 0.0, 0.0)

    e = spaces.facet_measure
    trace, flux = p.x.array[: len(e)] - data.psi_h, spaces.normal_flux(sigma) - data.q_Sh
    if penalty is not None:
        trace, flux = penalty.shift(trace, flux, eps)
    primal, dual, complementarity = comm.allreduce(
        np.array([e @ np.minimum(trace, 0) ** 2, e @ np.minimum(flux, 0) ** 2, e @ np.abs(trace * flux)])
    )
    imbalance = l2(ufl.CellDiameter(spaces.mesh) * (ufl.div(sigma) + data.f_h), ufl.dx)
    imbalance += length * l2(ufl.dot(sigma - data.sigma_lift, spaces.n), spaces.ds_neumann)
    return KKTResiduals(
        primal=float(np.sqrt(primal / length) / gradient),
        dual=float(np.sqrt(dual * length) / size),
        complementarity=float(complementarity / (gradient * size)),
        stationarity=_stationarity(spaces, sigma, u, p, data) / gradient,
        mass_balance=float(np.sqrt(spaces.integrate(imbalance)) / size),
    )


def _scales(spaces: Spaces, sigma: fem.Function, u: fem.Function, data: Data) -> tuple[float, float]:
    """G and S (collective)."""
    kappa = data.kappa_h
    gradient, flux, level = (
        float(np.sqrt(spaces.integrate(l2(field, ufl.dx)))) for field in (ufl.inv(kappa) * sigma, sigma, u)
    )
    level *= CONSTANT_PART / spaces.length()
    return max(gradient, level), max(flux, mean_conductivity(spaces, kappa) * level)


def _stationarity(spaces: Spaces, sigma: fem.Function, u: fem.Function, p: fem.Function, data: Data) -> float:
    V = spaces.V
    tau, v = ufl.TestFunction(V), ufl.TestFunction(spaces.Q)
    flux_residual, _ = multiplier_residual(sigma, u, p, data.f_h, tau, v, spaces.n, spaces.ds, data.kappa_h)
    flux_residual -= trace_term(data.u_lift, tau, spaces.n, spaces.ds_dirichlet)
    residual = fem.assemble_vector(spaces.form(flux_residual))
    residual.scatter_reverse(la.InsertMode.add)
    mass = assemble_matrix(fem.form(ufl.inner(ufl.TrialFunction(V), tau) * ufl.dx))
    mass.assemble()
    residual.array[spaces.neumann_dofs] = 0.0  # where σ·n is given there is no equation
    owned = residual.array[: V.dofmap.index_map.size_local]
    square = V.mesh.comm.allreduce(owned @ (owned / mass.getDiagonal().array_r))
    mass.destroy()
    return float(np.sqrt(square))
