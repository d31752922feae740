"""Domains far from 0, and thin ones: sizes are those of the domain, not of its coordinates."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import dolfinx.mesh
import numpy as np
import pytest
from broken_input import msh_text, square_msh
from commands import signorini
from mpi4py import MPI

from signorini_fenicsx import Domain, InputError, NumericalFailure, adapt, certify, domain_of, load_case, solve_case
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.meshes.meshing import build_domain, expected_size
from signorini_fenicsx.meshes.refinement import refine
from signorini_fenicsx.pictures.drawing import write_page
from signorini_fenicsx.pictures.scene import gathered_scene
from signorini_fenicsx.pictures.space import Space

COMM = MPI.COMM_WORLD
PLACE = (5e7 / 3, 4e8 / 3, 1e8 / 3)
"""So far that floats carry about seven digits of a cell of size 1/8."""


@pytest.mark.parametrize(
    ("shape", "sides", "h"),
    [
        ("[500000, 500100] x [4000000, 4000050]", (100, 50), 20),
        ("[100000, 100001] x [0, 1]", (1, 1), 0.3),
        ("[-4000000, -3999999.5] x [1e6, 1000001]", (0.5, 1), 0.3),
        ("[0, 1] x [0, 1e-8]", (1, 1e-8), 0.3),
        ("[0, 1e-8] x [1, 2]", (1e-8, 1), 0.3),
        ("[1e-9, 3e-9] x [0, 1e-9]", (2e-9, 1e-9), 1e-9),
    ],
)
def test_sides_of_far_and_thin_rectangles(shape: str, sides: tuple[float, float], h: float):
    for mesh in ("unstructured", "structured"):
        domain = build_domain(MPI.COMM_SELF, shape, h, mesh=mesh)
        for name, length in zip(("bottom", "top", "left", "right"), np.repeat(sides, 2), strict=True):
            nodes = dolfinx.mesh.entities_to_geometry(domain.mesh, 1, domain.facets[name])
            ends = domain.mesh.geometry.x[nodes]
            assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum() == pytest.approx(length, rel=1e-8)


@pytest.mark.parametrize("ends", ["1e9, 1000000001", "1e15, 1000000000000001", "1e15, 1000000000000000"])
def test_floats_that_cannot_carry_a_domain(folder: Path, ends: str):
    (folder / "far.toml").write_text(
        f'[geometry]\nshape = "[{ends}] x [0, 1]"\n[boundary]\nsignorini = ["bottom"]\n[problem]\nf = 1\n'
        "[solve]\nh = 0.1",
        encoding="utf-8",
    )
    ended = signorini(folder, "solve", "far.toml")
    assert ended.returncode == 2
    assert "measure coordinates from a point of the domain" in ended.stderr or "must begin with" in ended.stderr
    assert not (folder / "results").exists()


def test_a_geometry_that_gmsh_cannot_mesh(tmp_path: Path):
    path = tmp_path / "far.geo"
    path.write_text(rectangle_geo(1e15, 0.0), encoding="utf-8")
    with pytest.raises(InputError, match="too far from 0"):
        expected_size(str(path), 0.05)


def rectangle_geo(left: float, low: float, size: float = 0.5) -> str:
    """The text of a unit square for Gmsh."""
    corners = [(left, low), (left + 1, low), (left + 1, low + 1), (left, low + 1)]
    points = [f"Point({i}) = {{{x!r}, {y!r}, 0, {size!r}}};" for i, (x, y) in enumerate(corners, 1)]
    lines = [f"Line({i}) = {{{i}, {i % 4 + 1}}};" for i in range(1, 5)]
    surface = ["Curve Loop(1) = {1, 2, 3, 4};", "Plane Surface(1) = {1};", "Physical Surface(1) = {1};"]
    return "\n".join([*points, *lines, *surface])


def shifted(text: object, x0: tuple[float, ...]) -> object:
    """Expressions in coordinates that are measured from another point."""
    if isinstance(text, dict):
        return {key: shifted(value, x0) for key, value in text.items()}
    if isinstance(text, list):
        return [shifted(value, x0) for value in text]
    if isinstance(text, str):
        for name, c in zip("xyz", x0, strict=True):
            text = re.sub(rf"\b{name}\b", f"({name} - {c!r})", text)
    return text


def moved(case: CaseFile, x0: tuple[float, ...]) -> CaseFile:
    """A case whose domain is elsewhere."""
    tree = case.model_dump(exclude_unset=True)
    for section in ("problem", "exact"):
        if section in tree:
            tree[section] = {k: v if k == "plane" else shifted(v, x0) for k, v in tree[section].items()}
    for law in tree.get("law", []):
        law |= {key: shifted(value, x0) for key, value in law.items() if key not in ("parts", "kind")}
    return type(case).model_validate(tree | {"name": case.name})


def moved_domain(domain: Domain, x0: tuple[float, ...]) -> Domain:
    """The domain there; its mesh moves with it."""
    domain.mesh.geometry.x[:] += np.where(np.ptp(domain.box(), axis=0) > 0, x0, 0.0)
    return replace(domain)


NOT_COMPARED = ("timings", "peak_memory", "resultants", "kkt", "coulomb", "title")
CASES = {"crack": 0.3, "fault": None, "sphere": 0.8, "hertz": 0.25, "cube": 0.5}


def numbers(tree: object, name: str = "") -> Iterator[tuple[str, float]]:
    """The numbers of a summary, by their names."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from numbers(value, f"{name}.{key}")
    elif isinstance(tree, int | float):
        yield name, float(tree)


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "sphere")) for name in CASES])
def test_results_do_not_depend_on_the_place(name: str):
    """Domain and data are moved by about 1e8 times their size; residuals stay those of exact arithmetic."""
    case = load_case(name)
    if CASES[name]:
        case = case.with_values({"solve.h": CASES[name], "solve.predict": False})
    found: list[dict[str, float]] = []
    for here, domain in (
        (case, mesh_case(case, COMM)),
        (moved(case, PLACE), moved_domain(mesh_case(case, COMM), PLACE)),
    ):
        solution = solve_case(here, domain=domain)
        assert max(vars(solution.kkt).values()) < 1e-12
        certificate: Any = certify(solution)
        summary = {key: value for key, value in solution.summary().items() if key not in NOT_COMPARED}
        found.append(dict(numbers(summary)) | {"bound": certificate.bound})
    near, far = found
    assert near.keys() == far.keys()
    for key, value in near.items():
        assert far[key] == pytest.approx(value, rel=1e-2 if key == "bound" else 2e-5, abs=1e-9), key


