"""Known distances of contact sets, and comparisons that do not depend on order, mesh or ranks."""

import json
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from commands import signorini
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.comparing.comparison import compare
from signorini_fenicsx.discrete.contact_sets import FacetSet, hausdorff, jaccard
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces, build_spaces
from signorini_fenicsx.physics.diffusion.show.differences import Differences
from signorini_fenicsx.physics.diffusion.solution import Solution

COMM = MPI.COMM_WORLD


def facet_set(spaces: Spaces, low: float, high: float) -> FacetSet:
    """The facets of Γ_S with low < x < high."""
    import dolfinx.mesh

    x = dolfinx.mesh.compute_midpoints(spaces.mesh, spaces.mesh.topology.dim - 1, spaces.facets)[:, 0]
    return FacetSet(spaces, (low < x) & (x < high))


@pytest.mark.parallel(2)
def test_known_sets():
    """Intervals on the bottom of the square and strips on the bottom of the cube, on meshes that do not match."""
    for shape, per_unit in (("square", (4, 10)), ("cube", (2, 6))):
        diagonal = math.sqrt(2 if shape == "square" else 3)
        coarse, fine = (
            build_spaces(build_domain(COMM, shape, diagonal / n * 1.001, mesh="structured"), ["bottom"])
            for n in per_unit
        )
        half, most = facet_set(coarse, 0, 0.5), facet_set(fine, 0, 0.5 + 1 / per_unit[1])
        width = 0.5 + (1 / per_unit[1])
        assert jaccard(half, most) == pytest.approx(0.5 / width, abs=1e-12)
        assert hausdorff(half, most) == hausdorff(most, half) == pytest.approx(width - 0.5, abs=1e-12)
        left, right = facet_set(coarse, 0, 0.5), facet_set(fine, 0.5, 1)
        assert jaccard(left, right) == 0
        assert hausdorff(left, right) == pytest.approx(0.5)
        nothing = facet_set(fine, 2, 3)
        assert (jaccard(half, nothing), hausdorff(half, nothing)) == (0, math.inf)
        assert (jaccard(nothing, nothing), hausdorff(nothing, nothing)) == (1, 0)


@pytest.mark.parallel([1, 2])
def test_solutions():
    """Finer solutions are closer; order and ranks do not matter; a solution has no difference from itself."""
    case = load_case("example2")
    found = []
    for comm in (COMM, MPI.COMM_SELF)[: COMM.size]:
        coarse, middle, fine = (solve_case(case.with_values({"solve.h": h}), comm) for h in (0.4, 0.2, 0.1))
        far, near, back = compare(coarse, fine), compare(middle, fine), compare(fine, middle)
        assert near.norms == back.norms
        assert (near.jaccard, near.hausdorff) == (back.jaccard, back.hausdorff)
        assert near.norms.sigma_V < 0.6 * far.norms.sigma_V
        assert 0.9 < near.jaccard <= 1
        assert near.hausdorff < 1 / 4
        same = compare(fine, fine)
        assert same.jaccard == pytest.approx(1, abs=1e-13)
        assert max(same.hausdorff, *vars(same.norms).values()) < 1e-12
        found.append(near)
    together, alone = found[0], found[-1]
    assert vars(together.norms) == pytest.approx(vars(alone.norms), rel=1e-9)
    assert (together.jaccard, together.hausdorff) == pytest.approx((alone.jaccard, alone.hausdorff), rel=1e-10)
    with pytest.raises(InputError, match="the same domain and Γ_S"):
        compare(fine, solve_case(load_case("example1").with_values({"solve.h": 0.5}), MPI.COMM_SELF))


def test_position_of_the_exact_contact_set():
    """On transition cases the contact set is found to within about a facet."""
    for name, h in (("transition", 1 / 8), ("transition", 1 / 32), ("transition3d", 1 / 4)):
        errors = solve_case(load_case(name).with_values({"solve.h": h}), MPI.COMM_SELF).errors()
        assert errors is not None
        assert errors["contact_hausdorff"] < 1.5 * h


