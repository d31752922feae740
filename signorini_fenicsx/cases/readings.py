"""`[[probe]]`: points where a solution is read off. `[[section]]`: lines or planes through which its flux is."""

import csv
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from signorini_fenicsx.base.errors import InputError, reading
from signorini_fenicsx.base.reading import text_of
from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.cases.complaints import shown
from signorini_fenicsx.cases.parts import Section as CaseSection
from signorini_fenicsx.cases.values import number
from signorini_fenicsx.discrete.sections import Profile, Spots
from signorini_fenicsx.meshes.domain import AXES, Domain

MOST = 10_000
"""Points of all probes together."""
NAME = "name"


def _points(value: object) -> object:
    """One point as a list of it."""
    rows: list[Any] = value if isinstance(value, list) and value and isinstance(value[0], list) else [value]
    for row in rows:
        if not isinstance(row, list) or len(row) not in (2, 3):
            raise ValueError(f"must be a point such as [1, 2], or a list of points, not {shown(value)}")
    return [[number(each) for each in row] for row in rows]


type Coordinate = Annotated[float, Field(allow_inf_nan=False)]
type PointsOf = Annotated[list[list[Coordinate]], BeforeValidator(_points)]
type Name = Annotated[str, Field(pattern=r"^\w[\w .-]*$", max_length=60)]


class ProbeTexts(CaseSection):
    """A probe: its name, its points, and names of these if they are several."""

    name: Name
    points: PointsOf
    names: list[Annotated[str, Field(pattern=r"^[^\n\r]+$", max_length=60)]] | None = None

    @model_validator(mode="after")
    def _named(self) -> Self:
        if self.names is not None and len(self.names) != len(self.points):
            raise ValueError(f"names: {len(self.names)} names for {len(self.points)} points")
        return self

    @property
    def labels(self) -> list[str]:
        """A name for each point."""
        if self.names is not None:
            return [f"{self.name} {each}" for each in self.names]
        several = len(self.points) > 1
        return [f"{self.name} {i + 1}" if several else self.name for i in range(len(self.points))]


class SectionTexts(CaseSection):
    """A section: its name, and the points of a polyline in the plane, or a point of a plane in space and its normal."""

    name: Name
    points: PointsOf
    normal: list[Coordinate] | None = None

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        dim = len(self.points[0])
        if self.normal is not None and (len(self.points) > 1 or len(self.normal) != 3 or dim != 3):
            raise ValueError("normal: a plane in space has one point and a normal, each with three coordinates")
        if self.normal is not None and not any(self.normal):
            raise ValueError("normal: must not be 0")
        if self.normal is None and (dim == 3 or len(self.points) < 2):
            raise ValueError(
                "points: must be a polyline of at least two points in the plane, in space a point and a normal"
            )
        if self.normal is None and any(a == b for a, b in zip(self.points, self.points[1:], strict=False)):
            raise ValueError("points: two points that follow one another are the same")
        return self

    def made(self) -> Profile:
        """The section."""
        return Profile(np.array(self.points), None if self.normal is None else np.array(self.normal))


def check_names(probes: Sequence[ProbeTexts], sections: Sequence[SectionTexts]) -> None:
    """Refuse names that two of them have, and too many points.

    Raises:
        ValueError: If there are any.
    """
    for key, names in (
        ("probe", [label for each in probes for label in each.labels]),
        ("section", [each.name for each in sections]),
    ):
        twice = [name for name, times in Counter(names).items() if times > 1]
        if twice:
            raise ValueError(f"[[{key}]] '{twice[0]}' is the name of two")
        if len(names) > MOST:
            raise ValueError(f"[[{key}]]: {len(names)} points; at most {MOST} are read off")


def check_places(domain: Domain, probes: Sequence[ProbeTexts], sections: Sequence[SectionTexts]) -> None:
    """Refuse points that are outside the domain, and sections that do not cross it (collective).

    Raises:
        InputError: If there are any.
    """
    dim = domain.mesh.geometry.dim
    for key, each in [("probe", each) for each in probes] + [("section", each) for each in sections]:
        if any(len(point) != dim for point in each.points):
            raise InputError(f"[[{key}]] {each.name}: points must have {dim} coordinates, as the mesh has")
    for each in probes:
        places = Spots.of(domain, np.array(each.points))
        counts = domain.mesh.comm.allreduce(np.bincount(places.rows, minlength=len(each.points)))
        for point, label, count in zip(each.points, each.labels, counts, strict=True):
            if count == 0:
                raise InputError(f"[[probe]] {label}: {place_in_words(point)} is outside the domain, {_box(domain)}")
    for section in sections:
        if section.made().measure(domain) == 0:
            raise InputError(f"[[section]] {section.name}: does not cross the domain, {_box(domain)}")


def _box(domain: Domain) -> str:
    sides = (f"[{low:g}, {high:g}]" for low, high in domain.box().T[: domain.mesh.geometry.dim])
    return f"which is within {' x '.join(sides)}"


def with_points(probe: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The keys of a probe with the points of its `file`, a CSV with columns x, y, in space z, and perhaps name.

    So a case, and what is saved of it, does not need the file any more.

    Raises:
        InputError: If it cannot be read.
    """
    path = Path(os.path.normpath(folder / probe["file"]))
    with reading(f"[[probe]] {probe.get('name', '')}: {path}"):
        if "points" in probe:
            raise InputError("a probe has points or a file, not both")
        points, names = _read(path)
    return {key: value for key, value in probe.items() if key != "file"} | {"points": points, "names": names}


def _read(path: Path) -> tuple[list[list[float]], list[str] | None]:
    try:
        rows = list(csv.reader(text_of(path).splitlines()))
    except (ValueError, csv.Error) as error:
        raise InputError(f"not a CSV file: {error}") from None
    header = [each.strip().lower() for each in rows[0]] if rows else []
    axes = [axis for axis in AXES if axis in header]
    if axes not in (["x", "y"], ["x", "y", "z"]) or len(rows) < 2:
        raise InputError("must have a line of names, x,y or x,y,z and perhaps name, then a line per point")
    points, names = [], []
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            if len(row) != len(header):
                raise ValueError
            points.append([float(row[header.index(axis)]) for axis in axes])
        except ValueError:
            wanted = f"{len(header)} entries with numbers for {', '.join(axes)}"
            raise InputError(f"line {line} must have {wanted}") from None
        names += [row[header.index(NAME)].strip()] if NAME in header else []
    return points, names or None
