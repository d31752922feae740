"""`[plot]`: names, units, the physical flux, level lines; words of quantities, segments; water; cells on a page."""

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.plot import Plot
from signorini_fenicsx.cases.solving import evolve_case, quantities_of, solve_case
from signorini_fenicsx.cases.units import read_off, summary_of, units_of, with_units
from signorini_fenicsx.cli.solution_report import interval
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.show.pictures import columns_of_cells, segments
from signorini_fenicsx.physics.diffusion.show.pools import WATER_LINES, Pools, water_lines, wet
from signorini_fenicsx.physics.diffusion.show.seepage import seepage
from signorini_fenicsx.pictures.drawing import draw_all, overview
from signorini_fenicsx.pictures.geometry import finer
from signorini_fenicsx.pictures.page import Page
from signorini_fenicsx.pictures.panels import Panel, Where
from signorini_fenicsx.pictures.scene import Scene, gathered_scene
from signorini_fenicsx.pictures.sheet import Sheet
from signorini_fenicsx.pictures.streams import APART, ARROW, SHARES, heads
from signorini_fenicsx.pictures.style import CONTACT, around_0, colours_of, spans_decades
from signorini_fenicsx.studies.study import make_run

CUT = {"name": "cut", "points": [[0.5, -1], [0.5, 2]]}
HEAT = {
    "u": "temperature",
    "unit": "°C",
    "flux": "heat flux $x",
    "flux_unit": "W/m²",
    "sign": -1,
    "levels": [-0.1, 0.1],
}


def scene(case: Case) -> Scene:
    found = gathered_scene(solve_case(case, MPI.COMM_SELF))
    assert found is not None
    return found


def streams(scene: Scene) -> Panel:
    """The only panel of `sigma.png` in the plane."""
    return list(scene.pictures.files(scene)["sigma"][1])[1]


def test_names_and_levels():
    """They are on the maps, a dollar is no mathematics; a flux that is −σ turns the arrows round."""
    case = load_case("example2").with_values({"solve.h": 0.25})
    plain, named = scene(case), scene(case.with_values({f"plot.{key}": value for key, value in HEAT.items()}))
    texts = [axes.get_ylabel() for axes in overview(named).axes]
    assert {"temperature (°C)", r"heat flux \$x (W/m²)"} <= set(texts)
    assert {"$u_h$", r"$|\sigma_h|$"} <= {axes.get_ylabel() for axes in overview(plain).axes}
    there, back = (streams(each).lines[1] for each in (plain, named))
    middle = there.mean(axis=1)
    nearest = np.linalg.norm(back.mean(axis=1)[:, None] - middle, axis=2).argmin(axis=0)
    along = [each[:, 0] - each[:, 1:].mean(axis=1) for each in (there, back[nearest])]
    assert np.mean(np.einsum("ki,ki->k", *along) < 0) > 0.9


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"sign": 2}, "sign"),
        ({"levels": [1, 1]}, "levels: must ascend"),
        ({"u": "a\nb"}, "one line"),
        ({"u": "a" * 31}, "at most 30"),
        ({"name": "u"}, "unknown key"),
        ({"levels": list(range(101))}, "at most 100"),
    ],
)
def test_wrong_names_are_refused(values: dict, message: str):
    with pytest.raises(InputError, match=message):
        load_case("example1").with_values({f"plot.{key}": value for key, value in values.items()})


def test_units_of_bodies_and_flows():
    """Units of lengths, stresses and times are beside all axes, bars and numbers; what is of scalars is refused."""
    case = load_case("bar").with_values({"solve.h": 0.25, "plot.length_unit": "mm", "plot.stress_unit": "MPa"})
    found = gathered_scene(solve_case(case, MPI.COMM_SELF))
    assert found is not None
    texts = {text.get_text() for text in overview(found).findobj(Text)}
    assert {"$x$ (mm)", "von Mises stress (MPa)"} <= texts
    titles = [panel.title for panel in found.files["pressure"][1]]
    assert titles[:2] == ["pressure (MPa)", "gap (mm)"]
    lines = found.solution.lines(found.solution.summary())
    assert re.fullmatch(r"von Mises \S+ MPa at \(.*\) mm, \|u\| \S+ mm at \(.*\) mm", lines["largest"])
    assert lines["forces"].endswith("; in MPa mm")
    assert re.match(r"pressure at most \S+ MPa at \(2, 0.5\) mm, area \S+ mm, width \S+ mm, center", lines["on top"])
    case = load_case("outlet").with_values({"solve.h": 0.5, "plot.unit": "m/s", "plot.length_unit": "m"})
    solution = solve_case(case, MPI.COMM_SELF)
    lines = solution.lines(solution.summary())
    assert re.fullmatch(r"at most \S+ m/s at \(.*\) m", lines["speed"])
    assert lines["flow"].endswith(" m²/s")
    with pytest.raises(InputError, match="sign: elasticity has no such key; it has length_unit, stress_unit"):
        load_case("bar").with_values({"plot.sign": -1})


