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

BACKSLASH = "in paths / takes the place of a backslash, on all systems"
HINTS = {
    "Invalid value": 'texts are in quotation marks, such as f = "sin(x)"',
    "Unescaped": BACKSLASH,
    "Invalid hex": BACKSLASH,
}
"""What is meant where Python's reader of TOML says this."""


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
            hint = next((f"; {right}" for wrong, right in HINTS.items() if wrong in str(error)), "")
            raise InputError(f"not a TOML file: {error}{line}{hint}") from None
        except UnicodeDecodeError as error:
            raise InputError(f"not a TOML file: byte {error.start + 1} is not UTF-8; save it as this") from None
        except RecursionError as error:
            raise InputError(f"not a TOML file: {error}") from None
        except ValueError:  # Python reads at most 4300 digits
            raise InputError("an integer of thousands of digits; numbers are at most 1e308") from None
