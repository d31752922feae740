"""Makes the tables and figures of the slides again: runs the declared studies as far as needed, then draws.

Usage: [mpirun -n N] python scripts/reproduce.py [--quick] [--output FOLDER] ITEM...

ITEM is table1 … table6, figure1 … figure22 or all. Each is a selection of the runs of a study in `data/studies/`. Runs
that several items share, or that an earlier call has finished, are done once. `--quick` uses coarse meshes.
`scripts/figures.py` alone can draw the results again, including `results/reproduction/index.html`.
"""

import argparse
import itertools
import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mpi4py import MPI

import signorini_fenicsx  # noqa: F401 - orders MPI before DOLFINx
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import abort_all_on_exception, on_root
from signorini_fenicsx.base.versions import versions
from signorini_fenicsx.cli.study_report import Progress, StudyReport
from signorini_fenicsx.comparing.convergence import Vary, slides_errors
from signorini_fenicsx.studies.folder import StudyFolder
from signorini_fenicsx.studies.runner import check_all_succeeded, run_study
from signorini_fenicsx.studies.study import Convergence, Run, load_study, make_run

QUICK_H = 2.0**-4
QUICK_LEVELS, QUICK_REFERENCE = [2, 3, 4], 6


@dataclass(frozen=True)
class Item:
    """A table or figure.

    Attributes:
        draw: Key of `figures.DRAWN`, or "table".
        caption: Its contents in words.
        studies: Declared studies with its runs.
        where: Parameters that select them.
    """

    draw: str
    caption: str
    studies: Sequence[str] = ()
    where: dict[str, object] = field(default_factory=dict)

    def selects(self, run: Run) -> bool:
        """Whether a run of its studies belongs to this item."""
        return all(run.parameters[key] == value for key, value in self.where.items())


type Figures = tuple[str, str, list[str], dict[str, object], dict[int, int]]

FIGURES: tuple[Figures, ...] = (
    ("solution", "u_h, σ_h and |σ_h|.", ["solutions"], {}, {1: 2, 2: 5, 3: 8, 4: 11, 5: 15, 6: 19}),
    ("traces", "u_h, σ_h·n and p_h on Γ_S.", ["solutions"], {}, {1: 3, 2: 6, 3: 9}),
    ("iterations", "iteration errors.", ["iterations"], {}, {1: 4, 2: 7, 3: 10}),
    (
        *("penalty_traces", "u_εh, σ_εh·n and p_εh on Γ_S for two ε."),
        *(["penalty_iterations"], {"solve.algorithm": "alg3"}, {4: 12, 5: 16, 6: 20}),
    ),
    ("errors", "errors over h and over ε.", ["penalty_h", "penalty_eps"], {}, {4: 13, 5: 17, 6: 21}),
    ("iterations", "iteration errors.", ["penalty_iterations"], {"solve.eps": 1e-8}, {4: 14, 5: 18, 6: 22}),
)
"""How figures are drawn, their captions, studies, what selects runs, and the number of the figure of each example."""


def items() -> dict[str, Item]:
    """All tables and figures, by name."""
    by_name: dict[str, Item] = {}
    for number, (case, algorithm) in enumerate(itertools.product((1, 2, 3), ("alg1", "alg2")), start=1):
        by_name[f"table{number}"] = Item(
            "table",
            f"Example {case}: errors against a fine solution and their orders, beside the slides'."
            + (" The slides' are those of table 5 one level finer, probably by a misprint." if number == 6 else ""),
            ["tables"],
            {"case": f"example{case}", "solve.algorithm": algorithm},
        )
    by_name["figure1"] = Item("region", "A domain Ω with Dirichlet boundary Γ_D and Signorini boundary Γ_S.")
    for draw, caption, studies, where, numbers in FIGURES:
        for case, number in numbers.items():
            chosen = {"case": f"example{case}", **where}
            by_name[f"figure{number}"] = Item(draw, f"Example {case}: {caption}", studies, chosen)
    names = [f"table{number}" for number in range(1, 7)] + [f"figure{number}" for number in range(1, 23)]
    return {name: by_name[name] for name in names}


