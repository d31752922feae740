"""The command for studies."""

from typing import Annotated

import typer
from mpi4py import MPI

from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.shipped import study_names
from signorini_fenicsx.cli.common import results_place
from signorini_fenicsx.cli.options import Json, OutputFolder, Quiet


def study(
    study: Annotated[
        str, typer.Argument(help="Name of a shipped study or path of a .toml file.", autocompletion=study_names)
    ],
    output: OutputFolder = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the runs and their sizes; run nothing.")] = False,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Try failed runs again.")] = False,
    status: Annotated[
        bool, typer.Option("--status", help="Show how far the study is, also while it runs; run nothing.")
    ] = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Do all unfinished runs of a study; write results/<study>-study/. After an interruption start it again.

    Examples:
      signorini study my-study.toml --dry-run
      mpirun -n 4 signorini study my-study.toml
      signorini study my-study.toml --status
    """
    from signorini_fenicsx.cli.study_report import Progress, StudyReport, listing
    from signorini_fenicsx.studies.folder import StudyFolder
    from signorini_fenicsx.studies.runner import check_all_succeeded, run_study
    from signorini_fenicsx.studies.study import load_study

    comm, report = MPI.COMM_WORLD, StudyReport(quiet=quiet, as_json=as_json)
    declared, runs = on_root(comm, lambda: load_study(study))
    folder = StudyFolder(comm, results_place(output, f"{declared.name}-study"))
    report.heading(declared, runs, comm)
    if dry_run or status:
        if status:
            on_root(comm, lambda: report.status(runs, folder))
        else:
            report.plan(runs, folder)
        if as_json:
            report.json(on_root(comm, lambda: listing(declared, runs, folder)))
        return
    with folder:
        if retry_failed:
            on_root(comm, lambda: folder.forget_failures(runs))
        with Progress(runs, folder, comm, report) as progress:
            undrawn = run_study(
                runs, declared.ranks_per_run, folder, comm, title=declared.title or declared.name, on_run=progress.say
            )
        report.results(folder.path)
        if as_json:
            report.json(on_root(comm, lambda: listing(declared, runs, folder)))
        check_all_succeeded(runs, folder, comm, undrawn)
