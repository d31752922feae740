"""Errors in h and in ε against a reference solution, as in Tables 1 to 6 and Figures 13, 17 and 21 of the slides."""

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import collect_garbage, passed_on
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.base.shipped import data_folder
from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import boundary_of, solve_case
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.sampling import QUADRATURE_DEGREE, sampled
from signorini_fenicsx.methods.registry import METHODS
from signorini_fenicsx.solving.solution import Solution
from signorini_fenicsx.solving.solver import Solver

ERRORS = {"sigma_V": "‖δσ‖_V", "u_Q": "‖δu‖_Q", "p_Lambda": "‖δp‖_Λ", "p_half": "‖δp‖_½", "flux_scaled": "√ε‖δσ·n‖_Λ"}
ASYMPTOTIC_EPS = 1e-2
"""Slopes in ε are fitted to rows with ε up to this value."""


class Vary(Enum):
    """What a study varies from row to row; EPS_H and EPS_H2 vary h with ε = h or ε = h²."""

    H = "h"
    EPS = "eps"
    EPS_H = "eps=h"
    EPS_H2 = "eps=h^2"


@dataclass(frozen=True)
class Differences:
    """Norms of the difference of two solutions of one problem.

    Attributes:
        sigma_V: ‖σ − σ'‖_V.
        u_Q: ‖u − u'‖_Q.
        p_Lambda: ‖p − p'‖_Λ.
        p_half: ‖p − p'‖ in a discrete H^{1/2}(Γ_S), see `slobodeckij_norm`.
        flux_Lambda: ‖σ·n − σ'·n‖_Λ.
    """

    sigma_V: float
    u_Q: float
    p_Lambda: float
    p_half: float
    flux_Lambda: float


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
        sigma_V: ‖σ_ref − σ_h‖_V.
        sigma_V_order: Its order.
        u_Q: ‖u_ref − u_h‖_Q.
        u_Q_order: Its order.
        p_Lambda: ‖p_ref − p_h‖_Λ.
        p_Lambda_order: Its order.
        p_half: ‖p_ref − p_h‖ in a discrete H^{1/2}(Γ_S).
        p_half_order: Its order.
        flux_scaled: √ε‖(σ_ref − σ_h)·n‖_Λ; None without a penalty.
        flux_scaled_order: Its order.
        slides_sigma_V: The slides' ‖σ_ref − σ_h‖_V.
        slides_u_Q: The slides' ‖u_ref − u_h‖_Q.
    """

    level: int
    h: float
    eps: float | None
    cells: int
    iterations: int
    sigma_V: float
    sigma_V_order: float | None
    u_Q: float
    u_Q_order: float | None
    p_Lambda: float
    p_Lambda_order: float | None
    p_half: float
    p_half_order: float | None
    flux_scaled: float | None
    flux_scaled_order: float | None
    slides_sigma_V: float | None
    slides_u_Q: float | None


def differences(coarse: Solution, fine: Solution) -> Differences:
    """Norms of the difference of two solutions, by quadrature on the mesh of the second (collective).

    The coarse fields are evaluated at the quadrature points. Near a curved boundary a point may be outside the coarse
    mesh; then the nearest coarse cell is used.
    """
    source = coarse.spaces.domain
    mesh, gamma = fine.spaces.mesh, fine.spaces.Lambda.mesh
    sigma, u, div_sigma = sampled([coarse.sigma, coarse.u, _divergence(coarse)], mesh, source)
    p, flux = sampled([coarse.p, coarse.spaces.multiplier(coarse.spaces.normal_flux(coarse.sigma))], gamma, source)
    (p_middle,) = sampled([coarse.p], gamma, source, degree=0)

    metadata = {"quadrature_degree": QUADRATURE_DEGREE, "quadrature_scheme": "default"}
    dx = ufl.Measure("dx", domain=mesh, metadata=metadata)
    ds = ufl.Measure("dx", domain=gamma, metadata=metadata)
    squares = [
        l2(fine.sigma - sigma, dx) + l2(ufl.div(fine.sigma) - div_sigma, dx),
        l2(fine.u - u, dx),
        l2(fine.p - p, ds),
        l2(fine.spaces.multiplier(fine.spaces.normal_flux(fine.sigma)) - flux, ds),
    ]
    local = np.array([fem.assemble_scalar(fem.form(square)) for square in squares])
    sigma_V, u_Q, p_Lambda, flux_Lambda = np.sqrt(mesh.comm.allreduce(local)).tolist()
    size = len(fine.spaces.facets)
    return Differences(
        sigma_V, u_Q, p_Lambda, slobodeckij_norm(fine, fine.p.x.array[:size] - p_middle.x.array[:size]), flux_Lambda
    )


def slobodeckij_norm(solution: Solution, values: Array) -> float:
    """Discrete H^{1/2}(Γ_S) norm of one value per Γ_S facet (collective; quadratic in the number of facets).

    It is the Sobolev-Slobodeckij double integral, by midpoints for each pair of different facets:
    ‖p‖² + Σ_{e≠e'} |e||e'| (p_e − p_e')² / |x_e − x_e'|^d.
    """
    spaces = solution.spaces
    dim = spaces.mesh.topology.dim
    x = dolfinx.mesh.compute_midpoints(spaces.mesh, dim - 1, spaces.facets)
    comm, mine = spaces.mesh.comm, (x.reshape(-1, 3), spaces.facet_measure, values)
    square = float(mine[1] @ values**2)
    others = mine
    for turn in range(comm.size):
        for i, (place, e, p) in enumerate(zip(*mine, strict=True)):
            x, measure, q = (rows[i + 1 :] for rows in others) if turn == 0 else others  # on this rank each pair once
            distance = np.linalg.norm(x - place, axis=1)
            square += (2 if turn == 0 else 1) * e * float(measure @ ((q - p) ** 2 / distance**dim))
        others = passed_on(comm, others)
    return math.sqrt(comm.allreduce(square))


def _divergence(solution: Solution) -> fem.Function:
    """∇·σ_h in P0."""
    Q = solution.spaces.Q
    divergence = fem.Function(Q)
    divergence.interpolate(fem.Expression(ufl.div(solution.sigma), Q.element.interpolation_points))
    return divergence


def slides_errors(case: str, algorithm: str) -> dict[int, tuple[float, float]]:
    """The errors of σ and u in the slides per level; empty if the slides give none."""
    with (data_folder("tables") / "slides.csv").open(newline="", encoding="utf-8") as file:
        return {
            int(row["level"]): (float(row["sigma_V"]), float(row["u_Q"]))
            for row in csv.DictReader(file)
            if (row["case"], row["algorithm"]) == (case, algorithm)
        }


def convergence_study(
    case: Case,
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
        penalised = ", ".join(name for name, algorithm in METHODS.items() if algorithm.has_eps)
        raise InputError(f"--vary {vary.value}: {case.solve.algorithm} has no penalty; use one of {penalised}")
    solver = Solver(mesh_case(case, comm), boundary_of(case)) if vary is Vary.EPS else None
    cases = [case.with_values(level_values(vary, level)) for level in levels]
    best = case if vary is Vary.H else case.with_values({"solve.algorithm": "alg1"})
    if solver is None:
        best = best.with_values({"solve.h": 2.0**-reference})

    def solved(problem: Case) -> Solution:
        with doing(f"{problem.fineness}, {problem.solve.algorithm}"):
            return solve_case(problem, comm, domain=solver)

    fine = solved(best)
    slides = slides_errors(case.name, case.solve.algorithm) if vary is Vary.H else {}
    rows: list[ErrorRow] = []
    for level, problem in zip(levels, cases, strict=True):
        row = _row(level, solved(problem), fine, rows[-1] if rows else None, vary, slides.get(level))
        rows.append(row)
        on_row(row)
        collect_garbage(comm)
    return rows


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
    coarse: Solution,
    fine: Solution,
    before: ErrorRow | None,
    vary: Vary,
    slides: tuple[float, float] | None,
) -> ErrorRow:
    with doing("comparing"):
        error = differences(coarse, fine)
    topology = coarse.spaces.mesh.topology
    cells = topology.index_map(topology.dim).size_global
    options = coarse.options
    eps = options.eps if options.method.has_eps else None
    flux_scaled = None if eps is None else math.sqrt(eps) * error.flux_Lambda

    def order(name: str, value: float | None) -> float | None:
        earlier = None if before is None else getattr(before, name)
        if before is None or not earlier or not value:
            return None
        if vary is Vary.EPS:
            return math.log(earlier / value) / math.log(before.eps / options.eps) if before.eps else None
        return topology.dim * math.log(earlier / value) / math.log(cells / before.cells)

    return ErrorRow(
        level=level,
        h=coarse.spaces.domain.h,
        eps=eps,
        cells=cells,
        iterations=len(coarse.outcome.history),
        sigma_V=error.sigma_V,
        sigma_V_order=order("sigma_V", error.sigma_V),
        u_Q=error.u_Q,
        u_Q_order=order("u_Q", error.u_Q),
        p_Lambda=error.p_Lambda,
        p_Lambda_order=order("p_Lambda", error.p_Lambda),
        p_half=error.p_half,
        p_half_order=order("p_half", error.p_half),
        flux_scaled=flux_scaled,
        flux_scaled_order=order("flux_scaled", flux_scaled),
        slides_sigma_V=None if slides is None else slides[0],
        slides_u_Q=None if slides is None else slides[1],
    )


def fitted_slopes(rows: list[ErrorRow], vary: Vary) -> dict[str, float]:
    """Least-squares slopes of the errors on logarithmic axes, against 2^-level or ε (ε ≤ ASYMPTOTIC_EPS)."""
    if vary is Vary.EPS:
        rows = [row for row in rows if row.eps is not None and row.eps <= ASYMPTOTIC_EPS * (1 + 1e-12)]
    slopes = {}
    for name in ERRORS:
        values = [getattr(row, name) for row in rows]
        if len(rows) > 1 and all(values):
            base = 10 if vary is Vary.EPS else 2
            slopes[name] = -float(np.polyfit([row.level for row in rows], np.log(values) / np.log(base), 1)[0])
    return slopes
