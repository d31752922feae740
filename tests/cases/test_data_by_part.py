"""Case files with u_D, g_N, ψ and q_S by part: the problem with these conditions, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Dirichlet, InputError, Neumann, Signorini, load_case, solve, solve_case
from signorini_fenicsx.cases.inspection import check
from signorini_fenicsx.physics.diffusion.solution import Solution

BY_PART = """
[problem]
f = "2 - 10*x"
u_D = {left = "y/5"}
g_N = {right = "-0.3*y"}
psi = {bottom = "-x/20"}
q_S = 0.05
[boundary]
neumann = ["top", "right"]
signorini = ["bottom"]
[geometry]
shape = "square"
mesh = "structured"
[solve]
h = 0.3
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "case.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_conditions_on_parts(tmp_path: Path):
    """The problem is that with a condition for each part; without a value it is 0."""
    solution = solve_case(load_case(written(tmp_path, BY_PART)))
    conditions = [
        Dirichlet("left", "y/5"),
        Neumann("right", "-0.3*y"),
        Neumann("top"),
        Signorini("bottom", psi="-x/20", q_S=0.05),
    ]
    other = solve(solution.spaces.domain, Diffusion(f="2 - 10*x", conditions=conditions))
    assert isinstance(solution, Solution)
    assert solution.u.x.array == pytest.approx(other.u.x.array, abs=1e-12)
    assert np.ptp(solution.u.x.array) > 0.1
    assert solution.certify().guaranteed


def test_exact_column(tmp_path: Path):
    """The solution is 5 + 0.1(1 − y) between u = 5 on top and the flux 0.1 through the bottom, Γ_D being listed."""
    text = BY_PART.replace(
        '["top", "right"]\nsignorini = ["bottom"]', '["left", "right", "bottom"]\ndirichlet = ["top"]'
    )
    text = text.replace("2 - 10*x", "0").replace('{left = "y/5"}', "{top = 5}").replace("right =", "bottom =")
    text = text.replace('"-0.3*y"', "0.1").replace('psi = {bottom = "-x/20"}\n', "").replace("q_S = 0.05\n", "")
    solution = solve_case(load_case(written(tmp_path, text)))
    assert float(solution.certify().bound) < 1e-6
    assert solution.u.x.array.mean() == pytest.approx(5.05, abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("{right =", "{left =", r"\[problem\] g_N: 'left' is no part in \[boundary\] neumann"),
        ("{bottom =", "{top =", r"\[problem\] psi: 'top' is no part in \[boundary\] signorini"),
        ("{left =", "{bottom =", r"'bottom' is listed twice: in signorini and in problem.u_D"),
        ("{left =", "{lid =", r"\[problem\] u_D: unknown part 'lid' of square"),
        ('{left = "y/5"}', "{}", r"\[problem\] u_D: must be an expression, or a table with one per part"),
        ('"-0.3*y"', '"-0.3*q"', r"\[problem\] g_N.right: expression '-0.3\*q': unknown name 'q'"),
    ],
)
def test_refusals(tmp_path: Path, old: str, new: str, message: str):
    """The sentence names the place."""
    with pytest.raises(InputError, match=message):
        load_case(written(tmp_path, BY_PART.replace(old, new)))


PILE = """
Point(1) = {0, 0, 0}; Point(2) = {1, 0, 0}; Point(3) = {1, 1, 0}; Point(4) = {0.5, 1, 0}; Point(5) = {0, 1, 0};
Point(6) = {0.5, 0.5, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 1}; Line(6) = {4, 6};
Curve Loop(1) = {1, 2, 3, 4, 5}; Plane Surface(1) = {1}; Curve{6} In Surface{1};
Physical Curve("upstream") = {4}; Physical Curve("downstream") = {3}; Physical Curve("rest") = {1, 2, 5};
Physical Curve("pile") = {6}; Physical Surface("soil") = {1};
"""
SEEPAGE = """
[geometry]
file = "pile.geo"
[boundary]
impervious = ["pile"]
neumann = ["rest"]
[problem]
f = 0
u_D = {upstream = 4}
[solve]
h = 0.2
"""


def test_nothing_passes_a_wall(tmp_path: Path):
    """An impervious wall is a part inside with the flux 0, whichever its side; u may be two values where it ends."""
    (tmp_path / "pile.geo").write_text(PILE, encoding="utf-8")
    solution = solve_case(load_case(written(tmp_path, SEEPAGE)))
    text = (
        SEEPAGE.replace("impervious", "sides = {pile = [1, 0]}\ninner") + '[[law]]\nparts = ["pile"]\nkind = "friction"'
    )
    other = solve_case(load_case(written(tmp_path, text)))
    assert isinstance(solution, Solution)
    assert isinstance(other, Solution)
    assert solution.u.x.array == pytest.approx(other.u.x.array, abs=1e-10)
    assert solution.certify().guaranteed
    jumps = solution.p.x.array[solution.spaces.inner.rows]
    assert np.abs(jumps).max() > 2
    in_one = SEEPAGE.replace("{upstream = 4}", '"4 if x < 0.5 else 0"')
    assert not check(load_case(written(tmp_path, in_one)), MPI.COMM_SELF).remarks


@pytest.mark.parametrize(
    ("new", "message"),
    [
        ('impervious = ["pile", "downstream"]', "inner: part 'downstream' has 4 facets that are not between two cells"),
        ('impervious = ["pile"]\nsignorini = ["pile"]', "'pile' is listed twice: in signorini and in impervious"),
    ],
)
def test_walls_that_are_refused(tmp_path: Path, new: str, message: str):
    """A wall is inside, and has no other condition."""
    (tmp_path / "pile.geo").write_text(PILE, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        solve_case(load_case(written(tmp_path, SEEPAGE.replace('impervious = ["pile"]', new))))
