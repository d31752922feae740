"""The graphs of laws: their bounds, whether they are monotone, any number of corners."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from made_cases import Spring
from mpi4py import MPI

from signorini_fenicsx import Corners, Diffusion, InputError, Options, TwoSided, certify, load_solution, solve
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.law import Graph, Law, Values
from signorini_fenicsx.expressions.given import Given
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.output.writing import write_solution

COMM = MPI.COMM_WORLD


@dataclass(frozen=True)
class Held(Law):
    """A law of one's own that ends in vertical segments: u between rest and 2, or between others that it computes."""

    rest: Given = 0.0
    shift: Given = 0.0
    segments = ("below", "free", "above")

    def graph(self, values: Values) -> Graph:
        """The upper end is a number."""
        low = values["rest"] + values["shift"] if self.shift else values["rest"]
        return Graph((0.0, 0.0), [(low, 0.0), (2.0, 0.0)], np.inf, np.inf)


def test_bounds_are_found_by_the_graph():
    """The datum at a vertical end is a bound, whatever its name, in a law of one's own and in one given by corners."""
    domain = build_domain(COMM, "square", 0.2, mesh="unstructured")
    given = "0.1*cos(3*x)"
    solutions = [
        solve(domain, Diffusion("20*(x - 0.6)", conditions=[law]))
        for law in (
            TwoSided(["bottom"], psi_upper=2.0, psi=given),
            Held(["bottom"], rest=given),
            Corners(["bottom"], [(given, 0), (2, 0)], "vertical", "vertical"),
        )
    ]
    bounds = [certify(solution).bound for solution in solutions]
    assert bounds == pytest.approx([bounds[0]] * 3, rel=1e-12)
    lower, upper = solutions[1].data.laws.of_parts[0].bounds
    assert lower is solutions[1].data.laws.of_parts[0].data["rest"]
    assert upper is not None
    assert upper.number == 2.0


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (Held(["bottom"], rest="log(x)"), r"law.0.rest: not finite everywhere on its parts"),
        (Corners(["bottom"], [("log(x)", 0)], "vertical"), r"law.0.corners.0.0: not finite everywhere on its parts"),
        (Corners(["bottom"], [(-9, 1), ("-log(x)", 0)], 0, "vertical"), r"law.0.corners.1.0: not finite everywhere"),
        (Held(["bottom"], rest="x", shift="1"), r"law.0 \(Held\): its graph is vertical at the first end, so u of"),
        (Held(["bottom"], rest="3*x"), r"law.0 \(Held\): u must not fall from corner 0 to 1, as at \(0.9"),
        (Spring(["bottom"], stiffness="x - 2"), r"law.0 \(Spring\): before must not be negative, as at \(0.0"),
    ],
)
def test_graphs_are_checked(law: Law, message: str):
    """A bound must be finite in all points and a datum; a graph must be monotone, also that of a law of one's own."""
    domain = build_domain(COMM, "square", 0.25, mesh="structured")
    with pytest.raises(InputError, match=message):
        solve(domain, Diffusion("20*(x - 0.6)", conditions=[law]))


def test_beside():
    """A site is on two segments at the corner between them alone, not where one goes on in the line of the other."""
    p, flux = np.array([[0.0, 0.1, 0.2, 0.3]]), np.array([[0.0, -1.3, -1.65, -2.0]])  # the third and fourth in one line
    chains = Chains.through(p, flux, np.array([np.inf]), np.array([1.0]))
    scales = np.ones(1), np.ones(1)

    def beside(segment: int, *at: float) -> int:
        return int(chains.beside(np.array([segment]), *(np.array([x]) for x in at), scales, 1e-8)[0])

    assert [beside(2, 0.15, -1.475), beside(2, 0.1, -1.3), beside(1, 0.1, -1.3)] == [0, -1, 1]
    assert [beside(0, 0.0, 1e-9), beside(0, 0.0, 1.0), beside(4, 0.3, -2.0), beside(4, 5.0, -6.7)] == [1, 0, -1, 0]


def test_many_corners(folder: Path):
    """A graph of 300 corners: any segment has a number, in the loop, in files and in messages."""
    u = np.linspace(-0.3, 0.3, 300)
    corners = [(float(a), float(b)) for a, b in zip(u, -8 * np.sinh(3 * u), strict=True)]
    law = Corners(["bottom"], corners, "vertical", "vertical")
    domain = build_domain(COMM, "square", 0.2, mesh="structured")
    solution = solve(domain, Diffusion("20*sin(5*x)*cos(3*y)", conditions=[law]))
    chains, segment = solution.law, solution.segments().segment
    assert set(chains.count) == {300}
    np.testing.assert_allclose([end[0] for end in chains.extent()], [-0.3, 0.3, -np.inf, np.inf], atol=1e-15)
    assert segment.max() > 130
    qp = solve(domain, solution.problem, Options("qp"))
    np.testing.assert_allclose(qp.sigma.x.array, solution.sigma.x.array, atol=1e-8)
    np.testing.assert_array_equal(qp.segments().segment, segment)
    assert certify(solution).guaranteed
    write_solution(solution, folder, fields=False)
    np.testing.assert_array_equal(load_solution(folder, COMM).segments().segment, segment)
    again = solve(domain, solution.problem, start=solution)
    assert len(again.outcome.history) == 1