def test_surfaces_of_contact_are_in_the_legend():
    """Where two bodies may touch there is a line, and the legend says what it is; a body alone has none."""
    for name, surfaces in (("two_cylinders", True), ("bar", False)):
        (legend,) = overview(scene(load_case(name))).legends
        assert ("contact surfaces" in [text.get_text() for text in legend.get_texts()]) == surfaces


def test_a_quantity_has_a_symbol_a_unit_and_a_sign():
    """With a sign −1 it is that of the negative weight; symbol and unit are in words, summary and pictures."""
    outflow = {"name": "outflow", "kind": "flux", "parts": ["left"], "weight": "4*y*(1 - y)"}
    seen = outflow | {"name": "discharge", "symbol": "Q", "unit": "m³/d", "sign": -1}
    case = load_case("example1").with_values({"solve.h": 0.5, "quantity": [outflow, seen]})
    found = quantities_of(solve_case(case, MPI.COMM_SELF))
    plain, signed = found["outflow"], found["discharge"]
    both = [plain.value, plain.lower, plain.upper]
    np.testing.assert_allclose([-signed.value, -signed.upper, -signed.lower], both, rtol=1e-9)
    assert interval(signed).startswith("Q = ")
    assert "] m³/d" in interval(signed)
    assert {"symbol": "Q", "unit": "m³/d"}.items() <= signed.summary().items()
    assert case.quantity[1].label == "Q (m³/d)"
    with pytest.raises(InputError, match="sign: is of integral and flux; a energy has none"):
        case.with_values({"quantity": [{"name": "a", "kind": "energy", "sign": -1}]})


def test_segments_have_names():
    """Those that are given, else by their u; many have as many colours."""
    graph = {"kind": "graph", "parts": ["bottom"], "corners": [[-0.1, 0.3], [-0.1, 0.1], [0.1, 0.1], [0.2, -0.2]]}
    case = load_case("staircase").with_values({"solve.h": 0.5})
    assert "jump at $u = -0.1$" in scene(case).surface.segments
    names = ["freezing", "ice", "mush", "water", "steam"]
    case = case.with_values({"law": [graph | {"beyond": "vertical", "names": names}]})
    found = scene(case)
    assert list(found.surface.segments) == names
    assert [group.name for group in found.groups] == [name for name in names if name in {g.name for g in found.groups}]
    in_cells = found.colours_in_cells(["dry", "ice", "wet"])
    assert in_cells["ice"] == colours_of(names)["ice"]
    assert not {in_cells["dry"], in_cells["wet"]} & set(colours_of(names).values())
    assert len(set(colours_of([f"phase {i}" for i in range(20)] + ["contact", "stick"]).values())) == 22
    assert CONTACT not in colours_of(["lower", "open", "upper"]).values()  # that of the edge of contact in Ω


def test_states_of_cells_are_in_words():
    """The segments of a graph in Ω have their names, or are named by their u, with the region if there are several."""
    case = load_case("melting").with_values({"time.steps": 2, "solve.h": "1/8"})
    unnamed = case.with_values({"time.capacity": {"corners": [[0, 0], [0, 1]], "beyond": 1}})
    by_u = ["up to $u = 0$", "jump at $u = 0$", "from $u = 0$"]
    for each, names in ((case, ["ice", "mush", "water"]), (unnamed, by_u)):
        *_, last = evolve_case(each)
        assert list(columns_of_cells(last.solution).values()) == names


