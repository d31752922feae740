"""A solution saved so that any number of ranks can read it: arrays in one NumPy file, numbered as the mesh was made.

RT0 is rebuilt from what it is on each cell, σ(x) = σ(x_T) + (∇·σ/d)(x − x_T), so no degree of freedom, and with it no
partition, enters the file.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms.norms import l2
from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.exchange import repair
from signorini_fenicsx.base.parallel import on_root, scatter_rows
from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.cases.discretisation import discrete_data
from signorini_fenicsx.discrete.conditions import Condition, FacetConditions
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.kkt import TOLERANCE, KKTResiduals, kkt_residuals
from signorini_fenicsx.discrete.spaces import Spaces, build_spaces, centroids
from signorini_fenicsx.meshes.domain import Domain, Marks, Part, axis_part, distribute, facet_vertices, marked_domain
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.methods.registry import ALGORITHMS, Algorithm, By
from signorini_fenicsx.output.checkpoint_file import About, Arrays, read_checkpoint
from signorini_fenicsx.output.gather import FacetTable, Fields
from signorini_fenicsx.solving.solution import Solution

FILE = "checkpoint.npz"


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
        "kkt": vars(solution.kkt),
        **{key: getattr(solution, key) for key in ABOUT},
    }
    arrays = {key: getattr(fields, key) for key in ("points", "cells", "u", "sigma", "divergence")}
    arrays |= {f"facet_{key}": values for key, values in vars(facets).items()}
    arrays |= {f"part_{index}": vertices for index, vertices in enumerate(marks.facets.values())}
    arrays |= {} if marks.cells is None else {"inside": marks.cells}
    with path.open("wb") as file:
        np.savez(file, about=np.array(json.dumps(about)), **arrays)


ABOUT = (
    *("reason", "converged", "backend", "dofs", "linear_solver", "own_residual", "details"),
    *("rough_steps", "timings", "peak_memory"),
)
"""What a solution says about how it was found."""
SAME = 1e-3
"""Part of a KKT residual by which the one of what is read may differ from the one that was written."""


def load_solution(folder: Path | str, comm: MPI.Comm) -> Solution:
    """Read the solution of a results folder, on as many ranks as there are now (collective).

    Raises:
        InputError: If there is none, it could not have been written by this program, or its fields do not have the
            residuals that they had: then it is damaged, and no part of it is used.
    """
    path = Path(folder) / FILE
    everything: list[Arrays] = []

    def read() -> tuple[About, Case, Arrays, int]:
        repair(folder)
        found = read_checkpoint(path)
        everything.append(found.arrays)
        facets = {key: array for key, array in found.arrays.items() if key.startswith("facet_")}
        return found.about, found.case, facets, found.dim

    about, case, facets, dim = on_root(comm, read)
    arrays = everything[0] if everything else {}
    points = arrays.get("points", np.empty((0, dim)))
    cells = arrays.get("cells", np.empty((0, dim + 1), dtype=np.int64))
    mesh = distribute(comm, points, cells, dim)
    domain = marked_domain(mesh, _parts(case, about), _marks(about, arrays, dim), about.bend)
    spaces = build_spaces(domain, case.boundary.signorini, case.boundary.neumann)
    rows = _rows(facets["facet_vertices"], facet_vertices(spaces.mesh, spaces.facets))
    sigma, u = _fields(spaces, arrays)
    sigma.x.array[spaces.flux_dofs] = facets["facet_flux"][rows] * spaces.facet_measure / spaces.basis_flux
    sigma.x.scatter_forward()
    p = spaces.multiplier(facets["facet_p"][rows])
    data = discrete_data(case, spaces)
    conditions = FacetConditions(facets["facet_condition"][rows].astype(np.int8), about.beta)
    algorithm = ALGORITHMS[case.solve.algorithm]
    kkt = kkt_residuals(spaces, sigma, u, p, data, algorithm.penalty, case.solve.eps)
    damage = _damage(about, algorithm, kkt)
    by_sets = about.converged and algorithm.by is By.SETS
    if damage is None and by_sets and not _hold(conditions, sigma, u, p, spaces, data):
        damage = "its facet conditions are not those of its values"
    if damage is not None:
        raise InputError(f"{path}: is damaged: {damage}")
    return Solution(
        case=case,
        algorithm=algorithm,
        spaces=spaces,
        data=data,
        sigma=sigma,
        u=u,
        p=p,
        conditions=conditions,
        history=about.history,
        kkt=kkt,
        **{key: getattr(about, key) for key in ABOUT},
    )


def _damage(about: About, algorithm: Algorithm, kkt: KKTResiduals) -> str | None:
    """Why the residuals of what was read cannot be those of what was written; None if they can."""
    for name, value in vars(kkt).items():
        before = (about.kkt or {}).get(name, value)
        if np.isfinite(before) and not abs(value - before) <= TOLERANCE + SAME * before:
            return f"its KKT residual {name} is {value:.1e}, and was {before:.1e} when it was written"
    known = about.kkt is not None or algorithm.by is not By.CLASSICAL
    judged = about.converged and known and about.own_residual is None  # others have a residual of their own
    violation = kkt.violation() if judged else None
    return None if violation is None else f"it claims to be a solution, but has {violation}"


def _hold(
    conditions: FacetConditions, sigma: fem.Function, u: fem.Function, p: fem.Function, spaces: Spaces, data: Data
) -> bool:
    """Whether σ·n = q_S and p = ψ where the conditions say so (collective)."""
    e, kind = spaces.facet_measure, conditions.kind
    flux, trace = spaces.normal_flux(sigma) - data.q_Sh, p.x.array[: len(e)] - data.psi_h
    squares = [
        e @ np.where(kind == zero, values, 0.0) ** 2
        for values, zero in ((flux, Condition.NO_FLUX), (trace, Condition.ZERO_TRACE))
    ]
    left = spaces.length() * spaces.mesh.comm.allreduce(np.array(squares))
    sizes = [spaces.integrate(l2(field, ufl.dx)) for field in (sigma, u)]
    return bool(np.all(np.sqrt(left) <= TOLERANCE * np.sqrt(sizes)))


def shared_domain(start: Solution, case: Case) -> Domain | None:
    """The mesh of an earlier solution if the case asks for the same one; a file may have changed since."""
    earlier = start.case
    same = (earlier.geometry, earlier.solve.h) == (case.geometry, case.solve.h) and case.geometry.file is None
    return start.spaces.domain if same else None


def _parts(case: Case, about: About) -> Mapping[str, Part]:
    if case.geometry.shape is not None:
        return SHAPES[case.geometry.shape].parts
    return {name: axis_part(label) for name, label in about.parts.items()}


def _marks(about: About, arrays: Arrays, dim: int) -> Marks:
    """Parts and regions, on rank 0; nothing elsewhere."""
    empty = np.empty((0, dim), dtype=np.int64)
    facets = {name: arrays.get(f"part_{index}", empty) for index, name in enumerate(about.parts)}
    return Marks(facets, arrays.get("inside"), tuple(about.regions))


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


def _rows(known: Indices, wanted: Indices) -> Indices:
    """Row of each facet in the file, found by its vertices."""
    row = {tuple(vertices): index for index, vertices in enumerate(known.tolist())}
    return np.array([row[tuple(vertices)] for vertices in wanted.tolist()], dtype=np.int64)
