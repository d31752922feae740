"""Pictures: they are made and not blank; what they import; their geometry."""

import math
import os
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import run, signorini
from dolfinx.mesh import exterior_facet_indices
from matplotlib import rcParams
from matplotlib.figure import Figure
from matplotlib.image import imread
from mpi4py import MPI

from signorini_fenicsx.base.polylines import chains
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import adapt_case, solve_case
from signorini_fenicsx.certificate.adaptive import AdaptRow
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.contact.history import Step
from signorini_fenicsx.discrete.site_table import FacetTable
from signorini_fenicsx.meshes.domain import facet_vertices
from signorini_fenicsx.output.curves import draw_bounds
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.physics.diffusion.show.pictures import SETS
from signorini_fenicsx.physics.diffusion.show.pools import Pools, u_at_points
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.elasticity.show.pictures import _near, foundation_of
from signorini_fenicsx.pictures import sample, space, style, traces
from signorini_fenicsx.pictures.curves import draw_steps, moves
from signorini_fenicsx.pictures.cuts import SLANTED, Cut, outward
from signorini_fenicsx.pictures.drawing import draw_all, overview
from signorini_fenicsx.pictures.evolution import draw_over_time
from signorini_fenicsx.pictures.gather import DrawnBoundary, DrawnFields
from signorini_fenicsx.pictures.geometry import thinned
from signorini_fenicsx.pictures.page import plain
from signorini_fenicsx.pictures.panels import DrawnSteps, Panel
from signorini_fenicsx.pictures.plane import Plane, levels_between, on_levels
from signorini_fenicsx.pictures.scene import Scene, caption, gathered_scene
from signorini_fenicsx.pictures.sheet import Sheet
from signorini_fenicsx.pictures.space import Space
from signorini_fenicsx.pictures.streams import of_means, on_grid
from signorini_fenicsx.pictures.traces import without_rounding

COMM = MPI.COMM_WORLD
PICTURES = ("overview", "u", "sigma", "signorini", "iterations", "certificate")
PROGRAM = """
import os, sys
from signorini_fenicsx.cli import start as cli
before = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
try:
    cli.main()
except SystemExit as end:
    import matplotlib
    print(end.code, "pyvista" in sys.modules or "vtkmodules" in sys.modules, dict(os.environ) == before,
          matplotlib.rcParams["font.size"] == matplotlib.rcParamsDefault["font.size"])
"""


def scene(name: str, *, certified: bool = False, **values: object) -> Scene:
    """The scene of a solved case on one rank."""
    solution = solve_case(load_case(name).with_values({f"solve.{key}": value for key, value in values.items()}))
    found = gathered_scene(solution, certify(solution) if certified else None)
    assert found is not None
    return found


def panels(scene: Scene, name: str) -> list[Panel]:
    """The panels of a file."""
    return list(scene.pictures.files(scene)[name][1])


def draw(folder: Path, *arguments: str) -> tuple[Path, list[str]]:
    """Solve with pictures in a new process; return its results and its report about itself."""
    options = ("--plot", "--quiet", "--output", "drawn")
    done = run(folder, sys.executable, "-c", PROGRAM, "solve", *arguments, *options, ranks=1)
    assert done.returncode == 0, done.stderr
    return folder / "drawn", done.stdout.splitlines()[0].split()  # PETSc complains of -c after it


def assert_drawn(results: Path):
    for name in PICTURES:
        image = imread(results / f"{name}.png")
        assert min(image.shape[:2]) > 400
        colours = np.round(255 * image[..., :3]).astype(int) @ [1, 256, 65536]
        assert len(np.unique(colours)) > 200, name  # not blank
        assert 0.3 < image[..., :3].mean() < 0.995
        assert all(side[..., :3].min() > 0.99 for side in (image[:4], image[-4:], image[:, :4], image[:, -4:])), name


