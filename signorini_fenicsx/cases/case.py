"""Cases: the problem, its domain and its algorithm, read from TOML and validated before anything runs."""

import os
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import ufl
from pydantic import Field, ValidationError, model_validator

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.shipped import file_of
from signorini_fenicsx.cases.complaints import complaint, keys_of, shown, told
from signorini_fenicsx.cases.data_section import DataSection
from signorini_fenicsx.cases.geometry import Geometry
from signorini_fenicsx.cases.parts import Named, PartLists, Section
from signorini_fenicsx.cases.plot import Plot
from signorini_fenicsx.cases.quantities import QuantityTexts
from signorini_fenicsx.cases.readings import ProbeTexts, SectionTexts, check_names, with_points
from signorini_fenicsx.cases.toml_files import read_toml
from signorini_fenicsx.cases.values import Positive, Whole, choice, within
from signorini_fenicsx.expressions import depends_on, parse_expression, read
from signorini_fenicsx.meshes.cut import Side
from signorini_fenicsx.meshes.domain import coordinate_element
from signorini_fenicsx.meshes.shapes import Shape, shape_of
from signorini_fenicsx.methods.registry import METHODS, Method
from signorini_fenicsx.quantities.bracket import QUANTITY, VALUE
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.options import BACKENDS, ELEMENTS
from signorini_fenicsx.solving.physics import DIFFUSION, PHYSICS


class Solve(Section):
    """`[solve]`: the algorithm and its parameters; with `predict` large problems start from the sets of a coarser mesh.

    If rho or max_iterations is missing, the default of the algorithm is used.
    """

    algorithm: Annotated[str, choice("algorithm", tuple(METHODS))] = "alg1"
    backend: Annotated[str, choice("backend", tuple(BACKENDS))] = "hybrid"
    element: Annotated[str, choice("element", ELEMENTS)] | None = None
    h: Annotated[Positive, within(1e-90, 1e90)] = 2**-5  # powers of h must be floats
    rho: Annotated[Positive, within(1e-100, 1e100)] | None = None
    eps: Annotated[Positive, within(1e-14, 1e6)] = 1e-8
    max_iterations: Annotated[Whole, within(1, 10**6)] | None = None
    predict: bool = True


class Times(DataSection):
    """`[time]`: the steps of an `Evolution`. With it t is known to all expressions but those of this section."""

    words = ("end", "steps", "scheme")
    end: Annotated[Positive, within(1e-90, 1e90)]
    steps: Annotated[Whole, within(1, 10**6)]

    def evolution(self) -> Evolution:
        """The times for `evolve`."""
        return Evolution(**dict(self))


@dataclass(frozen=True)
class Cost:
    """What a facet costs, as measured; certificate and output included.

    Attributes:
        unknowns: Unknowns of the linear system.
        memory: Bytes.
        solver_rate: Facets per second and core from the assembled problem to the solution.
        run_rate: Facets per second and core of a whole run, with a structured mesh.
        times: So many times as long takes what is not linear.
        least: Seconds that it takes at least.
    """

    unknowns: int
    memory: float
    solver_rate: float
    run_rate: float
    times: float = 1.0
    least: float = 0.0


