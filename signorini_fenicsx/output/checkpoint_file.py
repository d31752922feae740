"""The files of a checkpoint, read without trusting them: only what this program can have written reaches DOLFINx.

Each rank reads a share of the rows of each array, however many ranks have written it.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from mpi4py import MPI
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, NonNegativeInt, ValidationError

from signorini_fenicsx.base.array_files import UNREADABLE, Header, read_header, read_share
from signorini_fenicsx.base.errors import InputError, reading, telling
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.reading import text_of
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.complaints import complaint
from signorini_fenicsx.contact.history import Step
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.meshes.shared_checks import check_cells, refuse
from signorini_fenicsx.solving.kept import Arrays, Keeping, Layout
from signorini_fenicsx.solving.physics import DIFFUSION, PHYSICS

FOLDER, TEXT = "checkpoint", "about.json"
"""The folder of a checkpoint in a results folder; the file of what is no array."""

FORMAT = 3
"""Format that is read and written: a folder with TEXT and `<name>.npy` for each array."""
OLD_FILE = "checkpoint.npz"
"""What versions up to 0.3 wrote."""


MESH: Layout = {
    "points": (np.float64, "points", "dim"),
    "cells": (np.int64, "cells", "corners"),
    "facet_vertices": (np.int64, "facets", "dim"),
}
"""The arrays of all physics."""


class GivenInPython(BaseModel):
    """A problem that was given in Python, not by a case file.

    Attributes:
        title: Title of the results.
        domain: Name of its domain.
        signorini: Parts of Γ_S.
        neumann: Parts of Γ_N.
        inner: Parts inside the domain.
        problem: The data that are numbers, texts or tables of these.
        laws: The laws, as [[law]] has them.
        missing: Names of the other data, which no file can hold.
        options: The options that are names and numbers; the algorithm is `options.OWN` if it is not in the registry.
        fixed: In elasticity the parts that are fixed in some components.
    """

    model_config = ConfigDict(strict=True, extra="allow")  # with what else the boundaries of a physics have

    title: str
    domain: str
    signorini: list[str]
    neumann: list[str] = []
    inner: list[str] = []
    problem: dict[str, Any]
    laws: list[dict[str, Any]] = []
    missing: list[str]
    options: dict[str, Any]
    fixed: dict[str, str] = {}


class About(BaseModel):
    """The contents of a file besides its arrays. Attributes that are not listed here are those of `Solution`.

    Attributes:
        name: Name of the case or the problem.
        format: See FORMAT.
        case: The contents of the case file; None for a problem given in Python.
        given: A problem given in Python, or None.
        part_names: Boundary parts of Γ_S.
        parts: For each boundary part the label of the coordinate along it.
        regions: Names of the regions.
        bend: See `Domain`.
        made: How the mesh was made, in words.
        history: One step per iteration.
        beta: β of the ROBIN facets.
        kkt: The KKT residuals when it was written.
        physics: Name of the physics.
        step: Number of the step of a case in time; None for others.
    """

    model_config = ConfigDict(strict=True, extra="allow")  # with what `Keeping.numbers` names

    name: str
    physics: str = DIFFUSION
    step: int | None = Field(default=None, ge=1)
    format: Literal[3]
    case: dict[str, Any] | None
    given: GivenInPython | None = None
    part_names: list[str]
    parts: dict[str, str]
    regions: list[str]
    bend: FiniteFloat = Field(ge=0)
    made: str = "given"
    history: list[Step]
    beta: FiniteFloat = Field(gt=0)
    kkt: dict[str, float]
    reason: str
    converged: bool
    backend: str
    dofs: NonNegativeInt
    linear_solver: str
    own_residual: float | None = None
    details: dict[str, float] = {}
    timings: dict[str, float]
    peak_memory: int


@dataclass(frozen=True)
class Checkpoint:
    """A file that has passed all checks except that of its residuals.

    Attributes:
        path: Where it is.
        about: Its contents besides arrays.
        case: Its case; None for a problem given in Python.
        headers: Shape and type of its arrays, see `MESH` and `Keeping.layout`. Further arrays: `part_0` … with the
            facets of each boundary part, shape (facets, dim); `inside`, shape (cells, regions), if there are regions;
            `together`, shape (pairs, 2), pairs of cells for one rank, if there are parts inside or pairs of surfaces.
        arrays: The rows of its arrays that this rank has read; rows continue from rank to rank.
    """

    path: Path
    about: About
    case: CaseFile | None
    headers: dict[str, Header]
    arrays: Arrays

    @property
    def keeping(self) -> Keeping:
        """How its physics keeps solutions."""
        return PHYSICS[self.about.physics].keeping

    @property
    def boundary(self) -> Any:
        """The parts of each kind of boundary."""
        if self.case is not None:
            return self.case.posed(self.dim).boundary
        given = self.about.given
        assert given is not None
        _, *others = (each.name for each in fields(self.keeping.boundary))
        return self.keeping.boundary(given.signorini, **{name: getattr(given, name) for name in others})

    @property
    def numbers(self) -> dict[str, list[float]]:
        """The lists of numbers that its physics keeps.

        Raises:
            InputError: If they are something else.
        """
        numbers = {name: (self.about.model_extra or {}).get(name, []) for name in self.keeping.numbers}
        for name, values in numbers.items():
            if not isinstance(values, list) or not all(isinstance(value, int | float) for value in values):
                raise InputError(f"{self.path}: not a readable solution ({name} is no list of numbers)")
        return numbers

    @property
    def title(self) -> str:
        """Title of the results."""
        if self.case is not None:
            return self.case.title
        return "" if self.about.given is None else self.about.given.title

    @property
    def shape(self) -> str | None:
        """The named shape, or None if the domain is not one."""
        return None if self.case is None else self.case.geometry.shape

    @property
    def domain(self) -> str:
        """Name of the domain."""
        if self.case is not None:
            return self.case.geometry.name
        return "" if self.about.given is None else self.about.given.domain

    @property
    def dim(self) -> int:
        """Dimension, 2 or 3; 0 if the points have another one."""
        shape = self.headers["points"].shape
        return shape[1] if shape[1:] in ((2,), (3,)) else 0


def read_checkpoint(comm: MPI.Comm, folder: Path) -> Checkpoint:
    """Read a checkpoint and check everything that can be checked without spaces and residuals (collective).

    Args:
        comm: Communicator.
        folder: The results folder.

    Raises:
        InputError: On all ranks, if there is no checkpoint, or it cannot come from this program.
    """

    def begin() -> Checkpoint:
        path = place_of(folder)
        with _told(path):
            about = About.model_validate_json(text_of(path / TEXT))
            files = sorted(file for file in path.glob("*.npy") if file.is_file())
            checkpoint = Checkpoint(path, about, _case(about), {file.stem: read_header(file) for file in files}, {})
            _check_layout(checkpoint)
        return checkpoint

    checkpoint = on_root(comm, begin)
    with _told(checkpoint.path):
        files = {name: (checkpoint.path / f"{name}.npy", header) for name, header in checkpoint.headers.items()}
        checkpoint = replace(checkpoint, arrays={name: read_share(comm, *file) for name, file in files.items()})
        refuse(comm, _wrong_value(checkpoint))
        with telling("is damaged: its mesh"):
            check_cells(comm, checkpoint.arrays["points"], checkpoint.arrays["cells"])
    return checkpoint


def place_of(folder: Path) -> Path:
    """The path of the checkpoint of a results folder.

    Raises:
        InputError: If there is none.
        OSError: If the folder cannot be read.
    """
    with reading(folder):
        if (folder / FOLDER / TEXT).is_file():
            return folder / FOLDER
        old = (folder / OLD_FILE).is_file()
    why = "so there is no solution to read"
    if old:
        why = f"but {OLD_FILE} of version 0.3 or older, which version 0.4 reads"
    elif (folder / "steps.csv").is_file():
        why = "because an older version solved this case in time; solve it again"
    elif (folder / "case.json").is_file():
        why = "because its run was ended; `signorini solve --restart` goes on"
    raise InputError(f"{folder}: holds no {FOLDER}, {why}")


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """Turn all errors of reading into one sentence with the path."""
    with reading(path):
        try:
            yield
        except ValidationError as error:
            raise InputError(f"not a readable solution ({complaint(error, About)})") from None
        except UNREADABLE as error:
            raise InputError(f"not a readable solution ({error})") from None


def _case(about: About) -> CaseFile | None:
    if about.physics not in PHYSICS:
        raise InputError(f"not a readable solution (its physics, {about.physics}, is not of this version)")
    if (about.case is None) == (about.given is None):
        raise InputError("not a readable solution (it has neither a case nor a problem)")
    if about.case is None:
        return None
    try:
        return PHYSICS[about.physics].case.model_validate(about.case | {"name": about.name})
    except ValidationError:
        raise InputError("its case is from another version") from None


def _check_layout(checkpoint: Checkpoint) -> None:
    """Check the types and shapes of the arrays, and that parts, shape and dimension fit (rank 0)."""
    about, headers = checkpoint.about, checkpoint.headers
    layout = {**MESH, **checkpoint.keeping.layout} | {
        f"part_{index}": (np.int64, f"facets of {name}", "dim") for index, name in enumerate(about.parts)
    }
    layout |= {name: form for name, form in checkpoint.keeping.of_some.items() if name in headers}
    if about.step is not None:
        layout |= checkpoint.keeping.of_step
        if checkpoint.case is None or about.step > checkpoint.case.steps:
            raise InputError("is damaged: its case has no such step")
    if about.regions:
        layout["inside"] = (np.bool_, "cells", "regions")
    dim = checkpoint.dim if "points" in headers else 0
    if dim and (checkpoint.boundary.named.get("inner") or "together" in headers):
        layout["together"] = (np.int64, "pairs", "two")
    missing = [name for name in layout if name not in headers]
    if missing:
        raise InputError(f"not a readable solution (it holds no {missing[0]})")
    sizes = {"dim": dim, "corners": dim + 1, "space": 3, "regions": len(about.regions), "two": 2}
    for name, (kind, *words) in layout.items():
        shape = headers[name].shape
        lengths = [sizes.setdefault(word, size) for word, size in zip(words, shape, strict=False)]
        if dim == 0 or headers[name].kind != kind or list(shape) != lengths or len(words) != len(shape):
            raise InputError(f"not a readable solution ({name} has type {headers[name].kind} and shape {shape})")
    for name in set(headers) - set(layout):
        del headers[name]
    if checkpoint.shape is None:
        suits_mesh = set(about.parts.values()) <= set(AXES[:dim])
    else:
        suits_mesh = list(about.parts) == list(shape_of(checkpoint.shape).parts)
        if shape_of(checkpoint.shape).dim != dim:
            raise InputError(f"is damaged: its mesh has dimension {dim}, but '{checkpoint.domain}' has another one")
    if not suits_mesh:
        raise InputError(f"is damaged: its boundary parts are not those of '{checkpoint.domain}'")
    if about.part_names != list(next(iter(checkpoint.boundary.named.values()))):
        raise InputError("is damaged: its parts of Γ_S are not those of its case")
    if checkpoint.case is not None:
        checkpoint.case.check_dimension(dim)


def _wrong_value(checkpoint: Checkpoint) -> str:
    """What is wrong with the values that this rank has read; empty if nothing is."""
    for name, rows in checkpoint.arrays.items():
        may_fail = name != "points" and not checkpoint.about.converged
        if rows.dtype == np.float64 and not may_fail and not np.isfinite(rows).all():
            return f"is damaged: {name} is not finite everywhere"
    for name, number in checkpoint.keeping.codes.items():
        if not np.isin(checkpoint.arrays.get(name, np.empty(0)), range(number)).all():
            return f"is damaged: {name} has a value that is no {name.removeprefix('facet_').removesuffix('_at')}"
    together = checkpoint.arrays.get("together", np.empty(0))
    if not ((together >= 0) & (together < checkpoint.headers["cells"].shape[0])).all():
        return "is damaged: together has a number that is no cell"
    return ""
