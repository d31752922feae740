"""A solution for notebooks: a figure, or a table with a figure."""

import base64
import html as text

from signorini_fenicsx.base.text import counted
from signorini_fenicsx.cases.units import TABLES, read_off, units_of
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.pictures.sheet import Sheet
from signorini_fenicsx.solving.solved import Solved, by_name


def figure(solution: Solved, certificate: Certificate | None = None) -> Sheet | None:
    """The overview of a solution (collective; None on all ranks but 0)."""
    from signorini_fenicsx.pictures import drawing  # takes a second to import
    from signorini_fenicsx.pictures.scene import gathered_scene

    scene = gathered_scene(solution, certificate)
    return None if scene is None else drawing.overview(scene)


def html(solution: Solved) -> str | None:
    """A table of the main results and the overview (collective; None on all ranks but 0)."""
    spaces, outcome = solution.spaces, solution.outcome
    facets, measure = solution.contact
    readings = {name: by_name(solution.readings[name]) for name in TABLES if name in solution.readings}
    iterations, picture = counted(len(outcome.history), "iteration"), figure(solution)
    if picture is None:
        return None
    of_run = {
        "algorithm": f"{solution.approach} ({solution.options.algorithm_name})",
        "mesh": f"h = {spaces.domain.h:.4g}, {spaces.Q.dofmap.index_map.size_global} cells",
        "contact": f"{facets} of {spaces.Lambda.dofmap.index_map.size_global} facets, measure {measure:.6g}",
        "converged" if solution.converged else "failed": f"{outcome.reason}, {iterations}",
        "largest KKT residual": f"{max(vars(solution.kkt).values()):.1e}",
    }
    rows = of_run | read_off(readings, units_of(solution))
    cells = "".join(
        f"<tr><th style='text-align:left'>{text.escape(name)}</th>"
        f"<td style='text-align:left'>{text.escape(value)}</td></tr>"
        for name, value in rows.items()
    )
    image = f"<img alt='overview' src='data:image/png;base64,{base64.b64encode(picture._repr_png_()).decode()}'>"
    return f"<table><caption>{text.escape(solution.title or solution.name)}</caption>{cells}</table>{image}"
