"""Refinement keeps the domain and does not depend on the number of ranks; adaptive runs have the best rate."""

import itertools
import json
from pathlib import Path

import dolfinx.mesh
import numpy as np
import pytest
import ufl
from bodies_apart import two
from commands import read_rows, signorini
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.api import Elasticity, Pair, Solver, Tied
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.owned import cells_behind
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import adapt_case
from signorini_fenicsx.certificate.adaptive import AdaptRow, rate, with_opposite
from signorini_fenicsx.meshes.domain import Domain, distribute
from signorini_fenicsx.meshes.meshing import build_domain, label_parts
from signorini_fenicsx.meshes.refinement import dorfler, refine
from signorini_fenicsx.meshes.shapes import SHAPES

COMM = MPI.COMM_WORLD


def corners(domain: Domain) -> np.ndarray:
    """Vertices of the cells of this rank, shape (cells, dim + 1, dim)."""
    return domain.mesh.geometry.x[domain.mesh.geometry.dofmaps[0], : domain.mesh.topology.dim]


def refined(comm: MPI.Comm, shape: str, mesh: str, h: float, times: int) -> Domain:
    """A mesh refined several times towards a point of Γ_S, and once everywhere."""
    domain = build_domain(comm, shape, h, mesh=mesh)
    corner = np.array([0.5, 0.0, 0.0] if SHAPES[shape].parts.keys() & {"bottom"} else [0.5, 0.0, -1.0])
    for time in range(times):
        distance = np.linalg.norm(corners(domain).mean(axis=1) - corner[: SHAPES[shape].dim], axis=1)
        cells = dorfler(1 / (0.01 + distance), 1.0 if time == 1 else 0.3, comm)
        domain = refine(domain, cells)
    return domain


@pytest.mark.parallel([1, 3])
def test_refined_meshes_fill_the_domain():
    """No gaps and no overlaps, complete parts, vertices on curved boundaries, cells of good shape."""
    for shape, mesh, h in [
        ("lshape", "structured", 0.8),
        ("half_disk", "unstructured", 0.5),
        ("annulus", "unstructured", 0.5),
        ("lprism", "structured", 1.0),
        ("ball", "unstructured", 0.8),
    ]:
        domain = refined(COMM, shape, mesh, h, 4)
        dim = SHAPES[shape].dim
        named = np.sort(np.concatenate(list(domain.facets.values())))
        np.testing.assert_array_equal(named, np.sort(dolfinx.mesh.exterior_facet_indices(domain.mesh.topology)))
        curved = [part for part in SHAPES[shape].parts.values() if part.nearest is not None]
        measure = COMM.allreduce(fem.assemble_scalar(fem.form(fem.Constant(domain.mesh, 1.0) * ufl.dx)))
        relative = measure / SHAPES[shape].measure - 1
        assert abs(relative) < (0.1 if curved else 1e-12)
        for name, part in SHAPES[shape].parts.items():
            nodes = dolfinx.mesh.entities_to_geometry(domain.mesh, dim - 1, domain.facets[name]).ravel()
            x = domain.mesh.geometry.x[nodes].T
            assert part.contains(x).all()
            if part.nearest is not None:
                np.testing.assert_allclose(x, part.nearest(x), atol=1e-15)
        x = corners(domain)
        longest = np.linalg.norm(x[:, :, None] - x[:, None], axis=3).max(axis=(1, 2), initial=0.0)
        volume = np.abs(np.linalg.det(x[:, 1:] - x[:, :1]))
        assert np.all(volume > {2: 0.15, 3: 0.015}[dim] * longest**dim)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize(("lower", "opposite"), [(4, [0.125, 0.375]), (12, [])])
