"""Studies: a case and lists of values, expanded into runs; read from TOML and validated before anything runs."""

import hashlib
import itertools
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, ValidationError, model_validator

from signorini_fenicsx.base.errors import InputError, reading, telling
from signorini_fenicsx.base.shipped import file_of
from signorini_fenicsx.base.version import __version__
from signorini_fenicsx.cases.case import CaseFile, Solve, load_case
from signorini_fenicsx.cases.complaints import complaint
from signorini_fenicsx.cases.domains import rough_cells
from signorini_fenicsx.cases.parts import Section
from signorini_fenicsx.cases.toml_files import read_toml
from signorini_fenicsx.comparing.convergence import Vary, level_values
from signorini_fenicsx.methods.registry import methods_that

SHORT = tuple(Solve.model_fields)
"""Keys of [solve] that a study may write without `solve.`"""
MAX_RUNS = 100_000
"""Largest number of runs; more are regarded as a mistake in the lists."""

type Level = Annotated[int, Field(ge=0, le=30, strict=True)]


class Convergence(Section):
    """`[convergence]`: each run measures errors, as `signorini convergence` does, instead of solving once."""

    vary: Vary = Vary.H
    levels: list[Level] = Field(min_length=1)
    reference: Level = 8

    @model_validator(mode="after")
    def _levels_get_finer(self) -> Self:
        if any(one >= other for one, other in itertools.pairwise(self.levels)):
            raise ValueError(f"levels must ascend, not {self.levels}")
        if self.vary is not Vary.EPS and max(self.levels) >= self.reference:
            raise ValueError(f"reference = {self.reference} must be finer than the last level, {max(self.levels)}")
        return self


class Study(Section):
    """A study file.

    Attributes:
        name: Short name, used for the default output folder; not a key of the file.
        title: Title of the study.
        case: Name or path of the case, unless the case is varied.
        ranks_per_run: Number of ranks for one run.
        fields: Whether each run also writes its fields for ParaView.
        plot: Whether each run also draws its pictures.
        set: Values of all runs.
        vary: Lists of values. The runs are all their combinations; the last list varies fastest.
        together: Groups of equally long lists that vary together; a group acts like one list of `vary`.
        convergence: The errors that each run measures, or None for one solve per run.
    """

    name: str = Field(default="study", exclude=True)
    title: str = ""
    case: str | None = None
    ranks_per_run: int = Field(default=1, ge=1, le=10**6, strict=True)
    fields: bool = False
    plot: bool = False
    set: dict[str, Any] = Field(default={})
    vary: dict[str, Any] = Field(default={})
    together: list[dict[str, Any]] = Field(default=[])
    convergence: Convergence | None = None


@dataclass(frozen=True)
class Run:
    """One run of a study.

    Attributes:
        name: Name of its folder. It contains a digest of everything that determines the result, so equal runs of
            different studies have the same name, and a changed run gets another one.
        case: The case.
        convergence: The errors to measure, or None for one solve.
        fields: Whether to write fields for ParaView.
        plot: Whether to draw pictures.
        cells: Rough number of cells of all its meshes, as a measure of its work.
    """

    name: str
    case: CaseFile
    convergence: Convergence | None
    fields: bool
    plot: bool
    cells: float

    @property
    def parameters(self) -> dict[str, Any]:
        """All keys of the case, dotted, with their values; those of [solve] come last."""
        return {"case": self.case.name} | flattened(self.case.model_dump(mode="json", exclude={"title"}))


