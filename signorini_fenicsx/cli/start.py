"""The start of `signorini`: if DOLFINx is not installed, it prints a sentence instead of a traceback."""

import importlib.util
import os
import signal
import sys

NEEDED = ("mpi4py", "petsc4py", "dolfinx")
EXIT_BAD_INPUT = 2


def main() -> None:
    """Entry point; exit status 2 without DOLFINx, or without a home, in which DOLFINx keeps compiled forms.

    On several ranks NumPy and MUMPS have one thread each, unless OMP_NUM_THREADS says otherwise: the threads of one
    rank would wait for those of another one. Until the program listens to signals, SIGINT just ends it.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        sys.stderr.write(
            f"error: DOLFINx is not installed ({', '.join(missing)} not found); install it with "
            "pip install 'signorini_fenicsx[dolfinx]', or use a Python that has it, such as that of Debian's "
            "python3-dolfinx\n"
        )
        sys.exit(EXIT_BAD_INPUT)
    if os.path.expanduser("~") == "~":
        sys.stderr.write("error: HOME is not set, and the system knows no home of this user; set HOME to a folder\n")
        sys.exit(EXIT_BAD_INPUT)
    os.environ.pop("MPLBACKEND", None)  # no window is opened, and Matplotlib refuses some of its values
    from mpi4py import MPI

    if MPI.COMM_WORLD.size > 1:
        os.environ.setdefault("OMP_NUM_THREADS", "1")  # is read when NumPy is imported
    from signorini_fenicsx.cli.main import main as run

    run()
