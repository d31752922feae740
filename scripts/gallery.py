"""Draws the pictures of docs/gallery.md: u of each shipped case on a coarse mesh, in small files.

Usage: python scripts/gallery.py [CASE …]
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from mpi4py import MPI
from PIL import Image

from signorini_fenicsx.base.shipped import case_names
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.elastic_case import ElasticCase
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.cli.evolving import solve_in_time
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.output.writing import write_solution

GALLERY = Path(__file__).parents[1] / "docs" / "static" / "gallery"
CELLS_ACROSS = {2: 64, 3: 16}
"""The diameter of a shape divided by h."""
WIDTH = 900


def draw(name: str) -> None:
    """Solve one case and keep the picture of u, of an elastic one that of the body, in time that of contact."""
    case = load_case(name)
    if case.geometry.shape is not None:
        shape = shape_of(case.geometry.shape)
        case = case.with_values({"solve.h": shape.diameter / CELLS_ACROSS[shape.dim]})
    with TemporaryDirectory() as folder:
        found = Path(folder) / ("deformed.png" if isinstance(case, ElasticCase) else "u.png")
        if case.time is not None:
            kept = {"restart": False, "certify_steps": False}
            solve_in_time(case, MPI.COMM_WORLD, Path(folder, "x"), **kept, plot=True, quiet=True, as_json=False)
            found = Path(folder) / "x" / "contact.png"
        else:
            write_solution(solve_case(case), folder, plot=True, fields=False)
        picture = Image.open(found).convert("RGB")
    size = (WIDTH, round(picture.height * WIDTH / picture.width))
    picture = picture.resize(size, Image.Resampling.LANCZOS)
    picture = picture.quantize(256, Image.Quantize.MEDIANCUT)  # maps of u stay smooth
    picture.save(GALLERY / f"{name}.png", optimize=True)


if __name__ == "__main__":
    for each in sys.argv[1:] or case_names():
        draw(each)
