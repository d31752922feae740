"""A module that tries what a confined process can do."""

import ctypes
import os
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from signorini_fenicsx.base import confined

LIBC = ctypes.CDLL(None, use_errno=True)


def call(number: int, *arguments: int) -> None:
    """A call of the kernel by its number on x86-64."""
    if LIBC.syscall(*map(ctypes.c_long, (number, *arguments))) < 0:
        raise OSError(ctypes.get_errno(), str(number))


def thread() -> None:
    """A thread, which is allowed."""
    one = threading.Thread(target=time.sleep, args=(0,))
    one.start()
    one.join()


def attempts(folder: Path) -> dict[str, Callable[[], object]]:
    """All forbidden actions; the parent is the process that they must not harm."""
    there, new = folder / "there", folder / "new"
    return {
        "system": lambda: os.system(f"touch {new}") and os.wait(),
        "run": lambda: subprocess.run(["touch", str(new)], check=False),
        "exec": lambda: os.execv("/bin/true", ["true"]),
        "spawn": lambda: os.posix_spawn("/bin/true", ["true"], {}),
        "write": lambda: new.write_text("x"),
        "append": lambda: there.open("a"),
        "truncate": lambda: os.truncate(there, 0),
        "mkdir": lambda: new.mkdir(),
        "rename": lambda: there.rename(new),
        "unlink": lambda: there.unlink(),
        "link": lambda: os.link(there, new),
        "symlink": lambda: os.symlink(there, new),
        "chmod": lambda: there.chmod(0o777),
        "utime": lambda: os.utime(there),
        "fifo": lambda: os.mkfifo(new),
        "own folder": lambda: Path("new").write_text("x"),
        "temporary": lambda: os.memfd_create("x") and os.open("/tmp", os.O_TMPFILE | os.O_RDWR),
        "socket": lambda: socket.socket(),
        "io_uring": lambda: call(425, 1, 0),
        "x32": lambda: call(0x40000000 + 83, 0, 0),
        "ptrace": lambda: call(101, 16, os.getppid(), 0, 0),
        "openat2": lambda: call(437, -100, 0, 0, 24),
    }


def main(arguments: list[str], result: BinaryIO) -> None:
    """Do something that a limit ends, or try all forbidden actions and write those that were not refused."""
    what, folder = arguments[0], Path(arguments[1])
    if what == "sleep":
        time.sleep(1000)
    if what == "memory":
        bytearray(2**50)
    if what == "crash":
        ctypes.string_at(0)
    confined.seal()
    thread()
    allowed = []
    for name, attempt in attempts(folder).items():
        try:
            attempt()
        except OSError:
            continue
        if name != "system" or (folder / "new").exists():
            allowed.append(name)
    result.write(", ".join(allowed).encode())
