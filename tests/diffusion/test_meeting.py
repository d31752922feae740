"""Parts inside the domain that cross each other or reach other parts of Γ_S, and an obstacle besides."""

from pathlib import Path

import numpy as np
import pytest
from makers.bounds import difference
from meeting_parts import Lines, crossed_square, cut_cube
from mpi4py import MPI

from signorini_fenicsx import adapt_case, certify, load_case, solve_case
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.meshes.uniform import refined_uniformly
from signorini_fenicsx.physics.diffusion.case import Case

COMM = MPI.COMM_WORLD
SLIDING = """
[boundary]
inner = ["fault", "cross"]
SIDES
[[law]]
parts = ["fault"]
kind = "FAULT"
[[law]]
parts = ["cross"]
kind = "CROSS"
[problem]
f = 0
u_D = "EXACT"
[exact]
u = "EXACT"
"""


def sliding(folder: Path, n: int, law: str) -> Case:
    """Two faults that cross, on which u jumps up to 0.3 and 0.2, with the flux 0 or, of friction, g."""
    slope = "0.5*x + 0.4*y + " if law == "friction" else ""
    above, right = "(16*x^2*(1 - x)^2 if y > 1/2 else 0)", "(16*y^2*(1 - y)^2 if x > 1/2 else 0)"
    exact = f"{slope}(x - 1/2)^2 - (y - 1/2)^2 + 0.3*{above} + 0.2*{right}"
    f = "-32*(0.3*(1 - 6*x + 6*x^2 if y > 1/2 else 0) + 0.2*(1 - 6*y + 6*y^2 if x > 1/2 else 0))"
    text = SLIDING.replace("EXACT", exact).replace("f = 0", f'f = "{f}"')
    for name, g in (("FAULT", 0.4), ("CROSS", 0.5)):
        text = text.replace(f'"{name}"', f'"{law}"' + (f"\ng = {g}" if law == "friction" else ""))
    return crossed_square(folder, n, text)


@pytest.mark.parametrize("law", ["friction", "signorini"])
def test_cross(tmp_path: Path, law: str):
    """σ_h has order 1 and the bound is sharp, though the jumps at the crossing are not 0."""
    errors = []
    for n in (6, 12):
        solution = solve_case(sliding(tmp_path, n, law), COMM)
        errors.append(solution.errors()["sigma_L2"])
        certificate = certify(solution)
        assert 1 <= certificate.sigma_bound / errors[-1] < 1.1
    assert np.log2(errors[0] / errors[1]) > 0.95


GENERAL = """
[boundary]
inner = ["fault", "cross"]
SIDES
signorini = ["right"]
neumann = ["left"]
[[law]]
parts = ["fault"]
kind = "signorini"
psi = "-0.02*x"
[[law]]
parts = ["cross"]
kind = "friction"
g = 0.2
[problem]
f = "9*sin(7*x + 4*y) - 4"
kappa = "1 + x"
psi = "-0.1 + 0.02*y"
"""
OBSTACLE = 'obstacle = "-0.35 + 0.1*x"\n'
CROSS = {"fault": (1, 0.0, 1.0), "cross": (0, 0.0, 1.0)}
BRANCH = {"fault": (1, 0.0, 1.0), "cross": (0, 0.0, 0.5)}
END = {"fault": (1, 0.5, 1.0), "cross": (0, 0.0, 0.75)}


@pytest.mark.parametrize(
    ("lines", "more", "way"),
    [
        (CROSS, OBSTACLE, {"backend": "mixed"}),
        (BRANCH, "", {"algorithm": "alg2"}),
        (END, OBSTACLE, {"algorithm": "qp"}),
    ],
)
def test_bounds(tmp_path: Path, lines: Lines, more: str, way: dict[str, str]):
    """Where parts meet each other, Γ_S and Γ_N the bound is above the distance to a fine solution, and not by much.

    Both backends, an interior-point method and an iterative solver agree, with an obstacle too.
    """
    case = crossed_square(tmp_path, 6, GENERAL + more, lines)
    mesh = mesh_case(case, MPI.COMM_SELF)
    solution = solve_case(case, domain=mesh)
    fine = solve_case(case, domain=refined_uniformly(refined_uniformly(mesh)))
    certificate, apart = certify(solution), difference(solution, fine)
    assert certificate.guaranteed
    assert apart < certificate.sigma_bound < 1.32 * apart
    tuning = Tuning(direct_up_to=0)
    others = case.with_values({f"solve.{key}": name for key, name in way.items()})
    for other in (solve_case(others, domain=mesh), solve_case(case, domain=mesh, tuning=tuning)):
        for name in ("u", "sigma"):
            expected = getattr(solution, name).x.array
            np.testing.assert_allclose(getattr(other, name).x.array, expected, rtol=0, atol=1e-8)


HALF = """
[boundary]
inner = ["cross"]
SIDES
neumann = ["floor"]
[[law]]
parts = ["cross"]
kind = "KIND"
[problem]
f = "9*sin(7*x + 4*y)"
"""


@pytest.mark.parametrize("kind", ['friction"\ng = "0.2', "signorini"])
def test_between_two_conditions(tmp_path: Path, kind: str):
    """A part that ends where Γ_D on its one side meets Γ_N on the other."""
    case = crossed_square(tmp_path, 6, HALF.replace("KIND", kind), {"cross": (0, 0.0, 0.75)})
    mesh = mesh_case(case, MPI.COMM_SELF)
    solution = solve_case(case, domain=mesh)
    apart = difference(solution, solve_case(case, domain=refined_uniformly(refined_uniformly(mesh))))
    assert apart < certify(solution).sigma_bound < 1.3 * apart


IN_SPACE = """
[boundary]
inner = ["fault"]
SIDES
[[law]]
parts = ["fault"]
kind = "signorini"
[problem]
f = "-2 + 9.6*(x*(1 - x) + y*(1 - y) if z > 1/2 else 0)"
u_D = "EXACT"
[exact]
u = "EXACT"
"""


def test_refined_in_space(folder: Path):
    """Both sides of a fault are refined alike where the error is, on any ranks."""
    exact = "(z - 1/2)^2 + (4.8*x*(1 - x)*y*(1 - y) if z > 1/2 else 0)"
    if COMM.rank == 0:
        cut_cube(folder, 2, IN_SPACE.replace("EXACT", exact))
    COMM.Barrier()
    case = load_case(str(folder / "2.toml")).with_values({"solve.element": "RT0"})
    first = solve_case(case, COMM)
    adapted, certificate = adapt_case(case, COMM, max_cells=300, theta=0.3)
    error = adapted.errors()["sigma_L2"]
    assert error < 0.9 * first.errors()["sigma_L2"]
    assert error < certificate.sigma_bound < 1.3 * error
    assert adapted.spaces.domain.mesh.topology.index_map(3).size_global > 1.3 * 48
