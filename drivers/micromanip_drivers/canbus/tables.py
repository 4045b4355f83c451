"""The tables of the compiled functions, filled from the messages of a configuration, and what those leave to Python."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from typing import Any

import can
import numpy as np
from can.interfaces.socketcan.socketcan import build_can_frame

from micromanip.driver.wire import FLOATING, MAX_BYTES, SIGNED, UNSIGNED, lend

from .link import CanLink
from .messages import ReceivedMessage, SentMessage
from .plan import BitField, Incoming, Outgoing
from .records import CONTEXT, MAX_FIELDS, MAX_GOOD, MAX_MESSAGES, MAX_WATCHED
from .socketcan import EXTENDED, frame_of

_EXACT_BITS = 53
_LEAST_BYTES, _LENGTH_AT, _MOST_DATA = 16, 4, 64


class Tables:
    """A driver's record, and its socket while that is open."""

    def __init__(
        self,
        context: np.dtype[np.void],
        received: Sequence[Incoming],
        sent: Sequence[Outgoing],
        fd: bool,
        watched: Sequence[tuple[int, bool]],
    ) -> None:
        """The record is a `context` that has ``FRAMES``; frames that are `watched` go to Python."""
        self.record = np.zeros(1, context)
        self._c = self.record[0]
        self._fields = 0
        self._c["fd"], self._c["watched_words"] = fd, len(watched)
        self._c["watched"][: len(watched)] = [_word(identity) for identity in watched]
        self._c["received_messages"], self._c["sent_messages"] = len(received), len(sent)
        for row, message in zip(self._c["received"], received, strict=False):
            row["word"], row["length"] = _word(message.identity), message.length
            row["latency_ns"], row["input"] = message.latency_ns, message.first
            row["field"], row["fields"] = self._add(message.fields)
        for row, out in zip(self._c["sent"], sent, strict=False):
            packet = build_can_frame(out.empty())
            row["word"], row["length"] = _word(out.identity), out.length
            row["bytes"], row["packet"][: len(packet)] = len(packet), np.frombuffer(packet, np.uint8)
            row["output"] = out.indices[0] if out.indices else 0
            row["field"], row["fields"] = self._add(out.fields)
        self.let_go()

    @staticmethod
    def have_room(received: Sequence[Incoming], sent: Sequence[Outgoing], watched: int) -> bool:
        """Whether so many messages, with so many signals, and so many identifiers for Python fit."""
        fields = sum(len(one.fields) for one in received) + sum(len(one.fields) for one in sent)
        return max(len(received), len(sent)) <= MAX_MESSAGES and fields <= MAX_FIELDS and watched <= MAX_WATCHED

    def hold(self, descriptor: int, stamp_bytes: int, heard_ns: int) -> None:
        """Use a socket that Python goes on owning."""
        lend(descriptor, self._c["socket"])
        self._c["socket"]["earliest_ns"] = self.heard_ns = heard_ns
        self._c["stamp_bytes"] = stamp_bytes

    def let_go(self) -> None:
        """The socket is about to be closed; what came by it and waited is forgotten."""
        self._c["socket"]["descriptor"] = -1
        self._c["left"] = self._c["receive_error"] = self._c["send_error"] = 0
        self._c["odd"] = 0

    @property
    def descriptor(self) -> int:
        """The socket's; -1 where there is none."""
        return int(self._c["socket"]["descriptor"])

    @property
    def heard_ns(self) -> int:
        """When a frame of a device came last."""
        return int(self._c["heard_ns"])

    @heard_ns.setter
    def heard_ns(self, time_ns: int) -> None:
        self._c["heard_ns"] = time_ns

    def counted(self, name: str) -> int:
        """What the compiled functions have counted: frames_in, frames_out, not_ours."""
        return int(self._c[name])

    def taken(self, link: CanLink) -> list[tuple[can.Message, int]]:
        """What they left, to begin a reception with. Raises what their system calls came to."""
        if (problem := self.error("receive_error")) is not None:
            raise link.sorted("receiving", problem)
        return link.counted(self.left())

    def complain(self, link: CanLink) -> None:
        """Raise what their sending came to, to begin one with."""
        if (problem := self.error("send_error")) is not None:
            raise link.sorted("sending", problem)

    def left(self) -> list[tuple[can.Message, int]]:
        """Frames that they left, with the times of their reception."""
        if not self._c["left"]:
            return []
        frames = list(self._odd())
        self._c["left"] = self._c["odd"] = 0
        return frames

    def error(self, name: str) -> OSError | None:
        """What a system call of theirs came to: receive_error, send_error."""
        if not (number := int(self._c[name])):
            return None
        self._c[name] = 0
        return OSError(number, os.strerror(number))

    def _odd(self) -> Iterator[tuple[can.Message, int]]:
        s, first = self._c["socket"], int(self._c["stamp_bytes"])
        for k in np.flatnonzero(self._c["odd"]):
            packet = s["received"][k][first : min(int(s["message"][k]["length"]), MAX_BYTES)].tobytes()
            if len(packet) >= _LEAST_BYTES and packet[_LENGTH_AT] <= _MOST_DATA:  # else it is no frame at all
                yield frame_of(packet), int(self._c["odd_ns"][k])

    def _add(self, fields: Sequence[BitField]) -> tuple[int, int]:
        first, self._fields = self._fields, self._fields + len(fields)
        for row, field in zip(self._c["field"][first:], fields, strict=False):
            _describe(row, field)
        return first, len(fields)


