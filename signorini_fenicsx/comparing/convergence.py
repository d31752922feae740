"""Errors in h and in ε against a reference solution, as in Tables 1 to 6 and Figures 13, 17 and 21 of the slides."""

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import collect_garbage, collector_off
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.base.shipped import data_folder
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.comparing.comparison import differences
from signorini_fenicsx.methods.registry import methods_that
from signorini_fenicsx.solving.solved import Solved
from signorini_fenicsx.solving.solver import Solver

ERRORS = {
    **{"sigma_V": "‖δσ‖_V", "u_Q": "‖δu‖_Q", "p_Lambda": "‖δp‖_Λ", "p_half": "‖δp‖_½"},
    **{"flux_Lambda": "‖δσ·n‖_Λ", "flux_scaled": "√ε‖δσ·n‖_Λ"},
    **{"energy": "|δσ|", "u_L2": "‖δu‖", "pressure_L2": "‖δσ_nn‖", "gap_L2": "‖δu_n‖"},
}
"""Norms of differences, and what reports call them; others have their own names there."""
ASYMPTOTIC_EPS = 1e-2
"""Slopes in ε are fitted to rows with ε up to this value."""


class Vary(Enum):
    """What a study varies from row to row; EPS_H and EPS_H2 vary h with ε = h or ε = h²."""

    H = "h"
    EPS = "eps"
    EPS_H = "eps=h"
    EPS_H2 = "eps=h^2"


@dataclass(frozen=True)
class ErrorRow:
    """Errors of one run against the reference, and those of the slides if they give them.

    Orders compare a row with the row before; the first row has None. They are orders in ε if ε varies, otherwise in the
    mean cell size cells^(-1/d), because the largest diameter of a Gmsh mesh is an outlier.

    Attributes:
        level: h ≤ 2^-level, or ε = 10^-level if ε varies.
        h: Largest cell diameter.
        eps: ε; None without a penalty.
        cells: Number of cells.
        iterations: Iterations of the algorithm.
        errors: Norms of the difference from the reference; √ε‖(σ_ref − σ_h)·n‖_Λ is None without a penalty.
        orders: Their orders.
        slides: Errors of σ and u in the slides, None where they give none; empty for other norms than those.
    """

    level: int
    h: float
    eps: float | None
    cells: int
    iterations: int
    errors: Mapping[str, float | None]
    orders: Mapping[str, float | None]
    slides: Mapping[str, float | None]

    def columns(self) -> dict[str, float | None]:
        """All numbers by the names that tables give them."""
        values = {name: getattr(self, name) for name in ("level", "h", "eps", "cells", "iterations")}
        for name, error in self.errors.items():
            values |= {name: error, f"{name}_order": self.orders[name]}
        return values | {f"slides_{name}": error for name, error in self.slides.items()}


def slides_errors(case: str, algorithm: str) -> dict[int, tuple[float, float]]:
    """The errors of σ and u in the slides per level; empty if the slides give none."""
    with (data_folder("tables") / "slides.csv").open(newline="", encoding="utf-8") as file:
        return {
            int(row["level"]): (float(row["sigma_V"]), float(row["u_Q"]))
            for row in csv.DictReader(file)
            if (row["case"], row["algorithm"]) == (case, algorithm)
        }


