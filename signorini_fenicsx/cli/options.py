"""Arguments and options of several commands, and the reading of their texts."""

import inspect
import math
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from signorini_fenicsx.base.errors import InputError, telling
from signorini_fenicsx.base.shipped import case_names

_method, _bound, _results = (
    partial(typer.Option, rich_help_panel=panel) for panel in ("Method", "Bound of the error", "Results")
)
"""Options of the groups in the help of commands."""


def _names_of_algorithms() -> list[str]:
    from signorini_fenicsx.methods.registry import METHODS

    return list(METHODS)


OF_NAME = "Name of a shipped case (example1 … example6) or path of a .toml file."
CaseName = Annotated[str, typer.Argument(help=OF_NAME, autocompletion=case_names)]
LISTED = "An algorithm of the list of `signorini methods`."
AlgorithmName = Annotated[str | None, _method("--algorithm", help=LISTED, autocompletion=_names_of_algorithms)]
MeshSize = Annotated[str | None, typer.Option("--h", help="Largest cell diameter: 0.0625, 1/16 or 2^-4.")]
Rho = Annotated[str | None, _method("--rho", help="ρ > 0 of the set rule or the Uzawa iteration.")]
Epsilon = Annotated[str | None, _method("--eps", help="ε of the penalty and stabilised methods.")]
BackendName = Annotated[str | None, _method("--backend", help="hybrid or mixed; only for alg1 to alg4.")]
ElementName = Annotated[str | None, _method("--element", help="RT0, or RT1 of one order more; alg1 to alg4 and vi.")]
OTHERS = "Any other key of the case, e.g. geometry.mesh=structured."
Settings = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help=OTHERS)]
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
OF_PENALTY = "Bound the distance of a penalty solution to the Signorini solution."
ForSignorini = Annotated[bool, _bound("--for-signorini", help=OF_PENALTY)]
Predict = Annotated[bool, _method(help="Start large problems from the sets of a coarser mesh.")]
EARLIER = "Results folder whose contact set is the first one; in time u_0, too."
StartFrom = Annotated[Path | None, _method("--start-from", help=EARLIER)]
Rigorous = Annotated[bool, _bound("--rigorous", help="Also prove the error bound, rounding included.")]
Restart = Annotated[bool, _results("--restart", help="Go on with a case in time after its last complete step.")]
CertifySteps = Annotated[bool, _bound("--certify-steps", help="Bound the error of each step of a case in time.")]
Verbose = Annotated[bool, _results("--verbose", "-v", help="Print all iterations, and how long each phase takes.")]
Plot = Annotated[bool, _results("--plot", help="Also draw pictures (PNG).")]
Quiet = Annotated[bool, _results("--quiet", "-q", help="Print only errors.")]
Json = Annotated[bool, _results("--json", help="Print only one JSON object, the summary.")]
Html = Annotated[bool, _results("--html", help="Also write solution.html, pictures that the mouse can turn.")]
OutputFolder = Annotated[Path | None, _results("--output", help="Folder for the results.", show_default=False)]


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
        InputError: If a setting is not KEY=VALUE, or a key has two values.
    """
    values: dict[str, object] = {f"solve.{name}": value for name, value in options.items() if value is not None}
    for setting in settings or []:
        key, separator, value = setting.partition("=")
        if not separator or not key:
            raise InputError(f"--set {setting}: must be KEY=VALUE, such as geometry.mesh=structured")
        if key in values:
            raise InputError(f"--set {setting}: {key} has the value {values[key]!r} already; give one of them")
        values[key] = _toml_value(value)
    return values


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

    with telling(option):
        value = parse_number(text)
    if not 0 < value < math.inf:
        raise InputError(f"{option} {text}: must be greater than 0")
    return value
