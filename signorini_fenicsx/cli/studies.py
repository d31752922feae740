"""The command for studies."""

from typing import Annotated

import typer

from signorini_fenicsx.base.shipped import study_names
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
    yes: Annotated[bool, typer.Option("--yes", help="Do a study of 1000 runs or more.")] = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Do all unfinished runs of a study; write results/<study>-study/. After an interruption start it again.

    Examples:
      signorini study my-study.toml --dry-run
      mpirun -n 4 signorini study my-study.toml
      signorini study my-study.toml --status
    """
    from signorini_fenicsx.cli.study_report import StudyReport, do_study

    report = StudyReport(quiet=quiet, as_json=as_json)
    do_study(study, output, report, dry_run=dry_run, retry_failed=retry_failed, status=status, yes=yes, as_json=as_json)
