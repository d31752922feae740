"""Files in the current folder that configure PETSc, DOLFINx and FFCx: a folder of others may hold them.

They can run code and change results. So the command line lets the libraries read them only if it is asked to; those in
the user's home are always read.
"""

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path

from signorini_fenicsx.base.errors import InputError, reading
from signorini_fenicsx.base.reading import text_of

PETSC = (".petscrc", "petscrc")
JSON = ("dolfinx_jit_options.json", "ffcx_options.json")
IGNORED = {"local": False}
"""Whether DOLFINx and FFCx must not see the files; on all ranks the same."""


def ignore() -> None:
    """Keep all libraries from reading option files; call this before PETSc starts and DOLFINx is imported."""
    IGNORED["local"] = True


def with_whole_paths(options: list[str]) -> list[str]:
    """PETSc's options, with paths of files of options that do not depend on the current folder."""
    before = ["", *options]
    return [
        os.path.abspath(word) if last == "-options_file" else word for last, word in zip(before, options, strict=False)
    ]


def check() -> None:
    """Refuse files that the libraries would wait for, or end with a traceback of.

    Raises:
        InputError: If one is not a small regular file, or not a JSON object.
    """
    for name in (*PETSC, *JSON):
        with reading(name), contextlib.suppress(FileNotFoundError):
            try:
                text = text_of(name)
                if name in JSON and not isinstance(json.loads(text), dict):
                    raise ValueError
            except (ValueError, RecursionError):
                raise InputError(f"is not {'a JSON object' if name in JSON else 'UTF-8'}") from None


@contextlib.contextmanager
def unseen() -> Iterator[None]:
    """Work in a folder without option files while these are ignored, so that libraries find none."""
    with contextlib.chdir(Path(__file__).parent) if IGNORED["local"] else contextlib.nullcontext():
        yield
