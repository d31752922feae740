"""Inspection of a case before it is solved: its sizes and parts, the cost of a run, and whether a run could start."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.cases.domains import mesh_case, rough_cells
from signorini_fenicsx.discrete.data import project_data
from signorini_fenicsx.discrete.evolution import Steps
from signorini_fenicsx.discrete.spaces import build_spaces
from signorini_fenicsx.meshes.checks import FileMesh, check_boundary, faces, neighbours
from signorini_fenicsx.meshes.files import read_mesh_file
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.solving.solver import check_solvability

FACETS_PER_CELL = {2: 1.5, 3: 2.0}
PROCESS_BYTES = 180 * 2**20
BYTES_PER_FACET = {2: 830.0, 3: 940.0}
"""For alg1 to alg4 with the hybrid backend, certificate and output included; measured on at least 395 000 facets."""
SOLVER_RATE = {2: 177e3, 3: 196e3}
"""Facets per second and core from the assembled problem to the solution; see docs/measured/speed.md."""
RUN_RATE = 5e4
"""Facets per second and core of a whole run, with a structured mesh, the certificate and output."""
START_SECONDS = 3.0
"""Seconds to load the libraries and the compiled forms; when forms are compiled for the first time it takes longer."""


@dataclass(frozen=True)
class Expected:
    """Sizes of a case and the expected cost of solving it. Sizes of named shapes and of `.geo` files are estimates.

    Attributes:
        dim: Dimension.
        parts: For each boundary part its condition and, for a mesh file, number and measure of its facets.
        regions: For each region of a mesh file the number of its cells.
        cells: Number of cells.
        facets: Number of facets, which are the unknowns of the hybrid backend.
        exact: Whether the numbers are those of the mesh, not estimates.
        memory: Bytes for all ranks together.
        solver_seconds: Seconds from the assembled problem to the solution.
        run_seconds: Seconds of the whole run without Gmsh.
    """

    dim: int
    parts: dict[str, dict[str, Any]]
    regions: dict[str, int]
    cells: int
    facets: int
    exact: bool
    memory: float
    solver_seconds: float
    run_seconds: float


def expected(case: Case, ranks: int) -> Expected:
    """Estimate sizes, memory and time of a case; a file is read, a named shape is not meshed (rank 0).

    Args:
        case: The case.
        ranks: Number of ranks of the run.

    Raises:
        InputError: If the file, its mesh or its parts cannot be used.
    """
    geometry = case.geometry
    parts: dict[str, dict[str, Any]]
    regions: dict[str, int] = {}
    cells = round(rough_cells(case))
    exact = geometry.shape is None and case.file_h is None
    if geometry.shape is not None:
        dim = SHAPES[geometry.shape].dim
        parts = {name: {"condition": _condition(case, name)} for name in SHAPES[geometry.shape].parts}
        facets = round(FACETS_PER_CELL[dim] * cells)
    else:
        mesh = _usable(case, read_mesh_file(geometry.file or ""))
        dim = mesh.dim
        parts = {
            name: {"condition": _condition(case, name), "facets": len(rows), "measure": _measure(mesh.points[rows])}
            for name, rows in mesh.parts.items()
        }
        regions = {name: len(rows) for name, rows in mesh.regions.items()}
        sides = (dim + 1) * len(mesh.cells)
        facets = round((sides - len(neighbours(faces(mesh.cells))[0])) * cells / len(mesh.cells))
    return Expected(
        dim=dim,
        parts=parts,
        regions=regions,
        cells=cells,
        facets=facets,
        exact=exact,
        memory=ranks * PROCESS_BYTES + BYTES_PER_FACET[dim] * facets,
        solver_seconds=facets / SOLVER_RATE[dim] / ranks,
        run_seconds=START_SECONDS + facets / RUN_RATE / ranks,
    )


def is_typical(case: Case) -> bool:
    """Whether the measured rates hold for the algorithm and the backend of the case."""
    return case.method.starts_from_sets and case.solve.backend == "hybrid"


def check(case: Case, comm: MPI.Comm) -> Mapping[str, int]:
    """Do everything that a run does before it solves: make or read the mesh, find parts, project data (collective).

    Returns:
        Numbers of cells and of facets of Γ_S, Γ_N and Γ_D.

    Raises:
        InputError: If a run of the case would fail here.
    """
    with doing("mesh"):
        domain = mesh_case(case, comm)
    with doing("assembly"):
        spaces = build_spaces(domain, [*case.boundary.signorini, *case.law_parts], case.boundary.neumann)
        problem = case.data(domain.mesh.geometry.dim)
        if case.time is not None:
            steps = Steps(spaces, problem, case.time.evolution())
            steps.start()
            problem = steps.problem(1)
        check_solvability(spaces, project_data(spaces, problem))
    topology = domain.mesh.topology
    counts = [
        topology.index_map(topology.dim).size_local,
        *map(len, (spaces.facets, spaces.neumann_facets, spaces.dirichlet_facets)),
    ]
    names = ("cells", "signorini_facets", "neumann_facets", "dirichlet_facets")
    return dict(zip(names, comm.allreduce(np.array(counts)).tolist(), strict=True))


def _usable(case: Case, mesh: FileMesh) -> FileMesh:
    try:
        check_boundary(mesh, case.parts.named)
        case.check_dimension(mesh.dim)
    except InputError as error:
        raise InputError(f"mesh {case.geometry.file}: {error}") from None
    return mesh


def _condition(case: Case, part: str) -> str:
    if part in case.boundary.signorini:
        return "signorini"
    if part in case.boundary.neumann:
        return "neumann"
    return next((law.kind for law in case.law if part in law.parts), "dirichlet")


def _measure(corners: np.ndarray) -> float:
    """Length or area of facets with these corners, shape (facets, dim, dim)."""
    edges = corners[:, 1:] - corners[:, :1]
    gram = np.linalg.det(edges @ edges.transpose(0, 2, 1))
    return float(np.sqrt(np.abs(gram)).sum() / (corners.shape[1] - 1))
