"""Elastic problems with exact solutions, and boxes to solve them in."""

import dolfinx.mesh
import numpy as np
import ufl
from dolfinx.mesh import GhostMode
from mpi4py import MPI
from ufl.core.expr import Expr

from signorini_fenicsx.forms.elasticity import strain, stress
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.own import domain_of


def box(comm: MPI.Comm, n: int, low: list[float], high: list[float]) -> Domain:
    """A rectangle or a box with n cells along its shortest edge; its parts are named by "xyz" and the end, as "y0"."""
    size = np.array(high) - low
    cells = np.round(n * size / size.min()).astype(int).tolist()
    make = {2: dolfinx.mesh.create_rectangle, 3: dolfinx.mesh.create_box}[len(low)]
    mesh = make(comm, [low, high], cells, ghost_mode=GhostMode.none)
    parts = {}
    for axis, name in enumerate("xyz"[: len(low)]):
        for end, place in enumerate((low[axis], high[axis])):
            parts[f"{name}{end}"] = lambda x, axis=axis, place=place: np.isclose(x[axis], place)
    return domain_of(mesh, parts)


def half_plane_contact(nu: float, x0: float = 0.07) -> list[str]:
    """Westergaard's contact, E = 1, plane strain: y > 0 on a foundation y < 0, in contact for x > x0 without a gap.

    With Z = −(z − x0)^½ and its integral Ẑ, σ_yy = Re Z + y Im Z', σ_xy = −y Re Z', 2μu = ((κ − 1)/2 Re Ẑ − y Im Z,
    (κ + 1)/2 Im Ẑ − y Re Z), κ = 3 − 4ν. On y = 0: σ_yy = −(x − x0)₊^½, u_y = (κ + 1)/6μ (x0 − x)₊^(3/2), σ_xy = 0.
    """
    mu2, kappa = 1 / (1 + nu), 3 - 4 * nu
    x = f"(x - {x0})"
    r = f"sqrt({x}^2 + y^2)"
    real, imaginary = f"sqrt(max(({r} + {x})/2, 0))", f"sqrt(max(({r} - {x})/2, 0))"  # of z^(1/2)
    ux = f"({(kappa - 1) / 2}*(-2/3)*({x}*{real} - y*{imaginary}) + y*{imaginary})/{mu2}"
    uy = f"({(kappa + 1) / 2}*(-2/3)*({x}*{imaginary} + y*{real}) + y*{real})/{mu2}"
    return [ux, uy]


def smooth(domain: Domain, nu: float) -> tuple[Expr, Expr, Expr]:
    """E that varies, u and f; u presses onto the plane where the last coordinate is 0: u_n = 0, σ_t = 0, σ_nn < 0."""
    x = ufl.SpatialCoordinate(domain.mesh)
    *flat, last = list(x)
    young = 1 + flat[0] / 2
    along = [ufl.sin(2 * flat[0] + i) * ufl.cos(last) for i in range(len(flat))]
    u = ufl.as_vector([*along, ufl.sin(last) * ufl.cos(flat[0]) - 5 * last])
    theta = nu if len(x) == 2 else nu / (1 + nu)
    f = -ufl.div(stress(strain(u), young / (1 + nu), theta))
    return young, u, f
