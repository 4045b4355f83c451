"""What every fault of a line has, and those that strike single messages."""

from __future__ import annotations

from random import Random
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr

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
        """What it still holds back when it ends."""
        return b""


class Drop(MessageFault):
    """The message is lost: a datagram that never comes, a reply that is missing."""

    kind: Literal["drop"]

    def through(self, message: bytes) -> Parts:  # noqa: ARG002
        return []


class Delay(MessageFault):
    """The message comes late. On a line nothing overtakes it: those that follow wait."""

    kind: Literal["delay"]
    ms: Milliseconds = 100.0

    def through(self, message: bytes) -> Parts:
        return [(round(self.ms * 1e6), message)]


class Duplicate(MessageFault):
    """The message comes twice."""

    kind: Literal["duplicate"]

    def through(self, message: bytes) -> Parts:
        return [(0, message), (0, message)]


class Reorder(MessageFault):
    """The message comes after the one that follows it."""

    kind: Literal["reorder"]
    _kept: bytes = PrivateAttr(default=b"")

    def through(self, message: bytes) -> Parts:
        if not self._kept:
            self._kept = message
            return []
        kept, self._kept = self._kept, b""
        return [(0, message), (0, kept)]

    def held(self) -> bytes:
        return self._kept


class Split(MessageFault):
    """The message comes in two parts, the second after a gap."""

    kind: Literal["split"]
    gap_ms: Milliseconds = 2.0

    def through(self, message: bytes) -> Parts:
        if len(message) < 2:
            return [(0, message)]
        cut = self._random.randrange(1, len(message))
        return [(0, message[:cut]), (round(self.gap_ms * 1e6), message[cut:])]


class Join(MessageFault):
    """Messages come so many at a time, at once, as a buffer on the way hands them over."""

    kind: Literal["join"]
    count: Annotated[int, Field(ge=2, le=100)] = 2
    _kept: list[bytes] = PrivateAttr(default_factory=list)

    def through(self, message: bytes) -> Parts:
        self._kept.append(message)
        if len(self._kept) < self.count:
            return []
        return [(0, self.held())]

    def held(self) -> bytes:
        joined = b"".join(self._kept)
        self._kept.clear()
        return joined


class Garbage(MessageFault):
    """So many random bytes come before the message, as when a plug is pushed in."""

    kind: Literal["garbage"]
    count: Annotated[int, Field(ge=1, le=4096)] = 16

    def through(self, message: bytes) -> Parts:
        return [(0, self._random.randbytes(self.count) + message)]


class Flip(MessageFault):
    """Bits of the message are wrong, so that its checksum, if it has one, is too."""

    kind: Literal["flip"]
    bits: Annotated[int, Field(ge=1, le=64)] = 1

    def through(self, message: bytes) -> Parts:
        flipped = bytearray(message)
        for place in self._random.sample(range(8 * len(message)), min(self.bits, 8 * len(message))):
            flipped[place // 8] ^= 1 << place % 8
        return [(0, bytes(flipped))]


class Short(MessageFault):
    """The message breaks off, and its rest never comes."""

    kind: Literal["short"]

    def through(self, message: bytes) -> Parts:
        return [(0, message[: self._random.randrange(len(message))])]