def test_files_of_a_far_mesh(folder: Path):
    """A checkpoint gives back what was written, and two solutions are compared, wherever they are."""
    (nodes, elements), found = square_msh(4), []
    for name, x0 in (("near", 0.0), ("far", 4e7)):
        rows = [(k, float(x) + x0, float(y) + x0) for k, x, y, _ in map(str.split, nodes)]
        text = msh_text([f"{k} {x!r} {y!r} 0" for k, x, y in rows], elements)
        (folder / f"{name}.msh").write_text(text, encoding="utf-8")
        (folder / f"{name}.toml").write_text(
            f'[geometry]\nfile = "{name}.msh"\n[boundary]\nsignorini = ["bottom"]\n'
            f'[problem]\nf = "100*((x - {x0}) - 0.4)"\npsi = "0.1*(y - {x0}) - 0.01"\n',
            encoding="utf-8",
        )
        assert signorini(folder, "solve", f"{name}.toml", "--output", name).returncode == 0
        more = ("--max-cells", "100", "--output", f"{name}-fine")
        assert signorini(folder, "adapt", f"{name}.toml", *more).returncode == 0
        found.append(json.loads(signorini(folder, "compare", name, f"{name}-fine", "--json").stdout))
    for one, other in (("near", "far"), ("near-fine", "far-fine")):
        before, after = (json.loads((folder / each / "summary.json").read_text()) for each in (one, other))
        assert after["certificate"]["bound"] == pytest.approx(before["certificate"]["bound"], rel=1e-5)
        assert max(after["kkt"].values()) < 1e-12
    near, far = found
    assert far["hausdorff"] == pytest.approx(near["hausdorff"], rel=1e-5)
    assert far["norms"] == pytest.approx(near["norms"], rel=1e-5)


def test_refinement_ends_where_floats_do():
    """With the last state and the reason, not with a mesh of cells that rounding has distorted."""
    case = load_case("singular").with_values({"solve.h": 0.5})
    far = 2.0**28

    def solve_on(domain: Domain, start: object) -> Any:
        return solve_case(moved(case, (far, far, 0.0)), domain=domain)

    domain = moved_domain(mesh_case(case, COMM), (far, far, 0.0))
    with pytest.raises(NumericalFailure, match=r"cannot refine further: .* apart") as failure:
        adapt(domain, solve_on, max_cells=10**5)
    assert failure.value.solution.converged


def test_pictures_of_far_domains(tmp_path: Path):
    """VTK's streamlines and the pages for browsers are in single precision."""
    solution = solve_case(load_case("cube").with_values({"solve.h": 0.6}))
    near = gathered_scene(solution)
    assert near is not None
    offset = 2.0 ** np.array([19, 22, 10])
    far = replace(near, fields=replace(near.fields, points=near.fields.points + offset))
    _, (_, streams) = near.files["sigma"]
    (lines, _), (same, _) = Space(near).streamlines(streams), Space(far).streamlines(streams)
    assert length(same) == pytest.approx(length(lines), rel=1e-2)
    write_page(tmp_path / "far.html", far)
    page = (tmp_path / "far.html").read_text(encoding="utf-8")
    assert "x \\u2212 524288" in page
    assert "y \\u2212 4194304" in page


def length(lines: Any) -> float:
    """Length of all streamlines."""
    pieces = np.split(np.asarray(lines.points)[lines.line_connectivity], lines.line_offsets[1:-1])
    return float(sum(np.linalg.norm(np.diff(piece, axis=0), axis=1).sum() for piece in pieces))


def test_a_mesh_is_as_before_after_a_failed_refinement(monkeypatch: pytest.MonkeyPatch):
    domain = build_domain(MPI.COMM_SELF, "square", 0.5, mesh="structured")
    before = domain.mesh.geometry.x.copy()

    def fails(*_: object, **__: object) -> None:
        raise RuntimeError("out of memory")

    monkeypatch.setattr(dolfinx.mesh, "refine", fails)
    with pytest.raises(RuntimeError, match="out of memory"):
        refine(domain, np.array([0], dtype=np.int32))
    np.testing.assert_array_equal(domain.mesh.geometry.x, before)


def test_a_mesh_in_single_precision():
    mesh = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 2, 2, dtype=np.float32)
    with pytest.raises(InputError, match=r"float32; make it with dtype=np\.float64"):
        domain_of(mesh, {"bottom": lambda x: x[1] < 1e-6})


def test_the_size_of_a_file_is_that_of_its_present_text(tmp_path: Path):
    path = tmp_path / "square.geo"
    sizes = []
    for size in (0.5, 0.25):
        path.write_text(rectangle_geo(0.0, 0.0, size), encoding="utf-8")
        sizes.append(expected_size(str(path), None)[1])
    assert sizes[1] > 2 * sizes[0]
