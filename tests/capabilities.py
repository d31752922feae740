"""What the program can do, as commands with their results: a net under every change of the code that keeps results.

Each `Capability` is some commands in one folder. Its results are the exit status of each command and, of every file
that the last one wrote, numbers that depend neither on the number of ranks nor on time: those of JSON files, and for
each column of a table and each array of a checkpoint its sum and its size.

Usage: mpirun -n RANKS python tests/capabilities.py record FILE [WORD]     write the results of all, or of those with
                                                                           this word in their names
       python tests/capabilities.py compare BEFORE AFTER                   print the largest differences; status 1 if
                                                                           one is too large

`tests/capabilities.json` holds the results that `test_capabilities.py` compares with.
"""

import contextlib
import csv
import io
import json
import sys
import tempfile
import time
from collections.abc import Iterator, Set
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from in_time import ending_after
from mpi4py import MPI

from signorini_fenicsx.base.parallel import collect_garbage, collector_off
from signorini_fenicsx.cli.main import main

COMM = MPI.COMM_WORLD
GOLDEN = Path(__file__).with_name("capabilities.json")
OF_0_4 = Path(__file__).with_name("results_of_0.4")
CASES = Path(__file__).with_name("capability_cases")
TOLERANCE = 1e-10
"""Largest difference of a number, relative to its own size or to that of the numbers beside it."""
OF_ONE_RUN = {"timings", "peak_memory", "ranks", "versions", "command", "seconds", "reason"}
OF_ONE_RUN |= {"linear_iterations", "quantities"}
"""Names whose values differ from run to run, or that other tests check."""
OF_QUANTITIES = ("von_mises", "_peak_pressure")
"""Ends of the names of columns of steps that repeat `quantities`."""
ROUNDING = {"kkt", "own_residual", "remainder", "divergence.npy", "water_balance", "balance"}
"""Names of numbers that may be rounding."""
TIES = {"contact", "contact_facets", "contact_measure", "condition=zero_trace", "segment=contact", "iterations"}
TIES |= {"condition=no_flux", "segment=open", "relative", "oscillation"}
"""Names of numbers that depend on the side on which sites are whose p and flux are both rounding."""
STOPS = {"relative", "oscillation", "bound", "sigma_bound"}
"""Names of numbers with enclosures, which stop where they are sharp enough: rounding decides about the last one."""
FREE = {f"{side}_force_{axis}" for side in ("left", "right") for axis in "xy"}
"""Names of the forces on sides without loads: 0 but for rounding."""
PATH, WAY = {"changed", "zero_trace", "no_flux", "robin", "sigma_change", "u_change"}, {"history.csv", "iterations"}
"""Names of numbers of steps on the way to the solution, and of all of it where rounding decides how long it is."""
STRUCTURED, MIXED, RT1 = ("--set", "geometry.mesh=structured"), ("--backend", "mixed"), ("--element", "RT1")
BY_GMSH = ("example3", "example6", "crack", "ball", "clamp", "two_cylinders", "rock", "stack", "mindlin", "many")
BY_GMSH += ("example1 --h 0.03", "example1 --h 0.06", "roller", "press_fit", "earth_dam", "sliding_block")
BY_GMSH += ("lap_joint", "two_spheres", "cylinders", "heat_sink")
"""Beginnings of names whose mesh Gmsh makes: on another machine it may be another mesh."""

ENDED = "ended after step 2"
"""In front of a command in time: it ends as if a solve of step 3 had failed."""
STUDY = """
title = "a study"
case = "example1"
[set]
h = "1/8"
"geometry.mesh" = "structured"
[vary]
algorithm = ["alg1", "alg3"]
eps = [1e-2, 1e-4]
"""


