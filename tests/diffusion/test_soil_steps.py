"""Water in soil over time: storage, balance, published and exact columns, RT1, pairs, levels in t, restarts, ranks."""

import itertools
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from bodies_apart import joined, two
from commands import read_rows
from in_time import run, run_in_two
from makers.bounds import difference
from mpi4py import MPI

from signorini_fenicsx import (
    Diffusion,
    Dirichlet,
    Evolution,
    InputError,
    Neumann,
    NumericalFailure,
    Options,
    Pair,
    River,
    Seepage,
    Tied,
    TwoSided,
    evolve,
    evolve_case,
    load_case,
    load_solution,
)
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.soils import Gardner, Soil, VanGenuchten
from signorini_fenicsx.physics.diffusion.solve.quasilinear import QuasiLinear
from signorini_fenicsx.quantities import Flux
from signorini_fenicsx.solving.evolving import Instant

COMM = MPI.COMM_WORLD
CELIA = VanGenuchten(0.00922, 0.0335, 2, 0.102, 0.368)


def column(n: int, height: float, comm: MPI.Intracomm = COMM, across: int = 2) -> Domain:
    """A column of squares, one or two in width; each has two triangles, or four."""
    h, diagonal = (1.0001, "crossed") if across == 2 else (1.4143, "right")
    shape = f"[0, {across * height / n}] x [0, {height}]"
    return build_domain(comm, shape, h * height / n, mesh="structured", diagonal=diagonal)


def by_finite_volumes(
    soil: Soil, height: float, n: int, steps: int, end: float, *, first: float, top: float, bottom: float
) -> tuple[np.ndarray, float]:
    """The pressure heads of n cells from the bottom at the end, and the water taken up, by Celia's iteration.

    At both ends the pressure head is given. κ between cells is the mean of both.
    """
    dz, tau = height / n, end / steps
    z = (np.arange(n) + 0.5) * dz
    x, ends = np.column_stack([np.zeros(n), z]), np.array([[0, 0.0], [0, height]])
    psi = np.full(n, first)
    began = theta = soil.content(x, psi + z)[0]
    k_ends = soil(ends, np.array([bottom, top + height]))[0]
    for _ in range(steps):
        for _ in range(100):
            k, (content, slope) = soil(x, psi + z)[0], soil.content(x, psi + z)
            through = np.concatenate([[2 * k_ends[0]], (k[1:] + k[:-1]) / 2, [2 * k_ends[1]]]) / dz**2
            matrix = np.diag(slope / tau + through[1:] + through[:-1])
            matrix -= np.diag(through[1:-1], 1) + np.diag(through[1:-1], -1)
            right = (slope * (psi + z) - content + theta) / tau
            right[0] += through[0] * bottom
            right[-1] += through[-1] * (top + height)
            change, psi = psi, np.linalg.solve(matrix, right) - z
            if np.abs(psi - change).max() < 1e-7 * np.abs(psi).max():
                break
        theta = theta + slope * (psi - change) + content - theta
    return psi, float((theta - began).sum() * dz)


def test_celias_infiltration(monkeypatch: pytest.MonkeyPatch):
    """Infiltration into dry soil has the front and the water of a finer solution in one dimension; no mass is lost.

    What is stored is looked at some 20 times for each linear problem: no step is halved for rounding.
    """
    looks, content = [], Soil.content
    monkeypatch.setattr(Soil, "content", lambda *given: looks.append(1) or content(*given))
    conditions = [Neumann(["left", "right"], 0), Dirichlet("top", 100 - 75), Dirichlet("bottom", -1000)]
    problem = Diffusion(kappa=CELIA, f=0, conditions=conditions)
    steps = list(evolve(column(20, 100), problem, Evolution(end=21600, steps=6, initial="y - 1000")))
    assert len(looks) < 3000
    psi, taken = by_finite_volumes(CELIA, 100, 100, 24, 21600, first=-1000, top=-75, bottom=-1000)
    assert max(step.numbers["mass_error"] for step in steps) < 1e-11
    assert max(step.numbers["content_change"] for step in steps) < 1e-11
    assert {step.numbers["parts"] for step in steps} == {1}
    inflow = sum(step.numbers["inflow"] for step in steps)
    assert inflow == pytest.approx(steps[-1].numbers["content"] - (10 * 100 * 0.10994), rel=2e-3)
    assert inflow == pytest.approx(10 * taken, rel=0.02)
    z = np.arange(100) + 0.5
    found = steps[-1].solution.at(np.column_stack([np.full(100, 5.1), z]))[0] - z
    assert np.interp(-500, found, z) == pytest.approx(np.interp(-500, psi, z), abs=2)
    assert found[90:] == pytest.approx(psi[90:], rel=0.02)