class CaseFile(Section):
    """What all case files have.

    Attributes:
        name: Short name, used for the default output folder; not a key of the file.
    """

    WORD: ClassVar[str] = "Case"
    PHYSICS: ClassVar[str]
    """The name of the physics."""
    name: str = Field(default="case", exclude=True)
    title: str = ""
    geometry: Geometry
    solve: Solve = Solve()
    time: Annotated[Times | None, Field(default=None, exclude_if=lambda time: time is None)]
    quantity: Annotated[list[QuantityTexts], Field(default=[], exclude_if=lambda quantities: not quantities)]
    probe: Annotated[list[ProbeTexts], Field(default=[], exclude_if=lambda probes: not probes)]
    section: Annotated[list[SectionTexts], Field(default=[], exclude_if=lambda sections: not sections)]
    boundary: PartLists
    law: Annotated[Sequence[Any], Field(default=[], exclude_if=lambda laws: not laws)]
    problem: DataSection
    exact: DataSection
    plot: Annotated[Plot | None, Field(default=None, exclude_if=lambda plot: plot is None)]
    plot_keys: ClassVar[Sequence[str]] = ()
    """The keys of `[plot]`."""
    inner_needs: ClassVar[str] = "a [[law]] between the jump of u and σ·n"
    """What a part inside the domain needs, in words."""
    held: ClassVar[str] = "u = u_D"
    """What holds on Γ_D, in words."""
    is_vector: ClassVar[bool] = False
    """Whether u is a vector."""
    first_words: ClassVar[Sequence[str]]
    """What may hold on a part of a first case, in a word, besides a given u or flux; first what has no law."""
    first_listed: ClassVar[Sequence[str]] = ()
    """Those whose parts `[boundary]` lists under the first one, if others than that."""
    first_data: ClassVar[Sequence[tuple[str, str, str]]]
    """The lines of `[problem]` of a first case, what they are, and the words of parts that need them, if some do."""
    first_laws: ClassVar[Mapping[str, tuple[str, list[str]]]] = {}
    """What laws in a first case say, and the lines of their data, for those that are no `Law`."""
    first_pairs: ClassVar[Sequence[str]] = ()
    """The kinds of pairs of bodies with meshes of their own."""

    @property
    def states(self) -> tuple[str, str]:
        """What reports call sites under the conditions NO_FLUX and ZERO_TRACE."""
        return "σ·n = 0", "p = 0"

    @property
    def parts(self) -> Named:
        """All parts that are named."""
        return self.boundary.with_lists(self.lists)

    @property
    def lists(self) -> dict[str, list[str]]:
        """The parts of each `[[law]]`, and other lists beside those of `[boundary]`, by their keys."""
        return {f"law.{i}.parts": law.parts for i, law in enumerate(self.law) if law.parts}

    @property
    def meeting(self) -> list[str]:
        """The parts that may be inside the domain: those with a law."""
        return [part for law in self.law for part in law.parts]

    def posed(self, dim: int) -> Any:
        """The problem, in time with t in it, sorted by the kinds of its boundary, as `Solver` takes it.

        Raises:
            InputError: If an expression cannot be read.
        """
        raise NotImplementedError

    def at_step(self, posed: Any, step: int | None, dim: int) -> Any:
        """The problem of a step, from that with t in it; itself if there are no steps.

        Raises:
            InputError: If an expression cannot be read.
        """
        if step is None or self.time is None:
            return posed
        return self._of_step(posed.in_time(dim), self.time.evolution(), step, dim)

    def _of_step(self, posed: Any, evolution: Evolution, step: int, _dim: int) -> Any:
        return posed.at(evolution.time(step))

    @property
    def last_time(self) -> float | None:
        """The end of a problem in time; None for others."""
        return None if self.time is None else self.time.end

    @property
    @abstractmethod
    def costs(self) -> Mapping[int, Cost]:
        """What it costs to solve it, by dimension."""

    @property
    def steps(self) -> int:
        """Number of steps of a problem in time; 0 for others."""
        return 0 if self.time is None else self.time.steps

    @property
    def scheme(self) -> str:
        """The scheme in time, in words; empty if there is none."""
        return ""

    @property
    def columns_of_step(self) -> dict[str, tuple[str, int, str]]:
        """What is printed of a step besides that of all physics: title, width and format of some keys of its row."""
        return {f"{QUANTITY}{each.name}{VALUE}": (each.name, max(11, len(each.name)), ".5g") for each in self.quantity}

    @property
    def inner(self) -> list[str]:
        """The parts inside the domain."""
        return self.parts.named.get("inner", [])

    @property
    def sides(self) -> Mapping[str, Side]:
        """The named sides of some of them."""
        return self.boundary.sides

    def texts(self) -> list[tuple[str, str, bool]]:
        """Each expression with its place, and whether t is known to it in a problem in time."""
        laws = [(f"law.{i}.", law.texts(), True) for i, law in enumerate(self.law)]
        quantities = [(f"quantity.{i}.", quantity.texts(), False) for i, quantity in enumerate(self.quantity)]
        of_time = [] if self.time is None else self.time.texts()
        sections = [("[problem] ", self.problem.texts(), True), ("[exact] ", self.exact.texts(), True)]
        sections += [*laws, *quantities, ("[time] ", of_time, False)]
        return [(f"{place}{key}", text, may_move) for place, own, may_move in sections for key, text in own]

    def condition_of(self, part: str) -> str:
        """The condition on a part, in a word: of a law its kind."""
        return next((law.kind for law in self.law if part in law.parts), self.boundary.condition_of(part))

    @model_validator(mode="after")
    def _measures_once(self) -> Self:
        names = [quantity.name for quantity in self.quantity]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise ValueError(f"quantity.{i}.name: '{name}' is the name of two quantities")
        check_names(self.probe, self.section)
        return self

    @model_validator(mode="after")
    def _is_drawn_with_its_words(self) -> Self:
        for key in self.plot.model_fields_set.difference(self.plot_keys) if self.plot is not None else ():
            known = f"it has {', '.join(self.plot_keys)}" if self.plot_keys else "it has none"
            raise ValueError(f"[plot] {key}: {self.PHYSICS} has no such key; {known}")
        return self

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.geometry.shape is not None:
            self._check_shape(shape_of(self.geometry.shape))
        elif self.file_h is not None and not self.geometry.takes_h:
            raise ValueError(f"[solve] h: the mesh of '{self.geometry.name}' has its own h; leave h out")
        elif self.file_h is None and (body := self.geometry.needs_h) is not None:
            raise ValueError(f"[geometry] bodies.{body}: needs h, the largest cell diameter; or give h in [solve]")
        else:
            self._check_expressions(3)  # the mesh file has not been read yet
        return self

    @model_validator(mode="after")
    def _lists_parts_once(self) -> Self:
        self.parts.refuse_repetition()
        self.boundary.check_inner(self.meeting, self.geometry.shape is None, self.inner_needs)
        return self

    @property
    def file_h(self) -> float | None:
        """The h for the mesh of a `.geo` file or of bodies, or None."""
        return self.solve.h if self.geometry.shape is None and "h" in self.solve.model_fields_set else None

    @property
    def fineness(self) -> str:
        """The mesh size in words, before there is a mesh."""
        asked = self.solve.h if self.geometry.shape is not None else self.file_h
        return f"mesh {self.geometry.name}" if asked is None else f"h ≤ {asked:g}"

    @property
    def method(self) -> Method:
        """The method that solves it."""
        return METHODS[self.solve.algorithm]

    @property
    def approach(self) -> str:
        """What is solved and how, in words."""
        return self.method.title

    @property
    def unproved(self) -> str:
        """Why `--rigorous` is not for the case, in words; empty if it is."""
        raise NotImplementedError

    def check_dimension(self, dim: int) -> None:
        """Refuse coordinates that a mesh read from a file does not have.

        Raises:
            InputError: If an expression uses such a coordinate.
        """
        try:
            self._check_expressions(dim)
        except ValueError as error:
            raise InputError(str(error)) from None

    def _check_shape(self, shape: Shape) -> None:
        self.parts.check(shape.names, self.geometry.name, shape.inside)
        if self.solve.h > shape.diameter:
            raise ValueError(
                f"[solve] h: {self.solve.h:g} is larger than the domain, whose diameter is {shape.diameter:.4g}"
            )
        self._check_expressions(shape.dim)

    def _check_expressions(self, dim: int) -> None:
        x = reference_coordinate(dim)
        for place, text, may_move in self.texts():
            with told(f"{place}: "):
                if not place.startswith("[problem] kappa") or not depends_on(read(text, "xyz"[:dim] + "tu"), "u"):
                    parse_expression(text, x, self.last_time if may_move else None)

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """Return a validated copy with new values of keys such as `solve.h` or `geometry.mesh`.

        Raises:
            InputError: If a key or value is not valid.
        """
        tree = self.model_dump(exclude_unset=True)
        for key, value in values.items():
            *sections, last = key.split(".")
            branch: Any = tree
            for section in sections:
                branch = _below(branch, section, key)
            if not isinstance(branch, dict):
                raise InputError(f"{key}: no such key in a case")
            branch[last] = value
        return validated(type(self), tree, self.name, "case " + self.name)


