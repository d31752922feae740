"""Checkpoints that are damaged or hostile: each is refused in one sentence."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies_apart import two
from mpi4py import MPI

from signorini_fenicsx.api import Diffusion, Dirichlet, Neumann, Pair, Wall, solve
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.output.checkpoint_file import FOLDER, TEXT
from signorini_fenicsx.output.writing import write_solution

type Arrays = dict[str, Any]

COMM = MPI.COMM_SELF


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a solution on a structured L-shape."""
    folder = tmp_path_factory.mktemp("good")
    case = load_case("example2").with_values({"solve.h": 0.5, "geometry.mesh": "structured"})
    write_solution(solve_case(case, COMM), folder, fields=False)
    return folder


def arrays_of(folder: Path) -> Arrays:
    """The arrays of a checkpoint, and its texts as `about`."""
    arrays = {path.stem: np.load(path) for path in (folder / FOLDER).glob("*.npy")}
    return arrays | {"about": (folder / FOLDER / TEXT).read_text()}


def put(folder: Path, arrays: Arrays) -> None:
    """Write a checkpoint with other contents."""
    (folder / FOLDER).mkdir(exist_ok=True)
    for name, array in arrays.items():
        if name == "about":
            (folder / FOLDER / TEXT).write_text(array)
        else:
            np.save(folder / FOLDER / f"{name}.npy", array)


def entry(name: str, value: float) -> Callable[[Arrays], Arrays]:
    """Replace the first entry of an array."""

    def change(arrays: Arrays) -> Arrays:
        array = arrays[name].copy()
        array.flat[0] = value
        return {name: array}

    return change


def about(**values: Any) -> Callable[[Arrays], Arrays]:
    """Replace some of the texts."""
    return lambda arrays: {"about": json.dumps(json.loads(arrays["about"]) | values)}


def whole(name: str, change: Callable[[Any], Any]) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {name: change(arrays[name])}


def turned(arrays: Arrays) -> Arrays:
    """Move a point inside the domain through the opposite side of a cell."""
    points = arrays["points"].copy()
    inner = np.flatnonzero(np.all((points > 0.1) & (points < 0.9), axis=1))[0]
    points[inner] += 1.1
    return {"points": points}


def third(arrays: Arrays) -> Arrays:
    """Put the last cell on an edge that two other cells share."""
    cells = arrays["cells"].copy()
    edges = np.sort(np.concatenate([cells[:-1, [0, 1]], cells[:-1, [0, 2]], cells[:-1, [1, 2]]]), axis=1)
    rows, times = np.unique(edges, axis=0, return_counts=True)
    cells[-1, :2] = next(edge for edge in rows[times == 2] if cells[-1, 2] not in edge)
    return {"cells": cells}