def flattened(tree: Mapping[str, Any], prefix: str = "", *, into_lists: bool = True) -> dict[str, Any]:
    """Turn nested dictionaries, and unless `into_lists` is false lists of them, into one with dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        if into_lists and isinstance(value, list) and value and all(isinstance(entry, dict) for entry in value):
            value = {str(i): entry for i, entry in enumerate(value)}
        if isinstance(value, dict):
            flat |= flattened(value, f"{prefix}{key}.", into_lists=into_lists)
        else:
            flat[prefix + key] = value
    return flat


def load_study(name_or_path: str | Path) -> tuple[Study, list[Run]]:
    """Read a study by name or path and expand it into its runs; equal runs are listed once.

    Raises:
        InputError: If there is no such study, or if the study or one of its cases is malformed.
    """
    path = file_of("study", name_or_path)
    tree = read_toml(path)
    with telling(path):
        if "name" in tree:
            raise InputError("unknown key 'name'; the name of a study is that of its file")
        try:
            study = Study.model_validate(tree | {"name": path.stem})
            return study, expanded(study, path.parent)
        except ValidationError as error:
            raise InputError(complaint(error, Study)) from None
        except RecursionError:
            raise InputError("nested too deeply") from None


def expanded(study: Study, folder: Path) -> list[Run]:
    """The runs of a study, in its order; equal runs are listed once.

    Args:
        study: The study.
        folder: Folder to which paths of its cases are relative.

    Raises:
        InputError: If lists or values are not valid.
    """
    fixed = _values("set", study.set)
    axes = [[{key: value} for value in _list(key, values)] for key, values in _values("vary", study.vary).items()]
    axes += [_in_step(_values("together", group)) for group in study.together]
    keys = [key for axis in axes for key in axis[0]]
    twice = [key for key in keys if keys.count(key) > 1]
    if twice:
        raise InputError(f"{twice[0]}: varies in two places")
    count = math.prod(map(len, axes))
    if count > MAX_RUNS:
        raise InputError(f"asks for {count} runs; at most {MAX_RUNS} are made")
    runs: dict[str, Run] = {}
    for combination in itertools.product(*axes):
        values = fixed | {key: value for part in combination for key, value in part.items()}
        run = _run(study, folder, values)
        runs.setdefault(run.name, run)
    return list(runs.values())


def _values(section: str, tree: Mapping[str, Any]) -> dict[str, Any]:
    """A section with dotted keys; `solve.` is added where it was left out."""
    values: dict[str, Any] = {}
    for short, value in flattened(tree, into_lists=section == "set").items():  # what varies may be tables
        key = f"solve.{short}" if short in SHORT else short
        if key in values:
            raise InputError(f"[{section}] {key}: is given twice")
        values[key] = value
    if section == "set" and "case" in values:
        raise InputError("[set] case: belongs to the top of the file")
    return values


def _list(key: str, values: object) -> list[Any]:
    if not isinstance(values, list) or not values:
        raise InputError(f"[vary] {key}: must be a list of values, not {values!r}")
    return values


def _in_step(lists: dict[str, Any]) -> list[dict[str, Any]]:
    lengths = {key: len(_list(key, values)) for key, values in lists.items()}
    if len(set(lengths.values())) != 1:
        raise InputError(f"[[together]]: the lists must be equally long, not {lengths}")
    return [dict(zip(lists, values, strict=True)) for values in zip(*lists.values(), strict=True)]


def _run(study: Study, folder: Path, values: dict[str, Any]) -> Run:
    values = dict(values)
    name = values.pop("case", study.case)
    if not isinstance(name, str):
        raise InputError("case: must be the name or path of a case, at the top of the file or in a list of [vary]")
    path = folder / name
    case = load_case(path if name.endswith(".toml") else name).with_values(values)
    task = study.convergence
    if task is not None and task.vary is not Vary.H and not case.method.has_eps:
        penalised = methods_that(lambda method: method.has_eps)
        raise InputError(f"[convergence] vary: {case.solve.algorithm} has no ε; {penalised} have it")
    if task is not None:
        for level in task.levels:
            case.with_values(level_values(task.vary, level))  # raises now, not after other runs
    return make_run(case, task, fields=study.fields, plot=study.plot)


def _file_digest(path: str) -> str:
    """Digest of a mesh file, because a run is identified by its mesh, not by the name of the file (rank 0).

    Raises:
        InputError: If the file cannot be read.
    """
    with reading(f"mesh {path}"):
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def make_run(case: CaseFile, task: Convergence | None = None, *, fields: bool = False, plot: bool = False) -> Run:
    """A run; its name contains a digest of its contents.

    Keys with default values do not enter the digest, so old runs stay valid when a new key is introduced.
    """
    values = flattened(case.model_dump(mode="json", exclude_defaults=True))
    values |= {key: _file_digest(file) for key, file in case.geometry.files.items()}
    if case.file_h is not None:  # without h, a `.geo` file uses its own sizes
        values["solve.h"] = case.file_h
    content = {
        "version": __version__,
        "case": case.name,
        "values": values,
        "convergence": None if task is None else task.model_dump(mode="json", exclude_defaults=True),
        "fields": fields,
        "plot": plot,
    }
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
    return Run(f"{case.name}-{case.solve.algorithm}-{digest}", case, task, fields, plot, sum(_cells(case, task)))


def _cells(case: CaseFile, task: Convergence | None) -> Iterator[float]:
    """Rough sizes of the meshes of a run."""
    if task is None:
        yield rough_cells(case)
    elif task.vary is Vary.EPS:
        yield (len(task.levels) + 1) * rough_cells(case)
    else:
        for level in (*task.levels, task.reference):
            yield rough_cells(case.with_values({"solve.h": 2.0**-level}))