def test_heads_of_rounding(monkeypatch: pytest.MonkeyPatch):
    """Far from where water enters the head stays 0 but for rounding, and no step of what is stored is halved for it."""
    looks, content = [], Soil.content
    monkeypatch.setattr(Soil, "content", lambda *given: looks.append(1) or content(*given))
    conditions = [Neumann(["left", "right"], 0), Dirichlet("top", 1e-3), Dirichlet("bottom", 0)]
    problem = Diffusion(kappa=CLAY, f=0, conditions=conditions)
    (step,) = evolve(column(10, 100), problem, Evolution(end=5e-4, steps=1, initial="0"))
    assert step.numbers["mass_error"] < 1e-11
    assert len(looks) < 30 * step.numbers["linear_solves"]


CLAY, SAND = VanGenuchten(0.048, 0.8, 1.09, 0.068, 0.38), VanGenuchten(7.128, 14.5, 2.68, 0.045, 0.43)
ON_TOP = {
    "rain on clay": (CLAY, Neumann("top", 0.024), Dirichlet("bottom", 0), "0", 0.625, 3, 18),
    "standing on clay": (CLAY, Dirichlet("top", 1.05), Dirichlet("bottom", -10), "y - 10", 0.3125, 3, 20),
    "a jump": (SAND, Neumann("top", 0), Dirichlet("bottom", 0), "1", 0.2, 2, 6),
    "standing water": (SAND, Dirichlet("top", 1), Dirichlet("bottom", -10), "y - 10", 0.0014, 1, 24),
}


@pytest.mark.parametrize(("soil", "top", "bottom", "first", "end", "steps", "most"), ON_TOP.values(), ids=ON_TOP)
def test_hard_steps(soil: Soil, top: Law, bottom: Law, first: str, end: float, steps: int, most: int):
    """Steps end in one piece where the slope of κ is infinite at saturation, after a jump, and in very dry soil.

    Soil that drains takes five of Newton's steps and a problem under a fixed κ.
    """
    domain = column(20, 1.0, across=1)
    problem = Diffusion(kappa=soil, f=0, conditions=[Neumann(["left", "right"], 0), top, bottom])
    numbers = [step.numbers for step in evolve(domain, problem, Evolution(end=end, steps=steps, initial=first))]
    assert max(each["parts"] for each in numbers) == 1
    assert max(each["mass_error"] for each in numbers) < 1e-11
    assert max(each["linear_solves"] for each in numbers) <= most


MEASURED = [(0.025, 1.121), (0.287, 1.102), (0.491, 1.073), (0.7, 1.038), (0.995, 0.97), (1.303, 0.902), (1.599, 0.836)]
"""The water table after 4 hours: x and height in m, read off from the figure of Vauclin, Khanji and Vachaud."""


def test_vauclins_water_table():
    """The water table of a slab with recharge is that of the experiment but for some centimetres."""
    case = load_case("vauclin").with_values({"solve.h": 0.236, "time.steps": 8, "time.end": 4})
    *_, last = evolve_case(case)
    line = last.solution.readings["phreatic"]
    x, height = np.array(MEASURED).T
    order = np.argsort(line["x"])
    assert np.interp(x, line["x"][order], line["y"][order]) == pytest.approx(height, abs=0.07)
    assert last.numbers["mass_error"] < 1e-11


ALPHA, SPAN, BEFORE, RAIN = 3.0, 0.4, 0.1, 0.6
WETTER = Diffusion(
    kappa=Gardner(1.0, ALPHA, theta_s=SPAN),
    f=0,
    conditions=[Neumann(["left", "right"], 0), Neumann("top", RAIN), Dirichlet("bottom", 0)],
)
"""More rain on Gardner's soil, in a column 1 high."""


