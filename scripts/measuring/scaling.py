"""How a whole run scales with ranks: seconds by phase, memory, and how often ranks talk to each other.

Three experiments, each for a case in the plane and one in space:

strong: the same mesh on one and on two ranks;
weak: as many cells per rank on two ranks as on one;
memory: the same mesh on 1, 2, 4, 8 and 16 ranks, more than there are cores, so the seconds mean nothing there. What an
empty process has (a run on a few cells with as many ranks) is taken off. Messages and reductions are those that PETSc
counts while it assembles and solves, and the products and norms of vectors, each of which is a reduction.

The results are `scaling.json` and `table.md`. The machine should be idle; `--quick` is a trial on small
meshes.
"""

import ast
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

DIM = {"example1": 2, "cube": 3}
SIZES = {"example1": 2.0**-8, "cube": 2.0**-4}
QUICK = {"example1": 2.0**-7, "cube": 2.0**-3}
PHASES = ("mesh", "assembly", "prediction", "solve", "kkt", "certificate", "output")
SOLVER = ("assembly", "prediction", "solve")
REDUCTIONS = ("VecTDot", "VecDot", "VecNorm", "VecMDot", "VecDotNorm2")
"""Operations on vectors that need one reduction each; PETSc does not count these."""
RANKS = (1, 2, 4, 8, 16)


@dataclass(frozen=True)
class Run:
    """One run of the program.

    Attributes:
        case: The case.
        ranks: Number of ranks.
        h: Largest cell diameter asked for.
        cells: Cells of the mesh.
        unknowns: Facets, the unknowns of the hybrid backend.
        seconds: From the start of the command to its end.
        timings: Seconds per phase.
        memory: Peak memory in bytes, summed over ranks.
        empty: The same for a run on a few cells.
        iterations: Iterations of the linear solver, those of predictions included.
        solves: Calls of the linear solver.
        messages: Messages per rank in assembly and solver, the mean over ranks.
        sent: Bytes per rank in these messages.
        reductions: Reductions of all ranks in assembly and solver.
    """

    case: str
    ranks: int
    h: float
    cells: int
    unknowns: int
    seconds: float
    timings: dict[str, float]
    memory: int
    empty: int
    iterations: int
    solves: int
    messages: float
    sent: float
    reductions: int

    @property
    def per_facet(self) -> float:
        """Bytes per facet over all ranks, without empty processes."""
        return (self.memory - self.empty) / self.unknowns


def scaling(
    quick: Annotated[bool, typer.Option(help="Small meshes, up to 4 ranks.")] = False,
    rounds: Annotated[
        int, typer.Option(min=1, help="Repeats of the runs whose seconds count; the fastest is kept.")
    ] = 3,
    output: Annotated[Path, typer.Option(help="Where the results go.")] = Path("results/scaling"),
) -> None:
    """Run the three experiments."""
    sizes, ranks = (QUICK, RANKS[:3]) if quick else (SIZES, RANKS)
    output.mkdir(parents=True, exist_ok=True)
    runs: dict[str, list[Run]] = {"strong": [], "weak": [], "memory": []}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case, h in sizes.items():
            empty = {n: measured(case, 1.0, n, folder, 0, log=False).memory for n in ranks}  # also fills the caches
            one, two = (best(case, h, n, folder, empty[n], rounds) for n in (1, 2))
            runs["strong"] += [one, two]
            runs["weak"] += [one, best(case, h * 0.5 ** (1 / DIM[case]), 2, folder, empty[2], rounds)]
            runs["memory"] += [measured(case, h, n, folder, empty[n]) for n in ranks]
    by_name = {name: [asdict(run) for run in each] for name, each in runs.items()}
    (output / "scaling.json").write_text(json.dumps(by_name, indent=2) + "\n", encoding="utf-8")
    tables = of_time("strong", runs["strong"]), of_time("weak", runs["weak"]), of_ranks(runs["memory"])
    text = "\n\n".join("\n".join(lines) for lines in tables)
    (output / "table.md").write_text(text + "\n", encoding="utf-8")
    print(text)


def best(case: str, h: float, ranks: int, folder: Path, empty: int, rounds: int) -> Run:
    """The fastest of several runs."""
    runs = [measured(case, h, ranks, folder, empty, log=False) for _ in range(rounds)]
    return min(runs, key=lambda run: run.seconds)


