"""Faults of a line, injected while it runs, each for a time: ``{"inject": "drop", "share": 0.1, "for_s": 2}``.

What strikes single messages, with ``share`` and ``direction`` (``sent`` by the device, or ``received``):

    drop        lost                                        a reply that is missing, a datagram that never comes
    delay       comes ``ms`` late
    duplicate   comes twice
    reorder     comes after the one that follows it
    split       comes in two parts, ``gap_ms`` apart
    join        comes together with the next, ``count`` at a time
    garbage     comes behind ``count`` random bytes
    flip        comes with ``bits`` wrong bits               its CRC doesn't fit
    short       breaks off                                  a short read

What befalls the line as a whole:

    hang        the device says nothing and hears nothing; a TCP connection stays open
    unplug      the port has gone: a pseudo terminal's link, a TCP port with its connections; it is back after ``for_s``
    disconnect  TCP connections are reset, and may be made anew
    echo        what is sent to the device comes back to the sender
    stranger    each datagram comes again, as it was when this began, from an address that is not the device's

What the device itself does, where it can (``device_line.py``):

    identity    it says that it is another one
    gcs_error   a GCS controller refuses commands with ``code``
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from random import Random
from typing import Annotated, Literal, TypeVar

from pydantic import Field, TypeAdapter

from micromanip.testbus.event_loop import EventLoop, Timer
from micromanip.testbus.fault import validated

from .fault import Delay, Drop, Duplicate, Flip, Garbage, Join, LineFault, MessageFault, Reorder, Short, Split


class Hang(LineFault):
    """Nothing goes either way."""

    kind: Literal["hang"]


class Unplug(LineFault):
    """The port has gone."""

    kind: Literal["unplug"]


class Disconnect(LineFault):
    """Connections are reset once."""

    kind: Literal["disconnect"]


class Echo(LineFault):
    """What is sent to the device comes back."""

    kind: Literal["echo"]


class Stranger(LineFault):
    """Datagrams of somebody else."""

    kind: Literal["stranger"]


class Identity(LineFault):
    """The device says that it is another one."""

    kind: Literal["identity"]


class GcsError(LineFault):
    """A GCS controller refuses commands."""

    kind: Literal["gcs_error"]
    code: Annotated[int, Field(ge=1, le=1000)] = 5


_Kind = TypeVar("_Kind", bound=LineFault)
_ANY: TypeAdapter[LineFault] = TypeAdapter(
    Annotated[
        Drop
        | Delay
        | Duplicate
        | Reorder
        | Split
        | Join
        | Garbage
        | Flip
        | Short
        | Hang
        | Unplug
        | Disconnect
        | Echo
        | Stranger
        | Identity
        | GcsError,
        Field(discriminator="kind"),
    ]
)


def parsed(document: object) -> LineFault:
    """The fault that a mapping describes. Raises UsageError with the first thing that is wrong with it."""
    return validated(_ANY, document)


class LineFaults:
    """Those that are active on one line."""

    def __init__(self, loop: EventLoop, seed: int) -> None:
        self._loop, self._random = loop, Random(seed)
        self._active: list[tuple[LineFault, Timer | None, Callable[[], None]]] = []

    def begin(self, fault: LineFault, end: Callable[[], None]) -> None:
        """Let `fault` begin now; `end` is called when it is over."""
        if isinstance(fault, MessageFault):
            fault.draw_from(self._random)
        timer = None
        if fault.for_s is not None:
            timer = self._loop.call_at(self._loop.now_ns() + round(fault.for_s * 1e9), partial(self._end, fault))
        self._active.append((fault, timer, end))

    def clear(self) -> None:
        """End all of them."""
        for fault, timer, _ in list(self._active):
            if timer is not None:
                timer.cancel()
            self._end(fault)

    @property
    def any(self) -> bool:
        """Whether there is one at all."""
        return bool(self._active)

    def active(self, kind: type[_Kind]) -> _Kind | None:
        """The first of a kind; None if there is none."""
        return next((fault for fault, _, _ in self._active if isinstance(fault, kind)), None)

    def through(self, message: bytes, direction: str) -> list[tuple[int, bytes]]:
        """What becomes of a message: passed through one fault after the other."""
        parts = [(0, message)]
        for fault, _, _ in self._active:
            if isinstance(fault, MessageFault) and fault.direction == direction:
                parts = [
                    (before_ns + after_ns, part)
                    for before_ns, whole in parts
                    for after_ns, part in (fault.through(whole) if whole and fault.strikes() else [(0, whole)])
                ]
        return parts

    def _end(self, fault: LineFault) -> None:
        ended = [entry for entry in self._active if entry[0] is fault]
        self._active = [entry for entry in self._active if entry[0] is not fault]
        for _, _, end in ended:
            end()
