"""What varies in a study: the keys in which its runs differ, and their values in words."""

from collections.abc import Mapping, Sequence
from typing import Any

from signorini_fenicsx.studies.study import Run

SOLVE = "solve."


def varied_keys(runs: Sequence[Run]) -> list[str]:
    """The keys in which runs differ, the case first; other keys than those of [solve] not where the case tells them."""
    parameters = [run.parameters for run in runs]
    keys = dict.fromkeys(key for values in parameters for key in values)
    varied = [key for key in keys if len({str(values.get(key)) for values in parameters}) > 1]
    if "case" not in varied:
        return varied
    return [key for key in varied if key == "case" or key.startswith(SOLVE) or not follows(parameters, key, "case")]


def follows(rows: Sequence[Mapping[str, Any]], key: str, other: str) -> bool:
    """Whether in these rows the value of another key tells that of a key."""
    pairs = {(str(row.get(other)), str(row.get(key))) for row in rows}
    return len(pairs) == len({first for first, _ in pairs})


def short(key: str, keys: Sequence[str]) -> str:
    """The last word of a key, if no other of these keys has it, too."""
    word = key.rpartition(".")[2]
    return word if [other.rpartition(".")[2] for other in keys].count(word) == 1 else key.removeprefix(SOLVE)


def in_words(run: Run, keys: Sequence[str]) -> str:
    """The values of these keys in a run; without keys the name of its case."""
    values: Mapping[str, Any] = run.parameters
    words = [f"{short(key, keys)} = {value_in_words(values[key])}" for key in keys if key in values]
    return "  ".join(words) or run.case.name


def value_in_words(value: object) -> str:
    """A value, numbers as short as possible."""
    return f"{value:g}" if isinstance(value, float) else str(value)
