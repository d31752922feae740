"""A confined process that runs a Python module, for files by unknown people, which may also crash the libraries.

The process has limits of time, memory and file size, an empty environment and an empty working folder, and it dies with
its parent. Before it reads an untrusted file it gives up rights (`seal`, on Linux with x86-64 or ARM): to start
programs, to open sockets, to open files for writing, to change, move or delete files, and to write into the memory of
other processes. Its result goes into a file that the parent has opened. On other systems only the limits hold. Calls
by which root administers a system, such as loading modules, are not refused.
"""

import contextlib
import ctypes
import errno
import importlib
import os
import platform
import resource
import select
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import BinaryIO

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import printable

SECONDS = 600
"""Limit of wall time, and of CPU time."""
LARGEST_RESULT = 2**34
"""Limit of the bytes of any file that is written."""
LEAST_MEMORY = 2**31
"""Bytes of memory that the process may use even if less is free."""
SLOW = f"takes more than {SECONDS} s to read or to mesh, the limit for one file"
FOLDER = ".signorini_fenicsx-read-"
"""Beginning of the names of its working folders; such that no folder of the user has it."""
KEPT = ("PATH", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH")
"""Variables of the environment by which libraries are found."""
LAST_WORDS = 4096


def run(module: str, arguments: list[str], result: BinaryIO) -> None:
    """Run `main(arguments, result)` of a module, confined, and wait for it.

    Args:
        module: Name of the module.
        arguments: Arguments of `main`; paths among them have to be absolute.
        result: An open file, into which `main` writes its result.

    Raises:
        InputError: If `main` raises InputError or OSError, crashes, or exceeds a limit.
    """
    _tidy()
    with tempfile.TemporaryDirectory(prefix=FOLDER) as folder, tempfile.TemporaryFile() as said:
        number = result.fileno()
        command = [sys.executable, "-P", "-B", "-m", __name__, str(os.getpid()), str(number), module, *arguments]
        try:
            with subprocess.Popen(
                command,
                cwd=folder,
                env=_environment(folder),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=said,
                pass_fds=(number,),
                start_new_session=True,
            ) as process:
                status = _status(process)
        except subprocess.TimeoutExpired:
            raise InputError(SLOW) from None
        said.seek(max(said.seek(0, os.SEEK_END) - LAST_WORDS, 0))
        words = said.read().decode(errors="replace").strip()
    if status != 0:
        raise InputError(_reason(status, words))


def _status(process: subprocess.Popen[bytes]) -> int:
    """Wait for a process; where the system tells of its end, not up to a twentieth of a second longer, as Python does.

    Raises:
        subprocess.TimeoutExpired: If it takes too long.
    """
    until = time.monotonic() + SECONDS
    try:
        if sys.platform == "linux":
            with contextlib.suppress(OSError), os.fdopen(os.pidfd_open(process.pid)) as ended:
                poll = select.poll()
                poll.register(ended)
                poll.poll(1000 * SECONDS)
        return process.wait(max(until - time.monotonic(), 0.0))
    except BaseException:
        process.kill()
        raise


def _tidy() -> None:
    """Remove the folders of processes that were killed: those that are older than any process may be."""
    for left in Path(tempfile.gettempdir()).glob(f"{FOLDER}*"):
        with contextlib.suppress(OSError):
            status = left.lstat()
            if status.st_uid == os.geteuid() and time.time() - status.st_mtime > 2 * SECONDS:
                shutil.rmtree(left)  # refuses links


def _environment(folder: str) -> dict[str, str]:
    """The environment: the library paths of this process, `folder` for all files, one thread, no plug-ins of HDF5."""
    paths = os.pathsep.join(os.path.abspath(path) for path in sys.path)
    own = {"PYTHONPATH": paths, "HOME": folder, "TMPDIR": folder, "LC_ALL": "C.UTF-8", "HDF5_PLUGIN_PRELOAD": "::"}
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return {name: os.environ[name] for name in KEPT if name in os.environ} | own | threads


def _reason(status: int, words: str) -> str:
    """Why the process ended, in one sentence."""
    if status == -signal.SIGXCPU:
        return SLOW
    if any(sign in words for sign in ("bad_alloc", "MemoryError", "Cannot allocate memory", "Unable to allocate")):
        return f"needs more than the {_memory() / 2**30:.1f} GB of memory that it may have, half of what is free"
    if status == -signal.SIGKILL:
        return "was ended by the system while it was read or meshed, most often for want of memory"
    if "File too large" in words:
        return f"gives more than {LARGEST_RESULT >> 30} GB of data, the limit for one file"
    return printable(words.splitlines()[-1]) if status > 0 and words else f"makes its reader crash ({_name(-status)})"


def _name(number: int) -> str:
    with contextlib.suppress(ValueError):
        return signal.Signals(number).name
    return f"status {-number}"


def _memory() -> int:
    """Half of the free memory in bytes, because other processes need some too; at least LEAST_MEMORY."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return max(512 * int(line.split()[1]), LEAST_MEMORY)
    return LEAST_MEMORY


def main(parent: int, result: int, module: str, arguments: list[str]) -> None:
    """The program of the process: set the limits first, then import the module and run it."""
    limit(parent)
    try:
        with os.fdopen(result, "wb") as file:
            importlib.import_module(module).main(arguments, file)
    except InputError as refusal:
        sys.exit(str(refusal))
    except MemoryError:
        sys.exit("MemoryError")
    except OSError as error:
        sys.exit(error.strerror or str(error))


def limit(parent: int) -> None:
    """Limit this process, and let it die with its parent.

    Args:
        parent: The parent's process number; if that has died already, so does this process.
    """
    limits = {resource.RLIMIT_CORE: 0, resource.RLIMIT_CPU: SECONDS, resource.RLIMIT_FSIZE: LARGEST_RESULT}
    if sys.platform == "linux":  # on other systems, reserved addresses count as well
        limits[resource.RLIMIT_AS] = _memory()
        _prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    for kind, most in limits.items():
        with contextlib.suppress(OSError, ValueError):  # a lower limit stands already
            resource.setrlimit(
                kind, (most, most + (kind == resource.RLIMIT_CPU))
            )  # a signal, and a second later the end
    if os.getppid() != parent:
        os._exit(1)


PR_SET_PDEATHSIG, PR_SET_NO_NEW_PRIVS = 1, 38
SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_TSYNC = 1, 1


def _prctl(option: int, value: int) -> int:
    """Linux's prctl."""
    libc = ctypes.CDLL(None, use_errno=True)
    return libc.prctl(option, ctypes.c_ulong(value), ctypes.c_ulong(0), ctypes.c_ulong(0), ctypes.c_ulong(0))


MACHINES = {"x86_64": (0, 0xC000003E, 317), "aarch64": (1, 0xC00000B7, 277)}
"""Per machine: its column in CALLS, the kernel's number for it, and the number of the call seccomp."""

CALLS = {  # name: number on x86-64 and on ARM, −1 for none
    **{"execve": (59, 221), "execveat": (322, 281), "socket": (41, 198), "socketpair": (53, 199)},
    **{"io_uring_setup": (425, 425), "open_by_handle_at": (304, 265), "ptrace": (101, 117)},
    **{"process_vm_writev": (311, 271), "creat": (85, -1), "unlink": (87, -1), "unlinkat": (263, 35)},
    **{"rename": (82, -1), "renameat": (264, 38), "renameat2": (316, 276), "mkdir": (83, -1), "mkdirat": (258, 34)},
    **{"rmdir": (84, -1), "link": (86, -1), "linkat": (265, 37), "symlink": (88, -1), "symlinkat": (266, 36)},
    **{"mknod": (133, -1), "mknodat": (259, 33), "truncate": (76, 45), "chmod": (90, -1), "fchmod": (91, 52)},
    **{"fchmodat": (268, 53), "fchmodat2": (452, 452), "chown": (92, -1), "fchown": (93, 55), "lchown": (94, -1)},
    **{"fchownat": (260, 54), "utime": (132, -1), "utimes": (235, -1), "futimesat": (261, -1), "utimensat": (280, 88)},
}
"""Calls that are refused with any arguments."""
OPENAT2 = 437
"""A call whose arguments the filter cannot read. It is reported as missing, so libraries use the older ones."""
OPEN = {2: 1, 257: 2}, {56: 2}
"""Calls that open files, and where their flags are."""
WRITING = 0o1 | 0o2 | 0o100 | 0o1000
"""Flags that are refused: O_WRONLY, O_RDWR, O_CREAT, O_TRUNC."""


def seal() -> bool:
    """Give up for good all rights that reading a file does not need.

    Returns:
        Whether this was possible; some systems cannot do it.
    """
    machine = MACHINES.get(platform.machine())
    if sys.platform != "linux" or machine is None:
        return False
    column, architecture, call = machine
    code = _filter(column, architecture)
    program = ctypes.create_string_buffer(code, len(code))

    class Program(ctypes.Structure):
        _fields_ = (("length", ctypes.c_ushort), ("code", ctypes.c_void_p))

    filter_program = Program(len(code) // 8, ctypes.addressof(program))
    _prctl(PR_SET_NO_NEW_PRIVS, 1)
    libc = ctypes.CDLL(None, use_errno=True)
    wanted = map(ctypes.c_long, (call, SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_TSYNC))
    return bool(libc.syscall(*wanted, ctypes.byref(filter_program)) == 0)


LOAD, EQUAL, AT_LEAST, ANY_BIT, RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
KILL, ALLOW, REFUSE, IS_MISSING = 0x80000000, 0x7FFF0000, 0x50000 | errno.EPERM, 0x50000 | errno.ENOSYS


def _filter(column: int, architecture: int) -> bytes:
    """Instructions for the kernel: each is a code, a jump if true, a jump if false, and a number."""

    def step(code: int, number: int, true: int = 0, false: int = 0) -> bytes:
        return struct.pack("=HBBI", code, true, false, number)

    code = step(LOAD, 4) + step(EQUAL, architecture, 1) + step(RETURN, KILL) + step(LOAD, 0)
    code += step(AT_LEAST, 0x40000000, 0, 1) + step(RETURN, REFUSE)  # x86's second set of numbers
    for numbers in CALLS.values():
        if numbers[column] >= 0:
            code += step(EQUAL, numbers[column], 0, 1) + step(RETURN, REFUSE)
    code += step(EQUAL, OPENAT2, 0, 1) + step(RETURN, IS_MISSING)
    for number, index in OPEN[column].items():
        flags = step(LOAD, 16 + 8 * index)  # the lower half of the argument
        code += step(EQUAL, number, 0, 4) + flags + step(ANY_BIT, WRITING, 0, 1) + step(RETURN, REFUSE)
        code += step(RETURN, ALLOW)
    return code + step(RETURN, ALLOW)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], sys.argv[4:])
