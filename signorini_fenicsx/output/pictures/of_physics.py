"""How the solutions of a physics are drawn."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.output.gather import Fields
from signorini_fenicsx.output.pictures.scene import Scene
from signorini_fenicsx.output.pictures.sheet import Sheet


@dataclass(frozen=True)
class Pictures:
    """How the solutions of a physics are drawn (rank 0).

    Attributes:
        caption: Gives what stands below the title: algorithm, mesh, certified error, in mathematical type.
        draw_files: Draws all files of a scene into a folder.
        overview: Gives the picture that a notebook shows.
        draw_steps: Draws a run in time into a folder, from its scene at the end and from tables, times and rows.
        animated: Whether a run in time has an animation in the plane.
    """

    caption: Callable[[Any, Fields, Certificate | None], str]
    draw_files: Callable[[Path, Scene], None]
    overview: Callable[[Scene], Sheet]
    draw_steps: Callable[..., None]
    animated: bool = False
