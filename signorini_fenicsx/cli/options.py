"""Arguments and options of several commands, and the reading of their texts."""

import inspect
import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.shipped import case_names

METHOD = "Method"
BOUND = "Bound of the error"
RESULTS = "Results"
"""Groups of options in the help of commands."""


def _names_of_algorithms() -> list[str]:
    from signorini_fenicsx.methods.registry import METHODS

    return list(METHODS)


CaseName = Annotated[
    str,
    typer.Argument(
        help="Name of a shipped case (example1 … example6) or path of a .toml file.", autocompletion=case_names
    ),
]
AlgorithmName = Annotated[
    str | None,
    typer.Option(
        "--algorithm",
        help="An algorithm of the list of `signorini methods`.",
        autocompletion=_names_of_algorithms,
        rich_help_panel=METHOD,
    ),
]
MeshSize = Annotated[str | None, typer.Option("--h", help="Largest cell diameter: 0.0625, 1/16 or 2^-4.")]
Rho = Annotated[
    str | None, typer.Option("--rho", help="ρ > 0 of the set rule or the Uzawa iteration.", rich_help_panel=METHOD)
]
Epsilon = Annotated[
    str | None, typer.Option("--eps", help="ε of the penalty and stabilised methods.", rich_help_panel=METHOD)
]
BackendName = Annotated[
    str | None, typer.Option("--backend", help="hybrid or mixed; only for alg1 to alg4.", rich_help_panel=METHOD)
]
ElementName = Annotated[
    str | None,
    typer.Option("--element", help="RT0, or RT1 of one order more; alg1 to alg4 and vi.", rich_help_panel=METHOD),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Any other key of the case, e.g. geometry.mesh=structured."),
]
OF_CASE = {
    "algorithm": AlgorithmName,
    "h": MeshSize,
    "rho": Rho,
    "eps": Epsilon,
    "backend": BackendName,
    "element": ElementName,
    "settings": Settings,
}
"""Options of commands that take a case, which give it new values; they are None if they are not given."""
ForSignorini = Annotated[
    bool,
    typer.Option(
        "--for-signorini",
        help="Bound the distance of a penalty solution to the Signorini solution.",
        rich_help_panel=BOUND,
    ),
]
Predict = Annotated[
    bool, typer.Option(help="Start large problems from the sets of a coarser mesh.", rich_help_panel=METHOD)
]
StartFrom = Annotated[
    Path | None,
    typer.Option(
        "--start-from",
        help="Results folder whose contact set is the first one; in time u_0, too.",
        rich_help_panel=METHOD,
    ),
]
Rigorous = Annotated[
    bool, typer.Option("--rigorous", help="Also prove the error bound, rounding included.", rich_help_panel=BOUND)
]
Restart = Annotated[
    bool,
    typer.Option("--restart", help="Go on with a case in time after its last complete step.", rich_help_panel=RESULTS),
]
CertifySteps = Annotated[
    bool, typer.Option("--certify-steps", help="Bound the error of each step of a case in time.", rich_help_panel=BOUND)
]
Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose", "-v", help="Print all iterations, and how long each phase takes.", rich_help_panel=RESULTS
    ),
]
Plot = Annotated[bool, typer.Option("--plot", help="Also draw pictures (PNG).", rich_help_panel=RESULTS)]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only errors.", rich_help_panel=RESULTS)]
Json = Annotated[bool, typer.Option("--json", help="Print only one JSON object, the summary.", rich_help_panel=RESULTS)]
Html = Annotated[
    bool,
    typer.Option("--html", help="Also write solution.html, pictures that the mouse can turn.", rich_help_panel=RESULTS),
]
OutputFolder = Annotated[
    Path | None, typer.Option("--output", help="Folder for the results.", show_default=False, rich_help_panel=RESULTS)
]


def of_case[C: Callable[..., None]](command: C) -> C:
    """A command with `OF_CASE` in the place of its `**new`; those that it names itself are its own."""
    case, *own, _ = inspect.signature(command).parameters.values()
    named, keyword = [each.name for each in own], inspect.Parameter.KEYWORD_ONLY
    new = [inspect.Parameter(name, keyword, annotation=kind) for name, kind in OF_CASE.items() if name not in named]
    new = [each.replace(default=None) for each in new]
    parameters = [case, *new, *(each.replace(kind=keyword) for each in own)]
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return command


def overrides(settings: list[str] | None = None, **options: object) -> dict[str, object]:
    """New values of keys of a case.

    Args:
        settings: Values of `--set`, as KEY=VALUE.
        options: Values of keys of [solve] that have their own options; None if not given.

    Raises:
        InputError: If a setting is not KEY=VALUE.
    """
    values: dict[str, object] = {}
    for setting in settings or []:
        key, separator, value = setting.partition("=")
        if not separator or not key:
            raise InputError(f"--set {setting}: must be KEY=VALUE, such as geometry.mesh=structured")
        values[key] = _toml_value(value)
    return values | {f"solve.{name}": value for name, value in options.items() if value is not None}


def _toml_value(text: str) -> object:
    """A value in TOML's notation, such as ["top", "left"]; any other text stays text."""
    try:
        tree = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return tree["value"] if len(tree) == 1 else text


def positive(option: str, text: str) -> float:
    """The positive number that an option gives.

    Raises:
        InputError: If it is not a positive number.
    """
    from signorini_fenicsx.expressions import parse_number

    try:
        value = parse_number(text)
    except InputError as error:
        raise InputError(f"{option}: {error}") from None
    if not 0 < value < math.inf:
        raise InputError(f"{option} {text}: must be greater than 0")
    return value
