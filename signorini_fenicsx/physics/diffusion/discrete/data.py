"""The data of a problem as they are given, and their means over cells and facets for the discrete problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, check_kind
from signorini_fenicsx.base.owned import owned_cells, owned_values, set_owned
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.discrete.bodies import spread
from signorini_fenicsx.discrete.data_values import (
    check_cells,
    check_finite,
    check_nodes,
    extent,
    facet_means,
    total,
)
from signorini_fenicsx.discrete.datum import Datum, datum_of, quadrature_degree, regional_datum
from signorini_fenicsx.discrete.known import Known
from signorini_fenicsx.discrete.mesh_spaces import cells_and_dofs
from signorini_fenicsx.discrete.seen import Values, values_in
from signorini_fenicsx.expressions import TREES, Tree, exactly
from signorini_fenicsx.expressions.given import Given, Rows
from signorini_fenicsx.physics.diffusion.discrete.added_flux import b_of
from signorini_fenicsx.physics.diffusion.discrete.boundary_laws import BoundaryLaws, boundary_laws
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import CellLaws, cell_laws, with_reactions
from signorini_fenicsx.physics.diffusion.discrete.coefficients import (
    cell_means,
    conductivity,
    mean_eigenvalues,
    reaction,
)
from signorini_fenicsx.physics.diffusion.discrete.data_of_u import DataOfU
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import depends_on_u, quasilinear_of
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.problem import Problem


@dataclass(frozen=True, kw_only=True)
class Data(DataOfU):
    """The data on a mesh. Functions hold owned and up-to-date ghost values.

    The lifts turn the problem into one for u − u_lift and σ − σ_lift with homogeneous conditions on the boundary.

    Attributes:
        f: Load as given.
        u_D: Dirichlet data as given.
        g_N: Flux on Γ_N as given.
        psi: Bound of the trace as given, where no other law holds.
        q_S: Bound of the flux as given, where no other law holds.
        u_lift: Crouzeix-Raviart function with the mean of u_D on each facet of Γ_D, of ψ on each of Γ_S, and 0 on all
            others. As τ_h·n is constant on a facet, (u_lift, τ_h·n) on Γ_D is (u_D, τ_h·n).
        sigma_lift: RT0 function whose flux is the mean of g_N on each facet of Γ_N, of q_S on each of Γ_S, and 0 on all
            others.
        psi_h: Mean of ψ per Γ_S facet of this rank; for other laws u at the reference.
        q_Sh: Mean of q_S per Γ_S facet of this rank; for other laws κ∇u·n at the reference.
        laws: The laws on Γ_S.
        inside: The laws in Ω but for reactions, which are in c.
        total_load: ∫f + ∫g_N plus the smallest flux that the laws allow on Γ_S, ∫q_S for the Signorini law; and the
            same with the largest flux, often ∞; less the s that laws in Ω allow. Exactly 0 if it is only rounding.
        exact: The exact u, where it is known.
        given: The constants and functions in the data, with the values that they had.
    """

    f: Datum
    u_D: Datum
    g_N: Datum
    psi: Datum
    q_S: Datum
    u_lift: fem.Function
    sigma_lift: fem.Function
    psi_h: Array
    q_Sh: Array
    laws: BoundaryLaws
    inside: CellLaws
    total_load: tuple[float, float]
    exact: Datum | None
    given: Values = ()

    @cached_property
    def chains(self) -> Chains:
        """The law of each site: of each facet of Γ_S and, with laws in Ω, of each owned cell."""
        return self.laws.chains.followed_by(self.inside.chains)

    def conductivities(self, spaces: Spaces) -> Array:
        """Mean eigenvalue of κ_h on each owned cell."""
        return mean_eigenvalues(spaces, self.kappa, self.kappa_h)

    def same_operator(self, other: Data, spaces: Spaces) -> bool:
        """Whether κ_h and c_h are those of other data on this mesh (collective)."""
        same = self.kappa.shape == other.kappa.shape and np.array_equal(self.matrices(spaces), other.matrices(spaces))
        if self.c_h is None or other.c_h is None:
            same = same and self.c_h is other.c_h
        else:
            same = same and np.array_equal(self.c_h.x.array, other.c_h.x.array)
        return bool(spaces.mesh.comm.allreduce(same, MPI.LAND))

    def like(self, other: Data, spaces: Spaces) -> Data:
        """The data with the memory of others and, where κ depends on u, the κ found with these (collective)."""
        data = self.after(other.memory)
        return data if data.quasilinear is None else data.with_kappa(spaces, other.kappa_values)

    def holds(self, spaces: Spaces) -> bool:
        """Whether u is unique where σ·n is given on all of Γ_S: there is a Γ_D, or c > 0 somewhere."""
        return spaces.has_dirichlet or self.c_h is not None

    def source(self, u: fem.Function) -> fem.Function:
        """f_h − c_h u for u in P0, which is −∇·σ_h; f_h itself where c = 0."""
        if self.c_h is None:
            return self.f_h
        source = self.f_h.copy()
        source.x.array[:] -= self.c_h.x.array * u.x.array
        return source

    def mean_sources(self, _spaces: Any, u: fem.Function) -> Array:
        """The mean of f − cu on each owned cell as the balance has it, for the u of a solution (collective)."""
        return owned_values(self.source(u))

    def matrices(self, spaces: Spaces) -> Array:
        """κ_h as a matrix on each owned cell, shape (cells, dim, dim), or (1, dim, dim) if κ is a number."""
        identity = np.eye(spaces.mesh.geometry.dim)
        if self.kappa.number is not None:
            return self.kappa.number * identity[None]
        entries = owned_values(self.kappa_h).reshape(-1, *(self.kappa.shape or (1, 1)))
        return entries if self.kappa.shape else entries * identity

    def jumps(self, spaces: Spaces) -> Array | None:
        """What stands for b in the first equation, see `AddedFlux.jumps` (collective)."""
        return None if self.b is None else self.b.jumps(self.matrices(spaces))

    def _without_sources(self, spaces: Any, traces: Array) -> tuple[Array, Array]:
        """See `DataOfU` (collective)."""
        of_u, z = self.quasilinear, self.jumps(spaces)
        assert of_u is not None
        assert of_u.storing is not None
        means = (traces if z is None else traces + z).mean(axis=1, keepdims=True)
        return means, of_u.storing.moments / self.kappa_values[:, :, None]

    def driving(self, flux: CellFlux) -> CellFlux:
        """A flux less b: the κ∇u of σ (collective)."""
        return flux if self.b is None else self.b.taken_from(flux, self.kappa)

    def less_b(self, spaces: Spaces) -> CellFlux | None:
        """−b by the quadratics near it; None without b (collective)."""
        nothing = np.zeros(len(spaces.cell_measures))
        zero = CellFlux(spaces, np.zeros((len(nothing), spaces.mesh.topology.dim)), nothing)
        return None if self.b is None else self.driving(zero)

    def extent(self, spaces: Spaces) -> tuple[float, float]:
        """The smallest and the largest mean of u_D, of ψ on the boundary, and of references in Ω; 0 without any.

        Collective.
        """
        means = [self._dirichlet_means(spaces), self.psi_h[spaces.outer_rows], self.inside.means]
        low, high = extent(np.concatenate(means), spaces.mesh.comm)
        return (low, high) if low <= high else (0.0, 0.0)

    def dirichlet_varies(self, spaces: Spaces, rounding: float) -> bool:
        """Whether facet means of u_D differ within one body by more than this share of the largest (collective)."""
        means = self._dirichlet_means(spaces)
        lowest, highest = extent(means, spaces.mesh.comm)
        largest = rounding * max(highest, -lowest)
        return highest - lowest > largest and spread(spaces, spaces.dirichlet_facets, means) > largest

    def _dirichlet_means(self, spaces: Spaces) -> Array:
        return self.u_lift.x.array[cells_and_dofs(self.u_lift.function_space, spaces.dirichlet_facets)[1]]

    def common_constant(self, spaces: Spaces) -> float:
        """The value nearest to 0 in the range of u_D and ψ: 0 unless all of them have one sign (collective)."""
        return float(np.clip(0.0, *self.extent(spaces)))

    def less(self, spaces: Spaces, constant: float) -> Data:
        """The data of the problem for u − constant; f itself stays, f_h does not where c > 0 (collective)."""
        if constant == 0:
            return self
        u_lift, psi_h, outer, f_h = self.u_lift.copy(), self.psi_h.copy(), spaces.outer_rows, self.f_h
        if self.c_h is not None:
            f_h = f_h.copy()
            f_h.x.array[:] -= constant * self.c_h.x.array
        for facets in (spaces.dirichlet_facets, spaces.facets[outer]):
            u_lift.x.array[cells_and_dofs(u_lift.function_space, facets)[1]] -= constant
        u_lift.x.scatter_forward()
        psi_h[outer] -= constant
        return replace(
            self,
            u_D=self.u_D.less(constant),
            psi=self.psi.less(constant),
            f_h=f_h,
            u_lift=u_lift,
            psi_h=psi_h,
            inside=self.inside.less(constant),
            quasilinear=self.quasilinear and replace(self.quasilinear, constant=self.quasilinear.constant + constant),
        )

    @property
    def bound(self) -> Array:
        """The means of ψ at the sites on Γ_S."""
        return self.psi_h

    def with_bound(self, spaces: Spaces, psi_h: Array) -> Data:
        """The data with other means of ψ at the sites on Γ_S (collective)."""
        u_lift = self.u_lift.copy()
        u_lift.x.array[cells_and_dofs(u_lift.function_space, spaces.facets)[1]] = psi_h
        u_lift.x.scatter_forward()
        return replace(self, psi_h=psi_h, u_lift=u_lift)


def project_data(spaces: Spaces, problem: Problem, known: Known | None = None) -> Data:
    """Take means over cells and facets, by quadrature of the degree that `quadrature_degree` gives (collective).

    Args:
        spaces: The discrete spaces.
        problem: The data as given.
        known: Keeps what was made of earlier data on these spaces.

    Raises:
        InputError: If a datum is not finite at some quadrature point, or so large or small that squares of the solution
            leave the range of floating-point numbers; if κ is not symmetric positive definite, or has no value on some
            cells; if c is negative somewhere.
    """
    check_kind("problem", problem, Problem)
    problem, known = problem.parsed(spaces.mesh.geometry.dim), known or Known(spaces.mesh.comm)
    problem = with_reactions(spaces, problem)
    # κ_h, f_h, σ_lift, u_lift: functions made in another order make another form, which would be compiled again.
    of_u = quasilinear_of(spaces, problem.kappa, problem.form) if depends_on_u(problem.kappa) else None
    b = b_of(spaces, problem, known)
    problem = problem if of_u is None else replace(problem, kappa=exactly(1.0))
    kappa, kappa_h, conductance = known.get("kappa", problem.kappa, lambda: conductivity(spaces, problem))
    f, f_h = known.get("f", problem.f, lambda: _load(spaces, problem, known))
    c, c_h = known.get("c", problem.c, lambda: reaction(spaces, problem))
    of_laws = [(id(type(law)), law.parts, law.region, law.data()) for law in problem.laws]
    on_boundary = [problem.u_D, problem.g_N, problem.psi, problem.q_S, problem.obstacle, of_laws]
    boundary = known.get("boundary", on_boundary, lambda: _boundary(spaces, problem))
    laws, q_Sh, sigma_lift = (boundary[name] for name in ("laws", "q_Sh", "sigma_lift"))
    given_flux = sigma_lift.x.array[spaces.neumann_dofs] * spaces.neumann_basis_flux
    inside: CellLaws = boundary["inside"]
    in_cells = inside.chains.extent()[2:] if inside else (0.0, 0.0)
    lowest, highest = (
        total(
            np.concatenate(
                [
                    spaces.cell_measures * (owned_values(f_h) + in_cell),
                    given_flux,
                    (spaces.facet_measure * (q_Sh + flux))[spaces.outer_rows],
                ]
            ),
            spaces.mesh.comm,
        )
        for flux, in_cell in zip(laws.chains.extent()[2:], in_cells, strict=True)
    )
    data = Data(
        f=f,
        kappa=kappa,
        c=c,
        f_h=f_h,
        kappa_h=kappa_h,
        c_h=c_h,
        conductance=conductance,
        total_load=(lowest, highest),
        exact=known.get("exact", problem.exact, lambda: _exact(spaces, problem.exact)),
        trees=_trees(problem),
        given=values_in(problem),
        quasilinear=of_u,
        b=b,
        **boundary,
    )
    if of_u is None:
        return data
    of_u = replace(of_u, ends=data.extent(spaces))
    return replace(data, quasilinear=of_u).with_kappa(spaces, of_u.first)


def _load(spaces: Spaces, problem: Problem, known: Known) -> tuple[Datum, fem.Function]:
    """The datum f, and f_h (collective)."""
    f = regional_datum(spaces, "f", problem.f)
    f_h, degree = fem.Function(spaces.Q, name="f_h"), quadrature_degree(f)
    if isinstance(problem.f, TREES):
        means = known.combination(
            f"f in degree {degree}",
            problem.f,
            lambda tree: cell_means(spaces, datum_of(spaces, "f", tree, continuous=False), degree),
        )
    else:
        means = cell_means(spaces, f)
    set_owned(f_h, means)
    check_cells("f", means, spaces)
    return f, f_h


def _boundary(spaces: Spaces, problem: Problem) -> dict[str, Any]:
    """The data on Γ_D, Γ_N and Γ_S and what is made of them, by the names that `Data` has for them (collective)."""
    u_D, g_N, psi, q_S = (datum_of(spaces, name, getattr(problem, name)) for name in ("u_D", "g_N", "psi", "q_S"))
    laws, psi_h, q_Sh = boundary_laws(spaces, problem, psi, q_S)
    dirichlet_means = facet_means(spaces, "u_D", u_D, spaces.dirichlet_facets, "on Γ_D")
    neumann_means = facet_means(spaces, "g_N", g_N, spaces.neumann_facets, "on Γ_N")
    near_dirichlet = np.unique(cells_and_dofs(spaces.V, spaces.dirichlet_facets)[0])
    check_nodes(spaces, "u_D", u_D, spaces.dirichlet_facets, "on Γ_D")
    check_finite(spaces, "[problem] u_D", "in the cells at Γ_D", u_D, near_dirichlet)
    sigma_lift = fem.Function(spaces.V, name="sigma_lift")
    sigma_lift.x.array[spaces.neumann_dofs] = neumann_means * spaces.neumann_measure / spaces.neumann_basis_flux
    sigma_lift.x.array[spaces.flux_dofs] = q_Sh * spaces.facet_measure / spaces.basis_flux
    u_lift = fem.Function(spaces.crouzeix_raviart, name="u_lift")
    for facets, means in ((spaces.dirichlet_facets, dirichlet_means), (spaces.facets, psi_h)):
        u_lift.x.array[cells_and_dofs(u_lift.function_space, facets)[1]] = means
    for lift in (u_lift, sigma_lift):
        lift.x.scatter_forward()
    spaces.carry_across(sigma_lift)
    inside = cell_laws(spaces, problem, u_D, laws.of_parts)
    given = {"u_D": u_D, "g_N": g_N, "psi": psi, "q_S": q_S, "laws": laws, "inside": inside}
    return given | {"psi_h": psi_h, "q_Sh": q_Sh, "u_lift": u_lift, "sigma_lift": sigma_lift}


def _exact(spaces: Spaces, given: Given | Mapping[str, Given] | None) -> Datum | None:
    if given is None:
        return None
    try:
        u = regional_datum(spaces, "exact", given) if isinstance(given, Mapping) else datum_of(spaces, "exact", given)
    except InputError as error:
        raise InputError(str(error).replace("[problem] exact", "[exact] u")) from None
    check_finite(spaces, "[exact] u", "in the domain", u, owned_cells(spaces.mesh))
    return u


def _trees(problem: Problem) -> dict[str, Tree | Rows]:
    given: dict[str, Any] = {name: getattr(problem, name) for name in ("u_D", "g_N", "psi", "q_S", "obstacle")}
    for name, whole in (("f", problem.f), ("kappa", problem.kappa), ("c", problem.c)):
        of_regions = {f"{name}.{key}": value for key, value in whole.items()} if isinstance(whole, Mapping) else None
        given |= {name: whole} if of_regions is None else of_regions
    return {name: value for name, value in given.items() if isinstance(value, TREES | tuple | list)}