@collector_off()
def convergence_study(
    case: CaseFile,
    vary: Vary,
    levels: Sequence[int],
    reference: int,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    on_row: Callable[[ErrorRow], None] = lambda row: None,
) -> list[ErrorRow]:
    """Solve for several h or ε and measure errors against a reference (collective).

    If h varies, the reference is the same problem with h ≤ 2^-reference. If ε depends on h, it is Algorithm 1 with that
    h. If ε varies, it is Algorithm 1 on the same mesh, so the error is that of the penalty alone.

    Args:
        case: The problem; its own value of what varies is ignored.
        vary: What varies.
        levels: h ≤ 2^-level, or ε = 10^-level.
        reference: Level of the reference, finer than all levels; unused if ε varies.
        comm: Communicator.
        on_row: Called on all ranks with each finished row.

    Raises:
        InputError: If a mesh cannot be made, or ε should vary for an algorithm without penalty.
        NumericalFailure: If a run fails.
    """
    if vary is not Vary.H and not case.method.has_eps:
        penalised = methods_that(lambda method: method.has_eps)
        raise InputError(f"--vary {vary.value}: {case.solve.algorithm} has no ε; {penalised} have it")
    solver = _solver(case, comm) if vary is Vary.EPS else None
    if solver is not None:  # the table has the steps of the algorithm itself, which a prediction would save
        case = case.with_values({"solve.predict": False})
    cases = [case.with_values(level_values(vary, level)) for level in levels]
    best = case if vary is Vary.H else case.with_values({"solve.algorithm": "alg1"})
    if solver is None:
        best = best.with_values({"solve.h": 2.0**-reference})

    def solved(problem: CaseFile) -> Solved:
        with doing(f"{problem.fineness}, {problem.solve.algorithm}"):
            solution: Solved = solve_case(problem, comm, domain=solver)
        return solution

    fine = solved(best)
    slides = slides_errors(case.name, case.solve.algorithm) if vary is Vary.H else {}
    rows: list[ErrorRow] = []
    for level, problem in zip(levels, cases, strict=True):
        row = _row(level, solved(problem), fine, rows[-1] if rows else None, vary, slides.get(level))
        rows.append(row)
        on_row(row)
        collect_garbage(comm)
    return rows


def _solver(case: CaseFile, comm: MPI.Comm) -> Solver:
    """A solver for the case on its mesh (collective)."""
    domain = mesh_case(case, comm)
    return Solver(domain, case.posed(domain.mesh.geometry.dim))


def level_values(vary: Vary, level: int) -> dict[str, float]:
    """The keys of the case that a level changes, and their values."""
    match vary:
        case Vary.H:
            return {"solve.h": 2.0**-level}
        case Vary.EPS:
            return {"solve.eps": 10.0**-level}
        case Vary.EPS_H:
            return {"solve.h": 2.0**-level, "solve.eps": 2.0**-level}
        case Vary.EPS_H2:
            return {"solve.h": 2.0**-level, "solve.eps": 4.0**-level}


def _row(
    level: int,
    coarse: Solved,
    fine: Solved,
    before: ErrorRow | None,
    vary: Vary,
    slides: tuple[float, float] | None,
) -> ErrorRow:
    with doing("comparing"):
        difference = differences(coarse, fine)
    domain, options = coarse.spaces.domain, coarse.options
    eps = options.eps if options.method.has_eps else None
    errors: dict[str, float | None] = dict(vars(difference))
    flux = errors.pop("flux_Lambda", None)
    if flux is not None:
        errors["flux_scaled"] = None if eps is None else math.sqrt(eps) * flux

    def order(name: str, value: float | None) -> float | None:
        earlier = None if before is None else before.errors[name]
        if before is None or not earlier or not value:
            return None
        if vary is Vary.EPS:
            return math.log(earlier / value) / math.log(before.eps / options.eps) if before.eps else None
        return domain.mesh.topology.dim * math.log(earlier / value) / math.log(domain.cells / before.cells)

    return ErrorRow(
        level=level,
        h=domain.h,
        eps=eps,
        cells=domain.cells,
        iterations=len(coarse.outcome.history),
        errors=errors,
        orders={name: order(name, error) for name, error in errors.items()},
        slides=dict(zip(("sigma_V", "u_Q"), slides or (None, None), strict=True)) if "sigma_V" in errors else {},
    )


def fitted_slopes(rows: list[ErrorRow], vary: Vary) -> dict[str, float]:
    """Least-squares slopes of the errors on logarithmic axes, against 2^-level or ε (ε ≤ ASYMPTOTIC_EPS)."""
    if vary is Vary.EPS:
        rows = [row for row in rows if row.eps is not None and row.eps <= ASYMPTOTIC_EPS * (1 + 1e-12)]
    slopes = {}
    for name in rows[0].errors if len(rows) > 1 else ():
        values = [row.errors[name] for row in rows]
        if all(values):
            base = 10 if vary is Vary.EPS else 2
            logarithms = np.log(np.array(values, dtype=np.float64)) / np.log(base)
            slopes[name] = -float(np.polyfit([row.level for row in rows], logarithms, 1)[0])
    return slopes
