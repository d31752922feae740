"""The way of finished files to their place, safe even if the program is killed, and without touching files of the user.

A run with results in `x` works in the folder `.x.partial` beside it. There is a lock, which the system releases when
the process dies, and a folder into which the files are written. When all files are there, this folder is renamed to
`done` or `failed`. From then on the result is complete, and its files are moved one by one to `x` or `x.failed`. If the
program is killed during this, the next program that *writes* into `x` goes on with it; a program that only reads
changes nothing. The list of the files is moved last; only files on the list of an earlier run are ever replaced or
removed.

All three folders may come from somebody else. So every change is one of a name in an open folder, and folders are
opened one below the other, none of them through a link, see `folder_below`: what is outside of `x`, `x.failed` and
`.x.partial` cannot be reached. All functions are for rank 0.
"""

import contextlib
import errno
import fcntl
import functools
import itertools
import json
import os
import shutil
import stat
import time
from collections.abc import Iterator, Set
from pathlib import Path, PurePosixPath

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.reading import text_of

MANIFEST = "files.json"
"""Lists the files in a results folder that the program wrote."""

PICTURES = (
    *("overview", "u", "sigma", "signorini", "iterations", "certificate", "deformed", "displacement", "pressure"),
    *("contact", "pairs", "phreatic", "probes", "quantities", "fronts", "forces", "steps", "field"),
    *("adapt", "mesh", "convergence"),
)
TABLES = (
    *("facets", "contact", "pairs", "vertices", "free_boundary", "probes", "sections", "phreatic"),
    *("history", "steps", "adapt", "convergence"),
)
SERIES = ("solution", "multiplier", "contact")
OWN = (
    *("checkpoint/about.json", "summary.json", "solution.h5", "show.py", "solution.html", "animation.gif"),
    *(f"{name}.csv" for name in TABLES),
    *(f"{name}.parquet" for name in TABLES),
    *(f"{name}.png" for name in PICTURES),
    *(f"{name}.xdmf" for name in (*SERIES, "boundary", "phreatic")),
    *(f"{name}.bp/{part}" for name in SERIES for part in ("data.0", "md.0", "md.idx", "mmd.0", "profiling.json")),
    "convergence.tex",
)
"""Names of files that the program writes: files of the user with these names are told of before anything is solved."""

PARTIAL, LOCK, DONE, FAILED, STEPS = ".partial", "lock", "done", "failed", ".steps"
PATIENCE = 1.0
"""Seconds to wait for a program that moves its files; it needs less."""
NO_FOLDER = (errno.ENOTDIR, errno.ELOOP)
"""Errors of opening a file or a link as a folder."""


def failed_place(target: Path) -> Path:
    """The folder in which the state of a failed run is kept."""
    return target.with_name(target.name + ".failed")


def area_of(target: Path) -> Path:
    """The folder in which runs with this target work."""
    return target.with_name(f".{target.name}{PARTIAL}")


@contextlib.contextmanager
def folder_below(at: int | Path, name: str = "", *, make: bool = False) -> Iterator[int]:
    """Open a folder below another one, one part of the name after the other, and none of them through a link.

    Args:
        at: The other folder: open, or its path, in which links are followed.
        name: Name of the folder in it, with slashes; empty for `at` itself.
        make: Make what is missing.

    Raises:
        OSError: If it is missing (ENOENT), or a part of the name is not a folder but a file or a link (NO_FOLDER).
    """
    folder = os.dup(at) if isinstance(at, int) else os.open(at, os.O_RDONLY | os.O_DIRECTORY)
    try:
        for part in _parts(name):
            if make:
                with contextlib.suppress(FileExistsError):
                    os.mkdir(part, dir_fd=folder)
            inner = os.open(part, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=folder)
            os.close(folder)
            folder = inner
        yield folder
    finally:
        os.close(folder)


def kind_of(at: int, name: str) -> int:
    """The kind of what has this name in an open folder, see `stat.S_IFMT`; 0 if there is nothing.

    A link is a link, whatever it leads to; what lies in a file or behind a link is nothing.
    """
    *above, last = _parts(name) or ("",)
    try:
        with folder_below(at, "/".join(above)) as folder:
            return stat.S_IFMT(os.lstat(last, dir_fd=folder).st_mode)
    except OSError as error:
        if error.errno in (errno.ENOENT, *NO_FOLDER):
            return 0
        raise