def _below(branch: Any, section: str, key: str) -> Any:
    """A section of a part of a case, new if there is none; of a list, such as that of [[law]], by its number."""
    if isinstance(branch, list):
        if section not in map(str, range(len(branch))):
            raise InputError(f"{key}: there is no number {section}, there are {len(branch)}, the first with number 0")
        return branch[int(section)]
    if not isinstance(branch, dict):
        raise InputError(f"{key}: no such key in a case")
    if section in ("law", "pair", "quantity", "probe", "section") and section not in branch:
        raise InputError(f"{key}: the case has no [[{section}]]")
    return branch.setdefault(section, {})


def reference_coordinate(dim: int) -> ufl.SpatialCoordinate:
    """Coordinate of a domain of this dimension that has no mesh yet."""
    return ufl.SpatialCoordinate(ufl.Mesh(coordinate_element(dim)))


def load_case(name_or_path: str | Path) -> Any:
    """Read a case of any physics by name (`example1`) or path (`my/case.toml`).

    Returns:
        A `Case`, or the case of another physics.

    Raises:
        InputError: If there is no such case, or it is malformed; the message names file, key and reason.
    """
    return case_of(*read_case_file(name_or_path))


def case_of(tree: dict[str, Any], path: Path) -> Any:
    """A case of any physics from the keys of its file, as `load_case` gives it.

    Raises:
        InputError: If they are malformed.
    """
    if "physics" not in tree:
        try:
            return validated(PHYSICS[DIFFUSION].case, tree, path.stem, str(path))
        except InputError as error:
            raise InputError(f"{error}{_of_other_physics(tree)}") from None
    if not isinstance(tree["physics"], str) or not _is_other(tree["physics"]):
        names = " or ".join(f'"{name}"' for name in _others())
        raise InputError(f"{path}: physics: unknown {shown(tree['physics'])}; use {names}, or leave it out")
    model = PHYSICS[tree["physics"]].case
    for key in [key for key in tree if key not in model.model_fields]:  # which imports all physics
        if others := [name for name in (DIFFUSION, *_others()) if key in PHYSICS[name].case.model_fields]:
            raise InputError(f"{path}: [{key}] is of {' and '.join(others)}; {tree['physics']} has none")
    return validated(model, tree, path.stem, str(path))