def wetter(steps: int, scheme: str = "implicit-euler") -> Evolution:
    """It until t = 0.1, from the steady head of the rain before."""
    first = f"y + log(({1 - BEFORE})*exp(-{ALPHA}*y) + {BEFORE})/{ALPHA}"
    return Evolution(end=0.1, steps=steps, initial=first, scheme=scheme)


@pytest.mark.parametrize(
    ("element", "scheme", "steps", "most", "order"),
    [("RT0", "implicit-euler", (4, 16), 0.01, math.log2(3)), ("RT1", "bdf2", (4, 8), 1.2e-3, 2)],
)
def test_srivastavas_and_yehs_column(element: str, scheme: str, steps: tuple[int, int], most: float, order: float):
    """It has an exact solution (Water Resour. Res. 27, 1991): order 1 in τ, 2 in h, and with BDF2 2 in both."""
    alpha, span, before, rain, end = ALPHA, SPAN, BEFORE, RAIN, 0.1
    n = np.arange(1, 61)
    low, high = (n - 0.5) * np.pi / alpha, n * np.pi / alpha  # a root of tan λα + 2λ in each
    for _ in range(60):
        middle = (low + high) / 2
        above = np.tan(middle * alpha) + 2 * middle > 0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    z, t = (np.arange(8) + 0.5) / 8, alpha * end / span
    waves = np.sin(np.outer(alpha * z, low)) * np.sin(low * alpha) * np.exp(-(low**2) * t)
    series = (waves / (1 + alpha / 2 + 2 * low**2 * alpha)).sum(axis=1)
    k = rain - (rain - 1) * np.exp(-alpha * z) - 4 * (rain - before) * np.exp(alpha * (1 - z) / 2 - t / 4) * series
    errors = []
    for number, each in zip((4, 8) if element == "RT1" else (8, 16), steps, strict=True):
        *_, last = evolve(column(number, 1.0), WETTER, wetter(each, scheme), Options(element=element))
        assert last.numbers["mass_error"] < 1e-11
        found = last.solution.at(np.column_stack([np.full(8, 1.01 / number), z]))[0] - z
        errors.append(np.abs(found - np.log(k) / alpha).max())
    assert errors[1] < most
    assert math.log2(errors[0] / errors[1]) > order


def test_order_two_in_space():
    """With RT1 the flux after two steps is of order two in h, and nearer to that of fine cells than with RT0 of 1/4."""
    found = {}
    for element, n in (("RT1", 2), ("RT1", 4), ("RT0", 8), ("RT1", 16)):
        *_, last = evolve(column(n, 1.0, across=1), WETTER, wetter(2, "bdf2"), Options(element=element))
        found[element, n] = last.solution
    fine = found.pop(("RT1", 16))
    coarse, finer, lowest = (difference(each, fine) for each in found.values())
    assert math.log2(coarse / finer) > 1.7
    assert finer < lowest / 5


def test_order_two_in_very_dry_soil():
    """Water on soil whose k_r is on its floor, and a column that dries: mass and KKT to rounding, with RT1."""
    sides = Neumann(["left", "right"], 0)
    for top, bottom, first, end, most in (
        (Dirichlet("top", 1), Dirichlet("bottom", -10), "y - 10", 0.00014, 2),
        (Neumann("top", 0), Dirichlet("bottom", 0), "1", 0.2, 1),
    ):
        problem = Diffusion(kappa=SAND, f=0, conditions=[sides, top, bottom])
        evolution = Evolution(end=end, steps=1, initial=first)
        (step,) = evolve(column(8, 1.0, across=1), problem, evolution, Options(element="RT1"))
        assert step.numbers["parts"] <= most
        assert step.numbers["mass_error"] < 1e-11
        assert max(vars(step.solution.kkt).values()) < 1e-9


@pytest.mark.parametrize("element", ["RT0", "RT1"])
def test_specific_storage_of_saturated_soil_is_a_capacity(element: str):
    """Where soil stays saturated the numbers are those of a linear problem with that capacity."""
    square = build_domain(COMM, "square", 0.3, mesh="structured")
    conditions = [Dirichlet("left", "9 + t"), Dirichlet("right", 8), Neumann(["top", "bottom"], 0)]
    evolution = Evolution(end=1, steps=3, initial="9 - x")
    wet, plain = (
        list(evolve(square, Diffusion(kappa=kappa, f="x", conditions=conditions), how, Options(element=element)))
        for kappa, how in (
            (VanGenuchten(2.0, 1.0, 2.0, specific_storage=0.7), evolution),
            (2.0, Evolution(end=1, steps=3, initial="9 - x", capacity=0.7)),
        )
    )
    for one, other in itertools.zip_longest(wet, plain):
        assert one.solution.norms() == pytest.approx(other.solution.norms(), rel=1e-10)


