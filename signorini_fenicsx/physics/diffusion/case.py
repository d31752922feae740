"""Case files of a scalar u, those without `physics`: one Signorini problem, its discretisation and its algorithm."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Self

from pydantic import BeforeValidator, Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from signorini_fenicsx.cases.case import Cost, Times
from signorini_fenicsx.cases.data_section import DataSection, data_section
from signorini_fenicsx.cases.first_case import GIVEN, HELD
from signorini_fenicsx.cases.pairs import BETWEEN, KINDS, LawTexts, PairTexts, WithPairs
from signorini_fenicsx.cases.parts import PartLists
from signorini_fenicsx.cases.plot import Plot
from signorini_fenicsx.cases.values import ByRegion, ExpressionByRegion, ExpressionOrByPart, choice
from signorini_fenicsx.contact.law import EVERYWHERE, Law, LawWithMemory
from signorini_fenicsx.contact.laws import LAWS, Dirichlet, Neumann, Signorini
from signorini_fenicsx.expressions import exactly
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.meshes.cut import ANY, Side
from signorini_fenicsx.meshes.domain import Boundary as Posed
from signorini_fenicsx.meshes.memory import BYTES_PER_FACET
from signorini_fenicsx.physics.diffusion.dam import Dam, with_dam, without_sections
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import depends_on_u
from signorini_fenicsx.physics.diffusion.evolution import problem_of_step
from signorini_fenicsx.physics.diffusion.problem import NO_RT0, Problem, laws_of
from signorini_fenicsx.physics.diffusion.soil_section import SoilTexts, kappa_of
from signorini_fenicsx.physics.diffusion.soils import FORMS
from signorini_fenicsx.solving.evolution import SCHEMES, Evolution
from signorini_fenicsx.solving.options import ELEMENTS

COSTS = {
    "RT0": {2: Cost(1, BYTES_PER_FACET[2], 177e3, 5e4), 3: Cost(1, BYTES_PER_FACET[3], 196e3, 5e4)},
    "RT1": {2: Cost(2, 4600, 35e3, 15e3), 3: Cost(3, 5000, 11e3, 6e3)},
}
"""Of diffusion by alg1 to alg4 with the hybrid backend, by element; of RT0 on at least 395 000 facets, see
docs/measured/speed.md, of RT1 on 170 000 to 200 000 facets, where seconds are an order of magnitude."""

OF_U = (85.0, 0.3), (15.0, 0.3)
"""`Cost.times` and `least` where κ depends on u, of `earth_dam` on 29 000 facets, and in time of `celia`."""

type CapacityText = str | dict[str, Any]


def _capacity(value: object) -> object:
    """A number or text, a table with one per region, or the graph of a storage."""
    if value is None or not isinstance(value, dict) or "corners" not in value:
        return value if value is None else ByRegion.func(value)  # type: ignore[call-arg]
    graph = LawTexts.model_validate({"kind": "storage", "region": EVERYWHERE, **value})
    return dict(graph.model_extra or {})


OF_LIST = {"u_D": "dirichlet", "g_N": "neumann", "psi": "signorini", "q_S": "signorini"}
"""The data that may be given by part, and the key of `[boundary]` that lists the parts."""
NOTHING = exactly(0)
"""The value on parts without one."""


ELSEWHERE: dict[str, Any] = dict.fromkeys(("exact", "laws", "boundary", "form")) | dict.fromkeys(
    OF_LIST, ExpressionOrByPart
)


class ProblemTexts(data_section(Problem, **ELSEWHERE)):  # type: ignore[misc]
    """`[problem]`: the data of a `Problem` as text in x, y, z.

    κ is a text, a matrix, or one of them per region; f and c are texts, or one per region; b a vector of texts, or one
    per region; u_D, g_N, ψ and q_S are texts, or one per part, and 0 on parts without one.
    """

    form: Annotated[str, choice("form", FORMS)] = Field(default=FORMS[0], exclude_if=lambda form: form == FORMS[0])
    words: ClassVar[tuple[str, ...]] = ("form",)

    @property
    def by_part(self) -> dict[str, dict[str, str]]:
        """The data that are given by part."""
        return {key: getattr(self, key) for key in OF_LIST if isinstance(getattr(self, key), dict)}

    def read(self, names: str, boundary: "ScalarParts") -> Problem:
        """The data as trees in these variables, those that differ between parts as laws.

        Raises:
            InputError: If an expression cannot be read.
        """
        places = {key: f"[problem] {key}" for key, _ in self if key not in self.words}
        data = {key: parsed(getattr(self, key), names + Problem.of_u(place), place) for key, place in places.items()}

        def on(key: str, part: str) -> Any:
            return data[key].get(part, NOTHING) if isinstance(data[key], Mapping) else data[key]

        laws: list[Law] = [Neumann(boundary.impervious, NOTHING)] if boundary.impervious else []
        held = boundary.dirichlet or ["", *self.by_part.get("u_D", ())]
        for kind, keys, parts in (
            (Dirichlet, ("u_D",), held),
            (Neumann, ("g_N",), boundary.neumann or [""]),
            (Signorini, ("psi", "q_S"), boundary.signorini or [""]),
        ):
            first, *others = ([on(key, part) for key in keys] for part in parts)
            laws += [kind([part], *own) for part, own in zip(parts[1:], others, strict=True) if own != first]
            data |= dict(zip(keys, first, strict=True))
        return Problem(**data, laws=laws, form=self.form)


class ScalarParts(PartLists):
    """`[boundary]`: the parts of Γ_S and Γ_N; everything else is Γ_D, whose parts may be listed as a check.

    Parts with a `[[law]]` belong to Γ_S and are not listed here, but for those inside the domain: "inner" has them.
    Thin walls inside, through which nothing flows, are "impervious".
    """

    signorini: list[str] = Field(default=[])
    neumann: list[str] = Field(default=[])
    dirichlet: list[str] | None = None
    impervious: list[str] = Field(default=[], exclude_if=lambda parts: not parts)

    @property
    def named(self) -> dict[str, list[str]]:
        """The lists that are given, by their keys; walls are inner parts."""
        inner = {"inner": [*self.inner, *self.impervious]} if self.impervious else {}
        return super().named | inner


class Time(Times):
    """`[time]` of diffusion."""

    initial: ExpressionByRegion = "0"
    capacity: Annotated[CapacityText | None, BeforeValidator(_capacity)] = None
    scheme: Annotated[str, choice("scheme", tuple(SCHEMES))] = "implicit-euler"

    @property
    def is_storage(self) -> bool:
        """Whether the capacity is the graph of a storage."""
        return isinstance(self.capacity, dict) and "corners" in self.capacity

    def texts(self) -> list[tuple[str, str]]:
        """Each expression with the name of its key; names of segments are none."""
        return [(key, text) for key, text in super().texts() if key != "capacity.names"]


class Exact(DataSection):
    """`[exact]`: the exact solution u, if it is known, as text in x, y, z, or one per region."""

    u: ExpressionByRegion | None = None


FIRST_DATA = (
    ("f = -1", "the source: −∇·(κ∇u) = f", ""),
    ("kappa = 1", "κ, the conductivity", ""),
    ("u_D = 0", "u on the rest", HELD),
    ("g_N = 0", "κ∇u·n on the parts in neumann, with the outer normal n", GIVEN),
    ("psi = -0.1", "u ≥ psi on the parts in signorini", "signorini"),
    ("q_S = 0", "κ∇u·n ≥ q_S there", "signorini"),
)
"""See `CaseFile.first_data`."""


class ScalarPair(PairTexts):
    """`[[pair]]` of a scalar u: perfect contact, or a law between the jump of u and κ∇u·n of the slave."""

    kind: Annotated[str, choice("kind of a pair", ("tied", *BETWEEN))]


COLUMNS_OF_SOIL = {
    "content": ("water", 11, ".5g"),
    "mass_error": ("mass", 8, ".0e"),
    "linear_solves": ("linear", 7, "d"),
    "parts": ("parts", 6, "d"),
}
"""What is printed of a step with soils, see `CaseFile.columns_of_step`."""


class Case(WithPairs):
    """One Signorini problem, its discretisation and its algorithm."""

    PHYSICS: ClassVar[str] = "diffusion"
    first_words = tuple(LAWS)
    first_data = FIRST_DATA
    first_pairs = ("tied", *BETWEEN)
    boundary: ScalarParts = ScalarParts()
    law: Annotated[list[LawTexts], Field(default=[], exclude_if=lambda laws: not laws)]
    problem: ProblemTexts
    pair: Annotated[list[ScalarPair], Field(default=[], exclude_if=lambda pairs: not pairs)]
    soil: Annotated[dict[str, SoilTexts], Field(default={}, exclude_if=lambda soils: not soils)]
    exact: Exact = Exact()
    time: Time | None = None
    dam: Annotated[Dam | None, Field(default=None, exclude_if=lambda dam: dam is None)]
    plot_keys = tuple(key for key in Plot.model_fields if key != "stress_unit")

    @model_validator(mode="before")
    @classmethod
    def _of_dam(cls, tree: dict[str, Any]) -> dict[str, Any]:
        """Add the sections that [dam] stands for."""
        return with_dam(tree)

    @model_serializer(mode="wrap")
    def _without_what_dam_makes(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        tree: dict[str, Any] = dump(self)
        return tree if self.dam is None else without_sections(self.dam, tree)

    @model_validator(mode="after")
    def _has_gamma_s(self) -> Self:
        for key, values in self.problem.by_part.items():
            listed = getattr(self.boundary, OF_LIST[key])
            for part in [] if listed is None else sorted({*values} - {*listed}):
                raise ValueError(f"[problem] {key}: '{part}' is no part in [boundary] {OF_LIST[key]}")
        if self.soil and "kappa" in self.problem.model_fields_set:
            raise ValueError("[soil]: says what κ is; leave out [problem] kappa")
        if self.problem.form != FORMS[0] and not self.soil:
            raise ValueError(f"[problem] form: '{self.problem.form}' is for soils, see [soil]")
        if self.problem.form != FORMS[0] and self.problem.b is not None:
            raise ValueError("[problem] b: with the form 'pressure' gravity is the given flux; leave out b")
        if self.pair and self.solve.element == "RT0":
            raise ValueError(f"[solve] {NO_RT0}")
        if self.soil and self.time is not None and self.time.capacity is not None:
            raise ValueError("[soil]: says what is stored; leave out [time] capacity")
        if EVERYWHERE in self.soil and len(self.soil) > 1:
            raise ValueError(f"[soil.{EVERYWHERE}]: is the soil everywhere; leave out the other soils")
        for i, texts in enumerate(self.law):
            if self.time is None and (texts.kind == "storage" or issubclass(KINDS[texts.kind], LawWithMemory)):
                raise ValueError(f"law.{i}: the law '{texts.kind}' needs [time]")
        return self

    @property
    def costs(self) -> Mapping[int, Cost]:
        """What it costs to solve it with its element, by dimension."""
        costs = COSTS[self.solve.element or ELEMENTS[bool(self.pair)]]
        if not self._of_u:
            return costs
        times, least = OF_U[self.time is not None]
        return {dim: replace(cost, times=times, least=least) for dim, cost in costs.items()}

    @property
    def _of_u(self) -> bool:
        """Whether κ depends on u."""
        return bool(self.soil) or depends_on_u(parsed(self.problem.kappa, "xyztu", "[problem] kappa"))

    @property
    def _stores(self) -> bool:
        return self.time is not None and self.time.is_storage

    @property
    def scheme(self) -> str:
        """The scheme in time, in words."""
        return "" if self.time is None else f" of {self.time.scheme}"

    @property
    def columns_of_step(self) -> dict[str, tuple[str, int, str]]:
        """What is printed of a step besides that of all physics, see `CaseFile.columns_of_step`."""
        if self.soil:
            return COLUMNS_OF_SOIL | super().columns_of_step
        if self.problem.obstacle is None or self._stores or any(law.region for law in self.law):
            return super().columns_of_step
        return {"contact_cells": ("cells", 9, "d"), "cells_measure": ("measure", 11, ".5g")} | super().columns_of_step

    @property
    def unproved(self) -> str:
        """Why `--rigorous` is not for the case; see `CaseFile.unproved`."""
        if self.pair:
            return "the proof is for one mesh, without pairs"
        if self.solve.element == "RT1":
            return "the proof is for RT0 alone; leave out the element"
        if self._of_u:
            return "the proof is for a κ that does not depend on u"
        if self.law or self.problem.by_part:
            return "the proof is for the law of Signorini alone, without [[law]] and data by part"
        if self.problem.b is not None:
            return "the proof is for problems without a given flux b"
        if self.problem.c != "0":
            return "the proof is for c = 0 alone; leave out [problem] c"
        no_obstacle = self.problem.obstacle is None
        return "" if no_obstacle else "the proof is for the law of Signorini alone, without an obstacle"

    @property
    def sides(self) -> Mapping[str, Side]:
        """The named sides of inner parts; those of walls do not matter."""
        return self.boundary.sides | dict.fromkeys(self.boundary.impervious, ANY)

    @property
    def lists(self) -> dict[str, list[str]]:
        """The parts of laws, and those of a u_D by part, see `CaseFile.lists`."""
        held = [*self.problem.u_D] if self.boundary.dirichlet is None and "u_D" in self.problem.by_part else []
        return super().lists | ({"problem.u_D": held} if held else {})

    def posed(self, dim: int) -> Problem:
        """The data as trees, with the exact u if it is given, and the parts, see `CaseFile.posed`."""
        names = "xyz"[:dim] + ("" if self.time is None else "t")
        exact = None if self.exact.u is None else parsed(self.exact.u, names, "[exact] u")
        problem = self.problem.read(names, self.boundary)
        pairs = [pair.made() for pair in self.pair]
        laws = [*(law.made() for law in self.law), *problem.laws, *(law for pair in pairs for law in laws_of(pair))]
        with_laws = [part for law in laws for part in law.parts]
        neumann = [part for part in self.boundary.neumann if part not in with_laws]
        boundary = Posed(self.boundary.signorini, neumann, self.inner, [pair.on_boundary for pair in pairs])
        problem = replace(problem, exact=exact, laws=laws, boundary=boundary)
        return replace(problem, kappa=kappa_of(self.soil)) if self.soil else problem

    def _of_step(self, posed: Problem, evolution: Evolution, step: int, dim: int) -> Problem:
        return problem_of_step(posed, evolution, step, dim)
