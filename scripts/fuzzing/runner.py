"""Runs the program in processes that are forked from a parent that has imported everything and initialised nothing.

A fresh Python needs seconds to import DOLFINx. So the parent imports it, but does not initialise MPI or PETSc and has
no second thread. For each input it is forked, and the fork initialises them. Heap corruption ends only the fork.
"""

import os
import platform
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from fuzzing.judge import Ending

CPU_SECONDS, WALL_SECONDS = 30, 150
ADDRESSES, FILE_SIZE = 16 * 2**30, 2**28
ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NO_COLOR": "1",
    "TERM": "dumb",
    "MALLOC_PERTURB_": "165",  # freed and uninitialised memory is not zero
}
HEAP_CHECK = {"MALLOC_CHECK_": "3", "LD_PRELOAD": "libc_malloc_debug.so.0"}
"""glibc's own check of the heap, where it is installed."""
LIBRARIES = (f"/lib/{platform.machine()}-linux-gnu", "/lib64", "/usr/lib")


def begin_again() -> None:
    """Replace this process by one with the environment for fuzzing; in that process return at once."""
    wanted = ENVIRONMENT | {"XDG_CACHE_HOME": os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))}
    if any(Path(folder, HEAP_CHECK["LD_PRELOAD"]).exists() for folder in LIBRARIES):
        wanted |= HEAP_CHECK
    if not wanted.items() <= os.environ.items():
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | wanted)


def import_everything(pencil: Path) -> None:
    """Import the program without initialising MPI or PETSc.

    Args:
        pencil: Folder for the files that Matplotlib keeps in the home folder.

    Raises:
        SystemExit: If one of them is initialised, or there are threads, which a fork would lose.
    """
    os.environ["MPLCONFIGDIR"] = str(pencil)
    import mpi4py

    mpi4py.rc.initialize, mpi4py.rc.finalize = False, True
    import signorini_fenicsx  # isort: skip
    import petsc4py.lib

    petsc4py.lib.ImportPETSc()  # `from petsc4py import PETSc` would initialise it
    from mpi4py import MPI

    import signorini_fenicsx.cases.inspection
    import signorini_fenicsx.certificate.adaptive
    import signorini_fenicsx.cli.adapt_report
    import signorini_fenicsx.cli.comparison_report
    import signorini_fenicsx.cli.study_report
    import signorini_fenicsx.comparing.comparison
    import signorini_fenicsx.meshes.meshio_files
    import signorini_fenicsx.output.checkpoint
    import signorini_fenicsx.studies.runner  # noqa: F401 - what the commands import when they need it

    if MPI.Is_initialized() or len(os.listdir("/proc/self/task")) > 1:
        sys.exit("MPI or a thread has begun too early: nothing can be forked")


def make_folders(root: Path) -> None:
    """Make the folders of an input: those of its run, and one for what it says."""
    for folder in ("work", "home", "tmp", "said"):
        (root / folder).mkdir(parents=True)


@dataclass
class Process:
    """A running input: its process, the function to call when it has ended, and its time limit."""

    root: Path
    done: Callable[[Ending], None]
    until: float
    late: bool = False


class Runner:
    """Runs up to a given number of processes at a time."""

    def __init__(self, jobs: int, ranks: int):
        self._jobs = jobs
        self._ranks = ranks
        self._running: dict[int, Process] = {}

    def start(self, words: list[str], root: Path, done: Callable[[Ending], None], *, homeless: bool = False) -> None:
        """Start the program in `root/work`, as soon as the number of processes allows it.

        Args:
            words: Its arguments.
            root: Folder with the folders `work`, `home` and `tmp`, and the file `said` for the output.
            done: Called with its ending.
            homeless: Whether HOME is not set.
        """
        while len(self._running) >= self._jobs:
            self._wait()
        sys.stdout.flush()
        process = os.fork()
        if process == 0:
            _become(words, root, self._ranks, homeless=homeless)
        self._running[process] = Process(root, done, time.monotonic() + WALL_SECONDS)

    def finish(self) -> None:
        """Wait until all have ended."""
        while self._running:
            self._wait()

    def _wait(self) -> None:
        for process, about in list(self._running.items()):
            ended, status, used = os.wait4(process, os.WNOHANG)
            if ended:
                del self._running[process]
                orphans = _end_all(process) and not about.late
                said = (about.root / "said" / "stderr").read_text(encoding="utf-8", errors="replace")
                about.done(Ending(status, said, about.late, orphans, 1024.0 * used.ru_maxrss))
                return
            if time.monotonic() > about.until:
                about.late = True
                _end_all(process)
        time.sleep(0.01)


def _end_all(group: int) -> bool:
    """End all remaining processes of a group; return whether there were any."""
    try:
        os.killpg(group, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def _become(words: list[str], root: Path, ranks: int, *, homeless: bool) -> None:
    """Become the program in a new process, and end like a program, so that errors at the end are seen too."""
    os.setsid()
    os.chdir(root / "work")
    os.environ |= {"HOME": str(root / "home"), "TMPDIR": str(root / "tmp")}
    if homeless:
        del os.environ["HOME"]
    said = [os.open(root / "said" / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC) for name in ("stdout", "stderr")]
    for number, file in enumerate([os.open(os.devnull, os.O_RDONLY), *said]):
        os.dup2(file, number)
    for kind, most in (
        (resource.RLIMIT_CPU, CPU_SECONDS * ranks),
        (resource.RLIMIT_AS, ADDRESSES),
        (resource.RLIMIT_FSIZE, FILE_SIZE),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(kind, (most, most))
    if ranks > 1:
        os.execvp("mpirun", ["mpirun", "-n", str(ranks), "signorini", *words])
    sys.argv = [str(Path(sys.executable).with_name("signorini")), *words]
    from mpi4py import MPI

    from signorini_fenicsx.cli.main import main

    MPI.Init_thread()
    main()
    sys.exit(0)


def numbered(count: int, kinds: list[str]) -> Iterator[tuple[str, int]]:
    """The kinds in turn, with the inputs of each kind numbered from 0."""
    for number in range(count):
        yield kinds[number % len(kinds)], number // len(kinds)