def runs_of(item: Item, *, quick: bool) -> list[Run]:
    """The runs of an item."""
    runs = [run for name in item.studies for run in load_study(name)[1] if item.selects(run)]
    return [coarser(run) for run in runs] if quick else runs


def coarser(run: Run) -> Run:
    """The run on coarse meshes."""
    case, task = run.case.with_values({"solve.h": max(run.case.solve.h, QUICK_H)}), run.convergence
    if task is not None and task.vary is Vary.H:
        task = Convergence(vary=task.vary, levels=QUICK_LEVELS, reference=QUICK_REFERENCE)
    return make_run(case, task)


def reproduce(names: Sequence[str], folder: StudyFolder, comm: MPI.Comm, *, quick: bool) -> None:
    """Run what is missing and draw (collective).

    Raises:
        NumericalFailure: If a run failed; then nothing is drawn.
    """
    wanted = {name: item for name, item in items().items() if name in names or "all" in names}
    runs_by_item = on_root(comm, lambda: {name: runs_of(item, quick=quick) for name, item in wanted.items()})
    runs = list({run.name: run for runs in runs_by_item.values() for run in runs}.values())
    with folder, Progress(runs, folder, comm, StudyReport()) as progress:
        if runs:
            run_study(runs, 1, folder, comm, title="The tables and figures of the slides", on_run=progress.say)
            check_all_succeeded(runs, folder, comm)
        on_root(comm, lambda: draw(wanted, runs_by_item, folder, quick=quick))


def draw(wanted: dict[str, Item], runs: dict[str, list[Run]], study: StudyFolder, *, quick: bool) -> None:
    """Write `reproduction.json`, which lists the runs, draw the wanted figures, and tables for LaTeX (rank 0)."""
    import figures

    option, folder = " --quick" if quick else "", study.path
    path = folder / "reproduction.json"
    earlier = json.loads(path.read_text(encoding="utf-8"))["items"] if path.exists() else {}
    new = {
        name: {
            "draw": item.draw,
            "caption": item.caption,
            "command": f"python scripts/reproduce.py{option} {name}",
            "runs": [run.name for run in runs[name]],
            "slides": _slides(item) if item.draw == "table" else {},
        }
        for name, item in wanted.items()
    }
    shown = earlier | new
    about = {
        "remark": "A quick pass on coarse meshes." if quick else "The meshes of the slides.",
        "versions": versions(),
        "items": {name: shown[name] for name in items() if name in shown},
    }
    path.write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    figures.make(folder, list(new))
    for name in [name for name, item in wanted.items() if item.draw == "table"]:
        shutil.copyfile(study.place(runs[name][0]) / "convergence.tex", folder / f"{name}.tex")


def _slides(item: Item) -> dict[str, dict[str, float]]:
    """The errors of the slides per level, as printed there."""
    errors = slides_errors(str(item.where["case"]), str(item.where["solve.algorithm"]))
    return {str(level): {"sigma_V": sigma, "u_Q": u} for level, (sigma, u) in errors.items()}


def main() -> int:
    """Read the command line; the exit status is that of `signorini`."""
    names = [*items(), "all"]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "items", nargs="+", metavar="ITEM", choices=names, help="table1 … table6, figure1 … figure22, all"
    )
    parser.add_argument("--quick", action="store_true", help="coarse meshes")
    parser.add_argument("--output", type=Path, help="default: results/reproduction, or results/reproduction-quick")
    arguments = parser.parse_args()
    comm = MPI.COMM_WORLD
    abort_all_on_exception(comm)
    default = Path("results", "reproduction-quick" if arguments.quick else "reproduction")
    folder = StudyFolder(comm, arguments.output or default)
    try:
        reproduce(arguments.items, folder, comm, quick=arguments.quick)
    except (InputError, NumericalFailure, OSError) as error:
        if comm.rank == 0:
            print(f"error: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    if comm.rank == 0:
        print(f"see {folder.path / 'index.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
