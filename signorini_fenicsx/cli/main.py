"""The entry point of `signorini`. PETSc options go after `--`: `signorini solve example1 -- -ksp_monitor`."""

import atexit
import errno
import gc
import io
import itertools
import os
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np
import petsc4py
import typer
from mpi4py import MPI
from rich.console import Console

from signorini_fenicsx.base import local_options, progress
from signorini_fenicsx.base.errors import (
    EXIT_BAD_INPUT,
    EXIT_FAILED,
    EXIT_LATER,
    InputError,
    LaterFailure,
    NumericalFailure,
    in_words,
)
from signorini_fenicsx.base.parallel import FORWARDING, abort_all_on_exception, end_all, on_root, refuse_lone_copies
from signorini_fenicsx.base.signals import Interruption, listen_again, listening, outlive_readers
from signorini_fenicsx.base.text import printable
from signorini_fenicsx.cli.app import app

LOCAL = "--local-options"
"""Any command takes this word: configuration files of libraries in the current folder are read, see `local_options`."""
MAX_WORDS = 800, 200
"""Most characters of a message that are shown, from its beginning and from its end."""


def _run(command: Callable[[], object]) -> int:
    """Run the command on all ranks and turn expected failures into exit statuses."""
    try:
        command()
    except InputError as error:
        _complain("error", str(error))
        return EXIT_BAD_INPUT
    except NumericalFailure as failure:
        _complain("failed", str(failure))
        return EXIT_LATER if isinstance(failure, LaterFailure) else EXIT_FAILED
    except OSError as error:  # a full disk, a folder that is gone; an impossible path
        is_input = error.errno == errno.ENAMETOOLONG
        _complain("error" if is_input else "failed", in_words(error))
        return EXIT_BAD_INPUT if is_input else EXIT_FAILED
    except RuntimeError as error:
        from signorini_fenicsx.linear.petsc import refuse_options

        try:
            refuse_options(error)
        except InputError as refusal:
            _complain("error", str(refusal))
            return EXIT_BAD_INPUT
        raise
    except Interruption as interruption:
        _complain("failed", str(interruption))
        _end_others(MPI.COMM_WORLD, interruption)
        return EXIT_FAILED
    except SystemExit as request:  # typer: usage errors and --help
        return request.code if isinstance(request.code, int) else EXIT_BAD_INPUT
    return 0


def _end_others(comm: MPI.Comm, interruption: Interruption) -> None:
    """End all ranks, because the signal may not have reached the others; rank 0 prints the message if it got it."""
    if comm.size > 1 and comm.rank > 0:
        time.sleep(2 * FORWARDING)
        end_all(comm, f"failed: rank {comm.rank} was {interruption}\n")
    if comm.size > 1:
        end_all(comm, "")


def _complain(kind: str, message: str) -> None:
    console = Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)
    console.print(f"{kind}:", style="bold red", end=" ")
    words, (first, last) = printable(" ".join(message.split())), MAX_WORDS
    console.print(words if len(words) <= first + last else f"{words[:first]} … {words[-last:]}", markup=False)


def main() -> None:
    """Entry point: PETSc gets the options after `--`, the command those before it; only rank 0 prints."""
    arguments, petsc_options = sys.argv[1:], []
    if "--" in arguments:
        split = arguments.index("--")
        arguments, petsc_options = arguments[:split], arguments[split + 1 :]
    local = LOCAL in arguments
    arguments = [argument for argument in arguments if argument != LOCAL]
    comm = MPI.COMM_WORLD
    abort_all_on_exception(comm)
    gc.disable()  # see `parallel.collect_garbage`
    atexit.register(gc.freeze)  # else Python's last act is to look through all objects, for more than 0.1 seconds
    if comm.rank != 0:
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - for the life of the process
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # do not fail on a terminal without Unicode
    command = typer.main.get_command(app)  # calling app itself would replace sys.excepthook

    def run() -> None:
        refuse_lone_copies(comm)
        for word in sys.argv:
            if not word.isascii() and word != word.encode(errors="replace").decode():
                raise InputError(f"'{word}': is not in UTF-8, which all names and texts have to be")
        if local:
            on_root(comm, local_options.check)
        else:
            local_options.ignore()
        _start_petsc(local_options.with_whole_paths(petsc_options), comm)
        listen_again()
        outlive_readers()
        command(args=arguments, prog_name="signorini")

    with listening(), np.errstate(all="ignore"):  # values that are not finite are reported in a sentence
        status = _run(run)
    progress.follow(None)
    sys.exit(status)


def _start_petsc(options: list[str], comm: MPI.Comm) -> None:
    """Start PETSc with its options; what it prints about an error goes into the error message.

    Some errors occur on rank 0 only, which then ends all ranks.

    Raises:
        InputError: If PETSc cannot start with these options.
    """
    failure: InputError | None = None
    with tempfile.TemporaryFile("w+", errors="replace") as words:
        stderr = os.dup(2)
        os.dup2(words.fileno(), 2)
        try:
            with local_options.unseen():
                petsc4py.init([sys.argv[0], *options])
        except RuntimeError as error:
            words.seek(0)
            said = [line.partition("ERROR: ")[2].strip() for line in words if "ERROR: " in line and "---" not in line]
            reason = ", ".join(itertools.takewhile(lambda line: not line.startswith("See "), said))
            failure = InputError(f"PETSc cannot start with its options: {reason or error}")
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
    if failure is not None and comm.size > 1:
        _complain("error", str(failure))
        end_all(comm, "", EXIT_BAD_INPUT)
    if failure is not None:
        raise failure