def is_file(at: int, name: str) -> bool:
    """Whether a name in an open folder is that of a file, not of a link to one."""
    return kind_of(at, name) == stat.S_IFREG


def delete(path: Path) -> None:
    """Remove a file or a link, or a folder with all that is in it; links in it are not followed."""
    with folder_below(path.parent) as above:
        _delete(above, path.name)


class Area:
    """The folder in which a run works, beside its target; a context manager that keeps its lock.

    Attributes:
        target: The results folder.
        path: The folder beside it.
    """

    def __init__(self, target: Path, patience: float = PATIENCE):
        """Make the folder, if there is none, and lock it.

        Raises:
            BlockingIOError: If another process keeps the lock for so many seconds.
            InputError: If the folder is not one of this program.
            OSError: If this is not possible, for example because the file system has no locks.
        """
        self.target, self.path = target, area_of(target)
        self._numbers = itertools.count()
        with contextlib.ExitStack() as opened:
            self._parent = opened.enter_context(folder_below(target.parent))
            try:
                self._lock(time.monotonic() + patience, opened)
            except OSError as error:
                if error.errno in NO_FOLDER:
                    raise _in_the_way(self.path, "it is not a folder") from None
                raise
            self._opened = opened.pop_all()

    def _lock(self, until: float, opened: contextlib.ExitStack) -> None:
        while True:
            try:
                with contextlib.ExitStack() as tried:
                    if self._try(tried):
                        opened.push(tried.pop_all())
                        return
            except (BlockingIOError, FileNotFoundError):  # the process before works, or has just removed its folder
                if time.monotonic() > until:
                    raise
                time.sleep(0.01)

    def _try(self, tried: contextlib.ExitStack) -> bool:
        """Lock the folder if no process has the lock; return whether it is still the folder of that name."""
        self._at = tried.enter_context(folder_below(self._parent, self.path.name, make=True))
        entries = os.listdir(self._at)
        if entries and LOCK not in entries:
            raise _in_the_way(self.path, "no earlier run wrote it")
        lock = os.open(LOCK, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666, dir_fd=self._at)
        tried.callback(os.close, lock)
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return os.path.samestat(os.fstat(lock), os.lstat(LOCK, dir_fd=self._at))

    def close(self) -> None:
        """Remove everything in the folder that is not complete, and release the lock."""
        with contextlib.suppress(OSError), self._opened:  # the folder may be gone
            self.tidy()
            if os.listdir(self._at) == [LOCK]:
                os.unlink(LOCK, dir_fd=self._at)
                with contextlib.suppress(OSError):  # another process is in it already
                    os.rmdir(self.path.name, dir_fd=self._parent)

    def tidy(self) -> None:
        """Remove what killed runs have left in the folder, except complete results."""
        for name in os.listdir(self._at):
            if name.isdigit() or name.endswith(STEPS):  # no other names are used
                _delete(self._at, name)

    def staging(self) -> Path:
        """Make a new folder for files of this process."""
        self._staging = f"{os.getpid()}{next(self._numbers)}"  # never the same twice: other machines may remember it
        os.mkdir(self._staging, dir_fd=self._at)
        return self.path / self._staging

    def commit(self, end: str, *, add: bool = False) -> None:
        """Make the files of the last staging folder the results (`DONE`) or the failure (`FAILED`) of the target.

        Args:
            end: `DONE` or `FAILED`.
            add: Keep earlier results with other names.

        Raises:
            InputError: If something is in the way; the staging folder is still there then.
        """
        staging, place = self.path / self._staging, self.target if end == DONE else failed_place(self.target)
        files = [path for path in staging.rglob("*") if path.is_file()]
        names = {path.relative_to(staging).as_posix() for path in files}
        self._check(place, names)
        with folder_below(self._at, staging.name) as folder:
            _write_list(folder, names | (self._listed(place) if add else set()))
        for path in (*files, staging / MANIFEST):
            _flush(path)  # some file systems report only now that the disk is full
        os.rename(staging.name, end, src_dir_fd=self._at, dst_dir_fd=self._at)
        self.settle()

    def settle(self) -> None:
        """Move complete results to their place, if that holds nothing but results and files of the user.

        Raises:
            InputError: If something is in the way.
        """
        places = (DONE, self.target), (FAILED, failed_place(self.target))
        for end, place in places:
            self._check(place, *self._coming(end))
        for end, place in places:
            if is_complete(self._at, end):
                if end == DONE:
                    self._clear(failed_place(self.target))  # it is out of date
                try:  # in the place of nothing or of an empty folder
                    os.rename(end, place.name, src_dir_fd=self._at, dst_dir_fd=self._parent)
                except OSError as error:
                    if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                        raise
                    with folder_below(self._at, end) as ready, folder_below(self._parent, place.name) as folder:
                        _exchange(ready, folder, place)
            if kind_of(self._at, end):
                _delete(self._at, end)

    def _coming(self, end: str) -> tuple[set[str], set[str]]:
        """The files of complete results that are still to be moved to their place, and those that have been."""
        if not is_complete(self._at, end):
            return set(), set()
        names = self._listed(self.path / end)
        coming = {name for name in names if is_file(self._at, f"{end}/{name}")}
        return coming, names - coming

    def _check(self, place: Path, coming: Set[str], moved: Set[str] = frozenset()) -> None:
        """Refuse a place for results that is used for something else, or where something is in the way.

        Args:
            place: It.
            coming: Files that are to be moved to it.
            moved: Files that have been moved to it, and are not on its list yet.

        Raises:
            InputError: If it is.
        """
        kind = kind_of(self._parent, place.name)
        if kind == stat.S_IFLNK:
            raise InputError(f"output {place}: is a link; name the folder that it leads to")
        if kind not in (0, stat.S_IFDIR):
            raise InputError(f"output {place}: is a file, not a folder")
        if kind == 0:
            return
        with folder_below(self._parent, place.name) as folder:
            ours = listed(folder, place)
            if os.listdir(folder) and not is_file(folder, MANIFEST):
                raise InputError(f"output {place}: is not empty and holds no {MANIFEST}; choose another folder")
            ours |= {*moved, MANIFEST}
            for name in sorted({*OWN, *coming, *ours}):
                *above, whole = _with_those_above(name)
                kinds = {each: kind_of(folder, each) for each in above}
                for each, kind in kinds.items():
                    if kind not in (0, stat.S_IFDIR):
                        raise _in_the_way(place / each, "it is not a folder")
                kind = 0 if 0 in kinds.values() else kind_of(folder, whole)
                if kind and (kind != stat.S_IFREG or name not in ours):
                    raise _in_the_way(place / name, "no earlier run wrote it")

    def _listed(self, place: Path) -> set[str]:
        """The files of a place, see `listed`; none if there is no such folder."""
        path = place.relative_to(self.target.parent).as_posix()
        with contextlib.suppress(FileNotFoundError), folder_below(self._parent, path) as folder:
            return listed(folder, place)
        return set()

    def _clear(self, place: Path) -> None:
        with contextlib.suppress(FileNotFoundError), folder_below(self._parent) as parent:
            clear(parent, place)