@pytest.mark.parametrize("element", ["RT0", "RT1"])
def test_cells_have_colours_by_segment(element: str):
    """Each law in Ω has a panel with its segments in colours of their own; where there are two laws both have one."""
    case = load_case("two_obstacles").with_values({"solve.h": 0.125, "solve.element": element})
    found = scene(case)
    (panel,) = segments(found)
    middle = found.fields.points[found.fields.cells].mean(axis=1)[:, 0]
    names = ["no law", "lower", "open", "upper"]
    shown = np.array(names)[np.asarray(panel.what)]
    assert set(shown[middle < 0.12]) == {"lower"}
    assert set(shown[middle > 0.88]) == {"upper"}
    assert set(panel.names) == set(names[1:])
    assert len(set(panel.names.values())) == 3
    steep = {"kind": "graph", "region": "all", "corners": [[0, 0], [0.05, 1]], "names": ["none", "some", "most"]}
    first, second = segments(scene(case.with_values({"law": [case.law[0].model_dump(exclude_none=True), steep]})))
    assert {"lower", "open"} <= set(first.names) <= {"lower", "open", "upper"}
    assert {"none", "most"} <= set(second.names) <= {"none", "some", "most"}


def test_arrow_heads_are_apart_and_inside():
    """Of parallel lines that are near each other only some have a head, none has one on the edge of the domain."""
    lines = [
        np.column_stack([np.linspace(0, 4, 50), np.full(50, y)]) for y in (0.0, 0.5, 0.505, 0.51, 0.515, 0.52, 0.525)
    ]
    found = heads(lines, (np.zeros(2), np.array([4.0, 1.0])))
    middle = found.mean(axis=1)
    apart = np.linalg.norm(middle[:, None] - middle, axis=2)[~np.eye(len(middle), dtype=bool)]
    assert len(found) == len(SHARES)
    assert apart.min() > APART * ARROW * 4
    assert middle[:, 1].min() > 0.4


def test_steep_values_are_drawn_on_small_triangles():
    """The smaller ones fill the steep one, and have its linear values."""
    points, values = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]), np.array([0.0, 0.05, 1.0, 0.0])
    flat = np.array([[0, 1, 3]])
    x, triangles, at = finer(points, np.concatenate([flat, [[0, 1, 2]]]), values, 0.1)
    corners = x[triangles[1:]]
    edges = corners[:, 1:] - corners[:, :1]
    assert triangles[:1].tolist() == flat.tolist()
    assert np.abs(np.linalg.det(edges)).sum() == pytest.approx(1.0)
    np.testing.assert_allclose(at[4:], 0.05 * x[4:, 0] + x[4:, 1], atol=1e-15)
    assert np.ptp(at[triangles], axis=1).max() < 0.2


def test_names_are_kept_with_a_solution(tmp_path: Path):
    case = load_case("example1")
    solve_case(case.with_values({"solve.h": 0.5, "plot.u": "head"}), MPI.COMM_SELF).write(tmp_path / "out")
    assert load_solution(tmp_path / "out", MPI.COMM_SELF).source.plot.u == "head"
    assert "plot" not in case.model_dump()
    assert "plot.u" not in make_run(case).parameters


def test_the_water_of_a_dam():
    """Its head is H upstream and h downstream; its lines share the discharge equally, and flow from left to right."""
    solution = solve_case(load_case("dam_baiocchi").with_values({"solve.h": 1.0}), MPI.COMM_SELF)
    found, known = gathered_scene(solution), seepage(solution)
    assert found is not None
    assert known is not None
    fields, sigma = found.fields, found.fields.at_points["sigma"]
    points, below = fields.points, np.unique(fields.cells[wet(fields)])
    head = points[:, 1] - sigma[:, 1]
    left = below[points[below, 0] == 0]
    right = below[(points[below, 0] == 16) & (points[below, 1] < 4)]
    np.testing.assert_allclose(head[left], 24, atol=1.0)
    np.testing.assert_allclose(head[right], 4, atol=1.0)
    stream = sigma[below, 0]
    assert np.ptp(stream) == pytest.approx(known.discharge, rel=0.08)
    lines, heads = water_lines(fields)
    assert len(lines) >= WATER_LINES
    assert all(line[0, 0] < line[-1, 0] for line in lines)
    assert np.all(heads[:, 0, 0] > heads[:, 1:, 0].mean(axis=1))
    panel = streams(found)
    assert "head" in panel.label
    assert len(panel.lines[0]) == len(lines)
    water = Pools.of(found)
    assert water is not None
    assert sorted(pool[:, 1].max() for pool in water.pools) == [4, 24]
    seen = found.pictures.files(found)["water"][1]
    assert [each.title for each in seen] == ["head $H$", "streamlines of the water", "pressure head $H - y$"]
    assert all(each.only is not None for each in seen)
    np.testing.assert_allclose(seen[2].what[left], 24 - points[left, 1], atol=1.0)
    assert Plot().flux_name == r"$\sigma_h$"


