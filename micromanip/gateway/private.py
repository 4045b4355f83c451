"""Files that hold a secret: only their owner may read them."""

from __future__ import annotations

import io
import os
from pathlib import Path

from micromanip.errors import PermissionDenied, system_error
from micromanip.files import open_regular


def read_private(path: Path, holds: str, *, group_may: bool = False) -> str:
    """The text of `path`, which `holds` says in words; PermissionDenied where others may read it, too.

    With `group_may` the file's group is let read it. Raises what `system_error` makes of a file that can't be read.
    """
    try:
        with io.TextIOWrapper(open_regular(path), encoding="utf-8", errors="replace") as file:
            found = os.fstat(file.fileno())
            if found.st_mode & (0o037 if group_may else 0o077):
                mode = "640" if group_may else "600"
                raise PermissionDenied(
                    f"{path}: others may read {holds}; make a new one, or `chmod {mode} {path}` where nobody has"
                )
            return file.read()
    except OSError as problem:
        raise system_error(problem, path) from problem