@pytest.mark.parallel([1, 2])
def test_command_line(folder: Path):
    for h in ("1/4", "1/8"):
        done = signorini(folder, "solve", "example3", "--h", h, "--output", h[-1])
        assert done.returncode == 0, done.stderr
    done = signorini(folder, "compare", "4", "8", "--output", "out")
    assert done.returncode == 0, done.stderr
    assert "Jaccard" in done.stdout
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert 0.8 < summary["jaccard"] <= 1
    assert np.isfinite(summary["hausdorff"])
    assert signorini(folder, "compare", "4", "missing").returncode == 2


def clipped(polygon: list[npt.NDArray], triangle: npt.NDArray) -> list[npt.NDArray]:
    """The part of a convex polygon in a triangle, both counterclockwise."""
    for a, b in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        inside = [float(np.linalg.det([b - a, x - a])) for x in polygon]
        kept = []
        for x, y, d, e in zip(polygon, np.roll(polygon, -1, axis=0), inside, np.roll(inside, -1), strict=True):
            if d >= 0:
                kept.append(x)
            if d * e < 0:
                kept.append(x + d / (d - e) * (y - x))
        if len(kept) < 3:
            return []
        polygon = kept
    return polygon


def exact_differences(coarse: Solution, fine: Solution) -> tuple[float, float]:
    """‖σ − σ'‖_V and ‖u − u'‖ by integrals over the intersections of all cells of two serial meshes."""
    fields = []
    for solution in (coarse, fine):
        mesh, cells = solution.spaces.mesh, np.arange(solution.spaces.domain.cells, dtype=np.int32)
        corners = mesh.geometry.x[mesh.geometry.dofmaps[0]][:, :, :2]
        turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
        corners[turned] = corners[turned][:, ::-1]
        middle = corners.mean(axis=1)
        sigma = solution.sigma.eval(np.pad(middle, ((0, 0), (0, 1))), cells)
        fields.append((corners, middle, sigma, solution.cell_flux.divergence, solution.u.x.array))
    squares = np.zeros(2)
    for corners, middle, sigma, divergence, u in zip(*fields[1], strict=True):
        low, high = corners.min(axis=0), corners.max(axis=0)
        near = ((fields[0][0].min(axis=1) < high) & (fields[0][0].max(axis=1) > low)).all(axis=1)
        for others in zip(*(values[near] for values in fields[0]), strict=True):
            common = clipped(list(corners), others[0])
            for i in range(1, len(common) - 1):
                part = np.array([common[0], common[i], common[i + 1]])
                area = float(np.linalg.det(part[1:] - part[0])) / 2
                ends = (part + np.roll(part, 1, axis=0)) / 2  # exact in degree 2
                off = sigma + divergence / 2 * (ends - middle) - others[2] - others[3] / 2 * (ends - others[1])
                squares += area * ((off**2).sum() / 3 + (divergence - others[3]) ** 2), area * (u - others[4]) ** 2
    sigma_V, u_Q = np.sqrt(squares).tolist()
    return sigma_V, u_Q


def test_meshes_that_do_not_match():
    """Norms of differences are those of integrals over the intersections of cells."""
    for name, h in (("example3", (1 / 3, 1 / 7)),):
        coarse, fine = (solve_case(load_case(name).with_values({"solve.h": each}), MPI.COMM_SELF) for each in h)
        norms = compare(coarse, fine).norms
        assert isinstance(norms, Differences)
        assert (norms.sigma_V, norms.u_Q) == pytest.approx(exact_differences(coarse, fine), rel=5e-3)


def test_what_is_read_off_is_compared():
    """Probes, sections and inflows of both under one name, and how far apart the phreatic lines are."""
    case = load_case(Path(__file__).parents[1] / "capability_cases" / "read_off.toml")
    one, other = (solve_case(case.with_values({"solve.h": h})) for h in (0.4, 0.2))
    found = compare(one, other)
    for name, at in (("wells 1 u", 0), ("wells 2 u", 1)):
        assert found.read_off[name] == pytest.approx(
            [solution.probe([[0.5, 0.5], [0.37, 0.91]])["u"][at] for solution in (one, other)], abs=1e-14
        )
    assert found.read_off["inflow left"] == pytest.approx([each.flux_through("left") for each in (one, other)])
    assert not {"wells 1 x", "across measure"} & found.read_off.keys()
    assert {"across flux", "wells 1 pressure"} <= found.read_off.keys()
    assert 0 < found.phreatic < 0.2
    assert compare(one, one).phreatic == 0
