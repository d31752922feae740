"""A solution saved so that any number of ranks can read it: arrays in one NumPy file, numbered as the mesh was made.

RT0 is rebuilt from what it is on each cell, σ(x) = σ(x_T) + (∇·σ/d)(x − x_T), so no degree of freedom, and with it no
partition, enters the file.
"""

import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from pydantic import ValidationError

from signorini_fenicsx.active_set import Step
from signorini_fenicsx.algorithms import ALGORITHMS
from signorini_fenicsx.case import Case
from signorini_fenicsx.conditions import FacetConditions
from signorini_fenicsx.discretisation import discrete_data
from signorini_fenicsx.domain import Domain, Marks, Part, axis_part, distribute, facet_vertices, marked_domain
from signorini_fenicsx.errors import InputError
from signorini_fenicsx.exchange import repair
from signorini_fenicsx.gather import FacetTable, Fields
from signorini_fenicsx.geometry import SHAPES
from signorini_fenicsx.kkt import kkt_residuals
from signorini_fenicsx.parallel import on_root, scatter_rows
from signorini_fenicsx.solution import Solution
from signorini_fenicsx.spaces import Spaces, build_spaces, centroids

FILE = "checkpoint.npz"

type Arrays = dict[str, npt.NDArray]


def write_checkpoint(path: Path, solution: Solution, fields: Fields, facets: FacetTable, marks: Marks) -> None:
    """Write a gathered solution (rank 0).

    Cells and points are numbered as the mesh was made, and a facet of Γ_S is known by its vertices. Pictures can be
    made of the file alone.

    Args:
        path: Of the file.
        solution: The solution, for what is the same on all ranks.
        fields: Its mesh and cell values.
        facets: Its values on Γ_S.
        marks: Its boundary parts and regions.
    """
    about = {
        "name": solution.case.name,
        "case": solution.case.model_dump(mode="json", exclude_unset=True),
        "part_names": solution.spaces.part_names,
        "parts": {name: part.label for name, part in solution.spaces.domain.parts.items()},
        "regions": marks.regions,
        "bend": solution.spaces.domain.bend,
        "history": [asdict(step) for step in solution.history],
        "beta": solution.conditions.beta,
        **{key: getattr(solution, key) for key in ABOUT},
    }
    arrays = {key: getattr(fields, key) for key in ("points", "cells", "u", "sigma", "divergence")}
    arrays |= {f"facet_{key}": values for key, values in vars(facets).items()}
    arrays |= {f"part_{index}": vertices for index, vertices in enumerate(marks.facets.values())}
    arrays |= {} if marks.cells is None else {"inside": marks.cells}
    with path.open("wb") as file:
        np.savez(file, about=np.array(json.dumps(about)), **arrays)


ABOUT = ("reason", "converged", "backend", "dofs", "linear_solver", "rough_steps", "timings", "peak_memory")
"""What a solution says about how it was found."""


