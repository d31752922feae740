"""Elastic problems with exact solutions, and boxes to solve them in."""

import boxes
import dolfinx.mesh
import numpy as np
import ufl
from dolfinx.mesh import DiagonalType
from mpi4py import MPI
from ufl.core.expr import Expr

from signorini_fenicsx import Contact, Dirichlet, Elasticity, Neumann, solve
from signorini_fenicsx.forms.elasticity import strain
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution


def box(comm: MPI.Comm, n: int, low: list[float], high: list[float], **cut: DiagonalType) -> Domain:
    """A rectangle or a box with n cells along its shortest edge; its parts are named by "xyz" and the end, as "y0"."""
    size = np.array(high) - low
    cells = np.round(n * size / size.min()).astype(int).tolist()
    make = {2: dolfinx.mesh.create_rectangle, 3: dolfinx.mesh.create_box}[len(low)]
    mesh = make(comm, [low, high], cells, **cut)
    parts = {}
    for axis, name in enumerate("xyz"[: len(low)]):
        for end, place in enumerate((low[axis], high[axis])):
            parts[f"{name}{end}"] = lambda x, axis=axis, place=place: np.isclose(x[axis], place)
    return domain_of(mesh, parts)


def block(comm: MPI.Comm) -> ElasticSolution:
    """A block 2 x 3 x 1 under a uniform pressure of 0.1 that may grow wider."""
    held = [Dirichlet(f"{axis}0", 0, components=axis) for axis in "xy"]
    conditions = [Contact("z0"), *held, Neumann("z1", ["0", "0", "-0.1"]), Neumann(["x1", "y1"], 0)]
    return solve(box(comm, 1, [0.0, 0.0, 0.0], [2.0, 3.0, 1.0]), Elasticity(1.0, 0.3, conditions=conditions))


def half(gap: str, push: float) -> Elasticity:
    """One half of a symmetric body, E = 1 and ν = 0.3, which a traction along y on top pushes onto a plane."""
    held, pushed = Dirichlet("x0", 0, components="x"), Neumann("y1", ["0", str(push)])
    return Elasticity(1.0, 0.3, conditions=[Contact("y0", gap), held, pushed, Neumann("x1", 0)])


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


def stress(strain: Expr, mu2: Expr, theta: Expr) -> Expr:
    """ℂε = 2μ (ε + θ/(1 − dθ) tr ε I) of an isotropic material; `mu2` is 2μ."""
    dim = strain.ufl_shape[0]
    return mu2 * (strain + theta / (1 - dim * theta) * ufl.tr(strain) * ufl.Identity(dim))


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


def two_boxes(comm: MPI.Comm, n: int, dim: int) -> Domain:
    """Two boxes on a mesh of DOLFINx, cut along their common side, where the last coordinate is 0 (collective)."""
    low, high = [0.0] * dim, [1.0] * dim
    low[-1], high[-1] = -0.5, 0.5
    return boxes.box(low, high, [n] * dim, comm, cut=0.0)
