"""What can go wrong on a bus, by what is to be done about it.

A driver raises these; the worker owns the policy. Anything else that a driver raises is a bug: the worker ends, and is
started again.
"""

# ruff: noqa: N818 (the names say what happened; a suffix "Error" on each would add nothing)

from __future__ import annotations

from collections.abc import Collection


class BusError(Exception):
    """Base of all that a driver may raise once it was built."""

    task: int | None = None
    """Number of the task that it is about, where that is not the one that was called for."""


class TransientError(BusError):
    """It failed once: a time-out, a wrong checksum, a device that is busy, a full transmit buffer, a stale reply.

    Counted; so many among the last tries are a lost link.
    """


class LinkError(BusError):
    """The bus is gone: bus-off, disconnected, network down. Closed, and opened again after a while."""


class PartMissing(LinkError):
    """Raised by ``open``, which has left the link open: some devices on it can't be served, the others can.

    The outputs of the others are brought to rest; then the link is closed, and opened again after a while.
    """

    def __init__(self, text: str, tasks: Collection[int]) -> None:
        """`tasks` are the numbers of those that can't be done."""
        super().__init__(text)
        self.tasks = frozenset(tasks)


class StillOpening(LinkError):
    """By ``open`` alone: it takes its time, and is to be called again, without ``close``, to go on with it.

    For a library that opens slowly, a device that starts when its port is opened. Whoever closes gives it up.
    """


class DeviceFault(BusError):
    """The device answers, and says that it can't: an exception code, an error register, an emergency message.

    Treated as a lost link: the outputs are safe until it has been opened again and the axes are armed anew.
    """


class IdentityMismatch(BusError):
    """What answers is not the device that the configuration names. Latched: never tried again by itself."""


class OutputsUnknown(BusError):
    """What the device has can't be known: a person is asked before anything is written. Latched."""


class OutputRefused(BusError):
    """A value that is not finite, or that the wire can't carry; nothing was sent."""
