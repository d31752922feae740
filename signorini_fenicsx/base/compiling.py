"""The cache of compiled forms: it survives killed runs, and tells failures in one sentence.

In DOLFINx's cache the file `<form>.c` means that some process compiles the form, and `<form>.c.cached` that the form is
ready. A process that is killed in between leaves only the first file, and all later runs wait for the second one in
vain. Here each process that compiles holds a shared lock on a file of the cache; the system releases the lock when the
process dies, on all nodes that see the cache. A `<form>.c` is removed as left behind if nobody holds the lock and the
file has not changed for some time. The waiting time is for programs that do not use the lock, and for a compiler that
outlives its parent.
"""

import contextlib
import errno
import fcntl
import os
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cffi

LOCK = "signorini.lock"
QUIET = 30.0
"""Seconds without a change after which a file counts as left behind, if nobody holds the lock."""
PATIENCE = 600.0
"""Seconds to wait for the compiler of another process."""


def clear_if_left(form: Path) -> bool:
    """Remove the `<form>.c` of a dead process; return whether there is none now.

    Raises:
        OSError: If it cannot be removed.
    """
    with _lock(form.parent, fcntl.LOCK_EX | fcntl.LOCK_NB) as (alone, now):
        if not alone or form.with_suffix(".c.cached").exists() or now - _last_change(form) < QUIET:
            return False
        form.unlink(missing_ok=True)
        return True


def patiently(work: Callable[[], Any], cache: Path, *, compiling: bool) -> Any:
    """Load a form, or compile it if this process may; wait while another process compiles it, a second at a time.

    Args:
        work: Loads it, or compiles it.
        cache: Folder of the cache.
        compiling: Whether this process may compile.

    Raises:
        OSError: If there is no working C compiler, the form cannot be loaded, or the other process does not end.
    """
    until = time.monotonic() + PATIENCE
    while True:
        try:
            with _lock(cache, fcntl.LOCK_SH) if compiling else contextlib.nullcontext():
                return work()
        except TimeoutError:
            if time.monotonic() > until:
                raise
            for form in cache.glob("*.c") if compiling else ():  # DOLFINx tells the one that it waits for in words only
                clear_if_left(form)
        except OSError as error:
            advice = "set XDG_CACHE_HOME to a folder in which compiled forms can be kept"
            raise OSError(error.errno, f"{error.strerror or error}; {advice}", error.filename) from None
        except cffi.VerificationError as error:
            reason = re.sub(r"\['([^']*)'.*\]", r"\1", str(error))  # the command without its arguments
            advice = "install one and Python's headers, such as gcc, libc6-dev and python3-dev"
            raise OSError(errno.ENOEXEC, f"cannot compile the forms ({reason}); {advice}", "C compiler") from None
        except ImportError as error:
            advice = "delete the folder, which will be filled again"
            raise OSError(errno.EIO, f"a compiled form cannot be loaded ({error}); {advice}", str(cache)) from None


def _last_change(form: Path) -> float:
    """Time of the last change of the files of a form; now if there are none."""
    times = []
    for path in form.parent.glob(f"{form.stem}.*"):
        with contextlib.suppress(FileNotFoundError):
            times.append(path.stat().st_mtime)
    return max(times, default=float("inf"))


@contextlib.contextmanager
def _lock(cache: Path, kind: int) -> Iterator[tuple[bool, float]]:
    """Hold the lock of a cache. Yields whether it is held, and the present time by the clock of the cache's files.

    A cache that cannot be written, or whose file system has no locks, is used without the lock.
    """
    try:
        cache.mkdir(parents=True, exist_ok=True)
        file = os.open(cache / LOCK, os.O_CREAT | os.O_RDONLY, 0o666)
    except OSError:  # if DOLFINx has to write, it raises a better error
        yield True, time.time()
        return
    try:
        held = True
        try:
            fcntl.flock(file, kind)
        except BlockingIOError:
            held = False
        except OSError:
            pass
        now = time.time()
        with contextlib.suppress(PermissionError):  # another user's
            os.utime(file)
            now = os.fstat(file).st_mtime
        yield held, now
    finally:
        os.close(file)
