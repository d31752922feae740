"""What came out of a run: how it ended, what it said, and which files it left, changed or lost."""

import hashlib
import json
import math
import os
import re
import signal
from dataclasses import dataclass, field
from pathlib import Path

from fuzzing.broken import OUTPUT, Broken

ENDINGS = {0: "solved", 1: "failed", 2: "refused"}
CRASHES = re.compile(
    r"Traceback \(most recent|PETSC ERROR|terminate called|corrupted|double free|free\(\): |malloc\(\): |munmap_chunk|"
    r"Segmentation|Fatal Python error|Exception ignored|Abort\(|HDF5-DIAG|core dumped|UCX  ERROR"
)
PLAIN = ("uzawa", "psor", "primal-pdas", "primal-penalty", "slimane")
"""Methods that pass residuals of their own, not those of (9)."""
TOLERANCE = 1e-6
MEMORY = 1.5e9
"""Bytes that no input here needs."""
BAD = ("traceback", "signal", "status", "hang", "memory", "orphan", "wordy", "outside", "lost", "accepted", "untrue")
"""Bad outcomes: a traceback or a library's last words; a signal; another exit status than 0, 1, 2; out of time; too
much memory; processes left; not one sentence; files where none belong; files of the user or earlier results lost or
changed; broken input that was not refused; status 0 without a solution."""

type Files = dict[str, str]


@dataclass
class Ending:
    """How a process ended.

    Attributes:
        status: Of `os.wait4`.
        said: Its standard error.
        late: Whether its time was over.
        orphans: Whether processes of its own outlived it.
        memory: Bytes that it had at most.
    """

    status: int
    said: str
    late: bool
    orphans: bool
    memory: float


@dataclass
class Verdict:
    """The ending in a word, what was bad, and the details of that."""

    ending: str
    bad: set[str] = field(default_factory=set)
    details: list[str] = field(default_factory=list)


def snapshot(root: Path) -> Files:
    """All files, folders and links below a folder, each with a digest of what it holds."""
    found: Files = {}
    for place, folders, files in os.walk(root):
        for name in [*folders, *files]:
            path = Path(place, name)
            if path.is_symlink():
                digest = os.readlink(path)
            elif path.is_file():
                digest = hashlib.sha256(path.read_bytes()).hexdigest()
            else:
                digest = "folder" if path.is_dir() else "special"
            found[str(path.relative_to(root))] = digest
    return found


def judged(broken: Broken, ending: Ending, before: Files, after: Files, root: Path) -> Verdict:
    """The verdict on one run.

    Args:
        broken: What was run.
        ending: How it ended.
        before: The files below root before.
        after: And afterwards.
        root: The folder with the working folder `work` and all others that the process was to use.
    """
    verdict = _of_process(ending)

    def blame(kind: str, detail: str) -> None:
        verdict.bad.add(kind)
        verdict.details.append(detail)

    code = os.waitstatus_to_exitcode(ending.status)
    if code in (1, 2) and "traceback" not in verdict.bad and not _is_a_sentence(ending.said, code):
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
    return verdict


def _of_process(ending: Ending) -> Verdict:
    code = os.waitstatus_to_exitcode(ending.status)
    if ending.late or code in (-signal.SIGXCPU, -signal.SIGKILL):
        verdict = Verdict("hang", {"hang"}, ["took too long"])
    elif code < 0 or "Caught signal number" in ending.said:  # PETSc catches them and ends with a status of its own
        name = signal.Signals(-code).name if code < 0 else "caught by PETSc"
        verdict = Verdict("signal", {"signal"}, [f"signal {name}"])
    elif code not in ENDINGS:
        verdict = Verdict("status", {"status"}, [f"exit status {code}"])
    else:
        verdict = Verdict(ENDINGS[code])
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
    """One line; or typer's words about a wrong usage, as everybody is used to."""
    said = said.strip()
    if code == 2 and said.startswith(("Usage: signorini", "╭─ Error ─")):
        return True
    return said.startswith(("error: ", "failed: ")) and "\n" not in said and len(said) < 1200


def _files(broken: Broken, code: int, before: Files, after: Files) -> tuple[list[str], list[str]]:
    """Files that appeared where none belong, and files that are gone or others."""
    out = f"work/{OUTPUT}"
    own = set() if code == 2 else {out, f"{out}.failed"}
    new = [name for name in after if name not in before and not name.startswith(GUI)]
    outside = [name for name in new if not any(name == place or name.startswith(place + "/") for place in own)]
    if code not in ENDINGS:  # what it was writing when it died is named after its place
        outside = [name for name in outside if not name.startswith(f"work/.{OUTPUT}.")]
    changed = [name for name, digest in before.items() if after.get(name) != digest]
    replaced = code == 0 or broken.words[0] == "study"
    lost = [name for name in changed if not (replaced and name.startswith(out + "/") and _is_result(name, out))]
    return outside, lost


def _is_result(name: str, out: str) -> bool:
    """Whether the program has made this file in the output folder; all others there are the user's."""
    return not name.removeprefix(out + "/").startswith(USERS)


GUI = "home/.fltk"
"""The preferences of Gmsh's windows, which its library writes when it is loaded."""
USERS = ("photo.png", "raw.bp", "measured.bp", "run.json", "mine")
"""What the user keeps in the output folder."""


def put_files_of_the_user(out: Path) -> None:
    """Put files of the user into a results folder, with names like those of results."""
    for name in ("photo.png", "measured.bp", "run.json", "mine.txt"):
        (out / name).write_text(f"{name} is the user's", encoding="utf-8")
    (out / "raw.bp").mkdir()
    (out / "raw.bp" / "data.0").write_text("the user's", encoding="utf-8")


def _has_solved(out: Path) -> bool:
    """Whether a results folder holds a solution whose residuals are small, or says that it holds none."""

    def refuse(text: str) -> float:
        raise ValueError(text)

    try:
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"), parse_constant=refuse)
        if not (out / "checkpoint.npz").is_file():
            return False
        if summary["converged"] is not True:
            return summary["converged"] is False
        numbers = [*summary["norms"].values(), *summary["kkt"].values()]
        residuals = [] if summary["algorithm"] in PLAIN else list(summary["kkt"].values())
        return all(math.isfinite(number) for number in numbers) and max(residuals, default=0) <= TOLERANCE
    except (OSError, ValueError, KeyError, TypeError):
        return False
