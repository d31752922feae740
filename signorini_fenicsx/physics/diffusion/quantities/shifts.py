"""Problems whose data differ a little: fluxes with more in them, laws moved in u or in κ∇u·n."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import dolfinx.mesh
import numpy as np

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.contact.laws import (
    Corners,
    Dirichlet,
    Friction,
    Neumann,
    Regulator,
    River,
    Seepage,
    Signorini,
    TwoSided,
    Wall,
)
from signorini_fenicsx.discrete.cell_shapes import facet_corners
from signorini_fenicsx.expressions import TREES, Binary, decided
from signorini_fenicsx.expressions.given import Given, parsed
from signorini_fenicsx.expressions.intervals import Interval
from signorini_fenicsx.meshes.domain import Boundary, Domain, other_side
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.quantities.beside import added, check_part

MOVED: Mapping[type[Law], tuple[Sequence[str], Sequence[str]]] = {
    Dirichlet: (["value"], []),
    Neumann: ([], ["value"]),
    Signorini: (["psi"], ["q_S"]),
    TwoSided: (["psi", "psi_upper"], ["q_S"]),
    Seepage: (["level"], ["rain"]),
    River: (["level", "bed"], ["q"]),
}
"""The data of a law with which its graph moves in u, and those with which it moves in κ∇u·n."""


def with_flux(domain: Domain, problem: Problem, weight: Given, parts: Sequence[str], factor: float) -> Problem:
    """The problem whose flux on some parts of Γ_N and Γ_S is larger by a multiple of a weight (collective).

    On parts inside the domain the jump of u is integrated.

    Raises:
        InputError: If a part is unknown, or u is given on it.
    """
    boundary = problem.boundary

    def more(given: Given) -> Given:
        return added(domain, given, weight, factor)

    for part in parts:
        check_part(domain, boundary, part)
    names = list(parts)
    if set(boundary.neumann) and set(boundary.neumann) <= set(names):
        problem = replace(problem, g_N=more(problem.g_N))
        names = [part for part in names if part not in boundary.neumann]
    for part in names:
        if part in boundary.neumann:
            others = [other for other in boundary.neumann if other != part]
            boundary = replace(boundary, neumann=others)
            problem = replace(problem, laws=[*problem.laws, Neumann(part, more(problem.g_N))], boundary=boundary)
        elif part in boundary.signorini:
            problem = _with_law(boundary, problem, part, lambda law: moved(domain, law, 0.0, weight, factor))
        else:
            raise InputError(f"u is given on the part '{part}'")
    return problem


def with_trace(domain: Domain, problem: Problem, parts: Sequence[str], weight: Given, amount: float) -> Problem:
    """The problem whose u_D on some parts is larger by a multiple of a weight, and laws on others so in u (collective).

    On parts inside the domain the jump of u takes the place of u.

    Raises:
        InputError: If a part is unknown, one of Γ_N, or the other side of one inside the domain.
    """
    boundary = problem.boundary
    fixed, even = [], isinstance(weight, int | float) and weight == 1
    for part in parts:
        check_part(domain, boundary, part)
        if part in boundary.neumann:
            raise InputError(f"the flux through the part '{part}' is given, as it is in neumann")
        if part in boundary.signorini:
            problem = _with_law(boundary, problem, part, lambda law: moved(domain, law, weight, 0.0, amount))
        else:
            fixed.append(part)
    if fixed and even and _are_all(domain, boundary, fixed):
        problem = replace(problem, u_D=added(domain, problem.u_D, amount, 1.0))
    elif fixed:
        held = [Dirichlet(part, _on_part(domain, part, added(domain, problem.u_D, weight, amount))) for part in fixed]
        problem = replace(problem, laws=[*problem.laws, *held])
    return problem


def check_paired(problem: Problem, part: str, *, is_flux: bool) -> None:
    """Refuse parts of pairs, but for the flux through a slave with a law.

    Raises:
        InputError: If it is one.
    """
    for pair in problem.boundary.pairs:
        if part in pair.master:
            raise InputError(f"the part '{part}' is the master of a pair; take a slave, or other parts of its body")
        if part in pair.slave and (pair.tied or not is_flux):
            how = "tied" if pair.tied else "a slave, and u jumps there"
            raise InputError(f"the part '{part}' of a pair is {how}; take other parts, or a region, of its body")


def _on_part(domain: Domain, part: str, given: Given) -> Given:
    """A datum as it is on a part: of a text the branches that hold there (collective)."""
    if not isinstance(given, TREES):
        return given
    dim, comm = domain.mesh.geometry.dim, domain.mesh.comm
    x = facet_corners(domain.mesh, domain.facets[part]).reshape(-1, dim)
    ends = comm.allgather([x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)])
    lo, hi = np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)
    return decided(given, {name: Interval(*np.array([lo[i], hi[i]])[:, None]) for i, name in enumerate("xyz"[:dim])})


def moved(domain: Domain, law: Law, u: Given, flux: Given, factor: float) -> Law:
    """A law on parts whose graph is moved by multiples of u and of κ∇u·n.

    Raises:
        InputError: If it is a law of one's own.
    """

    def in_u(given: Given) -> Given:
        return added(domain, given, u, factor)

    def in_flux(given: Given) -> Given:
        return added(domain, given, flux, factor)

    if isinstance(law, Corners):
        return replace(law, corners=[(in_u(level), in_flux(value)) for level, value in law.corners])
    if isinstance(law, Wall):
        return Corners(law.parts, corners=[(in_u(law.level), in_flux(0.0))], before=law.beta)
    if isinstance(law, Friction):
        minus_g = added(domain, 0.0, law.g, -1.0)
        return Corners(law.parts, corners=[(in_u(0.0), in_flux(law.g)), (in_u(0.0), in_flux(minus_g))])
    if isinstance(law, Regulator):
        ends = [(_difference(domain, law.a, g, law.k), g) for g in (law.g_high, law.g_low)]
        return Corners(law.parts, corners=[(in_u(level), in_flux(value)) for level, value in ends])
    if type(law) not in MOVED:
        raise InputError(f"a quantity on a part with the law '{law.name}', which is not one of the program's")
    of_u, of_flux = MOVED[type(law)]

    def change(key: str, given: Any) -> Any:
        name = key.rpartition(".")[2]
        return in_u(given) if name in of_u else in_flux(given) if name in of_flux else given

    return law.with_data(change)


def _difference(domain: Domain, a: Given, g: Given, k: Given) -> Given:
    """The u of a regulator at a flux g: a − g/k.

    Raises:
        InputError: If one of them is neither a number nor a text.
    """
    a, g, k = (parsed(given, "xyz"[: domain.mesh.geometry.dim], "regulator") for given in (a, g, k))
    if not all(isinstance(given, TREES) for given in (a, g, k)):
        raise InputError("a quantity on a part with the law 'regulator' needs data that are numbers or texts")
    return Binary("-", a, Binary("/", g, k))


def _with_law(boundary: Boundary, problem: Problem, part: str, change: Callable[[Law], Law]) -> Problem:
    """The problem with another law on one part of Γ_S."""
    for i, law in enumerate(problem.laws):
        if part in law.parts:
            others = [other for other in law.parts if other != part]
            kept = [replace(law, parts=others)] if others else []
            laws = [*problem.laws[:i], *kept, change(replace(law, parts=[part])), *problem.laws[i + 1 :]]
            return replace(problem, laws=laws)
    listed = {other for law in problem.laws for other in law.parts}
    plain = change(Signorini(part, problem.psi, problem.q_S))
    if set(boundary.signorini) - listed == {part} and isinstance(plain, Signorini):
        return replace(problem, psi=plain.psi, q_S=plain.q_S)
    return replace(problem, laws=[*problem.laws, plain])


def _are_all(domain: Domain, boundary: Boundary, parts: Sequence[str]) -> bool:
    """Whether these parts are all of Γ_D (collective)."""
    outer = dolfinx.mesh.exterior_facet_indices(domain.mesh.topology)
    across = [other_side(part) for part in boundary.inner]
    named = [domain.facets[part] for part in (*boundary.signorini, *boundary.neumann, *across, *parts)]
    left = np.setdiff1d(outer, np.concatenate(named))
    return bool(domain.mesh.comm.allreduce(len(left)) == 0)
