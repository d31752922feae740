"""What comes with the program: cases, studies, tables, and the names of the cases and studies."""

import sysconfig
from pathlib import Path


def data_folder(kind: str) -> Path:
    """Folder of the shipped data (`cases`, `tables`): the checkout's, or that of the installed package."""
    checkout = Path(__file__).parents[2] / "data" / kind
    return checkout if checkout.is_dir() else Path(sysconfig.get_path("data"), "share", "signorini_fenicsx", kind)


def case_names() -> list[str]:
    """Names of the shipped cases."""
    return sorted(path.stem for path in data_folder("cases").glob("*.toml"))


def study_names() -> list[str]:
    """Names of the shipped studies."""
    return sorted(path.stem for path in data_folder("studies").glob("*.toml"))
