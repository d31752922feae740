"""Errors against a fine solution on a non-nested mesh, as in Tables 1 to 6 of the slides."""

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import basix.ufl
import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms.norms import l2
from signorini_fenicsx.case import Case, data_folder
from signorini_fenicsx.solver import Solution, solve

QUADRATURE_DEGREE = 2
"""Exact for squares of RT0 differences on fine cells that one coarse cell covers."""


@dataclass(frozen=True)
class ErrorRow:
    """Errors of one level against the reference, and the slides' where they give them.

    Attributes:
        level: The mesh has h ≤ 2^-level.
        h: Largest cell diameter.
        cells: Cells.
        iterations: Iterations of the algorithm.
        sigma_V: ‖σ_ref − σ_h‖_V.
        sigma_order: Experimental order from the level before, None on the first.
        u_Q: ‖u_ref − u_h‖_Q.
        u_order: Its order.
        p_Lambda: ‖p_ref − p_h‖_Λ.
        p_order: Its order.
        slides_sigma_V: The slides' ‖σ_ref − σ_h‖_V.
        slides_u_Q: The slides' ‖u_ref − u_h‖_Q.
    """

    level: int
    h: float
    cells: int
    iterations: int
    sigma_V: float
    sigma_order: float | None
    u_Q: float
    u_order: float | None
    p_Lambda: float
    p_order: float | None
    slides_sigma_V: float | None
    slides_u_Q: float | None


@dataclass(frozen=True)
class Differences:
    """Norms of the difference of two solutions of one problem on two meshes."""

    sigma_V: float
    u_Q: float
    p_Lambda: float


def differences(coarse: Solution, fine: Solution) -> Differences:
    """‖σ − σ'‖_V, ‖u − u'‖_Q and ‖p − p'‖_Λ by quadrature on the fine mesh (collective).

    The coarse fields are evaluated at the quadrature points. Where a curved boundary is cut differently by the two
    meshes, the nearest coarse cell is taken.
    """
    padding = coarse.spaces.domain.h**2  # more than the gap between two polygons that approximate one curve
    mesh, gamma = fine.spaces.mesh, fine.spaces.Lambda.mesh
    divergence = fem.Function(coarse.spaces.Q)  # computed before sampling: derivatives of samples have no meaning
    divergence.interpolate(fem.Expression(ufl.div(coarse.sigma), coarse.spaces.Q.element.interpolation_points))
    sigma, u, div_sigma = _sampled([coarse.sigma, coarse.u, divergence], mesh, padding)
    (p,) = _sampled([coarse.p], gamma, padding)

    metadata = {"quadrature_degree": QUADRATURE_DEGREE, "quadrature_scheme": "default"}
    dx = ufl.Measure("dx", domain=mesh, metadata=metadata)
    ds = ufl.Measure("dx", domain=gamma, metadata=metadata)
    squares = [
        l2(fine.sigma - sigma, dx) + l2(ufl.div(fine.sigma) - div_sigma, dx),
        l2(fine.u - u, dx),
        l2(fine.p - p, ds),
    ]
    local = np.array([fem.assemble_scalar(fem.form(square)) for square in squares])
    return Differences(*np.sqrt(mesh.comm.allreduce(local)).tolist())


def _sampled(functions: Sequence[fem.Function], mesh: dolfinx.mesh.Mesh, padding: float) -> list[fem.Function]:
    """Values of functions of one other mesh at the quadrature points of this one (collective)."""
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    samples = []
    search = None  # finding the points is the expensive part, and the same for all functions
    for function in functions:
        element = basix.ufl.quadrature_element(mesh.basix_cell(), function.ufl_shape, degree=QUADRATURE_DEGREE)
        sample = fem.Function(fem.functionspace(mesh, element))
        search = search or fem.create_interpolation_data(
            sample.function_space, function.function_space, cells, padding=padding
        )
        sample.interpolate_nonmatching(function, cells, search)
        samples.append(sample)
    return samples


def slides_errors(case: str, algorithm: str) -> dict[int, tuple[float, float]]:
    """The slides' errors of σ and u per level, empty where they give none."""
    with (data_folder("tables") / "slides.csv").open(newline="", encoding="utf-8") as file:
        return {
            int(row["level"]): (float(row["sigma_V"]), float(row["u_Q"]))
            for row in csv.DictReader(file)
            if (row["case"], row["algorithm"]) == (case, algorithm)
        }


def convergence_study(
    case: Case,
    levels: Sequence[int],
    reference: int,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    on_start: Callable[[int], None] = lambda level: None,
    on_row: Callable[[ErrorRow], None] = lambda row: None,
) -> list[ErrorRow]:
    """Solve on meshes h ≤ 2^-level and measure errors against h ≤ 2^-reference (collective).

    Args:
        case: The problem; its h is ignored.
        levels: Ascending.
        reference: Finer than all levels.
        comm: Communicator.
        on_start: Called on all ranks with the level about to be solved.
        on_row: Called on all ranks with each finished row.

    Raises:
        InputError: If a mesh cannot be made.
        NumericalFailure: If a run fails.
    """

    def at(level: int) -> Solution:
        on_start(level)
        return solve(case.with_values({"solve.h": 2.0**-level}), comm)

    fine = at(reference)
    slides = slides_errors(case.name, case.solve.algorithm)
    rows: list[ErrorRow] = []
    for level in levels:
        coarse = at(level)
        error = differences(coarse, fine)
        before = rows[-1] if rows else None
        sigma_order, u_order, p_order = (
            None if before is None else _order(before, coarse.spaces.domain.h, name, getattr(error, name))
            for name in ("sigma_V", "u_Q", "p_Lambda")
        )
        slides_sigma, slides_u = slides.get(level, (None, None))
        mesh = coarse.spaces.mesh
        rows.append(
            ErrorRow(
                level,
                coarse.spaces.domain.h,
                mesh.topology.index_map(mesh.topology.dim).size_global,
                len(coarse.history),
                error.sigma_V,
                sigma_order,
                error.u_Q,
                u_order,
                error.p_Lambda,
                p_order,
                slides_sigma,
                slides_u,
            )
        )
        on_row(rows[-1])
    return rows


def _order(before: ErrorRow, h: float, name: str, error: float) -> float:
    """Order between two rows, over the diameters that the meshes really have."""
    return math.log(getattr(before, name) / error) / math.log(before.h / h)


def write_table(path: Path, rows: list[ErrorRow]) -> None:
    """Write the rows as CSV (rank 0)."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(ErrorRow)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
