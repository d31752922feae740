"""The commands of `signorini`, in the order of its help."""

import typer

from signorini_fenicsx.cli.about import cases, check, info, methods, version
from signorini_fenicsx.cli.comparisons import compare, convergence
from signorini_fenicsx.cli.solutions import adapt, export, solve
from signorini_fenicsx.cli.studies import study

app = typer.Typer(
    help="Fully mixed methods for the Signorini problem. PETSc options go after --. "
    "Configuration files of libraries in the current folder are read only with --local-options.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
for command in (solve, adapt, export, compare, convergence, study, cases, methods, info, check, version):
    app.command()(command)
