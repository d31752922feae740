"""Files of fields as VTK reads them: exact states, warping, arrows, parts, regions and states of laws, over time."""

import ast
import itertools
from pathlib import Path

import dolfinx.mesh
import numpy as np
import pytest
from elastic import block
from mpi4py import MPI
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkDataObject, vtkUnstructuredGrid
from vtkmodules.vtkFiltersCore import vtkCellCenters, vtkGlyph3D
from vtkmodules.vtkFiltersGeneral import vtkWarpVector
from vtkmodules.vtkFiltersSources import vtkArrowSource
from vtkmodules.vtkIOXdmf2 import vtkXdmfReader

from signorini_fenicsx import Diffusion, Neumann, Signorini, domain_of, solve
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cli.evolving import EvolutionReport, solve_in_time
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.solving.fields import Field

COMM = MPI.COMM_WORLD


def read(
    path: Path, t: float | None = None
) -> tuple[vtkUnstructuredGrid, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The grid of an XDMF file, its values at points, and those of cells."""
    reader = vtkXdmfReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    if t is None:
        reader.Update()
    else:
        reader.UpdateTimeStep(t)
    grid = reader.GetOutputDataObject(0)
    arrays = []
    for data in (grid.GetPointData(), grid.GetCellData()):
        found = (data.GetArray(i) for i in range(data.GetNumberOfArrays()))
        arrays.append({array.GetName(): vtk_to_numpy(array) for array in found})
    return grid, *arrays


def points_of(grid: vtkUnstructuredGrid) -> np.ndarray:
    return vtk_to_numpy(grid.GetPoints().GetData())


def names(folder: Path) -> dict[str, dict[str, list[str]]]:
    """What the script for ParaView calls the numbers of states; it is a program."""
    text = (folder / "show.py").read_text(encoding="utf-8")
    compile(text, "show.py", "exec")
    (line,) = [line for line in text.splitlines() if line.startswith("NAMES = ")]
    return ast.literal_eval(line.removeprefix("NAMES = "))


@pytest.mark.parallel(2)
def test_a_uniform_state_of_a_body(folder: Path):
    """Under a uniform pressure all stresses, the contact and the points of the warped body are exact."""
    solution = block(COMM)
    write_solution(solution, folder)
    if COMM.rank > 0:
        return
    grid, at_points, in_cells = read(folder / "solution.xdmf")
    x = points_of(grid)
    exact = x * [0.03, 0.03, -0.1]
    np.testing.assert_allclose(at_points["u"], exact, atol=1e-7)  # VTK reads points in single precision
    np.testing.assert_allclose(at_points["u_norm"], np.linalg.norm(exact, axis=1), atol=1e-7)
    np.testing.assert_allclose(
        in_cells["sigma"].reshape(-1, 3, 3), [np.diag([0, 0, -0.1])] * len(in_cells["u"]), atol=1e-12
    )
    for name, value in {"von_mises": 0.1, "principal_1": 0, "principal_2": 0, "principal_3": -0.1}.items():
        np.testing.assert_allclose(in_cells[name], value, atol=1e-12)
    warp = vtkWarpVector()
    warp.SetInputData(grid)
    warp.SetInputArrayToProcess(0, 0, 0, vtkDataObject.FIELD_ASSOCIATION_POINTS, "u")
    warp.Update()
    np.testing.assert_allclose(points_of(warp.GetOutput()), x * [1.03, 1.03, 0.9], atol=1e-6)
    gamma, on_gamma, _ = read(folder / "contact.xdmf")
    np.testing.assert_allclose(points_of(gamma)[:, 2], 0)
    np.testing.assert_allclose(on_gamma["u"], points_of(gamma) * [0.03, 0.03, 0], atol=1e-7)
    for name, value in {"pressure": 0.1, "gap": 0, "contact": 1}.items():
        np.testing.assert_allclose(on_gamma[name], value, atol=1e-12)
    assert names(folder)["contact"]["contact"] == ["open", "contact"]


@pytest.mark.parallel(2)
def test_a_constant_flux_with_regions(folder: Path):
    """A potential u = x is a constant per cell with its exact flux; parts and regions are where they are."""
    mesh = dolfinx.mesh.create_unit_square(COMM, 6, 6)
    sides = {"left": (0, 0), "right": (0, 1), "bottom": (1, 0), "top": (1, 1)}
    parts = {name: lambda x, axis=axis, at=at: np.isclose(x[axis], at) for name, (axis, at) in sides.items()}
    regions = {"lower": lambda x: x[1] < 0.5 + 1e-9, "upper": lambda x: x[1] > 0.5 - 1e-9}
    conditions = [Signorini("right", psi="-1", q_S="2"), Neumann(["bottom", "top"])]
    domain = domain_of(mesh, parts, regions)
    solution = solve(domain, Diffusion(f=0, kappa={"lower": 2.0, "upper": 2.0}, conditions=conditions))
    write_solution(solution, folder)
    if COMM.rank > 0:
        return
    grid, at_points, in_cells = read(folder / "solution.xdmf")
    centres = vtkCellCenters()
    centres.SetInputData(grid)
    centres.Update()
    x = points_of(centres.GetOutput())
    np.testing.assert_allclose(in_cells["u"], x[:, 0], atol=1e-6)
    np.testing.assert_allclose(in_cells["sigma"], [[2, 0, 0]] * len(x), atol=1e-12)
    inside = np.abs(points_of(grid)[:, :2] - 0.5).max(axis=1) < 0.45
    np.testing.assert_allclose(at_points["u"][inside], points_of(grid)[inside, 0], atol=1e-6)
    np.testing.assert_array_equal(in_cells["region"], (x[:, 1] > 0.5).astype(float))
    arrow = vtkArrowSource()
    glyphs = vtkGlyph3D()
    glyphs.SetInputConnection(centres.GetOutputPort())
    glyphs.SetSourceConnection(arrow.GetOutputPort())
    glyphs.SetInputArrayToProcess(1, 0, 0, vtkDataObject.FIELD_ASSOCIATION_POINTS, "sigma")
    glyphs.SetVectorModeToUseVector()
    glyphs.SetScaleModeToScaleByVector()
    glyphs.Update()
    drawn = points_of(glyphs.GetOutput())
    assert drawn[:, 0].max() == pytest.approx(x[:, 0].max() + 2, abs=1e-5)  # as long as |σ|
    facets, _, of_facets = read(folder / "boundary.xdmf")
    for number, (axis, at) in enumerate(sides.values()):
        ids = [facets.GetCell(i).GetPointIds() for i in np.flatnonzero(of_facets["part"] == number)]
        on_part = points_of(facets)[[cell.GetId(i) for cell in ids for i in range(2)]]
        assert len(ids) == 6
        np.testing.assert_allclose(on_part[:, axis], at)
    _, _, on_gamma = read(folder / "multiplier.xdmf")
    np.testing.assert_allclose(
        [on_gamma["flux"], on_gamma["p"], on_gamma["part"]], [[2] * 6, [1] * 6, [1] * 6], atol=1e-10
    )
    assert names(folder)["solution"] == {"region": ["lower", "upper"]}
    assert names(folder)["boundary"] == {"part": list(sides)}


def test_all_fields_over_time(folder: Path):
    """Each time has the stress, the contact and the state of friction, and another one than the times before."""
    case = load_case(Path(__file__).parents[1] / "capability_cases" / "pushed.toml").with_values({"time.steps": 3})
    solve_in_time(
        case, COMM, EvolutionReport(quiet=True), folder / "x", None, restart=False, certify_steps=False, plot=False
    )
    pressed = []
    for t in (1 / 3, 2 / 3, 1.0):
        _, at_points, in_cells = read(folder / "x" / "solution.xdmf", t)
        assert {"sigma", "von_mises", "principal_1", "equilibrium"} <= set(in_cells)
        trace = np.einsum("nii->n", in_cells["sigma"].reshape(-1, 3, 3))
        np.testing.assert_allclose(sum(in_cells[f"principal_{k}"] for k in (1, 2, 3)), trace, atol=1e-10)
        _, on_gamma, _ = read(folder / "x" / "contact.xdmf", t)
        assert {"pressure", "contact", "friction", "slip"} <= set(on_gamma)
        pressed.append([*on_gamma["shear"], *at_points["u_norm"]])
    assert not any(np.allclose(one, other, equal_nan=True) for one, other in itertools.pairwise(pressed))
    assert names(folder / "x")["contact"]["friction"][:3] == ["slip+", "stick", "slip-"]


def test_what_follows_from_a_field():
    """Shear has the von Mises stress √3 τ and the principal stresses ±τ; means are over all nodes."""
    shear = np.zeros((2, 3, 3, 3, 3))
    shear[..., 0, 1] = shear[..., 1, 0] = np.arange(1.0, 4.0)
    found = {field.name: field.values for field in Field("sigma", shear, order=2).means().with_derived()}
    np.testing.assert_allclose(found["von_mises"], [2 * np.sqrt(3)] * 2)
    np.testing.assert_allclose([found[f"principal_{k}"][0] for k in (1, 2, 3)], [2, 0, -2], atol=1e-12)