def test_masters_are_refined_with_slaves(lower: int, opposite: list[float]) -> None:
    """With the cell behind a slave those behind masters opposite to it are halved, if they would be coarse."""
    domain, problem = two(COMM, (3, 2), (lower, 2)), Elasticity(1, 0.3, conditions=[Pair("u10", "l11", Tied())])
    spaces = Solver(domain, problem).spaces
    centre = spaces.vertices.mean(axis=1)
    behind, beside = ((abs(centre[:, 1]) < 1 / 5) & (centre[:, 1] * side > 0) for side in (1, -1))
    on_pair = np.isin(np.arange(len(centre)), cells_behind(domain.mesh, spaces.pairs[0].slaves_and_masters))
    chosen = np.flatnonzero(behind & on_pair & (centre[:, 0] < 1 / 3)).astype(np.int32)
    marked = with_opposite(spaces, chosen)
    assert set(chosen) <= set(marked)
    x = centre[np.setdiff1d(marked, chosen)]
    assert (on_pair & beside)[np.setdiff1d(marked, chosen)].all()
    found = np.sort(np.concatenate(COMM.allgather(x[:, 0])))
    assert len(found) == len(opposite)
    assert np.allclose(found, opposite, atol=0.1)


@pytest.mark.parallel([2, 3])
def test_refinement_does_not_depend_on_the_ranks():
    """The cells are the same on any number of ranks, also where edges have equal length."""
    shapes = [("cube", "structured", 0.9), ("annulus", "unstructured", 0.5)]
    for shape, mesh, h in shapes:
        together, alone = (refined(comm, shape, mesh, h, 4) for comm in (COMM, MPI.COMM_SELF))
        weights = np.array([1.0, np.pi, np.e])[: SHAPES[shape].dim]
        parts = COMM.allgather(np.sort(corners(together) @ weights, axis=1))
        cells, expected = np.concatenate(parts), np.sort(corners(alone) @ weights, axis=1)
        assert len(cells) == len(expected) > 100
        for rows in (cells, expected):
            rows[:] = rows[np.lexsort(np.round(rows, 9).T)]
        np.testing.assert_allclose(cells, expected, atol=1e-13)


def test_no_slope_from_rounding():
    """Bounds that are rounding, and meshes of nearly one size, have no slope."""

    def rows(*pairs: tuple[int, float], relative: float = 1.29) -> list[AdaptRow]:
        of_mesh = {"refinement": "adaptive", "mesh": 0, "h": 0.1, "cells": 1, "seconds": 0.0, "iterations": 1}
        of_solution = {"contact_facets": 0, "contact_measure": 0.0, "gap": 0.0, "oscillation": 0.0}
        named = of_mesh | of_solution | {"relative": relative}
        return [AdaptRow(unknowns=unknowns, bound=bound, **named) for unknowns, bound in pairs]

    assert rate(rows((10, 4.0), (20, 4.0), (40, 2.0), (80, 1.0))) == pytest.approx(-1)
    assert rate(rows((10, 0.3), (20, 0.2), (40, 1e-1), (80, 1e-16))) is None  # −67 before
    assert rate(rows((10, 0.3), (20, 0.2), (1000, 0.1), (1010, 0.05))) is None
    assert rate(rows((10, 3e-15), (20, 2e-15), (40, 1e-15), (80, 1e-16), relative=1e-14)) is None


def test_dorfler():
    """The smallest set with the wanted share; ties are marked together."""
    rng = np.random.default_rng(COMM.rank)
    indicator = rng.uniform(0, 1, 50 + COMM.rank) ** 3
    everything = np.concatenate(COMM.allgather(indicator))
    for theta in (0.1, 0.5, 0.9):
        chosen = np.concatenate(COMM.allgather(indicator[dorfler(indicator, theta, COMM)]))
        wanted = theta * (everything**2).sum()
        assert (chosen**2).sum() >= wanted > (chosen**2).sum() - chosen.min() ** 2
        assert np.all(np.sort(everything)[-len(chosen) :] == np.sort(chosen))
    ties = np.repeat([1.0, 2.0], 10) * (1 + 1e-14 * rng.uniform(-1, 1, 20))
    assert list(dorfler(ties, 0.3, COMM)) == list(range(10, 20))
    assert len(dorfler(ties, 1.0, COMM)) == 20
    assert len(dorfler(np.zeros(0 if COMM.rank else 3), 0.5, COMM)) == (0 if COMM.rank else 3)


