"""Texts of users in pictures: what Matplotlib cannot read is shown as it is written, and nothing fails."""

import logging
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dolfinx.mesh import CellType, create_rectangle
from matplotlib import rc_context
from mpi4py import MPI

from signorini_fenicsx import Contact, Coulomb, Diffusion, Elasticity, Neumann, Signorini, domain_of, solve
from signorini_fenicsx.pictures.sheet import LINES, Sheet
from signorini_fenicsx.pictures.style import STYLE, readable
from signorini_fenicsx.studies.picture import draw_study

UNREADABLE = (r"$\bm{\sigma}$", "in_$flow_$", "$$", "$x_$ of 接触", "\x1b[31m", "a\ud800b", "$" + 300 * "{" + "$")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (r"$\sigma$ and $x^2$", r"$\sigma$ and $x^2$"),
        (r"$\bm{\sigma}$, $\leq$ 5 %", r"\$\bm{\sigma}\$, $\leq$ 5 %"),
        ("5$ and $m$", r"5$ and $m\$"),
        (r"5\$ per $m$", r"5\$ per $m$"),
        ("$a\n$b$", "\\$a\n$b$"),
        ("a\tb\x00\ud800", r"a\tb\x00\ud800"),
    ],
)
def test_only_mathematics_that_can_be_read(text: str, shown: str):
    assert readable(text) == shown
    assert readable(shown) == shown


def test_any_text_can_be_drawn(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    """In titles, labels, legends and on axes of words, and without warnings of letters that no font has."""
    sheet = Sheet([3], [2], title="\n".join(UNREADABLE) + 200 * " long, title")
    axes = sheet.panel(0, 0)
    for place, text in enumerate(UNREADABLE):
        axes.set(title=text, xlabel=text, ylabel=text)
        axes.plot([0, 1], [0, place], label=text)
    sheet.legend_below(axes.get_legend_handles_labels()[0])
    with warnings.catch_warnings(), caplog.at_level(logging.WARNING):
        warnings.simplefilter("error")
        sheet.save(tmp_path / "a.png")
        assert len(sheet._repr_png_()) > 1000
    assert caplog.records == []
    assert len(sheet._lines) == LINES
    rows = [{"status": "done", "name": text, "iterations": place} for place, text in enumerate(UNREADABLE)]
    assert draw_study(tmp_path / "b.png", rows, ["name"], UNREADABLE[0])


def test_titles_of_many_lines_are_apart_from_panels():
    """Lines with powers are higher than others; the title stays above those of the panels by half a line."""
    with rc_context(STYLE):
        sheet = Sheet([3], [2], title="\n".join([r"at most $1.10\times 10^{-4}$ of $\|\sigma_h\|$"] * 8))
        axes = sheet.panel(0, 0)
        axes.set_title("stress")
        sheet.legend_below([])
        sheet.draw_without_rendering()
        title, below = sheet._suptitle.get_window_extent(), axes.title.get_window_extent()
        assert title.y0 - below.y1 > 0.5 * below.height


def test_names_of_parts_and_titles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """All pictures of both physics, and the page."""
    monkeypatch.setitem(STYLE, "figure.dpi", 30)
    mesh = create_rectangle(MPI.COMM_SELF, [[0, 0], [1, 1]], [2, 2], CellType.triangle)
    down, up = UNREADABLE[1], UNREADABLE[0]
    domain = domain_of(mesh, {down: lambda x: np.isclose(x[1], 0), up: lambda x: np.isclose(x[1], 1)})
    scalar = solve(domain, Diffusion(f="x - 0.5", conditions=[Signorini([down, up])]))
    replace(scalar, title=up + "\ud800").write(tmp_path / "x", certificate=scalar.certify(), plot=True, html=True)
    touching = [Contact(down, friction=Coulomb(0.3)), Neumann(up, (0.1, -1.0))]
    body = solve(domain, Elasticity(young=10.0, poisson=0.3, conditions=touching))
    replace(body, title=up).write(tmp_path / "y", certificate=body.certify(), plot=True)
    assert {path.name for path in tmp_path.glob("*/*.png")} >= {"overview.png", "signorini.png", "pressure.png"}
    assert (tmp_path / "x" / "solution.html").stat().st_size > 1000
