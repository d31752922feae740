"""The problem in time: ∂(Cu + θ(u))/∂t − ∇·(κ∇u) + cu = f with C ≥ 0, in equal steps from u = u_0 at t = 0.

With ∂w/∂t ≈ a w_n − Σ_k w_k w_(n−k) for w = Cu + θ each step is a problem with c + aC for c, the law aθ in Ω and the
load f + Σ_k w_k w_(n−k), with all data at the time of the step. w_(n−k) is in P0, and so C has its mean on each cell.
With RT1 w_(n−k) is in P1 on each cell, the projection Π₁(Cu) by the quadrature that the reaction has; there is no θ.

Laws with memory on Γ_S have their state at the beginning of the step, see `discrete/remembered.py`.

θ is a monotone graph, a law of storage; at jumps of it θ is not known from u. What a step leaves is the θ that its
balance has selected, so that nothing is lost. At the start θ is the least value that u_0 allows. With soils steps are
those of `soil_steps.py`.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from ufl import Form

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.owned import owned_values
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.law import EVERYWHERE, VERTICAL, LawWithMemory
from signorini_fenicsx.contact.laws import Corners, Storage
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.discrete.data_values import check_cells
from signorini_fenicsx.discrete.datum import Datum, datum_by_cells, datum_of, regional_datum
from signorini_fenicsx.discrete.part_laws import PartLaw
from signorini_fenicsx.discrete.remembered import Remembered
from signorini_fenicsx.discrete.seen import seen_in_cells
from signorini_fenicsx.expressions import TREES, Binary, Tree, exactly
from signorini_fenicsx.expressions.given import Given, Rows, at_time, is_fixed, parsed
from signorini_fenicsx.expressions.tree import Conditional, Relation
from signorini_fenicsx.meshes.sampling import at_points
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import chains_in, part_in, plus
from signorini_fenicsx.physics.diffusion.discrete.coefficients import cell_means
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import has_soils
from signorini_fenicsx.physics.diffusion.discrete.rt1_data import projected
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.show.states import sizes
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.solving.evolution import Evolution, Past


@dataclass(frozen=True)
class Left:
    """What a step leaves.

    Attributes:
        content: W = Cu + θ.
        columns: What laws with memory remember, see `Remembered`.
    """

    content: fem.Function
    columns: Array


type Pieces = list[tuple[Tree | Rows, Mask | None]] | None


class DiffusionSteps:
    """The problems of the steps on a mesh.

    Attributes:
        spaces: The discrete spaces.
        given: C.
        capacity: Mean of C on each owned cell.
        initial: u_0.
        storage: The laws of θ with their cells, and their chains between u and −θ.
        remembered: The laws with memory.
    """

    def __init__(self, spaces: Spaces, problem: Problem, evolution: Evolution, start: Solution | None = None):
        """Read the data, and take means of C; u of a start takes the place of u_0 (collective).

        Raises:
            InputError: If a text cannot be read, or C or u_0 is not what it has to be.
        """
        dim = spaces.mesh.geometry.dim
        if start is not None:
            evolution = replace(evolution, initial=_carried(start, spaces))
        self.spaces, self._evolution = spaces, evolution
        self._problem = with_storage(problem.in_time(dim), evolution, dim)
        self.storage = [_storage(spaces, law, f"law.{i}") for i, law in _storages(self._problem)]
        self.remembered, self._before = Remembered.among(spaces, self._problem.laws), start
        for some, what in ((self.storage, "storage"), (self.remembered.laws, "laws with memory")):
            if spaces.degree and some:
                raise InputError(f"element: there is no RT1 for {what}; {instead_of_rt1(spaces)}")
        if evolution.scheme != "implicit-euler" and self.remembered.laws:
            raise InputError("[time] scheme: laws with memory need implicit-euler")
        if evolution.scheme != "implicit-euler" and self._jumps():
            raise InputError("[time] scheme: a storage that jumps, as of melting, needs implicit-euler")
        try:
            capacity = parsed(_capacity(evolution, self._problem), "xyz"[:dim], "[time] capacity")
            self.given = regional_datum(spaces, "capacity", capacity)
            self.capacity = self._means("capacity", self.given)
            self.initial = regional_datum(spaces, "initial", parsed(evolution.initial, "xyz"[:dim], "[time] initial"))
        except InputError as error:
            raise InputError(str(error).replace("[problem]", "[time]")) from None
        comm = spaces.mesh.comm
        if (least := comm.allreduce(float(self.capacity.min(initial=np.inf)), MPI.MIN)) < 0:
            raise InputError(f"[time] capacity: must not be negative; its smallest mean over a cell is {least:.3g}")
        stores = self.storage or self.remembered.laws or has_soils(problem.kappa)
        if not stores and not comm.allreduce(bool(self.capacity.any()), MPI.LOR):
            raise InputError("[time] capacity: is 0 everywhere; leave out [time]")

    def _jumps(self) -> bool:
        """Whether the graph of a θ is vertical somewhere (collective)."""
        jumps = any(bool(np.isinf(chains.slope).any()) for _, chains in self.storage)
        return bool(self.spaces.mesh.comm.allreduce(jumps, MPI.LOR))

    def start(self) -> Left:
        """The means of w = Cu + θ over the cells for u_0, of RT1 Π₁(CΠ₁u_0), and the states (collective).

        Raises:
            InputError: If they are not finite, or of no usable size.
        """
        u, columns = self._means("initial", self.initial), self.remembered.start(self._evolution.time(1), self._before)
        if isinstance(self.spaces, RT1Spaces):
            return Left(self._content(projected(self.spaces, self.initial)), columns)
        least = np.zeros_like(u)
        for part, chains in self.storage:
            least[part.rows] -= chains.ends_at(u[part.rows])[0]
        return Left(self._content(u, least), columns)

    def start_given(self) -> Datum | None:
        """W = Cu + θ for u_0 as a text in the points of each cell; None if u_0 is given in Python."""
        pieces = _both(len(self.capacity), self.initial.pieces, self.given.pieces)
        if pieces is None:
            return None
        contents = [(inside, u, Binary("*", c, u)) for inside, u, c in pieces]
        for (_, law), (part, _) in zip(_storages(self._problem), self.storage, strict=True):
            at_start, stores = law.with_data(lambda key, given: at_time(given, 0.0)), np.zeros(len(self.capacity), bool)
            stores[part.rows] = True
            contents = [
                each
                for inside, u, w in contents
                for each in (
                    (inside & ~stores, u, w),
                    (inside & stores, u, Binary("+", w, _least_theta(at_start, u))),
                )
            ]
        return datum_by_cells([(inside, datum_of(self.spaces, "initial", w)) for inside, _, w in contents])

    def _content(self, u: Array, theta: Array | float = 0.0) -> fem.Function:
        """The content of u, given on the owned cells, of RT1 at their vertices (collective)."""
        if isinstance(self.spaces, RT1Spaces):
            return self.spaces.scalar(projected(self.spaces, self.given, u))
        return self.spaces.scalar(self.capacity * u + theta)

    def problem(self, step: int, before: Sequence[Left] = ()) -> Problem:
        """The problem of a step, see `solving.evolution.Steps`.

        Raises:
            InputError: If C was given in Python, or c is a function of points.
        """
        problem = _of_step(self._problem, self._evolution, step, self.spaces.mesh.geometry.dim)
        if not self.remembered.laws:
            return problem
        columns = before[0].columns if before else self.start().columns
        return replace(problem, laws=self.remembered.in_step(problem.laws, columns))

    def touching(self, problem: Problem, solution: Solution) -> Problem | None:
        """The problem with the flux of a solution, see `solving.evolution.Steps` (collective)."""
        if not self.remembered.laws:
            return None
        parts, flux = solution.data.laws.of_parts, solution.flux_at
        if self.remembered.on_curves(parts, solution.p_at, flux, solution.data.conductance):
            return None
        columns = self.remembered.known(problem.laws)
        columns[:, -2] = flux
        return replace(problem, laws=self.remembered.in_step(problem.laws, columns))

    def weights(self, step: int) -> tuple[float, ...]:
        """w_1, w_2, … of a step."""
        return self._evolution.formula(step)[1]

    def rate(self, step: int) -> float:
        """The factor a of a step."""
        return self._evolution.formula(step)[0]

    def left_by(self, solution: Solution) -> Left:
        """The content w = Cu + θ in the space of u, and the states (collective)."""
        return Left(self._content(solution.u_values, self.theta(solution)), self._columns(solution))

    def _columns(self, solution: Solution) -> Array:
        """What the laws with memory remember after a step (collective)."""
        return self.remembered.left_by(solution)

    def theta(self, solution: Solution) -> Array:
        """The θ that the balance of a step has selected, per owned cell; 0 where there is no storage (collective).

        It is what is left of the s of all laws in Ω after those of which u tells s.
        """
        content, laws, step = np.zeros(len(self.capacity)), solution.data.inside, solution.step
        if not self.storage or step is None:
            return content
        u, a = owned_values(solution.u), self.rate(step)
        s = solution.cell_flux.divergence + owned_values(solution.data.source(solution.u))
        numbers = [i for i, _ in _storages(self._problem)]
        for number, (part, chains) in zip(numbers, self.storage, strict=True):
            others, rows = s.copy(), part.rows
            for other in laws.of_regions:
                if other.name != f"law.{number}":
                    ends = chains_in(self.spaces, other).ends_at(u[other.rows])
                    others[other.rows] += (ends[0] + ends[1]) / 2
            most, least = (-end for end in chains.ends_at(u[rows])[::-1])
            alone = len(laws.of_regions) == 1
            content[rows] += others[rows] / a if alone else np.clip(others[rows] / a, least, most)
        return content

    def of_step(self, solution: Solution, _earlier: Mapping[str, float] | None = None) -> dict[str, float]:
        """The integral of the content, where there is storage, and sizes of states (collective)."""
        of_states = {f"{name} {what}": size for name, of in sizes(solution).items() for what, size in of.items()}
        if not self.storage:
            return of_states
        local = float(self.spaces.cell_measures @ owned_values(self.left_by(solution).content))
        return {"content": self.spaces.mesh.comm.allreduce(local)} | of_states

    def halved(self, _failure: NumericalFailure) -> "DiffusionSteps | None":
        """None: each step is a convex problem."""
        return None

    def kept(self, solution: Solution) -> dict[str, npt.NDArray]:
        """u_h, the segments on which the step has ended, and θ if there is storage."""
        on, names = solution.segments(), {"facet_own": "facet"}
        if solution.data.inside:
            names["own"] = "cell"
        kinds = {key: self.spaces.site_kinds[name] for key, name in names.items()}
        segments = {key: on.of(names[key]).reshape(kind.count, *kind.shape) for key, kind in kinds.items()}
        linear = {"u_at": solution.u_values} if self.spaces.degree else {}
        theta = {"theta": self.theta(solution)} if self.storage else {}
        columns = {"facet_remembered": self._columns(solution)} if self.remembered.laws else {}
        return {"u": solution.u_means, **linear, **segments, **theta, **columns}

    def again(self, step: int, kept: Callable[[int, str], npt.NDArray]) -> Past:
        """What the step after this one needs, see `solving.evolution.Steps` (collective)."""
        left = []
        for earlier in range(step, max(step - 2, 0), -1):
            theta = kept(earlier, "theta").ravel() if self.storage else np.zeros_like(self.capacity)
            u = kept(earlier, "u_at") if self.spaces.degree else kept(earlier, "u").ravel()
            columns = kept(earlier, "facet_remembered") if self.remembered.laws else np.empty((0, 0))
            left.append(Left(self._content(u, theta), columns))
        keys = ("facet_own", "own") if self._problem.has_laws_inside else ("facet_own",)
        return Past(step, left, Segments(self.spaces, np.concatenate([kept(step, key).ravel() for key in keys])))

    def memory(self, step: int, before: Sequence[Left]) -> Any:
        """The sum Σ_k w_k w_(n−k) in the space of u, from the last content and those before it."""
        memory = fem.Function(self.spaces.scalar_space, name="memory")
        weights = self.weights(step)
        for weight, left in zip(weights, before[: len(weights)], strict=True):
            memory.x.array[:] += weight * left.content.x.array
        return memory

    def by_earlier(self, step: int, by: Mapping[str, Array]) -> Sequence[tuple[int, Array]]:
        """The derivatives by the contents that earlier steps have left, see `solving.evolution.Steps`."""
        return [(step - back, weight * by["f"]) for back, weight in enumerate(self.weights(step), 1) if step >= back]

    def functional(self, solution: Solution, by: Array) -> tuple[Array, Array]:
        """The derivatives by u and by the s of laws in Ω of each cell, from those by the content w = Cu + θ, θ = s/a.

        Raises:
            InputError: If there are other laws in Ω besides one of storage.
        """
        by_s, laws, step = np.zeros_like(by), solution.data.inside, solution.step
        if self.storage and step is not None:
            if len(laws.of_regions) > 1:
                raise InputError("derivatives in time: there are none with storage beside other laws in Ω")
            rows = self.storage[0][0].rows
            by_s[rows] = by[rows] / self.rate(step)
        return self.capacity * by, by_s

    def at_start(self, by: Array) -> Form:
        """The form of u_0, see `solving.evolution.Steps` (collective).

        Raises:
            InputError: If u_0 is given in UFL, and there are laws of storage.
        """
        if self.initial.pieces is not None:
            return Form([])
        if self.storage:
            raise InputError("derivatives in time: there are none with storage if the initial values are given in UFL")
        cells = np.arange(len(by), dtype=np.int32)
        means = seen_in_cells(self.spaces.Q, self.initial, cells, self.spaces.cell_measures)
        return means.weighted(self.capacity * by)

    def _means(self, key: str, datum: Datum) -> Array:
        means = cell_means(self.spaces, datum)
        check_cells(f"[time] {key}", means, self.spaces)
        return means


def instead_of_rt1(spaces: Spaces) -> str:
    """What to do where there is no RT1."""
    return "pairs of surfaces take no other, so mesh the bodies as one" if spaces.pairs else "take RT0"


def problem_of_step(problem: Problem, evolution: Evolution, step: int, dim: int) -> Problem:
    """The problem of a step, without what it takes from those before, from one that `Problem.in_time` has read.

    Raises:
        InputError: If C was given in Python, or c is a function of points.
    """
    return _of_step(with_storage(problem, evolution, dim), evolution, step, dim)


def _of_step(problem: Problem, evolution: Evolution, step: int, dim: int) -> Problem:
    """The problem of a step from one with all laws of storage."""
    now, (a, _) = problem.at(evolution.time(step)), evolution.formula(step)
    laws = tuple(_scaled(law, a) if isinstance(law, Storage) else law for law in now.laws)
    capacity = parsed(_capacity(evolution, problem), "xyz"[:dim], "[time] capacity")
    if not is_fixed(capacity):
        raise InputError("[time] capacity: must be numbers or texts; data in Python may be in c and the other data")
    return replace(now, c=plus(now.c, capacity, a, "[time]: c and capacity"), laws=laws)


def with_storage(problem: Problem, evolution: Evolution, dim: int) -> Problem:
    """The problem with the graph of `Evolution.capacity`, if it is one, as its last law.

    Raises:
        InputError: If the capacity has `corners` and is no graph.
    """
    graph = evolution.capacity
    if not isinstance(graph, Mapping) or "corners" not in graph:
        return problem
    try:
        law = Storage(region=EVERYWHERE, **graph)  # type: ignore[call-arg]
    except TypeError:
        raise InputError("[time] capacity: a graph has corners, before and beyond") from None
    names = "xyz"[:dim] + "t"
    read = law.with_data(lambda key, given: parsed(given, names, f"[time] capacity {key}"))
    return replace(problem, laws=(*problem.laws, read))


def _capacity(evolution: Evolution, problem: Problem) -> Given | Mapping[str, Given]:
    """The factor C: its default is 0 where there are laws of storage, or with memory."""
    if evolution.capacity is None or (isinstance(evolution.capacity, Mapping) and "corners" in evolution.capacity):
        others = any(isinstance(law, Storage | LawWithMemory) for law in problem.laws)
        return 0.0 if others or has_soils(problem.kappa) else 1.0
    return evolution.capacity


def _storages(problem: Problem) -> Iterator[tuple[int, Storage]]:
    """The laws of storage with their numbers."""
    return ((i, law) for i, law in enumerate(problem.laws) if isinstance(law, Storage))


def _both(number: int, u: Pieces, c: Pieces) -> list[tuple[Mask, Tree, Tree]] | None:
    """The trees of two data with the cells, of so many, in which both hold; None if one has none."""
    if u is None or c is None:
        return None
    everywhere = np.ones(number, dtype=bool)
    pairs = ((one, other, a, b) for one, a in u for other, b in c)
    return [
        (everywhere & (True if a is None else a) & (True if b is None else b), one, other)
        for one, other, a, b in pairs
        if isinstance(one, TREES) and isinstance(other, TREES)
    ]


def _least_theta(law: Storage, u: Tree) -> Tree:
    """The least θ that a graph allows for u."""

    def line(corner: tuple[Given, Given], slope: Given) -> Tree:
        level, theta = (_tree(each) for each in corner)
        rise = Binary("*", _tree(0.0 if slope == VERTICAL else slope), Binary("-", u, level))
        return Binary("+", theta, rise)

    theta = line(law.corners[-1], law.beyond)
    if len(law.corners) == 1 and law.before == law.beyond:
        return theta
    for one, other in itertools.pairwise(reversed(law.corners)):
        if one[0] != other[0]:
            width, height = (Binary("-", _tree(b), _tree(a)) for a, b in zip(other, one, strict=True))
            theta = _up_to(u, one, line(other, Binary("/", height, width)), theta)
    return _up_to(u, law.corners[0], line(law.corners[0], law.before), theta)


def _up_to(u: Tree, corner: tuple[Given, Given], then: Tree, otherwise: Tree) -> Tree:
    return Conditional(Relation("<=", u, _tree(corner[0])), then, otherwise)


def _tree(given: Given) -> Tree:
    return given if isinstance(given, TREES) else exactly(float(given))  # type: ignore[arg-type]


def _scaled(law: Storage, a: float) -> Corners:
    """The law in Ω of a step: a times θ.

    Raises:
        InputError: If its data were given in Python.
    """

    def times(given: Given) -> Given:
        if given == VERTICAL:
            return given
        if not isinstance(given, TREES):
            raise InputError("storage: its data must be numbers or texts")
        return Binary("*", exactly(a), given)

    corners = tuple((u, times(theta)) for u, theta in law.corners)
    before, beyond = (times(end) for end in (law.before, law.beyond))
    scaled: Corners = Corners(  # type: ignore[call-arg]
        region=law.region, corners=corners, before=before, beyond=beyond, names=law.names
    )
    return scaled


def _storage(spaces: Spaces, law: Storage, name: str) -> tuple[PartLaw, Chains]:
    """A law of storage with its cells and chains (collective).

    Raises:
        InputError: If its data are not what they have to be.
    """
    part, _ = part_in(spaces, law.with_data(lambda key, given: at_time(given, 0.0)), name)
    return part, chains_in(spaces, part)


def _carried(solution: Solution, spaces: Spaces) -> fem.Function:
    """Another u_h in the centroids of these cells; for RT1 linear on each by as many points as it has vertices.

    Of RT0 this takes the potential for RT1. Collective.

    Raises:
        InputError: If a point is not in its mesh.
    """
    vertices = spaces.vertices if isinstance(spaces, RT1Spaces) else corners(spaces.mesh)
    dim, u = vertices.shape[2], solution.potential if spaces.degree > solution.spaces.degree else solution.u
    rule = basix.make_quadrature(SIMPLEX[dim], 1 + spaces.degree)[0]
    hats = np.column_stack([1 - rule.sum(axis=1), rule])
    points = np.einsum("pv,nvi->npi", hats, vertices)
    values = at_points(solution.spaces.domain, u, points.reshape(-1, dim)).reshape(points.shape[:2])
    outside = spaces.mesh.comm.allreduce(int(np.isnan(values).any(axis=1).sum()))
    if outside > 0:
        raise InputError(
            f"the start, {solution.name}, has no u in the middle of {outside} cells, which are outside of its mesh; "
            "take one on the same mesh"
        )
    return spaces.scalar(values @ np.linalg.pinv(hats).T if spaces.degree else values)
