"""Draws the pictures of docs/gallery.md: u of each shipped case on a coarse mesh, in small files.

Usage: python scripts/gallery.py [CASE …]

Of some cases there is the whole `overview.png`, too. Without a case it also draws the strip of the README, and the end
of an adaptive run with fluxes of order two. It prints the number of facets in contact, of elastic bodies that of
vertices of facets.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mpi4py import MPI
from PIL import Image

from signorini_fenicsx.base.shipped import case_names
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import adapt_case, solve_case
from signorini_fenicsx.certificate.adaptive import FIRST_MESH
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.cli.evolving import EvolutionReport, solve_in_time
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.pictures import style

GALLERY = Path(__file__).parents[1] / "docs" / "static" / "gallery"
CELLS_ACROSS = {2: 64, 3: 16}
"""The diameter of a shape divided by h."""
WIDTH, HIGHEST, SHARE = 900, 1400, 0.6
"""Pixels, and the share of those drawn that wide pictures have."""
FIRST = ("water", "deformed", "flow", "u")
"""Which picture is kept: the first one that there is."""
AS_SHIPPED = {"vauclin": "phreatic"}
"""Which picture is kept of cases that are drawn on their own mesh, as they are compared with measurements."""
WITH_OVERVIEW = ("example2", "dam", "electropainting", "two_obstacles")
STRIP = {
    "example2": (0.0715, 0.09, 0.4145, 0.8415),
    "dam": (0.105, 0.05, 0.87, 0.262),
    "hertz": (0.165, 0.175, 0.81, 0.855),
    "ball": (0.062, 0.135, 0.395, 0.842),
}
"""Pictures of the strip, and which part of each, inside its axes: left, upper, right and lower edge."""
STRIP_HEIGHT, GAP = 260, 20


def draw(name: str) -> None:
    """Solve one case and keep the picture of u, of an elastic one that of the body, in time over it if it can be."""
    case = load_case(name)
    if case.geometry.shape is not None and name not in AS_SHIPPED:
        shape = shape_of(case.geometry.shape)
        if shape.dim == 2 or not case.is_vector:  # a vector in space takes too long
            case = case.with_values({"solve.h": shape.diameter / CELLS_ACROSS[shape.dim]})
    with TemporaryDirectory() as folder:
        if case.time is not None:
            kept = {"restart": False, "certify_steps": False}
            solve_in_time(case, MPI.COMM_WORLD, EvolutionReport(quiet=True), Path(folder, "x"), **kept, plot=True)
            kinds = [AS_SHIPPED[name]] if name in AS_SHIPPED else ["contact", "steps"]
            over_time = [Path(folder) / "x" / f"{kind}.png" for kind in kinds]
            at_end = name not in AS_SHIPPED and getattr(case, "soil", None)
            if at_end or not any(each.exists() for each in over_time):  # or in space
                write_solution(load_solution(Path(folder) / "x"), Path(folder) / "end", plot=True, fields=False)
                over_time = []
        else:
            over_time, solution = [], solve_case(case)
            sys.stdout.write(f"{name}: {solution.contact.facets} in contact\n")
            certificate = certify(solution) if name in WITH_OVERVIEW else None
            write_solution(solution, Path(folder) / "end", certificate=certificate, plot=True, fields=False)
        pictures = [*over_time, *(Path(folder) / "end" / f"{name}.png" for name in FIRST)]
        drawn = Image.open(next(each for each in pictures if each.exists()))
        width = max(WIDTH, round(SHARE * drawn.width))
        save(drawn, GALLERY / f"{name}.png", min(width, round(HIGHEST * drawn.width / drawn.height)))
        if name in WITH_OVERVIEW:
            save(Image.open(Path(folder) / "end" / "overview.png"), GALLERY / f"{name}_overview.png", 2 * WIDTH)


def save(picture: Image.Image, path: Path, width: int) -> None:
    """Write a picture with this width in few colours, among them those of sets: maps of u stay smooth."""
    size = (width, round(picture.height * width / picture.width))
    small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    sets = "".join(colour[1:] for colour in (style.CONTACT, style.FREE, *style.SEGMENTS, "#ffffff"))
    most = 256 - len(sets) // 6
    palette = small.quantize(most, Image.Quantize.MEDIANCUT, kmeans=2).getpalette() or []
    of_sets = Image.new("P", (1, 1))
    of_sets.putpalette([*palette[: 3 * most], *bytes.fromhex(sets)])
    few = small.quantize(palette=of_sets, dither=Image.Dither.NONE)
    few.paste(255, mask=Image.fromarray(np.all(np.asarray(small) == 255, axis=2)))  # which Pillow may have tinted
    few.save(path, optimize=True)


def draw_adapted() -> None:
    """Refine example5 as `signorini adapt` until one per cent is certified, and keep the whole picture at the end."""
    case = load_case("example5")
    assert case.geometry.shape is not None
    first = case.with_values({"solve.h": shape_of(case.geometry.shape).diameter / FIRST_MESH})
    solution, certificate = adapt_case(first, target=0.01)
    with TemporaryDirectory() as folder:
        write_solution(solution, folder, certificate=certificate, plot=True, fields=False)
        save(Image.open(Path(folder) / "overview.png"), GALLERY / "order_two_overview.png", 2 * WIDTH)


def draw_strip() -> None:
    """Put the main panels of four pictures of the gallery side by side."""
    panels = []
    for name, (left, upper, right, lower) in STRIP.items():
        picture = Image.open(GALLERY / f"{name}.png").convert("RGB")
        width, height = picture.size
        panel = picture.crop((round(left * width), round(upper * height), round(right * width), round(lower * height)))
        panels.append(panel.resize((round(panel.width * STRIP_HEIGHT / panel.height), STRIP_HEIGHT)))
    strip = Image.new("RGB", (sum(panel.width + GAP for panel in panels), STRIP_HEIGHT), "white")
    across = 0
    for panel in panels:
        strip.paste(panel, (across, 0))
        across += panel.width + GAP
    strip.save(GALLERY.parent / "strip.png", optimize=True)


if __name__ == "__main__":
    for each in sys.argv[1:] or case_names():
        draw(each)
    if not sys.argv[1:]:
        draw_strip()
        draw_adapted()