def test_a_cell_that_would_be_flattened_is_a_failure():
    """Six cells are too few for an annulus: the midpoints on the inner triangle would have to move too far."""
    angles = np.linspace(0, 2 * np.pi, 4)[:3]
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.concatenate([0.5 * ring, ring])
    quads = [(i, (i + 1) % 3, 3 + (i + 1) % 3, 3 + i) for i in range(3)]
    cells = np.array([tri for a, b, c, d in quads for tri in ((a, b, d), (b, c, d))])
    domain = label_parts(distribute(MPI.COMM_SELF, points, cells, 2), "annulus")
    with pytest.raises(NumericalFailure, match="flatten a cell"):
        refine(domain, np.arange(6, dtype=np.int32))


def history(case: str, theta: float, *, max_cells: int, **values: object) -> list[AdaptRow]:
    rows: list[AdaptRow] = []
    problem = load_case(case).with_values({key.replace("_", "."): value for key, value in values.items()})
    adapt_case(problem, COMM, max_cells=max_cells, theta=theta, on_row=rows.append)
    return rows


@pytest.mark.parametrize(("element", "best"), [("RT0", -0.47), ("RT1", -0.9)])
def test_best_rate_where_uniform_meshes_lose_it(element: str, best: float):
    """Example 5 has a corner of 270°: adaptive meshes keep the best order, uniform ones have ⅓ to 0.4."""
    given = {"max_cells": 7_000 if element == "RT0" else 2_000, "solve_h": 0.4, "solve_element": element}
    adaptive, uniform = (history("example5", theta, **given) for theta in (0.5, 1.0))
    slow, fast = rate(uniform), rate(adaptive)
    assert slow is not None
    assert fast is not None
    assert slow > -0.43
    assert fast < best
    reached = next(row for row in adaptive if row.bound <= uniform[-1].bound)
    assert reached.unknowns < 0.5 * uniform[-1].unknowns
    assert all(later.bound < earlier.bound for earlier, later in itertools.pairwise(adaptive))
    assert max(row.iterations for row in adaptive[2:]) <= (3 if element == "RT0" else 4)
    assert np.mean([row.iterations for row in adaptive[2:]]) <= 3


def test_all_algorithms_and_the_end():
    """Every algorithm refines until the target is reached and then stops."""
    for algorithm in ("alg4", "snes1", "vi"):
        case = load_case("example4").with_values({"solve.h": 0.4, "solve.algorithm": algorithm})
        rows: list[AdaptRow] = []
        _, certificate = adapt_case(case, COMM, target=0.06, max_cells=2000, on_row=rows.append)
        assert certificate.relative == rows[-1].relative
        assert rows[-1].relative <= 0.06 < rows[-2].relative or rows[-1].cells > 1000
    with pytest.raises(InputError, match="more than the 20 allowed"):
        adapt_case(case, COMM, max_cells=20)


def test_command_line(tmp_path: Path):
    done = signorini(tmp_path, "adapt", "example3", "--h", "1/2", "--max-cells", "800", "--uniform")
    assert done.returncode == 0, done.stderr
    assert "energy error ≤" in done.stdout
    results = tmp_path / "results" / "example3-adapt"
    rows = read_rows(results / "adapt.csv")
    assert {row["refinement"] for row in rows} == {"adaptive", "uniform"}
    assert all(int(row["cells"]) <= 800 for row in rows)
    certified = json.loads((results / "summary.json").read_text())["certificate"]["bound"]
    assert certified == float([row for row in rows if row["refinement"] == "adaptive"][-1]["bound"])
    for name in ("adapt.png", "mesh.png"):
        assert (results / name).stat().st_size > 10_000


def test_target_out_of_reach_is_a_failure_with_its_state(tmp_path: Path):
    done = signorini(tmp_path, "adapt", "example2", "--target", "1e-3", "--max-cells", "300")
    assert done.returncode == 1
    assert "not 0.001" in done.stderr
    assert [path.name for path in (tmp_path / "results").iterdir()] == ["example2-adapt.failed"]
    assert (tmp_path / "results" / "example2-adapt.failed" / "adapt.csv").exists()
