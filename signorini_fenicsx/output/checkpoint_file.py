"""Reads the file of a checkpoint without trusting it: only contents that this program can have written reach DOLFINx.

All functions run on rank 0.
"""

import tokenize
import warnings
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, NonNegativeInt, ValidationError

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.cases.complaints import complaint
from signorini_fenicsx.cases.solving import boundary_of
from signorini_fenicsx.discrete.conditions import Condition
from signorini_fenicsx.meshes.checks import Contents, check_boundary, checked
from signorini_fenicsx.meshes.domain import AXES, Boundary
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.methods.history import Step

type Arrays = dict[str, npt.NDArray]

UNREADABLE = (ValueError, EOFError, RecursionError, Warning, SyntaxError, tokenize.TokenError, zipfile.BadZipFile)
"""Errors of NumPy and zipfile for damaged files. NumPy also warns when it reads something that it never wrote."""

LAYOUT: dict[str, tuple[type, *tuple[str, ...]]] = {
    "points": (np.float64, "points", "dim"),
    "cells": (np.int64, "cells", "corners"),
    "u": (np.float64, "cells"),
    "sigma": (np.float64, "cells", "dim"),
    "divergence": (np.float64, "cells"),
    "facet_part": (np.int64, "facets"),
    "facet_x": (np.float64, "facets", "space"),
    "facet_along": (np.float64, "facets"),
    "facet_measure": (np.float64, "facets"),
    "facet_u": (np.float64, "facets"),
    "facet_p": (np.float64, "facets"),
    "facet_flux": (np.float64, "facets"),
    "facet_condition": (np.int64, "facets"),
    "facet_vertices": (np.int64, "facets", "dim"),
}
"""Type and shape of the arrays of a file; a word stands for the same number everywhere."""
VALUES = ("u", "sigma", "divergence", "facet_u", "facet_p", "facet_flux")
"""Arrays that need not be finite if the run has failed."""
SIMPLICES = {1: "line", 2: "triangle", 3: "tetra"}


FORMAT = 2
"""Format of the files that are written. Files of format 1 have no format number and no problems given in Python."""


class GivenInPython(BaseModel):
    """A problem that was given in Python, not by a case file.

    Attributes:
        title: Title of the results.
        domain: Name of its domain.
        signorini: Parts of Γ_S.
        neumann: Parts of Γ_N.
        problem: The data that are numbers, texts or tables of these.
        laws: The laws, as [[law]] has them.
        missing: Names of the other data, which no file can hold.
        options: The options that are names and numbers; the algorithm is `options.OWN` if it is not in the registry.
    """

    model_config = ConfigDict(strict=True)

    title: str
    domain: str
    signorini: list[str]
    neumann: list[str]
    problem: dict[str, Any]
    laws: list[dict[str, Any]] = []
    missing: list[str]
    options: dict[str, Any]


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
        history: One step per iteration.
        beta: β of the ROBIN facets.
        kkt: The KKT residuals when it was written; files of version 0.1 do not have them.
    """

    model_config = ConfigDict(strict=True)

    name: str
    format: int = Field(default=1, ge=1, le=FORMAT)
    case: dict[str, Any] | None
    given: GivenInPython | None = None
    part_names: list[str]
    parts: dict[str, str]
    regions: list[str]
    bend: FiniteFloat = Field(ge=0)
    history: list[Step]
    beta: FiniteFloat = Field(gt=0)
    kkt: dict[str, float] | None = None
    reason: str
    converged: bool
    backend: str
    dofs: NonNegativeInt
    linear_solver: str
    own_residual: float | None = None
    details: dict[str, float] = {}
    rough_steps: int
    timings: dict[str, float]
    peak_memory: int


@dataclass(frozen=True)
class Checkpoint:
    """A file that has passed all checks except that of its residuals.

    Attributes:
        about: Its contents besides arrays.
        case: Its case; None for a problem given in Python.
        arrays: Its arrays, see `LAYOUT`. Further arrays: `part_0` … with the facets of each boundary part, shape
            (facets, dim); `inside`, shape (cells, regions), if there are regions.
    """

    about: About
    case: Case | None
    arrays: Arrays

    @property
    def boundary(self) -> Boundary:
        """Γ_S and Γ_N."""
        if self.case is not None:
            return boundary_of(self.case)
        assert self.about.given is not None
        return Boundary(self.about.given.signorini, self.about.given.neumann)

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
        """Dimension, 2 or 3."""
        return int(self.arrays["points"].shape[1])


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a file and check everything that can be checked without spaces and residuals.

    Raises:
        InputError: If there is no file, or it cannot come from this program.
    """
    try:
        if not path.is_file():
            raise InputError(f"{path.parent}: holds no {path.name}, so there is no solution to read")
        arrays = _read(path)
        about = About.model_validate_json(str(arrays.pop("about", "")))
        found = Checkpoint(about, _case(about), arrays)
        _check_layout(found)
        _check_mesh(found)
        return found
    except ValidationError as error:
        raise InputError(f"{path}: not a readable solution ({complaint(error, About)})") from None
    except InputError as error:
        raise error if str(path.parent) in str(error) else InputError(f"{path}: {error}") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    except UNREADABLE as error:
        raise InputError(f"{path}: not a readable solution ({error})") from None


