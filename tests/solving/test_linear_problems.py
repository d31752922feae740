"""Problems of both physics without any law: a patch test, bounds, ranks, the command line, pictures."""

from pathlib import Path

import numpy as np
import pytest
from commands import signorini
from elastic import box
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Dirichlet, Elasticity, InputError, Neumann, solve
from signorini_fenicsx.pictures import space
from signorini_fenicsx.pictures.style import STYLE

COMM = MPI.COMM_WORLD


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_pulled_bar(dim: int):
    """A bar that is pulled along x has this stress alone, and the bound is 0 but for rounding."""
    domain, axes = box(COMM, 2, [0.0] * dim, [2.0] + [0.5] * (dim - 1)), "xyz"[:dim]
    planes = [Dirichlet(f"{axis}0", 0, components=axis) for axis in axes]
    free = [Neumann(f"{axis}1") for axis in axes[1:]]
    pulled = Neumann("x1", ["0.1", *["0"] * (dim - 1)])
    solution = solve(domain, Elasticity(1.0, 0.3, conditions=[*planes, *free, pulled]))
    wanted = np.zeros((dim, dim))
    wanted[0, 0] = 0.1
    np.testing.assert_allclose(solution.stresses, np.broadcast_to(wanted, solution.stresses.shape), atol=1e-13)
    certificate, summary = solution.certify(), solution.summary()
    assert (certificate.relative < 1e-8, certificate.guaranteed) == (True, True)
    assert (summary["reason"], summary["iterations"]) == ("without a law the problem is linear, and solved", 1)
    assert "contact" not in solution.fields()
    assert "contact" not in solution.lines(summary)
    assert "prediction" not in solution.timings


@pytest.mark.parallel([2])
def test_scalar_problem():
    """−Δu = 2 with u = 0 on two sides: u = x(1 − x) and σ of RT0 are exact in means; the bound holds."""
    domain = box(COMM, 8, [0.0, 0.0], [1.0, 1.0])
    solution = solve(domain, Diffusion(f=2, conditions=[Neumann(["y0", "y1"])], exact="x*(1 - x)"))
    error, certificate = solution.errors()["energy"], solution.certify()
    assert error <= certificate.bound <= 2 * error
    assert certificate.guaranteed


def test_what_nothing_holds():
    """Without a part that holds it the body can move, and u of a scalar problem is not bounded."""
    domain = box(COMM, 1, [0.0, 0.0], [1.0, 1.0])
    sides = ["x0", "x1", "y0", "y1"]
    with pytest.raises(InputError, match="the body can move rigidly, along"):
        solve(domain, Elasticity(1.0, 0.3, f=["1", "0"], conditions=[Neumann(sides)]))
    with pytest.raises(InputError, match="no part of the boundary is left for u = u_D"):
        solve(domain, Diffusion(f=1, conditions=[Neumann(sides)]))


CASE = """
title = "Pulled, or heated"
{physics}
[geometry]
shape = "{shape}"

[boundary]
neumann = ["right", "top"]

[problem]
{data}

[solve]
h = 1
"""
PULLED = ('physics = "elasticity"', "young = 1\npoisson = 0.3\ng_N = {right = %s}")
CASES = {
    "plate": ("square", PULLED[0], PULLED[1] % [0.1, 0]),
    "room": ("cube", "", "f = 1"),
}


@pytest.mark.parametrize("name", CASES)
def test_command_line(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch):
    """The report and the files speak of no contact where there is none, and all pictures are drawn."""
    monkeypatch.setattr(space, "PIXELS", 300)
    monkeypatch.setitem(STYLE, "figure.dpi", 30)
    shape, physics, data = CASES[name]
    (tmp_path / "mine.toml").write_text(CASE.format(shape=shape, physics=physics, data=data))
    done = signorini(tmp_path, "solve", "mine.toml", "--output", "out", "--plot")
    assert done.returncode == 0, done.stderr
    assert "certified  energy error ≤" in done.stdout
    drawn = {path.name for path in (tmp_path / "out").glob("*.png")}
    assert "certificate.png" in drawn
    assert drawn >= ({"deformed.png", "displacement.png"} if physics else {"overview.png", "u.png"})
    assert "pressure.png" not in drawn
    assert "facets" not in done.stdout
    assert "contact" not in done.stdout.replace("contact_force", "")
    assert not (tmp_path / "out" / "contact.xdmf").exists()


def test_pulled_in_time(tmp_path: Path):
    """Loads in steps: the forces are drawn, and there is no picture of contact."""
    shape, physics, data = CASES["plate"]
    time = "\n[time]\nend = 1\nsteps = 2\n"
    text = CASE.format(shape=shape, physics=physics, data=data.replace("0.1", '"0.1*t"')) + time
    (tmp_path / "mine.toml").write_text(text)
    done = signorini(tmp_path, "solve", "mine.toml", "--output", "out", "--plot")
    assert done.returncode == 0, done.stderr
    drawn = {path.name for path in (tmp_path / "out").glob("*.png")}
    assert ("forces.png" in drawn, "contact.png" in drawn) == (True, False)
