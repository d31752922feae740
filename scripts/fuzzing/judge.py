"""Runs the program, and judges how it ended, what it printed, and which files it left, changed or lost.

A fresh Python needs seconds to import DOLFINx. So a parent imports it, but does not initialise MPI or PETSc and has no
second thread. For each input it is forked, and the fork initialises them. Heap corruption ends only the fork.
"""

import hashlib
import json
import math
import os
import platform
import re
import resource
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

from fuzzing import OUTPUT, Broken
from signorini_fenicsx.base.errors import EXIT_LATER

ENDINGS = {0: "solved", 1: "failed", 2: "refused"}
CRASHES = re.compile(
    r"Traceback \(most recent|PETSC ERROR|terminate called|corrupted|double free|free\(\): |malloc\(\): |munmap_chunk|"
    r"Segmentation|Fatal Python error|Exception ignored|Abort\(|HDF5-DIAG|core dumped|UCX  ERROR"
)
PLAIN = ("uzawa", "psor", "primal-pdas", "primal-penalty", "slimane")
"""Methods that are judged by their own residuals, not by those of (9)."""
TOLERANCE = 1e-6
MEMORY = 1.5e9
"""Bytes of memory; no input here needs more."""
BAD = ("traceback", "signal", "status", "hang", "memory", "orphan", "wordy", "outside", "lost", "accepted", "untrue")
"""Bad outcomes: a traceback or the abort of a library; a signal; an exit status other than 0, 1, 2; out of time; too
much memory; processes that survive; not one sentence; files in wrong places; files of the user or earlier results lost
or changed; broken input that was not refused; status 0 without a solution."""

type Files = dict[str, str]


@dataclass
class Ending:
    """How a process ended.

    Attributes:
        status: Status of `os.wait4`.
        said: Its standard error.
        late: Whether it ran out of time.
        orphans: Whether processes that it started survived it.
        memory: Peak memory in bytes.
    """

    status: int
    said: str
    late: bool
    orphans: bool
    memory: float


@dataclass
class Verdict:
    """The ending in one word, the bad outcomes, and their details."""

    ending: str
    bad: set[str] = field(default_factory=set)
    details: list[str] = field(default_factory=list)


def snapshot(root: Path) -> Files:
    """All files, folders and links below a folder, each with a digest of its contents."""
    contents: Files = {}
    for place, folders, files in os.walk(root):
        for name in [*folders, *files]:
            path = Path(place, name)
            if path.is_symlink():
                digest = os.readlink(path)
            elif path.is_file():
                digest = hashlib.sha256(path.read_bytes()).hexdigest()
            else:
                digest = "folder" if path.is_dir() else "special"
            contents[str(path.relative_to(root))] = digest
    return contents


def judged(broken: Broken, ending: Ending, before: Files, after: Files, root: Path) -> Verdict:
    """The verdict on one run.

    Args:
        broken: The input.
        ending: How its run ended.
        before: The files below `root` before the run.
        after: The files below `root` after the run.
        root: The folder with the working folder `work` and all other folders of the process.
    """
    verdict = _of_process(ending)

    def blame(kind: str, detail: str) -> None:
        verdict.bad.add(kind)
        verdict.details.append(detail)

    code = os.waitstatus_to_exitcode(ending.status)
    if (
        code in (1, 2, EXIT_LATER)
        and not {"traceback", "status"} & verdict.bad
        and not _is_a_sentence(ending.said, code)
    ):
        blame("wordy", f"said {ending.said[:300]!r}")
    if code == 0 and ending.said.strip() and "--" not in broken.words:
        blame("wordy", f"solved, and said {ending.said[:300]!r}")
    if broken.refused and code in (0, 1):
        blame("accepted", "not refused")
    outside, lost = _files(broken, code, before, after)
    if outside:
        blame("outside", f"left {', '.join(outside[:6])}")
    if lost:
        blame("lost", f"lost or changed {', '.join(lost[:6])}")
    solves = broken.words[0] in ("solve", "adapt", "export") and OUTPUT in broken.words
    if code == 0 and solves and not _has_solved(root / "work" / OUTPUT):
        blame("untrue", "status 0 without a solution that can be trusted")
    if broken.solved and code in (1, 2, EXIT_LATER):
        blame("untrue", f"not solved: {ending.said[:300]!r}")
    return verdict


