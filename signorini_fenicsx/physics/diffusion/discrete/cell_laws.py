"""Laws in Ω, −∇·σ + s = f with s a monotone graph of u, such as an obstacle, as a condition on each cell.

The mean u_T of u and the mean s_T of s are on the graph of the means of the data. So a cell is a site like a facet of
Γ_S, with the pair (u_T − its reference, −s_T) in the place of (p, σ·n); −s_T is f_h + ∇·σ with its sign changed, for an
obstacle its force. What is linear in u, s = cu, is no condition: it stands in the matrix, see `with_reactions`.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.text import did_you_mean, place_in_words
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions, joined
from signorini_fenicsx.contact.law import EVERYWHERE, Graph, Law
from signorini_fenicsx.contact.laws import Obstacle, Reaction, Storage
from signorini_fenicsx.discrete.data_values import in_problem, worst_of
from signorini_fenicsx.discrete.datum import Datum, datum_of, quadrature_degree
from signorini_fenicsx.discrete.linear_traces import Hats
from signorini_fenicsx.discrete.part_laws import SHORT, PartLaw, chains_of, checked, data_of_law, means_of
from signorini_fenicsx.discrete.points import facet_type, in_facets, quadratic_nodes
from signorini_fenicsx.discrete.vertex_laws import VertexLaws, shared_compliance, vertex_graphs
from signorini_fenicsx.expressions import exactly
from signorini_fenicsx.expressions.given import Given, combined, parsed
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces
from signorini_fenicsx.physics.diffusion.problem import Problem

ROUNDING = 1e-12
"""Relative size by which u_D may be beyond a bound."""
SAME = 1e-9
"""Relative distance of u from a corner of a law that is rounding."""


@dataclass(frozen=True)
class CellLaws:
    """The laws in Ω of a problem, but for reactions; without any no cell is a site, and it is false.

    Attributes:
        of_regions: Each law with its cells.
        means: u_T at the reference of each cell that is a site: of its first law, 0 without one.
        chains: The sum of the laws of each such cell, between u_T − its reference and −s_T.
    """

    of_regions: tuple[PartLaw, ...] = ()
    means: Array = field(default_factory=lambda: np.empty(0))
    chains: Chains = field(default_factory=lambda: Chains.at_corner(0, before=0.0))

    def __bool__(self) -> bool:
        return len(self.of_regions) > 0

    def less(self, constant: float) -> "CellLaws":
        """The laws of the problem for u − constant."""
        return replace(self, means=self.means - constant)

    @property
    def is_obstacle(self) -> bool:
        """Whether the laws are one obstacle with one bound in all cells."""
        return len(self.of_regions) == 1 and type(self.of_regions[0].law) is Obstacle and self.chains.corners == 1

    @property
    def bounds_alone(self) -> bool:
        """Whether there are laws, all of them obstacles."""
        return bool(self) and all(type(part.law) is Obstacle for part in self.of_regions)

    def as_linear(self, conditions: SiteConditions) -> tuple[Array, Array]:
        """The laws under conditions as s = βu − q: β, ∞ where u_T is given, and q or that u_T, per owned cell.

        Args:
            conditions: Conditions of the cells.
        """
        values = np.broadcast_to(conditions.value, conditions.kind.shape)
        beta = np.where(conditions.kind == Condition.ROBIN, conditions.beta, 0.0)
        held = conditions.kind == Condition.ZERO_TRACE
        return np.where(held, np.inf, beta), np.where(held, self.means + values, values + beta * self.means)


def cell_laws(spaces: Spaces, problem: Problem, u_D: Datum, on_parts: Sequence[PartLaw]) -> CellLaws:
    """The laws in Ω, but for reactions (collective).

    Args:
        spaces: The discrete spaces.
        problem: The problem.
        u_D: u on Γ_D.
        on_parts: The laws on Γ_S.

    Raises:
        InputError: If data are not what their law allows, the laws of a cell leave no u, or u_D or all u that a law on
            Γ_S allows are beyond a bound.
    """
    laws: list[tuple[str, Law]] = [(f"law.{i}", law) for i, law in enumerate(problem.laws) if law.region]
    if problem.obstacle is not None:
        laws.insert(0, (SHORT, Obstacle(region=EVERYWHERE, psi=problem.obstacle)))  # type: ignore[call-arg]
    laws = [(name, law) for name, law in laws if not isinstance(law, Reaction)]
    if any(isinstance(law, Storage) for _, law in laws):
        raise InputError("storage: this law is of problems in time, which `evolve` solves")
    if not laws:
        return CellLaws()
    number = len(spaces.cell_measures)
    means, has_law = np.zeros(number), np.zeros(number, dtype=bool)
    chains, of_regions = Chains.at_corner(number, before=0.0), []
    for name, law in laws:
        part, graph = part_in(spaces, law, name)
        rows, first = part.rows, ~has_law[part.rows]
        means[rows[first]] = np.broadcast_to(graph.reference[0], len(rows))[first]
        of_part = chains_of(replace(graph, reference=(means[rows], 0.0)), len(rows))
        chains = _with(spaces, chains, part, rows, of_part, first)
        if len(laws) == 1 and isinstance(law, Obstacle) and len(graph.corners) == 1 and EVERYWHERE in law.region:
            chains = chains_of(graph, number)  # values that are exactly 0
        has_law[rows] = True
        of_regions.append(part)
        for what, facets, allowed in _allowed(spaces, u_D, on_parts):
            _check_bounds(spaces, part, what, facets, allowed)
    return CellLaws(tuple(of_regions), means, chains)


def part_in(spaces: Spaces, law: Law, name: str) -> tuple[PartLaw, Graph]:
    """A law in Ω with its cells, and its graph in the means of its data (collective).

    Raises:
        InputError: If data are not what the law allows.
    """
    data = {"psi": datum_of(spaces, SHORT, law.data()["psi"])} if name == SHORT else data_of_law(spaces, law, name)
    return checked(spaces, PartLaw(law, name, cells_of(spaces, law, name), data))


def chains_in(spaces: Spaces, part: PartLaw) -> Chains:
    """The chains of a law in its cells, between u and −s, from the means of its data (collective)."""
    graph = part.law.falling(means_of(spaces, part))
    return chains_of(replace(graph, reference=(0.0, 0.0)), len(part.rows))


def cells_of(spaces: Spaces, law: Law, name: str) -> Indices:
    """The owned cells of a law in regions, ascending.

    Raises:
        InputError: If the mesh has no such region, or the law has none.
    """
    regions = spaces.domain.regions
    if not law.region:
        raise InputError(f"{name} ({law.name}): this law is one of regions, not parts: give region")
    if EVERYWHERE in law.region:
        return owned_cells(spaces.mesh).astype(np.int64)
    for region in law.region:
        if region not in regions:
            which = f"its regions are {', '.join(regions)}" if regions else f'it has none; use "{EVERYWHERE}"'
            meant = did_you_mean(region, regions)
            raise InputError(f"{name}.region: unknown region '{region}' of the mesh; {which}{meant}")
    return np.unique(np.concatenate([regions[region] for region in law.region])).astype(np.int64)


def corners_passed(corners: Array, u: Array) -> Indices:
    """The segment that u is on, by the u of the corners of a law, shape (sites, corners); of jumps the jump."""
    near = SAME * np.maximum(np.abs(u[:, None]), np.abs(corners))
    below, at = (corners < u[:, None] - near).sum(axis=1), np.abs(corners - u[:, None]) <= near
    return np.asarray(below + np.where(at.sum(axis=1) > 1, 1, 0))


def at_vertices(spaces: RT1Spaces, laws: CellLaws) -> VertexLaws:
    """The laws at the vertices of all owned cells, of none without laws in Ω, between u and −s (collective).

    Raises:
        InputError: If the laws of a vertex leave no u.
    """
    size, cells = spaces.dim + 1, Hats(spaces.order, spaces.cell_measures)
    number, alone = size * len(laws.means), len(laws.of_regions) == 1 and laws.chains.plain
    means, has_law, chains = np.zeros(number), np.zeros(number, dtype=bool), Chains.at_corner(number, before=0.0)
    for part in laws.of_regions:
        rows = (size * part.rows[:, None] + np.arange(size)).ravel()
        first, parts, begin = ~has_law[rows], [], 0
        for points in part.quadrature(spaces, quadrature_degree(*part.data.values(), power=2)):
            graph, some = part.falling(points), rows[begin : begin + size * len(points.cells)]
            graph = graph if alone else replace(graph, reference=(graph.reference[0], 0.0))
            at = np.where(has_law[some], means[some], np.nan)
            laws_there, p_h, _ = vertex_graphs(cells.take(points.cells.astype(np.int64)), points, graph, at)
            means[some], has_law[some] = p_h, True
            parts.append((np.arange(begin, begin + len(some)), laws_there))
            begin += len(some)
        laws_there = joined(parts, len(rows))
        chains = laws_there if alone else _with(spaces, chains, part, rows, laws_there, first)
    return VertexLaws(laws.of_regions, chains, means, np.zeros(number), shared_compliance(chains, size), size)


def _with(spaces: Spaces, chains: Chains, part: PartLaw, rows: Indices, added: Chains, first: Mask) -> Chains:
    """The chains with those of one more law added in its cells (collective).

    Args:
        spaces: The discrete spaces.
        chains: Chains of all owned cells, or of their vertices.
        part: The law.
        rows: Its cells or vertices.
        added: Its chains there.
        first: Mask of them: those without an earlier law.

    Raises:
        InputError: If the laws of a cell leave no u.
    """
    number, again = len(chains.p), rows[~first]
    try:
        total, empty = chains[again].plus(added[np.flatnonzero(~first)]), False
    except ValueError:
        total, empty = added[:0], True
    if spaces.mesh.comm.allreduce(empty, MPI.LOR):
        raise InputError(f"{part.name} ({part.law.name}): with the laws before it no u is left in some cells")
    others = np.setdiff1d(np.arange(number), rows)
    parts = [(others, chains[others]), (rows[first], added[np.flatnonzero(first)]), (again, total)]
    all_chains = joined(parts, number)
    most = spaces.mesh.comm.allreduce(int(all_chains.count.max(initial=1)), MPI.MAX)
    return replace(
        all_chains,
        p=all_chains.p[:, :most],
        flux=all_chains.flux[:, :most],
        slope=all_chains.slope[:, : most + 1],
        value=all_chains.value[:, : most + 1],
    )


type Allowed = tuple[Datum | None, Datum | None]
"""The least and the largest u that are allowed, None where there is none."""


def _allowed(
    spaces: Spaces, u_D: Datum, on_parts: Sequence[PartLaw]
) -> Iterator[tuple[str, npt.NDArray[np.int32], Allowed]]:
    """What the boundary allows, in words and by facets: on Γ_D u_D alone, on Γ_S what is within the bounds of laws."""
    yield "u_D", spaces.dirichlet_facets, (u_D, u_D)
    for part in on_parts:
        rows = np.setdiff1d(part.rows, spaces.inner.rows)
        yield f"all u that {part.name or 'psi'} allows", spaces.facets[rows], part.bounds


def _check_bounds(spaces: Spaces, part: PartLaw, what: str, facets: npt.NDArray[np.int32], allowed: Allowed) -> None:
    """Make sure that what the boundary allows is within the bounds, in vertices and edge midpoints (collective).

    Raises:
        InputError: On all ranks, with the place where it is worst.
    """
    mesh = spaces.mesh
    points = in_facets(mesh, facets, quadratic_nodes(facet_type(mesh.topology.dim)))
    inside = np.zeros(len(spaces.cell_measures), dtype=bool)
    inside[part.rows] = True
    points = points.among(inside)
    for bound, farthest, sign, side in zip(part.bounds, allowed[::-1], (1.0, -1.0), ("above", "below"), strict=True):
        if bound is None or farthest is None:
            continue
        limit, u = (datum.values(points).ravel() for datum in (bound, farthest))
        most, place = worst_of(mesh.comm, sign * (limit - u), points)
        size = max(mesh.comm.allgather(float(np.abs(u).max(initial=0.0)) + float(np.abs(limit).max(initial=0.0))))
        if most > ROUNDING * size:
            key = next((name for name, datum in part.data.items() if datum is bound), "psi")
            where = "on Γ_D" if what == "u_D" else "on Γ_S"
            raise InputError(
                f"{in_problem(part.key(key))}: is {side} {what} {where}, as at {place_in_words(place)} by {most:.3g}; "
                f"u cannot be both {what if what == 'u_D' else 'one of these'} and {side} it"
            )


def with_reactions(spaces: Spaces, problem: Problem) -> Problem:
    """The problem with the factors of all reactions in c.

    Raises:
        InputError: If a region is unknown, or c or a reaction is a function of points.
    """
    names = "xyz"[: spaces.mesh.geometry.dim]
    for of_law, law in problem.named_laws:
        if isinstance(law, Reaction):
            cells_of(spaces, law, of_law)
            c = parsed(law.c, names, f"{of_law}.c")
            regions = [EVERYWHERE] if EVERYWHERE in law.region else law.region
            added = (
                c
                if EVERYWHERE in regions
                else dict.fromkeys(spaces.domain.regions, exactly(0.0)) | dict.fromkeys(regions, c)
            )
            problem = replace(problem, c=plus(problem.c, added, 1.0, f"{of_law}: c of the problem and of this law"))
    return problem


def plus(
    c: Given | Mapping[str, Given], term: Given | Mapping[str, Given], factor: float, where: str
) -> dict[str, Given] | Given:
    """The sum c + factor·more of data, or of tables of them by region.

    Raises:
        InputError: If one of them is a function of points; `where` says which data they are.
    """
    if isinstance(c, Mapping) or isinstance(term, Mapping):
        names = dict.fromkeys(name for table in (c, term) if isinstance(table, Mapping) for name in table)
        return {name: combined(_of(c, name), _of(term, name), factor, where) for name in names}
    return combined(c, term, factor, where)


def _of(given: Given | Mapping[str, Given], region: str) -> Given:
    return given.get(region, exactly(0.0)) if isinstance(given, Mapping) else given
