"""Break 200 case files and 50 meshes at random and run each: exit status 2, one sentence, no traceback, no hang.

    uv run python scripts/fuzz.py [--ranks 2] [--seed 0] [--cases 200] [--meshes 50]

A mutation that leaves a case valid must solve, or fail with exit status 1. All runs that are neither are listed.
"""

import argparse
import os
import random
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from broken_input import write_broken_case, write_broken_mesh

SECONDS = 120


def verdict(path: Path, ranks: int) -> tuple[str, str]:
    """How a run ended, and what it said."""
    command = ["mpirun", "-n", str(ranks), "signorini", "solve", path.name, "--output", f"{path.stem}-out"]
    try:
        done = subprocess.run(
            command,
            cwd=path.parent,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            errors="replace",
            timeout=SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "hangs", ""
    said = done.stderr.strip()
    if "Traceback" in said:
        return "traceback", said
    if done.returncode == 2:
        wrote = (path.parent / f"{path.stem}-out").exists()
        one = said.count("\n") == 0 and said.startswith("error: ")
        return ("one sentence" if one and not wrote else "several lines" if not one else "wrote something"), said
    return {0: "solved", 1: "failed"}.get(done.returncode, f"status {done.returncode}"), said


def main() -> None:
    """Run all and count the verdicts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for option, default in (("--ranks", 2), ("--seed", 0), ("--cases", 200), ("--meshes", 50)):
        parser.add_argument(option, type=int, default=default)
    options = parser.parse_args()
    rng = random.Random(options.seed)
    good = {"one sentence", "solved", "failed"}
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        folder = Path(name)
        paths = [write_broken_case(folder, rng, i) for i in range(options.cases)]
        meshes = [write_broken_mesh(folder, rng, i) for i in range(options.meshes)]
        bad = 0
        for kind, group in (("cases", paths), ("meshes", meshes)):
            counts: Counter[str] = Counter()
            for path in group:
                ending, said = verdict(path, options.ranks)
                counts[ending] += 1
                print(f"{path.name:<16} {ending:<14} {said[:200]}", flush=True)
                bad += ending not in (good if kind == "cases" else {"one sentence"})
            print(kind, dict(counts), flush=True)
        if (folder / "hacked").exists():
            sys.exit("a mesh file ran a command")
    sys.exit(f"{bad} runs ended badly" if bad else 0)


if __name__ == "__main__":
    main()
