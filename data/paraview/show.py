"""Show this run in ParaView: u or the deformed body, the flux or the stress, the contact, the phreatic line.

Without a window: pvbatch --force-offscreen-rendering show.py PICTURE.png
In a window: paraview --script=show.py, started in this folder. It reads the XDMF files here.
"""

import sys
from pathlib import Path

from paraview import simple

NAMES = {}
"""What the numbers of states, parts and regions are called, by file and field."""
RED, BLUE = (214, 39, 40), (90, 180, 230)
OF_NAME = {"contact": RED, "zero_trace": RED, "stick": RED, "open": BLUE, "no_flux": BLUE, "free": BLUE}
OTHERS = ((230, 159, 0), (0, 158, 115), (204, 121, 167), (0, 114, 178), (240, 228, 66), (127, 127, 127))
"""Colours of states by their names, and those of others in turn."""
FOLDER = Path(globals().get("__file__") or "show.py").resolve().parent  # the window of ParaView 5.11 tells no file
DEFORMED, HEIGHT, ARROW = 0.1, 0.4, 0.06
"""The largest displacement, difference of heights and arrow in the picture, as shares of the size of the body."""


def opened(name):
    """A file of this folder."""
    source = simple.OpenDataFile(str(FOLDER / f"{name}.xdmf"))
    simple.RenameSource(name, source)
    source.UpdatePipeline(max(source.TimestepValues, default=0.0))
    return source


def warped(source, factor):
    """A source with its points moved by the vector u."""
    moved = simple.WarpByVector(Input=source)
    moved.Vectors = ["POINTS", "u"]
    moved.ScaleFactor = factor
    return moved


def risen(source, values, size):
    """A source in the plane as a surface of height u above it."""
    surface = simple.WarpByScalar(Input=source)
    surface.Scalars = ["POINTS", "u"]
    surface.ScaleFactor = HEIGHT * size / max(values[1] - values[0], 1e-300)
    above = simple.Transform(Input=surface)
    above.Transform.Translate = [0, 0, HEIGHT * size - surface.ScaleFactor * values[0]]
    return above


def with_bar(shown, view, name, place):
    """Show what the colours of a field mean."""
    shown.SetScalarBarVisibility(view, True)
    bar = simple.GetScalarBar(simple.GetColorTransferFunction(name), view)
    bar.TitleFontSize, bar.LabelFontSize, bar.WindowLocation = 12, 12, place


def coloured_by_name(shown, view, association, name, called):
    """Colour by the number of a state, and write what the numbers are called."""
    simple.ColorBy(shown, (association, name))
    colours = simple.GetColorTransferFunction(name)
    colours.InterpretValuesAsCategories = 1
    colours.Annotations = [text for number, word in enumerate(called) for text in (str(number), word)]
    chosen = [OF_NAME.get(word, OTHERS[k % len(OTHERS)]) for k, word in enumerate(called)]
    colours.IndexedColors = [part / 255 for colour in chosen for part in colour]
    with_bar(shown, view, name, "Upper Right Corner")


def arrows(source, view, size):
    """The flux at the centres of some cells."""
    centres = simple.CellCenters(Input=source)
    centres.VertexCells = 1
    glyphs = simple.Glyph(Input=centres, GlyphType="Arrow")
    glyphs.OrientationArray = ["POINTS", "sigma"]
    glyphs.ScaleArray = ["POINTS", "sigma_norm"]
    glyphs.ScaleFactor = ARROW * size / max(source.CellData["sigma_norm"].GetRange()[1], 1e-300)
    glyphs.GlyphMode = "Uniform Spatial Distribution (Bounds Based)"
    glyphs.MaximumNumberOfSamplePoints = 1000
    shown = simple.Show(glyphs, view)
    shown.ColorArrayName = ["POINTS", ""]
    shown.AmbientColor = shown.DiffuseColor = [0.2, 0.2, 0.2]


def show():
    """Build the pipeline in the active view."""
    if not (FOLDER / "solution.xdmf").exists():
        raise FileNotFoundError(f"{FOLDER} has no solution.xdmf; start ParaView in the folder of show.py")
    simple.LoadPalette("WhiteBackground")
    view = simple.GetActiveViewOrCreate("RenderView")
    body = opened("solution")
    simple.GetAnimationScene().UpdateAnimationUsingDataTimeSteps()
    simple.GetAnimationScene().GoToLast()
    bounds = body.GetDataInformation().GetBounds()
    size = max(bounds[k + 1] - bounds[k] for k in (0, 2, 4))
    flat, u = bounds[5] == bounds[4], body.PointData["u"]
    is_moved = u.GetNumberOfComponents() > 1
    factor, surface = DEFORMED * size / max(u.GetRange(-1)[1], 1e-300), body
    if is_moved:
        surface = warped(body, factor)
    elif flat:
        surface = risen(body, u.GetRange(), size)
    shown = simple.Show(surface, view)
    association, name = ("CELLS", "von_mises") if is_moved else ("POINTS", "u")
    simple.ColorBy(shown, (association, name))
    with_bar(shown, view, name, "Lower Right Corner")
    if not is_moved:
        shown.Opacity = 1.0 if flat else 0.3
        arrows(body, view, size)
    for name in set(NAMES) - {"solution", "boundary"}:
        gamma, state = opened(name), list(NAMES[name])[-1]
        at_points = state in list(gamma.PointData.keys())
        contact = simple.Show(warped(gamma, factor) if is_moved else gamma, view)
        contact.LineWidth = 6
        coloured_by_name(contact, view, "POINTS" if at_points else "CELLS", state, NAMES[name][state])
    if (FOLDER / "phreatic.xdmf").exists():
        line = simple.Show(opened("phreatic"), view)
        line.LineWidth, line.Opacity = 4, 1.0 if flat else 0.5
        line.AmbientColor = line.DiffuseColor = [0.0, 0.0, 0.0]
    if flat and not is_moved:
        view.CameraPosition = [bounds[0] - size, bounds[2] - 1.5 * size, 1.5 * size]
        view.CameraFocalPoint = [(bounds[0] + bounds[1]) / 2, (bounds[2] + bounds[3]) / 2, 0]
        view.CameraViewUp = [0, 0, 1]
    elif not flat:
        view.CameraPosition = [bounds[0] - 2 * size, bounds[2] - 3 * size, bounds[5] + size]
        view.CameraFocalPoint = [sum(bounds[:2]) / 2, sum(bounds[2:4]) / 2, sum(bounds[4:]) / 2]
        view.CameraViewUp = [0, 0, 1]
    simple.ResetCamera(view)
    simple.Render(view)


show()
if sys.argv[1:] and sys.argv[-1].endswith(".png"):
    simple.SaveScreenshot(sys.argv[-1], ImageResolution=[1400, 1000])