DAMAGE = {
    "sigma": (whole("sigma", lambda x: 5 * x), "is damaged: its KKT residual stationarity is .*, and was"),
    "u": (entry("u", np.nan), "is damaged: u is not finite"),
    "p": (whole("facet_p", lambda x: x + 1), "is damaged: its KKT residual"),
    "conditions": (whole("facet_condition", lambda x: 1 - x), "is damaged: its facet conditions"),
    "data": (about(case={"geometry": {"shape": "square"}}), "its case is from another version"),
    "points": (whole("points", lambda x: 2 * x), "is damaged: its KKT residual"),
    "flat": (whole("points", lambda x: x[:, 0]), "points has type float64 and shape"),
    "space": (whole("points", lambda x: np.pad(x, ((0, 0), (0, 1)))), "cells has type int64 and shape"),
    "single": (whole("points", lambda x: x.astype(np.float32)), "points has type float32"),
    "narrow": (whole("cells", lambda x: x[:, :2]), "cells has type int64 and shape"),
    "negative": (entry("cells", -1), "has a point that is not in the file"),
    "huge": (entry("cells", 2**63 - 1), "has a point that is not in the file"),
    "repeated": (whole("cells", lambda x: np.repeat(x[:, :1], 3, axis=1)), "without volume"),
    "short": (whole("u", lambda x: x[:-1]), "u has type float64 and shape"),
    "object": (whole("u", lambda x: x.astype(object)), "does not have the size that it states"),
    "vertices": (entry("facet_vertices", 10**6), "facets with values are not those of Γ_S"),
    "condition": (entry("facet_condition", 256), "has a value that is no condition"),
    "part": (entry("part_2", 10**6), "part 'bottom' has facets that are not on the boundary"),
    "folded": (turned, "neighbouring cells overlap"),
    "third": (third, "more than two cells meet"),
    "alone": (whole("points", lambda x: np.pad(x, ((0, 1), (0, 0)))), "a point has no cell"),
    "deep": (lambda arrays: {"about": '{"a":' * 10**5}, "recursion limit"),
    "words": (lambda arrays: {"about": "3"}, "must be a section"),
    "history": (about(history=[{"x": 1}]), "missing key 'iteration'"),
    "beta": (about(beta=0), "greater than 0"),
    "regions": (about(regions=["a"]), "it holds no inside"),
    "parts": (about(parts={"left": "y"}), "boundary parts are not those of 'lshape'"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damage_is_told(good: Path, tmp_path: Path, kind: str):
    change, message = DAMAGE[kind]
    arrays = arrays_of(good)
    put(tmp_path, arrays | change(arrays))
    with pytest.raises(InputError, match=message) as caught:
        load_solution(tmp_path, COMM)
    assert str(tmp_path) in str(caught.value)


FORGED = [
    (None, "None is no pair of surfaces"),
    ("pair", "is no pair of surfaces"),
    ([{}], "is no pair of surfaces"),
    ([{"slave": ["u10"], "master": ["l11"], "more": 1}], "is no pair of surfaces"),
    ([{"slave": [7], "master": ["l11"]}], "unknown part '7'"),
    ([{"slave": ["u10"], "master": ["l11"], "tied": True}], "'u10' is in a law, too"),
    ([{"slave": ["u10"], "master": ["l11"], "direction": None}], "direction is None"),
]


def test_forged_pairs_are_told(tmp_path: Path):
    sides = Neumann([f"{body}0{end}" for body in "ul" for end in (0, 1)])
    given = [sides, Dirichlet("l10", 0), Dirichlet("u11", 1), Pair("u10", "l11", Wall((), beta=3))]
    solve(two(COMM, (2, 1), (3, 1)), Diffusion(f=0, conditions=given)).write(tmp_path / "out")
    good = arrays_of(tmp_path / "out")
    for pairs, message in FORGED:
        text = json.loads(good["about"])
        put(tmp_path / "out", {"about": json.dumps(text | {"given": text["given"] | {"pairs": pairs}})})
        with pytest.raises(InputError, match=message):
            load_solution(tmp_path / "out", COMM)


@pytest.mark.parametrize("missing", ["u", "cells", "facet_condition", "part_3"])
def test_what_is_missing_is_told(good: Path, tmp_path: Path, missing: str):
    put(tmp_path, {name: array for name, array in arrays_of(good).items() if name != missing})
    with pytest.raises(InputError, match="not a readable solution"):
        load_solution(tmp_path, COMM)


def test_files_of_old_versions_are_named(tmp_path: Path):
    (tmp_path / "checkpoint.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"checkpoint\.npz of version 0\.3 or older, which version 0\.4 reads"):
        load_solution(tmp_path, COMM)


@pytest.mark.parallel(2)
def test_all_ranks_refuse(folder: Path):
    comm = MPI.COMM_WORLD
    write_solution(solve_case(load_case("example1").with_values({"solve.h": 0.25}), comm), folder, fields=False)
    comm.Barrier()
    if comm.rank == 0:
        arrays = arrays_of(folder)
        put(folder, {"sigma": 5 * arrays["sigma"]})
    comm.Barrier()
    with pytest.raises(InputError, match="is damaged: its KKT residual"):
        load_solution(folder, comm)


def test_the_state_of_a_failed_run_is_read(tmp_path: Path):
    case = load_case("example2").with_values({"solve.h": 0.25, "solve.max_iterations": 1})
    with pytest.raises(NumericalFailure) as caught:
        solve_case(case, COMM)
    assert caught.value.solution is not None
    write_solution(caught.value.solution, tmp_path, fields=False)
    read = load_solution(tmp_path, COMM)
    assert not read.converged
    assert read.kkt.violation() is not None
    arrays = arrays_of(tmp_path)
    put(tmp_path, entry("u", np.nan)(arrays))
    with pytest.raises(InputError, match="is damaged: its KKT residual"):
        load_solution(tmp_path, COMM)


def test_a_structured_lshape_keeps_its_facets(good: Path):
    """The grid of the shape has points in the notch, which a file does not contain."""
    read = load_solution(good, COMM)
    assert read.spaces.facet_measure.sum() == pytest.approx(4)


def test_methods_with_residuals_of_their_own(tmp_path: Path):
    """Solutions that violate (9) by their method are not damaged; other changes are damage."""
    case = load_case("example1").with_values({"solve.h": 0.25, "solve.algorithm": "primal-pdas"})
    write_solution(solve_case(case, COMM), tmp_path, fields=False)
    read = load_solution(tmp_path, COMM)
    assert read.outcome.own_residual is not None
    assert read.kkt.violation() is not None
    arrays = arrays_of(tmp_path)
    put(tmp_path, {"sigma": 5 * arrays["sigma"]})
    with pytest.raises(InputError, match="is damaged: its KKT residual"):
        load_solution(tmp_path, COMM)


def test_nothing_is_read_that_is_no_file(tmp_path: Path, good: Path):
    for name, target in (("checkpoint.npz", "/dev/zero"), (FOLDER, FOLDER), (FOLDER, "/dev")):
        (tmp_path / name).symlink_to(target)
        with pytest.raises(InputError, match=r"holds no checkpoint|symbolic links"):
            load_solution(tmp_path, COMM)
        (tmp_path / name).unlink()
    shutil.copytree(good / FOLDER, tmp_path / FOLDER)
    (tmp_path / FOLDER / "u.npy").unlink()
    (tmp_path / FOLDER / "u.npy").symlink_to("/dev/zero")
    with pytest.raises(InputError, match="holds no u"):
        load_solution(tmp_path, COMM)
    with pytest.raises(InputError, match="name too long"):
        load_solution("x" * 5000, COMM)


def test_files_that_are_cut_are_refused(tmp_path: Path, good: Path):
    shutil.copytree(good / FOLDER, tmp_path / FOLDER)
    path = tmp_path / FOLDER / "u.npy"
    content = path.read_bytes()
    for damaged in (content[:-1], content + b"1", content[:100], b"", content.replace(b"Y\x01", b"Y\x07")):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"not a readable solution \(u.npy "):
            load_solution(tmp_path, COMM)
