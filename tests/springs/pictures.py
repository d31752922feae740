"""Pictures of beds: how far the springs are pressed, and in time how they settle."""

from signorini_fenicsx.output.pictures.scene import Pictures
from signorini_fenicsx.output.pictures.sheet import Sheet


def _line(title, x, y):
    sheet = Sheet([3.0], [2.0], title=title)
    sheet.panel(0, 0).plot(x, y)
    return sheet


def _overview(scene):
    return _line(scene.caption, range(len(scene.fields.u)), sorted(scene.fields.u))


def _draw_steps(folder, scene, tables, times, rows):
    _line(scene.title, times, [table.p.max() for table in tables]).save(folder / "settling.png")


PICTURES = Pictures(
    lambda solution, fields, certificate: f"{solution.name}: {fields.count}",
    lambda folder, scene: _overview(scene).save(folder / "bed.png"),
    _overview,
    _draw_steps,
)