@dataclass(frozen=True)
class Capability:
    """Commands that are run one after another in one folder.

    Attributes:
        name: What it is called.
        commands: Each a command line of `signorini`.
        status: Exit status of the last command; the others end with 0.
        files: Texts of files by their names.
        slow: Whether it takes more than a few seconds.
        beside: Names of numbers that are not compared.
    """

    name: str
    commands: tuple[tuple[str, ...], ...]
    status: int = 0
    files: dict[str, str] = field(default_factory=dict)
    slow: bool = False
    beside: frozenset[str] = frozenset()

    def differences(self, before: dict[str, Any], after: dict[str, Any]) -> list[tuple[float, str]]:
        """What differs by too much; of numbers on two meshes of Gmsh only that they are there."""
        found = [each for each in differences(before, after, self.beside) if each[0] > TOLERANCE]
        cells = [result["numbers"].get("summary.json/cells") for result in (before, after)]
        by_gmsh = self.name.startswith(tuple(f"solve {case}" for case in BY_GMSH)) and cells[0] != cells[1]
        return [each for each in found if not by_gmsh or np.isinf(each[0])]


def own(case: str, *options: str, **texts: str) -> Capability:
    """A case of the folder `capability_cases` solved, with words of it replaced."""
    content = (CASES / f"{case}.toml").read_text(encoding="utf-8")
    for word, text in texts.items():
        content = content.replace(word, text)
    return solved(f"{case}.toml", *options, **{case: content})


def solved(
    case: str,
    *options: str,
    h: str | None = None,
    slow: bool = False,
    status: int = 0,
    beside: Set[str] = frozenset(),
    **files: str,
) -> Capability:
    """A case solved, with its results in the folder `out`."""
    size = () if h is None else ("--h", h)
    name = " ".join(["solve", case, *size, *options])
    texts = {f"{key}.toml": text for key, text in files.items()}
    return Capability(
        name, (("solve", case, *size, *options, "--output", "out"),), status, texts, slow, frozenset(beside)
    )


def then(first: Capability, *options: str, status: int = 0, slow: bool = False) -> Capability:
    """A command after another one; it writes to the folder `out2`."""
    command = (*options, "--output", "out2")
    return Capability(f"{first.name}; {' '.join(options)}", (*first.commands, command), status, first.files, slow)


def _shipped() -> Iterator[Capability]:
    """All shipped cases on coarse meshes."""
    eighths = "example1 example4 biactive singular transition wall regulator two_sided staircase friction outlet filter"
    sizes = {"1/8": f"{eighths} soil_column hertz", "1/4": "example2 example5", "1/2": "lprism edge sphere"}
    by_rounding = {"staircase": STOPS | {"gap"}, "soil_column": PATH}
    for case, h in ((case, h) for h, cases in sizes.items() for case in cases.split()):
        yield solved(case, *STRUCTURED, h=h, beside=by_rounding.get(case, frozenset()))
    yield from (solved(case, h="1/4") for case in ("example3", "example6", "crack"))
    for case, h in (("cube", "1/3"), ("singular3d", "1/3"), ("transition3d", "1/2")):
        yield solved(case, *STRUCTURED, h=h, slow=case != "cube")
    yield from (solved("ball", h="1/2"), solved("rock_joint", h="1", beside=PATH, slow=True))
    for case in ("dam", "electropainting", "fault"):
        yield solved(case, beside=PATH)
    yield solved("dam_baiocchi", *STRUCTURED, h="2", beside=PATH)
    for case in ("two_obstacles", "saturation", "dead_core", "phases"):
        yield solved(case, *STRUCTURED, h="1/8", beside=STOPS if case == "two_obstacles" else frozenset())
    yield solved("duct", *STRUCTURED, h="1", slow=True)
    yield solved("slip", *STRUCTURED, h="1/4", beside={"errors", "certificate"})  # exact but for rounding
    yield from (solved(case, h=h, slow=True) for case, h in (("lap_joint", "1"), ("two_spheres", "40")))
    yield from (solved(case) for case in ("two_cylinders", "rock", "stack", "press_fit", "heat_sink"))
    yield from (solved("cylinders", h="1"), *(solved(case, slow=True) for case in ("roller", "earth_dam")))
    yield from (solved("plate", *STRUCTURED, h="0.005"), solved("clamp", h="8"))
    yield solved("mindlin", "--set", "time.end=3", "--set", "time.steps=3", "--certify-steps", beside=FREE, slow=True)
    few, two = (("--set", f"time.steps={steps}", "--certify-steps") for steps in (4, 2))
    yield solved("membrane", *STRUCTURED, *few, h="1/6", beside=TIES)
    yield solved("moving_transition", *STRUCTURED, *few, h="1/6")
    yield solved("seepage_falling", *few)
    yield own("film", "--certify-steps")
    off = {"mass_error", "content_change", "kappa_change", "kappa_energy_change"}  # rounding
    yield solved("celia", *STRUCTURED, *few, "--set", "time.end=14400", h="20", beside=off)
    yield solved("celia", *RT1, *STRUCTURED, *two, "--set", "time.end=14400", h="20", beside=off)
    yield from (solved(case, *few, h="1/8") for case in ("melting", "thawing", "oxygen", "soil"))