def _others() -> list[str]:
    """The physics with case files, but for diffusion."""
    return [name for name in PHYSICS if _is_other(name)]


def _is_other(name: str) -> bool:
    """Whether this is a physics with case files, but for diffusion; imports no other one."""
    return name in PHYSICS and name != DIFFUSION and PHYSICS[name].case is not None


def _of_other_physics(tree: dict[str, Any]) -> str:
    """What to say of a key in a file without `physics` that only the cases of another one have; "" if there is none."""
    for physics in _others():
        for section in ("problem", "boundary"):
            models = [PHYSICS[name].case.model_fields[section].annotation for name in (physics, DIFFUSION)]
            theirs, ours = (set(getattr(model, "model_fields", {})) for model in models)
            keys = tree.get(section)
            if isinstance(keys, dict) and (foreign := [key for key in keys if key in theirs - ours]):
                return f"; '{foreign[0]}' is of {physics}, which needs physics = \"{physics}\""
    return ""


def read_case_file(name_or_path: str | Path) -> tuple[dict[str, Any], Path]:
    """The keys of a case file, with the path of its mesh as seen from here, and its place.

    Raises:
        InputError: If there is no such case, or it is no TOML.
    """
    path = file_of("case", name_or_path)
    return seen_from_here(read_toml(path), path.parent), path


def seen_from_here(tree: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The keys of a case file in this folder, with the paths of its mesh and of surfaces as seen from here.

    Probes have the points of their files then.

    Raises:
        InputError: If such a file cannot be read.
    """
    laws, geometry = tree.get("law"), tree.get("geometry")
    bodies = geometry.get("bodies") if isinstance(geometry, dict) else None
    places = [(geometry, "file"), *((law, "surface") for law in (laws if isinstance(laws, list) else []))]
    for name, body in bodies.items() if isinstance(bodies, dict) else ():
        places.append((bodies, name) if isinstance(body, str) else (body, "file"))
    for section, key in places:
        if isinstance(section, dict) and isinstance(file := section.get(key), str):
            section[key] = os.path.normpath(folder / file)
    if isinstance(probes := tree.get("probe"), list):
        tree["probe"] = [with_points(probe, folder) if _has_file(probe) else probe for probe in probes]
    return tree


def _has_file(probe: object) -> bool:
    return isinstance(probe, dict) and isinstance(probe.get("file"), str)


def validated[C: CaseFile](model: type[C], tree: dict[str, Any], name: str, source: str) -> C:
    """A case from its keys.

    Raises:
        InputError: If they are not valid; the message names source, key and reason.
    """
    if "name" in tree:
        raise InputError(f"{source}: unknown key 'name'; known are {', '.join(keys_of(model))}")
    try:
        return model.model_validate(tree | {"name": name})
    except ValidationError as error:
        raise InputError(f"{source}: {complaint(error, model)}") from None