def test_scales_have_0_in_their_middle_or_at_an_end():
    found = [around_0(np.array(values)) for values in ([-1.0, 2.0], [-3.0, 1e-9], [0.0, 2.0], [0.0])]
    assert found[:3] == [(-2, 2), (-3, 0), (0, 2)]
    assert found[3][0] < found[3][1]


def test_scales_of_decades():
    """They are for values most of which are small beside the usual largest one."""
    size = np.full(100, 0.01)
    assert spans_decades(np.linspace(0.01, 1, 100) ** 9, size)
    assert not spans_decades(np.linspace(0.01, 1, 100), size)
    assert not spans_decades(np.zeros(100), size)
    assert not spans_decades(np.repeat([1e-9, 1.0], [60, 40]), size)


def test_a_slim_domain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A column has neither surfaces nor streamlines beside other maps, and all of its pictures."""
    drawn = dict[str, int]()
    monkeypatch.setattr(Sheet, "save", lambda sheet, path: drawn.update({path.name: len(sheet.widths)}))
    draw_all(tmp_path, scene(load_case("soil_column").with_values({"solve.h": 0.2})))
    assert drawn["water.png"] == 3
    assert {drawn["sigma.png"], drawn["u.png"]} == {1}


@pytest.mark.parametrize(
    ("case", "plot", "column", "unit", "words"),
    [
        ("example1", {"unit": "°C", "flux_unit": "W/m²", "length_unit": "m"}, "u", "°C", "W/m  measure 1 m"),
        ("bar", {"length_unit": "mm", "stress_unit": "MPa"}, "sigma_xy", "MPa", "MPa mm  measure 0.5 mm"),
        pytest.param(
            *("outlet", {"unit": "m/s", "stress_unit": "Pa", "length_unit": "m"}, "u_x", "m/s", "Pa m  measure 1 m"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_what_is_read_off_has_units(tmp_path: Path, case: str, plot: dict, column: str, unit: str, words: str):
    """Those of `[plot]` are in report, table, summary, page and notebook; tables without them keep their names."""
    values = {"solve.h": 0.5, "probe": [{"name": "P Q", "points": [0.3, 0.4]}], "section": [CUT]} | {
        f"plot.{key}": value for key, value in plot.items()
    }
    solution = solve_case(load_case(case).with_values(values), MPI.COMM_SELF)
    solution.write(tmp_path / "out", html=True)
    assert f",{column} ({unit})," in (tmp_path / "out" / "probes.csv").read_text(encoding="utf-8").splitlines()[0] + ","
    summary = summary_of(solution)
    assert summary["units"][column.partition("_")[0]] == unit
    lines = read_off(summary, units_of(solution))
    assert lines["section cut"].endswith(words)
    assert f" {unit}" in lines["probe P Q"]
    page, table = (tmp_path / "out" / "solution.html").read_text(encoding="utf-8"), solution._repr_html_()
    assert "probe P Q: " in page
    assert table is not None
    assert unit in table
    assert with_units({"u": np.zeros(1)}, {}).keys() == {"u"}


def test_a_panel_of_cells_in_space_is_on_cuts_of_the_page():
    """Each triangle of a cut has the value of its cell."""
    cube = scene(load_case("cube").with_values({"solve.h": 0.6}))
    x = cube.fields.points[cube.fields.cells].mean(axis=1)[:, 0]
    (cut,) = Page(cube, np.zeros(3)).traces(Panel(x, Where.MAP, "x of the centroid", in_cells=True))
    assert cut.intensitymode == "cell"
    assert set(np.asarray(cut.intensity)) <= set(x.astype(np.float32))
    assert len(set(np.asarray(cut.intensity))) > 3