def _methods() -> Iterator[Capability]:
    """Methods and backends."""
    for algorithm in ("alg1", "alg2", "alg3", "alg4", "snes1", "snes2", "vi", "qp"):
        beside = PATH if algorithm in ("snes1", "snes2", "vi") else frozenset()
        yield solved("example5", *STRUCTURED, "--algorithm", algorithm, h="1/4", beside=beside)
    for algorithm in ("primal-pdas", "primal-penalty", "psor", "mixed-uzawa1", "mixed-uzawa2", "mixed-uzawa-h12"):
        yield solved("example1", *STRUCTURED, "--algorithm", algorithm, h="1/6")
    for algorithm in ("uzawa", "mixed-uzawa-wang", "slimane"):
        yield solved("example1", *STRUCTURED, "--algorithm", algorithm, h="1/6", beside={"violation"})
    for case in ("example2", "friction", "sphere"):
        yield solved(case, *STRUCTURED, *MIXED, h="1/2", slow=case == "sphere")
    yield solved("cube", *RT1, *STRUCTURED, h="1/2")
    for case, h in (("transition3d", "1/2"), ("regulator", "1/8"), ("sphere", "1/2")):
        yield solved(case, *RT1, *STRUCTURED, h=h, beside=PATH, slow=case in ("sphere", "transition3d"))
    yield from (solved("fault", *RT1, beside=PATH), solved("phases", *RT1, *STRUCTURED, h="1/8", beside=WAY))
    yield from (solved("fault", "--algorithm", *each, slow="qp" in each) for each in (("alg2", *MIXED), ("qp",)))
    yield solved("example4", *STRUCTURED, "--algorithm", "alg4", "--eps", "1e-3", "--for-signorini", h="1/8")
    yield solved("hertz", *STRUCTURED, "--algorithm", "alg2", h="1/8")
    yield solved("example1", *STRUCTURED, "--set", "solve.max_iterations=1", h="1/8", status=1)
    yield solved("example1", *STRUCTURED, "--algorithm", "alg9", h="1/8", status=2)
    yield solved("hertz", "--algorithm", "qp", status=2)
    yield solved("transition", *STRUCTURED, h="2^-7", slow=True, beside=PATH)
    yield solved("example1", *STRUCTURED, h="2^-7", slow=True)


