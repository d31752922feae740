"""The start of `signorini`: if DOLFINx is not installed, it prints a sentence instead of a traceback."""

import importlib.util
import sys

NEEDED = ("mpi4py", "petsc4py", "dolfinx")
EXIT_BAD_INPUT = 2


def main() -> None:
    """Entry point; exit status 2 without DOLFINx."""
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        sys.stderr.write(
            f"error: DOLFINx is not installed ({', '.join(missing)} not found); install it with "
            "pip install 'signorini_fenicsx[dolfinx]', or use a Python that has it, such as that of Debian's "
            "python3-dolfinx\n"
        )
        sys.exit(EXIT_BAD_INPUT)
    from signorini_fenicsx.cli.main import main as run

    run()
