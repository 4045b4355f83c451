"""Files that somebody names to be read: a pipe, a device or a folder in their place is refused, and nothing waits."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

MOST_BYTES = 2_000_000_000


def open_regular(file: Path, most_bytes: int = MOST_BYTES) -> BinaryIO:
    """`file`, open for reading. OSError where it can't be, isn't a regular file, or is larger than `most_bytes`."""
    _require_regular(_known_to_the_system(file).stat(), file, most_bytes)  # before it is touched: some devices react
    descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        _require_regular(os.fstat(descriptor), file, most_bytes)
    except OSError:
        os.close(descriptor)
        raise
    return os.fdopen(descriptor, "rb")


def require_regular(file: Path, most_bytes: int = MOST_BYTES) -> None:
    """Raise OSError as `open_regular` does, for whoever opens the file by its name."""
    open_regular(file, most_bytes).close()


def _known_to_the_system(file: Path) -> Path:
    if "\0" in str(file):
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(file))
    return file


def _require_regular(found: os.stat_result, file: Path, most_bytes: int) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file, but a pipe, a socket or a device", str(file))
    if found.st_size > most_bytes:
        raise OSError(errno.EFBIG, f"it is larger than {most_bytes / 1e6:g} MB", str(file))
