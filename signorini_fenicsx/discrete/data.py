"""The data of a problem as they are given, and their means over cells and facets for the discrete problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.core.expr import Expr
from ufl.domain import extract_domains

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.boundary_laws import BoundaryLaws, several_laws, signorini_alone
from signorini_fenicsx.discrete.data_values import check_means, check_nodes, extent, total
from signorini_fenicsx.discrete.given import Given, Rows, parsed
from signorini_fenicsx.discrete.laws import Law, Signorini
from signorini_fenicsx.discrete.problem import Problem
from signorini_fenicsx.discrete.spaces import Spaces, assembled, cell_measures, cells_and_dofs
from signorini_fenicsx.expressions import TREES, Tree, to_ufl

ROUNDING = 1e-12
"""Relative asymmetry of κ that counts as rounding."""


@dataclass(frozen=True)
class Data:
    """The data on a mesh. Functions hold owned and up-to-date ghost values.

    The lifts turn the problem into one for u − u_lift and σ − σ_lift with homogeneous conditions on the boundary.

    Attributes:
        f: Load as given.
        kappa: κ as given.
        u_D: Dirichlet data as given.
        g_N: Flux on Γ_N as given.
        psi: Bound of the trace as given, where no other law holds.
        q_S: Bound of the flux as given, where no other law holds.
        f_h: P0 projection of f.
        kappa_h: P0 projection of κ, entry by entry; κ itself if it is a constant scalar.
        u_lift: Crouzeix-Raviart function with the mean of u_D on each facet of Γ_D, of ψ on each of Γ_S, and 0 on all
            others. As τ_h·n is constant on a facet, (u_lift, τ_h·n) on Γ_D is (u_D, τ_h·n).
        sigma_lift: RT0 function whose flux is the mean of g_N on each facet of Γ_N, of q_S on each of Γ_S, and 0 on all
            others.
        psi_h: Mean of ψ per Γ_S facet of this rank; for other laws u at the reference.
        q_Sh: Mean of q_S per Γ_S facet of this rank; for other laws κ∇u·n at the reference.
        laws: The laws on Γ_S.
        conductance: Mean of κ divided by L: the size of σ·n that belongs to p = 1.
        total_load: ∫f + ∫g_N plus the smallest flux that the laws allow on Γ_S, ∫q_S for the Signorini law; and the
            same with the largest flux, often ∞. Exactly 0 if it is only rounding.
        exact: The exact u, where it is known.
        trees: The data that were given as numbers or as text, by name, as trees: these can be enclosed in intervals. κ
            of regions has names such as "kappa.core".
    """

    f: Expr
    kappa: Expr
    u_D: Expr
    g_N: Expr
    psi: Expr
    q_S: Expr
    f_h: fem.Function
    kappa_h: Expr
    u_lift: fem.Function
    sigma_lift: fem.Function
    psi_h: Array
    q_Sh: Array
    laws: BoundaryLaws
    conductance: float
    total_load: tuple[float, float]
    exact: Expr | None
    trees: Mapping[str, Tree | Rows]

    def conductivities(self, spaces: Spaces) -> Array:
        """Mean eigenvalue of κ_h on each owned cell."""
        if is_constant(self.kappa_h):
            return np.full(spaces.Q.dofmap.index_map.size_local, float(self.kappa_h))
        shape = self.kappa_h.ufl_shape or (1, 1)
        return np.trace(self.kappa_h.x.array.reshape(-1, *shape), axis1=1, axis2=2) / shape[0]

    def extent(self, spaces: Spaces) -> tuple[float, float]:
        """The smallest and the largest facet mean of u_D and ψ (collective)."""
        return extent(np.concatenate([self._dirichlet_means(spaces), self.psi_h]), spaces.mesh.comm)

    def dirichlet_extent(self, spaces: Spaces) -> tuple[float, float]:
        """The smallest and the largest facet mean of u_D; ∞ and −∞ without Γ_D (collective)."""
        return extent(self._dirichlet_means(spaces), spaces.mesh.comm)

    def _dirichlet_means(self, spaces: Spaces) -> Array:
        return self.u_lift.x.array[cells_and_dofs(self.u_lift.function_space, spaces.dirichlet_facets)[1]]

    def common_constant(self, spaces: Spaces) -> float:
        """The value nearest to 0 in the range of u_D and ψ: 0 unless all of them have one sign (collective)."""
        return float(np.clip(0.0, *self.extent(spaces)))

    def less(self, spaces: Spaces, constant: float) -> Data:
        """The data of the problem for u − constant (collective)."""
        if constant == 0:
            return self
        u_lift = self.u_lift.copy()
        for facets in (spaces.dirichlet_facets, spaces.facets):
            u_lift.x.array[cells_and_dofs(u_lift.function_space, facets)[1]] -= constant
        u_lift.x.scatter_forward()
        shift = fem.Constant(spaces.mesh, constant)  # a plain number would compile a form for each value
        return replace(self, u_D=self.u_D - shift, psi=self.psi - shift, u_lift=u_lift, psi_h=self.psi_h - constant)


def project_data(spaces: Spaces, problem: Problem) -> Data:
    """Take means over cells and facets, by quadrature of the degree that `quadrature` gives (collective).

    Raises:
        InputError: If a datum is not finite at some quadrature point, or so large or small that squares of the solution
            leave the range of floating-point numbers; if κ is not symmetric positive definite, or has no value on some
            cells.
    """
    problem = problem.parsed(spaces.mesh.geometry.dim)
    f = _expression(spaces, "f", problem.f, continuous=False)
    u_D, g_N, psi, q_S = (_expression(spaces, name, getattr(problem, name)) for name in ("u_D", "g_N", "psi", "q_S"))
    kappa = _conductivity(spaces, problem.kappa)
    f_h = fem.Function(spaces.Q, name="f_h")
    f_means = _cell_means(spaces, f).ravel()
    f_h.x.array[:] = f_means
    check_means("f", "in the domain", f_means, spaces)

    laws, psi_h, q_Sh = _boundary_laws(spaces, problem, psi, q_S)
    dirichlet_means = _facet_means(spaces, "u_D", u_D, spaces.dirichlet_facets, spaces.ds_dirichlet, "on Γ_D")
    neumann_means = _facet_means(spaces, "g_N", g_N, spaces.neumann_facets, spaces.ds_neumann, "on Γ_N")
    near_dirichlet = np.unique(cells_and_dofs(spaces.V, spaces.dirichlet_facets)[0])
    if not is_constant(u_D):
        check_nodes(spaces, "u_D", u_D, spaces.dirichlet_facets, "on Γ_D")
    check_finite(spaces, "[problem] u_D", "in the cells at Γ_D", u_D, near_dirichlet)
    u_lift = fem.Function(fem.functionspace(spaces.mesh, ("CR", 1)), name="u_lift")
    for facets, means in ((spaces.dirichlet_facets, dirichlet_means), (spaces.facets, psi_h)):
        u_lift.x.array[cells_and_dofs(u_lift.function_space, facets)[1]] = means
    sigma_lift = fem.Function(spaces.V, name="sigma_lift")
    sigma_lift.x.array[spaces.neumann_dofs] = neumann_means * spaces.neumann_measure / spaces.neumann_basis_flux
    sigma_lift.x.array[spaces.flux_dofs] = q_Sh * spaces.facet_measure / spaces.basis_flux
    for lift in (u_lift, sigma_lift):
        lift.x.scatter_forward()
    kappa_h = _projected_conductivity(spaces, kappa)
    loads = [cell_measures(spaces.Q) * f_h.x.array, spaces.neumann_measure * neumann_means]  # no ghosts
    lowest, highest = (
        total(np.concatenate([*loads, spaces.facet_measure * (q_Sh + flux)]), spaces.mesh.comm)
        for flux in laws.chains.extent()[2:]
    )
    return Data(
        f=f,
        kappa=kappa,
        u_D=u_D,
        g_N=g_N,
        psi=psi,
        q_S=q_S,
        f_h=f_h,
        kappa_h=kappa_h,
        u_lift=u_lift,
        sigma_lift=sigma_lift,
        psi_h=psi_h,
        q_Sh=q_Sh,
        laws=laws,
        conductance=mean_conductivity(spaces, kappa_h) / spaces.length(),
        total_load=(lowest, highest),
        exact=_exact(spaces, problem.exact),
        trees=_trees(problem),
    )


def _boundary_laws(spaces: Spaces, problem: Problem, psi: Expr, q_S: Expr) -> tuple[BoundaryLaws, Array, Array]:
    """What holds on Γ_S, with u and κ∇u·n at the reference of each facet (collective)."""
    listed = {part for law in problem.laws for part in law.parts}
    plain = [part for part in spaces.part_names if part not in listed]
    own = {"psi": psi, "q_S": q_S}
    if not problem.laws:
        means = [_facet_means(spaces, name, value, spaces.facets, spaces.ds, "on Γ_S") for name, value in own.items()]
        if not is_constant(psi):
            check_nodes(spaces, "psi", psi, spaces.facets, "on Γ_S")
        return signorini_alone(spaces, own), means[0], means[1]
    laws: list[tuple[str, Law, Mapping[str, Expr]]] = [("", Signorini(plain), own)] if plain else []
    for i, law in enumerate(problem.laws):
        name = f"law.{i}"
        data = {key: _expression(spaces, f"{name}.{key}", given) for key, given in _read(law, name, spaces).items()}
        laws.append((name, law, data))
    topology = spaces.mesh.topology

    def means_of(name: str, value: Expr, rows: Indices, weight: Expr | None) -> Array:
        facets = spaces.facets[rows]
        domain = fem.compute_integration_domains(fem.IntegralType.exterior_facet, topology, np.sort(facets))
        ds = ufl.Measure("ds", domain=spaces.mesh, subdomain_data=[(1, domain)])(1)
        means = _facet_means(spaces, name.removeprefix("."), value, facets, ds, "on its parts")
        if weight is None or is_constant(weight):
            return means
        weights = _facet_means(spaces, name, weight, facets, ds, "on its parts")
        weighted = _facet_means(spaces, name, weight * value, facets, ds, "on its parts")
        return np.divide(weighted, weights, out=means, where=weights > 0)

    return several_laws(spaces, laws, means_of)


def _read(law: Law, name: str, spaces: Spaces) -> dict[str, Any]:
    """Its data with numbers and texts as trees.

    Raises:
        InputError: If a text cannot be read.
    """
    read = {}
    for key, given in law.data().items():
        try:
            read[key] = parsed(given, spaces.mesh.geometry.dim)
        except InputError as error:
            raise InputError(f"[[law]] {name}.{key}: {error}") from None
    return read


def _exact(spaces: Spaces, given: Given | None) -> Expr | None:
    if given is None:
        return None
    u = _expression(spaces, "exact", given)
    cells = np.arange(spaces.Q.dofmap.index_map.size_local, dtype=np.int32)
    check_finite(spaces, "[exact] u", "in the domain", u, cells)
    return u


def _trees(problem: Problem) -> dict[str, Tree | Rows]:
    given: dict[str, Any] = {name: getattr(problem, name) for name in ("f", "u_D", "g_N", "psi", "q_S")}
    if isinstance(problem.kappa, Mapping):
        given |= {f"kappa.{region}": value for region, value in problem.kappa.items()}
    else:
        given["kappa"] = problem.kappa
    return {name: value for name, value in given.items() if isinstance(value, TREES | tuple | list)}


def check_finite(spaces: Spaces, name: str, where: str, value: Expr, cells: npt.NDArray[np.int32]) -> None:
    """Make sure that a scalar and its gradient are finite at the quadrature points of these cells (collective).

    Raises:
        InputError: If they are not.
    """
    if is_constant(value):
        return
    both = value + sum(ufl.grad(value)[i] for i in range(spaces.mesh.geometry.dim))  # not finite if one is not
    dx = ufl.Measure("dx", spaces.mesh, subdomain_data=[(1, cells)], metadata=quadrature(value))
    integrals = assembled(both * ufl.TestFunction(spaces.Q) * dx(1))
    if not spaces.mesh.comm.allreduce(bool(np.isfinite(integrals).all()), op=MPI.LAND):
        raise InputError(f"{name}: it or its gradient is not finite everywhere {where}")


def quadrature(value: Expr) -> dict[str, int]:
    """Metadata of a measure for the integral of an expression: the degree that UFL estimates, cut to 8 … 30."""
    degree = ufl.algorithms.estimate_total_polynomial_degree(apply_algebra_lowering(value))
    return {"quadrature_degree": min(max(8, degree), 30)}


def scalar_conductivity(kappa: Expr) -> Expr:
    """κ, or the mean of its eigenvalues."""
    return ufl.tr(kappa) / kappa.ufl_shape[0] if kappa.ufl_shape else kappa


def mean_conductivity(spaces: Spaces, kappa: Expr) -> float:
    """Mean over Ω of the scalar conductivity (collective)."""
    zero = fem.Constant(spaces.mesh, 0.0)  # integrates a plain number on this mesh
    return spaces.integrate((scalar_conductivity(kappa) + zero) * ufl.dx) / spaces.length() ** spaces.mesh.geometry.dim


def is_constant(value: Expr) -> bool:
    """Whether an expression is a number."""
    return isinstance(value, ufl.constantvalue.ConstantValue) and value.ufl_shape == ()


def _expression(spaces: Spaces, name: str, given: Given, *, continuous: bool = True, matrix: bool = False) -> Expr:
    """The given data as UFL. Functions of points become quadratic on cells, from inner points if they may jump."""
    dim = spaces.mesh.geometry.dim
    shapes = [(), (dim, dim)] if matrix else [()]
    x = ufl.SpatialCoordinate(spaces.mesh)
    if isinstance(given, Expr):
        value = given
        if any(domain != spaces.mesh.ufl_domain() for domain in extract_domains(value)):
            raise InputError(f"[problem] {name}: is UFL on another mesh; write it on `domain.mesh`")
    elif isinstance(given, TREES):
        value = to_ufl(given, x)
    elif isinstance(given, tuple | list):
        value = ufl.as_matrix([[to_ufl(entry, x) for entry in row] for row in given])
    elif callable(given):
        probe = np.asarray(given(np.zeros((3, 1))))
        variant = basix.LagrangeVariant.gll_warped if continuous else basix.LagrangeVariant.legendre
        element = basix.ufl.element(
            "P", spaces.mesh.basix_cell(), 2, variant, shape=probe.shape[:-1], discontinuous=not continuous
        )
        value = fem.Function(fem.functionspace(spaces.mesh, element), name=name)
        value.interpolate(lambda x: np.reshape(given(x), (-1, x.shape[1])))
    else:
        value = ufl.as_ufl(given)
    if value.ufl_shape not in shapes:
        raise InputError(f"[problem] {name}: has shape {value.ufl_shape}, not {' or '.join(map(str, shapes))}")
    return value


def _conductivity(spaces: Spaces, given: Given | Mapping[str, Given]) -> Expr:
    """κ as UFL; values per region become a sum of indicator functions times values."""
    if not isinstance(given, Mapping):
        return _expression(spaces, "kappa", given, continuous=False, matrix=True)
    regions = spaces.domain.regions
    for name in given:
        if name not in regions:
            known = f"its regions are {', '.join(regions)}" if regions else "it has none"
            raise InputError(f"[problem] kappa: unknown region '{name}' of the mesh; {known}")
    values_given = np.zeros(spaces.Q.dofmap.index_map.size_local, dtype=np.int64)
    values = {
        name: _expression(spaces, f"kappa.{name}", value, continuous=False, matrix=True)
        for name, value in given.items()
    }
    is_matrix = any(value.ufl_shape for value in values.values())
    kappa = None
    for name, value in values.items():
        inside = fem.Function(spaces.Q, name=name)
        inside.x.array[regions[name]] = 1.0
        values_given[regions[name]] += 1
        term = inside * (value * ufl.Identity(spaces.mesh.geometry.dim) if is_matrix and not value.ufl_shape else value)
        kappa = term if kappa is None else kappa + term
    counts = np.array([np.count_nonzero(values_given == 0), np.count_nonzero(values_given > 1)])
    without, several = spaces.mesh.comm.allreduce(counts).tolist()
    if kappa is None or without > 0:
        missing = [name for name in regions if name not in given]
        raise InputError(f"[problem] kappa: {without} cells have no value; regions without one: {', '.join(missing)}")
    if several > 0:
        raise InputError(f"[problem] kappa: {several} cells are in more than one of {', '.join(given)}")
    return kappa


def _projected_conductivity(spaces: Spaces, kappa: Expr) -> Expr:
    """κ_h (collective)."""
    means = np.array([float(kappa)]) if is_constant(kappa) else _cell_means(spaces, kappa)
    check_means("kappa", "in the domain", means, spaces)
    matrices = means.reshape(len(means), *(kappa.ufl_shape or (1, 1)))
    size = np.abs(matrices).max(axis=(1, 2))
    symmetric = np.abs(matrices - matrices.transpose(0, 2, 1)).max(axis=(1, 2)) <= ROUNDING * size
    comm = spaces.mesh.comm
    if not comm.allreduce(bool(symmetric.all()), MPI.LAND):
        raise InputError("[problem] kappa: is not symmetric everywhere")
    smallest = comm.allreduce(float(np.linalg.eigvalsh(matrices).min(initial=np.inf)), MPI.MIN)
    if not smallest > 0:
        what = "eigenvalue" if kappa.ufl_shape else "mean over a cell"
        raise InputError(f"[problem] kappa: must be positive; its smallest {what} is {smallest:.3g}")
    if is_constant(kappa):
        return kappa
    element = ("DG", 0, kappa.ufl_shape) if kappa.ufl_shape else ("DG", 0)
    kappa_h = fem.Function(fem.functionspace(spaces.mesh, element), name="kappa_h")
    kappa_h.x.array[:] = means.ravel()  # no ghost cells
    return kappa_h


def _cell_means(spaces: Spaces, value: Expr) -> Array:
    """Mean of a scalar or tensor on each owned cell, shape (cells, entries)."""
    mesh = spaces.mesh
    dx = ufl.Measure("dx", domain=mesh, metadata=quadrature(value))
    size = int(np.prod(value.ufl_shape))
    if is_constant(value):
        return np.full((spaces.Q.dofmap.index_map.size_local, 1), float(value))
    entries = [value[index] for index in np.ndindex(value.ufl_shape)] if value.ufl_shape else [value]
    zero = fem.Constant(mesh, 0.0)  # an entry may be a plain 0, whose integral UFL would drop
    integrals = [assembled((entry + zero) * ufl.TestFunction(spaces.Q) * dx) for entry in entries]
    return np.stack(integrals, axis=1).reshape(-1, size) / cell_measures(spaces.Q)[:, None]


def _facet_means(
    spaces: Spaces, name: str, value: Expr, facets: npt.NDArray[np.int32], ds: ufl.Measure, where: str
) -> Array:
    """Mean on each of these boundary facets, which `ds` covers (collective)."""
    if is_constant(value):
        means = np.full(len(facets), float(value))
    else:
        dofs = cells_and_dofs(spaces.V, facets)[1]
        flux = ufl.dot(ufl.TestFunction(spaces.V), spaces.n)  # a constant on each facet, 0 on all but one
        weighted, plain = (assembled(form)[dofs] for form in (value * flux * ds(metadata=quadrature(value)), flux * ds))
        means = weighted / plain
    check_means(name, where, means, spaces)
    return means
