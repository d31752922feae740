"""What the error bound says of published values: the plate that slides on a rigid plane, Code_Aster's test SSNV128.

uv run python scripts/plate_values.py --cells 4000

The mean of u_x over 1.25 mm of the plane is (𝔸σ, τ) for each stress τ with div τ = 0 that is in balance with a
load of 1 there and needs no other forces than normal ones where the plate is held or certainly touches. So
(𝔸σ_h, τ) is off by at most ‖τ‖ times the bound of ‖σ − σ_h‖. τ is a solution of ours. As the friction is
Coulomb's, σ is that of Tresca's problem with the last bound of the shear. That the mean is not the value in the
middle changes less than 0.05 %.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import argparse

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from signorini_fenicsx.certificate.adaptive import adapt
from signorini_fenicsx.contact.laws import Dirichlet, Neumann
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.own import domain_of
from signorini_fenicsx.physics.elasticity.conditions import Contact, Coulomb
from signorini_fenicsx.physics.elasticity.problem import Elasticity
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.residuals import energy_squares
from signorini_fenicsx.solving.solver import solve

SIDE, WIDTH, RESTS = 0.04, 1.25e-3, 0.03
"""The plate certainly touches the plane right of the last."""
PUBLISHED = {"B": (1.25e-3, 2.72e-5), "C": (5e-3, 2.28e-5), "D": (7.5e-3, 1.98e-5), "E": (11.25e-3, 1.50e-5)}
"""x and u_x of points on the plane."""
MATERIAL = {"young": 1.3e11, "poisson": 0.2}


def plate() -> Domain:
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
    solution, certificate = adapt(plate(), problem, max_cells=cells)
    print(f"{solution.spaces.cell_measures.size} cells, bound {100 * certificate.relative:.2f} % of the stress")
    rows = []
    for name, (_, published) in PUBLISHED.items():
        free = Neumann([part for part in ("top", "left", *bottom) if part not in (name, "rests")])
        unit = [Neumann(name, [1 / WIDTH, 0.0]), free, symmetry, Dirichlet("rests", [0.0, 0.0], components="y")]
        tau = solve(solution.spaces.domain, Elasticity(**MATERIAL, conditions=unit))
        rows.append((name, published, product(solution, tau), tau.norms()["energy"] * certificate.sigma_bound))
    return rows


def main() -> None:
    """Print a line for each published value."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--cells", type=int, default=4000, help="of the finest mesh")
    print("point  published        mean      from        to")
    for name, published, mean, off in values(options.parse_args().cells):
        low, high = mean - off, mean + off
        verdict = "possible" if low <= published <= high else "not of this problem"
        print(f"{name:5}  {published:9.3e}  {mean:9.4e}  {low:9.4e}  {high:9.4e}  {verdict}")


if __name__ == "__main__":
    main()
