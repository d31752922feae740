"""The steps of a run in time, kept beside its results until these are complete: a folder of NumPy arrays for each.

All ranks write and read it together, each its own cells in its own order. Cells and facets are identified by their
places, the sums of their vertices, which each run that adds steps writes once. So any number of ranks can go on.
"""

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.array_files import UNREADABLE, Header, read_header, read_share, write_arrays
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.exchange import area_of, delete
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.reading import text_of
from signorini_fenicsx.base.rows import fetch_rows, find_rows
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.discrete.cell_shapes import corners, facet_corners
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.site_table import SiteTable
from signorini_fenicsx.solving.evolution import Past, Steps
from signorini_fenicsx.solving.evolving import Instant
from signorini_fenicsx.solving.fields import IN_CELLS, Field, Fields
from signorini_fenicsx.solving.solved import Columns

CASE, ROW, READINGS, MESH = "case.json", "row.json", "readings.json", "mesh-"
MEANS = "means_of_"
OPPOSITE = "opposite"
FORMAT = 4
"""Format of what is kept of a step; 3 had no readings, versions up to 0.4 kept no fields, and wrote no format."""
type Row = Mapping[str, Any]
"""The numbers of a step."""


class StepFolder:
    """The folder `<target>.steps`. Its methods are collective.

    It appears and disappears as a whole, by way of the folder in which the run works, see `base.exchange`.
    """

    def __init__(self, comm: MPI.Comm, target: Path):
        """Keep the place; nothing on disk changes."""
        self._comm = comm
        self.path = target.with_name(target.name + ".steps")
        self._beside = area_of(target) / self.path.name
        self._saved: MeshSpaces | None = None
        self._rows: dict[tuple[int, str], Indices] = {}

    def begin(self, case: CaseFile, start: Path | None = None, *, restart: bool) -> int:
        """Make the folder, or find out where to go on.

        Args:
            case: The case.
            start: The results folder that gives u_0, or None.
            restart: Whether to go on.

        Returns:
            The last step that is complete; 0 for none.

        Raises:
            InputError: If there are steps of another run, or there is nothing to go on with.
        """
        about = {**case.model_dump(mode="json", exclude_unset=True), "format": FORMAT}
        if start is not None:
            about["start-from"] = os.path.realpath(start)
        return on_root(self._comm, lambda: self._begin(about, restart=restart))

    def _begin(self, about: Mapping[str, Any], *, restart: bool) -> int:
        if self.path.is_symlink() or any(entry.is_symlink() for entry in self.path.glob("*")):
            raise InputError(f"{self.path} is a link or has one; the program writes through none: remove it")
        if not restart:
            if self.path.exists():
                raise InputError(f"{self.path} has steps of a run that was ended; go on with --restart, or remove it")
            self._beside.mkdir()
            (self._beside / CASE).write_text(json.dumps(about), encoding="utf-8")
            self._beside.rename(self.path)
            return 0
        if not self.path.exists():
            raise InputError(f"--restart: there is no {self.path} with steps to go on with")
        with self._told():
            before = dict(json.loads(text_of(self.path / CASE)))
            before["time"] = dict(before["time"])
        changed = [key for key in {**before, **about} if before.get(key) != about.get(key)]
        if changed == ["time"] and _same_steps(before["time"], about["time"]):
            changed = []
        if "format" in changed:
            raise InputError(f"--restart: {self.path} is of another version of the program; remove it")
        if "start-from" in changed:
            raise InputError(f"--restart: {self.path} is of a run with another --start-from; give the same")
        if changed:
            raise InputError(f"--restart: {self.path} is of a case with another [{changed[0]}]; take the same case")
        beyond = self._places()[about["time"]["steps"] :]  # if there are to be fewer steps
        for entry in [*self.path.glob("*.part"), *beyond]:
            delete(entry)
        with self._told():
            for array in self.path.glob("*/*.npy"):
                read_header(array)  # damage is bad input, so it is told before anything is solved
        return len(self._places())

    def _places(self) -> list[Path]:
        """The folders of the steps that are complete, in order (rank 0)."""
        return sorted(entry for entry in self.path.iterdir() if entry.suffix == "" and entry.name.isdigit())

    def save(self, instant: Instant, row: Row) -> None:
        """Keep a step.

        Raises:
            OSError: On all ranks, if the disk is full.
        """
        solution, comm, place = instant.solution, self._comm, self._place(instant.step)
        on_root(comm, lambda: delete(place) if place.exists() else None)  # the last step is done again, by other ranks
        if self._saved is None:
            self._saved = solution.spaces
            mesh = self.path / f"{MESH}{instant.step:06}"
            on_root(comm, lambda: mesh.mkdir(exist_ok=True))
            write_arrays(comm, mesh, _places(solution.spaces))
        part = place.with_suffix(".part")
        on_root(comm, part.mkdir)
        tables = {f"table_{key}": rows for key, rows in vars(solution.table()).items()}
        if (opposite := solution.opposite) is not None:
            tables |= {f"{OPPOSITE}_{key}": rows for key, rows in vars(opposite.table).items()}
        fields = [(_key(name, field), field) for name, of_file in solution.fields().items() for field in of_file]
        means = {MEANS + key: field.cell_means for key, field in fields if field.cell_means is not None}
        values = {key: field.values for key, field in fields}
        write_arrays(comm, part, instant.steps.kept(solution) | tables | values | means)
        readings = solution.readings

        def end() -> None:
            as_lists = {name: {key: column.tolist() for key, column in of.items()} for name, of in readings.items()}
            (part / READINGS).write_text(json.dumps(as_lists), encoding="utf-8")
            (part / ROW).write_text(json.dumps(dict(row)), encoding="utf-8")
            part.rename(place)

        on_root(comm, end)

    def _place(self, step: int) -> Path:
        return self.path / f"{step:06}"

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn all errors of reading into one sentence (rank 0)."""
        try:
            yield
        except (OSError, KeyError, TypeError, *UNREADABLE) as error:
            raise InputError(f"{self.path}: cannot be read ({error}); remove it and begin again") from None

    def rows(self) -> list[Row]:
        """The numbers of all steps.

        Raises:
            InputError: If they cannot be read.
        """

        def read() -> list[Row]:
            with self._told():
                return [dict(json.loads(text_of(place / ROW))) for place in self._places()]

        return on_root(self._comm, read)

    def kept(self, spaces: MeshSpaces, step: int, key: str) -> Array:
        """The rows of the cells or facets of this rank that a step has kept, see `Steps.kept`.

        Raises:
            InputError: If it is not of the cells and facets of this mesh.
        """
        return self._fetch(spaces, step, key, "facets" if key.startswith("facet_") else "cells")

    def fields(self, spaces: MeshSpaces, step: int, like: Fields) -> Fields:
        """The fields of a step, which has as many as another one.

        Raises:
            InputError: If it is not of the cells and facets of this mesh.
        """

        def again(key: str, field: Field) -> Field:
            means = None if field.cell_means is None else self.kept(spaces, step, MEANS + key)
            return replace(field, values=self.kept(spaces, step, key), cell_means=means)

        return {name: [again(_key(name, field), field) for field in of_file] for name, of_file in like.items()}

    def table(self, step: int, kind: type[SiteTable], of: str = "table") -> SiteTable:
        """The table of Γ_S after a step, or of what is `OPPOSITE` to it (rank 0, not collective).

        Raises:
            InputError: If it cannot be read.
        """
        place = self._place(step)
        with self._told():
            return kind(**{each.name: np.load(place / f"{of}_{each.name}.npy") for each in fields(kind)}).in_order()

    def readings(self, row: Row, name: str) -> Columns:
        """A table of what was read off after the step with this row (rank 0, not collective).

        Raises:
            InputError: If it cannot be read.
        """
        with self._told():
            kept = json.loads(text_of(self._place(row["step"]) / READINGS))[name]
            columns = {key: np.array(column) for key, column in kept.items()}
        length = len(next(iter(columns.values()), ()))
        return {key: np.full(length, row[key]) for key in ("step", "t")} | columns

    def past(self, steps: Steps, step: int) -> Past:
        """What the step after this one needs.

        Raises:
            InputError: If what was kept is not of the cells and facets of this mesh.
        """
        return steps.again(step, lambda earlier, key: self.kept(steps.spaces, earlier, key))

    def _fetch(self, spaces: MeshSpaces, step: int, key: str, kind: str) -> Any:
        """An array of a step for the cells or facets of this rank."""
        first = on_root(self._comm, lambda: self._first(step))
        if (first, kind) not in self._rows:
            places_of_file = self._read(self.path / f"{MESH}{first:06}" / f"{kind}.npy")
            rows = find_rows(self._comm, _places(spaces)[kind], [places_of_file])[:, 0]
            if self._comm.allreduce(int(np.count_nonzero(rows < 0))) > 0:
                raise InputError(f"--restart: {self.path} is of another mesh, or of another version of the program")
            self._rows[first, kind] = rows
        return fetch_rows(self._comm, self._rows[first, kind], self._read(self._place(step) / f"{key}.npy"))

    def _first(self, step: int) -> int:
        """The first step of the run that did this one (rank 0)."""
        with self._told():
            begun = (int(entry.name.removeprefix(MESH)) for entry in self.path.glob(f"{MESH}*"))
            return max(first for first in begun if first <= step)

    def _read(self, path: Path) -> Any:
        def header() -> Header:
            with self._told():
                return read_header(path)

        return read_share(self._comm, path, on_root(self._comm, header))

    def remove(self) -> None:
        """Remove the folder with all steps."""

        def end() -> None:
            self.path.rename(self._beside)
            delete(self._beside)

        on_root(self._comm, end)


def _key(name: str, field: Field) -> str:
    """The name of the array of a field."""
    return f"field_{field.name}" if name == IN_CELLS else f"facet_field_{field.name}"


def _same_steps(one: Row, other: Row) -> bool:
    """Whether two sections [time] differ at most in the number of their steps."""
    lengths = (time["end"] / time["steps"] for time in (one, other))
    return math.isclose(*lengths, rel_tol=1e-9) and {**one, "end": 0, "steps": 0} == {**other, "end": 0, "steps": 0}


def _places(spaces: MeshSpaces) -> dict[str, Indices]:
    """What identifies the owned cells and the facets of Γ_S on any rank: the bits of the sums of their vertices."""
    vertices = {"cells": corners(spaces.mesh), "facets": facet_corners(spaces.mesh, spaces.facets)}
    sums = {key: np.sort(x, axis=1).sum(axis=1) + 0.0 for key, x in vertices.items()}  # sorted: the same bits
    return {key: np.ascontiguousarray(rows).view(np.int64) for key, rows in sums.items()}
