"""Pictures of beds: how far the springs are pressed, and in time how they settle."""

from signorini_fenicsx.pictures.evolution import draw_over_time
from signorini_fenicsx.pictures.panels import Panel, Pictures, Where

PRESSED = Panel("p", Where.GAMMA, "pressed", curves={"p": ("$p$", {"color": "C0"})})


def _files(scene):
    return {"bed": (scene.caption, [Panel(scene.u, Where.MAP, "$u$"), PRESSED])}


def _in_time(folder, scene, steps):
    draw_over_time(folder / "settling.png", scene, steps, [PRESSED])


PICTURES = Pictures(_files, in_time=_in_time)