def test_plane(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """In the plane VTK is not imported; the settings of the process do not change.

    Nor is anything missing without HOME, which ADIOS2 reads, and with any backend of Matplotlib.
    """
    monkeypatch.setenv("XDG_CACHE_HOME", os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache")))
    monkeypatch.delenv("HOME")
    monkeypatch.setenv("MPLBACKEND", "foo")
    results, said = draw(tmp_path, "example1", "--h", "1/4")
    assert said == ["0", "False", "True", "True"]
    assert_drawn(results)
    assert (results / "solution.bp").is_dir()


def test_space(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Of a penalty, whose steps differ; the settings of the process do not change."""
    monkeypatch.setattr(space, "PIXELS", 300)
    before, size = dict(os.environ), rcParams["font.size"]
    options = ("--plot", "--html", "--quiet", "--output", "drawn")
    done = signorini(tmp_path, "solve", "cube", "--h", "0.5", "--algorithm", "alg3", *options)
    assert done.returncode == 0, done.stderr
    assert (dict(os.environ), rcParams["font.size"]) == (before, size)
    assert_drawn(tmp_path / "drawn")
    page = (tmp_path / "drawn" / "solution.html").read_text(encoding="utf-8")
    assert len(page.encode()) < 10_000_000
    assert not re.search(r"<(script|link|img)[^>]*(src|href)=", page)  # nothing from a network
    assert '"type":"mesh3d"' in page
    assert 'name="viewport"' in page  # phones


def assert_apart(sheet: Sheet):
    """Panels and bars with their labels, the title and the legend each have a place of their own, within the figure."""
    sheet.draw_without_rendering()
    legends = [legend.get_window_extent() for legend in sheet.legends]
    title = [] if sheet._suptitle is None else [sheet._suptitle.get_window_extent()]
    everything = [*(axes.get_tightbbox() for axes in sheet.axes), *legends, *title]
    for number, box in enumerate(everything):
        assert box.x0 >= 0
        assert box.y0 >= 0
        assert box.x1 <= sheet.bbox.x1
        assert box.y1 <= sheet.bbox.y1
        assert not [other for other in everything[:number] if box.overlaps(other)]


@pytest.mark.parallel([1])
def test_nothing_overlaps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    drawn = []
    monkeypatch.setattr(Sheet, "save", lambda sheet, path: drawn.append((path.name, sheet)))
    draw_all(tmp_path, scene("dam", certified=True))
    assert {path for path, _ in drawn} == {f"{each}.png" for each in (*PICTURES, "water")}
    for _, sheet in drawn:
        assert_apart(sheet)


@pytest.mark.parallel([1])
def test_sets_in_space_over_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Three views of the sets, each of its own step, over their measures."""
    drawn = []
    monkeypatch.setattr(Sheet, "save", lambda sheet, path: drawn.append(sheet))
    monkeypatch.setattr(space, "PIXELS", 300)
    cube = scene("cube", h=0.5)
    tables = [replace(cube.sites, condition=np.roll(cube.sites.condition, 20 * step)) for step in range(5)]
    draw_over_time(tmp_path / "contact.png", cube, DrawnSteps([1.0, 2.0, 3.0, 4.0, 5.0], tables, [{}], {}), [SETS])
    assert_apart(sheet := drawn[0])
    assert [axes.get_title() for axes in sheet.axes] == [*(f"contact set, $t = {t}$" for t in "135"), "sets"]
    images = [axes.images[0].get_array() for axes in sheet.axes[:3]]
    assert all(np.any(images[0] != other) for other in images[1:] if other.shape == images[0].shape)


@pytest.mark.parallel([1])
def test_segments_keep_their_colours():
    """Also in a step in which others have no facets."""
    whole = scene("friction", h=1 / 4)
    others = whole.surface.segments.index("slip+") != whole.sites.segment
    some = whole.with_surface(table=replace(whole.sites, segment=np.where(others, whole.sites.segment, 1)))
    colours, later = ({group.name: group.colour for group in each.groups} for each in (whole, some))
    assert len(set(colours.values())) == 3
    assert later == {name: colours[name] for name in ("slip-", "stick")}
    two_laws = whole.with_surface(segments=("contact", "open", "lower"))
    assert len({group.colour for group in two_laws.groups}) == 3


def test_dam_has_its_water():
    dam = scene("dam")
    water = Pools.of(dam)
    assert water is not None
    assert [pool[:, 1].max() for pool in water.pools] == pytest.approx([2, 8])
    (borders,) = (each.points for each in dam.over if each.label == "regions")
    assert sum(np.linalg.norm(np.diff(x, axis=0), axis=1).sum() for x in borders) == pytest.approx(2 * np.hypot(1, 10))
    assert Pools.of(scene("example1", h=0.25)) is None


@pytest.mark.parallel([1])
def test_field_of_the_plane():
    """Values on a grid are σ_h; u at the vertices is p_h and u_D on the boundary; closed parts use the arc length."""
    ring = scene("example6", h=0.25)
    x = y = np.linspace(-1.2, 1.2, 25)
    sigma = on_grid(ring.fields, of_means(ring.fields), x, y)
    radius = np.hypot(*np.meshgrid(x, y))
    assert not np.isfinite(sigma[:, (radius < 0.45) | (radius > 1.01)]).any()
    assert np.isfinite(sigma[:, (radius > 0.52) & (radius < 0.95)]).all()
    outer = np.isclose(np.linalg.norm(ring.fields.points, axis=1), 1)
    np.testing.assert_array_equal(u_at_points(ring)[outer], 0)
    (line,), label = traces.pieces(ring, 0)
    assert label == "angle"
    assert line.ends[[0, -1]] == pytest.approx([-np.pi, np.pi], abs=0.2)
    folded = ring.with_surface(facets=_by_x(ring.facets), table=_by_x(ring.sites))
    (line,), label = traces.pieces(folded, 0)
    assert label == "arc length"
    assert line.ends[-1] == pytest.approx(ring.facets.measure.sum())


def _by_x(facets: FacetTable) -> FacetTable:
    """The facets of Γ_S ordered by x, as for a mesh from a file."""
    order = np.argsort(facets.x[:, 0], kind="stable")
    columns = {key: values[order] for key, values in vars(facets).items()}
    return type(facets)(**columns | {"along": columns["x"][:, 0]})


@pytest.mark.parallel(2)
@pytest.mark.parametrize(("name", "h", "most"), [("example2", 0.1, 300), ("cube", 0.25, 800)])
def test_sample_is_the_same_on_all_ranks(name: str, h: float, most: int, monkeypatch: pytest.MonkeyPatch):
    """It covers the domain, has all vertices of the boundary, and the values of the whole mesh in its points."""
    case = load_case(name).with_values({"solve.h": h})
    alone = solve_case(case, MPI.COMM_SELF)
    whole = fields_of(alone)
    assert whole is not None
    assert whole.count == f"{len(whole.cells)} cells"
    monkeypatch.setattr(sample, "MOST_CELLS", {2: most, 3: most})
    together, few = fields_of(solve_case(case, COMM)), fields_of(alone)
    assert (together is None) == (COMM.rank > 0)
    assert few is not None
    if together is None:
        return
    for name, key in (("at_points", "u"), ("in_cells", "sigma")):
        np.testing.assert_allclose(vars(together)[name][key], vars(few)[name][key], atol=1e-9)
    np.testing.assert_allclose(together.points[together.cells], few.points[few.cells], atol=1e-9)
    assert most / 3 < len(few.cells) < 1.5 * most < few.of / 2
    assert few.count == f"{few.of} cells, a sample of {len(few.cells)} drawn"
    rows = np.searchsorted(whole.ids, few.ids)
    np.testing.assert_array_equal(few.points, whole.points[rows])
    np.testing.assert_allclose(few.at_points["u"], whole.at_points["u"][rows], atol=1e-12)
    mesh = alone.spaces.mesh
    assert np.isin(facet_vertices(mesh, exterior_facet_indices(mesh.topology)), few.ids).all()
    assert _volume(few) == pytest.approx(_volume(whole), rel=0.05 if few.points.shape[1] == 2 else 0.25)


def fields_of(solution: Solution) -> DrawnFields | None:
    """Mesh and values on rank 0."""
    found = gathered_scene(solution)
    return None if found is None else found.fields


def _volume(fields: DrawnFields) -> float:
    corners = fields.points[fields.cells]
    return float(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / math.factorial(corners.shape[2]))


@pytest.mark.parallel([2, 3])
def test_boundary_is_the_same_on_all_ranks():
    case = load_case("example2").with_values({"solve.h": 0.5})
    both, one = (gathered_scene(solve_case(case, comm)) for comm in (COMM, MPI.COMM_SELF))
    assert (both is None) == (COMM.rank > 0)
    if both is None or one is None:
        return

    def rows(boundary: DrawnBoundary) -> np.ndarray:
        table = np.column_stack([boundary.vertices, boundary.kind, boundary.known])
        return table[np.lexsort(table[:, 1::-1].T)]

    np.testing.assert_allclose(rows(both.boundary), rows(one.boundary), atol=1e-10)


@pytest.mark.parallel([1])
def test_foundation_of_a_body():
    """It is where the gap says, y = −x²/2 over a body that has moved, and touches it in the contact set."""
    h = 1 / 8
    body = gathered_scene(solve_case(load_case("hertz").with_values({"solve.h": h})))
    assert body is not None
    moved = body.fields.points + body.fields.at_points["u"]
    surface = foundation_of(body, moved, 1.0, 10.0)[:, :2]
    before, after = body.fields.points[body.facets.vertices], moved[body.facets.vertices]
    np.testing.assert_allclose(surface[..., 1], -(before[..., 0] ** 2) / 2, atol=h**2 / 4)
    assert body.touching[0]  # at the plane of symmetry
    np.testing.assert_allclose(surface[0], after[0], atol=1e-12)
    assert len(foundation_of(body, moved, 1.0, 0.1)) < len(surface)


@pytest.mark.parallel([1])
@pytest.mark.filterwarnings("error:Data has no positive values")
def test_without_any_load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """u, σ and the error are 0, and so have no logarithm and no streamlines."""
    monkeypatch.setitem(style.STYLE, "figure.dpi", 30)
    case = load_case("example1").with_values({"problem.f": 0, "solve.h": 0.5})
    rows: list[AdaptRow] = []
    solution, certificate = adapt_case(case, max_cells=200, on_row=rows.append)
    assert certificate.bound == 0
    write_solution(solution, tmp_path, certificate=certificate, plot=True, fields=False)
    draw_bounds(tmp_path / "adapt.png", rows, -0.5, "example1")
    assert {f"{each}.png" for each in {*PICTURES, "adapt"} - {"iterations"}} <= {
        path.name for path in tmp_path.iterdir()
    }
    assert not (tmp_path / "iterations.png").exists()


def test_rounding_is_not_drawn():
    np.testing.assert_array_equal(without_rounding(np.array([0.1, 1e-9, 2e-15, -1e-16])), [0.1, 1e-9, 0.0, 0.0])


def test_rough_steps_are_hollow():
    """Rough steps are points of the curves, with hollow markers; if nothing changed there is nothing to draw."""
    axes, alone = Figure().add_subplot(), Figure().add_subplot()
    steps = [Step(n, 3, 2, 0, 0, 0, 10.0**-n, 0.0, 5, 0.1, rough=n < 3) for n in range(1, 5)]
    draw_steps(axes, steps, "steps")
    sigma, hollow = axes.lines[:2]
    np.testing.assert_array_equal(sigma.get_xdata(), [0, 1, 2, 3])
    np.testing.assert_array_equal(hollow.get_xdata(), [0, 1])
    assert hollow.get_markerfacecolor() == "white"
    assert "rough" in axes.get_xlabel()
    assert moves(steps)
    assert not moves([Step(1, 3, 2, 0, 0, 0, 0.0, 0.0, 5, 0.1)])
    draw_steps(alone, [Step(1, 3, 2, 0, 0, 0, 0.1, 0.2, 5, 0.1)], "one step")
    np.testing.assert_array_equal(alone.get_xticks() % 1, 0)


def test_only_a_guaranteed_bound_is_called_certified():
    """Captions of pictures, those of `solution.html` among them, say "not guaranteed" where the certificate does."""
    solution = solve_case(load_case("example1").with_values({"solve.h": 1 / 4}))
    certificate = certify(solution)
    assert certificate.guaranteed
    assert "certified energy error $" in caption(solution, [], certificate)
    words = caption(solution, [], replace(certificate, proved=False, relative=1.3))
    assert "certified" not in words
    assert words.endswith("not guaranteed")
    assert "%" not in words  # of a norm that is not above the bound
    of_penalty = caption(solution, [], replace(certificate, of="the exact solution of the penalty problem"))
    assert "penalty problem" in of_penalty


@pytest.mark.parametrize(("name", "bounds"), [("fault", False), ("example2", True)])
def test_entries_of_the_legend(name: str, bounds: bool):
    """ψ and q_S are there where the law has them; shades, whose colours the lines of Γ_S have too, on their own."""
    shown = scene(name, **({"h": 0.4} if bounds else {}))
    on_gamma = panels(shown, "signorini")
    found = [str(entry.get_label()) for entry in traces.handles(shown, on_gamma, shades=False)]
    assert any("q_S" in label for label in found) == bounds
    shades = [str(entry.get_label()) for entry in traces.handles(shown, on_gamma)][len(found) :]
    assert sorted(shades) == (["contact"] if bounds else ["slip+", "slip-", "stick"])


def test_no_panel_without_iteration_errors():
    """An overview has one panel less where no step changed the first sets."""
    drawn = scene("example5", h=1 / 4)
    assert moves(drawn.history)
    outcome = replace(drawn.solution.outcome, history=[replace(drawn.history[0], sigma_change=0.0, u_change=0.0)])
    without = replace(drawn, solution=replace(drawn.solution, outcome=outcome))
    assert len(overview(without).axes) == len(overview(drawn).axes) - 1


@pytest.mark.parallel([1])
def test_cuts_show_the_contact_set():
    """The first cut of a ball with f = 5x crosses the contact set and the rest of Γ_S, and both are seen beside it."""
    ball = scene("ball", h=0.5)
    space = Space(ball)
    first, second = space.cuts
    assert np.flatnonzero(first.normal).tolist() == [1]  # contact and gap are left and right of it in a picture
    assert first.normal @ second.normal == 0
    for cut in space.cuts:
        assert cut.view @ cut.normal > SLANTED[0]
        corners = ball.fields.points[ball.facets.vertices]
        normals = outward(ball, ball.facets.vertices)
        np.testing.assert_array_less(0.7, np.sum(normals * corners.mean(axis=1), axis=1))  # away from the middle
        inside = cut.shown_from_inside(corners, normals, space._is_inside)
        seen = inside | (~cut.is_before(corners.mean(axis=1)) & (normals @ cut.view > 0))
        assert ball.facets.measure[seen & ball.touching].sum() > 0.1 * ball.facets.measure[ball.touching].sum()
        assert ball.facets.measure[seen & ~ball.touching].sum() > 0.1 * ball.facets.measure[~ball.touching].sum()
    edges = space.gamma.slice(first.normal, origin=first.origin)
    assert np.ptp(np.asarray(edges.points)[:, 0]) > 1.8  # Γ_S is cut from one end to the other


def test_a_cut_hides_the_shell_before_it():
    """Of two walls before a cut the one that stands before the domain itself is hidden."""
    cut = Cut(np.array([0.0, -1.0, 0.0]), np.zeros(3), np.array([0.6, -0.8, 0.0]))
    wall = np.array([[0.0, -0.1, 0.0], [0.0, -0.2, 1.0], [0.0, -0.2, 0.0]])
    corners = np.stack([wall + np.array([0.5, 0, 0]), wall - np.array([1.0, 0, 0])])
    normals = np.tile([-1.0, 0.0, 0.0], (2, 1))
    shown = cut.shown_from_inside(corners, normals, lambda x: np.abs(x[:, 0]) < 1)
    assert shown.tolist() == [False, True]
    assert not cut.shown_from_inside(corners, -normals, lambda x: np.abs(x[:, 0]) < 1).any()


@pytest.mark.parallel([1])
def test_pressures_are_labelled():
    """The title of a part has its largest pressure; there is a panel for the gap."""
    body = gathered_scene(solve_case(load_case("hertz").with_values({"solve.h": 0.25})))
    assert body is not None
    pressure, gap = Plane(body).sheet(panels(body, "pressure")).axes
    assert pressure.get_title() == f"(a) pressure on bottom, at most {body.sites.pressure.max():.4g}"
    assert gap.get_title() == "(b) gap on bottom"
    assert max(gap.lines[0].get_ydata()) == pytest.approx(body.sites.gap.max())


def test_chains():
    (open_rows, open_vertices), (closed_rows, closed_vertices) = chains(
        np.array([[2, 3], [0, 1], [1, 2], [5, 6], [6, 7], [5, 7]])
    )
    assert open_vertices.tolist() in ([0, 1, 2, 3], [3, 2, 1, 0])
    assert sorted(open_rows.tolist()) == [0, 1, 2]
    assert closed_vertices[0] == closed_vertices[-1]
    assert sorted(closed_rows.tolist()) == [3, 4, 5]


@pytest.mark.parallel([1])
def test_thinned_keeps_the_boundary():
    square = scene("example1", h=1 / 16)
    points = square.fields.points
    triangles, rows = thinned(points, square.fields.cells, 200)
    assert 50 < len(triangles) == len(rows) < 500
    corners = {tuple(corner) for corner in points[np.unique(triangles)].round(9)}
    assert {(0, 0), (0, 1), (1, 0), (1, 1)} <= corners


def test_numbers_in_mathematical_type():
    assert [style.power(value) for value in (2**-5, 1e-8, 0.03, 3e-7, 1.0, 0.0)] == [
        *("2^{-5}", "10^{-8}", "0.03", r"3.00 \times 10^{-7}", "1", "0")
    ]
    assert plain(r"$h = 2^{-5}$, $\|\sigma_h\|$") == "h = 2<sup>−5</sup>, ‖σ<sub>h</sub>‖"
    values = np.array([*np.linspace(0, 1, 1000), 50.0])
    assert style.limits(values, np.ones(1001)) == (0, pytest.approx(0.99, abs=0.01), "max")
    assert style.limits(np.zeros(3), np.ones(3)) == (0, 1, "neither")


def test_a_level_that_is_a_bound_is_drawn_where_contact_ends():
    """On cells in contact u is its bound but for rounding, which a line of this level must not follow."""
    plateau = np.array([-1, 0, 0, 1.0]) + 1e-15 * np.array([1, -1, 1, 0])
    assert on_levels(plateau, [-1.0, 0.0]).tolist() == [-1, 0, 0, 1]
    plane = scene("two_obstacles", h="1/8")
    x = plane.fields.points[:, 0]
    settled = on_levels(u_at_points(plane), [-0.1, 0.1])
    assert (settled[x < 0.2] == -0.1).all()
    assert (settled[x > 0.8] == 0.1).all()
    assert np.allclose(levels_between(-0.1 - 1e-9, 0.1), np.arange(-0.08, 0.09, 0.02))
    assert levels_between(1.0, 1.0) == []


def test_small_parts_inside_have_a_panel():
    """Beside the whole rock there is the crack, moved by u less its mean there; a stack of blocks has no such panel."""
    rock = scene("rock")
    near, cells, factor = _near(rock)
    crack, moved = np.unique(rock.facets.vertices), near.fields.points
    assert np.allclose((moved - rock.fields.points)[crack].mean(axis=0), 0, atol=1e-12)
    assert 0 < len(near.fields.cells) == cells.sum() < len(rock.fields.cells)
    assert np.ptp(near.frame, axis=0) == pytest.approx(1.5 * np.ptp(rock.fields.points[crack], axis=0).max())
    titles = [axes.get_title() for axes in overview(rock).axes if axes.get_title()]
    assert titles == ["(a) von Mises stress", rf"(b) von Mises stress, less the mean displacement, $\times$ {factor:g}"]
    assert _near(scene("stack")) is None
