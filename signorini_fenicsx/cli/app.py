"""The commands of `signorini`, in the groups of its help."""

from collections.abc import Callable
from typing import Annotated

import typer

from signorini_fenicsx.base.version import __version__
from signorini_fenicsx.cli.about import cases, check, info, methods, version
from signorini_fenicsx.cli.comparisons import compare, convergence
from signorini_fenicsx.cli.fields import certify
from signorini_fenicsx.cli.first_case import init
from signorini_fenicsx.cli.solutions import adapt, export, solve
from signorini_fenicsx.cli.studies import study

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)
GROUPS: dict[str, tuple[Callable[..., None], ...]] = {
    "Solve": (solve, adapt, export),
    "Compare and vary": (compare, certify, convergence, study),
    "Cases": (cases, init, info, check),
    "About the program": (methods, version),
}
for group, commands in GROUPS.items():
    for command in commands:
        app.command(rich_help_panel=group)(command)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"signorini_fenicsx {__version__}")
        raise typer.Exit


@app.callback()
def about(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Fully mixed methods for the Signorini problem.

    PETSc options go after --. Configuration files of libraries in the current folder are read only with
    --local-options.
    """