@pytest.mark.parametrize("element", ["RT0", "RT1"])
def test_the_pressure_form_has_the_water_of_the_head_form(element: str):
    """With the pressure head as u and gravity as a given flux a step stores and moves the same water."""
    soil, sides = VanGenuchten(1.0, 2.0, 1.8, 0.05, 0.4), Neumann(["left", "right"], 0)
    found = []
    for form, top, first in (("head", 0.9, "-1"), ("pressure", -0.1, "-1 - y")):
        problem = Diffusion(kappa=soil, f=0, form=form, conditions=[sides, Dirichlet("top", top), Neumann("bottom", 0)])
        *_, last = evolve(column(6, 1.0), problem, Evolution(end=0.2, steps=2, initial=first), Options(element=element))
        found.append({key: last.numbers[key] for key in ("content", "inflow")})
        assert last.numbers["mass_error"] < 1e-11
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_water_at_rest_loses_none():
    """A box in space is filled in a step, and in the next nothing flows: what rounding leaves is no error of mass."""
    cube, filled = build_domain(COMM, "cube", 0.9, mesh="structured"), Dirichlet("top", 1.1)
    walls = Neumann([part for part in cube.facets if part != "top"], 0)
    problem = Diffusion(kappa=VanGenuchten(1.0, 2.0, 1.8, 0.05, 0.4), f=0, conditions=[filled, walls])
    for step in evolve(cube, problem, Evolution(end=0.2, steps=2, initial=0.2), Options(element="RT1")):
        assert step.numbers["mass_error"] < 1e-11
        assert step.numbers["content"] == pytest.approx(0.4)


def test_bodies_with_meshes_of_their_own():
    """A tied pair of bodies with the same facets stores and moves the water of one body; with other facets near it."""
    soil, held = VanGenuchten(1.0, 2.0, 1.8, 0.05, 0.4), [Neumann("u11", 0.1), Dirichlet("l10", 0.3)]
    sides, pair = Neumann([f"{body}0{end}" for body in "ul" for end in (0, 1)]), Pair("u10", "l11", Tied())
    same, other = (two(COMM, *shapes) for shapes in (((3, 2), (3, 2)), ((3, 2), (2, 3))))
    whole = joined((3, 2)), [Neumann(["x0", "x1"]), TwoSided("u10", psi_upper=0)]
    found = []
    for domain, conditions in (whole, (same, [sides, pair]), (other, [sides, pair])):
        problem = Diffusion(kappa=soil, f=0, conditions=[*held, *conditions])
        *_, last = evolve(domain, problem, Evolution(end=0.4, steps=2, initial=0.3), Options(element="RT1"))
        assert last.numbers["mass_error"] < 1e-11
        found.append([last.numbers["content"], last.numbers["inflow"]])
    assert found[1] == pytest.approx(found[0], rel=1e-8)
    assert found[2] == pytest.approx(found[0], rel=0.05)


@pytest.mark.parametrize(("least", "parts"), [(15.0, 4), (np.inf, 0)])
def test_a_step_that_fails_is_done_in_halves(monkeypatch: pytest.MonkeyPatch, least: float, parts: int):
    """A step whose u is found in its quarters alone is that of four steps; without any the run ends and says so."""
    newton = QuasiLinear._newton

    def in_short_steps(method: QuasiLinear) -> Iterator[Outcome]:
        if method.backend.data.quasilinear.storing.rate > least:
            yield from newton(method)

    monkeypatch.setattr(QuasiLinear, "_newton", in_short_steps)
    conditions = [Neumann(["left", "right", "bottom"], 0), Dirichlet("top", 1)]
    soil = Gardner(1.0, 2.0, theta_s=0.4) if parts else CLAY
    problem = Diffusion(kappa=soil, f=0, conditions=conditions)

    def last(steps: int) -> Instant:
        *_, instant = evolve(column(3, 1.0), problem, Evolution(end=0.15, steps=steps, initial="y - 1"))
        return instant

    if parts == 0:
        with pytest.raises(NumericalFailure, match=r"n near 1 needs an air_entry.*1/1024 of the step") as failure:
            last(1)
        assert not failure.value.solution.converged
        return
    whole, small = last(1), last(parts)
    assert whole.numbers["parts"] == parts
    assert whole.numbers["content"] == pytest.approx(small.numbers["content"], rel=1e-9)
    assert whole.numbers["mass_error"] < 1e-11


