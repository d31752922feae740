"""Tests whether a change of the code changes results: records 60 runs before and after it and compares them.

Usage: python scripts/same_results.py record FOLDER [--only WORD]    solve, a folder per run, on 1 to 3 ranks
       python scripts/same_results.py compare BEFORE AFTER           the largest relative differences; status 1 if any
                                                                     run differs by more than it may

Norms, bounds and contact measures may differ by 1e-12 with a factorisation and by 1e-9 with CG, relative to their own
size, or to 1e-3 ‖σ_h‖ where they are smaller, since then they may be rounding. Counts may not differ at all.
"""

import argparse
import itertools
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

DIRECT, ITERATIVE = 1e-12, 1e-9
"""Largest relative difference by rounding, for a factorisation and for iterative solvers."""
COUNTS = ("cells", "signorini_facets", "dofs", "contact_facets", "iterations", "rough_steps", "converged")
SMALL = 1e-3
ITERATIVE_METHODS = {"uzawa", "psor", "qp", "vi"}

SET_METHODS = ("alg1", "alg2", "alg3", "alg4")
CLASSICAL = ("uzawa", "psor", "primal-pdas", "primal-penalty", "mixed-uzawa1", "mixed-uzawa2", "mixed-uzawa-h12")
CLASSICAL += ("mixed-uzawa-wang", "slimane", "qp")
FILE_CASES = {"dam", "electropainting"}
"""Cases with a mesh of their own: it is taken as it is."""


def runs() -> Iterator[tuple[int, str, str, dict[str, str]]]:
    """Ranks, case, algorithm and further options of each run."""
    for case, algorithm in itertools.product(("example1", "example4"), (*SET_METHODS, "snes1", "snes2", "vi")):
        yield 1, case, algorithm, {"h": "1/16"}
    for case, algorithm in itertools.product(("example2", "example5"), SET_METHODS):
        yield 2, case, algorithm, {"h": "1/16"}
    for case, algorithm in itertools.product(("example3", "biactive"), ("alg1", "alg2")):
        yield 1, case, algorithm, {"h": "1/16", "backend": "mixed"}
    for case in ("example6", "transition", "singular", "dam"):
        for ranks in (1, 3):
            yield ranks, case, "alg1", {"h": "1/16"}
    for case, ranks in (("cube", 1), ("cube", 3), ("lprism", 2), ("ball", 2), ("edge", 1), ("transition3d", 2)):
        yield ranks, case, "alg2" if ranks == 2 else "alg1", {"h": "1/4"}
    yield 2, "electropainting", "alg1", {}
    yield 1, "singular3d", "alg1", {"h": "1/4", "backend": "mixed"}
    for algorithm in CLASSICAL:
        yield 1, "example1", algorithm, {"h": "1/8"}
    for algorithm in ("primal-pdas", "primal-penalty", "qp"):
        yield 3, "example2", algorithm, {"h": "1/8"}
    for ranks in (1, 2, 3):
        yield ranks, "transition", "alg1", {"h": "2^-7"}  # so large that sets are predicted and CG solves
    yield 1, "transition", "alg3", {"h": "2^-7"}
    yield 2, "transition3d", "alg1", {"h": "1/16"}


def name_of(ranks: int, case: str, algorithm: str, options: dict[str, str]) -> str:
    """Folder of a run."""
    values = "-".join(value.replace("/", "_").replace("^", "") for value in options.values())
    return f"{case}-{algorithm}-{values}-n{ranks}"


def record(folder: Path, only: str) -> None:
    """Do all runs, or those with this word in their names."""
    for ranks, case, algorithm, options in runs():
        name = name_of(ranks, case, algorithm, options)
        if only not in name:
            continue
        command = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
        command += ["signorini", "solve", case, "--algorithm", algorithm, "--quiet", "--output", str(folder / name)]
        for key, value in options.items():
            if not (key == "h" and case in FILE_CASES):
                command += [f"--{key}", value]
        status = subprocess.run(command, check=False).returncode
        print(f"{name}: {'solved' if status == 0 else f'status {status}'}", flush=True)


def numbers(summary: dict[str, Any]) -> dict[str, float]:
    """The values that may change only by rounding, by dotted names."""
    certificate = summary.get("certificate", {})
    values = {f"norms.{key}": value for key, value in summary["norms"].items()}
    values |= {f"errors.{key}": value for key, value in summary.get("errors", {}).items() if value is not None}
    values |= {f"certificate.{key}": certificate[key] for key in ("bound", "sigma_bound") if certificate.get(key)}
    return values | {"contact_measure": summary["contact_measure"], "h": summary["h"]}


def difference(before: dict[str, Any], after: dict[str, Any]) -> tuple[float, str]:
    """The largest relative difference of two summaries and its name; infinite if a count differs."""
    for key in COUNTS:
        if before[key] != after[key]:
            return float("inf"), f"{key}: {before[key]} and {after[key]}"
    one, other = numbers(before), numbers(after)
    if one.keys() != other.keys():
        return float("inf"), f"only in one of them: {', '.join(sorted(one.keys() ^ other.keys()))}"
    small = SMALL * before["norms"]["sigma_L2"]
    differences = {key: abs(one[key] - other[key]) / max(abs(one[key]), small, 1e-300) for key in one}
    worst = max(differences, key=lambda key: differences[key])
    return differences[worst], worst


def allowed(summary: dict[str, Any]) -> float:
    """How much a run may differ."""
    exact = "lu" in summary["linear_solver"] or "cholesky" in summary["linear_solver"]
    iterates = summary["algorithm"] in ITERATIVE_METHODS or "uzawa" in summary["algorithm"]
    return DIRECT if exact and not iterates else ITERATIVE


def compare(before: Path, after: Path) -> int:
    """Print the differences of all runs, the largest last; return 1 if one is too large or a run is missing."""
    rows, bad = [], 0
    for run in runs():
        name = name_of(*run)
        summaries = [folder / name / "summary.json" for folder in (before, after)]
        missing = [str(path) for path in summaries if not path.is_file()]
        if missing:
            print(f"missing: {', '.join(missing)}")
            bad += 1
            continue
        one, other = (json.loads(path.read_text(encoding="utf-8")) for path in summaries)
        size, where = difference(one, other)
        bad += size > allowed(one)
        rows.append((size, name, where, "" if size <= allowed(one) else f"  more than {allowed(one):g}"))
    for size, name, where, remark in sorted(rows):
        print(f"{size:9.1e}  {name}  {where}{remark}")
    print(f"{len(rows)} runs compared, {bad} differ or are missing")
    return int(bad > 0)


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("record")
    recording.add_argument("folder", type=Path)
    recording.add_argument("--only", default="", metavar="WORD")
    comparing = commands.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "record":
        record(arguments.folder, arguments.only)
        return 0
    return compare(arguments.before, arguments.after)


if __name__ == "__main__":
    sys.exit(main())
