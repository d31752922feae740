"""TOML files from users: they are read within limits, and errors are told in one sentence."""

import re
import tomllib
from pathlib import Path
from typing import Any

from signorini_fenicsx.base.errors import InputError, reading
from signorini_fenicsx.base.reading import text_of
from signorini_fenicsx.cases.complaints import shown

MAX_DOTS = 500
"""Most dots of a dotted key; Python's time for a key grows with the square of this number."""


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        InputError: If it cannot be read.
    """
    with reading(path):
        if not path.is_file():
            raise InputError("is a folder, not a TOML file" if path.is_dir() else "no such file")
        try:
            text = text_of(path)
            if max(part.count(".") for part in re.split(r"[=,*/+()\n]", text)) > MAX_DOTS:
                raise InputError("a key is nested too deeply")
            return tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            place = re.search(r"at line (\d+)", str(error))
            line = "" if place is None else f": {shown(text.splitlines()[int(place[1]) - 1].strip())}"
            hint = '; texts are in quotation marks, such as f = "sin(x)"' if "Invalid value" in str(error) else ""
            raise InputError(f"not a TOML file: {error}{line}{hint}") from None
        except (UnicodeDecodeError, RecursionError) as error:
            raise InputError(f"not a TOML file: {error}") from None
        except ValueError:  # Python reads at most 4300 digits
            raise InputError("an integer of thousands of digits; numbers are at most 1e308") from None