def _read(path: Path) -> Arrays:
    """All arrays of a file. Their stated sizes are compared with the size of the file before memory is allocated."""
    with zipfile.ZipFile(path) as archive, warnings.catch_warnings(action="error"):
        entries = archive.infolist()
        if any(entry.flag_bits & 1 or entry.compress_type != zipfile.ZIP_STORED for entry in entries):
            raise InputError("not a readable solution (it is compressed or encrypted; this program never does that)")
        if sum(entry.file_size for entry in entries) > path.stat().st_size:
            raise InputError("not a readable solution (it states larger sizes than it has)")
        return {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> npt.NDArray:
    header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        if version not in header:
            raise InputError(f"not a readable solution ({entry.filename} is not an array)")
        shape, _, kind = header[version](file)
        count = 1
        for length in shape:
            count *= length
        if kind.hasobject or min(shape, default=0) < 0 or count * kind.itemsize != entry.file_size - file.tell():
            raise InputError(f"not a readable solution ({entry.filename} does not have the size that it states)")
        file.seek(0)
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


def _case(about: About) -> Case | None:
    if (about.case is None) == (about.given is None):
        raise InputError("not a readable solution (it has neither a case nor a problem)")
    try:
        return None if about.case is None else Case.model_validate(about.case | {"name": about.name})
    except ValidationError:
        raise InputError("its case is from another version") from None


def _check_layout(found: Checkpoint) -> None:
    """Check types and shapes, that values are finite, and that conditions and parts are known ones."""
    about, arrays = found.about, found.arrays
    layout = LAYOUT | {
        f"part_{index}": (np.int64, f"facets of {name}", "dim") for index, name in enumerate(about.parts)
    }
    if about.regions:
        layout["inside"] = (np.bool_, "cells", "regions")
    missing = [name for name in layout if name not in arrays]
    if missing:
        raise InputError(f"not a readable solution (it holds no {missing[0]})")
    points = arrays["points"]
    dim = points.shape[-1] if points.shape[-1:] in ((2,), (3,)) else 0
    sizes = {"dim": dim, "corners": dim + 1, "space": 3, "regions": len(about.regions)}
    for name, (kind, *words) in layout.items():
        array = arrays[name]
        lengths = [sizes.setdefault(word, size) for word, size in zip(words, array.shape, strict=False)]
        if dim == 0 or array.dtype != kind or list(array.shape) != lengths or len(words) != array.ndim:
            raise InputError(f"not a readable solution ({name} has type {array.dtype} and shape {array.shape})")
        if kind is np.float64 and not (np.isfinite(array).all() or (name in VALUES and not about.converged)):
            raise InputError(f"is damaged: {name} is not finite everywhere")
    if not np.isin(arrays["facet_condition"], list(Condition)).all():
        raise InputError("is damaged: facet_condition has a value that is no condition")
    if not np.isin(arrays["facet_part"], range(len(about.part_names))).all():
        raise InputError("is damaged: facet_part has a value that is no part")
    if found.shape is not None and shape_of(found.shape).dim != dim:
        raise InputError(f"is damaged: its mesh has dimension {dim}, but '{found.domain}' has another one")
    if found.case is not None:
        found.case.check_dimension(dim)


def _check_mesh(found: Checkpoint) -> None:
    """Check the mesh like that of any file; Γ_S must be the facets that have values."""
    about, arrays, dim = found.about, found.arrays, found.dim
    if found.shape is None:
        known = set(about.parts.values()) <= set(AXES[:dim])
    else:
        known = list(about.parts) == list(shape_of(found.shape).parts)
    if not known:
        raise InputError(f"is damaged: its boundary parts are not those of '{found.domain}'")
    if about.part_names != list(found.boundary.signorini):
        raise InputError("is damaged: its parts of Γ_S are not those of its case")
    facets = [arrays[f"part_{index}"] for index in range(len(about.parts))]
    kinds = [(SIMPLICES[dim], arrays["cells"]), *((SIMPLICES[dim - 1], rows) for rows in facets)]
    groups = [(name, dim - 1, [(k, np.arange(len(facets[k - 1])))]) for k, name in enumerate(about.parts, 1)]
    try:
        mesh = checked(Contents(arrays["points"], kinds, groups))
        check_boundary(mesh, {key: list(names) for key, names in vars(found.boundary).items()})
    except InputError as error:
        raise InputError(f"is damaged: its mesh: {error}") from None
    if len(mesh.points) != len(arrays["points"]):
        raise InputError("is damaged: its mesh has points without cells")
    gamma = np.unique(np.concatenate([mesh.parts[name] for name in about.part_names]), axis=0)
    vertices = arrays["facet_vertices"]
    if len(vertices) != len(gamma) or not np.array_equal(np.unique(vertices, axis=0), gamma):
        raise InputError("is damaged: its facets with values are not those of Γ_S")
