"""Faults of a line, injected while it runs, each for a time: ``{"inject": "drop", "share": 0.1, "for_s": 2}``.

``docs/buses.md`` has a table of them. What the device itself does, where it can, it asks for (``DeviceLine.active``).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from random import Random
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, TypeAdapter

from micromanip.testbus.event_loop import EventLoop, Timer
from micromanip.testbus.fault import validated

Parts = list[tuple[int, bytes]]
"""What becomes of a message: bytes, and how much later they come, ns."""
Milliseconds = Annotated[float, Field(gt=0, le=10_000)]


class LineFault(BaseModel):
    """A fault; it ends by itself after a time, or when it is cleared."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    kind: str
    for_s: float | None = Field(default=None, gt=0, description="How long it lasts; null: until it is cleared.")


class MessageFault(LineFault):
    """A fault of single messages: a reply, a frame, a packet, a datagram."""

    share: float = Field(default=1.0, gt=0, le=1, description="Share of the messages that it strikes, at random.")
    direction: Literal["sent", "received"] = Field(
        default="sent", description="Those that the device sends, or those that it receives."
    )
    _random: Random = PrivateAttr(default_factory=Random)
    _kept: list[bytes] = PrivateAttr(default_factory=list)

    def draw_from(self, random: Random) -> None:
        """Use this source of chance."""
        self._random = random

    def strikes(self) -> bool:
        """Whether this message is one of them."""
        return self.share == 1.0 or self._random.random() < self.share

    def through(self, message: bytes) -> Parts:
        """What becomes of a message that it strikes."""
        return [(0, message)]

    def held(self) -> bytes:
        """What it holds back, let go."""
        held = b"".join(self._kept)
        self._kept.clear()
        return held


class Disturbed(MessageFault):
    """Messages are lost, late, doubled, or overtaken by the next; come in parts, joined, behind rubbish, damaged, cut.

    On a line nothing overtakes one that is late: those that follow wait.
    """

    kind: Literal["drop", "delay", "duplicate", "reorder", "split", "join", "garbage", "flip", "short"]
    ms: Milliseconds = Field(default=100.0, description="Of `delay`.")
    gap_ms: Milliseconds = Field(default=2.0, description="Of `split`: until the second part comes.")
    count: Annotated[int, Field(ge=2, le=4096)] = Field(
        default=2, description="Of `join`: messages at once; of `garbage`: eight times as many bytes before one."
    )
    bits: Annotated[int, Field(ge=1, le=64)] = Field(default=1, description="Wrong ones, of `flip`.")

    def through(self, message: bytes) -> Parts:
        random = self._random
        match self.kind:
            case "drop":
                return []
            case "delay":
                return [(round(self.ms * 1e6), message)]
            case "duplicate":
                return [(0, message), (0, message)]
            case "reorder":
                if not self._kept:
                    self._kept.append(message)
                    return []
                return [(0, message), (0, self.held())]
            case "split" if len(message) > 1:
                cut = random.randrange(1, len(message))
                return [(0, message[:cut]), (round(self.gap_ms * 1e6), message[cut:])]
            case "join":
                self._kept.append(message)
                return [] if len(self._kept) < self.count else [(0, self.held())]
            case "garbage":
                return [(0, random.randbytes(8 * self.count) + message)]
            case "flip":
                flipped = bytearray(message)
                for place in random.sample(range(8 * len(message)), min(self.bits, 8 * len(message))):
                    flipped[place // 8] ^= 1 << place % 8
                return [(0, bytes(flipped))]
            case "short":
                return [(0, message[: random.randrange(len(message))])]
        return [(0, message)]


class PortFault(LineFault):
    """What befalls the line as a whole, or makes the device say that it is another one."""

    kind: Literal["hang", "unplug", "disconnect", "echo", "stranger", "identity"]


class GcsError(LineFault):
    """A GCS controller refuses commands."""

    kind: Literal["gcs_error"]
    code: Annotated[int, Field(ge=1, le=1000)] = 5


_ANY: TypeAdapter[LineFault] = TypeAdapter(Annotated[Disturbed | PortFault | GcsError, Field(discriminator="kind")])


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

    def active(self, kind: str) -> Any:
        """The first of a kind; None if there is none."""
        return next((fault for fault, _, _ in self._active if fault.kind == kind), None)

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
