"""Whole runs as multiples of the yardstick f₀, one linear solve with known contact set (`benchmark/yardstick.py`).

A run counts from the start of the command to its end, with certificate and output, on a mesh that it makes itself. In
each round a run on one rank, one on two ranks and the yardstick follow each other. Ratios are taken within a round, and
their least and largest values are printed. The machine should be idle.

    uv run python scripts/whole_runs.py                          # example1 at 2^-8 and the cube at 2^-4, three rounds
    uv run python scripts/whole_runs.py --run cube:2^-5 --rounds 2
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer

YARDSTICK = Path(__file__).with_name("benchmark") / "yardstick.py"
PHASES = {
    "mesh": ("mesh",),
    "assembly": ("assembly",),
    "sets and solution": ("prediction", "solve"),
    "KKT": ("kkt",),
    "certificate": ("certificate",),
    "output": ("output",),
}
WARM = ("solve", "example1", "--h", "0.3", "-q")


def main(
    run: Annotated[list[str], typer.Option(help="CASE:H; may be repeated.")] = ["example1:2^-8", "cube:2^-4"],  # noqa: B006
    rounds: Annotated[int, typer.Option(min=1)] = 3,
) -> None:
    """Measure and print one block per run."""
    with tempfile.TemporaryDirectory() as folder:
        launch([*command(), *WARM, "--output", f"{folder}/warm"], 1)
        for each in run:
            case, h = each.split(":")
            measure(case, h, rounds, Path(folder))


def measure(case: str, h: str, rounds: int, folder: Path) -> None:
    """Alternate the three and print their ratios."""
    seconds: dict[str, list[float]] = {}
    ratios: dict[str, list[float]] = {}
    about = {}
    for number in range(rounds + 1):
        totals = {}
        for ranks in (1, 2):
            output = folder / f"{case}-{ranks}"
            totals[ranks] = launch([*command(), "solve", case, "--h", h, "-q", "--output", str(output)], ranks)[0]
            about[ranks] = json.loads((output / "summary.json").read_text(encoding="utf-8"))
        yardstick = json.loads(launch([sys.executable, str(YARDSTICK), case, h], 1)[1])
        if number == 0:  # compiles, and fills the caches of the system
            continue
        f = yardstick["total"]
        timings = about[1]["timings"]
        parts = {name: sum(timings.get(key, 0.0) for key in keys) for name, keys in PHASES.items()}
        rest = totals[1] - sum(parts.values())
        for name, value in {"whole run": totals[1], **parts, "start and end": rest}.items():
            seconds.setdefault(name, []).append(value)
            ratios.setdefault(name, []).append(value / f)
        seconds.setdefault("f₀", []).append(f)
        ratios.setdefault("one rank / two ranks", []).append(totals[1] / totals[2])
        solving = [sum(about[n]["timings"].get(key, 0.0) for key in ("assembly", "prediction", "solve")) for n in about]
        ratios.setdefault("solver, one rank / two ranks", []).append(solving[0] / solving[1])
    facets = yardstick["unknowns"]
    print(f"{case}, h = {h}: {about[1]['cells']} cells, {facets} facets, {about[1]['mesh']}")
    for name in seconds:
        values = f"{min(seconds[name]):8.2f} to {max(seconds[name]):.2f} s"
        print(f"  {name:20}{values:22}" + (span(ratios[name]) + " f₀" if name in ratios else ""))
    for name in ("one rank / two ranks", "solver, one rank / two ranks"):
        print(f"  {name:30} {span(ratios[name])}")
    for ranks, summary in about.items():
        print(f"  memory on {ranks}: {summary['peak_memory'] / facets:.0f} bytes per facet over all ranks")


def span(values: list[float]) -> str:
    """The least and the largest."""
    return f"{min(values):.2f} to {max(values):.2f}"


def command() -> list[str]:
    """The program of this environment."""
    return [str(Path(sys.executable).with_name("signorini"))]


def launch(arguments: list[str], ranks: int) -> tuple[float, str]:
    """Seconds of a command, and the last line that it prints."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    began = time.perf_counter()
    done = subprocess.run(
        [*launcher, *arguments], check=True, capture_output=True, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"}
    )
    return time.perf_counter() - began, (done.stdout.splitlines() or [""])[-1]


if __name__ == "__main__":
    typer.run(main)
