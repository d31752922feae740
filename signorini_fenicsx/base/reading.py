"""Small text files that anybody may have written."""

import errno
import os
import stat
from pathlib import Path

MAX_BYTES = 2**23
"""Largest size of such a file; Python's TOML reader takes about a second per million bytes."""


def text_of(path: Path | str, *, at: int | None = None) -> str:
    """The text of a small regular file; a pipe is not waited for, and a device is not read.

    Args:
        path: The file.
        at: An open folder to which the path is relative; then a link is not followed.

    Raises:
        OSError: If it is no regular file, is too large, or cannot be read.
        UnicodeDecodeError: If it is not UTF-8.
    """
    follow = os.O_NOFOLLOW if at is not None else 0
    number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | follow, dir_fd=at)
    with open(number, "rb") as file:
        if not stat.S_ISREG(os.fstat(number).st_mode):
            raise OSError(errno.EINVAL, "is not a regular file", str(path))
        text = file.read(MAX_BYTES + 1)
    if len(text) > MAX_BYTES:
        raise OSError(errno.EFBIG, f"has more than {MAX_BYTES} bytes", str(path))
    return text.decode("utf-8-sig")  # some editors begin a file with a byte order mark
