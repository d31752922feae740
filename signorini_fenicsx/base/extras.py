"""Packages that one option alone needs; a small installation leaves them out."""

import importlib.util

from signorini_fenicsx.base.errors import InputError

EXTRAS = {"--html": ("plotly", "html"), "--rigorous": ("flint", "rigorous")}
"""For an option the module it needs, and the extra of this package that installs it."""


def check_installed(option: str) -> None:
    """Refuse an option whose package is not installed.

    Raises:
        InputError: If it is not.
    """
    module, extra = EXTRAS.get(option, ("", ""))
    if module and importlib.util.find_spec(module) is None:
        raise InputError(
            f"{option}: needs a package that is not installed; `pip install 'signorini_fenicsx[{extra}]'` adds it"
        )