SMALL = {"geometry.shape": "[0, 20] x [0, 100]", "solve.h": 20, "time.steps": 2, "time.end": 7200}


@pytest.mark.parametrize("element", ["RT0", "RT1"])
def test_a_case_ends_and_goes_on(tmp_path: Path, element: str):
    """A run that ended after a step has the results of one that did not; its bound and quantity are for the last κ."""
    case = load_case("celia").with_values(SMALL | {"solve.element": element})
    run(case, tmp_path / "whole", plot=element == "RT0")
    run_in_two(case, tmp_path / "two", 2)
    whole, two = (read_rows(tmp_path / name / "steps.csv") for name in ("whole", "two"))
    assert len(whole) == 2
    for key in ("content", "inflow", "linear_solves", "parts"):
        assert [float(row[key]) for row in two] == pytest.approx([float(row[key]) for row in whole], rel=1e-12)
    assert all(float(row["bound"]) > 0 and "last κ" in row["bound_is"] for row in whole)
    one, other = (load_solution(tmp_path / name, COMM) for name in ("whole", "two"))
    assert one.norms() == pytest.approx(other.norms(), rel=1e-11)
    assert one.certify().bound == pytest.approx(float(whole[-1]["bound"]), rel=1e-10)
    if element == "RT0":
        inflow = one.quantity(Flux(["top"]))
        assert inflow.lower < inflow.value < inflow.upper
        return
    run(case.with_values({"time.steps": 1}), tmp_path / "on", start_from=tmp_path / "two", certify_steps=False)
    (on,), last = read_rows(tmp_path / "on" / "steps.csv"), float(whole[-1]["content"])
    assert float(on["content"]) - float(on["inflow"]) == pytest.approx(last, rel=1e-6)


@pytest.mark.parametrize("element", ["RT0", "RT1"])
@pytest.mark.parallel(2)
def test_ranks(element: str):
    """Rain, a river and a seepage face that change in time balance; the numbers do not depend on the ranks."""
    beside = [Neumann("left", 0), Seepage("right", level="y")]
    rained = Seepage("top", level=1, rain="0.2*t")
    conditions = [*beside, rained, River("bottom", r=4, level="0.5 + t", bed=-1)]
    problem = Diffusion(kappa=Gardner(1.0, 3.0, theta_s=0.4), f=0, conditions=conditions)
    found = []
    for comm in (COMM, MPI.COMM_SELF):
        evolution = Evolution(end=0.5, steps=2, initial=0.2)
        *_, last = evolve(column(4, 1.0, comm), problem, evolution, Options(element=element))
        assert last.numbers["mass_error"] < 1e-11
        assert last.solution.flux_through("bottom") > 0 > last.solution.flux_through("right")
        found.append(last.solution.norms() | {key: last.numbers[key] for key in ("content", "inflow", "linear_solves")})
    assert found[0] == pytest.approx(found[1], rel=1e-10)


@pytest.mark.parametrize(
    ("evolution", "options", "more", "told"),
    [
        (Evolution(1, 2, capacity=2), Options(), {}, "soils say what is stored"),
        (Evolution(1, 2), Options(), {"c": 1}, "with soils in time there is none"),
        (Evolution(1, 2), Options(), {"obstacle": -1}, "no laws in Ω"),
    ],
)
def test_refusals(evolution: Evolution, options: Options, more: dict, told: str):
    """What does not go with soils in time is refused in a sentence."""
    square = build_domain(COMM, "square", 0.5, mesh="structured")
    with pytest.raises(InputError, match=told):
        next(evolve(square, Diffusion(kappa=Gardner(1.0, 1.0), f=0, **more), evolution, options))
