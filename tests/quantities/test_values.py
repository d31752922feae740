"""Values of quantities are those of the discrete solution; intervals of a problem and of its mirror are the same."""

from dataclasses import replace

import pytest
import ufl
from mpi4py import MPI

from signorini_fenicsx import Corners, Diffusion, Dirichlet, Neumann, River, Seepage, Signorini, solve
from signorini_fenicsx.cli.solution_report import interval
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.solution import flux_through
from signorini_fenicsx.quantities import Energy, Flux, Integral, Mean, Quantity

COMM = MPI.COMM_WORLD


def test_the_value_is_that_of_the_solution(monkeypatch: pytest.MonkeyPatch):
    """Of u_h over Ω, of p_h on Γ_S, of traces by σ_h and u_h on Γ_N, of σ_h through parts; so is an energy."""
    monkeypatch.setattr("signorini_fenicsx.quantities.bracket.MOST", 2)  # the intervals are not looked at
    conditions = [Signorini("left"), Dirichlet("right", "0.5"), Neumann(["top", "bottom"])]
    domain = build_domain(COMM, "square", 1.001 * 2**0.5 / 2, mesh="structured")
    solution = solve(domain, Diffusion(f="-12*x^2", conditions=conditions))
    spaces = solution.spaces
    flux, mean = solution.quantity(Flux("left", weight="y*(1 - y)")), solution.quantity(Mean())
    assert solution.quantity(Flux("right")).value == solution.flux_through("right")
    y = ufl.SpatialCoordinate(spaces.mesh)[1]
    assert flux.value == pytest.approx(flux_through(spaces, solution.sigma, "left", y * (1 - y)), abs=1e-13)
    assert mean.value == pytest.approx(COMM.allreduce(spaces.cell_measures @ solution.u.x.array), abs=1e-13)
    held = solution.quantity(Integral(parts="left"))
    assert held.value == pytest.approx(COMM.allreduce(spaces.facet_measure @ solution.p.x.array), abs=1e-13)
    energy = solution.quantity(Energy())
    assert energy.lower <= energy.value <= energy.upper
    linear = Diffusion(f=0, u_D="x + 2*y", conditions=[Neumann("top", 2), Signorini("bottom", psi="x - 1", q_S=-2)])
    trace = solve(build_domain(COMM, "square", 1 / 2, mesh="unstructured"), linear)
    assert trace.quantity(Integral(parts=["top", "bottom"])).value == pytest.approx(3, abs=1e-12)
    assert trace.quantity(Energy()).value == pytest.approx(2.5 - 5 + 1, abs=1e-12)


def test_a_value_beside_its_interval_is_told():
    """It is said in the report where σ_h is outside of the interval that it belongs to."""
    within, beside = Quantity(0.5, 0.0, 1.0, proved=True), Quantity(-0.5, 0.0, 1.0, proved=True)
    assert interval(within) == "0.5, in [0.0000000e+00, 1.0000000e+00]"
    assert interval(beside).startswith("-0.5 of the discrete solution, outside of [0.0")


@pytest.mark.parallel([1, 3])
def test_discharge_above_the_water_table():
    """Half of what flows through a square passes cells above the table, on its way in and out; others say nothing."""
    domain = build_domain(COMM, "square", 1.001 * 2**0.5 / 4, mesh="structured")
    river = River("right", r=1, level=0.45, bed=-1)
    solution = solve(domain, Diffusion(f=0, u_D=0.5, conditions=[river, Neumann(["top", "bottom"])]))
    assert solution.water["right"] == pytest.approx({"inflow": -0.025, "above_table": 0.5}, abs=1e-9)
    assert "through 'right' 0.025 flow out, 50 % of it passes where" in " ".join(solution.notes())
    for part in ("left", "right") if COMM.size == 1 else ():
        found = solution.quantity(Flux(part))
        assert found.above_table == pytest.approx(0.5, abs=1e-9)
        assert "50 % of it passes where the pressure is negative" in interval(found)
    wet = solve(domain, Diffusion(f=0, u_D=2, conditions=[replace(river, level=1.5), Neumann(["top", "bottom"])]))
    assert wet.water["right"]["above_table"] == 0
    assert not wet.notes()
    dry = solve(domain, Diffusion(f=0, u_D=-1, conditions=[Seepage("right", rain=-0.1), Neumann(["top", "bottom"])]))
    assert dry.water["right"]["above_table"] == pytest.approx(1, abs=1e-9)  # of a pressure head
    other = solve(domain, Diffusion(f=0, u_D=0.5, conditions=[Signorini("right"), Neumann(["top", "bottom"])]))
    assert not other.water


def test_laws_and_their_mirrors():
    """The interval for −u is that for u with the other sign, to rounding: a seepage face and Signorini's law."""
    found = []
    for sign, law in ((1, Seepage("right", level="y")), (-1, Signorini("right", psi="-y"))):
        conditions = [law, Neumann(["top", "bottom"])]
        problem = Diffusion(f=0, u_D=sign, kappa="1 if x < 0.5 else 1e3", conditions=conditions)
        domain = build_domain(COMM, "square", 1.001 * 2**0.5 / 4, mesh="structured")
        found.append(solve(domain, problem).quantity(Flux("right")))
    one, other = found
    assert (one.lower, one.upper) == pytest.approx((-other.upper, -other.lower), abs=1e-6 * one.width)


@pytest.mark.parametrize("law", ["seepage", "graph"])
def test_beside_a_waterline(law: str):
    """Where the kink of a bound and a large force are within a facet the interval is no longer than elsewhere."""
    level, rain = "max(y, 0.55)", "1e3 if y < 0.55 else 0"
    face = Seepage("left", level=level, rain=rain)
    if law == "graph":
        face = Corners("left", corners=[(level, rain)], beyond="vertical")
    conditions = [face, Seepage("right", level="y"), Neumann(["top", "bottom"])]
    domain = build_domain(COMM, "square", 1.001 * 2**0.5 / 4, mesh="structured")
    assert solve(domain, Diffusion(f=1, conditions=conditions)).quantity(Flux("right")).width < 0.12