def is_complete(at: int, end: str) -> bool:
    """Whether an open area has complete results or a complete failure."""
    return is_file(at, f"{end}/{MANIFEST}")


def _exchange(ready: int, folder: int, place: Path) -> None:
    """Replace the files of the run before. If this was interrupted, a second call goes on from there."""
    new, old = listed(ready, place), listed(folder, place)
    for name in sorted(new):
        if is_file(ready, name):
            _move(name, ready, folder)
    _remove(folder, old - new)
    _move(MANIFEST, ready, folder)


def _move(name: str, source: int, target: int) -> None:
    *parts, last = _parts(name)
    above = "/".join(parts)
    with folder_below(source, above) as one, folder_below(target, above, make=True) as other:
        os.rename(last, last, src_dir_fd=one, dst_dir_fd=other)


def _delete(at: int, name: str) -> None:
    """Remove what has this name in an open folder; links are not followed."""
    if kind_of(at, name) == stat.S_IFDIR:
        shutil.rmtree(name, dir_fd=at)
    else:
        os.unlink(name, dir_fd=at)


def complete(place: Path | str) -> None:
    """Move results or a failure that a killed run has left to this folder: for programs that write into it.

    Raises:
        InputError: If something is in the way.
    """
    for target in _targets(place):
        with contextlib.suppress(OSError):  # another run is writing into it, or a folder that may only be read
            if area_of(target).is_dir():
                area = Area(target, PATIENCE)
                try:
                    area.settle()
                finally:
                    area.close()


