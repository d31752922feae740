"""Makes the tables and figures of the slides again: runs the declared studies as far as needed, then draws.

Usage: [mpirun -n N] python scripts/reproduce.py [--quick] [--output FOLDER] ITEM...

ITEM is table1 … table6, figure2 … figure22 or all. Each is a selection of the runs of a study in `data/studies/`. Runs
that several items share, or that an earlier call has finished, are done once: the same call again only draws.
`index.html` shows all that there is. `--quick` uses coarse meshes.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import argparse
import csv
import itertools
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import figures
import matplotlib as mpl
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import abort_all_on_exception, on_root
from signorini_fenicsx.cli.study_report import Progress, StudyReport
from signorini_fenicsx.comparing.convergence import Vary
from signorini_fenicsx.pictures.style import STYLE
from signorini_fenicsx.studies.folder import Status, StudyFolder
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
    studies: Sequence[str]
    where: dict[str, object]

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
    for draw, caption, studies, where, numbers in FIGURES:
        for case, number in numbers.items():
            chosen = {"case": f"example{case}", **where}
            by_name[f"figure{number}"] = Item(draw, f"Example {case}: {caption}", studies, chosen)
    names = [f"table{number}" for number in range(1, 7)] + [f"figure{number}" for number in range(2, 23)]
    return {name: by_name[name] for name in names}


declared = cache(load_study)
"""A declared study, read once."""


def runs_of(item: Item, *, quick: bool) -> list[Run]:
    """The runs of an item."""
    runs = [run for name in item.studies for run in declared(name)[1] if item.selects(run)]
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
        run_study(runs, 1, folder, comm, title="The tables and figures of the slides", on_run=progress.say)
        check_all_succeeded(runs, folder, comm)
        on_root(comm, lambda: draw(wanted, folder, quick=quick))


def draw(wanted: dict[str, Item], study: StudyFolder, *, quick: bool) -> None:
    """Draw what is wanted, and write the page with all that was ever drawn here (rank 0)."""
    option, sections, folder = " --quick" if quick else "", {}, study.path
    for name, item in items().items():
        runs, is_drawn = runs_of(item, quick=quick), any(folder.glob(f"{name}.*"))
        if name not in wanted and not (is_drawn and all(study.status(run) is Status.DONE for run in runs)):
            continue
        kept = [figures.Kept(run, study.place(run), study.record(run)) for run in runs]
        shown = figures.picture(name, item.caption)
        if item.draw == "table":
            shown = figures.table(lines := figures.table_rows(kept[0]))
            with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerows([["h", *list(figures.COLUMNS)[1:]], *lines])
            shutil.copyfile(kept[0].folder / "convergence.tex", folder / f"{name}.tex")
        elif name in wanted:
            with mpl.rc_context(STYLE):
                figure = figures.DRAWN[item.draw](kept)
                for suffix in ("png", "pdf"):
                    figure.savefig(folder / f"{name}.{suffix}")
        command = f"python scripts/reproduce.py{option} {name}"
        sections[name] = figures.section(name, shown, item.caption, command, kept)
    remark = "A quick pass on coarse meshes." if quick else "The meshes of the slides."
    (folder / "index.html").write_text(figures.page(remark, sections), encoding="utf-8")


def main() -> int:
    """Read the command line; the exit status is that of `signorini`."""
    names = [*items(), "all"]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "items", nargs="+", metavar="ITEM", choices=names, help="table1 … table6, figure2 … figure22, all"
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
