"""The reference atlas and the answers to questions: their commands and pages, known values, coarse runs."""

import json
import re
import shlex
from functools import partial
from pathlib import Path
from typing import Any

import pages
import pytest
import typer
from commands import signorini
from pages import line, read_atlas

from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cli.app import app
from signorini_fenicsx.cli.options import overrides

DOCS = Path(__file__).parents[2] / "docs"
ROWS = read_atlas()
KNOWN = {("crack", "moment"): -1.3903602848384253, ("sphere", "volume"): 3.714324731707287}
"""Of exact solutions, by quadrature."""


def options_of(command: str) -> dict[str, Any]:
    """What a command line of `signorini` is given."""
    _, name, *arguments = shlex.split(command)
    return typer.main.get_command(app).commands[name].make_context(name, arguments).params


@pytest.mark.parametrize("row", ROWS, ids=[f"{row['problem']}, {row['quantity']}" for row in ROWS])
def test_each_row_is_what_its_command_asks_for(row: dict[str, str]):
    """Its case has the quantity, its interval is as short as wanted, and the page shows both."""
    given = options_of(row["command"])
    case = load_case(given["case"]).with_values(overrides(given["settings"]))
    assert given["quantity"] == row["quantity"]
    assert row["quantity"] in [each.name for each in case.quantity]
    length = float(row["upper"]) - float(row["lower"])
    assert 0 < length < 1.03 * float(given["width"])
    page = (DOCS / "measured" / "atlas.md").read_text(encoding="utf-8")
    assert line(row) in page
    assert f"uv run {row['command']}\n" in page
    known = KNOWN.get((row["problem"], row["quantity"]))
    assert known is None or float(row["lower"]) <= known <= float(row["upper"])


def test_a_row_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A row of the atlas on a coarse mesh: its interval contains the recorded one's middle."""
    (row,) = [row for row in ROWS if row["quantity"] == "to the stream"]
    monkeypatch.setattr(pages, "signorini", partial(signorini, tmp_path))
    again = pages.rerun(row, "--h", "4", "--width", "0.2")
    assert again["guaranteed"] == row["guaranteed"] == "yes"
    assert float(again["lower"]) < (float(row["lower"]) + float(row["upper"])) / 2 < float(again["upper"])
    assert int(again["unknowns"]) < int(row["unknowns"])


SOLVED = [
    pytest.param("muskat", "0.6", marks=pytest.mark.slow),
    ("hillslope", "2"),
    ("membrane_steady", "1/4"),
    pytest.param("plate_tresca", "0.02", marks=pytest.mark.slow),
    ("bar", "1"),
]


@pytest.mark.parametrize(("name", "h"), SOLVED)
def test_cases_on_coarse_meshes(name: str, h: str, tmp_path: Path):
    """Each new case has its quantities, and the page's intervals are not beside them."""
    assert signorini(tmp_path, "solve", name, "--h", h, "--output", "out", "--quiet").returncode == 0
    found = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))["quantities"]
    page = (DOCS / "guide" / "questions.md").read_text(encoding="utf-8")
    for each in [quantity.name for quantity in load_case(name).quantity]:
        interval = found[each]
        assert interval["guaranteed"], interval["reason"]
        told = [row for row in ROWS if row["quantity"] == each and f" {name} " in row["command"]]
        ends = [(float(row["lower"]), float(row["upper"])) for row in told]
        shown = re.findall(rf"\| {re.escape(each)}\b[^|\n]*\| \[([-\d.]+), ([-\d.]+)\]", page)
        ends += [(float(lower), float(upper)) for lower, upper in shown]
        assert all(interval["lower"] <= upper and lower <= interval["upper"] for lower, upper in ends)
