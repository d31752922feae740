"""The linear problems that the soils of Carsel and Parrish (1988) take, see docs/guide/soils.md."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

from typing import Annotated

import numpy as np
import typer
from boxes import box
from dolfinx.mesh import DiagonalType
from scipy.integrate import quad
from scipy.optimize import brentq

from signorini_fenicsx import (
    Diffusion,
    Dirichlet,
    Evolution,
    Neumann,
    NumericalFailure,
    Signorini,
    VanGenuchten,
    evolve,
    load_case,
    solve,
    solve_case,
)
from signorini_fenicsx.contact.law import Law

SOILS = {
    "sand": (14.5, 2.68, 29.7, 0.045, 0.43), "loamy sand": (12.4, 2.28, 14.59, 0.057, 0.41),
    "sandy loam": (7.5, 1.89, 4.42, 0.065, 0.41), "loam": (3.6, 1.56, 1.04, 0.078, 0.43),
    "silt": (1.6, 1.37, 0.25, 0.034, 0.46), "silt loam": (2.0, 1.41, 0.45, 0.067, 0.45),
    "sandy clay loam": (5.9, 1.48, 1.31, 0.1, 0.39), "clay loam": (1.9, 1.31, 0.26, 0.095, 0.41),
    "silty clay loam": (1.0, 1.23, 0.07, 0.089, 0.43), "sandy clay": (2.7, 1.23, 0.12, 0.1, 0.38),
    "silty clay": (0.5, 1.09, 0.02, 0.07, 0.36), "clay": (0.8, 1.09, 0.20, 0.068, 0.38),
}  # fmt: skip
"""α in 1/m, n, K in cm/h, θ_r and θ_s."""
HEIGHT, CELLS, SUCTION = 2.0, 80, 10.0


def evaporation(soil: VanGenuchten) -> float:
    """The exact q/K."""
    ends = -np.logspace(np.log10(SUCTION), -4, 60)

    def height(log_q: float) -> float:
        def of(psi: float) -> float:
            return float(1 / (1 + np.exp(log_q) / (soil(np.zeros((1, 1)), np.array([psi]))[0][0] / soil.K)))

        return sum(quad(of, *pair)[0] for pair in zip(ends, [*ends[1:], 0.0], strict=True))

    return float(np.exp(brentq(lambda log_q: height(log_q) - HEIGHT, -28.0, 0.0, xtol=1e-8)))


def by_linear_elements(soil: VanGenuchten) -> float:
    """The q/K of linear elements with the mean of κ at their nodes, two for each layer: its squares are cut crosswise.

    From the bottom up each element gives the pressure head of its upper node, found by halving, for many q at once.
    """
    low, high, dz = -28.0, 0.0, HEIGHT / CELLS / 2

    def k_r(psi: np.ndarray) -> np.ndarray:
        return np.asarray(soil(np.zeros((len(psi), 1)), psi)[0] / soil.K)

    for _ in range(3):
        log_q, psi = np.linspace(low, high, 60), np.zeros(60)
        for _ in range(2 * CELLS):
            above, below, before = psi, np.full(60, -2 * SUCTION), k_r(psi)
            for _ in range(40):
                middle = (above + below) / 2
                lower = (before + k_r(middle)) * (middle - psi + dz) + 2 * dz * np.exp(log_q) > 0
                above, below = np.where(lower, middle, above), np.where(lower, below, middle)
            psi = middle
        at = int(np.searchsorted(-psi, SUCTION))
        low, high = log_q[at - 1 : at + 1].tolist()
    return float(np.exp((low + high) / 2))


def soils() -> None:
    """The linear problems that soils take in a dam and in columns.

    For each soil: as the shell of the shipped `earth_dam`; as a column 2 m high above a water table with rain of 0.3 K;
    and with a suction of 10 m at its top, together with the evaporation q over K, the exact one, and that of linear
    elements with the mean of κ at their nodes, the usual ones for soil. The exact q is the one with
    ∫ dψ/(1 + q/K k_r) = 2 m from -10 m to 0.
    """
    width, case = 2 * HEIGHT / CELLS, load_case("earth_dam")
    domain = box([0, 0], [width, HEIGHT], [2, CELLS], diagonal=DiagonalType.crossed)
    print(f"{'soil':16}{'dam':>6}{'rain':>6}{'dry':>6}{'q/K':>12}{'exact':>12}{'linear':>12}")
    for name, (alpha, n, k, *_) in SOILS.items():
        soil = VanGenuchten(k * 0.01 / 3600, alpha, n)
        shell = case.soil["shell"].model_copy(update={"K": soil.K, "alpha": alpha, "n": n})
        solutions = [solve_case(case.model_copy(update={"soil": case.soil | {"shell": shell}}))]
        for top in (Neumann("top", 0.3 * soil.K), Dirichlet("top", HEIGHT - SUCTION)):
            conditions = [Neumann(["left", "right"], 0), top, Dirichlet("bottom", 0)]
            solutions.append(solve(domain, Diffusion(f=0, kappa=soil, conditions=conditions)))
        solves = [solution.outcome.details["linear_solves"] for solution in solutions]
        q = -solutions[-1].flux_through("top") / width / soil.K
        others = f"{evaporation(soil):12.3e}{by_linear_elements(soil):12.3e}"
        print(f"{name:16}{solves[0]:6}{solves[1]:6}{solves[2]:6}{q:12.3e}{others}", flush=True)


PER_DAY = 0.24
"""One cm/h in m/day."""
LAYERS, STEPS = 20, 20
BESIDE = Neumann(["left", "right"], 0)


def scenarios(K: float) -> dict[str, tuple[float, float, list[Law]]]:
    """The days, the head at first and the conditions of each."""
    taken, given = Signorini("top", psi=-99, q_S=-0.005), Neumann("top", K / 2)
    return {
        "drained": (2.0, 1.0, [BESIDE, Neumann("top", 0), Dirichlet("bottom", 0)]),
        "rain": (0.2 / K, 0.0, [BESIDE, given, Dirichlet("bottom", 0)]),
        "evaporation": (20.0, 0.0, [BESIDE, taken, Dirichlet("bottom", 0)]),
    }


def row(name: str, what: str) -> str:
    """What one column takes."""
    alpha, n, k, theta_r, theta_s = SOILS[name]
    K = PER_DAY * k
    end, first, conditions = scenarios(K)[what]
    problem = Diffusion(kappa=VanGenuchten(K, alpha, n, theta_r, theta_s), f=0, conditions=conditions)
    solves, halved, balance = [], 0, 0.0
    try:
        for step in evolve(box([0, 0], [1 / LAYERS, 1], [1, LAYERS]), problem, Evolution(end, STEPS, initial=first)):
            solves.append(step.numbers["linear_solves"])
            halved += step.numbers["parts"] > 1
            balance = max(balance, step.numbers["mass_error"])
    except NumericalFailure as failure:
        return f"fails in step {len(solves) + 1}: {failure}"
    return f"{np.median(solves):g}, {np.mean(solves):.1f}, {max(solves)}, {halved} halved, mass to {balance:.0e}"


def soil_columns(
    names: Annotated[list[str] | None, typer.Argument(help="Some of the soils; all for none.")] = None,
) -> None:
    """The linear problems of columns of soils over time.

    A column is 1 m high, in metres and days. Drained: it is saturated, and the head at the bottom falls to 0. Rain:
    over a water table at the bottom, with water at rest at first, rain of half of K until 0.1 m have fallen.
    Evaporation: the same, with 5 mm a day taken from the top as long as the pressure head there is above -100 m. For
    each the table has the median, the mean and the largest number of linear problems per step, how many steps were
    halved, and the largest error of mass.
    """
    for name in names or SOILS:
        for what in scenarios(1.0):
            print(f"{name:16} {what:12} {row(name, what)}", flush=True)
