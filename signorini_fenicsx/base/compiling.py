"""The cache of compiled forms: it survives killed runs, and tells failures in one sentence.

In DOLFINx's cache the file `<form>.c` means that some process compiles the form, and `<form>.c.cached` that the form is
ready. A process that is killed in between leaves only the first file, and all later runs wait for the second one in
vain. Here each process that loads or compiles a form shares a lock on a file of the cache, which the system releases
when the process dies, on all nodes that see the cache. Who has to wait for a form takes the lock alone, so that nobody
compiles: then the form is ready, or it has been left behind, and is compiled again.
"""

import contextlib
import errno
import fcntl
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cffi

LOCK = "signorini.lock"
PATIENCE = 600
"""Seconds to wait for a form that is not ready: where there are no locks, and until another node sees its file."""


def patiently(work: Callable[[int], Any], cache: Path) -> Any:
    """Load a form, or compile it; wait while another process compiles it.

    Args:
        work: Loads it, or compiles it; it waits so many seconds for a form that another process seems to compile.
        cache: Folder of the cache.

    Raises:
        OSError: If there is no working C compiler, or the cache cannot be used.
    """
    with in_a_sentence(cache):
        with _lock(cache, fcntl.LOCK_SH), contextlib.suppress(TimeoutError):
            return work(1)
        with _lock(cache, fcntl.LOCK_EX) as is_held:
            for form in cache.glob("*.c") if is_held else ():
                if not form.with_suffix(".c.cached").exists():
                    form.unlink()
            return work(PATIENCE)


@contextlib.contextmanager
def in_a_sentence(cache: Path) -> Iterator[None]:
    """Tell what fails in this context as an OSError, with what can be done."""
    try:
        yield
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


@contextlib.contextmanager
def _lock(cache: Path, kind: int) -> Iterator[bool]:
    """Hold the lock of a cache, and tell whether it is held: not if nothing can be written, or there are no locks."""
    with contextlib.ExitStack() as opened:
        is_held = False
        with contextlib.suppress(OSError):  # if DOLFINx has to write, it raises a better error
            cache.mkdir(parents=True, exist_ok=True)
            file = os.open(cache / LOCK, os.O_CREAT | os.O_RDONLY, 0o666)
            opened.callback(os.close, file)
            fcntl.flock(file, kind)
            is_held = True
        yield is_held
