"""Errors that a user can act on; each carries the exit code of the command that it ends.

Any other exception is a bug, and a command that meets one exits with 70.
"""

from __future__ import annotations

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