class MessageTables(Tables):
    """Those of messages with counters and a status, of devices whose silence counts."""

    def __init__(
        self, received: Sequence[ReceivedMessage], sent: Sequence[SentMessage], fd: bool, silence_ns: int | None
    ) -> None:
        """From now on the counters of the messages are kept in it."""
        super().__init__(CONTEXT, received, sent, fd, [message.identity for message in sent])
        self._c["silence_ns"] = silence_ns or 0
        for row, message in zip(self._c["received"], received, strict=False):
            if message.counter is not None:
                row["counted"] = 1
                _describe(row["counter_field"], message.own[0])
                message.counter.move_to(row["counter"])
            if message.good is not None:
                row["judged"], row["goods"] = 1, len(message.good)
                row["good"][: len(message.good)] = sorted(message.good)
                _describe(row["status_field"], message.own[-1])
        for row, out in zip(self._c["sent"], sent, strict=False):
            if out.counter is not None:
                row["counted"], row["counts"] = 1, min(out.counts, 1 << _EXACT_BITS)
                _describe(row["counter_field"], out.counter)
            out.count_in(row)

    @classmethod
    def hold_all(cls, received: Sequence[ReceivedMessage], sent: Sequence[SentMessage]) -> bool:
        """Whether they fit."""
        goods = max((len(message.good or ()) for message in received), default=0)
        return cls.have_room(received, sent, len(sent)) and goods <= MAX_GOOD


def _word(identity: tuple[int, bool]) -> int:
    """Identifier and flag as the kernel has them."""
    identifier, extended = identity
    return identifier | (EXTENDED if extended else 0)


def _describe(row: Any, field: BitField) -> None:
    row["big"], row["byte"], row["bit"], row["bits"] = field.big_endian, field.shift // 8, field.shift % 8, field.bits
    row["kind"] = FLOATING if field.floating else SIGNED if field.sign else UNSIGNED
    row["scale"], row["offset"] = field.scale, field.offset
    row["lowest_code"], row["highest_code"] = -_highest_double(-field.low), _highest_double(field.high)


def _highest_double(bound: float) -> float:
    """The highest one that is not above `bound`, which may be a whole number of more than 53 bits."""
    nearest = float(bound)
    return math.nextafter(nearest, -math.inf) if nearest > bound else nearest