def _of_process(ending: Ending) -> Verdict:
    code = os.waitstatus_to_exitcode(ending.status)
    if ending.late or code in (-signal.SIGXCPU, -signal.SIGKILL):
        verdict = Verdict("hang", {"hang"}, ["took too long"])
    elif code < 0 or "Caught signal number" in ending.said:  # PETSc catches them and ends with its own status
        name = signal.Signals(-code).name if code < 0 else "caught by PETSc"
        verdict = Verdict("signal", {"signal"}, [f"signal {name}"])
    elif code not in ENDINGS and not (code == EXIT_LATER and "; the solution is in " in ending.said):
        verdict = Verdict("status", {"status"}, [f"exit status {code}"])
    else:
        verdict = Verdict(ENDINGS.get(code, "solved, but not complete"))
    crash = CRASHES.search(ending.said)
    if crash is not None:
        verdict.bad.add("traceback")
        verdict.details.append((ending.said.strip() or crash[0])[-500:])
    if ending.orphans:
        verdict.bad.add("orphan")
    if ending.memory > MEMORY:
        verdict.bad.add("memory")
        verdict.details.append(f"{ending.memory / 1e9:.1f} GB")
    return verdict


def _is_a_sentence(said: str, code: int) -> bool:
    """Whether the output is one line, or typer's usual text about wrong usage."""
    said = said.strip()
    if code == 2 and said.startswith(("Usage: signorini", "╭─ Error ─")):
        return True
    return said.startswith(("error: ", "failed: ")) and "\n" not in said and len(said) < 1200


def _files(broken: Broken, code: int, before: Files, after: Files) -> tuple[list[str], list[str]]:
    """New files in wrong places, and files that are gone or changed."""
    out = f"work/{OUTPUT}"
    own = set() if code == 2 else {out, f"{out}.failed"}
    new = [name for name in after if name not in before and not name.startswith((GUI, *broken.forged))]
    outside = [name for name in new if not any(name == place or name.startswith(place + "/") for place in own)]
    if code not in ENDINGS:  # after a crash there may be a file that it was writing
        outside = [name for name in outside if not name.startswith(f"work/.{OUTPUT}.")]
    changed = [name for name, of in before.items() if after.get(name) != of and not name.startswith(broken.forged)]
    replaced = code in (0, EXIT_LATER) or broken.words[0] == "study"
    lost = [name for name in changed if not (replaced and name.startswith(out + "/") and _is_result(name, out))]
    return outside, lost


def _is_result(name: str, out: str) -> bool:
    """Whether the program has made this file in the output folder; all other files there belong to the user."""
    return not name.removeprefix(out + "/").startswith(USERS)


GUI = "home/.fltk"
"""Gmsh's window preferences, which its library writes when it is loaded."""
USERS = ("photo.png", "raw.bp", "measured.bp", "run.json", "mine")
"""Files of the user in the output folder."""


def put_files_of_the_user(out: Path) -> None:
    """Put files of the user into a results folder, with names like those of results."""
    for name in ("photo.png", "measured.bp", "run.json", "mine.txt"):
        (out / name).write_text(f"{name} is the user's", encoding="utf-8")
    (out / "raw.bp").mkdir()
    (out / "raw.bp" / "data.0").write_text("the user's", encoding="utf-8")


def _has_solved(out: Path) -> bool:
    """Whether a results folder has a solution with small residuals, or states that it has none."""

    def refuse(text: str) -> float:
        raise ValueError(text)

    try:
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"), parse_constant=refuse)
        if not (out / "checkpoint" / "about.json").is_file() and "time" not in summary:
            return False
        if summary["converged"] is not True:
            return summary["converged"] is False
        numbers = [*summary["norms"].values(), *summary["kkt"].values()]
        residuals = [] if summary["algorithm"] in PLAIN else list(summary["kkt"].values())
        return all(math.isfinite(number) for number in numbers) and max(residuals, default=0) <= TOLERANCE
    except (OSError, ValueError, KeyError, TypeError):
        return False


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


NEEDED = ("cases.inspection", "certificate.adaptive", "cli.adapt_report", "cli.comparison_report", "cli.study_report")
NEEDED += ("comparing.comparison", "meshes.meshio_files", "output.checkpoint", "studies.runner")
"""What the commands import when they need it."""


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
    import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
    import petsc4py.lib

    petsc4py.lib.ImportPETSc()  # `from petsc4py import PETSc` would initialise it
    from mpi4py import MPI

    for name in NEEDED:
        import_module(f"signorini_fenicsx.{name}")
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

    def start(
        self,
        words: list[str],
        root: Path,
        done: Callable[[Ending], None],
        *,
        homeless: bool = False,
        seconds: float = WALL_SECONDS,
    ) -> None:
        """Start the program in `root/work`, as soon as the number of processes allows it.

        Args:
            words: Its arguments.
            root: Folder with the folders `work`, `home` and `tmp`, and the file `said` for the output.
            done: Called with its ending.
            homeless: Whether HOME is not set.
            seconds: Time after which it is killed.
        """
        while len(self._running) >= self._jobs:
            self._wait()
        sys.stdout.flush()
        process = os.fork()
        if process == 0:
            _become(words, root, self._ranks, homeless=homeless)
        self._running[process] = Process(root, done, time.monotonic() + seconds)

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
