"""Pictures of beds: how far the springs are pressed, and in time how they settle."""

import numpy as np

from signorini_fenicsx.discrete.site_table import Surfaces
from signorini_fenicsx.pictures.evolution import draw_over_time
from signorini_fenicsx.pictures.gather import whole_boundary
from signorini_fenicsx.pictures.panels import Drawn, Panel, Pictures, Where

PRESSED = Panel("p", Where.GAMMA, "pressed", curves={"p": ("$p$", {"color": "C0"})})


def _drawn(solution):
    spaces, u, table = solution.spaces, solution.u.x.array, solution.table()
    corners = np.broadcast_to(u[:, None, None], (len(u), spaces.mesh.geometry.dim + 1, 1))
    surface = Surfaces(spaces.part_names, table, table, solution.columns)
    return Drawn({"u": corners}, {}, whole_boundary(spaces), [surface])


def _files(scene):
    return {"bed": (scene.caption, [Panel(scene.fields.at_points["u"][:, 0], Where.MAP, "$u$"), PRESSED])}


def _in_time(folder, scene, steps):
    draw_over_time(folder / "settling.png", scene, steps, [PRESSED])


PICTURES = Pictures(_drawn, _files, in_time=_in_time)