def load_solution(folder: Path | str, comm: MPI.Comm) -> Solution:
    """Read the solution of a results folder, on as many ranks as there are now (collective).

    Raises:
        InputError: If there is none, or it is not readable.
    """
    path = Path(folder) / FILE
    everything: list[Arrays] = []

    def read() -> tuple[dict[str, Any], Arrays, int, float]:
        repair(folder)
        about, arrays = _read(path)
        everything.append(arrays)
        facets = {key: arrays[key] for key in arrays if key.startswith("facet_")}
        return about, facets, arrays["points"].shape[1], about["bend"]

    about, facets, dim, bend = on_root(comm, read)
    arrays = everything[0] if everything else {}
    case = _case(path, about)
    points = arrays.get("points", np.empty((0, dim)))
    cells = arrays.get("cells", np.empty((0, dim + 1), dtype=np.int64))
    domain = marked_domain(distribute(comm, points, cells, dim), _parts(case, about), _marks(about, arrays, dim), bend)
    spaces = build_spaces(domain, case.boundary.signorini, case.boundary.neumann)
    rows = _rows(facets["facet_vertices"], facet_vertices(spaces.mesh, spaces.facets))
    sigma, u = _fields(spaces, arrays)
    sigma.x.array[spaces.flux_dofs] = facets["facet_flux"][rows] * spaces.facet_measure / spaces.basis_flux
    sigma.x.scatter_forward()
    p = spaces.multiplier(facets["facet_p"][rows])
    data = discrete_data(case, spaces)
    return Solution(
        case=case,
        algorithm=ALGORITHMS[case.solve.algorithm],
        spaces=spaces,
        data=data,
        sigma=sigma,
        u=u,
        p=p,
        conditions=FacetConditions(facets["facet_condition"][rows].astype(np.int8), about["beta"]),
        history=[Step(**step) for step in about["history"]],
        kkt=kkt_residuals(spaces, sigma, u, p, data, ALGORITHMS[case.solve.algorithm].penalty, case.solve.eps),
        **{key: about[key] for key in ABOUT},
    )


def shared_domain(start: Solution, case: Case) -> Domain | None:
    """The mesh of an earlier solution if the case asks for the same one; a file may have changed since."""
    earlier = start.case
    same = (earlier.geometry, earlier.solve.h) == (case.geometry, case.solve.h) and case.geometry.file is None
    return start.spaces.domain if same else None


def _read(path: Path) -> tuple[dict[str, Any], Arrays]:
    if not path.is_file():
        raise InputError(f"{path.parent}: holds no {FILE}, so no solution to start from")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        return json.loads(str(arrays.pop("about"))), arrays
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a readable solution ({error})") from None


def _case(path: Path, about: dict[str, Any]) -> Case:
    try:
        return Case.model_validate(about["case"] | {"name": about["name"]})
    except (ValidationError, KeyError):
        raise InputError(f"{path}: its case is from another version, or its data were given in Python") from None


def _parts(case: Case, about: dict[str, Any]) -> Mapping[str, Part]:
    if case.geometry.shape is not None:
        return SHAPES[case.geometry.shape].parts
    return {name: axis_part(label) for name, label in about["parts"].items()}


def _marks(about: dict[str, Any], arrays: Arrays, dim: int) -> Marks:
    """Parts and regions, on rank 0; nothing elsewhere."""
    empty = np.empty((0, dim), dtype=np.int64)
    facets = {name: arrays.get(f"part_{index}", empty) for index, name in enumerate(about["parts"])}
    return Marks(facets, arrays.get("inside"), tuple(about["regions"]))


def _fields(spaces: Spaces, arrays: Arrays) -> tuple[fem.Function, fem.Function]:
    """σ_h and u_h from cell values that rank 0 has in the order in which the mesh was made (collective)."""
    mesh = spaces.mesh
    dim = mesh.geometry.dim
    centroid = centroids(mesh)
    middle = fem.Function(centroid.function_space)
    divergence, u = fem.Function(spaces.Q), fem.Function(spaces.Q, name="u")
    for function, key in ((middle, "sigma"), (divergence, "divergence"), (u, "u")):
        values = scatter_rows(mesh.comm, mesh.topology.original_cell_index, arrays.get(key))
        function.x.array[:] = values.ravel()
    sigma = fem.Function(spaces.V, name="sigma")
    x = ufl.SpatialCoordinate(mesh)
    sigma.interpolate(fem.Expression(middle + divergence / dim * (x - centroid), spaces.V.element.interpolation_points))
    sigma.x.scatter_forward()
    return sigma, u


def _rows(known: npt.NDArray[np.int64], wanted: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Row of each facet in the file, found by its vertices."""
    row = {tuple(vertices): index for index, vertices in enumerate(known.tolist())}
    return np.array([row[tuple(vertices)] for vertices in wanted.tolist()], dtype=np.int64)
