"""Cases: what to solve, on which domain, with which algorithm; read from TOML and validated before anything runs."""

import difflib
import os
import re
import tomllib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self, get_args

import basix.ufl
import ufl
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.shipped import case_names, data_folder
from signorini_fenicsx.discrete.data import Given, Problem
from signorini_fenicsx.expressions import Tree, parse_expression, parse_number, read
from signorini_fenicsx.meshes.files import is_geometry
from signorini_fenicsx.meshes.shapes import SHAPES, Shape
from signorini_fenicsx.methods.registry import ALGORITHMS

MAX_BYTES = 2**23
"""Of a TOML file; Python reads about a million a second."""
MAX_BITS = 1000
"""Of an integer."""
MAX_DOTS = 500
"""Of a dotted key, which takes Python a time that grows with the square of them."""


def _number(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("must be a number, not true or false")
    if isinstance(value, str):
        try:
            value = parse_number(value)
        except InputError as error:
            raise ValueError(str(error)) from None
    return _not_huge(value)


def _text(value: object) -> object:
    return str(_not_huge(value)) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _not_huge(value: object) -> object:
    """Refuse integers of TOML that are no floating point numbers; Python cannot even print some of them."""
    if isinstance(value, int) and value.bit_length() > MAX_BITS:
        raise ValueError(f"must be a number of at most {MAX_BITS} bits")
    return value


def _choice(kind: str, known: tuple[str, ...]) -> BeforeValidator:
    """Accept one of the known names; otherwise a sentence that lists them."""

    def check(value: object) -> object:
        if value not in known:
            raise ValueError(f"unknown {kind} {_shown(value)}; use one of {', '.join(known)}")
        return value

    return BeforeValidator(check)


def _within(low: float, high: float) -> AfterValidator:
    def check(value: float) -> float:
        if not low <= value <= high:
            raise ValueError(f"must be between {low:g} and {high:g}, not {value:g}")
        return value

    return AfterValidator(check)


Positive = Annotated[float, BeforeValidator(_number), Field(gt=0, allow_inf_nan=False)]
Expression = Annotated[str, BeforeValidator(_text)]
type Conductivity = str | list[list[str]] | dict[str, str | list[list[str]]]


def _conductivity(value: object) -> object:
    """A number or text, a square matrix of them, or a table with one of them per region."""
    if isinstance(value, dict):
        if not value:
            raise ValueError("the table of regions is empty")
        return {region: _matrix_or_text(entry) for region, entry in value.items()}
    return _matrix_or_text(value)


def _matrix_or_text(value: object) -> object:
    value = _text(value)
    if isinstance(value, list):
        rows = [[_text(entry) for entry in row] if isinstance(row, list) else [] for row in value]
        if len(rows) not in (2, 3) or any(len(row) != len(rows) for row in rows):
            raise ValueError("a matrix must have 2 rows of 2 expressions, in 3D 3 of 3")
        if all(isinstance(entry, str) for row in rows for entry in row):
            return rows
    elif isinstance(value, str):
        return value
    raise ValueError("must be an expression, a matrix such as [[2, 0], [0, 1]], or a table with one per region")


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Geometry(_Section):
    """`[geometry]`: a named shape and the kind of its mesh; or a file with a mesh, or that Gmsh makes one of."""

    shape: Annotated[str, _choice("shape", tuple(SHAPES))] | None = None
    file: Annotated[str, Field(min_length=1)] | None = None
    mesh: Annotated[str, _choice("mesh", ("unstructured", "structured"))] = "unstructured"
    diagonal: Annotated[str, _choice("diagonal", ("left", "right", "crossed"))] | None = None

    @model_validator(mode="after")
    def _mesh_exists(self) -> Self:
        if (self.shape is None) == (self.file is None):
            raise ValueError("must have either a shape, such as 'square', or a file, such as 'mesh.msh'")
        if self.shape is None:
            if {"mesh", "diagonal"} & self.model_fields_set:
                raise ValueError("mesh and diagonal apply to named shapes, not to files")
            return self
        shape = SHAPES[self.shape]
        if self.mesh == "structured" and shape.grid is None:
            structured = ", ".join(name for name, other in SHAPES.items() if other.grid is not None)
            raise ValueError(f"shape '{self.shape}' has no structured mesh; only {structured} have")
        if self.diagonal is not None and (self.mesh != "structured" or shape.dim != 2):
            raise ValueError("diagonal applies to structured meshes of square and lshape only")
        return self

    @property
    def name(self) -> str:
        """The shape, or the name of the file."""
        return self.shape or Path(self.file or "").name


class Boundary(_Section):
    """`[boundary]`: the parts that make up Γ_S and Γ_N; everything else is Γ_D, which may be listed to make sure."""

    signorini: list[str] = Field(min_length=1)
    neumann: list[str] = []
    dirichlet: list[str] | None = None

    @model_validator(mode="after")
    def _no_repetition(self) -> Self:
        repeated = sorted(part for part, times in Counter(self.listed()).items() if times > 1)
        if repeated:
            raise ValueError(f"'{repeated[0]}' is listed twice")
        return self

    def check(self, known: list[str], where: str) -> None:
        """Make sure that the named parts exist and, if Γ_D is listed, that none is left.

        Args:
            known: All parts of the boundary.
            where: Name of the domain.

        Raises:
            ValueError: If not; the message names key and part.
        """
        for key in ("signorini", "neumann", "dirichlet"):
            for part in getattr(self, key) or []:
                if part not in known:
                    raise ValueError(
                        f"[boundary] {key}: unknown part '{part}' of {where}; its parts are {', '.join(known)}"
                    )
        left = [part for part in known if part not in self.listed()]
        if self.dirichlet is not None and left:
            raise ValueError(f"[boundary] '{left[0]}' is in none of signorini, neumann and dirichlet")

    def listed(self) -> list[str]:
        """All parts that are named."""
        return [*self.signorini, *self.neumann, *(self.dirichlet or [])]


class ProblemTexts(_Section):
    """`[problem]`: the data of a `data.Problem`, as text in x, y, z; κ as text, a matrix or one of them per region."""

    f: Expression
    kappa: Annotated[Conductivity, BeforeValidator(_conductivity)] = "1"
    u_D: Expression = "0"
    g_N: Expression = "0"
    psi: Expression = "0"
    q_S: Expression = "0"

    def texts(self) -> list[tuple[str, str]]:
        """Each expression with the name of its key."""
        found = [(name, getattr(self, name)) for name in ("f", "u_D", "g_N", "psi", "q_S")]
        if isinstance(self.kappa, dict):
            values = [(f"kappa.{region}", value) for region, value in self.kappa.items()]
        else:
            values = [("kappa", self.kappa)]
        for name, value in values:
            found += [(name, value)] if isinstance(value, str) else [(name, entry) for row in value for entry in row]
        return found

    def read(self, dim: int) -> Problem:
        """The data in this dimension.

        Raises:
            InputError: If an expression cannot be read.
        """
        names = "xyz"[:dim]
        f, u_D, g_N, psi, q_S = (read(getattr(self, key), names) for key in ("f", "u_D", "g_N", "psi", "q_S"))

        def conductivity(text: str | list[list[str]]) -> Tree | list[list[Tree]]:
            return (
                read(text, names) if isinstance(text, str) else [[read(entry, names) for entry in row] for row in text]
            )

        if isinstance(self.kappa, dict):
            kappa: Given | dict[str, Given] = {region: conductivity(text) for region, text in self.kappa.items()}
        else:
            kappa = conductivity(self.kappa)
        return Problem(f=f, kappa=kappa, u_D=u_D, g_N=g_N, psi=psi, q_S=q_S)


class Exact(_Section):
    """`[exact]`: the solution u, where it is known, as text in x, y, z; then σ = ∇u and p = u on Γ_S."""

    u: Expression | None = None


class Solve(_Section):
    """`[solve]`: the algorithm and its parameters; `predict` starts large problems from a coarser mesh's sets.

    Without ρ or a number of iterations the algorithm takes its own.
    """

    algorithm: Annotated[str, _choice("algorithm", tuple(ALGORITHMS))] = "alg1"
    backend: Annotated[str, _choice("backend", ("hybrid", "mixed"))] = "hybrid"
    h: Annotated[Positive, _within(1e-90, 1e90)] = 2**-5  # its powers are numbers
    rho: Annotated[Positive, _within(1e-100, 1e100)] | None = None
    eps: Annotated[Positive, _within(1e-14, 1e6)] = 1e-8
    max_iterations: Annotated[int, BeforeValidator(_number), _within(1, 10**6)] | None = None
    predict: bool = True


class Case(_Section):
    """One Signorini problem, how to discretise and how to solve it.

    Attributes:
        name: Short name, used for the default output folder; not a key of the file.
    """

    name: str = Field(default="case", exclude=True)
    title: str = ""
    geometry: Geometry
    boundary: Boundary
    problem: ProblemTexts
    exact: Exact = Exact()
    solve: Solve = Solve()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.geometry.shape is not None:
            self._check_shape(SHAPES[self.geometry.shape])
        elif self.file_h is not None and not is_geometry(self.geometry.file or ""):
            raise ValueError(f"[solve] h: the mesh of '{self.geometry.name}' is as fine as it is; leave h out")
        else:
            self._check_expressions(3)  # the file is not read yet
        return self

    @property
    def file_h(self) -> float | None:
        """Mesh size asked of a `.geo` file, if one is."""
        return self.solve.h if self.geometry.shape is None and "h" in self.solve.model_fields_set else None

    @property
    def fineness(self) -> str:
        """What is known of the mesh size before there is a mesh."""
        asked = self.solve.h if self.geometry.shape is not None else self.file_h
        return f"mesh {self.geometry.name}" if asked is None else f"h ≤ {asked:g}"

    def check_dimension(self, dim: int) -> None:
        """Refuse coordinates that a mesh read from a file does not have.

        Raises:
            InputError: If an expression uses one.
        """
        try:
            self._check_expressions(dim)
        except ValueError as error:
            raise InputError(str(error)) from None

    def _check_shape(self, shape: Shape) -> None:
        self.boundary.check(list(shape.parts), self.geometry.name)
        if self.solve.h > shape.diameter:
            raise ValueError(
                f"[solve] h: {self.solve.h:g} is larger than the domain, whose diameter is {shape.diameter:.4g}"
            )
        self._check_expressions(shape.dim)

    def _check_expressions(self, dim: int) -> None:
        x = reference_coordinate(dim)
        texts = [("problem", *entry) for entry in self.problem.texts()] + [("exact", "u", self.exact.u or "0")]
        for section, name, text in texts:
            try:
                parse_expression(text, x)
            except InputError as error:
                raise ValueError(f"[{section}] {name}: {error}") from None

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """Return a validated copy in which keys such as `solve.h` or `geometry.mesh` have new values.

        Raises:
            InputError: If a key or value is not valid.
        """
        tree = self.model_dump(exclude_unset=True)
        for key, value in values.items():
            *sections, last = key.split(".")
            branch = tree
            for section in sections:
                branch = branch.setdefault(section, {})
                if not isinstance(branch, dict):
                    raise InputError(f"{key}: no such key in a case")
            branch[last] = value
        return _validated(type(self), tree, self.name, "case " + self.name)


def reference_coordinate(dim: int) -> ufl.SpatialCoordinate:
    """Coordinate of a domain that has a dimension but no mesh yet."""
    cell = {2: "triangle", 3: "tetrahedron"}[dim]
    return ufl.SpatialCoordinate(ufl.Mesh(basix.ufl.element("Lagrange", cell, 1, shape=(dim,))))


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        InputError: If it cannot be read.
    """
    try:
        if not path.is_file():
            raise InputError(f"{path}: is a folder, not a TOML file" if path.is_dir() else f"{path}: no such file")
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: has more than {MAX_BYTES} bytes, as no case or study has")
        text = path.read_text(encoding="utf-8")
        if max(part.count(".") for part in re.split(r"[=,*/+()\n]", text)) > MAX_DOTS:
            raise InputError(f"{path}: a key is nested too deeply")
        return tomllib.loads(text)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not a TOML file: {error}") from None
    except ValueError:  # Python reads no more than 4300 digits
        raise InputError(f"{path}: an integer of thousands of digits; numbers are at most 1e308") from None


def load_case(name_or_path: str | Path) -> Case:
    """Read a case by name (`example1`) or path (`my/case.toml`).

    Raises:
        InputError: If there is no such case, or it is malformed; the message names file, key and reason.
    """
    text = str(name_or_path)
    if text.endswith(".toml") or "/" in text:
        path = Path(text)
    else:
        path = data_folder("cases") / f"{text}.toml"
        if text not in case_names():
            raise InputError(f"unknown case '{text}'; use one of {', '.join(case_names())} or the path of a .toml file")
    tree = read_toml(path)
    geometry = tree.get("geometry")
    if isinstance(geometry, dict) and isinstance(file := geometry.get("file"), str):
        geometry["file"] = os.path.normpath(path.parent / file)
    return _validated(Case, tree, path.stem, str(path))


def _validated[C: Case](model: type[C], tree: dict[str, Any], name: str, source: str) -> C:
    if "name" in tree:
        raise InputError(f"{source}: unknown key 'name'; known are {', '.join(_keys(Case))}")
    try:
        return model.model_validate(tree | {"name": name})
    except ValidationError as error:
        raise InputError(f"{source}: {complaint(error, Case)}") from None


def complaint(error: ValidationError, root: type[BaseModel]) -> str:
    """The first complaint of pydantic about a file, as one sentence with the place in TOML's notation."""
    first = error.errors(include_url=False)[0]
    *sections, last = [str(step) for step in first["loc"]] or [""]
    place = "".join(f"[{section}] " for section in sections[:1]) + ".".join([*sections[1:], last])
    match first["type"]:
        case "extra_forbidden":
            return f"unknown key '{last}'{_place_of_key(sections)}; known are {_known_keys(root, sections, last)}"
        case "missing":
            return f"missing {'key' if sections else 'section or key'} '{last}'{_place_of_key(sections)}"
        case "model_type" | "model_attributes_type":
            return f"'{last}' must be a section, [{last}], not {_shown(first['input'])}"
        case "value_error":
            message = str(first["ctx"]["error"])
            return f"{place}: {message}" if last else message
    message = first["msg"][0].lower() + first["msg"][1:]
    return f"{place}: {message}, not {_shown(first['input'])}"


def _shown(value: object) -> str:
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # integers of many digits, deep lists
        text = f"this {type(value).__name__}"
    return text if len(text) <= 60 else text[:57] + "..."


def _place_of_key(sections: list[str]) -> str:
    return f" in [{sections[0]}]" if sections else ""


def _known_keys(model: type[BaseModel], sections: list[str], wrong: str) -> str:
    for section in sections:
        annotation = model.model_fields[section].annotation
        kinds = (annotation, *get_args(annotation))  # of a section that may be left out: a union with None
        model = next(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel))
    known = _keys(model)
    close = difflib.get_close_matches(wrong, known, 1)
    return ", ".join(known) + (f" (did you mean '{close[0]}'?)" if close else "")


def _keys(model: type[BaseModel]) -> list[str]:
    return [key for key, field in model.model_fields.items() if not field.exclude]
