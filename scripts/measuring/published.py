"""Published and exact values beside ours: Mindlin's sphere, the plate of SSNV128, the penalty of the slides, soils."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer
from boxes import box, grid, sides
from dolfinx.mesh import DiagonalType
from mpi4py import MPI
from scipy.integrate import quad
from scipy.optimize import brentq

from measuring import say, show
from signorini_fenicsx import (
    Diffusion,
    Dirichlet,
    Evolution,
    Neumann,
    NumericalFailure,
    Signorini,
    VanGenuchten,
    evolve,
    evolve_case,
    load_case,
    solve,
    solve_case,
)
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.certificate.adaptive import adapt
from signorini_fenicsx.comparing.comparison import differences
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.elasticity.conditions import Contact, Coulomb
from signorini_fenicsx.physics.elasticity.problem import Elasticity
from signorini_fenicsx.quantities import Mean, Quantity

RADIUS, YOUNG, POISSON, MU, FORCE = 8.0, 1.0, 0.49, 0.3, 0.219332
NEAR = "near = 0.2;"
"""The size of cells in the mesh of the case."""
SHOWN = ("push", "radius", "peak", "depth", "sticks", "c", "off_pressure", "off_shear")


def ellipse(r: Array, radius: float) -> Array:
    """√(1 − r²/a²) for r < a, 0 beyond."""
    return np.sqrt(np.maximum(1 - (r / radius) ** 2, 0))


def theory(push: float) -> dict[str, float]:
    """By Hertz, Cattaneo and Mindlin, for Q/μP."""
    a = (3 * FORCE * RADIUS * (1 - POISSON**2) / (4 * YOUNG)) ** (1 / 3)
    c, shear_modulus = a * (1 - push) ** (1 / 3), YOUNG / (2 * (1 + POISSON))
    way = 3 * MU * FORCE * (2 - POISSON) / (16 * shear_modulus * a) * (1 - (c / a) ** 2)
    return {"a": a, "p0": 3 * FORCE / (2 * np.pi * a**2), "c": c, "depth": a**2 / RADIUS, "way": way}


def steps(case: Any) -> Iterator[dict[str, float]]:
    """What is found in each step, in units of theory, and what sticks; the body and the sphere are halves."""
    for instant in evolve_case(case):
        solution = instant.solution
        push = -solution.resultants()["bottom"][0] / (MU * FORCE / 2)
        expected = theory(push)
        a, c, p0 = (expected[name] for name in ("a", "c", "p0"))
        r = np.linalg.norm(solution.spaces.contact.vertices[:, :, :2], axis=2)
        measure = solution.spaces.site_kinds["normal"].measure.reshape(-1, 3)
        shear = MU * p0 * (ellipse(r, a) - c / a * ellipse(r, c))[:, :, None] * [1, 0, 0]
        moved = solution.quantities()["tools"]["contact"]["displacement"]
        off = np.abs(solution.pressure - p0 * ellipse(r, a)), np.linalg.norm(solution.shear_vectors - shear, axis=2)
        yield {
            "push": push,
            "radius": np.sqrt(2 * solution.contact.measure / np.pi) / a,
            "peak": solution.pressure.max() / p0,
            "depth": -moved["z"] / expected["depth"],
            "sticks": np.sqrt(2 * solution.friction_states()["stick"]["measure"] / np.pi),
            "c": c,
            "moved": moved["x"],
            "way": expected["way"],
            "off_pressure": (measure * off[0]).sum() / (FORCE / 2),
            "off_shear": (measure * off[1]).sum() / (MU * FORCE / 2),
        }


def mindlin(
    near: Annotated[float | None, typer.Option(help="Size of the cells where both touch, 0.2 in the case.")] = None,
) -> None:
    """The case mindlin3d, a sphere pressed onto a block and pushed sideways, beside the theory of half-spaces.

    For each step: Q/μP; the radius of contact, the largest pressure and how deep the sphere goes, over those of Hertz;
    the radius of what sticks, its value by Mindlin, and how far the sphere goes sideways over that by Mindlin; and what
    the pressure and the shear are off, as shares of P and of μP. A last line has δ(last) − δ(first)Q(last)/Q(first) of
    the way sideways over its value by theory, in which there is no part that is linear in Q, as that of the block as a
    whole.
    """
    case, found = load_case("mindlin3d"), []
    with TemporaryDirectory() as folder:
        if near is not None:
            finer = Path(folder, "block.geo")
            finer.write_text(Path(case.geometry.file).read_text(encoding="utf-8").replace(NEAR, f"near = {near};"))
            case = case.with_values({"geometry.file": str(finer)})
        for row in steps(case):
            found.append(row)
            of_way = row["moved"] / row["way"] if row["push"] > 0.01 else np.nan
            say(", ".join(f"{name} {row[name]:.3f}" for name in SHOWN) + f", moved/way {of_way:.3f}")
    first, last = found[1], found[-1]
    share = last["push"] / first["push"]
    bent = [last[name] - share * first[name] for name in ("moved", "way")]
    say(f"what is not linear of the way: {bent[0] / bent[1]:.3f} of that by theory")


SIDE, WIDTH = 0.04, 1.25e-3
"""Of the plate, and of the pieces of the plane over which means are taken."""
PUBLISHED = {"B": (1.25e-3, 2.72e-5), "C": (5e-3, 2.28e-5), "D": (7.5e-3, 1.98e-5), "E": (11.25e-3, 1.50e-5)}
"""x and u_x of points on the plane."""


def plate_mesh() -> Domain:
    """The left half of the plate, with parts of the plane around the published points."""
    corners = [0.0, 0.0], [SIDE, SIDE]
    parts = sides(*corners)
    bottom, places = parts.pop("bottom"), [[x] for x, _ in PUBLISHED.values()]
    for name, (place, _) in PUBLISHED.items():
        parts[name] = lambda x, place=place: bottom(x) & (np.abs(x[0] - place) < WIDTH / 2 + 1e-9)
    parts["rest"] = lambda x: bottom(x) & np.all(np.abs(x[0] - places) > WIDTH / 2 - 1e-9, axis=0)
    return domain_of(grid(*corners, [64, 20], MPI.COMM_SELF), parts)


def plate_values(cells: int) -> Iterator[tuple[str, float, Quantity]]:
    """Of each published value its name, u_x, and the interval of the mean on a mesh with at most so many cells."""
    held = Dirichlet("right", [0.0, 0.0], components="x")
    loads = [Neumann("top", [0.0, -5e7]), Neumann("left", [15e7, 0.0])]
    conditions = [Contact([*PUBLISHED, "rest"], friction=Coulomb(1.0)), held, *loads]
    solution, certificate = adapt(plate_mesh(), Elasticity(1.3e11, 0.2, conditions=conditions), max_cells=cells)
    print(f"{solution.spaces.cell_measures.size} cells, bound {100 * certificate.relative:.2f} % of the stress")
    for name, (_, published) in PUBLISHED.items():
        yield name, published, solution.quantity(Mean(direction=[1, 0], parts=name))


def plate(cells: Annotated[int, typer.Option(help="Of the finest mesh.")] = 4000) -> None:
    """What intervals say of published values: the plate that slides on a rigid plane, Code_Aster's test SSNV128.

    They are of means of u_x over 1.25 mm of the plane, which are less than 0.05 % from the value in the middle. With
    that, and half a unit in its last digit, a published value is possible or not. As the friction is Coulomb's, u is
    that of Tresca's problem with the last bound of the shear.
    """
    print("point  published        mean      from        to")
    for name, published, mean in plate_values(cells):
        off = 5e-4 * published + 5e-8
        verdict = "possible" if mean.lower - off <= published <= mean.upper + off else "not of this problem"
        print(f"{name:5}  {published:9.3e}  {mean.value:9.4e}  {mean.lower:9.4e}  {mean.upper:9.4e}  {verdict}")


def bound(solution: Solution, violation: float, *, with_trace: bool) -> float:
    """Left side of (27) or (28) divided by ‖f_h‖."""
    norms = solution.norms()
    left = np.hypot(norms["sigma_L2"], norms["div_sigma_L2"]) + norms["u_L2"]
    left += violation / np.sqrt(solution.options.eps) + with_trace * norms["p_L2"]
    return left / norms["div_sigma_L2"]  # ∇·σ_h = −f_h


def penalty(finest: Annotated[int, typer.Argument(help="h ≥ 2^-FINEST.")] = 5) -> None:
    """The statements of the slides on the penalty formulations: the bounds (27), (28) and "I ⇔ II".

    For examples 4 to 6 on meshes h ≤ 2^-2 … 2^-FINEST and ε = 1 … 1e-12 it prints

    - bound I:  (‖σ‖_V + ‖u‖_Q + ‖[p]_-‖_Λ/√ε + ‖p‖_Λ) / ‖f_h‖_Q, which (27) says is bounded in h and ε,
    - bound II: (‖σ‖_V + ‖u‖_Q + ‖[σ·n]_-‖_Λ/√ε) / ‖f_h‖_Q, which (28) says is bounded,
    - I − II:   ‖σ_I − σ_II‖_V / ‖σ_I‖_V, the distance between the two formulations,
    - sign I, sign II: ‖[p]_-‖_Λ/ε and ‖[σ·n]_-‖_Λ/ε, bounded if the signs of proposition 3 hold up to O(ε).
    """
    rows = []
    for example in (4, 5, 6):
        for level in range(2, finest + 1):
            base = load_case(f"example{example}").with_values({"solve.h": 2.0**-level})
            domain = mesh_case(base, comm=MPI.COMM_WORLD)
            for eps in (1.0, 1e-2, 1e-4, 1e-8, 1e-12):
                one, two = (
                    solve_case(base.with_values({"solve.algorithm": name, "solve.eps": eps}), domain=domain)
                    for name in ("alg3", "alg4")
                )
                p_minus, flux_minus = one.violation()["trace"], two.violation()["flux"]
                sigma_norm = np.hypot(one.norms()["sigma_L2"], one.norms()["div_sigma_L2"])
                row = (
                    bound(one, p_minus, with_trace=True),
                    bound(two, flux_minus, with_trace=False),
                    differences(one, two).sigma_V / sigma_norm,
                    p_minus / eps,
                    flux_minus / eps,
                )
                rows.append([example, f"2^-{level}", eps, *row])
    show(["example", "h", "ε", "bound I", "bound II", "I − II", "sign I", "sign II"], rows)


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
