"""The tables and figures of the slides from the command line, on coarse meshes."""

import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
import reproduce
from commands import read_rows
from figures import DRAWN, Kept, draw_solution
from matplotlib.figure import Figure


def test_reproduce_and_draw_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Items that share runs; then a picture again, without new runs."""
    names = ["table1", "figure2", "figure3"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(reproduce, "QUICK_LEVELS", [1, 2])
    monkeypatch.setattr(reproduce, "QUICK_REFERENCE", 3)
    monkeypatch.setattr(sys, "argv", ["reproduce.py", "--quick", *names])
    drawn: list[Figure] = []

    def draw(runs: Sequence[Kept]) -> Figure:
        drawn.append(draw_solution(runs))
        return drawn[-1]

    monkeypatch.setitem(DRAWN, "solution", draw)
    assert reproduce.main() == 0
    assert all(axes.get_ylabel() for axes in drawn[0].axes)  # of the colour bar too
    folder = tmp_path / "results" / "reproduction-quick"
    assert len(list((folder / "runs").iterdir())) == 2  # figures 2 and 3 are of one run
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert "reproduce.py --quick figure2" in page
    for name in names[1:]:
        assert f'<img src="{name}.png"' in page
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert (folder / f"{name}.png").stat().st_size > 10_000
    rows = read_rows(folder / "table1.csv")
    assert [row["h"] for row in rows] == ["2^-1", "2^-2"]
    names_of_columns = (folder / "table1.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert len(set(names_of_columns)) == len(names_of_columns) == 9
    assert "<td>1.65</td>" in page  # the slides' error beside ours
    (folder / "figure3.png").unlink()
    monkeypatch.setattr(sys, "argv", ["reproduce.py", "--quick", "figure3"])
    assert reproduce.main() == 0
    assert (folder / "figure3.png").exists()
    assert "1 runs were finished before" in capsys.readouterr().out
    assert (folder / "index.html").read_text(encoding="utf-8") == page  # with the table


def test_unknown_items_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["reproduce.py", "figure23"])
    with pytest.raises(SystemExit, match="2"):
        reproduce.main()
    assert "invalid choice: 'figure23'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
