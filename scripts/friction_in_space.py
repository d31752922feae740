"""How many linear problems friction in space takes: a block pressed, tilted, pushed and twisted on a plane.

For each mesh and each μ: facet vertices that stick, slip and are open, linear problems, and the bound of the error as a
share of the stress. The first line for a mesh is Tresca's law with g = 0.03.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import argparse

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from signorini_fenicsx.api import Contact, Coulomb, Dirichlet, Elasticity, Neumann, Tresca, domain_of, solve


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, nargs="*", default=[1, 2, 4], help="cells along the height")
    parser.add_argument("--mu", type=float, nargs="*", default=[0.1, 0.3, 1.0])
    arguments = parser.parse_args()
    print("cells  law    stick  slip  open  solves  bound")
    for n in arguments.cells:
        mesh = dolfinx.mesh.create_box(MPI.COMM_WORLD, [[0.0, 0.0, 0.0], [1.0, 1.0, 0.5]], [2 * n, 2 * n, n])
        places = {"bottom": (2, 0.0), "top": (2, 0.5), "left": (0, 0.0), "right": (0, 1.0)}
        places |= {"front": (1, 0.0), "back": (1, 1.0)}
        parts = {name: lambda x, i=i, at=at: np.isclose(x[i], at) for name, (i, at) in places.items()}
        domain = domain_of(mesh, parts)
        for law in (Tresca(0.03), *map(Coulomb, arguments.mu)):
            conditions = [
                Contact("bottom", gap="0.01*x", friction=law),
                Dirichlet("top", ["-0.1*(y - 0.4)", "0.1*(x - 0.5) + 0.01", "-0.05 + 0.03*x"]),
                Neumann(["left", "right", "front", "back"]),
            ]
            solution = solve(domain, Elasticity(young=1.0, poisson=0.3, conditions=conditions))
            states = [solution.friction_states()[name]["vertices"] for name in ("stick", "slip", "open")]
            bound, name = solution.certify().relative, f"mu {law.mu:g}" if isinstance(law, Coulomb) else "Tresca"
            solves = len(solution.outcome.history)
            if MPI.COMM_WORLD.rank == 0:
                print(f"{n:5} {name:7} {states[0]:5} {states[1]:5} {states[2]:5} {solves:7} {bound:6.1%}")


if __name__ == "__main__":
    main()
