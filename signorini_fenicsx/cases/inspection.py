"""Inspection of a case before it is solved: its sizes and parts, the cost of a run, and whether a run could start."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.errors import telling
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.domains import mesh_case, rough_cells
from signorini_fenicsx.cases.quantities import AT_ONCE
from signorini_fenicsx.cases.solving import options_of, posed_on
from signorini_fenicsx.discrete.cell_shapes import corners, hat_gradients
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.pair_overviews import overviews
from signorini_fenicsx.meshes.checks import faces, left_over, neighbours
from signorini_fenicsx.meshes.domain import Domain, other_side
from signorini_fenicsx.meshes.memory import FACETS_PER_CELL, PROCESS_BYTES
from signorini_fenicsx.meshes.meshing import usable
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import System, Wish, system_on

START_SECONDS = 3.0
"""Seconds to load the libraries and the compiled forms; when forms are compiled for the first time it takes longer."""

OF_INTERVAL, OF_LATER_INTERVAL = 10.0, 2.0
"""What an interval that is searched costs beside a run without one, measured as 4 to 11; in later steps two bounds."""

NONE_OF_ITS_OWN = "none of its own"
"""What is said of a part all of whose facets are in parts that lists have."""


@dataclass(frozen=True)
class Expected:
    """Sizes of a case and the expected cost of solving it. Sizes of named shapes and of `.geo` files are estimates.

    Attributes:
        dim: Dimension.
        parts: For each boundary part its condition and, for a mesh file, number, measure and centre of its facets.
        left: Parts of Γ_D that no list has; "" stands for facets of a mesh file in no part.
        regions: For each region of a mesh file the number of its cells.
        cells: Number of cells.
        facets: Number of facets.
        unknowns: Unknowns of the linear system: one per facet in the hybrid backend, d with RT1, d² in elasticity.
        exact: Whether the numbers are those of the mesh, not estimates.
        memory: Bytes for all ranks together.
        solver_seconds: Seconds from the assembled problem to the solution; in time for all steps together.
        run_seconds: Seconds of the whole run without Gmsh, with the intervals of quantities.
    """

    dim: int
    parts: dict[str, dict[str, Any]]
    left: list[str]
    regions: dict[str, int]
    cells: int
    facets: int
    unknowns: int
    exact: bool
    memory: float
    solver_seconds: float
    run_seconds: float


@dataclass(frozen=True)
class Checked:
    """What a check has found.

    Attributes:
        counts: Numbers of cells and of facets of Γ_S, which in elasticity is Γ_C, Γ_N and Γ_D.
        left: Parts of Γ_D that no list has; "" stands for facets in no part.
        parts: For each part its condition, the number of its facets, their measure and centre.
        cells: Sizes and shapes of the cells, and what is in each region, in lines by what they are of.
        pairs: Of each pair of surfaces how they cover each other, distances and sizes of facets, in a line.
        remarks: What is worth knowing of the data besides, in sentences.
    """

    counts: Mapping[str, int]
    left: Sequence[str]
    parts: Mapping[str, Mapping[str, Any]]
    cells: Sequence[tuple[str, str]]
    pairs: Sequence[str]
    remarks: Sequence[str]


def expected(case: CaseFile, ranks: int) -> Expected:
    """Estimate sizes, memory and time of a case; a file is read, a named shape is not meshed (rank 0).

    Args:
        case: The case.
        ranks: Number of ranks of the run.

    Raises:
        InputError: If the file, its mesh or its parts cannot be used.
    """
    geometry = case.geometry
    parts: dict[str, dict[str, Any]]
    listed, regions = case.parts.listed(), dict[str, int]()
    exact = geometry.shape is None and case.file_h is None
    if geometry.shape is not None:
        shape = shape_of(geometry.shape)
        dim = shape.dim
        parts = {name: {"condition": case.condition_of(name)} for name in shape.names}
        left = [name for name in shape.names if name not in listed]
        cells = round(rough_cells(case))
        facets = round(FACETS_PER_CELL[dim] * cells)
    else:
        mesh = usable(geometry.source, geometry.source.read(None)[0], case.parts.named, case.sides)
        case.check_dimension(mesh.dim)
        dim = mesh.dim
        counts = left_over(mesh, [*listed, *map(other_side, case.inner)])
        left = [name for name, number in counts.items() if number > 0]
        parts = {
            name: {
                "condition": case.condition_of(name) if counts.get(name) != 0 else NONE_OF_ITS_OWN,
                "facets": len(rows),
                "measure": _measure(mesh.points[rows]),
                "center": (_moments(mesh.points[rows]) / _measure(mesh.points[rows])).tolist() if len(rows) else [],
            }
            for name, rows in mesh.parts.items()
            if name not in map(other_side, case.inner)
        }
        regions = {name: len(rows) for name, rows in mesh.regions.items()}
        cells, sides = len(mesh.cells) if exact else round(rough_cells(case)), (dim + 1) * len(mesh.cells)
        facets = round((sides - len(neighbours(faces(mesh.cells))[0])) * cells / len(mesh.cells))
    cost, steps = case.costs[dim], max(case.steps, 1)
    searched = sum(each.kind not in AT_ONCE for each in case.quantity)
    runs = 1 + searched * (OF_INTERVAL + OF_LATER_INTERVAL * (steps - 1))
    of_linear = facets / cost.solver_rate / ranks
    solver_seconds = steps * (cost.times * of_linear + cost.least)
    return Expected(
        dim=dim,
        parts=parts,
        left=left,
        regions=regions,
        cells=cells,
        facets=facets,
        unknowns=cost.unknowns * facets,
        exact=exact,
        memory=ranks * PROCESS_BYTES + cost.memory * facets,
        solver_seconds=solver_seconds,
        run_seconds=START_SECONDS + facets * runs / cost.run_rate / ranks + solver_seconds - of_linear,
    )


def is_typical(case: CaseFile) -> bool:
    """Whether the measured rates hold for the algorithm and the backend of the case."""
    return case.method.starts_from_sets and case.solve.backend == "hybrid"


def check(case: CaseFile, comm: MPI.Comm) -> Checked:
    """Do everything that a run does before it solves: make or read the mesh, find parts, project data (collective).

    In time the data of all steps are projected.

    Raises:
        InputError: If a run of the case would fail here.
    """
    with doing("mesh"):
        domain = mesh_case(case, comm)
    with doing("assembly"):
        posed = posed_on(case, domain)
        system = system_on(domain, posed)
        spaces, contact = system.spaces, next(iter(system.boundary.named))
        if case.time is None:
            remarks = system.prepared(posed, Wish(options_of(case))).remarks()
        else:
            remarks = _check_steps(system, posed, case.time.evolution(), options_of(case))
    topology = domain.mesh.topology
    counts = [
        topology.index_map(topology.dim).size_local,
        *map(len, (spaces.facets, spaces.neumann_facets, spaces.dirichlet_facets)),
    ]
    names = ("cells", f"{contact}_facets", "neumann_facets", "dirichlet_facets")
    totals = dict(zip(names, comm.allreduce(np.array(counts)).tolist(), strict=True))
    pairs = [each.line() for each in overviews(getattr(spaces, "pairs", ()), comm)]
    remarks = [*spaces.notices, *remarks]
    return Checked(totals, _left(case, spaces), _parts(case, spaces), _cells(domain), pairs, remarks)


def _cells(domain: Domain) -> list[tuple[str, str]]:
    """Lengths of edges and the flattest cell, and cells and measure of each region, in lines (collective)."""
    x, comm = corners(domain.mesh), domain.mesh.comm
    one, other = np.triu_indices(x.shape[1], 1)
    edges = np.linalg.norm(x[:, one] - x[:, other], axis=2)
    heights = 1 / np.linalg.norm(hat_gradients(domain.mesh), axis=2).max(axis=1)
    extremes = edges.min(initial=np.inf), -edges.max(initial=0.0), (heights / edges.max(axis=1)).min(initial=np.inf)
    short, long, flat = np.min(comm.allgather(extremes), axis=0)
    found = [("cells", f"edges from {short:.3g} to {-long:.3g}, the flattest cell {flat:.2g} times as high as long")]
    for name, rows in domain.regions.items():
        count, measure = comm.allreduce(np.array([len(rows), _measure(x[rows])]))
        found.append(("region", f"{name}: {count:.0f} cells, measure {measure:.6g}"))
    return found


def _parts(case: CaseFile, spaces: MeshSpaces) -> dict[str, dict[str, Any]]:
    """The condition and the size of each part of the boundary and of each inner part (collective)."""
    mesh, facets, listed = spaces.mesh, spaces.domain.facets, case.parts.listed()
    names = [name for name in facets if name not in map(other_side, case.inner)]
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    of_parts = [mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, dim - 1, facets[name]), :dim] for name in names]
    own = [name in listed or len(np.intersect1d(facets[name], spaces.dirichlet_facets)) for name in names]
    sizes = [[len(each), _measure(each), own[i], *_moments(each)] for i, each in enumerate(of_parts)]
    rows = mesh.comm.allreduce(np.array(sizes, dtype=float).reshape(-1, 3 + dim))
    return {
        name: {
            "condition": case.condition_of(name) if has_own else NONE_OF_ITS_OWN,
            "facets": int(count),
            "measure": float(measure),
            "center": [float(moment / measure) for moment in moments],
        }
        for name, (count, measure, has_own, *moments) in zip(names, rows, strict=True)
    }


def _left(case: CaseFile, spaces: MeshSpaces) -> list[str]:
    """Parts of Γ_D that no list has, and "" for facets in no part (collective)."""
    facets, listed = spaces.domain.facets, case.parts.listed()
    others = {name: numbers for name, numbers in facets.items() if name not in listed}
    nowhere = np.setdiff1d(spaces.dirichlet_facets, np.concatenate([*facets.values(), []]))
    counts_of_parts = [len(np.intersect1d(numbers, spaces.dirichlet_facets)) for numbers in others.values()]
    counts = spaces.mesh.comm.allreduce(np.array([*counts_of_parts, len(nowhere)]))
    return [name for name, count in zip([*others, ""], counts, strict=True) if count > 0]


def _check_steps(system: System, problem: Any, evolution: Evolution, options: Options) -> list[str]:
    """Read the data of all steps in time, as a run does (collective).

    Returns:
        What is worth knowing of each datum, in a sentence with the first step that has it.

    Raises:
        InputError: If a datum is not what it has to be, or there is not one solution.
    """
    steps, remarks = system.steps(problem, evolution, None, options), dict[str, str]()
    steps.start()
    for step in range(1, evolution.steps + 1):
        when = f"step {step}, t = {evolution.time(step):.5g}"
        with telling(when):
            for remark in system.check(steps.problem(step)):
                remarks.setdefault(remark.partition(":")[0], f"{when}: {remark}")
    return list(remarks.values())


def _measures(x: np.ndarray) -> np.ndarray:
    """The measure of each of some simplices with these corners, shape (simplices, corners, dim)."""
    edges = x[:, 1:] - x[:, :1]
    gram = np.linalg.det(edges @ edges.transpose(0, 2, 1))
    return np.asarray(np.sqrt(np.abs(gram)) / math.factorial(x.shape[1] - 1))


def _measure(x: np.ndarray) -> float:
    """The measure of simplices with these corners."""
    return float(_measures(x).sum())


def _moments(x: np.ndarray) -> np.ndarray:
    """The integrals of the coordinates over simplices with these corners."""
    return np.asarray(_measures(x) @ x.mean(axis=1))