def _rare() -> Iterator[Capability]:
    """Paths that are taken seldom."""
    for case in ("two_parts", "crossed", "reaction", "block", "springs", "held", "many", "read_off", "space"):
        yield own(case)
    yield own("two_parts", "--backend", "mixed", "--algorithm", "alg2")
    yield own("tresca", FRICTION="g = 0.01")
    yield replace(own("tresca", FRICTION="mu = 0.3"), name="solve coulomb")
    yield replace(own("pushed"), beside=FREE)
    yield replace(own("pushed", "--certify-steps"), beside=FREE)
    yield own("blocks", LAW='kind = "friction", mu = 0.3, gap = "0.2*(x - 0.5)^2"', LOAD="-0.1")
    joint = own(
        "blocks", LAW='kind = "joint_springs", normal = 20, shear = 5, mu = 0.3, gap = "0.2*(x - 0.5)^2"', LOAD="-0.1"
    )
    yield replace(joint, name="solve joint_springs", beside=PATH)
    for obstacle, h in ((None, "0.03"), ("-0.1", "0.06")):  # residuals of CG and rounding of forces, not in the bound
        more = () if obstacle is None else ("--set", f"problem.obstacle={obstacle}")
        yield solved("example1", "--set", "problem.f=-10 if x < 0.317 else 2", *more, h=h, beside=PATH)
    yield solved("example1", *STRUCTURED, "--rigorous", h="1/8")
    yield solved("cube", *STRUCTURED, "--rigorous", h="1/2")
    yield solved("example2", *STRUCTURED, "--plot", "--html", h="1/2", slow=True)
    yield solved("hertz", *STRUCTURED, "--plot", h="1/4")
    yield then(
        solved("example1", *STRUCTURED, h="1/4"), "solve", "example1", *STRUCTURED, "--h", "1/8", "--start-from", "out"
    )
    yield then(
        solved("hertz", *STRUCTURED, h="1/4"), "solve", "hertz", *STRUCTURED, "--h", "1/8", "--start-from", "out"
    )
    short = ("--set", "time.steps=4")
    yield then(solved("membrane", *STRUCTURED, *short, h="1/4"), "export", "out")
    steps = ("solve", "moving_transition", *STRUCTURED, "--h", "1/4", "--set", "time.steps=4", "--output", "out")
    yield Capability("restart", ((ENDED, *steps), (*steps, "--restart")))
    steps = ("solve", "thawing", "--h", "1/8", "--set", "time.steps=4", "--output", "out")
    yield Capability("restart of a storage", ((ENDED, *steps), (*steps, "--restart")))
    steps, off = ("solve", "sliding_block", "--output", "out"), FREE | {"top_force_x", "changes", "bound_changes"}
    yield Capability("solve sliding_block; restart", ((ENDED, *steps), (*steps, "--restart")), beside=frozenset(off))
    for case in ("example2", "hertz"):
        yield then(solved(case, *STRUCTURED, h="1/4"), "export", "out")
        twice = solved(case, *STRUCTURED, h="1/4")
        other = ("solve", case, *STRUCTURED, "--h", "1/8", "--output", "finer")
        both = (*twice.commands, other, ("compare", "out", "finer", "--output", "out2"))
        yield Capability(f"compare {case}", both, slow=case == "hertz")
    bounded = ("--max-cells", "300", "--output", "out")
    for case, h in (("example5", "1/2"), ("hertz", "1/4"), ("cube", "1"), ("friction", "1/4")):
        # of edges that are equally long the number decides which one is halved, and rounding where the flux is q_S
        beside, command = frozenset({"checkpoint", "violation"}), ("adapt", case, *STRUCTURED, "--h", h, *bounded)
        yield Capability(f"adapt {case}", (command,), slow=case == "friction", beside=beside)
    levels = ("--levels", "1:2", "--reference", "3", "--output", "out")
    yield Capability("convergence example1", (("convergence", "example1", *STRUCTURED, *levels),))
    by_eps = ("--vary", "eps", "--levels", "1:3", "--h", "1/8", "--output", "out")
    yield Capability("convergence in eps", (("convergence", "example4", *STRUCTURED, *by_eps),))
    yield Capability("study", (("study", "study.toml", "--output", "out"),), files={"study.toml": STUDY})


def _of_0_4() -> Iterator[Capability]:
    """Results that version 0.4 has written."""
    for folder in sorted(OF_0_4.glob("*")):
        name, again = f"{folder.name} of 0.4", ("export", str(folder), "--output", "out")
        yield Capability(f"export {name}", (again,), slow=folder.name == "sphere")
        if folder.name != "moving_transition":
            finer = ("solve", folder.name, *STRUCTURED, "--h", "1/3", "--output", "finer")
            both = ("compare", str(folder), "finer", "--output", "out")
            yield Capability(f"compare {name}", (finer, both), slow=folder.name not in ("example2", "hertz"))


def capabilities() -> list[Capability]:
    """All of them."""
    return [*_shipped(), *_methods(), *_rare(), *_of_0_4()]


