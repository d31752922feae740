"""The steps of a run in time, kept beside its results until these are complete: a folder of NumPy arrays for each.

All ranks write and read it together, and any number of ranks can go on with it. See `checkpoint_writing`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.array_files import read_header, read_share, write_arrays
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.exchange import delete
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.rows import Order, fetch_rows, find_rows
from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.discrete.contact_sets import FacetSegments
from signorini_fenicsx.discrete.spaces import Spaces
from signorini_fenicsx.meshes.domain import facet_vertices
from signorini_fenicsx.output.gather import FacetTable, cell_values, facet_table, in_order
from signorini_fenicsx.solving.evolving import Instant, Past
from signorini_fenicsx.solving.solver import Solver

CASE, ROW = "case.json", "row.json"
type Row = Mapping[str, Any]
"""The numbers of a step."""


class StepFolder:
    """The folder `<target>.steps`. Its methods are collective."""

    def __init__(self, comm: MPI.Comm, target: Path):
        """Keep the place; nothing on disk changes."""
        self._comm = comm
        self.path = target.with_name(target.name + ".steps")
        self._order: tuple[Spaces, Order] | None = None

    def begin(self, case: Case, *, restart: bool) -> int:
        """Make the folder, or find out where to go on.

        Returns:
            The last step that is complete; 0 for none.

        Raises:
            InputError: If there are steps of another run, or there is nothing to go on with.
        """
        about = case.model_dump(mode="json", exclude_unset=True)
        return on_root(self._comm, lambda: self._begin(about, restart=restart))

    def _begin(self, about: Mapping[str, Any], *, restart: bool) -> int:
        if not restart:
            if self.path.exists():
                raise InputError(f"{self.path} has steps of a run that was ended; go on with --restart, or remove it")
            self.path.mkdir(parents=True)
            (self.path / CASE).write_text(json.dumps(about), encoding="utf-8")
            return 0
        try:
            before = json.loads((self.path / CASE).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            raise InputError(f"--restart: there is no {self.path} with steps to go on with") from None
        changed = [key for key in {**before, **about} if before.get(key) != about.get(key)]
        if changed:
            raise InputError(f"--restart: {self.path} is of a case with another [{changed[0]}]; take the same case")
        for entry in self.path.glob("*.part"):
            delete(entry)
        return len(self._places())

    def _places(self) -> list[Path]:
        """The folders of the steps that are complete, in order (rank 0)."""
        return sorted(entry for entry in self.path.iterdir() if entry.suffix == "" and entry.name.isdigit())

    def save(self, instant: Instant, row: Row) -> None:
        """Keep a step.

        Raises:
            OSError: On all ranks, if the disk is full.
        """
        solution, comm = instant.solution, self._comm
        spaces = solution.spaces
        if self._order is None or self._order[0] is not spaces:
            self._order = spaces, Order(comm, spaces.mesh.topology.original_cell_index)
        part = self._place(instant.step).with_suffix(".part")
        on_root(comm, part.mkdir)
        arrays = {key: self._order[1].sorted(rows) for key, rows in cell_values(solution).items()}
        arrays |= {f"facet_{key}": rows for key, rows in vars(facet_table(solution)).items()}
        arrays["facet_own"] = solution.segments().segment
        write_arrays(comm, part, arrays)

        def end() -> None:
            (part / ROW).write_text(json.dumps(dict(row)), encoding="utf-8")
            part.rename(self._place(instant.step))

        on_root(comm, end)

    def _place(self, step: int) -> Path:
        return self.path / f"{step:06}"

    def rows(self) -> list[Row]:
        """The numbers of all steps; none on ranks but 0."""
        if self._comm.rank > 0:
            return []
        return [json.loads((place / ROW).read_text(encoding="utf-8")) for place in self._places()]

    def cells(self, spaces: Spaces, step: int, key: str) -> Array:
        """u, sigma or divergence in the cells of this rank after a step, see `gather.Fields`."""
        found: Array = fetch_rows(self._comm, spaces.mesh.topology.original_cell_index, self._read(step, key))
        return found

    def in_order(self, step: int, key: str) -> Array:
        """The same for all cells in the order of the mesh (rank 0, not collective)."""
        found: Array = np.load(self._place(step) / f"{key}.npy")
        return found

    def facets(self, step: int) -> FacetTable:
        """Γ_S after a step (rank 0, not collective)."""
        columns = {key: np.load(self._place(step) / f"facet_{key}.npy") for key in FacetTable.__dataclass_fields__}
        return in_order(FacetTable(**columns))

    def past(self, solver: Solver, step: int) -> Past:
        """What the step after this one needs.

        Raises:
            InputError: If these are not the cells and facets of this mesh.
        """
        spaces = solver.spaces
        u = []
        for earlier in range(step, max(step - 2, 0), -1):
            values = fem.Function(spaces.Q, name="u")
            values.x.array[:] = self.cells(spaces, earlier, "u").ravel()
            u.append(values)
        own, vertices = self._read(step, "facet_own"), self._read(step, "facet_vertices").astype(np.int64)
        rows = find_rows(self._comm, facet_vertices(spaces.mesh, spaces.facets), [vertices])[:, 0]
        if self._comm.allreduce(int(np.count_nonzero(rows < 0))) > 0:
            raise InputError(f"--restart: {self.path} is of another mesh")
        return Past(step, u, FacetSegments(spaces, fetch_rows(self._comm, rows, own)))

    def _read(self, step: int, key: str) -> Array:
        path = self._place(step) / f"{key}.npy"
        rows: Array = read_share(self._comm, path, on_root(self._comm, lambda: read_header(path)))
        return rows

    def remove(self) -> None:
        """Remove the folder with all steps."""
        on_root(self._comm, lambda: delete(self.path))
