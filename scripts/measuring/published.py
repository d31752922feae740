"""Published and exact values beside ours: Mindlin's sphere, the plate of SSNV128, the penalty of the slides."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import dolfinx.mesh
import numpy as np
import typer
from mpi4py import MPI

from measuring import show
from signorini_fenicsx import evolve_case, load_case, solve, solve_case
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.certificate.adaptive import adapt
from signorini_fenicsx.comparing.comparison import differences
from signorini_fenicsx.contact.laws import Dirichlet, Neumann
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.own import domain_of
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.elasticity.conditions import Contact, Coulomb
from signorini_fenicsx.physics.elasticity.problem import Elasticity
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.residuals import energy_squares

RADIUS, YOUNG, POISSON, MU, FORCE = 8.0, 1.0, 0.49, 0.3, 0.219332
NEAR = "near = 0.2;"
"""The size of cells in the mesh of the case."""


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
    case = load_case("mindlin3d")
    sys.stdout.write("Q/muP  radius  peak   depth  sticks  c      moved  off pressure, shear\n")
    with TemporaryDirectory() as folder:
        if near is not None:
            finer = Path(folder, "block.geo")
            finer.write_text(Path(case.geometry.file).read_text(encoding="utf-8").replace(NEAR, f"near = {near};"))
            case = case.with_values({"geometry.file": str(finer)})
        rows = []
        for row in steps(case):
            rows.append(row)
            moved = row["moved"] / row["way"] if row["push"] > 0.01 else np.nan
            line = (
                f"{row['push']:5.3f}  {row['radius']:.3f}   {row['peak']:.3f}  {row['depth']:.3f}  {row['sticks']:.3f}"
            )
            line += f"   {row['c']:.3f}  {moved:.3f}  {row['off_pressure']:.3f}         {row['off_shear']:.3f}\n"
            sys.stdout.write(line)
    first, last = rows[1], rows[-1]
    share = last["push"] / first["push"]
    bent = [last[name] - share * first[name] for name in ("moved", "way")]
    sys.stdout.write(f"what is not linear of the way: {bent[0] / bent[1]:.3f} of that by theory\n")


SIDE, WIDTH, RESTS = 0.04, 1.25e-3, 0.03
"""The plate certainly touches the plane right of the last."""
PUBLISHED = {"B": (1.25e-3, 2.72e-5), "C": (5e-3, 2.28e-5), "D": (7.5e-3, 1.98e-5), "E": (11.25e-3, 1.50e-5)}
"""x and u_x of points on the plane."""
MATERIAL = {"young": 1.3e11, "poisson": 0.2}


def plate_mesh() -> Domain:
    """The left half of the plate, with parts of the plane around the published points."""
    corners = [[0.0, 0.0], [SIDE, SIDE]]
    mesh = dolfinx.mesh.create_rectangle(MPI.COMM_SELF, corners, [64, 16])
    ends = {name: (x - WIDTH / 2, x + WIDTH / 2) for name, (x, _) in PUBLISHED.items()} | {"rests": (RESTS, SIDE)}

    def between(x: np.ndarray, low: float, high: float) -> np.ndarray:
        return np.isclose(x[1], 0) & (x[0] > low - 1e-9) & (x[0] < high + 1e-9)

    parts = {name: lambda x, low=low, high=high: between(x, low, high) for name, (low, high) in ends.items()}
    gaps = np.array([0.0, *sum(ends.values(), ()), SIDE]).reshape(-1, 2)
    free = [(low, high) for low, high in gaps if high > low + 1e-9]
    parts["rest"] = lambda x: np.any([between(x, low, high) for low, high in free], axis=0)
    for name, (axis, place) in {"left": (0, 0.0), "right": (0, SIDE), "top": (1, SIDE)}.items():
        parts[name] = lambda x, axis=axis, place=place: np.isclose(x[axis], place)
    return domain_of(mesh, parts)


def product(one: ElasticSolution, two: ElasticSolution) -> float:
    """(𝔸σ, τ) of two solutions on the same mesh."""
    plus, minus = (energy_squares(one.spaces, one.data, one.stresses + sign * two.stresses).sum() for sign in (1, -1))
    return float(plus - minus) / 4


def values(cells: int) -> list[tuple[str, float, float, float, float]]:
    """Of each published value its name, u_x, the mean of ours, by how much it may be off, and half of it in percent."""
    bottom = [*PUBLISHED, "rests", "rest"]
    symmetry = Dirichlet("right", [0.0, 0.0], components="x")
    loads = [Neumann("top", [0.0, -5e7]), Neumann("left", [15e7, 0.0])]
    problem = Elasticity(**MATERIAL, conditions=[Contact(bottom, friction=Coulomb(1.0)), symmetry, *loads])
    solution, certificate = adapt(plate_mesh(), problem, max_cells=cells)
    print(f"{solution.spaces.cell_measures.size} cells, bound {100 * certificate.relative:.2f} % of the stress")
    rows = []
    for name, (_, published) in PUBLISHED.items():
        free = Neumann([part for part in ("top", "left", *bottom) if part not in (name, "rests")])
        unit = [Neumann(name, [1 / WIDTH, 0.0]), free, symmetry, Dirichlet("rests", [0.0, 0.0], components="y")]
        tau = solve(solution.spaces.domain, Elasticity(**MATERIAL, conditions=unit))
        rows.append((name, published, product(solution, tau), tau.norms()["energy"] * certificate.sigma_bound))
    return rows


def plate(cells: Annotated[int, typer.Option(help="Of the finest mesh.")] = 4000) -> None:
    """What the error bound says of published values: the plate that slides on a rigid plane, Code_Aster's test SSNV128.

    The mean of u_x over 1.25 mm of the plane is (𝔸σ, τ) for each stress τ with div τ = 0 that is in balance with a
    load of 1 there and needs no other forces than normal ones where the plate is held or certainly touches. So
    (𝔸σ_h, τ) is off by at most ‖τ‖ times the bound of ‖σ − σ_h‖. τ is a solution of ours. As the friction is
    Coulomb's, σ is that of Tresca's problem with the last bound of the shear. That the mean is not the value in the
    middle changes less than 0.05 %.
    """
    print("point  published        mean      from        to")
    for name, published, mean, off in values(cells):
        low, high = mean - off, mean + off
        verdict = "possible" if low <= published <= high else "not of this problem"
        print(f"{name:5}  {published:9.3e}  {mean:9.4e}  {low:9.4e}  {high:9.4e}  {verdict}")


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