ON_THREE_RANKS = ("example2", "hertz")
"""Words in the names of capabilities that are also run on three ranks, each the first with it."""
ON_TWO_RANKS = (
    *("example6", "dam_baiocchi", "block.toml", "space.toml", "read_off.toml", "pushed.toml", "two_obstacles"),
    *("coulomb", "cube --h 1/2 --element", "fault --element", "snes2", "psor", "mixed-uzawa-h12", "--backend mixed"),
    *("--rigorous", "restart of a storage", "problem.obstacle=", "two_parts.toml", "crossed.toml", "reaction.toml"),
    *("springs.toml", "film.toml", "blocks.toml", "many.toml", "alg3", "snes1", "--algorithm vi", "qp"),
    *("--for-signorini", "max_iterations", "--start-from", "export out", "compare hertz of", "compare example2 of"),
)
"""Words in the names of others that are also run on two, as many as there are cores, which takes half the time."""


def on_ranks() -> list[list[Capability]]:
    """The capabilities that together take all paths of the program: those for three ranks, and those for two."""
    return [
        [next(each for each in capabilities() if word in each.name) for word in words]
        for words in (ON_THREE_RANKS, ON_TWO_RANKS)
    ]


def run(capability: Capability, folder: Path) -> dict[str, Any]:
    """The results of a capability in an empty folder; the same on all ranks (collective).

    Returns:
        The exit status of each command, and the numbers of the files in the output of the last one.
    """
    if COMM.rank == 0:
        for name, text in capability.files.items():
            fault = Path(__file__).parents[1] / "data" / "meshes" / "fault.msh"
            (folder / name).write_text(text.replace("FAULT", str(fault)), encoding="utf-8")
    COMM.Barrier()
    statuses = [_status(folder, command) for command in capability.commands]
    numbers: dict[str, list[float]] = {}
    if COMM.rank == 0 and statuses[-1] != 2:
        last = capability.commands[-1]
        numbers = of_folder(folder / last[last.index("--output") + 1])
    return {"status": statuses, "numbers": COMM.bcast(numbers)}


def _status(folder: Path, command: tuple[str, ...]) -> int:
    """The exit status of a command line of `signorini` in a folder (collective)."""
    silent = io.StringIO()
    if command[0] == ENDED:
        with ending_after(2):
            return _status(folder, command[1:])
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(silent),
        contextlib.redirect_stderr(silent),
        mock.patch.object(sys, "argv", ["signorini", *command]),
    ):
        try:
            main()
        except SystemExit as end:
            (status,) = set(COMM.allgather(end.code))
    return int(status or 0)


def of_folder(folder: Path) -> dict[str, list[float]]:
    """Sum and size of what the files of a folder hold, by file and name; of pictures and the like that they exist."""
    found: dict[str, list[float]] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.suffix == ".json" and path.parent.suffix != ".bp" and path.name != "files.json":
            content = json.loads(path.read_text(encoding="utf-8"))
            found |= _of_json({key: value for key, value in content.items() if key != "history"}, name)
        elif path.suffix == ".csv" and path.name != "timings.csv":
            found |= _of_table(path, name)
        elif path.suffix == ".npy":
            found |= _of_array(np.load(path), name)
        elif path.suffix in (".png", ".html", ".xdmf", ".h5", ".bp", ".parquet"):
            found[name] = []
    return found


def _of_json(value: Any, name: str) -> dict[str, list[float]]:
    if name.rsplit("/", 1)[-1] in OF_ONE_RUN:
        return {}
    if isinstance(value, dict):
        return {
            key: numbers for part, inner in value.items() for key, numbers in _of_json(inner, f"{name}/{part}").items()
        }
    if isinstance(value, list):
        return {
            key: numbers
            for part, inner in enumerate(value)
            for key, numbers in _of_json(inner, f"{name}/{part}").items()
        }
    return {name: [float(value)]} if isinstance(value, bool | int | float) else {}


def _of_table(path: Path, name: str) -> dict[str, list[float]]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    found: dict[str, list[float]] = {f"{name}/rows": [float(len(rows))]}
    for column in rows[0] if rows else ():
        texts, place = [row[column] for row in rows], f"{name}/{column.replace('.', '/')}"
        if column in OF_ONE_RUN or column.endswith(OF_QUANTITIES) or "_tool_" in column:
            continue
        try:
            found |= _of_array(np.array([float(text) for text in texts if text]), place)
        except ValueError:
            found |= {f"{place}={text}": [float(texts.count(text))] for text in sorted(set(texts))}
    return found


