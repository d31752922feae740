"""Show a results folder in ParaView: u_h as a surface coloured by its value, σ_h as arrows, Γ_S by its condition.

Usage: pvbatch --force-offscreen-rendering scripts/paraview_view.py FOLDER PICTURE.png; or, in ParaView's Python shell,
    exec(open("scripts/paraview_view.py").read()); show("FOLDER")

It reads `solution.bp` and `multiplier.bp`, for which ParaView must have been built with ADIOS2.
"""

import sys
from pathlib import Path

from paraview import simple

CONTACT = {"0": "sigma.n = 0", "1": "p = 0", "2": "penalty"}
"""Values of `condition`: in contact are p = 0 (Algorithms 1, 2, 4) and penalty (Algorithm 3)."""


def show(folder: str | Path) -> None:
    """Build the pipeline in the active view."""
    folder = Path(folder)
    view = simple.GetActiveViewOrCreate("RenderView")
    solution = simple.ADIOS2VTXReader(registrationName="solution", FileName=str(folder / "solution.bp"))
    multiplier = simple.ADIOS2VTXReader(registrationName="multiplier", FileName=str(folder / "multiplier.bp"))
    for source in (solution, multiplier):
        source.UpdatePipeline()
    bounds = solution.GetDataInformation().GetBounds()
    extent = max(bounds[1] - bounds[0], bounds[3] - bounds[2])
    flat = bounds[5] == bounds[4]

    low, high = solution.PointData["u"].GetRange()
    surface = solution
    if flat:
        joined = simple.CleantoGrid(registrationName="joined", Input=solution)  # u_h is constant on each cell
        joined.PointDataWeightingStrategy = "Average by Number"
        joined.ToleranceIsAbsolute, joined.AbsoluteTolerance = 1, 1e-9 * extent
        surface = simple.WarpByScalar(registrationName="u as height", Input=joined)
        surface.Scalars = ["POINTS", "u"]
        surface.ScaleFactor = 0.4 * extent / max(high - low, 1e-300)
    shown = simple.Show(surface, view)
    simple.ColorBy(shown, ("POINTS", "u"))
    shown.SetScalarBarVisibility(view, True)
    shown.Opacity = 1.0 if flat else 0.3

    arrows = simple.Glyph(registrationName="sigma", Input=solution, GlyphType="Arrow")
    arrows.OrientationArray = ["POINTS", "sigma"]
    arrows.ScaleArray = ["POINTS", "sigma_norm"]
    arrows.ScaleFactor = 0.08 * extent / max(solution.PointData["sigma_norm"].GetRange()[1], 1e-300)
    arrows.GlyphMode = "Uniform Spatial Distribution (Bounds Based)"
    arrows.MaximumNumberOfSamplePoints = 1000
    shown = simple.Show(arrows, view)
    shown.ColorArrayName = ["POINTS", ""]
    shown.AmbientColor = shown.DiffuseColor = [0.2, 0.2, 0.2]

    contact = simple.Show(multiplier, view)
    contact.LineWidth = 6
    simple.ColorBy(contact, ("CELLS" if "condition" in list(multiplier.CellData.keys()) else "POINTS", "condition"))
    colors = simple.GetColorTransferFunction("condition")
    colors.InterpretValuesAsCategories = True
    colors.Annotations = [text for entry in CONTACT.items() for text in entry]
    colors.IndexedColors = [0.2, 0.4, 0.8, 0.9, 0.2, 0.2, 1.0, 0.6, 0.1]
    contact.SetScalarBarVisibility(view, True)
    if flat:
        view.CameraPosition = [bounds[0] - extent, bounds[2] - 1.5 * extent, 1.5 * extent]
        view.CameraFocalPoint = [(bounds[0] + bounds[1]) / 2, (bounds[2] + bounds[3]) / 2, 0]
        view.CameraViewUp = [0, 0, 1]
    view.UseColorPaletteForBackground = 0
    view.Background = [1, 1, 1]
    for name in ("u", "condition"):
        bar = simple.GetScalarBar(simple.GetColorTransferFunction(name), view)
        bar.TitleFontSize = bar.LabelFontSize = 12
        bar.TitleColor = bar.LabelColor = [0, 0, 0]
        bar.WindowLocation = "Lower Right Corner" if name == "u" else "Upper Right Corner"
    simple.ResetCamera(view)
    simple.Render(view)


if __name__ == "__main__" and len(sys.argv) > 1:
    show(sys.argv[1])
    if len(sys.argv) > 2:
        simple.SaveScreenshot(sys.argv[2], ImageResolution=[1400, 1000])
