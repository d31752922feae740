"""Its problem, its solution and its system; `Solved`, `System` and `Run` say what their methods are."""
# ruff: noqa: D102

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import owned_values, set_owned
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.kept_backend import KeptBackend
from signorini_fenicsx.contact.residuals import Residuals
from signorini_fenicsx.discrete.contact_sets import FacetSet
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces, build_mesh_spaces
from signorini_fenicsx.discrete.site_table import FacetTable, along_parts
from signorini_fenicsx.meshes.domain import Domain, facet_vertices
from signorini_fenicsx.solution import Solution
from signorini_fenicsx.solving.evolution import Evolution, Past
from signorini_fenicsx.solving.fields import IN_CELLS, Field


@dataclass(frozen=True)
class Edges:
    """The parts of Γ."""

    rests: Sequence[str]
    physics: ClassVar[str] = "springs"

    @property
    def named(self):
        return {"rests": self.rests}


@dataclass(frozen=True)
class Bed:
    """k and f, as numbers, and the parts of Γ."""

    k: float
    f: float
    boundary: Edges

    def on(self, domain: Domain):
        return self


@dataclass(frozen=True)
class Balance(Residuals):
    """The largest |ku − load| where u > 0."""

    balance: float


@dataclass(frozen=True)
class Distance:
    """‖u − u'‖."""

    u_L2: float


@dataclass(frozen=True, repr=False, kw_only=True)
class Rested(Solution):
    """A bed at rest."""

    problem: Bed
    spaces: MeshSpaces
    data: Array
    kkt: Balance
    order = 1

    @property
    def p(self):
        return self.u.x.array[self.spaces.cells]

    def contact_set(self):
        return FacetSet(self.spaces, self.outcome.conditions.kind == Condition.ZERO_TRACE)

    def norms(self):
        square = self.spaces.mesh.comm.allreduce(self.spaces.cell_measures @ self.u.x.array**2)
        return {"u_L2": float(np.sqrt(square))}

    sizes = norms

    def errors(self):
        return None

    def segments(self):
        """None: what a bed does needs no start."""

    def _sets(self):
        return {"dofs": self.outcome.dofs, "contact_facets": self.contact.facets}

    def _particular(self):
        return {}

    def lines(self, summary):
        return {"contact": f"{summary['contact_facets']} facets"}

    def differences(self, coarse):
        assert np.array_equal(coarse.spaces.domain.cells, self.spaces.domain.cells)
        return Distance(float(np.linalg.norm(self.u.x.array - coarse.u.x.array)))

    def fields(self):
        return {IN_CELLS: [Field("u", self.u.x.array, at_points=True)], "rests": [Field("u", self.p)]}

    def table(self):
        spaces, none = self.spaces, np.zeros(len(self.spaces.facets))
        x = spaces.mesh.geometry.x[spaces.mesh.geometry.dofmaps[0][spaces.cells]].mean(axis=1).reshape(-1, 3)
        part = spaces.part_of_facet.astype(np.int64)
        return FacetTable(
            part=part,
            along=along_parts(spaces, part, x),
            x=x,
            measure=spaces.facet_measure,
            p=self.p,
            flux=none,
            condition=self.outcome.conditions.kind.astype(np.int64),
            segment=none.astype(np.int64),
            vertices=facet_vertices(spaces.mesh, spaces.facets),
        )

    def columns(self, table):
        return {"x": table.x[:, 0], "u": table.p}


class System:
    """The spaces of a bed."""

    def __init__(self, domain: Domain, problem: Bed):
        self.boundary, self.kept = problem.boundary, KeptBackend()
        self.spaces = build_mesh_spaces(domain, problem.boundary.rests)

    def prepared(self, problem: Bed, wish: Any):
        load = np.full(len(self.spaces.cell_measures), problem.f) + (0.0 if wish.memory is None else wish.memory)
        return Run(self.spaces, problem, load)

    def steps(self, problem: Bed, evolution: Evolution, start: Any, options: Any):
        return Settling(self.spaces, problem, evolution)


@dataclass
class Settling:
    """The steps of a bed."""

    spaces: MeshSpaces
    given: Bed
    evolution: Evolution

    def start(self):
        return 0.0

    def touching(self, problem: Bed, solution: Rested):
        return None

    def problem(self, step: int, before: Sequence[Any] = ()):
        return replace(self.given, f=self.given.f * self.evolution.time(step))

    def memory(self, step: int, before: Sequence[Any]):
        return before[0]

    def left_by(self, solution: Rested):
        return solution.data

    def of_step(self, solution: Rested, earlier: Any = None):
        return {}

    def halved(self, failure: Any):
        return None

    def kept(self, solution: Rested):
        return {"load": solution.data}

    def again(self, step: int, kept: Any):
        return Past(step, [kept(step, "load")], None)


@dataclass
class Run:
    """A bed that is not at rest yet."""

    spaces: MeshSpaces
    problem: Bed
    load: Array

    def outcome(self):
        u, cells = fem.Function(self.spaces.Q, name="u"), self.spaces.cells
        set_owned(u, self.load / self.problem.k)
        u.x.array[cells] = np.maximum(u.x.array[cells], 0.0)
        return Outcome(*state(self.spaces, u), [], "all springs rest", True, "springs", len(u.x.array), "none")

    def judged(self, outcome: Outcome):
        return outcome, residuals(self.problem, outcome.iterate.u, self.load)

    def solution(self, outcome: Outcome, **about: Any):
        return Rested(
            spaces=self.spaces,
            data=self.load,
            outcome=outcome,
            **about,
        )


def state(spaces: MeshSpaces, u: fem.Function):
    """The last solution and its conditions."""
    dim, p = spaces.mesh.geometry.dim, u.x.array[spaces.cells]
    sigma = fem.Function(fenicsx.function_space(spaces.mesh, ("DG", 0, (dim,))), name="sigma")
    kind = np.where(p > 0, Condition.NO_FLUX, Condition.ZERO_TRACE).astype(np.int8)
    return Iterate(p=p, flux=0 * p, linear_iterations=0, sigma=sigma, u=u), SiteConditions(kind)


def residuals(problem: Bed, u: fem.Function, load: Array):
    """How far the springs are from rest under a load per cell."""
    values = owned_values(u)
    left = np.abs(problem.k * values - load)[values != 0].max(initial=0.0)
    return Balance(float(max(u.function_space.mesh.comm.allgather(left))))