def measured(case: str, h: float, ranks: int, folder: Path, empty: int, *, log: bool = True) -> Run:
    """Run the program and read what it has written; `log` lets PETSc count, which takes some time."""
    place, counts = folder / "run", folder / "log.py"
    program = Path(sys.executable).with_name("signorini")
    command = ["mpirun", "-n", str(ranks), str(program), "solve", case, "--h", str(h), "-q", "--output", str(place)]
    command += ["--", "-log_view", f":{counts}:ascii_info_detail"] if log else []
    began = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
    seconds = time.perf_counter() - began
    summary = json.loads((place / "summary.json").read_text(encoding="utf-8"))
    return Run(
        case=case,
        ranks=ranks,
        h=h,
        cells=summary["cells"],
        unknowns=summary["dofs"],
        seconds=seconds,
        timings=summary["timings"],
        memory=summary["peak_memory"],
        empty=empty,
        **(counted(counts) if log else {"iterations": 0, "solves": 0, "messages": 0.0, "sent": 0.0, "reductions": 0}),
    )


def counted(path: Path) -> dict[str, Any]:
    """What PETSc has counted in assembly and solver, from its log, whose lines are assignments in Python."""
    line = re.compile(r'^Stages\["([^"]+)"\]\["([^"]+)"\]\[(\d+)\] = (\{.*\})$', re.MULTILINE)
    events: dict[str, list[dict[str, float]]] = {}
    ranks = 0
    for stage, event, rank, values in line.findall(path.read_text(encoding="utf-8")):
        ranks = max(ranks, int(rank) + 1)
        if stage in SOLVER and (rank == "0" or event == "summary"):
            events.setdefault(event, []).append(ast.literal_eval(values) | {"rank": int(rank)})

    def total(event: str, key: str, *, of_all: bool = False) -> float:
        return sum(values[key] for values in events.get(event, []) if of_all or values["rank"] == 0)

    counted = total("summary", "numReductions") + sum(total(event, "count") for event in REDUCTIONS)
    return {
        "iterations": round(total("PCApply", "count")),
        "solves": round(total("KSPSolve", "count")),
        "messages": total("summary", "numMessages", of_all=True) / ranks,
        "sent": total("summary", "messageLength", of_all=True) / ranks,
        "reductions": round(counted),
    }


def of_time(name: str, runs: list[Run]) -> list[str]:
    """A table of seconds by phase, in pairs of runs on one and on two ranks."""
    lines = [
        f"| {name} | ranks | cells | whole run | {' | '.join(PHASES)} | start and end |",
        "|---|" + "---:|" * (len(PHASES) + 4),
    ]
    for one, two in zip(runs[::2], runs[1::2], strict=True):
        for run in (one, two):
            phases = [run.timings.get(phase, 0.0) for phase in PHASES]
            cells = [*(f"{value:.2f}" for value in phases), f"{run.seconds - sum(phases):.2f}"]
            lines.append(f"| {run.case} | {run.ranks} | {run.cells} | {run.seconds:.2f} s | {' | '.join(cells)} |")
        ratios = [one.timings.get(phase, 0.0) / max(two.timings.get(phase, 0.0), 1e-9) for phase in PHASES]
        work = (two.cells / one.cells) if name == "weak" else 1.0
        shown = [f"{work * ratio:.2f}" for ratio in (one.seconds / two.seconds, *ratios)]
        lines.append(f"| cells per second, two / one | | | {' | '.join(shown)} | |")
    return lines


def of_ranks(runs: list[Run]) -> list[str]:
    """A table of memory and communication over ranks."""
    names = ["case", "ranks", "facets", "bytes per facet", "memory / that of one rank", "iterations", "solves"]
    names += ["messages per rank", "kB per message", "reductions"]
    lines = [f"| {' | '.join(names)} |", "|---|" + "---:|" * (len(names) - 1)]
    for run in runs:
        one = next(each for each in runs if each.case == run.case and each.ranks == 1)
        memory = f"{run.per_facet:.0f}", f"{run.per_facet / one.per_facet:.2f}"
        talk = f"{run.messages:.0f}", f"{run.sent / max(run.messages, 1) / 1000:.2f}"
        numbers = (run.ranks, run.unknowns, *memory, run.iterations, run.solves, *talk, run.reductions)
        lines.append(f"| {run.case} | {' | '.join(map(str, numbers))} |")
    return lines
