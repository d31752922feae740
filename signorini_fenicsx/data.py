"""The data of a problem, as given and as the discrete problem sees them: means over cells and facets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from forms.mixed import trace_term
from signorini_fenicsx.errors import InputError
from signorini_fenicsx.spaces import Spaces, assembled, cell_measures, cells_and_dofs

type Array = npt.NDArray[np.float64]

DATA_RANGE = 1e-100, 1e100


@dataclass(frozen=True)
class Data:
    """f and u_D. Functions hold owned and up-to-date ghost values.

    Attributes:
        f: Load as given.
        u_D: Dirichlet data as given.
        f_h: P0 projection of f.
        u_Dh: Crouzeix-Raviart function whose mean is that of u_D on each facet of Γ_D, and 0 on all other facets. As
            τ_h·n is constant on a facet, (u_Dh, τ_h·n) on Γ_D is (u_D, τ_h·n).
    """

    f: Expr
    u_D: Expr
    f_h: fem.Function
    u_Dh: fem.Function


def project_data(spaces: Spaces, f: Expr, u_D: Expr) -> Data:
    """Take cell means of f and facet means of u_D, by quadrature of the degree UFL estimates, at least 8 (collective).

    Raises:
        InputError: If one is not finite at all quadrature points, or so large or small that squares of the solution
            leave the range of floating-point numbers.
    """
    mesh = spaces.mesh
    f_h = fem.Function(spaces.Q, name="f_h")
    dx = ufl.Measure("dx", domain=mesh, metadata=quadrature(f))
    zero = fem.Constant(mesh, 0.0)  # UFL would drop the integral of a plain 0
    f_h.x.array[:] = assembled((f + zero) * ufl.TestFunction(spaces.Q) * dx) / cell_measures(spaces.Q)
    _check("f", "in the domain", f_h, mesh.comm)

    tau = ufl.TestFunction(spaces.V)
    ds = spaces.ds_dirichlet(metadata=quadrature(u_D))
    flux_dofs = cells_and_dofs(spaces.V, spaces.dirichlet_facets)[1]
    weighted, plain = (assembled(trace_term(value, tau, spaces.n, ds))[flux_dofs] for value in (u_D + zero, 1.0 + zero))
    u_Dh = fem.Function(fem.functionspace(mesh, ("CR", 1)), name="u_D")
    u_Dh.x.array[cells_and_dofs(u_Dh.function_space, spaces.dirichlet_facets)[1]] = weighted / plain
    u_Dh.x.scatter_forward()
    _check("u_D", "on Γ_D", u_Dh, mesh.comm)
    return Data(f, u_D, f_h, u_Dh)


def quadrature(value: Expr) -> dict[str, int]:
    """Metadata of a measure for the integral of an expression: the degree UFL estimates, between 8 and 30."""
    return {"quadrature_degree": min(max(8, ufl.algorithms.estimate_total_polynomial_degree(value)), 30)}


def _check(name: str, where: str, means: fem.Function, comm: MPI.Comm) -> None:
    values = means.x.array
    if not comm.allreduce(bool(np.isfinite(values).all()), op=MPI.LAND):
        raise InputError(f"[problem] {name}: not finite everywhere {where}")
    largest = comm.allreduce(float(np.abs(values).max(initial=0.0)), MPI.MAX)
    low, high = DATA_RANGE
    if largest != 0 and not low <= largest <= high:
        raise InputError(f"[problem] {name}: its largest value, {largest:.1e}, is outside {low:g} … {high:g}; scale it")