def refuse_incomplete(place: Path | str) -> None:
    """Refuse a folder into which a run has not moved all its files: for programs that read it; nothing is changed.

    Raises:
        InputError: If it is one.
    """
    until = time.monotonic() + PATIENCE
    for target in _targets(place):
        while any(os.path.isfile(area_of(target) / end / MANIFEST) for end in (DONE, FAILED)):
            if time.monotonic() > until:
                raise InputError(
                    f"{place}: a run was ended while it moved its files here; `signorini export {place}` finishes this"
                )
            time.sleep(0.01)


def _targets(place: Path | str) -> set[Path]:
    """Targets of runs whose results or failure would be in this folder."""
    real = Path(os.path.realpath(place))
    if not real.name:  # the root, which is no results folder
        return set()
    return {real, real.with_name(real.name.removesuffix(".failed") or real.name)}


def clear(parent: int | Path, place: Path) -> None:
    """Remove a results folder in an open folder, but keep files of the user in it.

    Raises:
        InputError: If its list is damaged.
    """
    with folder_below(parent) as above, folder_below(above, place.name) as folder:
        names = listed(folder, place)
        if not names and not is_file(folder, MANIFEST):
            return
        _remove(folder, names)
        if set(os.listdir(folder)) - {MANIFEST}:
            _write_list(folder, set())  # so it is still recognised as a results folder
            return
        with contextlib.suppress(FileNotFoundError):
            os.unlink(MANIFEST, dir_fd=folder)
        os.rmdir(place.name, dir_fd=above)


def listed(folder: int, place: Path) -> set[str]:
    """The files in an open folder that the program wrote, as paths in it with slashes.

    Raises:
        InputError: If their list is damaged.
    """
    if not kind_of(folder, MANIFEST):
        return set()
    try:
        table = json.loads(text_of(MANIFEST, at=folder))
        names = table.get("files") if isinstance(table, dict) and table.get("written_by") == __package__ else None
        if not isinstance(names, list) or not all(isinstance(name, str) and _is_below(name) for name in names):
            raise ValueError
    except (OSError, ValueError, RecursionError):
        raise InputError(
            f"{place / MANIFEST}: is not the list that an earlier run wrote there; move it elsewhere"
        ) from None
    return set(names)


def _in_the_way(path: Path, why: str) -> InputError:
    return InputError(f"output {path}: is in the way, as {why}; move it elsewhere")


@functools.cache
def _parts(name: str) -> tuple[str, ...]:
    """The parts of a name with slashes; the same names are asked for often."""
    return PurePosixPath(name).parts


def _with_those_above(name: str) -> list[str]:
    """The names of the folders above a name with slashes, the outermost first, and the name."""
    parts = _parts(name)
    return ["/".join(parts[:end]) for end in range(1, len(parts) + 1)]


def _is_below(name: str) -> bool:
    parts = _parts(name)
    return parts != () and not name.startswith("/") and ".." not in parts and "\0" not in name


def _write_list(folder: int, names: set[str]) -> None:
    part = f"{MANIFEST}.part"
    with contextlib.suppress(FileNotFoundError):
        os.unlink(part, dir_fd=folder)
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666, dir_fd=folder), "w") as file:
        file.write(json.dumps({"written_by": __package__, "files": sorted(names)}, indent=2) + "\n")
    os.rename(part, MANIFEST, src_dir_fd=folder, dst_dir_fd=folder)


def _remove(folder: int, names: set[str]) -> None:
    """Remove these files of an open folder, and subfolders that are then empty."""
    for *parts, last in map(_parts, names):
        with contextlib.suppress(FileNotFoundError), folder_below(folder, "/".join(parts)) as above:
            os.unlink(last, dir_fd=above)
    for inner in sorted({each for name in names for each in _with_those_above(name)[:-1]}, reverse=True):
        *parts, last = _parts(inner)
        with contextlib.suppress(OSError), folder_below(folder, "/".join(parts)) as above:  # it holds others' files
            os.rmdir(last, dir_fd=above)


def _flush(path: Path) -> None:
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
