"""Data shipped with the program: cases, studies, tables, and the names of the cases and studies."""

from pathlib import Path

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import did_you_mean


def data_folder(kind: str) -> Path:
    """Folder of the shipped data (`cases`, `tables`)."""
    return (Path(__file__).parents[1] / "data").resolve() / kind


def case_names() -> list[str]:
    """Names of the shipped cases."""
    return sorted(path.stem for path in data_folder("cases").glob("*.toml"))


def study_names() -> list[str]:
    """Names of the shipped studies."""
    return sorted(path.stem for path in data_folder("studies").glob("*.toml"))


def file_of(kind: str, name_or_path: str | Path) -> Path:
    """The file of a case or study, by the name of a shipped one or by a path.

    Args:
        kind: "case" or "study".
        name_or_path: What the user gave; it is a path if it ends in `.toml` or has a slash.

    Raises:
        InputError: If there is no shipped one with this name.
    """
    text = str(name_or_path)
    if text.endswith(".toml") or "/" in text:
        return Path(text)
    folder, names = {"case": ("cases", case_names()), "study": ("studies", study_names())}[kind]
    if text not in names and Path(text).is_file():
        raise InputError(f"{text}: is no {kind}, a .toml file; `signorini init my-case.toml --mesh {text}` begins one")
    if text not in names:
        meant = did_you_mean(text, names)
        raise InputError(f"unknown {kind} '{text}'; use one of {', '.join(names)} or the path of a .toml file{meant}")
    return data_folder(folder) / f"{text}.toml"
