"""Which frame of a `binary` section is which, and how long it has to be."""

from __future__ import annotations

from collections.abc import Iterable

from micromanip.driver import ConfigError

from .binary_messages import IdentityFrame, ReceivedFrame
from .binary_options import Binary
from .number import NumberCodec

_OTHERS_MOST = 256
"""Longest frame of a kind that we do not know: a damaged length must not swallow what follows."""


class FrameKinds:
    """The frames that are known. Raises ConfigError for two that can't be told apart."""

    def __init__(self, options: Binary, received: Iterable[ReceivedFrame], identity: IdentityFrame | None) -> None:
        self._by_kind: dict[int | None, ReceivedFrame] = {}
        for message in received:
            if message.kind in self._by_kind:
                other = self._by_kind[message.kind].name
                why = "have the same kind" if options.kind else "can't be told apart without binary.kind"
                raise ConfigError(f"binary.receive.{message.name}: {other} and {message.name} {why}")
            self._by_kind[message.kind] = message
        self._lengths = {kind: message.length for kind, message in self._by_kind.items()}
        self.identity = identity
        if identity is not None:
            known = self._lengths.setdefault(identity.kind, identity.length)
            if identity.length > known:
                raise ConfigError(
                    f"binary.identity: its frame has {identity.length} bytes, that of the same kind in binary.receive "
                    f"has {known}"
                )
        self._kind = NumberCodec(options.kind) if options.kind else None
        self._length = NumberCodec(options.length) if options.length else None
        self._plus = options.length.plus if options.length else 0
        ends = [one.end for one in (options.kind, options.length) if one]
        self._header = max([len(options.sync.replace(" ", "")) // 2, *ends])
        crc_size = options.crc.size if options.crc else 0
        self._shortest = self._header + crc_size
        self._longest = max([_OTHERS_MOST, *self._lengths.values()])

    def kind(self, frame: bytes | bytearray) -> int | None:
        """The number by which a frame is told; None where there is one kind only."""
        return int(self._kind.read(frame)) if self._kind else None

    def message(self, frame: bytes) -> ReceivedFrame | None:
        """The message that a frame is; None for another one."""
        return self._by_kind.get(self.kind(frame))

    def length(self, data: bytes | bytearray) -> int | None:
        """Of the frame that begins with `data`: 0 if it can't be one, None if that can't be said yet."""
        if len(data) < self._header:
            return None
        known = self._lengths.get(self.kind(data))
        if self._length is None:
            return known or 0
        said = int(self._length.read(data)) + self._plus
        if known is not None:
            return known if said == known else 0
        return said if self._shortest <= said <= self._longest else 0