def _of_array(values: np.ndarray, name: str) -> dict[str, list[float]]:
    """Sum and size of an array, each column of a matrix by itself; places of cells in files depend on ranks."""
    if values.dtype.kind not in "fb":  # whole numbers are numbers of things, which depend on ranks
        return {}
    columns = np.asarray(values, dtype=float).reshape(len(np.atleast_1d(values)), int(np.prod(values.shape[1:])))
    whole = columns[np.isfinite(columns).all(axis=1)]
    return {name: [*whole.sum(axis=0).tolist(), float(np.sqrt((whole**2).sum())), float(np.abs(whole).sum())]}


def _group(name: str) -> str:
    """The numbers beside a number: those of a file that have the same first key, those of an array."""
    file, _, keys = name.partition(".json/")
    return f"{file}.json/{keys.split('/')[0]}" if keys else name


def differences(
    before: dict[str, Any], after: dict[str, Any], beside: Set[str] = frozenset()
) -> list[tuple[float, str]]:
    """What two results differ in, but for names in `beside`, with the size of each difference, the largest first.

    A difference is relative to the largest number beside it; it is infinite where something is missing.
    """
    if before["status"] != after["status"]:
        return [(np.inf, f"exit status {before['status']} and {after['status']}")]
    one, other = before["numbers"], after["numbers"]
    found = [(np.inf, f"{name}: only in one") for name in sorted(one.keys() ^ other.keys())]
    scales: dict[str, float] = {}
    for name, values in one.items():
        group = _group(name)
        scales[group] = max(scales.get(group, 0.0), *np.abs(np.nan_to_num(values)), 0.0)
    for name in one.keys() & other.keys():
        a, b = np.array(one[name]), np.array(other[name])
        if (ROUNDING | beside) & set(name.split("/")):
            continue
        if a.shape != b.shape:
            found.append((np.inf, f"{name}: {a.shape} and {b.shape} numbers"))
        elif len(a) and not np.array_equal(a, b, equal_nan=True):
            off = np.abs(a - b).max() / max(scales[_group(name)], 1e-300)
            found.append((float(off) if np.isfinite(off) else np.inf, name))
    return sorted(found, reverse=True)


@collector_off()
def record(path: Path, word: str) -> None:
    """Write the results of all capabilities, or of those with this word in their names (collective)."""
    found = {}
    for capability in capabilities():
        if word in capability.name:
            start = time.perf_counter()
            with tempfile.TemporaryDirectory() as place:
                found[capability.name] = run(capability, Path(COMM.bcast(place)))
                COMM.Barrier()
            collect_garbage(COMM)
            if COMM.rank == 0:
                seconds, status = time.perf_counter() - start, found[capability.name]["status"]
                print(f"{seconds:6.1f} s", status, capability.name, flush=True)
    if COMM.rank == 0:
        path.write_text(json.dumps(found, indent=0, sort_keys=True) + "\n", encoding="utf-8")


def compare(before: Path, after: Path) -> int:
    """Print the largest difference of each capability that has one; return 1 if one is above the tolerance."""
    one, other = (json.loads(path.read_text(encoding="utf-8")) for path in (before, after))
    bad = 0
    for capability in capabilities():
        name = capability.name
        both = name in one and name in other
        found = differences(one[name], other[name], capability.beside) if both else [(np.inf, "missing")]
        for size, where in [each for each in found if each[0] > TOLERANCE][:5]:
            print(f"{size:9.1e}  {name}  {where}")
            bad += 1
    print(f"{len(one)} capabilities, {bad} differences above {TOLERANCE:g}")
    return int(bad > 0)


if __name__ == "__main__":
    if sys.argv[1] == "record":
        record(Path(sys.argv[2]), sys.argv[3] if len(sys.argv) > 3 else "")
    else:
        sys.exit(compare(Path(sys.argv[2]), Path(sys.argv[3])))
