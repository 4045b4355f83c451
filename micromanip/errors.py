"""Errors that a user can act on; each carries the exit code of the command that it ends.

Any other exception is a bug, and a command that meets one exits with 70.
"""

from __future__ import annotations

import difflib
import errno
import os
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

# The names say what happened to the user; a suffix "Error" on each would add nothing (N818).


class MicromanipError(Exception):
    """Base: catch it to print one clear message instead of a traceback. Raise one of the classes below."""

    exit_code: ClassVar[int] = 70


class CheckFailed(MicromanipError):  # noqa: N818
    """A check said no or a fault latched: the command did its work, and the answer is bad."""

    exit_code = 1


class UsageError(MicromanipError):
    """The command line makes no sense: options that exclude each other, a column that the recording lacks."""

    exit_code = 64


class DeviceUnavailable(MicromanipError):  # noqa: N818
    """A bus, device or daemon can't be reached: cable, power, wrong interface name, daemon not running."""

    exit_code = 69


class PermissionDenied(MicromanipError):  # noqa: N818
    """The operating system refuses: real-time priority, locked memory, a device node, the control socket."""

    exit_code = 77


class ConfigError(MicromanipError):
    """The configuration can't be used: not readable, not YAML, or values that are wrong alone or together."""

    exit_code = 78


_REFUSED = (errno.EACCES, errno.EPERM, errno.EROFS)
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_MISNAMED = {
    errno.ENOENT: "give a path that is there",
    errno.ENOTDIR: "a part of that path is no folder",
    errno.EISDIR: "give a file, not a folder",
    errno.EEXIST: "give another name",
    errno.ELOOP: "its links lead in a circle",
    errno.ENAMETOOLONG: "give a shorter name",
}


def system_error(problem: OSError, path: Path | str | None = None) -> MicromanipError:
    """What the operating system refused, as an error that a user can act on; never a bug.

    `path` is what it was about, by default what `problem` names. 77 where rights are missing, 64 where a name is
    wrong, else (full, broken, unreachable) 69.
    """
    where = os.fsdecode(problem.filename) if isinstance(problem.filename, str | bytes) else None
    said = problem.strerror or str(problem) or type(problem).__name__
    text = f"{path or where}: {said}" if path or where else said
    if problem.errno in _REFUSED:
        return PermissionDenied(f"{text}; choose another place, or have its rights changed")
    if problem.errno in _MISNAMED:
        return UsageError(f"{text}; {_MISNAMED[problem.errno]}")
    if problem.errno in _FULL:
        return DeviceUnavailable(f"{text}; make room there, or choose another place")
    return DeviceUnavailable(text)


def sentence(said: str | Exception) -> str:
    """What was `said` as a sentence that another may follow, whatever it ends with."""
    text = str(said).rstrip()
    return text if text.endswith((".", "!", "?")) else f"{text}."


def nearest(name: str, known: Iterable[str]) -> str | None:
    """That of `known` which was probably meant by `name`, in capitals or not; None without an idea."""
    lowered = {one.lower(): one for one in map(str, known)}
    near = difflib.get_close_matches(name.lower(), lowered, 1)
    return lowered[near[0]] if near else None


_MOST_TOLD = 100


def did_you_mean(name: str, known: Iterable[str], there: str = "it has") -> str:
    """The end of a message about a `name` that is not `known`: the nearest of them, else what is `there`."""
    known = list(map(str, known))
    near, others = nearest(name, known), [f"{len(known) - _MOST_TOLD} more"] if len(known) > _MOST_TOLD else []
    return f"did you mean {near}?" if near else f"{there} {', '.join([*known[:_MOST_TOLD], *others]) or 'none'}"


def require_axis(axis: str, axes: Iterable[str], where: str = "") -> None:
    """Raise UsageError where `axis` is none of the `axes`, which are those `where`: " in FILE"."""
    if axis not in axes:
        raise UsageError(f"there is no axis {axis!r:.40}{where}; {did_you_mean(axis, axes, 'there are')}")
